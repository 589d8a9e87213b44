"""What a controller may know when it is prepared: the model, each scenario's speed, the sample time."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import numpy.typing as npt

from ldctoolkit.vehicle.augmented import AugmentedStep, augmented
from ldctoolkit.vehicle.bicycle import BicycleModel, SteadyState
from ldctoolkit.vehicle.discretization import Discretization


@dataclasses.dataclass(frozen=True)
class Plant:
    """The vehicle discretised once for a scenario set, shared by every design.

    It carries no scenario but the speed at which each is driven, so that a design cannot look at its own examination.

    Attributes
    ----------
    model : BicycleModel
        The continuous model.
    v : (n,) [m/s]
        Speed of each scenario, frozen at the trigger.
    dt : float [s]
        Sample time of the controller.
    step : Discretization
        One step of dt at each speed, of the vehicle alone.
    lag : float [s]
        Time constant of the nominal actuator; 0 for none.
    delay : float [s]
        From the moment that the law sees to the moment at which its command acts: delay of the nominal actuator and
        `age`.
    age : float [s]
        How old a frame of the nominal camera is, on average, when the law first sees it. The lane ahead is that of the
        present.
    """

    model: BicycleModel
    v: npt.NDArray[np.float64]
    dt: float
    step: Discretization
    lag: float = 0.0
    delay: float = 0.0
    age: float = 0.0

    @classmethod
    def build(
        cls, model: BicycleModel, v: npt.ArrayLike, dt: float, *, lag: float = 0.0, delay: float = 0.0, age: float = 0.0
    ) -> Plant:
        """Discretise `model` at the speeds `v` (n,) [m/s] with the step `dt` [s]; `delay` includes `age`."""
        speed = np.atleast_1d(np.asarray(v, dtype=float))
        return cls(model, speed, float(dt), model.discretize(speed, dt), lag=lag, delay=delay, age=age)

    def at(self, v: npt.ArrayLike) -> Plant:
        """The same plant at other speeds (n,) [m/s]."""
        return Plant.build(self.model, v, self.dt, lag=self.lag, delay=self.delay, age=self.age)

    @functools.cached_property
    def augmented(self) -> AugmentedStep:
        """One sample behind the actuator at each speed, as what the law sees moves on; worked out once."""
        return augmented(*self.model.matrices(self.v), self.dt, lag=self.lag, delay=self.delay)

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return int(self.v.shape[0])

    def steady_state(self) -> SteadyState:
        """Steady cornering at each scenario's speed, per unit of lane yaw rate; worked out once for all designs."""
        return self._steady_state

    @functools.cached_property
    def _steady_state(self) -> SteadyState:
        return self.model.steady_state(self.v)
