"""What `linear_mpc` works out once for every scenario: the plan without limits, and what commands do to its rows.

Everything is per scenario, vectorised over the n speeds. The plan is kept as its two recursions (backwards over the
horizon for the feedforward, forwards for the state), not as a matrix: that is less to store and less to multiply.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.declared import gain
from ldctoolkit.vehicle.bicycle import Plant

from .riccati import Horizon, QuadraticCost, in_time, regulator

SOFT: tuple[str, ...] = ("a_y", "jerk", "e_y")  # kinds of soft limits, in the order of their rows

SHARES = np.array([1.0, 30.0, 1.0])
"""Of the weight of slacks, of each kind: where a takeover leaves no way to keep all, the jerk comes first."""

WINDOW = 0.5  # time [s] over which ISO 11270 averages jerk


class Condensed(NamedTuple):
    """The MPC of n scenarios, horizon N, M free moves, m states; z is the deviation from steady cornering."""

    A_cl: FloatArray
    """(n, m, m) closed loop A - B K."""
    B: FloatArray
    """(n, m)"""
    K: FloatArray
    """(n, m) LQR gain."""
    D: FloatArray
    """(n, m) what a change of the lane's yaw rate over a step does to z."""
    PD: FloatArray
    """(n, m) P D."""
    back: FloatArray
    """(n, m) -B / s: from the costate to the feedforward."""
    x_ss: FloatArray
    """(n, m) steady state per unit of lane yaw rate."""
    delta_ss: FloatArray
    """(n,) steady steering angle per unit of lane yaw rate."""
    impulse: FloatArray
    """(n, N) commands that follow from a unit correction now, under the LQR."""
    project: FloatArray
    """(n, M, N) moves of the blocked optimum, from the plan; (n, 0, 0) without blocks."""
    moves: FloatArray
    """(n, M, M) moves from corrections; (n, 0, 0) without blocks."""
    A: FloatArray
    """(n, m, m) of the plant."""
    E_0: FloatArray
    """(n, m)"""
    E_1: FloatArray
    """(n, m)"""
    a: FloatArray
    """(n, m + 2) lateral acceleration less that of the lane, from (x, command, lane yaw rate)."""
    response: FloatArray
    """(n, 3, N) of a at the end of the step, a just after the command and e_y at the end of the step, k steps after a
    unit command held for one sample; (n, 0, 0) without soft limits."""

    def take(self, rows: IntArray) -> Condensed:
        """Some of the scenarios."""
        return Condensed(*(each[rows] for each in self))


class InitialState(NamedTuple):
    """What a sample gives to the QPs of n scenarios."""

    x: FloatArray
    """(n, m) state now."""
    prev: FloatArray
    """(n,) command before [rad]."""
    sent: FloatArray
    """(n, delay + 1) commands up to it, of which all but the first are still to arrive [rad]."""
    r: FloatArray
    """(n, delay + N + 1) yaw rate of the lane [rad/s]."""
    past: FloatArray
    """(n, 2, window + 1) a before and after each of the last samples, the first of now is the last; (n, 2, 0) without a
    limit on jerk."""


class Limits(NamedTuple):
    """The rows of the QP, the same for every scenario: R = 2 M - 1 hard ones, then the soft ones."""

    delay: int
    """Samples until a command arrives, whole ones."""
    window: int
    """Samples over which jerk is averaged, rounded up; 0 without a limit on jerk."""
    share: float
    """By how much that is rounded up."""
    sides: int
    """2 where a jumps with the command, else 1."""
    delta_max: float
    rate_step: float
    """Largest change of the command from one sample to the next [rad]."""
    start: IntArray
    """(M,) sample at which each free move begins."""
    group: IntArray
    """(R,) -1 for a hard row, else the place of its kind in `SOFT`."""
    shift: IntArray
    """(R,) the row that stood in this row's place one sample before."""
    scale: FloatArray
    """(3,) 1 / limit of each kind of soft limit, of a change of a for the jerk; 0 where there is none."""
    weight: FloatArray
    """(3,) of the slacks, linear and quadratic."""


@dataclasses.dataclass(frozen=True)
class MPCDesign(QuadraticCost, Horizon):
    """Gains that both MPCs have."""

    delta_max: float = gain(0.1, unit="rad", lower=1e-3, upper=1.0, description="limit of the steering angle")
    rate_max: float = gain(0.2, unit="rad/s", lower=1e-3, upper=10.0, description="limit of the steering rate")
    a_y_max: float = gain(0.0, unit="m/s^2", lower=0.0, upper=20.0, description="soft limit of |a_y|; 0 for none")
    jerk_max: float = gain(0.0, unit="m/s^3", lower=0.0, upper=1000.0, description="soft limit of jerk; 0 for none")
    e_y_max: float = gain(0.0, unit="m", lower=0.0, upper=20.0, description="soft limit of |e_y|; 0 for none")

    @property
    def soft_limits(self) -> tuple[float, float, float]:
        """a_y [m/s^2], its mean change [m/s^3], e_y [m], in the order of `SOFT`; 0 for none."""
        return self.a_y_max, self.jerk_max, self.e_y_max


def block_starts(horizon: int, blocks: int) -> IntArray:
    """First sample of each free move: one sample each at first, then longer and longer, as even as whole samples
    allow.
    """
    if not 0 < blocks < horizon:
        return np.arange(horizon)
    # quadratic growth, never less than one sample a move
    ideal = horizon * (np.arange(blocks) / blocks) ** 2
    return np.maximum(np.round(ideal).astype(np.int64), np.arange(blocks))


def jerk_window(dt: float) -> tuple[int, float]:
    """Samples over which jerk is averaged, rounded up, and by how much."""
    window = int(np.ceil(WINDOW / dt - 1e-7))
    share = window - WINDOW / dt
    return window, share if share > 1e-7 else 0.0


def limits(plant: Plant, design: MPCDesign, blocks: int, soft_weight: float) -> Limits:
    """The rows of the QP."""
    start = block_starts(design.horizon, blocks)
    M, N, dt = start.size, design.horizon, plant.dt
    scale = np.array([1.0 / limit if limit > 0 else 0.0 for limit in design.soft_limits])
    scale[1] /= WINDOW
    delay, sides = plant.augmented.whole, 1 if plant.lag > 0 or plant.augmented.split else 2
    sizes = np.where(scale > 0, [sides * N, sides * N, N], 0)
    group = np.concatenate([np.full(2 * M - 1, -1), np.repeat(np.arange(3), sizes)])
    shift = np.arange(group.size)
    if M == N:  # rows of a sample each: the row of one sample later moves up
        for first in [0, *range(2 * M - 1, group.size, N)]:
            shift[first : first + N] = first + np.minimum(np.arange(N) + 1, N - 1)
        shift[M : 2 * M - 1] = M + np.minimum(np.arange(M - 1) + 1, M - 2)
    window, share = jerk_window(dt) if scale[1] else (0, 0.0)
    step = design.rate_max * dt
    return Limits(delay, window, share, sides, design.delta_max, step, start, group, shift, scale, soft_weight * SHARES)


def condense(plant: Plant, design: MPCDesign, blocks: int) -> Condensed:
    """Solve the Riccati equation and work out the responses, for every scenario's speed."""
    n, N = plant.n, design.horizon
    lq = regulator(plant, design.q, design.r_delta, actuator=True)
    K, P = lq.K, lq.P
    A, B, E_0, E_1 = in_time(plant)
    m = B.shape[1]
    steady = plant.steady_state()
    x_ss = np.zeros((n, m))
    x_ss[:, 2], x_ss[:, 4:] = steady.e_psi, steady.delta[:, None]
    # a change of lane yaw rate over one step pushes the deviation from steady cornering by D
    D = 0.5 * B * steady.delta[:, None] + E_1 - x_ss
    s = design.r_delta + np.sum(B * _apply(P, B), axis=1)
    A_cl = A - B[:, :, None] * K[:, None, :]

    impulse = np.ones((n, N))
    forward = B
    for k in range(1, N):
        impulse[:, k] = -np.sum(K * forward, axis=1)
        forward = _apply(A_cl, forward)

    A_c, B_c, E_c = plant.model.matrices(plant.v)
    # the wheel is the command, or the fifth state
    wheel = np.zeros((n, m - 3))
    wheel[:, 0] = B_c[:, 1]
    a = np.column_stack([A_c[:, 1], wheel, E_c[:, 1]])
    nothing = np.zeros((n, 0, 0))
    project, moves = nothing, nothing
    start = block_starts(N, blocks)
    if start.size < N:
        project, moves = _blocked(A, B, K, start, N)
    condensed = Condensed(
        A_cl=A_cl,
        B=B,
        K=K,
        D=D,
        PD=_apply(P, D),
        back=-B / s[:, None],
        x_ss=x_ss,
        delta_ss=steady.delta,
        impulse=impulse,
        project=project,
        moves=moves,
        A=A,
        E_0=E_0,
        E_1=E_1,
        a=a,
        response=_responses(A, B, a, N) if any(design.soft_limits) else nothing,
    )
    # laid out as after `take`: the compiled sweep need not be compiled for two layouts
    return Condensed(*(np.ascontiguousarray(each) for each in condensed))


def _responses(A: FloatArray, B: FloatArray, a: FloatArray, N: int) -> FloatArray:
    """What a unit command, held for one sample, does to a (at the end of each step, and right after) and to e_y."""
    response, m = np.zeros((B.shape[0], 3, N)), B.shape[1]
    response[:, 1, 0] = a[:, m]
    forward = B
    for k in range(N):
        at_end = np.sum(a[:, :m] * forward, axis=1)
        response[:, 0, k] = at_end + (a[:, m] if k == 0 else 0.0)
        response[:, 2, k] = forward[:, 0]
        if k + 1 < N:
            response[:, 1, k + 1] = at_end
        forward = _apply(A, forward)
    return response


def _blocked(A: FloatArray, B: FloatArray, K: FloatArray, start: IntArray, N: int) -> tuple[FloatArray, FloatArray]:
    """Moves of the blocked optimum from the plan (n, M, N), and moves from corrections with unit Hessian (n, M, M)."""
    n, M = B.shape[0], start.size
    back = np.ones((n, N))  # the corrections that a unit command, held for one sample, stands for
    forward = B
    for k in range(1, N):
        back[:, k] = np.sum(K * forward, axis=1)
        forward = _apply(A, forward)
    toeplitz = np.zeros((n, N, N))
    for k in range(N):
        j = np.arange(k, N)
        toeplitz[:, j, j - k] = back[:, k, None]
    held = np.zeros((N, M))
    held[np.arange(N), np.searchsorted(start, np.arange(N), side="right") - 1] = 1.0
    # cost |back (held theta - U)|^2 / 2 = |R (theta - theta*)|^2 / 2 + constant
    Q, R = np.linalg.qr(toeplitz @ held)
    inverse = np.linalg.inv(R)
    return inverse @ Q.transpose(0, 2, 1) @ toeplitz, inverse


def _apply(M: FloatArray, x: FloatArray) -> FloatArray:
    """M x for a stack of matrices (n, 4, 4) and vectors (n, 4)."""
    product: FloatArray = np.einsum("nij,nj->ni", M, x)
    return product


def lookahead(samples: int, dt: float, age: float) -> FloatArray:
    """Lookahead times for `lane`."""
    times = np.arange(samples + 1) * dt - age
    return np.asarray([0.0, dt, *np.maximum(times, 0.0)] if age else times, dtype=np.float64)


def lane(r: FloatArray, dt: float, age: float) -> FloatArray:
    """Yaw rate of the lane (n, samples + 1) from the moment on that the law sees, by a straight line before now."""
    if not age:
        return r
    behind = np.minimum(np.arange(r.shape[1] - 2) - age / dt, 0.0)
    result: FloatArray = r[:, 2:] + behind * (r[:, 1:2] - r[:, :1])
    return result
