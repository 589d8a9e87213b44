"""What a fitted mixture's likelihood is worth: information criteria, from one pass over the events."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._distribution import Distribution
from ldctoolkit.mixture._expectation import natural
from ldctoolkit.mixture.events import Events


@dataclasses.dataclass(frozen=True)
class Criteria:
    """Information criteria of a mixture on its events; lower is better.

    Attributes
    ----------
    events : float
        Sum of the weights n; the number of rows without any.
    log_likelihood : float
        Sum of ln f over the events.
    entropy : float
        Entropy of the shares, -sum_i sum_k tau_ik ln tau_ik [nats]: none where each event has one component.
    n_parameters : int
        Free parameters p.
    """

    events: float
    log_likelihood: float
    entropy: float
    n_parameters: int

    @property
    def aic(self) -> float:
        """Akaike's criterion, -2 ln L + 2 p."""
        return -2.0 * self.log_likelihood + 2.0 * self.n_parameters

    @property
    def bic(self) -> float:
        """Schwarz' criterion, -2 ln L + p ln n."""
        return -2.0 * self.log_likelihood + self.n_parameters * float(np.log(self.events))

    @property
    def icl(self) -> float:
        """Integrated completed likelihood, BIC plus twice the entropy of the shares."""
        return self.bic + 2.0 * self.entropy


def criteria_of(events: Events, distribution: Distribution) -> Criteria:
    """Criteria of a mixture on events inside its box.

    Parameters
    ----------
    events : Events
        Rows, with their weights if any.
    distribution : Distribution
        The mixture; all its weights are positive.

    Returns
    -------
    Criteria
        A pass over the blocks gives it; nothing is kept per event.
    """
    from ldctoolkit.mixture._kernels import statistics_of_rows  # here: the compiler is slow to import

    # components live in (y - location)/scale, y the transform's
    scaled, location, scale = distribution.own_units()
    theta, transform = natural(scaled), distribution.transform

    def look(x: FloatArray, weight: FloatArray | None) -> tuple[float, float, float]:
        """Events, log-likelihood and entropy of a block."""
        total, sums = statistics_of_rows(transform.forward(x), weight, location, scale, theta)
        # ln tau_ik = theta_k . features_i - ln sum_j exp(theta_j . features_i), and the sums hold tau_ik features_i
        entropy = total - float(np.sum(theta * sums))
        n = float(x.shape[0]) if weight is None else float(weight.sum())
        total -= n * float(np.log(scale).sum())
        if not transform.identity:
            slope = transform.log_slope(x)
            total += float(slope.sum() if weight is None else weight @ slope)
        return n, total, entropy

    n, total, entropy = 0.0, 0.0, 0.0
    for part in events.map_blocks(look):
        n, total, entropy = n + part[0], total + part[1], entropy + part[2]
    return Criteria(n, total, max(entropy, 0.0), distribution.n_parameters)
