"""What a fitted mixture can be asked: densities, shares, criteria, samples."""

from __future__ import annotations

import inspect
import math
from collections.abc import Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture._conditional import Given
from ldctoolkit.mixture._distribution import Distribution
from ldctoolkit.mixture.checks import RandomState, check_matrix, check_number, check_sample_weight, seed_of


class Parameters:
    """Constructor arguments that are kept as attributes of the same name."""

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The constructor's arguments (scikit-learn's convention)."""
        del deep
        return {
            name: getattr(self, name) for name in inspect.signature(type(self).__init__).parameters if name != "self"
        }

    def set_params(self, **params: Any) -> Self:
        """Change constructor arguments (scikit-learn's convention)."""
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise InputError(f"{type(self).__name__}: no parameter {name!r}; {nearest(name, known)}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        default = {k: v.default for k, v in inspect.signature(type(self).__init__).parameters.items()}
        shown = ", ".join(f"{k}={v!r}" for k, v in self.get_params().items() if v is not default[k])
        return f"{type(self).__name__}({shown})"


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
        likelihood, n = self._likelihood(X, sample_weight)
        return likelihood / n

    def predict_proba(self, X: npt.ArrayLike) -> FloatArray:
        """Share of each component in each row, (n, K).

        Raises
        ------
        InputError
            If a row is outside the box, or on a bound that a transform maps to infinity.
        """
        x = check_matrix(X, self.distribution.dimension, self.names)
        inside = self.distribution.has_density(x)
        if not inside.all():
            row = int(np.argmin(inside))
            raise InputError(f"X: row {row} is outside the box ({int((~inside).sum())} of {inside.size} rows)")
        return self.distribution.shares(x)

    def predict(self, X: npt.ArrayLike) -> IntArray:
        """Most likely component of each row, (n,)."""
        return np.asarray(np.argmax(self.predict_proba(X), axis=1), dtype=np.int64)

    def n_parameters(self) -> int:
        """Free parameters: K means, K covariances, K - 1 weights."""
        return self.distribution.n_parameters

    def log_prob(self, X: npt.ArrayLike, given: Given | None = None) -> FloatArray:
        """Exact log-density of each row, for reweighting, (n,).

        Parameters
        ----------
        X : (n, d)
            Rows.
        given : mapping, optional
            Conditions as for `sample`. The density is then that of the columns without a given value, normalised over
            the rows that meet the conditions, and -inf for all others.

        Raises
        ------
        InputError
            As for `sample`.

        Examples
        --------
        >>> from ldctoolkit.mixture import BoundedGaussianMixture
        >>> model = BoundedGaussianMixture.from_parameters(
        ...     [1.0], [[0.0, 0.0]], [[[1.0, 0.5], [0.5, 1.0]]], lower=0.0, names=["x", "y"]
        ... )
        >>> rows = model.sample(3, 0, given={"x": (1.0, None)})[0]
        >>> bool((model.log_prob(rows, given={"x": (1.0, None)}) > model.log_prob(rows)).all())
        True
        """
        distribution = self._given(given)
        return distribution.log_density(check_matrix(X, distribution.dimension, self.names))

    def bic(self, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> float:
        """Bayesian information criterion, -2 ln L + p ln n, n the sum of the weights: lower is better."""
        likelihood, n = self._likelihood(X, sample_weight)
        return -2.0 * likelihood + self.n_parameters() * math.log(n)

    def aic(self, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> float:
        """Akaike information criterion, -2 ln L + 2 p: lower is better."""
        likelihood, _ = self._likelihood(X, sample_weight)
        return -2.0 * likelihood + 2.0 * self.n_parameters()

    def _likelihood(self, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None) -> tuple[float, float]:
        """Log-likelihood and number of events, both weighted."""
        values = self.score_samples(X)
        weight = check_sample_weight(sample_weight, values.size)
        if values.size == 0:
            raise InputError("X: no rows")
        if weight is None:
            return float(values.sum()), float(values.size)
        used = weight > 0.0  # a row of no weight may lie outside
        return float(weight[used] @ values[used]), float(weight.sum())

    def sample(
        self, n_samples: int = 1, random_state: RandomState = None, given: Given | None = None
    ) -> tuple[FloatArray, IntArray]:
        """Draw events inside the box, exactly.

        Parameters
        ----------
        n_samples : int
            Number of events; the first m of n events do not depend on n.
        random_state : int or Generator, optional
            Seed; the estimator's own by default.
        given : mapping, optional
            Conditions: column name (if there are `names`) or number -> a value that all events have, or (lower,
            upper) between which they lie, None or infinite where open.

        Returns
        -------
        X : (n_samples, d)
            Events in random order, all columns.
        component : (n_samples,)
            The component each came from.

        Raises
        ------
        InputError
            For conditions on unknown columns, reversed intervals, intervals and values outside the box, what is not
            a number, or values for all columns.
        ModelError
            If a component cannot be sampled (proposals are capped).

        Notes
        -----
        Conditions are met exactly and not by filtering, however rare they are: see `Distribution.condition`.

        Examples
        --------
        >>> from ldctoolkit.mixture import BoundedGaussianMixture
        >>> model = BoundedGaussianMixture.from_parameters(
        ...     [1.0], [[0.0, 0.0]], [[[1.0, 0.5], [0.5, 1.0]]], lower=0.0, names=["x", "y"]
        ... )
        >>> x, _ = model.sample(1000, 0, given={"x": (1.0, 1.5), "y": 0.25})
        >>> bool(x[:, 0].min() > 1.0 and x[:, 0].max() < 1.5 and (x[:, 1] == 0.25).all())
        True
        """
        check_number("n_samples", n_samples, 0, integer=True)
        seed = seed_of(self.random_state if random_state is None else random_state)
        return self._given(given).sample(int(n_samples), seed)

    def _given(self, given: Given | None) -> Distribution:
        return self.distribution if given is None else self.distribution.condition(given, self.names)

    @property
    def distribution(self) -> Distribution:
        """The fitted distribution, apart from how it was fitted."""
        if not hasattr(self, "_distribution"):
            raise InputError(f"{type(self).__name__}: not fitted yet; call fit first")
        return self._distribution
