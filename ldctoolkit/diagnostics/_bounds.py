"""Mass next to the bounds, where a mixture of normals fails first."""

from __future__ import annotations

from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics._marginals import box_share
from ldctoolkit.diagnostics.parts import Strip
from ldctoolkit.mixture import Distribution

QUANTILE: Final = 0.05
"""A strip reaches from the bound to this quantile of the events."""

NEAR: Final = 0.5
"""A bound counts where its strip is narrower than this part of the middle 90 % of the events."""

_ENDS: Final[tuple[Literal["lower", "upper"], ...]] = ("lower", "upper")


def weighted_quantile(column: FloatArray, weight: FloatArray, share: float) -> float:
    """The least value that this share of the weight does not exceed; weights sum to one."""
    order = np.argsort(column, kind="stable")
    reached = np.cumsum(weight[order])
    return float(column[order][min(int(np.searchsorted(reached, share * (1.0 - 1e-12))), column.size - 1)])


def strips(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray, effective_events: float
) -> tuple[tuple[Strip, ...], tuple[tuple[str, str], ...]]:
    """Strips at the bounds that events come near to, and the names of the bounds that they do not.

    Parameters
    ----------
    distribution : Distribution
        The mixture.
    names : tuple of str
        Its d parameters.
    x : (n, d)
        Events inside the box.
    weight : (n,)
        Summing to one.
    effective_events : float
        Kish's effective number, for the standard errors.

    Returns
    -------
    strips : tuple of Strip
    far : tuple of (str, str)
        Parameter and end of the bounds that events do not come near to, see `NEAR`.
    """
    found: list[Strip] = []
    far: list[tuple[str, str]] = []
    for j, name in enumerate(names):
        quantiles = [weighted_quantile(x[:, j], weight, share) for share in (QUANTILE, 1.0 - QUANTILE)]
        for end, edge in zip(_ENDS, quantiles, strict=True):
            low, high = distribution.transform.lower.copy(), distribution.transform.upper.copy()
            bound = float(low[j] if end == "lower" else high[j])
            if not np.isfinite(bound):
                continue
            if abs(edge - bound) > NEAR * (quantiles[1] - quantiles[0]) or edge == bound:
                far.append((name, end))
                continue
            inside = x[:, j] <= edge if end == "lower" else x[:, j] >= edge
            (high if end == "lower" else low)[j] = edge
            data, model = float(weight[inside].sum()), box_share(distribution, low, high)
            spread = float(np.sqrt(data * (1.0 - data) / effective_events))
            found.append(Strip(name, end, bound, edge, data, model, model / data - 1.0, spread / data * (model / data)))
    return tuple(found), tuple(far)
