"""Plans of linear-quadratic formulations, for all scenarios at once.

With linear dynamics, a quadratic cost and limits that no lane changes, the plan without limits is affine in what a
sample gives, s = (x, own states, commands on their way, lane yaw rates), and the Hessian of the QP is a constant of the
scenario. Both are worked out when a law is prepared, from the functions of `_nmpc_model` at s = 0 and at unit vectors.
A sample is then a few products for all scenarios, and only plans that break a limit are QPs. Sums are made term by
term: a scenario's command has the same bits in any company.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray

from ._nmpc_solver import Workspace, quadratic_program, reachable
from ._prediction_model import STATES

_INSIDE: Final = 1e-12  # the plan without limits counts as inside them up to this [rad, or units of a soft limit]


class Plans(NamedTuple):
    """Of n scenarios at one sample."""

    done: BoolArray  # (n,) Whether all that follows is a solution; the others are left to the SQP
    delta: FloatArray  # (n,) [rad] Commands
    U: FloatArray  # (n, N) [rad]
    iterations: IntArray  # (n,) QPs that were solved, 0 or 1
    past: FloatArray  # (n, 2, window) As in `PredictiveState`, for the next sample
    own: FloatArray  # (n, number of the class's states) The same


@dataclasses.dataclass(frozen=True)
class AffinePlans:
    """What is constant for each of n scenarios; M moves, R soft rows."""

    # (n, w) and (n, s, w) What s = 0 and units of s give: a_y now, at the start and the end of each sample before the
    # command acts, and with a command of 0; the class's states a sample later; moves; soft rows without history
    base: FloatArray
    slopes: FloatArray
    effect: FloatArray  # (n, 1 + own) Of the command on a_y with it, and on the class's states a sample later
    H: FloatArray  # (n, M, M) Hessian on the moves; NaN where it is not positive definite
    C: FloatArray  # (n, M + R, M) Changes of moves and soft rows, from moves
    low: FloatArray  # (n, 2 N + R) Limits of commands, of their changes and of the soft rows
    high: FloatArray
    weights: FloatArray  # (n, 2, R) Of the soft rows, linear and quadratic
    before: FloatArray  # (R, 2 window + 1) Soft rows from accelerations before, as in `_SoftRows`
    first: IntArray  # (M,) Sample at which each move begins
    delay: int

    def take(self, rows: IntArray) -> AffinePlans:
        """Some of the scenarios."""
        names = ("base", "slopes", "effect", "H", "C", "low", "high", "weights")
        return dataclasses.replace(self, **{name: getattr(self, name)[rows] for name in names})

    def solve(self, s: FloatArray, past: FloatArray, delta_prev: FloatArray) -> Plans:
        """Plans from s (n, .), accelerations before, NaN for none, and the command before."""
        out = self.base.copy()
        for j in range(s.shape[1]):
            out += self.slopes[:, j] * s[:, j : j + 1]
        R, (M,), own = len(self.before), self.first.shape, self.effect.shape[1] - 1
        N, k = (self.low.shape[1] - R) // 2, self.delay
        a, with_zero, moves, soft = np.split(out, np.cumsum([1 + 2 * k, 1 + own, M]), axis=1)

        # accelerations just before and after each command: of the last samples, of now, of those on their way
        window, now = past.shape[2], a[:, :1]
        past = np.where(np.isnan(past), now[:, :, None], past)
        ends, starts = np.column_stack([past[:, 0], now, a[:, 2::2]]), np.column_stack([past[:, 1], a[:, 1::2], now])
        past = np.stack([ends[:, 1 : window + 1], starts[:, 1 : window + 1]], axis=1)
        history = np.column_stack([ends[:, k:], starts[:, k:-1]])
        for j in np.flatnonzero(self.before.any(axis=0)).tolist():
            soft += self.before[:, j] * history[:, j : j + 1]

        U = moves[:, np.searchsorted(self.first, np.arange(N), side="right") - 1]
        values = np.column_stack([U, np.diff(U, axis=1, prepend=delta_prev[:, None]), soft])
        low, high = self.low.copy(), self.high.copy()
        changes = low[:, N : 2 * N], high[:, N : 2 * N]
        low[:, :N], high[:, :N], beyond = reachable(low[:, :N], high[:, :N], *changes, delta_prev)
        outside: BoolArray = np.any((values < low - _INSIDE) | (values > high + _INSIDE), axis=1)
        done: BoolArray = np.isfinite(out).all(axis=1) & np.isfinite(self.H[:, 0, 0]) & ~(outside & beyond)
        rows = np.flatnonzero(outside & done)
        bounds = []
        for room, tightest in ((low[rows] - values[rows], np.maximum), (high[rows] - values[rows], np.minimum)):
            angles = tightest.reduceat(room[:, :N], self.first, axis=1)
            bounds.append(np.column_stack([angles, room[:, N + self.first], room[:, 2 * N :]]))
        zero = np.zeros(M)
        for i, down, up in zip(rows, *bounds, strict=True):
            weights = self.weights[i] if R else None
            correction, _ = quadratic_program(self.H[i], zero, self.C[i], down, up, weights)
            if correction is None:
                done[i] = False
            else:
                U[i] += np.repeat(correction, np.diff(self.first, append=N))
        delta = np.clip(U[:, 0], low[:, 0], high[:, 0])
        # a sum with 0 turns -0 into 0
        delta = np.clip(delta, delta_prev + low[:, N], delta_prev + high[:, N]) + 0.0
        if not k:
            with_zero += self.effect * delta[:, None]
            past[:, 1, -1] = with_zero[:, 0]
        return Plans(done, delta, U, outside.astype(np.int64), past, with_zero[:, 1:])


def affine_plans(
    work: Workspace, columns: FloatArray, samples: Callable[[FloatArray], FloatArray], delay: int, rows: FloatArray,
    before: FloatArray,
) -> AffinePlans:  # fmt: skip
    """The plans of scenarios with these columns; `samples` gives their lanes, `rows` and `before` the soft rows."""
    n, N, M, R, own = len(columns), work.N, work.first.size, len(rows), len(work.form.own)
    nx, head, ahead = len(STATES) + own, 2 * delay + 2 + own, delay + N + 1
    units = np.eye(nx + delay + 1 + ahead + 1)[:, 1:]  # the first row is s = 0
    lanes = [samples(np.tile(r, (n, 1))) for r in units[[0, *range(-ahead, 0)], -ahead:]]
    out, effect, H = np.zeros((n, len(units), head + M + R)), np.empty((n, 1 + own)), np.full((n, M, M), np.nan)
    C, limits = np.empty((n, M + R, M)), np.empty((n, 2, 2 * N + R))
    C[:, :M], weights = np.diff(np.eye(M), axis=0, prepend=0.0), np.empty((n, 2, R))
    g = np.empty((len(units), N))
    for i in range(n):
        work.c[:], work.P[:] = columns[i], lanes[0][i, delay:]
        bounds = [part.ravel() for part in work.limits()]
        limits[i] = [np.concatenate(bounds[side:6:2]) for side in (0, 1)]
        weights[i] = bounds[6:]
        curved, Y = work.curvature()
        curved, C[i, M:] = work.held.T @ curved @ work.held, rows @ Y @ work.held
        for j, unit in enumerate(units):
            lane = lanes[max(j + len(lanes) - len(units), 0)][i]
            out[i, j, :head] = _until_it_acts(work, unit[:nx], unit[nx : nx + delay + 1], lane)
            work.P[:] = lane[delay:]
            g[j], y = work.unsteered()
            out[i, j, head + M :] = rows @ y
        work.z_0[:] = 0.0
        z, a_0, _ = work.predict(1.0, lanes[0][i, 0])
        effect[i] = np.append(a_0, z[len(STATES) : nx]) - out[i, 0, head - own - 1 : head]
        try:
            np.linalg.cholesky(curved)
        except np.linalg.LinAlgError:
            continue
        H[i] = curved
        moves = -np.linalg.solve(curved, work.held.T @ g.T)
        out[i, :, head : head + M] = moves.T
        out[i, :, head + M :] += (C[i, M:] @ moves).T
    within = np.setdiff1d(np.arange(N), work.first)  # a move
    limits[:, 0, N + within], limits[:, 1, N + within] = -np.inf, np.inf
    slopes, (low, high) = out[:, 1:] - out[:, :1], limits.transpose(1, 0, 2)
    return AffinePlans(out[:, 0], slopes, effect, H, C, low, high, weights, before, work.first, delay)


def _until_it_acts(work: Workspace, x: FloatArray, sent: FloatArray, lane: FloatArray) -> FloatArray:
    """Take the workspace's state to where the command acts; the first numbers of `AffinePlans.base`."""
    work.z_0[:] = np.concatenate([x, sent[:1]])[: work.form.size]
    a, own, at_zero = [work.predict(sent[0], lane[0])[1]], x[len(STATES) :], 0.0
    for k, u in enumerate(sent[1:]):
        z, a_0, a_1 = work.predict(u, lane[k])
        a += [a_0, a_1]
        work.z_0[:] = z
        if k == 0:
            own = z[len(STATES) : x.size].copy()
    if sent.size == 1:
        z, at_zero, _ = work.predict(0.0, lane[0])
        own = z[len(STATES) : x.size]
    return np.concatenate([a, [at_zero], own])
