"""Sends parts to an executor and gives what comes back; finds the part that ends its worker."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Final

from ldctoolkit.recordings.part_result import PartResult
from studies.extraction.part_work import PartWork, Probe, Unread
from studies.running.executors import Executor
from studies.running.faults import Faults

_AHEAD: Final = 2
"""Parts a worker that are under way or wait in the executor."""

_ENDED = "ended its worker process each time it was read (out of memory?); it is left out"


def send_parts(executor: Executor, works: Sequence[PartWork]) -> Iterator[tuple[PartWork, PartResult | Unread]]:
    """Run parts, and give each with what came out as soon as it is there.

    A part that may have ended its worker is run again alone. If it ends that one too, it is `Unread`.

    Parameters
    ----------
    executor : Executor
        Where they run.
    works : sequence of PartWork
        In the order in which they begin.

    Raises
    ------
    LdcError
        If workers end whatever they run.
    """
    waiting, alone = deque(works), deque[PartWork]()
    faults = Faults()
    under_way = 0
    while waiting or alone or under_way:
        if alone:
            if not under_way:
                executor.start(alone.popleft())
                under_way = 1
        else:
            most = 1 if executor.workers == 1 else _AHEAD * executor.workers
            while under_way < most and waiting:
                executor.start(waiting.popleft())
                under_way += 1
        came = executor.wait()
        faults.came_back(came)
        for ended in came:
            under_way -= 1
            work: PartWork = ended.task
            if ended.done is not None:
                faults.ended_well()
                yield work, ended.done
            elif ended.fault is None:
                waiting.append(work)
            elif not faults.guilty(work, ended.fault, certain=ended.certain):
                alone.append(work)
            else:
                faults.check_workers(executor, Probe(1 + max(one.number for one in works)))
                yield work, Unread(_ENDED)
