"""Paired differences of mean scores with intervals of Student's t, one by one."""

from __future__ import annotations

import dataclasses
import math
import statistics

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.ranking.row_blocks import row_means
from studies.ranking.standard_error import (
    degrees_of_freedom,
    error_parts,
    half_widths,
    lengths,
    spread_is_known,
    with_tails_of_t,
)

SAME = 1e-6
"""Scores [m s] that differ by less are the same."""


@dataclasses.dataclass(frozen=True)
class PairedMeans:
    """Differences of means and their intervals, (k,) [m s] each."""

    difference: FloatArray
    low: FloatArray
    high: FloatArray


def paired_means(old: FloatArray, new: FloatArray, side: IntArray, confidence: float) -> PairedMeans:
    """New minus old of k rows on the same n scenarios.

    Parameters
    ----------
    old, new : (k, n) [m s]
    side : (n,) int
        Stratum of each scenario: the two sides are drawn by themselves.
    confidence : float
        Of each interval by itself.

    Returns
    -------
    PairedMeans
        Without an interval (NaN) where some, but so few scenarios changed that even equal signs may be chance, or a
        side has one scenario only. No difference has no width.

    Examples
    --------
    >>> import numpy as np
    >>> scores = np.ones((1, 8))
    >>> found = paired_means(scores, scores + 0.5, np.repeat([1, -1], 4), 0.95)
    >>> float(found.low[0]), float(found.high[0])
    (0.5, 0.5)
    """
    change = new - old
    changed = (np.abs(change) > SAME).sum(axis=1)
    difference = row_means(change)
    z = statistics.NormalDist().inv_cdf(0.5 * (1.0 + confidence))
    critical = with_tails_of_t(z, degrees_of_freedom(side))
    half = half_widths(critical, lengths(error_parts(change, side)))
    fewest = 1.0 + math.log2(1.0 / (1.0 - confidence))
    untold = (changed > 0) & ((changed < fewest) | (not spread_is_known(side)))
    half = np.where(changed == 0, 0.0, np.where(untold, np.nan, half))
    return PairedMeans(difference, difference - half, difference + half)
