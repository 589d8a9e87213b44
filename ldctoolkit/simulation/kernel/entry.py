"""The compiled loops as they are called from Python: ranges of scenarios, the interpreter's lock released.

Every entry works on bare views of its arrays: counting references to them in each small function would cost as much as
the step of a plant, and the counters would go back and forth between the threads.

A compiled entry is kept on disk between runs. What it calls lies in other files of this package, which numba does not
look at: a digest of all of them is part of each entry, so that a changed file is compiled anew.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call, call-arg"

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import cgutils
from numba.extending import intrinsic

from ldctoolkit.arrays import FloatArray
from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.simulation import _philox
from ldctoolkit.simulation.kernel import (
    between,
    data,
    fused,
    lane_cuts,
    lane_events,
    lane_table,
    lanes,
    plant,
    sample,
    senses,
)
from ldctoolkit.simulation.kernel.data import (
    A_BEFORE,
    ALIVE,
    AXLE,
    BACK,
    COMMAND,
    COUNT,
    DEEP,
    DELTA_0,
    DT,
    ESTIMATE,
    FRONT,
    OVER,
    RING,
    SCORE,
    SLOT,
    START,
    STEPS,
    W_SEEN,
    WHEEL,
    WORK,
    X_0,
    X,
)
from ldctoolkit.simulation.kernel.lane_table import LANES, ROWS
from ldctoolkit.simulation.kernel.lanes import drive_block
from ldctoolkit.simulation.kernel.plant import OPTIONS, accelerations, curvature, speed
from ldctoolkit.simulation.kernel.sample import advance, record, rings
from ldctoolkit.simulation.kernel.senses import lane_ahead, linear_command, see
from ldctoolkit.vehicle import _nonlinear_compiled


def _digest() -> int:
    """Of the text of everything that is compiled into an entry."""
    text = hashlib.sha256(",".join(SCENARIO_METRICS).encode())
    lane_modules = (lane_cuts, lane_events, lane_table, lanes)
    for module in (data, *lane_modules, between, fused, plant, sample, senses, _philox, _nonlinear_compiled):
        text.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(text.digest()[:6], "big")


@intrinsic
def _bare(typing, array):  # noqa: ARG001
    """The same numbers, not counted; the caller of the entry keeps them alive."""

    def build(context, builder, signature, arguments):  # noqa: ARG001
        counted = context.make_array(array)(context, builder, arguments[0])
        bare = context.make_array(array)(context, builder)
        for name in ("data", "nitems", "itemsize", "shape", "strides"):
            setattr(bare, name, getattr(counted, name))
        for name in ("meminfo", "parent"):
            setattr(bare, name, cgutils.get_null_value(getattr(counted, name).type))
        return bare._getvalue()

    return array(array), build


def _entries(digest: int) -> Any:
    """The entries, each with the digest among what it closes over: numba keeps one version a value."""

    @numba.njit(cache=True, **OPTIONS)
    def begin(scene, setting, state, paths, rows):
        """Start of the scenarios `rows`."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        paths = _bare(paths)
        rows = _bare(rows)
        commands, frames, _, _ = rings(setting)
        for i in rows:
            for n in range(state.shape[1]):
                if n not in (SLOT, COUNT):
                    state[i, n] = 0.0
            for n in range(4):
                state[i, X + n] = state[i, ESTIMATE + n] = scene[i, X_0 + n]
            state[i, WHEEL] = state[i, COMMAND] = scene[i, DELTA_0]
            state[i, commands:frames] = scene[i, DELTA_0]
            state[i, SCORE + DEEP] = scene[i, X_0]
            state[i, SCORE + FRONT] = scene[i, X_0] + setting[AXLE] * scene[i, X_0 + 2]
            state[i, SCORE + BACK] = math.inf
            state[i, SCORE + OVER] = -scene[i, X_0]
            state[i, ALIVE] = 1.0 if scene[i, STEPS] > 0.0 else 0.0
            record(paths, state, i, scene[i, START])

    @numba.njit(cache=True, **OPTIONS)
    def before(scene, setting):
        """Fill in the lateral acceleration just before the trigger."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        for i in range(scene.shape[0]):
            t, p, psi, w = scene[i, START], scene[i, X_0 + 1], scene[i, X_0 + 2], scene[i, X_0 + 3]
            v, _ = speed(scene, setting, i, t)
            r = v * curvature(scene, i, t)
            _, _, scene[i, A_BEFORE] = accelerations(scene, setting, i, t, r, p, psi, w, scene[i, DELTA_0])

    @numba.njit(cache=True, **OPTIONS)
    def look(scene, setting, state, k, rows, times, seen, yaw_rate, turn, work):
        """What the law sees at sample k of the scenarios `rows`, into (r, 4), (r, p), (r, p)."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        rows = _bare(rows)
        times = _bare(times)
        seen = _bare(seen)
        yaw_rate = _bare(yaw_rate)
        turn = _bare(turn)
        work = _bare(work)
        for n in range(rows.shape[0]):
            i = rows[n]
            see(scene, setting, state, i, k, work)
            for j in range(4):
                seen[n, j] = work[W_SEEN + j]
            t = scene[i, START] + k * setting[DT]
            for j in range(times.shape[0]):
                yaw_rate[n, j], turn[n, j] = lane_ahead(scene, setting, i, t, times[j])

    @numba.njit(cache=True, **OPTIONS)
    def go_on(scene, setting, state, paths, k, rows, command, work):
        """Sample k of the scenarios `rows` with the commands (r,)."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        paths = _bare(paths)
        rows = _bare(rows)
        command = _bare(command)
        work = _bare(work)
        for n in range(rows.shape[0]):
            advance(scene, setting, state, paths, rows[n], k, command[n], work)

    @numba.njit(cache=True, **OPTIONS)
    def drive_each(scene, setting, law, times, state, paths, rows, work):
        """A linear law on the scenarios `rows`, each from its start to its end."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        law = _bare(law)
        times = _bare(times)
        state = _bare(state)
        paths = _bare(paths)
        rows = _bare(rows)
        work = _bare(work)
        for i in rows:
            for k in range(int(scene[i, STEPS])):
                if state[i, ALIVE] == 0.0:
                    break
                see(scene, setting, state, i, k, work)
                t = scene[i, START] + k * setting[DT]
                command = linear_command(scene, setting, law, times, state, i, t, work)
                advance(scene, setting, state, paths, i, k, command, work)

    @numba.njit(cache=True, **OPTIONS)
    def drive_lanes(
        scene, exact, setting, law, times, state, paths, first, last, score, diverged, failed, work, score_only
    ):
        """Linear laws (d, m, ...) on blocks first to last of the ideal plant. S alone on request."""
        if digest < 0:
            return
        scene = _bare(scene)
        exact = _bare(exact)
        setting = _bare(setting)
        law = _bare(law)
        times = _bare(times)
        state = _bare(state)
        paths = _bare(paths)
        score = _bare(score)
        diverged = _bare(diverged)
        failed = _bare(failed)
        work = _bare(work)
        size, rows = int(setting[RING]), 2 * times.shape[1]
        lane = work[WORK:].reshape(-1, LANES)
        w, g = lane[:ROWS].ravel(), lane[ROWS : ROWS + rows].ravel()
        ring = lane[ROWS + rows : ROWS + rows + 1 + 2 * size].ravel()
        tables = (w, g, ring, work)
        for block in range(first, last):
            drive_block(
                scene, exact, setting, law, times, state, paths, block, score, diverged, failed, tables, score_only
            )

    return begin, before, look, go_on, drive_each, drive_lanes


begin, before, look, go_on, drive_each, drive_lanes = _entries(_digest())


def scratch(setting: FloatArray | None = None, lookaheads: int = 0) -> FloatArray:
    """Scratch of one call; with a setting, for `drive_lanes` with that many lookahead times."""
    lanes_rows = 0 if setting is None else ROWS + 2 * lookaheads + 1 + 2 * int(setting[RING])
    return np.zeros(WORK + lanes_rows * LANES)
