"""What an extraction was asked for and of which files: what has to be the same for its parts to be used again."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
import json
from pathlib import Path
from typing import Any, Final

import ldctoolkit
from ldctoolkit.recordings.criteria import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.sources import GROUP, RecordingSource
from studies.extraction.part_work import PACKAGES
from studies.running.executors.checked_task import versions

FORMAT_VERSION: Final = 1

_SAID: Final = {
    "files": "the files have changed",
    "parts": "they are divided in another way",
    "program": "the program has changed",
}
"""What it means where a digest differs."""

Plan = dict[str, Any]
"""Content of a work folder's manifest, as JSON reads it back."""


def plan_of(reader: str, source: RecordingSource, criteria: Criteria, preparation: Preparation) -> Plan:
    """What decides the numbers of all parts.

    Parameters
    ----------
    reader : str
        Name of the source's reader.
    source : RecordingSource
        Its files are told by their digests, its parts by their keys.
    criteria : Criteria
        What counts as a departure.
    preparation : Preparation
        How recordings are brought to a common form.
    """
    keys = json.dumps([part.key for part in source.parts])
    plan = {
        "format_version": FORMAT_VERSION,
        "reader": reader,
        "program": _program(),
        "versions": dict(versions(("ldctoolkit", *PACKAGES))) | _offered_by(reader),
        "criteria": dataclasses.asdict(criteria),
        "preparation": dataclasses.asdict(preparation),
        "files": [[file.name, file.bytes, file.sha256] for file in source.files],
        "parts": [len(source.parts), hashlib.sha256(keys.encode()).hexdigest()],
    }
    content: Plan = json.loads(json.dumps(plan))
    return content


def _program() -> str:
    """Digest of the code that decides the numbers: a checkout changes without another version."""
    digest = hashlib.sha256()
    home = Path(ldctoolkit.__file__).parent
    for path in [*sorted((home / "recordings").glob("*.py")), home / "departures.py"]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes() if path.exists() else b"")
    return digest.hexdigest()


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
