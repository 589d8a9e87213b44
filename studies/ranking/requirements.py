"""Which designs meet the requirements of a ranking."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from studies.ranking.case_figures import CaseFigures
from studies.ranking.figures import Requirement, figure_values


def missed_requirements(requirements: Sequence[Requirement], figures: CaseFigures) -> tuple[tuple[str, ...], ...]:
    """For every design the requirements that it does not meet, in words.

    Parameters
    ----------
    requirements : sequence of Requirement
    figures : CaseFigures
        Of d designs.

    Returns
    -------
    tuple of d tuples of str
        Empty for a design that meets all. A figure that a design does not have (NaN) meets nothing.
    """
    missed: list[list[str]] = [[] for _ in range(figures.S.size)]
    for one in requirements:
        for i in np.flatnonzero(~one.met(figure_values(one.figure.name, figures))).tolist():
            missed[i].append(one.text)
    return tuple(tuple(texts) for texts in missed)
