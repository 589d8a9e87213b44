"""Figures of one parameter or one side: margins, calibration, BIC, bounds. Plain functions that return a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics import Calibration, Marginal, PairDensity, SideDiagnostics, Strip
from ldctoolkit.scenario_model import SideSummary
from studies.fit_page.style import COLORS, DASHES, MODEL, TITLES, axis_label, color_map
from studies.report.figures.scores import new_panel
from studies.report.look.style import figure_settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# ruff: noqa: RUF001 - true minus signs in labels


_SMALL = (3.35, 2.2)


def draw_marginal(axes: Axes, marginal: Marginal, side: str) -> None:
    """Events as bars, the model as a line of steps [% per bin]."""
    axes.stairs(100.0 * marginal.data, marginal.edges, fill=True, color=COLORS[side], alpha=0.45, label="events")
    axes.stairs(100.0 * marginal.model, marginal.edges, color=MODEL, linewidth=1.5, label="model")
    axes.set_xlim(marginal.edges[0], marginal.edges[-1])
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel(axis_label(marginal.name))
    axes.locator_params(axis="x", nbins=4)


def marginal_figure(marginal: Marginal, side: str) -> Figure:
    """Histogram of one parameter beside the model's share of each bin."""
    with figure_settings():
        figure, axes = new_panel(*_SMALL)
        draw_marginal(axes, marginal, side)
        axes.set_ylabel("Share per bin [%]")
        return figure


def calibration_figure(found: Mapping[str, Calibration]) -> Figure:
    """Probability integral transform of one parameter, both sides: excess of events below u, with the chance band."""
    with figure_settings():
        figure, axes = new_panel(*_SMALL)
        for side, one in found.items():
            axes.fill_between(
                [0.0, 1.0], -100 * one.limit, 100 * one.limit, color=COLORS[side], alpha=0.13, linewidth=0
            )
        axes.axhline(0.0, color=MODEL, linewidth=0.9)
        for side, one in found.items():
            dash = (0, DASHES[side]) if DASHES[side] else "-"
            axes.plot(one.u, 100.0 * one.difference, color=COLORS[side], linestyle=dash, linewidth=1.6)
        axes.set_xlim(0.0, 1.0)
        axes.set_xlabel("u = F(x) of the model")
        axes.set_ylabel("Events below − u [%]")
        return figure


def bic_figure(summary: SideSummary, K: int, side: str) -> Figure:
    """BIC above its least over K; the model's own K has a ring."""
    with figure_settings():
        figure, axes = new_panel()
        tried = np.array(summary.n_components)
        above = np.array(summary.bic) - min(summary.bic)
        axes.plot(tried, above, color=COLORS[side], marker="o", markersize=4)
        if K in summary.n_components:
            at = summary.n_components.index(K)
            axes.plot(K, above[at], "o", markersize=12, fillstyle="none", color=MODEL, markeredgewidth=1.4)
            axes.annotate(f"K = {K}", (K, above[at]), (0, 12), textcoords="offset points", ha="center")
        axes.set_xticks(tried if tried.size <= 16 else tried[:: -(-tried.size // 12)])
        axes.margins(y=0.12)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:,.0f}".replace("-", "−"))
        axes.set_xlabel("Number of components K")
        axes.set_ylabel("BIC above the least")
        axes.set_title(f"{TITLES[side]}: {summary.events:,} departures")
        return figure


def draw_strips(axes: Axes, strips: Sequence[Strip], side: str) -> None:
    """Relative error of the model's mass next to each bound, with 1.96 standard errors [%]."""
    for i, one in enumerate(strips):
        error, spread = 100.0 * one.error, 196.0 * one.standard_error
        axes.errorbar(error, i, xerr=spread, fmt="o", color=COLORS[side], capsize=3, linewidth=1.4, markersize=5)
    axes.axvline(0.0, color=MODEL, linewidth=0.9)
    for edge in (-20.0, 20.0):
        axes.axvline(edge, color="#767676", linewidth=0.9, linestyle=(0, (3.0, 2.0)))
    axes.set_yticks(range(len(strips)), [f"{one.name} {one.end}" for one in strips])
    axes.set_ylim(len(strips) - 0.4, -0.6)
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, -25.0), max(high, 25.0))
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("Model's mass against that of the events [%]")


def strips_figure(strips: Sequence[Strip], side: str) -> Figure:
    """`draw_strips` in a panel."""
    with figure_settings():
        figure, axes = new_panel(height=0.95 + 0.34 * max(len(strips), 2))
        draw_strips(axes, strips, side)
        axes.set_title(TITLES[side])
        return figure


LEVELS: Final = (0.9, 0.5)
"""Contours hold these shares of the model."""


def density_levels(share: FloatArray, held: tuple[float, ...] = LEVELS) -> list[float]:
    """Cell shares above which the densest cells together hold each of the given shares, ascending."""
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
