"""Counter-based random numbers, compiled: a draw follows from its numbers alone, never from the draws before it.

Philox4x32-10 of J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw, *Parallel random numbers: as easy as 1, 2, 3*,
SC11, section 4.3. Every function here may be called from other compiled functions. The compiler takes a while to
import: callers import this module where they call it.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray

_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}  # strict IEEE: the same bits in every loop

# numba makes a float of uint64 with int64: every number below is unsigned
_MULTIPLIER_0: Final = np.uint64(0xD2511F53)
_MULTIPLIER_1: Final = np.uint64(0xCD9E8D57)
_WEYL_0: Final = np.uint64(0x9E3779B9)
_WEYL_1: Final = np.uint64(0xBB67AE85)
_LOW: Final = np.uint64(0xFFFFFFFF)
_32: Final = np.uint64(32)
_12: Final = np.uint64(12)


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def philox(c0: Any, c1: Any, c2: Any, c3: Any, k0: Any, k1: Any) -> Any:
    """Philox4x32-10: four random words from a counter of four and a key of two, 32 bits each, held in uint64."""
    c0, c1, c2, c3 = np.uint64(c0) & _LOW, np.uint64(c1) & _LOW, np.uint64(c2) & _LOW, np.uint64(c3) & _LOW
    k0, k1 = np.uint64(k0) & _LOW, np.uint64(k1) & _LOW
    for _ in range(10):
        product_0, product_1 = _MULTIPLIER_0 * c0, _MULTIPLIER_1 * c2
        c0, c2 = (product_1 >> _32) ^ c1 ^ k0, (product_0 >> _32) ^ c3 ^ k1
        c1, c3 = product_1 & _LOW, product_0 & _LOW
        k0, k1 = (k0 + _WEYL_0) & _LOW, (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def uniform_pair(seed: Any, index: Any, stream: Any, counter: Any) -> Any:
    """Two uniform numbers on (0, 1), odd multiples of 2^-53: neither 0 nor 1 can occur."""
    key, number = np.uint64(seed), np.uint64(index)
    a, b, c, d = philox(number, number >> _32, np.uint64(stream), np.uint64(counter), key, key >> _32)
    first = np.float64(((b << _32) | a) >> _12)
    second = np.float64(((d << _32) | c) >> _12)
    return (first + 0.5) * 2.0**-52, (second + 0.5) * 2.0**-52


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def normal_pair(seed: Any, index: Any, stream: Any, counter: Any) -> Any:
    """Two independent standard normal numbers (Box and Muller, Ann. Math. Statist. 29, 1958)."""
    first, second = uniform_pair(seed, index, stream, counter)
    radius = math.sqrt(-2.0 * math.log(first))
    angle = 2.0 * math.pi * second
    return radius * math.cos(angle), radius * math.sin(angle)


@numba.njit(**_OPTIONS, cache=True)  # type: ignore[untyped-decorator]
def fill_uniforms(seed: int, index: IntArray, stream: int, out: FloatArray) -> None:
    """Uniform numbers into `out` (n, count): column j is element j % 2 of the pair at counter j // 2."""
    n, count = out.shape
    for i in range(n):
        for pair in range((count + 1) // 2):
            first, second = uniform_pair(seed, index[i], stream, pair)
            out[i, 2 * pair] = first
            if 2 * pair + 1 < count:
                out[i, 2 * pair + 1] = second


@numba.njit(**_OPTIONS, cache=True)  # type: ignore[untyped-decorator]
def fill_normals(seed: int, index: IntArray, stream: int, out: FloatArray) -> None:
    """Standard normal numbers into `out` (n, count), numbered like the uniform ones."""
    n, count = out.shape
    for i in range(n):
        for pair in range((count + 1) // 2):
            first, second = normal_pair(seed, index[i], stream, pair)
            out[i, 2 * pair] = first
            if 2 * pair + 1 < count:
                out[i, 2 * pair + 1] = second
