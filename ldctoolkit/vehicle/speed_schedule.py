"""Solutions of Riccati equations as smooth functions of speed.

A stabilising solution is analytic in the speed, so a Chebyshev interpolant in log v through the solver's answers at a
few dozen speeds is exact to rounding at every other speed, and nothing need be solved once a scenario. The range of
speeds is fixed: what a scenario gets cannot depend on which others are in its set.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError, LdcError

SPEED_RANGE: Final = (1.0, 90.0)
"""Speeds [m/s] for which gains are scheduled."""

_TAIL = 1e-9  # largest share that the last coefficients may have: above it the interpolant has not converged


def scheduled(
    solve: Callable[[FloatArray], FloatArray], v: FloatArray, what: str, *, columns: slice = slice(None)
) -> FloatArray:
    """Values of a smooth function of speed, from an interpolant that is made once.

    Parameters
    ----------
    solve : callable
        Speeds (m,) [m/s] to values (m, k), one row a speed whatever the others are. The interpolant is kept by this
        argument: it must be hashable, and equal only to what gives equal values, as a frozen dataclass is.
    v : (n,) [m/s]
        Speeds within `SPEED_RANGE`.
    what : str
        What is scheduled, in the plural, for messages.
    columns : slice
        Which of the k values are wanted, all by default; the others cost nothing.

    Returns
    -------
    (n, k)
        Or as many columns as are wanted.

    Raises
    ------
    InputError
        For a speed outside `SPEED_RANGE`.
    LdcError
        If the function is not smooth enough over the range.

    Examples
    --------
    >>> import numpy as np
    >>> def steering_per_curvature(v):
    ...     return np.column_stack([2.9 + 1e-3 * v**2])
    >>> scheduled(steering_per_curvature, np.array([20.0]), "angles").round(9)
    array([[3.3]])
    """
    low, high = SPEED_RANGE
    outside = ~((v >= low) & (v <= high))
    if outside.any():
        i = int(np.argmax(outside))
        raise InputError(f"speed at the trigger: {v[i]:g} m/s; allowed for scheduled gains: {low:g} to {high:g}")
    z = 2.0 * np.log(v / low) / math.log(high / low) - 1.0
    from ldctoolkit.vehicle._clenshaw import clenshaw

    coefficients = np.ascontiguousarray(_coefficients(solve, what)[:, columns])
    values = np.empty((z.size, coefficients.shape[1]))
    clenshaw(z, coefficients, values)
    return values


@functools.lru_cache(maxsize=256)
def _coefficients(solve: Callable[[FloatArray], FloatArray], what: str) -> FloatArray:
    """Chebyshev coefficients over log v, (nodes, k)."""
    for nodes in (48, 96, 192):
        z = np.cos(np.pi * (2 * np.arange(nodes) + 1) / (2 * nodes))
        values = solve(SPEED_RANGE[0] * (SPEED_RANGE[1] / SPEED_RANGE[0]) ** ((z + 1) / 2))
        basis = np.polynomial.chebyshev.chebvander(z, nodes - 1)
        coefficients: FloatArray = 2.0 / nodes * np.einsum("ik,ij->kj", basis, values)  # discrete orthogonality
        coefficients[0] /= 2.0
        scale = np.abs(coefficients).max(axis=0)
        if np.all(np.abs(coefficients[-3:]).max(axis=0) <= _TAIL * np.maximum(scale, 1e-300)):
            coefficients.flags.writeable = False
            return coefficients
    raise LdcError(f"{what} change too sharply with speed to be scheduled")
