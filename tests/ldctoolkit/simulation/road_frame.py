"""An independent closed loop for tests: one departure in the road frame, integrated by scipy between samples.

Written from the paper's definitions in ISO 8855 road coordinates (right departures are negative there), with nothing
shared with the package but the law's formula: plant from literal matrices, start state from derivatives by hand,
|e_y| integrated to 1e-12 with every change of sign located.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

W_L, W_V = 3.6, 1.9
CAF = CAR = 80000.0
LF, LR, M, IZ = 1.43, 1.47, 1000.0, 3344.0

Law = Callable[[float, np.ndarray, Callable[[float], float], Callable[[float, float], float]], float]


def matrices(v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    A = np.array(
        [
            [0, 1, 0, 0],
            [0, -(2 * CAF + 2 * CAR) / (M * v), (2 * CAF + 2 * CAR) / M, -(2 * CAF * LF - 2 * CAR * LR) / (M * v)],
            [0, 0, 0, 1],
            [
                0,
                -(2 * CAF * LF - 2 * CAR * LR) / (IZ * v),
                (2 * CAF * LF - 2 * CAR * LR) / IZ,
                -(2 * CAF * LF**2 + 2 * CAR * LR**2) / (IZ * v),
            ],
        ]
    )
    B = np.array([0, 2 * CAF / M, 0, 2 * CAF * LF / IZ])
    E = np.array([0, -(2 * CAF * LF - 2 * CAR * LR) / (M * v) - v, 0, -(2 * CAF * LF**2 + 2 * CAR * LR**2) / (IZ * v)])
    return A, B, E


def drive(
    *,
    side: int,
    T: float,
    d_y: float,
    v_mean: float,
    a_mean: float,
    c_0: float,
    dc: float,
    law: Law,
    y_s: float,
    dt: float,
) -> tuple[float, float, np.ndarray, float]:
    """Return (S over [0, T], S uncorrected, final state in the road frame, trigger time).

    `c_0` and `dc` are in the road frame here: positive to the left, whatever the side.
    """
    d_x = v_mean * T

    def x(t: float) -> float:
        return v_mean * t + a_mean * (t**2 - T * t) / 2

    def v(t: float) -> float:
        return v_mean + a_mean * (t - T / 2)

    def y(t: float) -> float:
        return -4 * d_y / d_x**2 * (x(t) - d_x / 2) ** 2 + d_y

    def e_recorded(t: float) -> float:
        return side * (y(t) + (W_L - W_V) / 2)

    S_recorded, _ = quad(lambda t: abs(e_recorded(t)), 0, T, epsabs=1e-13)
    t_peak = brentq(lambda t: x(t) - d_x / 2, 0, T, xtol=1e-14)
    if y(t_peak) <= y_s:
        return S_recorded, S_recorded, np.full(4, np.nan), np.inf
    t_s = brentq(lambda t: y(t) - y_s, 0, t_peak, xtol=1e-15, rtol=1e-14) if y_s > 0 else 0.0
    S, _ = quad(lambda t: abs(e_recorded(t)), 0, t_s, epsabs=1e-13)

    v_s = v(t_s)
    slope = -8 * d_y / d_x**2 * (x(t_s) - d_x / 2)
    y_rate = slope * v_s
    y_acceleration = -8 * d_y / d_x**2 * v_s**2 + slope * a_mean
    state = side * np.array([y_s + (W_L - W_V) / 2, y_rate, np.arctan(y_rate / v_s), y_acceleration / v_s])
    A, B, E = matrices(v_s)

    def yaw_rate(t: float) -> float:
        return v_s * (c_0 + dc * min(t, T) / T)

    def heading(t_0: float, t_1: float) -> float:
        kink = [T] if t_0 < T < t_1 else None
        return quad(yaw_rate, t_0, t_1, epsabs=1e-14, points=kink)[0] if t_1 > t_0 else 0.0

    t = t_s
    while t < T - 1e-12:
        end = min(t + dt, T)
        delta = law(t, state, yaw_rate, heading)
        path = solve_ivp(
            lambda s, z, delta=delta: A @ z + B * delta + E * yaw_rate(s),
            (t, end), state, method="DOP853", rtol=1e-13, atol=1e-14, dense_output=True, max_step=(end - t) / 4,
        )  # fmt: skip
        grid = np.linspace(t, end, 41)
        e = path.sol(grid)[0]
        changes = np.flatnonzero(e[:-1] * e[1:] < 0)
        kinks = [brentq(lambda s, path=path: path.sol(s)[0], grid[i], grid[i + 1], xtol=1e-15) for i in changes]
        edges = [t, *kinks, end]
        for low, high in itertools.pairwise(edges):
            nodes, weights = np.polynomial.legendre.leggauss(16)
            s = 0.5 * (high - low) * nodes + 0.5 * (high + low)
            S += 0.5 * (high - low) * float(weights @ np.abs(path.sol(s)[0]))
        state, t = path.y[:, -1], end
    return S, S_recorded, state, t_s
