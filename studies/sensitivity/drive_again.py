"""Designs that a study does not hold, driven on its stored scenarios with its own settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ldctoolkit import EventStatus, LdcError
from ldctoolkit.arrays import FloatArray
from ldctoolkit.law_errors import raised
from ldctoolkit.simulation import Takeover, drive
from studies.design import Design
from studies.results import FAILED_STATUSES, CaseResults, StudyResults
from studies.study_file.spec import Study

_SAME = 1e-6
"""Scores [m s] that are driven anew differ from the stored ones by less: solver tolerance."""


def drive_designs(
    results: StudyResults,
    study: Study,
    case: CaseResults,
    designs: Sequence[Design],
    advance: Callable[[int, int], None] | None = None,
) -> dict[Design, FloatArray | str]:
    """Drive designs on all scenarios of a study; one takeover serves every design of a threshold.

    Parameters
    ----------
    results : StudyResults
        With the scenarios.
    study : Study
        With the settings.
    case : CaseResults
        The case whose window and convention count.
    designs : sequence of Design
    advance : callable, optional
        Called with the number of designs driven so far and of all.

    Returns
    -------
    dict of Design to (n,) [m s], or to str
        S as `CaseResults.counted` has it, NaN where a scenario cannot be driven; or why the law failed.
    """
    found: dict[Design, FloatArray | str] = {}
    for y_s in dict.fromkeys(design.y_s for design in designs):
        takeover = Takeover.build(results.scenarios, study.setup(case.case.convention), y_s=y_s)
        for design in designs:
            if design.y_s == y_s:
                found[design] = _counted(design, takeover, case)
                if advance is not None:
                    advance(len(found), len(designs))
    return found


def _counted(design: Design, takeover: Takeover, case: CaseResults) -> FloatArray | str:
    try:
        outcome = drive(design.controller(case.case.convention), takeover).outcome(case.case.window)
    except Exception as error:  # a controller may be anybody's code
        return raised(error)
    if not np.isfinite(outcome.S[outcome.status != EventStatus.INVALID]).all():
        return "S is not finite in some scenario"
    failed = np.isin(outcome.status, FAILED_STATUSES)
    counted: FloatArray = np.where(failed, np.maximum(outcome.S, outcome.S_uncorrected), outcome.S)
    return counted


def check_reproduced(design: Design, again: FloatArray | str, stored: FloatArray) -> None:
    """Refuse to set designs beside stored ones if one of these, driven again, does not give its stored scores.

    Raises
    ------
    LdcError
        Naming the design.
    """
    if isinstance(again, str):
        raise LdcError(f"design {design.id} ({design.label}) has results, but fails now: {again}")
    if not np.allclose(again, stored, rtol=0.0, atol=_SAME, equal_nan=True):
        raise LdcError(
            f"design {design.id} ({design.label}), driven again, does not give its stored scores: they are of another "
            "version or machine; no design can be added to them"
        )
