"""The table of components: shares, probabilities of the box, conditioning, effective numbers of events."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics.parts import Component
from ldctoolkit.mixture import Distribution

_BLOCK: Final = 65_536


def components(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray
) -> tuple[Component, ...]:
    """One row a component; weights count events."""
    K = distribution.weights.size
    total, squares = np.zeros(K), np.zeros(K)
    for start in range(0, x.shape[0], _BLOCK):
        rows = slice(start, start + _BLOCK)
        share = weight[rows, None] * distribution.shares(x[rows])
        total += share.sum(axis=0)
        squares += (share**2).sum(axis=0)
    normal = distribution.truncated
    spread = np.sqrt(np.diagonal(normal.Sigma, axis1=1, axis2=2))
    outside = np.maximum(np.maximum(normal.lower - normal.mu, normal.mu - normal.upper) / spread, 0.0)
    worst = np.argmax(outside, axis=1)
    condition = np.linalg.cond(normal.Sigma / (spread[:, :, None] * spread[:, None, :]))
    return tuple(
        Component(
            weight=float(distribution.weights[k]),
            log_probability=float(normal.log_probability[k]),
            outside=float(outside[k, worst[k]]),
            outside_name=names[worst[k]] if outside[k, worst[k]] > 0.0 else "",
            condition=float(condition[k]),
            events=float(total[k]),
            kish=float(total[k] ** 2 / squares[k]) if squares[k] > 0.0 else 0.0,
        )
        for k in range(K)
    )
