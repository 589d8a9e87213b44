"""Designs in the order of a ranking, and what fresh scenarios say of the first of them."""

import dataclasses
from collections.abc import Sequence
from typing import Final, Self

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.metrics import METRICS, USER_GROUP, Metric
from ldctoolkit.simulation import Window
from ldctoolkit.vehicle import Convention

from ..design import Design
from ..design_space import Dimension
from ..requirements import Estimate, Miss, Requirement, metric, metric_values
from ..results import FailedDesign, RefitScores, StudyResults, score_label
from .design_metrics import DesignMetrics, mean_reduction
from .inference import (
    SAME,
    Differences,
    Inference,
    Interval,
    Resampled,
    critical_value,
    simultaneous_interval,
    skewed_widths,
)


def choose_winner(resampled: Resampled, set_of_best: BoolArray, meets: BoolArray, confidence: float) -> int | None:
    """The first finalist in the set of best that meets the requirements, or of all finalists if none in the set does.

    If the interval of the difference to it is below 0 for other candidates, the candidate with the smallest mean among
    these. None if no finalist meets the requirements. The smallest fresh score would again be a choice by luck, and too
    small. The search's first design was not chosen on the fresh scenarios, so its fresh score is not too small.
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


_STREAM = 1  # of the resamples; the search uses stream 0


@dataclasses.dataclass(frozen=True)
class FreshScores(Differences):
    """Scores of the finalists on scenarios that no design was chosen on, arrays of d; NaN for other designs.
    The reference is the search's first. The baseline is scored there too. It is a finalist only where it is in the set
    of best.
    """

    # (d,) [m s] Mean S and its interval, for all finalists and the baseline at once
    S: FloatArray
    low: FloatArray
    high: FloatArray
    reduction: FloatArray  # (d,) 1 - mean S / mean S of the baseline
    unmet: tuple[tuple[str, ...], ...]  # Requirements that a finalist misses on the fresh scenarios
    # (d,) [m s] How much better the search's score was than the fresh one, and its interval, for all finalists at
    # once: an interval that contains 0 is explained by the two draws of scenarios
    optimism: FloatArray
    optimism_low: FloatArray
    optimism_high: FloatArray
    # Whether that score is the difference to the baseline (where the baseline is a law) or mean S itself
    optimism_paired: bool
    scenarios: int  # Number of fresh scenarios; 0 without any
    best: int | None  # Position of the finalist with the smallest `S`
    # Position of the design to take, see `choose_winner`; without fresh scenarios the first of the ranking. None where
    # no design is ranked, or no finalist meets the requirements on the fresh scenarios
    winner: int | None


def no_fresh_scores(d: int, ranked: int) -> FreshScores:
    """`FreshScores` of a study without fresh scenarios."""
    undefined = np.full(d, np.nan)
    unknown = (undefined, undefined, undefined)
    unmet: tuple[tuple[str, ...], ...] = ((),) * d
    return FreshScores(*unknown, *unknown, *unknown, undefined, unmet, *unknown, False, 0, None, 0 if ranked else None)


@dataclasses.dataclass(frozen=True)
class ReplayedScores:
    """Scores of the finalists on recorded departures, arrays of d; NaN for other designs."""

    # (d,) [m s] Mean S with its interval
    S: FloatArray
    low: FloatArray
    high: FloatArray
    reduction: FloatArray  # (d,)
    departures: int  # Number of recorded departures; 0 without any


@dataclasses.dataclass(frozen=True)
class RecordingScores:
    """Intervals of what the recordings leave open, arrays of d: of the winner, NaN for other designs."""

    text: str  # Origin of the recorded departures, or why there are no intervals; empty if no refits were requested
    refits: int  # Number of refits behind them
    failed: int  # Refits that failed
    # (d,) [m s] Of mean S, and of its difference to the baseline
    low: FloatArray
    high: FloatArray
    baseline_difference_low: FloatArray
    baseline_difference_high: FloatArray
    reduction_low: FloatArray
    reduction_high: FloatArray

    @classmethod
    def of(
        cls, refits: RefitScores | None, ids: Sequence[str], centres: FloatArray, winner: int | None,
        baseline: int | None, confidence: float,
    ) -> Self:  # fmt: skip
        """About the centres (3, d): mean S, its difference to the baseline, and the reduction."""
        ends = np.full((3, 2, len(ids)), np.nan)
        if refits is None:
            return cls("", 0, 0, *ends.reshape(6, -1))
        text, named = refits.text, [ids[i] for i in dict.fromkeys((winner, baseline)) if i is not None]
        if winner is not None and len(refits.S):
            if set(named) <= set(refits.designs):
                S, other = (refits.S[:, refits.designs.index(name)] for name in (named[0], named[-1]))
                values = (S, S - other if len(named) > 1 else np.full_like(S, np.nan), 1.0 - S / refits.S[:, -1])
                half = [refits.half_width(value, confidence) for value in values]
                ends[:, :, winner] = centres[:, winner, None] + np.outer(half, (-1.0, 1.0))
                ends[0], ends[2] = np.maximum(ends[0], 0.0), np.minimum(ends[2], 1.0)
            else:
                text = "not known for this winner: run the study with these settings"
        return cls(text, len(refits.S), refits.failed, *ends.reshape(6, -1))


@dataclasses.dataclass(frozen=True)
class Criterion:
    """What designs are ranked by where it is not S: means over all departures with simultaneous intervals, (d,) each.

    `Inference` and `FreshScores` then hold its differences in place of those of S, above 0 where a design is worse, and
    the optimism; their S, its intervals and reductions are those of S.
    """

    metric: Metric
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    # On the fresh scenarios; NaN for designs that were not driven there
    fresh: FloatArray
    fresh_low: FloatArray
    fresh_high: FloatArray


def fresh_scores(
    results: StudyResults,
    values: FloatArray,
    positions: IntArray,
    study_scores: Resampled,
    inference: Inference,
    unmet: Sequence[tuple[str, ...]],
    *,
    ranked: int,
    baseline: int | None,
    paired: bool,
    first_failed: bool,
    seed: int,
    samples: int,
    confidence: float,
) -> FreshScores:
    """Score the finalists on fresh scenarios, whose drivable ones the results hold, by values (d, n) such as S.

    `positions` are those of the finalists in the ranking, whose first `ranked` designs are ranked; `study_scores` and
    `inference` are those of its d designs on the study scenarios. `paired` says whether the baseline is a law: a
    difference to it cancels most of the effect of the draw.
    """
    d = study_scores.mean.size
    order = np.argsort(positions, kind="stable")
    positions, unmet = positions[order], [unmet[i] for i in order.tolist()]
    scored = Resampled.of(values, results.scenarios.side, seed=seed, samples=samples, stream=_STREAM, rows=order)
    rows = np.flatnonzero(
        (positions < ranked)
        & (inference.set_of_best[positions] | (positions != (-1 if baseline is None else baseline)))
    )
    finalists, resampled = positions[rows], scored.take(rows)

    def spread(values: FloatArray, among: IntArray) -> FloatArray:
        result = np.full(d, np.nan)
        result[among] = values
        return result

    def ends(interval: Interval, among: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return spread(interval.centre, among), spread(interval.low, among), spread(interval.high, among)

    undefined = (np.full(d, np.nan),) * 3
    S = spread(scored.mean, positions)
    to_first = to_baseline = optimism = undefined
    reduction = undefined[0]
    if finalists.size and (finalists[0] == 0 or first_failed):
        to_first = ends(simultaneous_interval(resampled, confidence, 0), finalists)
    baseline_is_scored = baseline is not None and baseline in positions
    if baseline is not None and baseline_is_scored and finalists.size:
        among = np.unique([*finalists, baseline])
        compared = scored.take(np.searchsorted(positions, among))
        reference = int(np.searchsorted(among, baseline))
        to_baseline = ends(simultaneous_interval(compared, confidence, reference), among)
        without = np.full_like(compared.mean, compared.mean[reference])
        reduction = spread(mean_reduction(compared.mean, without), among)
    paired = paired and baseline_is_scored
    if finalists.size:
        among = np.array([*finalists, *([baseline] if paired else [])], dtype=np.int64)
        fresh = scored.take(np.searchsorted(positions, among))
        interval = lost(study_scores.take(among), fresh, confidence, among.size - 1 if paired else None)
        optimism = ends(interval, among)
        if paired:  # the baseline's own difference is 0 by definition
            for values in optimism:
                values[baseline] = np.nan
    winner: int | None = 0 if ranked else None
    if finalists.size and (finalists[0] == 0 or first_failed):
        meets = np.array([not unmet[i] for i in rows.tolist()], dtype=np.bool_)
        winning_row = choose_winner(resampled, inference.set_of_best[finalists], meets, confidence)
        winner = None if winning_row is None else int(finalists[winning_row])
    texts = dict(zip(finalists.tolist(), (unmet[i] for i in rows.tolist()), strict=True))
    return FreshScores(
        *to_first,
        *to_baseline,
        S,
        *ends(simultaneous_interval(scored, confidence), positions)[1:],
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
    errors_before, errors_after = before.errors(reference), after.errors(reference)
    errors = np.hypot(errors_before, errors_after)
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
"""Meaning of every score, without a full stop because the window may follow."""


@dataclasses.dataclass(frozen=True, repr=False)
class RankedDesigns:
    """Designs, best first; every array has an entry for each design in this order."""

    metrics: DesignMetrics  # Means, tails, reductions, shares and counts
    inference: Inference  # Intervals, and the set of best
    fresh: FreshScores  # The finalists on fresh scenarios, and the winner
    replayed: ReplayedScores  # The finalists on recorded departures
    recordings: RecordingScores  # What the recordings behind the model leave open of the winner
    window: Window  # Of S
    convention: Convention  # Reading of the paper
    # d designs: those that meet all requirements, smallest mean S first (or what is ranked by), equal designs in the
    # study's order; then the other designs in the same way
    designs: tuple[Design, ...]
    index: IntArray  # (d,) Position of each in `StudyResults.designs`
    # (d,) 1 for the best; designs with the same mean S share a rank. 0 for a design that misses a requirement: it is
    # not ranked
    rank: IntArray
    missed: tuple[tuple[Miss, ...], ...]  # For each design, the requirements that it misses, and its values
    requirements: tuple[Requirement, ...]
    # The requirements, followed by those of the sets ``stable``, ``comfort``, ``physical`` and ``acceptable``
    limits: tuple[Requirement, ...]
    # (k, 3, d) Values of the k limited metrics and the ends of their intervals: pointwise for quantiles and shares, for
    # all designs at once for mean S, NaN for other metrics
    limited: FloatArray
    fresh_limited: FloatArray  # (k, 3, d) The same on the fresh scenarios; NaN for designs that were not driven there
    fresh_saved: FloatArray  # (d,) 1 - mean S / mean S without control on the fresh scenarios
    fresh_needless: FloatArray  # (d,) Share of departures with a needless intervention on the fresh scenarios
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
    criterion: Criterion | None = None  # What designs are ranked by; None for S
    ranges: tuple[tuple[str, str, Dimension], ...] = ()  # Of samples and searches: law, gain or threshold, its values

    def __len__(self) -> int:
        return len(self.designs)

    @property
    def ranked_by(self) -> Metric:
        """The row of what designs are ranked by."""
        return METRICS["S"] if self.criterion is None else self.criterion.metric

    def scale_and_unit(self, of_S: str = "m s") -> tuple[float, str]:
        """Factor and unit that differences to other designs are shown in; `of_S` where designs are ranked by it."""
        return (1.0, of_S) if self.criterion is None else (self.ranked_by.scale, self.ranked_by.shown_unit)

    def apart(self, value: float, low: float, high: float, form: str = ".4f") -> str:
        """A difference to another design with its interval."""
        scale, unit = self.scale_and_unit()
        shown, *ends = (f"{scale * x:{form}}" for x in (value, low, high))
        return f"{shown} {unit} ({' .. '.join(ends)})"

    def criterion_text(self, i: int) -> str:
        """What a design is ranked by, on the scenarios of `sample`, as a sentence; empty for S."""
        if (of := self.criterion) is None:
            return ""
        fresh, digits = bool(np.isfinite(of.fresh[i])), of.metric.digits
        columns = (of.fresh, of.fresh_low, of.fresh_high) if fresh else (of.mean, of.low, of.high)
        value, low, high = (f"{of.metric.scale * column[i]:.{digits}f}" for column in columns)
        between = "" if not np.isfinite(columns[1][i]) else f" ({100 * self.confidence:g} % interval {low} to {high})"
        unit = f" {of.metric.shown_unit}".rstrip()
        return f"{of.metric.title}: {value}{unit} on {self.sample(i)}{between}. "

    @property
    def user_columns(self) -> dict[str, Metric]:
        """Metrics of the designer's that a table shows: what is ranked by, what is required, else the mean of each."""
        rows = [row for row in map(metric, self.metrics.beside) if row.group == USER_GROUP]
        named = [self.ranked_by, *(requirement.metric for requirement in self.requirements)]
        asked = [row for row in named if row.group == USER_GROUP]
        others = [row for row in rows if row.aggregate == "mean" and row.of not in [other.of for other in asked]]
        return {row.name: row for row in (*asked, *others)}

    @property
    def costs(self) -> tuple[FloatArray, FloatArray]:
        """What is to be small, (d,), on the study scenarios and on the fresh ones."""
        if (of := self.criterion) is None:
            return self.metrics.S, self.fresh.S
        sign = -1.0 if of.metric.better == "more" else 1.0
        return sign * of.mean, sign * of.fresh

    def __repr__(self) -> str:
        best = (
            f"best {self.designs[0].label!r}, mean S {self.metrics.S[0]:.4g} m s" if self.ranked else "none is ranked"
        )
        return f"<Ranking of {len(self)} designs, {self.label}: {best}>"

    @property
    def label(self) -> str:
        """Window of S and reading of the paper: ``"departure window, signs consistent"``."""
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
        return tuple(requirement.text for requirement in self.requirements)

    @property
    def unmet(self) -> tuple[tuple[str, ...], ...]:
        """For each design, the requirements that it misses, as text."""
        return tuple(tuple(miss.requirement.text for miss in misses) for misses in self.missed)

    def sample(self, i: int) -> str:
        """The scenarios that a design is judged on: the fresh ones if it was driven on them."""
        fresh = bool(np.isfinite(self.fresh.S[i]))
        return f"{self.fresh.scenarios:,} fresh scenarios" if fresh else f"the {self.scenarios:,} study scenarios"

    def saved(self, i: int) -> float:
        """1 - mean S / mean S without control on the scenarios of `sample`."""
        return float((self.fresh_saved if np.isfinite(self.fresh.S[i]) else self.metrics.reduction)[i])

    def needless(self, i: int) -> float:
        """Share of departures with a needless intervention, of the scenarios of `sample`."""
        fresh = bool(np.isfinite(self.fresh.S[i]))
        return float((self.fresh_needless if fresh else metric_values("needless", self.metrics))[i])

    def estimates(self, i: int) -> tuple[Estimate, ...]:
        """The limited metrics of a design on the scenarios of `sample`."""
        fresh = bool(np.isfinite(self.fresh.S[i]))
        numbers = (self.fresh_limited if fresh else self.limited)[:, :, i].tolist()
        return tuple(
            Estimate(requirement, value, low, high, requirement in self.requirements, fresh)
            for requirement, (value, low, high) in zip(self.limits, numbers, strict=True)
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
