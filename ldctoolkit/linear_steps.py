"""A linear law, called sample by sample as any other."""

from __future__ import annotations

import dataclasses
from typing import final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import EventStatus, LinearLaw, Preview, StatusArray, SteeringLaw
from ldctoolkit.vehicle import Plant

State = tuple[FloatArray, FloatArray | None, FloatArray]


@final
@dataclasses.dataclass(frozen=True)
class LinearSteps(SteeringLaw):
    """The formula of `LinearLaw`; its state is z, earlier commands (n, c), the latest first, and the wheel angle.

    The wheel angle is not measured here: it is what the nominal actuator makes of the commands. Sums are made term by
    term: a scenario's command has the same bits in a batch of any size.

    Attributes
    ----------
    law : LinearLaw
    dt : float [s]
    kept : int
        c.
    whole : int [samples]
        Age of the younger command that moves the wheel within a sample.
    wheel : (n, 3)
        Weights of the wheel angle, that command and the older one in the angle a sample later.

    Examples
    --------
    >>> import numpy as np
    >>> from controllers.lqr import LQR
    >>> from ldctoolkit import BicycleModel, Plant
    >>> plant = Plant.build(BicycleModel(), [20.0], 0.05)
    >>> LinearSteps.of(LQR().prepare(plant), plant).preview_times
    array([0.])
    """

    law: LinearLaw
    dt: float
    kept: int
    whole: int
    wheel: FloatArray

    @classmethod
    def of(cls, law: LinearLaw, plant: Plant) -> LinearSteps:
        """A law that was prepared with a plant."""
        wheel, past, whole = np.tile([0.0, 1.0, 0.0], (plant.n, 1)), 0, 0
        if law.f_wheel is not None:
            step = plant.augmented
            whole = step.whole
            if plant.lag > 0:
                wheel = np.column_stack([step.A[:, 4, 4], step.B[:, 4], step.B_old[:, 4]])
        if law.f_past is not None:
            past = law.f_past.shape[1]
        return cls(law, plant.dt, max(past, whole + 1) if law.knows_actuator else 0, whole, wheel)

    @property
    def preview_times(self) -> FloatArray:
        """Those of the linear law."""
        return self.law.preview_times

    def init(self, n: int) -> State:
        """No integral; the commands before the trigger are those that the first step is shown."""
        return np.zeros(n), None, np.zeros(n)

    def step(
        self,
        t: FloatArray,  # noqa: ARG002
        x: FloatArray,
        preview: Preview,
        delta_prev: FloatArray,
        state: State,
    ) -> tuple[FloatArray, State, StatusArray]:
        """The weighted sum, and the state for the next sample."""
        law, (z, past, angle) = self.law, state
        if past is None:
            past, angle = np.repeat(delta_prev[:, None], self.kept, axis=1), delta_prev
        elif law.f_wheel is not None:
            young, old = delta_prev if self.whole == 0 else past[:, self.whole - 1], past[:, self.whole]
            angle = self.wheel[:, 0] * angle + self.wheel[:, 1] * young + self.wheel[:, 2] * old
        delta = law.f_u * delta_prev
        if law.f_i is not None:
            delta += law.f_i * z
        if law.f_wheel is not None:
            delta += law.f_wheel * angle
        for i in range(4):
            delta += law.F[:, i] * x[:, i]
        for j in range(law.preview_times.size):
            delta += law.G_yaw_rate[:, j] * preview.yaw_rate[:, j] + law.G_heading[:, j] * preview.heading[:, j]
        if law.f_past is not None:
            for j in range(law.f_past.shape[1]):
                delta += law.f_past[:, j] * past[:, j]
        if self.kept:
            past = np.column_stack([delta_prev, past[:, :-1]])
        return delta, (z + self.dt * x[:, 0], past, angle), np.full(delta.size, EventStatus.OK, dtype=np.int8)

    def take(self, rows: IntArray, state: State) -> tuple[LinearSteps, State]:
        """Only some scenarios."""
        law, (z, past, angle) = self.law, state
        arrays = {name: value for name, value in vars(law).items() if name != "preview_times" and value is not None}
        kept = dataclasses.replace(law, **{name: value[rows] for name, value in arrays.items()})
        left = z[rows], None if past is None else past[rows], angle[rows]
        return dataclasses.replace(self, law=kept, wheel=self.wheel[rows]), left
