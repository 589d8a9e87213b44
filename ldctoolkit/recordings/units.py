"""Warnings, in words, about recordings whose columns look like another unit or another reference."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ldctoolkit.recordings.table import BoolArray, FloatArray, RecordingTable


class UnitCheck:
    """Counts samples beyond plausible limits, table by table, and says at the end what looks wrong.

    Only counts are kept, so a median is judged ("more than half lie above") without holding the samples, and the
    warnings do not depend on how the recordings were split.
    """

    def __init__(self, vehicle_width: float) -> None:
        self._vehicle_width = vehicle_width
        self._count: dict[str, int] = {}

    def add(self, table: RecordingTable, usable: BoolArray, median_step: FloatArray) -> None:
        """Count one table.

        Parameters
        ----------
        table : RecordingTable
            m samples of r recordings.
        usable : (m,) bool
            Samples to be judged.
        median_step : (r,) [s]
            Median time step of each recording; NaN where it has no two samples.
        """
        offset, width = np.abs(table.lane_offset[usable]), table.lane_width[usable]
        speed = table.speed[usable]
        steps = median_step[np.isfinite(median_step)]
        counts: dict[str, int] = {
            "samples": speed.size,
            "speed > 60": _count(speed > 60.0),
            "speed > 42": _count(speed > 42.0),
            "speed > 1000": _count(speed > 1000.0),
            "speed < 0": _count(speed < 0.0),
            "width > 1000": _count(width > 1000.0),
            "width > 100": _count(width > 100.0),
            "width > 6": _count(width > 6.0),
            "width < 2": _count(width < 2.0),
            "width <= vehicle": _count(width <= self._vehicle_width),
            "offset > 10": _count(offset > 10.0),
            "offset > width": _count(offset > width),
            "recordings": steps.size,
            "step > 2": _count(steps > 2.0),
            "step < 0.002": _count(steps < 0.002),
        }
        if table.curvature is not None:
            counts["curvature > 0.2"] = _count(np.abs(table.curvature[usable]) > 0.2)
        elif table.yaw_rate is not None:
            counts["yaw rate > 1.5"] = _count(np.abs(table.yaw_rate[usable]) > 1.5)
        self.take(counts.items())

    @property
    def counts(self) -> tuple[tuple[str, int], ...]:
        """What was counted so far."""
        return tuple(self._count.items())

    def take(self, counts: Iterable[tuple[str, int]]) -> None:
        """Add what another check has counted."""
        for name, count in counts:
            self._count[name] = self._count.get(name, 0) + count

    def _share(self, name: str, of: str = "samples") -> float:
        return self._count.get(name, 0) / max(self._count.get(of, 0), 1)

    def messages(self) -> tuple[str, ...]:
        """Warnings in words, none when everything is plausible."""
        found = []
        if self._share("speed > 1000") > 0.5:
            found.append("column 'speed': most values are above 1000; the unit looks like mm/s, m/s is needed")
        elif self._share("speed > 60") > 0.01:
            share = self._share("speed > 60")
            found.append(
                f"column 'speed': {share:.0%} of the samples are above 60 m/s (216 km/h); the unit looks like km/h, "
                "m/s is needed (divide by 3.6)"
            )
        elif self._share("speed > 42") > 0.5:  # a city driven at 50 km/h stays below 60 in either unit
            found.append(
                "column 'speed': most samples are above 42 m/s (150 km/h); if the unit is km/h, divide by 3.6: m/s is "
                "needed"
            )
        if self._share("speed < 0") > 0.5:
            found.append("column 'speed': most values are negative; speed along the road is positive")
        if self._share("width > 1000") > 0.5:
            found.append("column 'lane_width': most values are above 1000; the unit looks like mm, m is needed")
        elif self._share("width > 100") > 0.5:
            found.append("column 'lane_width': most values are above 100; the unit looks like cm, m is needed")
        elif self._share("width > 6") > 0.5:
            found.append("column 'lane_width': most lanes are wider than 6 m; is the unit feet? m is needed")
        elif self._share("width < 2") > 0.5:
            found.append("column 'lane_width': most lanes are narrower than 2 m; full width in m is needed, not half")
        elif self._share("width <= vehicle") > 0.5:
            found.append(f"vehicle width {self._vehicle_width} m: most lanes are no wider than that")
        if self._share("offset > 10") > 0.5:
            found.append("column 'lane_offset': most values are beyond 10; the unit looks like mm or cm, m is needed")
        elif self._share("offset > width") > 0.05 and self._share("width < 2") <= 0.5:
            share = self._share("offset > width")
            found.append(
                f"column 'lane_offset': in {share:.0%} of the samples the vehicle's centre is further than a lane "
                "width from the lane's centre; the offset is measured in m from the centre of the vehicle's own lane"
            )
        if self._share("step > 2", "recordings") > 0.5:
            found.append("column 't': the time step is above 2 in most recordings; the unit looks like ms, s is needed")
        if self._share("step < 0.002", "recordings") > 0.5:
            found.append("column 't': the time step is below 0.002 in most recordings; is the unit minutes or hours?")
        if self._share("curvature > 0.2") > 0.01:
            found.append(
                f"column 'curvature': {self._share('curvature > 0.2'):.0%} of the samples are beyond 0.2 1/m (a radius "
                "under 5 m); is it a radius or in 1/km? 1/m is needed"
            )
        if self._share("yaw rate > 1.5") > 0.01:
            found.append(
                f"column 'yaw_rate': {self._share('yaw rate > 1.5'):.0%} of the samples are beyond 1.5 rad/s; the unit "
                "looks like deg/s, rad/s is needed"
            )
        return tuple(found)


def _count(mask: BoolArray) -> int:
    return int(np.count_nonzero(mask))
