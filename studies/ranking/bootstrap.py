"""Bootstrap of means over scenarios, resampled within each side, with one set of weights for all designs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from studies.ranking.row_blocks import row_blocks, row_means

_STREAM = 0x626F6F74
"""Keeps the bootstrap's random numbers apart from those of the scenarios, which come from the same seed."""

_BLOCK_ENTRIES = 2_000_000
"""Weights held at once (16 MB)."""

_GRID_ENTRIES = 2_500_000
"""Scores that are resampled at once (20 MB, and as much again for what is worked out on the way)."""

_KEPT_ENTRIES = 10_000_000
"""Weights of a block that was kept (80 MB): in products of small matrices threads wait for each other."""

_MANTISSA = 53
"""Bits of a double precision number."""


def bootstrap_means(values: FloatArray, side: IntArray, *, samples: int, seed: int, stream: int = 0) -> FloatArray:
    """Means of d designs over resampled scenarios.

    A resample is a multinomial weight vector w / n; the means are one matrix product, in blocks of B. The weights
    depend on seed, stream, B and the sides only. A column depends on its own row and the weights, to the last bit.
    """
    return bootstrap_deviations(values, side, samples=samples, seed=seed, stream=stream) + row_means(values)


def bootstrap_deviations(
    values: FloatArray, side: IntArray, *, samples: int, seed: int, stream: int = 0, rows: IntArray | None = None
) -> FloatArray:
    """What `bootstrap_means` gives minus the designs' means, (B, d); parameters and errors are the same.

    With `rows`, (d,) int, of these rows of the values, in the order given.
    """
    n = values.shape[1]
    d = values.shape[0] if rows is None else rows.size
    mean = row_means(values, rows)
    deviations = np.empty((max(samples, 0), d))
    # weights take a byte each: below this number of designs the numbers themselves take less
    entries = max(_GRID_ENTRIES, samples // 8 * n)
    blocks: Iterable[FloatArray] = weight_blocks(side, samples=samples, seed=seed, stream=stream)
    if d * n > entries:
        blocks = _Kept(blocks)
    for places, block in row_blocks(values, rows, entries=entries):
        # centred: a spread that is small against the mean keeps its digits
        grid, unit = exact_grid(block - mean[places, None], n)
        first = 0
        for weights in blocks:
            result = deviations[first : first + len(weights), places]
            np.matmul(weights, grid.T, out=result)
            result *= unit / n
            first += len(weights)
    return deviations


class _Kept:
    """Weights that are needed more than once, in the smallest whole numbers that hold them; large blocks come back."""

    def __init__(self, blocks: Iterable[FloatArray]) -> None:
        self._weights = np.concatenate([block.astype(np.min_scalar_type(int(block.max()))) for block in blocks])

    def __iter__(self) -> Iterator[FloatArray]:
        return (block.astype(np.float64) for _, block in row_blocks(self._weights, entries=_KEPT_ENTRIES))


def weight_blocks(side: IntArray, *, samples: int, seed: int, stream: int = 0) -> Iterator[FloatArray]:
    """How often each scenario is drawn in each resample, in blocks (b, n) that hold `samples` rows together."""
    n = side.size
    if samples < 1 or n < 1:
        raise InputError(f"bootstrap: {samples} samples of {n} scenarios; allowed: at least one of each")
    strata = [np.flatnonzero(side == which) for which in np.unique(side)]
    generator = np.random.default_rng(np.random.SeedSequence([seed, _STREAM, stream]))
    size = max(1, _BLOCK_ENTRIES // n)
    for first in range(0, samples, size):
        block = min(size, samples - first)
        weights = np.zeros((block, n))
        for rows in strata:
            drawn = generator.integers(rows.size, size=(block, rows.size))
            drawn += rows.size * np.arange(block)[:, None]
            weights[:, rows] = np.bincount(drawn.ravel(), minlength=block * rows.size).reshape(block, rows.size)
        yield weights


def exact_grid(values: FloatArray, total: int) -> tuple[FloatArray, FloatArray]:
    """Values as whole numbers of a unit, so that weighted sums of them are exact.

    Every partial sum of weights times grid is a whole number below 2^53. A matrix product is then the same to the
    last bit in whatever order a BLAS sums, on any machine, for any number of threads and any rows beside it.
    """
    _, exponent = np.frexp(np.abs(values).max(axis=1, initial=0.0))
    unit = np.ldexp(1.0, exponent + int(total).bit_length() - _MANTISSA)
    grid: FloatArray = np.rint(values / unit[:, None])
    return grid, unit


def percentile_interval(means: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Percentile interval of every column of (B, d) resampled means."""
    check_confidence(confidence)
    tail = 0.5 * (1.0 - confidence)
    low, high = np.quantile(means, [tail, 1.0 - tail], axis=0)
    return low, high


def check_confidence(confidence: float) -> None:
    """Refuse what is not between 0 and 1."""
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence: {confidence!r}; allowed: between 0 and 1")
