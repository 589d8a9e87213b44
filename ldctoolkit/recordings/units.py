"""Warnings, in words, about recordings whose columns look like another unit or another reference.

Only counts of samples beyond plausible limits are kept, so a median is judged ("more than half lie above") without
holding the samples, and the warnings do not depend on how the recordings were split.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.recordings.table import RecordingTable


def unit_counts(
    table: RecordingTable, usable: BoolArray, median_step: FloatArray, vehicle_width: float
) -> tuple[tuple[str, int], ...]:
    """Count samples and recordings beyond limits.

    Parameters
    ----------
    table : RecordingTable
        m samples of r recordings.
    usable : (m,) bool
        Samples to be judged.
    median_step : (r,) [s]
        Median time step of each recording; NaN where it has no two samples.
    vehicle_width : float [m]
        Width that was taken.
    """
    offset, width = np.abs(table.lane_offset[usable]), table.lane_width[usable]
    speed = table.speed[usable]
    steps = median_step[np.isfinite(median_step)]
    beyond = {
        "speed > 60": speed > 60.0,
        "speed > 42": speed > 42.0,
        "speed > 1000": speed > 1000.0,
        "speed < 0": speed < 0.0,
        "width > 1000": width > 1000.0,
        "width > 100": width > 100.0,
        "width > 6": width > 6.0,
        "width < 2": width < 2.0,
        "width <= vehicle": width <= vehicle_width,
        "offset > 10": offset > 10.0,
        "offset > width": offset > width,
        "step > 2": steps > 2.0,
        "step < 0.002": steps < 0.002,
    }
    if table.curvature is not None:
        beyond["curvature > 0.2"] = np.abs(table.curvature[usable]) > 0.2
    elif table.yaw_rate is not None:
        beyond["yaw rate > 1.5"] = np.abs(table.yaw_rate[usable]) > 1.5
    counts = {name: int(np.count_nonzero(mask)) for name, mask in beyond.items()}
    return tuple({"samples": speed.size, "recordings": steps.size, **counts}.items())


def unit_warnings(counts: Mapping[str, int], vehicle_width: float) -> list[str]:
    """Warnings in words, none when everything is plausible.

    Parameters
    ----------
    counts : mapping of str to int
        Sums of what `unit_counts` gave.
    vehicle_width : float [m]
        Width that was taken.
    """

    def share(name: str, of: str = "samples") -> float:
        return counts.get(name, 0) / max(counts.get(of, 0), 1)

    found = []
    if share("speed > 1000") > 0.5:
        found.append("column 'speed': most values are above 1000; the unit looks like mm/s, m/s is needed")
    elif share("speed > 60") > 0.01:
        found.append(
            f"column 'speed': {share('speed > 60'):.0%} of the samples are above 60 m/s (216 km/h); the unit looks "
            "like km/h, m/s is needed (divide by 3.6)"
        )
    elif share("speed > 42") > 0.5:  # a city driven at 50 km/h stays below 60 in either unit
        found.append(
            "column 'speed': most samples are above 42 m/s (150 km/h); if the unit is km/h, divide by 3.6: m/s is "
            "needed"
        )
    if share("speed < 0") > 0.5:
        found.append("column 'speed': most values are negative; speed along the road is positive")
    if share("width > 1000") > 0.5:
        found.append("column 'lane_width': most values are above 1000; the unit looks like mm, m is needed")
    elif share("width > 100") > 0.5:
        found.append("column 'lane_width': most values are above 100; the unit looks like cm, m is needed")
    elif share("width > 6") > 0.5:
        found.append("column 'lane_width': most lanes are wider than 6 m; is the unit feet? m is needed")
    elif share("width < 2") > 0.5:
        found.append("column 'lane_width': most lanes are narrower than 2 m; full width in m is needed, not half")
    elif share("width <= vehicle") > 0.5:
        found.append(f"vehicle width {vehicle_width} m: most lanes are no wider than that")
    if share("offset > 10") > 0.5:
        found.append("column 'lane_offset': most values are beyond 10; the unit looks like mm or cm, m is needed")
    elif share("offset > width") > 0.05 and share("width < 2") <= 0.5:
        found.append(
            f"column 'lane_offset': in {share('offset > width'):.0%} of the samples the vehicle's centre is further "
            "than a lane width from the lane's centre; the offset is measured in m from the centre of the vehicle's "
            "own lane"
        )
    if share("step > 2", "recordings") > 0.5:
        found.append("column 't': the time step is above 2 in most recordings; the unit looks like ms, s is needed")
    if share("step < 0.002", "recordings") > 0.5:
        found.append("column 't': the time step is below 0.002 in most recordings; is the unit minutes or hours?")
    if share("curvature > 0.2") > 0.01:
        found.append(
            f"column 'curvature': {share('curvature > 0.2'):.0%} of the samples are beyond 0.2 1/m (a radius under "
            "5 m); is it a radius or in 1/km? 1/m is needed"
        )
    if share("yaw rate > 1.5") > 0.01:
        found.append(
            f"column 'yaw_rate': {share('yaw rate > 1.5'):.0%} of the samples are beyond 1.5 rad/s; the unit looks "
            "like deg/s, rad/s is needed"
        )
    return found
