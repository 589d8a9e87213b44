"""The review of one design: its loop against thresholds, its limits against each other, and what is left out."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.declared import GainValue, check_declared, checked_number, declared, is_number
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.law_checks import check_controller
from ldctoolkit.plant_options import Actuator, PlantOptions
from ldctoolkit.review.law_model import KINK, LARGER, PULSE, LinearView, held_wheels, linear_view
from ldctoolkit.review.loop_numbers import BEND_ERROR, MISMATCH, LoopNumbers, loop_numbers
from ldctoolkit.setup import PlantKnowledge, Setup
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.bicycle import checked_speeds
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE

Severity = Literal["fault", "warning", "note"]


@dataclasses.dataclass(frozen=True)
class Finding:
    """One result of a review.

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
    sentence: str  # The result, what is allowed, what helps
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

    # [dB] Factor that the loop gain may grow, or shrink, by
    gain_margin: tuple[float, float] = declared((6.0, 3.0), unit="dB", above=0.0, pair="descending")
    phase_margin: tuple[float, float] = declared(
        (math.radians(30.0), math.radians(15.0)), unit="rad", above=0.0, pair="descending"
    )
    disk_margin: tuple[float, float] = declared((0.5, 0.25), above=0.0, pair="descending")  # Balanced (skew 0)
    delay_margin: tuple[float, float] = declared((1.0, 0.5), unit="samples", above=0.0, pair="descending")
    # Damping ratio of the closed loop's poles
    damping: tuple[float, float] = declared((0.3, 0.1), above=0.0, pair="descending")
    # Bandwidth over sampling frequency
    sampling: tuple[float, float] = declared((0.1, 0.5), above=0.0, pair="ascending")
    # [s] Time constant of the slowest pole
    slowest: tuple[float, float] = declared((10.0, 100.0), unit="s", above=0.0, pair="ascending")
    # [m] |e_y| in a steady bend on the nominal vehicle, and on a vehicle with other tyres
    bend: tuple[float, float] = declared((0.1, 0.3), unit="m", above=0.0, pair="ascending")
    bend_mismatched: tuple[float, float] = declared((0.3, 0.6), unit="m", above=0.0, pair="ascending")
    # Condition number of the condensed Hessian
    hessian: tuple[float, float] = declared((1e6, 1e12), above=0.0, pair="ascending")

    def __post_init__(self) -> None:
        check_declared(self, "thresholds")


def _at(
    severity: Severity, name: str, v: FloatArray, i: int, text: str, value: float = math.nan, allowed: float = math.nan
) -> Finding:
    """A finding about the i-th of the speeds v."""
    return Finding(severity, name, f"At {v[i]:.3g} m/s {text}", float(value), allowed, float(v[i]))


def _count(affected: BoolArray, of: str = "at {} of {} speeds") -> str:
    """How many of several speeds, or departures, are affected."""
    return f" (so {of.format(int(affected.sum()), affected.size)})" if affected.size > 1 else ""


# ------------------------------------------------------------------------------------------------ the law by itself

_NONLINEAR: Final = 0.05  # Relative difference of the answers to small and larger pulses from which it is reported
_UNEXPLAINED: Final = 0.02  # Part of a pulse response that the model of the memory may miss without a report


def law_findings(controller: Controller, view: LinearView, v: FloatArray) -> Iterator[Finding]:
    """Findings on a law by itself."""
    bound = limit_of(controller, "e_y_max")
    if not view.finite.all():
        text = "the law gives commands that are not finite numbers near straight, centred driving."
        yield _at("fault", "finite", v, int(np.argmin(view.finite)), f"{text} Nothing else can be said about its loop.")
    elif not view.quiet.all():
        text = "the law steers while driving straight and centred."
        yield _at("fault", "quiet", v, int(np.argmin(view.quiet)), text)
    if view.finite.all() and not view.exact:
        memory = f"a memory of order {view.order}" if view.order else "no memory"
        text = (
            "The law is not linear by its type: poles and margins are those of small deviations from straight driving "
            f"(pulses of {PULSE[0]:g} m, {PULSE[1]:g} m/s and {PULSE[2]:g} rad or less), with {memory}."
        )
        yield Finding("note", "linearised", text)
        i = int(np.argmax(view.kink))
        if view.kink[i] > KINK:
            text = (
                f"the law is not linear around straight driving: answers to small pulses differ by "
                f"{100 * view.kink[i]:.3g} % of the largest from those of its linear part, as where a limit is active "
                "or the cost has a kink. It has no poles and margins."
            )
            yield _at("warning", "kink", v, i, text, view.kink[i], KINK)
            return
        i = int(np.argmax(view.nonlinearity))
        if view.nonlinearity[i] > _NONLINEAR:
            text = (
                f"the answers to pulses {LARGER:g} times larger differ from proportional ones by "
                f"{100 * view.nonlinearity[i]:.2g} % of the largest: poles and margins hold for small deviations only."
            )
            yield _at("note", "nonlinear", v, i, text, view.nonlinearity[i], _NONLINEAR)
        i = int(np.argmax(view.unexplained))
        if view.unexplained[i] > _UNEXPLAINED:
            text = (
                f"{100 * view.unexplained[i]:.2g} % of the law's answer to a pulse are not those of a small linear "
                "system: poles and margins may be wrong."
            )
            yield _at("warning", "memory", v, i, text, view.unexplained[i], _UNEXPLAINED)
    if bound is not None and not view.exact:
        text = f"The law keeps |e_y| <= e_y_max = {bound:g} m by itself: the loop while that bound holds the command"
        yield Finding("note", "bound", f"{text} is not looked at, poles and margins are those far from it.")


# ------------------------------------------------------------------------------------------------ the loop


@dataclasses.dataclass(frozen=True)
class Check:
    """One number of a loop against its thresholds."""

    name: str
    values: FloatArray  # (n,) NaN where there is none
    limits: tuple[float, float]  # Where a warning starts, and a fault
    text: str  # Half a sentence with {value}
    help: str  # What helps, a sentence without its full stop
    unit: str = ""
    factor: float = 1.0  # From SI units to those that are shown
    at_least: bool = True  # Small values are the bad ones

    def findings(self, v: FloatArray) -> Iterator[Finding]:
        """The finding at the worst speed, none where all is well."""
        sign = -1.0 if self.at_least else 1.0
        badness = np.where(np.isnan(self.values), -math.inf, sign * self.values)
        i, warning, fault = int(np.argmax(badness)), sign * self.limits[0], sign * self.limits[1]
        if badness[i] > warning:
            value, limit = (f"{x * self.factor:.3g} {self.unit}".rstrip() for x in (self.values[i], self.limits[0]))
            bound = f"{'at least' if self.at_least else 'at most'} {limit}{_count(badness > warning)}"
            text = f"{self.text.format(value=value)}; allowed: {bound}. {self.help}."
            severity: Severity = "fault" if badness[i] > fault else "warning"
            yield _at(severity, self.name, v, i, text, self.values[i], self.limits[0])


def loop_findings(numbers: LoopNumbers, controller: Controller, dt: float, thresholds: Thresholds) -> Iterator[Finding]:
    """Findings on the numbers of a loop."""
    n, v, softer = numbers, numbers.v, _softer(controller)
    if not n.stable.all():
        i = int(np.argmax(n.radius))
        text = (
            f"a deviation is never corrected: a pole of the closed loop lies on the stability limit{_count(~n.stable)}."
            " Give the law a gain on both e_y and e_psi."
        )
        if n.radius[i] > 1.0 + 1e-6:
            digits = max(2, 1 - math.floor(math.log10(n.radius[i] - 1.0)))  # As many as tell it from 1
            factor = f"{n.radius[i]:.3g}" if n.radius[i] >= 1.1 else f"{n.radius[i]:.{digits}f}"
            text = (
                f"the closed loop is unstable: a deviation grows by a factor of {factor} a sample of {dt:g} s"
                f"{_count(~n.stable)}. {softer}, or shorten delay and lag."
            )
        yield _at("fault", "stability", v, i, text, n.radius[i], 1.0)
    other_tyres = f"on tyres that are {100 * MISMATCH:g} % softer or stiffer than the law knows"
    unstable = np.isinf(n.e_y_bend_mismatched)
    if unstable.any():
        text = f"the closed loop is unstable {other_tyres}{_count(unstable)}. {softer}, or shorten delay and lag."
        yield _at("fault", "stability_mismatched", v, int(np.argmax(unstable)), text)
    for check in _checks(numbers, dt, thresholds, softer, other_tyres):
        yield from check.findings(v)
    i, wrong = int(np.argmax(n.bend_error)), n.bend_error > BEND_ERROR
    if wrong.any():
        text = (
            f"the law is not linear in a steady bend: its command there differs by {100 * n.bend_error[i]:.3g} % from "
            f"what small deviations predict. Offsets in the bend are left out ({int(wrong.sum())} of {wrong.size} "
            "speeds)."
        )
        yield _at("note", "bend_not_linear", v, i, text, n.bend_error[i], BEND_ERROR)


def _checks(numbers: LoopNumbers, dt: float, t: Thresholds, softer: str, other_tyres: str) -> tuple[Check, ...]:
    n, sampling = numbers, 2.0 * math.pi / dt
    damping, slowest = (np.where(n.stable, values, np.nan) for values in (n.damping, n.slowest))
    offset = f"a steady bend of {(n.bend * n.v).max():.3g} m/s^2 leaves an offset of {{value}}"
    nominal, mismatched = np.abs(n.e_y_bend), np.abs(n.e_y_bend_mismatched)
    beyond = ", above the Nyquist frequency, which is half of it" if n.bandwidth.max() > 0.5 * sampling else ""
    rate = f"the loop's bandwidth is {{value}} of the sampling frequency of {sampling:.3g} rad/s{beyond}"
    delay = (t.delay_margin[0] * dt, t.delay_margin[1] * dt)
    return (
        Check("gain_margin", n.gain_margin, t.gain_margin, "the loop has a gain margin of {value}", softer, "dB"),
        Check("gain_reduction_margin", n.gain_reduction_margin, t.gain_margin,
              "the loop gets unstable if its gain shrinks by {value}", "Weigh e_psi and the rates more against e_y",
              "dB"),
        Check("phase_margin", n.phase_margin, t.phase_margin, "the loop has a phase margin of {value}", softer, "deg",
              180.0 / math.pi),
        Check("disk_margin", n.disk_margin, t.disk_margin, "the loop has a disk margin of {value}", softer),
        Check("delay_margin", n.delay_margin, delay, "the loop stands no more additional delay than {value}", softer,
              "ms", 1000.0),
        Check("damping", damping, t.damping, "the closed loop has a damping ratio of {value}", softer),
        Check("slowest_pole", slowest, t.slowest, "the slowest pole of the closed loop has a time constant of {value}",
              "Raise the gain on e_y or its integral", "s", at_least=False),
        Check("hessian", n.hessian_condition, t.hessian, "the condensed Hessian has a condition number of {value}",
              "Raise r_delta against the other weights or shorten the horizon", at_least=False),
        Check("bend", nominal, t.bend, offset,
              "Add curvature feedforward or integral action, or raise the gain on e_y", "m", at_least=False),
        Check("bend_mismatched", np.where(np.isinf(mismatched), np.nan, mismatched), t.bend_mismatched,
              f"{other_tyres} {offset}", "Add integral action or raise the gain on e_y", "m", at_least=False),
        Check("sampling", n.bandwidth / sampling, t.sampling, rate,
              f"Lower the gains or sample faster than every {dt:g} s", at_least=False),
    )  # fmt: skip


def _softer(controller: Controller) -> str:
    """What makes a law gentler, by the names of its own gains."""
    names = [g.name for g in controller.gains()]
    restraint = [name for name in names if name.startswith("r_")]
    if restraint:
        return f"Raise {restraint[0]}"
    gains = [name for name in names if name.lower().startswith("k") and "max" not in name and "soft" not in name]
    return f"Lower {', '.join(gains)} in size" if gains else "Make the law softer"


# ------------------------------------------------------------------------------------------------ limits

_NO_HORIZON: Final = 1.0  # [s] Time within which a law without a horizon should have its limits back
_RARE: Final = 0.01  # Share of departures below which wheels beyond the limits are a warning
_OFF_AT_0: Final = ("a_y_max", "jerk_max", "e_y_max")
_ROUNDING: Final = 1e-9


def limit_of(controller: Controller, name: str) -> float | None:
    """A limit that a design declares and has set, None otherwise."""
    value: Any = getattr(controller, name) if any(g.name == name for g in controller.gains()) else None
    if not is_number(value) or value < 0:
        return None
    return None if value == 0 and name in _OFF_AT_0 else float(value)


def limit_findings(
    controller: Controller, actuator: Actuator, v: FloatArray, dt: float, steady: FloatArray, a_y: FloatArray,
    at_trigger: tuple[FloatArray, FloatArray], e_y_trigger: float,
) -> Iterator[Finding]:  # fmt: skip
    """Contradictions between the limits of the law, of the actuator, of the bend and of the departure.

    `steady` and `a_y` (n,) are the angle [rad] and acceleration [m/s^2] of the bend at speeds v, `at_trigger` angles
    and speeds (m,) of the wheels at triggers, `e_y_trigger` the offset there [m].
    """
    limits = {name: limit_of(controller, name) for name in ("delta_max", "rate_max", "a_y_max", "e_y_max")}
    tightest = {}
    for name, unit, word in (("delta_max", "rad", "angle"), ("rate_max", "rad/s", "rate")):
        law, wheel = limits[name], getattr(actuator, name)
        tightest[name] = min((limit for limit in (law, wheel) if limit is not None), default=None)
        if law is not None and wheel is not None and law > wheel * (1 + _ROUNDING):
            text = (
                f"The law counts on {name} = {law:g} {unit}, the actuator gives {wheel:g} {unit}: what lies between is "
                f"commanded and not steered. Set {name} of the law to at most {wheel:g}."
            )
            yield Finding("warning", f"actuator_{word}", text, law, wheel)
    delta_max, rate_max = tightest["delta_max"], tightest["rate_max"]
    a_y_max, e_y_max = limits["a_y_max"], limits["e_y_max"]
    if delta_max is not None:
        i = int(np.argmax(np.abs(steady)))
        needed = abs(float(steady[i]))
        if needed > delta_max * (1 + _ROUNDING):
            text = (
                f"a bend of {a_y[i]:.3g} m/s^2 needs {needed:.3g} rad of steering; the limit delta_max is "
                f"{delta_max:.3g} rad. Raise delta_max or leave out such speeds."
            )
            yield _at("fault", "angle_in_bend", v, i, text, needed, delta_max)
        if rate_max is not None:
            yield from _initial_angle(delta_max, rate_max, getattr(controller, "horizon", None), dt, *at_trigger)
        reached = delta_max * a_y / np.maximum(np.abs(steady), 1e-12)
        if a_y_max is not None and (reached < a_y_max).any():
            i = int(np.argmin(reached))
            text = (
                f"Up to {v[reached < a_y_max].max():.3g} m/s steady cornering at delta_max = {delta_max:g} rad stays "
                f"below a_y_max = {a_y_max:g} m/s^2 ({reached[i]:.2g} m/s^2 at {v[i]:.3g} m/s): delta_max counts there."
            )
            yield Finding("note", "acceleration_limit", text, float(reached[i]), a_y_max, float(v[i]))
    if e_y_max is not None and e_y_max <= e_y_trigger:
        text = (
            f"The law's corridor e_y_max = {e_y_max:g} m is left already at the trigger, where e_y is "
            f"{e_y_trigger:.3g} m. Widen e_y_max or trigger earlier."
        )
        yield Finding("warning", "corridor", text, e_y_max, e_y_trigger)


def _initial_angle(
    delta_max: float, rate_max: float, horizon: object, dt: float, delta_prev: FloatArray, v: FloatArray
) -> Iterator[Finding]:
    """Wheels that stand beyond the limit at the trigger, and cannot be brought back in one sample."""
    step, angles = rate_max * dt, np.abs(delta_prev)
    beyond = angles - delta_max > step * (1 + _ROUNDING)
    if not beyond.any():
        return
    i = int(np.argmax(angles))
    samples = math.ceil((angles[i] - delta_max) / step - _ROUNDING) if step > 0 else "all"
    reach, whose = math.ceil(_NO_HORIZON / dt), "a second has"
    if isinstance(horizon, int) and not isinstance(horizon, bool):
        reach, whose = horizon, "its horizon is"
    text = (
        f"the wheels may stand at {angles[i]:.3g} rad when the law takes over: beyond delta_max = {delta_max:g} rad by "
        f"more than rate_max dt = {step:.3g} rad{_count(beyond, 'in {} of {} departures')}. No command keeps both "
        f"limits, for {samples} samples ({whose} {reach} samples). Raise delta_max or rate_max."
    )
    severity: Severity = "warning" if beyond.mean() < _RARE else "fault"
    yield _at(severity, "initial_angle", v, i, text, angles[i], delta_max + step)


# ------------------------------------------------------------------------------------------------ the review

_IN_THE_LOOP: Final = ("period", "delay", "kalman")  # Options of the camera that the loop holds


def plant_notes(options: PlantOptions) -> Iterator[Finding]:
    """Note on the options of a plant that the review leaves out."""
    sensors = options.sensors
    words = {
        "the speed profile": options.speed == "profile",
        "mismatch": not options.mismatch.ideal,
        "saturating tyres": not options.tyres.ideal,
        "noise, bias, quantisation and errors of the curvature of the camera": any(
            getattr(sensors, field.name) for field in dataclasses.fields(sensors) if field.name not in _IN_THE_LOOP
        ),
        "the camera's period but for the age that it adds on average": sensors.period > 0,
        "residuals": not options.residuals.ideal,
        "the driver's intent and override": not options.driver.ideal,
    }
    left_out = [text for text, holds in words.items() if holds]
    if left_out:
        text = f"The study's plant has more than the review looks at: {', '.join(left_out)}."
        yield Finding("note", "left_out", text)


LONGEST: Final = 200  # Longest delay of actuator or camera [samples]: each sample is a state of the loop


def review_plant(
    model: BicycleModel,
    dt: float,
    options: PlantOptions,
    speeds: npt.ArrayLike,
    plant_knowledge: PlantKnowledge = "nominal",
) -> Plant:
    """The nominal vehicle of a review at its speeds.

    Raises `InputError` for a setup or speeds outside what is allowed, or a delay of too many samples.

    Parameters
    ----------
    model : BicycleModel
    dt : float [s]
    options : PlantOptions
        Its delays are checked.
    speeds : (n,) [m/s]
    plant_knowledge : {"nominal", "ideal"}

    Examples
    --------
    >>> review_plant(BicycleModel(), 0.05, PlantOptions(), [20.0, 30.0]).n
    2
    """
    setup = Setup(
        vehicle=model.parameters, convention=model.convention, dt=dt, options=options, plant_knowledge=plant_knowledge
    )
    v = checked_speeds(speeds)
    if v.size == 0:
        raise InputError("speeds", value=[], allowed="one or more")
    for i, speed in enumerate(v.tolist()):
        checked_number(f"speeds[{i}]", speed, lower=SPEED_RANGE[0], upper=SPEED_RANGE[1], unit="m/s")
    for name, delay in (("actuator", options.actuator.delay), ("sensors", options.sensors.delay)):
        if delay > LONGEST * setup.dt * (1 + 1e-9):
            problem = f"s is {delay / setup.dt:.6g} samples of {setup.dt:g} s"
            raise InputError(f"{name}.delay", problem, value=delay, allowed=f"at most {LONGEST} samples")
    return setup.plant(v)


SPEEDS = tuple(float(v) for v in np.linspace(10.0, 40.0, 13))  # Default speeds [m/s]
BEND = 2.0  # Lateral acceleration [m/s^2] of the steady bend
TIGHTEST = 50.0  # Radius [m] of the tightest bend: below 10 m/s it is this one, with less lateral acceleration


@dataclasses.dataclass(frozen=True)
class Review:
    """Numbers of the loop and findings of one design."""

    law: str  # Registry name
    title: str
    gains: tuple[tuple[str, GainValue], ...]  # Every gain of the design
    dt: float  # [s] Sample time
    # None for a design that leaves the recorded path alone, or has a law without a linear part at straight driving
    loop: LoopNumbers | None
    findings: tuple[Finding, ...]  # Faults first
    # The loop with arms on the wheel, by their name: relaxed and tensed; nothing without a driver
    held: tuple[tuple[str, LoopNumbers], ...] = ()

    @property
    def faults(self) -> tuple[Finding, ...]:
        """The findings that are faults."""
        return tuple(finding for finding in self.findings if finding.severity == "fault")


def review(
    controller: Controller,
    *,
    model: BicycleModel | None = None,
    dt: float = 0.05,
    options: PlantOptions | None = None,
    speeds: npt.ArrayLike = SPEEDS,
    a_y: float = BEND,
    y_s: float = 0.0,
    delta_prev: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    plant_knowledge: PlantKnowledge = "nominal",
    thresholds: Thresholds | None = None,
) -> Review:
    """Check a design before it is run: poles, margins, sampling, limits, conditioning, bends.

    Raises `InputError` for an argument outside what is allowed; `LdcError` if the design cannot be prepared.

    Parameters
    ----------
    controller : Controller
        The design.
    model : BicycleModel, optional
        Nominal vehicle; the default one by default.
    dt : float [s]
        Sample time, > 0.
    options : PlantOptions, optional
        Actuator and camera of the plant; what the review leaves out is stated in a note.
    speeds : (n,) [m/s]
        Where to look.
    a_y : float [m/s^2]
        Lateral acceleration of the steady bend, > 0; its radius is at least `TIGHTEST`.
    y_s : float [m]
        Trigger threshold, >= 0.
    delta_prev : ((m,), (m,)) or (float, float), optional
        Steering angles [rad] at triggers, and the speeds [m/s] there; by default the angle that holds the bend, at the
        speed where that is most.
    plant_knowledge : {"nominal", "ideal"}
        Whether the design knows the lag and the delays of actuator and camera, as in `Setup`.
    thresholds : Thresholds, optional
        Where findings start.

    Examples
    --------
    >>> from ldctoolkit import controller_class
    >>> lqr = review(controller_class("lqr")(), speeds=[20.0, 30.0])
    >>> lqr.faults, bool(lqr.loop.stable.all())
    ((), True)
    """
    check_controller(controller)
    options = PlantOptions() if options is None else options
    thresholds = Thresholds() if thresholds is None else thresholds
    model = BicycleModel() if model is None else model
    a_y = checked_number("a_y", a_y, above=0.0, unit="m/s^2")
    y_s = checked_number("y_s", y_s, lower=0.0, unit="m")
    plant = review_plant(model, dt, options, speeds, plant_knowledge)
    v, dt, options = plant.v, plant.dt, options.sampled(plant.dt)
    identity = _identity(controller)
    view = linear_view(controller, plant)
    if view is None:
        sentence = f"{controller.title} leaves the recorded path alone: there is no loop to review."
        return Review(*identity, dt, None, (Finding("note", "recorded_path", sentence),))
    findings = list(law_findings(controller, view, v))
    bend = np.minimum(a_y / v, v / TIGHTEST)
    numbers, held = None, []
    if view.finite.all() and not (view.kink > KINK).any():
        numbers = loop_numbers(controller, view, plant, options, bend)
        findings += loop_findings(numbers, controller, dt, thresholds)
        for arms, system in held_wheels(options.driver):
            held.append((arms, loop_numbers(controller, view, plant, options, bend, system)))
            known = {(finding.name.removesuffix("_held"), finding.severity) for finding in findings}
            for finding in loop_findings(held[-1][1], controller, dt, thresholds):
                if not known & {(finding.name, finding.severity), (finding.name, "fault")}:
                    text = f"With {arms}, {finding.sentence[0].lower()}{finding.sentence[1:]}"
                    findings.append(dataclasses.replace(finding, name=f"{finding.name}_held", sentence=text))
    steady = plant.steady_state().delta * bend
    i = int(np.argmax(np.abs(steady)))
    at_trigger = _angles((steady[i], v[i]) if delta_prev is None else delta_prev)
    e_y_trigger = model.parameters.edge_offset + y_s
    findings += limit_findings(controller, options.actuator, v, dt, steady, bend * v, at_trigger, e_y_trigger)
    findings += plant_notes(options)
    order = {"fault": 0, "warning": 1, "note": 2}
    findings.sort(key=lambda finding: order[finding.severity])
    return Review(*identity, dt, numbers, tuple(findings), tuple(held))


def without_review(controller: Controller, dt: float, error: LdcError) -> Review:
    """The review of a design that cannot be reviewed, with what it raised as its fault.

    Parameters
    ----------
    controller : Controller
    dt : float [s]
    error : LdcError
        What `review` raised.
    """
    return Review(*_identity(controller), dt, None, (Finding("fault", "raises", f"No review: {error}"),))


def _identity(controller: Controller) -> tuple[str, str, tuple[tuple[str, GainValue], ...]]:
    gains = tuple((g.name, getattr(controller, g.name)) for g in controller.gains())
    return controller.name, controller.title, gains


def _angles(given: tuple[npt.ArrayLike, npt.ArrayLike]) -> tuple[FloatArray, FloatArray]:
    """Steering angles at triggers and their speeds, both (m,)."""
    angles, v = (np.atleast_1d(np.asarray(values, dtype=np.float64)) for values in given)
    if angles.ndim != 1 or angles.shape != v.shape or not angles.size or not np.isfinite([angles, v]).all():
        shapes = f"angles of shape {angles.shape}, speeds of shape {v.shape}"
        raise InputError("delta_prev", shapes, allowed="finite numbers, (m,) each")
    return angles, v
