"""Bootstrap of means over scenarios, resampled within each side, with one set of weights for all designs."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_STREAM = 0x626F6F74
"""Keeps the bootstrap's random numbers apart from those of the scenarios, which come from the same seed."""

_BLOCK_ENTRIES = 2_000_000
"""Weights held at once (16 MB)."""


def bootstrap_means(values: FloatArray, side: IntArray, *, samples: int, seed: int) -> FloatArray:
    """Means of d designs over resampled scenarios.

    Parameters
    ----------
    values : (d, n)
        One row a design.
    side : (n,) int
        Stratum of each scenario: each side keeps its number of scenarios.
    samples : int
        Number of resamples B.
    seed : int

    Returns
    -------
    (B, d)
        Row b is the mean of every design over the same resample, so that differences between columns are paired.

    Raises
    ------
    InputError
        If samples is not positive, or there are no scenarios.

    Notes
    -----
    A resample is a multinomial weight vector w / n; the means are one matrix product, in blocks of B. The weights
    depend on seed, B and the sides only.

    Examples
    --------
    >>> import numpy as np
    >>> bootstrap_means(np.ones((2, 5)), np.array([1, 1, 1, -1, -1]), samples=3, seed=0)
    array([[1., 1.],
           [1., 1.],
           [1., 1.]])
    """
    d, n = values.shape
    if samples < 1 or n < 1:
        raise InputError(f"bootstrap: {samples} samples of {n} scenarios; allowed: at least one of each")
    strata = [np.flatnonzero(side == which) for which in np.unique(side)]
    generator = np.random.default_rng(np.random.SeedSequence([seed, _STREAM]))
    # centred: a spread that is small against the mean keeps its digits
    centre = values.mean(axis=1)
    centred = np.ascontiguousarray((values - centre[:, None]).T)
    means = np.empty((samples, d))
    size = max(1, _BLOCK_ENTRIES // n)
    for first in range(0, samples, size):
        block = min(size, samples - first)
        weights = np.zeros((block, n))
        for rows in strata:
            drawn = generator.integers(rows.size, size=(block, rows.size))
            drawn += rows.size * np.arange(block)[:, None]
            weights[:, rows] = np.bincount(drawn.ravel(), minlength=block * rows.size).reshape(block, rows.size)
        means[first : first + block] = weights @ centred / n + centre
    return means


def percentile_interval(means: FloatArray, confidence: float) -> tuple[FloatArray, FloatArray]:
    """Percentile interval of every column of (B, d) resampled means.

    Parameters
    ----------
    means : (B, d)
    confidence : float
        Between 0 and 1.

    Returns
    -------
    low, high : (d,)

    Raises
    ------
    InputError
        For a confidence outside (0, 1).
    """
    if not 0.0 < confidence < 1.0:
        raise InputError(f"confidence: {confidence!r}; allowed: between 0 and 1")
    tail = 0.5 * (1.0 - confidence)
    low, high = np.quantile(means, [tail, 1.0 - tail], axis=0)
    return low, high
