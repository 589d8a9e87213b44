"""The one loop over work: sent to an executor, repeated where a worker was lost, handed back as it ends."""

import contextlib
import dataclasses
import itertools
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final, Literal, Protocol, Self, TypeVar

import ldctoolkit.compiling as compiling
from ldctoolkit.errors import LdcError

Fault = Literal["died", "late"]

new_number = itertools.count().__next__


@dataclasses.dataclass(frozen=True, eq=False)
class Work:
    """Something to be done in one go, anywhere: plain data that can be sent, and how it is done.

    The base class does nothing, which shows whether a worker lives at all.
    """

    number: int = dataclasses.field(default_factory=new_number, kw_only=True)  # in the sending process

    @property
    def time_limit(self) -> float:
        """How long [s] `run` may take where the worker can be ended; 0 for no limit."""
        return 0.0

    def make_ready(self, cache: dict[str, Any]) -> None:
        """Load in a worker process what it lacks; no time limit holds."""

    def run(self, cache: dict[str, Any]) -> Any:  # noqa: ARG002
        """Do it; what may serve the next work in the same process is left in `cache`. The result is never None."""
        return True

    def halves(self) -> Sequence[Self]:
        """Smaller works that have the same results; none where it cannot be divided."""
        return ()

    def harmless(self) -> "Work":
        """Work of this kind that ends no sound worker."""
        return Work()


@dataclasses.dataclass(frozen=True, eq=False)
class Ended:
    """Work that is no longer under way."""

    work: Any  # as it was given to `Executor.start`
    result: Any = None  # of its `run`; None if the worker is gone, or the work never began
    fault: Fault | None = None  # the worker ended during the work; None where the work is not to blame
    certain: bool = False  # no other work can have been the reason


class Executor(Protocol):
    """Runs work, in any order."""

    name: str  # "serial", "processes" or "dask"
    isolated: bool  # whether work that ends its process leaves this one alive

    @property
    def workers(self) -> int:
        """How many works run at the same time."""

    def start(self, work: Work) -> None:
        """Begin a work, or queue it."""

    def wait(self) -> list[Ended]:
        """Works that have ended; none if nothing did for a moment."""

    def close(self, *, orderly: bool) -> None:
        """Give back what was taken; if not `orderly`, work under way is given up."""


@contextlib.contextmanager
def closing(executor: Executor) -> Iterator[None]:
    """Close an executor behind the block; work under way is given up where that raises."""
    try:
        yield
    except BaseException:
        executor.close(orderly=False)
        raise
    executor.close(orderly=True)


_PREFETCH: Final = 2  # works a worker that are under way or wait in the executor
_MOST_ENDS: Final = 2  # work that has ended its worker so often is to blame: once may be bad luck
_MOST_LOST: Final = 25  # times in a row that innocent work is lost before it is plain that workers cannot live here

W = TypeVar("W", bound=Work)
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclasses.dataclass(frozen=True)
class Lost:
    """In place of a result: the work ends every worker, or takes longer than its limit."""

    fault: Fault


def run_works(
    executor: Executor, works: Iterable[W], *, still_needed: Callable[[W], W | None] = lambda work: work
) -> Iterator[tuple[W, Any]]:
    """Run works; each with its result, or `Lost`, as soon as that is there.

    Work that may have ended its worker runs again with no other beside it, so that there is no doubt. If it ends that
    worker too, or was over its time, its halves take its place; what cannot be halved is `Lost`. Raises `LdcError` if
    workers end whatever they run.

    Parameters
    ----------
    executor : Executor
        Not closed here.
    works : iterable of Work
        Taken one by one as workers become free, so that it may depend on earlier results.
    still_needed : callable
        What is left of a work when it is about to start; None for nothing.
    """
    remaining = iter(works)
    next_work = next(remaining, None)
    to_repeat: deque[W] = deque()
    alone: deque[W] = deque()
    ends: Counter[int] = Counter()
    under_way, lost_in_a_row, workers_live, suspect_runs = 0, 0, False, False

    def start(work: W) -> int:
        left = still_needed(work)
        if left is None:
            return 0
        executor.start(left)
        return 1

    while next_work or to_repeat or alone or under_way:
        most = 1 if executor.workers == 1 else _PREFETCH * executor.workers
        suspect_runs = suspect_runs and under_way > 0
        while alone and not under_way:
            under_way += start(alone.popleft())
            suspect_runs = under_way > 0
        while not (alone or suspect_runs) and under_way < most and (to_repeat or next_work):
            if to_repeat:
                under_way += start(to_repeat.popleft())
            elif next_work:
                under_way += start(next_work)
                next_work = next(remaining, None)
        if not under_way:
            continue
        ended_works = executor.wait()
        # once, however many a broken pool held
        if any(ended.result is None and ended.fault is None for ended in ended_works):
            lost_in_a_row += 1
            if lost_in_a_row >= _MOST_LOST:
                raise LdcError(
                    problem="worker processes end before they have done anything (out of memory, or killed)",
                    hint="what was stored is kept: run it again, with fewer workers if memory was short",
                )
        for ended in ended_works:
            under_way -= 1
            work: W = ended.work
            if ended.result is not None:
                lost_in_a_row, workers_live = 0, True
                yield work, ended.result
            elif ended.fault is None:
                to_repeat.append(work)
            else:
                ends[work.number] += 1
                if not ended.certain or (ended.fault == "died" and ends[work.number] < _MOST_ENDS):
                    alone.append(work)
                elif halves := work.halves():
                    ends.update({half.number: _MOST_ENDS - 1 for half in halves})
                    # the halves go first: what is left waits for no other end
                    alone.extendleft(reversed(halves))
                else:
                    if not workers_live:
                        _check_workers(executor, work.harmless())
                    workers_live = True
                    yield work, Lost(ended.fault)


def _check_workers(executor: Executor, harmless: Work) -> None:
    """Raise `LdcError` if no worker lives; nothing else may be under way."""
    executor.start(harmless)
    while not (ended_works := executor.wait()):
        pass
    if ended_works[0].result is None:
        raise LdcError(problem="worker processes end whatever they run", hint="what was stored is kept")


@dataclasses.dataclass(frozen=True, eq=False)
class _Call(Work):
    function: Callable[[Any], Any]
    item: Any

    def run(self, cache: dict[str, Any]) -> Any:  # noqa: ARG002
        return (self.function(self.item),)


def map_on(executor: Executor, function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """As `map`, in the order in which results are there; `LdcError` where one ends every worker."""
    for _, result in run_works(executor, [_Call(function, item) for item in items]):
        if isinstance(result, Lost):
            problem = "a worker process ended abruptly: out of memory, or killed"
            raise LdcError(problem=problem, hint="one worker needs no other process")
        yield result[0]


class Progress:
    """What a run reports to; this one shows nothing."""

    def stage(self, name: str, total: int) -> None:
        """A new stage of so many scenario runs begins; the one before is over."""

    def advance(self, runs: int) -> None:
        """So many more scenario runs are done."""

    def phase(self, name: str) -> None:
        """What takes its time between two stages."""

    @contextlib.contextmanager
    def compiling(self, text: str) -> Iterator[None]:
        """Loops are compiled while the block runs."""
        self.phase(text)
        yield

    def close(self) -> None:
        """Nothing comes any more."""


class Bar(Progress):
    """A bar on stderr with the rate and the time left."""

    def __init__(self) -> None:
        from rich import progress
        from rich.console import Console

        self._bar: Any = progress.Progress(
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            progress.TaskProgressColumn(),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._bar.start()
        self._task: Any = None
        self._done, self._started = 0, time.monotonic()

    def stage(self, name: str, total: int) -> None:
        """Begin a bar; without a total it pulses."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._done, self._started = 0, time.monotonic()
        self._task = self._bar.add_task(name, total=total or None, rate="")

    def phase(self, name: str) -> None:
        """Show the name."""
        self.stage(name, 0)

    @contextlib.contextmanager
    def compiling(self, text: str) -> Iterator[None]:
        """A second line that moves."""
        task = self._bar.add_task(text, total=None, rate="")
        yield
        self._bar.remove_task(task)

    def advance(self, runs: int) -> None:
        """Move the bar."""
        self._done += runs
        rate = self._done / max(time.monotonic() - self._started, 1e-3)
        self._bar.update(self._task, completed=self._done, rate=f"{rate:,.0f} scenario runs/s")

    def close(self) -> None:
        """Take the bar away."""
        self._bar.stop()


@contextlib.contextmanager
def displayed(progress: bool | Progress | None) -> Iterator[Progress]:
    """What a run reports to: a bar if requested, or, with None, where stderr is a terminal; it shows compiling too."""
    show = sys.stderr.isatty() if progress is None else progress
    shown = (Bar() if show else Progress()) if isinstance(show, bool) else show
    # where there is no terminal, compiling takes a line, which was not refused
    elsewhere = contextlib.nullcontext() if progress is None and not show else compiling.shown_by(shown.compiling)
    with contextlib.closing(shown), elsewhere:
        yield shown
