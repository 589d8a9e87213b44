"""What looks wrong with recordings: units, scale, signs, repeated recordings."""

import dataclasses
import math
import re
import sys
from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.recordings import Preparation, Recording, extract_departures
from ldctoolkit.recordings.extract import few_usable, quality_warnings, table_of
from ldctoolkit.recordings.preparation import FILLED
from ldctoolkit.recordings.quality import no_statistics, unit_counts, unit_warnings
from ldctoolkit.recordings.recording import usable_samples

N = 6000
T_EVIDENCE = np.arange(N) * 0.1
LANE = "no column 'lane': a lane change is seen only as a jump of the offset by about a lane width"


def bends(seed: int = 0, largest: float = 0.06) -> np.ndarray:
    """Yaw rate [rad/s] of a drive through bends."""
    phase = np.random.default_rng(seed).uniform(0.0, 6.0)
    return largest * np.sin(2.0 * math.pi * T_EVIDENCE / 40.0 + phase)


def drive_evidence(name: str = "a", seed: int = 0, **changes: Any) -> Recording:
    rng = np.random.default_rng(seed)
    rate = changes.pop("true_rate", bends(seed))
    columns: dict[str, Any] = {
        "lane_offset": 0.2 * np.sin(0.3 * T_EVIDENCE) + rng.normal(0.0, 0.01, N),
        "lane_width": np.full(N, 3.5),
        "speed": np.full(N, 25.0),
        "valid": np.ones(N, bool),
        "yaw_rate": rate,
        "heading": (np.cumsum(rate) * 0.1 + math.pi) % (2.0 * math.pi) - math.pi,
    }
    return Recording(name, T_EVIDENCE, **(columns | changes))


def warnings(*recordings: Recording, **preparation: Any) -> tuple[str, ...]:
    found = extract_departures(list(recordings), preparation=Preparation(**preparation))
    return tuple(words for words in found.warnings if words != LANE)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("step", [None, 0.1, 0.5])
def test_the_right_yaw_rate_is_silent(noise, step):
    """Also with noise on the course [rad] of the size that receivers have."""
    one = drive_evidence()
    course = one.heading + noise * np.random.default_rng(1).standard_normal(N)
    assert warnings(dataclasses.replace(one, heading=course), step=step) == ()


@pytest.mark.parametrize(
    "rate", [np.full(N, 6e-4 * 28.0), np.where((T_EVIDENCE > 60.0) & (T_EVIDENCE < 80.0), 0.025, 0.0)]
)
def test_gentle_bends_tell_the_sign_too(rate):
    """A motorway: one long bend, or a single one among straights; the course is as good as a receiver's."""
    course = np.cumsum(rate) * 0.1 + 0.002 * np.random.default_rng(2).standard_normal(N)
    one = drive_evidence(true_rate=rate, heading=course)
    assert warnings(one) == ()
    (words,) = warnings(dataclasses.replace(one, yaw_rate=-rate))
    assert "turns against the GPS heading" in words
    (words,) = warnings(dataclasses.replace(one, yaw_rate=rate * math.pi / 180.0))
    assert re.search(r"0\.017[456] times what the GPS heading turns", words)  # the course is noisy


@pytest.mark.parametrize("usable", [0.2, 0.3])
def test_few_usable_samples(usable):
    valid = np.arange(N) % 10 < 10 * usable
    found = warnings(drive_evidence(valid=valid), step=None)
    assert [words.startswith("only 1,200 of 6,000 samples can be used (20.0%)") for words in found] == [True] * (
        usable < 0.25
    )


@pytest.mark.parametrize(
    ("factor", "words", "advice"),
    [
        (-1.0, "the yaw rate turns against the GPS heading (correlation -1.00); it is positive to the right", "-1"),
        (180.0 / math.pi, "the yaw rate is 57.3 times what the GPS heading turns: another unit?", "0.0175"),
        (-180.0 / math.pi, "(correlation -1.00), and 57.3 times as much: another unit?; it is positive", "-0.0175"),
        (0.5, "the yaw rate is 0.5 times", "2"),
    ],
)
def test_sign_and_scale(factor, words, advice):
    wrong = drive_evidence(yaw_rate=factor * bends())
    found = [text for text in warnings(wrong) if "GPS" in text]
    assert len(found) == 1
    assert words in found[0]
    assert f"--yaw-rate-factor {advice}" in found[0].replace(",", " ").replace(")", " ").replace("  ", " ")
    # the advice mends it
    assert warnings(wrong, yaw_rate_factor=1.0 / factor) == ()


@pytest.mark.parametrize(
    ("true", "given", "words", "advice"),
    [
        # what the user gave was wrong: the sign, the unit, both
        (1.0, -1.0, "the yaw rate times -1, as given, turns against the GPS heading", "1"),
        (1.0, -1.0, "without the factor it is positive to the left: give", "1"),
        (-1.0, 1.0, "the yaw rate turns against the GPS heading", "-1"),
        (-1.0, 2.0, "the yaw rate times 2, as given, turns against", "-1"),
        (-1.0, 2.0, "without the factor it is positive to the right: give", "-1"),
        (0.5, 4.0, "the yaw rate times 4, as given, is 2 times what the GPS heading turns", "2"),
        (-180.0 / math.pi, -1.0, "the yaw rate times -1, as given, is 57.3 times", "-0.0175"),
        (0.25, -2.0, "the yaw rate times -2, as given, turns against", "4"),
    ],
)
def test_the_advice_is_for_the_recorded_yaw_rate(true, given, words, advice):
    """A factor that was given already is in what was compared."""
    wrong = drive_evidence(yaw_rate=true * bends())
    (found,) = (text for text in warnings(wrong, yaw_rate_factor=given) if "GPS" in text)
    assert words in found
    reported = re.search(r"--yaw-rate-factor (-?[\d.]+)[ ,)]", found)[1]
    assert reported == advice
    assert warnings(wrong, yaw_rate_factor=float(reported)) == ()


@pytest.mark.parametrize("step", [None, 0.1, 0.5])
def test_a_yaw_rate_from_the_heading_is_not_compared_with_it(step):
    """A third of the yaw rates is recorded, with the wrong sign; the others come from the heading."""
    recorded = (np.arange(N) // 200) % 3 == 0
    one = drive_evidence(yaw_rate=np.where(recorded, -bends(), np.nan))
    found = [words for words in warnings(one, step=step) if "GPS heading (correlation" in words]
    assert [re.sub(r"\).*", ")", words) for words in found] == [
        "the yaw rate turns against the GPS heading (correlation -1.00)"
    ]
    # nothing recorded at all: nothing to check, not a good word either
    assert warnings(drive_evidence(yaw_rate=np.full(N, np.nan)), step=step) == (f"{FILLED}: 1 of 1 recordings",)
    # nor where a reader has done the same
    whole = np.where(recorded, -bends(), bends())
    marked = drive_evidence(yaw_rate=whole, yaw_rate_measured=recorded)
    assert any("turns against the GPS heading (correlation -1.00)" in words for words in warnings(marked, step=step))
    assert not any("GPS" in words for words in warnings(dataclasses.replace(marked, yaw_rate_measured=~recorded)))


def test_noise_on_the_heading_is_not_taken_for_a_wrong_scale():
    """It makes the heading turn more than the yaw rate does."""
    one = drive_evidence(true_rate=bends(largest=0.03))
    course = one.heading + 0.03 * np.random.default_rng(1).standard_normal(N)
    assert warnings(dataclasses.replace(one, heading=course)) == ()
    wrong = dataclasses.replace(one, heading=course, yaw_rate=-one.yaw_rate)
    assert "turns against the GPS heading" in warnings(wrong)[0]
    assert "another unit" not in warnings(wrong)[0]


def test_a_yaw_rate_that_has_nothing_to_do_with_the_heading():
    noise = 0.06 * np.random.default_rng(3).standard_normal(N)
    (words,) = warnings(drive_evidence(yaw_rate=noise))
    assert "do not agree" in words
    assert "curvatures are doubtful" in words


def test_where_nothing_can_be_said_nothing_is():
    rng = np.random.default_rng(4)
    straight = drive_evidence(true_rate=np.zeros(N), yaw_rate=0.002 * rng.standard_normal(N))
    noisy = dataclasses.replace(straight, heading=straight.heading + 0.02 * rng.standard_normal(N))
    reversed_rate = -bends()
    slow = drive_evidence(speed=np.full(N, 5.0), yaw_rate=reversed_rate)
    for silent in (
        straight,
        noisy,
        slow,
        drive_evidence(heading=None, yaw_rate=reversed_rate),
        drive_evidence(heading=np.full(N, np.nan), yaw_rate=reversed_rate),
        drive_evidence(
            heading=np.where(T_EVIDENCE < 8.0, drive_evidence().heading, np.nan), yaw_rate=reversed_rate
        ),  # too little of it
        drive_evidence(valid=T_EVIDENCE < 8.0, yaw_rate=reversed_rate),
    ):
        assert [words for words in warnings(silent) if "GPS" in words] == []


def test_gaps_and_lost_samples_take_no_part():
    """Turns across a gap, or with samples in between that cannot be used, are not compared."""
    one = drive_evidence()
    rate, course = one.yaw_rate.copy(), one.heading.copy()
    lost = (np.arange(N) // 50) % 4 == 1
    rate[lost] = 50.0 * np.random.default_rng(0).standard_normal(int(lost.sum()))
    assert warnings(dataclasses.replace(one, yaw_rate=rate, valid=~lost)) == ()
    rate[lost] = np.inf
    filled = (f"{FILLED}: 1 of 1 recordings",)
    assert warnings(dataclasses.replace(one, yaw_rate=rate)) == filled
    # most of the time: what is lost counts as nothing, not as straight on
    often = np.arange(N) % 60 > 22
    assert warnings(dataclasses.replace(one, yaw_rate=np.where(often, np.nan, one.yaw_rate))) == filled
    course[::7] = np.nan
    assert warnings(dataclasses.replace(one, yaw_rate=rate, heading=course)) == filled
    assert [words for words in warnings(one.take(~lost)) if "GPS" in words] == []


def test_repeated_recordings():
    rng = np.random.default_rng(0)
    several = [drive_evidence(f"r{i}", seed=i) for i in range(8)]
    assert warnings(*several) == ()
    # on another clock, and whether scaled, resampled or not
    twin = dataclasses.replace(several[2], name="copy", t=T_EVIDENCE + 1000.0, source="other")
    for preparation in ({}, {"step": 0.1}, {"nominal_lane_width": 3.5}):
        (words,) = warnings(*several, twin, **preparation)
        assert words == "1 recording repeats another's samples, and the departures count twice: r2 = copy"
    third = dataclasses.replace(twin, name="again")
    many = [dataclasses.replace(one, name=f"{one.name}'") for one in several]
    (words,) = warnings(*several, *many, third)
    assert words.startswith("9 recordings repeat another's samples, and the departures count twice: r0 = r0'; r1 = r1'")
    assert words.endswith("r2 = r2' = again; r3 = r3'; r4 = r4'; and 3 more")
    # one sample differs; short ones are alike by chance
    other = several[2].lane_offset.copy()
    other[int(rng.integers(N))] += 1e-9
    assert warnings(*several, dataclasses.replace(twin, lane_offset=other)) == ()
    short = several[2].take(slice(0, 50))
    assert warnings(*several, short, dataclasses.replace(short, name="short")) == ()


@pytest.mark.parametrize(
    ("widths", "warned"),
    [
        ([3.5], False),
        ([2.9, 3.5, 3.7], False),
        ([3.0, 3.4, 3.8, 4.1], False),  # roads differ: country road and motorway
        ([2.5, 2.9, 3.0, 3.2, 3.6], True),
        ([2.5], True),
        ([4.6], True),
        ([3.4] * 60 + [2.4], False),  # one odd trip of many
    ],
)
def test_the_scale_of_the_lane(widths, warned):
    recordings = [
        drive_evidence(f"r{i}", seed=i, lane_width=np.full(N, w)).take(slice(0, 600)) for i, w in enumerate(widths)
    ]
    found = [words for words in warnings(*recordings) if "median lane width" in words]
    assert bool(found) == warned
    if warned:
        assert f"from {min(widths):.2f} to {max(widths):.2f} m" in found[0]
        assert "--nominal-lane-width" in found[0]
    assert warnings(*recordings, nominal_lane_width=3.5) == ()
    # what a reader scaled is judged as the source had it
    scaled = [dataclasses.replace(one, lane_width=one.lane_width * 1.01, lane_scale=1.01) for one in recordings]
    assert [words for words in warnings(*scaled) if "median lane width" in words] == found


def test_flat_curvature():
    flat = "the lane is straight in nearly all samples: c_0 and dc tell nothing"
    assert warnings(drive_evidence(yaw_rate=np.zeros(N), heading=None)) == (flat,)
    assert warnings(drive_evidence(yaw_rate=None, heading=None, curvature=np.zeros(N))) == (flat,)
    assert (
        warnings(drive_evidence(yaw_rate=None, heading=None, curvature=np.where(T_EVIDENCE < 100.0, 1e-3, 0.0))) == ()
    )
    assert warnings(drive_evidence(yaw_rate=None, heading=None)) == (
        "no column 'curvature' or 'yaw_rate': the lane's curvature is taken as 0 (c_0 = dc = 0)",
    )
    (words,) = warnings(drive_evidence(yaw_rate=None, heading=None), drive_evidence("b", seed=1))
    assert words.startswith("no column 'curvature' or 'yaw_rate' in some recordings")


def test_notes_are_counted():
    notes = [("no GPS", "no yaw"), ("no GPS",), (), ("short",)]
    recordings = [drive_evidence(f"r{i}", seed=i, notes=given) for i, given in enumerate(notes)]
    assert warnings(*recordings) == (
        "no GPS: 2 of 4 recordings",
        "no yaw: 1 of 4 recordings",
        "short: 1 of 4 recordings",
    )


def test_warnings_do_not_depend_on_the_split(monkeypatch):
    """The sums behind them are the same to the last bit, however recordings are searched together."""
    from ldctoolkit.recordings import Criteria
    from ldctoolkit.recordings.departures_table import combined_results
    from ldctoolkit.recordings.extract import extract_items

    rng = np.random.default_rng(7)
    recordings = [
        drive_evidence(f"r{i}", seed=i, true_rate=bends(i) * rng.uniform(0.1, 2.0)).take(
            slice(0, int(rng.integers(200, N)))
        )
        for i in range(7)
    ]
    whole = extract_items(recordings, Criteria(), Preparation()).evidence
    monkeypatch.setattr(sys.modules["ldctoolkit.recordings.extract"], "BATCH", 7000)
    for cut in (1, 3, 6):
        parts = [extract_items(some, Criteria(), Preparation()) for some in (recordings[:cut], recordings[cut:])]
        split = combined_results(parts).evidence
        for field in dataclasses.fields(whole):
            np.testing.assert_array_equal(getattr(split, field.name), getattr(whole, field.name))


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (
            {"speed": 25.0 * 3.6},
            "column 'speed': 100% of the samples are above 60 m/s (216 km/h); the unit looks like km/h",
        ),
        ({"speed": np.where(T < 9.7, 40.0, 61.0)}, "the unit looks like km/h"),  # in town, but sometimes 61 km/h
        ({"speed": 50.0}, "most samples are above 42 m/s"),  # in town, at a steady 50 km/h
        ({"speed": 25_000.0}, "the unit looks like mm/s"),
        ({"speed": -25.0}, "column 'speed': most values are negative"),
        ({"lane_offset": 1000.0 * OFFSET}, "column 'lane_offset': most values are beyond 10; the unit looks like mm"),
        ({"lane_offset": OFFSET + 3.6}, "further than a lane width from the lane's centre"),
        ({"lane_width": 3600.0}, "column 'lane_width': most values are above 1000; the unit looks like mm"),
        ({"lane_width": 360.0}, "the unit looks like cm"),
        ({"lane_width": 12.0}, "is the unit feet?"),
        ({"lane_width": 1.85}, "most lanes are narrower than 2 m"),
        ({"t": 1000.0 * T}, "column 't': the time step is above 2 in most recordings; the unit looks like ms"),
        ({"t": T / 3600.0}, "column 't': the time step is below 0.002"),
        ({"curvature": 800.0}, "column 'curvature': 100% of the samples are beyond 0.2 1/m"),
        ({"curvature": None, "yaw_rate": 2.0}, "the unit looks like deg/s"),
    ],
)
def test_a_warning_names_column_and_unit(columns, words):
    found = extract_departures([drive(**columns)], vehicle_width=1.8)
    assert len(found.warnings) == 1
    assert words in found.warnings[0]


def test_all_in_mm_and_kmh():
    found = extract_departures([drive(lane_offset=1000 * OFFSET, lane_width=3600.0, speed=90.0)], vehicle_width=1.8)
    assert [warning.split(":")[0] for warning in found.warnings] == [
        "column 'speed'",
        "column 'lane_width'",
        "column 'lane_offset'",
    ]


def test_a_vehicle_as_wide_as_the_lane():
    found = extract_departures([drive(lane_width=2.5)], vehicle_width=2.55)
    assert found.warnings == ("vehicle width 2.55 m: most lanes are no wider than that",)


def test_plausible_recordings_give_none():
    assert extract_departures([drive(speed=41.0, t=T * 10, curvature=0.05)], vehicle_width=1.8).warnings == ()


def reported(**changes: Any) -> str:
    plain = dataclasses.replace(no_statistics(), kinds=("yaw_rate",), bends=np.array([10_000, 5_000]))
    arrays = {name: np.array(value) for name, value in changes.items()}
    return "; ".join(quality_warnings(dataclasses.replace(plain, **arrays), 1.8, None))


@pytest.mark.parametrize(
    ("name", "silent", "warned", "words"),
    [
        # windows, and the sums of h^2, h r, r^2 over them
        ("turns", (99, 9.0, -9.0, 9.0), (100, 9.0, -9.0, 9.0), "turns against the GPS heading"),
        ("turns", (500, 9.0, 4.6, 9.0), (500, 9.0, 4.4, 9.0), "do not agree"),
        ("turns", (500, 0.79, 0.0, 9.0), (500, 0.81, 0.0, 9.0), "do not agree"),  # 0.04 rad in the root mean square
        ("turns", (500, 9.0, 9 * 1.24, 9 * 1.24**2), (500, 9.0, 9 * 1.26, 9 * 1.26**2), "1.26 times what"),
        ("turns", (500, 9.0, 9 * 0.81, 9 * 0.81**2), (500, 9.0, 9 * 0.79, 9 * 0.79**2), "0.79 times what"),
        ("bends", (10_000, 10), (10_000, 9), "the lane is straight in nearly all samples"),
        ("bends", (1000, 0), (1001, 0), "the lane is straight in nearly all samples"),
        ("median_widths", [2.8], [2.79], "median lane width"),
        ("median_widths", [4.3], [4.31], "median lane width"),
        ("median_widths", [2.4] + [3.5] * 20, [2.4] * 2 + [3.5] * 19, "median lane width"),  # the outer 5 %
        ("median_widths", [2.5, 3.0, 3.2], [2.5, 3.0, 3.3], "median lane width"),  # by more than a quarter
    ],
)
def test_evidence(name, silent, warned, words):
    assert reported(**{name: silent}) == ""
    assert words in reported(**{name: warned})


def test_a_quarter_of_the_samples_is_enough():
    assert few_usable(100, 25) == ()
    assert few_usable(100, 24) == (
        "only 24 of 100 samples can be used (24.0%): in the others the lane, the speed or the yaw rate is missing, or "
        "the source itself distrusts them",
    )


@pytest.mark.parametrize(
    ("name", "most", "words"),
    [
        ("speed > 60", 10, "above 60 m/s"), ("speed > 42", 500, "above 42 m/s"), ("speed > 1000", 500, "mm/s"),
        ("speed < 0", 500, "negative"), ("width > 1000", 500, "looks like mm"), ("width > 100", 500, "looks like cm"),
        ("width > 6", 500, "feet"), ("width < 2", 500, "not half"), ("width <= vehicle", 500, "no wider"),
        ("offset > 10", 500, "beyond 10"), ("offset > width", 50, "further than a lane width"),
        ("step > 2", 20, "above 2"), ("step < 0.002", 20, "below 0.002"), ("curvature > 0.2", 10, "beyond 0.2 1/m"),
        ("yaw rate > 1.5", 10, "beyond 1.5 rad/s"),
    ],
)  # fmt: skip
def test_shares_of_samples_or_recordings(name, most, words):
    counts = {"samples": 1000, "recordings": 40}
    assert unit_warnings(counts | {name: most}, 1.8) == []
    (warning,) = unit_warnings(counts | {name: most + 1}, 1.8)
    assert words in warning


@pytest.mark.parametrize(
    ("column", "limit", "name"),
    [
        ("speed", 60.0, "speed > 60"), ("speed", 42.0, "speed > 42"), ("speed", 1000.0, "speed > 1000"),
        ("lane_width", 1000.0, "width > 1000"), ("lane_width", 100.0, "width > 100"), ("lane_width", 6.0, "width > 6"),
        ("lane_offset", -10.0, "offset > 10"), ("lane_offset", 3.6, "offset > width"),
        ("curvature", -0.2, "curvature > 0.2"), ("yaw_rate", -1.5, "yaw rate > 1.5"),
    ],
)  # fmt: skip
def test_values_are_counted_beyond_their_limit(column, limit, name):
    own = {"lane_offset": 0.0} | ({"curvature": None} if column == "yaw_rate" else {})
    for value, counted in ((limit, 0), (np.nextafter(limit, np.sign(limit) * np.inf), 3)):
        one = table_of([drive(t=[0.0, 0.1, 0.2], **(own | {column: value}))])
        assert dict(unit_counts(one, usable_samples(one), np.array([0.1]), 1.8))[name] == counted


def test_values_that_are_counted_below_a_limit():
    def counted(step: float = 0.1, **columns: float) -> dict[str, int]:
        one = table_of([drive(t=[0.0, 0.1, 0.2], lane_offset=0.0, **columns)])
        return dict(unit_counts(one, usable_samples(one), np.array([step, np.nan]), 1.8))

    below = np.nextafter(2.0, 0.0)
    assert (counted(lane_width=2.0)["width < 2"], counted(lane_width=below)["width < 2"]) == (0, 3)
    assert (counted(lane_width=1.8)["width <= vehicle"], counted(lane_width=1.81)["width <= vehicle"]) == (3, 0)
    assert (counted(speed=0.0)["speed < 0"], counted(speed=-0.1)["speed < 0"]) == (0, 3)
    assert (counted(2.0)["step > 2"], counted(2.1)["step > 2"]) == (0, 1)
    assert (counted(0.002)["step < 0.002"], counted(0.0019)["step < 0.002"]) == (0, 1)
