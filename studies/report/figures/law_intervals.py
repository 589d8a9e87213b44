"""The picture of the answer: mean S of each law's best design with its interval, against no control."""

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
