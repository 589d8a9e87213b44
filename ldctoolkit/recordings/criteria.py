"""What counts as a departure."""

from __future__ import annotations

import dataclasses
import math

from ldctoolkit.errors import InputError


@dataclasses.dataclass(frozen=True)
class Criteria:
    """What counts as a departure.

    Attributes
    ----------
    vehicle_width : float [m]
        Width over the wheels' outer edges.
    min_duration, max_duration : float [s]
        Both allowed values included.
    min_speed : float [m/s]
        The mean speed lies above.
    max_gap : float [s] or None
        Longest time step that is not a gap; None: 2.5 median steps of the recording, at least 0.25 s.
    max_jump : float [m]
        Largest step of the offset from one sample to the next.
    """

    vehicle_width: float = 1.9
    min_duration: float = 0.5
    max_duration: float = 10.0
    min_speed: float = 5.0
    max_gap: float | None = None
    max_jump: float = 0.6

    def __post_init__(self) -> None:
        def refuse(name: str, good: bool, allowed: str) -> None:
            if not good:
                raise InputError(f"{name}: {getattr(self, name)!r}; allowed: {allowed}")

        refuse("vehicle_width", 0.5 <= self.vehicle_width <= 4.0, "0.5 to 4 m")
        refuse("min_duration", 0.0 <= self.min_duration < math.inf, "0 s or more")
        refuse("max_duration", self.min_duration < self.max_duration < math.inf, "more than min_duration, finite")
        refuse("min_speed", 0.0 <= self.min_speed < math.inf, "0 m/s or more")
        refuse("max_gap", self.max_gap is None or 0.0 < self.max_gap < math.inf, "more than 0 s, or None")
        refuse("max_jump", self.max_jump > 0.0, "more than 0 m")
