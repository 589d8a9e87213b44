"""Racing: which designs need no further scenarios, because the best of them is separable from those already."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from studies.bootstrap import row_means
from studies.simultaneous import SAME, separable

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

FIRST_ROUND: Final = 100
"""Scenarios of the first round: with fewer, tails as far out as many designs need are guesswork."""

LEAST: Final = 50
"""A round with fewer scenarios that could be driven gives up nothing."""

LEAST_A_SIDE: Final = 10
"""Nor does one with fewer than this of a side that it has scenarios of."""

_WORTH_A_ROUND = 1.5
"""A round is held where it leaves out a third of all scenarios or more; a later one would save little."""


@dataclasses.dataclass(frozen=True)
class Decision:
    """What one round of a race decides about k designs.

    Attributes
    ----------
    keep : (k,) bool
        Designs that go on; the best always does.
    best : int
        The design with the smallest mean; the first of several.
    mean : (k,) [m s]
        Mean S on the scenarios of the round.
    difference : (k,) [m s]
        The same minus that of the best.
    low : (k,) [m s]
        Lower end of the difference, simultaneous over designs and rounds: a design is given up where it is above
        1e-6 m s. Minus infinity where the round has too few scenarios to say anything.
    """

    keep: BoolArray
    best: int
    mean: FloatArray
    difference: FloatArray
    low: FloatArray


@dataclasses.dataclass(frozen=True)
class Replay:
    """What a race would have done in a study that was run in full.

    Attributes
    ----------
    rounds : tuple of int
        Scenarios after each round.
    alive : tuple of int
        Designs left after each round.
    kept : (d,) bool
        Designs that reach the end.
    runs, full_runs : int
        Scenario runs with and without the race.
    """

    rounds: tuple[int, ...]
    alive: tuple[int, ...]
    kept: BoolArray
    runs: int
    full_runs: int

    @property
    def share(self) -> float:
        """Scenario runs of the race over those of the full study."""
        return self.runs / self.full_runs


def schedule(n: int) -> tuple[int, ...]:
    """Number of scenarios after each round of a race over n: 100, then twice as many every time, and all at the end.

    Parameters
    ----------
    n : int
        Scenarios of the study.

    Returns
    -------
    tuple of int
        Rising, the last one n; n alone where there are too few for a race.

    Raises
    ------
    InputError
        If n is not a positive whole number.

    Examples
    --------
    >>> schedule(2000)
    (100, 200, 400, 800, 2000)
    >>> schedule(120)
    (120,)
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise InputError(f"n: {n!r}; allowed: a whole number >= 1")
    sizes, size = [], FIRST_ROUND
    while size * _WORTH_A_ROUND <= n:
        sizes.append(size)
        size *= 2
    return (*sizes, int(n))


def prefix_rows(side: IntArray, m: int) -> IntArray:
    """The scenarios of a round: the first ones of each side, as many as is its share.

    Parameters
    ----------
    side : (n,) int
        Of all scenarios.
    m : int
        How many scenarios, 1 to n.

    Returns
    -------
    (m,) int
        Rising positions; those of a smaller m are among them.

    Raises
    ------
    InputError
        If m is outside 1 to n.

    Examples
    --------
    >>> import numpy as np
    >>> prefix_rows(np.array([1, 1, 1, 1, -1, -1]), 3)
    array([0, 1, 4])
    """
    side = np.asarray(side)
    if not 1 <= m <= side.size:
        raise InputError(f"m: {m!r}; allowed: 1 to {side.size}, the number of scenarios")
    which, counts = np.unique(side, return_counts=True)
    # cumulative shares, rounded: each count rises with m, and together they make m
    ends = np.floor(np.cumsum(counts) * m / side.size + 0.5).astype(np.int64)
    taken = np.diff(ends, prepend=0)
    rows = [np.flatnonzero(side == one)[:count] for one, count in zip(which, taken, strict=True)]
    return np.sort(np.concatenate(rows))


def race_round(
    scores: FloatArray,
    side: IntArray,
    *,
    round: int,
    rounds: int,
    seed: int,
    confidence: float,
    samples: int,
    started: int | None = None,
) -> Decision:
    """Decide which designs go on after a round.

    Parameters
    ----------
    scores : (k, m) [m s]
        S as it counts of the designs still in the race, failures penalised, on all scenarios up to this round, in the
        study's primary case. A scenario with NaN under some design is left out for all.
    side : (m,) int
        Of the scenarios.
    round : int
        From 1 on.
    rounds : int
        Of the whole race. The last one gives up nothing: there is nothing left to save, and the ranking says more.
    seed : int
        Of the bootstrap.
    confidence : float
        That the best design is given up in no round.
    samples : int
        Resamples of the bootstrap.
    started : int, optional
        Designs at the start of the race; k by default. Designs that were given up before still count in how certain
        the others have to be.

    Returns
    -------
    Decision

    Raises
    ------
    InputError
        For arrays that do not belong together, scores that are infinite, or settings outside what is allowed.

    Notes
    -----
    The error 1 - confidence is shared out evenly over the rounds - 1 that decide. In each, a design is given up if two
    lower bounds of its difference to the best are both above 1e-6 m s. One is the max-t bootstrap bound of
    `studies.simultaneous.separable`. The other is made for few scenarios and tails far out: Student's t at the error's
    share of one pair, less what scenarios may do that were not met yet. With probability 1 - delta all departures
    whose difference is larger than the largest met, L, are together less frequent than log(1/delta)/m; they are
    taken to speak for the design with L each.

    Scores above the worst one of the best design are counted as that worst one, in favour of the designs that have
    them, so that a design which diverges now and then is not kept for the large spread that this makes.

    Examples
    --------
    >>> import numpy as np
    >>> common = np.random.default_rng(0).gamma(2.0, 1.0, 100)
    >>> side = np.repeat([1, -1], 50)
    >>> scores = np.stack([common, common, 1.5 * common + 0.5])
    >>> race_round(scores, side, round=1, rounds=3, seed=0, confidence=0.95, samples=500).keep
    array([ True,  True, False])
    """
    scores, side, decisions = _checked(scores, side, round, rounds, confidence)
    if started is None:
        started = len(scores)
    elif isinstance(started, bool) or not isinstance(started, int | np.integer) or started < len(scores):
        raise InputError(f"started: {started!r}; allowed: a whole number >= {len(scores)}, the designs left")
    known = ~np.isnan(scores).any(axis=0)
    if not known.all():
        scores, side = scores[:, known], side[known]
    k, m = scores.shape
    mean = row_means(scores) if m else np.full(k, np.nan)
    best = int(mean.argmin())
    difference = row_means(scores - scores[best]) if m else mean
    low = np.full(k, -np.inf)
    few = m < LEAST or np.unique(side, return_counts=True)[1].min() < LEAST_A_SIDE
    if not few and k > 1 and round < rounds:
        counted = _capped(scores, best)
        error = (1.0 - confidence) / decisions
        bound = separable(counted, side, seed=seed, confidence=1.0 - error, samples=samples, stream=round)
        low = np.minimum(bound.low, _cautious_low(counted - counted[best], error / max(1, started - 1)))
        low[best] = -np.inf
    return Decision(keep=~(low > SAME), best=best, mean=mean, difference=difference, low=low)


def replay(scores: FloatArray, side: IntArray, *, seed: int, confidence: float = 0.95, samples: int = 2000) -> Replay:
    """Race on a finished study's table: what would have been left out, and who would have been kept?

    Parameters
    ----------
    scores : (d, n) [m s]
        S as it counts of all designs on all scenarios.
    side : (n,) int
        Of the scenarios.
    seed, confidence, samples
        As in `race_round`.

    Returns
    -------
    Replay

    Raises
    ------
    InputError
        As in `race_round`.

    Examples
    --------
    >>> import numpy as np
    >>> common = np.random.default_rng(0).gamma(2.0, 1.0, 400)
    >>> scores = np.outer([1.0, 1.5, 2.0], common)
    >>> raced = replay(scores, np.repeat([1, -1], 200), seed=0, samples=500)
    >>> raced.kept
    array([ True, False, False])
    >>> raced.rounds, raced.alive, raced.share
    ((100, 200, 400), (2, 1, 1), 0.5833333333333334)
    """
    d, n = scores.shape
    rounds = schedule(n)
    designs, runs, before, alive = np.arange(d), 0, 0, []
    for number, m in enumerate(rounds, 1):
        runs += designs.size * (m - before)
        rows = prefix_rows(side, m)
        decision = race_round(
            scores[np.ix_(designs, rows)],
            side[rows],
            round=number,
            rounds=len(rounds),
            seed=seed,
            confidence=confidence,
            samples=samples,
            started=d,
        )
        designs, before = designs[decision.keep], m
        alive.append(int(designs.size))
    return Replay(rounds, tuple(alive), np.isin(np.arange(d), designs), runs, d * n)


def _checked(
    scores: FloatArray, side: IntArray, round: int, rounds: int, confidence: float
) -> tuple[FloatArray, IntArray, int]:
    """Scores and sides as arrays, and the number of rounds that decide."""
    scores, side = np.asarray(scores, dtype=np.float64), np.asarray(side)
    if scores.ndim != 2 or not len(scores) or side.shape != scores.shape[1:]:
        raise InputError(f"scores: shape {scores.shape} with sides {side.shape}; allowed: (k, m) with (m,), k >= 1")
    if np.isinf(scores).any():
        raise InputError("scores: infinite in some scenario; allowed: finite numbers, and NaN for one not driven")
    if not 1 <= round <= rounds:
        raise InputError(f"round: {round!r}; allowed: 1 to {rounds}, the number of rounds")
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence: {confidence!r}; allowed: between 0 and 1")
    return scores, side, max(1, rounds - 1)


def _capped(scores: FloatArray, best: int) -> FloatArray:
    """Scores no larger than the best design's worst one, (k, m), unless another design is the best of these."""
    capped: FloatArray = np.minimum(scores, scores[best].max())
    # one that owes its mean to a few bad scenarios only may be better but for them: nothing can be said against it
    return capped if int(row_means(capped).argmin()) == best else scores


def _cautious_low(difference: FloatArray, error: float) -> FloatArray:
    """Lower bounds, (k,), of mean differences (k, m): Student's t, less what rare scenarios not met may do."""
    from scipy.special import stdtrit

    m = difference.shape[1]
    spread = np.ascontiguousarray(difference).std(axis=1, ddof=1) / math.sqrt(m)
    unseen = min(1.0, -math.log(error) / m) * np.abs(difference).max(axis=1)
    low: FloatArray = row_means(difference) + stdtrit(m - 1, error) * spread - unseen
    return low


__all__ = [
    "FIRST_ROUND",
    "LEAST",
    "LEAST_A_SIDE",
    "Decision",
    "Replay",
    "prefix_rows",
    "race_round",
    "replay",
    "schedule",
]
