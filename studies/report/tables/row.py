"""One design in one case, as the report shows it."""

from __future__ import annotations

import dataclasses

from studies.design import Design


@dataclasses.dataclass(frozen=True)
class Interval:
    """An estimate and the interval around it."""

    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Side:
    """Scores on the departures to one side: mean S [m s] and its reduction against no control."""

    S: float
    reduction: float


@dataclasses.dataclass(frozen=True)
class Row:
    """One design in one case.

    Attributes
    ----------
    index : int
        Of the design in the study.
    place : int
        Position in the ranking, from 0.
    rank : int
        0 for a design that misses a requirement.
    unmet : tuple of str
        The requirements that it misses.
    design : Design
    title : str
        The law's name for people.
    gains : tuple of (name, value, unit)
        As text: what the study sweeps in this law, and what differs from its default.
    S : Interval [m s]
        Mean and its interval.
    reduction : Interval
        1 - mean S / mean S_uncorrected.
    left, right : Side or None
        None: the study has no such departures.
    difference : Interval [m s]
        Paired difference of mean S to the first design of the ranking.
    to_baseline : Interval or None [m s]
        The same to the baseline, where there is one.
    in_set : bool
        In the set of best.
    pareto : bool
        On the Pareto front.
    fresh : Interval or None [m s]
        Mean S on fresh scenarios, of a finalist.
    fresh_difference, fresh_to_baseline : Interval or None [m s]
        Paired differences there, to the first design of the ranking and to the baseline.
    fresh_uncorrected : float or None [m s]
        Mean S without control there, over the design's own window.
    fresh_reduction : Interval or None
        1 - mean S / mean S_uncorrected there.
    fresh_unmet : tuple of str
        Requirements that it misses there.
    optimism : Interval or None [m s]
        How much better the score was on the scenarios that designs were chosen on.
    triggered, deeper : float
        Share of departures that were taken over, and share deeper than D_y.
    solver_failed, diverged, timed_out, crashed, beyond_delta_max, invalid : int
        Departures with that status.
    failed_solves : int
        Commands that came from a law's fallback.
    """

    index: int
    place: int
    rank: int
    unmet: tuple[str, ...]
    design: Design
    title: str
    gains: tuple[tuple[str, str, str], ...]
    S: Interval
    reduction: Interval
    left: Side | None
    right: Side | None
    difference: Interval
    to_baseline: Interval | None
    in_set: bool
    pareto: bool
    fresh: Interval | None
    fresh_difference: Interval | None
    fresh_to_baseline: Interval | None
    fresh_uncorrected: float | None
    fresh_reduction: Interval | None
    fresh_unmet: tuple[str, ...]
    optimism: Interval | None
    triggered: float
    deeper: float
    solver_failed: int
    diverged: int
    timed_out: int
    crashed: int
    beyond_delta_max: int
    invalid: int
    failed_solves: int

    @property
    def failures(self) -> int:
        """Departures that did not run as designed."""
        return self.solver_failed + self.diverged + self.timed_out + self.crashed + self.invalid


def is_baseline(row: Row) -> bool:
    """Whether the design never intervenes."""
    return row.design.is_baseline
