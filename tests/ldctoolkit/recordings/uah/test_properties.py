"""Whatever bytes the files hold: recordings, problems or an `LdcError`, nothing else."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ldctoolkit.errors import LdcError
from ldctoolkit.recordings.criteria import Criteria
from ldctoolkit.recordings.extract_part import extract_part
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.rising_times import rising_rows
from ldctoolkit.recordings.uah.text import Column, number, read_number_text
from ldctoolkit.recordings.uah_driveset import READER

FILES = ("PROC_LANE_DETECTION.txt", "RAW_GPS.txt", "RAW_ACCELEROMETERS.txt")
NAME = "20151110175712-16km-D1-NORMAL1-SECONDARY"
CRITERIA = Criteria(vehicle_width=1.8)
PREPARATION = Preparation(step=0.1, nominal_lane_width=3.5)


def sound_files() -> tuple[bytes, ...]:
    """A few seconds with one departure, in as few lines as will do."""
    t = np.arange(1.0, 7.0, 0.1)
    x = -np.clip(1.15 - 0.4 * (t - 4.0) ** 2, 0.0, None)
    lane = "".join(f"{a:.2f} {b:.3f} 0 3.5 2\n" for a, b in zip(t, x, strict=True))
    gps = "".join(f"{a:.1f} 90 40.5 -3.4 600 6 10 {5 * a:.0f} 0 0\n" for a in np.arange(0.5, 8.0))
    yaw = "".join(f"{a:.1f} 1 0 0 0 0 0 0 0 0 {np.angle(np.exp(1j * (3.0 + 0.1 * a))):.4f}\n" for a in t)
    return lane.encode(), gps.encode(), yaw.encode()


SOUND = sound_files()
ODD = (
    b"", b"\n", b"\r", b" ", b"\t", b"\0", b"-", b".", b"e", b"nan", b"-inf", b"1e308", b"-1e308", b"1e-320", b",",
    b";", b"-9", b"2", b"99999999", b"\xff\xfe", b"\xef\xbb\xbf", b"\x80", b"1_0", b"\n1 1 1 1 2\n", b"1e999",
    b"0x1", b"\x0b",
)  # fmt: skip


@st.composite
def damaged(draw: st.DrawFn, sound: bytes) -> bytes:
    """A sound file with pieces cut, doubled, moved or replaced."""
    data = sound
    for _ in range(draw(st.integers(0, 4))):
        a, b = sorted(draw(st.tuples(st.integers(0, len(data)), st.integers(0, len(data)))))
        piece = draw(st.sampled_from([*ODD, data[a:b], data[a:b][::-1]]) | st.binary(max_size=30))
        short = min(b, a + draw(st.sampled_from([0, 1, 5, 10_000])))
        data = (data[:a] + piece + data[short:])[:20_000]
    return data


CONTENT = [st.binary(max_size=200) | damaged(SOUND[i]) | st.sampled_from(SOUND) for i in range(3)]


def check(contents: tuple[bytes, ...]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        trip = Path(folder, NAME)
        trip.mkdir()
        for name, content in zip(FILES, contents, strict=True):
            (trip / name).write_bytes(content)
        try:
            source = READER.open([trip])
            items = [item for part in source.parts for item in part.read()]
            result = extract_part(source.parts[0], CRITERIA, PREPARATION)
        except LdcError:
            return
    assert all(isinstance(item, Recording | Problem) for item in items)
    assert items
    assert all(folder not in str(item) for item in items if isinstance(item, Problem))
    assert np.isfinite(result.departures.matrix()).all()
    assert (result.departures.T > 0.0).all()


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.tuples(*CONTENT))
def test_any_content(contents):
    check(contents)


@pytest.mark.slow
@settings(max_examples=10_000, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.tuples(*CONTENT))
def test_any_content_at_length(contents):
    check(contents)


def test_the_sound_files_hold_a_departure(tmp_path):
    folder = tmp_path / NAME
    folder.mkdir()
    for name, content in zip(FILES, SOUND, strict=True):
        (folder / name).write_bytes(content)
    (part,) = READER.open([folder]).parts
    assert extract_part(part, CRITERIA, PREPARATION).departures.side.tolist() == [1]


COLUMNS = (Column(0, "time"), Column(1, "offset"), Column(3, "lane width"))
TOKENS = st.sampled_from(
    [
        "1",
        "2.5",
        "-9",
        "+3",
        ".5",
        "1e3",
        "-1E-3",
        "nan",
        "inf",
        "x",
        "1_0",
        "\u0663",
        "0x1",
        "1,5",
        "#",
        '"1"',
        "NULL",
        "é",
    ]
)
LINES = st.lists(TOKENS, max_size=6).flatmap(
    lambda tokens: st.sampled_from([" ", "  ", "\t"]).map(lambda s: s.join(tokens))
)


@settings(max_examples=300, deadline=None)
@given(st.lists(LINES, max_size=8), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_against_plain_python(lines, end, last):
    """Line by line with nothing but `split` and `float`."""
    text = end.join(lines) + (end if last else "")
    expected, faulty = [], []
    for line, content in enumerate(lines, start=1):
        tokens = content.split()
        if not tokens:
            continue
        try:
            if not content.isascii() or "_" in content:
                raise ValueError
            row = [float(tokens[i]) for i in (0, 1, 3)]
            if not abs(row[0]) < 1e9:
                raise ValueError
            expected.append(row)
        except (ValueError, IndexError):
            # a token that is not read may be anything
            used = [tokens[i] for i in (0, 1, 3) if i < len(tokens)]
            if len(used) == 3 and all(number(token) is not None for token in used) and abs(float(used[0])) < 1e9:
                expected.append([float(token) for token in used])
            else:
                faulty.append(line)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.txt")
        path.write_bytes(text.encode())
        found = read_number_text(path, "a.txt", COLUMNS)
    if found.values is None:
        assert len(found.problems) == 1
        # a whole file is refused only for its delimiter or because no line is good
        assert not expected or "decimal comma" in found.problems[0].what
        return
    rows = np.array(expected)
    kept = rising_rows(rows[:, 0])
    np.testing.assert_array_equal(found.values, rows[kept])
    told = [problem for problem in found.problems if "time runs" not in problem.what]
    assert [problem.place for problem in told][:5] == [f"line {line}" for line in faulty[:5]]
    assert len(found.problems) - len(told) == (not kept.all())
