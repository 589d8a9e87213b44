"""Cells of tables as numbers, with every faulty line named."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.recordings.table import MISSING

if TYPE_CHECKING:
    import polars as pl

COMPILED_FROM: Final = 1 << 20
"""Loading a compiler's library is not worth it for less."""

_PIECE: Final = 1 << 17
_LINE_END: Final = 10
_BLANKS: Final = " \t\r\"'"


@dataclasses.dataclass(frozen=True)
class RowFault:
    """A line of a text that was left out.

    Attributes
    ----------
    row : int
        Place of the line in the text, from 0.
    kind : str
        Faults of one kind are counted together.
    what : str
        What is wrong.
    """

    row: int
    kind: str
    what: str


@dataclasses.dataclass(frozen=True)
class Cells:
    """Columns of numbers.

    Attributes
    ----------
    names : tuple of str
        The k columns.
    values : tuple of (m,) float
        One array a column; NaN for a missing value.
    row : (m,) int
        Place of each line in the text, from 0.
    lines : int
        Lines of the text, whatever they hold.
    faults : tuple of RowFault
        Lines left out, by place.
    """

    names: tuple[str, ...]
    values: tuple[FloatArray, ...]
    row: IntArray
    lines: int
    faults: tuple[RowFault, ...] = ()

    def __getitem__(self, name: str) -> FloatArray:
        return self.values[self.names.index(name)]


def read_cells(
    text: bytes | bytearray | memoryview,
    columns: Sequence[str],
    wanted: Sequence[str],
    *,
    cells: Sequence[int] = (),
    compiled_from: int = COMPILED_FROM,
) -> Cells:
    r"""Parse whole lines of numbers.

    Parameters
    ----------
    text : bytes
        Comma-separated lines without a header; the last one may lack its end.
    columns : sequence of str
        Name of each column.
    wanted : sequence of str
        Those to parse; the others may hold any text.
    cells : sequence of int, optional
        Allowed numbers of cells in a line, each at least enough for the wanted columns; by default one for each column.
    compiled_from : int
        Size of a text [bytes] from which a compiled parser is tried first; the numbers are the same.

    Returns
    -------
    Cells
        Rows in the order of the text. Empty cells and words such as NULL are NaN. Blank lines are passed over. Lines
        with another number of cells, that are not UTF-8, or with a word where a number is wanted are left out and told.

    Notes
    -----
    A clean text is parsed at once as numbers: plain ones, as recorders write them, by a compiled loop over the bytes,
    three times as fast as a CSV library, others by the library. If that is not possible, lines are looked through, all
    together; if that does not help either, the cells are read as words.

    Examples
    --------
    >>> found = read_cells(b"1,2.5,x\n2, NULL,y\n3\n4,five,z\n", ["a", "b", "c"], ["b"])
    >>> found["b"].tolist(), found.row.tolist()
    ([2.5, nan], [0, 1])
    >>> [fault.what for fault in found.faults]
    ['1 cell; the header has 3 columns', "column 'b' holds 'five'; allowed: numbers"]
    """
    import polars as pl

    allowed = tuple(cells) or (len(columns),)
    place = [f"c{i}" for i in range(max(len(columns), *allowed))]
    chosen = [place[list(columns).index(name)] for name in wanted]
    bytes_ = np.frombuffer(text, dtype=np.uint8)
    if bytes_.size == 0:
        return Cells(tuple(wanted), tuple(np.empty(0) for _ in wanted), np.empty(0, dtype=np.int64), 0)

    def parse(
        source: bytes | bytearray | memoryview, kind: type[pl.DataType], width: int = len(place)
    ) -> pl.DataFrame | None:
        kinds: dict[str, type[pl.DataType]] = dict.fromkeys(place[:width], pl.String)
        kinds |= dict.fromkeys(chosen, kind)
        try:
            return pl.read_csv(
                b"".join((",".join(kinds).encode(), b"\n", source)),
                schema=kinds,
                columns=list(dict.fromkeys([*chosen, place[width - 1]])),
                quote_char=None,
                truncate_ragged_lines=True,
                raise_if_empty=False,
            )
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException):
            return None

    lines = _count(bytes_, b"\n") + int(bytes_[-1] != _LINE_END)
    if bytes_.size >= compiled_from:
        from ldctoolkit.recordings.trips._text_kernels import plain_numbers

        for number in allowed:
            numbers = plain_numbers(bytes_, [place.index(name) for name in chosen], number, lines)
            if numbers is not None:
                return Cells(tuple(wanted), tuple(numbers), np.arange(lines), lines)
    commas = _count(bytes_, b",")
    exact = next((number for number in allowed if commas == lines * (number - 1)), 0)
    if exact and bytes_.max() < 128:
        frame = parse(text, pl.Float64, exact)
        # the last cell is nowhere missing, so no line is short; the sum then says that none is long
        if frame is not None and frame.height == lines and frame[place[exact - 1]].null_count() == 0:
            return Cells(tuple(wanted), _arrays(frame.select(chosen)), np.arange(lines), lines)
    row, source, faults = _survey(bytes(text), bytes_, allowed)
    frame = parse(source, pl.Float64)
    if frame is None or frame.height != row.size:
        frame = parse(source, pl.String)
        if frame is None or frame.height != row.size:  # a text that the library itself cannot split
            told = RowFault(int(row[0]) if row.size else 0, "unreadable", "these lines cannot be split into cells")
            return Cells(tuple(wanted), tuple(np.empty(0) for _ in wanted), np.empty(0, dtype=np.int64), lines, (told,))
        frame, row, words = _numbers(frame.select(chosen), row, wanted)
        faults = sorted([*faults, *words], key=lambda fault: fault.row)
    return Cells(tuple(wanted), _arrays(frame.select(chosen)), row, lines, tuple(faults))


def _count(bytes_: npt.NDArray[np.uint8], one: bytes) -> int:
    """How often a byte occurs; in pieces that stay in the cache."""
    pieces = (bytes_[begin : begin + _PIECE] for begin in range(0, bytes_.size, _PIECE))
    return sum(int(np.count_nonzero(piece == ord(one))) for piece in pieces)


def _arrays(frame: pl.DataFrame) -> tuple[FloatArray, ...]:
    return tuple(frame[name].fill_null(float("nan")).to_numpy() for name in frame.columns)


def _survey(
    text: bytes, bytes_: npt.NDArray[np.uint8], allowed: tuple[int, ...]
) -> tuple[IntArray, bytes, list[RowFault]]:
    """Lines that have the right number of cells, their text, and what is wrong with the others."""
    ends = np.flatnonzero(bytes_ == 10)
    if bytes_[-1] != 10:
        ends = np.append(ends, bytes_.size)
    starts = np.concatenate([[0], ends[:-1] + 1])
    found = np.diff(np.searchsorted(np.flatnonzero(bytes_ == 44), ends), prepend=0) + 1
    good = np.isin(found, allowed)
    faults: list[RowFault] = []
    plural = " or ".join(map(str, allowed))
    for i in np.flatnonzero(~good):
        if not text[starts[i] : ends[i]].strip():
            continue
        cells = "1 cell" if found[i] == 1 else f"{found[i]} cells"
        faults.append(RowFault(int(i), "cells", f"{cells}; the header has {plural} columns"))
    strange = np.unique(np.searchsorted(ends, np.flatnonzero(bytes_ >= 128)))
    for i in strange[good[strange]]:
        try:
            text[starts[i] : ends[i]].decode("utf-8")
        except UnicodeDecodeError as error:
            good[i] = False
            faults.append(RowFault(int(i), "encoding", f"the text is not UTF-8 ({error.reason})"))
    if not good.all():
        # runs of good lines are copied as they are
        change = np.flatnonzero(np.diff(good.astype(np.int8), prepend=0, append=0))
        text = b"".join(text[starts[a] : ends[b - 1] + 1] for a, b in change.reshape(-1, 2))
    return np.flatnonzero(good), text, sorted(faults, key=lambda fault: fault.row)


def _numbers(
    frame: pl.DataFrame, row: IntArray, wanted: Sequence[str]
) -> tuple[pl.DataFrame, IntArray, list[RowFault]]:
    """Words as numbers; rows with a word that is neither a number nor stands for none are left out."""
    import polars as pl

    words = frame.with_columns(pl.all().str.strip_chars(_BLANKS))
    values = words.with_columns(pl.all().cast(pl.Float64, strict=False))
    bad = np.zeros(row.size, dtype=bool)
    faults: list[RowFault] = []
    for column, name in zip(frame.columns, wanted, strict=True):
        wrong = values[column].is_null() & ~words[column].str.to_lowercase().is_in(MISSING).fill_null(True)
        new = np.flatnonzero(wrong.to_numpy() & ~bad)
        texts = words[column].gather(new).to_list()
        faults += [
            RowFault(int(row[i]), "number", f"column {name!r} holds {text[:40]!r}; allowed: numbers")
            for i, text in zip(new, texts, strict=True)
        ]
        bad[new] = True
    return values.filter(pl.Series(~bad)), row[~bad], faults
