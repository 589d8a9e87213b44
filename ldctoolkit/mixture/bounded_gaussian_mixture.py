"""Bounded Gaussian mixture: sum_k eta_k g_k(x)/P_k on a box, fitted by the truncated EM of Lee and Scott."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture._checks import (
    RandomState,
    check_bound_array,
    check_constant,
    check_inside,
    check_matrix,
    check_number,
    seed_of,
)
from ldctoolkit.mixture._em import EMSettings, fit_components
from ldctoolkit.mixture._expectation import Components, FloatArray, log_sum, log_terms
from ldctoolkit.mixture._maximisation import Step
from ldctoolkit.mixture.truncated_normal import TruncatedNormal, check_bounds

IntArray = npt.NDArray[np.int64]

SAMPLE_BLOCK: Final = 1024
"""Events drawn from one random stream; fixed, so that the first m of n samples do not depend on n."""


class BoundedGaussianMixture:
    """Mixture of K multivariate normals, each truncated to one box and normalised on it.

    Follows scikit-learn's conventions (`fit`, `score_samples`, `get_params`, fitted attributes that end in ``_``)
    without depending on it.

    Parameters
    ----------
    n_components : int
        K.
    lower, upper : (d,) or float, optional
        The box, in the data's units; infinite entries are open, None is open everywhere.
    random_state : int or Generator, optional
        Seed of the starts, and of `sample` when it is given none.
    n_init : int
        Short runs from different k-means starts; the best one is continued.
    short_iter : int
        Passes of a short run.
    subsample : int
        Events used by the short runs.
    tol : float
        Stop when the penalised log-likelihood per event gained less than this per pass, on average over five passes.
    max_iter : int
        Most passes of the final run.
    prior_strength : float
        Pseudo-events per component, pulling its covariance towards the covariance of the events around it. Without
        them the likelihood of data that pile up at a bound may have no maximum: a component runs away and its box
        probability to zero. 10 is mild; 0 is plain maximum likelihood.
    step : {"newton", "lee_scott"}
        M-step, see Notes.
    names : sequence of str, optional
        Column names for messages.

    Attributes
    ----------
    weights_ : (K,)
        eta_k, the share of events of each component.
    means_ : (K, d)
        mu_k before truncation; it may lie outside the box.
    covariances_ : (K, d, d)
        Sigma_k before truncation.
    log_probabilities_ : (K,)
        ln P_k, the logarithm of each normal's probability of the box.
    converged_ : bool
        Whether `tol` was reached at a maximum.
    stop_reason_ : str
        "converged", "max_iter", "stuck" (no step gained, though it is no maximum) or "collapsed" (a component became
        too thin for the arithmetic; the pass before is kept).
    n_iter_ : int
        Passes of the final run.
    lower_bound_ : float
        Penalised log-likelihood per event at the end of the final run [nats], in standardised units.
    lower_bounds_ : (n_iter_ + 1,)
        Its history; it never falls.
    n_features_in_ : int
        d.

    Notes
    -----
    f(x) = sum_k eta_k g_k(x)/P_k, eta_k = pi_k P_k/sum_j pi_j P_j. In the M-step of Lee and Scott the weighted mean
    and scatter are corrected by the moments of the truncated normal,

        mu_k' = xbar_k - m_k,  m_k = E_k[x] - mu_k,
        Sigma_k' = weighted scatter about mu_k' + H_k,  H_k = Sigma_k - E_k[(x - mu_k)(x - mu_k)^T].

    It is a fixed-point step on the likelihood equations and converges slowly where much of a component lies outside.
    The default ``"newton"`` solves the same equations by Newton's method with the Fisher matrix from the same
    moments; dimensions open on both sides are a regression on the others, exact in one step. Either step is
    shortened until the objective does not fall, and where no length gains the other is tried. Both have the same
    fixed points.

    References
    ----------
    Lee and Scott, CSDA 56(9):2816-2829, 2012. Zhao, Wang, LeBlanc, 2017, section III.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.abs(np.random.default_rng(0).normal(size=(2000, 1)))
    >>> model = BoundedGaussianMixture(1, lower=0.0, random_state=0, n_init=1).fit(x)
    >>> bool(model.sample(100, 1)[0].min() > 0)
    True
    """

    weights_: FloatArray
    means_: FloatArray
    covariances_: FloatArray
    log_probabilities_: FloatArray
    converged_: bool
    stop_reason_: str
    n_iter_: int
    lower_bound_: float
    lower_bounds_: FloatArray
    n_features_in_: int

    def __init__(
        self,
        n_components: int = 1,
        *,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
        random_state: RandomState = None,
        n_init: int = 8,
        short_iter: int = 15,
        subsample: int = 8000,
        tol: float = 1e-6,
        max_iter: int = 500,
        prior_strength: float = 10.0,
        step: Step = "newton",
        names: Sequence[str] | None = None,
    ) -> None:
        self.n_components = n_components
        self.lower = lower
        self.upper = upper
        self.random_state = random_state
        self.n_init = n_init
        self.short_iter = short_iter
        self.subsample = subsample
        self.tol = tol
        self.max_iter = max_iter
        self.prior_strength = prior_strength
        self.step = step
        self.names = names

    @classmethod
    def from_parameters(
        cls,
        weights: npt.ArrayLike,
        means: npt.ArrayLike,
        covariances: npt.ArrayLike,
        *,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
        names: Sequence[str] | None = None,
    ) -> BoundedGaussianMixture:
        """A mixture with known parameters, as good as fitted.

        Parameters
        ----------
        weights : (K,)
            eta_k, positive, summing to one.
        means : (K, d)
            mu_k.
        covariances : (K, d, d)
            Sigma_k.
        lower, upper, names
            As for the class.

        Raises
        ------
        InputError
            On wrong shapes, weights that are not shares, or a covariance that is not positive definite.
        """
        eta, mu = np.asarray(weights, dtype=float), np.asarray(means, dtype=float)
        if eta.ndim != 1 or mu.ndim != 2 or mu.shape[0] != eta.shape[0]:
            raise InputError(f"weights {eta.shape}, means {mu.shape}; allowed: (K,) and (K, d)")
        if not (np.all(eta >= 0) and abs(eta.sum() - 1.0) < 1e-6):
            raise InputError(f"weights: sum {eta.sum():.9g}, least {eta.min():g}; allowed: shares >= 0 that sum to 1")
        model = cls(eta.size, lower=lower, upper=upper, names=names)
        model._store(eta, mu, np.asarray(covariances, dtype=float))
        return model

    def _bounds(self, dimension: int) -> tuple[FloatArray, FloatArray]:
        low = check_bound_array(self.lower, "lower", -np.inf, dimension)
        high = check_bound_array(self.upper, "upper", np.inf, dimension)
        check_bounds(low, high)
        return low, high

    def _store(self, weights: FloatArray, means: FloatArray, covariances: FloatArray) -> None:
        self.n_features_in_ = means.shape[1]
        low, high = self._bounds(self.n_features_in_)
        self._truncated = TruncatedNormal(means, covariances, low, high)
        self.weights_, self.means_, self.covariances_ = weights, means, covariances
        self.log_probabilities_ = self._truncated.log_probability

    def _check_settings(self) -> None:
        check_number("n_components", self.n_components, 1, integer=True)
        check_number("n_init", self.n_init, 1, integer=True)
        check_number("short_iter", self.short_iter, 1, integer=True)
        check_number("subsample", self.subsample, 1, integer=True)
        check_number("tol", self.tol, 0.0)
        check_number("max_iter", self.max_iter, 1, integer=True)
        check_number("prior_strength", self.prior_strength, 0.0)
        if self.step not in ("newton", "lee_scott"):
            raise InputError(f"step: {self.step!r}; {nearest(str(self.step), ('newton', 'lee_scott'))}")

    def fit(self, X: npt.ArrayLike, y: object = None) -> Self:
        """Fit by truncated EM.

        Parameters
        ----------
        X : (n, d)
            Events, strictly inside the box.
        y : ignored
            For scikit-learn's conventions.

        Returns
        -------
        self

        Raises
        ------
        InputError
            Data on or outside a bound, not finite, a constant column, fewer rows than ``K (d + 1)``, or a setting out
            of range; the message names the column, the row and the count. Also without a prior, where the likelihood
            has no maximum.
        """
        del y
        self._check_settings()
        x = check_matrix(X, None, self.names)
        n, d = x.shape
        if d == 0:
            raise InputError("X: no columns")
        low, high = self._bounds(d)
        least = self.n_components * (d + 1)
        if n < least:
            raise InputError(f"X: {n} rows; allowed: at least K (d + 1) = {least} for K = {self.n_components}, d = {d}")
        check_inside(x, low, high, self.names)
        check_constant(x, self.names)
        location, scale = x.mean(axis=0), x.std(axis=0)
        settings = EMSettings(
            K=int(self.n_components),
            lower=(low - location) / scale,
            upper=(high - location) / scale,
            seed=seed_of(self.random_state),
            n_init=int(self.n_init),
            short_iter=int(self.short_iter),
            subsample=int(self.subsample),
            tol=float(self.tol),
            max_iter=int(self.max_iter),
            prior_strength=float(self.prior_strength),
            step=self.step,
        )
        result = fit_components((x - location) / scale, settings)
        c = result.components
        self._store(c.weights, location + scale * c.mu, c.Sigma * scale[:, None] * scale)
        self.stop_reason_, self.converged_ = result.stop_reason, result.stop_reason == "converged"
        self.n_iter_ = result.history.size - 1
        self.lower_bounds_, self.lower_bound_ = result.history, float(result.history[-1])
        return self

    def _terms(self, X: npt.ArrayLike) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
        """ln(eta_k g_k/P_k), (n, K), and which rows are inside the box."""
        self._check_fitted()
        x = check_matrix(X, self.n_features_in_, self.names)
        low, high = self._bounds(self.n_features_in_)
        # standardised by the mixture's own spread: the features x_i x_j would otherwise cancel
        location = self.weights_ @ self.means_
        variances = np.diagonal(self.covariances_, axis1=1, axis2=2)
        scale = np.sqrt(self.weights_ @ variances)
        inside = np.all((x >= low) & (x <= high), axis=1)
        scaled = Components(
            self.weights_,
            (self.means_ - location) / scale,
            self.covariances_ / (scale[:, None] * scale),
            self.log_probabilities_,
        )
        return log_terms((x - location) / scale, scaled) - float(np.log(scale).sum()), inside

    def score_samples(self, X: npt.ArrayLike) -> FloatArray:
        """Log-density ln f(x) of each row, (n,); -inf outside the box."""
        terms, inside = self._terms(X)
        return np.where(inside, log_sum(terms)[0], -np.inf)

    def score(self, X: npt.ArrayLike, y: object = None) -> float:
        """Mean log-likelihood per event [nats]."""
        del y
        return float(np.mean(self.score_samples(X)))

    def predict_proba(self, X: npt.ArrayLike) -> FloatArray:
        """Share of each component in each row, (n, K).

        Raises
        ------
        InputError
            If a row is outside the box.
        """
        terms, inside = self._terms(X)
        if not inside.all():
            row = int(np.argmin(inside))
            raise InputError(f"X: row {row} is outside the box ({int((~inside).sum())} of {inside.size} rows)")
        return log_sum(terms)[1]

    def predict(self, X: npt.ArrayLike) -> IntArray:
        """Most likely component of each row, (n,)."""
        return np.asarray(np.argmax(self.predict_proba(X), axis=1), dtype=np.int64)

    def n_parameters(self) -> int:
        """Free parameters: K means, K covariances, K - 1 weights."""
        self._check_fitted()
        K, d = self.means_.shape
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
        self._check_fitted()
        check_number("n_samples", n_samples, 0, integer=True)
        seed = seed_of(self.random_state if random_state is None else random_state)
        parts = [self.sample_block(seed, (block,)) for block in range(-(-int(n_samples) // SAMPLE_BLOCK))]
        if not parts:
            return np.empty((0, self.n_features_in_)), np.empty(0, dtype=np.int64)
        return np.concatenate([p[0] for p in parts])[:n_samples], np.concatenate([p[1] for p in parts])[:n_samples]

    def check_samplable(self) -> None:
        """Draw from every component: a `ModelError` here rather than in a later `sample`."""
        for k in np.flatnonzero(self.weights_ > 0.0):
            self._truncated.sample(4, 0, component=int(k))

    def sample_block(self, seed: int, key: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """`SAMPLE_BLOCK` events from the random stream named by (seed, key)."""
        self._check_fitted()
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
        label = rng.choice(self.weights_.size, size=SAMPLE_BLOCK, p=self.weights_ / self.weights_.sum())
        x = np.empty((SAMPLE_BLOCK, self.n_features_in_))
        for k in range(self.weights_.size):
            rows = np.flatnonzero(label == k)
            x[rows] = self._truncated.sample(rows.size, rng, component=k)
        return x, label.astype(np.int64)

    def _check_fitted(self) -> None:
        if not hasattr(self, "weights_"):
            raise InputError("BoundedGaussianMixture: not fitted yet; call fit first")

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
                raise InputError(f"BoundedGaussianMixture: no parameter {name!r}; {nearest(name, known)}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        default = {k: v.default for k, v in inspect.signature(type(self).__init__).parameters.items()}
        shown = ", ".join(f"{k}={v!r}" for k, v in self.get_params().items() if v is not default[k])
        return f"BoundedGaussianMixture({shown})"
