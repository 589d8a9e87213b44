"""Paths of the departures explorer as the page holds them: whole numbers of a stated resolution, one list a kind."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from studies.report.context import Context
from studies.report.embedded.packed import packed, script_json
from studies.report.replay.paths import Replay, replay
from studies.report.replay.picks import STATUS_WORDS, Chosen, Pick, most_departures, picked_departures

RESOLUTION: Final = {"y": 1e-3, "delta": math.radians(1e-3), "a_y": 1e-3}
"""Steps of the embedded positions [m], steering angles [rad] and lateral accelerations [m/s^2]."""

BUDGET: Final = 1_000_000
"""Most bytes of paths in the page, as they are estimated."""

MOST: Final = 1_150_000
"""The same, for what they weigh once they are driven."""

COUNTS: Final = (120, 110, 100, 80, 60, 40)
"""Numbers of departures that are tried until they fit."""

COARSEST: Final = 0.2
"""Longest step [s] between embedded samples; the clock of the controller where that is longer."""

_FACTS: Final = ("deepest", "a_y_peak", "jerk_peak", "delta_peak", "t_back")
_BYTES: Final = 2 * 4 / 3


@dataclasses.dataclass(frozen=True)
class Grid:
    """How many departures the page holds, and at which step.

    Attributes
    ----------
    count : int
        Departures, about.
    every : int
        Samples of the controller from one embedded sample to the next.
    """

    count: int
    every: int


def grids(dt: float) -> list[Grid]:
    """What may be tried, the finest first: fewer departures before longer steps."""
    longest = max(1, math.floor(COARSEST / dt + 1e-9))
    steps = [every for every in (1, 2, 4, 8, 16, 32) if every <= longest]
    return [Grid(count, every) for every in steps for count in COUNTS]


def weight(context: Context, picks: tuple[Pick, ...], designs: tuple[Chosen, ...], every: int) -> float:
    """Bytes of the paths in the page, at most."""
    T, step = context.scenarios.T[[pick.row for pick in picks]], every * context.report.setup.dt
    recorded = 2.0 * (T / step + 2.0)
    driven = 3.0 * ((T + context.report.setup.settle) / step + 2.0)
    return float(_BYTES * (recorded.sum() + sum(driven[: most_departures(one)].sum() for one in designs)))


def trimmed(context: Context, picks: tuple[Pick, ...], designs: tuple[Chosen, ...], every: int) -> tuple[Pick, ...]:
    """The picks that fit, the last ones left out first; those asked for stay."""
    asked = sum("asked for" in pick.roles for pick in picks)
    low, high = max(asked, 1), len(picks)
    while low < high:
        middle = (low + high + 1) // 2
        if weight(context, picks[:middle], designs, every) <= BUDGET:
            low = middle
        else:
            high = middle - 1
    return picks[:low]


def bytes_of(data: Mapping[str, object]) -> int:
    """What the paths weigh in the page: more than `weight` where a design loses the vehicle."""
    return len(script_json({name: data[name] for name in ("paths", "recorded")}))


def embedded_departures(context: Context, replayed: Replay, every: int) -> dict[str, object]:
    """What the script reads.

    Parameters
    ----------
    context : Context
    replayed : Replay
        p departures and c designs.
    every : int
        Samples of the controller from one embedded sample to the next.

    Returns
    -------
    dict
        Whole numbers of `RESOLUTION`; for each design its paths one after the other, ``count`` (c, p) samples each,
        the first at ``start`` (c, p), then every ``step``; 0 samples where there is no path. Recorded paths begin at 0
        and end at T. Facts are (c, p) as stored.
    """
    return {
        "step": every * context.report.setup.dt,
        "resolution": {"y": RESOLUTION["y"], "delta": 1e-3, "a_y": RESOLUTION["a_y"]},
        "far": -2.0 * context.report.setup.vehicle.edge_offset,
        "numbers": [int(context.scenarios.index.min()), int(context.scenarios.index.max())],
        "departures": _departures(replayed),
        "recorded": _recorded(replayed, every * context.report.setup.dt),
        "paths": _paths(replayed, every, context.report.setup.dt),
        "facts": _facts(context, replayed),
        "own_window": context.case.case.window == "control",
        "words": [STATUS_WORDS[status] for status in sorted(STATUS_WORDS)],
    }


def _departures(replayed: Replay) -> dict[str, object]:
    some = replayed.scenarios
    names = ("T", "d_y", "sigma_y", "v_mean", "a_mean", "sigma_v", "c_0", "dc")
    return {
        "index": packed(some.index, "i4"),
        "side": packed(some.side, "i1"),
        "roles": [list(pick.roles) for pick in replayed.picks],
        **{name: packed(getattr(some, name)) for name in names},
    }


def _recorded(replayed: Replay, step: float) -> dict[str, object]:
    some = replayed.scenarios
    count = np.ceil(some.T / step - 1e-9).astype(np.int64) + 1
    t = np.minimum(np.arange(int(count.max())) * step, some.T[:, None])
    path = replayed.recorded
    y, v = path.lateral(t), path.speed(t)
    a_y = path.lateral_acceleration(t) + v**2 * path.curvature(t)
    used = np.arange(t.shape[1]) < count[:, None]
    return {
        "count": packed(count, "i4"),
        "deepest": packed(path.deepest(some.T)),
        "y": _whole(y[used], "y"),
        "a_y": _whole(a_y[used], "a_y"),
    }


def _paths(replayed: Replay, every: int, dt: float) -> dict[str, object]:
    count, start = [], []
    values: dict[str, list[dict[str, str]]] = {name: [] for name in RESOLUTION}
    for paths in replayed.designs:
        kept = [_kept(t, every * dt) for t in paths.t]
        count += [rows.size for rows in kept]
        start += [paths.t[k, 0] if rows.size else 0.0 for k, rows in enumerate(kept)]
        for name, some in values.items():
            table = getattr(paths, name)
            line = [table[k, rows] for k, rows in enumerate(kept)]
            some.append(_whole(np.concatenate([np.empty(0), *line]), name))
    return {"count": packed(count, "i4"), "start": packed(start), **values}


def _kept(t: FloatArray, step: float) -> npt.NDArray[np.int64]:
    """Samples at whole steps after the first; T itself may lie between two."""
    known = t[np.isfinite(t)]
    since = (known - known[:1]) / step
    return np.flatnonzero(np.abs(since - np.rint(since)) * step < 1e-9)


def _facts(context: Context, replayed: Replay) -> dict[str, object]:
    """As stored."""
    case = context.case
    rows = [pick.row for pick in replayed.picks]
    designs = [paths.chosen.row.index for paths in replayed.designs]
    tables = {"S": case.S, "S_uncorrected": case.S_uncorrected}
    tables |= {name: getattr(case.companions, name) for name in _FACTS}
    return {
        **{name: packed(np.stack([table[i][rows] for i in designs])) for name, table in tables.items()},
        "status": packed(np.stack([case.status[i][rows] for i in designs]), "u1"),
        "tried": packed(np.stack([paths.tried for paths in replayed.designs]), "u1"),
    }


def _whole(values: FloatArray, name: str) -> dict[str, str]:
    """Whole numbers of the resolution: 16 bits where they fit, which they do unless a design loses the vehicle."""
    steps = np.clip(np.rint(values / RESOLUTION[name]), -(2.0**31) + 1, 2.0**31 - 1).astype(np.int64)
    small = steps.size == 0 or np.abs(steps).max() < 2**15
    return packed(steps, "i2" if small else "i4")


_FEWEST: Final = 100
"""Departures that further designs leave in the page."""


def fitted_departures(context: Context, designs: tuple[Chosen, ...]) -> tuple[int, Replay, dict[str, object]]:
    """Drive again what fits into the page: departures first, then further designs as long as a hundred departures stay.

    Parameters
    ----------
    context : Context
    designs : tuple of Chosen
        Further ones last.

    Returns
    -------
    every : int
        Samples of the controller from one embedded sample to the next.
    replayed : Replay
        With the designs that are in the page.
    data : dict
        What the script reads.
    """
    kept = tuple(one for one in designs if not one.further)
    every, picks = 1, picked_departures(context, kept, 0)
    for grid in grids(context.report.setup.dt):
        every, picks = grid.every, picked_departures(context, kept, grid.count)
        if weight(context, picks, kept, every) <= BUDGET:
            break
    else:
        picks = trimmed(context, picks, kept, every)
    # further designs take the place of departures that nobody asked for or named, down to a hundred
    for count in range(len(designs), len(kept), -1):
        for most in COUNTS:
            some = picked_departures(context, designs[:count], most)
            fits = weight(context, some, designs[:count], every) <= BUDGET
            if fits and len(some) >= min(_FEWEST, len(picks)):
                return _driven(context, every, some, designs[:count])
    return _driven(context, every, picks, kept)


def _driven(
    context: Context, every: int, picks: tuple[Pick, ...], designs: tuple[Chosen, ...]
) -> tuple[int, Replay, dict[str, object]]:
    """Further designs go first where paths weigh more than they were estimated to, then departures."""
    replayed = replay(context, picks, designs)
    data = embedded_departures(context, replayed, every)
    while bytes_of(data) > MOST and replayed.designs[-1].chosen.further:
        replayed = dataclasses.replace(replayed, designs=replayed.designs[:-1])
        data = embedded_departures(context, replayed, every)
    while bytes_of(data) > MOST and len(replayed.picks) > max(1, len(context.report.departures)):
        replayed = replayed.first(max(1, len(context.report.departures), int(0.8 * len(replayed.picks))))
        data = embedded_departures(context, replayed, every)
    return every, replayed, data
