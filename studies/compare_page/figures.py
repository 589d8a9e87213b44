"""Figures of a comparison: intervals of the most changed designs, and old against new scores."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ldctoolkit import controller_class
from studies.comparison.comparison import CaseComparison
from studies.comparison.paired_verdicts import Verdict
from studies.report.look.style import LineStyle, figure_settings, law_styles
from studies.report.words.text import shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CHANGED = 30
"""Designs in the figure of intervals."""

_COLORS = {Verdict.BETTER: "#0072B2", Verdict.WORSE: "#D55E00", Verdict.UNTOLD: "#595959", Verdict.SAME: "#595959"}
_MARKERS = {Verdict.BETTER: "v", Verdict.WORSE: "^", Verdict.UNTOLD: "o", Verdict.SAME: "_"}
_SAID = {
    Verdict.BETTER: "better",
    Verdict.WORSE: "worse",
    Verdict.UNTOLD: "cannot be told",
    Verdict.SAME: "the same",
}


def most_changed(case: CaseComparison) -> tuple[int, ...]:
    """Positions of at most `MOST_CHANGED` designs whose S changed, the largest change of the mean first."""
    changed = [i for i in range(len(case)) if case.S.changed[i]]
    return tuple(sorted(changed, key=lambda i: -abs(float(case.S.difference[i])))[:MOST_CHANGED])


def forest_figure(case: CaseComparison) -> Figure | None:
    """Paired differences of mean S with their intervals, the most changed designs.

    Parameters
    ----------
    case : CaseComparison

    Returns
    -------
    Figure or None
        None where nothing changed. A design without an interval has a point only.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    chosen = most_changed(case)
    if not chosen:
        return None
    S = case.S
    with figure_settings():
        figure = Figure(figsize=(6.4, 1.25 + 0.22 * len(chosen)), layout="constrained")
        axes = figure.subplots()
        axes.axvline(0.0, color="#222222", linewidth=1.0, zorder=1)
        for row, i in enumerate(chosen):
            color, verdict = _COLORS[S.verdict[i]], S.verdict[i]
            if np.isfinite(S.low[i]) and np.isfinite(S.high[i]):
                axes.hlines(row, S.low[i], S.high[i], color=color, linewidth=1.6, zorder=2)
            axes.plot(S.difference[i], row, marker=_MARKERS[verdict], color=color, markersize=5, linestyle="none",
                      markerfacecolor="#ffffff" if verdict is Verdict.UNTOLD else color, zorder=3)  # fmt: skip
        labels = [shorten(case.designs[i].label, 46) for i in chosen]
        axes.set_yticks(range(len(chosen)), labels, fontsize=7)
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.set_ylim(len(chosen) - 0.4, -0.6)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("New minus old mean S [m·s]; left of 0 is better")
        shown = [verdict for verdict in Verdict if any(S.verdict[i] is verdict for i in chosen)]
        handles = [
            Line2D([], [], color=_COLORS[v], marker=_MARKERS[v], markersize=5, label=_SAID[v],
                   markerfacecolor="#ffffff" if v is Verdict.UNTOLD else _COLORS[v])
            for v in shown
        ]  # fmt: skip
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
        return figure


def scatter_figure(case: CaseComparison) -> Figure | None:
    """Mean S in the old study against that in the new one, with the line of equality.

    Parameters
    ----------
    case : CaseComparison

    Returns
    -------
    Figure or None
        None where no design is in both. Points below the line are better now.
    """
    from matplotlib.figure import Figure

    if not len(case):
        return None
    S, laws = case.S, [design.law for design in case.designs]
    best_first = np.argsort(S.S_new, kind="stable").tolist()
    styles: dict[str, LineStyle] = law_styles(laws[i] for i in best_first)
    values = np.concatenate([S.S_old, S.S_new])
    values = values[np.isfinite(values)]
    low, high = float(values.min()), float(values.max())
    margin = 0.06 * max(high - low, 0.02 * abs(high), 1e-3)
    with figure_settings():
        figure = Figure(figsize=(6.4, 6.4), layout="constrained")
        axes = figure.subplots()
        axes.axline((low, low), slope=1.0, color="#222222", linewidth=1.0, dashes=(6, 3), zorder=1)
        for law, style in styles.items():
            rows = [i for i, one in enumerate(laws) if one == law]
            marker = "*" if style.marker == "|" else style.marker  # a stroke is too thin for a point
            look: dict[str, Any] = {"marker": marker, "markersize": 7.5, "markeredgecolor": "#ffffff"}
            axes.plot(
                S.S_old[rows],
                S.S_new[rows],
                ls="none",
                color=style.color,
                label=shorten(controller_class(law).title, 28),
                **look,
            )
        axes.set_xlim(low - margin, high + margin)
        axes.set_ylim(low - margin, high + margin)
        axes.set_aspect("equal")
        axes.annotate("worse now", (0.03, 0.97), xycoords="axes fraction", va="top", fontsize=8.5, color="#555555")
        axes.annotate("better now", (0.97, 0.03), xycoords="axes fraction", ha="right", fontsize=8.5, color="#555555")
        axes.set_xlabel("Old mean S [m·s]")
        axes.set_ylabel("New mean S [m·s]")
        figure.legend(loc="outside lower center", ncols=2 if len(styles) > 1 else 1)
        return figure
