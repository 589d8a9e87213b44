"""Everything that happens to text files on their way: cut, mixed up, edited by hand, saved by a spreadsheet, rotten.

A damage is an operation with numbers that say where; so it is shown in short, and made smaller when it finds a fault.
"""

import contextlib
import gzip
import io
import zlib
from collections.abc import Callable

import polars as pl
from hypothesis import strategies as st

Files = dict[str, bytes]
Damage = tuple[str, int, int, bytes]  # operation, two numbers that say where, and bytes to put there

WORDS_OF_TEXT = tuple(
    word.encode()
    for word in (
        *("", " ", "\t", "NULL", "nan", "-nan", "NaN", "N/A", "inf", "-inf", "Infinity", "-0", "-0.0", "0", "1", "2"),
        *("-1", "+1", "--1", "1.", ".", ".5", "e5", "1e", "1e+", "1e5", "-1e5", "1e9", "1e11", "99999999999", "1e15"),
        *("1e20", "1e308", "-1e308", "1e309", "1e-320", "4.9e-324", "9007199254740993", "9223372036854775807"),
        *("9223372036854775808", "-9223372036854775809", "18446744073709551616", "9" * 40, "0" * 40 + "1", "0x10"),
        *("1_000", "true", "TRUE", "left", "=1+1", "#N/A", "1,5", "1;5", "1 5", '"', '""', '"1"', '"1', "'1'", '1"2'),
        *("\u0661\u0662\u0663", "\uff11", "\u00bd", "\u22125", "\u00a05", "\ufeff1", "\U0001d7cf", "\u00e9", "\u2028"),
        *("\0", "\x1a", "\x0b", "\x0c", "\x1b[31m", "\x85", "\r", "\n", "\r\n", "\n\n", "r0", "7", "7,1", "{", "\\"),
    )
)
NO_TEXT = (b"\xff", b"\x80", b"\xed\xa0\x80", b"\xc3", b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf", b"\xe9", b"\xf8\x88")
ODD = (*WORDS_OF_TEXT, *NO_TEXT)

FACTORS = (-1.0, 0.0, 1e-3, 1e-6, 0.01, 0.1, 0.5, 3.6, 10.0, 57.3, 100.0, 1e3, 1e6, 1e9, 1e15, 1e100, 1e300, -1e300)


def _lines(data: bytes) -> list[bytes]:
    return data.split(b"\n")


def _mark(data: bytes) -> bytes:
    """What parts the cells."""
    return b"," if b"," in data else b" "


def _columns(data: bytes, change: Callable[[list[bytes]], None], first: int = 0, count: int | None = None) -> bytes:
    """Change the cells of some lines, all by default."""
    mark, lines = _mark(data), _lines(data)
    for i in range(first, len(lines) if count is None else min(first + count, len(lines))):
        if lines[i]:
            cells = lines[i].split(mark)
            change(cells)
            lines[i] = mark.join(cells)
    return b"\n".join(lines)


def _put(data: bytes, line: int, column: int, word: bytes, count: int | None = 1) -> bytes:
    def change(cells: list[bytes]) -> None:
        cells[column % len(cells)] = word

    return _columns(data, change, line % max(len(_lines(data)), 1), count)


def _rows(data: bytes, change: Callable[[list[bytes]], list[bytes]]) -> bytes:
    """Change the lines behind the first."""
    lines = _lines(data)
    return b"\n".join([lines[0], *change(lines[1:])])


def _add(cells: list[bytes], column: int, factor: float, offset: float) -> None:
    with contextlib.suppress(ValueError):
        cells[column % len(cells)] = repr(float(cells[column % len(cells)]) * factor + offset).encode()


def _swap(items: list, a: int, b: int) -> list:
    if items:
        a, b = a % len(items), b % len(items)
        items[a], items[b] = items[b], items[a]
    return items


def _recoded(data: bytes, encoding: str) -> bytes:
    return data.decode("utf-8", "replace").encode(encoding, "replace")


ENCODINGS = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "utf-7", "cp037")
MARKS = (b";", b"\t", b"|", b" ", b",", b", ", b"\0")
ENDS = (b"\r\n", b"\r", b"\n\n", b"\r\r\n", b"\n\r", b"\0\n", b" ", b"\x0b", b"\x1e")


def _hole(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    a %= len(data) + 1
    return data[:a] + odd + data[a + b % 300 :]


def _insert(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    a %= len(data) + 1
    return data[:a] + odd * (1 + b % 3) + data[a:]


def _flip(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    if not data:
        return data
    a %= len(data)
    return data[:a] + bytes([data[a] ^ (1 << b % 8)]) + data[a + 1 :]


def _repeat_rows(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    def change(rows: list[bytes]) -> list[bytes]:
        at = a % (len(rows) + 1)
        return rows[:at] + rows[at : at + b % 40] * 2 + rows[at:]

    return _rows(data, change)


def _move_rows(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    def change(rows: list[bytes]) -> list[bytes]:
        at = a % (len(rows) + 1)
        piece, rest = rows[at : at + 20], rows[:at] + rows[at + 20 :]
        to = b % (len(rest) + 1)
        return rest[:to] + piece + rest[to:]

    return _rows(data, change)


def _scaled_cells(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    first = 1 + a % max(len(_lines(data)), 1)
    return _columns(data, lambda cells: _add(cells, b, FACTORS[(a ^ b) % len(FACTORS)], 0.0), first, 1 + b % 50)


def _shifted_cells(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    first = 1 + a % max(len(_lines(data)), 1)
    return _columns(data, lambda cells: _add(cells, b, 1.0, FACTORS[(a ^ b) % len(FACTORS)]), first, None)


def _swap_columns(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    def change(cells: list[bytes]) -> None:
        _swap(cells, a, b)

    return _columns(data, change, a % 2)


def _quoted(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    def change(cells: list[bytes]) -> None:
        cells[:] = [b'"' + cell + b'"' for cell in cells]

    return _columns(data, change, a % max(len(_lines(data)), 1), b % 200)


def _marks_in_part(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    a %= len(data) + 1
    return data[:a] + data[a : a + 500].replace(_mark(data), MARKS[b % len(MARKS)]) + data[a + 500 :]


def _mixed_encodings(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    lines = _lines(data)
    at = a % (len(lines) + 1)
    return b"\n".join(lines[:at]) + b"\n" + _recoded(b"\n".join(lines[at:]), ENCODINGS[b % len(ENCODINGS)])


def _zeros(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    """What a machine leaves that loses its power while it writes."""
    a %= len(data) + 1
    return data[:a] + b"\0" * (b % 5000) + data[a + b % 5000 :]


def _long(data: bytes, a: int, b: int, odd: bytes) -> bytes:
    a %= len(data) + 1
    return data[:a] + (odd or b"1")[:1] * (70_000 if b % 8 else 1_200_000) + data[a:]


OPERATIONS: dict[str, Callable[[bytes, int, int, bytes], bytes]] = {
    "cut": lambda data, a, b, odd: data[: a % (len(data) + 1)],
    "cut_head": lambda data, a, b, odd: data[a % (len(data) + 1) :],
    "all": lambda data, a, b, odd: odd * (1 + a % 4),
    "swap_lines": lambda data, a, b, odd: b"\n".join(_swap(_lines(data), a, b)),
    "swap_rows": lambda data, a, b, odd: _rows(data, lambda rows: _swap(rows, a, b)),
    "drop_rows": lambda data, a, b, odd: _rows(
        data, lambda rows: rows[: a % (len(rows) + 1)] + rows[a % (len(rows) + 1) + b % 40 :]
    ),
    "reverse_rows": lambda data, a, b, odd: _rows(data, lambda rows: rows[::-1]),
    "shuffle_rows": lambda data, a, b, odd: _rows(data, lambda rows: sorted(rows, key=lambda row: zlib.crc32(row, a))),
    "cell": lambda data, a, b, odd: _put(data, a, b, odd),
    "first_cells": lambda data, a, b, odd: _put(data, a, b % 3, odd),
    "cells_below": lambda data, a, b, odd: _put(data, a, b, odd, 1 + b % 60),
    "whole_column": lambda data, a, b, odd: _put(data, 1, b, odd, None),
    "name": lambda data, a, b, odd: _put(data, 0, b, odd),
    "scaled_column": lambda data, a, b, odd: _columns(
        data, lambda cells: _add(cells, b, FACTORS[a % len(FACTORS)], 0.0), 1
    ),
    "drop_column": lambda data, a, b, odd: _columns(data, lambda cells: cells.__delitem__(b % len(cells))),
    "double_column": lambda data, a, b, odd: _columns(
        data, lambda cells: cells.insert(a % (len(cells) + 1), cells[b % len(cells)])
    ),
    "more_cells": lambda data, a, b, odd: _columns(
        data, lambda cells: cells.extend([odd] * (1 + b % 3)), a % max(len(_lines(data)), 1), 1 + b % 20
    ),
    "marks": lambda data, a, b, odd: data.replace(_mark(data), MARKS[a % len(MARKS)]),
    "decimal_commas": lambda data, a, b, odd: (
        data.replace(b",", b";").replace(b".", b",") if a % 2 else data.replace(b".", b",")
    ),
    "ends": lambda data, a, b, odd: data.replace(b"\n", ENDS[a % len(ENDS)]),
    "encoding": lambda data, a, b, odd: _recoded(data, ENCODINGS[a % len(ENCODINGS)]),
    "twice": lambda data, a, b, odd: data + data,
    "packed": lambda data, a, b, odd: gzip.compress(data, 1, mtime=0),
    "hole": _hole,
    "insert": _insert,
    "flip": _flip,
    "repeat_rows": _repeat_rows,
    "move_rows": _move_rows,
    "scaled_cells": _scaled_cells,
    "shifted_cells": _shifted_cells,
    "swap_columns": _swap_columns,
    "quoted": _quoted,
    "marks_in_part": _marks_in_part,
    "mixed_encodings": _mixed_encodings,
    "zeros": _zeros,
    "long": _long,
}

_MILD = ("cell", "first_cells", "scaled_cells", "scaled_column", "cells_below", "shifted_cells", "swap_rows", "flip")
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


_TYPES = ("Int8", "UInt64", "Float32", "String", "Boolean", "Date", "Datetime", "Duration", "Time", "Categorical")
_TYPES += ("Binary", "Decimal", "Null", "List", "Struct", "Int128")


def _retyped(data: bytes, number: int, kind: str) -> bytes:
    """A Parquet table with one column of another type, as far as its values allow."""
    table = pl.read_parquet(io.BytesIO(data))
    name = table.columns[number % table.width]
    column = table[name]
    if kind == "List":
        column = column.reshape((-1, 1)).arr.to_list()
    elif kind == "Struct":
        column = column.to_frame("a").to_struct(name)
    else:
        text = column.cast(pl.String) if kind in ("Binary", "Categorical") else column
        type_ = pl.Decimal(20, 3) if kind == "Decimal" else getattr(pl, kind)
        column = text.cast(type_, strict=False)
    stream = io.BytesIO()
    table.with_columns(column.alias(name)).write_parquet(stream, compression="uncompressed")
    return stream.getvalue()


def _damaged_parquet(data: bytes, damages: list[Damage]) -> bytes:
    """Damage to the table's values, to their types, or to the file's bytes."""
    for operation, a, b, word in damages:
        way = a % 4
        if way == 3:
            data = OPERATIONS[operation](data, a, b, word)
            continue
        try:
            if way == 0:
                data = _retyped(data, a, _TYPES[b % len(_TYPES)])
                continue
            text = OPERATIONS[operation](pl.read_parquet(io.BytesIO(data)).write_csv().encode(), a // 4, b, word)
            rows = pl.read_csv(
                text, infer_schema=way == 1, ignore_errors=True, truncate_ragged_lines=True, encoding="utf8-lossy"
            )
            stream = io.BytesIO()
            rows.write_parquet(stream, compression="uncompressed")
            data = stream.getvalue()
        except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError, TypeError):
            pass  # such a table cannot be made
    return data


class Changed(dict[str, bytes]):
    """Content of files by name, shown as what was done to them."""

    def __init__(self, files: Files) -> None:
        super().__init__(files)
        self.story: list[tuple] = []

    def __repr__(self) -> str:
        return f"{sorted(self)} after {self.story}"


@st.composite
def files_changed(draw: st.DrawFn, shapes: tuple[Files, ...]) -> Files:
    """A set of files, of which some are damaged, missing, renamed, doubled or in each other's place."""
    files = Changed(draw(st.sampled_from(shapes)))
    names = list(files)
    hit = draw(st.lists(st.sampled_from(names), min_size=1, max_size=2))
    for name in hit:
        damages = draw(st.lists(DAMAGES, max_size=3))
        files.story.append((name, *damages))
        if name.endswith(".parquet"):
            files[name] = _damaged_parquet(files[name], damages)
        else:
            files[name] = damaged(files[name], damages, name.endswith(".gz"))
    change = draw(st.sampled_from((*[""] * 9, "drop", "rename", "double", "swap", "folder", "mixed")))
    a, b = draw(st.sampled_from(names)), draw(st.sampled_from(names))
    if change:
        files.story.append((change, a, b))
    if change == "drop":
        del files[a]
    elif change == "rename":
        files[draw(st.sampled_from(_renamed(a)))] = files.pop(a)
    elif change == "double":
        files[draw(st.sampled_from(_renamed(a)))] = draw(st.sampled_from((files[a], shapes[0].get(a, files[a]))))
    elif change == "swap":
        files[a], files[b] = files[b], files[a]
    elif change == "folder":
        files[f"{a}/inside.csv"] = files.pop(a)
    elif change == "mixed":
        files["HV_Primary.csv" if "HV_Primary.csv" not in files else "DataLane.csv"] = files[a]
    return files


def _renamed(name: str) -> tuple[str, ...]:
    folder, _, last = name.rpartition("/")
    stem, _, suffix = last.partition(".")
    names = (
        f"{stem}_2.{suffix}", f"{stem}.{suffix}.gz", stem, f"more/{last}", last.upper(), f"\u00e9 {last}",
        "RAW_GPS.txt",
    )  # fmt: skip
    return tuple(f"{folder}/{one}" if folder else one for one in (*names, "a.parquet", "DataLane.csv"))
