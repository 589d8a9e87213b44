"""A worker that is told to end finishes what it is sending, and nothing else."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import signal
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from studies import simulate_designs

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="processes end in another way on Windows")

SIZE = 50_000_000


class Large:
    """Says when it is being sent, and takes its time over it."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[Any, ...]:
        self.marker.touch()
        time.sleep(0.5)
        return bytes, (SIZE,)


def _start(marker: Path, *, slow: bool) -> None:
    def run(block: object) -> list[Large]:
        if slow:
            marker.touch()
            time.sleep(120)
        return [Large(marker)]

    signal.signal(signal.SIGTERM, simulate_designs._end)
    simulate_designs._simulator = SimpleNamespace(run=run)  # type: ignore[assignment]


def _slow(marker: Path) -> None:
    _start(marker, slow=True)


def _large(marker: Path) -> None:
    _start(marker, slow=False)


def _ended_after_marker(start: Any, marker: Path, times: int = 1) -> Any:
    context = multiprocessing.get_context("fork")
    with concurrent.futures.ProcessPoolExecutor(1, context, initializer=start, initargs=(marker,)) as pool:
        future = pool.submit(simulate_designs.work, None)  # type: ignore[arg-type]
        while not marker.exists():
            time.sleep(0.01)
        for _ in range(times):
            for process in multiprocessing.active_children():
                process.terminate()
            time.sleep(0.1)
        return future.result(timeout=60)


def test_a_result_on_its_way_arrives_whole(tmp_path: Path) -> None:
    """Else the parent waits for ever for its other half."""
    assert _ended_after_marker(_large, tmp_path / "sending") == [bytes(SIZE)]


def test_a_block_that_is_being_computed_ends_at_once(tmp_path: Path) -> None:
    with pytest.raises(BrokenProcessPool):
        _ended_after_marker(_slow, tmp_path / "computing")


def test_the_second_time_a_worker_ends_whatever_it_does(tmp_path: Path) -> None:
    """A pool that lost another worker reads no more results, and asks again: nobody may wait for one that sends."""
    with pytest.raises(BrokenProcessPool):
        _ended_after_marker(_large, tmp_path / "sending", times=2)
