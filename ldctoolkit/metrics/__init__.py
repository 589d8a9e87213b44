"""The score S and its companions: pure functions of trajectories and of one value a scenario.

Trajectories have their samples along the last axis, NaN after the end; values have the scenarios along it.
"""

from ldctoolkit.metrics.motion import (
    acceleration_peak,
    jerk_peak,
    lateral_acceleration,
    linear_lateral_acceleration,
    moving_average_jerk,
)
from ldctoolkit.metrics.position import (
    deepest_position,
    distance_to_lane_edge,
    largest_on_path,
    overshoot,
    time_back_inside,
)
from ldctoolkit.metrics.score import crossing_of_step, reduction
from ldctoolkit.metrics.shares import (
    A_Y_LIMIT,
    DTLE_LIMIT,
    JERK_LIMIT,
    back_inside_share,
    comfortable,
    comfortable_share,
    intervention_share,
    needless,
    needless_share,
    overshoot_share,
    share_deeper,
    share_within_dtle,
)
from ldctoolkit.metrics.steering import steering_effort, steering_peak, steering_rate_peak, steering_travel
from ldctoolkit.metrics.values import COMPANION_COLUMNS, COMPANION_UNITS, Companions, companions

__all__ = [
    "A_Y_LIMIT",
    "COMPANION_COLUMNS",
    "COMPANION_UNITS",
    "DTLE_LIMIT",
    "JERK_LIMIT",
    "Companions",
    "acceleration_peak",
    "back_inside_share",
    "comfortable",
    "comfortable_share",
    "companions",
    "crossing_of_step",
    "deepest_position",
    "distance_to_lane_edge",
    "intervention_share",
    "jerk_peak",
    "largest_on_path",
    "lateral_acceleration",
    "linear_lateral_acceleration",
    "moving_average_jerk",
    "needless",
    "needless_share",
    "overshoot",
    "overshoot_share",
    "reduction",
    "share_deeper",
    "share_within_dtle",
    "steering_effort",
    "steering_peak",
    "steering_rate_peak",
    "steering_travel",
    "time_back_inside",
]
