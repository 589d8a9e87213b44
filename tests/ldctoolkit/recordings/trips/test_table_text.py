import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.trip_index import TEXT_COMPILED_FROM, read_cells

COLUMNS = ("a", "b", "c", "d")
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


def by_hand(text: bytes, wanted: tuple[str, ...]) -> tuple[list[tuple[int, list[float]]], list[int]]:
    """Rows that can be used, and the places of those that cannot."""
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
        values = [number(cells[COLUMNS.index(name)]) for name in wanted] if len(cells) == 4 else [None]
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
@given(
    text=text,
    wanted=st.sampled_from([("a", "b", "c", "d"), ("b",), ("d", "a")]),
    compiled_from=st.sampled_from([0, TEXT_COMPILED_FROM]),
)
@example(text=b"1,2,3\n1,2,3,4,5\n", wanted=("a", "d"), compiled_from=0)
@example(text=b"1,2,3\n1,2,3,4,5\n", wanted=("a", "d"), compiled_from=TEXT_COMPILED_FROM)
@example(text=b"1,2,3,4\n1,2,x,4", wanted=("a", "d"), compiled_from=0)
@example(text=b"1,2,3,e0\n", wanted=("d",), compiled_from=0)
@example(text=b"1,2,3,", wanted=("d",), compiled_from=0)
def test_cells_are_those_that_python_reads(text: bytes, wanted: tuple[str, ...], compiled_from: int) -> None:
    found = read_cells(text, COLUMNS, wanted, compiled_from=compiled_from)
    rows, bad = by_hand(text, wanted)
    assert (found.row.tolist(), sorted(fault.row for fault in found.faults)) == ([row for row, _ in rows], bad)
    for i, name in enumerate(wanted):
        np.testing.assert_array_equal(found[name], [values[i] for _, values in rows])


@examples(200)
@given(lines=st.lists(line, max_size=12), at=st.integers(0, 12))
def test_a_text_in_two_pieces_gives_the_same(lines: list[bytes], at: int) -> None:
    """What a line gives does not depend on the others: not on the way they had to be parsed."""
    lines = [one + b"\n" for one in lines]
    whole = read_cells(b"".join(lines), COLUMNS, COLUMNS)
    pieces = [read_cells(b"".join(some), COLUMNS, COLUMNS) for some in (lines[:at], lines[at:])]
    for name in COLUMNS:
        np.testing.assert_array_equal(whole[name], np.concatenate([piece[name] for piece in pieces]))
    reported = [(f.row + shift, f.what) for piece, shift in zip(pieces, (0, at), strict=True) for f in piece.faults]
    assert [(fault.row, fault.what) for fault in whole.faults] == reported


PLAIN = st.one_of(
    st.integers(-(10**19), 10**19).map(str),
    st.floats(-1e6, 1e6).map(repr),
    st.floats(-1e6, 1e6).map(lambda value: f"{value:.7E}"),
    st.builds(lambda a, b: f"{a}.{b}", st.integers(-(10**6), 10**6), st.text("0123456789", max_size=14)),
    st.builds(lambda a, b: f"{a}e{b}", st.integers(-(10**16), 10**16), st.integers(-30, 30)),
    st.sampled_from(["", "-0", "-0.0", "0.1", "9007199254740993", "9007199254740992", "1.", "-.5"]),
)


@examples(300)
@given(rows=st.lists(st.tuples(PLAIN, PLAIN), min_size=1, max_size=8), end=st.sampled_from(["\n", "\r\n"]))
def test_the_compiled_parser_rounds_as_python_does(rows: list[tuple[str, str]], end: str) -> None:
    text = "".join(f"7,{one},x y,{other}{end}" for one, other in rows).encode()
    found = read_cells(text, COLUMNS, ("b", "d"), compiled_from=0)
    for name, cells in zip("bd", zip(*rows, strict=True), strict=True):
        expected = np.array([float(cell or "nan") for cell in cells])
        np.testing.assert_array_equal(found[name], expected)
        np.testing.assert_array_equal(np.signbit(found[name]), np.signbit(expected))


@pytest.mark.parametrize("compiled_from", [0, TEXT_COMPILED_FROM])
@pytest.mark.parametrize("line", [b"1,2,3,4\n", b"1,2,3,4,,\n", b"1,2,3,4,5,6\r\n"])
def test_every_allowed_number_of_cells_alone(line: bytes, compiled_from: int) -> None:
    found = read_cells(line * 3, COLUMNS, ("d", "a"), cells=(4, 6), compiled_from=compiled_from)
    assert (found["d"].tolist(), found["a"].tolist()) == ([4.0] * 3, [1.0] * 3)
    assert found.faults == ()


def test_several_numbers_of_cells() -> None:
    found = read_cells(b"1,2,3,4\n5,6,7,8,9,10\n1,2,3,4,5\n", COLUMNS, ("d",), cells=(4, 6))
    assert found["d"].tolist() == [4.0, 8.0]
    assert [(fault.row, fault.what) for fault in found.faults] == [(2, "5 cells; the header has 4 or 6 columns")]
