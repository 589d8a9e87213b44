"""Measures of designs besides the runs of the study: loop margins, named vehicles, standards."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import EventStatus, SteeringLaw
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import LdcError
from ldctoolkit.law_checks import raised
from ldctoolkit.metrics import DRIVER_METRICS, comfortable_share
from ldctoolkit.plant_options import Driver, Mismatch, PlantOptions, Tyres
from ldctoolkit.review import design_margins
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover, Window, drive
from ldctoolkit.vehicle import VehicleModel

from .assessment import assess
from .design import Design
from .results import FAILED_STATUSES, StudyResults, status_among
from .standards import VEHICLES
from .storage.measure_table import MeasureTable

MARGIN_SPEEDS: Final = tuple(range(10, 41, 5))  # speeds [m/s]; the margins of a design are the minima over these

DEPARTURES: Final = 50  # departures of each side that designs are driven on with named vehicles

LOOP: Final = ("gain_margin", "phase_margin", "solver")
"""Measures of the loop: both margins, [1] and [rad], and whether the law has a solver (1 or 0)."""

Group = tuple[tuple[str, ...], Callable[[Sequence[Design]], Sequence[FloatArray]]]
"""Names of measures, and the function that returns all of them, each (d,), for d designs."""


def measured(
    results: StudyResults,
    table: MeasureTable,
    setup: Setup,
    vehicles: Sequence[str | VehicleModel] = (),
    standards: Sequence[str] = (),
) -> StudyResults:
    """The results with the measures of their designs; missing measures are computed and added to the table.

    The measures of `StudyResults.unsafe` are NaN.
    """
    departures = first_of_each_side(results.scenarios, DEPARTURES) if vehicles else results.scenarios
    groups: list[Group] = [(LOOP, functools.partial(_loop, setup=setup))]
    for vehicle in vehicles:
        on = functools.partial(_on_vehicle, vehicle=vehicle, scenarios=departures, setup=setup, window=results.window)
        groups.append((vehicle_measures(vehicle, results.scenarios), on))
    groups += [((name,), functools.partial(_scores, standard=name, setup=setup)) for name in standards]
    unsafe = frozenset(results.unsafe)
    for names, measure in groups:
        missing = table.without(names[-1], results.designs)
        if driven := [design for design in missing if design not in unsafe]:
            table.add(dict(zip(names, measure(driven), strict=True)), driven)
        if left_out := [design for design in missing if design in unsafe]:
            table.add(dict.fromkeys(names, np.full(len(left_out), np.nan)), left_out)
    return dataclasses.replace(results, measures=table.of(results.designs))


def vehicle_measures(vehicle: str | VehicleModel, scenarios: Scenarios) -> tuple[str, str]:
    """Names of the mean S [m s] and the comfortable share of a named vehicle, on the first of these departures."""
    if isinstance(vehicle, VehicleModel):
        vehicle = f"{type(vehicle).__name__} {vehicle.identity}"
    content = hashlib.sha256()
    for array in first_of_each_side(scenarios, DEPARTURES).arrays():
        content.update(array.tobytes())
    on = f"{vehicle} {content.hexdigest()[:12]}"
    return f"S of {on}", f"comfortable of {on}"


def _loop(designs: Sequence[Design], *, setup: Setup) -> Sequence[FloatArray]:
    """Margins and solver of every design; they do not depend on its threshold."""
    by_law = {(design.law, design.gains, design.code): design for design in designs}
    controllers = [design.controller(setup.convention) for design in by_law.values()]
    gain, phase = design_margins(controllers, setup, MARGIN_SPEEDS)
    solver = [_has_solver(controller, setup) for controller in controllers]
    numbers = np.stack([gain.min(axis=1), phase.min(axis=1), solver])
    column_of = {key: i for i, key in enumerate(by_law)}
    return list(numbers[:, [column_of[design.law, design.gains, design.code] for design in designs]])


def _has_solver(controller: Any, setup: Setup) -> float:
    """Whether the law that a controller prepares overrides `solver_calls`; 1 where that is unknown."""
    try:
        law = type(controller.prepare(setup.plant(np.array([25.0]))))
    except Exception:  # a controller may be third-party code
        return 1.0
    return float(issubclass(law, SteeringLaw) and law.solver_calls is not SteeringLaw.solver_calls)


def _scores(designs: Sequence[Design], *, standard: str, setup: Setup) -> Sequence[FloatArray]:
    """Share of the standard's cells that each design passes as stated; NaN where the law raises."""
    scores = []
    for design in designs:
        try:
            assessment = assess(design.controller(setup.convention), standard, setup, y_s=design.y_s, tolerances=False)
            scores.append(assessment.score)
        except LdcError:
            scores.append(math.nan)
    return [np.array(scores)]


def _on_vehicle(
    designs: Sequence[Design], *, vehicle: str | VehicleModel, scenarios: Scenarios, setup: Setup, window: Window
) -> Sequence[FloatArray]:
    """Mean S [m s] and comfortable share of every design on a named vehicle; NaN where they are not known."""
    if isinstance(vehicle, VehicleModel):
        plant = on_model(setup, vehicle)
    else:
        fixed = {quantity: (factor, factor) for quantity, factor in VEHICLES[vehicle].items()}
        # friction is of the road, not of the vehicle
        mismatch = Mismatch(mu=setup.options.mismatch.mu, **fixed)
        plant = setup.on(dataclasses.replace(setup.options, mismatch=mismatch))
    drives = drive_on_plants(designs, [plant], scenarios, setup, window)
    driven = drives.status[0] != EventStatus.INVALID
    S = np.where(driven, drives.S[0], 0.0).sum(axis=1) / np.maximum(driven.sum(axis=1), 1)
    return np.where(driven.any(axis=1), S, np.nan), drives.comfortable[0]


def on_model(setup: Setup, model: VehicleModel) -> Setup:
    """The setup with a vehicle model, which brings its own mass and tyres; nobody holds its wheel."""
    options = dataclasses.replace(setup.options, mismatch=Mismatch(), tyres=Tyres(), driver=Driver())
    kept: dict[str, Any] = {"convention": "consistent", "start": "steady"}
    return dataclasses.replace(setup, options=options, vehicle_model=model, **kept)


@dataclasses.dataclass(frozen=True)
class Drives:
    """Scores of d designs on p plants and n scenarios."""

    # (p, d, n) [m s] As it counts: a failed scenario at least as bad as without control. NaN where the law raised, or
    # the plant cannot drive the scenario
    S: FloatArray
    S_uncorrected: FloatArray  # (p, d, n) [m s] NaN in the same places
    status: npt.NDArray[np.int8]  # (p, d, n) `ldctoolkit.EventStatus`
    # (p, d) [1] Share of the interventions within both limits of ISO 11270; NaN without any, and where the law raised
    comfortable: FloatArray
    driver: Mapping[str, FloatArray]  # Of each of `DRIVER_METRICS` (p, d, n); NaN without a driver
    raised: tuple[tuple[int, int, str], ...]  # Plant, design and error of each law that raised


def first_of_each_side(scenarios: Scenarios, most: int) -> Scenarios:
    """The first `most` scenarios of each side, with their numbers."""
    rows = [np.flatnonzero(scenarios.side == side)[:most] for side in (LEFT, RIGHT)]
    return scenarios.take(np.concatenate(rows))


def trigger_speeds(takeovers: Iterable[Takeover]) -> tuple[float, float] | None:
    """Lowest and highest speed at the triggers [m/s]; None where nothing triggers."""
    speeds = [takeover.plant.v for takeover in takeovers if takeover.m]
    return (min(float(v.min()) for v in speeds), max(float(v.max()) for v in speeds)) if speeds else None


def drive_on_plants(
    designs: Sequence[Design], plants: Sequence[PlantOptions | Setup], scenarios: Scenarios, setup: Setup,
    window: Window, advance: Callable[[int, int], None] | None = None,
) -> Drives:  # fmt: skip
    """Drive every design on every plant separately, so that no number depends on another.

    A plant is options instead of those of the setup, or a setup of its own; designs know that of `setup`. `advance` is
    called with the number of drives so far and of all.
    """
    shape = (len(plants), len(designs), scenarios.n)
    S, S_uncorrected = np.full(shape, np.nan), np.full(shape, np.nan)
    status = np.full(shape, EventStatus.INVALID, dtype=np.int8)
    comfortable = np.full(shape[:2], np.nan)
    driver = {name: np.full(shape, np.nan) for name in DRIVER_METRICS}
    failed = []
    for k, plant in enumerate(plants):
        takeovers: dict[float, Takeover] = {}  # of one plant only: tables of a takeover are large
        for i, design in enumerate(designs):
            if design.y_s not in takeovers:
                driven = plant if isinstance(plant, Setup) else setup.on(plant)
                over = Takeover.build(scenarios, driven, y_s=design.y_s)
                # designs know the actuator and the camera of the study, not the other ones
                takeovers[design.y_s] = dataclasses.replace(over, plant=setup.plant(over.plant.v))
            over = takeovers[design.y_s]
            if advance is not None:
                advance(k * len(designs) + i + 1, len(plants) * len(designs))
            try:
                outcome = drive(design.controller(setup.convention), over).outcome(window)
            except Exception as error:  # a controller may be third-party code
                failed.append((k, i, raised(error)))
                continue
            bad = status_among(outcome.status, FAILED_STATUSES)
            S[k, i] = np.where(bad, np.maximum(outcome.S, outcome.S_uncorrected), outcome.S)
            S_uncorrected[k, i], status[k, i] = outcome.S_uncorrected, outcome.status
            if not np.isfinite(S[k, i, outcome.status != EventStatus.INVALID]).all():
                S[k, i] = np.nan
                failed.append((k, i, "S is not finite in some scenario"))
                continue
            acted = ~status_among(outcome.status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
            for name, values in driver.items():
                values[k, i] = getattr(outcome.metrics, name)
            if not design.is_baseline:
                peaks = outcome.metrics
                comfortable[k, i] = comfortable_share(peaks.a_y_added_peak, peaks.jerk_added_peak, acted)
    return Drives(S, S_uncorrected, status, comfortable, driver, tuple(failed))
