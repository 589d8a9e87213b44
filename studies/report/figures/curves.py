"""Scores of designs as curves of a figure."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from studies.report.context import Context
from studies.report.figures.scores import Curve
from studies.report.look.style import RECORDED
from studies.report.tables.row import Row
from studies.report.words.text import printable


def score_curves(
    context: Context, rows: Iterable[Row], mask: npt.NDArray[np.bool_], *, recorded: bool = True
) -> list[Curve]:
    """Scores of designs on some scenarios, with those without control first.

    Parameters
    ----------
    context : Context
    rows : iterable of Row
    mask : (n,) bool
        Which scenarios.
    recorded : bool
        Whether to begin with no control.

    Returns
    -------
    list of Curve
    """
    curves = []
    if recorded:
        curves.append(Curve("No control", RECORDED, context.S_uncorrected(context.primary.best)[mask]))
    paper = context.primary.paper_design
    for row in rows:
        S, S_0 = context.S(row)[mask], context.S_uncorrected(row)[mask]
        is_paper = paper is not None and row.index == paper.index
        label = printable(row.title) + (" (Table I)" if is_paper else "") + ("" if row.rank else " (not ranked)")
        saved = 1.0 - float(np.mean(S)) / float(np.mean(S_0)) if np.any(S_0 > 0) else 0.0
        curves.append(Curve(label, context.styles[row.design.law], S, saved))
    return curves
