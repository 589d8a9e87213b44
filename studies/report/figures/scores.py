"""Figures of scores: bars by side, distributions, convergence. Plain functions of arrays that return a figure."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from studies.report.look.style import PANEL, LineStyle, figure_settings
from studies.report.words.text import change, compact, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Curve:
    """One design (or the recorded path) in a figure.

    Attributes
    ----------
    label : str
        Legend text.
    style : LineStyle
    S : (n,) [m s]
        Scores per scenario.
    reduction : float or None
        Of the mean, against no control; None for the recorded path.
    """

    label: str
    style: LineStyle
    S: FloatArray
    reduction: float | None = None


def new_panel(width: float = PANEL[0], height: float = PANEL[1]) -> tuple[Figure, Axes]:
    """An empty panel; call it inside `figure_settings`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def sides_figure(curves: Sequence[Curve], title: str, limit: float | None = None) -> Figure:
    """Mean and spread of S, one bar per design (the paper's bar figure, lying down so that names can be read).

    Parameters
    ----------
    curves : sequence of Curve
        From top to bottom.
    title : str
        Of the panel: the side.
    limit : float [m s], optional
        Right end of the axis, to give two panels one scale.

    Returns
    -------
    Figure
        Bar: mean. Line: 10 % to 90 % quantile. Number: mean and its reduction.
    """
    with figure_settings():
        figure, axes = new_panel(height=0.95 + 0.44 * max(len(curves), 2))
        limit = limit or sides_limit(curves)
        for i, curve in enumerate(curves):
            mean = float(np.mean(curve.S))
            low, high = np.quantile(curve.S, [0.1, 0.9])
            recorded = curve.reduction is None
            axes.barh(i, mean, height=0.62, color=curve.style.color, alpha=0.45 if recorded else 0.85, linewidth=0)
            axes.hlines(i, low, high, color="#222222", linewidth=1.2)
            axes.plot([low, high], [i, i], linestyle="none", marker="|", markersize=6, color="#222222")
            said = number(mean) if curve.reduction is None else f"{number(mean)} ({change(curve.reduction)})"
            axes.text(max(high, mean) + 0.02 * limit, i, said, va="center", fontsize=8.5)
        axes.set_yticks(range(len(curves)), [wrap(curve.label, 22) for curve in curves])
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.invert_yaxis()
        axes.set_xlim(0.0, limit)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("Score S [m·s]")
        axes.set_title(title)
        return figure


def sides_limit(curves: Sequence[Curve]) -> float:
    """Right end of the axis of `sides_figure` that leaves room for the numbers [m s]."""
    ends = [max(float(np.mean(c.S)), float(np.quantile(c.S, 0.9))) for c in curves if c.S.size]
    return 1.4 * max([*ends, 1e-3])


def distribution_figure(curves: Sequence[Curve], title: str) -> Figure:
    """Empirical distribution of S over the scenarios.

    Parameters
    ----------
    curves : sequence of Curve
    title : str
        Of the panel.

    Returns
    -------
    Figure
        The axis ends where 99.5 % of the recorded (first) curve's scores are reached.
    """
    with figure_settings():
        figure, axes = new_panel(height=PANEL[1] + 0.2 * (len(curves) // 2))
        limit = max(float(np.quantile(curves[0].S, 0.995)), 1e-3)
        for curve in curves:
            share = np.linspace(0.0, 1.0, min(curve.S.size, 200) + 1)
            axes.plot(np.quantile(curve.S, share), share, label=wrap(curve.label, 34), **curve.style.line())
        axes.set_xlim(0.0, limit)
        axes.set_ylim(0.0, 1.0)
        axes.set_xlabel("Score S [m·s]")
        axes.set_ylabel("Share of departures with less")
        axes.set_title(title)
        figure.legend(loc="outside lower center", ncols=1 if len(curves) < 3 else 2)
        return figure


def interleaved(side: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """An order of the scenarios in which every stretch holds left and right ones in their overall proportion.

    Examples
    --------
    >>> interleaved(np.array([1, 1, -1, -1]))
    array([0, 2, 1, 3])
    """
    place = np.empty(side.size)
    for value in np.unique(side):
        rows = np.flatnonzero(side == value)
        place[rows] = (np.arange(rows.size) + 0.5) / rows.size
    return np.lexsort((np.arange(side.size), place))


def running_mean(values: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray, FloatArray]:
    """Mean of the first k values and 1.96 standard errors of it, at up to 160 counts k from 2 to n.

    Examples
    --------
    >>> running_mean(np.array([1.0, 3.0]))
    (array([2]), array([2.]), array([1.96]))
    """
    n = values.size
    if n < 2:
        return np.arange(1, n + 1), values.copy(), np.full(n, np.nan)
    counts = np.unique(np.round(np.geomspace(2, n, 160)).astype(np.int64))
    shifted = values - values.mean()  # else the difference of two large sums would lose the small variance
    total, squares = np.cumsum(shifted)[counts - 1], np.cumsum(shifted**2)[counts - 1]
    variance = np.maximum(squares - total**2 / counts, 0.0) / (counts - 1)
    return counts, total / counts + values.mean(), 1.96 * np.sqrt(variance / counts)


def convergence_figure(curves: Sequence[Curve], order: npt.NDArray[np.int64], title: str, ylabel: str) -> Figure:
    """Running mean over the first scenarios with a 95 % band.

    Parameters
    ----------
    curves : sequence of Curve
        `S` is what is averaged: scores, or paired differences.
    order : (n,) int
        Order in which scenarios are counted, see `interleaved`.
    title, ylabel : str

    Returns
    -------
    Figure
    """
    with figure_settings():
        figure, axes = new_panel()
        bounds: list[float] = []
        for curve in curves:
            count, mean, error = running_mean(curve.S[order])
            axes.fill_between(count, mean - error, mean + error, color=curve.style.color, alpha=0.16, linewidth=0)
            axes.plot(count, mean, label=wrap(curve.label, 34), **curve.style.line())
            settled = count >= min(20, order.size)
            bounds += [*(mean - np.nan_to_num(error))[settled], *(mean + np.nan_to_num(error))[settled]]
        if bounds and max(bounds) > min(bounds):  # the first few scenarios would set the scale otherwise
            margin = 0.06 * (max(bounds) - min(bounds))
            axes.set_ylim(min(bounds) - margin, max(bounds) + margin)
        plain_log(axes, order.size)
        axes.set_xlabel("Number of scenarios")
        axes.set_ylabel(ylabel)
        axes.set_title(title)
        figure.legend(loc="outside lower center", ncols=1 if len(curves) < 3 else 2)
        return figure


def plain_log(axes: Axes, n: int) -> None:
    """A logarithmic axis of counts with the numbers written out."""
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.set_xscale("log")
    axes.set_xlim(2, max(n, 3))
    ticks = [t for t in (2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000) if t <= n]
    ticks += [10**k for k in range(4, 9) if 10**k <= n]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")


def plain_decades(axis: Axis) -> None:
    """A logarithmic axis whose numbers are written out where there is room: 1, 2, 5, 10 or whole decades."""
    from matplotlib.ticker import LogLocator, NullLocator

    low, high = axis.get_data_interval()
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high < 200 * low else (1.0,)))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(lambda value, _: compact(float(f"{value:.6g}")))


def wrap(label: str, width: int) -> str:
    """A label on at most two lines."""
    return "\n".join(textwrap.wrap(label, width, max_lines=2, placeholder="…"))
