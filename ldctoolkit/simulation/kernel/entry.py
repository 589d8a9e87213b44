"""The compiled loops as they are called from Python: ranges of scenarios, the interpreter's lock released.

Every entry works on bare views of its arrays: counting references to them in each small function would cost as much as
the step of a plant, and the counters would go back and forth between the threads.

A compiled entry is kept on disk between runs. What it calls lies in other files of this package, which numba does not
look at: a digest of all of them is part of each entry, so that a changed file is compiled anew.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call, call-arg"

from __future__ import annotations

import hashlib
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
    lane_events,
    lane_rows,
    lane_sight,
    lane_table,
    lanes,
    plant,
    rk4_lanes,
)
from ldctoolkit.simulation.kernel.data import LANES, RING
from ldctoolkit.simulation.kernel.lane_rows import SEEN, TARGET
from ldctoolkit.simulation.kernel.lane_sight import lay_road, look_ahead, noise_of, see, segment_size, substeps_of
from ldctoolkit.simulation.kernel.lane_table import ROWS
from ldctoolkit.simulation.kernel.lanes import drive_block
from ldctoolkit.simulation.kernel.plant import OPTIONS
from ldctoolkit.simulation.kernel.rk4_lanes import advance, drive_block_any, start


def _digest() -> int:
    """Of the text of everything that is compiled into an entry."""
    text = hashlib.sha256(",".join(SCENARIO_METRICS).encode())
    lane_modules = (lane_events, lane_rows, lane_sight, lane_table, lanes)
    for module in (data, *lane_modules, between, fused, plant, rk4_lanes, _philox):
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
    def begin(scene, setting, state, paths, place, blocks):
        """Start of the scenarios of some blocks, their tables in the rows of `state`."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        paths = _bare(paths)
        place = _bare(place)
        blocks = _bare(blocks)
        for block in blocks:
            start(scene, setting, block, state[block], paths, place)

    @numba.njit(cache=True, **OPTIONS)
    def look(scene, setting, state, k, blocks, times, seen, lane):
        """What the law sees at sample k of the scenarios of some blocks, into (m, 4) and (2, m, p)."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        blocks = _bare(blocks)
        times = _bare(times)
        seen = _bare(seen)
        lane = _bare(lane)
        ahead, noise = np.zeros((1 + 2 * times.shape[0]) * LANES), np.zeros(2 * LANES)
        for block in blocks:
            w = state[block]
            look_ahead(scene, setting, block, k, times, ahead, 0)
            noise_of(scene, setting, block, k, noise, 0)
            see(setting, w, k, ahead, 0, noise, 0)
            for l in range(min(LANES, scene.shape[0] - block * LANES)):
                i = block * LANES + l
                for n in range(4):
                    seen[i, n] = w[SEEN + n * LANES + l]
                for j in range(times.shape[0]):
                    lane[0, i, j] = ahead[(1 + 2 * j) * LANES + l]
                    lane[1, i, j] = ahead[(2 + 2 * j) * LANES + l]

    @numba.njit(cache=True, **OPTIONS)
    def go_on(scene, setting, state, paths, place, k, blocks, command):
        """Sample k of the scenarios of some blocks with the commands (m,)."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        state = _bare(state)
        paths = _bare(paths)
        place = _bare(place)
        blocks = _bare(blocks)
        command = _bare(command)
        most = 1
        for block in blocks:
            most = max(most, substeps_of(scene, block))
        road = np.empty(3 * segment_size(most))
        for block in blocks:
            w = state[block]
            parts = substeps_of(scene, block)
            for l in range(min(LANES, scene.shape[0] - block * LANES)):
                w[TARGET + l] = command[block * LANES + l]
            end = lay_road(scene, setting, block, k, w, parts, road, 0)
            advance(scene, setting, block, w, k, parts, road, 0, end, paths, place)

    @numba.njit(cache=True, **OPTIONS)
    def drive_any(scene, setting, law, times, paths, place, blocks, score, diverged, failed):
        """Linear laws (d, m, ...) on some blocks of any plant; scores into (d, columns, m)."""
        if digest < 0:
            return
        scene = _bare(scene)
        setting = _bare(setting)
        law = _bare(law)
        times = _bare(times)
        paths = _bare(paths)
        place = _bare(place)
        blocks = _bare(blocks)
        score = _bare(score)
        diverged = _bare(diverged)
        failed = _bare(failed)
        for block in blocks:
            drive_block_any(scene, setting, law, times, paths, place, block, score, diverged, failed)

    @numba.njit(cache=True, **OPTIONS)
    def drive_lanes(scene, exact, setting, law, times, first, last, score, diverged, failed, work, score_only):
        """Linear laws (d, m, ...) on blocks first to last of the ideal plant. S alone on request."""
        if digest < 0:
            return
        scene = _bare(scene)
        exact = _bare(exact)
        setting = _bare(setting)
        law = _bare(law)
        times = _bare(times)
        score = _bare(score)
        diverged = _bare(diverged)
        failed = _bare(failed)
        work = _bare(work)
        size, rows = int(setting[RING]), 2 * times.shape[1]
        lane = work.reshape(-1, LANES)
        w, g = lane[:ROWS].ravel(), lane[ROWS : ROWS + rows].ravel()
        ring = lane[ROWS + rows : ROWS + rows + 1 + 2 * size].ravel()
        tables = (w, g, ring)
        for block in range(first, last):
            drive_block(scene, exact, setting, law, times, block, score, diverged, failed, tables, score_only)

    return begin, look, go_on, drive_any, drive_lanes


begin, look, go_on, drive_any, drive_lanes = _entries(_digest())


def scratch(setting: FloatArray, lookaheads: int) -> FloatArray:
    """Scratch of one call of `drive_lanes` with that many lookahead times."""
    return np.zeros((ROWS + 2 * lookaheads + 1 + 2 * int(setting[RING])) * LANES)
