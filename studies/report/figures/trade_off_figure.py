"""Scatter of two figures of all designs, with the front of the two: a plain function that returns a figure."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import Better
from studies.ranking.pareto import pareto_front
from studies.report.figures.scores import new_panel
from studies.report.look.style import LineStyle, figure_settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class Group:
    """The designs of one law.

    Attributes
    ----------
    label : str
    style : LineStyle
    x, y : (m,)
        In the units of the axes.
    """

    label: str
    style: LineStyle
    x: FloatArray
    y: FloatArray


def front_of_two(
    values: FloatArray, ranked: npt.NDArray[np.bool_], better_x: Better, better_y: Better
) -> npt.NDArray[np.int64]:
    """Places on the Pareto front of two figures, from the best of the first one on.

    Parameters
    ----------
    values : (2, d)
    ranked : (d,) bool
        Designs that meet the requirements; where there is none, all are looked at.
    better_x, better_y : {"less", "more"}

    Returns
    -------
    (m,) int
    """
    signs = np.array([[1.0 if better == "less" else -1.0] for better in (better_x, better_y)])
    allowed = np.isfinite(values).all(axis=0)
    if (allowed & ranked).any():
        allowed &= ranked
    costs = np.where(allowed, signs * values, np.nan).T
    front = np.flatnonzero(pareto_front(costs))
    return front[np.lexsort(costs[front].T[::-1])]


def trade_off_figure(
    groups: Sequence[Group],
    front: FloatArray,
    marked: Mapping[str, tuple[float, float]],
    labels: tuple[str, str],
) -> Figure:
    """Draw the designs, the front as a step line, and rings around those that are marked.

    Parameters
    ----------
    groups : sequence of Group
    front : (2, m)
        In its order.
    marked : mapping of str to (x, y)
        What is written beside the ring.
    labels : tuple of str
        Of the two axes.

    Returns
    -------
    Figure
    """
    with figure_settings():
        figure, axes = new_panel(6.4, 4.2)
        for group in groups:
            axes.plot(
                group.x,
                group.y,
                linestyle="none",
                marker=group.style.marker,
                markersize=4.5,
                markeredgewidth=1.2 if group.style.marker == "|" else 0.0,
                color=group.style.color,
                alpha=0.75,
                label=group.label,
            )
        if front.shape[1] > 1:
            axes.step(*front, where="post", color="#222222", linewidth=1.1, label="Pareto front of the two", zorder=1.5)
        for name, (x, y) in marked.items():
            axes.plot(
                [x], [y], linestyle="none", marker="o", markersize=10, markerfacecolor="none", color="#222222", zorder=4
            )
            axes.annotate(name, (x, y), xytext=(7, 7), textcoords="offset points", fontsize=8.5)
        axes.set_xlabel(labels[0])
        axes.set_ylabel(labels[1])
        axes.legend(loc="upper left", bbox_to_anchor=(0.0, -0.18), ncols=3)
        return figure
