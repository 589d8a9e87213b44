"""Figures of two parameters: T against d_y, and all pairs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics import PairDensity, SideDiagnostics
from studies.fit_page.figures import draw_marginal
from studies.fit_page.style import MODEL, axis_label, color_map
from studies.report.figures.scores import new_panel
from studies.report.look.style import figure_settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVELS: Final = (0.9, 0.5)
"""Contours hold these shares of the model."""


def density_levels(share: FloatArray, held: tuple[float, ...] = LEVELS) -> list[float]:
    """Cell shares above which the densest cells together hold each of the given shares, ascending.

    Examples
    --------
    >>> density_levels(np.array([[0.5, 0.3], [0.15, 0.05]]), (0.9, 0.5))
    [0.15, 0.5]
    """
    ordered = np.sort(share.ravel())[::-1]
    reached = np.cumsum(ordered)
    found = [float(ordered[min(int(np.searchsorted(reached, part - 1e-12)), ordered.size - 1)]) for part in held]
    return sorted({level for level in found if level > 0.0})


def smooth(share: FloatArray) -> FloatArray:
    """A light blur for contours only: the sample's noise would fray them."""
    padded = np.pad(share, 1, mode="edge")
    rows = 0.25 * padded[:-2] + 0.5 * padded[1:-1] + 0.25 * padded[2:]
    out: FloatArray = 0.25 * rows[:, :-2] + 0.5 * rows[:, 1:-1] + 0.25 * rows[:, 2:]
    return out


def draw_density(
    axes: Axes, pair: PairDensity, share: FloatArray, side: str, *, highest: float, contours: bool, turned: bool = False
) -> Any:
    """Map of cell shares; `turned` puts the second parameter on the horizontal axis."""
    (x, y), cells = (pair.first_edges, pair.second_edges), share.T
    model = smooth(pair.model).T
    if turned:
        (x, y), cells, model = (y, x), cells.T, model.T
    image = axes.imshow(
        np.ma.masked_less_equal(np.sqrt(cells), 0.0),  # the root shows the rare cells too
        origin="lower",
        extent=(x[0], x[-1], y[0], y[-1]),
        aspect="auto",
        interpolation="none",
        cmap=color_map(side),
        vmin=0.0,
        vmax=np.sqrt(highest),
    )
    levels = density_levels(model)
    if contours and levels:
        centers = 0.5 * (x[1:] + x[:-1]), 0.5 * (y[1:] + y[:-1])
        axes.contour(*centers, model, levels=levels, colors=MODEL, linewidths=(0.9, 1.6)[-len(levels) :])
    axes.grid(visible=False)
    return image


def joint_figure(pair: PairDensity, side: str, *, of_model: bool) -> Figure:
    """T against d_y: events or model as a map, the model's contours on both, one colour scale."""
    with figure_settings():
        figure, axes = new_panel(3.9, 3.0)
        highest = float(max(pair.data.max(), pair.model.max()))
        share = pair.model if of_model else pair.data
        image = draw_density(axes, pair, share, side, highest=highest, contours=True)
        axes.set_xlabel(axis_label(pair.first))
        axes.set_ylabel(axis_label(pair.second))
        axes.set_title("Model" if of_model else "Events")
        bar = figure.colorbar(image, ax=axes, pad=0.02)
        ticks = [t for t in _round_shares(100.0 * highest) if t <= 100.0 * highest]
        bar.set_ticks(np.sqrt(np.array(ticks) / 100.0).tolist(), labels=[f"{t:g}" for t in ticks])
        bar.set_label("Share per cell [%]")
        bar.outline.set_linewidth(0.5)
        return figure


def _round_shares(highest: float) -> list[float]:
    step = 10.0 ** np.floor(np.log10(highest))
    for unit in (step, 0.5 * step, 0.2 * step, 0.1 * step):
        if highest / unit >= 3:
            return [0.0, *(float(f"{unit * i:.6g}") for i in range(1, int(highest / unit) + 1))]
    return [0.0, highest]


def pairs_figure(found: SideDiagnostics, side: str) -> Figure:
    """All pairs: events below the diagonal, the model above it, margins on it."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, NullLocator

    names = found.names
    d = len(names)
    by_name = {(pair.first, pair.second): pair for pair in found.pairs}
    with figure_settings():
        # margins are set by hand: to measure every label of 64 panels takes longer than the rest of the page
        size = 0.9 + 1.2 * max(d, 2)
        figure = Figure(figsize=(size, size))
        edges = {"left": 0.72 / size, "right": 1 - 0.12 / size, "bottom": 0.55 / size, "top": 1 - 0.08 / size}
        grid = figure.subplots(d, d, squeeze=False, gridspec_kw={"wspace": 0.12, "hspace": 0.12, **edges})
        for i in range(d):
            for j in range(d):
                axes = grid[i, j]
                if i == j:
                    draw_marginal(axes, found.marginals[i], side)
                    axes.set_yticks([])
                    axes.grid(visible=False)
                else:
                    pair = by_name[names[min(i, j)], names[max(i, j)]]
                    share = pair.data if i > j else pair.model
                    highest = float(max(pair.data.max(), pair.model.max()))
                    draw_density(axes, pair, share, side, highest=highest, contours=True, turned=i < j)
                axes.xaxis.set_major_locator(MaxNLocator(2, prune="both") if i == d - 1 else NullLocator())
                axes.yaxis.set_major_locator(MaxNLocator(3, prune="both") if j == 0 < i else NullLocator())
                axes.tick_params(labelsize=7.5)
                axes.set_xlabel(axis_label(names[j]) if i == d - 1 else "")
                axes.set_ylabel("")
                if j == 0:
                    axes.set_ylabel(axis_label(names[i]))
                    axes.yaxis.set_label_coords(-0.5 / (size / d), 0.5)
        return figure
