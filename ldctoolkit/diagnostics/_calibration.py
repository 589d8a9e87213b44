"""Probability integral transform and Kolmogorov distance, with the limit that chance sets."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics._marginals import ModelMarginal
from ldctoolkit.diagnostics.parts import Calibration

LEVEL: Final = 0.95
_GRID: Final = 201


def kolmogorov_limit(effective_events: float, parameters: int) -> float:
    """Kolmogorov distance that events drawn from the model itself exceed in one parameter of d or more in 5 % of cases.

    Parameters
    ----------
    effective_events : float
        Kish's effective number.
    parameters : int
        d; each is given 0.05/d (Bonferroni), so that it is 5 % or fewer whatever their dependence.

    Returns
    -------
    float

    Notes
    -----
    The exact distribution of the distance for whole numbers of events, between them a straight line. The model is not
    fitted again: against events that it was fitted to, a right model stays below this limit more often than 95 %.

    Examples
    --------
    >>> round(kolmogorov_limit(1000, 1), 4), kolmogorov_limit(149.25, 8) > kolmogorov_limit(150, 8)
    (0.0428, True)
    """
    # SciPy's distributions take long to import
    from scipy.stats import kstwo

    n = max(effective_events, 1.0)
    whole = np.floor(n)
    below, above = kstwo.isf((1.0 - LEVEL) / parameters, [whole, whole + 1.0])
    return float(below + (n - whole) * (above - below))


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
