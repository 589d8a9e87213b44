"""What happens to text files on their way: cut, mixed up, edited by hand, saved by a spreadsheet, rotten.

A damage is an operation with numbers that say where; so it is shown in short, and made smaller when it finds a fault.
"""

import contextlib
import gzip
import io
import zlib
from collections.abc import Callable
from pathlib import Path

import polars as pl
from hypothesis import strategies as st

Files = dict[str, bytes]
Damage = tuple[str, int, int, bytes]  # operation, two numbers that say where, and bytes to put there

ODD = (
    *(
        b"",
        b" ",
        b"NULL",
        b"nan",
        b"N/A",
        b"inf",
        b"-inf",
        b"-0.0",
        b"0",
        b"1",
        b"-1",
        b"+1",
        b"1.",
        b".",
        b"e5",
        b"1e",
    ),
    *(b"1e9", b"1e11", b"1e15", b"1e308", b"1e309", b"4.9e-324", b"9007199254740993", b"18446744073709551616"),
    *(b"9" * 40, b"0x10", b"1_000", b"true", b"left", b"#N/A", b"1,5", b"1;5", b'"', b'""', b'"1', b"7,1", b"r0"),
    *(word.encode() for word in ("\u0661\u0662", "\uff11", "\u22125", "\ufeff1", "\u2028")),
    *(b"\0", b"\x1a", b"\x1b[31m", b"\r", b"\n", b"\r\n", b"\n\n", b"\xff", b"\xed\xa0\x80", b"\xff\xfe"),
)
FACTORS = (-1.0, 0.0, 1e-3, 0.01, 0.1, 3.6, 57.3, 100.0, 1e3, 1e6, 1e15, 1e300)
ENCODINGS = ("utf-16", "utf-16-be", "utf-32", "utf-8-sig", "cp037")
MARKS = (b";", b"\t", b"|", b" ", b", ", b"\0")
ENDS = (b"\r\n", b"\r", b"\n\n", b"\r\r\n", b" ")


def _mark(data: bytes) -> bytes:
    """What parts the cells."""
    return b"," if b"," in data else b" "


def _cells(data: bytes, change: Callable[[list[bytes]], object], first: int = 0, count: int | None = None) -> bytes:
    """Change the cells of some lines, all by default."""
    mark, lines = _mark(data), data.split(b"\n")
    first %= max(len(lines), 1)
    for i in range(first, len(lines) if count is None else min(first + count, len(lines))):
        if lines[i]:
            cells = lines[i].split(mark)
            change(cells)
            lines[i] = mark.join(cells)
    return b"\n".join(lines)


def _put(data: bytes, line: int, column: int, word: bytes, count: int | None = 1) -> bytes:
    return _cells(data, lambda cells: cells.__setitem__(column % len(cells), word), line, count)


def _scaled(data: bytes, a: int, b: int, count: int | None, offset: float = 0.0) -> bytes:
    def change(cells: list[bytes]) -> None:
        with contextlib.suppress(ValueError):
            value = float(cells[b % len(cells)])
            cells[b % len(cells)] = repr(value + offset if offset else value * FACTORS[a % len(FACTORS)]).encode()

    return _cells(data, change, 1 + a, count)


def _rows(data: bytes, change: Callable[[list[bytes], int], list[bytes]], a: int) -> bytes:
    """Change the lines behind the first."""
    head, *rows = data.split(b"\n")
    return b"\n".join([head, *change(rows, a % (len(rows) + 1))])


def _spliced(data: bytes, a: int, odd: bytes, gone: int = 0) -> bytes:
    a %= len(data) + 1
    return data[:a] + odd + data[a + gone :]


def _flipped(data: bytes, a: int, b: int) -> bytes:
    a %= max(len(data), 1)
    return data[:a] + bytes(one ^ (1 << b % 8) for one in data[a : a + 1]) + data[a + 1 :]


OPERATIONS: dict[str, Callable[[bytes, int, int, bytes], bytes]] = {
    "cut": lambda data, a, b, odd: data[: a % (len(data) + 1)],
    "cut_head": lambda data, a, b, odd: data[a % (len(data) + 1) :],
    "hole": lambda data, a, b, odd: _spliced(data, a, odd, b % 300),
    "insert": lambda data, a, b, odd: _spliced(data, a, odd * (1 + b % 3)),
    "flip": lambda data, a, b, odd: _flipped(data, a, b),
    "zeros": lambda data, a, b, odd: _spliced(data, a, b"\0" * (b % 5000), b % 5000),  # the power was lost
    "long": lambda data, a, b, odd: _spliced(data, a, (odd or b"1")[:1] * (70_000 if b % 8 else 1_200_000)),
    "drop_rows": lambda data, a, b, odd: _rows(data, lambda rows, at: rows[:at] + rows[at + b % 40 :], a),
    "repeat_rows": lambda data, a, b, odd: _rows(data, lambda rows, at: rows[: at + b % 40] + rows[at:], a),
    "reverse_rows": lambda data, a, b, odd: _rows(data, lambda rows, at: rows[:at] + rows[at:][::-1], a),
    "cell": lambda data, a, b, odd: _put(data, a, b, odd),
    "first_cells": lambda data, a, b, odd: _put(data, a, b % 3, odd),
    "cells_below": lambda data, a, b, odd: _put(data, a, b, odd, 1 + b % 60),
    "whole_column": lambda data, a, b, odd: _put(data, 1, b, odd, None),
    "name": lambda data, a, b, odd: _put(data, 0, b, odd),
    "scaled_cells": lambda data, a, b, odd: _scaled(data, a, b, 1 + b % 50),
    "shifted_cells": lambda data, a, b, odd: _scaled(data, a, b, None, FACTORS[b % len(FACTORS)] or 1.0),
    "drop_column": lambda data, a, b, odd: _cells(data, lambda cells: cells.pop(b % len(cells))),
    "more_cells": lambda data, a, b, odd: _cells(data, lambda cells: cells.append(odd), a, 1 + b % 20),
    "quoted": lambda data, a, b, odd: _cells(
        data, lambda cells: cells.insert(0, b'"' + cells.pop(0) + b'"'), a, b % 200
    ),
    "marks": lambda data, a, b, odd: data.replace(_mark(data), MARKS[a % len(MARKS)]),
    "decimal_commas": lambda data, a, b, odd: data.replace(b",", b";" if a % 2 else b",").replace(b".", b","),
    "ends": lambda data, a, b, odd: data.replace(b"\n", ENDS[a % len(ENDS)]),
    "encoding": lambda data, a, b, odd: data.decode("utf-8", "replace").encode(
        ENCODINGS[a % len(ENCODINGS)], "replace"
    ),
    "twice": lambda data, a, b, odd: data + data,
    "packed": lambda data, a, b, odd: gzip.compress(data, 1, mtime=0),
}

_MILD = ("cell", "first_cells", "scaled_cells", "cells_below", "shifted_cells", "flip")
"""What leaves most of a file as it was; these come more often, else hardly a departure would be left."""

WORDS = st.sampled_from(ODD) | st.binary(max_size=40)
_NUMBERS = st.integers(0, 99_999)
DAMAGES = st.tuples(st.sampled_from([*OPERATIONS, *_MILD, *_MILD]), _NUMBERS, _NUMBERS, WORDS)


def damaged(data: bytes, damages: list[Damage], packed: bool = False) -> bytes:
    """The bytes with one damage after the other; of a gzip file, half of the first numbers hit what is inside."""
    for operation, a, b, word in damages:
        act = OPERATIONS[operation]
        if packed and a % 2:
            try:
                data = gzip.compress(act(gzip.decompress(data), a // 2, b, word), 1, mtime=0)
                continue
            except (OSError, EOFError, zlib.error):
                pass
        # a million equal bytes inside a gzip file may stand for millions of lines, which take longer than a hang
        data = act(data, a, b | 1 if packed and operation == "long" else b, word)
    return data


def _damaged_parquet(data: bytes, damages: list[Damage]) -> bytes:
    """Damage to the table's text, or to the file's bytes."""
    for operation, a, b, word in damages:
        if a % 3 == 0:
            data = OPERATIONS[operation](data, a, b, word)
            continue
        with contextlib.suppress(
            pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, TypeError
        ):
            text = OPERATIONS[operation](pl.read_parquet(io.BytesIO(data)).write_csv().encode(), a // 3, b, word)
            rows = pl.read_csv(
                text, infer_schema=a % 3 == 1, ignore_errors=True, truncate_ragged_lines=True, encoding="utf8-lossy"
            )
            stream = io.BytesIO()
            rows.write_parquet(stream, compression="uncompressed")
            data = stream.getvalue()
    return data


class Changed(dict[str, bytes]):
    """Content of files by name, shown as what was done to them."""

    story: tuple[object, ...] = ()

    def __repr__(self) -> str:
        return f"{sorted(self)} after {self.story}"


@st.composite
def files_changed(draw: st.DrawFn, shapes: tuple[Files, ...]) -> Files:
    """A set of files, of which some are damaged, missing, renamed, or in each other's place."""
    files = Changed(draw(st.sampled_from(shapes)))
    names = list(files)
    for name in draw(st.lists(st.sampled_from(names), min_size=1, max_size=2)):
        damages = draw(st.lists(DAMAGES, max_size=3))
        files.story += ((name, *damages),)
        if name.endswith(".parquet"):
            files[name] = _damaged_parquet(files[name], damages)
        else:
            files[name] = damaged(files[name], damages, name.endswith(".gz"))
    change = draw(st.sampled_from((*[""] * 9, "drop", "rename", "swap")))
    a, b = draw(st.sampled_from(names)), draw(st.sampled_from(names))
    if change:
        files.story += ((change, a, b),)
    if change == "drop":
        del files[a]
    elif change == "rename":
        other = draw(st.sampled_from(("DataLane.csv", "a.parquet", "RAW_GPS.txt", a.upper(), f"more/{a}")))
        files[other] = files.pop(a)
    elif change == "swap":
        files[a], files[b] = files[b], files[a]
    return files


def write(root: Path, files: Files) -> list[Path]:
    """Write files below a folder; one whose place is taken is passed over."""
    written = []
    for name, content in files.items():
        path = root / name
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            written.append(path)
    return written
