"""What `linear_mpc` works out once for every scenario: the plan without limits, and what commands do to its rows.

Everything is per scenario, vectorised over the n speeds. The plan is kept as its two recursions (backwards over the
horizon for the feedforward, forwards for the state), not as a matrix: that is less to store and less to multiply.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from controllers.riccati import Weights, regulator
from ldctoolkit import Plant

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

SOFT: tuple[str, ...] = ("a_y", "jerk", "e_y")
"""Kinds of soft limits, in the order of their rows."""


class Condensed(NamedTuple):
    """The MPC of n scenarios, horizon N, M free moves; z is the deviation from steady cornering."""

    A_cl: FloatArray
    """(n, 4, 4) closed loop A - B K."""
    B: FloatArray
    """(n, 4)"""
    K: FloatArray
    """(n, 4) LQR gain."""
    D: FloatArray
    """(n, 4) what a change of the lane's yaw rate over a step does to z."""
    PD: FloatArray
    """(n, 4) P D."""
    back: FloatArray
    """(n, 4) -B / s: from the costate to the feedforward."""
    e_psi: FloatArray
    """(n,) steady heading error per unit of lane yaw rate."""
    delta_ss: FloatArray
    """(n,) steady steering angle per unit of lane yaw rate."""
    impulse: FloatArray
    """(n, N) commands that follow from a unit correction now, under the LQR."""
    project: FloatArray
    """(n, M, N) moves of the blocked optimum, from the plan; (n, 0, 0) without blocks."""
    moves: FloatArray
    """(n, M, M) moves from corrections; (n, 0, 0) without blocks."""
    A: FloatArray
    """(n, 4, 4) of the plant."""
    E_0: FloatArray
    """(n, 4)"""
    E_1: FloatArray
    """(n, 4)"""
    a_y: FloatArray
    """(n, 6) lateral acceleration from (x, delta, lane yaw rate)."""
    response: FloatArray
    """(n, 3, N) of a_y just after the command, a_y at the end of the step and e_y there, k steps after a unit command
    held for one sample; (n, 0, 0) without soft limits."""

    def take(self, rows: IntArray) -> Condensed:
        """Some of the scenarios."""
        return Condensed(*(each[rows] for each in self))


class Limits(NamedTuple):
    """The rows of the QP, the same for every scenario: R = 2 M - 1 hard ones, then the soft ones."""

    dt: float
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
    """(3,) 1 / limit of each kind of soft limit; 0 where there is none."""
    weight: float
    """Of the slacks, linear and quadratic."""


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What the design says, gains checked."""

    horizon: int
    weights: Weights
    r_delta: float
    delta_max: float
    rate_max: float
    soft_limits: tuple[float, float, float]
    """a_y [m/s^2], jerk [m/s^3], e_y [m]; 0 for none."""
    soft_weight: float
    blocks: int


def block_starts(horizon: int, blocks: int) -> IntArray:
    """First sample of each free move: one sample each at first, then longer and longer, as even as whole samples allow.

    Parameters
    ----------
    horizon : int
        N.
    blocks : int
        Number of free moves; 0, or N and more, for one a sample.

    Examples
    --------
    >>> block_starts(20, 6).tolist()
    [0, 1, 2, 5, 9, 14]
    """
    if not 0 < blocks < horizon:
        return np.arange(horizon)
    # quadratic growth, never less than one sample a move
    ideal = horizon * (np.arange(blocks) / blocks) ** 2
    return np.maximum(np.round(ideal).astype(np.int64), np.arange(blocks))


def limits(wanted: Wanted, dt: float) -> Limits:
    """The rows of the QP."""
    start = block_starts(wanted.horizon, wanted.blocks)
    M, N = start.size, wanted.horizon
    scale = np.array([1.0 / limit if limit > 0 else 0.0 for limit in wanted.soft_limits])
    sizes = np.where(scale > 0, [2 * N, N, N], 0)
    group = np.concatenate([np.full(2 * M - 1, -1), np.repeat(np.arange(3), sizes)])
    shift = np.arange(group.size)
    if M == N:  # rows of a sample each: what was one sample ahead is here now
        parts = [(0, M), (M, M - 1)]
        at = 2 * M - 1
        for size in (N, N, N, N) if scale[0] > 0 else (0, 0, N, N):
            present = size if at < group.size else 0
            parts.append((at, present))
            at += present
        for first, size in parts:
            shift[first : first + size] = first + np.minimum(np.arange(size) + 1, size - 1)
    return Limits(dt, wanted.delta_max, wanted.rate_max * dt, start, group, shift, scale, wanted.soft_weight)


def condense(plant: Plant, wanted: Wanted) -> Condensed:
    """Solve the Riccati equation and work out the responses, for every scenario's speed.

    Parameters
    ----------
    plant : Plant
        n speeds.
    wanted : Wanted

    Returns
    -------
    Condensed

    Raises
    ------
    InputError
        For a speed without scheduled gains.
    LdcError
        If the Riccati equation has no stabilising solution.
    """
    lq = regulator(plant, wanted.weights, wanted.r_delta)
    n, N, K = plant.n, wanted.horizon, lq.K
    A, B = plant.step.A, plant.step.B
    steady = plant.steady_state()
    x_ss = np.zeros((n, 4))
    x_ss[:, 2] = steady.e_psi
    # a change of lane yaw rate over one step pushes the deviation from steady cornering by D
    D = 0.5 * B * steady.delta[:, None] + plant.step.E_1 - x_ss
    s = wanted.r_delta + np.sum(B * _apply(lq.P, B), axis=1)
    A_cl = A - B[:, :, None] * K[:, None, :]

    impulse = np.ones((n, N))
    forward = B
    for k in range(1, N):
        impulse[:, k] = -np.sum(K * forward, axis=1)
        forward = _apply(A_cl, forward)

    A_c, B_c, E_c = plant.model.matrices(plant.v)
    a_y = np.column_stack([A_c[:, 1], B_c[:, 1], E_c[:, 1] + plant.v])
    nothing = np.zeros((n, 0, 0))
    project, moves = nothing, nothing
    start = block_starts(N, wanted.blocks)
    if start.size < N:
        project, moves = _blocked(A, B, K, start, N)
    condensed = Condensed(
        A_cl=A_cl,
        B=B,
        K=K,
        D=D,
        PD=_apply(lq.P, D),
        back=-B / s[:, None],
        e_psi=steady.e_psi,
        delta_ss=steady.delta,
        impulse=impulse,
        project=project,
        moves=moves,
        A=A,
        E_0=plant.step.E_0,
        E_1=plant.step.E_1,
        a_y=a_y,
        response=_responses(A, B, a_y, N) if any(wanted.soft_limits) else nothing,
    )
    # laid out as after `take`: the compiled sweep need not be compiled for two layouts
    return Condensed(*(np.ascontiguousarray(each) for each in condensed))


def _responses(A: FloatArray, B: FloatArray, a_y: FloatArray, N: int) -> FloatArray:
    """What a unit command, held for one sample, does to a_y (right after, and at the end of each step) and to e_y."""
    response = np.zeros((B.shape[0], 3, N))
    response[:, 0, 0] = a_y[:, 4]
    forward = B
    for k in range(N):
        at_end = np.sum(a_y[:, :4] * forward, axis=1)
        response[:, 1, k] = at_end + (a_y[:, 4] if k == 0 else 0.0)
        response[:, 2, k] = forward[:, 0]
        if k + 1 < N:
            response[:, 0, k + 1] = at_end
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
