"""Accounts of an extraction gathered into rows: per source, per label, all together; and the reasons in words."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Final

from ldctoolkit.recordings.account import Account, Origin, joined_accounts
from ldctoolkit.recordings.events import REASONS

SIDES: Final = ("left", "right")

MOST_ROWS: Final = 60
"""Rows of a table of sources or labels; further ones are gathered in one."""

NOT_KNOWN: Final = "not known"

MEANINGS: Final = {
    "lane_change": "the lane changes in it",
    "invalid": "it holds or touches samples that cannot be used",
    "gap": "it holds a gap in time",
    "jump": "the offset jumps in it",
    "cut_by_end": "the recording starts or ends with the edge beyond the line",
    "too_short": "shorter than the shortest duration",
    "too_long": "longer than the longest duration",
    "too_few_samples": "fewer than three samples between its crossings",
    "slow": "too slow on average, or the vehicle stops in it",
    "intended": "the turn signal is on towards the departed side",
    "implausible": "it accelerates or bends more than tyres can do, or the lane is no wider than the vehicle: noise",
}


def reason_title(reason: str) -> str:
    """A reason as a heading: ``lane change``."""
    return reason.replace("_", " ")


@dataclasses.dataclass(frozen=True)
class Row:
    """Counts of some recordings."""

    title: str  # source or value of a label
    account: Account  # their sum
    sources: tuple[str, ...] = ()  # sources, or values of the label, that the row stands for; none for all together

    @property
    def departures(self) -> tuple[int, int]:
        """Left and right."""
        left, right = self.account.departures.tolist()
        return left, right

    @property
    def refused(self) -> tuple[int, int]:
        """Refused candidates, left and right."""
        left, right = self.account.refused.sum(axis=1).tolist()
        return left, right

    @property
    def rates(self) -> tuple[float, float]:
        """Departures in an hour of valid recording, left and right; NaN without any."""
        hours = self.account.hours_valid
        left, right = (count / hours if hours > 0.0 else float("nan") for count in self.departures)
        return left, right

    @property
    def valid_share(self) -> float:
        """Valid hours of those read; NaN where nothing was read."""
        return self.account.hours_valid / self.account.hours_read if self.account.hours_read > 0.0 else float("nan")

    def refusals(self, side: int) -> dict[str, int]:
        """Count of each reason; 0 left, 1 right."""
        return dict(zip(REASONS, self.account.refused[side].tolist(), strict=True))


def total(accounts: Sequence[Account]) -> Row | None:
    """All together; None where nothing was read."""
    joined = joined_accounts(dataclasses.replace(one, origin=Origin()) for one in accounts)
    return Row("All", joined[0]) if joined else None


def by_source(accounts: Sequence[Account], most: int = MOST_ROWS) -> tuple[Row, ...]:
    """One row a source, in the order of the accounts; beyond `most` the ones with the fewest hours make one row."""
    return _rows([dataclasses.replace(one, origin=Origin(one.origin.source)) for one in accounts], most)


def label_names(accounts: Sequence[Account]) -> tuple[str, ...]:
    """Labels that any recording has, in the order in which they first come."""
    return tuple(dict.fromkeys(label.name for one in accounts for label in one.origin.labels))


def by_label(accounts: Sequence[Account], name: str, most: int = MOST_ROWS) -> tuple[Row, ...]:
    """One row a value of a label, D2 before D10; recordings without it come last. `most` as in `by_source`."""

    def value(one: Account) -> str:
        return next((label.value for label in one.origin.labels if label.name == name), "")

    valued = [dataclasses.replace(one, origin=Origin(value(one))) for one in accounts]
    return _rows(sorted(valued, key=lambda one: (not one.origin.source, _natural(one.origin.source))), most)


def _natural(words: str) -> list[tuple[int, int, str]]:
    """Sorts runs of digits as numbers, however long."""
    parts = re.split("0*([0-9]+)", words)
    return [(1, 0, part) if k % 2 == 0 else (0, len(part), part) for k, part in enumerate(parts)]


def _rows(accounts: Sequence[Account], most: int) -> tuple[Row, ...]:
    joined = joined_accounts(accounts)
    longest = set(range(len(joined)))
    if len(joined) > most:
        longest = set(sorted(longest, key=lambda i: -joined[i].read_ns)[: most - 1])
    rows = [
        Row(one.origin.source or NOT_KNOWN, one, (one.origin.source,)) for i, one in enumerate(joined) if i in longest
    ]
    rest = [one for i, one in enumerate(joined) if i not in longest]
    if rest:
        (gathered,) = joined_accounts(dataclasses.replace(one, origin=Origin()) for one in rest)
        rows.append(Row(f"{len(rest):,} more", gathered, tuple(one.origin.source for one in rest)))
    return tuple(rows)
