"""Several departures tables as one."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path

from ldctoolkit.departures import Departures, joined_departures
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Provenance, Refused, read_departures


def read_all_departures(paths: Sequence[str | os.PathLike[str]]) -> tuple[Departures, Provenance]:
    """Read departures tables, in this order, as one.

    Raises
    ------
    RecordingError
        As `read_departures`; for tables of different criteria or preparations, or of the same recordings.
    """
    given = [Path(path).absolute() for path in paths]
    for path in given:
        if given.count(path) > 1:
            raise RecordingError(f"{path.name}: given more than once; allowed: every table once")
    tables = [read_departures(path) for path in paths]
    names = [Path(path).name for path in paths]
    provenance = merged_provenance(names, [found for _, found in tables])
    if len(tables) == 1:
        return tables[0][0], provenance
    return joined_departures([departures for departures, _ in tables]), provenance


def merged_provenance(names: Sequence[str], found: Sequence[Provenance]) -> Provenance:
    """Where the departures of several tables come from; `names` are the tables', for messages.

    Raises
    ------
    RecordingError
        If the criteria or the preparations differ, or a recording is in two tables.
    """
    first = found[0]
    if len(found) == 1:
        return first
    seen: dict[str, str] = {}
    for name, one in zip(names, found, strict=True):
        for kind in ("criteria", "preparation"):
            theirs = dataclasses.asdict(getattr(first, kind))
            for key, value in dataclasses.asdict(getattr(one, kind)).items():
                if value != theirs[key]:
                    raise RecordingError(
                        f"{name}: extracted with {key} = {value!r}, {names[0]} with {theirs[key]!r}; "
                        f"allowed: tables of the same {kind}"
                    )
        for source in one.sources:
            # empty files are all alike
            if source.bytes and seen.setdefault(source.sha256, name) != name:
                raise RecordingError(
                    f"{name}: holds departures of {source.name}, as does {seen[source.sha256]}; "
                    "allowed: every recording once"
                )
    refused = [dataclasses.asdict(one.refused) for one in found]
    kinds = {one.curvature for one in found}
    readers = {one.reader for one in found}
    return Provenance(
        criteria=first.criteria,
        refused=Refused(**{reason: sum(one[reason] for one in refused) for reason in refused[0]}),
        sources=tuple(source for one in found for source in one.sources),
        recordings=sum(one.recordings for one in found),
        samples=sum(one.samples for one in found),
        invalid_samples=sum(one.invalid_samples for one in found),
        hours=sum(one.hours for one in found),
        curvature=first.curvature if len(kinds) == 1 else "mixed",
        warnings=tuple(dict.fromkeys(warning for one in found for warning in one.warnings)),
        reader=first.reader if len(readers) == 1 else "mixed",
        preparation=first.preparation,
        problems=tuple(problem for one in found for problem in one.problems),
    )
