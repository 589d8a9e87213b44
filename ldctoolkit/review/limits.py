"""Limits that contradict each other: those of the law, of the actuator, of the bend, of the departure."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Literal, get_args

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.declared import is_number
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Actuator

Severity = Literal["fault", "warning", "note"]


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that a review found.

    Raises `InputError` for an unknown severity.

    Examples
    --------
    >>> Finding("note", "linear", "The law is linear.").severity
    'note'
    """

    # A fault makes the design useless or dangerous somewhere in the range, a warning is worth a second look, a note
    # says what the numbers stand on
    severity: Severity
    name: str  # The check
    sentence: str  # What was found, what is allowed, what helps
    value: float = math.nan  # The worst value, in SI units; NaN where there is none
    allowed: float = math.nan  # Where the finding starts; NaN where there is none
    v: float = math.nan  # [m/s] Speed of the worst value; NaN where it does not depend on the speed

    def __post_init__(self) -> None:
        if self.severity not in get_args(Severity):
            raise InputError("severity", value=self.severity, allowed=get_args(Severity))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where findings start. A pair is (warning, fault).

    Gain and phase margin, and the damping that goes with the latter, are the lower ends of what is usual: gain margin 2
    to 5, phase margin 30 to 60 degrees (K. J. Astrom, R. M. Murray, *Feedback Systems*, section on stability margins).
    A disk margin of 0.5 stands for gain that changes by a factor of 1.67 and phase that changes by 28 degrees, one of
    the two, or part of both at a time (P. Seiler, A. Packard, P. Gahinet, *An Introduction to Disk Margins*, IEEE
    Control Systems Magazine 40(5), 2020). Faults are at half of these. Sampling ten times faster than the bandwidth is
    a usual lower end (K. J. Astrom, B. Wittenmark, *Computer-Controlled Systems*); half the sampling frequency is
    Nyquist's limit. The others are choices of this toolkit. Raises `InputError` for a value that is not > 0, or a fault
    that starts before its warning.

    Examples
    --------
    >>> Thresholds(gain_margin=(8.0, 4.0)).disk_margin
    (0.5, 0.25)
    """

    gain_margin: tuple[float, float] = (6.0, 3.0)  # [dB] Factor that the loop gain may grow, or shrink, by
    phase_margin: tuple[float, float] = (math.radians(30.0), math.radians(15.0))  # [rad]
    disk_margin: tuple[float, float] = (0.5, 0.25)  # Balanced (skew 0)
    delay_margin: tuple[float, float] = (1.0, 0.5)  # [samples]
    damping: tuple[float, float] = (0.3, 0.1)  # Damping ratio of the closed loop's poles
    sampling: tuple[float, float] = (0.1, 0.5)  # Bandwidth over sampling frequency
    slowest: tuple[float, float] = (10.0, 100.0)  # [s] Time constant of the slowest pole
    bend: tuple[float, float] = (0.1, 0.3)  # [m] |e_y| in a steady bend on the nominal vehicle
    bend_mismatched: tuple[float, float] = (0.3, 0.6)  # [m] The same on a vehicle with other tyres
    hessian: tuple[float, float] = (1e6, 1e12)  # Condition number of the condensed Hessian

    def __post_init__(self) -> None:
        rising = {"sampling", "slowest", "bend", "bend_mismatched", "hessian"}
        for field in dataclasses.fields(self):
            pair = getattr(self, field.name)
            if not (isinstance(pair, tuple) and len(pair) == 2):
                raise InputError(f"thresholds.{field.name}", value=pair, allowed="(warning, fault)")
            if not all(is_number(value) and value > 0 for value in pair):
                raise InputError(f"thresholds.{field.name}", value=pair, allowed="numbers > 0")
            ordered = pair[0] <= pair[1] if field.name in rising else pair[0] >= pair[1]
            if not ordered:
                word = ">=" if field.name in rising else "<="
                raise InputError(
                    f"thresholds.{field.name}", value=pair, allowed=f"(warning, fault), fault {word} warning"
                )


_NO_HORIZON = 1.0  # time [s] within which a law without a horizon should have its limits back
_RARE = 0.01  # share of departures below which wheels that stand beyond the limits are a warning

_OFF_AT_0 = ("a_y_max", "jerk_max", "e_y_max")

_ROUNDING = 1e-9


@dataclasses.dataclass(frozen=True)
class Situation:
    """What limits are held against."""

    v: FloatArray  # (n,) [m/s]
    dt: float  # [s]
    steady: FloatArray  # (n,) [rad] Steering angle that holds the bend
    a_y: FloatArray  # (n,) [m/s^2] Lateral acceleration of the bend
    delta_prev: FloatArray  # (m,) [rad] Angles at which the wheels may stand at a trigger
    delta_prev_v: FloatArray  # (m,) [m/s] Speeds there
    e_y_trigger: float  # [m] e_y at the trigger
    actuator: Actuator


def limit_findings(controller: Controller, situation: Situation) -> Iterator[Finding]:
    """Every contradiction between the limits that a design declares and what it will meet."""
    own = {g.name: getattr(controller, g.name) for g in controller.gains()}
    limits = {name: limit_of(controller, name) for name in ("delta_max", "rate_max", "a_y_max", "e_y_max")}
    yield from _against_actuator(limits, situation.actuator)
    yield from _bend(limits["delta_max"], situation)
    yield from _start(limits, own.get("horizon"), situation)
    if limits["a_y_max"] is not None:
        yield from _acceleration(limits["a_y_max"], limits["delta_max"], situation)
    if limits["e_y_max"] is not None and limits["e_y_max"] <= situation.e_y_trigger:
        yield Finding(
            "warning",
            "corridor",
            f"The law's corridor e_y_max = {limits['e_y_max']:g} m is left already at the trigger, where e_y is "
            f"{situation.e_y_trigger:.3g} m. Widen e_y_max or trigger earlier.",
            limits["e_y_max"],
            situation.e_y_trigger,
        )


def limit_of(controller: Controller, name: str) -> float | None:
    """A limit that a design declares and has set, None otherwise."""
    value = getattr(controller, name) if any(g.name == name for g in controller.gains()) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
        return None
    return None if value == 0 and name in _OFF_AT_0 else float(value)


def _against_actuator(limits: dict[str, float | None], actuator: Actuator) -> Iterator[Finding]:
    for name, unit, word in (("delta_max", "rad", "angle"), ("rate_max", "rad/s", "rate")):
        law, wheel = limits[name], getattr(actuator, name)
        if law is not None and wheel is not None and law > wheel * (1 + _ROUNDING):
            yield Finding(
                "warning",
                f"actuator_{word}",
                f"The law counts on {name} = {law:g} {unit}, the actuator gives {wheel:g} {unit}: what lies between is "
                f"commanded and not steered. Set {name} of the law to at most {wheel:g}.",
                law,
                wheel,
            )


def _tightest(one: float | None, other: float | None) -> float | None:
    return min((limit for limit in (one, other) if limit is not None), default=None)


def _bend(delta_max: float | None, s: Situation) -> Iterator[Finding]:
    """The angle that a bend needs, against the limit of law and actuator."""
    limit = _tightest(delta_max, s.actuator.delta_max)
    i = int(np.argmax(np.abs(s.steady)))
    needed = abs(float(s.steady[i]))
    if limit is not None and needed > limit * (1 + _ROUNDING):
        yield Finding(
            "fault",
            "angle_in_bend",
            f"At {s.v[i]:.3g} m/s a bend of {s.a_y[i]:.3g} m/s^2 needs {needed:.3g} rad of steering; the limit "
            f"delta_max is {limit:.3g} rad. Raise delta_max or leave out such speeds.",
            needed,
            limit,
            float(s.v[i]),
        )


def _start(limits: dict[str, float | None], horizon: object, s: Situation) -> Iterator[Finding]:
    """Wheels that stand beyond the limit at the trigger, and cannot be brought back in one sample."""
    delta_max = _tightest(limits["delta_max"], s.actuator.delta_max)
    rate_max = _tightest(limits["rate_max"], s.actuator.rate_max)
    if delta_max is None or rate_max is None:
        return
    step = rate_max * s.dt
    angles = np.abs(s.delta_prev)
    beyond = angles - delta_max > step * (1 + _ROUNDING)
    if not beyond.any():
        return
    i = int(np.argmax(angles))
    samples = f"{math.ceil((angles[i] - delta_max) / step - _ROUNDING)}" if step > 0 else "all"
    reach, whose = math.ceil(_NO_HORIZON / s.dt), "a second has"
    if isinstance(horizon, int) and not isinstance(horizon, bool):
        reach, whose = horizon, "its horizon is"
    rare = beyond.mean() < _RARE
    share = f" (so in {int(beyond.sum())} of {beyond.size} departures)" if beyond.size > 1 else ""
    yield Finding(
        "warning" if rare else "fault",
        "initial_angle",
        f"At {s.delta_prev_v[i]:.3g} m/s the wheels may stand at {angles[i]:.3g} rad when the law takes over: beyond "
        f"delta_max = {delta_max:g} rad by more than rate_max dt = {step:.3g} rad{share}. No command keeps both "
        f"limits, for {samples} samples ({whose} {reach} samples). Raise delta_max or rate_max.",
        float(angles[i]),
        delta_max + step,
        float(s.delta_prev_v[i]),
    )


def _acceleration(a_y_max: float, delta_max: float | None, s: Situation) -> Iterator[Finding]:
    limit = _tightest(delta_max, s.actuator.delta_max)
    if limit is None:
        return
    reached = limit * s.a_y / np.maximum(np.abs(s.steady), 1e-12)
    below = reached < a_y_max
    if below.any():
        i = int(np.argmin(reached))
        yield Finding(
            "note",
            "acceleration_limit",
            f"Up to {s.v[below].max():.3g} m/s steady cornering at delta_max = {limit:g} rad stays below a_y_max = "
            f"{a_y_max:g} m/s^2 ({reached[i]:.2g} m/s^2 at {s.v[i]:.3g} m/s): delta_max counts there.",
            float(reached[i]),
            a_y_max,
            float(s.v[i]),
        )
