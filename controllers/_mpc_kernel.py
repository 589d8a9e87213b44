"""The compiled sweep of `linear_mpc`: all that a sample needs, of every scenario, as far as no solver is needed.

The compiler takes a while to import: callers import this module where they call it. A compiled entry is kept on disk
between runs. What it calls lies in other files too, which numba does not look at: a digest of all of them is part of
each entry, so that a changed file is compiled anew.
"""

# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from controllers import _mpc_active_set, _mpc_condensing, _mpc_rows
from controllers._mpc_active_set import polish, prove, sign
from controllers._mpc_condensing import Condensed, Given, Limits
from controllers._mpc_rows import OPTIONS, ROUNDING, decided, matrix, values

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

FREE, HELD, OPEN, BEYOND = range(4)
"""How a scenario stands after the sweep: no limit active, a guess proved itself, a solver is needed, infeasible."""

__all__ = ["BEYOND", "FREE", "HELD", "OPEN", "assemble", "finish", "sweep"]


def _digest() -> int:
    """Of the text of everything that is compiled into an entry."""
    text = hashlib.sha256()
    for file in (__file__, *(str(module.__file__) for module in (_mpc_active_set, _mpc_condensing, _mpc_rows))):
        text.update(Path(file).read_bytes())
    return int.from_bytes(text.digest()[:6], "big")


@numba.njit(**OPTIONS)
def plan_of_four(c: Condensed, i: int, x: FloatArray, r: FloatArray, U: FloatArray, work: FloatArray) -> None:
    """`plan` with four states, unrolled: three times as fast."""
    N = U.size
    A, B, K, D, PD, back = c.A_cl[i], c.B[i], c.K[i], c.D[i], c.PD[i], c.back[i]
    g0 = g1 = g2 = g3 = 0.0
    for j in range(N - 1, -1, -1):
        d = r[j + 1] - r[j]
        h0 = PD[0] * d + A[0, 0] * g0 + A[1, 0] * g1 + A[2, 0] * g2 + A[3, 0] * g3
        h1 = PD[1] * d + A[0, 1] * g0 + A[1, 1] * g1 + A[2, 1] * g2 + A[3, 1] * g3
        h2 = PD[2] * d + A[0, 2] * g0 + A[1, 2] * g1 + A[2, 2] * g2 + A[3, 2] * g3
        h3 = PD[3] * d + A[0, 3] * g0 + A[1, 3] * g1 + A[2, 3] * g2 + A[3, 3] * g3
        g0, g1, g2, g3 = h0, h1, h2, h3
        work[j] = back[0] * g0 + back[1] * g1 + back[2] * g2 + back[3] * g3
    z0, z1, z2, z3 = x[0], x[1], x[2] - c.x_ss[i, 2] * r[0], x[3]
    half = 0.5 * c.delta_ss[i]
    for j in range(N):
        d, f = r[j + 1] - r[j], work[j]
        U[j] = f - (K[0] * z0 + K[1] * z1 + K[2] * z2 + K[3] * z3) + half * (r[j] + r[j + 1])
        y0 = A[0, 0] * z0 + A[0, 1] * z1 + A[0, 2] * z2 + A[0, 3] * z3 + B[0] * f + D[0] * d
        y1 = A[1, 0] * z0 + A[1, 1] * z1 + A[1, 2] * z2 + A[1, 3] * z3 + B[1] * f + D[1] * d
        y2 = A[2, 0] * z0 + A[2, 1] * z1 + A[2, 2] * z2 + A[2, 3] * z3 + B[2] * f + D[2] * d
        y3 = A[3, 0] * z0 + A[3, 1] * z1 + A[3, 2] * z2 + A[3, 3] * z3 + B[3] * f + D[3] * d
        z0, z1, z2, z3 = y0, y1, y2, y3


@numba.njit(**OPTIONS)
def plan(
    c: Condensed, i: int, x: FloatArray, r: FloatArray, U: FloatArray, work: FloatArray, costate: FloatArray
) -> None:
    """Optimal commands without limits into U (N,), from x (m,) and the lane's yaw rate r (N + 1,).

    work (N,) and costate (2, m) are room.
    """
    N, m = U.size, x.size
    A, B, K, D, PD, back, x_ss = c.A_cl[i], c.B[i], c.K[i], c.D[i], c.PD[i], c.back[i], c.x_ss[i]
    g, h = costate[0], costate[1]
    for k in range(m):
        g[k] = 0.0
    for j in range(N - 1, -1, -1):
        d, total = r[j + 1] - r[j], 0.0
        for k in range(m):
            value = PD[k] * d
            for b in range(m):
                value += A[b, k] * g[b]
            h[k] = value
            total += back[k] * value
        g, h = h, g
        work[j] = total
    z, y = g, h
    for k in range(m):
        z[k] = x[k] - x_ss[k] * r[0]
    half = 0.5 * c.delta_ss[i]
    for j in range(N):
        d, f = r[j + 1] - r[j], work[j]
        feedback = 0.0
        for k in range(m):
            feedback += K[k] * z[k]
            value = B[k] * f + D[k] * d
            for b in range(m):
                value += A[k, b] * z[b]
            y[k] = value
        U[j] = f - feedback + half * (r[j] + r[j + 1])
        z, y = y, z


@numba.njit(**OPTIONS)
def block(c: Condensed, limits: Limits, i: int, U: FloatArray, work: FloatArray) -> None:
    """Replace the plan by the optimum with blocked moves, in place."""
    N, M = U.size, limits.start.size
    for b in range(M):
        total = 0.0
        for j in range(N):
            total += c.project[i, b, j] * U[j]
        work[b] = total
    for b in range(M):
        for j in range(limits.start[b], limits.start[b + 1] if b + 1 < M else N):
            U[j] = work[b]


@numba.njit(**OPTIONS)
def first(limits: Limits, C: FloatArray, U_0: float, low: float, high: float, w: FloatArray) -> float:
    """First command of the corrected plan, not beyond its bounds by a solver's tolerance."""
    total = U_0
    for k in range(limits.start.size):
        total += C[0, k] * w[k]
    return min(max(total, low), high)


@numba.njit(**OPTIONS)
def _shifted(limits: Limits, last: FloatArray, last_slack: FloatArray, side: IntArray, beyond: IntArray) -> None:
    """The guess that the rows held one sample before are held still, each one sample nearer."""
    M = limits.start.size
    for row in range(side.size):
        side[row] = sign(last[limits.shift[row]])
    if side[0] == 0 and M > 1 and limits.shift[0] == 1:
        side[0] = sign(last[M])  # the first change is now the row of the first move
    for kind in range(3):
        beyond[kind] = 1 if last_slack[kind] > 0.0 else 0


@numba.njit(**OPTIONS)
def _warm(limits: Limits, last: FloatArray, w: FloatArray, multipliers: FloatArray) -> None:
    """What a solver starts from: the multipliers one sample before, each one sample nearer."""
    w[:] = 0.0
    for row in range(multipliers.size):
        multipliers[row] = last[limits.shift[row]]


def _entries(digest: int) -> Any:
    """What is called from Python, each with the digest among what it closes over: numba keeps one version a value."""

    @numba.njit(cache=True, **OPTIONS)
    def sweep(
        c: Condensed,
        limits: Limits,
        guess: bool,
        given: Given,
        last: FloatArray,
        last_slack: FloatArray,
        U: FloatArray,
        delta: FloatArray,
        w: FloatArray,
        multipliers: FloatArray,
        how: npt.NDArray[np.int8],
    ) -> None:
        """One sample of every scenario: what can be proved without a solver, and which scenarios need one.

        Parameters
        ----------
        c : Condensed
        limits : Limits
        guess : bool
            Whether to prove anything; otherwise every feasible scenario is left to the solver.
        given : Given
        last : (n, R)
            Multipliers one sample before.
        last_slack : (n, 3)
            Slacks one sample before.
        U : (n, N), delta : (n,), w : (n, M + 3), multipliers : (n, R), how : (n,)
            Results; w and multipliers zero at first.
        """
        if digest < 0:
            return
        n, N = U.shape
        X, prev, sent, r_all, past = given
        M, R = limits.start.size, limits.group.size
        y, low, high, work = np.empty(R), np.empty(R), np.empty(R), np.empty(N)
        C, G, a, room = np.empty((R, M)), np.empty((N, M)), np.empty((2, N, M)), np.empty((M + 3, M + 4))
        x, costate = np.empty(given.x.shape[1]), np.empty((2, given.x.shape[1]))
        lateral = np.empty((3, limits.window + limits.delay + N + x.size))
        side, beyond = np.empty(R, dtype=np.int64), np.empty(3, dtype=np.int64)
        for i in range(n):
            x[:] = X[i]
            if limits.window > 0:
                lateral[:2, : limits.window + 1] = past[i]
            if limits.delay > 0:
                decided(c, limits, i, x, sent[i], r_all[i], lateral)
            r = r_all[i, limits.delay :]
            if x.size == 4:
                plan_of_four(c, i, x, r, U[i], work)
            else:
                plan(c, i, x, r, U[i], work, costate)
            if M < N:
                block(c, limits, i, U[i], work)
            delta[i] = U[i, 0]
            if not values(c, limits, i, x, r, prev[i], U[i], lateral, y, low, high):
                how[i] = BEYOND
                continue
            if not guess:
                how[i] = OPEN
                _warm(limits, last[i], w[i], multipliers[i])
                continue
            inside = True
            for row in range(R):
                inside &= (y[row] <= high[row] + ROUNDING) & (y[row] >= low[row] - ROUNDING)
            if inside:
                how[i] = FREE
                delta[i] = min(max(delta[i], low[0]), high[0])
                continue
            matrix(c, limits, i, C, G, a)
            _shifted(limits, last[i], last_slack[i], side, beyond)
            if prove(limits, C, y, low, high, side, beyond, w[i], multipliers[i], room):
                how[i] = HELD
                delta[i] = first(limits, C, U[i, 0], low[0], high[0], w[i])
            else:
                how[i] = OPEN
                _warm(limits, last[i], w[i], multipliers[i])

    @numba.njit(cache=True, **OPTIONS)
    def assemble(
        c: Condensed,
        limits: Limits,
        rows: IntArray,
        given: Given,
        U: FloatArray,
        C: FloatArray,
        y: FloatArray,
        low: FloatArray,
        high: FloatArray,
    ) -> None:
        """The QPs of the scenarios `rows` (k,): C (k, R, M), y, low and high (k, R), from plans U (n, N)."""
        if digest < 0:
            return
        N, M = U.shape[1], limits.start.size
        X, prev, sent, r_all, past = given
        G, a, x = np.empty((N, M)), np.empty((2, N, M)), np.empty(given.x.shape[1])
        lateral = np.empty((3, limits.window + limits.delay + N + x.size))
        for k in range(rows.size):
            i = rows[k]
            x[:] = X[i]
            if limits.window > 0:
                lateral[:2, : limits.window + 1] = past[i]
            decided(c, limits, i, x, sent[i], r_all[i], lateral)
            values(c, limits, i, x, r_all[i, limits.delay :], prev[i], U[i], lateral, y[k], low[k], high[k])
            matrix(c, limits, i, C[k], G, a)

    @numba.njit(cache=True, **OPTIONS)
    def finish(
        limits: Limits,
        exact: bool,
        C: FloatArray,
        y: FloatArray,
        low: FloatArray,
        high: FloatArray,
        w: FloatArray,
        multipliers: FloatArray,
    ) -> float:
        """First command of a solver's answer, which is polished in place if it should be exact."""
        if digest < 0:
            return 0.0
        if exact:
            polish(limits, C, y, low, high, w, multipliers)
        return first(limits, C, y[0], low[0], high[0], w)

    return sweep, assemble, finish


sweep, assemble, finish = _entries(_digest())
