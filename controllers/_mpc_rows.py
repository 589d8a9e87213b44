"""The compiled rows of `linear_mpc`'s QP: their values for a plan, their bounds, and what corrections do to them.

Row by row: the first move (angle and rate in one), the other moves, their changes; then, where there are such limits,
as shares of the limit, the lateral acceleration a just after each command (only where the wheel jumps with it), a at
the end of each step, its change over the last half second in the same two places, e_y at the end of each step.

Values of a stand in two arrays, on the left and on the right of each sample: first the past `window` samples, then
the `delay` samples that are decided, then the horizon.
"""

# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt

from controllers._mpc_condensing import Condensed, Limits

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

# strict IEEE: a scenario's numbers are the same bits whichever stand beside it
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}

ROUNDING: Final = 1e-12
"""The plan without limits counts as inside them up to this [rad, or share of a soft limit]."""


@numba.njit(**OPTIONS)
def decided(
    c: Condensed, limits: Limits, i: int, x: FloatArray, sent: FloatArray, r: FloatArray, room: FloatArray
) -> None:
    """Move the state x (m,) to where the next command arrives, in place; accelerations on the way into room (2, .)."""
    for k in range(limits.delay):
        _go_on(c, i, x, sent[1 + k], r[k], r[k + 1], limits.window + k, room)


@numba.njit(**OPTIONS)
def _go_on(
    c: Condensed, i: int, x: FloatArray, u: float, r_0: float, r_1: float, sample: int, room: FloatArray
) -> None:
    """One step of the plant, in place; a just after its start and at its end into room."""
    A, B, E_0, E_1, a, after = c.A[i], c.B[i], c.E_0[i], c.E_1[i], c.a[i], room[2]
    m = x.size
    value = 0.0
    for k in range(m):
        value += a[k] * x[k]
        total = B[k] * u + E_0[k] * r_0 + E_1[k] * r_1
        for b in range(m):
            total += A[k, b] * x[b]
        after[k] = total
    room[1, sample] = value + a[m] * u + a[m + 1] * r_0
    value = 0.0
    for k in range(m):
        x[k] = after[k]
        value += a[k] * x[k]
    room[0, sample + 1] = value + a[m] * u + a[m + 1] * r_1


@numba.njit(**OPTIONS)
def values(
    c: Condensed,
    limits: Limits,
    i: int,
    x: FloatArray,
    r: FloatArray,
    prev: float,
    U: FloatArray,
    room: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> bool:
    """Values y (R,) of the rows for the commands U, and their bounds; False if no command meets the hard ones.

    The state x (m,) is changed where there are soft rows.
    """
    M = limits.start.size
    limit, step = limits.delta_max, limits.rate_step
    for b in range(M):
        y[b] = U[limits.start[b]]
        low[b], high[b] = -limit, limit
        if b > 0:
            y[M + b - 1] = y[b] - y[b - 1]
            low[M + b - 1], high[M + b - 1] = -step, step
    # angle and rate of the first move are one row
    low[0], high[0] = max(-limit, prev - step), min(limit, prev + step)
    if low[0] > high[0]:
        if low[0] - high[0] > ROUNDING:
            return False
        if prev > 0.0:
            high[0] = low[0]
        else:
            low[0] = high[0]
    if y.size > 2 * M - 1:
        _soft_values(c, limits, i, x, r, U, room, y, low, high)
    return True


@numba.njit(**OPTIONS)
def _soft_values(
    c: Condensed,
    limits: Limits,
    i: int,
    x: FloatArray,
    r: FloatArray,
    U: FloatArray,
    room: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> None:
    """Values of the soft rows as shares of their limits, bounds -1 and 1."""
    N, at = U.size, 2 * limits.start.size - 1
    for row in range(at, y.size):
        low[row], high[row] = -1.0, 1.0
    acceleration, jerk, offset = limits.scale
    now = limits.window + limits.delay
    for j in range(N):
        _go_on(c, i, x, U[j], r[j], r[j + 1], now + j, room)
        if offset > 0.0:
            y[y.size - N + j] = x[0] * offset
    if acceleration > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                y[at + j] = room[1 - side, now + j + side] * acceleration
            at += N
    if jerk > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                sample = now + j + side
                past = sample - limits.window
                before = room[1 - side, past]
                if limits.share > 0.0:
                    before = (1.0 - limits.share) * room[1, past] + limits.share * room[0, past + 1]
                y[at + j] = (room[1 - side, sample] - before) * jerk
            at += N


@numba.njit(**OPTIONS)
def matrix(c: Condensed, limits: Limits, i: int, C: FloatArray, G: FloatArray, a: FloatArray) -> None:
    """What corrections do to the rows, into C (R, M).

    G (N, M) is room for what they do to the commands, a (2, N, M) for what they do to a at the ends of steps and just
    after commands.
    """
    N, M = G.shape
    if M == N:
        for j in range(N):
            for k in range(j + 1):
                G[j, k] = c.impulse[i, j - k]
            for k in range(j + 1, M):
                G[j, k] = 0.0
    else:
        for b in range(M):
            for j in range(limits.start[b], limits.start[b + 1] if b + 1 < M else N):
                for k in range(M):
                    G[j, k] = c.moves[i, b, k]
    for b in range(M):
        for k in range(M):
            C[b, k] = G[limits.start[b], k]
            if b > 0:
                C[M + b - 1, k] = C[b, k] - C[b - 1, k]
    at = 2 * M - 1
    acceleration, jerk, offset = limits.scale
    response = c.response[i]
    if acceleration > 0.0 or jerk > 0.0:
        _respond(response[0], 1.0, G, a[0])
        _respond(response[1], 1.0, G, a[1])
    if acceleration > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                for k in range(M):
                    C[at + j, k] = acceleration * a[1 - side, j, k]
            at += N
    if jerk > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                past = j + side - limits.window  # the sample, from that of the first command on
                for k in range(M):
                    change = a[1 - side, j, k]
                    if past >= 0 and limits.share > 0.0:
                        change -= (1.0 - limits.share) * a[1, past, k] + limits.share * a[0, past, k]
                    elif past >= side and limits.share == 0.0:
                        change -= a[1 - side, past - side, k]
                    C[at + j, k] = jerk * change
            at += N
    if offset > 0.0:
        _respond(response[2], offset, G, C[at : at + N])


@numba.njit(**OPTIONS)
def _respond(response: FloatArray, scale: float, G: FloatArray, out: FloatArray) -> None:
    """Rows of an output that answers to a command k steps before by response[k]."""
    N, M = G.shape
    for j in range(N):
        for k in range(M):
            out[j, k] = 0.0
        for m in range(j + 1):
            weight = scale * response[j - m]
            for k in range(M):
                out[j, k] += weight * G[m, k]
