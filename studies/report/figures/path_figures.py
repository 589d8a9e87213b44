"""Figures of example departures: the recorded path, the paths under control, and the steering angle."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.report.look.style import PANEL, RECORDED, LineStyle, figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class ControlledPath:
    """One design on one departure.

    Attributes
    ----------
    label : str
    style : LineStyle
    t : (k,) [s]
        From the trigger to the end of the settling horizon; empty where the design never took over.
    y : (k,) [m]
        Edge beyond the line, outward.
    delta : (k,) [rad]
        Steering angle of the wheel from that time on.
    """

    label: str
    style: LineStyle
    t: FloatArray
    y: FloatArray
    delta: FloatArray


@dataclasses.dataclass(frozen=True)
class Example:
    """One departure with and without control.

    Attributes
    ----------
    row : int
        Which scenario of the study.
    side : str
        ``"Left"`` or ``"Right"``.
    role : str
        Why it is shown: least, median or greatest reduction.
    facts : str
        Its parameters in words.
    reduction : float
        Of the winner on this departure.
    t, y : (k,) [s], [m]
        The recorded path.
    far_line : float [m]
        y at which the vehicle's other edge is on the lane's other line.
    paths : tuple of ControlledPath
        The winner first.
    """

    row: int
    side: str
    role: str
    facts: str
    reduction: float
    t: FloatArray
    y: FloatArray
    far_line: float
    paths: tuple[ControlledPath, ...]


def path_limits(examples: Sequence[Example]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Common ranges of y [m] and of the steering angle [deg] for a set of examples."""
    recorded = np.concatenate([e.y for e in examples])
    y = np.concatenate([recorded, *(p.y for e in examples for p in e.paths)])
    y = np.clip(y, -2.4, max(2.0 * float(recorded.max()), 0.5))  # a path that diverges may leave the panel
    delta = np.degrees(np.concatenate([[0.0], *(p.delta for e in examples for p in e.paths)]))
    return _padded(y), _padded(delta)


def _padded(values: FloatArray) -> tuple[float, float]:
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
    margin = 0.07 * max(high - low, 0.05)
    return low - margin, high + margin


def path_figure(example: Example, limits: tuple[tuple[float, float], tuple[float, float]] | None = None) -> Figure:
    """Lateral position above, steering angle below, against time.

    Parameters
    ----------
    example : Example
    limits : pair of pairs, optional
        Ranges of y [m] and steering angle [deg]; by default those of this example.

    Returns
    -------
    Figure
        The lane line is y = 0; the trigger is a marker of the law's shape; a thin upright line is the departure's end
        where paths go on beyond it. The winner is drawn on top.
    """
    from matplotlib.figure import Figure

    (y_low, y_high), (d_low, d_high) = limits or path_limits([example])
    with figure_settings():
        figure = Figure(figsize=(PANEL[0], 3.9), layout="constrained")
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        above.axhspan(max(y_low, example.far_line), 0.0, color="#f1f4f7", linewidth=0, zorder=0)
        above.axhline(0.0, color="#222222", linewidth=2.2, dashes=(7, 4), zorder=1.5)
        above.plot(example.t, example.y, zorder=2, **RECORDED.line())
        below.axhline(0.0, color="#9a9a9a", linewidth=0.8, zorder=1)
        for depth, path in enumerate(example.paths):
            if not path.t.size:
                continue
            order = 6 - 0.1 * depth
            width = 2.2 if depth == 0 else 1.5
            above.plot(path.t, path.y, zorder=order, **(path.style.line() | {"linewidth": width}))
            above.plot(
                path.t[0],
                path.y[0],
                marker=path.style.marker,
                markersize=6.5,
                markerfacecolor="#ffffff",
                markeredgecolor=path.style.color,
                markeredgewidth=1.6,
                zorder=order + 1,
                clip_on=False,
            )
            stairs = path.style.line() | {"linewidth": 0.8 * width}
            below.step(path.t, np.degrees(path.delta), where="post", zorder=order, **stairs)
        above.set_ylim(y_low, y_high)
        below.set_ylim(d_low, d_high)
        T = float(example.t[-1])
        end = max([T, *(float(path.t[-1]) for path in example.paths if path.t.size)])
        above.set_xlim(-0.02 * end, end)
        if end > T:  # the loop goes on after the departure, S does not
            for axes in (above, below):
                axes.axvline(T, color="#767676", linewidth=0.9, zorder=1.2)
        if y_low < example.far_line:
            above.axhline(example.far_line, color="#222222", linewidth=1.1, dashes=(7, 4), zorder=1.5)
        if y_low < -0.12 * (y_high - y_low):
            lowest = max(y_low, example.far_line)
            above.annotate("inside the lane", (0.015, lowest), xycoords=("axes fraction", "data"), xytext=(0, 3),
                           textcoords="offset points", fontsize=8, color="#5f6b76", zorder=1)  # fmt: skip
        above.set_ylabel("Edge beyond line y [m]")
        below.set_ylabel("Steering δ [°]")
        below.set_xlabel("Time since the crossing t [s]")
        above.set_title(f"{example.side}, {example.role}")
        figure.align_ylabels([above, below])
        return figure
