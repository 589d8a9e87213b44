# ruff: noqa: RUF001 - true minus signs in labels
"""Figures of one parameter or one side: margins, calibration, BIC, bounds. Plain functions that return a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.diagnostics import Calibration, Marginal, Strip
from ldctoolkit.scenario_model import SideSummary
from studies.fit_page.style import COLORS, DASHES, MODEL, TITLES, axis_label
from studies.report.figures.scores import new_panel
from studies.report.look.style import figure_settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
