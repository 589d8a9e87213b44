"""What an extraction is asked for and what it gives: criteria, departures, and the account of everything refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator

from ldctoolkit.departures import Departures, joined_departures, no_departures
from ldctoolkit.recordings.account import Account, joined_accounts
from ldctoolkit.recordings.drawn import Drawn, joined_drawn
from ldctoolkit.recordings.events import REASONS
from ldctoolkit.recordings.evidence import Evidence, joined_evidence, no_evidence
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.recordings.source_file import SourceFile


@dataclasses.dataclass(frozen=True)
class PartResult:
    """What was found in some recordings.

    Attributes
    ----------
    departures : Departures
        In the order of the recordings and of time; extra columns: source, lane_scale, labels.
    accounts : tuple of Account
        One an origin.
    evidence : Evidence
        For warnings.
    drawn : Drawn
        Departures with their signals, to be looked at.
    problems : tuple of Problem
        What could not be used.
    """

    departures: Departures = dataclasses.field(default_factory=no_departures)
    accounts: tuple[Account, ...] = ()
    evidence: Evidence = dataclasses.field(default_factory=no_evidence)
    drawn: Drawn = dataclasses.field(default_factory=Drawn)
    problems: tuple[Problem, ...] = ()


def joined_results(parts: Iterable[PartResult]) -> PartResult:
    """Several shares as one, in their order."""
    given = list(parts)
    return PartResult(
        departures=joined_departures([part.departures for part in given]),
        accounts=joined_accounts(account for part in given for account in part.accounts),
        evidence=joined_evidence(part.evidence for part in given),
        drawn=joined_drawn(part.drawn for part in given),
        problems=tuple(problem for part in given for problem in part.problems),
    )


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
        The mean acceleration, or speed and curvature together, are beyond 9.81 m/s^2, more than tyres can do: noise. Or
        the lane is no wider than the vehicle: one of its lines is not the lane's.
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
    reader : str
        Name of the reader: "table", "spmd-das1", ...
    preparation : Preparation
        How recordings were brought to a common form.
    problems : tuple of str
        What could not be used, with file and line.
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
    reader: str = "table"
    preparation: Preparation = dataclasses.field(default_factory=Preparation)
    problems: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Extraction:
    """Departures found, and the account of everything else.

    Attributes
    ----------
    departures : Departures
        In the order of the recordings and, inside each, of time.
    provenance : Provenance
        Criteria, counts and sources.
    accounts : tuple of Account
        Counts of each source and label.
    drawn : Drawn
        Some departures with their signals, to be looked at.
    problems : tuple of Problem
        What could not be used; the rest was.
    """

    departures: Departures
    provenance: Provenance
    accounts: tuple[Account, ...] = ()
    drawn: Drawn = dataclasses.field(default_factory=Drawn)
    problems: tuple[Problem, ...] = ()

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
