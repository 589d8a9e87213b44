"""The review of one design: every check at every speed, and the findings that follow."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller
from ldctoolkit.errors import InputError, LdcError, plain
from ldctoolkit.gains import GainValue
from ldctoolkit.law_checks import check_controller
from ldctoolkit.option_checks import is_number
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.review.findings import Finding, Thresholds
from ldctoolkit.review.law_model import linear_view
from ldctoolkit.review.limits import Situation, limit_findings
from ldctoolkit.review.loop_checks import loop_findings
from ldctoolkit.review.loop_numbers import LoopNumbers, loop_numbers
from ldctoolkit.review.notes import bend_notes, bound_notes, law_findings, plant_notes
from ldctoolkit.setup import PlantKnowledge, known_plant
from ldctoolkit.vehicle import BicycleModel, Plant
from ldctoolkit.vehicle.bicycle import checked_speeds
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE

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

    Parameters
    ----------
    model : BicycleModel
    dt : float [s]
    options : PlantOptions
        Its delays are checked.
    speeds : (n,) [m/s]
    plant_knowledge : {"nominal", "ideal"}

    Returns
    -------
    Plant

    Raises
    ------
    InputError
        For a sample time or speeds outside what is allowed, or a delay of too many samples.

    Examples
    --------
    >>> review_plant(BicycleModel(), 0.05, PlantOptions(), [20.0, 30.0]).n
    2
    """
    dt = positive("dt", dt, "s")
    v = checked_speeds(speeds)
    if v.size == 0 or v.max() > SPEED_RANGE[1] or v.min() < SPEED_RANGE[0]:
        shown = f"{v.min():g} to {v.max():g} m/s" if v.size else "none"
        raise InputError(f"speeds: {shown}; allowed: one or more from {SPEED_RANGE[0]:g} to {SPEED_RANGE[1]:g} m/s")
    for name, delay in (("actuator", options.actuator.delay), ("sensors", options.sensors.delay)):
        if delay > LONGEST * dt * (1 + 1e-9):
            raise InputError(
                f"{name}.delay: {delay:g} s with dt = {dt:g} s is {delay / dt:.6g} samples; allowed: at most {LONGEST}"
            )
    return known_plant(model, v, dt, options, plant_knowledge)


def positive(name: str, value: object, unit: str) -> float:
    """A finite number above 0."""
    given = plain(value)
    if not is_number(given) or not given > 0:
        raise InputError(f"{name}: {given!r} {unit}; allowed: a finite number > 0")
    return float(given)


SPEEDS = tuple(float(v) for v in np.linspace(10.0, 40.0, 13))
"""Speeds [m/s] that are looked at by default."""

BEND = 2.0
"""Lateral acceleration [m/s^2] of the steady bend."""

TIGHTEST = 50.0
"""Radius [m] of the tightest bend: below 10 m/s it is this one, with less lateral acceleration."""


@dataclasses.dataclass(frozen=True)
class Review:
    """What the review of a design found.

    Attributes
    ----------
    law : str
        Registry name.
    title : str
    gains : tuple of (name, value)
        Every gain of the design.
    dt : float [s]
        Sample time.
    loop : LoopNumbers or None
        None for a design that leaves the recorded path alone.
    findings : tuple of Finding
        Faults first.
    """

    law: str
    title: str
    gains: tuple[tuple[str, GainValue], ...]
    dt: float
    loop: LoopNumbers | None
    findings: tuple[Finding, ...]

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

    Parameters
    ----------
    controller : Controller
        The design.
    model : BicycleModel, optional
        Nominal vehicle; the default one by default.
    dt : float [s]
        Sample time, > 0.
    options : PlantOptions, optional
        Actuator and camera of the plant; what the review leaves out is told in a note.
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

    Returns
    -------
    Review

    Raises
    ------
    InputError
        For an argument outside what is allowed.
    LdcError
        If the design cannot be prepared.

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
        raise InputError(f"y_s: {y_s!r} m; allowed: a finite number >= 0")
    plant = review_plant(model, dt, options, speeds, plant_knowledge)
    v = plant.v
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

    Returns
    -------
    Review
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
            f"delta_prev: angles of shape {angles.shape}, speeds of shape {v.shape}; allowed: finite numbers, (m,) each"
        )
    return angles, v
