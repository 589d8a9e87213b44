"""Sequential quadratic programming for one nonlinear MPC problem at a time.

Unknowns are the commands U = (u_0 .. u_(N-1)) and, by multiple shooting, the states X = (x_1 .. x_N); the gaps
d_j = F(x_j, u_j) - x_(j+1) are zero at the solution. `Program` holds CasADi functions for a horizon N with all numbers
as inputs, written with maps over the samples, so that the C code does not grow with N.

Each iteration condenses the linearised problem to the N commands (`linearise` of the program) and solves the QP with
DAQP. The Hessian is that of the Lagrangian; where the QP is then not convex, Gauss-Newton's. A full step of
commands and states is taken if it lowers the merit function J + soft penalties + nu sum |gaps|; if not, the gaps are
closed by driving the model with a shortened step of the commands, until the merit falls. Hard limits are linear in
the commands, so that every iterate meets them.
"""

import contextlib
import dataclasses
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import InputError
from ldctoolkit.surroundings import cache_folder, private
from ldctoolkit.vehicle.bicycle import Plant

# ------------------------------------------------------------------------------------------------ the model
#
# The prediction model of the nonlinear MPC in CasADi: one sample of the nonlinear bicycle, and steady cornering.
#
# The bicycle is that of the closed loop on saturating tyres (Rajamani, *Vehicle Dynamics and Control*, 2.3, with the
# Magic Formula of Pacejka) at constant speed. A sample is a step of the third-order exponential Runge-Kutta method
# ETD3RK (S. Cox, P. Matthews, *Exponential time differencing for stiff systems*, J. Comp. Phys. 176, 2002) about
# straight driving: with f = A x + B delta + E r + g, and l(x), l_h(x) the exact linear plant after dt and dt/2,
#
#     g_0 = g(x, r_0),  a = l_h(x) + H_1 g_0,  g_a = g(a, r_h),  b = l(x) + G_1 (2 g_a - g_0),  g_b = g(b, r_1)
#     x+  = l(x) + G_1 g_0 + G_2 (4 g_a - 3 g_0 - g_b) + G_3 (4 g_0 - 8 g_a + 4 g_b),
#
# G_1, G_2, G_3 the responses to accelerations 1, s and s^2/2 of s = t/dt. So what is linear is exact, as in the linear
# plant, and stiffness at low speed is no trouble. Only the accelerations have a part g that is not linear.

SHAPE: Final = 1.3  # Pacejka's C of the tyres that the law believes in

GRAVITY: Final = 9.81
_SATURATED: Final = 0.95  # steady cornering is held up to this share of the tyres' peak force
_TURNED: Final = 0.97  # and the front tyres, turned by delta, up to this

# numbers of one scenario that CasADi's functions take as one column, in this order
LAYOUT: Final = {
    "vehicle": 8, "v": 1, "linear": 10, "A": 16, "B": 4, "E_0": 4, "E_1": 4,
    "A_h": 16, "B_h": 4, "E_0h": 4, "E_1h": 4, "H_1": 8, "G_1": 8, "G_2": 8, "G_3": 8,
    "q": 4, "r_delta": 1, "P": 16, "K": 4, "rate_step": 1,
}  # fmt: skip
SIZE: Final = sum(LAYOUT.values())


def unpack(column: Any) -> dict[str, Any]:
    """Named parts of a column of `LAYOUT`."""
    parts, start = {}, 0
    for name, size in LAYOUT.items():
        parts[name] = column[start : start + size]
        start += size
    return parts


def pack(plant: Plant, mu: float, q: tuple[float, ...], r_delta: float, P: Any, K: Any, rate_step: float) -> FloatArray:
    """Columns of `LAYOUT` for every scenario of a plant."""
    n, p = plant.n, plant.model.parameters
    A, B, E = plant.model.matrices(plant.v)
    G_1, G_2, G_3 = _forced(A, plant.dt)
    step, half = plant.step, plant.model.discretize(plant.v, 0.5 * plant.dt)
    vehicle = np.array([p.C_af, p.C_ar, p.l_f, p.l_r, p.m, p.I_z, mu, SHAPE])
    linear = np.concatenate([A[:, 1, 1:], A[:, 3, 1:], B[:, (1, 3)], E[:, (1, 3)]], axis=1)
    parts = {
        "vehicle": np.tile(vehicle, (n, 1)), "v": plant.v[:, None], "linear": linear,
        "A": _by_column(step.A), "B": step.B, "E_0": step.E_0, "E_1": step.E_1,
        "A_h": _by_column(half.A), "B_h": half.B, "E_0h": half.E_0, "E_1h": half.E_1,
        "H_1": _by_column(_forced(A, 0.5 * plant.dt)[0]),
        "G_1": _by_column(G_1), "G_2": _by_column(G_2), "G_3": _by_column(G_3),
        "q": np.tile(q, (n, 1)), "r_delta": np.full((n, 1), r_delta),
        "P": _by_column(P), "K": K, "rate_step": np.full((n, 1), rate_step),
    }  # fmt: skip
    return np.ascontiguousarray(np.concatenate([parts[name] for name in LAYOUT], axis=1))


def _by_column(M: FloatArray) -> FloatArray:
    """Stack of matrices as rows of numbers in CasADi's order."""
    return np.asarray(M.transpose(0, 2, 1).reshape(M.shape[0], M.shape[1] * M.shape[2]), dtype=np.float64)


def _forced(A: FloatArray, dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Responses (n, 4, 2) after dt to accelerations (of e_y, of e_psi) that go like 1, s and s^2/2, s = t/dt."""
    import scipy.linalg

    M = np.zeros((A.shape[0], 10, 10))
    M[:, :4, :4] = A * dt
    M[:, 1, 4] = M[:, 3, 5] = dt
    for k in range(4, 8):
        M[:, k, k + 2] = 1.0
    exp = scipy.linalg.expm(M)
    return exp[:, :4, 4:6], exp[:, :4, 6:8], exp[:, :4, 8:10]


def accelerations(x: Any, delta: Any, r: Any, v: Any, vehicle: Any) -> tuple[Any, Any, Any]:
    """Accelerations of the lane errors and lateral tyre force over mass."""
    import casadi as ca

    C_af, C_ar, l_f, l_r, m, I_z, mu, shape = (vehicle[i] for i in range(8))
    sin, cos = ca.sin(x[2]), ca.cos(x[2])
    v_y = (x[1] - v * sin) / cos
    omega = x[3] + r
    load = m * GRAVITY / (2.0 * (l_f + l_r))

    def force(alpha: Any, C_alpha: Any, F_z: Any) -> Any:
        return 2.0 * mu * F_z * ca.sin(shape * ca.atan(C_alpha * alpha / (shape * mu * F_z)))

    front = force(delta - ca.atan((v_y + l_f * omega) / v), C_af, load * l_r) * ca.cos(delta)
    rear = force(-ca.atan((v_y - l_r * omega) / v), C_ar, load * l_f)
    a_y = (front + rear) / m
    e_y_acceleration = v * cos * x[3] + (a_y - v * omega) * cos - v_y * sin * x[3]
    return e_y_acceleration, (l_f * front - l_r * rear) / I_z, a_y


def sample(x: Any, delta: Any, r_0: Any, r_1: Any, column: Any) -> tuple[Any, Any, Any]:
    """One sample of the model.

    Returns
    -------
    x_next : (4)
    a_y_0, a_y_1 : lateral acceleration [m/s^2] just after the command and at the end of the sample
    """
    import casadi as ca

    c = unpack(column)
    lin = c["linear"]

    def rest(x: Any, r: Any) -> tuple[Any, Any]:
        e_y, e_psi, a_y = accelerations(x, delta, r, c["v"], c["vehicle"])
        e_y_linear = ca.dot(lin[0:3], x[1:4]) + lin[6] * delta + lin[8] * r
        e_psi_linear = ca.dot(lin[3:6], x[1:4]) + lin[7] * delta + lin[9] * r
        return ca.vertcat(e_y - e_y_linear, e_psi - e_psi_linear), a_y

    def linear(part: str, r_end: Any) -> Any:
        A = ca.reshape(c["A" + part], 4, 4)
        return ca.mtimes(A, x) + c["B" + part] * delta + c["E_0" + part[1:]] * r_0 + c["E_1" + part[1:]] * r_end

    H_1, G_1, G_2, G_3 = (ca.reshape(c[name], 4, 2) for name in ("H_1", "G_1", "G_2", "G_3"))
    r_h = 0.5 * (r_0 + r_1)
    g_0, a_y_0 = rest(x, r_0)
    g_a, _ = rest(linear("_h", r_h) + ca.mtimes(H_1, g_0), r_h)
    whole = linear("", r_1)
    g_b, _ = rest(whole + ca.mtimes(G_1, 2 * g_a - g_0), r_1)
    x_next = whole + ca.mtimes(G_1, g_0) + ca.mtimes(G_2, 4 * g_a - 3 * g_0 - g_b)
    x_next += ca.mtimes(G_3, 4 * (g_0 - 2 * g_a + g_b))
    return x_next, a_y_0, accelerations(x_next, delta, r_1, c["v"], c["vehicle"])[2]


@dataclasses.dataclass(frozen=True)
class Cornering:
    """Steady cornering of the nonlinear bicycle with e_y = 0, one number for each lane yaw rate."""

    e_psi: FloatArray
    delta: FloatArray


def steady_cornering(plant: Plant, mu: float, r: FloatArray) -> Cornering:
    """Heading error and steering angle that hold a bend on the law's tyres. The axles carry m v r shared by their
    distances; the Magic Formula is inverted below its peak. Bends beyond the tyres are taken at 95 % of their
    force.
    """
    p, v = plant.model.parameters, plant.v[:, None]
    wheelbase = p.l_f + p.l_r

    def slip(share: FloatArray, C_alpha: float, arm: float) -> FloatArray:
        """Slip angle of an axle that carries this share of its peak force."""
        softness = SHAPE * mu * p.m * GRAVITY * arm / (2.0 * wheelbase * C_alpha)
        return np.asarray(softness * np.tan(np.arcsin(share) / SHAPE), dtype=np.float64)

    # both axles carry the same share of their peak, a_y/(mu g)
    share = np.clip(v * r / (mu * GRAVITY), -_SATURATED, _SATURATED)
    v_y = p.l_r * r - v * np.tan(slip(share, p.C_ar, p.l_f))
    direction = np.arctan((v_y + p.l_f * r) / v)
    delta = direction + slip(share, p.C_af, p.l_r)
    for _ in range(6):  # the front force is turned by delta; each round gains two digits or more
        turned = np.clip(share / np.cos(delta), -_TURNED, _TURNED)
        delta = direction + slip(turned, p.C_af, p.l_r)
    return Cornering(e_psi=np.asarray(-np.arctan(v_y / v), dtype=np.float64), delta=delta)


# ------------------------------------------------------------------------------------------------ the problem


class Program(NamedTuple):
    """Functions of one horizon; X is (4, N), U (1, N), r (1, N+1) [rad/s], e_ref (1, N+1), u_ref (1, N) [rad]."""

    predict: Any  # (x, u, r_0, r_1, c) -> (x after a sample, a_0, a_1) One sample with a command that is known
    # (x_0, guess, share, delta_prev, r, e_ref, u_ref, low, high, c) -> (U, X) Drive the model with commands guess, or,
    # with share = 1, the LQR, moved into the limits
    roll: Any
    # (X, U, x_0, r, e_ref, u_ref, c) -> (J, gap, a_0, a_1) Half the cost, sum of the absolute gaps, lateral
    # acceleration just after each command and at each sample's end
    value: Any
    # (X, U, x_0, r, e_ref, u_ref, c[, m_0, m_1, m_y]) -> (H, g, T, t, J_t, slope[, Y_0, Y_1, y_0, y_1]) The condensed
    # QP: Delta X = T' Delta U + t, Hessian H of the Lagrangian, gradient g, change J_t of the cost by t alone, largest
    # multiplier; T is (N, 4 N). With soft limits also the rows of a_0 and a_1 and their change by t, from multipliers m
    # of a_0, a_1 and e_y
    linearise: Any


def build(N: int, soft: bool) -> Program:
    """The functions for horizon N, not compiled."""
    import casadi as ca

    x, u, r_0, r_1, c = ca.SX.sym("x", 4), ca.SX.sym("u"), ca.SX.sym("r_0"), ca.SX.sym("r_1"), ca.SX.sym("c", SIZE)
    f, a_0, a_1 = sample(x, u, r_0, r_1, c)
    predict = ca.Function("predict", [x, u, r_0, r_1, c], [f, a_0, a_1])
    return Program(predict, _roll(ca, N, x, u, r_0, r_1, c, f), *_plan(ca, N, x, u, r_0, r_1, c, f, a_0, a_1, soft))


def _roll(ca: Any, N: int, x: Any, u: Any, r_0: Any, r_1: Any, c: Any, f: Any) -> Any:
    step = ca.Function("sample_f", [x, u, r_0, r_1, c], [f])
    p = unpack(c)
    guess, share, e_ref, u_ref, low, high, previous = (
        ca.SX.sym(name) for name in ("guess", "share", "e_ref", "u_ref", "low", "high", "previous")
    )
    lqr = u_ref - ca.dot(p["K"], x - ca.vertcat(0, 0, e_ref, 0))
    within_limits = ca.fmin(ca.fmax((1 - share) * guess + share * lqr, low), high)
    command = ca.fmin(ca.fmax(within_limits, previous - p["rate_step"]), previous + p["rate_step"])
    state = ca.vertcat(x, previous)
    after = ca.vertcat(step(x, command, r_0, r_1, c), command)
    single = ca.Function("roll_one", [state, guess, share, r_0, r_1, e_ref, u_ref, low, high, c], [after])
    drive = single.mapaccum("roll_all", N)

    x_0, guess, delta_prev = ca.MX.sym("x_0", 4), ca.MX.sym("guess", 1, N), ca.MX.sym("delta_prev")
    share, r, e_ref = ca.MX.sym("share"), ca.MX.sym("r", 1, N + 1), ca.MX.sym("e_ref", 1, N + 1)
    u_ref, low, high, c = ca.MX.sym("u", 1, N), ca.MX.sym("low", 1, N), ca.MX.sym("high", 1, N), ca.MX.sym("c", SIZE)
    same = ca.MX.ones(1, N)
    path = drive(
        ca.vertcat(x_0, delta_prev), guess, share * same, r[:-1], r[1:], e_ref[:-1], u_ref, low, high,
        ca.repmat(c, 1, N),
    )  # fmt: skip
    return ca.Function(
        "roll", [x_0, guess, share, delta_prev, r, e_ref, u_ref, low, high, c], [path[4, :], path[:4, :]]
    )


def _plan(
    ca: Any, N: int, x: Any, u: Any, r_0: Any, r_1: Any, c: Any, f: Any, a_0: Any, a_1: Any, soft: bool
) -> tuple[Any, Any]:
    p = unpack(c)
    xu = ca.vertcat(x, u)
    e_ref, u_ref = ca.SX.sym("e_ref"), ca.SX.sym("u_ref")
    last = ca.SX.sym("last")  # 1 at the end of the horizon

    # the cost of x_(j+1) and u_j
    weight = (1 - last) * ca.diag(p["q"]) + last * ca.reshape(p["P"], 4, 4)
    after = ca.SX.sym("after", 4)
    off = after - ca.vertcat(0, 0, e_ref, 0)
    pull = ca.mtimes(weight, off)
    cost = 0.5 * ca.dot(off, pull) + 0.5 * p["r_delta"] * (u - u_ref) ** 2

    inputs = [x, u, after, r_0, r_1, e_ref, u_ref, last, c]
    names = ["x", "u", "after", "r_0", "r_1", "e_ref", "u_ref", "last", "c"]
    gap = f - after
    value_one = ca.Function("value_one", inputs, [cost, ca.norm_1(gap), a_0, a_1], names, ["J", "gap", "a_0", "a_1"])
    slopes_one = ca.Function(
        "slopes_one", inputs,
        [gap, ca.jacobian(f, x), ca.jacobian(f, u), pull, p["r_delta"] * (u - u_ref),
         ca.jacobian(a_0, x).T, ca.jacobian(a_0, u), ca.jacobian(a_1, x).T, ca.jacobian(a_1, u)],
    )  # fmt: skip
    shared = [8]
    values = value_one.map("value_all", "serial", N, shared, [0, 1])
    slopes = slopes_one.map("slopes_all", "serial", N, shared, [])

    # multipliers, backwards
    after_multiplier, A, pulled = ca.SX.sym("l", 4), ca.SX.sym("A", 4, 4), ca.SX.sym("pull", 4)
    back_one = ca.Function("back_one", [after_multiplier, A, pulled], [ca.mtimes(A.T, after_multiplier) + pulled])
    back = back_one.mapaccum("back_all", N)
    multiplier, m_0, m_1 = ca.SX.sym("l", 4), ca.SX.sym("m_0"), ca.SX.sym("m_1")
    lagrangian = ca.dot(multiplier, f) + m_0 * a_0 + m_1 * a_1
    curvature, _ = ca.hessian(lagrangian, xu)
    bend_one = ca.Function("bend_one", [x, u, r_0, r_1, c, multiplier, m_0, m_1], [ca.densify(curvature)])
    bends = bend_one.map("bend_all", "serial", N, [4], [])

    # condensing: rows of T are the states' sensitivities to one command
    T, t, B, d, e = ca.SX.sym("T", N, 4), ca.SX.sym("t", 4), ca.SX.sym("B", 4), ca.SX.sym("d", 4), ca.SX.sym("e", N)
    forward_one = ca.Function(
        "forward_one", [T, t, A, B, d, e],
        [ca.mtimes(T, A.T) + ca.mtimes(e, B.T), ca.mtimes(A, t) + d],
    )  # fmt: skip
    forward = forward_one.mapaccum("forward_all", N, 2)
    W, h = ca.SX.sym("W", 4, 4), ca.SX.sym("h", 4)
    weigh_one = ca.Function("weigh_one", [T, W, t, h], [ca.mtimes(T, W), ca.mtimes(W, t), ca.mtimes(T, h)])
    weigh = weigh_one.map("weigh_all", "serial", N, [], [])
    row_one = ca.Function("row_one", [T, h], [ca.mtimes(T, h)])
    rows = row_one.map("row_all", "serial", N, [], [])

    X, U, x_0 = ca.MX.sym("X", 4, N), ca.MX.sym("U", 1, N), ca.MX.sym("x_0", 4)
    r, e_ref, u_ref = ca.MX.sym("r", 1, N + 1), ca.MX.sym("e_ref", 1, N + 1), ca.MX.sym("u_ref", 1, N)
    c = ca.MX.sym("c", SIZE)
    soft_inputs = [ca.MX.sym(name, 1, N) for name in ("m_0", "m_1", "m_y")]
    m_0, m_1, m_y = soft_inputs if soft else [ca.MX.zeros(1, N)] * 3
    last = ca.MX(ca.horzcat(ca.DM.zeros(1, N - 1), 1))
    before = ca.horzcat(x_0, X[:, :-1])
    samples = [before, U, X, r[:-1], r[1:], e_ref[1:], u_ref, last, c]
    names = ["X", "U", "x_0", "r", "e_ref", "u_ref", "c"]
    problem = [X, U, x_0, r, e_ref, u_ref, c]
    value = ca.Function("value", problem, list(values(*samples)), names, ["J", "gap", "a_0", "a_1"])

    d, A, B, pull, push, a_0_x, a_0_u, a_1_x, a_1_u = slopes(*samples)
    # gradient of the soft limits' terms on x_1 .. x_N: accelerations of the sample that starts there, and e_y
    accelerations = a_0_x * ca.repmat(m_0, 4, 1) + a_1_x * ca.repmat(m_1, 4, 1)
    push_soft = ca.horzcat(accelerations[:, 1:], ca.MX.zeros(4, 1)) + ca.vertcat(m_y, ca.MX.zeros(3, N))
    pulled = pull + push_soft
    flip = list(range(N - 1, -1, -1))
    A_next = ca.horzcat(A[:, 4:], ca.MX.zeros(4, 4))  # of the sample after
    reverse = [4 * k + i for k in flip for i in range(4)]
    multipliers = back(ca.MX.zeros(4), A_next[:, reverse], pulled[:, flip])[:, flip]
    L = bends(before, U, r[:-1], r[1:], c, multipliers, m_0, m_1)

    eye = ca.MX(ca.DM.eye(N))
    T, t = forward(ca.MX.zeros(N, 4), ca.MX.zeros(4), A, B, d, eye)
    q, P = ca.diag(unpack(c)["q"]), ca.reshape(unpack(c)["P"], 4, 4)
    columns = [k for j in range(1, N) for k in range(5 * j, 5 * j + 4)]
    W = L[:4, columns] + ca.repmat(q, 1, N - 1) if N > 1 else ca.MX.zeros(4, 0)
    W = ca.horzcat(W, P)
    cross = ca.horzcat(L[:4, [5 * j + 4 for j in range(1, N)]], ca.MX.zeros(4, 1))  # of x_j with u_j, j = 1 .. N
    TW, Wt, mixed = weigh(T, W, t, cross)  # mixed: column j-1 is Phi_j' cross_j, for u_j
    mixed = ca.horzcat(ca.MX.zeros(N, 1), mixed[:, : N - 1])
    H = ca.mtimes(TW, T.T) + mixed + mixed.T
    H += ca.diag(unpack(c)["r_delta"] + L[4, [5 * j + 4 for j in range(N)]].T)
    g = ca.mtimes(T, ca.reshape(pull + Wt, 4 * N, 1)) + push.T
    g += ca.vertcat(0, ca.sum1(cross * t)[: N - 1].T) if N > 1 else 0
    J_t = ca.dot(pull, t) + 0.5 * ca.dot(t, Wt)
    t_before = ca.horzcat(ca.MX.zeros(4, 1), t[:, :-1])
    T_before = ca.horzcat(ca.MX.zeros(N, 4), T[:, :-4])
    Y_0, Y_1 = rows(T_before, a_0_x) + ca.diag(a_0_u), rows(T_before, a_1_x) + ca.diag(a_1_u)
    y_0, y_1 = ca.sum1(a_0_x * t_before), ca.sum1(a_1_x * t_before)
    outputs = [H, g, T, t, J_t, ca.norm_inf(ca.vec(multipliers)), *([Y_0, Y_1, y_0, y_1] if soft else [])]
    linearise = ca.Function(
        "linearise", [*problem, *(soft_inputs if soft else [])], [ca.densify(v) for v in outputs],
        [*names, *(["m_0", "m_1", "m_y"] if soft else [])],
        ["H", "g", "T", "t", "J_t", "slope", *(["Y_0", "Y_1", "y_0", "y_1"] if soft else [])],
    )  # fmt: skip
    return value, linearise


CODE, CACHE = "LDC_NMPC_CODE", "LDC_NMPC_CACHE"
_OPTIONS = ("-O2", "-fPIC", "-shared", "-ffp-contract=off")


def compiled(functions: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    """The functions from compiled C code, or as they are where that is switched off or does not work."""
    import casadi as ca

    choice = os.environ.get(CODE, "") or "auto"
    if choice not in ("auto", "vm"):
        raise InputError(CODE, value=choice, allowed=("auto", "vm"))
    library = _library(functions, name) if choice == "auto" else None
    if library is None:
        return functions
    try:
        return tuple(ca.external(function.name(), str(library)) for function in functions)
    except RuntimeError:  # a damaged file, made anew by the next process, or a folder that nothing may run from
        with contextlib.suppress(OSError):
            library.unlink(missing_ok=True)
        return functions


def _library(functions: tuple[Any, ...], name: str) -> Path | None:
    """The compiled library, made if it is not there yet; None where it cannot be made, or kept from others."""
    compiler = None if sys.platform == "win32" else shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    import casadi as ca

    generator = ca.CodeGenerator(name)
    for function in functions:
        generator.add(function)
    text = str(generator.dump())
    key = hashlib.sha256("\n".join([compiler, *_OPTIONS, platform.platform(), text]).encode()).hexdigest()[:24]
    try:
        folder = Path(os.environ.get(CACHE) or cache_folder())
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        target = folder / f"{name}-{key}.so"
        if not private(folder):
            return None
        if not private(target):
            _compile(compiler, text, target)
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None
    return target


def _compile(compiler: str, text: str, target: Path) -> None:
    """Compile beside the target and rename, so that half a library is never seen."""
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".compile-") as folder:
        source, library = Path(folder, "code.c"), Path(folder, "code.so")
        source.write_text(text, encoding="utf-8")
        command = [compiler, *_OPTIONS, "-o", str(library), str(source), "-lm"]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        library.chmod(0o700)
        with contextlib.suppress(FileExistsError):
            library.replace(target)


MAX_ITERATIONS: Final = 60
_STEP_NEWTON: Final = 1e-5  # [rad] the error after a full Newton step is the square of it, up to a factor
_STEP_LINEAR: Final = 1e-7  # [rad] after a step with another Hessian
_STEP_LAST: Final = 1e-6  # [rad] where the merit cannot fall any more
_GAP: Final = 1e-6
_PRIMAL: Final = 1e-10
_HELD: Final = 1e-8  # [rad] a limit this close is active
_MEMORY: Final = 4  # iterations whose merit a full step may come back to, so that rows that bend do not
# shorten it (the watchdog), and for how many iterations it may
_PATIENCE: Final = 15
_BLIND: Final = 3  # full steps taken where the merit of soft limits cannot fall


@dataclasses.dataclass(frozen=True)
class SoftLimits:
    """Limits that a penalty holds: w v + w v^2/2 for each violation v, in units of a scale. The rows are linear in y =
    (a_y just after each of N commands, a_y at each sample's end, e_y there); to them the workspace's `offset` (m,)
    is added.
    """

    rows: FloatArray  # (m, 3 N)
    # (m,) Largest values, and w
    bound: FloatArray
    weight: FloatArray
    # (m, 2 window + 1) Weights of the accelerations before and after each of the last samples, before the first command
    # the last
    before: FloatArray

    @property
    def size(self) -> int:
        """Number of rows."""
        return int(self.bound.size)

    def penalty(self, values: FloatArray) -> float:
        """Of values of the rows."""
        v = np.maximum(np.abs(values) - self.bound, 0.0)
        return float(self.weight @ (v + 0.5 * v * v))


@dataclasses.dataclass
class Solution:
    """What became of one solve."""

    U: FloatArray  # (N,) [rad] Commands; they meet the limits whatever `solved` says
    solved: bool
    iterations: int
    step: float  # [rad] Largest change of a command in the last iteration
    cost: float  # Sum of the weighted squares, without the penalties


class _Call:
    """A CasADi function on arrays that stay where they are."""

    def __init__(self, function: Any, inputs: list[FloatArray]) -> None:
        self.outputs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
        self._references = function, inputs, function.buffer()
        buffer, self.run = self._references[2]
        for k, array in enumerate(inputs):
            if array.size != function.nnz_in(k):
                raise ValueError(f"{function.name()}: input {k} has {array.size} numbers, not {function.nnz_in(k)}")
            buffer.set_arg(k, array.data)
        for k, array in enumerate(self.outputs):
            buffer.set_res(k, array.data)


class Workspace:
    """Arrays and functions for one horizon, used by one thread. A solve starts from its arguments alone; nothing of
    the solve before is used.
    """

    def __init__(self, N: int, soft: bool) -> None:
        self.N = N
        self.offset: FloatArray = np.zeros(1)
        self._sample = np.zeros((3, 1))
        self.x_0, self.delta_prev, self.c = np.zeros(4), np.zeros(1), np.zeros(SIZE)
        self.r, self.e_ref, self.u_ref = np.zeros(N + 1), np.zeros(N + 1), np.zeros(N)
        self.low, self.high = np.zeros(N), np.zeros(N)
        self.guess, self.share = np.zeros(N), np.zeros(1)
        self.U, self.X = np.zeros(N), np.zeros(4 * N)
        self.U_try, self.X_try = np.zeros(N), np.zeros(4 * N)
        self.m_0, self.m_1, self.m_y = np.zeros(N), np.zeros(N), np.zeros(N)
        problem = [self.x_0, self.r, self.e_ref, self.u_ref, self.c]
        predict, roll, value, linearise = _functions(N, soft)
        self._predict = _Call(predict, [self.x_0, *self._sample, self.c])
        self._roll = _Call(
            roll, [self.x_0, self.guess, self.share, self.delta_prev, *problem[1:4], self.low, self.high, self.c]
        )
        self._value = _Call(value, [self.X_try, self.U_try, *problem])
        soft_inputs = [self.m_0, self.m_1, self.m_y] if soft else []
        self._linearise = _Call(linearise, [self.X, self.U, *problem, *soft_inputs])
        out = self._linearise.outputs
        self.H, self.T = out[0].reshape(N, N), out[2].reshape(4 * N, N)
        self.g, self.t, self.J_t, self.slope = out[1], out[3], out[4], out[5]
        self.Y = [values.reshape(N, N) for values in out[6:8]]
        self.y_t = out[8:10]
        self._change = np.diff(np.eye(N), axis=0, prepend=0.0)
        self._hard = np.vstack([np.eye(N), self._change])
        self._sense = np.zeros(2 * N, dtype=np.int32)
        self._active = np.zeros(2 * N, dtype=np.bool_)

    def predict(self, u: float, r_0: float, r_1: float) -> tuple[FloatArray, float, float]:
        """The state after a sample with the command u; a_y just after it and at the end."""
        self._sample[:, 0] = u, r_0, r_1
        self._predict.run()
        x, a_0, a_1 = self._predict.outputs
        return x, float(a_0[0]), float(a_1[0])

    def solve(self, warm: FloatArray | None, soft: SoftLimits | None) -> Solution:
        """Solve the problem in the input arrays."""
        self.m_0[:], self.m_1[:], self.m_y[:], self._active[:] = 0.0, 0.0, 0.0, False
        J, merit, rows = self._start(warm, soft)
        step, gap = np.inf, 0.0
        recent, blind = [merit], _BLIND
        for iteration in range(1, MAX_ITERATIONS + 1):
            direction = self._direction(rows, soft)
            if direction is None:
                return self._end(False, iteration, step, J)
            dU, row_change, newton = direction
            step = float(np.max(np.abs(dU)))
            pull = self.J_t[0] + self.g @ dU + 0.5 * dU @ (self.H @ dU)
            if soft is not None and rows is not None and row_change is not None:
                pull += soft.penalty(rows + row_change) - soft.penalty(rows)
            nu = 2.0 * self.slope[0] + 1e-6
            before = merit + nu * gap
            drop = max(nu * gap - pull, 0.0)
            trial = self._lift(dU, soft)
            high = max(before, *recent) if iteration <= _PATIENCE else before
            allowed = high - 1e-4 * drop + 1e-12 * (1.0 + abs(before))
            full = trial[1] + nu * trial[3] <= allowed
            if not full:
                shorter = self._shorten(dU, before, drop, soft)
                if shorter is None and gap == 0.0:
                    # the merit cannot fall: rounding, if the step is small, or soft rows whose bend the QP has not seen
                    if step <= _STEP_LAST or soft is None or blind == 0:
                        return self._end(step <= _STEP_LAST, iteration, step, J)
                    blind -= 1
                    shorter = self._lift(dU, soft)
                trial = shorter or self._close(soft)
            J, merit, rows, gap = trial
            self.U[:], self.X[:] = self.U_try, self.X_try
            recent = [*recent[1 - _MEMORY :], merit + nu * gap]
            if gap <= _GAP and full and step <= (_STEP_NEWTON if newton else _STEP_LINEAR):
                return self._end(True, iteration, step, self._close(soft)[0])
        return self._end(step <= _STEP_LAST and gap <= _GAP, MAX_ITERATIONS, step, J)

    def _close(self, soft: SoftLimits | None) -> tuple[float, float, FloatArray | None, float]:
        """The same commands without gaps."""
        self.share[0], self.guess[:] = 0.0, self.U
        self._drive()
        return (*self._measure(soft)[:3], 0.0)

    def _lift(self, dU: FloatArray, soft: SoftLimits | None) -> tuple[float, float, FloatArray | None, float]:
        """The full step of commands and states."""
        np.add(self.U, dU, out=self.U_try)
        self.X_try[:] = self.X + self.t + self.T @ dU
        return self._measure(soft)

    def _end(self, solved: bool, iterations: int, step: float, J: float) -> Solution:
        return Solution(self.U.copy(), solved and bool(np.isfinite(self.U).all()), iterations, step, 2.0 * J)

    def _start(self, warm: FloatArray | None, soft: SoftLimits | None) -> tuple[float, float, FloatArray | None]:
        """The better of the warm start and the LQR, both inside the limits and driven by the model."""
        self.share[0] = 1.0
        self._drive()
        best = self._measure(soft)
        self.U[:], self.X[:] = self.U_try, self.X_try
        if warm is not None:
            self.share[0], self.guess[:] = 0.0, warm
            self._drive()
            trial = self._measure(soft)
            if trial[1] <= best[1] or not np.isfinite(best[1]):
                best = trial
                self.U[:], self.X[:] = self.U_try, self.X_try
        return best[:3]

    def _drive(self) -> None:
        self._roll.run()
        self.U_try[:], self.X_try[:] = self._roll.outputs

    def _measure(self, soft: SoftLimits | None) -> tuple[float, float, FloatArray | None, float]:
        """Half the cost, the same with penalties, the soft limits' rows, the gaps of the trial."""
        self._value.run()
        J, gap, a_0, a_1 = self._value.outputs
        if soft is None:
            return float(J[0]), float(J[0]), None, float(gap[0])
        rows = soft.rows @ np.concatenate([a_0, a_1, self.X_try[0::4]]) + self.offset
        return float(J[0]), float(J[0]) + soft.penalty(rows), rows, float(gap[0])

    def _shorten(
        self, dU: FloatArray, before: float, drop: float, soft: SoftLimits | None
    ) -> tuple[float, float, FloatArray | None, float] | None:
        """The first shortened step, driven by the model, that lowers the merit; None if there is none."""
        start = self.U.copy()
        self.share[0] = 0.0
        length = 1.0
        for _ in range(12):
            self.guess[:] = start + length * dU
            self._drive()
            trial = self._measure(soft)
            if trial[1] < before - 1e-4 * length * drop:
                return trial[0], trial[1], trial[2], 0.0
            length *= 0.5
        return None

    def _direction(
        self, rows: FloatArray | None, soft: SoftLimits | None
    ) -> tuple[FloatArray, FloatArray | None, bool] | None:
        """Solution of the QP, the change of the soft rows with it, whether the step is Newton's; None if unsolved."""
        self._linearise.run()
        if not (np.isfinite(self.g).all() and np.isfinite(self.H).all()):
            return None
        dU, change, active = self._qp(self.H, rows, soft)
        if dU is not None:
            self._active = active
            return dU, change, True
        # not convex: stiffen the rows that are active here and were so in the last QP, which changes no solution
        # on them, and what is left of negative curvature
        low, high = self._bounds()
        held = self._active & ((np.abs(low) <= _HELD) | (np.abs(high) <= _HELD))
        C = self._hard[held]
        stiff = self.H + float(np.abs(self.H).max()) * (C.T @ C)
        values, vectors = np.linalg.eigh(0.5 * (stiff + stiff.T))
        floor = 1e-8 * float(np.abs(values).max())
        newton = bool(values[0] > floor)
        if not newton:
            stiff = (vectors * np.maximum(np.abs(values), floor)) @ vectors.T
        dU, change, active = self._qp(stiff, rows, soft)
        self._active = active
        return None if dU is None else (dU, change, newton)

    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """How far each angle and each change may go down and up."""
        U, rate = self.U, self.c[-1]
        turn = np.diff(U, prepend=self.delta_prev)
        return np.concatenate([self.low - U, -rate - turn]), np.concatenate([self.high - U, rate - turn])

    def _qp(
        self, H: FloatArray, rows: FloatArray | None, soft: SoftLimits | None
    ) -> tuple[FloatArray | None, FloatArray | None, BoolArray]:
        import daqp

        N = self.N
        C, sense = self._change, self._sense
        low, high = self._bounds()
        S = now = None
        if soft is not None and rows is not None:
            S = soft.rows @ np.concatenate([*self.Y, self.T[0::4]])
            now = rows + soft.rows @ np.concatenate([*self.y_t, self.t[0::4]])
            C = np.concatenate([C, S])
            sense = np.concatenate([sense, np.full(soft.size, 8, dtype=np.int32)])
            low, high = np.concatenate([low, -soft.bound - now]), np.concatenate([high, soft.bound - now])
            model = daqp.Model()
            model.settings = {"primal_tol": _PRIMAL, "eps_prox": 0.0}
            if model.setup(H, self.g, C, high, low, sense)[0] < 0:
                return None, None, self._active
            linear = np.concatenate([np.ones(2 * N), soft.weight])
            model.soft_weights(rho_l=1.0 / linear, rho_u=1.0 / linear, w_l=linear, w_u=linear)
            dU, _, flag, info = model.solve()
        else:
            dU, _, flag, info = daqp.solve(H, self.g, C, high, low, sense, primal_tol=_PRIMAL, eps_prox=0.0)
        if flag < 1 or not np.isfinite(dU).all():
            return None, None, self._active
        active = info["lam"][: 2 * N] != 0.0
        if soft is None or S is None or now is None or rows is None:
            return dU, None, active
        pressed = info["lam"][2 * N :] @ soft.rows
        self.m_0[:], self.m_1[:], self.m_y[:] = pressed[:N], pressed[N : 2 * N], pressed[2 * N :]
        return dU, now - rows + S @ dU, active


@functools.lru_cache(maxsize=16)
def _functions(N: int, soft: bool) -> tuple[Any, ...]:
    return compiled(tuple(build(N, soft)), f"nonlinear_mpc_{N}{'_soft' if soft else ''}")


_LOCAL = threading.local()


def workspace(N: int, soft: bool) -> Workspace:
    """Workspace of the calling thread for a horizon, with or without soft limits."""
    workspaces: dict[tuple[int, bool], Workspace] = _LOCAL.__dict__.setdefault("workspaces", {})
    if (N, soft) not in workspaces:
        workspaces[N, soft] = Workspace(N, soft)
    return workspaces[N, soft]
