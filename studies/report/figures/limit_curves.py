"""Depth, lateral acceleration and jerk of designs as curves of a figure, with the share beyond a limit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus
from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import DTLE_LIMIT, SCENARIO_METRICS
from studies.report.context import Context
from studies.report.figures.limit_figure import LimitCurve
from studies.report.look.style import RECORDED
from studies.report.tables.row import Row, is_baseline
from studies.report.words.text import printable


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
    """Peak of lateral acceleration [m/s^2] or jerk [m/s^3], over the interventions of each design that has any.

    Parameters
    ----------
    context : Context
    name : {"a_y_peak", "jerk_peak"}
    """
    limit = SCENARIO_METRICS[name].limit

    def curves() -> Iterator[LimitCurve]:
        for row in context.shown:
            acted = np.asarray(context.case.status[row.index]) != EventStatus.NEVER_TRIGGERED
            values = _values(context, name, row)[acted]
            if values.size:
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
