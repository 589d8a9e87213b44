"""The account of an extraction: what was read, what was found and why the rest was refused, per source and label."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.departures import LEFT
from ldctoolkit.recordings.find_departures import ACCEPTED, REASONS, Found
from ldctoolkit.recordings.recording import Label, RecordingTable
from ldctoolkit.recordings.source_file import printable

WIDTH_STEP: Final = 0.1
"""Width of a bin of the lane-width histogram [m]."""

WIDTH_BINS: Final = 80
"""Bins from 0 to 8 m; the last also holds what is wider."""

LONGEST: Final = 1e8
"""Time [s] of a recording that is counted at most, three years: the sums stay whole numbers of 64 bits."""

SIDES: Final = 2
"""Left first, then right."""


@dataclasses.dataclass(frozen=True)
class Origin:
    """What a recording came from: recordings of one origin are counted together.

    Attributes
    ----------
    source : str
        File or folder.
    labels : tuple of Label
        Such as driver, behaviour, road.
    """

    source: str = ""
    labels: tuple[Label, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "source", printable(self.source))


@dataclasses.dataclass(frozen=True)
class Account:
    """Counts of all recordings of one origin.

    Attributes
    ----------
    origin : Origin
        What they came from.
    recordings, samples, usable : int
        Amounts; samples after resampling.
    read_ns, valid_ns : int [ns]
        Time in steps between neighbours, and between usable neighbours; without gaps. Whole numbers, whose sums do not
        depend on how the recordings were split.
    departures : (2,) int
        Left, right.
    refused : (2, k) int
        Candidates by side of their first crossing and by reason, in the order of `REASONS`.
    widths : (80,) int
        Usable samples by lane width, in bins of 0.1 m from 0; the last bin also holds wider ones.
    """

    origin: Origin
    recordings: int
    samples: int
    usable: int
    read_ns: int
    valid_ns: int
    departures: IntArray
    refused: IntArray
    widths: IntArray

    @property
    def candidates(self) -> IntArray:
        """Departures and refused candidates, (2,): left, right."""
        total: IntArray = self.departures + self.refused.sum(axis=1)
        return total

    @property
    def hours_read(self) -> float:
        """Hours of recordings, without gaps."""
        return self.read_ns / 3.6e12

    @property
    def hours_valid(self) -> float:
        """Hours in which a departure could have been seen."""
        return self.valid_ns / 3.6e12


def accounts_of(table: RecordingTable, found: Found, origins: tuple[Origin, ...]) -> tuple[Account, ...]:
    """Accounts of one table of r recordings; `origins` has one of each, (r,)."""
    distinct = tuple(dict.fromkeys(origins))
    place = {origin: i for i, origin in enumerate(distinct)}
    group = np.array([place[origin] for origin in origins], dtype=np.int64)
    count = len(distinct)
    samples = np.diff(table.offsets)
    sample_group = np.repeat(group, samples)[found.usable]
    bins = np.clip(table.lane_width[found.usable] / WIDTH_STEP, 0, WIDTH_BINS - 1).astype(np.int64)
    widths = np.bincount(sample_group * WIDTH_BINS + bins, minlength=count * WIDTH_BINS).reshape(count, WIDTH_BINS)
    kinds = ACCEPTED + 1
    side = np.where(found.side == LEFT, 0, 1)
    cell = (group[found.recording] * SIDES + side) * kinds + found.reason
    candidates = np.bincount(cell, minlength=count * SIDES * kinds).reshape(count, SIDES, kinds)
    before = np.concatenate([[0], np.cumsum(found.usable)])
    usable = before[table.offsets[1:]] - before[table.offsets[:-1]]
    amounts = [_grouped(values, group, count) for values in (np.ones_like(group), samples, usable)]
    read, valid = (_grouped(_nanoseconds(seconds), group, count) for seconds in (found.read, found.driven))
    return tuple(
        Account(
            origin=origin,
            recordings=int(amounts[0][i]),
            samples=int(amounts[1][i]),
            usable=int(amounts[2][i]),
            read_ns=int(read[i]),
            valid_ns=int(valid[i]),
            departures=candidates[i, :, ACCEPTED],
            refused=candidates[i, :, : len(REASONS)],
            widths=widths[i],
        )
        for i, origin in enumerate(distinct)
    )


def _grouped(values: IntArray, group: IntArray, count: int) -> IntArray:
    """Sums of whole numbers by group, (count,)."""
    total = np.zeros(count, dtype=np.int64)
    np.add.at(total, group, values)
    return total


def _nanoseconds(seconds: FloatArray) -> IntArray:
    """Times as whole numbers; a recording of absurd times counts as `LONGEST`."""
    whole: IntArray = np.rint(np.minimum(seconds, LONGEST) * 1e9).astype(np.int64)
    return whole


def joined_accounts(accounts: Iterable[Account]) -> tuple[Account, ...]:
    """One account an origin, in the order in which the origins first come."""
    of: dict[Origin, list[Account]] = {}
    for account in accounts:
        of.setdefault(account.origin, []).append(account)
    return tuple(_sum(origin, parts) for origin, parts in of.items())


def _sum(origin: Origin, parts: list[Account]) -> Account:
    names = [field.name for field in dataclasses.fields(Account) if field.name != "origin"]
    return Account(origin, *(sum(getattr(part, name) for part in parts) for name in names))


def share_of_widths(widths: IntArray) -> tuple[FloatArray, FloatArray]:
    """Bin edges, (81,) [m], and the share of samples in each bin, (80,)."""
    edges: FloatArray = np.asarray(np.arange(WIDTH_BINS + 1) * WIDTH_STEP, dtype=np.float64)
    return edges, widths / max(int(widths.sum()), 1)
