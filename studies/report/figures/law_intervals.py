"""Mean S with intervals: each law's best design against no control, and finalists on both sets of scenarios."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from studies.report.figures.scores import new_panel, wrap
from studies.report.look.style import RECORDED, LineStyle, figure_settings
from studies.report.tables.row import Interval
from studies.report.words.text import change, number

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Line:
    """One design.

    Attributes
    ----------
    label : str
    style : LineStyle
    S : Interval [m s]
        Mean and its interval.
    fresh : Interval or None [m s]
        The same on fresh departures.
    reduction : float
        Against no control.
    winner : bool
    """

    label: str
    style: LineStyle
    S: Interval
    fresh: Interval | None
    reduction: float
    winner: bool


def law_intervals_figure(lines: Sequence[Line], uncorrected: float) -> Figure:
    """Means with intervals, one design a line.

    Parameters
    ----------
    lines : sequence of Line
        From top to bottom.
    uncorrected : float [m s]
        Mean S without control.

    Returns
    -------
    Figure
        Filled marker and bar: the departures that all designs share; open marker: fresh ones; dashed line: no control.
    """
    with figure_settings():
        figure, axes = new_panel(7.2, 1.15 + 0.42 * max(len(lines), 2))
        ends = [uncorrected, *(one.S.high for one in lines), *(one.fresh.high for one in lines if one.fresh)]
        limit = max(*(end for end in ends if end < 3.0 * max(uncorrected, 1e-9)), uncorrected, 1e-3)
        for i, one in enumerate(lines):
            color, marker = one.style.color, one.style.marker
            axes.hlines(i, one.S.low, one.S.high, color=color, linewidth=2.2)
            axes.plot(one.S.value, i, marker=marker, color=color, markersize=8 if one.winner else 6)
            if one.fresh is not None:
                axes.hlines(i + 0.24, one.fresh.low, one.fresh.high, color=color, linewidth=1.2)
                axes.plot(
                    one.fresh.value, i + 0.24, marker=marker, color=color, markerfacecolor="#ffffff", markersize=5
                )
            said = f"{number(one.S.value)} ({change(one.reduction)})"
            axes.text(1.03 * limit, i, said, va="center", fontsize=8.5, fontweight="bold" if one.winner else "normal")
        axes.axvline(uncorrected, color=RECORDED.color, linestyle=(0, (5, 3)), linewidth=1.2)
        axes.annotate(
            f"no control {number(uncorrected)}", (uncorrected, 1.0), (0, 4), xycoords=("data", "axes fraction"),
            textcoords="offset points", ha="right" if uncorrected > 0.6 * limit else "left", fontsize=8.5,
            color="#444444",
        )  # fmt: skip
        axes.set_yticks(range(len(lines)), [wrap(one.label, 30) for one in lines])
        for tick, one in zip(axes.get_yticklabels(), lines, strict=True):
            tick.set_fontweight("bold" if one.winner else "normal")
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.set_ylim(len(lines) - 0.4, -0.6)
        axes.set_xlim(0.0, 1.02 * limit)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("Mean S [m·s]")
        return figure


_SEARCH, _FRESH = "#767676", "#0072B2"


@dataclasses.dataclass(frozen=True)
class Finalist:
    """Mean S of a finalist [m s] on both sets of scenarios."""

    label: str
    search: Interval
    fresh: Interval


def finalists_figure(finalists: Sequence[Finalist], title: str) -> Figure:
    """Both scores of each finalist, one above the other, with their intervals.

    Parameters
    ----------
    finalists : sequence of Finalist
        From top to bottom.
    title : str

    Returns
    -------
    Figure
        Open squares: where designs were chosen. Full circles: fresh scenarios.
    """
    with figure_settings():
        figure, axes = new_panel(height=1.45 + 0.42 * max(len(finalists), 2))
        for i, one in enumerate(finalists):
            axes.plot([one.search.value, one.fresh.value], [i - 0.16, i + 0.16], color="#b5b5b5", linewidth=1.0)
        for shift, color, marker, face, label, some in (
            (-0.16, _SEARCH, "s", "#ffffff", "where designs were chosen", [one.search for one in finalists]),
            (0.16, _FRESH, "o", _FRESH, "fresh departures", [one.fresh for one in finalists]),
        ):
            places = [i + shift for i in range(len(finalists))]
            axes.hlines(places, [one.low for one in some], [one.high for one in some], color=color, linewidth=1.4)
            axes.plot([one.value for one in some], places, linestyle="none", marker=marker, markersize=6, label=label,
                      markerfacecolor=face, markeredgecolor=color)  # fmt: skip
        axes.set_yticks(range(len(finalists)), [wrap(one.label, 24) for one in finalists])
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.set_ylim(len(finalists) - 0.45, -0.55)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("Mean S [m·s], with intervals")
        axes.set_title(title)
        figure.legend(loc="outside lower center", ncols=2)
        return figure
