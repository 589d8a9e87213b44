"""Chebyshev series, compiled. The compiler takes a while to import: callers import this module where they call it."""

from __future__ import annotations

import numba
import numpy as np

from ldctoolkit.arrays import FloatArray

_BLOCK = 64


# strict IEEE: the same operations in the same order for every point, wherever it stands
@numba.njit(nogil=True, cache=True, error_model="numpy")
def clenshaw(z: FloatArray, coefficients: FloatArray, out: FloatArray) -> None:
    """Evaluate k series of at least three terms, `coefficients` (terms, k), at z (n,) into `out` (n, k).

    The recurrence of C. W. Clenshaw (1955), operation by operation as in ``numpy.polynomial.chebyshev.chebval``.
    """
    terms = coefficients.shape[0]
    inner, outer, twice = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    for start in range(0, z.size, _BLOCK):
        count = min(_BLOCK, z.size - start)
        for i in range(count):
            twice[i] = 2.0 * z[start + i]
        for j in range(coefficients.shape[1]):
            inner[:] = coefficients[terms - 2, j]
            outer[:] = coefficients[terms - 1, j]
            for term in range(terms - 3, -1, -1):
                c = coefficients[term, j]
                for i in range(count):
                    before = inner[i]
                    inner[i] = c - outer[i]
                    outer[i] = before + outer[i] * twice[i]
            for i in range(count):
                out[start + i, j] = inner[i] + outer[i] * z[start + i]
