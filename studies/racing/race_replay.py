"""A race on the table of a study that was run in full: what it would have left out, and whom it would have kept."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from studies.racing.race import race_round
from studies.running.pieces import prefix_rows, schedule

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


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
    ((100, 200, 400), (1, 1, 1), 0.5)
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
