"""What a fitted mixture can be asked: densities, shares, criteria, samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._checks import RandomState, check_matrix, check_number, check_sample_weight, seed_of
from ldctoolkit.mixture._conventions import Parameters
from ldctoolkit.mixture._distribution import Distribution, IntArray
from ldctoolkit.mixture._expectation import FloatArray


class FittedMixture(Parameters):
    """The questions of scikit-learn's mixtures, answered by a `Distribution`."""

    _distribution: Distribution
    random_state: RandomState
    names: Sequence[str] | None

    def score_samples(self, X: npt.ArrayLike) -> FloatArray:
        """Log-density ln f(x) of each row, (n,); -inf outside the box."""
        return self.distribution.log_density(check_matrix(X, self.distribution.dimension, self.names))

    def score(self, X: npt.ArrayLike, y: object = None, sample_weight: npt.ArrayLike | None = None) -> float:
        """Mean log-likelihood per event [nats]."""
        del y
        values = self.score_samples(X)
        return float(np.average(values, weights=check_sample_weight(sample_weight, values.size)))

    def predict_proba(self, X: npt.ArrayLike) -> FloatArray:
        """Share of each component in each row, (n, K).

        Raises
        ------
        InputError
            If a row is outside the box.
        """
        x = check_matrix(X, self.distribution.dimension, self.names)
        inside = self.distribution.inside(x)
        if not inside.all():
            row = int(np.argmin(inside))
            raise InputError(f"X: row {row} is outside the box ({int((~inside).sum())} of {inside.size} rows)")
        return self.distribution.shares(x)

    def predict(self, X: npt.ArrayLike) -> IntArray:
        """Most likely component of each row, (n,)."""
        return np.asarray(np.argmax(self.predict_proba(X), axis=1), dtype=np.int64)

    def n_parameters(self) -> int:
        """Free parameters: K means, K covariances, K - 1 weights."""
        d, K = self.distribution.dimension, self.distribution.weights.size
        return int(K * (d + d * (d + 1) // 2) + K - 1)

    def bic(self, X: npt.ArrayLike) -> float:
        """Bayesian information criterion, -2 ln L + p ln n: lower is better."""
        values = self.score_samples(X)
        return float(-2.0 * values.sum() + self.n_parameters() * np.log(values.size))

    def sample(self, n_samples: int = 1, random_state: RandomState = None) -> tuple[FloatArray, IntArray]:
        """Draw events inside the box, exactly.

        Parameters
        ----------
        n_samples : int
            Number of events; the first m of n events do not depend on n.
        random_state : int or Generator, optional
            Seed; the estimator's own by default.

        Returns
        -------
        X : (n_samples, d)
            Events in random order.
        component : (n_samples,)
            The component each came from.

        Raises
        ------
        ModelError
            If a component cannot be sampled (proposals are capped).
        """
        distribution = self.distribution
        check_number("n_samples", n_samples, 0, integer=True)
        seed = seed_of(self.random_state if random_state is None else random_state)
        return distribution.sample(int(n_samples), seed)

    @property
    def distribution(self) -> Distribution:
        """The fitted distribution, apart from how it was fitted."""
        if not hasattr(self, "_distribution"):
            raise InputError(f"{type(self).__name__}: not fitted yet; call fit first")
        return self._distribution
