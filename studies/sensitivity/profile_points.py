"""Which designs a one-at-a-time profile looks at: those a study holds, and others that fill the declared ranges."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.law_space import THRESHOLD, Choices, Span
from studies.results import StudyResults
from studies.sensitivity.sensitivity import gain_value
from studies.study_file.spec import Study


@dataclasses.dataclass(frozen=True)
class ProfilePoint:
    """One value of one dimension, and the design that has it and is otherwise the one in the middle."""

    name: str
    value: GainValue
    design: Design


def profile_points(results: StudyResults, study: Study, winner: Design, points: int) -> Iterator[ProfilePoint]:
    """Every value of every dimension that is to be looked at, the winner's own among them.

    Parameters
    ----------
    results : StudyResults
    study : Study
    winner : Design
    points : int
        Numbers of which there are fewer are filled up to so many, and both ends of the declared range are looked at; 0
        takes only designs that the results hold.

    Yields
    ------
    ProfilePoint
        Dimension by dimension, the threshold first; numbers in rising order, words and switches as they are written.
        A dimension with a single value has none.
    """
    asked = () if study.search is not None else study.designs
    family = [design for design in dict.fromkeys((*results.designs, *asked)) if design.law == winner.law]
    held = frozenset(results.designs)
    kinds = {gain.name: gain for gain in controller_class(winner.law).gains()}
    for name in (THRESHOLD, *(gain for gain, _ in winner.gains)):
        used = list(dict.fromkeys((*(gain_value(one, name) for one in family), *_declared(study, winner.law, name))))
        own = gain_value(winner, name)
        if len(used) < 2:
            continue
        have = [value for value in used if value == own or moved(winner, name, value) in held]
        gain = kinds.get(name)
        words = any(isinstance(value, str | bool) for value in used)
        if points and words:
            have = used
        elif points:
            log = gain is not None and gain.scale == "log"
            whole = gain is not None and isinstance(gain.default, int)
            held_numbers = [float(value) for value in have]
            have += _between([float(value) for value in used], held_numbers, points, log=log, whole=whole)
        if len(have) > 1:
            ordered = have if words else sorted(have, key=float)
            yield from (ProfilePoint(name, value, moved(winner, name, value)) for value in ordered)


def declared_ends(study: Study, law: str, name: str) -> tuple[float, float] | None:
    """Smallest and largest number that the tables of a study allow in one dimension of a law.

    Parameters
    ----------
    study : Study
    law : str
        Registry name.
    name : str
        ``"y_s"`` or a gain.

    Returns
    -------
    tuple of float, or None
        None for words and switches, and for a dimension that no table of the law sets.

    Examples
    --------
    >>> block = {"law": "none", "y_s": {"from": 0.3, "to": 0.05}, "sample": {"method": "sobol", "count": 4}}
    >>> declared_ends(Study.from_dict({"name": "s", "design": [block]}), "none", "y_s")
    (0.05, 0.3)
    """
    values = list(_declared(study, law, name))
    if not values or any(isinstance(value, str | bool) for value in values):
        return None
    numbers = [float(value) for value in values]
    return min(numbers), max(numbers)


def _declared(study: Study, law: str, name: str) -> Iterator[GainValue]:
    """Every value of the lists and both ends of the ranges that the tables hold for one dimension of a law."""
    for block in study.design:
        for space in block.space():
            if space.law == law:
                for other, dimension in space.dimensions:
                    if other == name:
                        yield from (
                            dimension.values if isinstance(dimension, Choices) else (dimension.low, dimension.high)
                        )


def _between(used: Sequence[float], have: Sequence[float], points: int, *, log: bool, whole: bool) -> list[GainValue]:
    """Evenly spaced numbers over the range of those used, without such as lie close to one that is there already.

    Both ends are always among the old and new ones: a range is not shorter because its sample did not meet them.
    """
    low, high = min(used), max(used)
    span = Span(low, high, "log" if log and low * high > 0 else "linear")
    added: list[GainValue] = [round(end) if whole else end for end in (low, high) if end not in have]
    if len(have) >= points:
        return added
    there = [_share(span, value) for value in have]
    for share in np.linspace(0.0, 1.0, points)[1:-1].tolist():
        if min(abs(share - other) for other in there) > 0.5 / max(1, points - 1):
            value = round(float(span.at(share))) if whole else span.at(share)
            if value not in added and value not in have:
                added.append(value)
    return added


def _share(span: Span, value: float) -> float:
    """Where a value lies between the ends, from 0 to 1."""
    if span.scale == "log":
        return float(np.log(value / span.first) / np.log(span.last / span.first))
    return (value - span.first) / (span.last - span.first)


def moved(winner: Design, name: str, value: GainValue) -> Design:
    """The design with another value in one dimension."""
    if name == THRESHOLD:
        return dataclasses.replace(winner, y_s=float(value))
    gains = tuple((gain, value if gain == name else own) for gain, own in winner.gains)
    return dataclasses.replace(winner, gains=gains)
