"""Example departures for the static figures: those with the least, the median and the greatest reduction."""

from __future__ import annotations

import numpy as np

from studies.report.context import Context
from studies.report.figures.path_figures import ControlledPath, Example
from studies.report.replay.paths import DesignPaths, Replay
from studies.report.replay.picks import REDUCTIONS, SIDE_NAMES, reductions
from studies.report.words.text import number, printable


def examples(context: Context, replayed: Replay) -> tuple[Example, ...]:
    """Examples of departures in which the first design took over, the left side first.

    Parameters
    ----------
    context : Context
    replayed : Replay
        With the best designs among those that were driven again.

    Returns
    -------
    tuple of Example
        Up to three a side.
    """
    if not replayed.designs:
        return ()
    reduction = reductions(context, replayed.designs[0].chosen.row.index)
    shown = {row.index for row in context.shown}
    drawn = [one for one in replayed.designs if one.chosen.row.index in shown]
    return tuple(
        _example(context, replayed, k, role, drawn, float(reduction[pick.row]))
        for side in SIDE_NAMES
        for role in REDUCTIONS
        for k, pick in enumerate(replayed.picks)
        if role in pick.roles and replayed.scenarios.side[k] == side
    )


def _example(
    context: Context, replayed: Replay, k: int, role: str, drawn: list[DesignPaths], reduction: float
) -> Example:
    one = replayed.scenarios.take([k])
    t = np.linspace(0.0, float(one.T[0]), 121)
    facts = (
        f"T = {number(float(one.T[0]), 2)} s, v_mean = {number(float(one.v_mean[0]), 1)} m/s, "
        f"d_y = {number(float(one.d_y[0]), 2)} m, scenario {one.index[0]}"
    )
    return Example(
        replayed.picks[k].row,
        SIDE_NAMES[int(one.side[0])],
        role,
        facts,
        reduction,
        t,
        replayed.recorded.take([k]).lateral(t[None, :])[0],
        -2.0 * context.report.setup.vehicle.edge_offset,
        tuple(_path(context, paths, k) for paths in drawn),
    )


def _path(context: Context, paths: DesignPaths, k: int) -> ControlledPath:
    row, driven = paths.chosen.row, np.isfinite(paths.t[k])
    style = context.styles[row.design.law]
    return ControlledPath(printable(row.title), style, paths.t[k, driven], paths.y[k, driven], paths.delta[k, driven])
