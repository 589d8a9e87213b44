"""How a study drives: what other plants share with its own."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from ldctoolkit import BicycleModel, VehicleParameters
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.simulation import SETTLE, InitialYawRate, Takeover
from studies.results import Case

if TYPE_CHECKING:
    from ldctoolkit import Scenarios
    from studies.study_file.spec import Study


@dataclasses.dataclass(frozen=True)
class Setting:
    """Vehicle, clock, plant and case of a study.

    Attributes
    ----------
    case : Case
        Window and convention.
    vehicle : VehicleParameters
    dt : float [s]
    initial_yaw_rate : {"path", "zero"}
    options : PlantOptions
    settle : float [s]
    seed : int
    """

    case: Case
    vehicle: VehicleParameters = dataclasses.field(default_factory=VehicleParameters)
    dt: float = 0.05
    initial_yaw_rate: InitialYawRate = "path"
    options: PlantOptions = dataclasses.field(default_factory=PlantOptions)
    settle: float = SETTLE
    seed: int = 0

    @classmethod
    def of(cls, study: Study, case: Case) -> Setting:
        """That of a study in one of its cases."""
        return cls(
            case=case,
            vehicle=study.vehicle,
            dt=study.simulation.dt,
            initial_yaw_rate=study.simulation.initial_yaw_rate,
            options=study.plant,
            settle=study.simulation.settle,
            seed=study.seed,
        )

    @property
    def model(self) -> BicycleModel:
        """The nominal vehicle."""
        return BicycleModel(self.vehicle, self.case.convention)

    def takeover(self, scenarios: Scenarios, y_s: float, options: PlantOptions) -> Takeover:
        """Scenarios at their triggers, on a plant."""
        return Takeover.build(
            scenarios,
            self.model,
            y_s=y_s,
            dt=self.dt,
            initial_yaw_rate=self.initial_yaw_rate,
            options=options,
            seed=self.seed,
            settle=self.settle,
        )
