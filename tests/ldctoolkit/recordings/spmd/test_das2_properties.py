"""HV_Primary against plain Python."""

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from helpers import das2
from helpers.examples import examples
from ldctoolkit.recordings.recording import Problem, Recording
from ldctoolkit.recordings.spmd_das2 import SpmdDas2

NUMBER = st.sampled_from(
    ["0", "1", "-1483.0", "2077.0", "3.1524999999999997E-2", " 3600 ", "499", "500", "900", "NULL", "", "  ", "15   ",
     "nan", "-1800", "1800", "3600", "1e308", "-inf", "-2e9"]
)  # fmt: skip
CELL = NUMBER | st.sampled_from(["x", "1;2", "1_0", "0x1", "--1", "é"])
PLACES = {
    "time": 2, "heading": 6, "gps_speed": 11, "gps_valid": 13, "speed": 20, "signal_left": 26, "signal_right": 27,
    "yaw_rate": 29, "left": 32, "right": 33, "width": 34, "p_left": 35, "p_right": 36,
}  # fmt: skip


@st.composite
def rows(draw: st.DrawFn) -> list[str]:
    """Some lines of one to three trips, with odd cells here and there, some cells too many or too few."""
    found = []
    for i in range(draw(st.integers(1, 8))):
        cells = ["0"] * draw(st.sampled_from([45, 45, 53, 53, 44, 46, 52]))
        cells[:3] = [str(draw(st.integers(1, 2))), "7", str(100 * i)]
        for place in PLACES.values():
            if draw(st.integers(0, 3)):
                cells[place] = draw(NUMBER if draw(st.integers(0, 9)) else CELL) if place != 2 else cells[2]
        if not draw(st.integers(0, 9)):
            cells[2] = draw(CELL)
        found.append(",".join(cells))
    return found


def number(text: str) -> float | None:
    """What a cell holds, by plain Python; None for a word."""
    text = text.strip()
    if text.lower() in ("", "null", "nan"):
        return math.nan
    if "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def by_hand(lines: list[str]) -> tuple[dict[str, list[tuple[float, ...]]], set[int]]:
    """Samples of each trip, and numbers of the lines that are left out (times that run backwards aside)."""
    trips: dict[str, list[tuple[float, ...]]] = {}
    faulty = set()
    for i, line in enumerate(lines, start=2):
        cells = line.split(",")
        values = {name: number(cells[place]) for name, place in PLACES.items() if place < len(cells)}
        if len(cells) not in (45, 53) or None in values.values() or not abs(values["time"]) < 1e11:  # type: ignore[arg-type]
            faulty.add(i)
            continue
        v: Any = {
            name: x if name == "time" or abs(x) < 1e9 else math.nan  # type: ignore[arg-type]
            for name, x in values.items()
        }
        width = (v["right"] - v["left"]) / 1000
        valid = v["p_left"] >= 500 and v["p_right"] >= 500 and width > 0
        if v["width"] > 0 and not abs(width - v["width"] / 1000) <= 0.5:
            valid = False
        gps = v["gps_valid"] == 1
        speed = v["speed"] if not math.isnan(v["speed"]) else v["gps_speed"] if gps else math.nan
        trips.setdefault(f"{cells[0]}/{cells[1]}", []).append(
            (
                v["time"] / 1000, (v["left"] + v["right"]) / 2000, width, speed, valid, math.radians(v["yaw_rate"]),
                -math.radians(v["heading"]) if gps else math.nan, (v["signal_left"] > 0) - (v["signal_right"] > 0),
            )
        )  # fmt: skip
    return trips, faulty


@examples(150, suppress_health_check=[HealthCheck.too_slow])
@given(rows(), st.sampled_from(["\n", "\r\n"]), st.booleans(), st.integers(1, 3000))
def test_against_plain_python(lines: list[str], end: str, ended: bool, part_bytes: int) -> None:
    expected, faulty = by_hand(lines)
    text = das2.HEADER + end + end.join(lines) + end * ended
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "HV_Primary.csv")
        path.write_bytes(text.encode())
        source = SpmdDas2(part_bytes=part_bytes).open([path])
        items = [item for part in source.parts for item in part.read()]
    found = {item.name: item for item in items if isinstance(item, Recording)}
    reported = [*source.problems, *(item for item in items if isinstance(item, Problem))]
    assert {one.place for one in reported if "backwards" not in one.what and "goes on here" not in one.what} == {
        f"line {line}" for line in faulty
    }
    assert set(found) == set(expected)
    for name, samples in expected.items():
        t = [sample[0] for sample in samples]
        one = found[name]
        if t != sorted(t):
            # whole pieces of a trip are put in order; single rows that are not go
            assert one.samples < len(t) or np.allclose(one.t, sorted(t), rtol=1e-12, atol=1e-12)
            continue
        columns = (one.t, one.lane_offset, one.lane_width, one.speed, one.valid, one.yaw_rate, one.heading)
        for column, values in zip((*columns, one.turn_signal), zip(*samples, strict=True), strict=True):
            np.testing.assert_allclose(np.asarray(column, float), np.array(values, float), rtol=1e-12, atol=1e-12)
