"""The compiled rows of `linear_mpc`'s QP: their values for a plan, their bounds, and what corrections do to them.

Row by row: the first move (angle and rate in one), the other moves, their changes; then, where there are such limits,
as shares of the limit, a_y just after each command, a_y at the end of each step, jerk over each step, e_y at its end.
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
def values(
    c: Condensed,
    limits: Limits,
    i: int,
    x: FloatArray,
    r: FloatArray,
    prev: float,
    U: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> bool:
    """Values y (R,) of the rows for the commands U, and their bounds; False if no command meets the hard ones."""
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
        _soft_values(c, limits, i, x, r, prev, U, y, low, high)
    return True


@numba.njit(**OPTIONS)
def _soft_values(
    c: Condensed,
    limits: Limits,
    i: int,
    x: FloatArray,
    r: FloatArray,
    prev: float,
    U: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> None:
    """Values of the soft rows as shares of their limits, bounds -1 and 1."""
    N, at = U.size, 2 * limits.start.size - 1
    for row in range(at, y.size):
        low[row], high[row] = -1.0, 1.0
    acceleration, jerk, offset = limits.scale
    first_jerk = at + (2 * N if acceleration > 0.0 else 0)
    first_offset = first_jerk + (N if jerk > 0.0 else 0)
    w = c.a_y[i]
    s0, s1, s2, s3 = x
    lateral = w[1] * s1 + w[2] * s2 + w[3] * s3
    before = lateral + w[4] * prev + w[5] * r[0]
    A, B, E_0, E_1 = c.A[i], c.B[i], c.E_0[i], c.E_1[i]
    for j in range(N):
        u, r_0, r_1 = U[j], r[j], r[j + 1]
        after = lateral + w[4] * u + w[5] * r_0
        n0 = A[0, 0] * s0 + A[0, 1] * s1 + A[0, 2] * s2 + A[0, 3] * s3 + B[0] * u + E_0[0] * r_0 + E_1[0] * r_1
        n1 = A[1, 0] * s0 + A[1, 1] * s1 + A[1, 2] * s2 + A[1, 3] * s3 + B[1] * u + E_0[1] * r_0 + E_1[1] * r_1
        n2 = A[2, 0] * s0 + A[2, 1] * s1 + A[2, 2] * s2 + A[2, 3] * s3 + B[2] * u + E_0[2] * r_0 + E_1[2] * r_1
        n3 = A[3, 0] * s0 + A[3, 1] * s1 + A[3, 2] * s2 + A[3, 3] * s3 + B[3] * u + E_0[3] * r_0 + E_1[3] * r_1
        s0, s1, s2, s3 = n0, n1, n2, n3
        lateral = w[1] * s1 + w[2] * s2 + w[3] * s3
        end = lateral + w[4] * u + w[5] * r_1
        if acceleration > 0.0:
            y[at + j], y[at + N + j] = after * acceleration, end * acceleration
        if jerk > 0.0:
            y[first_jerk + j] = (end - before) / limits.dt * jerk
        if offset > 0.0:
            y[first_offset + j] = s0 * offset
        before = end


@numba.njit(**OPTIONS)
def matrix(c: Condensed, limits: Limits, i: int, C: FloatArray, G: FloatArray) -> None:
    """What corrections do to the rows, into C (R, M); G (N, M) is room for what they do to the commands."""
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
    if acceleration > 0.0:
        _respond(response[0], acceleration, G, C[at : at + N])
        _respond(response[1], acceleration, G, C[at + N : at + 2 * N])
        at += 2 * N
    if jerk > 0.0:
        _respond(response[1], jerk / limits.dt, G, C[at : at + N])
        for j in range(N - 1, 0, -1):
            for k in range(M):
                C[at + j, k] -= C[at + j - 1, k]
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
