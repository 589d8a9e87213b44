"""What a predictive controller believes in: the vehicle in CasADi expressions, and the numbers of a scenario."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.casadi_code import Names
from ldctoolkit.vehicle.bicycle import Plant
from ldctoolkit.vehicle.discretization import expm

SHAPE: Final = 1.3  # Pacejka's C of the tyres that a law believes in

GRAVITY: Final = 9.81
SATURATED: Final = 0.95  # steady cornering is held up to this share of the tyres' peak force
TURNED: Final = 0.97  # and the front tyres, turned by delta, up to this

STATES: Final = ("e_y", "e_y_rate", "e_psi", "e_psi_rate")
PREVIOUS: Final = "previous"  # the last state of z, where it is used: the command of the sample before


class Vehicle(Names):
    """The vehicle that a law believes in, as `dynamics` gets it."""

    def nonlinear(self, x: Any, delta: Any, lane: Any, shape: Any = SHAPE) -> dict[str, Any]:
        """Rates of the states of the bicycle on saturating tyres with the wheels at delta, and a_y.

        Rajamani, *Vehicle Dynamics and Control*, section 2.3, with the Magic Formula (Pacejka) of C = `shape`.
        """
        import casadi as ca

        r, v = lane.yaw_rate, self.v
        sin, cos = ca.sin(x.e_psi), ca.cos(x.e_psi)
        v_y = (x.e_y_rate - v * sin) / cos
        omega = x.e_psi_rate + r
        load = self.m * GRAVITY / (2.0 * (self.l_f + self.l_r))

        def force(alpha: Any, C_alpha: Any, F_z: Any) -> Any:
            return 2.0 * self.mu * F_z * ca.sin(shape * ca.atan(C_alpha * alpha / (shape * self.mu * F_z)))

        front = force(delta - ca.atan((v_y + self.l_f * omega) / v), self.C_af, load * self.l_r) * ca.cos(delta)
        rear = force(-ca.atan((v_y - self.l_r * omega) / v), self.C_ar, load * self.l_f)
        a_y = (front + rear) / self.m
        e_y_acceleration = v * cos * x.e_psi_rate + (a_y - v * omega) * cos - v_y * sin * x.e_psi_rate
        turn = (self.l_f * front - self.l_r * rear) / self.I_z
        return {
            "e_y": x.e_y_rate, "e_y_rate": e_y_acceleration, "e_psi": x.e_psi_rate, "e_psi_rate": turn,
            "a_y": a_y - v * r,
        }  # fmt: skip

    def linear(self, x: Any, delta: Any, lane: Any) -> dict[str, Any]:
        """The same on linear tyres for small angles: the plant of the linear laws (Rajamani, eq. 2.45)."""
        lin, r = self._linear, lane.yaw_rate
        moved = (x.e_y_rate, x.e_psi, x.e_psi_rate)
        e_y, e_psi = (
            sum(lin[3 * i + j] * moved[j] for j in range(3)) + lin[6 + i] * delta + lin[8 + i] * r for i in (0, 1)
        )
        return {"e_y": x.e_y_rate, "e_y_rate": e_y, "e_psi": x.e_psi_rate, "e_psi_rate": e_psi, "a_y": e_y}


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
    share = np.clip(v * r / (mu * GRAVITY), -SATURATED, SATURATED)
    v_y = p.l_r * r - v * np.tan(slip(share, p.C_ar, p.l_f))
    direction = np.arctan((v_y + p.l_f * r) / v)
    delta = direction + slip(share, p.C_af, p.l_r)
    for _ in range(6):  # the front force is turned by delta; each round gains two digits or more
        turned = np.clip(share / np.cos(delta), -TURNED, TURNED)
        delta = direction + slip(turned, p.C_af, p.l_r)
    return Cornering(e_psi=np.asarray(-np.arctan(v_y / v), dtype=np.float64), delta=delta)


# ------------------------------------------------------------------------------------------------ numbers of a scenario


class Layout(dict[str, int]):
    """Parts of a scenario's column and their sizes, in order."""

    @property
    def size(self) -> int:
        """Numbers of a column."""
        return sum(self.values())

    def unpack(self, column: Any) -> dict[str, Any]:
        """Named parts of a column."""
        parts, start = {}, 0
        for name, size in self.items():
            parts[name] = column[start : start + size]
            start += size
        return parts

    def pack(self, **parts: FloatArray) -> FloatArray:
        """Rows (n, size) from named parts, matrices in CasADi's order."""
        flat = (
            parts[name] if parts[name].ndim == 2 else parts[name].mT.reshape(len(parts[name]), self[name])
            for name in self
        )
        return np.ascontiguousarray(np.concatenate([*flat], axis=1), dtype=np.float64)


VEHICLE: Final = ("C_af", "C_ar", "l_f", "l_r", "m", "I_z", "mu", "v", "offset", "dt")


def base_layout(gains: int) -> Layout:
    """What expressions refer to: vehicle, linear plant, gains."""
    return Layout(vehicle=len(VEHICLE), linear=10, gains=gains)


def base_columns(plant: Plant, mu: float, gains: tuple[float, ...]) -> FloatArray:
    """Columns (n, k) of `base_layout`."""
    n, p = plant.n, plant.model.parameters
    A, B, E = plant.model.matrices(plant.v)
    vehicle = np.tile([p.C_af, p.C_ar, p.l_f, p.l_r, p.m, p.I_z, mu, 0.0, p.edge_offset, plant.dt], (n, 1))
    vehicle[:, 7] = plant.v
    linear = np.concatenate([A[:, 1, 1:], A[:, 3, 1:], B[:, (1, 3)], E[:, (1, 3)]], axis=1)
    return base_layout(len(gains)).pack(vehicle=vehicle, linear=linear, gains=np.tile(gains, (n, 1)))


def forced(A: FloatArray, rows: tuple[int, ...], dt: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Responses (n, k, len(rows)) after dt to rates of `rows` that go like 1, s and s^2/2, s = t/dt."""
    k, q = A.shape[1], len(rows)
    M = np.zeros((A.shape[0], k + 3 * q, k + 3 * q))
    M[:, :k, :k] = A * dt
    M[:, list(rows), k + np.arange(q)] = dt
    for i in range(k, k + 2 * q):
        M[:, i, i + q] = 1.0
    phi = expm(M)[:, :k]
    return phi[:, :, k : k + q], phi[:, :, k + q : k + 2 * q], phi[:, :, k + 2 * q :]
