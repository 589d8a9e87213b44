"""One-at-a-time profile around a design: what mean S does when one gain, or the threshold, moves and nothing else."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import InputError
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.design_space.law_space import THRESHOLD
from studies.ranking.resampled import Resampled, simultaneous_interval
from studies.results import CaseResults, StudyResults
from studies.sensitivity.drive_again import check_reproduced, drive_designs
from studies.sensitivity.profile_points import ProfilePoint, declared_ends, profile_points
from studies.study_file.spec import Study

POINTS = 9
"""Values of a numeric dimension that a profile has at least."""

_SAME = 1e-6
"""Differences of mean S [m s] below this are solver tolerance."""


@dataclasses.dataclass(frozen=True)
class Profile:
    """Mean S along one dimension through a design; k values in rising order, words and switches as they are written.

    Attributes
    ----------
    name : str
        ``"y_s"`` or a gain.
    unit : str
        SI unit; ``"1"`` for a pure number.
    designs : tuple of Design
        k of them, which differ in this dimension only.
    values : tuple of float, int, str or bool
        Of the dimension.
    at : int
        Which of them is the design that the profile goes through.
    S : (k,) [m s]
        Mean on the scenarios that all profiles share; NaN where the law failed.
    difference, low, high : (k,) [m s]
        Mean S minus that of the design, paired on the scenarios, and its interval; those of all profiles of a call hold
        at once.
    stored : (k,) bool
        Designs of the study; the others were driven for the profile.
    failures : tuple of str
        Why a law failed; empty where it did not.
    open_ends : tuple of float
        Smallest and largest number that the study's tables declare, as far as the law itself allows more beyond; none
        for words and switches.
    """

    name: str
    unit: str
    designs: tuple[Design, ...]
    values: tuple[GainValue, ...]
    at: int
    S: FloatArray
    difference: FloatArray
    low: FloatArray
    high: FloatArray
    stored: BoolArray
    failures: tuple[str, ...]
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

        None where S is smallest elsewhere, where nothing beyond is allowed, and where S at the end cannot be told from
        S at the design, or, if the design itself is at the end, from S next to it: chance or nothing moves it there.
        """
        best = self.best
        if len(self.values) < 2 or self.values[best] not in self.open_ends:
            return None
        if best != self.at:
            told = self.high[best] < 0 and self.difference[best] < -_SAME
        else:
            inner = best + 1 if best == 0 else best - 1
            told = self.low[inner] > 0 and self.difference[inner] > _SAME
        return self.values[best] if told else None


def winner_profile(
    results: StudyResults,
    study: Study,
    winner: Design,
    *,
    case: int = 0,
    points: int = POINTS,
    advance: Callable[[int, int], None] | None = None,
) -> tuple[Profile, ...]:
    """Move one dimension at a time away from a design, over the range that the study's tables declare for its law.

    Parameters
    ----------
    results : StudyResults
        Of the study.
    study : Study
    winner : Design
        One of the designs in the results.
    case : int
        Which case; the primary one by default.
    points : int
        Numbers of which the study holds fewer are filled up to so many, evenly over the range that its tables declare,
        whose ends are always among them, and driven on the study's scenarios; 0 takes only what the study holds.
    advance : callable, optional
        Called with the number of designs driven so far and of all to be driven.

    Returns
    -------
    tuple of Profile
        One for each dimension that varies in the study's designs of that law, the threshold first; empty for none.

    Raises
    ------
    InputError
        If the winner is none of the designs, or for a negative number of points.
    LdcError
        If the winner, driven anew, does not give the stored scores: another machine or version cannot add to them.
    """
    if winner not in results.designs:
        raise InputError(f"design {winner.id}: not among the results")
    if points < 0:
        raise InputError(f"points: {points}; allowed: 0 or more")
    chosen = results.cases[case]
    row = {design: i for i, design in enumerate(results.designs)}
    along = list(profile_points(results, study, winner, points))
    missing = tuple(dict.fromkeys(one.design for one in along if one.design not in row))
    driven = drive_designs(results, study, chosen, (winner, *missing), advance) if missing else {}
    at_winner = row[winner]
    if missing:
        check_reproduced(winner, driven[winner], chosen.counted[at_winner])
    reasons = {design: found for design, found in driven.items() if isinstance(found, str)}
    table = {design: found for design, found in driven.items() if not isinstance(found, str)}
    table |= {one.design: chosen.counted[row[one.design]] for one in along if one.design in row}
    return tuple(_profiles(along, winner, table, reasons, row, results, study, chosen))


def _profiles(
    along: Sequence[ProfilePoint],
    winner: Design,
    table: Mapping[Design, FloatArray],
    reasons: Mapping[Design, str],
    row: Mapping[Design, int],
    results: StudyResults,
    study: Study,
    case: CaseResults,
) -> Iterator[Profile]:
    if not along:
        return
    scored = list(dict.fromkeys((winner, *(one.design for one in along if one.design in table))))
    S = np.stack([table[design] for design in scored])
    columns = case.drivable & np.isfinite(S).all(axis=0)
    if not columns.any():
        raise InputError("results: no scenario could be driven under every design; there is no profile")
    S = S[:, columns]
    side, settings = results.scenarios.side[columns], study.ranking
    resampled = Resampled.of(S, side, seed=study.seed, samples=settings.bootstrap)
    interval = simultaneous_interval(resampled, settings.confidence, reference=0)
    numbers = np.stack([resampled.mean, interval.centre, interval.low, interval.high])
    position = {design: i for i, design in enumerate(scored)}
    gains = controller_class(winner.law).gains()
    units = {gain.name: gain.unit for gain in gains} | {THRESHOLD: "m"}
    bounds = {gain.name: (gain.lower, gain.upper) for gain in gains} | {THRESHOLD: (0.0, math.inf)}
    for name in dict.fromkeys(one.name for one in along):
        points = [one for one in along if one.name == name]
        designs = tuple(one.design for one in points)
        own = np.full((4, len(points)), np.nan)
        for i, design in enumerate(designs):
            if design in position:
                own[:, i] = numbers[:, position[design]]
        yield Profile(
            name,
            units[name],
            designs,
            tuple(one.value for one in points),
            designs.index(winner),
            *(own[0], own[1], own[2], own[3]),
            np.array([design in row for design in designs]),
            tuple(reasons.get(design, "") for design in designs),
            tuple(end for end in declared_ends(study, winner.law, name) or () if end not in bounds[name]),
        )
