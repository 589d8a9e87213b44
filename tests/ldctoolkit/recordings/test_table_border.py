"""Plain tables at the border of what can be read: clocks, lost lines, units, names that are none, very long ones."""

import codecs
import dataclasses
import gzip
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import ldctoolkit as ldc
from helpers.recordings import read_source
from ldctoolkit.errors import LdcError, RecordingError
from ldctoolkit.recordings import open_recordings, table_reader, text_table
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.table_reader import READER

HEADER = "recording,t,lane_offset,lane_width,speed\n"
KINDS = ("csv", "csv.gz", "parquet")
TEXTS = ("csv", "csv.gz")

Save = Callable[..., Path]


def line(name: str, t: float | str, offset: float | str = 0.1) -> str:
    return f"{name},{t},{offset},3.6,25\n"


def lines(name: str, *times: float | str) -> str:
    return "".join(line(name, t) for t in times)


@pytest.fixture
def save(tmp_path: Path) -> Save:
    def write(content: str | bytes, kind: str = "csv", name: str = "drive") -> Path:
        """A text as a file of that kind."""
        path = tmp_path / f"{name}.{kind}"
        data = content if isinstance(content, bytes) else content.encode()
        if kind == "parquet":
            pl.read_csv(io.BytesIO(data), infer_schema_length=None).write_parquet(path)
        else:
            path.write_bytes(gzip.compress(data) if kind == "csv.gz" else data)
        return path

    return write


def read(*paths: Path, block_bytes: int = 1 << 24) -> tuple[list[Recording], list[Problem]]:
    return read_source(dataclasses.replace(READER, block_bytes=block_bytes).open(paths))


def rows(problems: list[Problem]) -> list[int]:
    """The row of each problem, in a table without odd lines."""
    return [int(problem.place.split()[1]) - problem.place.startswith("line") for problem in problems]


def places(problems: list[Problem]) -> list[str]:
    return [problem.place for problem in problems]


def cuts(recording: Recording) -> list[int]:
    """Samples that nothing is joined to from before."""
    return [] if recording.cut is None else np.flatnonzero(recording.cut).tolist()


# --- columns


@pytest.mark.parametrize("kind", KINDS)
def test_heading_steering_and_a_system_that_steers(kind: str, save: Save) -> None:
    text = (
        "recording,t,lane_offset,lane_width,speed,heading,steering,engaged\n"
        "a,0,0.1,3.6,25,1.5,-0.02,true\na,0.1,0.1,3.6,25,,0.5,false\na,0.2,0.1,3.6,25,-3.25,,\n"
    )
    [recording], problems = read(save(text, kind))
    assert problems == []
    np.testing.assert_array_equal(recording.heading, [1.5, np.nan, -3.25])
    np.testing.assert_array_equal(recording.steering, [-0.02, 0.5, np.nan])
    assert recording.engaged is not None
    assert (recording.engaged.dtype, recording.engaged.tolist()) == (bool, [True, False, False])


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize(
    ("word", "value"),
    [("1", True), ("TRUE", True), ("1.0", True), (" true ", True), ("0", False), ("False", False), ("n/a", False)],
)
def test_words_for_a_system_that_steers(word: str, value: bool, kind: str, save: Save) -> None:
    text = HEADER.replace("speed", "speed,engaged") + line("a", 0).strip() + f",{word}\n"
    [recording], problems = read(save(text, kind))
    assert (problems, recording.engaged.tolist()) == ([], [value])  # type: ignore[union-attr]


# --- clocks


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("odd", "expected"),
    [
        ({30: "99.0"}, [30]),  # ahead of the clock
        ({30: "0.0"}, [30]),  # behind it
        ({5: "-7.5", 60: "1000.0"}, [5, 59]),
        ({20: "9.0", 21: "9.1", 40: "0.5"}, [20, 38]),
        ({99: "0.0"}, []),  # the last one
    ],
)
def test_single_rows_in_disorder_are_left_out(odd: dict[int, str], expected: list[int], kind: str, save: Save) -> None:
    times = [odd.get(i, f"{i / 10:.1f}") for i in range(100)]
    [recording], problems = read(save(HEADER + lines("a", *times), kind))
    assert recording.t.tolist() == [float(times[i]) for i in range(100) if i not in odd]
    assert (cuts(recording), rows(problems)) == (expected, [min(odd) + 1])
    assert (f"({len(odd)} " in problems[0].what) == (len(odd) > 1)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rate", [5, 10, 50])
def test_a_clock_that_starts_again_begins_another_recording(kind: str, rate: int, save: Save) -> None:
    first, second, third = ([round(i / rate + 3.0, 3) for i in range(n)] for n in (30, 20, 25))
    text = HEADER + lines("b", 0, 0.1) + lines("a", *first, *second, *third) + lines("c", 0)
    recordings, problems = read(save(text, kind))
    assert [(r.name, r.t.tolist(), cuts(r), r.continues) for r in recordings] == [
        (name, times, [], False)
        for name, times in (("b", [0.0, 0.1]), ("a", first), ("a (2)", second), ("a (3)", third), ("c", [0.0]))
    ]
    assert rows(problems) == [33, 53]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("order", [1, -1])
def test_a_name_that_is_in_use_is_passed_over(kind: str, order: int, save: Save) -> None:
    """In the file or in another one."""
    texts = [lines("a", 5, 6, 0, 1), lines("a (2)", 7, 8)][::order]
    apart = [save(HEADER + text, kind, f"{i}") for i, text in enumerate(texts)]
    for paths in (apart, [save(HEADER + "".join(texts), kind)]):
        recordings, problems = read(*paths)
        assert {r.name: r.t.tolist() for r in recordings} == {"a": [5, 6], "a (3)": [0, 1], "a (2)": [7, 8]}
        assert len(problems) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_rows_in_no_order_of_time_are_no_recording(kind: str, save: Save) -> None:
    times = [t for i in range(30) for t in (i + 1, i)]
    recordings, problems = read(save(HEADER + lines("a", *times) + lines("b", 0, 1), kind))
    assert [r.name for r in recordings] == ["b"]
    assert rows(problems) == [2]


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_joined_over_a_sample_without_a_time(kind: str, save: Save) -> None:
    text = HEADER + lines("a", "", 0, 0.1, "", 0.3, 0.4, "", "", 0.7, "") + lines("b", 0, 0.1)
    recordings, problems = read(save(text, kind))
    assert problems == []
    assert [(r.name, r.t.tolist(), cuts(r)) for r in recordings] == [
        ("a", [0.0, 0.1, 0.3, 0.4, 0.7], [2, 4]),
        ("b", [0.0, 0.1], []),
    ]


# --- names


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("word", ["nan", "NaN", "NULL", "none", "n/a", "NA", " ", ""])
def test_a_missing_name_is_no_recording(word: str, kind: str, save: Save) -> None:
    text = HEADER + lines("a", 0, 0.1) + lines("b", 0, 0.1) + lines(word, 0.2, 0.3) + lines("c", 0) + lines("d", 0, 0.1)
    recordings, problems = read(save(text, kind))
    assert [r.name for r in recordings] == ["a", "d"]  # the rows may be either neighbour's
    assert rows(problems) == [5, 4, 7]
    assert "(2 " in problems[0].what


# --- long recordings


def wandering(n: int, start: int = 0, rate: int = 10) -> str:
    """A vehicle that is 0.8 m off its lane's centre for 60 of every 200 rows, to either side, and near it else."""
    rows = []
    for i in range(start, start + n):
        offset = (1 if i % 400 < 200 else -1) * (0.8 if i % 200 < 60 else 0.2)
        rows.append(line("a", f"{i / rate:.2f}", f"{offset:.1f}"))
    return "".join(rows)


@pytest.fixture
def short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(table_reader, "LONGEST_PIECE", 500)
    monkeypatch.setattr(text_table, "PACKED_PIECE", 256)


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("block_bytes", [400, 5000, 20_000])
@pytest.mark.parametrize("rate", [pytest.param(10, marks=pytest.mark.slow), 25])
def test_a_long_recording_comes_in_pieces(kind: str, block_bytes: int, rate: int, save: Save) -> None:
    text = HEADER + lines("b", 0, 1) + wandering(4000, rate=rate) + lines("c", 0, 1)
    recordings, problems = read(save(text, kind), block_bytes=block_bytes)
    assert problems == []
    pieces = [r for r in recordings if r.name == "a"]
    assert [r.name for r in recordings] == ["b", *["a"] * len(pieces), "c"]
    assert [r.continues for r in recordings] == [False, False, *[True] * (len(pieces) - 1), False]
    assert all(r.cut is None for r in recordings)
    np.testing.assert_array_equal(np.concatenate([r.t for r in pieces]), np.round(np.arange(4000) / rate, 2))
    assert len(pieces) >= (8 if block_bytes == 400 else 3)
    assert max(r.samples for r in pieces) <= 500 + 2 * block_bytes / (64 if kind == "parquet" else 15)
    for piece in pieces[1:]:  # within 2 s the vehicle is within 0.15 * 3.6 m of its lane's centre
        first = round(rate * float(piece.t[0])) % 200
        assert 60 + 2 * rate <= first <= 199 - 2 * rate, first


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize("block_bytes", [1 << 24, 1000])
def test_recordings_that_are_not_long_are_whole(block_bytes: int, save: Save) -> None:
    text = HEADER + "".join(wandering(450).replace("a,", f"{name},") for name in "abcd")
    recordings, problems = read(save(text), block_bytes=block_bytes)
    assert problems == []
    assert [(r.name, r.samples, r.continues) for r in recordings] == [(name, 450, False) for name in "abcd"]


@pytest.mark.usefixtures("short_pieces")
def test_two_pieces_part_where_the_vehicle_is_calm_for_the_last_time(save: Save) -> None:
    """Rows 0 to 500 wait, up to t = 50 s. From 40 s to 45.9 s the vehicle is off the centre, and what comes after 50 s
    is not known: 37.9 s is the last time with more than 2 s to either."""
    recordings, _ = read(save(HEADER + wandering(600)), block_bytes=10)
    assert [r.t[0] for r in recordings] == [0.0, 37.9]


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize(("odd", "cut"), [("9999", 1), ("0.05", 0)])
def test_a_time_in_disorder_where_two_pieces_part(odd: str, cut: int, save: Save) -> None:
    """It is not taken for the clock of all that comes before, or behind it."""
    recordings, problems = read(save(HEADER + wandering(600).replace("a,37.80,", f"a,{odd},")), block_bytes=10)
    assert [(r.name, r.continues, cuts(r)) for r in recordings] == [("a", False, []), ("a", True, [cut])]
    assert sum(r.samples for r in recordings) == 599
    assert places(problems) == ["line 380"]


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize(("offset", "border"), [(0.7, 470), (-0.7, 470), ("", 250)])
def test_a_recording_without_a_calm_place(offset: float | str, border: int, save: Save) -> None:
    """The nearest to the lane's centre is taken; it lies in the second half."""
    rows = "".join(line("a", f"{i / 10:.1f}", offset) for i in range(600))
    rows = rows.replace(line("a", "10.0", offset), line("a", "10.0", 0.0))  # in the first half
    if offset:
        rows = rows.replace(line("a", "47.0", offset), line("a", "47.0", 0.55))
        rows = rows.replace(line("a", "30.0", offset), line("a", "30.0", ""))
    recordings, problems = read(save(HEADER + rows), block_bytes=10)
    assert (problems, [r.samples for r in recordings]) == ([], [border, 600 - border])
    assert [r.continues for r in recordings] == [False, True]


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_costs_the_piece_that_it_is_in(kind: str, save: Save) -> None:
    text = HEADER.replace("speed", "speed,valid") + wandering(2000).replace("\n", ",1\n")
    path = save(text.replace("a,80.00,0.8,3.6,25,1", "a,80.00,0.8,3.6,25,7"), kind)
    whole, none = read(save(text, kind, "sound"), block_bytes=2000)
    recordings, problems = read(path, block_bytes=2000)
    assert none == []
    starts = [piece.t[0] for piece in whole]
    (lost,) = [i for i, piece in enumerate(whole) if piece.t[0] <= 80.0 <= piece.t[-1]]
    assert 0 < lost < len(whole) - 1
    assert [r.t[0] for r in recordings] == starts[:lost] + starts[lost + 1 :]
    assert [r.continues for r in recordings] == [False] + [True] * (len(recordings) - 1)
    assert [cuts(r) for r in recordings] == [[0] if i == lost else [] for i in range(len(recordings))]
    first, last = (round(10 * whole[lost].t[i]) + 1 + (kind != "parquet") for i in (0, -1))
    assert rows(problems) == [801, 801]
    assert f"s {first} to {last}, " in problems[1].what


@pytest.mark.usefixtures("short_pieces")
def test_a_fault_in_the_first_piece(save: Save) -> None:
    """379 rows as above; what comes behind begins the recording."""
    recordings, problems = read(save(HEADER + wandering(600).replace("a,1.00,0.8", "a,1.00,far")), block_bytes=10)
    assert [(r.name, r.t[0], r.continues, cuts(r)) for r in recordings] == [("a", 37.9, False, [])]
    assert places(problems) == ["line 12", "line 12"]


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("first", [480, 700, 1500])
def test_a_clock_that_starts_again_in_a_long_recording(kind: str, first: int, save: Save) -> None:
    """Wherever the pieces part, the samples of each drive are one recording's, in pieces."""
    text = HEADER + wandering(first) + wandering(900) + lines("b", 0, 1)
    for block_bytes in (300, 3000, 1 << 24):
        recordings, problems = read(save(text, kind), block_bytes=block_bytes)
        t = {name: np.concatenate([r.t for r in recordings if r.name == name]) for name in ("a", "a (2)", "b")}
        np.testing.assert_array_equal(t["a"], np.round(np.arange(first) / 10, 2))
        np.testing.assert_array_equal(t["a (2)"], np.round(np.arange(900) / 10, 2))
        assert [r.name for r in recordings if not r.continues] == ["a", "a (2)", "b"]
        assert rows(problems) == [first + 1]


@pytest.mark.usefixtures("short_pieces")
def test_lane_labels_and_signals_of_pieces(save: Save) -> None:
    text = HEADER.replace("speed", "speed,lane,turn_signal")
    text += "".join(line("a", i / 10).strip() + f",L{i // 300},{'left' if i == 650 else ''}\n" for i in range(900))
    recordings, problems = read(save(text), block_bytes=400)
    assert problems == []
    lanes = [r.lane for r in recordings]
    changes = [t for r in recordings for t in r.t[1:][np.diff(r.lane) != 0]]  # type: ignore[arg-type]
    assert (len(lanes), changes) == (2, [30.0, 60.0])
    assert [r.t[r.turn_signal == 1].tolist() for r in recordings] == [[], [65.0]]


# --- bytes that a power failure leaves


A, B = lines("a", 0, 0.1, 0.2), lines("b", 0, 0.1)
NUL_BYTES = {  # NUL for the bytes; the lines that are named, the times of "a", and where nothing is joined
    "at the end": (HEADER + A + "NUL", [5], [0.0, 0.1, 0.2], []),
    "in the last line": (HEADER + A + "a,0.4,0.1,3.6NUL", [5], [0.0, 0.1, 0.2], []),
    "in the last cell": (HEADER + A + "a,0.4,0.1,3.6,2NUL", [5], [0.0, 0.1, 0.2], []),
    "a line": (HEADER + A + "NUL\n" + lines("a", 0.6) + B, [5], [0.0, 0.1, 0.2, 0.6], [3]),
    "the end of a line": (HEADER + A + "a,0.4,0.NUL\n" + lines("a", 0.6) + B, [5], [0.0, 0.1, 0.2, 0.6], [3]),
    "in a line": (HEADER + A + "a,0.NUL0.1,3.6,25\n" + lines("a", 0.6) + B, [5], [0.0, 0.1, 0.2, 0.6], [3]),
    "the start of a line": (HEADER + A + "NUL,25\n" + lines("a", 0.6) + B, [5], [0.0, 0.1, 0.2, 0.6], [3]),
    # what is left of the lines at both ends of a block looks like a line
    "joining lines": (HEADER + A + "a,0.3,0.1,3.6,2NUL5\na,107.NUL4,0.1,3.6,25\n" + lines("a", 107.5),
                      [5, 6], [0.0, 0.1, 0.2, 107.5], [3]),
    "under the header": ("t,recording,lane_offset,lane_width,speed\nNUL\n0,a,0.1,3.6,25\n0.1,a,0.1,3.6,25\n",
                         [2], [0.0, 0.1], []),
    "before the header": ("NUL" + HEADER + A, [1], [0.0, 0.1, 0.2], []),
    "a line before the header": ("NUL\r\n" + HEADER + A, [2], [0.0, 0.1, 0.2], []),
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("count", [1, 512, 5000, 3_000_000])
@pytest.mark.parametrize("where", NUL_BYTES)
@pytest.mark.parametrize("block_bytes", [1 << 24, 50])
def test_nul_bytes(kind: str, count: int, where: str, block_bytes: int, save: Save) -> None:
    """The lines around stay; nothing is joined across."""
    text, named, times, cut = NUL_BYTES[where]
    path = save(text.replace("NUL", count * "\0"), kind)
    recordings, problems = read(path, block_bytes=max(block_bytes, 1 << 19) if count > 10_000 else block_bytes)
    assert (recordings[0].t.tolist(), cuts(recordings[0])) == (times, cut)
    assert [r.t.tolist() for r in recordings[1:]] == [[0.0, 0.1]] * ("b," in text)
    assert places(problems) == [f"line {number}" for number in named]
    assert all(problem.what.startswith(f"{count} NUL bytes") for problem in problems)


@pytest.mark.usefixtures("short_pieces")
@pytest.mark.parametrize(("lost", "time"), [([399], ""), ([400], ""), ([399, 400, 401], ""), ([400], 100 * "\0")])
def test_a_row_that_is_lost_next_to_another_piece(
    lost: list[int], time: str, save: Save, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its time is missing, or there are NUL bytes in it."""
    monkeypatch.setattr(table_reader, "_border_of_pieces", lambda frame: 400)
    text = "".join(line("a", time if i in lost else i / 10) for i in range(700))
    recordings, problems = read(save(HEADER + text), block_bytes=400)
    assert places(problems) == (["line 402"] if time else [])
    assert [(r.continues, cuts(r)) for r in recordings] == [(False, []), (True, [0])]
    assert sum(r.samples for r in recordings) == 700 - len(lost)


# --- units


UNITS = [
    ",s,m,m,m/s", '"",s,m,m,m/s', "-,[s],[m],[m],[m/s]", "text,(s),(m),(m),(m/s)", ",sec,M,m,m/sec",
    " , s , m , m , m / s ", ",s,,,", ",s,-,-,m/s", "[-],[s],[m],[m],[m/s]",
]  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_row_of_units_is_passed_over(kind: str, units: str, end: str, save: Save) -> None:
    text = (HEADER + units + "\n" + lines("a", 0, 0.1)).replace("\n", end)
    recordings, problems = read(save(text, kind), save(text.replace("a,", "b,"), kind, "other"))
    assert [(r.name, r.t.tolist(), cuts(r)) for r in recordings] == [("a", [0.0, 0.1], []), ("b", [0.0, 0.1], [])]
    assert [(problem.file, problem.place) for problem in problems] == [
        (f"{name}.{kind}", "line 2") for name in ("drive", "other")
    ]


def test_units_of_all_columns(save: Save) -> None:
    head = HEADER.replace("speed", "speed,curvature,yaw_rate,heading,steering,valid,other")
    rows = "".join(line("a", t).strip() + ",0,0,0,0,1,7\n" for t in (0, 0.1))
    for curvature in ("1/m", "m^-1", "m⁻¹", "rad/m"):
        text = head + f",s,m,m,m/s,{curvature},rad/s,rad,[rad],bool,km\n" + rows
        [recording], problems = read(save(text))
        assert (recording.samples, places(problems)) == (2, ["line 2"])


@pytest.mark.parametrize(
    ("column", "unit", "needed"),
    [
        ("t", "ms", "s"), ("t", "[min]", "s"), ("lane_offset", "cm", "m"), ("lane_offset", "mm", "m"),
        ("lane_width", "ft", "m"), ("speed", "km/h", "m/s"), ("speed", "[mph]", "m/s"), ("speed", "kn", "m/s"),
        ("curvature", "1/km", "1/m"), ("yaw_rate", "deg/s", "rad/s"), ("yaw_rate", "(°/s)", "rad/s"),
        ("heading", "deg", "rad"), ("steering", "°", "rad"), ("steering", "mrad", "rad"),
    ],
)  # fmt: skip
def test_a_file_in_another_unit_is_refused(column: str, unit: str, needed: str, save: Save) -> None:
    sound = {"recording": "", "t": "s", "lane_offset": "m", "lane_width": "m", "speed": "m/s", "curvature": "1/m",
             "yaw_rate": "rad/s", "heading": "rad", "steering": "rad"}  # fmt: skip
    text = ",".join(sound) + "\n" + ",".join((sound | {column: unit}).values()) + "\na,0,0.1,3.6,25,0,0,0,0\n"
    with pytest.raises(RecordingError) as raised:
        open_recordings(save(text))
    shown = unit.strip("[]()")
    assert str(raised.value) == f"drive.csv, line 2: column '{column}' is in '{shown}'; needed: {needed}"


@pytest.mark.parametrize("first", ["a,0,,,", "a,nan,nan,nan,nan", ",,,,", "a,-,-,-,-", "a,inf,x,3.6,25", "a,0,m,m,m/s"])
def test_a_first_row_that_is_none_of_units(first: str, save: Save) -> None:
    """It is read, or at fault, as any other row; so is a row of units further down."""
    recordings, problems = read(save(HEADER + first + "\n" + lines("b", 0, 0.1)))
    assert recordings[-1].t.tolist() == [0.0, 0.1]
    assert not any("units" in problem.what for problem in problems)
    assert bool(problems) == any(word in first for word in ("-", "x", "m"))


# --- what spreadsheets and editors add


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize(
    ("before", "shift"),
    [
        ("sep=,\n", 1), ("sep=,\r\n", 1), ("SEP=,\n", 1), ("\ufeffsep=,\n", 1), ("\ufeff", 0),
        ("# a log, of 2024\n", 1), ("\ufeff# one\n#\n# three\n", 3), ("#\r\n", 1),
    ],
)  # fmt: skip
def test_lines_before_the_header(kind: str, before: str, shift: int, save: Save) -> None:
    path = save(before + HEADER + lines("a", 0, 0.1) + "b,0,far,3.6,25\n", kind)
    assert open_recordings(path).reader.name == "table"
    recordings, problems = read(path)
    assert [(r.name, r.t.tolist()) for r in recordings] == [("a", [0.0, 0.1])]
    assert problems[0].place == f"line {4 + shift}"


@pytest.mark.parametrize("kind", TEXTS)
@pytest.mark.parametrize("block_bytes", [1 << 24, 40])
@pytest.mark.parametrize("comment", ["# pause", '# an open " mark', "#,,,,,,,,,", "#"])
def test_comments_between_rows(kind: str, block_bytes: int, comment: str, save: Save) -> None:
    """Also above a row of units; a quoted name is none."""
    text = f"{HEADER}{comment}\n\n,s,m,m,m/s\n{line('a', 0)}{comment}\r\n{comment}\n{line('a', 0.1)}"
    recordings, problems = read(
        save(f"{text}{line('a', 'x')}" + line('"#1"', 0) + comment, kind), block_bytes=block_bytes
    )
    assert [(r.name, r.t.tolist(), cuts(r)) for r in recordings] == [("#1", [0.0], [])]
    assert places(problems) == ["line 4", "line 9", "line 9"]
    [recording], _ = read(save(text, kind), block_bytes=block_bytes)
    assert (recording.t.tolist(), cuts(recording)) == ([0.0, 0.1], [])


@pytest.mark.parametrize("mark", [";", "\t", "|"])
@pytest.mark.parametrize("sep", [True, False])
@pytest.mark.parametrize("commas", [True, False])
def test_other_separators_are_refused(mark: str, sep: bool, commas: bool, save: Save) -> None:
    text = (HEADER + lines("a", 0, 0.1)).replace(",", mark)
    with pytest.raises(RecordingError, match=rf"^drive\.csv, line {1 + sep}: columns are not separated by commas: "):
        open_recordings(save((f"sep={mark}\n" if sep else "") + (text.replace(".", ",") if commas else text)))


ENCODINGS = ["utf-16", "utf-16-le", "utf-16-be"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("before", ["", "sep=,\n", "# log\n"])
def test_utf_16_is_refused(encoding: str, before: str, save: Save) -> None:
    path = save((before + HEADER + lines("a", 0)).encode(encoding))
    for format in ("table", *(["auto"] if not before else [])):
        with pytest.raises(RecordingError, match="the text is UTF-16; save it as UTF-8"):
            open_recordings(path, format=format)


def test_a_study_file_in_another_encoding(tmp_path: Path) -> None:
    path, content = tmp_path / "mine.toml", b'name = "mine"\n[[design]]\nlaw = "none"\n'
    path.write_bytes(codecs.BOM_UTF8 + content)
    assert ldc.load_study(path).name == "mine"
    for encoding in ENCODINGS:
        path.write_bytes(content.decode().encode(encoding))
        with pytest.raises(LdcError, match="the text is UTF-16; save it as UTF-8"):
            ldc.load_study(path)
