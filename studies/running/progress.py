"""How far a run is: a bar for people, lines for scripts, or nothing."""

from __future__ import annotations

import json
import sys
import time
from typing import Any, Protocol, TextIO

_LINE_EVERY = 1.0
"""Seconds between lines."""


class Progress(Protocol):
    """Told what a run does."""

    def stage(self, name: str, total: int) -> None:
        """A new stage of so many scenario runs begins; the one before is over."""

    def advance(self, runs: int) -> None:
        """So many more scenario runs are done."""

    def close(self) -> None:
        """Nothing comes any more."""


class Silent:
    """Tells nothing."""

    def stage(self, name: str, total: int) -> None:
        """Nothing."""

    def advance(self, runs: int) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


class Lines:
    """One JSON object a line: stage, scenario runs done and in all, rate and seconds left."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._name, self._total, self._done = "", 0, 0
        self._started = self._told = time.monotonic()

    def stage(self, name: str, total: int) -> None:
        """Write the first line of a stage."""
        self._name, self._total, self._done = name, total, 0
        self._started = time.monotonic()
        self._tell()

    def advance(self, runs: int) -> None:
        """Write a line if the last one is old, or this is the stage's last."""
        self._done += runs
        if self._done >= self._total or time.monotonic() - self._told > _LINE_EVERY:
            self._tell()

    def _tell(self) -> None:
        now = time.monotonic()
        seconds = now - self._started
        rate = self._done / seconds if self._done and seconds > 0 else None
        line = {
            "event": "progress",
            "stage": self._name,
            "done": self._done,
            "total": self._total,
            "runs_per_s": None if rate is None else round(rate, 1),
            "seconds_left": None if rate is None else round((self._total - self._done) / rate, 1),
        }
        self._stream.write(json.dumps(line) + "\n")
        self._stream.flush()
        self._told = now

    def close(self) -> None:
        """Nothing more."""


class Bar:
    """A bar on stderr with the rate and the time left."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

        self._bar: Any = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self._bar.start()
        self._task: Any = None
        self._done, self._started = 0, time.monotonic()

    def stage(self, name: str, total: int) -> None:
        """Begin a bar."""
        if self._task is not None:
            self._bar.remove_task(self._task)
        self._done, self._started = 0, time.monotonic()
        self._task = self._bar.add_task(name, total=max(total, 1), rate="")

    def advance(self, runs: int) -> None:
        """Move the bar."""
        self._done += runs
        rate = self._done / max(time.monotonic() - self._started, 1e-3)
        self._bar.update(self._task, completed=self._done, rate=f"{rate:,.0f} scenario runs/s")

    def close(self) -> None:
        """Take the bar away."""
        self._bar.stop()


def default_progress(show: bool | None) -> Progress:
    """A bar if asked for, or, with None, where stderr is a terminal."""
    return Bar() if (sys.stderr.isatty() if show is None else show) else Silent()
