"""The prediction model of the nonlinear MPC in CasADi: one sample of the nonlinear bicycle, and steady cornering.

The bicycle is that of `tools/nonlinear_plant.py` (Rajamani, *Vehicle Dynamics and Control*, section 2.3, with the
Magic Formula of Pacejka) at constant speed. A sample is a step of the third-order exponential Runge-Kutta method
ETD3RK (S. Cox, P. Matthews, *Exponential time differencing for stiff systems*, J. Comp. Phys. 176, 2002) about
straight driving: with f = A x + B delta + E r + g, and l(x), l_h(x) the exact linear plant after dt and dt/2,

    g_0 = g(x, r_0),  a = l_h(x) + H_1 g_0,  g_a = g(a, r_h),  b = l(x) + G_1 (2 g_a - g_0),  g_b = g(b, r_1)
    x+  = l(x) + G_1 g_0 + G_2 (4 g_a - 3 g_0 - g_b) + G_3 (4 g_0 - 8 g_a + 4 g_b),

G_1, G_2, G_3 the responses to accelerations 1, s and s^2/2 of s = t/dt. So what is linear is exact, as in the linear
plant, and stiffness at low speed is no trouble. Only the accelerations have a part g that is not linear.
"""

import dataclasses
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.vehicle.bicycle import Plant

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
    """Accelerations of the lane errors and lateral tyre force over mass, as in `_nonlinear_compiled`."""
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
