"""What a share of the recordings gives: departures, accounts, evidence; and shares as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

from ldctoolkit.departures import Departures, joined_departures, no_departures
from ldctoolkit.recordings.account import Account, joined_accounts
from ldctoolkit.recordings.drawn import Drawn, joined_drawn
from ldctoolkit.recordings.evidence import Evidence, joined_evidence, no_evidence
from ldctoolkit.recordings.recording import Problem


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
