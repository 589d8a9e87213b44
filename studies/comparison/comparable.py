"""A finished study as one side of a comparison, and what differs between the inputs of two."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ldctoolkit.errors import StoreError
from studies.design import Design
from studies.results import StudyResults
from studies.storage.manifest import Manifest
from studies.storage.store import Store
from studies.study_file.spec import Study


@dataclasses.dataclass(frozen=True)
class FinishedStudy:
    """A study that ran to its end.

    Attributes
    ----------
    source : str
        What messages call it: its folder.
    manifest : Manifest
    study : Study
    results : StudyResults
    """

    source: str
    manifest: Manifest
    study: Study
    results: StudyResults

    @classmethod
    def read(cls, folder: str | Path) -> FinishedStudy:
        """Read the folder of a study.

        Raises
        ------
        StoreError
            If it holds no study, or one that is broken or not finished.
        """
        store = Store.open(folder)
        if not store.manifest.finished:
            raise StoreError(f"{folder}: the study is not finished; run it into this folder again to go on")
        return cls(str(folder), store.manifest, store.manifest.read_study(), store.results())


def held_designs(results: StudyResults) -> dict[str, Design]:
    """All designs that a study met, by identifier: with results, failed, or given up in a race."""
    dropped = results.race.dropped if results.race is not None else ()
    every = (*results.designs, *(one.design for one in results.failed), *(one.design for one in dropped))
    return {design.id: design for design in every}


def input_differences(old: FinishedStudy, new: FinishedStudy) -> tuple[str, ...]:
    """What decides the numbers of two studies and is not the same, as ``"vehicle.m: 1000.0 -> 1100.0"``.

    Parameters
    ----------
    old, new : FinishedStudy

    Returns
    -------
    tuple of str
        The scenario model and the toolkit first, the designs and other packages last; empty if all inputs are the
        same.
    """
    return tuple(_differences(old, new))


def _differences(old: FinishedStudy, new: FinishedStudy) -> Iterator[str]:
    was, now = old.manifest, new.manifest
    if was.model_hash != now.model_hash:
        texts = [f"{m.model} (content {m.model_hash[:12]})" for m in (was, now)]
        yield f"scenarios.model: {texts[0]} -> {texts[1]}"
    own = "ldctoolkit"
    yield from _changes({own: was.versions.get(own)}, {own: now.versions.get(own)}, "")
    yield from _changes(old.study.inputs(), new.study.inputs(), "")
    before, after = (held_designs(side.results) for side in (old, new))
    if before.keys() != after.keys():
        yield f"designs: {len(before)} -> {len(after)}, {len(before.keys() & after.keys())} of them in both"
    packages = [{k: v for k, v in m.versions.items() if k != own} | {"Python": m.python} for m in (was, now)]
    yield from _changes(packages[0], packages[1], "")


def _changes(old: dict[str, Any], new: dict[str, Any], prefix: str) -> Iterator[str]:
    for key in {**old, **new}:
        was, now = old.get(key), new.get(key)
        if was == now:
            continue
        if isinstance(was, dict) and isinstance(now, dict):
            yield from _changes(was, now, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}: {_text(was)} -> {_text(now)}"


def _text(value: Any) -> str:
    return "not set" if value is None else str(value)
