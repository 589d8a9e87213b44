"""The number of components: candidates are fitted in parallel and compared by a criterion."""

from __future__ import annotations

import concurrent.futures
import contextlib
import dataclasses
import io
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import Events, RandomState, check_components, check_number, seed_of, usable_cores
from ldctoolkit.surroundings import WORKERS, leave_with, safe_path, temporary_folder
from ldctoolkit.whole_file import write_whole


@dataclasses.dataclass(frozen=True)
class Failure:
    """A K that could not be fitted."""

    n_components: int  # K
    message: str  # Why not


@dataclasses.dataclass(frozen=True)
class Trial:
    """A fit of one K."""

    model: BoundedGaussianMixture
    log_likelihood: float  # Sum of ln f over the events

    @property
    def n_components(self) -> int:
        """K."""
        return self.model.n_components


Outcome = Trial | Failure


def fit_one(events: Events, model: BoundedGaussianMixture) -> Outcome:
    """Fit one K to the events; the model is changed."""
    try:
        model._fit_events(events)
    except InputError as error:
        return Failure(model.n_components, str(error))

    def evaluate(x: FloatArray, weight: FloatArray | None) -> float:
        values = model.distribution.log_density(x)
        return float(values.sum() if weight is None else weight @ values)

    return Trial(model, sum(events.map_blocks(evaluate)))


Job = TypeVar("Job")
Result = TypeVar("Result")
_LISTEN_EVERY: Final = 0.2  # seconds after which an interrupt is noticed at the latest


def in_processes(
    work: Callable[[Events, Job], Result], jobs: Sequence[Job], events: Events, workers: int
) -> Generator[tuple[int, Result], None, None]:
    """What `work` gives for each job, as they end; jobs begin in their order."""
    from loky import ProcessPoolExecutor
    from loky.process_executor import BrokenProcessPool

    with temporary_folder() as folder, safe_path():
        paths = [Path(folder, "x.npy")] + [Path(folder, "weight.npy")] * (events.weight is not None)
        for path, values in zip(paths, (events.x, events.weight), strict=False):
            content = io.BytesIO()
            np.save(content, values, allow_pickle=False)  # type: ignore[arg-type]
            write_whole(path, content.getvalue(), LdcError)
        arguments = (os.getpid(), work, paths)
        pool = ProcessPoolExecutor(workers, initializer=_start_worker, initargs=arguments, env=WORKERS)
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
    threading.Thread(target=leave_with, args=(parent,), daemon=True).start()
    x, weight = [np.load(path, mmap_mode="r", allow_pickle=False) for path in (*paths, paths[0])][:2]
    _task = work, Events(x, weight if len(paths) > 1 else None, 1)


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
    bic: FloatArray  # (m,) -2 ln L + p ln n, lower is better
    aic: FloatArray  # (m,) -2 ln L + 2 p, lower is better
    models: tuple[BoundedGaussianMixture, ...]  # The fits, to all events
    failures: tuple[Failure, ...]  # The K that could not be fitted, each with its message
    criterion: Criterion  # What the choice went by
    allowance: float  # How far from the best criterion a K may be to be chosen
    chosen: int  # Index of the chosen K
    reason: str  # One sentence: which K was taken and by which rule

    @property
    def best(self) -> BoundedGaussianMixture:
        """The chosen fit."""
        return self.models[self.chosen]

    @property
    def risen(self) -> bool:
        """Whether the last K is worse than a smaller one by more than the rule allows."""
        loss = getattr(self, self.criterion)
        return bool(loss[-1] > loss[least(loss)] + self.allowance)


def select_components(
    X: npt.ArrayLike,
    components: Iterable[int],
    *,
    criterion: Criterion = "bic",
    slack: float = 10.0,
    indifference: float = 0.0,
    sample_weight: npt.ArrayLike | None = None,
    random_state: RandomState = None,
    n_jobs: int | None = None,
    enough: Callable[[Selection], bool] | None = None,
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
    criterion : {"bic", "aic"}
        What to choose by.
    slack : float
        The smallest K within this distance of the best criterion is taken.
    indifference : float
        The same in nats per event, where smaller gains are of no use; the larger of the two counts. A gain of 0.001
        nats is a density that is 0.1 % higher at the typical event.
    sample_weight : (n,), optional
        Events that each row stands for.
    random_state : int or Generator, optional
        Seed of all fits.
    n_jobs : int, optional
        Cores to use, all by default. Fits run so many at a time in processes of their own, if they take long enough
        to be worth it. No number depends on it.
    enough : callable, optional
        The K are fitted one after the other, and larger ones are left out once this says so of the fits so far.
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
    BIC beyond 10 is very strong evidence (Kass and Raftery), and AIC leaves no support there (Burnham and Anderson).
    It does not stop a curve that falls by thousands for hundredths of a nat per event; `indifference` does.

    References
    ----------
    Kass and Raftery, JASA 90(430):773-795, 1995, section 3.2. Burnham and Anderson, Model Selection and Multimodel
    Inference, 2002, section 2.6.

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
    if n_jobs is not None:
        check_number("n_jobs", n_jobs, 1, integer=True)
    seed = seed_of(random_state)
    # made here, so that a wrong setting is found before anything starts
    models = [BoundedGaussianMixture(K, random_state=seed, **settings) for K in tried]
    events = Events.of(X, sample_weight, n_jobs)
    events = dataclasses.replace(events, x=np.ascontiguousarray(events.x))  # in the order the passes read it
    rule = Rule(criterion, slack, indifference, float(events.rows if events.weight is None else events.weight.sum()))
    outcomes = _run(
        models, events, n_jobs, progress, None if enough is None else lambda fits: enough(_selection(rule, fits, ()))
    )
    trials = [outcome for outcome in outcomes if isinstance(outcome, Trial)]
    failures = tuple(outcome for outcome in outcomes if isinstance(outcome, Failure))
    if not trials:
        raise InputError(failures[0].message)
    return _selection(rule, trials, failures)


def _run(
    models: Sequence[BoundedGaussianMixture],
    events: Events,
    n_jobs: int | None,
    progress: Progress | None,
    enough: Callable[[list[Trial]], bool] | None,
) -> list[Outcome]:
    """All fits, in the order of the models; the longest begin first where several run at a time."""
    workers = 1
    if enough is None and not multiprocessing.current_process().daemon:
        size = events.x.size * sum(model.n_components for model in models)
        workers = min(n_jobs or (usable_cores() if size > _SMALL else 1), len(models))
    queue = list(models)
    ended: Generator[tuple[int, Outcome], None, None]
    if workers > 1:
        queue.reverse()
        ended = in_processes(fit_one, queue, events, workers)
    else:
        ended = ((i, fit_one(events, model)) for i, model in enumerate(queue))
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
            fits = [one for one in outcomes.values() if isinstance(one, Trial)]
            if enough is not None and fits and enough(fits):
                break
    return sorted(outcomes.values(), key=lambda outcome: outcome.n_components)


def _selection(rule: Rule, trials: Sequence[Trial], failures: tuple[Failure, ...]) -> Selection:
    K = np.array([trial.n_components for trial in trials], dtype=np.int64)
    p = np.array([trial.model.n_parameters() for trial in trials], dtype=np.int64)
    log_likelihood = np.array([trial.log_likelihood for trial in trials])
    criteria = {"bic": -2.0 * log_likelihood + p * np.log(rule.events), "aic": -2.0 * log_likelihood + 2.0 * p}
    loss = criteria[rule.criterion]
    chosen = choose(loss, rule.allowance)
    reason = rule.reason(K, loss, chosen)
    if failures:
        reason += f"; K = {', '.join(str(f.n_components) for f in failures)} could not be fitted"
    return Selection(
        n_components=K,
        n_parameters=p,
        log_likelihood=log_likelihood / rule.events,
        **criteria,
        models=tuple(trial.model for trial in trials),
        failures=failures,
        criterion=rule.criterion,
        allowance=rule.allowance,
        chosen=chosen,
        reason=reason,
    )


Criterion = Literal["bic", "aic"]


@dataclasses.dataclass(frozen=True)
class Rule:
    """The smallest K whose criterion lies within an allowance of the best."""

    criterion: Criterion  # what is compared
    slack: float  # the allowance, in units of the criterion
    indifference: float  # the allowance where it is the larger one [nats per event]
    events: float  # sum of the weights n; the number of rows without any

    def __post_init__(self) -> None:
        if self.criterion not in get_args(Criterion):
            raise InputError("criterion", value=self.criterion, allowed=get_args(Criterion))
        check_number("slack", self.slack, 0.0)
        check_number("indifference", self.indifference, 0.0)

    @property
    def allowance(self) -> float:
        """How far from the best a K may be."""
        return max(self.slack, 2.0 * self.events * self.indifference)

    def reason(self, K: IntArray, loss: FloatArray, chosen: int) -> str:
        """One sentence: which K was taken, and why."""
        if K.size == 1:
            return f"K = {K[0]}, the only one there is"
        best = least(loss)
        within = f"{self.slack:g}" if self.slack == self.allowance else f"{self.indifference:g} nats an event"
        text = f"K = {K[chosen]}, the smallest whose {self.criterion.upper()} lies within {within} of the best"
        if best != chosen:
            text += f" (K = {K[best]}, better by {loss[chosen] - loss[best]:.1f})"
        if best == K.size - 1:
            text += "; the best is the last one tried, so more components may be better still"
        return text


def least(loss: FloatArray) -> int:
    """Index of the least finite loss."""
    return int(np.argmin(np.where(np.isfinite(loss), loss, np.inf)))


def choose(loss: FloatArray, allowed: float) -> int:
    """Index of the first K whose loss lies within the allowance of the least."""
    usable = np.isfinite(loss)
    if not usable.any():
        raise InputError("components", "no fit has a finite criterion", allowed="at least one")
    return int(np.argmax(usable & (loss <= loss[least(loss)] + allowed)))
