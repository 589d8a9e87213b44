"""The SPMD tables DataLane and DataWsu."""

import dataclasses
import pickle
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers import spmd
from helpers.bits import examples
from helpers.planted import assert_planted
from helpers.recordings import read_source
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Criteria, Preparation, Recording, extract_part
from ldctoolkit.recordings.departures_table import PartResult, combined_results
from ldctoolkit.recordings.recording import FoundParts
from ldctoolkit.recordings.spmd_das1 import READER, nearest_rows
from ldctoolkit.recordings.trip_tables import TripPart


def extracted(source: FoundParts[TripPart]) -> PartResult:
    criteria, preparation = Criteria(vehicle_width=READER.vehicle_width), Preparation(step=READER.step)
    return combined_results(extract_part(part, criteria, preparation) for part in source.parts)


def assert_same(left: Iterable[Recording], right: Iterable[Recording]) -> None:
    for recording, other_recording in zip(left, right, strict=True):
        assert recording.name == other_recording.name
        for column in Recording.COLUMNS:
            np.testing.assert_array_equal(getattr(recording, column), getattr(other_recording, column))


@pytest.mark.parametrize("first", [0, 43580])
def test_planted_departures_are_given_back(tmp_path: Path, first: int) -> None:
    spmd.write_tables(tmp_path, [spmd.planted_drive(10107, 60, first=first)])
    departures = extracted(READER.open([tmp_path])).departures
    assert set(departures.recording) == {"10107/60"}
    assert_planted(departures, spmd.PLANTED, spmd.curvature_at, clock=first / 100.0)


def test_units_signs_and_validity(tmp_path: Path) -> None:
    lane = (
        "Device,Trip,Time,LaneDistanceLeft,LaneDistanceRight,LaneHeading,LaneQualityRight,LaneQualityLeft\n"
        "7,1,0,-1.5,2.5,-9.5000006E-3,2,3\n"
        "7,1,10,-1.875,1.875,-1.024,3,3\n"
        "7,1,20,-1.5,2.5,0,1,3\n"
        "7,1,30,-1.5,2.5,0,3,0\n"
        "7,1,40,-1.5,NULL,0,3,3\n"
        "7,1,50,1.5,-2.5,0,3,3\n"
        "7,1,60,-2.0,1.5,0,3,3\n"
        "7,1,70,-2.0,1.5,0,3,3\n"
    )
    header = ["Device", "Trip", "Time", *spmd.WSU_COLUMNS[3:]]
    base = dict.fromkeys(header, 0) | {"Device": 7, "Trip": 1, "GpsValidWsu": 1, "GpsSpeedWsu": 9.0, "ValidCanWsu": 1}
    base |= {"SpeedWsu": 36.0, "YawRateWsu": 180.0, "GpsHeadingWsu": 90.0}
    changes: list[dict[str, object]] = [
        {}, {"TurnSngLWsu": 1.0}, {"TurnSngRWsu": 1}, {"TurnSngRWsu": 1, "TurnSngLWsu": 1}, {"ValidCanWsu": 0},
        {"ValidCanWsu": 0, "GpsValidWsu": 0}, {"SpeedWsu": "NULL"},
    ]  # fmt: skip
    rows = [base | {"Time": 10 * i} | change for i, change in enumerate(changes)]
    wsu = "\n".join([",".join(header), *(",".join(str(row[name]) for name in header) for row in rows)])
    (tmp_path / "DataLane.csv").write_text(lane)
    (tmp_path / "DataWsu.csv").write_text(wsu)
    (recording,), problems = read_source(READER.open([tmp_path]))
    assert (problems, recording.name, recording.source) == ([], "7/1", "DataLane.csv")
    nan = np.nan
    np.testing.assert_allclose(recording.t, np.arange(8) * 0.1)
    np.testing.assert_array_equal(recording.lane_offset, [0.5, 0.0, 0.5, 0.5, nan, -0.5, -0.25, -0.25])
    np.testing.assert_array_equal(recording.lane_width, [4.0, 3.75, 4.0, 4.0, nan, -4.0, 3.5, 3.5])
    np.testing.assert_array_equal(recording.valid, [True, False, False, False, False, False, True, True])
    np.testing.assert_allclose(recording.speed, [10, 10, 10, 10, 9, nan, 9, nan])
    np.testing.assert_allclose(recording.yaw_rate, [np.pi, np.pi, np.pi, np.pi, nan, nan, np.pi, nan])
    np.testing.assert_allclose(recording.heading, -np.pi / 2 * np.array([1, 1, 1, 1, 1, nan, 1, nan]))
    np.testing.assert_array_equal(recording.turn_signal, [0, 1, -1, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(("lag", "near"), [(4, True), (-4, True), (5, True), (-5, True), (6, False), (-6, False)])
def test_a_lag_of_more_than_half_a_step_joins_nothing(tmp_path: Path, lag: int, near: bool) -> None:
    """Every second lane row is left out, so that the next row of DataWsu is no nearer."""
    drive = spmd.planted_drive(7, 1, rows=100, speed=20.0 + np.arange(100) / 8)
    spmd.write_tables(tmp_path, [drive], lag=lag)
    wsu = spmd.wsu_frame([drive], lag=lag)[::2]
    (tmp_path / "DataWsu.csv").write_bytes(spmd.text_of(wsu))
    (recording,), _ = read_source(READER.open([tmp_path]))
    expected = wsu["SpeedWsu"].to_numpy() / 3.6
    np.testing.assert_allclose(recording.speed[::2], expected if near else np.full(50, np.nan), rtol=1e-12)


def fleet() -> list[object]:
    rng = np.random.default_rng(5)
    return [
        spmd.planted_drive(10100 + i // 7, i, spmd.PLANTED[: i % 9], first=int(rng.integers(0, 999)), rows=300 + 97 * i)
        for i in range(17)
    ]


def test_parts_of_any_size_give_the_same(tmp_path: Path) -> None:
    drives = fleet()
    spmd.write_tables(tmp_path, drives[:9], suffix="_October")
    spmd.write_tables(tmp_path, drives[9:], suffix="_April")
    whole = READER.open([tmp_path])
    recordings, problems = read_source(whole)
    assert len(whole.parts) == 2  # two lane tables
    assert [r.name for r in recordings] == [f"{10100 + i // 7}/{i}" for i in (*range(9, 17), *range(9))]
    assert (problems, whole.problems) == ([], ())
    departures = extracted(whole).departures
    assert departures.n > 50
    largest = [part.bytes for part in dataclasses.replace(READER, part_bytes=1).open([tmp_path]).parts]  # one trip each
    assert len(largest) == len(drives)
    for part_bytes in (1, 100_000):
        source = dataclasses.replace(READER, part_bytes=part_bytes).open([tmp_path])
        assert len(source.parts) > 2
        assert len({part.key for part in source.parts}) == len(source.parts)
        assert sum(part.bytes for part in source.parts) == sum(part.bytes for part in whole.parts)
        # what bounds the memory: a part ends with the trip that fills it
        assert max(part.bytes for part in source.parts) < part_bytes + max(largest)
        assert_same(read_source(source)[0], recordings)
        in_parts = extracted(source).departures
        np.testing.assert_array_equal(in_parts.matrix(), departures.matrix())
        np.testing.assert_array_equal(in_parts.recording, departures.recording)
    assert pickle.loads(pickle.dumps(whole.parts)) == whole.parts


def test_the_order_of_trips_in_the_other_table_does_not_matter(tmp_path: Path) -> None:
    drives = fleet()
    lane, wsu = spmd.write_tables(tmp_path, drives)
    recordings, _ = read_source(READER.open([lane, wsu]))
    wsu.write_bytes(spmd.text_of(spmd.wsu_frame(drives[::-1])))
    assert_same(read_source(READER.open([wsu, lane]))[0], recordings)


def test_columns_are_found_by_name(tmp_path: Path) -> None:
    drives = fleet()[:3]
    lane, wsu = spmd.write_tables(tmp_path, drives)
    recordings, _ = read_source(READER.open([tmp_path]))
    frame = spmd.lane_frame(drives)
    order = ["Device", "Trip", *reversed([name for name in spmd.LANE_COLUMNS[2:] if name != "LaneHeading"])]
    lane.write_bytes(spmd.text_of(frame.select(order)).replace(b"LaneDistanceLeft", b" lanedistanceleft "))
    wsu.write_bytes(spmd.text_of(spmd.wsu_frame(drives).with_columns(pl.lit('a "word"').alias("Note"))))
    assert_same(read_source(READER.open([tmp_path]))[0], recordings)


def test_tables_with_one_name_are_told_apart(tmp_path: Path) -> None:
    for i, month in enumerate(("october", "april")):
        (tmp_path / month).mkdir()
        spmd.write_tables(tmp_path / month, fleet()[2 * i : 2 * i + 2])
    source = READER.open([tmp_path])
    assert [file.name for file in source.files] == [
        "april/DataLane.csv", "october/DataLane.csv", "april/DataWsu.csv", "october/DataWsu.csv",
    ]  # fmt: skip
    assert {r.source for r in read_source(source)[0]} == {"april/DataLane.csv", "october/DataLane.csv"}


@pytest.mark.parametrize(("folder", "suffix"), [("two-month", ""), ("one-day", "_04_11_13")])
def test_the_real_heads_with_a_made_partner(sample: Path, tmp_path: Path, folder: str, suffix: str) -> None:
    lane, wsu = sample / folder / f"DataLane{suffix}.csv", sample / folder / f"DataWsu{suffix}.csv"
    for path, make in ((lane, spmd.wsu_frame), (wsu, spmd.lane_frame)):
        real = pl.read_csv(path, columns=["Device", "Trip", "Time"])
        device, trip = real["Device"][0], real["Trip"][0]
        drive = spmd.planted_drive(device, trip, first=real["Time"][0], rows=real.height)
        partner = tmp_path / "partner.csv"
        partner.write_bytes(spmd.text_of(make([drive])))
        (recording,), problems = read_source(READER.open([path, partner]))
        assert (problems, recording.name) == ([], f"{device}/{trip}")
        assert recording.samples == real.height == 19
        np.testing.assert_allclose(recording.t, real["Time"].to_numpy() / 100)
        assert np.isfinite(recording.speed).all()
        full = pl.read_csv(path)
        if path is wsu:
            np.testing.assert_allclose(recording.speed * 3.6, full["SpeedWsu"].to_numpy(), rtol=1e-12)
        else:
            usable = (full["LaneQualityLeft"] > 1) & (full["LaneQualityRight"] > 1)
            np.testing.assert_array_equal(recording.valid, usable.to_numpy())
            width = (full["LaneDistanceRight"] - full["LaneDistanceLeft"]).to_numpy()
            np.testing.assert_array_equal(recording.lane_width, width)


def test_nothing_to_read(tmp_path: Path) -> None:
    lane, wsu = spmd.write_tables(tmp_path, fleet()[:1])
    with pytest.raises(RecordingError, match="no table DataWsu"):
        READER.open([lane])
    with pytest.raises(RecordingError, match="no table DataLane"):
        READER.open([wsu])
    with pytest.raises(RecordingError, match="no table DataLane"):
        READER.open([tmp_path / "nowhere"])


Rows = list[tuple[int, float]]

near = st.integers(0, 60).map(float)
fine = st.integers(0, 3000).map(lambda value: value / 100.0)
far = st.sampled_from([-1e9, -7.0, 0.0, 99.0, 1e9, 1e10])
rows = st.lists(st.tuples(st.integers(0, 4), st.one_of(near, fine, far)), max_size=40).map(sorted)


def by_hand(left: Rows, right: Rows, tolerance: float) -> list[int]:
    """Every pair looked at; the earliest of those that are nearest."""
    result = []
    for trip, t in left:
        best = -1
        for i, (other_trip, u) in enumerate(right):
            if other_trip == trip and abs(u - t) <= tolerance and (best < 0 or abs(u - t) < abs(right[best][1] - t)):
                best = i
        result.append(best)
    return result


def columns(given_rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    return np.array([row[0] for row in given_rows], dtype=np.int64), np.array(
        [row[1] for row in given_rows], dtype=float
    )


@examples(400)
@given(left=rows, right=rows, tolerance=st.sampled_from([5.0, 0.5, 7.25, 40.0]))
def test_the_join_is_that_of_all_pairs(left: Rows, right: Rows, tolerance: float) -> None:
    assert nearest_rows(*columns(left), *columns(right), tolerance).tolist() == by_hand(left, right, tolerance)


def test_long_drives_keep_their_digits() -> None:
    t = np.tile(np.arange(0.0, 8.64e6, 80.0), 3)
    trip = np.repeat(np.arange(3), t.size // 3)
    shift = np.random.default_rng(1).uniform(-4.99, 4.99, t.size).round(2)
    assert nearest_rows(trip, t, trip, t + shift, 5.0).tolist() == list(range(t.size))
