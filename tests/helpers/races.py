"""A race on a table of scores that is known in full."""

import numpy as np

from studies.racing import race_round
from studies.running.tasks import prefix_rows, schedule


def race(
    scores: np.ndarray, side: np.ndarray, *, seed: int, samples: int = 2000, confidence: float = 0.95
) -> tuple[np.ndarray, float]:
    """Which designs reach the end (d,), and the share of scenario runs that the race takes."""
    d, n = scores.shape
    designs, runs, before, rounds = np.arange(d), 0, 0, schedule(n)
    for number, m in enumerate(rounds, 1):
        runs, before = runs + designs.size * (m - before), m
        rows = prefix_rows(side, m)
        decision = race_round(
            scores[np.ix_(designs, rows)], side[rows], round=number, rounds=len(rounds), seed=seed,
            confidence=confidence, samples=samples, started=d,
        )  # fmt: skip
        designs = designs[decision.keep]
    return np.isin(np.arange(d), designs), runs / (d * n)
