"""Predictive controllers that a designer might write."""

import dataclasses
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from ldctoolkit import PredictiveController, Soft, Stage, gain

frozen = dataclasses.dataclass(frozen=True)


def horizon(samples: int = 20) -> Any:
    return gain(samples, unit="samples", lower=1, upper=100, description="prediction horizon")


def weight(value: float) -> Any:
    return gain(value, unit="1", lower=0.0, upper=1e6, description="a weight")


HARD = (0.1, 0.01)  # [rad] of angle and change


def hard(u: Any) -> list[tuple[Any, float, float]]:
    return [(u.delta, -HARD[0], HARD[0]), (u.change, -HARD[1], HARD[1])]


@frozen
class Corridor(PredictiveController):
    """Soft limits on jerk and offset."""

    name, title = "corridor", "Corridor MPC"
    horizon: int = horizon()
    r: float = weight(2e4)
    width: float = weight(0.3)

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + x.e_psi**2 + self.r * (u.delta - lane.steady_delta) ** 2
        soft = [Soft(x.jerk, -5.0, 5.0), Soft(x.e_y, upper=lane.offset + self.width, weight=1e2)]
        return Stage(cost, hard=hard(u), soft=soft)


class Held(Corridor):
    """Free moves that are held."""

    name, move_blocks = "held", 5


class Narrow(Held):
    """Moves that are held while the limits of the angle narrow."""

    name = "narrow"

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        limits = [(u.delta, 0.002 * k - HARD[0], HARD[0] - 0.002 * k), (u.change, -HARD[1], HARD[1])]
        return dataclasses.replace(super().stage(x, u, lane, k), hard=limits)


class Three(Corridor):
    """A real-time iteration."""

    name, iterations = "three", 3


class Fading(Corridor):
    """A soft limit that costs nothing in sharp bends."""

    name, horizon = "fading", 8

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        weight = 100.0 * ca.fmax(0.0, 1.0 - (500.0 * lane.curvature) ** 2)
        return dataclasses.replace(super().stage(x, u, lane, k), soft=[Soft(x.e_y, upper=lane.offset, weight=weight)])


@frozen
class Slow(PredictiveController):
    """Two states of its own, the command before among the terms."""

    name, title = "slow", "Slow actuator"
    states: ClassVar[tuple[str, ...]] = ("wheel", "area")
    horizon: int = horizon()
    r: float = weight(2e4)
    tau: float = weight(0.1)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        rates = vehicle.nonlinear(x, x.wheel, lane)
        return {**rates, "wheel": (u.delta - x.wheel) / self.tau, "area": x.e_y - 0.01 * x.area}

    def initial(self, x: Any, delta: Any) -> Any:
        return {"area": 0.5 * x[:, 0] + delta - 0.1}

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + 0.1 * x.area**2 + 1e4 * u.change**2
        cost += self.r * (u.delta - lane.steady_delta) ** 2
        return Stage(cost, hard=hard(u), soft=[Soft(x.a_y, -3, 3)])


class Bent(Slow):
    """States that begin with a square."""

    name = "bent"

    def initial(self, x: Any, delta: Any) -> Any:
        return {"area": np.square(x[:, 0])}


@frozen
class Quadratic(PredictiveController):
    """One quadratic program a step."""

    name, title = "quadratic", "LQ MPC"
    horizon: int = horizon()
    r: float = weight(2e4)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return vehicle.linear(x, u.delta, lane)

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + self.r * (u.delta - lane.steady_delta) ** 2
        return Stage(cost, hard=hard(u))


class Rooted(Quadratic):
    """A limit that is no number in sharp bends."""

    name, horizon = "rooted", 8

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        limits = [(u.delta, -HARD[0], 3.0 * ca.sqrt(0.002 - lane.curvature)), (u.change, -HARD[1], HARD[1])]
        return dataclasses.replace(super().stage(x, u, lane, k), hard=limits)
