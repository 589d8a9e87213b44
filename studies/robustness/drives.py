"""Designs driven on several plants, on the same scenarios."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, Scenarios, Setup
from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.law_errors import raised
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.simulation import Takeover, drive
from studies.design import Design
from studies.results import FAILED_STATUSES, Case, status_among


@dataclasses.dataclass(frozen=True)
class Drives:
    """Scores of d designs on p plants and n scenarios.

    Attributes
    ----------
    S : (p, d, n) [m s]
        As it counts: a failed scenario at least as bad as without control. NaN where the law raised, or the plant
        cannot drive the scenario.
    S_uncorrected : (p, d, n) [m s]
        NaN in the same places.
    status : (p, d, n) int8
        `ldctoolkit.EventStatus`.
    raised : tuple of (plant, design, reason)
        By position: laws that raised.
    """

    S: FloatArray
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]
    raised: tuple[tuple[int, int, str], ...]


def first_of_each_side(scenarios: Scenarios, most: int) -> Scenarios:
    """The first scenarios of each side, with the numbers that they have.

    Parameters
    ----------
    scenarios : Scenarios
    most : int
        Of each side.

    Returns
    -------
    Scenarios
    """
    rows = [np.flatnonzero(scenarios.side == side)[:most] for side in (LEFT, RIGHT)]
    return scenarios.take(np.concatenate(rows))


def drive_on_plants(
    designs: Sequence[Design], plants: Sequence[PlantOptions], scenarios: Scenarios, setup: Setup, case: Case
) -> Drives:
    """Drive every design on every plant; each by itself, so that no number depends on another.

    Parameters
    ----------
    designs : sequence of Design
        d of them.
    plants : sequence of PlantOptions
        p of them.
    scenarios : Scenarios
        n of them.
    setup : Setup
        In the convention of the case; its own plant does not count.
    case : Case

    Returns
    -------
    Drives

    Raises
    ------
    InputError
        For a plant that does not go with the setup.
    """
    shape = (len(plants), len(designs), scenarios.n)
    S, S_uncorrected = np.full(shape, np.nan), np.full(shape, np.nan)
    status = np.full(shape, EventStatus.INVALID, dtype=np.int8)
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
                outcome = drive(design.controller(case.convention), over).outcome(case.window)
            except Exception as error:  # a controller may be anybody's code
                failed.append((k, i, raised(error)))
                continue
            bad = status_among(outcome.status, FAILED_STATUSES)
            S[k, i] = np.where(bad, np.maximum(outcome.S, outcome.S_uncorrected), outcome.S)
            S_uncorrected[k, i], status[k, i] = outcome.S_uncorrected, outcome.status
            if not np.isfinite(S[k, i, outcome.status != EventStatus.INVALID]).all():
                S[k, i] = np.nan
                failed.append((k, i, "S is not finite in some scenario"))
    return Drives(S, S_uncorrected, status, tuple(failed))
