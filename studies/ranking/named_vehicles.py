"""Designs on other vehicles than their laws were designed for: the worst of a few named ones, and any plant."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.law_checks import raised
from ldctoolkit.metrics import comfortable_share
from ldctoolkit.plant_options import Mismatch, PlantOptions
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover, Window, drive

from ..design import Design
from ..results import FAILED_STATUSES, status_among

VEHICLES: Final[Mapping[str, Mapping[str, float]]] = {
    "light": {"m": 0.85, "I_z": 0.85},
    "heavy": {"m": 1.3, "I_z": 1.3},
    "soft": {"C_af": 0.8, "C_ar": 0.8},
    "stiff": {"C_af": 1.2, "C_ar": 1.2},
}
"""Named vehicles: what the quantities of the study's vehicle are multiplied with; the others are as nominal."""

DEPARTURES: Final = 50  # of each side, that every design is driven on with every named vehicle
Worst = Mapping[str, tuple[float, float]]  # design -> its S_worst [m s] and comfortable_worst


def worst_of_vehicles(
    names: tuple[str, ...], designs: Sequence[Design], scenarios: Scenarios, setup: Setup, window: Window
) -> Worst:
    """The largest mean S and the least comfortable share over named vehicles, on the first departures of each side.

    A number that is not known on one vehicle is not known at all.
    """
    some = first_of_each_side(scenarios, DEPARTURES)
    content = b"".join(array.tobytes() for array in some.arrays())
    return _worst(names, tuple(designs), _Kept(content, some), setup, window)


@dataclasses.dataclass(frozen=True)
class _Kept:
    content: bytes
    scenarios: Scenarios = dataclasses.field(compare=False)


@functools.lru_cache(maxsize=8)
def _worst(names: tuple[str, ...], designs: tuple[Design, ...], kept: _Kept, setup: Setup, window: Window) -> Worst:
    """Kept for the next time: a run ranks more than once."""
    plants = []
    for name in names:
        fixed = {quantity: (factor, factor) for quantity, factor in VEHICLES[name].items()}
        # friction is of the road, not of the vehicle
        mismatch = Mismatch(mu=setup.options.mismatch.mu, **fixed)
        plants.append(dataclasses.replace(setup.options, mismatch=mismatch))
    drives = drive_on_plants(designs, plants, kept.scenarios, setup, window)
    driven = drives.status != EventStatus.INVALID
    S = np.where(driven, drives.S, 0.0).sum(axis=2) / np.maximum(driven.sum(axis=2), 1)
    S_worst = np.where(driven.any(axis=2), S, np.nan).max(axis=0)
    pairs = zip(S_worst.tolist(), drives.comfortable.min(axis=0).tolist(), strict=True)
    return dict(zip((design.id for design in designs), pairs, strict=True))


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
    raised: tuple[tuple[int, int, str], ...]  # By position: laws that raised


def first_of_each_side(scenarios: Scenarios, most: int) -> Scenarios:
    """At most so many scenarios of each side, with the numbers that they have."""
    rows = [np.flatnonzero(scenarios.side == side)[:most] for side in (LEFT, RIGHT)]
    return scenarios.take(np.concatenate(rows))


def drive_on_plants(
    designs: Sequence[Design], plants: Sequence[PlantOptions], scenarios: Scenarios, setup: Setup, window: Window
) -> Drives:
    """Drive every design on every plant; each by itself, so that no number depends on another.

    The setup's own plant does not count.
    """
    shape = (len(plants), len(designs), scenarios.n)
    S, S_uncorrected = np.full(shape, np.nan), np.full(shape, np.nan)
    status = np.full(shape, EventStatus.INVALID, dtype=np.int8)
    comfortable = np.full(shape[:2], np.nan)
    failed = []
    for k, options in enumerate(plants):
        takeovers: dict[float, Takeover] = {}  # of one plant only: tables of a takeover are large
        for i, design in enumerate(designs):
            if design.y_s not in takeovers:
                over = Takeover.build(scenarios, setup.on(options), y_s=design.y_s)
                # designs know the actuator and the camera of the study, not the other ones
                takeovers[design.y_s] = dataclasses.replace(over, plant=setup.plant(over.plant.v))
            over = takeovers[design.y_s]
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
            if not design.is_baseline:
                peaks = outcome.companions
                comfortable[k, i] = comfortable_share(peaks.a_y_added_peak, peaks.jerk_added_peak, acted)
    return Drives(S, S_uncorrected, status, comfortable, tuple(failed))
