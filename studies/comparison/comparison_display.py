"""A comparison in a notebook: its sentence and the designs that changed most, in one piece of escaped HTML."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from studies.comparison.comparison import CaseComparison, Comparison

TOP: Final = 20
"""Rows, of the primary case."""

_CELL: Final = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"


def comparison_html(comparison: Comparison, top: int = TOP) -> str:
    """A comparison as HTML without script.

    Parameters
    ----------
    comparison : Comparison
    top : int
        Rows.

    Returns
    -------
    str
        Everything in it is escaped.
    """
    case = comparison.cases[0]
    names = ("verdict", "design", "old S [m s]", "new S [m s]", "new \u2212 old [m s]", "interval")
    headings = "".join(f'<th scope="col" style="text-align:left;{_CELL}">{html.escape(name)}</th>' for name in names)
    rows = "".join(_row(case, i) for i in case.order[:top])
    differs = "".join(f"<br>{html.escape(text)}" for text in comparison.differences)
    warnings = "".join(f"<br><b>Warning:</b> {html.escape(text)}" for text in comparison.warnings)
    more = len(case) - min(top, len(case))
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(comparison.old_name)} &rarr; '
        f"{html.escape(comparison.new_name)}</b><br>{html.escape(comparison.summary)}{differs}{warnings}</div>"
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><thead><tr>{headings}</tr></thead>'
        f"<tbody>{rows}</tbody></table>{f'<div>and {more:,} more</div>' if more else ''}</div>"
    )


def _row(case: CaseComparison, i: int) -> str:
    S = case.S
    interval = f"{S.low[i]:+.4f} to {S.high[i]:+.4f}" if np.isfinite(S.low[i] + S.high[i]) else "too few changed"
    numbers = (f"{S.S_old[i]:.4f}", f"{S.S_new[i]:.4f}", f"{S.difference[i]:+.4g}", interval)
    cells = (str(S.verdict[i]), case.designs[i].label, *(one.replace("-", "\u2212") for one in numbers))
    # only a design's label may break
    styles = (_CELL + ";white-space:nowrap" * (column != 1) for column in range(len(cells)))
    shown = (
        f'<td style="text-align:left;{style}">{html.escape(cell)}</td>'
        for style, cell in zip(styles, cells, strict=True)
    )
    return f"<tr>{''.join(shown)}</tr>"
