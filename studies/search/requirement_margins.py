"""How far designs are from meeting the requirements of a ranking: what a sampler takes for constraints."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.ranking.case_figures import CaseFigures
from studies.ranking.figures import Requirement, figure_values

_MISSED: Final = 1e-12
"""Least margin of a requirement that is missed: ``"S < 0.5"`` at exactly 0.5."""


def requirement_margins(requirements: Sequence[Requirement], figures: CaseFigures) -> FloatArray:
    """How far each design is beyond the limit of each requirement, as a part of the limit.

    Parameters
    ----------
    requirements : sequence of Requirement
        k of them.
    figures : CaseFigures
        Of d designs.

    Returns
    -------
    (d, k)
        At most 0 where `Requirement.met` says so, above 0 elsewhere, infinite for a figure that a design does not have.
        In parts of the limit, because a sampler adds them up; in the figure's unit for a limit of 0.
    """
    margins = np.empty((figures.S.size, len(requirements)))
    for column, one in enumerate(requirements):
        values = figure_values(one.figure.name, figures)
        sign = 1.0 if one.operator in ("<", "<=") else -1.0
        with np.errstate(over="ignore"):  # infinitely far is an answer
            beyond = sign * (values - one.limit) / (abs(one.limit) or 1.0)
        beyond = np.where(np.isnan(beyond), np.inf, beyond)
        margins[:, column] = np.where(one.met(values), np.minimum(beyond, 0.0), np.maximum(beyond, _MISSED))
    return margins
