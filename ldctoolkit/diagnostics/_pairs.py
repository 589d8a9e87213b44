"""Joint histograms of two parameters, events beside a sample of the model."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.diagnostics._marginals import bin_edges, bin_of
from ldctoolkit.diagnostics.parts import PairDensity
from ldctoolkit.mixture import Distribution

PAIR_BINS: Final = 24
JOINT_BINS: Final = 48


def _shares(a: IntArray, b: IntArray, bins: int, weight: FloatArray | None) -> FloatArray:
    """Share of each cell; events outside the axes count in the total."""
    seen = (a >= 0) & (b >= 0)
    counts = np.bincount(a[seen] * bins + b[seen], None if weight is None else weight[seen], bins * bins)
    total = a.size if weight is None else 1.0
    return (counts / total).reshape(bins, bins)


def pair_densities(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray, drawn: FloatArray
) -> tuple[tuple[PairDensity, ...], PairDensity | None]:
    """All pairs of parameters in coarse bins, and T against d_y in fine ones; weights sum to one."""
    low, high = distribution.transform.lower, distribution.transform.upper

    def binned(bins: int, wanted: list[int]) -> dict[int, tuple[FloatArray, IntArray, IntArray]]:
        out = {}
        for j in wanted:
            edges = bin_edges(x[:, j], drawn[:, j], float(low[j]), float(high[j]), bins)
            out[j] = edges, bin_of(x[:, j], edges), bin_of(drawn[:, j], edges)
        return out

    def pair(parts: dict[int, tuple[FloatArray, IntArray, IntArray]], i: int, j: int, bins: int) -> PairDensity:
        (edges_i, data_i, model_i), (edges_j, data_j, model_j) = parts[i], parts[j]
        return PairDensity(
            names[i],
            names[j],
            edges_i,
            edges_j,
            _shares(data_i, data_j, bins, weight),
            _shares(model_i, model_j, bins, None),
        )

    d = len(names)
    coarse = binned(PAIR_BINS, list(range(d)))
    pairs = tuple(pair(coarse, i, j, PAIR_BINS) for i in range(d) for j in range(i + 1, d))
    joint = None
    if "T" in names and "d_y" in names:
        i, j = names.index("T"), names.index("d_y")
        joint = pair(binned(JOINT_BINS, [i, j]), i, j, JOINT_BINS)
    return pairs, joint
