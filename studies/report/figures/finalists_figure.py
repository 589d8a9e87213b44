"""Scores of finalists on the scenarios that they were chosen on, and on fresh ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

from studies.report.figures.scores import new_panel, wrap
from studies.report.look.style import figure_settings
from studies.report.tables.row import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SEARCH, _FRESH = "#767676", "#0072B2"


@dataclasses.dataclass(frozen=True)
class Finalist:
    """Mean S of a finalist [m s] on both sets of scenarios."""

    label: str
    search: Interval
    fresh: Interval


def finalists_figure(finalists: Sequence[Finalist], title: str) -> Figure:
    """Both scores of each finalist, one above the other, with their intervals.

    Parameters
    ----------
    finalists : sequence of Finalist
        From top to bottom.
    title : str

    Returns
    -------
    Figure
        Open squares: where designs were chosen. Full circles: fresh scenarios.
    """
    with figure_settings():
        figure, axes = new_panel(height=1.45 + 0.42 * max(len(finalists), 2))
        for i, one in enumerate(finalists):
            axes.plot([one.search.value, one.fresh.value], [i - 0.16, i + 0.16], color="#b5b5b5", linewidth=1.0)
        for shift, color, marker, face, label, some in (
            (-0.16, _SEARCH, "s", "#ffffff", "where designs were chosen", [one.search for one in finalists]),
            (0.16, _FRESH, "o", _FRESH, "fresh departures", [one.fresh for one in finalists]),
        ):
            places = [i + shift for i in range(len(finalists))]
            axes.hlines(places, [one.low for one in some], [one.high for one in some], color=color, linewidth=1.4)
            axes.plot([one.value for one in some], places, linestyle="none", marker=marker, markersize=6, label=label,
                      markerfacecolor=face, markeredgecolor=color)  # fmt: skip
        axes.set_yticks(range(len(finalists)), [wrap(one.label, 24) for one in finalists])
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.set_ylim(len(finalists) - 0.45, -0.55)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("Mean S [m·s], with intervals")
        axes.set_title(title)
        figure.legend(loc="outside lower center", ncols=2)
        return figure
