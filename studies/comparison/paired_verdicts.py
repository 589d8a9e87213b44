"""Paired differences of mean S between two sets of runs on the same scenarios, and what can be said about them."""

from __future__ import annotations

import dataclasses
import enum
import math
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import InputError
from studies.ranking.bootstrap import bootstrap_means, check_confidence
from studies.ranking.row_blocks import row_means
from studies.ranking.simultaneous import SAME
from studies.ranking.standard_error import error_parts, lengths

_STREAM: Final = 0x636D70
"""Keeps these resamples apart from those of the rankings."""

_FLAT: Final = 1e-9
"""A row whose scenarios changed equally, up to this [m s]: what is left is rounding, and no spread."""

_ROWS: Final = 500
"""Rows resampled at once; a constant, so that no number depends on anything else."""


class Verdict(enum.StrEnum):
    """What the interval of a difference of mean S, new minus old, says."""

    BETTER = "better"
    WORSE = "worse"
    UNTOLD = "not separated"
    SAME = "same"


@dataclasses.dataclass(frozen=True)
class PairedDifferences:
    """New minus old on n shared scenarios; arrays have one entry a row, k in all."""

    # (k,) [m s] Means over the shared scenarios
    S_old: FloatArray
    S_new: FloatArray
    difference: FloatArray  # (k,) [m s] S_new - S_old
    # (k,) [m s] Its interval, simultaneous over all rows that were compared together; NaN where too few scenarios
    # changed
    low: FloatArray
    high: FloatArray
    changed: IntArray  # (k,) Scenarios that differ by more than 1e-6 m s
    largest: FloatArray  # (k,) [m s] The largest change of one scenario, with its sign; 0 where nothing changed
    largest_at: IntArray  # (k,) Position of that scenario among the shared ones
    verdict: tuple[Verdict, ...]

    def __len__(self) -> int:
        return len(self.verdict)

    def take(self, rows: range) -> PairedDifferences:
        """Some of the rows."""
        arrays = {f.name: getattr(self, f.name)[rows.start : rows.stop] for f in dataclasses.fields(self)}
        return PairedDifferences(**arrays)


def paired_differences(
    old: FloatArray, new: FloatArray, side: IntArray, *, seed: int, bootstrap: int = 2000, confidence: float = 0.95
) -> PairedDifferences:
    """Compare k rows pair by pair, all of them with one confidence.

    The intervals are those of the studentised bootstrap (Efron and Tibshirani, An Introduction to the Bootstrap,
    1993, section 12.5), symmetric, with the largest |t| over all rows in place of one row's own (max-t; Romano and
    Wolf, Econometrica 73, 2005), so that they hold for all rows together. Unequal tails would follow the few
    scenarios that changed most: where only some scenarios change, they miss too often. A row is *the same* where no
    scenario changed by more than 1e-6 m s, or its interval lies within that of 0; *better* or *worse* where the
    interval lies beyond it. Where only m scenarios changed, even equal signs come about by chance with 2^(1 - m);
    rows where that is above (1 - confidence) / k have no interval and *not separated*.
    """
    check_confidence(confidence)
    if not (np.isfinite(old).all() and np.isfinite(new).all()):
        raise InputError("S is not finite in some scenario; a mean would drop or hide it")
    k, n = new.shape
    change = new - old
    moved = np.abs(change) > SAME
    changed = moved.sum(axis=1)
    largest_at = np.abs(change).argmax(axis=1) if n else np.zeros(k, dtype=np.int64)
    largest = change[np.arange(k), largest_at]
    difference = row_means(change)
    low, high = difference.copy(), difference.copy()
    fewest = 1.0 + math.log2(max(k, 1) / (1.0 - confidence))
    too_few = (changed > 0) & (changed < fewest)
    low[too_few] = high[too_few] = np.nan
    rows = np.flatnonzero(changed >= fewest)
    if rows.size:
        half = _half_widths(change[rows], side, bootstrap, seed, confidence)
        low[rows] -= half
        high[rows] += half
    verdict = tuple(map(_verdict, changed > 0, low, high))
    largest = np.where(changed > 0, largest, 0.0)
    return PairedDifferences(
        S_old=row_means(old),
        S_new=row_means(new),
        difference=difference,
        low=low,
        high=high,
        changed=changed.astype(np.int64),
        largest=largest,
        largest_at=largest_at.astype(np.int64),
        verdict=verdict,
    )


def _verdict(any_changed: bool, low: float, high: float) -> Verdict:
    if not any_changed or (low >= -SAME and high <= SAME):
        return Verdict.SAME
    if high < -SAME:
        return Verdict.BETTER
    return Verdict.WORSE if low > SAME else Verdict.UNTOLD


def _half_widths(values: FloatArray, side: IntArray, samples: int, seed: int, confidence: float) -> FloatArray:
    """Half of each row's interval, (k,); infinite where the scenarios cannot tell."""
    strata = [side == which for which in np.unique(side)]
    if min(rows.sum() for rows in strata) < 2:
        return np.full(len(values), np.inf)  # one scenario tells nothing of its side's spread
    centred = values - row_means(values)[:, None]
    centred[np.abs(centred).max(axis=1) <= _FLAT] = 0.0
    farthest = np.zeros(samples)
    for first in range(0, len(values), _ROWS):
        block = centred[first : first + _ROWS]
        parts = [np.where(rows, block**power, 0.0) for rows in strata for power in (1, 2)]
        # one call: rows, powers and sides have to see the same resamples
        moments = bootstrap_means(np.concatenate(parts), side, samples=samples, seed=seed, stream=_STREAM)
        moments = moments.reshape(samples, len(strata), 2, len(block))
        mean, error = np.abs(moments[:, :, 0].sum(axis=1)), _errors(moments, strata)
        # a resample without any spread, off the mean, may lie any number of errors away
        t = np.divide(mean, error, out=np.where(mean > 0.0, np.inf, 0.0), where=error > 0.0)
        np.maximum(farthest, t.max(axis=1), out=farthest)
    # a value that occurred: between a finite one and an infinite one nothing can be interpolated
    critical = float(np.quantile(farthest, confidence, method="higher"))
    error = lengths(error_parts(centred, side))
    return np.multiply(critical, error, out=np.zeros_like(error), where=error > 0.0)


def _errors(moments: FloatArray, strata: list[BoolArray]) -> FloatArray:
    """Standard errors of resampled means, (b, k), from what each side adds to mean and mean square, (b, s, 2, k)."""
    share = np.array([rows.mean() for rows in strata])[:, None]
    count = np.array([rows.sum() for rows in strata])[:, None]
    mean, square = moments[:, :, 0] / share, moments[:, :, 1] / share
    variance = np.maximum(square - mean**2, 0.0)
    result: FloatArray = np.sqrt((share**2 * variance / (count - 1.0)).sum(axis=1))
    return result
