"""Probability integral transform and Kolmogorov distance, with the limit that chance sets."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.diagnostics._marginals import ModelMarginal
from ldctoolkit.diagnostics.parts import Calibration, FloatArray

_DRAWS: Final = 1999
_MOST: Final = 2_000
"""Events of a bootstrap draw; beyond them the distance falls as 1/sqrt(n) to better than 1 %."""

LEVEL: Final = 0.95
_GRID: Final = 201


def kolmogorov_limit(effective_events: float, parameters: int, seed: int) -> float:
    """Kolmogorov distance that events drawn from the model itself exceed in one parameter of d or more in 5 % of cases.

    Parameters
    ----------
    effective_events : float
        Kish's effective number.
    parameters : int
        d; each is given 0.05/d (Bonferroni).
    seed : int
        Seed of the 1,999 bootstrap draws.

    Returns
    -------
    float

    Notes
    -----
    A parametric bootstrap: F(x) of an event from the model is uniform, so uniform numbers are drawn. The model is not
    fitted again to each draw: against events that it was fitted to, a right model stays below this limit more often
    than 95 %.

    Examples
    --------
    >>> abs(kolmogorov_limit(1000, 1, seed=0) - 1.358 / 1000**0.5) < 2e-3
    True
    """
    n = max(1, int(min(effective_events, _MOST)))
    rng = np.random.default_rng([seed, 1])
    step = np.arange(n + 1) / n
    distances = np.empty(_DRAWS)
    for i in range(_DRAWS):
        u = np.sort(rng.random(n))
        distances[i] = max(float((step[1:] - u).max()), float((u - step[:-1]).max()))
    return float(np.quantile(distances, 1.0 - (1.0 - LEVEL) / parameters)) * float(
        np.sqrt(n / max(effective_events, 1.0))
    )


def calibrate(name: str, column: FloatArray, weight: FloatArray, model: ModelMarginal, limit: float) -> Calibration:
    """Compare one parameter's events with the model's distribution function; weights sum to one."""
    order = np.argsort(column, kind="stable")
    ordered = column[order]
    u = model.cdf(ordered)
    above = np.cumsum(weight[order])
    below = above - weight[order]
    gaps = above - u, u - below  # among equal values the greatest are those of the whole step
    best = [int(np.argmax(gap)) for gap in gaps]
    which = 0 if gaps[0][best[0]] >= gaps[1][best[1]] else 1
    grid = np.linspace(0.0, 1.0, _GRID)
    reached = np.concatenate([[0.0], above])[np.searchsorted(u, grid, side="right")]
    return Calibration(
        name=name,
        u=grid,
        difference=reached - grid,
        distance=float(max(gaps[which][best[which]], 0.0)),
        limit=limit,
        position=float(ordered[best[which]]),
    )
