"""A finished study as one side of a comparison, and what differs between the inputs of two."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ldctoolkit.errors import StoreError
from studies.manifest import Manifest
from studies.results import StudyResults
from studies.spec import Study
from studies.store import Store


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


def input_differences(old: Manifest, new: Manifest) -> tuple[str, ...]:
    """What decides the numbers of two studies and is not the same, as ``"vehicle.m: 1000.0 -> 1100.0"``.

    Parameters
    ----------
    old, new : Manifest

    Returns
    -------
    tuple of str
        The scenario model and the toolkit first, other packages last; empty if all inputs are the same.
    """
    return tuple(_differences(old, new))


def _differences(old: Manifest, new: Manifest) -> Iterator[str]:
    if old.model_hash != new.model_hash:
        was, now = (f"{m.model} (content {m.model_hash[:12]})" for m in (old, new))
        yield f"scenarios.model: {was} -> {now}"
    own = "ldctoolkit"
    yield from _changes({own: old.versions.get(own)}, {own: new.versions.get(own)}, "")
    yield from _changes(old.identity, new.identity, "")
    others = [{key: value for key, value in m.versions.items() if key != own} for m in (old, new)]
    yield from _changes({**others[0], "Python": old.python}, {**others[1], "Python": new.python}, "")


def _changes(old: dict[str, Any], new: dict[str, Any], prefix: str) -> Iterator[str]:
    for key in {**old, **new}:
        was, now = old.get(key), new.get(key)
        if was == now:
            continue
        if isinstance(was, dict) and isinstance(now, dict):
            yield from _changes(was, now, f"{prefix}{key}.")
        elif prefix + key == "designs" and isinstance(was, list) and isinstance(now, list):
            shared = len(set(was) & set(now))
            yield f"designs: {len(was)} -> {len(now)}, {shared} of them in both"
        else:
            yield f"{prefix}{key}: {_text(was)} -> {_text(now)}"


def _text(value: Any) -> str:
    return "not set" if value is None else str(value)
