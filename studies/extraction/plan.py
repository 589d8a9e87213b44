"""What an extraction was asked for and of which files: what has to be the same for its parts to be used again."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import ldctoolkit
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings.extract_part import extract_part
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.opened import ReadersTogether
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.result import PartResult
from ldctoolkit.recordings.sources import GROUP, RecordingPart, RecordingReader, RecordingSource
from studies.running.worker import versions

PACKAGES: Final = ("numpy", "polars", "numba")
"""Packages that read files or decide numbers."""


@dataclasses.dataclass(frozen=True)
class Unread:
    """Why nothing came out of a part."""

    reason: str  # One sentence


@dataclasses.dataclass(frozen=True, eq=False)
class PartWork:
    """Reads one part and finds its departures."""

    number: int  # Place of the part in its source
    part: RecordingPart  # What is read
    criteria: Criteria  # What counts as a departure
    preparation: Preparation  # How recordings are brought to a common form
    time_limit: float = 0.0  # [s] None: how long a file takes depends on the disk

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Nothing is needed."""

    def run(self, kept: dict[str, Any]) -> PartResult | Unread:  # noqa: ARG002
        """Read the part; a fault in it, or in its reader, ends this part alone."""
        try:
            return extract_part(self.part, self.criteria, self.preparation)
        except LdcError as error:
            return Unread(str(error))
        except Exception as error:  # a reader may be anybody's code
            return Unread(f"{type(error).__name__}: {error}")


@dataclasses.dataclass(frozen=True, eq=False)
class Probe:
    """Does nothing: tells whether workers live at all."""

    number: int  # Of no part
    time_limit: float = 0.0  # [s] None

    def make_ready(self, kept: dict[str, Any]) -> None:
        """Nothing is needed."""

    def run(self, kept: dict[str, Any]) -> bool:  # noqa: ARG002
        """Say so."""
        return True


FORMAT_VERSION: Final = 1

_SAID: Final = {
    "files": "the files have changed",
    "parts": "they are divided in another way",
    "program": "the program has changed",
}
"""What it means where a digest differs."""

Plan = dict[str, Any]
"""Content of a work folder's manifest, as JSON reads it back."""


def plan_of(reader: RecordingReader, source: RecordingSource, criteria: Criteria, preparation: Preparation) -> Plan:
    """What decides the numbers of all parts."""
    home = Path(ldctoolkit.__file__).parent
    keys = json.dumps([part.key for part in source.parts])
    plan = {
        "format_version": FORMAT_VERSION,
        "reader": reader.name,
        "program": _program(home, _others(home, reader, source.parts)),
        "versions": dict(versions(("ldctoolkit", *PACKAGES))) | _offered_by(reader.name),
        "criteria": dataclasses.asdict(criteria),
        "preparation": dataclasses.asdict(preparation),
        "files": [[file.name, file.bytes, file.sha256] for file in source.files],
        "parts": [len(source.parts), hashlib.sha256(keys.encode()).hexdigest()],
    }
    content: Plan = json.loads(json.dumps(plan))
    return content


def _program(home: Path, others: Iterable[tuple[str, Path]] = ()) -> str:
    """Digest of the code that decides the numbers: a checkout changes without another version.

    `home` is the toolkit's folder, `others` are names and files of modules outside it.
    """
    own = [*(home / "recordings").rglob("*.py"), home / "departures.py"]
    named = sorted((path.relative_to(home).as_posix(), path) for path in own)
    digest = hashlib.sha256()
    for name, path in [*named, *others]:
        content = path.read_bytes() if path.is_file() else b""
        digest.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def _others(home: Path, reader: RecordingReader, parts: Iterable[RecordingPart]) -> Iterator[tuple[str, Path]]:
    """Names and files of the modules outside the toolkit that a reader and its parts come from, where they have one."""
    readers = reader.readers if isinstance(reader, ReadersTogether) else (reader,)
    modules = {one.__name__ if isinstance(one, ModuleType) else type(one).__module__ for one in readers}
    for name in sorted(modules | {kind.__module__ for kind in {type(part) for part in parts}}):
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is not None and not Path(file).is_relative_to(home):
            yield name, Path(file)


def _offered_by(reader: str) -> dict[str, str]:
    """The package that a reader comes with, and its version; of each, where several work together."""
    names = reader.split(" + ")
    points = [point for point in importlib.metadata.entry_points(group=GROUP) if point.name in names]
    return {point.dist.name: point.dist.version for point in points if point.dist is not None}


def what_differs(there: Plan, now: Plan) -> str:
    """Half a sentence on what differs between two plans; at most three things are named."""
    found: list[str] = []
    for key in {**now, **there}:
        a, b = there.get(key), now.get(key)
        if a == b:
            continue
        if isinstance(a, dict) and isinstance(b, dict):
            for name in {**b, **a}:
                if a.get(name) != b.get(name):
                    found.append(f"{name}: {_shown(a.get(name))} there, {_shown(b.get(name))} now")
        elif key in _SAID:
            found.append(_SAID[key])
        else:
            found.append(f"{key}: {_shown(a)} there, {_shown(b)} now")
    more = f"; and {len(found) - 3} more" if len(found) > 3 else ""
    return "; ".join(found[:3]) + more


def _shown(value: Any) -> str:
    return "not set" if value is None else str(value)
