"""A source whose parts are made up: what they hold is known, and they can misbehave."""

import dataclasses
import os
import signal
import sys
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Extraction
from ldctoolkit.recordings.departures_table import PartResult
from ldctoolkit.recordings.recording import Label, OpenedRecordings, Problem, Recording, SourceFile


def drive(seed: int) -> Recording:
    """Two departures, one to either side, with labels."""
    generator = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.1)
    offset = np.zeros(t.size)
    for middle, sign in ((8.0, 1), (20.0, -1)):
        T, peak = generator.uniform(1, 4), generator.uniform(0.1, 0.5)
        offset += sign * np.maximum(peak * (1 - (2 * (t - middle) / T) ** 2) + 0.9, 0.0)
    offset += 0.01 * generator.normal(size=t.size)
    return Recording(
        name=f"drive {seed}", t=t, lane_offset=offset, lane_width=np.full(t.size, 3.6),
        speed=generator.uniform(20, 30) + 0.1 * generator.normal(size=t.size), valid=np.ones(t.size, dtype=bool),
        yaw_rate=0.01 * generator.normal(size=t.size), labels=(Label("driver", f"D{seed % 2}"),),
        source=f"file {seed % 3}", lane_scale=1.0 if seed % 4 else 1.25, notes=("no heading",),
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class MadePart:
    """Three drives; `how` says what else happens while it is read, `folder` is where it notes that it was."""

    seed: int
    folder: str
    how: str = "good"
    bytes: int = 100

    @property
    def key(self) -> str:
        return f"part {self.seed}"

    def read(self) -> Iterator[Recording | Problem]:
        with Path(self.folder, f"read-{self.seed}").open("a", encoding="utf-8") as stream:
            stream.write("x")
        if self.how == "refused":
            raise RecordingError("nothing here can be used")
        for i in range(3):
            one = drive(10 * self.seed + i)
            yield dataclasses.replace(one, speed=3.6 * one.speed) if self.how == "in km/h" else one
            if self.how == "dies" or (self.how == "dies once" and self.times == 1):
                os.kill(os.getpid(), signal.SIGKILL)
            if self.how == "raises":
                raise ZeroDivisionError("a reader's own fault")
            if self.how == "interrupted" and self.times == 1:
                raise KeyboardInterrupt
        yield Problem(self.key, "line 7", "is left out")

    @property
    def times(self) -> int:
        """How often it was read."""
        path = Path(self.folder, f"read-{self.seed}")
        return len(path.read_text(encoding="utf-8")) if path.exists() else 0


@dataclasses.dataclass(frozen=True)
class ShownPart(MadePart):
    """Has a name for users."""

    @property
    def shown(self) -> str:
        return f"{self.seed}.made"


@dataclasses.dataclass(frozen=True)
class MadeSource:
    parts: tuple[MadePart, ...]
    files: tuple[SourceFile, ...]
    problems: tuple[Problem, ...] = (Problem("file 9", "", "is empty"),)


def made(folder: Path, *how: str, digest: str = "0" * 64, kind: type[MadePart] = MadePart) -> OpenedRecordings:
    """Opened recordings with one part for each word."""
    folder.mkdir(exist_ok=True)
    parts = tuple(kind(i, str(folder), word) for i, word in enumerate(how))
    reader: Any = types.SimpleNamespace(name="made", vehicle_width=1.8, step=0.1)
    return OpenedRecordings(reader, MadeSource(parts, (SourceFile("file 0", 300, digest),)), "made up")


def content(found: Extraction) -> tuple[Any, ...]:
    """All that an extraction holds, comparable bit for bit."""
    from ldctoolkit.studies.storage.checked_parts import encoded

    whole = PartResult(found.departures, found.accounts, drawn=found.drawn, problems=found.problems)
    return found.provenance, encoded(whole)


@pytest.fixture(name="made")
def _made(tmp_path: Path) -> Iterator[Callable[..., OpenedRecordings]]:
    """`made` in a folder of the test; workers learn these classes by value."""
    module = sys.modules[__name__]
    cloudpickle.register_pickle_by_value(module)
    yield lambda *how, **named: made(tmp_path / "notes", *how, **named)
    cloudpickle.unregister_pickle_by_value(module)


@pytest.fixture(name="shown_part", scope="session")
def _shown_part() -> type[MadePart]:
    return ShownPart


@pytest.fixture(name="content")
def _content() -> Callable[[Extraction], tuple[Any, ...]]:
    return content


@pytest.fixture(name="drive", scope="session")
def _drive() -> Callable[[int], Recording]:
    return drive
