"""Whatever stands in the files: recordings and problems, or an error of the toolkit; nothing else."""

from __future__ import annotations

import tempfile
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import Criteria, PartResult, Preparation, extract_part
from ldctoolkit.recordings.spmd_das1 import SpmdDas1

CELLS = [
    b"", b"NULL", b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-320", b"0", b"-0", b"3", b"10", b"9" * 20,
    b"x", b"\xff", b"\x00", b'"', b'"3"', b" 5 ", b"1;2", b"\t", b"1.5.5", b"\xef\xbb\xbf", b"\xc3\xa4", b"1_0",
    b"-1.875",
]  # fmt: skip
LINES = [
    b"",
    b"   ",
    b",",
    b",,,,,,,",
    b"7,1",
    b"7,1,",
    b"7,2,0,-1.8,1.8,0,3,3",
    b"\r",
    b"#",
    b"7,1,5,x\r",
    b"\x00" * 9,
]
WHOLE = [
    b"",
    b"\n",
    b"\xef\xbb\xbf",
    b"\xff\xfe",
    b"\x1f\x8b",
    b"PK",
    b"Device,Trip,Time",
    b"\r",
    b"a,b\n",
    b"Device;Trip\n",
]

cell = st.tuples(st.just("cell"), st.integers(0, 60), st.integers(0, 30), st.sampled_from(CELLS))
line = st.tuples(st.just("line"), st.integers(0, 60), st.sampled_from(["put", "insert"]), st.sampled_from(LINES))
copy = st.tuples(st.just("copy"), st.integers(0, 60), st.integers(0, 60), st.integers(1, 30))
cut = st.tuples(st.just("cut"), st.integers(0, 4000))
drop = st.tuples(st.just("drop"), st.integers(0, 4000), st.integers(1, 200))
byte = st.tuples(st.just("byte"), st.integers(0, 4000), st.binary(min_size=1, max_size=4))
end = st.tuples(st.just("end"), st.sampled_from([b"\n", b"\r\n", b"\r", b"\n\r", b"\r\r\n"]))
code = st.tuples(st.just("code"), st.sampled_from(["utf-16", "utf-16-le", "utf-8-sig", "utf-32"]))
mark = st.tuples(st.just("mark"), st.sampled_from([b";", b"\t", b"|", b" ", b", "]))
whole = st.tuples(st.just("whole"), st.one_of(st.sampled_from(WHOLE), st.binary(max_size=200)))
edits = st.lists(st.one_of(cell, line, copy, cut, drop, byte, cell, line, end, code, mark, whole), max_size=4)


def edited(text: bytes, changes: list[tuple]) -> bytes:  # type: ignore[type-arg]
    for kind, *how in changes:
        lines = text.split(b"\n")
        if kind == "cell":
            row, column, value = how
            cells = lines[row % len(lines)].split(b",")
            cells[column % len(cells)] = value
            lines[row % len(lines)] = b",".join(cells)
            text = b"\n".join(lines)
        elif kind == "line":
            row, way, value = how
            lines[row % len(lines) : row % len(lines) + (way == "put")] = [value]
            text = b"\n".join(lines)
        elif kind == "copy":
            first, to, count = how
            lines[to:to] = lines[first : first + count]
            text = b"\n".join(lines)
        elif kind == "cut":
            text = text[: how[0] % (len(text) + 1)]
        elif kind == "drop":
            at = how[0] % (len(text) + 1)
            text = text[:at] + text[at + how[1] :]
        elif kind == "byte":
            at = how[0] % (len(text) + 1)
            text = text[:at] + how[1] + text[at:]
        elif kind == "end":
            text = text.replace(b"\r\n", b"\n").replace(b"\n", how[0])
        elif kind == "code":
            text = text.decode("utf-8", "replace").encode(how[0])
        elif kind == "mark":
            text = text.replace(b",", how[0])
        else:
            text = how[0]
    return text


def check(lane: bytes, wsu: bytes, part_bytes: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "DataLane.csv").write_bytes(lane)
        (folder / "DataWsu.csv").write_bytes(wsu)
        reader = SpmdDas1(part_bytes=part_bytes)
        assert isinstance(reader.recognise([folder]), str)
        try:
            source = reader.open([folder])
        except LdcError:
            return
        criteria, preparation = Criteria(vehicle_width=1.82), Preparation(step=0.1)
        for part in source.parts:
            result: PartResult = extract_part(part, criteria, preparation)
            assert np.isfinite(result.departures.matrix()).all()
            for problem in (*source.problems, *result.problems):
                assert problem.file in ("DataLane.csv", "DataWsu.csv")
                assert "\n" not in str(problem)
                assert len(str(problem)) < 400


@pytest.fixture(scope="module")
def clean(das1: ModuleType) -> tuple[bytes, bytes]:
    drives = [das1.planted_drive(7, trip, (das1.Planted(1, 0.5, 1.2, 0.2),), rows=25) for trip in (1, 2)]
    return das1.text_of(das1.lane_frame(drives)), das1.text_of(das1.wsu_frame(drives))


options = {"deadline": None, "suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow]}


@settings(max_examples=60, **options)
@given(lane=edits, wsu=edits, part_bytes=st.sampled_from([1, 1 << 24]))
def test_any_content(clean: tuple[bytes, bytes], lane: list, wsu: list, part_bytes: int) -> None:  # type: ignore[type-arg]
    check(edited(clean[0], lane), edited(clean[1], wsu), part_bytes)


@pytest.mark.slow
@settings(max_examples=3000, **options)
@given(lane=edits, wsu=edits, part_bytes=st.sampled_from([1, 1 << 24]))
def test_any_content_at_length(clean: tuple[bytes, bytes], lane: list, wsu: list, part_bytes: int) -> None:  # type: ignore[type-arg]
    check(edited(clean[0], lane), edited(clean[1], wsu), part_bytes)
