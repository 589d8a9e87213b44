"""The number of components: candidates are fitted, in parallel where they can be, and compared by BIC."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import Events, RandomState, check_components, seed_of

ALLOWANCE: Final = 10.0
"""The smallest K whose BIC lies within this distance of the least one is chosen."""


@dataclasses.dataclass(frozen=True)
class Failure:
    """A number of components that could not be fitted, and the error."""

    n_components: int  # K
    error: InputError  # Why not


@dataclasses.dataclass(frozen=True)
class Trial:
    """A fitted model with K components and its likelihood."""

    model: BoundedGaussianMixture
    log_likelihood: float  # Sum of ln f over the events

    @property
    def n_components(self) -> int:
        """Number of components K of the model."""
        return self.model.n_components


Outcome = Trial | Failure
Fit = Callable[[BoundedGaussianMixture], Outcome]
FitEach = Callable[[Fit, Sequence[BoundedGaussianMixture]], Iterable[Outcome]]
Progress = Callable[[str, int, int], None]


def fit_candidate(events: Events, model: BoundedGaussianMixture) -> Outcome:
    """Fit one K to the events; the model is changed."""
    try:
        model.fit_events(events)
    except InputError as error:
        return Failure(model.n_components, error)

    def evaluate(x: FloatArray, weight: FloatArray | None) -> float:
        values = model.distribution.log_density(x)
        return float(values.sum() if weight is None else weight @ values)

    return Trial(model, sum(events.map_blocks(evaluate)))


@dataclasses.dataclass(frozen=True)
class Selection:
    """Fits over a range of K, their BIC, and the fit that was chosen."""

    n_components: IntArray  # (m,) The K that could be fitted, ascending
    n_parameters: IntArray  # (m,) Free parameters p of each
    log_likelihood: FloatArray  # (m,) Log-likelihood per event [nats]
    bic: FloatArray  # (m,) -2 ln L + p ln n, lower is better
    models: tuple[BoundedGaussianMixture, ...]  # The fits, to all events
    failures: tuple[Failure, ...]  # The K that could not be fitted, and why
    chosen: int  # Index of the chosen K
    reason: str  # One sentence: which K was taken and by which rule

    @property
    def best(self) -> BoundedGaussianMixture:
        """The chosen fit."""
        return self.models[self.chosen]

    @property
    def risen(self) -> bool:
        """Whether the BIC of the last K is above that of a smaller one by more than the rule allows."""
        return bool(self.bic[-1] > self.bic[_least(self.bic)] + ALLOWANCE)


def select_components(
    X: npt.ArrayLike,
    components: Iterable[int],
    *,
    sample_weight: npt.ArrayLike | None = None,
    random_state: RandomState = None,
    n_jobs: int | None = None,
    fit_each: FitEach | None = None,
    enough: Callable[[Selection], bool] | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Selection:
    """Fit every K of a range, keep all fits, and choose the smallest K whose BIC lies within 10 of the least.

    Raises `InputError` if the range is empty, a K is not a positive integer, an option is not allowed, or no K can be
    fitted: then with the error of the smallest. A K that cannot be fitted beside others that can is left out and
    reported.

    Parameters
    ----------
    X : (n, d)
        Events, strictly inside the box.
    components : iterable of int
        The K to try.
    sample_weight : (n,), optional
        Events that each row stands for.
    random_state : int or Generator, optional
        Seed of all fits.
    n_jobs : int, optional
        Cores that a fit uses, all by default. No number depends on it.
    fit_each : callable, optional
        What runs the fits, `map` by default: ``fit_each(fit, models)`` gives what ``fit`` gives for each model, in any
        order, so that worker processes may run several at a time.
    enough : callable, optional
        The K are fitted one after the other in this process, and larger ones are left out once this says so of the
        fits so far.
    progress : callable, optional
        Called as ``progress("K = 3", done, total)`` with the next K, and once at the end.
    **settings
        For `BoundedGaussianMixture`: ``lower``, ``upper``, ``tol``, ...

    Returns
    -------
    Selection
        In ascending K.

    Notes
    -----
    With half a million events the curve falls on slowly where more components are not worth it, so the least BIC is a
    poor guide. A difference of BIC beyond 10 is very strong evidence (Kass and Raftery). The rule does not stop a curve
    that falls by thousands for hundredths of a nat per event: the reason then says that the best K is the last one.

    References
    ----------
    Kass and Raftery, JASA 90(430):773-795, 1995, section 3.2.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=(300, 2)) + np.repeat([[0.0, 0.0], [9.0, 9.0]], 150, axis=0)
    >>> selection = select_components(x, range(1, 4), random_state=0)
    >>> selection.best.n_components
    2
    >>> selection.reason
    'K = 2, the smallest whose BIC lies within 10 of the best'
    """
    tried = check_components(components)
    seed = seed_of(random_state)
    # built here, so that a wrong setting is refused before anything starts
    models = [BoundedGaussianMixture(K, random_state=seed, **settings) for K in tried]
    events = Events.of(X, sample_weight, n_jobs)
    events = dataclasses.replace(events, x=np.ascontiguousarray(events.x))  # in the order the passes read it
    n = float(events.rows if events.weight is None else events.weight.sum())
    if enough is not None or fit_each is None or len(models) == 1:
        fit_each = map
    if fit_each is not map:
        models.reverse()  # the longest fits begin first
        events = dataclasses.replace(events, threads=1)
    trials: list[Trial] = []
    failures: list[Failure] = []
    # closed here: an interrupt ends worker processes at once
    with contextlib.closing(outcome for outcome in fit_each(functools.partial(fit_candidate, events), models)) as fits:
        for done, model in enumerate(models):
            if progress is not None:
                progress(f"K = {model.n_components}", done, len(models))
            outcome = next(fits)
            if isinstance(outcome, Failure):
                failures.append(outcome)
                continue
            trials.append(outcome)
            if enough is not None and enough(_selection(n, trials, [])):
                break
    if progress is not None:
        progress("done", len(models), len(models))
    if not trials:
        raise min(failures, key=lambda failure: failure.n_components).error
    return _selection(n, trials, failures)


def _selection(events: float, trials: Sequence[Trial], failures: Sequence[Failure]) -> Selection:
    trials = sorted(trials, key=lambda trial: trial.n_components)
    failures = sorted(failures, key=lambda failure: failure.n_components)
    K = np.array([trial.n_components for trial in trials], dtype=np.int64)
    p = np.array([trial.model.n_parameters() for trial in trials], dtype=np.int64)
    log_likelihood = np.array([trial.log_likelihood for trial in trials])
    bic = -2.0 * log_likelihood + p * np.log(events)
    chosen = choose(bic)
    reason = reason_of(K, bic, chosen)
    if failures:
        reason += f"; K = {', '.join(str(failure.n_components) for failure in failures)} could not be fitted"
    models = tuple(trial.model for trial in trials)
    return Selection(K, p, log_likelihood / events, bic, models, tuple(failures), chosen, reason)


def reason_of(K: IntArray, bic: FloatArray, chosen: int) -> str:
    """One sentence: which K was taken, and why."""
    if K.size == 1:
        return f"K = {K[0]}, the only one there is"
    best = _least(bic)
    text = f"K = {K[chosen]}, the smallest whose BIC lies within {ALLOWANCE:g} of the best"
    if best != chosen:
        text += f" (K = {K[best]}, better by {bic[chosen] - bic[best]:.1f})"
    if best == K.size - 1:
        text += "; the best is the last one tried, so more components may be better still"
    return text


def _least(bic: FloatArray) -> int:
    """Index of the least finite BIC."""
    return int(np.argmin(np.where(np.isfinite(bic), bic, np.inf)))


def choose(bic: FloatArray) -> int:
    """Index of the first K whose BIC lies within the allowance of the least."""
    usable = np.isfinite(bic)
    if not usable.any():
        raise InputError("components", "no fit has a finite BIC", allowed="at least one")
    return int(np.argmax(usable & (bic <= bic[_least(bic)] + ALLOWANCE)))
