"""Departures and designs that a reader asks for by number and by identifier."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

import numpy as np

from ldctoolkit import Scenarios
from ldctoolkit.errors import InputError
from studies.design import Design

_LISTED = 8
"""Identifiers that a message names."""


def asked_departures(scenarios: Scenarios, numbers: Sequence[int]) -> tuple[int, ...]:
    """Rows of the scenarios with these numbers, each once.

    Parameters
    ----------
    scenarios : Scenarios
        Those that every design could be driven on.
    numbers : sequence of int
        As in `Scenarios.index`.

    Raises
    ------
    InputError
        For a number that no scenario has.

    Examples
    --------
    >>> asked_departures(Scenarios.from_arrays(T=[2.0, 3.0], d_y=0.3, v_mean=25.0), [1, 1])
    (1,)
    """
    found = []
    for number in numbers:
        rows = np.flatnonzero(scenarios.index == number)
        if not rows.size:
            low, high = int(scenarios.index.min()), int(scenarios.index.max())
            inside = low <= number <= high
            why = "it is a scenario that cannot be driven; " if inside else ""
            near = int(scenarios.index[np.argmin(np.abs(scenarios.index - number))])
            raise InputError(f"departure: {number}; {why}allowed: {low} to {high}, the nearest is {near}")
        found.append(int(rows[0]))
    return tuple(dict.fromkeys(found))


def asked_designs(designs: Sequence[Design], prefixes: Sequence[str]) -> tuple[int, ...]:
    """Positions of the designs whose identifiers begin like this, each once.

    Parameters
    ----------
    designs : sequence of Design
    prefixes : sequence of str
        Beginnings of `Design.id`, long enough to mean one design.

    Raises
    ------
    InputError
        For a beginning that no design has, or several.
    """
    ids = [design.id for design in designs]
    found = []
    for prefix in prefixes:
        places = [i for i, name in enumerate(ids) if prefix and name.startswith(prefix.lower())]
        if len(places) != 1:
            raise InputError(f"design: {prefix!r}; {_help(prefix, [ids[i] for i in places], ids)}")
        found.append(places[0])
    return tuple(dict.fromkeys(found))


def _help(prefix: str, several: list[str], ids: list[str]) -> str:
    if several:
        more = f" and {len(several) - _LISTED} more" if len(several) > _LISTED else ""
        return f"{len(several)} designs begin like this ({', '.join(several[:_LISTED])}{more}); allowed: more digits"
    given = prefix.lower()

    def likeness(name: str) -> tuple[int, float]:
        shared = sum(name.startswith(given[:k]) for k in range(1, len(given) + 1))
        return shared, difflib.SequenceMatcher(None, given, name).ratio()

    close = max(ids, key=likeness)
    return f"no design begins like this, the nearest is {close}; allowed: the first digits of a design's id"
