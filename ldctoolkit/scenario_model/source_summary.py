"""What a model's file keeps of the departures that it was fitted to: how they spread, and none of them."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.mixture.events import Events

TOGETHER: Final = 10
"""Departures behind every quantile at least: each is a mean over so many."""

LEAST_IN_CELL: Final = 5
"""Departures behind every share of a cell; cells with fewer are told as empty."""

QUANTILES: Final = 40
CELLS: Final = 12
UNIT: Final = 10_000
"""Shares of cells are whole numbers of 1/UNIT."""

_FEWEST_CELLS: Final = 4
_EVENTS_PER_CELL: Final = 20
_MOST_LOOKED_AT: Final = 50_000


@dataclasses.dataclass(frozen=True)
class SourceSummary:
    """Quantiles, rank correlations and coarse joint shares of one side's departures.

    Attributes
    ----------
    names : tuple of str
        The d parameters that vary, in the order of the side's mixture.
    departures : int
        Departures that were looked at.
    effective : float
        Kish's effective number of them.
    quantiles : tuple of tuple of float
        (d, m), SI units: at the probabilities (i + 1/2)/m.
    rank_correlations : tuple of float
        Spearman's, of the pairs (0, 1), (0, 2), ..., (d-2, d-1).
    cells : tuple of tuple of int
        The same pairs: shares in 1/10,000 of b x b cells between the `edges` of both parameters, row by row, the first
        parameter's cells one after the other.

    Notes
    -----
    A quantile is the mean of the quantile function over a window that holds ten departures or more, and windows do not
    overlap. A cell with fewer than five departures counts as empty. So no number can be led back to one departure.

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=(4000, 2)) @ [[1.0, 0.8], [0.0, 0.6]]
    >>> found = summarize(x, names=("T", "d_y"))
    >>> abs(float(found.at(0.5)[0])) < 0.1, 0.7 < found.rank_correlations[0] < 0.85
    (True, True)
    """

    names: tuple[str, ...]
    departures: int
    effective: float
    quantiles: tuple[tuple[float, ...], ...]
    rank_correlations: tuple[float, ...]
    cells: tuple[tuple[int, ...], ...]

    @property
    def probabilities(self) -> FloatArray:
        """Of the quantiles, (m,)."""
        m = len(self.quantiles[0])
        return np.asarray((np.arange(m) + 0.5) / m)

    def at(self, probability: float) -> FloatArray:
        """A quantile of each parameter (d,), between those that are kept; the outermost ones beyond them."""
        return np.array([np.interp(probability, self.probabilities, row) for row in self.quantiles])

    def edges(self, j: int) -> FloatArray:
        """Edges (b + 1,) of the cells of parameter j: even, from below the first quantile to above the last."""
        return cell_edges(np.array(self.quantiles[j]), self.b)

    @property
    def b(self) -> int:
        """Cells along one parameter."""
        return math.isqrt(len(self.cells[0])) if self.cells else 0

    def pair(self, i: int, j: int) -> FloatArray:
        """Shares (b, b) of the departures in the cells of parameters i < j."""
        return np.array(self.cells[pair_number(i, j, len(self.names))], dtype=float).reshape(self.b, self.b) / UNIT

    def rank_correlation(self, i: int, j: int) -> float:
        """Of parameters i < j."""
        return self.rank_correlations[pair_number(i, j, len(self.names))]


def pair_number(i: int, j: int, d: int) -> int:
    """Place of the pair i < j among (0, 1), (0, 2), ..., (d-2, d-1)."""
    return i * (2 * d - i - 1) // 2 + j - i - 1


def cell_edges(quantiles: FloatArray, b: int) -> FloatArray:
    """Even edges (b + 1,) that reach beyond the outermost quantiles, further where these are few."""
    low, high = float(quantiles[0]), float(quantiles[-1])
    margin = (high - low) * (0.05 + 2.0 / quantiles.size)
    if not margin > 0.0:  # nearly all are equal
        margin = max(abs(low), 1.0) * 1e-6
    return np.linspace(low - margin, high + margin, b + 1)


def summarize(x: FloatArray, weight: FloatArray | None = None, *, names: tuple[str, ...]) -> SourceSummary | None:
    """Sum departures up.

    Parameters
    ----------
    x : (n, d)
        Departures, finite numbers.
    weight : (n,), optional
        Events that each stands for.
    names : tuple of str
        The d parameters.

    Returns
    -------
    SourceSummary or None
        None where too few departures carry too much of the weight: a quantile would be one of them.
    """
    if weight is not None:
        x, weight = x[weight > 0.0], weight[weight > 0.0]
    n, d = x.shape
    share = np.full(n, 1.0 / max(n, 1)) if weight is None else weight / weight.sum()
    half = 0.5 * TOGETHER * float(share.max(initial=1.0 / max(n, 1)))
    m = min(QUANTILES, int(1.0 / (2.0 * half) + 1e-9))
    if n < TOGETHER or m < 2:
        return None
    quantiles = np.stack([_quantiles(x[:, j], share, m, half) for j in range(d)])
    b = min(CELLS, max(_FEWEST_CELLS, math.isqrt(n // _EVENTS_PER_CELL)))
    places = [places_between(x[:, j], cell_edges(quantiles[j], b)) for j in range(d)]
    ranks = np.column_stack([weighted_ranks(x[:, j], share) for j in range(d)])
    pairs = [(i, j) for i in range(d) for j in range(i + 1, d)]
    return SourceSummary(
        names,
        n,
        _rounded(1.0 / float((share**2).sum())),
        tuple(tuple(map(_rounded, row.tolist())) for row in quantiles),
        tuple(round(rank_correlation(ranks[:, i], ranks[:, j], share), 4) for i, j in pairs),
        tuple(_cells(places[i], places[j], share, b) for i, j in pairs),
    )


def summarize_events(events: Events, names: tuple[str, ...]) -> SourceSummary | None:
    """Sum up what a fit was made of; of more than 50,000 departures as many evenly spread rows."""
    rows = events.rows
    if rows > _MOST_LOOKED_AT:
        events = events.take(np.arange(_MOST_LOOKED_AT, dtype=np.int64) * rows // _MOST_LOOKED_AT)
    return summarize(events.x, events.weight, names=names)


def weighted_ranks(column: FloatArray, share: FloatArray) -> FloatArray:
    """Share below each value and half of that at it, (n,)."""
    _, value = np.unique(column, return_inverse=True)
    at = np.bincount(value, share)
    return np.asarray((np.cumsum(at) - 0.5 * at)[value])


def rank_correlation(one: FloatArray, other: FloatArray, share: FloatArray) -> float:
    """Pearson's correlation of ranks (n,) with shares (n,); 0 where a column is constant."""
    a, b = (ranks - np.einsum("i,i->", share, ranks) for ranks in (one, other))
    size = math.sqrt(float(np.einsum("i,i,i->", share, a, a)) * float(np.einsum("i,i,i->", share, b, b)))
    return float(np.einsum("i,i,i->", share, a, b)) / size if size > 0.0 else 0.0


def places_between(column: FloatArray, edges: FloatArray) -> IntArray:
    """Cell of each value, -1 outside."""
    place = np.searchsorted(edges, column, side="right") - 1
    place[(place >= edges.size - 1) | (place < 0)] = -1
    return place.astype(np.int64)


def _quantiles(column: FloatArray, share: FloatArray, m: int, half: float) -> FloatArray:
    """Means of the quantile function over windows of width 2 `half` about (i + 1/2)/m."""
    order = np.argsort(column, kind="stable")
    reached = np.concatenate([[0.0], np.cumsum(share[order])])
    integral = np.concatenate([[0.0], np.cumsum(share[order] * column[order])])
    middle = (np.arange(m) + 0.5) / m
    low, high = np.maximum(middle - half, 0.0), np.minimum(middle + half, reached[-1])
    means = (np.interp(high, reached, integral) - np.interp(low, reached, integral)) / (high - low)
    return np.asarray(np.maximum.accumulate(np.clip(means, column.min(), column.max())))


def _cells(first: IntArray, second: IntArray, share: FloatArray, b: int) -> tuple[int, ...]:
    seen = (first >= 0) & (second >= 0)
    number = first[seen] * b + second[seen]
    carried = np.bincount(number, share[seen], b * b)
    carried[np.bincount(number, minlength=b * b) < LEAST_IN_CELL] = 0.0
    return tuple(int(cell) for cell in np.floor(UNIT * carried + 1e-9))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
