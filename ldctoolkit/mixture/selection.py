"""The number of components: candidates are fitted in parallel and compared by a criterion."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import multiprocessing
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError, LdcError, nearest
from ldctoolkit.mixture._distribution import Distribution
from ldctoolkit.mixture._expectation import natural
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import (
    Events,
    RandomState,
    as_matrix,
    check_components,
    check_number,
    check_sample_weight,
    seed_of,
    usable_cores,
)


@dataclasses.dataclass(frozen=True)
class Failure:
    """A K that could not be fitted."""

    n_components: int  # K
    message: str  # Why not


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
    """Information criteria of a mixture on its events; lower is better."""

    events: float  # Sum of the weights n; the number of rows without any
    log_likelihood: float  # Sum of ln f over the events
    # Entropy of the shares, -sum_i sum_k tau_ik ln tau_ik [nats]: none where each event has one component
    entropy: float
    n_parameters: int  # Free parameters p

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

    def evaluate(x: FloatArray, weight: FloatArray | None) -> tuple[float, float, float]:
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
    for part in events.map_blocks(evaluate):
        n, total, entropy = n + part[0], total + part[1], entropy + part[2]
    return Criteria(n, total, max(entropy, 0.0), distribution.n_parameters)


Job = TypeVar("Job")
Result = TypeVar("Result")
_LISTEN_EVERY: Final = 0.2  # seconds after which an interrupt is noticed at the latest
_LOOK_FOR_PARENT_EVERY: Final = 2.0  # seconds after which a worker notices that no process waits for it

_ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
"""Environment of the workers: the fits are what runs in parallel."""


def in_processes(
    work: Callable[[Events, Job], Result], jobs: Sequence[Job], events: Events, workers: int
) -> Generator[tuple[int, Result], None, None]:
    """What `work` gives for each job, as they end; jobs begin in their order."""
    from loky import ProcessPoolExecutor
    from loky.process_executor import BrokenProcessPool

    with tempfile.TemporaryDirectory(prefix="ldc-") as folder:
        paths = [Path(folder, "x.npy")] + [Path(folder, "weight.npy")] * (events.weight is not None)
        for path, values in zip(paths, (events.x, events.weight), strict=False):
            np.save(path, values, allow_pickle=False)  # type: ignore[arg-type]
        arguments = (os.getpid(), work, paths)
        pool = ProcessPoolExecutor(workers, initializer=_start_worker, initargs=arguments, env=_ONE_THREAD)
        try:
            number = {pool.submit(_run_job, job): i for i, job in enumerate(jobs)}
            pending = set(number)
            while pending:
                # never an endless wait: an interrupt is seen only once Python code runs again
                done, pending = concurrent.futures.wait(pending, _LISTEN_EVERY, concurrent.futures.FIRST_COMPLETED)
                for future in sorted(done, key=number.__getitem__):
                    yield number[future], future.result()
        except BrokenProcessPool:
            raise LdcError(
                "a worker process ended abruptly: out of memory, or killed; n_jobs=1 needs no other process"
            ) from None
        finally:
            # after an error or an interrupt nothing waits for fits that are not used
            pool.shutdown(wait=True, kill_workers=True)


_task: tuple[Callable[[Events, Any], Any], Events] | None = None  # of a worker


def _start_worker(parent: int, work: Callable[[Events, Any], Any], paths: Sequence[Path]) -> None:
    global _task
    # the parent decides what an interrupt means
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    x, weight = [np.load(path, mmap_mode="r", allow_pickle=False) for path in (*paths, paths[0])][:2]
    _task = work, Events(x, weight if len(paths) > 1 else None, 1)


def _leave_with(parent: int) -> None:
    """End this process soon after its parent was killed."""
    while os.getppid() == parent:
        time.sleep(_LOOK_FOR_PARENT_EVERY)
    os._exit(1)


def _run_job(job: Any) -> Any:
    if _task is None:
        raise RuntimeError("the worker was not started")
    work, events = _task
    return work(events, job)


Progress = Callable[[str, int, int], None]

_SMALL: Final = 100_000  # up to so many numbers times components to fit, other processes are not worth their start


@dataclasses.dataclass(frozen=True)
class Selection:
    """Fits over a range of K, their criteria, and the one that was chosen."""

    n_components: IntArray  # (m,) The K that could be fitted, ascending
    n_parameters: IntArray  # (m,) Free parameters p of each
    log_likelihood: FloatArray  # (m,) Log-likelihood per event [nats]
    # (m,) -2 ln L + p ln n, -2 ln L + 2 p, and BIC plus twice the entropy of the shares; lower is better
    bic: FloatArray
    aic: FloatArray
    icl: FloatArray
    # (m,) Log-likelihood per held-out event of a fit to the others [nats]; NaN for another criterion
    held_out: FloatArray
    held_out_error: FloatArray  # (m,) Its standard error
    # (m,) Standard error of its paired difference to the best one; it is what the rule looks at
    held_out_gap_error: FloatArray
    models: tuple[BoundedGaussianMixture, ...]  # The fits, to all events
    failures: tuple[Failure, ...]  # The K that could not be fitted, each with its message
    criterion: Criterion  # What the choice went by
    chosen: int  # Index of the chosen K
    reason: str  # One sentence: which K was taken and by which rule

    @property
    def best(self) -> BoundedGaussianMixture:
        """The chosen fit."""
        return self.models[self.chosen]


def select_components(
    X: npt.ArrayLike,
    components: Iterable[int],
    *,
    criterion: Criterion = "bic",
    slack: float | None = None,
    indifference: float = 0.0,
    held_out_share: float = 0.2,
    sample_weight: npt.ArrayLike | None = None,
    random_state: RandomState = None,
    n_jobs: int | None = None,
    patience: int | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Selection:
    """Fit every K of a range, keep all of them, and choose one by a stated rule.

    Raises `InputError` if the range is empty, a K is not a positive integer, an option is not allowed, or no K can be
    fitted: then with the message of the smallest. A K that cannot be fitted beside others that can is left out and
    reported; `LdcError` if a worker process ends abruptly.

    Parameters
    ----------
    X : (n, d)
        Events, strictly inside the box.
    components : iterable of int
        The K to try.
    criterion : {"bic", "aic", "icl", "held_out"}
        What to choose by. All but "held_out" are computed in any case; "held_out" needs a second fit of each K, to
        the events that are not held out.
    slack : float, optional
        The smallest K within this distance of the best criterion is taken: 10 units of BIC, AIC or ICL by default,
        one standard error of the paired difference for "held_out".
    indifference : float
        The same in nats per event, where smaller gains are of no use; the larger of the two counts. A gain of 0.001
        nats is a density that is 0.1 % higher at the typical event.
    held_out_share : float
        Share of the rows that is held out for "held_out"; the same rows for every K.
    sample_weight : (n,), optional
        Events that each row stands for.
    random_state : int or Generator, optional
        Seed of all fits and of the split.
    n_jobs : int, optional
        Cores to use, all by default. Fits run so many at a time in processes of their own, if they take long enough
        to be worth it. No number depends on it.
    patience : int, optional
        The K are fitted one after the other, and larger ones are left out once so many in a row were worse than a
        smaller one by more than the rule allows.
    progress : callable, optional
        Called as ``progress("K = 3", done, total)`` when fits begin, with the K under way, and once at the end.
    **settings
        For `BoundedGaussianMixture`: ``lower``, ``upper``, ``tol``, ...

    Returns
    -------
    Selection
        In ascending K.

    Notes
    -----
    With half a million events the curve falls on slowly where more components are not worth it, so the
    least criterion is a poor guide. By the default rule a larger K must be better by more than 10: a difference of
    BIC beyond 10 is very strong evidence (Kass and Raftery). It does not stop a curve that falls by thousands for
    hundredths of a nat per event; `indifference` does.

    References
    ----------
    Kass and Raftery, JASA 90(430):773-795, 1995, section 3.2. Burnham and Anderson, Model Selection and Multimodel
    Inference, 2002, section 2.6. Biernacki, Celeux and Govaert, IEEE TPAMI 22(7):719-725, 2000, and McLachlan and Peel,
    Finite Mixture Models, 2000, section 6.10 (ICL by the entropy of the shares). Breiman et al., Classification and
    Regression Trees, 1984, section 3.4.3 (one standard error).

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=(300, 2)) + np.repeat([[0.0, 0.0], [9.0, 9.0]], 150, axis=0)
    >>> found = select_components(x, range(1, 4), random_state=0)
    >>> found.best.n_components
    2
    >>> found.reason
    'K = 2, the smallest whose BIC lies within 10 of the best'
    """
    tried = check_components(components)
    rule = Rule.of(criterion, slack, indifference)
    if n_jobs is not None:
        check_number("n_jobs", n_jobs, 1, integer=True)
    seed = seed_of(random_state)
    # made here, so that a wrong setting is found before anything starts
    models = [BoundedGaussianMixture(K, random_state=seed, **settings) for K in tried]
    x = np.ascontiguousarray(as_matrix(X))  # in the order the passes read it
    if x.size == 0:
        raise InputError(f"X: {'no columns' if x.shape[0] else 'no rows'}")
    events = Events(x, check_sample_weight(sample_weight, x.shape[0]), n_jobs)
    held = split_rows(events, held_out_share, seed) if rule.criterion == "held_out" else None
    outcomes = _run(Trials(held), models, events, n_jobs, progress, None if patience is None else (patience, rule))
    trials = [outcome for outcome in outcomes if isinstance(outcome, Trial)]
    failures = tuple(outcome for outcome in outcomes if isinstance(outcome, Failure))
    if not trials:
        raise InputError(failures[0].message)
    return _selection(rule, trials, failures)


def _run(
    trials: Trials,
    models: Sequence[BoundedGaussianMixture],
    events: Events,
    n_jobs: int | None,
    progress: Progress | None,
    patience: tuple[int, Rule] | None = None,
) -> list[Outcome]:
    """All fits, in the order of the models; the longest begin first where several run at a time."""
    workers = 1
    if patience is None and not multiprocessing.current_process().daemon:
        size = events.x.size * sum(model.n_components for model in models)
        workers = min(n_jobs or (usable_cores() if size > _SMALL else 1), len(models))
    queue = list(models)
    ended: Generator[tuple[int, Outcome], None, None]
    if workers > 1:
        queue.reverse()
        ended = in_processes(trials, queue, events, workers)
    else:
        ended = ((i, trials(events, model)) for i, model in enumerate(queue))
    outcomes: dict[int, Outcome] = {}

    def report() -> None:
        if progress is not None:
            under_way = [str(model.n_components) for i, model in enumerate(queue) if i not in outcomes][:workers]
            progress(f"K = {', '.join(under_way)}" if under_way else "done", len(outcomes), len(queue))

    # closed here: an interrupt ends the processes at once
    with contextlib.closing(ended):
        report()
        for i, outcome in ended:
            outcomes[i] = outcome
            report()
            if patience is not None and _risen(list(outcomes.values()), *patience):
                break
    return sorted(outcomes.values(), key=lambda outcome: outcome.n_components)


def _risen(outcomes: Sequence[Outcome], count: int, rule: Rule) -> bool:
    """Whether the last `count` fits were all worse than an earlier one by more than the rule allows."""
    trials = [outcome for outcome in outcomes if isinstance(outcome, Trial)]
    if len(trials) <= count:
        return False
    found = _selection(rule, trials, ())
    loss = -found.held_out if rule.criterion == "held_out" else getattr(found, rule.criterion)
    allowed = rule.allowance(trials[0].criteria.events, found.held_out_gap_error)
    return bool(np.all(loss[-count:] > loss[least(loss)] + allowed[-count:]))


def _selection(rule: Rule, trials: Sequence[Trial], failures: tuple[Failure, ...]) -> Selection:
    K = np.array([trial.n_components for trial in trials], dtype=np.int64)
    criteria = [trial.criteria for trial in trials]
    events = criteria[0].events
    held_out, error, gap_error = np.full((3, K.size), np.nan)
    if rule.criterion == "held_out":
        held_out = np.array([trial.held_out.mean for trial in trials])
        error = np.array([trial.held_out.error for trial in trials])
        best = trials[least(-held_out)].held_out
        gap_error = np.array([trial.held_out.minus(best).error for trial in trials])
    values = {name: np.array([getattr(c, name) for c in criteria]) for name in ("bic", "aic", "icl")}
    loss = -held_out if rule.criterion == "held_out" else values[rule.criterion]
    allowed = rule.allowance(events, gap_error)
    chosen = choose(loss, allowed)
    reason = rule.reason(K, loss, allowed, chosen, events)
    if failures:
        reason += f"; K = {', '.join(str(f.n_components) for f in failures)} could not be fitted"
    return Selection(
        n_components=K,
        n_parameters=np.array([c.n_parameters for c in criteria], dtype=np.int64),
        log_likelihood=np.array([c.log_likelihood / c.events for c in criteria]),
        **values,
        held_out=held_out,
        held_out_error=error,
        held_out_gap_error=gap_error,
        models=tuple(trial.model for trial in trials),
        failures=failures,
        criterion=rule.criterion,
        chosen=chosen,
        reason=reason,
    )


Criterion = Literal["bic", "aic", "icl", "held_out"]

SLACK: Final[dict[str, float]] = {"bic": 10.0, "aic": 10.0, "icl": 10.0, "held_out": 1.0}
"""Default slack. Information criteria: 10 of their units, where Kass and Raftery (1995) begin to call a difference of
BIC very strong evidence, and Burnham and Anderson (2002) see no support left by AIC. Held out: one standard error."""


@dataclasses.dataclass(frozen=True)
class Rule:
    """The smallest K whose criterion lies within an allowance of the best."""

    criterion: Criterion  # what is compared
    slack: float  # the allowance, in units of the criterion; for "held_out" in standard errors of the paired difference
    indifference: float  # the allowance where it is the larger one [nats per event]

    @classmethod
    def of(cls, criterion: str, slack: float | None, indifference: float) -> Rule:
        """The caller's wish, checked."""
        for known in get_args(Criterion):
            if criterion == known:
                break
        else:
            raise InputError(f"criterion: {criterion!r}; {nearest(str(criterion), get_args(Criterion))}")
        if slack is not None:
            check_number("slack", slack, 0.0)
        check_number("indifference", indifference, 0.0)
        return cls(known, SLACK[known] if slack is None else float(slack), float(indifference))

    def allowance(self, events: float, error: FloatArray) -> FloatArray:
        """How far from the best each K may be, (m,); `error` are the standard errors of the held-out differences."""
        if self.criterion == "held_out":
            return np.maximum(self.slack * error, self.indifference)
        return np.full(error.shape, max(self.slack, 2.0 * events * self.indifference))

    def reason(self, K: IntArray, loss: FloatArray, allowed: FloatArray, chosen: int, events: float) -> str:
        """One sentence: which K was taken, and why."""
        if K.size == 1:
            return f"K = {K[0]}, the only one there is"
        name = "held-out log-likelihood" if self.criterion == "held_out" else self.criterion.upper()
        best = least(loss)
        unit = 1.0 if self.criterion == "held_out" else 2.0 * events
        if self.indifference > 0.0 and allowed[chosen] == unit * self.indifference:
            within = f"{self.indifference:g} nats an event"
        elif self.criterion == "held_out":
            within = "one standard error" if self.slack == 1.0 else f"{self.slack:g} standard errors"
        else:
            within = f"{self.slack:g}"
        text = f"K = {K[chosen]}, the smallest whose {name} lies within {within} of the best"
        if best != chosen:
            gap = loss[chosen] - loss[best]
            size = f"{gap:.2g} nats an event" if self.criterion == "held_out" else f"{gap:.1f}"
            text += f" (K = {K[best]}, better by {size})"
        if best == K.size - 1:
            text += "; the best is the last one tried, so more components may be better still"
        return text


def least(loss: FloatArray) -> int:
    """Index of the least finite loss."""
    return int(np.argmin(np.where(np.isfinite(loss), loss, np.inf)))


def choose(loss: FloatArray, allowed: FloatArray) -> int:
    """Index of the first K whose loss lies within its allowance of the least."""
    usable = np.isfinite(loss)
    if not usable.any():
        raise InputError("components: no fit has a finite criterion; allowed: at least one")
    return int(np.argmax(usable & (loss <= loss[least(loss)] + allowed)))
