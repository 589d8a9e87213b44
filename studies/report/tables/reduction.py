"""Reduction of mean S against no control, with the interval of a ratio of means."""

from __future__ import annotations

import math
import statistics

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.ranking.standard_error import spread_is_known
from studies.report.tables.row import Interval


def ratio_interval(S: FloatArray, S_0: FloatArray, side: IntArray, confidence: float = 0.95) -> Interval:
    """Reduction 1 - mean S / mean S_0 of paired scores, with its interval by linearisation.

    Parameters
    ----------
    S, S_0 : (n,) [m s]
    side : (n,) int
        The two sides are strata: how many departures go to each is part of the study, not chance.
    confidence : float
        Of the interval.

    Returns
    -------
    Interval
        Zero width where there was nothing to reduce. NaN ends where a side has one departure: its spread is not known.

    Notes
    -----
    The standard error of a ratio r of means is that of the mean of S - r S_0, divided by mean S_0 (Cochran, *Sampling
    Techniques*, 3rd ed., section 6.4).

    Examples
    --------
    >>> ratio_interval(np.array([1.0, 2.0]), np.array([2.0, 4.0]), np.array([1, 1]))
    Interval(value=0.5, low=0.5, high=0.5)
    """
    total = float(np.mean(S_0))
    if not total > 0:
        return Interval(0.0, 0.0, 0.0)
    ratio = float(np.mean(S)) / total
    if not spread_is_known(side):
        return Interval(1.0 - ratio, math.nan, math.nan)
    z = statistics.NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    error = z * standard_error(S - ratio * S_0, side) / total
    return Interval(1.0 - ratio, 1.0 - ratio - error, 1.0 - ratio + error)


def standard_error(values: FloatArray, side: IntArray) -> float:
    """Standard error of the mean, stratified by side, each of two departures or more."""
    strata = [values[side == one] for one in np.unique(side)]
    variance = sum(part.size * float(np.var(part, ddof=1)) for part in strata)
    return math.sqrt(variance) / values.size
