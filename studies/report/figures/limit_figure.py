"""Distribution of a quantity that has a limit, design by design."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit.arrays import FloatArray
from studies.report.figures.scores import new_panel, wrap
from studies.report.look.style import PANEL, LineStyle, figure_settings
from studies.report.words.text import percent

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STEPS = 200


@dataclasses.dataclass(frozen=True)
class LimitCurve:
    """One design (or the recorded path).

    Attributes
    ----------
    label : str
    style : LineStyle
    values : (k,)
        Of the quantity, over departures or interventions; one at least.
    beyond : float
        Share of them beyond the limit.
    """

    label: str
    style: LineStyle
    values: FloatArray
    beyond: float


def axis_ends(curves: Sequence[LimitCurve], limit: float) -> tuple[float, float]:
    """Ends of the horizontal axis: nearly all values, but no more than four times the limit.

    Where a curve would not be seen at all then, three quarters of its values are.
    """
    low = min(float(np.quantile(curve.values, 0.005)) for curve in curves)
    high = max(float(np.quantile(curve.values, 0.99)) for curve in curves)
    most = max(4.0 * limit, *(1.05 * float(np.quantile(curve.values, 0.75)) for curve in curves))
    return min(0.0, low), max(1.1 * limit, min(high, most))


def limit_figure(curves: Sequence[LimitCurve], title: str, xlabel: str, limit: float, limit_name: str) -> Figure:
    """Share of departures, or interventions, with a value below that on the horizontal axis.

    Parameters
    ----------
    curves : sequence of LimitCurve
        One at least.
    title, xlabel : str
    limit : float
        Drawn as a vertical line, named in the legend.
    limit_name : str

    Returns
    -------
    Figure
        The legend holds the share beyond the limit.
    """
    with figure_settings():
        figure, axes = new_panel(height=PANEL[1] + 0.2 * (len(curves) + 1))
        for curve in curves:
            share = np.linspace(0.0, 1.0, min(curve.values.size, _STEPS) + 1)
            label = f"{wrap(curve.label, 40)}: {percent(curve.beyond)} beyond"
            axes.plot(np.quantile(curve.values, share), share, label=label, **curve.style.line())
        axes.axvline(limit, color="#B00020", linewidth=1.4, linestyle=(0, (5.0, 1.5, 1.0, 1.5)), label=limit_name)
        axes.set_xlim(*axis_ends(curves, limit))
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel(xlabel)
        axes.set_ylabel("Share with less")
        axes.set_title(title)
        figure.legend(loc="outside lower left")
        return figure
