"""One-at-a-time profiles around a design: mean S over a single gain, or the threshold, with all else fixed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.declared import GainValue, checked_whole
from ldctoolkit.errors import InputError, LdcError

from ..design import Design
from ..design_space import THRESHOLD, Choices, Span
from ..measures import drive_on_plants
from ..ranking.inference import Resampled, simultaneous_interval
from ..results import StudyResults
from ..storage.folder_files import write_text
from ..study_file import Study
from ..tables import Table, to_csv
from .sensitivity import BlockSensitivity, gain_value

COLUMNS: Final = (
    *("kind", "block", "law", "dimension", "unit", "method", "designs", "index", "index_low", "index_high"),
    *("interval_over", "value", "design", "S_m_s", "difference_m_s", "difference_low_m_s", "difference_high_m_s"),
    *("stored", "note"),
)
"""``kind`` is ``first``, ``total``, ``none`` (``note`` says why) or ``profile``; fields that a kind lacks are empty."""


def write_sensitivity(blocks: Sequence[BlockSensitivity], profiles: Sequence[Profile], path: str | Path) -> None:
    """Write indices and profiles as one CSV file, whole or not at all."""
    rows = [*(row for block in blocks for row in _index_rows(block))]
    rows += [row for profile in profiles for row in _profile_rows(profile)]
    write_text(Path(path), to_csv(Table.of(COLUMNS, rows)))


def _index_rows(block: BlockSensitivity) -> Iterator[dict[str, Any]]:
    shared = {"block": block.block, "law": block.law}
    indices = block.indices
    if indices is None:
        yield {"kind": "none", **shared, "note": block.reason}
        return
    kinds = {
        "first": (indices.first, indices.first_low, indices.first_high),
        "total": (indices.total, indices.total_low, indices.total_high),
    }
    for i, name in enumerate(block.names):
        for kind, numbers in kinds.items():
            if np.isnan(numbers[0][i]):
                continue
            yield {
                "kind": kind,
                **shared,
                "dimension": name,
                "method": block.method,
                "designs": block.designs,
                **{f"index{end}": values[i] for end, values in zip(("", "_low", "_high"), numbers, strict=True)},
                "interval_over": block.interval_over,
                "note": block.note,
            }


def _profile_rows(profile: Profile) -> Iterator[dict[str, Any]]:
    for i, (design, value) in enumerate(zip(profile.designs, profile.values, strict=True)):
        yield {
            "kind": "profile",
            "law": design.law,
            "dimension": profile.name,
            "unit": profile.unit,
            "value": value,
            "design": design.id,
            "S_m_s": profile.S[i],
            "difference_m_s": profile.difference[i],
            "difference_low_m_s": profile.low[i],
            "difference_high_m_s": profile.high[i],
            "stored": bool(profile.stored[i]),
            "note": profile.failures[i],
        }


POINTS = 9  # least number of values of a numeric dimension in a profile
_SAME = 1e-6  # differences of mean S [m s] below this are solver tolerance


@dataclasses.dataclass(frozen=True)
class Profile:
    """Mean S along a dimension through a design; k numbers in rising order, or words and switches in order of use."""

    name: str  # ``"y_s"`` or a gain
    unit: str  # SI unit; ``"1"`` for a pure number
    designs: tuple[Design, ...]  # (k,) Designs that differ in this dimension only
    values: tuple[GainValue, ...]  # (k,) Values of the dimension
    at: int  # Position of the design that the profile goes through
    S: FloatArray  # (k,) [m s] Mean on the scenarios that all profiles share; NaN where the law failed
    # (k,) [m s] Mean S minus that of the design, paired on the scenarios, and its interval, which is simultaneous over
    # all profiles of a call
    difference: FloatArray
    low: FloatArray
    high: FloatArray
    stored: BoolArray  # (k,) Whether the study holds the design; the others were driven for the profile
    failures: tuple[str, ...]  # (k,) Why a law failed; empty where it did not
    # Ends of the range that the study's tables declare, where the law allows values beyond; none for words and switches
    open_ends: tuple[float, ...] = ()

    @property
    def spread(self) -> float:
        """Largest minus smallest mean S along the dimension [m s]."""
        return float(np.nanmax(self.S) - np.nanmin(self.S))

    @property
    def best(self) -> int:
        """Position of the smallest mean S; the design itself where that is as small."""
        return self.at if self.difference[self.at] <= np.nanmin(self.difference) else int(np.nanargmin(self.difference))

    @property
    def beyond(self) -> GainValue | None:
        """The end of the declared range where mean S is smallest, if something better may lie beyond it.

        None where S is smallest elsewhere, where no value beyond is allowed, and where S at the end is not separated
        from S at the design, or, if the design itself is at the end, from S at the next value: the minimum may then be
        there by chance.
        """
        best = self.best
        if len(self.values) < 2 or self.values[best] not in self.open_ends:
            return None
        if best != self.at:
            separated = self.high[best] < 0 and self.difference[best] < -_SAME
        else:
            inner = best + 1 if best == 0 else best - 1
            separated = self.low[inner] > 0 and self.difference[inner] > _SAME
        return self.values[best] if separated else None


def winner_profile(
    results: StudyResults,
    study: Study,
    winner: Design,
    *,
    points: int = POINTS,
    advance: Callable[[int, int], None] | None = None,
) -> tuple[Profile, ...]:
    """Move one dimension at a time away from a design, over the range that the study's tables declare for its law.

    Raises `InputError` if the winner is none of the designs, or for a negative number of points; `LdcError` if the
    winner, driven anew, does not give the stored scores: another machine or version cannot add to them.

    Parameters
    ----------
    results : StudyResults
        Of the study.
    study : Study
    winner : Design
        One of the designs in the results.
    points : int
        Numbers of which the study holds fewer are filled up to so many, evenly over the range that its tables declare,
        whose ends are always among them, and driven on the study's scenarios; 0 takes only what the study holds.
    advance : callable, optional
        Called with the number of designs driven so far and of all to be driven.

    Returns
    -------
    tuple of Profile
        One for each dimension that varies in the study's designs of that law, the threshold first; empty for none.
    """
    if winner not in results.designs:
        raise InputError("winner", "is not among the results", value=winner.id)
    checked_whole("points", points, lower=0)
    if points and winner in results.unsafe:
        problem = "ended or held up its process in the study, and is not driven in this one"
        raise InputError("winner", problem, value=winner.label, hint="points = 0 drives nothing")
    row = {design: i for i, design in enumerate(results.designs)}
    along = list(profile_points(results, study, winner, points))
    missing = tuple(dict.fromkeys(point.design for point in along if point.design not in row))
    reasons: dict[Design, str] = {}
    table = {point.design: results.counted[row[point.design]] for point in along if point.design in row}
    if missing:
        setup, designs = study.setup(), (winner, *missing)
        drives = drive_on_plants(designs, [setup.options], results.scenarios, setup, results.window, advance)
        reasons = {designs[i]: reason for _, i, reason in drives.raised}
        _check_reproduced(winner, reasons.get(winner, ""), drives.S[0, 0], results.counted[row[winner]])
        pairs = zip(missing, drives.S[0, 1:], strict=True)
        table |= {design: S for design, S in pairs if design not in reasons}
    return tuple(_profiles(along, winner, table, reasons, row, results, study))


def _profiles(
    along: Sequence[ProfilePoint],
    winner: Design,
    table: Mapping[Design, FloatArray],
    reasons: Mapping[Design, str],
    row: Mapping[Design, int],
    results: StudyResults,
    study: Study,
) -> Iterator[Profile]:
    if not along:
        return
    scored = list(dict.fromkeys((winner, *(point.design for point in along if point.design in table))))
    S = np.stack([table[design] for design in scored])
    columns = results.drivable & np.isfinite(S).all(axis=0)
    if not columns.any():
        raise InputError("results", "no scenario could be driven under every design", hint="there is no profile")
    S = S[:, columns]
    side, settings = results.scenarios.side[columns], study.ranking
    cluster = results.scenarios.cluster
    cluster = None if cluster is None else cluster[columns]
    resampled = Resampled.of(S, side, seed=study.seed, samples=settings.bootstrap, cluster=cluster)
    interval = simultaneous_interval(resampled, settings.confidence, reference=0)
    numbers = np.stack([resampled.mean, interval.centre, interval.low, interval.high])
    numbers = np.append(numbers, np.full((4, 1), np.nan), axis=1)  # the last column serves all laws that failed
    position = {design: i for i, design in enumerate(scored)}
    gains = winner.kind.gains()
    units = {gain.name: gain.unit for gain in gains} | {THRESHOLD: "m"}
    bounds = {gain.name: (gain.lower, gain.upper) for gain in gains} | {THRESHOLD: (0.0, math.inf)}
    for name in dict.fromkeys(point.name for point in along):
        points = [point for point in along if point.name == name]
        designs = tuple(point.design for point in points)
        scores = numbers[:, [position.get(design, -1) for design in designs]]
        yield Profile(
            name,
            units[name],
            designs,
            tuple(point.value for point in points),
            designs.index(winner),
            *(scores[0], scores[1], scores[2], scores[3]),
            np.array([design in row for design in designs]),
            tuple(reasons.get(design, "") for design in designs),
            tuple(end for end in declared_ends(study, winner.law, name) or () if end not in bounds[name]),
        )


@dataclasses.dataclass(frozen=True)
class ProfilePoint:
    """A value of a dimension, and the winner with that value in place of its present one."""

    name: str
    value: GainValue
    design: Design


def profile_points(results: StudyResults, study: Study, winner: Design, points: int) -> Iterator[ProfilePoint]:
    """Every value of every dimension in the profiles, that of the winner included."""
    written = () if study.search is not None else study.designs
    family = [design for design in dict.fromkeys((*results.designs, *written)) if design.law == winner.law]
    held = frozenset(results.designs)
    kinds = {gain.name: gain for gain in winner.kind.gains()}
    for name in (THRESHOLD, *(gain for gain, _ in winner.gains)):
        used = list(
            dict.fromkeys((*(gain_value(design, name) for design in family), *_declared(study, winner.law, name)))
        )
        winner_value = gain_value(winner, name)
        if len(used) < 2:
            continue
        have = [value for value in used if value == winner_value or moved(winner, name, value) in held]
        gain = kinds.get(name)
        options = any(isinstance(value, str | bool) for value in used)
        if points and options:
            have = used
        elif points:
            log = gain is not None and gain.scale == "log"
            whole = gain is not None and isinstance(gain.default, int)
            held_numbers = [float(value) for value in have]
            have += _between([float(value) for value in used], held_numbers, points, log=log, whole=whole)
        if len(have) > 1:
            ordered = have if options else sorted(have, key=float)
            yield from (ProfilePoint(name, value, moved(winner, name, value)) for value in ordered)


def declared_ends(study: Study, law: str, name: str) -> tuple[float, float] | None:
    """Smallest and largest number that the tables of a study declare in a dimension of a law; None without numbers."""
    values = list(_declared(study, law, name))
    if not values or any(isinstance(value, str | bool) for value in values):
        return None
    numbers = [float(value) for value in values]
    return min(numbers), max(numbers)


def _declared(study: Study, law: str, name: str) -> Iterator[GainValue]:
    """The values of all lists and the ends of all ranges that the tables declare in a dimension of a law."""
    for block in study.design:
        for space in block.space():
            if space.law == law:
                for other, dimension in space.dimensions:
                    if other == name:
                        yield from (
                            dimension.values if isinstance(dimension, Choices) else (dimension.low, dimension.high)
                        )


def _between(used: Sequence[float], have: Sequence[float], points: int, *, log: bool, whole: bool) -> list[GainValue]:
    """Evenly spaced numbers over the range of `used`, except those close to a number of `have`.

    Both ends of the range are added if they are missing: a sample seldom contains them.
    """
    low, high = min(used), max(used)
    span = Span(low, high, "log" if log and low * high > 0 else "linear")
    added: list[GainValue] = [round(end) if whole else end for end in (low, high) if end not in have]
    if len(have) >= points:
        return added
    held_shares = [span.share(value) for value in have]
    for share in np.linspace(0.0, 1.0, points)[1:-1].tolist():
        if min(abs(share - other) for other in held_shares) > 0.5 / (points - 1):
            value = round(float(span.at(share))) if whole else span.at(share)
            if value not in added and value not in have:
                added.append(value)
    return added


def moved(winner: Design, name: str, value: GainValue) -> Design:
    """The design with another value in a dimension."""
    if name == THRESHOLD:
        return dataclasses.replace(winner, y_s=float(value))
    gains = tuple((gain, value if gain == name else unchanged) for gain, unchanged in winner.gains)
    return dataclasses.replace(winner, gains=gains)


_AS_STORED = 1e-6  # differences [m s] between new and stored scores below this are solver tolerance


def _check_reproduced(design: Design, reason: str, again: FloatArray, stored: FloatArray) -> None:
    """Raise if a stored design, driven again, does not give its stored scores: no new design is then comparable."""
    where = f"design {design.id} ({design.label})"
    if reason:
        raise LdcError(where, f"has results, but fails now: {reason}")
    if not np.allclose(again, stored, rtol=0.0, atol=_AS_STORED, equal_nan=True):
        hint = "they are of another version or machine; no design can be added to them"
        raise LdcError(where, "driven again, does not give its stored scores", hint=hint)
