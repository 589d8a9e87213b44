"""The compiled loops as they are called from Python: ranges of scenarios, the interpreter's lock released.

Every entry works on bare views of its arrays: counting references to them in each small function would cost as much as
the step of a plant, and the counters would go back and forth between the threads.

A compiled entry is kept on disk between runs. What it calls lies in other files of this package, which numba does not
look at: a digest of all of them is part of each entry, so that a changed file is compiled anew.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call, call-arg"

import hashlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import cgutils
from numba.extending import intrinsic

import ldctoolkit.lane_functions as lane_functions
from ldctoolkit.arrays import FloatArray
from ldctoolkit.lane_functions import OPTIONS
from ldctoolkit.metrics import SCENARIO_METRICS
from ldctoolkit.paths import kernels
from ldctoolkit.simulation.kernel import data, exact_lanes, lanes, rk4_lanes, sight
from ldctoolkit.simulation.kernel.data import ALIVE, LANES, SEEN, TARGET, WHEEL_SEEN


def _digest() -> int:
    """Of the text of everything that is compiled into an entry."""
    text = hashlib.sha256(",".join(SCENARIO_METRICS).encode())
    for module in (lane_functions, data, lanes, exact_lanes, sight, rk4_lanes, kernels):
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
    def begin(scene, exact, setting, state, paths, chosen):
        """Start of all scenarios, the tables of their blocks in the rows of `state`."""
        if digest < 0:
            return
        scene, exact, setting, state = _bare(scene), _bare(exact), _bare(setting), _bare(state)
        paths, chosen = _bare(paths), _bare(chosen)
        for block in range(state.shape[0]):
            rk4_lanes.start(scene, setting, block, state[block], paths, chosen)
            if exact.shape[1]:
                exact_lanes.start(scene, exact, setting, block, state[block], paths, chosen)

    @numba.njit(cache=True, **OPTIONS)
    def look(setting, state, k, blocks, times, seen, yaw_rate, heading, wheel):
        """What the law sees at sample k of the scenarios of some blocks that go on: (m, 4), twice (m, p), (m,)."""
        if digest < 0:
            return
        setting, state, blocks = _bare(setting), _bare(state), _bare(blocks)
        times, seen, yaw_rate, heading = _bare(times), _bare(seen), _bare(yaw_rate), _bare(heading)
        wheel = _bare(wheel)
        ahead, noise = np.zeros((1 + 2 * times.shape[0]) * LANES), np.zeros(2 * LANES)
        for block in blocks:
            w = state[block]
            sight.look_ahead(setting, k, w, times, ahead, 0)
            sight.noise_of(setting, k, w, noise, 0)
            sight.see(setting, w, k, ahead, 0, noise, 0)
            for l in range(min(LANES, seen.shape[0] - block * LANES)):
                i = block * LANES + l
                if w[ALIVE + l] > 0.0:
                    for n in range(4):
                        seen[i, n] = w[SEEN + n * LANES + l]
                    wheel[i] = w[WHEEL_SEEN + l]
                    for j in range(times.shape[0]):
                        yaw_rate[i, j] = ahead[(1 + 2 * j) * LANES + l]
                        heading[i, j] = ahead[(2 + 2 * j) * LANES + l]

    @numba.njit(cache=True, **OPTIONS)
    def go_on(exact, setting, state, recorded, paths, k, blocks, command):
        """Sample k of the scenarios of some blocks with the commands (m,); exact steps where there are matrices."""
        if digest < 0:
            return
        exact, setting, state, blocks = _bare(exact), _bare(setting), _bare(state), _bare(blocks)
        recorded, paths, command = _bare(recorded), _bare(paths), _bare(command)
        most = 1
        for block in blocks:
            most = max(most, sight.substeps_of(state[block]))
        road, bend = np.empty(3 * sight.segment_size(most)), np.empty(4 * LANES)
        for block in blocks:
            w = state[block]
            for l in range(min(LANES, command.shape[0] - block * LANES)):
                w[TARGET + l] = command[block * LANES + l] if w[ALIVE + l] > 0.0 else 0.0
            lanes.lay_bend(setting, recorded, block, k, w, bend, 0)
            if exact.shape[1]:
                exact_lanes.advance(exact, setting, w, k, 0.0, block * LANES, bend, 0, paths)
            else:
                parts = sight.substeps_of(w)
                end = sight.lay_road(setting, k, w, parts, road, 0)
                rk4_lanes.advance(setting, w, k, parts, road, 0, end, bend, 0, paths)

    @numba.njit(cache=True, **OPTIONS)
    def drive_any(scene, setting, law, times, recorded, paths, chosen, blocks, score, diverged, failed):
        """Linear laws (d, m, ...) on some blocks of any plant; scores into (d, columns, m)."""
        if digest < 0:
            return
        scene, setting, law, times, recorded = _bare(scene), _bare(setting), _bare(law), _bare(times), _bare(recorded)
        paths, chosen, blocks = _bare(paths), _bare(chosen), _bare(blocks)
        score, diverged, failed = _bare(score), _bare(diverged), _bare(failed)
        for block in blocks:
            rk4_lanes.drive_block_any(
                scene, setting, law, times, recorded, paths, chosen, block, score, diverged, failed
            )

    @numba.njit(cache=True, **OPTIONS)
    def drive_lanes(
        scene, exact, setting, law, times, recorded, paths, chosen, first, last, score, diverged, failed,
        work, g, bend, begun,
    ):  # fmt: skip
        """Linear laws (d, m, ...) on blocks first to last of the ideal plant."""
        if digest < 0:
            return
        scene, exact, setting, law, times = _bare(scene), _bare(exact), _bare(setting), _bare(law), _bare(times)
        recorded, score, diverged, failed = _bare(recorded), _bare(score), _bare(diverged), _bare(failed)
        paths, chosen, tables = _bare(paths), _bare(chosen), (_bare(work), _bare(g), _bare(bend), _bare(begun))
        for block in range(first, last):
            exact_lanes.drive_block(
                scene, exact, setting, law, times, recorded, paths, chosen, block,
                score, diverged, failed, tables,
            )  # fmt: skip

    return begin, look, go_on, drive_any, drive_lanes


begin, look, go_on, drive_any, drive_lanes = _entries(_digest())


def scratch(setting: FloatArray, lookaheads: int, most: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Scratch of one call of `drive_lanes`: table of a block, weights of the lane ahead, y'' of `most` samples, start.

    The caller keeps it: what a compiled function makes is freed after its last use there, bare views do not count.
    """
    sizes = 2 * lookaheads * LANES, 4 * most * LANES, data.LIMITS
    ends = lanes.rings.py_func(setting)  # plain Python: compiling it for one call would take a second
    return np.zeros(ends[-1]), *(np.empty(size) for size in sizes)  # type: ignore[return-value]
