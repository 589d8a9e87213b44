"""The compiled sweep of `linear_mpc`: rows of the QP, guesses that prove themselves, one sample of all scenarios.

The QP of a scenario, in corrections e (M,) of the plan without limits and slacks s, one a kind of soft limit:

    minimise    |e|^2/2 + weight sum (s + s^2/2)
    subject to  low <= y + C e <= high              in the hard rows,
                low - s <= y + C e <= high + s      in the soft rows, s >= 0.

Order of the rows, guesses and their conditions: `docs/explanation/mpc.md`. The compiler takes a while to import:
callers import this module where they call it. All that an entry calls stands here: a change compiles it anew.
"""

# mypy: disable-error-code="untyped-decorator, no-any-return"

from typing import Final, NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.numba_internals import OPTIONS

from ._mpc_condensing import Condensed, InitialState, Limits

__all__ = ["BEYOND", "FREE", "HELD", "OPEN", "Rows", "assemble", "finish", "sweep"]

_INSIDE: Final = 1e-12  # The plan without limits counts as inside them up to this [rad, or share of a soft limit]


class Rows(NamedTuple):
    """The rows of the QP of one scenario: low <= y + C e <= high."""

    C: FloatArray  # (R, M) Effect of corrections
    y: FloatArray  # (R,) Values without corrections
    low: FloatArray  # (R,)
    high: FloatArray  # (R,)


@numba.njit(**OPTIONS)
def decided(
    mpc: Condensed, limits: Limits, i: int, x: FloatArray, sent: FloatArray, r: FloatArray, lateral: FloatArray
) -> None:
    """Move the state x (m,) to where the next command arrives, in place; a_y on the way into `lateral` (3, .)."""
    go_on(mpc, i, x, sent[1:], r, limits.delay, limits.window, lateral)


@numba.njit(**OPTIONS)
def go_on(
    mpc: Condensed, i: int, x: FloatArray, u: FloatArray, r: FloatArray, count: int, sample: int, lateral: FloatArray
) -> None:
    """Steps x+ = A x + B u + E_0 r_0 + E_1 r_1, in place; a_y = a (x, u, r) just after their starts, and at their ends.

    After step j, e_y is in ``lateral[2, j]``.
    """
    if x.size == 5:
        _go_on(mpc, i, x, u, r, count, sample, lateral, 5)
    elif x.size == 6:
        _go_on(mpc, i, x, u, r, count, sample, lateral, 6)
    else:
        _go_on(mpc, i, x, u, r, count, sample, lateral, x.size)


# with a number of states that the compiler knows, loops over them are unrolled: three times as fast
@numba.njit(forceinline=True, **OPTIONS)
def _go_on(
    mpc: Condensed, i: int, x: FloatArray, u: FloatArray, r: FloatArray, count: int, sample: int, lateral: FloatArray,
    m: int,
) -> None:  # fmt: skip
    A, B, E_0, E_1, a = mpc.A[i], mpc.B[i], mpc.E_0[i], mpc.E_1[i], mpc.a[i]
    after = np.empty(m)
    for j in range(count):
        value = 0.0
        for k in range(m):
            value += a[k] * x[k]
            total = B[k] * u[j] + E_0[k] * r[j] + E_1[k] * r[j + 1]
            for b in range(m):
                total += A[k, b] * x[b]
            after[k] = total
        lateral[1, sample + j] = value + a[m] * u[j] + a[m + 1] * r[j]
        value = 0.0
        for k in range(m):
            x[k] = after[k]
            value += a[k] * x[k]
        lateral[0, sample + j + 1] = value + a[m] * u[j] + a[m + 1] * r[j + 1]
        lateral[2, j] = x[0]


@numba.njit(**OPTIONS)
def values(
    mpc: Condensed,
    limits: Limits,
    i: int,
    x: FloatArray,
    r: FloatArray,
    prev: float,
    U: FloatArray,
    lateral: FloatArray,
    rows: Rows,
) -> bool:
    """Values of the rows for the commands U, and their bounds; False if no command meets the hard ones.

    The state x (m,) is changed where there are soft rows.
    """
    _, y, low, high = rows
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
        if low[0] - high[0] > _INSIDE:
            return False
        if prev > 0.0:
            high[0] = low[0]
        else:
            low[0] = high[0]
    if y.size > 2 * M - 1:
        _soft_values(mpc, limits, i, x, r, U, lateral, rows)
    return True


@numba.njit(**OPTIONS)
def _soft_values(
    mpc: Condensed, limits: Limits, i: int, x: FloatArray, r: FloatArray, U: FloatArray, lateral: FloatArray, rows: Rows
) -> None:
    """Values of the soft rows as shares of their limits, bounds -1 and 1."""
    _, y, low, high = rows
    N, first_row = U.size, 2 * limits.start.size - 1
    for row in range(first_row, y.size):
        low[row], high[row] = -1.0, 1.0
    acceleration, jerk, offset = limits.scale
    now = limits.window + limits.delay
    go_on(mpc, i, x, U, r, N, now, lateral)
    if offset > 0.0:
        for j in range(N):
            y[y.size - N + j] = lateral[2, j] * offset
    if acceleration > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                y[first_row + j] = lateral[1 - side, now + j + side] * acceleration
            first_row += N
    if jerk > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                sample = now + j + side
                past = sample - limits.window
                before = lateral[1 - side, past]
                if limits.share > 0.0:
                    before = (1.0 - limits.share) * lateral[1, past] + limits.share * lateral[0, past + 1]
                y[first_row + j] = (lateral[1 - side, sample] - before) * jerk
            first_row += N


@numba.njit(**OPTIONS)
def matrix(mpc: Condensed, limits: Limits, i: int, C: FloatArray, G: FloatArray, a_y: FloatArray) -> None:
    """Effect of corrections on the rows, into C (R, M).

    G (N, M) receives their effect on the commands, a_y (2, N, M) that on the acceleration at the ends of steps and just
    after commands.
    """
    N, M = G.shape
    if M == N:
        for j in range(N):
            for k in range(j + 1):
                G[j, k] = mpc.impulse[i, j - k]
            for k in range(j + 1, M):
                G[j, k] = 0.0
    else:
        for b in range(M):
            for j in range(limits.start[b], limits.start[b + 1] if b + 1 < M else N):
                for k in range(M):
                    G[j, k] = mpc.moves[i, b, k]
    for b in range(M):
        for k in range(M):
            C[b, k] = G[limits.start[b], k]
            if b > 0:
                C[M + b - 1, k] = C[b, k] - C[b - 1, k]
    first_row = 2 * M - 1
    acceleration, jerk, offset = limits.scale
    response = mpc.response[i]
    if acceleration > 0.0 or jerk > 0.0:
        _respond(response[0], 1.0, G, a_y[0])
        _respond(response[1], 1.0, G, a_y[1])
    if acceleration > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                for k in range(M):
                    C[first_row + j, k] = acceleration * a_y[1 - side, j, k]
            first_row += N
    if jerk > 0.0:
        for side in range(2 - limits.sides, 2):
            for j in range(N):
                past = j + side - limits.window  # the sample, from that of the first command on
                for k in range(M):
                    change = a_y[1 - side, j, k]
                    if past >= 0 and limits.share > 0.0:
                        change -= (1.0 - limits.share) * a_y[1, past, k] + limits.share * a_y[0, past, k]
                    elif past >= side and limits.share == 0.0:
                        change -= a_y[1 - side, past - side, k]
                    C[first_row + j, k] = jerk * change
            first_row += N
    if offset > 0.0:
        _respond(response[2], offset, G, C[first_row : first_row + N])


@numba.njit(**OPTIONS)
def _respond(response: FloatArray, scale: float, G: FloatArray, out: FloatArray) -> None:
    """Rows of an output that answers to a command k steps before by response[k]."""
    N, M = G.shape
    if M == N:  # G holds an impulse response, and so does the product
        for j in range(N):
            total = 0.0
            for m in range(j + 1):
                total += scale * response[j - m] * G[m, 0]
            for k in range(N - j):
                out[j + k, k] = total
            for k in range(j + 1, M):
                out[j, k] = 0.0
        return
    for j in range(N):
        for k in range(M):
            out[j, k] = 0.0
        for m in range(j + 1):
            weight = scale * response[j - m]
            for k in range(M):
                out[j, k] += weight * G[m, k]


_PROVED: Final = 1e-10  # Largest violation of a condition by a guess that counts as the solution
_RELATIVE: Final = 1e-14  # The same as a share of the largest term, where multipliers are large
_MORE_CORRECTIONS: Final = 4  # A guess is corrected three times as often as there are moves, and this much more


@numba.njit(**OPTIONS)
def prove(
    limits: Limits,
    rows: Rows,
    side: IntArray,
    beyond: IntArray,
    w: FloatArray,
    multipliers: FloatArray,
    gram: FloatArray,
) -> bool:
    """Correct a guess until it proves itself; False if it does not within a limited number of rounds.

    With C_h the held rows, e = -C_h' m and (C_h C_h' + terms of slacks) m = y_h - bound, by Cholesky in `gram`. This
    is the solution if every multiplier m has the sign of its bound, every other row is inside, and the magnitudes of a
    soft kind sum to at most weight (s = 0), or to weight (1 + s). The row with the most wrong multiplier is let go, or
    else the row that is violated most is held.
    """
    C, y, low, high = rows
    R, M = C.shape
    held = np.empty(M + 3, dtype=np.int64)
    entered = np.zeros(R, dtype=np.int64)
    for _ in range(3 * M + _MORE_CORRECTIONS):
        count = 0
        for row in range(R):
            if side[row] != 0:
                if count == held.size:
                    return False
                held[count] = row
                count += 1
        dependent = _magnitudes(limits, rows, side, beyond, held[:count], gram)
        if dependent >= 0:
            side[dependent] = 0
            continue
        w[:] = 0.0
        multipliers[:] = 0.0
        proved = True
        sums, tolerance = np.zeros(3), _PROVED
        for refined in range(2):
            for a in range(count):
                row, magnitude = held[a], gram[a, -1]
                for k in range(M):
                    part = magnitude * C[row, k]
                    w[k] -= side[row] * part
                    tolerance = max(tolerance, _RELATIVE * abs(part))
                multipliers[row] += side[row] * magnitude
                if limits.group[row] >= 0:
                    sums[limits.group[row]] += magnitude
            if refined or tolerance == _PROVED:
                break
            # multipliers this large leave w inexact: once more, for the residual
            for a in range(count):
                row = held[a]
                residual, kind = y[row] - (high[row] if side[row] > 0 else low[row]), limits.group[row]
                for k in range(M):
                    residual += C[row, k] * w[k]
                slack = sums[kind] / limits.weight[kind] - 1.0 if kind >= 0 and beyond[kind] else 0.0
                gram[a, -1] = side[row] * residual - slack
            _substitute(gram, count)
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
            entered[worst_row] += 1
            if entered[worst_row] > 2:
                return False  # the corrections go in circles
        elif proved:
            return True
    return False


@numba.njit(**OPTIONS)
def _magnitudes(limits: Limits, rows: Rows, side: IntArray, beyond: IntArray, held: IntArray, gram: FloatArray) -> int:
    """Magnitudes of the held rows' multipliers into gram[:, -1], by Cholesky; -1, or a row that depends on others."""
    C, y, low, high = rows
    M, count = C.shape[1], held.size
    for a in range(count):
        row, kind = held[a], limits.group[held[a]]
        gram[a, -1] = y[row] - high[row] if side[row] > 0 else low[row] - y[row]
        if kind >= 0 and beyond[kind]:
            gram[a, -1] += 1.0
        for b in range(a + 1):
            other_row = held[b]
            total = 0.0
            for k in range(M):
                total += C[row, k] * C[other_row, k]
            total *= side[row] * side[other_row]
            if kind >= 0 and beyond[kind] and limits.group[other_row] == kind:
                total += 1.0 / limits.weight[kind]
            gram[a, b] = total
        diagonal = gram[a, a]
        for b in range(a + 1):
            total = gram[a, b]
            for k in range(b):
                total -= gram[a, k] * gram[b, k]
            if b < a:
                gram[a, b] = total / gram[b, b]
            else:
                if not total > 1e-12 * diagonal:
                    return row
                gram[a, a] = np.sqrt(total)
    _substitute(gram, count)
    return -1


@numba.njit(**OPTIONS)
def _substitute(gram: FloatArray, count: int) -> None:
    """Solve with the factor, for gram[:, -1] in place."""
    for a in range(count):
        total = gram[a, -1]
        for k in range(a):
            total -= gram[a, k] * gram[k, -1]
        gram[a, -1] = total / gram[a, a]
    for a in range(count - 1, -1, -1):
        total = gram[a, -1]
        for k in range(a + 1, count):
            total -= gram[k, a] * gram[k, -1]
        gram[a, -1] = total / gram[a, a]


@numba.njit(**OPTIONS)
def polish(limits: Limits, rows: Rows, w: FloatArray, multipliers: FloatArray) -> bool:
    """Replace a solver's solution by the exact one, if the rows that it holds at bounds prove to be right."""
    R, M = rows.C.shape
    side, beyond = np.empty(R, dtype=np.int64), np.empty(3, dtype=np.int64)
    gram, exact, exact_multipliers = np.empty((M + 3, M + 4)), np.empty(M + 3), np.empty(R)
    for row in range(R):
        side[row] = sign(multipliers[row]) if abs(multipliers[row]) > 1e-9 else 0
    for kind in range(3):
        beyond[kind] = 1 if w[M + kind] > 1e-6 else 0
    proved: bool = prove(limits, rows, side, beyond, exact, exact_multipliers, gram)
    if proved:
        w[:] = exact
        multipliers[:] = exact_multipliers
    return proved


@numba.njit(**OPTIONS)
def sign(number: float) -> int:
    return 1 if number > 0.0 else -1 if number < 0.0 else 0


FREE, HELD, OPEN, BEYOND = range(4)
"""Result of the sweep: no limit active, a guess proved itself, a solver is needed, infeasible."""


@numba.njit(**OPTIONS)
def plan(
    mpc: Condensed, i: int, x: FloatArray, r: FloatArray, U: FloatArray, work: FloatArray, costate: FloatArray
) -> None:
    """Optimal commands without limits into U (N,), from x (m,) and the lane's yaw rate r (N + 1,).

    work (N,) and costate (2, m) are scratch.
    """
    if x.size == 4:
        _plan(mpc, i, x, r, U, work, costate, 4)
    elif x.size == 5:
        _plan(mpc, i, x, r, U, work, costate, 5)
    elif x.size == 6:
        _plan(mpc, i, x, r, U, work, costate, 6)
    else:
        _plan(mpc, i, x, r, U, work, costate, x.size)


@numba.njit(forceinline=True, **OPTIONS)
def _plan(
    mpc: Condensed, i: int, x: FloatArray, r: FloatArray, U: FloatArray, work: FloatArray, costate: FloatArray, m: int
) -> None:
    N = U.size
    A, B, K, D, PD, back, x_ss = mpc.A_cl[i], mpc.B[i], mpc.K[i], mpc.D[i], mpc.PD[i], mpc.back[i], mpc.x_ss[i]
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
    half = 0.5 * mpc.delta_ss[i]
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
def block(mpc: Condensed, limits: Limits, i: int, U: FloatArray, work: FloatArray) -> None:
    """Replace the plan by the optimum with blocked moves, in place."""
    N, M = U.size, limits.start.size
    for b in range(M):
        total = 0.0
        for j in range(N):
            total += mpc.project[i, b, j] * U[j]
        work[b] = total
    for b in range(M):
        for j in range(limits.start[b], limits.start[b + 1] if b + 1 < M else N):
            U[j] = work[b]


@numba.njit(**OPTIONS)
def first(limits: Limits, rows: Rows, U_0: float, w: FloatArray) -> float:
    """First command of the corrected plan, not beyond its bounds by a solver's tolerance."""
    total = U_0
    for k in range(limits.start.size):
        total += rows.C[0, k] * w[k]
    return min(max(total, rows.low[0]), rows.high[0])


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


@numba.njit(cache=True, **OPTIONS)
def sweep(
    mpc: Condensed,
    limits: Limits,
    guess: bool,
    initial: InitialState,
    last: FloatArray,
    last_slack: FloatArray,
    U: FloatArray,
    delta: FloatArray,
    w: FloatArray,
    multipliers: FloatArray,
    result: npt.NDArray[np.int8],
) -> None:
    """One sample of every scenario: what can be proved without a solver, and which scenarios need one.

    `last` (n, R) and `last_slack` (n, 3) are multipliers and slacks one sample before; without `guess` every feasible
    scenario is left to the solver. Results are U (n, N), delta (n,), w (n, M + 3), multipliers (n, R) and result (n,).
    """
    n, N = U.shape
    X, prev, sent, r_all, past = initial
    M, R = limits.start.size, limits.group.size
    rows, work = Rows(np.empty((R, M)), np.empty(R), np.empty(R), np.empty(R)), np.empty(N)
    C, y, low, high = rows
    G, a_y, gram = np.empty((N, M)), np.empty((2, N, M)), np.empty((M + 3, M + 4))
    x, costate = np.empty(initial.x.shape[1]), np.empty((2, initial.x.shape[1]))
    lateral = np.empty((3, limits.window + limits.delay + N + x.size))
    side, beyond = np.empty(R, dtype=np.int64), np.empty(3, dtype=np.int64)
    for i in range(n):
        x[:] = X[i]
        if limits.window > 0:
            lateral[:2, : limits.window + 1] = past[i]
        if limits.delay > 0:
            decided(mpc, limits, i, x, sent[i], r_all[i], lateral)
        r = r_all[i, limits.delay :]
        plan(mpc, i, x, r, U[i], work, costate)
        if M < N:
            block(mpc, limits, i, U[i], work)
        delta[i] = U[i, 0]
        if not values(mpc, limits, i, x, r, prev[i], U[i], lateral, rows):
            result[i] = BEYOND
            continue
        if not guess:
            result[i] = OPEN
            _warm(limits, last[i], w[i], multipliers[i])
            continue
        inside = True
        for row in range(R):
            inside &= (y[row] <= high[row] + _INSIDE) & (y[row] >= low[row] - _INSIDE)
        if inside:
            result[i] = FREE
            delta[i] = min(max(delta[i], low[0]), high[0])
            continue
        matrix(mpc, limits, i, C, G, a_y)
        _shifted(limits, last[i], last_slack[i], side, beyond)
        if prove(limits, rows, side, beyond, w[i], multipliers[i], gram):
            result[i] = HELD
            delta[i] = first(limits, rows, U[i, 0], w[i])
        else:
            result[i] = OPEN
            _warm(limits, last[i], w[i], multipliers[i])


@numba.njit(cache=True, **OPTIONS)
def assemble(
    mpc: Condensed,
    limits: Limits,
    scenarios: IntArray,
    initial: InitialState,
    U: FloatArray,
    C: FloatArray,
    y: FloatArray,
    low: FloatArray,
    high: FloatArray,
) -> None:
    """The QPs of some scenarios (k,): C (k, R, M), y, low and high (k, R), from plans U (n, N)."""
    N, M = U.shape[1], limits.start.size
    X, prev, sent, r_all, past = initial
    G, a_y, x = np.empty((N, M)), np.empty((2, N, M)), np.empty(initial.x.shape[1])
    lateral = np.empty((3, limits.window + limits.delay + N + x.size))
    for k in range(scenarios.size):
        i = scenarios[k]
        x[:] = X[i]
        if limits.window > 0:
            lateral[:2, : limits.window + 1] = past[i]
        decided(mpc, limits, i, x, sent[i], r_all[i], lateral)
        rows = Rows(C[k], y[k], low[k], high[k])
        values(mpc, limits, i, x, r_all[i, limits.delay :], prev[i], U[i], lateral, rows)
        matrix(mpc, limits, i, C[k], G, a_y)


@numba.njit(cache=True, **OPTIONS)
def finish(limits: Limits, exact: bool, rows: Rows, w: FloatArray, multipliers: FloatArray) -> float:
    """First command of a solver's answer, which is polished in place if it should be exact."""
    if exact:
        polish(limits, rows, w, multipliers)
    return first(limits, rows, rows.y[0], w)
