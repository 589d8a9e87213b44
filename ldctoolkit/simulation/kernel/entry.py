"""The compiled loops as they are called from Python: ranges of scenarios, the interpreter's lock released.

A compiled entry is kept on disk between runs. What it calls lies in other files of this package, which numba does not
look at: a digest of all of them is part of each entry, so that a changed file is compiled anew.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np

from ldctoolkit.simulation import _philox
from ldctoolkit.simulation.kernel import data, lanes, plant, sample, senses
from ldctoolkit.simulation.kernel.data import SCORES
from ldctoolkit.simulation.kernel.lanes import LANES, ROWS, drive_block
from ldctoolkit.simulation.kernel.plant import OPTIONS, accelerations, curvature
from ldctoolkit.simulation.kernel.sample import advance, record
from ldctoolkit.simulation.kernel.senses import lane_ahead, linear_command, see
from ldctoolkit.vehicle import _nonlinear_compiled


class Work(NamedTuple):
    """Scratch of one thread."""

    x: Any
    after: Any
    end: Any
    K: Any
    score: Any
    limits: Any


def _digest() -> int:
    """Of the text of everything that is compiled into an entry."""
    text = hashlib.sha256()
    for module in (data, lanes, plant, sample, senses, _philox, _nonlinear_compiled):
        text.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(text.digest()[:6], "big")


@numba.njit(**OPTIONS)
def _work():
    return Work(np.zeros(4), np.zeros(5), np.zeros(5), np.zeros((12, 5)), np.zeros(SCORES), np.zeros(2))


def _entries(digest: int) -> Any:
    """The entries, each with the digest among what it closes over: numba keeps one version a value."""

    @numba.njit(cache=True, **OPTIONS)
    def begin(scene, setting, state, paths, rows):
        """Start of the scenarios `rows`."""
        if digest < 0:
            return
        for i in rows:
            for n in range(4):
                state.x[i, n] = scene.x_0[i, n]
                state.estimate[i, n] = scene.x_0[i, n]
            state.wheel[i] = state.command[i] = scene.delta_0[i]
            state.commands[i, :] = scene.delta_0[i]
            state.score[i, :] = 0.0
            state.score[i, data.DEEP] = scene.x_0[i, 0]
            state.score[i, data.FRONT] = scene.x_0[i, 0] + setting.l_f * scene.x_0[i, 2]
            state.score[i, data.BACK] = math.inf
            state.score[i, data.OVER] = -scene.x_0[i, 0]
            state.alive[i] = scene.steps[i] > 0
            state.diverged[i] = False
            state.failed[i] = 0
            record(paths, state, i, scene.start[i])

    @numba.njit(cache=True, **OPTIONS)
    def before(scene, setting, out):
        """Lateral acceleration just before the trigger, into (m,)."""
        for i in range(out.shape[0]):
            if digest < 0:
                return
            t, x = scene.start[i], scene.x_0[i]
            v, _ = plant.speed(scene, setting, i, t)
            _, _, out[i] = accelerations(
                scene, setting, i, t, v * curvature(scene, i, t), x[1], x[2], x[3], scene.delta_0[i]
            )

    @numba.njit(cache=True, **OPTIONS)
    def look(scene, setting, camera, state, k, rows, times, seen, yaw_rate, turn):
        """What the law sees at sample k of the scenarios `rows`, into (r, 4), (r, p), (r, p)."""
        if digest < 0:
            return
        frame = np.zeros(2)
        for n in range(rows.shape[0]):
            i = rows[n]
            see(scene, setting, camera, state, i, k, seen[n], frame)
            t = scene.start[i] + k * setting.dt
            for j in range(times.shape[0]):
                yaw_rate[n, j], turn[n, j] = lane_ahead(scene, setting, camera, i, t, times[j])

    @numba.njit(cache=True, **OPTIONS)
    def go_on(scene, setting, state, paths, k, rows, command):
        """Sample k of the scenarios `rows` with the commands (r,)."""
        if digest < 0:
            return
        work = _work()
        for n in range(rows.shape[0]):
            advance(scene, setting, state, paths, rows[n], k, command[n], work)

    @numba.njit(cache=True, **OPTIONS)
    def drive_each(scene, setting, camera, law, state, paths, rows):
        """A linear law on the scenarios `rows`, each from its start to its end."""
        if digest < 0:
            return
        work, seen, frame = _work(), np.zeros(4), np.zeros(2)
        for n in range(rows.shape[0]):
            i = rows[n]
            for k in range(scene.steps[i]):
                if not state.alive[i]:
                    break
                see(scene, setting, camera, state, i, k, seen, frame)
                command = linear_command(scene, setting, camera, law, state, i, scene.start[i] + k * setting.dt, seen)
                advance(scene, setting, state, paths, i, k, command, work)

    @numba.njit(cache=True, **OPTIONS)
    def drive_lanes(scene, exact, setting, law, state, paths, first, last, score, diverged, failed):
        """Linear laws on blocks first to last of the ideal plant."""
        if digest < 0:
            return
        size = int(math.ceil(setting.window)) + 3
        w, g = np.zeros(ROWS * LANES), np.zeros(2 * law.times.shape[1] * LANES + 1)
        left, right = np.zeros((size, LANES)), np.zeros((size, LANES))
        single, work = np.zeros(LANES), _work()
        for block in range(first, last):
            drive_block(
                scene, exact, setting, law, state, paths, block, w, g, left, right, single, work, score, diverged, failed
            )

    return begin, before, look, go_on, drive_each, drive_lanes


begin, before, look, go_on, drive_each, drive_lanes = _entries(_digest())
