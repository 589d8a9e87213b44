"""A ranking in a notebook: a small table with interval bars, in one piece of escaped HTML with its own styles."""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING, Final

import numpy as np

from studies.ranking.sentences import failures, marks, ranking_sentences

if TYPE_CHECKING:
    from studies.ranking.ranking import Ranking

TOP: Final = 20
"""Rows; the winner and the baseline follow where they are further down."""

_BAR: Final = 120
"""Width of the interval bars [px]."""

# no ground and no text colour of its own: the notebook's theme, light or dark, sets them
_CELL: Final = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"
_LEFT: Final = f"text-align:left;{_CELL}"
_RIGHT: Final = f"text-align:right;white-space:nowrap;{_CELL}"


_MINUS: Final = re.compile(r"(?<![\w.])-(?=\d)")


def ranking_html(ranking: Ranking, top: int = TOP) -> str:
    """A ranking as HTML without script.

    Parameters
    ----------
    ranking : Ranking
    top : int
        Rows.

    Returns
    -------
    str
        Everything in it is escaped.
    """
    places = list(range(min(top, len(ranking))))
    places += sorted({p for p in (ranking.winner, ranking.baseline) if p is not None and p >= len(places)})
    title = f"{len(ranking):,} design{'' if len(ranking) == 1 else 's'} by mean S, {ranking.case.label}"
    said = "<br>".join(html.escape(_MINUS.sub("\u2212", sentence)) for sentence in ranking_sentences(ranking))
    warnings = "".join(f"<br><b>Warning:</b> {html.escape(text)}" for text in ranking.warnings)
    level = f"{100 * ranking.confidence:g} % interval"
    headings = "".join(
        f'<th scope="col" style="{style}">{html.escape(text)}</th>'
        for text, style in (
            ("rank", _RIGHT),
            ("design", _LEFT),
            ("mean S [m s]", _RIGHT),
            (level, _LEFT),
            ("to the best [m s]", _RIGHT),
            ("reduction", _RIGHT),
            ("failed", _RIGHT),
            ("", _LEFT),
        )
    )
    most = _right_end(ranking, places)
    rows = "".join(_row(ranking, place, most) for place in places)
    more = len(ranking) - len(places)
    foot = f"<div>and {more:,} more</div>" if more > 0 else ""
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b><br>{said}{warnings}</div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><thead><tr>{headings}</tr></thead>'
        f"<tbody>{rows}</tbody></table>{foot}</div>"
    )


def _right_end(ranking: Ranking, places: list[int]) -> float:
    ends = np.concatenate([ranking.S[places], ranking.S_high[places]])
    ends = ends[np.isfinite(ends)]
    return max(float(ends.max()), 1e-12) if ends.size else 1.0


def _row(ranking: Ranking, i: int, most: float) -> str:
    away = "–" if i == 0 else f"{ranking.difference[i]:+.4f}".replace("-", "\u2212")  # noqa: RUF001
    weight = ";font-weight:bold" if i == ranking.winner else ""
    cells = (
        (_RIGHT, str(ranking.rank[i]) if ranking.rank[i] else "–"),  # noqa: RUF001
        (_LEFT + weight, html.escape(ranking.designs[i].label)),
        (_RIGHT + weight, f"{ranking.S[i]:.4f}"),
        (
            f"{_LEFT};white-space:nowrap",
            _bar(float(ranking.S[i]), float(ranking.S_low[i]), float(ranking.S_high[i]), most),
        ),
        (_RIGHT, away),
        (_RIGHT, _percent(float(ranking.reduction[i]))),
        (_RIGHT, str(failures(ranking, i) or "–")),  # noqa: RUF001
        (_LEFT, html.escape(", ".join(marks(ranking, i)))),
    )
    return "<tr>" + "".join(f'<td style="{style}">{cell}</td>' for style, cell in cells) + "</tr>"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %".replace("-", "\u2212") if np.isfinite(share) else "–"  # noqa: RUF001


def _bar(value: float, low: float, high: float, most: float) -> str:
    """The interval as a line and the mean as a point, to the scale of all rows; the numbers are its title."""
    if not np.isfinite(low + high):
        return "–"  # noqa: RUF001
    left, right, at = (round(_BAR * min(max(one / most, 0.0), 1.0), 1) for one in (low, high, value))
    text = f"{low:.4f} to {high:.4f}".replace("-", "\u2212")
    width = max(round(right - left, 1), 1.0)
    line = f"position:absolute;top:6px;height:2px;left:{left:g}px;width:{width:g}px;background:currentColor"
    point = f"position:absolute;top:3px;width:3px;height:8px;left:{at - 1.5:g}px;background:#0072B2"
    return (
        f'<span title="{text}" style="display:inline-block;position:relative;width:{_BAR}px;height:14px;'
        f'border-bottom:1px solid rgba(128,128,128,.35)"><span style="{line}"></span>'
        f'<span style="{point}"></span></span> {text}'
    )
