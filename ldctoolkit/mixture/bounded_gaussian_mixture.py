"""Bounded Gaussian mixture: sum_k eta_k g_k(x)/P_k on a box, fitted by the truncated EM of Lee and Scott."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Sequence
from dataclasses import field
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, unmasked
from ldctoolkit.errors import CheckedArguments, InputError
from ldctoolkit.mixture._distribution import Conditions, Distribution, Transform
from ldctoolkit.mixture._em import EMSettings, fit_components
from ldctoolkit.mixture._expectation import Components
from ldctoolkit.mixture._maximisation import Step
from ldctoolkit.mixture.checks import (
    Events,
    Profile,
    RandomState,
    check_bound_array,
    check_events,
    check_matrix,
    check_number,
    check_sample_weight,
    column_name,
    profile_of,
    seed_of,
    sums_of,
)
from ldctoolkit.mixture.truncated_normal import TruncatedNormal, check_bounds

_LEAST_LOG_P: Final = -20.0
"""Below this ln P the box lies some 6 standard deviations off: only the density inside still says something."""

_FAR_OUTSIDE: Final = 6.0
_SAME: Final = 0.9999  # correlation of two columns of which one could be left out

_THIN: Final = 5e-3
"""Standard deviation of a component, in the data's, below which it describes single values rather than a spread."""

_LOST_DIGITS: Final = 1e-8
"""Spread of a column over its size: half of a number's sixteen digits are used up by what is common to all rows."""

_OUTLYING: Final = 5.0
_SHARE_OF_ONE: Final = 0.5
_MOST: Final = 6  # components named in a sentence


def correlation_of(events: Events, profile: Profile) -> FloatArray:
    """Correlations (d, d) of the events' columns, by one pass."""
    d = events.dimension
    i, j = np.triu_indices(d)
    _, sums = sums_of(events, profile.mean, profile.scale, np.zeros((1, 1 + d + i.size)))
    out = np.empty((d, d))
    out[i, j] = out[j, i] = sums[0, 1 + d :] / sums[0, 0]
    return out


def fit_warnings(
    distribution: Distribution,
    profile: Profile,
    correlation: FloatArray,
    *,
    stop_reason: str,
    passes: int,
    names: Sequence[str] | None = None,
) -> tuple[str, ...]:
    """Sentences, the gravest first; none where nothing is to be reported."""
    out = [_stopped(stop_reason, passes)] if stop_reason != "converged" else []
    out += _of_components(distribution, profile)
    out += _of_columns(profile, correlation, names)
    return tuple(out)


def _stopped(stop_reason: str, passes: int) -> str:
    if stop_reason == "max_iter":
        return f"Not converged in {passes} passes: raise max_iter or tol."
    if stop_reason == "stuck":
        return (
            f"Not converged: after {passes} passes no step raised the likelihood, though it is at no maximum; raise "
            "prior_strength or fit fewer components."
        )
    return (
        f"Not converged: after {passes} passes a component had become too thin for the arithmetic; raise "
        "prior_strength or fit fewer components."
    )


def _of_components(distribution: Distribution, profile: Profile) -> list[str]:
    t = distribution.truncated
    d = distribution.dimension
    out: list[str] = []
    if t.box is not None:
        lost = ~np.isfinite(t.box.log_peak) & (t.log_probability < np.log(0.25))
        if lost.any():
            out.append(f"{_which(lost)} cannot be sampled: the box is too far off.")
    parameters = d + d * (d + 1) // 2
    events = distribution.weights * profile.events
    few = events < parameters
    if few.any():
        out.append(
            f"{_which(few)} ({_figures(few, events)} events): fewer than the {parameters} parameters of a mean and a "
            "covariance; the prior decides the rest."
        )
    deviation = np.sqrt(np.diagonal(t.Sigma, axis1=1, axis2=2))
    outside = np.max(np.maximum(np.maximum(t.lower - t.mu, t.mu - t.upper) / deviation, 0.0), axis=1)
    far = (t.log_probability < _LEAST_LOG_P) | (outside > _FAR_OUTSIDE)
    if far.any():
        out.append(
            f"{_which(far)} (ln P {_figures(far, t.log_probability)}; {_figures(far, outside)} standard deviations "
            "outside the box): events pile up at a bound as an exponential does; mean and covariance before truncation "
            "say little, the density in the box holds."
        )
    scaled = t.Sigma / (profile.scale[:, None] * profile.scale)
    width = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[:, 0], 0.0))
    thin = width < _THIN
    if thin.any():
        out.append(
            f"{_which(thin)} ({_figures(thin, width)} standard deviations of the data): hardly any width in some "
            "direction; look for repeated rows, columns that depend on each other, or events far off."
        )
    return out


def _of_columns(profile: Profile, correlation: FloatArray, names: Sequence[str] | None) -> list[str]:
    out: list[str] = []
    for a, b in zip(*(k.tolist() for k in np.triu_indices(correlation.shape[0], 1)), strict=True):
        r = float(correlation[a, b])
        if abs(r) > _SAME:
            one, other = column_name(a, names), column_name(b, names)
            out.append(f"{_capital(one)} and {other} are nearly the same (correlation {r:.9g}): leave one out.")
    above, below = (profile.most - profile.mean) / profile.scale, (profile.mean - profile.least) / profile.scale
    off = np.maximum(above, below)
    size = np.maximum(np.abs(profile.least), np.abs(profile.most))
    for j in range(size.size):
        name = _capital(column_name(j, names))
        share = min(float(off[j] ** 2) / profile.rows, 1.0)
        if profile.scale[j] < _LOST_DIGITS * size[j]:
            ratio = float(profile.scale[j] / size[j])
            out.append(f"{name} varies by {ratio:.1g} of its size: few digits are left; subtract what is common.")
        if off[j] > _OUTLYING and share > _SHARE_OF_ONE:
            value = float(profile.most[j] if above[j] >= below[j] else profile.least[j])
            out.append(f"{name}: one event, {value:.6g}, makes up {share:.0%} of the variance; is it real?")
    return out


def _which(mask: BoolArray) -> str:
    """Names of components: ``Component 2``, ``Components 2, 5``."""
    rows = np.flatnonzero(mask)
    more = ", ..." if rows.size > _MOST else ""
    return f"Component{'s' if rows.size > 1 else ''} {', '.join(str(k) for k in rows[:_MOST])}{more}"


def _figures(mask: BoolArray, values: FloatArray) -> str:
    """The same components' figures."""
    shown = values[mask]
    return ", ".join(f"{v:.3g}" for v in shown[:_MOST].tolist()) + (", ..." if shown.size > _MOST else "")


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


@dataclasses.dataclass(eq=False, repr=False)
class BoundedGaussianMixture(CheckedArguments):
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
        Rows used by the short runs, and by the moves.
    split_merge : bool
        Whether the best short run is led out of local optima: one component is split and two are merged, as long as
        that raises the likelihood. It finds optima that many more starts miss, and takes longer than they do on few
        events.
    tol : float
        Stop when the penalised log-likelihood per event gained less than this per pass, on average over five passes.
    max_iter : int
        Most passes over all events; the run on all lattice points makes one more where the one before used them up.
    prior_strength : float
        Pseudo-events per component, pulling its covariance towards the covariance of the events around it. Without
        them the likelihood of data that pile up at a bound may have no maximum: a component runs away and its box
        probability to zero. 10 is mild; 0 is plain maximum likelihood.
    step : {"newton", "lee_scott"}
        M-step, see Notes.
    transform : {"none", "log", "logit", "auto"} or sequence of them, optional
        Map of each column before the fit; none by default, as in the paper. ``"log"`` needs one finite bound,
        ``"logit"`` two, ``"auto"`` takes what the bounds allow. A mapped column has no bound any more, so no mass can
        pile up at it; `means_` and `covariances_` are in the mapped coordinates, densities and samples in the data's.
    warm_start : bool
        Go on from the last fit (or from `from_parameters`) in place of new starts.
    verbose : int
        1 tells of starts and of every pass on stderr, 0 is silent.
    n_jobs : int, optional
        Threads; all cores by default. It changes no number.
    names : sequence of str, optional
        Column names for messages.

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

    n_components: int = 1
    _: dataclasses.KW_ONLY
    lower: npt.ArrayLike | None = None
    upper: npt.ArrayLike | None = None
    random_state: RandomState = None
    n_init: int = 8
    short_iter: int = 15
    subsample: int = 25_000
    split_merge: bool = True
    tol: float = 1e-7
    max_iter: int = 500
    prior_strength: float = 10.0
    step: Step = "newton"
    transform: str | Sequence[str] | None = None
    warm_start: bool = False
    verbose: int = 0
    n_jobs: int | None = None
    names: Sequence[str] | None = None

    weights_: FloatArray = field(init=False)  # (K,) eta_k, the share of events of each component
    means_: FloatArray = field(init=False)  # (K, d) mu_k before truncation; it may lie outside the box
    covariances_: FloatArray = field(init=False)  # (K, d, d) Sigma_k before truncation
    log_probabilities_: FloatArray = field(init=False)  # (K,) ln P_k, of each normal's probability of the box
    converged_: bool = field(init=False)  # Whether `tol` was reached at a maximum
    # "converged", "max_iter", "stuck" (no step gained, though it is no maximum) or "collapsed" (a component became too
    # thin for the arithmetic; the pass before is kept)
    stop_reason_: str = field(init=False)
    # Passes, those on few lattice points included; leaps that were refused are not counted
    n_iter_: int = field(init=False)
    # Penalised log-likelihood per event at the end of the final run [nats], in standardised coordinates
    lower_bound_: float = field(init=False)
    # (m,) Its history over the final run, on all lattice points; it falls by no more than rounding, 1e-8
    lower_bounds_: FloatArray = field(init=False)
    lower_: FloatArray = field(init=False)  # (d,) The box
    upper_: FloatArray = field(init=False)
    # What a user should know before trusting the fit, the gravest first; empty where there is nothing to report
    warnings_: tuple[str, ...] = field(init=False)
    n_features_in_: int = field(init=False)  # d

    _distribution: Distribution = field(init=False)

    def __repr__(self) -> str:
        shown = (f for f in dataclasses.fields(self) if f.init and getattr(self, f.name) is not f.default)
        return f"{type(self).__name__}({', '.join(f'{f.name}={getattr(self, f.name)!r}' for f in shown)})"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """The constructor's arguments (scikit-learn's convention)."""
        del deep
        return {one.name: getattr(self, one.name) for one in dataclasses.fields(self) if one.init}

    def set_params(self, **params: Any) -> Self:
        """Change constructor arguments (scikit-learn's convention)."""
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise InputError(type(self).__name__, "is no parameter", value=name, allowed=known)
            setattr(self, name, value)
        return self

    @classmethod
    def from_parameters(
        cls,
        weights: npt.ArrayLike,
        means: npt.ArrayLike,
        covariances: npt.ArrayLike,
        *,
        lower: npt.ArrayLike | None = None,
        upper: npt.ArrayLike | None = None,
        transform: str | Sequence[str] | None = None,
        names: Sequence[str] | None = None,
    ) -> BoundedGaussianMixture:
        """A mixture with known parameters, as good as fitted.

        Raises `InputError` on wrong shapes, weights that are not shares, or a covariance that is not positive definite.

        Parameters
        ----------
        weights : (K,)
            eta_k, positive, summing to one.
        means : (K, d)
            mu_k.
        covariances : (K, d, d)
            Sigma_k.
        lower, upper, transform, names
            As for the class.
        """
        eta, mu, Sigma = (np.asarray(unmasked(one), dtype=float) for one in (weights, means, covariances))
        if eta.ndim != 1 or mu.ndim != 2 or mu.shape[0] != eta.shape[0]:
            raise InputError(f"weights {eta.shape}, means {mu.shape}; allowed: (K,) and (K, d)")
        if not (np.all(eta >= 0) and abs(eta.sum() - 1.0) < 1e-6):
            raise InputError(
                "weights", f"sum {eta.sum():.9g}, least {eta.min():g}", allowed="shares >= 0 that sum to 1"
            )
        model = cls(eta.size, lower=lower, upper=upper, transform=transform, names=names)
        model._store(eta, mu, Sigma, _checked_transform(lower, upper, transform, mu.shape[1]))
        return model

    def score_samples(self, X: npt.ArrayLike) -> FloatArray:
        """Log-density ln f(x) of each row, (n,); -inf outside the box."""
        return self.distribution.log_density(check_matrix(X, self.distribution.dimension, self.names))

    def score(self, X: npt.ArrayLike, y: object = None, sample_weight: npt.ArrayLike | None = None) -> float:
        """Mean log-likelihood per event [nats]."""
        del y
        likelihood, n = self._likelihood(X, sample_weight)
        return likelihood / n

    def predict_proba(self, X: npt.ArrayLike) -> FloatArray:
        """Share of each component in each row, (n, K); a row outside the box is an `InputError`."""
        x = check_matrix(X, self.distribution.dimension, self.names)
        inside = self.distribution.has_density(x)
        if not inside.all():
            row = int(np.argmin(inside))
            raise InputError("X", f"row {row} is outside the box ({int((~inside).sum())} of {inside.size} rows)")
        return self.distribution.shares(x)

    def predict(self, X: npt.ArrayLike) -> IntArray:
        """Most likely component of each row, (n,)."""
        return np.asarray(np.argmax(self.predict_proba(X), axis=1), dtype=np.int64)

    def n_parameters(self) -> int:
        """Free parameters: K means, K covariances, K - 1 weights."""
        return self.distribution.n_parameters

    def log_prob(self, X: npt.ArrayLike, given: Conditions | None = None) -> FloatArray:
        """Exact log-density of each row, for reweighting, (n,).

        Raises `InputError` as for `sample`.

        Parameters
        ----------
        X : (n, d)
            Rows.
        given : mapping, optional
            Conditions as for `sample`. The density is then that of the columns without a given value, normalised over
            the rows that meet the conditions, and -inf for all others.

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
            raise InputError("X", "no rows")
        if weight is None:
            return float(values.sum()), float(values.size)
        used = weight > 0.0  # a row of no weight may lie outside
        return float(weight[used] @ values[used]), float(weight.sum())

    def sample(
        self, n_samples: int = 1, random_state: RandomState = None, given: Conditions | None = None
    ) -> tuple[FloatArray, IntArray]:
        """Draw events inside the box, exactly.

        Raises `InputError` for conditions on unknown columns, reversed intervals, intervals and values outside the box,
        what is not a number, or values for all columns; `ModelError` if a component cannot be sampled (proposals are
        capped).

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

    def _given(self, given: Conditions | None) -> Distribution:
        return self.distribution if given is None else self.distribution.condition(given, self.names)

    @property
    def distribution(self) -> Distribution:
        """The fitted distribution, apart from how it was fitted."""
        if not hasattr(self, "_distribution"):
            raise InputError(f"{type(self).__name__}", "not fitted yet", hint="call fit first")
        return self._distribution

    def _store(self, weights: FloatArray, means: FloatArray, covariances: FloatArray, transform: Transform) -> None:
        truncated = TruncatedNormal(means, covariances, *transform.box())
        self._distribution = Distribution(weights, truncated, transform)
        self.n_features_in_ = means.shape[1]
        self.lower_, self.upper_ = transform.lower, transform.upper
        self.weights_, self.means_, self.covariances_ = weights, means, covariances
        self.log_probabilities_ = truncated.log_probability
        self.warnings_ = ()

    def _check_settings(self) -> None:
        for name, least in (("n_components", 1), ("n_init", 1), ("short_iter", 1), ("subsample", 1), ("max_iter", 1)):
            check_number(name, getattr(self, name), least, integer=True)
        check_number("tol", self.tol, 0.0)
        check_number("prior_strength", self.prior_strength, 0.0)
        if self.n_jobs is not None:
            check_number("n_jobs", self.n_jobs, 1, integer=True)
        if self.step not in ("newton", "lee_scott"):
            raise InputError("step", value=self.step, allowed=("newton", "lee_scott"))

    def fit(self, X: npt.ArrayLike, y: object = None, sample_weight: npt.ArrayLike | None = None) -> Self:
        """Fit by truncated EM.

        Parameters
        ----------
        X : (n, d)
            Events, strictly inside the box.
        y : ignored
            For scikit-learn's conventions.
        sample_weight : (n,), optional
            Events that each row stands for, not negative; a row of weight 2 counts as two, one of weight 0 not at all.

        Raises
        ------
        InputError
            Data on or outside a bound, not finite, a constant column, fewer rows than ``K (d + 1)``, or a setting out
            of range; the message names the column, the row and the count. Also without a prior, where the likelihood
            has no maximum.
        """
        del y
        self._check_settings()
        return self._fit_events(Events.of(X, sample_weight, self.n_jobs))

    def _fit_events(self, events: Events) -> Self:
        """Fit to rows that have weights already, on the threads that they name."""
        self._check_settings()
        transform = _checked_transform(self.lower, self.upper, self.transform, events.dimension)
        profile = check_events(events, self.n_components, transform.lower, transform.upper, self.names)
        if not transform.identity:
            events = dataclasses.replace(events, x=transform.forward(events.x))
            profile = profile_of(events)
        low, high = transform.box()
        location, scale = profile.mean, profile.scale
        settings = EMSettings(
            K=int(self.n_components),
            lower=(low - location) / scale,
            upper=(high - location) / scale,
            seed=seed_of(self.random_state),
            n_init=int(self.n_init),
            short_iter=int(self.short_iter),
            subsample=int(self.subsample),
            split_merge=bool(self.split_merge),
            tol=float(self.tol),
            max_iter=int(self.max_iter),
            prior_strength=float(self.prior_strength),
            step=self.step,
            threads=self.n_jobs,
        )
        result = fit_components(events, profile, settings, self._start(location, scale), self._report)
        c = result.components
        self._store(c.weights, location + scale * c.mu, c.Sigma * scale[:, None] * scale, transform)
        self.stop_reason_, self.converged_ = result.stop_reason, result.stop_reason == "converged"
        self.n_iter_ = result.passes
        self.lower_bounds_, self.lower_bound_ = result.history, float(result.history[-1])
        self.warnings_ = fit_warnings(
            self._distribution,
            profile,
            correlation_of(events, profile),
            stop_reason=result.stop_reason,
            passes=self.n_iter_,
            names=self.names,
        )
        return self

    def _start(self, location: FloatArray, scale: FloatArray) -> Components | None:
        """Where a warm start goes on, in standardised units."""
        if not self.warm_start or not hasattr(self, "weights_"):
            return None
        if self.means_.shape != (self.n_components, location.size):
            K, d = self.means_.shape
            raise InputError(
                "warm_start",
                f"the last fit has K = {K} and {d} columns",
                allowed=f"n_components = {self.n_components} and {location.size} columns, as now",
            )
        mu, Sigma = (self.means_ - location) / scale, self.covariances_ / (scale[:, None] * scale)
        return Components(self.weights_, mu, Sigma, self.log_probabilities_)

    def _report(self, line: str) -> None:
        if self.verbose:
            print(f"K = {self.n_components}: {line}", file=sys.stderr)


def _checked_transform(
    lower: npt.ArrayLike | None, upper: npt.ArrayLike | None, wanted: str | Sequence[str] | None, dimension: int
) -> Transform:
    low = check_bound_array(lower, "lower", -np.inf, dimension)
    high = check_bound_array(upper, "upper", np.inf, dimension)
    check_bounds(low, high)
    return Transform.of(wanted, low, high)
