"""The compiled loops as they are called from Python: ranges of scenarios, the interpreter's lock released.

Every entry works on uncounted arrays, and is kept on disk with the version of all sources that are compiled into it:
see `ldctoolkit.numba_internals`.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call, call-arg"

import math
from typing import Any

import numba

import ldctoolkit.lanes as lanes
import ldctoolkit.numba_internals as numba_internals
import ldctoolkit.vector_math as vector_math
from ldctoolkit.arrays import LANES, FloatArray
from ldctoolkit.lanes import below, table, zeros
from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.numba_internals import OPTIONS, source_version, uncounted
from ldctoolkit.paths import kernels
from ldctoolkit.simulation.kernel import (
    actuator,
    block_table,
    data,
    driver,
    exact_loop,
    model_loop,
    rk4_loop,
    road,
    sight,
)
from ldctoolkit.simulation.kernel.data import ALIVE, COMMAND, SEEN_E_Y, WHEEL_SEEN
from ldctoolkit.simulation.kernel.road import HEADER, POINT, lay_road

_SOURCES = (
    lanes,
    numba_internals,
    vector_math,
    data,
    block_table,
    exact_loop,
    actuator,
    driver,
    road,
    sight,
    rk4_loop,
    model_loop,
    kernels,
)


def _entries(version: int) -> Any:
    """The entries; each closes over the version of its sources, and uses it."""

    @numba.njit(cache=True, **OPTIONS)
    def begin(scene, exact, setting, state, paths, path_rows):
        """Start of all scenarios, the tables of their blocks in `state` (blocks, rows, lanes)."""
        if version < 0:
            return
        scene, exact, setting, state = uncounted(scene), uncounted(exact), uncounted(setting), uncounted(state)
        paths, path_rows = uncounted(paths), uncounted(path_rows)
        for block in range(state.shape[0]):
            w = table(state[block])
            rk4_loop.start(scene, setting, block, w, paths, path_rows)
            if exact.shape[1]:
                exact_loop.start(scene, exact, setting, block, w, paths, path_rows)

    @numba.njit(cache=True, **OPTIONS)
    def go_on(
        exact, setting, state, work, recorded, motion, paths, k, blocks, drives, command, going, times, seen,
        yaw_rate, heading, wheel, torque, yielding,
    ):  # fmt: skip
        """Sample k of the scenarios of some blocks, then what the law sees after it while their tables are at hand.

        If it `drives`, sample k with the commands (m,); exact steps where there are matrices. Which lanes go on into
        `going` (blocks, lanes). Seen are state, lane and wheel angle, (m, 4), twice (m, p), (m,); the driver's torque,
        and whether the assist yields, (m,).
        """
        if version < 0:
            return
        exact, setting, state, blocks = uncounted(exact), uncounted(setting), uncounted(state), uncounted(blocks)
        recorded, paths, command, motion = uncounted(recorded), uncounted(paths), uncounted(command), uncounted(motion)
        times, seen, yaw_rate, heading = uncounted(times), uncounted(seen), uncounted(yaw_rate), uncounted(heading)
        wheel, torque, yielding, going = uncounted(wheel), uncounted(torque), uncounted(yielding), uncounted(going)
        noise = bend = table(work)
        intended, road, preview = below(bend, 4), below(bend, 11), below(noise, 2)
        for block in blocks:
            w, first = table(state[block]), block * LANES
            if drives:
                for l in range(min(LANES, command.shape[0] - first)):
                    w[COMMAND, l] = command[first + l] if w[ALIVE, l] > 0.0 else 0.0
                block_table.lay_bend(setting, recorded, block, k, w, bend, 0)
                if exact.shape[1]:
                    exact_loop.advance(exact, setting, w, k, 0.0, first, bend, 0, paths)
                else:
                    end = lay_road(setting, k, w, True, road, 0)
                    if setting[data.HELD] > 0.0:
                        driver.lay_recorded(setting, w, motion, block, k, intended, 0)
                    rk4_loop.advance(setting, w, k, road, 0, end, bend, 0, intended, 0, paths)
            sight.preview_lane(setting, k + 1, w, times, preview, 0)
            sight.noise_of(setting, k + 1, w, noise, 0)
            sight.see(setting, w, k + 1, preview, 0, noise, 0)
            for l in range(LANES):
                going[block, l] = w[ALIVE, l] > 0.0
            for l in range(min(LANES, seen.shape[0] - first)):
                i = first + l
                if w[ALIVE, l] > 0.0:
                    for n in range(4):
                        seen[i, n] = w[SEEN_E_Y + n, l]
                    wheel[i], torque[i], yielding[i] = w[WHEEL_SEEN, l], w[data.TORQUE, l], w[data.YIELDING, l]
                    for j in range(times.shape[0]):
                        yaw_rate[i, j], heading[i, j] = preview[1 + 2 * j, l], preview[2 + 2 * j, l]

    @numba.njit(cache=True, **OPTIONS)
    def drive_any(
        scene, setting, law, times, recorded, motion, paths, path_rows, blocks, score, diverged, failed, work, ends
    ):
        """Linear laws (d, m, ...) on some blocks of any plant; scores into (d, columns, m)."""
        if version < 0:
            return
        scene, setting, law, times = uncounted(scene), uncounted(setting), uncounted(law), uncounted(times)
        recorded, motion, ends = uncounted(recorded), uncounted(motion), uncounted(ends)
        paths, path_rows, blocks = uncounted(paths), uncounted(path_rows), uncounted(blocks)
        score, diverged, failed = uncounted(score), uncounted(diverged), uncounted(failed)
        w, most = table(work), ends.shape[0] - 1
        lane_weights = below(w, block_table.rings(setting)[3])
        bend = below(lane_weights, law.shape[2] - data.LAW)
        preview = below(bend, 4 * most)
        noise = below(preview, most * (1 + 2 * times.shape[1]))
        intended = below(noise, 2 * most)
        road = below(intended, 7 * most if setting[data.HELD] > 0.0 else 0)
        for block in blocks:
            rk4_loop.drive_block_any(
                scene, setting, law, times, recorded, motion, paths, path_rows, block, score, diverged, failed,
                (w, lane_weights, bend, road, preview, noise, intended), ends,
            )  # fmt: skip

    @numba.njit(cache=True, **OPTIONS)
    def drive_lanes(
        scene, exact, setting, law, times, recorded, paths, path_rows, first, last, score, diverged, failed, work
    ):
        """Linear laws (d, m, ...) on blocks first to last of the ideal plant."""
        if version < 0:
            return
        scene, exact, setting, law = uncounted(scene), uncounted(exact), uncounted(setting), uncounted(law)
        times, recorded, paths, path_rows = (
            uncounted(times),
            uncounted(recorded),
            uncounted(paths),
            uncounted(path_rows),
        )
        score, diverged, failed = uncounted(score), uncounted(diverged), uncounted(failed)
        w = table(work)
        lane_weights = below(w, block_table.rings(setting)[3])
        initial = below(lane_weights, law.shape[2] - data.LAW)
        tables = w, lane_weights, initial, below(initial, data.A_Y_START)
        for block in range(first, last):
            exact_loop.drive_block(
                scene, exact, setting, law, times, recorded, paths, path_rows, block, score, diverged, failed, tables
            )

    @numba.njit(cache=True, **OPTIONS)
    def exchange(
        phase, setting, state, recorded, paths, k, j, segment, blocks, rows, command, road, ends, ramps, e, result
    ):
        """A piece of sample k of some blocks, the rows of `road`, `ends`, `ramps`: what a vehicle model is asked, or
        what follows from its answer.
        """
        if version < 0:
            return
        setting, state, recorded, paths = uncounted(setting), uncounted(state), uncounted(recorded), uncounted(paths)
        blocks, rows, command, road = uncounted(blocks), uncounted(rows), uncounted(command), uncounted(road)
        ends, ramps, e, result = uncounted(ends), uncounted(ramps), uncounted(e), uncounted(result)
        for i in range(rows.shape[0]):
            row, first = rows[i], i * LANES
            block = blocks[row]
            w, way = table(state[block]), table(road[row])
            if phase == data.ASK_COMMANDED:
                ends[row] = model_loop.begin(setting, recorded, block, w, k, command, way)
            if phase % 2 == 0:
                ramps[row] = model_loop.ask(phase, setting, w, way, k, j, segment, ramps[row], e, first)
            else:
                model_loop.take(phase, setting, w, way, k, j, segment, paths, e, result, first)

    return begin, go_on, drive_any, drive_lanes, exchange


begin, go_on, drive_any, drive_lanes, exchange = _entries(source_version(_SOURCES, *SCENARIO_METRICS))


def table_rows(setting: FloatArray) -> int:
    """Rows of the table of a block."""
    return int(block_table.rings.py_func(setting)[3])  # plain Python: compiling it for one call would take a second


def scratch(setting: FloatArray, law: FloatArray, lookaheads: int, most: int, substeps: float = 0.0) -> FloatArray:
    """Scratch of one call of `drive_lanes`, or with substeps of `drive_any`, over at most so many samples.

    The caller keeps it: what a compiled function makes is freed after its last use there, a table is no use.
    """
    rows = table_rows(setting) + law.shape[2] + data.A_Y_START + 4 * most
    if substeps:
        rows += most * (3 + 2 * lookaheads + 7) + _road_rows(setting, most, substeps)
    return zeros(rows, LANES)


def sample_scratch(setting: FloatArray, lookaheads: int, substeps: float) -> FloatArray:
    """Scratch of one call of `go_on`."""
    return zeros(max(3 + 2 * lookaheads, 11 + _road_rows(setting, 1, substeps)), LANES)


def _road_rows(setting: FloatArray, samples: int, substeps: float) -> int:
    """Rows of the road of so many samples; where T cuts a lane, either part may be a whole sample of another."""
    cut = min(samples, LANES)
    segments = (2 if setting[data.DELAY_PART] else 1) * samples + cut
    # each segment has at most a substep more than its share
    parts = math.ceil(substeps) * (samples + 2 * cut) + segments
    return segments * (HEADER + POINT) + 2 * POINT * parts
