"""Figures of generated departures beside those that they stand for: margins, and pairs of parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.fit_page.figures import density_levels, smooth
from studies.fit_page.style import COLORS, MODEL, TITLES, axis_label
from studies.report.look.style import figure_settings
from studies.report.model_match.parts import Pair, SideMatch

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path

MODEL_DASH: Final = (4.0, 2.0)

_TICKS: Final = 9
_LABELS: Final = 10.5
"""Sizes of the text beside pairs [pt]: the grid of seven by seven is wide, and its panels are small."""

_CHARACTER: Final = 0.6
"""Width of a digit, of the text's size."""

_SPILL: Final = 2.0
"""How far a tick's label may reach beside its panel [pt]: a third of the way to the next one."""

_SHADES: Final = (0.22, 0.5, 0.95)
"""Of the generated departures' colour: all cells, those that hold the densest 90 %, and 50 %."""


def margins_figure(side: SideMatch) -> Figure:
    """Each parameter: generated departures as bars, source departures as a line, the model as a dashed one."""
    from matplotlib.figure import Figure

    rows = -(-len(side.margins) // 2)
    with figure_settings():
        figure = Figure(figsize=(5.2, 0.35 + 1.55 * rows), layout="constrained")
        grid = figure.subplots(rows, 2, squeeze=False).ravel()
        for axes, margin in zip(grid, side.margins, strict=False):
            axes.stairs(100.0 * margin.generated, margin.edges, fill=True, color=COLORS[side.key], alpha=0.45)
            if margin.source is not None:
                axes.stairs(100.0 * margin.source, margin.edges, color=MODEL, linewidth=1.4)
            if margin.model is not None:
                middle = 0.5 * (margin.edges[1:] + margin.edges[:-1])
                axes.plot(middle, 100.0 * margin.model, color=MODEL, linewidth=1.2, linestyle=(0, MODEL_DASH))
            axes.set_xlim(margin.edges[0], margin.edges[-1])
            axes.set_ylim(bottom=0.0)
            axes.set_xlabel(axis_label(margin.name))
            axes.locator_params(axis="x", nbins=4)
            axes.locator_params(axis="y", nbins=3)
        for axes in grid[len(side.margins) :]:
            axes.set_axis_off()
        figure.suptitle(f"{TITLES[side.key]}: share per bin [%]", x=0.02, ha="left", fontweight="bold", fontsize=9.5)
        return figure


def pairs_figure(side: SideMatch) -> Figure:
    """All pairs: generated departures as shaded cells, contours of the reference."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, NullLocator

    names = side.names
    d = len(names) - 1
    by_name = {(pair.first, pair.second): pair for pair in side.pairs}
    with figure_settings():
        # margins are set by hand: to measure the labels of all panels takes longer than to draw them
        size = 0.85 + 1.15 * max(d, 2)
        figure = Figure(figsize=(size, size))
        edges = {"left": 0.8 / size, "right": 1 - 0.28 / size, "bottom": 0.55 / size, "top": 1 - 0.08 / size}
        grid = figure.subplots(d, d, squeeze=False, gridspec_kw={"wspace": 0.1, "hspace": 0.1, **edges})
        for i in range(d):
            for j in range(d):
                axes = grid[i, j]
                if j > i:
                    axes.set_axis_off()
                    continue
                points = 72.0 * size * axes.get_position().width
                _draw_pair(axes, by_name[names[j], names[i + 1]], side.key, points)
                axes.xaxis.set_major_locator(NullLocator())
                if i == d - 1:
                    axes.set_xticks(_roomy(MaxNLocator(2, prune="both").tick_values(*axes.get_xlim()), axes, points))
                axes.yaxis.set_major_locator(MaxNLocator(3, prune="both") if j == 0 else NullLocator())
                axes.tick_params(labelsize=_TICKS)
                if i == d - 1:
                    axes.set_xlabel(axis_label(names[j]), fontsize=_LABELS)
                if j == 0:
                    axes.set_ylabel(axis_label(names[i + 1]), fontsize=_LABELS)
                    axes.yaxis.set_label_coords(-0.62 / (size * axes.get_position().width), 0.5)
        return figure


def _roomy(ticks: Sequence[float], axes: Axes, points: float) -> list[float]:
    """Ticks whose labels stay below their own panel, so that those of the next panel have room."""
    low, high = axes.get_xlim()
    chosen: list[float] = []
    free = -_SPILL
    half = 0.5 * _CHARACTER * _TICKS * max((len(f"{tick:g}") for tick in ticks), default=0)  # all have the same digits
    for tick in ticks:
        place = (tick - low) / (high - low) * points
        if place - half >= free and place + half <= points + _SPILL:
            chosen.append(float(tick))
            free = place + half + _SPILL
    return chosen


def _draw_pair(axes: Axes, pair: Pair, side: str, points: float) -> None:
    """Cells as a few shapes and not one by one: a report holds many of them. The panel is so many points wide."""
    from matplotlib.patches import PathPatch

    x, y = pair.first_edges, pair.second_edges
    levels = [1e-12, *density_levels(pair.generated)][-3:]
    for level, shade in zip(levels, _SHADES[-len(levels) :], strict=True):
        # a hair wider than a cell, so that no light gaps show between neighbours
        path, width = _runs_above(pair.generated, x, y, level), 1.05 * points / (x.size - 1)
        axes.add_patch(PathPatch(path, facecolor="none", edgecolor=_tint(side, shade), linewidth=width))
    if pair.reference is not None and min(pair.reference.shape) > 1 and pair.reference.max() > 0.0:
        model = smooth(pair.reference).T
        centers = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
        held = [level for level in density_levels(model) if level < model.max()]
        if held:
            axes.contour(*centers, model, levels=held, colors=MODEL, linewidths=(0.8, 1.5)[-len(held) :])
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    axes.grid(visible=False)
    axes.patch.set_visible(False)


def _tint(side: str, shade: float) -> tuple[float, float, float]:
    """A side's colour on white."""
    from matplotlib.colors import to_rgb

    red, green, blue = (1.0 - shade * (1.0 - part) for part in to_rgb(COLORS[side]))
    return red, green, blue


def _runs_above(share: FloatArray, x: FloatArray, y: FloatArray, level: float) -> Path:
    """Cells of at least a share: neighbours of a column are one stroke, as wide as a cell."""
    from matplotlib.path import Path

    ends: list[tuple[float, float]] = []
    for i, column in enumerate(share >= level):
        changes = np.flatnonzero(np.diff(np.concatenate([[False], column, [False]]).astype(int)))
        ends += [(0.5 * (x[i] + x[i + 1]), y[change]) for change in changes]
    codes = np.tile(np.array([Path.MOVETO, Path.LINETO], dtype=np.uint8), len(ends) // 2)
    return Path(np.array(ends).reshape(-1, 2), codes)
