"""Designs in the order of a ranking, and what fresh scenarios say of the first of them."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention

from ..design import Design
from ..requirements import Estimate, Miss, Requirement
from ..results import FailedDesign, score_label
from .design_metrics import DesignMetrics, DrivableResults, mean_reduction
from .inference import SAME, Inference, Interval, Resampled, critical_value, simultaneous_interval, skewed_widths


def choose_winner(resampled: Resampled, set_of_best: BoolArray, meets: BoolArray, confidence: float) -> int | None:
    """The first finalist in the set of best that meets the requirements; of all, where none in the set does.

    Where the interval of the difference to it is below 0 for others of these, the one with the smallest mean; None
    where none meets the requirements. To take the smallest fresh score would choose by luck again, and that score
    would be too small again. The search's first was not chosen on the fresh scenarios, so its fresh score is not.
    """
    candidates = np.flatnonzero(meets & set_of_best)
    if not candidates.size:
        candidates = np.flatnonzero(meets)
    if not candidates.size:
        return None
    first = int(candidates[0])
    below = simultaneous_interval(resampled, confidence, first).high < -SAME
    better = candidates[below[candidates]]
    return int(better[np.argmin(resampled.mean[better])]) if better.size else first


_STREAM = 1  # of the resamples; the search has stream 0


@dataclasses.dataclass(frozen=True)
class FreshScores:
    """What scenarios that no design was chosen on say of the finalists, arrays of d; NaN for designs that are none.
    The baseline is scored there too. It is a finalist only where it is in the set of best.
    """

    # (d,) [m s] Mean S and its interval, for all finalists and the baseline at once
    S: FloatArray
    low: FloatArray
    high: FloatArray
    # (d,) [m s] Mean S minus that of the search's first, paired, with its interval, for all finalists at once
    difference: FloatArray
    difference_low: FloatArray
    difference_high: FloatArray
    # (d,) [m s] The same to the baseline
    baseline_difference: FloatArray
    baseline_difference_low: FloatArray
    baseline_difference_high: FloatArray
    reduction: FloatArray  # (d,) 1 - mean S / mean S of the baseline
    unmet: tuple[tuple[str, ...], ...]  # Requirements that a finalist misses on the fresh scenarios
    # (d,) [m s] How much better the search's score was than the fresh one, and its interval, for all finalists at
    # once: an interval that holds 0 is no more than two draws of scenarios explain
    optimism: FloatArray
    optimism_low: FloatArray
    optimism_high: FloatArray
    # Whether that score is the difference to the baseline (where the baseline is a law) or mean S itself
    optimism_paired: bool
    scenarios: int  # How many; 0 for none
    best: int | None  # Position of the finalist with the smallest `S`
    # Position of the design to take, see `choose_winner`; without fresh scenarios the first of the ranking. None where
    # no design is ranked, or no finalist meets the requirements on the fresh scenarios
    winner: int | None


def no_fresh_scores(d: int, ranked: int) -> FreshScores:
    """No fresh scenarios were run."""
    nothing = np.full(d, np.nan)
    three = (nothing, nothing, nothing)
    unmet: tuple[tuple[str, ...], ...] = ((),) * d
    return FreshScores(*three, *three, *three, nothing, unmet, *three, False, 0, None, 0 if ranked else None)


@dataclasses.dataclass(frozen=True)
class ReplayedScores:
    """What recorded departures say of the finalists, arrays of d; NaN for the others."""

    # (d,) [m s] Mean S with its interval
    S: FloatArray
    low: FloatArray
    high: FloatArray
    reduction: FloatArray  # (d,)
    departures: int  # How many; 0 for none


@dataclasses.dataclass(frozen=True)
class SearchScores:
    """What the search's scenarios show, d designs by position in the ranking."""

    scores: FloatArray  # (d, n) [m s] Counted S, in the study's order
    order: IntArray  # (d,) Where the designs of the ranking stand in it
    side: npt.NDArray[np.signedinteger]  # (n,)
    set_of_best: BoolArray  # (d,)
    ranked: int  # So many first designs are ranked
    baseline: int | None  # Position of the design that all are compared with
    paired: bool  # Whether the baseline is a law: a difference to it then leaves most of the draw of scenarios out


def fresh_scores(
    drivable: DrivableResults,
    positions: IntArray,
    search: SearchScores,
    unmet: Sequence[tuple[str, ...]],
    *,
    first_failed: bool = False,
    seed: int,
    samples: int,
    confidence: float,
) -> FreshScores:
    """Score the finalists."""
    d = len(search.scores)
    order = np.argsort(positions, kind="stable")
    positions, unmet = positions[order], [unmet[i] for i in order.tolist()]
    results = drivable.results
    every = Resampled.of(
        results.counted, results.scenarios.side, seed=seed, samples=samples, stream=_STREAM, rows=order
    )
    rows = np.flatnonzero(
        (positions < search.ranked)
        & (search.set_of_best[positions] | (positions != (-1 if search.baseline is None else search.baseline)))
    )
    finalists, resampled = positions[rows], every.take(rows)

    def spread(values: FloatArray, among: IntArray) -> FloatArray:
        result = np.full(d, np.nan)
        result[among] = values
        return result

    def ends(interval: Interval, among: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return spread(interval.centre, among), spread(interval.low, among), spread(interval.high, among)

    nothing = (np.full(d, np.nan),) * 3
    S = spread(every.mean, positions)
    to_first = to_baseline = optimism = nothing
    reduction = nothing[0]
    if finalists.size and (finalists[0] == 0 or first_failed):
        to_first = ends(simultaneous_interval(resampled, confidence, 0), finalists)
    there = search.baseline is not None and search.baseline in positions
    if search.baseline is not None and there and finalists.size:
        among = np.unique([*finalists, search.baseline])
        taken = every.take(np.searchsorted(positions, among))
        reference = int(np.searchsorted(among, search.baseline))
        to_baseline = ends(simultaneous_interval(taken, confidence, reference), among)
        without = np.full_like(taken.mean, taken.mean[reference])
        reduction = spread(mean_reduction(taken.mean, without), among)
    paired = search.paired and there
    if finalists.size:
        among = np.array([*finalists, *([search.baseline] if paired else [])], dtype=np.int64)
        fresh = every.take(np.searchsorted(positions, among))
        before = Resampled.of(search.scores, search.side, seed=seed, samples=samples, rows=search.order[among])
        found = lost(before, fresh, confidence, among.size - 1 if paired else None)
        optimism = ends(found, among)
        if paired:  # the baseline's own difference is 0 by definition
            for values in optimism:
                values[search.baseline] = np.nan
    winner: int | None = 0 if search.ranked else None
    if finalists.size and (finalists[0] == 0 or first_failed):
        meets = np.array([not unmet[i] for i in rows.tolist()], dtype=np.bool_)
        chosen = choose_winner(resampled, search.set_of_best[finalists], meets, confidence)
        winner = None if chosen is None else int(finalists[chosen])
    texts = dict(zip(finalists.tolist(), (unmet[i] for i in rows.tolist()), strict=True))
    return FreshScores(
        S,
        *ends(simultaneous_interval(every, confidence), positions)[1:],
        *to_first,
        *to_baseline,
        reduction,
        tuple(texts.get(i, ()) for i in range(d)),
        *optimism,
        paired,
        results.scenarios.n,
        int(finalists[np.argmin(resampled.mean)]) if finalists.size else None,
        winner,
    )


def lost(before: Resampled, after: Resampled, confidence: float, reference: int | None = None) -> Interval:
    """Means on one sample of scenarios minus those on another, independent one, simultaneous for all designs."""
    one, two = before.errors(reference), after.errors(reference)
    errors = np.hypot(one, two)
    deviations = after.deviations - before.deviations
    if reference is not None:
        deviations = deviations - deviations[:, reference : reference + 1]
    scale = np.divide(1.0, errors, out=np.zeros_like(errors), where=errors > 0)
    largest = np.abs(deviations * scale).max(axis=1, initial=0.0)
    critical = critical_value(largest, confidence, min(before.df, after.df))
    means = (
        (before.mean, after.mean)
        if reference is None
        else (before.differences(reference), after.differences(reference))
    )
    centre = means[1] - means[0]
    below, above = skewed_widths(critical, errors, after.cubes(reference) - before.cubes(reference))
    return Interval(centre, errors, centre - below, centre + above, critical)


SCORE: Final = (
    "S is the integral over time of |e_y|, the distance of the vehicle's centre from the lane's centre: less is better"
)
"""What every score means; no full stop, the window may follow."""


@dataclasses.dataclass(frozen=True, repr=False)
class RankedDesigns:
    """Designs, best first; every array has one entry a design in that order."""

    metrics: DesignMetrics  # Means, tails, reductions, shares and counts
    inference: Inference  # Intervals, and the set of best
    fresh: FreshScores  # The finalists on fresh scenarios, and the winner
    replayed: ReplayedScores  # The finalists on recorded departures
    window: Window  # Of S
    convention: Convention  # Reading of the paper
    # d designs: those that meet all requirements, smallest mean S first, equal ones in the study's order; then the
    # others in the same way
    designs: tuple[Design, ...]
    index: IntArray  # (d,) Position of each in `StudyResults.designs`
    # (d,) 1 for the best; designs with the same mean S share a rank. 0 for a design that misses a requirement: it is
    # not ranked
    rank: IntArray
    missed: tuple[tuple[Miss, ...], ...]  # For each design, the requirements that it misses, and its values
    requirements: tuple[Requirement, ...]
    # The requirements, and behind them those of the sets ``stable``, ``comfort`` and ``physical``
    limits: tuple[Requirement, ...]
    # (k, 3, d) Values of the k limited metrics, and the ends of the interval of each by itself: NaN unless it is a
    # quantile, a share or mean S, whose intervals hold for all designs at once
    limited: FloatArray
    fresh_limited: FloatArray  # (k, 3, d) The same on the fresh scenarios; NaN for designs that were not driven there
    fresh_saved: FloatArray  # (d,) 1 - mean S / mean S without control there
    baseline: int | None  # Position of the design behind `Inference.baseline_difference`
    # (d,) Ranked designs that no other ranked design beats in one metric of `pareto_metrics` without being worse in
    # another
    pareto: BoolArray
    pareto_metrics: tuple[str, ...]
    scenarios: int  # Study scenarios that could be driven under every design
    D_y: float  # [m]
    bootstrap: int  # Resamples
    confidence: float  # Of every family of intervals, and of the set of best
    warnings: tuple[str, ...]  # What a reader must know before comparing designs
    failed: tuple[FailedDesign, ...] = ()  # Designs whose law failed: they have no rank and no metrics

    def __len__(self) -> int:
        return len(self.designs)

    def __repr__(self) -> str:
        best = (
            f"best {self.designs[0].label!r}, mean S {self.metrics.S[0]:.4g} m s" if self.ranked else "none is ranked"
        )
        return f"<Ranking of {len(self)} designs, {self.label}: {best}>"

    @property
    def label(self) -> str:
        """Window of S and reading of the paper: ``"departure window, consistent"``."""
        return score_label(self.window, self.convention)

    @property
    def winner(self) -> int | None:
        """Position of the design to take, see `FreshScores`."""
        return self.fresh.winner

    @property
    def ranked(self) -> int:
        """Number of designs that have a rank; they are the first ones."""
        return int((self.rank > 0).sum())

    @property
    def require(self) -> tuple[str, ...]:
        """The requirements as text."""
        return tuple(one.text for one in self.requirements)

    @property
    def unmet(self) -> tuple[tuple[str, ...], ...]:
        """For each design, the requirements that it misses, as text."""
        return tuple(tuple(miss.requirement.text for miss in some) for some in self.missed)

    def sample(self, i: int) -> str:
        """The scenarios that a design is judged on: fresh ones where it was driven on such."""
        fresh = bool(np.isfinite(self.fresh.S[i]))
        return f"{self.fresh.scenarios:,} fresh scenarios" if fresh else f"the {self.scenarios:,} study scenarios"

    def saved(self, i: int) -> float:
        """1 - mean S / mean S without control there."""
        return float((self.fresh_saved if np.isfinite(self.fresh.S[i]) else self.metrics.reduction)[i])

    def estimates(self, i: int) -> tuple[Estimate, ...]:
        """The limited metrics of a design there."""
        fresh = bool(np.isfinite(self.fresh.S[i]))
        numbers = (self.fresh_limited if fresh else self.limited)[:, :, i].tolist()
        return tuple(
            Estimate(one, value, low, high, one in self.requirements, fresh)
            for one, (value, low, high) in zip(self.limits, numbers, strict=True)
        )

    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of every law, best law first."""
        return best_of_laws(self.designs)


def best_of_laws(designs: Sequence[Design]) -> tuple[int, ...]:
    """Positions of the first design of every law."""
    first: dict[str, int] = {}
    for i, design in enumerate(designs):
        first.setdefault(design.law, i)
    return tuple(first.values())
