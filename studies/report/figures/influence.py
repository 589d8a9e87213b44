"""How much of the differences in a score goes with one quantity: a rough measure, for choosing what to draw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit.gains import GainValue

_MOST_GROUPS = 8


def influence(values: Sequence[GainValue], S: npt.NDArray[np.float64]) -> float:
    """Part of the variance of S between groups of designs with the same, or nearly the same, value.

    Parameters
    ----------
    values : sequence of m values
        Of one quantity, one a design.
    S : (m,) [m s]

    Returns
    -------
    float
        From 0 to 1: the correlation ratio, with numbers in up to eight groups of about the same size.

    Examples
    --------
    >>> influence([0.1, 0.1, 0.2, 0.2], np.array([1.0, 1.0, 2.0, 2.0]))
    1.0
    """
    found, group = np.unique([str(v) for v in values], return_inverse=True)
    if len(found) > _MOST_GROUPS and not any(isinstance(v, str | bool) for v in values):
        numbers = np.array([float(v) for v in values])
        inner = np.quantile(numbers, np.linspace(0.0, 1.0, _MOST_GROUPS + 1)[1:-1])
        group = np.searchsorted(inner, numbers, side="left")
    size = np.bincount(group)
    mean = np.bincount(group, weights=S)[size > 0] / size[size > 0]
    between = float(np.average((mean - S.mean()) ** 2, weights=size[size > 0]))
    return min(between / float(S.var()), 1.0) if S.var() > 0 else 0.0
