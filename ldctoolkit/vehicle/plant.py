"""What a controller may know when it is prepared: the model, each scenario's speed, the sample time."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import numpy.typing as npt

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
        One step of dt at each speed.
    """

    model: BicycleModel
    v: npt.NDArray[np.float64]
    dt: float
    step: Discretization

    @classmethod
    def build(cls, model: BicycleModel, v: npt.ArrayLike, dt: float) -> Plant:
        """Discretise `model` at the speeds `v` (n,) [m/s] with the step `dt` [s]."""
        speed = np.atleast_1d(np.asarray(v, dtype=float))
        return cls(model=model, v=speed, dt=float(dt), step=model.discretize(speed, dt))

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
