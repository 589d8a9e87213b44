"""What an extraction is asked for and what it gives: criteria, departures, and the account of everything refused."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

from ldctoolkit.departures import Departures
from ldctoolkit.errors import InputError
from ldctoolkit.recordings.events import REASONS
from ldctoolkit.recordings.read import SourceFile


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


@dataclasses.dataclass(frozen=True)
class Refused:
    """Refused candidates, counted by reason. One candidate has one reason: the first that holds, in this order.

    Attributes
    ----------
    lane_change, invalid, gap, jump : int
        Something broke into the manoeuvre: the lane changed, samples were invalid, time or offset jumped.
    cut_by_end : int
        The recording started or ended with the edge beyond the line.
    too_short, too_long, too_few_samples, slow : int
        A criterion was not met; fewer than three samples cannot be reduced to the eight parameters.
    intended : int
        The turn signal was on towards the departed side.
    implausible : int
        The mean acceleration is beyond 9.81 m/s^2 either way, more than tyres can do: noise in the speeds.
    """

    lane_change: int = 0
    invalid: int = 0
    gap: int = 0
    jump: int = 0
    cut_by_end: int = 0
    too_short: int = 0
    too_long: int = 0
    too_few_samples: int = 0
    slow: int = 0
    intended: int = 0
    implausible: int = 0

    @property
    def total(self) -> int:
        """All refused candidates."""
        return sum(count for _, count in self.items())

    def items(self) -> Iterator[tuple[str, int]]:
        """Reason and count, in order of precedence."""
        return ((reason, getattr(self, reason)) for reason in REASONS)


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Where departures come from and how they were found; kept in the departures table.

    Attributes
    ----------
    criteria : Criteria
        What counted as a departure.
    refused : Refused
        Candidates that did not.
    sources : tuple of SourceFile
        Files read; empty when the recordings were given as arrays.
    recordings, samples, invalid_samples : int
        Amounts read; invalid samples are those marked so and those with a missing number.
    hours : float [h]
        Time driven: steps between usable neighbours, without gaps.
    curvature : str
        "measured", "yaw_rate", "none" or "mixed".
    warnings : tuple of str
        What looked wrong with the recordings.
    """

    criteria: Criteria = dataclasses.field(default_factory=Criteria)
    refused: Refused = dataclasses.field(default_factory=Refused)
    sources: tuple[SourceFile, ...] = ()
    recordings: int = 0
    samples: int = 0
    invalid_samples: int = 0
    hours: float = 0.0
    curvature: str = "none"
    warnings: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Extraction:
    """Departures found, and the account of everything else.

    Attributes
    ----------
    departures : Departures
        In the order of the recordings and, inside each, of time.
    provenance : Provenance
        Criteria, counts and sources.
    """

    departures: Departures
    provenance: Provenance

    @property
    def refused(self) -> Refused:
        """Refused candidates by reason."""
        return self.provenance.refused

    @property
    def candidates(self) -> int:
        """Departures and refused candidates together."""
        return len(self.departures) + self.refused.total

    @property
    def recordings(self) -> int:
        """Number of recordings read."""
        return self.provenance.recordings

    @property
    def hours(self) -> float:
        """Time driven [h], without gaps and invalid samples."""
        return self.provenance.hours

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looked wrong with the recordings, in words."""
        return self.provenance.warnings
