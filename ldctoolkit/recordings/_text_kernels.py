"""Compiled reading of numbers and keys in the bytes of a table."""

from typing import Final

import numba
import numpy as np
import numpy.typing as npt

import ldctoolkit.compiling as compiling
from ldctoolkit.arrays import FloatArray, IntArray

compiling.listen()

_POWERS: Final[FloatArray] = np.array([10.0**power for power in range(23)])
_LARGEST: Final = 2**53

_COMMA, _LINE_END, _RETURN, _MINUS, _PLUS, _POINT, _SMALL_E, _LARGE_E, _ZERO = np.frombuffer(
    b",\n\r-+.eE0", dtype=np.uint8
)


def plain_numbers(text: npt.NDArray[np.uint8], places: list[int], cells: int, lines: int) -> FloatArray | None:
    r"""Chosen cells of each line, (chosen, lines); an empty cell is NaN."""
    if not text.size or text[-1] != _LINE_END:
        return None
    column = np.full(cells, -1, dtype=np.int64)
    column[places] = np.arange(len(places))
    numbers = np.empty((len(places), lines))
    text = text.view()
    text.flags.writeable = False  # or the loop would be compiled twice
    return numbers if _parse(text, column, numbers, _POWERS) == lines else None


@numba.njit(cache=True, nogil=True)
def _parse(text: npt.NDArray[np.uint8], column: IntArray, numbers: FloatArray, powers: FloatArray) -> int:
    """Number of lines, or -1 where something is not plain.

    The text ends with a line end, where every inner loop stops, so that none has to require the end of the text. Places
    are unsigned: a place that may be negative would be looked at twice.
    """
    size, one = np.uint64(text.size), np.uint64(1)
    cells, lines = column.size, numbers.shape[1]
    i, row, seen = np.uint64(0), 0, np.uint8(0)
    while i < size:
        if row == lines:
            return -1
        for c in range(cells):
            target = column[c]
            if target < 0:
                byte = text[i]
                while byte != _COMMA and byte != _LINE_END:
                    seen |= byte
                    i += one
                    byte = text[i]
            else:
                first = i
                negative = text[i] == _MINUS
                if negative:
                    i += one
                mantissa = np.int64(0)
                begin = i
                digit = np.uint8(text[i] - _ZERO)
                while digit < 10:
                    mantissa = mantissa * 10 + np.int64(digit)
                    i += one
                    digit = np.uint8(text[i] - _ZERO)
                digits = np.int64(i - begin)
                exponent = np.int64(0)
                if text[i] == _POINT:
                    i += one
                    begin = i
                    digit = np.uint8(text[i] - _ZERO)
                    while digit < 10:
                        mantissa = mantissa * 10 + np.int64(digit)
                        i += one
                        digit = np.uint8(text[i] - _ZERO)
                    exponent = -np.int64(i - begin)
                    digits -= exponent
                if digits > 18 or mantissa > _LARGEST:  # with more digits the product may have run over
                    return -1
                if text[i] == _SMALL_E or text[i] == _LARGE_E:
                    i += one
                    down = text[i] == _MINUS
                    if down or text[i] == _PLUS:
                        i += one
                    begin = i
                    shift = np.int64(0)
                    digit = np.uint8(text[i] - _ZERO)
                    while digit < 10 and i - begin < 4:
                        shift = shift * 10 + np.int64(digit)
                        i += one
                        digit = np.uint8(text[i] - _ZERO)
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
                if c == cells - 1 and text[i] == _RETURN:
                    i += one
            if text[i] != (_COMMA if c < cells - 1 else _LINE_END):
                return -1
            i += one
        row += 1
    return row if seen < 128 else -1


def first_other_line(text: npt.NDArray[np.uint8], starts: IntArray, line: int, key: bytes) -> int:
    r"""The first line behind `line` that does not begin with the key's bytes."""
    return int(_first_other(text, starts, line, np.frombuffer(key, dtype=np.uint8)))


@numba.njit(cache=True, nogil=True)
def _first_other(text: npt.NDArray[np.uint8], starts: IntArray, line: int, key: npt.NDArray[np.uint8]) -> int:
    for j in range(line + 1, starts.size):
        start = starts[j]
        for p in range(key.size):
            if text[start + p] != key[p]:
                return j
    return int(starts.size)
