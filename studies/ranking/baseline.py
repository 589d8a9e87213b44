"""The design that all others are compared with beside the best, found by the word of the study file."""

from __future__ import annotations

import re
from collections.abc import Sequence

from ldctoolkit.errors import InputError, nearest
from studies.design import NO_CONTROL, Design
from studies.results import StudyResults

_FEWEST_DIGITS = 6
"""Of an identifier, so that no law's name is taken for one."""


def find_baseline(baseline: str, results: StudyResults) -> int | None:
    """Position of the baseline in `results.designs`.

    Parameters
    ----------
    baseline : str
        A law's name (its first design in the study's order), the start of a design's identifier (6 digits or more), or
        empty for the design without control.
    results : StudyResults

    Returns
    -------
    int or None
        None where the study has no design without control and no other is wanted, or where the one that is wanted
        failed or was given up in a race.

    Raises
    ------
    InputError
        If the study has no such design, or more than one; the message names the nearest.
    """
    here = _found(baseline or NO_CONTROL, results.designs)
    if here:
        return here[0]
    dropped = () if results.race is None else results.race.dropped
    gone = [*(one.design for one in results.failed), *(one.design for one in dropped)]
    if not baseline or _found(baseline, gone):
        return None
    laws = list(dict.fromkeys(design.law for design in (*results.designs, *gone)))
    raise InputError(
        f"ranking.baseline: {baseline!r} is no law of this study, nor the start of a design's identifier "
        f"({_FEWEST_DIGITS} digits or more); {nearest(baseline, laws)}"
    )


def _found(baseline: str, designs: Sequence[Design]) -> list[int]:
    of_law = [i for i, design in enumerate(designs) if design.law == baseline]
    if of_law or not re.fullmatch(rf"[0-9a-f]{{{_FEWEST_DIGITS},12}}", baseline):
        return of_law
    of_start = [i for i, design in enumerate(designs) if design.id.startswith(baseline)]
    if len(of_start) > 1:
        raise InputError(
            f"ranking.baseline: {baseline!r} is the start of {len(of_start)} identifiers; allowed: more digits, as "
            f"{designs[of_start[0]].id!r}"
        )
    return of_start
