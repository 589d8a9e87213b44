"""The review of one design: every check at every speed, and the findings that follow."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.declared import GainValue, is_number
from ldctoolkit.errors import InputError, LdcError, plain
from ldctoolkit.law_checks import check_controller
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.law_model import LARGER, PULSE, LinearView, linear_view
from ldctoolkit.review.limits import Finding, Severity, Situation, Thresholds, limit_findings, limit_of
from ldctoolkit.review.loop_numbers import BEND_ERROR, MISMATCH, LoopNumbers, loop_numbers
from ldctoolkit.setup import PlantKnowledge, known_plant
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.bicycle import checked_speeds
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE


@dataclasses.dataclass(frozen=True)
class Check:
    """One number of a loop against its thresholds."""

    name: str
    values: FloatArray  # (n,) NaN where there is none
    limits: tuple[float, float]  # Where a warning starts, and a fault
    text: str  # Half a sentence with {value}
    help: str  # What helps, a sentence without its full stop
    # How values are shown
    factor: float = 1.0
    unit: str = ""
    at_least: bool = True  # Small values are the bad ones

    def finding(self, v: FloatArray) -> Finding | None:
        """The finding at the worst speed, None where all is well."""
        sign = -1.0 if self.at_least else 1.0
        badness = np.where(np.isnan(self.values), -math.inf, sign * self.values)
        i = int(np.argmax(badness))
        warning, fault = sign * self.limits[0], sign * self.limits[1]
        if not badness[i] > warning:
            return None
        severity: Severity = "fault" if badness[i] > fault else "warning"
        value, word = float(self.values[i]), "at least" if self.at_least else "at most"
        shown = self.text.format(value=self._shown(value))
        sentence = (
            f"At {v[i]:.3g} m/s {shown}; allowed: {word} {self._shown(self.limits[0])}{share(badness > warning)}. "
            f"{self.help}."
        )
        return Finding(severity, self.name, sentence, value, self.limits[0], float(v[i]))

    def _shown(self, value: float) -> str:
        return f"{value * self.factor:.3g} {self.unit}".rstrip()


def share(where: BoolArray) -> str:
    """How many of several speeds are meant."""
    return f" (so at {int(where.sum())} of {where.size} speeds)" if where.size > 1 else ""


def loop_findings(numbers: LoopNumbers, controller: Controller, dt: float, thresholds: Thresholds) -> Iterator[Finding]:
    """What the numbers of a loop say."""
    softer = _softer(controller)
    yield from _instability(numbers, dt, softer)
    sampling = 2.0 * math.pi / dt
    beyond = float(numbers.bandwidth.max()) > 0.5 * sampling
    above = ", above the Nyquist frequency, which is half of it" if beyond else ""
    checks = (
        *_margins(numbers, dt, thresholds, softer),
        *_bends(numbers, thresholds),
        Check(
            "sampling",
            numbers.bandwidth / sampling,
            thresholds.sampling,
            f"the loop's bandwidth is {{value}} of the sampling frequency of {sampling:.3g} rad/s{above}",
            f"Lower the gains or sample faster than every {dt:g} s",
            at_least=False,
        ),
    )
    for check in checks:
        found = check.finding(numbers.v)
        if found is not None:
            yield found


def _instability(numbers: LoopNumbers, dt: float, softer: str) -> Iterator[Finding]:
    v, i = numbers.v, int(np.argmax(numbers.radius))
    radius = float(numbers.radius[i])
    where = share(~numbers.stable)
    if not numbers.stable.all() and radius > 1.0 + 1e-6:
        text = (
            f"At {v[i]:.3g} m/s the closed loop is unstable: a deviation grows by a factor of {_factor(radius)} a "
            f"sample of {dt:g} s{where}. {softer}, or shorten delay and lag."
        )
        yield Finding("fault", "stability", text, radius, 1.0, float(v[i]))
    elif not numbers.stable.all():
        text = (
            f"At {v[i]:.3g} m/s a deviation is never corrected: a pole of the closed loop lies on the stability limit"
            f"{where}. Give the law a gain on both e_y and e_psi."
        )
        yield Finding("fault", "stability", text, radius, 1.0, float(v[i]))
    lost = np.isinf(numbers.e_y_bend_mismatched)
    if lost.any():
        at = float(v[int(np.argmax(lost))])
        text = (
            f"At {at:.3g} m/s the closed loop is unstable on tyres that are {100 * MISMATCH:g} % softer or stiffer "
            f"than the law knows{share(lost)}. {softer}, or shorten delay and lag."
        )
        yield Finding("fault", "stability_mismatched", text, v=at)


def _factor(radius: float) -> str:
    """A factor above 1 with as many digits as tell it from 1."""
    digits = max(2, 1 - math.floor(math.log10(radius - 1.0)))
    return f"{radius:.3g}" if radius >= 1.1 else f"{radius:.{digits}f}"


def _margins(numbers: LoopNumbers, dt: float, t: Thresholds, softer: str) -> Iterator[Check]:
    stable = numbers.stable
    yield Check(
        "gain_margin", numbers.gain_margin, t.gain_margin, "the loop has a gain margin of {value}", softer, 1, "dB"
    )
    yield Check(
        "gain_reduction_margin",
        numbers.gain_reduction_margin,
        t.gain_margin,
        "the loop gets unstable if its gain shrinks by {value}",
        "Weigh e_psi and the rates more against e_y",
        unit="dB",
    )
    in_degrees = 180.0 / math.pi
    text = "the loop has a phase margin of {value}"
    yield Check("phase_margin", numbers.phase_margin, t.phase_margin, text, softer, in_degrees, "deg")
    yield Check("disk_margin", numbers.disk_margin, t.disk_margin, "the loop has a disk margin of {value}", softer)
    samples = (t.delay_margin[0] * dt, t.delay_margin[1] * dt)
    text = "the loop stands no more additional delay than {value}"
    yield Check("delay_margin", numbers.delay_margin, samples, text, softer, 1000.0, "ms")
    damping = np.where(stable, numbers.damping, np.nan)
    yield Check("damping", damping, t.damping, "the closed loop has a damping ratio of {value}", softer)
    slowest = np.where(stable, numbers.slowest, np.nan)
    text = "the slowest pole of the closed loop has a time constant of {value}"
    yield Check(
        "slowest_pole", slowest, t.slowest, text, "Raise the gain on e_y or its integral", unit="s", at_least=False
    )
    yield Check(
        "hessian",
        numbers.hessian_condition,
        t.hessian,
        "the condensed Hessian has a condition number of {value}",
        "Raise r_delta against the other weights or shorten the horizon",
        at_least=False,
    )


def _bends(numbers: LoopNumbers, t: Thresholds) -> Iterator[Check]:
    largest = float((numbers.bend * numbers.v).max())
    bend = f"a steady bend of {largest:.3g} m/s^2 leaves an offset of {{value}}"
    nominal, other = np.abs(numbers.e_y_bend), np.abs(numbers.e_y_bend_mismatched)
    help_ = "Add curvature feedforward or integral action, or raise the gain on e_y"
    yield Check("bend", nominal, t.bend, bend, help_, unit="m", at_least=False)
    yield Check(
        "bend_mismatched",
        np.where(np.isinf(other), np.nan, other),
        t.bend_mismatched,
        f"on tyres that are {100 * MISMATCH:g} % softer or stiffer than the law knows {bend}",
        "Add integral action or raise the gain on e_y",
        unit="m",
        at_least=False,
    )


def _softer(controller: Controller) -> str:
    """What makes a law gentler, by the names of its own gains."""
    names = [g.name for g in controller.gains()]
    restraint = [name for name in names if name.startswith("r_")]
    if restraint:
        return f"Raise {restraint[0]}"
    gains = [name for name in names if name.lower().startswith("k") and "max" not in name and "soft" not in name]
    return f"Lower {', '.join(gains)} in size" if gains else "Make the law softer"


_NONLINEAR = 0.05  # relative difference of the answers to small and larger pulses from which it is reported
_IN_THE_LOOP = ("period", "delay", "kalman")  # what of the camera the loop holds
_UNEXPLAINED = 0.02  # part of a pulse response that the model of the memory may leave out untold


def law_findings(view: LinearView, v: FloatArray) -> Iterator[Finding]:
    """What can be stated of a law by itself."""
    if not view.finite.all():
        at = float(v[int(np.argmin(view.finite))])
        text = f"At {at:.3g} m/s the law gives commands that are not finite numbers near straight, centred driving."
        yield Finding("fault", "finite", f"{text} Nothing else can be said about its loop.", v=at)
        return
    if not view.quiet.all():
        at = float(v[int(np.argmin(view.quiet))])
        yield Finding("fault", "quiet", f"At {at:.3g} m/s the law steers while driving straight and centred.", v=at)
    if view.exact:
        return
    memory = f"a memory of order {view.order}" if view.order else "no memory"
    yield Finding(
        "note",
        "linearised",
        f"The law is not linear by its type: poles and margins are those of its answers to pulses of {PULSE[0]:g} m, "
        f"{PULSE[1]:g} m/s and {PULSE[2]:g} rad around straight driving, which show {memory}.",
    )
    i = int(np.argmax(view.nonlinearity))
    if view.nonlinearity[i] > _NONLINEAR:
        yield Finding(
            "note",
            "nonlinear",
            f"At {v[i]:.3g} m/s the answers to pulses {LARGER:g} times larger differ from proportional ones by "
            f"{100 * view.nonlinearity[i]:.2g} % of the largest: poles and margins hold for small deviations only.",
            float(view.nonlinearity[i]),
            _NONLINEAR,
            float(v[i]),
        )
    i = int(np.argmax(view.unexplained))
    if view.unexplained[i] > _UNEXPLAINED:
        yield Finding(
            "warning",
            "memory",
            f"At {v[i]:.3g} m/s {100 * view.unexplained[i]:.2g} % of the law's answer to a pulse are not those of a "
            "small linear system: poles and margins may be wrong.",
            float(view.unexplained[i]),
            _UNEXPLAINED,
            float(v[i]),
        )


def bound_notes(controller: Controller, view: LinearView) -> Iterator[Finding]:
    """What a review does not see of a law that keeps a corridor."""
    bound = limit_of(controller, "e_y_max")
    if bound is not None and not view.exact:
        text = f"The law keeps |e_y| <= e_y_max = {bound:g} m by itself: the loop while that bound holds the command"
        yield Finding("note", "bound", f"{text} is not looked at, poles and margins are those far from it.")


def bend_notes(numbers: LoopNumbers) -> Iterator[Finding]:
    """Offsets in a bend that are left out because the law is not linear up to them."""
    i, wrong = int(np.argmax(numbers.bend_error)), numbers.bend_error > BEND_ERROR
    if wrong.any():
        text = (
            f"At {numbers.v[i]:.3g} m/s the law is not linear in a steady bend: its command there differs by "
            f"{100 * numbers.bend_error[i]:.3g} % from what small deviations predict. Offsets in the bend are left "
            f"out ({int(wrong.sum())} of {wrong.size} speeds)."
        )
        yield Finding("note", "bend_not_linear", text, float(numbers.bend_error[i]), BEND_ERROR, float(numbers.v[i]))


def plant_notes(options: PlantOptions) -> Iterator[Finding]:
    """What of a plant the review leaves out."""
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
    }
    left_out = [text for text, holds in words.items() if holds]
    if left_out:
        yield Finding(
            "note", "left_out", f"The study's plant has more than the review looks at: {', '.join(left_out)}."
        )


LONGEST: Final = 200
"""Samples of delay of the actuator, or of the camera, up to which the loop is worked out: each one is a state."""


def review_plant(
    model: BicycleModel,
    dt: float,
    options: PlantOptions,
    speeds: npt.ArrayLike,
    plant_knowledge: PlantKnowledge = "nominal",
) -> Plant:
    """The nominal vehicle of a review at its speeds.

    Raises `InputError` for a sample time or speeds outside what is allowed, or a delay of too many samples.

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
    dt = positive("dt", dt, "s")
    v = checked_speeds(speeds)
    if v.size == 0 or v.max() > SPEED_RANGE[1] or v.min() < SPEED_RANGE[0]:
        shown = f"{v.min():g} to {v.max():g} m/s" if v.size else "none"
        raise InputError("speeds", shown, allowed=f"one or more from {SPEED_RANGE[0]:g} to {SPEED_RANGE[1]:g} m/s")
    for name, delay in (("actuator", options.actuator.delay), ("sensors", options.sensors.delay)):
        if delay > LONGEST * dt * (1 + 1e-9):
            raise InputError(
                f"{name}.delay",
                f"{delay:g} s with dt = {dt:g} s is {delay / dt:.6g} samples",
                allowed=f"at most {LONGEST}",
            )
    return known_plant(model, v, dt, options.sampled(dt), plant_knowledge)


def positive(name: str, value: object, unit: str) -> float:
    """A finite number above 0."""
    given = plain(value)
    if not is_number(given) or not given > 0:
        raise InputError(name, unit, value=given, allowed="a finite number > 0")
    return float(given)


SPEEDS = tuple(float(v) for v in np.linspace(10.0, 40.0, 13))  # speeds [m/s] that are looked at by default
BEND = 2.0  # lateral acceleration [m/s^2] of the steady bend
TIGHTEST = 50.0  # radius [m] of the tightest bend: below 10 m/s it is this one, with less lateral acceleration


@dataclasses.dataclass(frozen=True)
class Review:
    """What the review of a design found."""

    law: str  # Registry name
    title: str
    gains: tuple[tuple[str, GainValue], ...]  # Every gain of the design
    dt: float  # [s] Sample time
    loop: LoopNumbers | None  # None for a design that leaves the recorded path alone
    findings: tuple[Finding, ...]  # Faults first

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
    >>> found = review(controller_class("lqr")(), speeds=[20.0, 30.0])
    >>> found.faults, bool(found.loop.stable.all())
    ((), True)
    """
    check_controller(controller)
    options = PlantOptions() if options is None else options
    thresholds = Thresholds() if thresholds is None else thresholds
    model = BicycleModel() if model is None else model
    dt, a_y = positive("dt", dt, "s"), positive("a_y", a_y, "m/s^2")
    if not is_number(plain(y_s)) or y_s < 0:
        raise InputError("y_s", "m", value=y_s, allowed="a finite number >= 0")
    plant = review_plant(model, dt, options, speeds, plant_knowledge)
    v, options = plant.v, options.sampled(dt)
    identity = _identity(controller)
    view = linear_view(controller, plant)
    if view is None:
        sentence = f"{controller.title} leaves the recorded path alone: there is no loop to review."
        return Review(*identity, dt, None, (Finding("note", "recorded_path", sentence),))
    findings = [*law_findings(view, v), *bound_notes(controller, view)]
    bend = np.minimum(a_y / v, v / TIGHTEST)
    numbers = None
    if view.finite.all():
        numbers = loop_numbers(controller, view, plant, options, bend)
        findings += [*loop_findings(numbers, controller, dt, thresholds), *bend_notes(numbers)]
    steady = plant.steady_state().delta * bend
    i = int(np.argmax(np.abs(steady)))
    angles, at = _angles((steady[i], v[i]) if delta_prev is None else delta_prev)
    trigger = model.parameters.edge_offset + float(y_s)
    findings += limit_findings(controller, Situation(v, dt, steady, bend * v, angles, at, trigger, options.actuator))
    findings += plant_notes(options)
    order = {"fault": 0, "warning": 1, "note": 2}
    return Review(*identity, dt, numbers, tuple(sorted(findings, key=lambda finding: order[finding.severity])))


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
        raise InputError(
            "delta_prev",
            f"angles of shape {angles.shape}, speeds of shape {v.shape}",
            allowed="finite numbers, (m,) each",
        )
    return angles, v
