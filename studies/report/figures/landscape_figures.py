"""Figures of S over trigger threshold and gains."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.gains import GainValue
from studies.report.figures.scores import new_panel, plain_decades
from studies.report.look.style import LineStyle, figure_settings
from studies.report.words.text import compact, number, shorten, unit_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_ANNOTATED_CELLS = 48
_MARKED_POINTS = 40
_WORSE = "#d4d4d4"


@dataclasses.dataclass(frozen=True)
class Axis:
    """A swept quantity.

    Attributes
    ----------
    name, unit : str
    values : tuple
        In rising order; words in the order of the study.
    log : bool
        Whether the law declares the quantity's logarithm as what is even.
    """

    name: str
    unit: str
    values: tuple[GainValue, ...]
    log: bool = False

    @property
    def label(self) -> str:
        """``K_y [rad/m]``."""
        unit = unit_text(self.unit)
        return f"{self.name} [{unit}]" if unit else self.name

    @property
    def numeric(self) -> bool:
        """Whether the values are numbers (then a profile may be drawn to scale)."""
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)

    @property
    def wide(self) -> bool:
        """Whether it is to be drawn on a logarithmic scale: so declared, and over a decade or more."""
        return self.log and self.numeric and 0 < 10 * float(self.values[0]) <= float(self.values[-1])

    def positions(self, values: Sequence[GainValue]) -> FloatArray:
        """Where values are drawn: numbers at themselves, words at 0, 1, ..."""
        if self.numeric:
            return np.array([float(value) for value in values])
        return np.array([float(self.values.index(value)) for value in values])


@dataclasses.dataclass(frozen=True)
class Landscape:
    """Mean S of one law over one or two swept quantities, at the best of all the others.

    Attributes
    ----------
    law, title : str
        Registry name and name for people.
    x : Axis
    y : Axis or None
        None: only one quantity is swept.
    S : (ny, nx) [m s]
        NaN where the study has no such design.
    best : (row, column)
        The law's best design.
    winner : bool
        Whether that is the best of the whole study.
    """

    law: str
    title: str
    x: Axis
    y: Axis | None
    S: FloatArray
    best: tuple[int, int]
    winner: bool


def heat_map(landscape: Landscape, low: float, high: float, uncorrected: float) -> Figure:
    """S over two swept quantities.

    Parameters
    ----------
    landscape : Landscape
        With a y axis.
    low, high : float [m s]
        Ends of the colour scale, common to all laws.
    uncorrected : float [m s]
        Mean S without control; cells above it are grey and hatched, whatever the scale.

    Returns
    -------
    Figure
        The law's best cell is framed; it carries a star if it is the study's winner.
    """
    import matplotlib
    from matplotlib.colors import Normalize
    from matplotlib.patches import Rectangle

    if landscape.y is None:
        raise ValueError("heat_map needs two axes")
    x, y, S = landscape.x, landscape.y, landscape.S
    with figure_settings():
        figure, axes = new_panel(height=1.55 + 0.33 * max(4, min(len(y.values), 9)))
        # fewer than 50 colours: the colour bar is then drawn as shapes and not as an embedded image
        color_map = matplotlib.colormaps["viridis"].resampled(48).with_extremes(bad="#ffffff")
        scale = Normalize(low, high if high > low else low + 1e-9)
        worse = uncorrected * (1.0 + 1e-9) < S
        mesh = axes.pcolormesh(
            np.arange(len(x.values) + 1) - 0.5,
            np.arange(len(y.values) + 1) - 0.5,
            np.ma.masked_where(~np.isfinite(S) | worse, S),
            cmap=color_map,
            norm=scale,
            edgecolors="#ffffff",
            linewidth=0.6,
        )
        for row, column in np.argwhere(worse):
            box = Rectangle((column - 0.5, row - 0.5), 1, 1, facecolor=_WORSE, edgecolor="#ffffff", linewidth=0.6)
            axes.add_patch(box)
            axes.plot([column - 0.5, column + 0.5], [row - 0.5, row + 0.5], color="#ffffff", linewidth=1.0)
        if S.size <= _ANNOTATED_CELLS:
            _annotate(axes, S, worse, scale, color_map, landscape)
        row, column = landscape.best
        for color, width in (("#000000", 3.6), ("#ffffff", 1.8)):
            axes.add_patch(
                Rectangle(
                    (column - 0.5, row - 0.5),
                    1,
                    1,
                    fill=False,
                    edgecolor=color,
                    linewidth=width,
                    zorder=3,
                    clip_on=False,
                )
            )
        if landscape.winner and S.size > _ANNOTATED_CELLS:
            axes.plot(column, row, marker="*", markersize=9, markerfacecolor="#ffffff", markeredgecolor="#000000",
                      markeredgewidth=0.7, linestyle="none", zorder=4)  # fmt: skip
        _ticks(axes, x, y)
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
        axes.set_title(shorten(landscape.title, 44))
        bar = figure.colorbar(mesh, ax=axes, pad=0.02, aspect=22)
        bar.set_label("Mean S [m·s]")
        bar.outline.set_visible(False)
        return figure


def _annotate(axes, S, worse, scale, color_map, landscape) -> None:  # type: ignore[no-untyped-def]
    size = 8.0 if S.shape[1] <= 6 else 6.8
    for (row, column), value in np.ndenumerate(S):
        if not np.isfinite(value):
            continue
        r, g, b, _ = color_map(scale(value))
        light = worse[row, column] or 0.299 * r + 0.587 * g + 0.114 * b > 0.5
        best = (row, column) == landscape.best
        star = "★\n" if best and landscape.winner else ""
        axes.text(column, row, star + number(value, 2 if value >= 10 else 3), ha="center", va="center", fontsize=size,
                  color="#111111" if light else "#ffffff", fontweight="bold" if best else "normal")  # fmt: skip


def _ticks(axes, x: Axis, y: Axis) -> None:  # type: ignore[no-untyped-def]
    for axis, which in ((x, "x"), (y, "y")):
        places = list(range(len(axis.values)))
        every = -(-len(places) // 12)  # at most twelve labels
        every_label = tick_labels(axis)
        labels = [every_label[i] for i in places[::every]]
        if which == "x":
            crowded = sum(len(label) for label in labels) > 34
            axes.set_xticks(places[::every], labels, rotation=45 if crowded else 0, ha="right" if crowded else "center")
            axes.set_xlabel(axis.label)
        else:
            axes.set_yticks(places[::every], labels)
            axes.set_ylabel(axis.label)


def tick_labels(axis: Axis) -> list[str]:
    """The values as short as they stay distinct.

    Examples
    --------
    >>> tick_labels(Axis("K_y", "rad/m", (-0.00422949, -0.002)))
    ['\N{MINUS SIGN}0.00423', '\N{MINUS SIGN}0.002']
    """
    rounded = [float(f"{v:.3g}") if isinstance(v, float) else v for v in axis.values]
    values = rounded if len(set(rounded)) == len(rounded) else axis.values
    return [shorten(compact(v), 14) for v in values]


def profile(landscape: Landscape, style: LineStyle, uncorrected: float) -> Figure:
    """S over the only swept quantity of a law, with the level of no control.

    Parameters
    ----------
    landscape : Landscape
        Without a y axis.
    style : LineStyle
    uncorrected : float [m s]

    Returns
    -------
    Figure
    """
    x, S = landscape.x, landscape.S[0]
    with figure_settings():
        figure, axes = new_panel()
        places = x.positions(x.values)
        axes.axhline(uncorrected, color="#595959", linewidth=1.2, linestyle=(0, (1.2, 1.4)))
        axes.annotate("no control", (1.0, uncorrected), xycoords=("axes fraction", "data"), xytext=(-2, -3),
                      textcoords="offset points", ha="right", va="top", color="#595959", fontsize=8.5)  # fmt: skip
        marker = style.marker if len(x.values) <= _MARKED_POINTS else None
        axes.plot(places, S, marker=marker, markersize=5, **style.line())
        best = landscape.best[1]
        axes.plot(places[best], S[best], marker="*" if landscape.winner else "o",
                  markersize=15 if landscape.winner else 10, markerfacecolor="#ffffff" if landscape.winner else "none",
                  markeredgecolor="#000000", linestyle="none")  # fmt: skip
        axes.annotate(number(float(S[best])), (places[best], S[best]), xytext=(0, 10), textcoords="offset points",
                      ha="center", fontsize=8.5, fontweight="bold")  # fmt: skip
        axes.margins(x=0.08, y=0.18)
        if x.wide:
            axes.set_xscale("log")
            plain_decades(axes.xaxis)
        elif not x.numeric or len(x.values) <= 8:
            axes.set_xticks(places, tick_labels(x))
        axes.set_xlabel(x.label)
        axes.set_ylabel("Mean S [m·s]")
        axes.set_title(shorten(landscape.title, 44))
        return figure
