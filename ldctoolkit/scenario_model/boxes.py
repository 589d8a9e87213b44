"""The box of each side: given bounds, those of the extraction and of physics, and those read off the data."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.mixture.bounds import auto_bounds
from ldctoolkit.recordings import Criteria
from ldctoolkit.scenario_model.provenance import LEAST_LOWER, PHYSICAL_BOUNDS

End = float | None | Literal["auto"]
Bounds = Literal["auto", "physical"] | Mapping[str, tuple[End, End] | Literal["auto", "physical"]]
"""For all parameters one word, or per parameter a word or (lower, upper); None is open."""

GIVEN: Final = "given"
CRITERIA: Final = "extraction criteria"
PHYSICAL: Final = "physical"
AUTO: Final = "auto"


@dataclasses.dataclass(frozen=True)
class _End:
    """One wanted end: a value, or with `auto` the furthest that what the data show may reach."""

    value: float
    origin: str
    auto: bool = False


WantedBounds = Mapping[str, tuple[_End, _End]]


@dataclasses.dataclass(frozen=True)
class Box:
    """The box of one side."""

    lower: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    upper: FloatArray  # (8,): in the order of `PARAMETER_NAMES`
    origins: tuple[tuple[str, str, str], ...]  # (str, str, str)


def wanted_bounds(bounds: Bounds | None, criteria: Criteria | None) -> WantedBounds:
    """The bounds of each parameter, those of "auto" still to be found in the data."""
    known = _physical(criteria)
    if bounds is None or isinstance(bounds, str):
        per_name: Mapping[str, Any] = {} if bounds is None else dict.fromkeys(PARAMETER_NAMES, _word("bounds", bounds))
    elif isinstance(bounds, Mapping):
        per_name = bounds
    else:
        raise InputError(f"bounds: {bounds!r}; allowed: 'auto', 'physical', or a mapping of parameters")
    out = dict(known)
    for name, entry in per_name.items():
        if name not in known:
            raise InputError(f"bounds: no parameter {name!r}; {nearest(str(name), PARAMETER_NAMES)}")
        out[name] = _wanted(name, entry, known[name])
    return out


def _word(where: str, word: str) -> str:
    if word not in (AUTO, PHYSICAL):
        raise InputError(f"{where}: {word!r}; {nearest(word, (AUTO, PHYSICAL))}")
    return word


def _physical(criteria: Criteria | None) -> dict[str, tuple[_End, _End]]:
    out = {name: (_End(low, PHYSICAL), _End(high, PHYSICAL)) for name, (low, high) in PHYSICAL_BOUNDS.items()}
    if criteria is not None:  # no event outside them could have been found
        out["T"] = (_End(criteria.min_duration, CRITERIA), _End(criteria.max_duration, CRITERIA))
        out["v_mean"] = (_End(criteria.min_speed, CRITERIA), _End(np.inf, PHYSICAL))
    return out


def _furthest(name: str, known: tuple[_End, _End]) -> tuple[_End, _End]:
    """How far bounds that are read off the data may reach: what was not found, or cannot be driven, is outside."""
    low, high = known
    if low.origin != CRITERIA:
        low = _End(LEAST_LOWER.get(name, -np.inf), PHYSICAL)
    if high.origin != CRITERIA:
        high = _End(np.inf, PHYSICAL)
    return dataclasses.replace(low, auto=True), dataclasses.replace(high, auto=True)


def _wanted(name: str, entry: Any, known: tuple[_End, _End]) -> tuple[_End, _End]:
    where = f"bounds[{name!r}]"
    if isinstance(entry, str):
        return _furthest(name, known) if _word(where, entry) == AUTO else known
    ends: list[_End] = []
    try:
        given = tuple(entry)
        for value, fill, limit in zip(given, (-np.inf, np.inf), _furthest(name, known), strict=True):
            if isinstance(value, str) and value == AUTO:
                ends.append(limit)
            else:
                ends.append(_End(fill if value is None else float(value), GIVEN))
    except (TypeError, ValueError):
        raise InputError(f"{where}: {entry!r}; allowed: 'auto', 'physical' or (lower, upper)") from None
    least = LEAST_LOWER.get(name, -np.inf)
    if given[0] is None and least > -np.inf:
        ends[0] = _End(least, PHYSICAL)  # open as far as can be driven
    if not (ends[0].value < ends[1].value and ends[0].value >= least):
        raise InputError(f"{where}: {entry!r}; allowed: {least:g} <= lower < upper")
    return ends[0], ends[1]


def box_of(wanted: WantedBounds, x: FloatArray) -> Box:
    """The box for the events x (n, 8) of one side."""
    lower, upper = np.empty(len(PARAMETER_NAMES)), np.empty(len(PARAMETER_NAMES))
    origins = []
    for j, name in enumerate(PARAMETER_NAMES):
        low, high = wanted[name]
        found = auto_bounds(x[:, [j]]) if low.auto or high.auto else (np.empty(1), np.empty(1))
        lower[j], low_from = _decided(low, float(found[0][0]), 1.0)
        upper[j], high_from = _decided(high, float(found[1][0]), -1.0)
        origins.append((name, low_from, high_from))
    return Box(lower, upper, tuple(origins))


def _decided(end: _End, found: float, inwards: float) -> tuple[float, str]:
    """The value of an end, and where it comes from."""
    if not end.auto:
        return end.value, end.origin
    further_in = inwards * found >= inwards * end.value
    return (found, AUTO) if further_in else (end.value, end.origin)
