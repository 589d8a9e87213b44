"""Plants that differ from a study's own in one option each, with values of the usual size."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Final

from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.vehicle import Convention

REAL: Final = PlantOptions(
    speed="profile",
    actuator=Actuator(rate_max=0.33, lag=0.1, delay=0.05),
    mismatch=Mismatch(m=(1.0, 1.3), I_z=(1.0, 1.3), C_af=(0.8, 1.2), C_ar=(0.8, 1.2)),
    tyres=Tyres(model="magic_formula", mu=0.9),
    sensors=Sensors(e_y_noise=0.03, e_psi_noise=0.003, delay=0.1, curvature_noise=2e-4, kalman=KalmanFilter()),
)
"""The plant of the catalog's study `reality`, where the reason for each value stands."""

ANGLE: Final = 0.1
"""Limit of the steering angle [rad]: about 90 deg at a steering wheel with a ratio of 16."""

LIGHT: Final = 0.85
"""Factor on mass and yaw inertia of a vehicle that is lighter than the laws know it."""


@dataclasses.dataclass(frozen=True)
class OtherPlant:
    """A plant to drive on."""

    name: str  # Letters and dashes
    title: str  # A few words
    what: str  # What is different, with values and units
    options: PlantOptions


def other_plants(options: PlantOptions) -> tuple[OtherPlant, ...]:
    """The variations of a study's plant; an option that it has already is taken away."""
    plants = [*_actuator(options), *_mismatch(options), *_tyres(options), *_camera(options), *_departure(options)]
    if options.ideal:
        what = "the plant of the catalog\u2019s study reality: actuator, mismatch, tyres, camera with filter, speed"
        plants.append(OtherPlant("together", "Many at once", what, REAL))
    else:
        plants.append(
            OtherPlant("ideal", "Ideal plant", "none of the options of the study\u2019s plant", PlantOptions())
        )
    return tuple(plants)


def impossible(plant: OtherPlant, convention: Convention, has_residuals: bool) -> str:
    """Why a plant cannot be driven on; empty where it can."""
    if convention != "consistent" and not plant.options.tyres.ideal:
        return "the matrix as printed is linear and has no saturating tyres"
    if not plant.options.residuals.ideal and not has_residuals:
        return "the departures have no residuals"
    return ""


def _with(options: PlantOptions, name: str, title: str, what: str, **parts: object) -> OtherPlant:
    return OtherPlant(name, title, what, dataclasses.replace(options, **parts))  # type: ignore[arg-type]


def _actuator(options: PlantOptions) -> Iterator[OtherPlant]:
    own, real = options.actuator, REAL.actuator
    delay, lag = (0.0 if own.delay else real.delay), (0.0 if own.lag else real.lag)
    what = f"{delay:g} s from command to actuator" if delay else "no delay"
    yield _with(options, "delay", "Actuator delay", what, actuator=dataclasses.replace(own, delay=delay))
    what = f"time constant of {lag:g} s" if lag else "no lag"
    yield _with(options, "lag", "Actuator lag", what, actuator=dataclasses.replace(own, lag=lag))
    if own.rate_max is None and own.delta_max is None:
        limited = dataclasses.replace(own, rate_max=real.rate_max, delta_max=ANGLE)
        what = f"at most {ANGLE:g} rad and {real.rate_max:g} rad/s at the front wheels"
    else:
        limited, what = dataclasses.replace(own, rate_max=None, delta_max=None), "no limits of angle and rate"
    yield _with(options, "limits", "Steering limits", what, actuator=limited)


def _mismatch(options: PlantOptions) -> Iterator[OtherPlant]:
    own, heavy, soft_stiff = options.mismatch, REAL.mismatch.m[1], REAL.mismatch.C_af
    none = (1.0, 1.0)
    if (own.m, own.I_z) == (none, none):
        for name, title, factor in (("heavy", "Heavier vehicle", heavy), ("light", "Lighter vehicle", LIGHT)):
            pair = (factor, factor)
            what = f"mass and yaw inertia times {factor:g}; laws do not know"
            yield _with(options, name, title, what, mismatch=dataclasses.replace(own, m=pair, I_z=pair))
    else:
        mismatch = dataclasses.replace(own, m=none, I_z=none)
        yield _with(options, "mass", "Mass as known", "mass and yaw inertia as the laws know them", mismatch=mismatch)
    if (own.C_af, own.C_ar) == (none, none):
        for name, title, factor in zip(("soft", "stiff"), ("Softer tyres", "Stiffer tyres"), soft_stiff, strict=True):
            pair = (factor, factor)
            what = f"cornering stiffness of both axles times {factor:g}; laws do not know"
            yield _with(options, name, title, what, mismatch=dataclasses.replace(own, C_af=pair, C_ar=pair))
    else:
        mismatch = dataclasses.replace(own, C_af=none, C_ar=none)
        yield _with(options, "stiffness", "Stiffness as known", "cornering stiffness as the laws know it",
                    mismatch=mismatch)  # fmt: skip


def _tyres(options: PlantOptions) -> Iterator[OtherPlant]:
    if options.tyres.ideal:
        what = f"magic formula, friction coefficient {REAL.tyres.mu:g}"
        yield _with(options, "tyres", "Saturating tyres", what, tyres=REAL.tyres)
    else:
        mismatch = dataclasses.replace(options.mismatch, mu=(1.0, 1.0))  # linear tyres have no friction coefficient
        yield _with(options, "tyres", "Linear tyres", "tyres do not saturate", tyres=Tyres(), mismatch=mismatch)


def _camera(options: PlantOptions) -> Iterator[OtherPlant]:
    own, real, ideal = options.sensors, REAL.sensors, Sensors()
    timing = {"period", "delay", "kalman"}
    errors = [field.name for field in dataclasses.fields(Sensors) if field.name not in timing]
    if any(getattr(own, name) for name in errors):
        sensors, what = dataclasses.replace(own, **{name: getattr(ideal, name) for name in errors}), "no errors"
    else:
        sensors = dataclasses.replace(own, **{name: getattr(real, name) for name in errors})
        what = (
            f"standard deviations of {real.e_y_noise:g} m, {real.e_psi_noise:g} rad, and {real.curvature_noise:g} 1/m "
            "in the curvature"
        )
    yield _with(options, "noise", "Camera noise", what, sensors=sensors)
    delay = 0.0 if own.delay or own.period else real.delay
    sensors = dataclasses.replace(own, delay=delay, period=0.0)
    what = f"{delay:g} s from light to number" if delay else "frames at every sample, at once"
    yield _with(options, "camera-delay", "Camera delay", what, sensors=sensors)
    if own.kalman is None:
        # without noise a filter knows the state as well as the laws do
        sensors = dataclasses.replace(own, kalman=real.kalman, **{name: getattr(real, name) for name in errors})
        what = "it gives no rates: a Kalman filter estimates them from its numbers with the noise above"
        yield _with(options, "filter", "Camera with filter", what, sensors=sensors)
    else:
        sensors = dataclasses.replace(own, kalman=None)
        yield _with(options, "filter", "No Kalman filter", "laws see the true rates", sensors=sensors)


def _departure(options: PlantOptions) -> Iterator[OtherPlant]:
    if options.speed == "frozen":
        what = "the speed follows the departure, it is not frozen at the trigger"
        yield _with(options, "speed", "Speed profile", what, speed="profile")
    else:
        yield _with(options, "speed", "Frozen speed", "the speed of the trigger stays", speed="frozen")
    if options.residuals.ideal:
        what = "the recorded path and speed leave their fitted curves"
        yield _with(options, "residuals", "Residuals", what, residuals=Residuals(y=True, v=True))
    else:
        yield _with(options, "residuals", "No residuals", "path and speed are the fitted curves", residuals=Residuals())
