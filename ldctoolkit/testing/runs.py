"""Runs of a law outside the closed loop: what it commands on a `Road`, sample by sample."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus, Law, LinearLaw, Preview, RecordedPath, SteeringLaw
from ldctoolkit.law_checks import check_law, check_step, check_taken
from ldctoolkit.testing.roads import Road
from ldctoolkit.vehicle import BicycleModel, Plant


@dataclasses.dataclass(frozen=True)
class Commands:
    """What a law said over k samples to n scenarios.

    Attributes
    ----------
    delta : (k, n) [rad]
    status : (k, n) int8
    """

    delta: FloatArray
    status: npt.NDArray[np.int8]

    def take(self, rows: IntArray) -> Commands:
        """Of some of the scenarios."""
        return Commands(self.delta[:, rows], self.status[:, rows])


@dataclasses.dataclass(frozen=True)
class Linear(SteeringLaw):
    """A linear law, called as any other: the formula of `LinearLaw`, summed term by term."""

    law: LinearLaw
    dt: float

    @property
    def preview_times(self) -> FloatArray:
        """As the law has them."""
        return self.law.preview_times

    def init(self, n: int) -> FloatArray:
        """The integral of e_y, 0."""
        return np.zeros(n)

    def step(
        self,
        t: FloatArray,  # noqa: ARG002
        x: FloatArray,
        preview: Preview,
        delta_prev: FloatArray,
        state: FloatArray,
    ) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int8]]:
        """The formula; one term after the other, so that no row depends on how many there are."""
        law = self.law
        delta = law.f_u * delta_prev
        for j in range(4):
            delta = delta + law.F[:, j] * x[:, j]
        for j in range(law.preview_times.size):
            delta = delta + law.G_yaw_rate[:, j] * preview.yaw_rate[:, j] + law.G_heading[:, j] * preview.heading[:, j]
        if law.f_i is not None:
            delta = delta + law.f_i * state
        return delta, state + self.dt * x[:, 0], np.full(delta.size, EventStatus.OK, dtype=np.int8)

    def take(self, rows: IntArray, state: FloatArray) -> tuple[Linear, FloatArray]:
        """Some of the rows."""
        names = [name for name in ("F", "G_yaw_rate", "G_heading", "f_u", "f_i") if getattr(self.law, name) is not None]
        kept: dict[str, Any] = {name: getattr(self.law, name)[rows] for name in names}
        return Linear(dataclasses.replace(self.law, **kept), self.dt), state[rows]


def plant_at(v: FloatArray, dt: float) -> Plant:
    """A new plant of the default vehicle."""
    return Plant.build(BicycleModel(), v.copy(), dt)


def prepared(design: Controller, v: FloatArray, dt: float) -> SteeringLaw | None:
    """The law of a design at these speeds, checked; None where it leaves the departure alone."""
    law: Law = check_law(design.prepare(plant_at(v, dt)), v.size, design.name)
    if isinstance(law, RecordedPath):
        return None
    return Linear(law, dt) if isinstance(law, LinearLaw) else law


class Walk:
    """One run of a law on a road, a sample at a time."""

    def __init__(self, law: SteeringLaw, road: Road, dt: float, name: str) -> None:
        self.law, self.road, self.dt, self.name = law, road, dt, name
        self.times = np.array(law.preview_times, dtype=np.float64)
        self.state: Any = law.init(road.n)
        self.previous = road.delta_0.copy()
        self.k = 0
        self.said: list[tuple[FloatArray, npt.NDArray[np.int8]]] = []

    def seen(self) -> tuple[FloatArray, FloatArray, Preview, FloatArray]:
        """What the law is shown next: arrays of its own."""
        road, k = self.road, self.k
        return road.start + k * self.dt, road.x[k].copy(), road.preview(k, self.times), self.previous.copy()

    def go_on(self) -> None:
        """Take one sample."""
        result = self.law.step(*self.seen(), self.state)
        delta, self.state, status = check_step(result, self.road.n, self.name)
        self.said.append((delta.copy(), status))
        # as the closed loop does
        self.previous = np.where(np.isfinite(delta), delta, self.previous)
        self.k += 1

    def take(self, rows: IntArray) -> bool:
        """Go on with some of the scenarios; False where the law cannot be cut down."""
        taken = check_taken(self.law.take(rows, self.state), rows.size, self.name, self.times)
        if taken is None:
            return False
        self.law, self.state = taken
        self.road, self.previous = self.road.take(rows), self.previous[rows]
        return True

    def to_the_end(self) -> Commands:
        """Take all samples that are left."""
        while self.k < self.road.samples:
            self.go_on()
        return Commands(np.array([delta for delta, _ in self.said]), np.array([status for _, status in self.said]))


def commands(law: SteeringLaw, road: Road, dt: float, name: str) -> Commands:
    """What a law says on a road from beginning to end."""
    return Walk(law, road, dt, name).to_the_end()
