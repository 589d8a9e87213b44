"""Tables of trips: numbers in their text, and where each trip lies."""

import dataclasses
import hashlib
import math
import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from helpers.bits import examples
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import trip_tables
from ldctoolkit.recordings.text_table import Cells, Layout, read_numbers
from ldctoolkit.recordings.trip_tables import Stretch, TripIndex, index_trips

COLUMNS = ("a", "b", "c", "d")


def numbers_in(text: bytes, names: tuple[str, ...] = COLUMNS, cells: tuple[int, ...] = (4,)) -> Cells:
    return read_numbers(text, Layout({name: COLUMNS.index(name) for name in names}, cells))


WORDS = ("", "null", "nan", "na", "n/a", "none", "-nan", "#n/a")


def number(cell: str) -> float | None:
    """None for a word that is no number."""
    cell = cell.strip(" \t\r\"'")
    if cell.lower() in WORDS:
        return math.nan
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def by_hand(text: bytes, names: tuple[str, ...]) -> tuple[list[tuple[int, list[float]]], list[int]]:
    """Rows that can be used, and the line indices of those that cannot."""
    rows: list[tuple[int, list[float]]] = []
    bad: list[int] = []
    lines = text.split(b"\n")
    for i, line in enumerate(lines[:-1] if lines[-1] == b"" else lines):
        if not line.strip() and b"," not in line:
            continue
        try:
            cells = line.decode("utf-8").split(",")
        except UnicodeDecodeError:
            bad.append(i)
            continue
        values = [number(cells[COLUMNS.index(name)]) for name in names] if len(cells) == 4 else [None]
        if any(value is None for value in values):
            bad.append(i)
        else:
            rows.append((i, [value for value in values if value is not None]))
    return rows, bad


cell = st.one_of(
    st.integers(-(10**6), 10**6).map(str),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.floats(-1e3, 1e3).map(lambda value: f"{value:.7E}"),
    st.sampled_from(
        ["", "NULL", "NaN", "  12  ", '"3"', "'4'", "+5", "-.5", "6.", ".5", "1e5", "1E-3", "-9.5000006E-3", "x", "1 2",
         "0x1", "1_0", "--1", "e5", ".", "-", "+", "1e", "\t7", "8\t", "infinity1", "ä", "1,5", "1\r", "é1", "0012",
         "1e400"]
    ),
)  # fmt: skip
line = st.one_of(
    st.lists(cell, min_size=4, max_size=4).map(lambda cells: ",".join(cells).encode()),
    st.lists(st.integers(-999, 999).map(str), min_size=4, max_size=4).map(lambda cells: ",".join(cells).encode()),
    st.lists(cell, max_size=6).map(lambda cells: ",".join(cells).encode()),
    st.sampled_from([b"", b"   ", b"\xff,1,2,3", b"1,2,3,\x80", b"1,2,3,4,", b",,,"]),
)
text = st.builds(
    lambda lines, end, last: end.join([*lines, b""] if last else lines), st.lists(line, max_size=12),
    st.sampled_from([b"\n", b"\r\n"]), st.booleans(),
)  # fmt: skip


@examples(300)
@given(text=text, names=st.sampled_from([("a", "b", "c", "d"), ("b",), ("d", "a")]))
@example(text=b"1,2,3\n1,2,3,4,5\n", names=("a", "d"))
@example(text=b"1,2,3,4,5\n1,2,3\n", names=("a", "d"))
@example(text=b"1,2,3,4\n1,2,x,4", names=("a", "d"))
@example(text=b"1,2,3,e0\n", names=("d",))
@example(text=b"1,2,3,", names=("d",))
def test_cells_are_those_that_python_reads(text: bytes, names: tuple[str, ...]) -> None:
    cells = numbers_in(text, names)
    rows, bad = by_hand(text, names)
    assert (cells.row.tolist(), [fault.line for fault in cells.faults]) == ([row for row, _ in rows], bad)
    for i, name in enumerate(names):
        np.testing.assert_array_equal(cells[name], [values[i] for _, values in rows])


@examples(200)
@given(lines=st.lists(line, max_size=12), cut=st.integers(0, 12))
def test_a_text_in_two_pieces_gives_the_same(lines: list[bytes], cut: int) -> None:
    """What a line gives does not depend on the others: not on the way they had to be parsed."""
    lines = [text + b"\n" for text in lines]
    whole = numbers_in(b"".join(lines))
    pieces = [numbers_in(b"".join(piece_lines)) for piece_lines in (lines[:cut], lines[cut:])]
    for name in COLUMNS:
        np.testing.assert_array_equal(whole[name], np.concatenate([piece[name] for piece in pieces]))
    reported = [(f.line + shift, f.what) for piece, shift in zip(pieces, (0, cut), strict=True) for f in piece.faults]
    assert [(fault.line, fault.what) for fault in whole.faults] == reported


@pytest.mark.parametrize("line", [b"1,2,3,4\n", b"1,2,3,4,,\n", b"1,2,3,4,5,6\r\n"])
def test_every_allowed_number_of_cells_alone(line: bytes) -> None:
    cells = numbers_in(line * 3, ("d", "a"), (4, 6))
    assert (cells["d"].tolist(), cells["a"].tolist()) == ([4.0] * 3, [1.0] * 3)
    assert cells.faults == ()


def test_several_numbers_of_cells() -> None:
    cells = numbers_in(b"1,2,3,4\n5,6,7,8,9,10\n1,2,3,4,5\n", ("d",), (4, 6))
    assert cells["d"].tolist() == [4.0, 8.0]
    assert [(fault.line, fault.what) for fault in cells.faults] == [(2, "5 cells; allowed: 4 or 6")]


HEADER = b"Device,Trip,Time\r\n"


def indexed(text: bytes, **options: int) -> TripIndex:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.csv")
        path.write_bytes(HEADER + text)
        return index_trips(path, len(HEADER), 2, **options)


def stretches_by_hand(text: bytes) -> tuple[list[Stretch], list[int]]:
    """Line after line."""
    stretches: list[Stretch] = []
    faults: list[int] = []
    open_ = False
    end = len(HEADER)
    lines = text.split(b"\n")
    whole = [line + b"\n" for line in lines[:-1]] + ([lines[-1]] if lines[-1] else [])
    for number, line in enumerate(whole, 2):
        begin, end = end, end + len(line)
        cells = line.split(b",")
        if not line.strip():
            if open_:
                last = stretches.pop()
                stretches.append(dataclasses.replace(last, end=end, lines=last.lines + 1))
            continue
        key = [cell.strip(b" \t") for cell in cells[:2]]
        if len(cells) < 3 or not all(re.fullmatch(rb"-?\d+(\.0*)?", cell) for cell in key):
            faults.append(number)
            open_ = False
            continue
        device, trip = (int(float(cell)) for cell in key)
        if open_ and (stretches[-1].device, stretches[-1].trip) == (device, trip):
            last = stretches.pop()
            stretches.append(dataclasses.replace(last, end=end, lines=last.lines + 1))
        else:
            stretches.append(Stretch(device, trip, begin, end, number, 1, len(faults)))
        open_ = True
    return stretches, faults


keyed_line = st.one_of(
    st.builds(
        lambda device, trip, rest: f"{device},{trip},{rest}".encode(),
        st.sampled_from(["7", "71", "7 ", " 8", "8.0", "-3"]),
        st.sampled_from(["1", "12", "1 ", "2", "123456"]),
        st.text("0123456789,.-E \t", max_size=30),
    ),
    st.sampled_from([b"", b"  ", b"junk", b"7,1", b"7,x,1", b",,", b"\xff\xfe", b"7;1;2", b"1_0,1,2"]),
)
keyed_text = st.builds(
    lambda lines, end, last: end.join([*lines, b""] if last else lines),
    st.lists(keyed_line.flatmap(lambda one: st.integers(1, 40).map(lambda n: [one] * n)), max_size=12).map(
        lambda runs: [line for run in runs for line in run]
    ),
    st.sampled_from([b"\n", b"\r\n"]),
    st.booleans(),
)


@pytest.mark.slow
@examples(150)
@given(text=keyed_text, block_bytes=st.sampled_from([1, 7, 64, 1000, 1 << 20]))
def test_stretches_are_those_of_a_line_by_line_search(text: bytes, block_bytes: int) -> None:
    index = indexed(text, block_bytes=block_bytes)
    stretches, faults = stretches_by_hand(text)
    assert (list(index.stretches), [fault.line for fault in index.faults]) == (stretches, faults[:20])
    assert (index.more_faults, index.bytes) == (len(faults[20:]), len(HEADER + text))
    assert index.sha256 == hashlib.sha256(HEADER + text).hexdigest()


@examples(100)
@given(text=st.binary(max_size=400), block_bytes=st.integers(1, 60))
def test_any_bytes_give_whole_lines(text: bytes, block_bytes: int) -> None:
    whole, parts = indexed(text), indexed(text, block_bytes=block_bytes)
    assert whole == parts
    content = HEADER + text
    for stretch in whole.stretches:
        assert content[stretch.begin - 1 : stretch.begin] == b"\n"
        assert content[stretch.end - 1 : stretch.end] == b"\n" or stretch.end == len(content)
        assert stretch.line == content.count(b"\n", 0, stretch.begin) + 1


def test_rows_that_are_not_sorted_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trip_tables, "MOST_STRETCHES", 10)
    with pytest.raises(RecordingError, match=r"line 12: more than 10 stretches .*sorted by device, trip and time"):
        indexed(b"7,1,0\n7,2,0\n" * 20)
