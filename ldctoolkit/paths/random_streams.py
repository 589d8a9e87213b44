"""What is drawn for a scenario: numbers that follow from the seed, the scenario's number, a stream and a position.

No draw depends on another, so neither on the order of scenarios nor on which others are there.
"""

from __future__ import annotations

import enum

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError
from ldctoolkit.option_checks import checked_seed


class RandomStream(enum.IntEnum):
    """Which quantity is drawn; streams are independent of each other."""

    MISMATCH = 1
    RESIDUAL_Y = 2
    RESIDUAL_V = 3
    CAMERA = 4
    CURVATURE = 5


def uniforms(seed: int, index: npt.ArrayLike, stream: int, count: int) -> FloatArray:
    """Independent uniform numbers on (0, 1), (n, count), for scenarios `index` (n,); no column depends on `count`.

    Column j is element j % 2 of the pair at counter j // 2. Philox4x32-10 (Salmon et al., SC11, 2011), 53 bits each;
    0 and 1 themselves do not occur.
    """
    from ldctoolkit.paths.philox import fill_uniforms

    seed, numbers, out = _checked(seed, index, count)
    fill_uniforms(seed, numbers, int(stream), out)
    return out


def normals(seed: int, index: npt.ArrayLike, stream: int, count: int) -> FloatArray:
    """Independent standard normal numbers, (n, count), for scenarios `index` (n,); no column depends on `count`.

    The transform of Box and Muller (Ann. Math. Statist. 29, 1958) of the uniform numbers; none is beyond 8.6.
    """
    from ldctoolkit.paths.philox import fill_normals

    seed, numbers, out = _checked(seed, index, count)
    fill_normals(seed, numbers, int(stream), out)
    return out


def _checked(seed: int, index: npt.ArrayLike, count: int) -> tuple[int, npt.NDArray[np.int64], FloatArray]:
    numbers = np.asarray(index)
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
        raise InputError(f"index: {numbers.ndim} dimensions of {numbers.dtype}; allowed: (n,) whole numbers")
    numbers = np.ascontiguousarray(numbers, dtype=np.int64)
    if np.any(numbers < 0):
        i = int(np.argmax(numbers < 0))
        raise InputError(f"index[{i}] = {numbers[i]}; allowed: >= 0")
    if count < 0:
        raise InputError(f"count: {count!r}; allowed: >= 0")
    return checked_seed(seed), numbers, np.empty((numbers.size, count))
