"""One K of a range: its fit, its criteria, and what it says of events it has not seen."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture._distribution import Distribution
from ldctoolkit.mixture._expectation import natural
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.events import Events


@dataclasses.dataclass(frozen=True)
class Failure:
    """A K that could not be fitted.

    Attributes
    ----------
    n_components : int
        K.
    message : str
        Why not.
    """

    n_components: int
    message: str


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Log-densities of held-out rows."""

    value: FloatArray  # (m,): ln f of each row [nats], or a difference of two
    weight: FloatArray  # (m,): events that each row stands for

    @property
    def mean(self) -> float:
        """Mean per event."""
        return float(np.average(self.value, weights=self.weight))

    @property
    def error(self) -> float:
        """Standard error of the mean; a row counts as one draw, whatever its weight."""
        spread = self.weight * (self.value - self.mean)
        rows = int(np.count_nonzero(self.weight))
        total = float(self.weight.sum())
        return float(np.sqrt(spread @ spread * rows / max(rows - 1, 1))) / total

    def minus(self, other: HeldOut) -> HeldOut:
        """Row by row, less the other."""
        return HeldOut(self.value - other.value, self.weight)


@dataclasses.dataclass(frozen=True)
class Trial:
    """A fit of one K and what it is worth; `held_out` is empty where nothing was held out."""

    model: BoundedGaussianMixture
    criteria: Criteria
    held_out: HeldOut

    @property
    def n_components(self) -> int:
        """K."""
        return self.model.n_components


Outcome = Trial | Failure


@dataclasses.dataclass(frozen=True)
class Trials:
    """Fits one K after the other; it can be pickled."""

    held: IntArray | None  # (m,): rows to hold out, ascending

    def __call__(self, events: Events, model: BoundedGaussianMixture) -> Outcome:
        """Fit one K to the events; the model is changed."""
        try:
            held_out = self._held_out(events, model)
            model._fit_events(events)
        except InputError as error:
            return Failure(model.n_components, str(error))
        return Trial(model, criteria_of(events, model.distribution), held_out)

    def _held_out(self, events: Events, model: BoundedGaussianMixture) -> HeldOut:
        if self.held is None:
            return HeldOut(np.empty(0), np.empty(0))
        kept = np.ones(events.rows, dtype=bool)
        kept[self.held] = False
        held = events.take(self.held)
        try:
            other = BoundedGaussianMixture(**model.get_params())._fit_events(events.take(kept))
        except InputError as error:
            raise InputError(f"without the {self.held.size} rows held out: {error}") from None
        weight = np.ones(held.rows) if held.weight is None else held.weight
        return HeldOut(other.distribution.log_density(held.x), weight)


def split_rows(events: Events, share: float, seed: int) -> IntArray:
    """Rows to hold out, ascending: as many as the share says, drawn with the seed."""
    if isinstance(share, bool) or not isinstance(share, int | float | np.number) or not 0.0 < share < 1.0:
        raise InputError(f"held_out_share: {share!r}; allowed: a number between 0 and 1")
    rows = events.rows
    count = round(float(share) * rows)
    held = np.sort(np.random.default_rng([seed, 2]).permutation(rows)[:count])
    weight = np.ones(rows) if events.weight is None else events.weight
    seen = np.count_nonzero(weight[held])
    if seen < 2 or seen == np.count_nonzero(weight):
        raise InputError(
            f"held_out_share: {float(share):g} holds out {seen} of {np.count_nonzero(weight)} rows; "
            "allowed: at least two, and not all"
        )
    return held.astype(np.int64)


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
    """Criteria of a mixture on events inside its box."""
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
