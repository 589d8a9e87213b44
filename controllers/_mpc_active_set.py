"""Guesses of a QP's solution that prove themselves, compiled.

The QP of a scenario, in corrections e (M,) and slacks s, one a kind of soft limit:

    minimise    |e|^2/2 + weight sum (s + s^2/2)
    subject to  low <= y + C e <= high              in the hard rows,
                low - s <= y + C e <= high + s      in the soft rows, s >= 0.

Multipliers are positive at an upper bound. At a solution e = -C' multipliers, and the magnitudes of the multipliers of
one kind sum to at most its weight where s = 0, to weight (1 + s) where s > 0. A guess is a set of rows held at their
bounds; it gives e and the multipliers by one small linear system, and it *is* the solution if these conditions hold,
whatever it came from. A guess that fails is mended, for a limited number of times: rows with a multiplier of the wrong
sign are let go, the row that is violated most is held (after the primal-dual active set method; M. Hintermueller,
K. Ito, K. Kunisch, *The primal-dual active set strategy as a semismooth Newton method*, SIAM J. Optim. 13(3), 2003).
"""

# mypy: disable-error-code="untyped-decorator, no-any-return"

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

from controllers._mpc_condensing import Limits
from controllers._mpc_rows import OPTIONS

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_PROVED: Final = 1e-10
"""Largest violation of a condition by a guess that counts as the solution."""
_ROUNDING: Final = 1e-14
"""Where multipliers are large, as those of a soft limit that cannot be met, this share of the largest term counts."""
_MORE_MENDINGS: Final = 4
"""A guess is mended three times as often as there are moves, and this much more."""


@numba.njit(**OPTIONS)
def prove(
    limits: Limits,
    C: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
    side: IntArray,
    beyond: IntArray,
    w: FloatArray,
    multipliers: FloatArray,
    room: FloatArray,
) -> bool:
    """Mend a guess until it proves itself; False if it does not within a few rounds."""
    R, M = C.shape
    held = np.empty(M + 3, dtype=np.int64)
    for _ in range(3 * M + _MORE_MENDINGS):
        count = 0
        for row in range(R):
            if side[row] != 0:
                if count == held.size:
                    return False
                held[count] = row
                count += 1
        dependent = _magnitudes(limits, C, y, low, high, side, beyond, held[:count], room)
        if dependent >= 0:
            side[dependent] = 0
            continue
        w[:] = 0.0
        multipliers[:] = 0.0
        proved = True
        sums, tolerance = np.zeros(3), _PROVED
        for a in range(count):
            row, magnitude = held[a], room[a, -1]
            for k in range(M):
                part = magnitude * C[row, k]
                w[k] -= side[row] * part
                tolerance = max(tolerance, _ROUNDING * abs(part))
            multipliers[row] = side[row] * magnitude
            if limits.group[row] >= 0:
                sums[limits.group[row]] += magnitude
        for kind in range(3):
            slack = sums[kind] / limits.weight[kind] - 1.0
            if beyond[kind]:
                w[M + kind] = slack
                if slack < 0.0:
                    beyond[kind] = 0
                    proved = False
            elif slack > tolerance:
                beyond[kind] = 1
                proved = False
        worst, worst_row, worst_side = tolerance, -1, 0
        wrong, wrong_row = -tolerance, -1
        for row in range(R):
            value = y[row]
            for k in range(M):
                value += C[row, k] * w[k]
            slack = w[M + limits.group[row]] if limits.group[row] >= 0 else 0.0
            above, below = value - high[row] - slack, low[row] - slack - value
            if side[row] == 0:
                if max(above, below) > worst:
                    worst, worst_row, worst_side = max(above, below), row, 1 if above > below else -1
            elif side[row] * multipliers[row] < -tolerance:
                if side[row] * multipliers[row] < wrong:
                    wrong, wrong_row = side[row] * multipliers[row], row
                proved = False
            elif abs(above if side[row] > 0 else below) > tolerance:
                proved = False
        if wrong_row >= 0:
            side[wrong_row] = 0
        elif worst_row >= 0:
            side[worst_row] = worst_side
        elif proved:
            return True
    return False


@numba.njit(**OPTIONS)
def _magnitudes(
    limits: Limits,
    C: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
    side: IntArray,
    beyond: IntArray,
    held: IntArray,
    room: FloatArray,
) -> int:
    """Magnitudes of the held rows' multipliers into room[:, -1], by Cholesky; -1, or a row that depends on others."""
    M, count = C.shape[1], held.size
    for a in range(count):
        row, kind = held[a], limits.group[held[a]]
        right = y[row] - high[row] if side[row] > 0 else low[row] - y[row]
        if kind >= 0 and beyond[kind]:
            right += 1.0
        for b in range(a + 1):
            other = held[b]
            total = 0.0
            for k in range(M):
                total += C[row, k] * C[other, k]
            total *= side[row] * side[other]
            if kind >= 0 and beyond[kind] and limits.group[other] == kind:
                total += 1.0 / limits.weight[kind]
            room[a, b] = total
        diagonal = room[a, a]
        for b in range(a + 1):
            total = room[a, b]
            for k in range(b):
                total -= room[a, k] * room[b, k]
            if b < a:
                room[a, b] = total / room[b, b]
            else:
                if not total > 1e-12 * diagonal:
                    return row
                room[a, a] = np.sqrt(total)
        for k in range(a):
            right -= room[a, k] * room[k, -1]
        room[a, -1] = right / room[a, a]
    for a in range(count - 1, -1, -1):
        total = room[a, -1]
        for k in range(a + 1, count):
            total -= room[k, a] * room[k, -1]
        room[a, -1] = total / room[a, a]
    return -1


@numba.njit(**OPTIONS)
def polish(
    limits: Limits,
    C: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
    w: FloatArray,
    multipliers: FloatArray,
) -> bool:
    """Put the exact solution in the place of a solver's, if the rows that it holds at bounds prove to be right."""
    R, M = C.shape
    side, beyond = np.empty(R, dtype=np.int64), np.empty(3, dtype=np.int64)
    room, exact, exact_multipliers = np.empty((M + 3, M + 4)), np.empty(M + 3), np.empty(R)
    for row in range(R):
        side[row] = sign(multipliers[row]) if abs(multipliers[row]) > 1e-9 else 0
    for kind in range(3):
        beyond[kind] = 1 if w[M + kind] > 1e-6 else 0
    proved: bool = prove(limits, C, y, low, high, side, beyond, exact, exact_multipliers, room)
    if proved:
        w[:] = exact
        multipliers[:] = exact_multipliers
    return proved


@numba.njit(**OPTIONS)
def sign(number: float) -> int:
    return 1 if number > 0.0 else -1 if number < 0.0 else 0
