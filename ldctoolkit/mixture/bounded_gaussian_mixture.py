"""Bounded Gaussian mixture: sum_k eta_k g_k(x)/P_k on a box, fitted by the truncated EM of Lee and Scott."""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import field
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, unmasked
from ldctoolkit.declared import checked_number, checked_whole
from ldctoolkit.errors import CheckedArguments, InputError
from ldctoolkit.mixture._distribution import Components, Conditions, Distribution, Transform
from ldctoolkit.mixture._em import EMSettings, StopReason, fit_components
from ldctoolkit.mixture.checks import (
    Events,
    Profile,
    RandomState,
    check_bound_array,
    check_events,
    check_matrix,
    check_sample_weight,
    column_name,
    profile_of,
    seed_of,
    sums_of,
)
from ldctoolkit.mixture.truncated_normal import TruncatedNormal, check_bounds

_LEAST_LOG_P: Final = -20.0
"""Below this ln P the box lies some 6 standard deviations off: only the density inside still says something."""

_FAR_OUTSIDE: Final = 6.0  # standard deviations of a mean outside the box
_COLLINEAR: Final = 0.9999  # correlation of two columns of which one could be left out
_THIN: Final = 5e-3
"""Standard deviation of a component, in the data's, below which it describes single values rather than a spread."""

_LOST_DIGITS: Final = 1e-8
"""Spread of a column over its size: half of a number's sixteen digits are used up by what is common to all rows."""

_OUTLYING: Final = 5.0  # standard deviations of an outlier
_OUTLIER_SHARE: Final = 0.5  # of the variance of its column
_MOST_LISTED: Final = 6  # components named in a sentence

_COUNTS: Final = ("n_components", "n_init", "short_iter", "subsample", "max_iter")

_STOPPED: Final[dict[StopReason, str]] = {
    "max_iter": "Not converged in {} passes: raise max_iter or tol.",
    "stuck": "Not converged: after {} passes no step raised the likelihood, though it is at no maximum; raise "
    "prior_strength or fit fewer components.",
    "collapsed": "Not converged: after {} passes a component had become too thin for the arithmetic; raise "
    "prior_strength or fit fewer components.",
}


def correlation_of(events: Events, profile: Profile) -> FloatArray:
    """Correlations (d, d) of the events' columns, by one pass."""
    d = events.dimension
    i, j = np.triu_indices(d)
    _, sums = sums_of(events, profile.mean, profile.scale, np.zeros((1, 1 + d + i.size)))
    out = np.empty((d, d))
    out[i, j] = out[j, i] = sums[0, 1 + d :] / sums[0, 0]
    return out


def fit_warnings(
    model: BoundedGaussianMixture, profile: Profile, correlation: FloatArray, names: Sequence[str] | None
) -> Iterator[str]:
    """What a user should know before trusting a fit, the gravest first."""
    if model.stop_reason_ in _STOPPED:
        yield _STOPPED[model.stop_reason_].format(model.n_iter_)
    yield from _component_warnings(model.distribution, profile)
    yield from _column_warnings(profile, correlation, names)


def _component_warnings(distribution: Distribution, profile: Profile) -> Iterator[str]:
    t = distribution.truncated
    d = distribution.dimension
    if t.box is not None:
        unreachable = ~np.isfinite(t.box.log_peak) & (t.log_probability < np.log(0.25))
        if unreachable.any():
            yield f"{_components(unreachable)} cannot be sampled: the box is too far off."
    parameters = d + d * (d + 1) // 2
    events = distribution.weights * profile.events
    few = events < parameters
    if few.any():
        yield (
            f"{_components(few)} ({_values(few, events)} events): fewer than the {parameters} parameters of a mean and "
            "a covariance; the prior decides the rest."
        )
    deviation = np.sqrt(np.diagonal(t.Sigma, axis1=1, axis2=2))
    outside = np.max(np.maximum(np.maximum(t.lower - t.mu, t.mu - t.upper) / deviation, 0.0), axis=1)
    far = (t.log_probability < _LEAST_LOG_P) | (outside > _FAR_OUTSIDE)
    if far.any():
        yield (
            f"{_components(far)} (ln P {_values(far, t.log_probability)}; {_values(far, outside)} standard deviations "
            "outside the box): events pile up at a bound as an exponential does; mean and covariance before truncation "
            "say little, the density in the box holds."
        )
    scaled = t.Sigma / (profile.scale[:, None] * profile.scale)
    width = np.sqrt(np.maximum(np.linalg.eigvalsh(scaled)[:, 0], 0.0))
    thin = width < _THIN
    if thin.any():
        yield (
            f"{_components(thin)} ({_values(thin, width)} standard deviations of the data): hardly any width in some "
            "direction; look for repeated rows, columns that depend on each other, or events far off."
        )


def _column_warnings(profile: Profile, correlation: FloatArray, names: Sequence[str] | None) -> Iterator[str]:
    labels = [column_name(j, names) for j in range(profile.mean.size)]
    capital = [label[:1].upper() + label[1:] for label in labels]
    for a, b in zip(*np.triu_indices(len(labels), 1), strict=True):
        if abs(r := float(correlation[a, b])) > _COLLINEAR:
            yield f"{capital[a]} and {labels[b]} are nearly the same (correlation {r:.9g}): leave one out."
    above, below = (profile.most - profile.mean) / profile.scale, (profile.mean - profile.least) / profile.scale
    farthest = np.maximum(above, below)
    size = np.maximum(np.abs(profile.least), np.abs(profile.most))
    for j, name in enumerate(capital):
        share = min(float(farthest[j] ** 2) / profile.rows, 1.0)
        if profile.scale[j] < _LOST_DIGITS * size[j]:
            ratio = float(profile.scale[j] / size[j])
            yield f"{name} varies by {ratio:.1g} of its size: few digits are left; subtract what is common."
        if farthest[j] > _OUTLYING and share > _OUTLIER_SHARE:
            value = float(profile.most[j] if above[j] >= below[j] else profile.least[j])
            yield f"{name}: one event, {value:.6g}, makes up {share:.0%} of the variance; is it real?"


def _components(mask: BoolArray) -> str:
    """The marked components as text: ``Component 2``, or ``Components 2, 5``."""
    return f"Component{'s' if mask.sum() > 1 else ''} {_listed([str(k) for k in np.flatnonzero(mask)])}"


def _values(mask: BoolArray, values: FloatArray) -> str:
    """The values of some components, to list."""
    return _listed([f"{value:.3g}" for value in values[mask].tolist()])


def _listed(texts: list[str]) -> str:
    return ", ".join(texts[:_MOST_LISTED]) + (", ..." if len(texts) > _MOST_LISTED else "")


@dataclasses.dataclass(eq=False, repr=False)
class BoundedGaussianMixture(CheckedArguments):
    """Mixture of K multivariate normals, each truncated to one box and normalised on it.

    What `fit` finds stands in attributes that end in ``_``.

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
    transform : {"none", "log", "logit", "auto"} or sequence of them, optional
        Map of each column before the fit; none by default, as in the paper. ``"log"`` needs one finite bound,
        ``"logit"`` two, ``"auto"`` takes what the bounds allow. A mapped column has no bound any more, so no mass can
        pile up at it; `means_` and `covariances_` are in the mapped coordinates, densities and samples in the data's.
    verbose : int
        1 reports starts and every pass on stderr, 0 is silent.
    n_jobs : int, optional
        Threads; all cores by default. It changes no number.
    names : sequence of str, optional
        Column names for messages.

    Notes
    -----
    f(x) = sum_k eta_k g_k(x)/P_k, eta_k = pi_k P_k/sum_j pi_j P_j. At a maximum of the likelihood (Lee and Scott) the
    weighted mean and scatter are those of the truncated normal but for the correction of its moments,

        mu_k = xbar_k - m_k,  m_k = E_k[x] - mu_k,
        Sigma_k = weighted scatter about mu_k + H_k,  H_k = Sigma_k - E_k[(x - mu_k)(x - mu_k)^T].

    The M-step solves these equations by Newton's method with the Fisher matrix from the same moments; dimensions open
    on both sides are a regression on the others, exact in one step. It is shortened until the objective does not fall.

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
    transform: str | Sequence[str] | None = None
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
    stop_reason_: StopReason = field(init=False)
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

    _distribution: Distribution = field(init=False)

    def __repr__(self) -> str:
        shown = (f for f in dataclasses.fields(self) if f.init and getattr(self, f.name) is not f.default)
        return f"{type(self).__name__}({', '.join(f'{f.name}={getattr(self, f.name)!r}' for f in shown)})"

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
        eta, mu, Sigma = (np.asarray(unmasked(array), dtype=float) for array in (weights, means, covariances))
        if eta.ndim != 1 or mu.ndim != 2 or mu.shape[0] != eta.shape[0]:
            raise InputError("weights, means", f"shapes {eta.shape}, {mu.shape}", allowed="(K,), (K, d)")
        if not (np.all(eta >= 0) and abs(eta.sum() - 1.0) < 1e-6):
            problem = f"sum {eta.sum():.9g}, least {eta.min():g}"
            raise InputError("weights", problem, allowed="shares >= 0 that sum to 1")
        model = cls(eta.size, lower=lower, upper=upper, transform=transform, names=names)
        model._store(eta, mu, Sigma, model._checked_transform(mu.shape[1]))
        return model

    def score_samples(self, X: npt.ArrayLike) -> FloatArray:
        """Log-density ln f(x) of each row, (n,); -inf outside the box."""
        return self.distribution.log_density(check_matrix(X, self.distribution.dimension, self.names))

    def score(self, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> float:
        """Mean log-likelihood per event [nats]."""
        likelihood, n = self._likelihood(X, sample_weight)
        return likelihood / n

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
        seed = seed_of(self.random_state if random_state is None else random_state)
        return self._given(given).sample(checked_whole("n_samples", n_samples, lower=0), seed)

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
        self.lower_, self.upper_ = transform.lower, transform.upper
        self.weights_, self.means_, self.covariances_ = weights, means, covariances
        self.log_probabilities_ = truncated.log_probability
        self.warnings_ = ()

    def fit(self, X: npt.ArrayLike, sample_weight: npt.ArrayLike | None = None) -> Self:
        """Fit by truncated EM.

        Parameters
        ----------
        X : (n, d)
            Events, strictly inside the box.
        sample_weight : (n,), optional
            Events that each row stands for, not negative; a row of weight 2 counts as two, one of weight 0 not at all.

        Raises
        ------
        InputError
            Data on or outside a bound, not finite, a constant column, fewer rows than ``K (d + 1)``, or a setting out
            of range; the message names the column, the row and the count. Also without a prior, where the likelihood
            has no maximum.
        """
        return self.fit_events(Events.of(X, sample_weight, self.n_jobs))

    def fit_events(self, events: Events, start: BoundedGaussianMixture | None = None) -> Self:
        """Fit to rows that have weights already, on the threads that they name; without starts where one is given."""
        counts = {name: checked_whole(name, getattr(self, name), lower=1) for name in _COUNTS}
        tol = checked_number("tol", self.tol, lower=0.0)
        prior_strength = checked_number("prior_strength", self.prior_strength, lower=0.0)
        seed = seed_of(self.random_state)
        transform = self._checked_transform(events.dimension)
        profile = check_events(events, counts["n_components"], transform.lower, transform.upper, self.names)
        if not transform.identity:
            events = dataclasses.replace(events, x=transform.forward(events.x))
            profile = profile_of(events)
        low, high = transform.box()
        location, scale = profile.mean, profile.scale
        settings = EMSettings(
            lower=(low - location) / scale,
            upper=(high - location) / scale,
            seed=seed,
            split_merge=bool(self.split_merge),
            tol=tol,
            prior_strength=prior_strength,
            **counts,
        )
        first = (
            None
            if start is None
            else Components(
                start.weights_,
                (start.means_ - location) / scale,
                start.covariances_ / (scale[:, None] * scale),
                start.log_probabilities_,
            )
        )
        result = fit_components(events, profile, settings, self._report, first)
        c = result.components
        self._store(c.weights, location + scale * c.mu, c.Sigma * scale[:, None] * scale, transform)
        self.stop_reason_, self.converged_ = result.stop_reason, result.stop_reason == "converged"
        self.n_iter_ = result.passes
        self.lower_bounds_, self.lower_bound_ = result.history, float(result.history[-1])
        self.warnings_ = tuple(fit_warnings(self, profile, correlation_of(events, profile), self.names))
        return self

    def _checked_transform(self, dimension: int) -> Transform:
        low = check_bound_array(self.lower, "lower", -np.inf, dimension)
        high = check_bound_array(self.upper, "upper", np.inf, dimension)
        check_bounds(low, high)
        if self.names is not None and len(self.names) != dimension:
            raise InputError("names", f"{len(self.names)} names", allowed=f"{dimension}, one per column")
        return Transform.of(self.transform, low, high, self.names)

    def _report(self, line: str) -> None:
        if self.verbose:
            print(f"K = {self.n_components}: {line}", file=sys.stderr)
