"""Files of older versions: each step makes the next version's content, and the last one is read.

Nothing is checked here: a value that does not belong is left alone, and the reader finds it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

Json = dict[str, Any]

FIRST: Final = 1


def _change(owner: Mapping[str, Any], key: str, change: Callable[[Json], Json]) -> Json:
    """A copy of an object with one of its objects changed."""
    value = owner.get(key)
    return {**owner, key: change(value)} if isinstance(value, dict) else dict(owner)


def _from_1(data: Mapping[str, Any]) -> Json:
    """Version 2 knows transforms and a longer card; nothing of it was known before but the criterion."""

    def side(old: Json) -> Json:
        names = old.get("parameters")
        return {"transform": ["none"] * len(names) if isinstance(names, list) else [], **old}

    def summary(old: Json) -> Json:
        lists: Json = {key: [] for key in ("n_parameters", "aic", "icl", "held_out", "failed", "bounds_from")}
        tried = old.get("n_components")
        several = isinstance(tried, list) and len(tried) > 1
        how = {"criterion": "bic", "reason": "smallest BIC"} if several else {"criterion": "", "reason": ""}
        return {**lists, **how, "passes": None, "stop_reason": "", "weight": None, **old}

    def provenance(old: Json) -> Json:
        for label in ("left", "right"):
            old = _change(old, label, summary)
        return {"versions": {}, "settings": None, **old}

    def sides(old: Json) -> Json:
        return _change(_change(old, "left", side), "right", side)

    return {**_change(_change(data, "sides", sides), "provenance", provenance), "version": 2}


def _from_2(data: Mapping[str, Any]) -> Json:
    """Version 3 may hold how the departures of a side spread."""

    def summary(old: Json) -> Json:
        return {"source_summary": None, **old}

    def provenance(old: Json) -> Json:
        return _change(_change(old, "left", summary), "right", summary)

    return {**_change(data, "provenance", provenance), "version": 3}


STEPS: Final[tuple[Callable[[Mapping[str, Any]], Json], ...]] = (_from_1, _from_2)
"""From version `FIRST` on, one step a version."""

NEWEST: Final = FIRST + len(STEPS)


def to_newest(data: Mapping[str, Any], version: int) -> Mapping[str, Any]:
    """Content of the newest version, from that of any known one.

    Examples
    --------
    >>> to_newest({"version": 1, "sides": {"left": {"parameters": ["T"]}}}, 1)
    {'version': 3, 'sides': {'left': {'transform': ['none'], 'parameters': ['T']}}}
    """
    for step in STEPS[version - FIRST :]:
        data = step(data)
    return data
