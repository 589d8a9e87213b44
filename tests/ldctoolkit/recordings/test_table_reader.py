"""Plain recording tables as a source: the same departures as before, and faults that cost one recording or one file."""

import dataclasses
import gzip
import hashlib
import math
import re
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import assert_same_bits, examples
from helpers.errors import refused
from helpers.recordings import OFFSET, assert_same, drive, frame_of, read_source
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import extract_departures, read_recordings
from ldctoolkit.recordings.recording import Problem, Recording, open_recordings
from ldctoolkit.recordings.table_reader import READER, TablePart

Save = Callable[..., Path]
HEADER = "recording,t,lane_offset,lane_width,speed\n"
A, B, C = (f"{name},0,0.1,3.6,25\n{name},0.1,0.2,3.6,25\n" for name in "abc")
ROWS = A + "b,0,0.3,3.6,25\n"
PLAIN = HEADER + ROWS
SOUND_DRIVES = [
    drive(name, t, lane_offset=offset, lane_width=3.6, curvature=None, lane=None)
    for name, t, offset in (("a", [0.0, 0.1], [0.1, 0.2]), ("b", [0.0], 0.3))
]


@pytest.fixture
def save(tmp_path: Path) -> Save:
    def write(content: str | bytes | pl.DataFrame, name: str = "drive.csv") -> Path:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        if isinstance(content, pl.DataFrame):
            content.write_parquet(path)
        else:
            path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def read(*paths: Path, block_bytes: int = 1 << 24) -> tuple[dict[str, Recording], list[Problem]]:
    recordings, problems = read_source(dataclasses.replace(READER, block_bytes=block_bytes).open(paths))
    assert len({r.name for r in recordings}) == len(recordings)
    return {r.name: r for r in recordings}, problems


@pytest.mark.parametrize("kind", ["csv", "CSV.gz", "parquet"])
def test_the_same_departures_as_from_arrays(kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    drives = [
        drive(
            str(i), lane_offset=OFFSET + rng.normal(0, 0.01, 100), curvature=rng.normal(0, 1e-3, 100), turn_signal=0,
            valid=rng.random(100) > 0.002,
        )
        for i in range(20)
    ]  # fmt: skip
    frame = frame_of(drives)
    path = tmp_path / f"drive.{kind}"
    if kind == "parquet":  # typed columns: identifiers and lanes as integers, validity as booleans
        frame.with_columns(pl.col("recording").cast(pl.Int32)).write_parquet(path)
    else:
        text = frame.write_csv().encode()
        path.write_bytes(gzip.compress(text) if kind == "CSV.gz" else text)
    opened = open_recordings([path])
    assert (opened.reader.name, opened.found) == ("table", "1 recording table")
    extraction = extract_departures(opened, vehicle_width=1.8)
    assert extraction.departures.n > 5
    assert_same(extraction, extract_departures(drives, vehicle_width=1.8))
    assert_same(extraction, extract_departures(read_recordings(path), vehicle_width=1.8))
    content = path.read_bytes()
    (file,) = extraction.provenance.sources
    assert (file.name, file.bytes, file.sha256) == (path.name, len(content), hashlib.sha256(content).hexdigest())


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + PLAIN.encode(),
        PLAIN.replace("\n", "\r\n").encode(),
        PLAIN.replace("a,", '"a",').replace("25", '"25"').encode(),
        PLAIN.replace(",", " , ").encode(),
        PLAIN.rstrip("\n").encode(),
        (PLAIN + "\n,,,,\n\n").encode(),
        # columns in another order, and columns that nobody asked for: one twice, one without a name
        b"speed,x,t,lane_width,lane_offset,x,,recording\n"
        b"25,q,0,3.6,0.1,1,2,a\n25,q,0.1,3.6,0.2,1,2,a\n25,q,0,3.6,0.3,1,2,b\n",
    ],
    ids=["bom", "crlf", "quoted", "blanks", "no last newline", "blank lines", "other columns"],
)
def test_same_table_in_another_dress(save: Save, content: bytes) -> None:
    recordings, problems = read(save(content))
    assert problems == []
    assert_same_bits([dataclasses.replace(r, source="") for r in recordings.values()], SOUND_DRIVES)


def test_reading_stops_at_the_first_fault(save: Save) -> None:
    first_file, two = save(HEADER + A + B, "one.csv"), save(HEADER + C + "c,x,0.1,3.6,25\n", "two.csv")
    recordings = read_recordings([first_file, two])
    assert [next(recordings).name, next(recordings).name] == ["a", "b"]
    with pytest.raises(RecordingError, match=r"^two\.csv, line 4: column 't' holds 'x'; allowed: numbers$"):
        next(recordings)
    with pytest.raises(RecordingError, match=r"^two\.csv, line 2: recording 'b' is also in one\.csv, line 4"):
        next(read_recordings([first_file, save(HEADER + B + C, "two.csv")]))
    with pytest.raises(RecordingError, match="does not exist"):
        read_recordings("nowhere.csv")


def test_optional_columns_and_samples_without_a_time(save: Save) -> None:
    text = (
        "turn_signal,lane,recording,t,lane_offset,lane_width,speed,yaw_rate,valid\n"
        "left,3,a,0,0.1,3.6,25,0.01,1\n"
        "right,,a,0.1,0.2,3.6,25,0.02,1\n"
        ",4,a,,0.3,3.6,25,0.03,1\n"
        ",4.0,a,0.3,0.4,3.6,,0.04,false\n"
    )
    [recording], problems = read(save(text))[0].values(), read(save(text))[1]
    assert (problems, recording.source) == ([], "drive.csv")
    np.testing.assert_array_equal(recording.t, [0.0, 0.1, 0.3])
    np.testing.assert_array_equal(recording.speed, [25.0, 25.0, np.nan])
    assert (recording.valid.tolist(), recording.turn_signal.tolist()) == ([True, False, False], [1, -1, 0])
    assert recording.cut.tolist() == [False, False, True]
    assert recording.yaw_rate.tolist() == [0.01, 0.02, 0.04]
    assert recording.curvature is None


FAULTS = {
    "text for a number": ("b,0.1,0.2,3.6,25", "b,0.1,far,3.6,25", "line 5", "'far'"),
    "too many fields": ("b,0.1,0.2,3.6,25", "b,0.1,0.2,3.6,25,7", "line 5", "6 fields"),
    "an open quote": ("b,0.1,0.2,3.6,25", '"b,0.1,0.2,3.6,25', "line 5", "quotation"),
    "no name": ("b,0.1,0.2,3.6,25\n", "b,0.1,0.2,3.6,25\n,0.2,0.2,3.6,25\n", "line 6", "identifier"),
    "not UTF-8": ("b,0.1,0.2,3.6,25", "b\xff,0.1,0.2,3.6,25", "line 5", "the text is not UTF-8"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_recording_at_fault_is_left_out_and_the_others_stay(fault: str, save: Save) -> None:
    good, bad, faulty_line, words = FAULTS[fault]
    text = HEADER + A + B + C
    assert text.count(good) == 1
    recordings, problems = read(save(text.replace(good, bad).encode("latin-1")))
    # a line without a name may belong to either neighbour
    assert list(recordings) == (["a"] if fault in ("no name", "not UTF-8") else ["a", "c"])
    assert any(problem.place == faulty_line and words in problem.what for problem in problems), [
        str(problem) for problem in problems
    ]
    assert all(problem.file == "drive.csv" for problem in problems)
    assert any("'b'" in problem.what and "left out" in problem.what for problem in problems)


def test_a_parquet_row_at_fault(save: Save) -> None:
    frame = pl.read_csv((HEADER + A + B + C).encode()).with_columns(valid=pl.Series([1, 1, 1, 7, 1, 1]))
    recordings, problems = read(save(frame, "drive.parquet"))
    assert (list(recordings), problems[0].place) == (["a", "c"], "row 4")
    assert "holds 7" in problems[0].what


def test_of_a_recording_in_two_files_the_first_ones_rows_are_taken(save: Save) -> None:
    first_file = save(HEADER + A + B, "one.csv")
    two = save(pl.read_csv((HEADER + C + B.replace("0.1,3.6", "0.15,3.6")).encode()), "two.parquet")
    three = save(gzip.compress((HEADER + '"d",0,0.1,3.6,25\n' + B).encode()), "three.csv.gz")
    recordings, problems = read(first_file, two, three)
    assert (list(recordings), recordings["b"].source) == (["a", "b", "c", "d"], "one.csv")
    assert recordings["b"].lane_offset[0] == 0.1
    assert [str(problem) for problem in problems] == [
        "two.parquet, row 3: recording 'b' is also in one.csv, line 4; these rows are left out",
        "three.csv.gz, line 3: recording 'b' is also in one.csv, line 4; these rows are left out",
    ]


def test_lines_are_counted_past_blank_and_faulty_ones(save: Save) -> None:
    first_file = save(HEADER + "\n \n" + B + "\n" + A, "one.csv")
    two = save((HEADER + C + "c,1,2,3,4,5\n\n" + A).replace("\n", "\r\n"), "two.csv")
    _, problems = read(first_file, two)
    assert str(problems[0]) == "two.csv, line 6: recording 'a' is also in one.csv, line 7; these rows are left out"


REFUSED_TEXT: dict[str, tuple[str | bytes, str]] = {
    "not a number": (
        PLAIN + "b,1,left,3.6,25\nb,2,x,3.6,25\n",
        "drive.csv, line 5: column 'lane_offset' holds 'left'; allowed: numbers (2 lines in all)",
    ),
    "decimal comma": (HEADER + 'a,0,"0,1",3.6,25\n', "line 2: column 'lane_offset' holds '0,1'; allowed: numbers"),
    "unsorted": (PLAIN + "b,-0.5,0,3.6,25\n", "drive.csv, line 5: recording 'b': the clock starts again"),
    "unsorted around a hole": (PLAIN + "b,,0,3.6,25\nb,-1,0,3.6,25\n", "line 6: recording 'b': the clock"),
    "two pieces": (PLAIN + "a,9,0,3.6,25\n", "drive.csv, line 5: recording 'a' comes in separate pieces"),
    "all missing": (HEADER + "a,0,,3.6,25\na,1,nan,3.6,25\n", "column 'lane_offset' holds no number in any of 2 rows"),
    "all lanes missing": (HEADER.replace("speed", "speed,lane") + "a,0,0,3.6,25,\n", "column 'lane' holds no number"),
    "fields behind an unread column": (
        HEADER.replace("speed", "speed,x") + "a,0,0,3.6,25,x\nb,1,0,3.6,25,x,7\n",
        "line 3: 7 fields; ",
    ),
    "line break in quotes": (HEADER + '"a\nb",1,0,3.6,25\n', "line 2: a quotation mark is not closed on its line"),
    "bad valid": (HEADER.replace("speed", "speed,valid") + "a,0,0,3.6,25,maybe\n", "column 'valid' holds 'maybe'"),
    "bad turn signal": (
        HEADER.replace("speed", "speed,turn_signal") + "a,0,0,3.6,25,2\n",
        "column 'turn_signal' holds",
    ),
    "no name": (HEADER + 9 * ",0,0.1,3.6,25\n", "drive.csv: column 'recording' holds no name in any of 9 rows"),
    "an angle": (HEADER.replace("speed", "speed,heading") + "a,0,0,3.6,25,N\n", "line 2: column 'heading' holds 'N'"),
    "a long line": (HEADER.encode() + b"x" * 3_000_000, "line 2: longer than 1048576 bytes; this is not CSV"),
}


@pytest.mark.parametrize("name", REFUSED_TEXT)
@pytest.mark.parametrize("block_bytes", [1 << 20, 40])
def test_what_is_wrong_with_a_text(save: Save, name: str, block_bytes: int) -> None:
    content, message = REFUSED_TEXT[name]
    if block_bytes == 40 and name == "not a number":
        message = message.split(" (")[0]
    path = save(content)
    try:
        reported = [str(problem) for problem in read(path, block_bytes=block_bytes)[1]]
    except RecordingError as error:
        reported = [str(error)]
    assert any(text.startswith("drive.csv") and message in text for text in reported), reported


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (pl.col("t").cast(pl.Date), "column 't' is of type Date; allowed: numbers"),
        (pl.concat_list("t").alias("lane"), "column 'lane' is of type List(Float64); allowed: text or numbers"),
        (pl.duration(seconds="t").alias("lane"), "column 'lane' is of type Duration("),
        (pl.lit(None, pl.String).alias("recording"), "column 'recording' holds no name in any of 3 rows"),
        (pl.lit(np.nan).alias("recording"), "column 'recording' holds no name in any of 3 rows"),
        (pl.when(pl.col("t") == 0.0).then(7.0).otherwise(np.nan).alias("recording"), "row 2: column 'recording' holds"),
        (-pl.col("t"), "row 2: recording 'a': the clock starts again here; it is read as another recording 'a (2)'"),
        (pl.lit("x").alias("speed"), "row 1: column 'speed' holds 'x'; allowed: numbers (3 rows in all)"),
        (pl.lit(None).alias("speed"), "column 'speed' holds no number in any of 3 rows"),
    ],
)
def test_bad_parquet_columns(tmp_path: Path, change: pl.Expr, message: str) -> None:
    frame = pl.read_csv(PLAIN.encode(), schema_overrides={"t": pl.Float64})
    frame.with_columns(change).write_parquet(tmp_path / "drive.parquet")
    reported = [str(problem) for problem in read(tmp_path / "drive.parquet")[1]]
    assert any(text.startswith("drive.parquet") and message in text for text in reported), reported


def test_broken_gzip_and_parquet(save: Save) -> None:
    content = gzip.compress(PLAIN.encode())
    for part in (content[:-9], content[:20] + b"\x00\xff" * 8 + content[36:], content + b"x" * 9):
        with pytest.raises(RecordingError, match=r"^drive\.csv\.gz: broken gzip"):
            list(read_recordings(save(part, "drive.csv.gz"), format="table"))
    path = save(pl.read_csv(PLAIN.encode()), "drive.parquet")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(RecordingError, match=r"^drive\.parquet: cannot be read as Parquet: "):
        list(read_recordings(path, format="table"))


WHOLE: dict[str, tuple[str, bytes | str, str]] = {
    "missing column": ("bad.csv", PLAIN.replace("offset", "ofset", 1), "column 'lane_offset' is missing; did"),
    "no other column": ("bad.csv", "recording,t,lane_width,speed\n", "column 'lane_offset' is missing; no"),
    "empty": ("bad.csv", b"", "the file is empty"),
    "blank": ("bad.csv", "\n \n# a\n", "only comments and blank lines"),
    "header only": ("bad.csv", HEADER, "a header but no rows"),
    "semicolons": ("bad.csv", PLAIN.replace(",", ";"), "columns are not separated by commas"),
    "column twice": ("bad.csv", HEADER.replace("speed", "speed,t") + "a,0,0,3.6,25,1\n", "column 't' appears 2 times"),
    "latin-1": ("bad.csv", b"B\xe4r," + HEADER.encode(), "the text is not UTF-8"),
    "UTF-16": ("bad.csv", PLAIN.encode("utf-16"), "the text is UTF-16"),
    "gzip inside": ("bad.csv", gzip.compress(PLAIN.encode()), "the content is gzip"),
    "suffix": ("bad.txt", PLAIN, "suffix"),
    "not gzip": ("bad.csv.gz", PLAIN, "gzip"),
    "not Parquet": ("bad.parquet", PLAIN, "cannot be read as Parquet: "),
    "an empty Parquet": ("bad.parquet", b"", "cannot be read as Parquet: "),
    "a torn Parquet": ("bad.parquet", b"PAR1" + b"x" * 50 + b"PAR1", "cannot be read as Parquet: "),
    "a long line": ("bad.csv", b"x" * (1 << 20), "not CSV"),
    "NUL bytes": ("bad.csv", 4096 * "\0", ""),
    # without the name of the column `valid` all samples would count
    "NUL bytes over the header": ("bad.csv", "\0\0\0id," + HEADER + "0,a,0,0.1,3.6,25\n", "3 NUL bytes stand where "),
}


@pytest.mark.parametrize("fault", WHOLE)
def test_a_file_that_cannot_be_used(fault: str, save: Save, tmp_path: Path) -> None:
    name, content, words = WHOLE[fault]
    bad = save(content, name)
    with pytest.raises(RecordingError, match=rf"^{name}.*{words}"):
        open_recordings([bad], format="table")
    recordings, problems = read(bad, save(HEADER + A), tmp_path / "none.csv")
    assert (list(recordings), [problem.file for problem in problems]) == (["a"], [name, "none.csv"])
    assert words in problems[0].what
    assert not any(str(tmp_path) in problem.file for problem in problems)


def test_a_gzip_file_that_is_cut_short(save: Save) -> None:
    rows = "".join(f"r{i},{t / 10},{i % 7 / 10 + t / 1000},3.6,25\n" for i in range(2000) for t in range(5))
    packed = gzip.compress((HEADER + rows).encode())
    path = save(packed[: len(packed) // 2], "drive.csv.gz")
    recordings, problems = read(path)
    assert len(recordings) > 500
    assert list(recordings) == [f"r{i}" for i in range(len(recordings))]
    assert [r.samples for r in recordings.values()] == [5] * len(recordings)
    (problem,) = problems
    assert "cut short" in problem.what
    last = int(re.search(r"broken gzip after line (\d+)", problem.what)[1])  # type: ignore[index]
    # the recording that the cut goes through is left out
    assert 0 <= (last - 1) - 5 * len(recordings) <= 5


def test_many_problems_are_counted(save: Save) -> None:
    rows = "".join(f"r{i},1,0.1,3.6,25\nr{i},0,0.1,3.6,25\n" for i in range(50))
    recordings, problems = read(save(HEADER + A + rows))
    assert list(recordings) == ["a", *(name for i in range(50) for name in (f"r{i}", f"r{i} (2)"))]
    assert len(problems) == 21
    assert problems[-1].what.startswith("30 more problems; the last: line 103: ")


def test_folders(save: Save, tmp_path: Path) -> None:
    save(HEADER + A, "in/one.csv")
    save(HEADER + B, "in/two.csv")
    save("x,y\n1,2\n", "in/other.csv")
    save(pl.DataFrame({"side": ["left"]}), "in/departures.parquet")
    assert READER.recognise([tmp_path / "in"]) == "2 recording tables"
    recordings, problems = read(tmp_path / "in")
    assert (list(recordings), problems) == (["a", "b"], [])
    assert READER.recognise([tmp_path / "none", tmp_path]) == ""
    with refused(tmp_path.name, RecordingError, problem="the folder holds no recording table", hint="1 more problem"):
        READER.open([tmp_path, tmp_path / "none.csv"])


FIELD = st.sampled_from(["0", "1", "2.5", " 3 ", "", "nan", "NULL", "x", "-1e-3", "inf", '"4"'])
LINE = st.tuples(st.sampled_from("abc"), st.integers(0, 9).map(str) | FIELD, FIELD)


@examples(150)
@given(st.lists(LINE, min_size=1, max_size=12))
def test_against_plain_python(lines: list[tuple[str, str, str]]) -> None:
    """Which recordings are kept, and their samples, worked out with nothing but `float`."""

    def number(text: str) -> float | None:
        text = text.strip().strip('"').strip()
        try:
            return float("nan") if text in ("", "NULL") else float(text)
        except ValueError:
            return None

    expected: dict[str, list[tuple[float, float, bool]]] = {}
    faulty: set[str] = set()
    closed: set[str] = set()
    previous, passed_over = "", False
    for name, t, offset in lines:
        if name != previous and previous:
            closed.add(previous)
        passed_over &= name == previous
        previous = name
        if name in closed:
            continue
        time_or_none, offset_or_none = number(t), number(offset)
        if time_or_none is None or offset_or_none is None:
            faulty.add(name)
        elif math.isfinite(time_or_none):
            expected.setdefault(name, []).append((time_or_none, offset_or_none, passed_over))
            passed_over = False
        else:
            passed_over = True
    text = "".join(f"{name},{t},{offset},3.6,25\n" for name, t, offset in lines)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.csv")
        path.write_text(HEADER + A.replace("a", "sound") + text)
        recordings = {
            item.name: item
            for item in TablePart(str(path), "a", 1, "a.csv").read()
            if isinstance(item, Recording)
        }  # fmt: skip
    sound: dict[str, list[tuple[float, float, bool]]] = {}
    for name, rows in expected.items():
        if name not in faulty:
            last, clocks = -math.inf, 0
            for t, offset, cut in rows:
                clocks += t < last or not clocks
                samples = sound.setdefault(name if clocks == 1 else f"{name} ({clocks})", [])
                samples.append((t, offset, cut and bool(samples)))
                last = t
    assert sorted(recordings) == sorted([*sound, "sound"])
    for name, rows in sound.items():
        np.testing.assert_array_equal(recordings[name].t, [t for t, _, _ in rows])
        np.testing.assert_array_equal(recordings[name].lane_offset, [offset for _, offset, _ in rows])
        cut = recordings[name].cut
        assert [cut for _, _, cut in rows] == (cut.tolist() if cut is not None else [False] * len(rows))
