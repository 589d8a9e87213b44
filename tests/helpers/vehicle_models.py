"""Vehicle models for tests: the nonlinear bicycle in CasADi and NumPy, and the published ones of CommonRoad."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import operator
import types
from collections.abc import Callable
from typing import Any
from unittest import mock

import casadi as ca
import numpy as np
import vehiclemodels.utils.tire_model as tire_model
import vehiclemodels.utils.vehicle_dynamics_ks_cog as kinematic
import vehiclemodels.vehicle_dynamics_mb as multi_body
import vehiclemodels.vehicle_dynamics_std as drift
from vehiclemodels.init_mb import init_mb
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

import ldctoolkit as ldc


@dataclasses.dataclass(frozen=True)
class Bicycle(ldc.VehicleModel):
    """The toolkit's plant on saturating tyres, of Table I."""

    m: float = 1000.0
    I_z: float = 3344.0
    l_f: float = 1.43
    l_r: float = 1.47
    C_f: float = 160000.0
    C_r: float = 160000.0
    mu: float = 0.9

    def derivatives(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> dict[str, Any]:
        sin, cos, atan = (ca.sin, ca.cos, ca.atan) if self.symbolic else (np.sin, np.cos, np.arctan)
        v_y, omega = self.v_y(x, v), self.yaw_rate(x, lane)
        load = self.mu * self.m * 9.81 / (self.l_f + self.l_r)

        def force(slip: Any, C: float, D: float) -> Any:
            return D * sin(1.3 * atan(C * slip / (1.3 * D)))

        front = force(delta - atan((v_y + self.l_f * omega) / v), self.C_f, load * self.l_r) * cos(delta)
        rear = force(atan((self.l_r * omega - v_y) / v), self.C_r, load * self.l_f)
        return {
            "e_y_rate": self.e_y_acceleration(x, v, v_rate, lane, (front + rear) / self.m),
            "e_psi_rate": (self.l_f * front - self.l_r * rear) / self.I_z,
        }


@dataclasses.dataclass(frozen=True)
class NumPyBicycle(Bicycle):
    symbolic = False


@dataclasses.dataclass(frozen=True)
class SelfDriven(NumPyBicycle):
    """The same, with e_y_rate and e_psi_rate advanced by itself in ten steps of Euler's method."""

    states = ("lateral",)
    longest_step = 0.005

    def initial(self, turn: Any) -> dict[str, Any]:
        return {"lateral": turn.e_y_acceleration + turn.v * turn.yaw_rate}

    def begin(self, turn: Any) -> list[int]:
        return [0] * turn.v.size

    def advance(self, memory: list[int], rows: Any, x: Any, road: Any, h: Any) -> dict[str, Any]:
        names, k = ("e_y", "e_y_rate", "e_psi", "e_psi_rate"), 10
        now = types.SimpleNamespace(**{name: getattr(x, name) for name in names})
        for row in rows:
            memory[row] += 1
        start, middle, end = road
        for _ in range(k):
            rates = self.derivatives(
                now, (start.delta + 4 * middle.delta + end.delta) / 6, middle.v, middle.v_rate, middle
            )
            now.e_y, now.e_psi = now.e_y + h / k * now.e_y_rate, now.e_psi + h / k * now.e_psi_rate
            now.e_y_rate = now.e_y_rate + h / k * rates["e_y_rate"]
            now.e_psi_rate = now.e_psi_rate + h / k * rates["e_psi_rate"]
        a_y = super().a_y(now, end.delta, end.v, end.v_rate, end)
        return {name: getattr(now, name) for name in names} | {"lateral": a_y}

    def a_y(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> Any:
        return x.lateral


# ------------------------------------------------------------------------------------------------ CommonRoad


class Traced:
    """A CasADi expression with its value near straight driving, by which the published code takes its branches."""

    def __init__(self, expression: Any, value: float) -> None:
        self.expression, self.value = expression, value


def _pair(x: Any) -> tuple[Any, Any]:
    return (x.expression, x.value) if isinstance(x, Traced) else (x, x)


def _traced(on_numbers: Callable[..., Any], on_symbols: Callable[..., Any] | None = None) -> Callable[..., Traced]:
    def apply(*given: Any) -> Traced:
        expressions, values = zip(*map(_pair, given), strict=True)
        return Traced((on_symbols or on_numbers)(*expressions), on_numbers(*values))

    return apply


for _name in ("add", "sub", "mul", "truediv", "pow"):
    _on = getattr(operator, _name)
    setattr(Traced, f"__{_name}__", _traced(_on))
    setattr(Traced, f"__r{_name}__", _traced(lambda a, b, on=_on: on(b, a)))
for _name in ("lt", "le", "gt", "ge"):
    _on = getattr(operator, _name)
    setattr(Traced, f"__{_name}__", lambda a, b, on=_on: on(a.value, _pair(b)[1]))
Traced.__neg__, Traced.__abs__ = _traced(operator.neg), _traced(abs, ca.fabs)  # type: ignore[attr-defined]

_NAMES = ("sin", "cos", "tan", "atan", "tanh", "sqrt", "fabs")
_MATH = types.SimpleNamespace(**{name: _traced(getattr(math, name), getattr(ca, name)) for name in _NAMES})
PARAMETERS = setup_vehicle_parameters(vehicle_id=2)  # a BMW 320i
_V = 25.0  # [m/s] at which the branches are taken


def _published(dynamics: Callable[..., list[Any]], x: list[Any]) -> list[Any]:
    """Rates of the published model in CasADi; the jump of its tyres at a camber angle of 0 is a steep slope."""
    sign = _traced(lambda gamma: math.tanh(gamma / 0.01), lambda gamma: ca.tanh(gamma / 0.01))
    with contextlib.ExitStack() as patches:
        for module in (drift, multi_body, tire_model, kinematic):
            patches.enter_context(mock.patch.object(module, "math", _MATH))
        patches.enter_context(mock.patch.object(tire_model, "sign", sign))
        return [_pair(rate)[0] for rate in dynamics(x, [0.0, 0.0], PARAMETERS)]


@dataclasses.dataclass(frozen=True)
class Drift(ldc.VehicleModel):
    """Single track with combined slip and wheel speeds (M. Althoff, G. Wuersching)."""

    states = ("omega_f", "omega_r")

    def initial(self, turn: Any) -> dict[str, Any]:
        return self.steady_turn(turn, omega_f=turn.v / PARAMETERS.R_w, omega_r=turn.v / PARAMETERS.R_w)

    def derivatives(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> dict[str, Any]:
        v_y, omega, wheel = self.v_y(x, v), self.yaw_rate(x, lane), _V / PARAMETERS.R_w
        V, beta = ca.sqrt(v**2 + v_y**2), ca.atan(v_y / v)
        seen = Traced(omega, 0.0), Traced(beta, 0.0), Traced(x.omega_f, wheel), Traced(x.omega_r, wheel)
        f = _published(drift.vehicle_dynamics_std, [0.0, 0.0, Traced(delta, 0.0), Traced(V, _V), 0.0, *seen])
        a_y = f[3] * ca.sin(beta) + V * (f[6] + omega) * ca.cos(beta)
        rate = self.e_y_acceleration(x, v, v_rate, lane, a_y)
        return {"e_y_rate": rate, "e_psi_rate": f[5], "omega_f": f[7], "omega_r": f[8]}


_OWN = (6, 7, 8, 9, *range(11, 29))


@dataclasses.dataclass(frozen=True)
class MultiBody(ldc.VehicleModel):
    """Sprung and unsprung masses, roll, pitch, suspension, wheels: 29 states (M. Althoff)."""

    states = tuple(f"x{i}" for i in _OWN)

    def initial(self, turn: Any) -> dict[str, Any]:
        first = np.array([init_mb([0, 0, 0, v, 0, 0, 0], PARAMETERS) for v in turn.v]).reshape(-1, 29)
        return self.steady_turn(turn, **{f"x{i}": first[:, i] for i in _OWN})

    def derivatives(self, x: Any, delta: Any, v: Any, v_rate: Any, lane: Any) -> dict[str, Any]:
        omega, straight = self.yaw_rate(x, lane), init_mb([0, 0, 0, _V, 0, 0, 0], PARAMETERS)
        own = {i: Traced(getattr(x, f"x{i}"), float(straight[i])) for i in _OWN}
        seen = {2: delta, 5: omega, 10: self.v_y(x, v)}
        every = own | {i: Traced(value, 0.0) for i, value in seen.items()} | {0: 0.0, 1: 0.0, 3: Traced(v, _V), 4: 0.0}
        f = _published(multi_body.vehicle_dynamics_mb, [every[i] for i in range(29)])
        rate = self.e_y_acceleration(x, v, v_rate, lane, f[10] + v * omega)
        return {"e_y_rate": rate, "e_psi_rate": f[5]} | {f"x{i}": f[i] for i in _OWN}
