"""Half width of intervals over the number of scenarios."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from studies.report.figures.scores import new_panel, plain_decades, plain_log, wrap
from studies.report.look.style import PANEL, LineStyle, figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_FURTHEST = 100
"""The axis goes to so many times the scenarios that there are, at most."""


@dataclasses.dataclass(frozen=True)
class WidthCurve:
    """Half width of one interval.

    Attributes
    ----------
    label : str
    style : LineStyle
    count : (k,) int
        Numbers of scenarios, the last one all.
    half : (k,) [m s]
        Half width there.
    difference : float or None [m s]
        Size of the difference that it is the interval of.
    needed : float
        Number of scenarios at which the half width equals the difference.
    """

    label: str
    style: LineStyle
    count: npt.NDArray[np.int64]
    half: FloatArray
    difference: float | None = None
    needed: float = np.inf


def precision_figure(curves: Sequence[WidthCurve], title: str) -> Figure:
    """Measured half widths as points, the law of the square root through the last one as a line.

    Parameters
    ----------
    curves : sequence of WidthCurve
        One at least, each with a positive half width.
    title : str

    Returns
    -------
    Figure
        A thin level line is the difference that an interval must not reach; a ring stands where it does not any more.
    """
    n = max(int(curve.count[-1]) for curve in curves)
    reached = [1.5 * curve.needed for curve in curves if curve.needed <= _FURTHEST * n]
    end = max(2.0 * n, *reached, 40.0) if reached else max(2.0 * n, 40.0)
    start = min(int(curve.count[0]) for curve in curves)
    with figure_settings():
        figure, axes = new_panel(height=PANEL[1] + 0.2 * len(curves))
        for curve in curves:
            ends = np.array([float(start), end])
            law = curve.half[-1] * np.sqrt(n / ends)
            axes.plot(ends, law, linewidth=1.2, color=curve.style.color, linestyle=curve.style.line()["linestyle"])
            axes.plot(curve.count, curve.half, linestyle="none", marker=curve.style.marker, markersize=5,
                      color=curve.style.color)  # fmt: skip
            axes.plot(
                [], [], marker=curve.style.marker, markersize=5, label=wrap(curve.label, 46), **curve.style.line()
            )
            if curve.difference:
                axes.plot(ends, [curve.difference] * 2, color=curve.style.color, linewidth=0.8, alpha=0.8)
            if start <= curve.needed <= end and curve.difference:
                axes.plot(curve.needed, curve.difference, marker="o", markersize=9, markerfacecolor="none",
                          markeredgecolor="#000000")  # fmt: skip
        axes.axvline(n, color="#767676", linewidth=0.8, linestyle=(0, (1.2, 1.4)))
        axes.annotate("this study", (n, 1.0), xycoords=("data", "axes fraction"), xytext=(-3, -2), rotation=90,
                      textcoords="offset points", ha="right", va="top", fontsize=8, color="#555555")  # fmt: skip
        axes.set_yscale("log")
        plain_log(axes, int(end))
        axes.set_xlim(0.9 * start, end)
        axes.margins(y=0.1)
        plain_decades(axes.yaxis)
        axes.set_xlabel("Number of scenarios")
        axes.set_ylabel("Half width [m·s]")
        axes.set_title(title)
        figure.legend(loc="outside lower left")
        return figure
