"""A single track whose tyre forces build up over a relaxation length: the vehicle of the study `my-vehicle`."""

import dataclasses
from typing import Any

import casadi as ca

from ldctoolkit.vehicle import VehicleModel


@dataclasses.dataclass(frozen=True)
class Car(VehicleModel):
    """A car of 1,650 kg; its states are the lateral forces of both axles [N]."""

    states = ("F_f", "F_r")
    m: float = 1650.0
    I_z: float = 2800.0
    l_f: float = 1.25
    l_r: float = 1.55
    C_f: float = 130e3  # Cornering stiffness of an axle [N/rad]
    C_r: float = 150e3
    relaxation: float = 0.4  # [m]
    mu: float = 0.9

    def derivatives(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> dict[str, Any]:
        """Forces run after those of the slip angles, which saturate."""
        v_y, yaw_rate = self.v_y(x, v), self.yaw_rate(x, lane)
        peak = self.mu * self.m * 9.81 / (self.l_f + self.l_r)
        slips = delta - ca.atan((v_y + self.l_f * yaw_rate) / v), ca.atan((self.l_r * yaw_rate - v_y) / v)
        peaks = peak * self.l_r, peak * self.l_f
        front, rear = (p * ca.tanh(C * s / p) for p, C, s in zip(peaks, (self.C_f, self.C_r), slips, strict=True))
        return {
            "F_f": (front - x.F_f) * v / self.relaxation,
            "F_r": (rear - x.F_r) * v / self.relaxation,
            "e_y_rate": self.e_y_acceleration(x, v, v_rate, lane, (x.F_f + x.F_r) / self.m),
            "e_psi_rate": (self.l_f * x.F_f - self.l_r * x.F_r) / self.I_z,
        }
