"""The bad end of S: its 95 % quantile and the mean of its worst 5 %."""

from __future__ import annotations

import math

import numpy as np

from ldctoolkit.arrays import FloatArray

_BLOCK_ENTRIES = 500_000
"""Scores sorted at once (4 MB)."""


def tail_figures(values: FloatArray, percent: int = 95) -> tuple[FloatArray, FloatArray]:
    """Quantile, and mean beyond it, of every row.

    Parameters
    ----------
    values : (d, n)
    percent : int
        Of the scenarios are not worse, 1 to 99.

    Returns
    -------
    quantile : (d,)
        Linear between neighbours.
    cvar : (d,)
        Mean of the worst (100 - percent) % of the n values: k = n (100 - percent) / 100 of them, the last one counted
        with the fraction that k leaves over. The conditional value at risk of the n values (Rockafellar and
        Uryasev 2002).

    Examples
    --------
    >>> import numpy as np
    >>> quantile, cvar = tail_figures(np.arange(1.0, 31.0)[None])
    >>> quantile.round(9), cvar.round(9)
    (array([28.55]), array([29.66666667]))
    """
    d, n = values.shape
    quantile, cvar = np.empty(d), np.empty(d)
    whole, rest = divmod(n * (100 - percent), 100)  # in whole numbers: 0.05 n is not exact
    size = max(1, _BLOCK_ENTRIES // n)
    place = percent * (n - 1) / 100
    low = math.floor(place)
    high = min(low + 1, n - 1)
    needed = sorted({low, high, max(n - whole - 1, 0), min(n - whole, n - 1)})
    for first in range(0, d, size):
        ordered = np.partition(values[first : first + size], needed, axis=1)
        rows = slice(first, first + size)
        quantile[rows] = ordered[:, low] + (ordered[:, high] - ordered[:, low]) * (place - low)
        # in order: a sum depends on it in the last bit
        worst = np.ascontiguousarray(np.sort(ordered[:, n - whole :], axis=1)).sum(axis=1)
        if rest:
            worst = worst + ordered[:, n - whole - 1] * (rest / 100)
        cvar[rows] = worst * (100 / (n * (100 - percent)))
    return quantile, cvar
