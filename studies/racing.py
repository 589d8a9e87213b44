"""Racing: which designs need no further scenarios, because the best of them is separable from those already."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray

from .design import Design
from .measures import measured
from .ranking.design_metrics import find_baseline
from .ranking.inference import SAME, row_means, separable
from .ranking.ranking import Ranking
from .requirements import metric_values, requirements_of
from .results import Dropped, Race, StudyResults
from .running.campaign import Campaign
from .storage.manifest import write_race
from .storage.store import Store
from .study_file import Study


def run_race(campaign: Campaign) -> tuple[Sequence[Design], Race]:
    """Run the race of a study; the designs that are left, and how it went."""
    study, store, rounds = campaign.study, campaign.store, campaign.prefixes.stops
    alive, dropped, counts, runs = list(study.designs), [], [], 0
    failed: list[Design] = []  # not run again in every round
    before = 0
    for i, size in enumerate(rounds, start=1):
        campaign.complete(alive, size, f"round {i} of {len(rounds)}, {len(alive)} designs")
        runs += len(alive) * (size - before)
        before = size
        results = campaign.table.results(
            campaign.scenarios,
            {},
            store.failures,
            source=str(store.folder),
            designs=alive,
            rows=campaign.prefixes.rows(size),
        )
        drivable = results.drivable
        counted = results.counted[:, drivable]
        raced = _raced(study, store, results, counted.mean(axis=1))
        decision = race_round(
            counted[raced],
            results.scenarios.side[drivable],
            round=i,
            rounds=len(rounds),
            seed=study.seed,
            confidence=study.ranking.confidence,
            samples=study.ranking.bootstrap,
            started=len(study.designs),
        )
        reference = find_baseline(study.ranking.baseline, results)
        for k, place in enumerate(raced.tolist()):
            # the baseline is in no race: all others are compared with it at the end
            if not decision.keep[k] and place != reference:
                numbers = (float(values[k]) for values in (decision.mean, decision.difference, decision.low))
                dropped.append(Dropped(results.designs[place], i, size, *numbers))
        failed += [one.design for one in results.failed]
        gone = {design.id for design in (*(one.design for one in dropped), *failed)}
        alive = [design for design in alive if design.id not in gone]
        counts.append(len(alive))
    race = Race(rounds, tuple(counts), tuple(dropped), runs, len(study.designs) * len(campaign.scenarios))
    write_race(store.folder, race, study.ranked_as)
    left = {design.id for design in (*alive, *failed)}
    return [design for design in study.designs if design.id in left], race


_SPARE = 0.1  # part of every limit that the design compared with keeps in reserve: more scenarios may cost it


def _raced(study: Study, store: Store, results: StudyResults, mean: FloatArray) -> IntArray:
    """Designs that a round may give up: those no better than the best one that clearly meets the requirements.

    A better one that misses a requirement now may meet it on more scenarios; one that is worse can only lose. Without
    requirements these are all; where none meets them, it is none but the best by S.
    """
    if not study.ranking.require:
        return np.arange(len(mean))
    results = measured(results, store.measures, study.setup(), study.vehicles, study.standards)
    asked: dict[str, Any] = {"setup": study.setup(), "vehicles": study.vehicles, "standards": study.standards}
    ranking = Ranking.of(results, bootstrap=100, D_y=study.report.D_y, **asked)
    worst = np.full(len(mean), -np.inf)
    for one in requirements_of(study.ranking.require, study.plant):
        excess = one.excess(metric_values(one.metric.name, ranking))
        # a count of none, and a margin or a score that no more scenarios change, have nothing to spare
        fixed = one.metric.group == "loop" or one.metric.name in study.standards
        spare = 0.0 if not one.limit or fixed else _SPARE
        worst[ranking.index] = np.maximum(worst[ranking.index], np.where(np.isneginf(excess), -1.0, excess) + spare)
    acting = np.array([not design.is_baseline for design in results.designs])
    clear = np.flatnonzero((worst <= 0.0) & acting)
    best = mean.argmin() if not clear.size else clear[mean[clear].argmin()]
    return np.flatnonzero(mean >= mean[best]) if clear.size else np.array([best])


LEAST: Final = 50  # a round with fewer scenarios that could be driven gives up nothing
LEAST_A_SIDE: Final = 10  # nor does one with fewer than this of a side that it has scenarios of

_LEADERS = 16
"""Designs that each one is compared with: one much like it, but better, shows soonest that it is not the best."""


@dataclasses.dataclass(frozen=True)
class Decision:
    """What one round of a race decides about k designs."""

    keep: BoolArray  # (k,) Designs that go on; the best always does
    best: int  # The design with the smallest mean; the first of several
    mean: FloatArray  # (k,) [m s] Mean S on the scenarios of the round
    difference: FloatArray  # (k,) [m s] The same minus that of the best
    # (k,) [m s] Lower bound of how much worse the design is than the best one in truth, simultaneous over designs and
    # rounds: it is given up where that is above 1e-6 m s. Minus infinity where nothing can be stated
    low: FloatArray


def race_round(
    scores: FloatArray,
    side: IntArray,
    *,
    round: int,
    rounds: int,
    seed: int,
    confidence: float,
    samples: int,
    started: int,
) -> Decision:
    """Decide which designs go on after a round, by their scores (k, m) on m scenarios; `started` ones began the race.

    The error 1 - confidence is shared out evenly over the rounds - 1 that decide. In each, a design is given up if
    two lower bounds of how much worse it is than the best are both above 1e-6 m s. One is the max-t bootstrap bound
    of `simultaneous.separable`. The other is made for few scenarios and tails far out: the largest of Student's t
    bounds of the paired differences to each of the 16 leading designs, at the error's share of one pair of designs,
    less what scenarios that were not met yet may do. For that: departures of a kind that m scenarios do not hold
    have, with probability 1 - error, a share of at most log(1 / error) / m. Each is taken to speak for the design
    with L, the largest difference that any design shows to the best one, so that a leader is not trusted for the
    luck of having met none of the failures that others met. Scores above the worst one of the design compared with
    are counted as that worst one, in favour of the designs that have them: else a design which diverges now and
    then would be kept for the large spread that this makes.
    """
    k, m = scores.shape
    mean = row_means(scores) if m else np.full(k, np.nan)
    best = int(mean.argmin())
    difference = row_means(scores - scores[best]) if m else mean
    low = np.full(k, -np.inf)
    few = m < LEAST or np.unique(side, return_counts=True)[1].min() < LEAST_A_SIDE
    if not few and k > 1 and round < rounds:
        error = (1.0 - confidence) / (rounds - 1)
        counted = _without_outliers(scores, best)
        bound = separable(counted, side, seed=seed, confidence=1.0 - error, samples=samples, stream=round)
        low = np.minimum(bound.low, _cautious_low(scores, mean, error=error, pairs=started - 1))
        low[best] = -np.inf
    return Decision(keep=~(low > SAME), best=best, mean=mean, difference=difference, low=low)


def _without_outliers(scores: FloatArray, best: int) -> FloatArray:
    """Scores no larger than the best design's worst one, (k, m), unless another design is the best of these."""
    counted = _capped(scores, best)
    # one that owes its mean to a few bad scenarios only may be better but for them: then all counts as it is
    return counted if int(row_means(counted).argmin()) == best else scores


def _capped(scores: FloatArray, reference: int) -> FloatArray:
    capped: FloatArray = np.minimum(scores, scores[reference].max())
    return capped


def _cautious_low(scores: FloatArray, mean: FloatArray, *, error: float, pairs: int) -> FloatArray:
    """How much worse each design is than some other at least, (k,): Student's t, less what was not met yet."""
    from scipy.special import stdtrit

    k, m = scores.shape
    # any choice of references is allowed, for all pairs share the error: those in front say most
    leaders = np.argsort(mean, kind="stable")[:_LEADERS]
    quantile = float(stdtrit(m - 1, error / pairs))
    low: FloatArray = np.full(k, -np.inf)
    for leader in leaders:
        difference = np.ascontiguousarray(_capped(scores, leader) - scores[leader])
        spread = difference.std(axis=1, ddof=1) / math.sqrt(m)
        np.maximum(low, row_means(difference) + quantile * spread, out=low)
    largest = float(np.abs(_capped(scores, leaders[0]) - scores[leaders[0]]).max())
    low -= min(1.0, -math.log(error) / m) * largest
    return low
