"""Lines that begin alike, compiled. Imports numba, so it is imported late."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt


def first_other_line(text: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], line: int, key: bytes) -> int:
    r"""The first line behind `line` that does not begin with the key's bytes.

    Parameters
    ----------
    text : (n,) uint8
        Whole lines; the last byte is a line end.
    starts : (lines,) int
        Where each begins.
    line : int
        A line that begins with the key.
    key : bytes
        Holds no line end, so that a shorter line differs before it ends.

    Examples
    --------
    >>> text = np.frombuffer(bytearray(b"7,1,0\n7,1,5\n7,2,0\n"), dtype=np.uint8)
    >>> first_other_line(text, np.array([0, 6, 12]), 0, b"7,1,")
    2
    """
    return int(_first_other(text, starts, line, np.frombuffer(key, dtype=np.uint8)))


@numba.njit(cache=True, nogil=True)
def _first_other(
    text: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], line: int, key: npt.NDArray[np.uint8]
) -> int:
    for j in range(line + 1, starts.size):
        start = starts[j]
        for p in range(key.size):
            if text[start + p] != key[p]:
                return j
    return int(starts.size)
