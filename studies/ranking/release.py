"""What a release engineer asks of a design beside its mean S: one figure a design, from the companions of its runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


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
