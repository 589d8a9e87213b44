"""What all designs of a comparison share: vehicle, clock, plant, seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final, Literal, get_args

import numpy.typing as npt

from ldctoolkit.declared import Declaration, check_declared, checked_seed, declarations, declared, short_repr
from ldctoolkit.errors import CheckedArguments, InputError, expect
from ldctoolkit.plant_options import Driver, Mismatch, PlantOptions
from ldctoolkit.vehicle import BicycleModel, Convention, Plant, VehicleModel, VehicleParameters

InitialYawRate = Literal["path", "zero"]
Start = Literal["steady", "printed"]
Trigger = Literal["distance", "ttlc"]
PlantKnowledge = Literal["nominal", "ideal"]

TTLC: Final = 1.0  # time to line crossing [s] of a trigger that goes by it
SETTLE: Final = 3.0  # how long [s] the loop goes on after the departure by default, to see whether it settles


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup(CheckedArguments):
    """How scenarios are driven, whichever design drives them; passed whole from a study to the closed loop.

    A number or word made with `declared` is an option of the simulation: it is checked here, and the table
    ``[simulation]`` of a study file and the settings of a report have it too. Raises `InputError` for a value outside
    what is allowed, or values that exclude each other.

    Attributes
    ----------
    vehicle : VehicleParameters
        The nominal vehicle, which every design is made for.
    convention : {"consistent", "as_printed"}
        Reading of the paper, as for `BicycleModel`.
    options : PlantOptions
        In what the plant differs from the ideal linear one.
    seed : int
        Of what is drawn for each scenario; with the scenario's number (`Scenarios.index`) it decides every draw.
    dt : float [s]
        Sample time of the controller, up to 10.
    initial_yaw_rate : {"path", "zero"}
        de_psi/dt at the trigger: that of the recorded path, (d2y/dt2)/v, or zero.
    start : {"steady", "printed"}
        Heading error and steering angle at the trigger: those of the steady turn with the recorded path's lateral
        acceleration, on the plant that is driven. ``"printed"`` is the paper's: its e_psi = arctan(v_y/v) has no side
        slip and does not fit the steering angle, so the lateral acceleration jumps.
    settle : float [s]
        How long the loop goes on after the departure, 0 to 60, rounded up to whole samples: the way back, acceleration
        and steering are watched until then. S always ends at T.
    plant_knowledge : {"nominal", "ideal"}
        What a design may know of actuator and camera: their lag and delays, or nothing, as if there were none. Limits,
        noise, bias and mismatch are never known.
    trigger : {"distance", "ttlc"}
        Control starts when the edge is further than y_s beyond the line (before it where y_s < 0), or when the time
        until it will be, at the present lateral velocity, falls below `ttlc`.
    ttlc : float [s]
        That time to line crossing, up to 10; only of the trigger ``"ttlc"``.
    vehicle_model : VehicleModel, optional
        What is driven in place of the single track. Designs are still made for `vehicle`; it and `options.tyres` also
        give the recorded path its heading before the trigger. Mismatch, `convention` and `start` keep their defaults.

    Examples
    --------
    >>> Setup(dt=0.02).settle
    3.0
    >>> Setup(dt=0)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: dt: 0; allowed: a finite number > 0 and <= 10 s
    """

    __repr__ = short_repr

    vehicle: VehicleParameters = declared(VehicleParameters)
    convention: Convention = "consistent"
    options: PlantOptions = declared(PlantOptions)
    seed: int = 0
    dt: float = declared(0.05, unit="s", above=0.0, upper=10.0, usual=(1e-3, 1.0), description="sample time dt")
    initial_yaw_rate: InitialYawRate = declared(
        "path", choices=get_args(InitialYawRate), description="initial yaw rate"
    )
    start: Start = declared("steady", choices=get_args(Start), description="state at the trigger")
    settle: float = declared(SETTLE, unit="s", lower=0.0, upper=60.0, description="settling after the end")
    plant_knowledge: PlantKnowledge = declared(
        "nominal", choices=get_args(PlantKnowledge), description="what laws know of actuator and camera"
    )
    trigger: Trigger = declared("distance", choices=get_args(Trigger), description="trigger")
    ttlc: float = declared(
        TTLC, unit="s", above=0.0, upper=10.0, usual=(0.01, 10.0), description="time to line crossing at the trigger"
    )
    vehicle_model: VehicleModel | None = None

    def __post_init__(self) -> None:
        check_declared(self)
        expect("vehicle_model", self.vehicle_model, VehicleModel | None)
        if self.trigger == "distance" and self.ttlc != TTLC:
            raise InputError(
                "ttlc", "is ignored with trigger 'distance'", value=self.ttlc, hint="trigger = 'ttlc' uses it"
            )
        object.__setattr__(self, "seed", checked_seed(self.seed))
        object.__setattr__(self, "options", self.options.sampled(self.dt))
        if self.model.convention != "consistent" and not self.options.tyres.ideal:
            raise InputError(
                "convention",
                f"cannot be combined with tyres.model {self.options.tyres.model!r}: the printed matrix is linear",
                value=self.convention,
                allowed="'consistent'",
            )
        if self.vehicle_model is not None:
            options = self.options
            for name, value, default in (
                ("convention", self.convention, "consistent"),
                ("start", self.start, "steady"),
                ("mismatch", options.mismatch, Mismatch()),
                ("driver", options.driver, Driver()),
            ):
                if value != default:
                    hint = "they belong to the single track: the model brings its own"
                    raise InputError(name, "with a vehicle model", value=value, allowed=repr(default), hint=hint)

    @property
    def ahead(self) -> float:
        """How far the trigger looks ahead [s]."""
        return self.ttlc if self.trigger == "ttlc" else 0.0

    @property
    def model(self) -> BicycleModel:
        """The nominal vehicle's linear model."""
        return BicycleModel(self.vehicle, self.convention)

    def plant(self, v: npt.ArrayLike) -> Plant:
        """The plant as far as a design may know it, at speeds v (n,) [m/s]."""
        if self.plant_knowledge == "ideal":
            return Plant.build(self.model, v, self.dt)
        actuator, age = self.options.actuator, self.options.sensors.age(self.dt)
        return Plant.build(self.model, v, self.dt, lag=actuator.lag, delay=actuator.delay + age, age=age)

    def on(self, options: PlantOptions) -> Setup:
        """The setup with other plant options."""
        return dataclasses.replace(self, options=options)


def simulation_options() -> Iterator[Declaration]:
    """The fields of a `Setup` that are options of the simulation."""
    return (declaration for declaration in declarations(Setup).values() if declaration.kind is None)
