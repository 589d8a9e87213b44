"""Recording files: what is read, and how each kind of bad file is refused."""

from __future__ import annotations

import gzip
import hashlib
import re
import sys
from pathlib import Path
from subprocess import run
from typing import Any

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings import RecordingTable, extract_departures, read_recordings

HEADER = "recording,t,lane_offset,lane_width,speed\n"
ROWS = "a,0,0.1,3.6,25\na,0.1,0.2,3.6,25\nb,0,0.3,3.6,25\n"


@pytest.fixture
def save(tmp_path):
    def write(content: str | bytes, name: str = "drive.csv") -> Path:
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return write


def read(*paths: Path, **options: Any) -> list[RecordingTable]:
    return list(read_recordings(paths, **options))


def test_plain_table(save):
    one, two = read(save(HEADER + ROWS))  # the last recording comes by itself: its end is the file's
    assert (one.names.tolist(), two.names.tolist()) == (["a"], ["b"])
    assert (one.offsets.tolist(), two.offsets.tolist()) == ([0, 2], [0, 1])
    assert one.t.tolist() == [0.0, 0.1]
    assert one.lane_offset.tolist() == [0.1, 0.2]
    assert one.valid.all()
    assert one.curvature is one.yaw_rate is one.lane is one.turn_signal is None


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + (HEADER + ROWS).encode(),
        (HEADER + ROWS).replace("\n", "\r\n").encode(),
        (HEADER + ROWS).replace("a,", '"a",').replace("25", '"25"').encode(),
        (HEADER + ROWS).replace(",", " , ").encode(),
        (HEADER + ROWS).rstrip("\n").encode(),
        (HEADER + ROWS + "\n,,,,\n\n").encode(),
        # columns in another order, and columns that nobody asked for: one twice, one without a name
        b"speed,x,t,lane_width,lane_offset,x,,recording\n"
        b"25,q,0,3.6,0.1,1,2,a\n25,q,0.1,3.6,0.2,1,2,a\n25,q,0,3.6,0.3,1,2,b\n",
    ],
    ids=["bom", "crlf", "quoted", "blanks", "no last newline", "blank lines", "other columns"],
)
def test_same_table_in_another_dress(save, content):
    for table, plain in zip(read(save(content)), read(save(HEADER + ROWS, "plain.csv")), strict=True):
        assert table.names.tolist() == plain.names.tolist()
        for name in ("offsets", "t", "lane_offset", "lane_width", "speed", "valid"):
            np.testing.assert_array_equal(getattr(table, name), getattr(plain, name))


def test_optional_columns(save):
    text = "recording,t,lane_offset,lane_width,speed,lane,valid,turn_signal,curvature,yaw_rate\n"
    text += "x,0,0,3.6,9,2,1,left,0.001,0.02\nx,1,0,3.6,9,2.0,true,-1,,0.02\nx,2,0,3.6,9,L,0,none,0.1,NA\n"
    text += "x,3,0,3.6,9,,,,0.1,\n"
    (table,) = read(save(text))
    assert table.valid.tolist() == [True, True, False, False]
    assert table.turn_signal is not None
    assert table.turn_signal.tolist() == [1, -1, 0, 0]
    assert table.lane is not None
    assert table.lane[0] == table.lane[1] != table.lane[2]
    # a missing curvature makes its sample unusable; the yaw rate is not needed beside it
    assert table.usable.tolist() == [True, False, False, False]


@pytest.mark.parametrize("word", ["", "NaN", "nan", "NA", "null", "inf", "-inf", "1e400"])
def test_a_missing_number_makes_an_invalid_sample(save, word):
    (table,) = read(save(HEADER + f"a,0,0.1,3.6,25\na,0.1,{word},3.6,25\n"))
    assert table.usable.tolist() == [True, False]


def test_a_lane_without_a_label_is_invalid(save):
    (table,) = read(save(HEADER.replace("speed", "speed,lane") + "a,0,0.1,3.6,25,1\na,0.1,0,3.6,25,\n"))
    assert table.usable.tolist() == [True, False]


def test_parquet_and_gzip_give_the_same_numbers(bump, to_frame, tmp_path, assert_same):
    frame = to_frame(bump(recording=["7"] * 60 + ["8"] * 40, turn_signal=0, valid=1))
    plain, zipped, parquet = (tmp_path / f"d{suffix}" for suffix in (".csv", ".CSV.gz", ".parquet"))
    frame.write_csv(plain)
    zipped.write_bytes(gzip.compress(plain.read_bytes()))
    # typed columns: identifiers and lanes as integers, validity as booleans
    frame.with_columns(pl.col("recording").cast(pl.Int32)).write_parquet(parquet)
    one, two, three = (
        extract_departures(read_recordings(path), vehicle_width=1.8) for path in (plain, zipped, parquet)
    )
    assert_same(one, two)
    assert_same(one, three)
    assert one.candidates == 1


def test_sources_tell_name_size_and_digest(save):
    content = gzip.compress((HEADER + ROWS).encode())
    recordings = read_recordings([save(content, "one.csv.gz"), save(HEADER + "c,0,0,3.6,25\n", "two.csv")])
    assert recordings.sources == ()
    assert [name for table in recordings for name in table.names] == ["a", "b", "c"]
    one, two = recordings.sources
    assert (one.name, one.bytes, one.sha256) == ("one.csv.gz", len(content), hashlib.sha256(content).hexdigest())
    assert two.name == "two.csv"
    assert sum(table.samples for table in recordings) == 4  # iterating again reads again
    assert recordings.sources == (one, two)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
def test_progress_ends_at_the_total(save, tmp_path, suffix):
    path = tmp_path / f"d{suffix}"
    text = (HEADER + ROWS).encode()
    if suffix == ".parquet":
        pl.read_csv(text).write_parquet(path)
    else:
        path.write_bytes(gzip.compress(text) if suffix.endswith("gz") else text)
    seen: list[tuple[int, int]] = []
    read(path, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (path.stat().st_size, path.stat().st_size)
    assert seen == sorted(seen)


def test_polars_is_not_imported_before_reading():
    code = "import sys, ldctoolkit.recordings; sys.exit('polars' in sys.modules)"
    assert run([sys.executable, "-c", code], check=False).returncode == 0


REFUSED_TEXT: dict[str, tuple[str | bytes, str]] = {
    "missing column": (
        HEADER.replace("lane_offset", "lane_ofset") + ROWS,
        "drive.csv: column 'lane_offset' is missing; did you mean 'lane_ofset'?",
    ),
    "no other column": (
        "recording,t,lane_width,speed\n",
        "column 'lane_offset' is missing; no other column of the file could be it",
    ),
    "not a number": (
        HEADER + ROWS + "b,1,left,3.6,25\nb,2,x,3.6,25\n",
        "drive.csv, line 5: column 'lane_offset' holds 'left'; allowed: numbers (2 lines in all)",
    ),
    "decimal comma": (HEADER + 'a,0,"0,1",3.6,25\n', "line 2: column 'lane_offset' holds '0,1'; allowed: numbers"),
    "semicolons": ((HEADER + ROWS).replace(",", ";"), "line 1: columns are not separated by commas"),
    "unsorted": (
        HEADER + ROWS + "b,-0.5,0,3.6,25\n",
        "drive.csv, line 5: column 't', recording 'b': t = -0.5 s comes after t = 0.0 s: times are not sorted",
    ),
    "repeated": (HEADER + ROWS + "b,0,0,3.6,25\n", "line 5: column 't', recording 'b': t = 0.0 s is repeated"),
    "unsorted around a hole": (HEADER + ROWS + "b,,0,3.6,25\nb,-1,0,3.6,25\n", "line 6: column 't', recording 'b'"),
    "two pieces": (
        HEADER + ROWS + "a,9,0,3.6,25\n",
        "drive.csv, line 5: column 'recording': 'a' comes in separate pieces; allowed: each recording in one piece",
    ),
    "no identifier": (HEADER + ROWS + ",9,0,3.6,25\n", "line 5: column 'recording' holds None; allowed: an identifier"),
    "empty": ("", "drive.csv: the file is empty; a header is needed: recording, t,"),
    "blank header": ("\n" + HEADER + ROWS, "drive.csv: line 1 is blank; a header is needed"),
    "header only": (HEADER, "drive.csv: a header but no rows"),
    "all missing": (HEADER + "a,0,,3.6,25\na,1,nan,3.6,25\n", "column 'lane_offset' holds no number in any of 2 rows"),
    "all lanes missing": (
        HEADER.replace("speed", "speed,lane") + "a,0,0,3.6,25,\n",
        "column 'lane' holds no number in any of 1 rows; leave the column out",
    ),
    "column twice": (HEADER.replace("speed", "speed,t") + "a,0,0,3.6,25,1\n", "column 't' appears 2 times"),
    "too many fields": (HEADER + ROWS + "b,1,0,3.6,25,7\n", "line 5: 6 fields; the header has 5 columns"),
    "open quote": (HEADER + ROWS + '"b,1,0,3.6,25\n', "line 5: a quotation mark is not closed on its line"),
    "line break in quotes": (HEADER + '"a\nb",1,0,3.6,25\n', "line 2: a quotation mark is not closed on its line"),
    "latin-1": ((HEADER + ROWS).encode() + b"b\xe4r,1,0,3.6,25\n", "line 5: the text is not UTF-8"),
    "latin-1 header": (b"B\xe4r," + HEADER.encode(), "line 1: the text is not UTF-8"),
    "utf-16": ((HEADER + ROWS).encode("utf-16"), "the text is UTF-16; save it as UTF-8"),
    "gzip inside": (
        gzip.compress((HEADER + ROWS).encode()),
        "the content is gzip; give it a name that ends in .csv.gz",
    ),
    "bad valid": (
        HEADER.replace("speed", "speed,valid") + "a,0,0,3.6,25,maybe\n",
        "line 2: column 'valid' holds 'maybe'; allowed: 0, 1, false, true",
    ),
    "bad turn signal": (
        HEADER.replace("speed", "speed,turn_signal") + "a,0,0,3.6,25,2\n",
        "line 2: column 'turn_signal' holds '2'; allowed: left, right, none, or 1 (left), -1 (right), 0 (none)",
    ),
}


@pytest.mark.parametrize("name", REFUSED_TEXT)
@pytest.mark.parametrize("block_bytes", [1 << 20, 40])
def test_bad_text_is_refused(save, name, block_bytes):
    content, message = REFUSED_TEXT[name]
    if block_bytes == 40 and name in ("not a number", "line break in quotes"):
        message = message.split(" (")[0] if name == "not a number" else "line 2"
    with pytest.raises(RecordingError, match=re.escape(message)):
        read(save(content), block_bytes=block_bytes)


def test_broken_gzip(save):
    content = gzip.compress((HEADER + ROWS * 1).encode())
    broken = [
        content[:-9],
        b"recording,t\n",
        content[:20] + b"\x00\xff" * 8 + content[36:],
        content[:5],
        content + b"x" * 9,
    ]
    for part in broken:
        with pytest.raises(RecordingError, match=r"^drive\.csv\.gz: broken gzip"):
            read(save(part, "drive.csv.gz"))
    with pytest.raises(RecordingError, match=r"^drive\.csv\.gz: the file is empty"):
        read(save(b"", "drive.csv.gz"))


def test_broken_parquet(save, tmp_path):
    pl.read_csv((HEADER + ROWS).encode()).write_parquet(tmp_path / "good.parquet")
    content = (tmp_path / "good.parquet").read_bytes()
    for part in (content[: len(content) // 2], content[:-1], b"", b"PAR1" + b"x" * 50 + b"PAR1"):
        with pytest.raises(RecordingError, match=r"^drive\.parquet: cannot be read as Parquet: "):
            read(save(part, "drive.parquet"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (pl.col("t").cast(pl.Date), "column 't' is of type Date; allowed: numbers"),
        (pl.concat_list("t").alias("lane"), "column 'lane' is of type List(Float64); allowed: text or numbers"),
        (pl.lit(None, pl.String).alias("recording"), "row 1: column 'recording' holds None; allowed: an identifier"),
        (pl.lit(1.0).alias("t"), "row 2: column 't', recording 'a': t = 1.0 s is repeated"),
        (pl.lit("x").alias("speed"), "row 1: column 'speed' holds 'x'; allowed: numbers (3 rows in all)"),
        (pl.lit(None).alias("speed"), "column 'speed' holds no number in any of 3 rows"),
    ],
)
def test_bad_parquet_columns(tmp_path, change, message):
    frame = pl.read_csv((HEADER + ROWS).encode(), schema_overrides={"t": pl.Float64})
    frame.with_columns(change).write_parquet(tmp_path / "drive.parquet")
    with pytest.raises(RecordingError, match=rf"^drive\.parquet.*{re.escape(message)}"):
        read(tmp_path / "drive.parquet")


def test_bad_paths(save, tmp_path):
    good = save(HEADER + ROWS)
    for paths, message in [
        ([good / "below.csv"], r"below\.csv: does not exist"),
        ([tmp_path / ("x" * 300 + ".csv")], "cannot be read: File name too long"),
        ([tmp_path / "nul\0.csv"], "cannot be read: .*embedded null"),
        ([tmp_path / "nowhere.csv"], r"nowhere\.csv: does not exist"),
        ([save("", "drive.txt")], r"drive\.txt: the suffix is not known; allowed: \.csv, \.csv\.gz, \.parquet"),
        ([good, good], r"drive\.csv: given twice"),
    ]:
        with pytest.raises(RecordingError, match=message):
            read_recordings(paths)
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(RecordingError, match=r"folder\.csv: is a folder"):
        read_recordings(tmp_path / "folder.csv")
    with pytest.raises(InputError, match="none given"):
        read_recordings([])
    with pytest.raises(InputError, match="block_bytes"):
        read_recordings(good, block_bytes=0)
    # the same identifier in two files
    with pytest.raises(
        RecordingError, match=r"two\.csv, line 2: column 'recording': 'b' was already read from drive\.csv"
    ):
        read(good, save(HEADER + "b,5,0,3.6,25\n", "two.csv"))


def test_a_file_without_line_breaks_is_not_swallowed(save):
    for content, line in ((b"x" * 3_000_000, 1), (HEADER.encode() + b"x" * 3_000_000, 2)):
        with pytest.raises(RecordingError, match=rf"^drive\.csv, line {line}: longer than 1048576 bytes"):
            read(save(content), block_bytes=1000)


def test_a_file_that_vanishes_meanwhile(save):
    path = save(HEADER + ROWS)
    recordings = read_recordings(path)
    path.unlink()
    with pytest.raises(RecordingError, match=r"drive\.csv: cannot be read"):
        list(recordings)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"recording": []}, "recording: shape"),
        ({"speed": [1.0]}, "speed: shape"),
        ({"recording": ["a", "b", "a"]}, "recording 'a' comes in 2 separate pieces"),
        ({"t": [0, 2, 1]}, "row 2: column 't', recording 'a'"),
        ({"turn_signal": [0, 3, 0]}, r"turn_signal\[1\] = "),
    ],
)
def test_bad_arrays(columns, message):
    good: dict[str, Any] = {"recording": ["a"] * 3, "t": [0, 1, 2], "lane_offset": 0, "lane_width": 3.6, "speed": 25}
    RecordingTable.from_arrays(**good)
    with pytest.raises(RecordingError, match=message):
        RecordingTable.from_arrays(**(good | columns))


FIELD = st.one_of(
    st.floats(-10, 10).map(str),
    st.sampled_from(
        ["a", "b", "", "nan", "inf", "1e308", "-1e308", "0", "1", "3.6", '"', '"a"', "ä", "1e9", "left", "\r"]
    ),
)
LINES = st.lists(st.lists(FIELD, min_size=0, max_size=9).map(",".join), max_size=12)


@settings(max_examples=150, deadline=None)
@given(
    header=st.permutations(["recording", "t", "lane_offset", "lane_width", "speed", "valid", "yaw_rate", "lane"]),
    lines=LINES,
    block=st.integers(1, 200),
)
def test_any_text_is_read_or_refused_in_words(tmp_path_factory, header, lines, block):
    path = tmp_path_factory.mktemp("any") / "drive.csv"
    path.write_text("\n".join([",".join(header), *lines]), encoding="utf-8")
    try:
        found = extract_departures(read_recordings(path, block_bytes=block), min_duration=0.0, min_speed=0.0)
    except LdcError as error:
        assert str(error).startswith("drive.csv")  # noqa: PT017
        return
    assert found.candidates == len(found.departures) + found.refused.total
    assert np.isfinite(found.departures.matrix()).all()
