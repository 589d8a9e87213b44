"""What a release engineer asks of a design beside its mean S: one figure a design, from the companions of its runs."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import EventStatus, metrics
from studies.design import Design
from studies.ranking.masked import masked_max, masked_mean, masked_quantile
from studies.results import CaseResults, status_among

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


@dataclasses.dataclass(frozen=True)
class ReleaseFigures:
    """Figures of d designs, arrays of d. Each says over which departures it is taken.

    What is taken over interventions is NaN where a design never intervened.

    Attributes
    ----------
    deepest_mean, deepest_p95 : [m]
        Deepest position of the edge beyond the line: mean and 95 % quantile over all departures.
    dtle_mean, dtle_p5, dtle_min : [m]
        Smallest distance of the front axle's edge to the line, negative beyond it: mean, 5 % quantile and least.
    within_dtle : share
        Departures whose distance stays at or above -0.3 m.
    needless : share
        Departures in which the design took over although they stay below D_y without control.
    overshoot_share : share
        Of the interventions, those that take the opposite edge beyond the opposite line.
    overshoot_max : [m]
        How far at most.
    back_inside : share
        Of the interventions, those after which the edge is back inside before the loop ends.
    t_back_median : [s]
        Over interventions, from the departure's start; one that is not back counts as infinite.
    a_y_peak_mean, a_y_peak_p95, a_y_peak_max : [m/s^2]
        Largest lateral acceleration, over interventions.
    jerk_peak_mean, jerk_peak_p95, jerk_peak_max : [m/s^3]
        Largest lateral jerk, over interventions.
    comfortable : share
        Of the interventions, those that keep both limits of ISO 11270.
    delta_peak_max : [rad]
        Largest steering angle of the wheel.
    delta_rate_peak_max : [rad/s]
        Largest rate of it.
    effort_mean : [rad^2 s]
        Mean integral of the squared steering angle, over interventions.
    travel_mean : [rad]
        Mean sum of the steering angle's changes, over interventions.
    law_time : [us]
        Mean wall time of the law's own step per command; 0 for a linear law, NaN where it was not measured.
    """

    deepest_mean: FloatArray
    deepest_p95: FloatArray
    dtle_mean: FloatArray
    dtle_p5: FloatArray
    dtle_min: FloatArray
    within_dtle: FloatArray
    needless: FloatArray
    overshoot_share: FloatArray
    overshoot_max: FloatArray
    back_inside: FloatArray
    t_back_median: FloatArray
    a_y_peak_mean: FloatArray
    a_y_peak_p95: FloatArray
    a_y_peak_max: FloatArray
    jerk_peak_mean: FloatArray
    jerk_peak_p95: FloatArray
    jerk_peak_max: FloatArray
    comfortable: FloatArray
    delta_peak_max: FloatArray
    delta_rate_peak_max: FloatArray
    effort_mean: FloatArray
    travel_mean: FloatArray
    law_time: FloatArray

    @classmethod
    def of(
        cls, case: CaseResults, designs: Sequence[Design], d_y: FloatArray, *, order: Sequence[int], D_y: float
    ) -> ReleaseFigures:
        """Take the figures of one case.

        Parameters
        ----------
        case : CaseResults
            Scenarios that can be driven only.
        designs : sequence of Design
            In the order of `case`.
        d_y : (n,) [m]
            Depth of the departures without control.
        order : sequence of int
            Which designs, in the order wanted.
        D_y : float [m]
            Depth below which a departure needs no intervention.
        """
        acted = ~status_among(case.status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
        acted[[design.is_baseline for design in designs]] = False
        in_memory = isinstance(case.companions.deepest, np.ndarray)
        size = max(1, (_BLOCK_ENTRIES if in_memory else _STORED_ENTRIES) // max(1, d_y.size))
        rows = [np.asarray(order[first : first + size], dtype=np.int64) for first in range(0, len(order), size)]
        with ThreadPoolExecutor(max(1, min(_MOST_THREADS, os.cpu_count() or 1, len(rows)))) as pool:
            blocks = list(pool.map(lambda some: _figures(case, acted, some, d_y, D_y), rows))
        columns: dict[str, Any] = {name: np.concatenate([block[name] for block in blocks]) for name in COLUMNS}
        return cls(**columns)

    def take(self, order: Sequence[int] | npt.NDArray[np.int64]) -> ReleaseFigures:
        """The same for some of the designs, in the order given."""
        changes: dict[str, Any] = {name: getattr(self, name)[order] for name in COLUMNS}
        return dataclasses.replace(self, **changes)


COLUMNS: Final = {
    "deepest_mean": "deepest_mean_m",
    "deepest_p95": "deepest_p95_m",
    "dtle_mean": "dtle_mean_m",
    "dtle_p5": "dtle_p5_m",
    "dtle_min": "dtle_min_m",
    "within_dtle": "within_dtle_share",
    "needless": "needless_share",
    "overshoot_share": "overshoot_share",
    "overshoot_max": "overshoot_max_m",
    "back_inside": "back_inside_share",
    "t_back_median": "t_back_median_s",
    "a_y_peak_mean": "a_y_peak_mean_m_s2",
    "a_y_peak_p95": "a_y_peak_p95_m_s2",
    "a_y_peak_max": "a_y_peak_max_m_s2",
    "jerk_peak_mean": "jerk_peak_mean_m_s3",
    "jerk_peak_p95": "jerk_peak_p95_m_s3",
    "jerk_peak_max": "jerk_peak_max_m_s3",
    "comfortable": "comfortable_share",
    "delta_peak_max": "delta_peak_max_rad",
    "delta_rate_peak_max": "delta_rate_peak_max_rad_s",
    "effort_mean": "effort_mean_rad2_s",
    "travel_mean": "travel_mean_rad",
    "law_time": "law_time_us",
}
"""Figure -> its column in a table, with the unit or the word share at the end."""


_BLOCK_ENTRIES: Final = 500_000
"""Runs whose companions are looked at at once (4 MB each); no figure depends on it."""

_STORED_ENTRIES: Final = 2_500_000
"""The same where companions are read from a study's folder (20 MB each): a file is opened for many designs at once."""

_MOST_THREADS: Final = 2
"""Blocks at once: each takes the memory of several companions."""


def _figures(
    case: CaseResults, acted: BoolArray, rows: npt.NDArray[np.int64], d_y: FloatArray, D_y: float
) -> dict[str, Any]:
    """All figures of some designs by name; `acted` tells where each took over."""
    acted = acted[rows]

    def value(name: str) -> FloatArray:
        result: FloatArray = getattr(case.companions, name)[rows].astype(np.float64, copy=False)
        return result

    # one companion after the other: all of them together would be the largest thing in memory
    return {
        "needless": metrics.needless_share(acted, d_y, D_y),
        "law_time": 1e6 * case.law_time[rows],
        **_of_deepest(value("deepest")),
        **_of_distance(value("dtle")),
        **_of_overshoot(value("overshoot"), acted),
        **_of_way_back(value("t_back"), acted),
        **_of_motion(value("a_y_peak"), value("jerk_peak"), acted),
        "delta_peak_max": masked_max(value("delta_peak"), acted),
        "delta_rate_peak_max": masked_max(value("delta_rate_peak"), acted),
        "effort_mean": masked_mean(value("effort"), acted),
        "travel_mean": masked_mean(value("travel"), acted),
    }


def _of_deepest(deepest: FloatArray) -> dict[str, Any]:
    return {"deepest_mean": deepest.mean(axis=1), "deepest_p95": np.quantile(deepest, 0.95, axis=1)}


def _of_distance(dtle: FloatArray) -> dict[str, Any]:
    return {
        "dtle_mean": dtle.mean(axis=1),
        "dtle_p5": np.quantile(dtle, 0.05, axis=1),
        "dtle_min": dtle.min(axis=1),
        "within_dtle": metrics.share_within_dtle(dtle),
    }


def _of_overshoot(overshoot: FloatArray, acted: BoolArray) -> dict[str, Any]:
    return {
        "overshoot_share": metrics.overshoot_share(overshoot, acted),
        "overshoot_max": masked_max(overshoot, acted),
    }


def _of_way_back(t_back: FloatArray, acted: BoolArray) -> dict[str, Any]:
    return {
        "back_inside": metrics.back_inside_share(t_back, acted),
        "t_back_median": masked_quantile(t_back, acted, 0.5),
    }


def _of_motion(a_y_peak: FloatArray, jerk_peak: FloatArray, acted: BoolArray) -> dict[str, Any]:
    return {
        "a_y_peak_mean": masked_mean(a_y_peak, acted),
        "a_y_peak_p95": masked_quantile(a_y_peak, acted, 0.95),
        "a_y_peak_max": masked_max(a_y_peak, acted),
        "jerk_peak_mean": masked_mean(jerk_peak, acted),
        "jerk_peak_p95": masked_quantile(jerk_peak, acted, 0.95),
        "jerk_peak_max": masked_max(jerk_peak, acted),
        "comfortable": metrics.comfortable_share(a_y_peak, jerk_peak, acted),
    }
