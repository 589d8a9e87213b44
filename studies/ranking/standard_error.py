"""Standard errors of means over scenarios that are drawn within each side."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from studies.ranking.row_blocks import row_means

_BLOCK_ENTRIES = 64_000
"""Differences held at once; they stay in the cache."""

_ROUNDING = 1e-12
"""An error below this share of the scores is rounding."""


def error_parts(values: FloatArray, side: IntArray) -> FloatArray:
    """What each scenario adds to a standard error: its length over a row is the standard error of the row's mean."""
    parts = np.zeros(values.shape)
    for which in np.unique(side):
        rows = side == which
        size = int(rows.sum())
        if size > 1:
            part = values[:, rows]
            part = part - row_means(part)[:, None]
            parts[:, rows] = part * (np.sqrt(size / (size - 1.0)) / side.size)
    return parts


def lengths(parts: FloatArray) -> FloatArray:
    """Standard error of every row's mean, (d,), from its `error_parts`."""
    return paired_errors(parts, np.zeros(parts.shape[1]), 0.0)


def paired_errors(parts: FloatArray, reference: FloatArray, largest: float) -> FloatArray:
    """Standard error of the mean paired difference of every row to a reference; 0 where they move along."""
    d, n = parts.shape
    errors = np.empty(d)
    size = max(1, _BLOCK_ENTRIES // n)
    for first in range(0, d, size):
        block = parts[first : first + size] - reference
        block *= block
        errors[first : first + size] = np.sqrt(block.sum(axis=1))
    errors[errors <= _ROUNDING * largest] = 0.0
    return errors


def paired_cubes(parts: FloatArray, reference: FloatArray) -> FloatArray:
    """Third moment of the mean paired difference of every row to a reference, (d,); parameters as `paired_errors`."""
    d, n = parts.shape
    cubes = np.empty(d)
    size = max(1, _BLOCK_ENTRIES // n)
    for first in range(0, d, size):
        block = parts[first : first + size] - reference
        cubes[first : first + size] = (block * block * block).sum(axis=1)
    return cubes


def spread_is_known(side: IntArray) -> bool:
    """Whether every side has two scenarios or more; one alone shows no spread, and no standard error is finite then."""
    return bool((np.unique(side, return_counts=True)[1] > 1).all())


def half_widths(critical: float | FloatArray, errors: FloatArray) -> FloatArray:
    """Critical value times standard errors, (d,); infinite for an infinite error, whatever the critical value."""
    result: FloatArray = np.full(errors.shape, np.inf)
    np.multiply(critical, errors, out=result, where=np.isfinite(errors))
    return result


def skewed_widths(critical: float, errors: FloatArray, cubes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How far intervals of skewed scores reach below and above their estimates.

    With g = cubes / errors^3, the skewness of an estimate, the Edgeworth expansion of Student's t (Hall 1992,
    Johnson 1978) asks for g (1 + 2 c^2) / 6 standard errors more on the side of the longer tail, and for g^2 (c^5 +
    2 c^3 - 3 c) / 18 on both, here c at most. The expansion's gain on the side of the shorter tail is not taken: g
    is itself an estimate.
    """
    skewness = np.zeros(errors.shape)
    usable = np.isfinite(errors) & (errors**3 > 0)
    np.divide(cubes, errors**3, out=skewness, where=usable)
    both = critical + np.clip(skewness**2 * (critical**5 + 2 * critical**3 - 3 * critical) / 18, 0.0, critical)
    one = skewness * (1 + 2 * critical**2) / 6
    return half_widths(both + np.maximum(-one, 0.0), errors), half_widths(both + np.maximum(one, 0.0), errors)


def degrees_of_freedom(side: IntArray) -> int:
    """Scenarios minus the means that are estimated, one for each side; at least 1."""
    return max(1, side.size - np.unique(side).size)


def with_tails_of_t(critical: float, df: int) -> float:
    """A critical value of standard normal quantities, made that of Student's t with the same tail."""
    from scipy.special import ndtr, stdtrit

    return float(-stdtrit(df, ndtr(-critical)))
