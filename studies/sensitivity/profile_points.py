"""Which designs a one-at-a-time profile looks at: those a study holds, and numbers between that fill the gaps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.dimensions import Span
from studies.design_space.law_space import THRESHOLD
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
        Numbers of which there are fewer are filled up to so many; 0 takes only designs that the results hold.

    Yields
    ------
    ProfilePoint
        Dimension by dimension, the threshold first; numbers in rising order, words and switches as they are written.
        A dimension with a single value has none.
    """
    asked = () if study.search is not None else study.designs
    family = [design for design in dict.fromkeys((*results.designs, *asked)) if design.law == winner.law]
    held = frozenset(results.designs)
    declared = {gain.name: gain for gain in controller_class(winner.law).gains()}
    for name in (THRESHOLD, *(gain for gain, _ in winner.gains)):
        used = list(dict.fromkeys(gain_value(design, name) for design in family))
        own = gain_value(winner, name)
        if len(used) < 2:
            continue
        have = [value for value in used if value == own or moved(winner, name, value) in held]
        gain = declared.get(name)
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


def _between(used: Sequence[float], have: Sequence[float], points: int, *, log: bool, whole: bool) -> list[GainValue]:
    """Evenly spaced numbers over the range of those used, without such as lie close to one that is there already."""
    if len(have) >= points:
        return []
    low, high = min(used), max(used)
    span = Span(low, high, "log" if log and low * high > 0 else "linear")
    added: list[GainValue] = []
    shares = np.linspace(0.0, 1.0, points)
    there = [_share(span, value) for value in have]
    for share in shares.tolist():
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
