"""Sobol indices as bars."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.report.figures.scores import new_panel
from studies.report.look.style import figure_settings
from studies.report.words.text import number, shorten

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_BARS = 8
"""Quantities in one figure."""

_FIRST, _TOTAL = "#0072B2", "#E69F00"


@dataclasses.dataclass(frozen=True)
class IndexBar:
    """Sobol indices of one quantity with their intervals; the total one may be NaN.

    Attributes
    ----------
    name : str
    first, total : (3,)
        Index, low and high end.
    """

    name: str
    first: FloatArray
    total: FloatArray


def sensitivity_figure(bars: Sequence[IndexBar], title: str) -> Figure:
    """Part of the variance of mean S that goes with each quantity.

    Parameters
    ----------
    bars : sequence of IndexBar
        From top to bottom; the first `MOST_BARS` are drawn.
    title : str

    Returns
    -------
    Figure
        Full bars: first-order indices. Hatched ones: total indices, where there are any.
    """
    bars = bars[:MOST_BARS]
    totals = any(np.isfinite(bar.total[0]) for bar in bars)
    kinds = [("alone (first order)", _FIRST, "", [bar.first for bar in bars])]
    if totals:
        kinds.append(("with interactions (total)", _TOTAL, "////", [bar.total for bar in bars]))
    height = 0.8 / len(kinds)
    with figure_settings():
        figure, axes = new_panel(height=1.25 + (0.5 if totals else 0.34) * max(len(bars), 2))
        right = 1.0
        for k, (label, color, hatch, indices) in enumerate(kinds):
            values = np.array(indices)
            places = np.arange(len(bars)) + (k - 0.5 * (len(kinds) - 1)) * height
            axes.barh(places, np.nan_to_num(values[:, 0]), height=0.9 * height, label=label, hatch=hatch, linewidth=0.8,
                      facecolor=color if not hatch else "#ffffff", edgecolor=color)  # fmt: skip
            known = np.isfinite(values).all(axis=1)
            axes.hlines(places[known], values[known, 1], values[known, 2], color="#222222", linewidth=1.2)
            for place, (value, _, high) in zip(places, values, strict=True):
                if np.isfinite(value):
                    end = max(value, high if np.isfinite(high) else value, 0.0)
                    axes.text(end + 0.02, place, number(float(value), 2), va="center", fontsize=8.5)
                    right = max(right, end)
        axes.set_yticks(range(len(bars)), [shorten(bar.name, 18) for bar in bars])
        axes.tick_params(axis="y", length=0, labelcolor="#222222")
        axes.invert_yaxis()
        axes.set_xlim(min(0.0, *(float(np.nanmin([*b.first, *b.total])) for b in bars)), 1.13 * right)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("Part of the variance of mean S")
        axes.set_title(shorten(title, 48))
        figure.legend(loc="outside lower center", ncols=2)
        return figure
