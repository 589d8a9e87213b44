"""Faults that people report of recordings: each is read right, refused, or warned of, whatever side, rate or amount."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.drives import VEHICLE, clean, held, lane, only, planted
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Extraction, Preparation, Recording, extract_departures

sides = pytest.mark.parametrize("side", [LEFT, RIGHT])
rates = pytest.mark.parametrize("rate", [10.0, 20.0, 100.0])
replace = dataclasses.replace


def extract(*recordings: Recording, **options: Any) -> Extraction:
    return extract_departures(recordings, **({"vehicle_width": VEHICLE} | options))


def refused(extraction: Extraction) -> dict[str, int]:
    return {reason: count for reason, count in extraction.refused.items() if count}


def new_warnings(extraction: Extraction) -> list[str]:
    return [text for text in extraction.warnings if not text.startswith("no column")]


# ------------------------------------------------------------------------------------------------ jumps


def as_recorded(signal: Callable[..., Any], rate: float) -> tuple[Any, ...]:
    t = np.arange(round(20.0 * rate) + 1) / rate
    return t, *signal(t)


def interpolated(signal: Callable[..., Any], rate: float) -> tuple[Any, ...]:
    """A camera of 10 Hz, exported by straight lines."""
    camera, t = np.arange(201) / 10.0, np.arange(round(20.0 * rate) + 1) / rate
    return t, *(np.interp(t, camera, values) for values in signal(camera))


def smoothed(signal: Callable[..., Any], rate: float) -> tuple[Any, ...]:
    """The same, after a moving average of 0.5 s."""
    camera, t = np.arange(201) / 10.0, np.arange(round(20.0 * rate) + 1) / rate
    means = [np.convolve(np.pad(values, 2, "edge"), np.full(5, 0.2), "valid") for values in signal(camera)]
    return t, *(np.interp(t, camera, values) for values in means)


signals = pytest.mark.parametrize("signal", [as_recorded, interpolated, smoothed])


@sides
@rates
@signals
@pytest.mark.parametrize(("step", "beside", "seconds"), [(0.95, 0.0, 1.5), (1.0, 0.0, 4.0), (0.8, 0.3, 0.9)])
def test_a_line_that_jumps_to_another_marking_is_no_departure(signal, rate, side, step, beside, seconds):
    """One line steps inwards while the vehicle goes straight on, in the lane's centre or beside it."""

    def lines(t):
        near = 1.8 - beside - step * ((t > 5.03) & (t < 5.03 + seconds))
        far = -1.8 - beside
        return -side * 0.5 * (near + far), near - far

    t, offset, width = signal(lines, rate)
    extraction = extract(lane(t, offset, width), force=True)
    assert (len(extraction.departures), refused(extraction)) == (0, {"jump": 1})
    noise = 0.03 * np.random.default_rng(1).standard_normal((2, t.size))
    assert len(extract(lane(t, offset + noise[0], width + noise[1]), force=True).departures) == 0


@sides
@rates
@signals
@pytest.mark.parametrize("seconds", [3.0, 5.0, 10.0])
@pytest.mark.parametrize(("width", "step"), [(3.0, None), (3.6, 0.1)])
def test_a_lane_change_is_one_at_any_rate(signal, rate, side, seconds, width, step):
    def changes(t):
        share = np.clip((t - 5.037) / seconds, 0.0, 1.0)
        way = side * width * share**2 * (3.0 - 2.0 * share)
        return way - width * np.round(way / width), np.full(t.size, width)

    t, offset, lanes = signal(changes, rate)
    extraction = extract(lane(t, offset, lanes), force=True, preparation=Preparation(step))
    assert (len(extraction.departures), refused(extraction)) == (0, {"lane_change": 1})


@sides
@pytest.mark.parametrize("labels", [1, np.nan])
def test_a_lane_label_that_never_changes_says_nothing(side, labels):
    """The tracker holds on to the lane that was left: by 0.8 lane widths, out and back."""
    t = np.arange(0.0, 40.0, 0.1)
    share = np.clip((t - 10.0) / 4.0, 0.0, 1.0) - np.clip((t - 16.0) / 4.0, 0.0, 1.0)
    way = side * 0.8 * 3.6 * share**2 * (3.0 - 2.0 * share)
    columns = {} if np.isnan(labels) else {"lane": np.full(t.size, labels, dtype=np.int64)}
    extraction = extract(lane(t, way, **columns), force=True)
    assert (len(extraction.departures), refused(extraction)) == (0, {"lane_change": 1})


# ------------------------------------------------------------------------------------------------ not available


@sides
@pytest.mark.parametrize("rate", [10.0, 20.0, 50.0])
@pytest.mark.parametrize(
    ("column", "code"),
    [
        ("lane_width", 655.35), ("lane_width", 25.5), ("lane_width", 12.7), ("lane_width", -12.8), ("lane_width", 0.0),
        ("lane_offset", 12.7), ("lane_offset", -12.8), ("speed", 182.04), ("yaw_rate", 5.72), ("yaw_rate", 2.55),
    ],
)  # fmt: skip
def test_a_sample_that_is_not_available_is_invalid(rate, side, column, code):
    """Not two departures where one sample of the first has a placeholder."""
    t, offset = planted(rate, side)
    row = int(np.argmin(np.abs(t - 10.5)))
    drive = lane(t, offset, curvature=None, yaw_rate=0.01 * np.sin(0.2 * t))
    values = getattr(drive, column).copy()
    values[row] = code
    extraction = extract(replace(drive, **{column: values}))
    assert (extraction.departures.side.tolist(), extraction.refused.invalid) == ([-side], 1)
    assert extraction.provenance.invalid_samples == 1
    assert extraction.hours * 3600.0 == pytest.approx((t.size - 3) / rate)


@sides
@pytest.mark.parametrize(
    ("column", "code"),
    [
        ("lane_width", 5.11), ("lane_width", 6.35), ("lane_width", 2.55), ("lane_offset", 3.2767), ("speed", 70.83),
        ("speed", 51.1), ("speed", 0.0), ("curvature", 0.0327), ("curvature", 327.67), ("yaw_rate", -1.28),
    ],
)  # fmt: skip
def test_the_end_of_a_range_that_repeats_is_a_code(side, column, code):
    """Half a second in the first departure, and the last three seconds, which are not driving either."""
    t, offset = planted(20.0, side)
    rng = np.random.default_rng(5)
    drive = lane(
        t, offset, 3.6 + 0.01 * rng.standard_normal(t.size), 25.0 + 0.05 * rng.standard_normal(t.size),
        curvature=0.001 * np.sin(0.2 * t) if column == "curvature" else None, yaw_rate=0.01 * np.sin(0.2 * t),
    )  # fmt: skip
    values = getattr(drive, column).copy()
    values[(np.abs(t - 10.5) < 0.25) | (t > 36.95)] = code
    extraction = extract(replace(drive, **{column: values}))
    assert (extraction.departures.side.tolist(), extraction.refused.invalid) == ([-side], 1)
    assert extraction.provenance.invalid_samples == 69
    assert extraction.hours * 3600.0 == pytest.approx((740 - 1 - 10) / 20.0)


# ------------------------------------------------------------------------------------------------ clocks and windows


@sides
@pytest.mark.parametrize(("rate", "frames"), [(20.0, 2), (30.0, 3), (50.0, 5), (100.0, 3), (100.0, 10)])
@pytest.mark.parametrize("apart", [0.0, 0.001])
def test_frames_that_come_in_bursts_give_the_same_curvature(rate, frames, side, apart):
    t, offset = planted(rate, side, noise=0.0)
    bend = 2e-3 * np.sin(2.0 * np.pi * t / 12.0)
    stamps = t[np.minimum(np.arange(t.size) // frames * frames + frames - 1, t.size - 1)]
    stamps = stamps + apart * (np.arange(t.size) % frames)
    columns = {"curvature": None, "yaw_rate": 25.0 * bend}
    even, burst = (extract(lane(times, offset, **columns)).departures for times in (t, stamps))
    assert even.side.tolist() == burst.side.tolist() == [side, -side]
    # the stamps are late by half a burst on average; over a second the bend changes by 1e-3
    late = 0.5 * (frames - 1) / rate
    np.testing.assert_allclose(burst.c_0, even.c_0, atol=1.2e-3 * late + 1e-5)
    np.testing.assert_allclose(burst.dc, even.dc, atol=1e-4)


# ------------------------------------------------------------------------------------------------ units and references

RADIANS = np.pi / 180.0
FAULTS: dict[str, tuple[Callable[[Recording], Recording], str]] = {
    "offset in feet": (lambda r: only(r, "heading", lane_offset=r.lane_offset * 3.2808), "'lane_offset': it moves"),
    "offset without sign": (lambda r: only(r, lane_offset=np.abs(r.lane_offset)), "turns back at zero"),
    "distance to the left": (lambda r: only(r, lane_offset=0.5 * r.lane_width - 0.9 - r.lane_offset), "half of the"),
    "distance to the right": (lambda r: only(r, lane_offset=0.9 - 0.5 * r.lane_width - r.lane_offset), "half of the"),
    "from the right line": (lambda r: only(r, lane_offset=r.lane_offset + 0.5 * r.lane_width), "'lane_offset'"),
    "sign of the offset, heading": (lambda r: only(r, "heading", lane_offset=-r.lane_offset), "goes against"),
    "sign of the offset, yaw rate": (lambda r: only(r, "yaw_rate", lane_offset=-r.lane_offset), "goes against"),
    "sign of the yaw rate": (lambda r: only(r, yaw_rate=-r.yaw_rate), "goes against"),
    "sign of the yaw rate, heading": (lambda r: only(r, "heading", yaw_rate=-r.yaw_rate), "the yaw rate turns against"),
    "yaw rate in deg/s": (lambda r: only(r, yaw_rate=r.yaw_rate / RADIANS), "'yaw_rate'"),
    "yaw rate in deg/s, heading": (lambda r: only(r, "heading", yaw_rate=r.yaw_rate / RADIANS), "'yaw_rate'"),
    "sign of the curvature, yaw rate": (lambda r: only(r, "yaw_rate", curvature=-r.curvature), "the curvature turns"),
    "sign of the curvature, heading": (lambda r: only(r, "heading", curvature=-r.curvature), "the curvature turns"),
    "sign of the steering": (lambda r: only(r, "yaw_rate", steering=-r.steering), "the steering angle turns"),
    "steering against the curvature": (lambda r: only(r, "steering", curvature=-r.curvature), "the steering angle"),
    "curvature as a radius": (lambda r: only(r, curvature=1.0 / r.curvature), "'curvature'"),
    "curvature in 1/km": (lambda r: only(r, curvature=1000.0 * r.curvature), "'curvature'"),
    "curvature in degrees": (lambda r: only(r, curvature=r.curvature / RADIANS), "'curvature'"),
    "speed in km/h": (lambda r: only(r, speed=3.6 * r.speed), "'speed'"),
    "speed in mph, heading": (lambda r: only(r, "heading", speed=2.237 * r.speed), "speed"),
    "compass heading": (lambda r: only(r, "yaw_rate", heading=(360.0 - r.heading / RADIANS) % 360.0), "'heading'"),
    "width in feet": (lambda r: only(r, lane_width=3.2808 * r.lane_width), "'lane_width'"),
    "half of the width": (lambda r: only(r, lane_width=0.5 * r.lane_width), "'lane_width'"),
    "offset in steps of 0.25 m": (lambda r: only(r, lane_offset=np.round(4.0 * r.lane_offset) / 4.0), "in steps of"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_right_is_refused(fault):
    """Drives of two minutes with bends of 1/500 m and more, above 20 m/s, pooled: most single ones tell, too."""
    change, words = FAULTS[fault]
    drives = [clean(seed) for seed in range(60)]
    fit = [r for r in drives if np.abs(r.curvature).max() > 2e-3 and r.speed.min() > 20.0][:5]
    with pytest.raises(RecordingError, match=words):
        extract(*map(change, fit))
    alone = 0
    for recording in fit:
        try:
            extract(change(recording))
        except RecordingError:
            alone += 1
    assert alone >= 4
    forced = extract(*map(change, fit), force=True)
    assert any(words in text for text in forced.warnings)
    assert extract(*(only(r, "curvature", "yaw_rate", "heading", "steering") for r in fit)).candidates > 0


def test_one_side_alone(tmp_path: Path) -> None:
    """A camera that looks past the centre: 20 departures, 19 to the left."""
    t, offset = planted(10.0, LEFT, T=30.0)
    left, both = lane(t, np.where(t < 17.0, offset, 0.02 * np.sin(t))), lane(t, offset)
    to_the_left = [replace(left, name=f"r{i}", lane_offset=left.lane_offset + 1e-4 * i) for i in range(18)]
    with pytest.raises(RecordingError, match="19 of 20 departures are to the left"):
        extract(*to_the_left, both)
    assert len(extract(*to_the_left[:-1], both).departures) == 19
    mirrored = replace(both, name="b", lane_offset=-both.lane_offset)
    assert len(extract(*to_the_left[:-1], both, mirrored).departures) == 21


# ------------------------------------------------------------------------------------------------ own clocks


def slow_lane(drive: Recording, every: float, how: str) -> Recording:
    """A lane signal that is new so seldom, in rows that come more often."""
    t = drive.t
    if how == "missing":
        new = np.append(True, np.diff(np.floor(t / every + 1e-9)) > 0)
        return replace(drive, lane_offset=np.where(new, drive.lane_offset, np.nan))
    if how == "interpolated":
        clock = np.arange(0.0, t[-1] + every, every)
        return replace(drive, lane_offset=np.interp(t, clock, np.interp(clock, t, drive.lane_offset)))
    columns = {"held": ("lane_offset", "lane_width"), "offset": ("lane_offset",)}
    names = columns.get(how, ("lane_offset", "lane_width", "speed", "yaw_rate"))
    return replace(drive, **{name: held(getattr(drive, name), t, every) for name in names})


@pytest.mark.parametrize("how", ["held", "offset", "repeated rows", "missing", "interpolated"])
@pytest.mark.parametrize("step", [None, 0.1])
def test_departures_are_not_made_of_a_signal_that_does_not_move(how, step):
    """Every 2 s in rows of 10 Hz and more; then a departure has three samples beyond the line, in 4 s."""
    drives = [only(clean(seed, T=150.0), "yaw_rate") for seed in range(10)]
    extraction = extract(*(slow_lane(r, 2.0, how) for r in drives), preparation=Preparation(step), force=True)
    assert extraction.departures.T.min(initial=10.0) > 4.0
    assert extraction.refused.too_few_samples > 5
    (warning,) = [text for text in extraction.warnings if text.startswith("the lane is new")]
    refresh, shortest = "the lane is new every 2 s only", "departures of less than about 6 s cannot be found"
    assert warning == f"{refresh}: {shortest}: 10 of 10 recordings"
    assert len(extract(*drives, preparation=Preparation(step)).departures) > 15


@pytest.mark.parametrize("every", [0.2, 0.4])
def test_a_camera_that_is_slower_than_its_rows_keeps_its_departures(every):
    drives = [only(clean(seed, rate=50.0, noise=0.0), "yaw_rate") for seed in range(4)]
    true, slow = extract(*drives).departures, extract(*(slow_lane(r, every, "held") for r in drives)).departures
    assert 0 < len(slow) <= len(true)
    same = np.abs(true.start_time[:, None] - slow.start_time).argmin(axis=0)
    assert (
        np.abs(true.start_time[same] - slow.start_time).max() < 0.5 * every
    )  # between two values, not at the next one
    assert np.abs(true.T[same] - slow.T).max() < 0.5 * every


@pytest.mark.parametrize("column", ["speed", "yaw_rate"])
@pytest.mark.parametrize("how", ["held", "missing"])
@pytest.mark.parametrize("every", [0.2, 0.5, 1.0])
def test_a_signal_on_a_clock_of_its_own_is_interpolated(column, how, every):
    drive = only(clean(11, rate=20.0), "yaw_rate")
    values = getattr(drive, column)
    new = np.append(True, np.diff(np.floor(drive.t / every + 1e-9)) > 0)
    slow = held(values, drive.t, every) if how == "held" else np.where(new, values, np.nan)
    true, extraction = extract(drive), extract(replace(drive, **{column: slow}))
    assert extraction.departures.T.tolist() == pytest.approx(true.departures.T.tolist())
    np.testing.assert_allclose(extraction.departures.v_mean, true.departures.v_mean, atol=0.1)
    np.testing.assert_allclose(extraction.departures.c_0, true.departures.c_0, atol=1.5e-3)
    notes = [f"{column} is new every {every:g} s only, and interpolated between: 1 of 1 recordings"]
    assert new_warnings(extraction) == ([] if (how, every) == ("held", 0.2) else notes)


def test_two_clocks_in_one_table():
    """Rows of the camera and of the bus in turns, as an outer join leaves them."""
    drive = only(clean(11, rate=20.0), "yaw_rate")
    t = np.sort(np.concatenate([drive.t, drive.t + 0.003]))
    camera = np.arange(t.size) % 2 == 0

    def beside(values: Any, there: Any) -> Any:
        return np.where(there, np.repeat(values, 2), np.nan)

    both = Recording(
        "a", t, beside(drive.lane_offset, camera), beside(drive.lane_width, camera), beside(drive.speed, ~camera),
        np.ones(t.size, dtype=bool), yaw_rate=beside(drive.yaw_rate, ~camera),
    )  # fmt: skip
    true, departures = extract(drive).departures, extract(both).departures
    assert len(true) == len(departures) > 0
    np.testing.assert_allclose(departures.start_time, true.start_time, atol=1e-9)


# ------------------------------------------------------------------------------------------------ no false alarm


def test_clean_drives_are_extracted_without_a_word():
    """200 drives, with any of the signals, on any number of decimals; alone and together."""
    drives = []
    for seed in range(200):
        signals = ["curvature", "yaw_rate", "heading", "steering"]
        drive = only(clean(1000 + seed, T=30.0 + seed), *signals[seed % 4 :: 1 + seed % 2])
        if seed % 3:
            decimals = 1 + seed % 3
            drive = replace(
                drive, **{name: np.round(getattr(drive, name), decimals) for name in ("lane_offset", "speed")}
            )
        assert new_warnings(extract(drive)) == []
        drives.append(drive)
    extraction = extract(*drives)
    assert new_warnings(extraction) == []
    assert len(extraction.departures) > 300
