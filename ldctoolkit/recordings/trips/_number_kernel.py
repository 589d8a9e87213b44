"""Plain numbers out of comma-separated text, compiled. Imports numba, so it is imported late.

It reads only numbers whose digits, up to 2^53, and whose power of ten, up to 10^22, are exact floats: then their one
product or quotient is the nearest float. Everything else is left to a parser that knows more.
"""

from __future__ import annotations

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_POWERS: Final[FloatArray] = np.array([10.0**power for power in range(23)])
_LARGEST: Final = 2**53


def plain_numbers(text: npt.NDArray[np.uint8], places: list[int], cells: int, lines: int) -> FloatArray | None:
    r"""Chosen cells of each line, (chosen, lines); an empty cell is NaN.

    Parameters
    ----------
    text : (n,) uint8
        ASCII.
    places : list of int
        Which cells of a line are wanted.
    cells, lines : int
        How many a line, and the text, must have.

    Returns
    -------
    (chosen, lines) float or None
        None if any line has another number of cells, or any wanted cell is not a plain number.

    Examples
    --------
    >>> text = np.frombuffer(b"1,x,-9.5000006E-3\r\n2,y,\r\n", dtype=np.uint8)
    >>> plain_numbers(text, [2, 0], 3, 2).tolist()
    [[-0.0095000006, nan], [1.0, 2.0]]
    >>> plain_numbers(text, [1], 3, 2) is None
    True
    """
    column = np.full(cells, -1, dtype=np.int64)
    column[places] = np.arange(len(places))
    numbers = np.empty((len(places), lines))
    text = text.view()
    text.flags.writeable = False  # or the loop would be compiled twice
    return numbers if _parse(text, column, numbers, _POWERS) == lines else None


@numba.njit(cache=True, nogil=True)
def _parse(text: npt.NDArray[np.uint8], column: npt.NDArray[np.int64], numbers: FloatArray, powers: FloatArray) -> int:
    """Number of lines, or -1 where something is not plain."""
    size, cells, lines = text.size, column.size, numbers.shape[1]
    i = row = 0
    while i < size:
        if row == lines:
            return -1
        for c in range(cells):
            target = column[c]
            if target < 0:
                while i < size and text[i] != 44 and text[i] != 10:
                    i += 1
            else:
                first = i
                negative = i < size and text[i] == 45
                if negative:
                    i += 1
                mantissa = np.int64(0)
                begin = i
                while i < size and 48 <= text[i] <= 57:
                    mantissa = mantissa * 10 + (np.int64(text[i]) - 48)
                    i += 1
                digits = i - begin
                exponent = np.int64(0)
                if i < size and text[i] == 46:
                    i += 1
                    begin = i
                    while i < size and 48 <= text[i] <= 57:
                        mantissa = mantissa * 10 + (np.int64(text[i]) - 48)
                        i += 1
                    digits += i - begin
                    exponent = np.int64(begin - i)
                if digits > 18 or mantissa > _LARGEST:  # with more digits the product may have run over
                    return -1
                if i < size and (text[i] == 69 or text[i] == 101):
                    i += 1
                    down = i < size and text[i] == 45
                    if i < size and (text[i] == 45 or text[i] == 43):
                        i += 1
                    begin = i
                    shift = np.int64(0)
                    while i < size and i < begin + 4 and 48 <= text[i] <= 57:
                        shift = shift * 10 + (np.int64(text[i]) - 48)
                        i += 1
                    if i == begin:
                        return -1
                    exponent += -shift if down else shift
                if i == first:
                    value = np.nan
                elif digits == 0 or exponent < -22 or exponent > 22:
                    return -1
                elif exponent < 0:
                    value = mantissa / powers[-exponent]
                else:
                    value = mantissa * powers[exponent]
                numbers[target, row] = -value if negative else value
                if c == cells - 1 and i < size and text[i] == 13:
                    i += 1
            if c < cells - 1:
                if i >= size or text[i] != 44:
                    return -1
                i += 1
            elif i < size:
                if text[i] != 10:
                    return -1
                i += 1
        row += 1
    return row
