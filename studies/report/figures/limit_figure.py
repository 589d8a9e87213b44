"""Distributions of depth, lateral acceleration and jerk, design by design, with the share beyond a limit."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus
from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import DTLE_LIMIT, SCENARIO_METRICS
from studies.report.context import Context
from studies.report.figures.scores import new_panel, wrap
from studies.report.look.style import PANEL, RECORDED, LineStyle, figure_settings
from studies.report.tables.row import Row, is_baseline
from studies.report.words.text import percent, printable

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


def depth_curves(context: Context) -> tuple[LimitCurve, ...]:
    """How far the edge goes beyond the line at the centre of gravity [m], over all departures; the limit is D_y."""
    D_y = context.primary.D_y

    def curve(values: FloatArray, row: Row | None) -> LimitCurve:
        return _curve(context, row, values, values > D_y)

    held = _without_control(context)
    # no control's depth stands in the results where the study holds that design, with residuals on the path
    first = context.scenarios.d_y if held is None else _values(context, "deepest", held)
    return (curve(first, None), *(curve(_values(context, "deepest", row), row) for row in context.shown))


def axle_curves(context: Context) -> tuple[LimitCurve, ...]:
    """How far the front axle's outer edge goes beyond the line [m], over all departures: the negative of `dtle`."""

    def curve(row: Row, shown: Row | None) -> LimitCurve:
        dtle = _values(context, "dtle", row)
        return _curve(context, shown, -dtle, dtle < DTLE_LIMIT)

    held = _without_control(context)
    first = () if held is None else (curve(held, None),)
    return (*first, *(curve(row, row) for row in context.shown))


def comfort_curves(context: Context, name: str) -> tuple[LimitCurve, ...]:
    """Added peak of lateral acceleration [m/s^2] or jerk [m/s^3], over the interventions of each design that has any.

    Parameters
    ----------
    context : Context
    name : {"a_y_added_peak", "jerk_added_peak"}
        No curve of results that do not hold it.
    """
    limit = SCENARIO_METRICS[name].limit

    def curves() -> Iterator[LimitCurve]:
        for row in context.shown:
            acted = np.asarray(context.case.status[row.index]) != EventStatus.NEVER_TRIGGERED
            values = _values(context, name, row)[acted]
            if values.size and not np.isnan(values).any():
                yield _curve(context, row, values, values > limit)

    return tuple(curves())


def _without_control(context: Context) -> Row | None:
    return next((row for row in context.primary.rows if is_baseline(row)), None)


def _values(context: Context, name: str, row: Row) -> FloatArray:
    result: FloatArray = np.asarray(getattr(context.case.companions, name)[row.index], dtype=np.float64)
    return result


def _curve(context: Context, row: Row | None, values: FloatArray, beyond: npt.NDArray[np.bool_]) -> LimitCurve:
    if row is None:
        return LimitCurve("No control", RECORDED, values, float(beyond.mean()))
    return LimitCurve(printable(row.title), context.styles[row.design.law], values, float(beyond.mean()))
