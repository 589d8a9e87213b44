"""Designs of a sample or a search: one point each, coloured by mean S."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.report.figures.landscape_figures import Axis, tick_labels
from studies.report.figures.scores import new_panel, plain_decades
from studies.report.look.style import figure_settings
from studies.report.words.text import number, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 400
"""Points of one figure; of more designs the best half of it, and others at even steps of the rank."""

_WORSE = "#8a8a8a"


@dataclasses.dataclass(frozen=True)
class Sample:
    """Designs of one law over two quantities that nearly every design has its own value of.

    Attributes
    ----------
    law, title : str
        Registry name and name for people.
    x, y : Axis
    at : (m, 2)
        Where the designs stand.
    S : (m,) [m s]
        Their mean S.
    best : int
        Position of the law's best design.
    winner : bool
        Whether that is the best of the whole study.
    """

    law: str
    title: str
    x: Axis
    y: Axis
    at: FloatArray
    S: FloatArray
    best: int
    winner: bool


def shown_points(S: FloatArray, best: int) -> IntArray:
    """Which designs are drawn, the worst first, so that good ones lie on top of them.

    Examples
    --------
    >>> shown_points(np.array([2.0, 1.0, 3.0]), 1)
    array([2, 0, 1])
    """
    order = np.argsort(S, kind="stable")
    if order.size > MOST_POINTS:
        half = MOST_POINTS // 2
        rest = np.round(np.linspace(half, order.size - 1, half)).astype(np.int64)
        order = order[np.unique([*range(half), *rest])]
    if best not in order:
        order = np.array([best, *order], dtype=np.int64)
    return order[::-1].astype(np.int64)


def sample_figure(sample: Sample, low: float, high: float, uncorrected: float) -> Figure:
    """Mean S of designs over two quantities.

    Parameters
    ----------
    sample : Sample
    low, high : float [m s]
        Ends of the colour scale, common to all laws.
    uncorrected : float [m s]
        Mean S without control; designs above it are grey crosses.

    Returns
    -------
    Figure
        The law's best design has a ring, or a star if it is the study's winner.
    """
    import matplotlib
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shown = shown_points(sample.S, sample.best)
    with figure_settings():
        figure, axes = new_panel()
        color_map = matplotlib.colormaps["viridis"].resampled(48)
        scale = Normalize(low, high if high > low else low + 1e-9)
        worse = sample.S[shown] > uncorrected * (1.0 + 1e-9)
        crosses, dots = shown[worse], shown[~worse]
        if crosses.size:
            axes.plot(*sample.at[crosses].T, linestyle="none", marker="x", markersize=4, color=_WORSE, zorder=2)
        axes.scatter(
            sample.at[dots, 0],
            sample.at[dots, 1],
            c=sample.S[dots],
            cmap=color_map,
            norm=scale,
            s=22,
            linewidths=0,
            zorder=3,
        )
        x, y = sample.at[sample.best]
        axes.plot(x, y, linestyle="none", marker="*" if sample.winner else "o", markersize=14 if sample.winner else 10,
                  markerfacecolor="#ffffff" if sample.winner else "none", markeredgecolor="#000000",
                  markeredgewidth=1.2, zorder=4)  # fmt: skip
        axes.margins(0.07)
        for axis, drawn, name in ((sample.x, axes.xaxis, "x"), (sample.y, axes.yaxis, "y")):
            drawn.set_label_text(axis.label)
            if axis.wide:
                axes.set(**{f"{name}scale": "log"})
                plain_decades(drawn)
            elif not axis.numeric:
                drawn.set_ticks(range(len(axis.values)), tick_labels(axis))
                axes.set(**{f"{name}lim": (-0.6, len(axis.values) - 0.4)})
        axes.set_title(shorten(f"{sample.title} (best {number(float(sample.S[sample.best]))})", 44))
        bar = figure.colorbar(ScalarMappable(scale, color_map), ax=axes, pad=0.02, aspect=22)
        bar.set_label("Mean S [m·s]")
        bar.outline.set_visible(False)
        return figure
