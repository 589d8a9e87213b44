"""What looks wrong with recordings: units, scale, signs, repeated recordings."""

import dataclasses
import math
import re
from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Criteria, Preparation, Recording, extract_departures
from ldctoolkit.recordings.extract import extract_items, few_usable, merge_results, quality_doubts, quality_warnings
from ldctoolkit.recordings.extraction_statistics import (
    OFFSET_BINS,
    RELATIONS,
    QualityStatistics,
    unit_counts,
    unit_warnings,
)
from ldctoolkit.recordings.preparation import FILLED
from ldctoolkit.recordings.recording import RecordingTable, usable_samples

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
    """Doubts and other warnings."""
    extraction = extract_departures(list(recordings), preparation=Preparation(**preparation), force=True)
    return tuple(words for words in extraction.warnings if words != LANE)


def of_turning(texts: tuple[str, ...]) -> list[str]:
    """Those that compare yaw rate and heading."""
    return [words for words in texts if "GPS" in words and FILLED not in words]


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.02])
@pytest.mark.parametrize("step", [None, 0.1, 0.5])
def test_the_right_yaw_rate_is_silent(noise, step):
    """Also with noise on the course [rad] of the size that receivers have."""
    recording = drive_evidence()
    course = recording.heading + noise * np.random.default_rng(1).standard_normal(N)
    assert warnings(dataclasses.replace(recording, heading=course), step=step) == ()


@pytest.mark.parametrize(
    "rate", [np.full(N, 6e-4 * 28.0), np.where((T_EVIDENCE > 60.0) & (T_EVIDENCE < 80.0), 0.025, 0.0)]
)
def test_gentle_bends_tell_the_sign_too(rate):
    """A motorway: one long bend, or a single one among straights; the course is as good as a receiver's."""
    course = np.cumsum(rate) * 0.1 + 0.002 * np.random.default_rng(2).standard_normal(N)
    recording = drive_evidence(true_rate=rate, heading=course)
    assert warnings(recording) == ()
    (words,) = warnings(dataclasses.replace(recording, yaw_rate=-rate))
    assert "turns against the GPS heading" in words
    (words,) = warnings(dataclasses.replace(recording, yaw_rate=rate * math.pi / 180.0))
    assert re.search(r"0\.017[456] times what the GPS heading turns", words)  # the course is noisy


@pytest.mark.parametrize(
    ("true", "factor", "words", "advice"),
    [
        (180.0 / math.pi, 1.0, "the yaw rate is 57.3 times what the GPS heading turns: another unit?", "0.0175"),
        (
            -180.0 / math.pi,
            1.0,
            "(correlation -1.00), and 57.3 times as much: another unit?; it is positive",
            "-0.0175",
        ),
        (0.5, 1.0, "the yaw rate is 0.5 times", "2"),
        # what the user gave was wrong: the sign, the unit, both
        (1.0, -1.0, "the yaw rate times -1, as given, turns against the GPS heading", "1"),
        (1.0, -1.0, "without the factor it is positive to the left (give", "1"),
        (-1.0, 1.0, "the yaw rate turns against the GPS heading", "-1"),
        (-1.0, 2.0, "the yaw rate times 2, as given, turns against", "-1"),
        (-1.0, 2.0, "without the factor it is positive to the right (give", "-1"),
        (0.5, 4.0, "the yaw rate times 4, as given, is 2 times what the GPS heading turns", "2"),
        (-180.0 / math.pi, -1.0, "the yaw rate times -1, as given, is 57.3 times", "-0.0175"),
        (0.25, -2.0, "the yaw rate times -2, as given, turns against", "4"),
    ],
)
def test_the_advice_is_for_the_recorded_yaw_rate(true, factor, words, advice):
    """A factor that was given already is in what was compared."""
    wrong = drive_evidence(yaw_rate=true * bends())
    (text,) = of_turning(warnings(wrong, yaw_rate_factor=factor))
    assert words in text
    reported = re.search(r"--yaw-rate-factor (-?[\d.]+)[ ,)]", text)[1]
    assert reported == advice
    assert warnings(wrong, yaw_rate_factor=float(reported)) == ()


@pytest.mark.parametrize("step", [None, 0.1, 0.5])
def test_a_yaw_rate_from_the_heading_is_not_compared_with_it(step):
    """A third of the yaw rates is recorded, with the wrong sign; the others come from the heading."""
    recorded = (np.arange(N) // 200) % 3 == 0
    recording = drive_evidence(yaw_rate=np.where(recorded, -bends(), np.nan))
    texts = [words for words in warnings(recording, step=step) if "GPS heading (correlation" in words]
    assert [re.sub(r"\).*", ")", words) for words in texts] == [
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
    recording = drive_evidence(true_rate=bends(largest=0.03))
    course = recording.heading + 0.03 * np.random.default_rng(1).standard_normal(N)
    assert warnings(dataclasses.replace(recording, heading=course)) == ()
    wrong = dataclasses.replace(recording, heading=course, yaw_rate=-recording.yaw_rate)
    assert "turns against the GPS heading" in warnings(wrong)[0]
    assert "another unit" not in warnings(wrong)[0]


def test_doubts_stop_it_unless_forced():
    """The same words, first of all; the advice mends them."""
    recording = drive_evidence(yaw_rate=-bends(), speed=np.full(N, 90.0), notes=("odd",))
    with pytest.raises(RecordingError) as caught:
        extract_departures([recording])
    forced = extract_departures([recording], force=True)
    doubts = forced.warnings[:2]
    assert [words.split(":")[0] for words in forced.warnings] == [
        "column 'speed'",
        "the yaw rate turns against the GPS heading (correlation -1.00); it is positive to the right (give "
        "--yaw-rate-factor -1, or all curvatures have the wrong sign; or is the heading a compass course?)",
        "no column 'lane'",
        "odd",
    ]
    assert caught.value.problem == f"the recordings cannot be right: {'; '.join(doubts)}"
    assert "--force" in caught.value.hint
    right = Preparation(yaw_rate_factor=-1.0)
    assert extract_departures(
        [dataclasses.replace(recording, speed=recording.speed / 3.6)], preparation=right
    ).warnings == (LANE, "odd: 1 of 1 recordings")
    # the parts by themselves know nothing of it
    parts = [extract_items([recording], Criteria(), Preparation())]
    with pytest.raises(RecordingError, match="cannot be right"):
        merge_results(parts, Criteria(), Preparation())
    assert merge_results(parts, Criteria(), Preparation(), force=True).warnings == forced.warnings


def bending(name: str, true_rate: np.ndarray) -> np.ndarray:
    """What a signal says of a vehicle that turns at that rate, at 25 m/s."""
    curvature = true_rate / 25.0
    return {"heading": np.cumsum(true_rate) * 0.1, "yaw_rate": true_rate, "curvature": curvature,
            "steering": 16.0 * np.arctan(2.8 * curvature)}[name]  # fmt: skip


@pytest.mark.parametrize("pair", RELATIONS, ids="-".join)
def test_each_pair_of_signals(pair):
    """Signals that agree give no warning, whatever the steering ratio; of two that disagree the second is named."""
    said = {"heading": "the GPS heading" if pair == RELATIONS[0] else "the heading", "yaw_rate": "the yaw rate",
            "curvature": "the curvature", "steering": "the steering angle"}  # fmt: skip
    none = {"heading": None, "yaw_rate": None, "curvature": None}
    first, second = (bending(name, bends()) for name in pair)

    def told(compared: np.ndarray) -> list[str]:
        texts = warnings(drive_evidence(**(none | {pair[0]: first, pair[1]: compared})))
        return [words for words in texts if "turn" in words]

    assert told(second) == []
    (words,) = told(-second)
    assert words.startswith(f"{said[pair[1]]} turns against {said[pair[0]]} (correlation -1.00); ")
    wrong = told(20.0 * second)
    if pair[1] == "steering":
        assert wrong == []
    else:
        assert [text.split(":")[0] for text in wrong] == [f"{said[pair[1]]} is 20 times what {said[pair[0]]} turns"]


def weaving(seconds: float = 120.0, seed: int = 0, *, noise: float = 0.0, speed: float = 25.0) -> Recording:
    """A vehicle that weaves in its lane through gentle bends: its heading against the road's makes its offset."""
    rng = np.random.default_rng(seed)
    t = 0.1 * np.arange(round(seconds * 10.0) + 1)
    angle = sum(0.01 * rng.uniform() * np.sin(2.0 * np.pi * t / p + rng.uniform(0, 6)) for p in (2.5, 3.1, 4.3, 5.2))
    offset = np.cumsum(speed * angle) * 0.1
    offset -= np.polyval(np.polyfit(t, offset, 1), t)
    rate = np.gradient(angle, t) + 0.01 * np.sin(t / 7.0)
    return Recording(
        "a", t, offset + noise * rng.normal(size=t.size), np.full(t.size, 3.5), np.full(t.size, speed),
        np.ones(t.size, bool), yaw_rate=rate,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("seconds", "windows"), [(5.9, 0), (60.0, 10), (120.0, 20), (126.0, 11), (240.0, 20), (900.0, 19)]
)
def test_the_sway_is_looked_at_in_twenty_windows_at_most(seconds, windows):
    """Of six seconds; spread over the recording."""
    evidence = extract_items([weaving(seconds)], Criteria(), Preparation()).evidence
    assert evidence.sway[0] == windows


@pytest.mark.parametrize("with_heading", [False, True])
def test_the_offset_goes_with_the_vehicles_heading(with_heading):
    recording = weaving()
    if with_heading:
        recording = dataclasses.replace(recording, heading=np.cumsum(recording.yaw_rate) * 0.1 % (2.0 * np.pi))
    assert warnings(recording) == ()
    (words,) = warnings(dataclasses.replace(recording, lane_offset=-recording.lane_offset))
    assert words.startswith("column 'lane_offset': it goes against the vehicle's heading (correlation -")
    # in feet, and at a speed in km/h
    for times_as_far, changes in (
        ("3.3", {"lane_offset": 3.28 * recording.lane_offset}),
        ("2", {"speed": 0.5 * recording.speed}),
    ):
        (words,) = warnings(dataclasses.replace(recording, **changes))
        assert words.startswith(f"column 'lane_offset': it moves {times_as_far} times as far as the vehicle's heading")
    # too short, too slow, lost in noise: nothing can be said
    for silent in (weaving(45.0), weaving(speed=7.9), weaving(noise=3.0)):
        turned = dataclasses.replace(silent, lane_offset=-silent.lane_offset)
        assert not any("vehicle's heading" in words for words in warnings(turned))


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
    recording = drive_evidence()
    rate, course = recording.yaw_rate.copy(), recording.heading.copy()
    lost = (np.arange(N) // 50) % 4 == 1
    rate[lost] = 50.0 * np.random.default_rng(0).standard_normal(int(lost.sum()))
    assert warnings(dataclasses.replace(recording, yaw_rate=rate, valid=~lost)) == ()
    rate[lost] = np.inf
    filled = (f"{FILLED}: 1 of 1 recordings",)
    assert warnings(dataclasses.replace(recording, yaw_rate=rate)) == filled
    # most of the time: what is lost counts as nothing, not as straight on
    often = np.arange(N) % 60 > 22
    assert warnings(dataclasses.replace(recording, yaw_rate=np.where(often, np.nan, recording.yaw_rate))) == filled
    course[::7] = np.nan
    assert warnings(dataclasses.replace(recording, yaw_rate=rate, heading=course)) == filled
    assert [words for words in warnings(recording.take(~lost)) if "GPS" in words] == []


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
    twins = [dataclasses.replace(r, name=f"{r.name}'") for r in several]
    (words,) = warnings(*several, *twins, third)
    assert words.startswith("9 recordings repeat another's samples, and the departures count twice: r0 = r0'; r1 = r1'")
    assert words.endswith("r2 = r2' = again; r3 = r3'; r4 = r4'; and 3 more")
    # one sample differs; short ones are alike by chance
    offset = several[2].lane_offset.copy()
    offset[int(rng.integers(N))] += 1e-9
    assert warnings(*several, dataclasses.replace(twin, lane_offset=offset)) == ()
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
    texts = [words for words in warnings(*recordings) if "median lane width" in words]
    assert bool(texts) == warned
    if warned:
        assert f"from {min(widths):.2f} to {max(widths):.2f} m" in texts[0]
        assert "--nominal-lane-width" in texts[0]
    assert warnings(*recordings, nominal_lane_width=3.5) == ()
    # what a reader scaled is judged as the source had it
    scaled = [dataclasses.replace(r, lane_width=r.lane_width * 1.01, lane_scale=1.01) for r in recordings]
    assert [words for words in warnings(*scaled) if "median lane width" in words] == texts


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
    recordings = [
        drive_evidence(f"r{i}", seed=i, notes=notes_of_recording) for i, notes_of_recording in enumerate(notes)
    ]
    assert warnings(*recordings) == (
        "no GPS: 2 of 4 recordings",
        "no yaw: 1 of 4 recordings",
        "short: 1 of 4 recordings",
    )


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"speed": 90.0}, "column 'speed': 100% of the samples are above 60 m/s (216 km/h); the unit looks like km/h"),
        ({"lane_width": 360.0}, "column 'lane_width': most values are above 100; the unit looks like cm"),
        ({"lane_offset": OFFSET + 3.6}, "further than a lane width from the lane's centre"),
        ({"t": 1000.0 * T}, "column 't': the time step is above 12 in most recordings; the unit looks like ms"),
        ({"t": T / 3600.0}, "column 't': the time step is below 0.002"),
        ({"curvature": None, "yaw_rate": 2.0}, "beyond 1.5 rad/s; the unit looks like deg/s"),
        ({"heading": 90.0}, "column 'heading': 100% of the samples are beyond 40; the unit looks like degrees"),
    ],
)
def test_a_warning_names_column_and_unit(columns, words):
    recording = drive(**({"lane_offset": 0.3 * np.sin(T)} | columns))
    (doubt,) = (
        text for text in extract_departures([recording], vehicle_width=1.8, force=True).warnings if words in text
    )
    with pytest.raises(RecordingError) as caught:
        extract_departures([recording], vehicle_width=1.8)
    assert caught.value.problem == f"the recordings cannot be right: {doubt}"


def test_all_in_mm_and_kmh():
    recording = drive(lane_offset=1000 * OFFSET, lane_width=3600.0, speed=90.0)
    extraction = extract_departures([recording], vehicle_width=1.8, force=True)
    assert [warning.split(":")[0] for warning in extraction.warnings] == [
        "column 'speed'",
        "column 'lane_width'",
        "column 'lane_offset'",
        "only 0 of 100 samples can be used (0.0%)",
    ]


def test_a_vehicle_as_wide_as_the_lane():
    extraction = extract_departures([drive(lane_width=2.5)], vehicle_width=2.55, force=True)
    assert extraction.warnings == ("vehicle width 2.55 m: most lanes are no wider than that",)


def test_plausible_recordings_give_none():
    fast = drive(speed=46.0, t=T * 10, lane_offset=0.3 * np.sin(T), curvature=0.0055)
    slow = drive("b", speed=7.0, t=T * 10, lane_offset=0.3 * np.sin(T), curvature=0.06, heading=39.0, steering=-40.0)
    assert extract_departures([fast, slow], vehicle_width=1.8).warnings == ()


def reported(sides: tuple[int, int] = (0, 0), **changes: Any) -> tuple[str, ...]:
    plain = dataclasses.replace(QualityStatistics(), kinds=("yaw_rate",), bends=np.array([10_000, 5_000]))
    evidence = dataclasses.replace(plain, **{name: np.array(value) for name, value in changes.items()})
    return (*quality_doubts(evidence, 1.8, np.array(sides)).values(), *quality_warnings(evidence, None))


def turns(pair: int, *sums: float) -> np.ndarray:
    """Windows, and the sums of h^2, h r, r^2 over them, of one pair of signals."""
    rows = np.zeros((len(RELATIONS), 4))
    rows[pair] = sums
    return rows


def times(pair: int, ratio: float) -> np.ndarray:
    return turns(pair, 500, 9.0, 9.0 * ratio, 9.0 * ratio**2)


@pytest.mark.parametrize(
    ("name", "silent", "warned", "words"),
    [
        ("turns", turns(0, 99, 9.0, -9.0, 9.0), turns(0, 100, 9.0, -9.0, 9.0), "turns against the GPS heading"),
        ("turns", turns(0, 500, 9.0, 4.6, 9.0), turns(0, 500, 9.0, 4.4, 9.0), "do not agree"),
        # 0.04 rad in the root mean square
        ("turns", turns(0, 500, 0.79, 0.0, 9.0), turns(0, 500, 0.81, 0.0, 9.0), "do not agree"),
        ("turns", times(0, 1.24), times(0, 1.26), "the yaw rate is 1.26 times what the GPS heading turns"),
        ("turns", times(0, 0.81), times(0, 0.79), "the yaw rate is 0.79 times what the GPS heading turns"),
        # the lane itself does not turn as the vehicle does
        ("turns", times(1, 9.9), times(1, 10.1), "the curvature is 10.1 times what the heading turns"),
        ("turns", times(1, 0.101), times(1, 0.099), "the curvature is 0.099 times what the heading turns"),
        ("turns", times(2, 9.9), times(2, 10.1), "the curvature is 10.1 times what the yaw rate turns"),
        *(
            ("turns", turns(pair, 500, 9.0, -4.4, 9.0), turns(pair, 500, 9.0, -4.6, 9.0), words)
            for pair, words in [
                (1, "the curvature turns against the heading"), (2, "the curvature turns against the yaw rate"),
                (3, "the steering angle turns against the heading"),
                (4, "the steering angle turns against the yaw rate"),
                (5, "the steering angle turns against the curvature"),
            ]
        ),
        *(("turns", times(pair, 1e3), times(pair, -1e3), "the steering angle turns against") for pair in (3, 4, 5)),
        # windows of six seconds, and the sums over them
        ("sway", (7, 9.0, -9.0, 9.0), (8, 9.0, -9.0, 9.0), "goes against the vehicle's heading (correlation -1.00)"),
        ("sway", (8, 9.0, -5.40, 9.0), (8, 9.0, -5.42, 9.0), "goes against the vehicle's heading"),  # 1.7/sqrt(8)
        ("sway", (100, 9.0, -1.79, 9.0), (100, 9.0, -1.81, 9.0), "goes against the vehicle's heading"),  # 0.2
        ("sway", (8, 9.0, 9.0 * 1.59, 9.0 * 1.59**2), (8, 9.0, 9.0 * 1.61, 9.0 * 1.61**2), "moves 1.6 times as far"),
        ("sway", (8, 9.0, 9.0 * 0.61, 9.0 * 0.61**2), (8, 9.0, 9.0 * 0.59, 9.0 * 0.59**2), "moves 0.59 times as far"),
        ("sway", (100, 9.0, 15.0, 80.0), (100, 9.0, 15.0, 60.0), "moves 2.6 times as far"),  # likeness 0.56, 0.65
        ("bends", (10_000, 10), (10_000, 9), "the lane is straight in nearly all samples"),
        ("bends", (1000, 0), (1001, 0), "the lane is straight in nearly all samples"),
        ("median_widths", [2.8], [2.79], "median lane width"),
        ("median_widths", [4.3], [4.31], "median lane width"),
        ("median_widths", [2.4] + [3.5] * 20, [2.4] * 2 + [3.5] * 19, "median lane width"),  # the outer 5 %
        ("median_widths", [2.5, 3.0, 3.2], [2.5, 3.0, 3.3], "median lane width"),  # by more than a quarter
        # 20 departures, 5 % of them to the other side
        ("sides", (19, 0), (20, 0), "20 of 20 departures are to the left"),
        ("sides", (2, 18), (1, 19), "19 of 20 departures are to the right"),
        ("sides", (37, 3), (38, 2), "38 of 40 departures are to the left"),
    ],
)  # fmt: skip
def test_evidence(name, silent, warned, words):
    assert reported(**{name: silent}) == ()
    (text,) = reported(**{name: warned})
    assert words in text


def test_a_signal_that_is_doubted_already_is_doubted_once():
    rows = turns(0, 500, 9.0, -9.0, 9.0) + turns(2, 500, 9.0, -9.0, 9.0)
    (text,) = reported(turns=rows, sway=(100, 9.0, -9.0, 9.0))
    assert "the yaw rate turns against the GPS heading" in text


def test_a_wrong_unit_of_the_lane_is_not_a_wrong_reference_too():
    samples = (("samples", 1000), ("recordings", 40))
    for unit, doubts in (("width < 2", 1), ("offset > 10", 1), ("width <= vehicle", 1), ("speed < 0", 2)):
        evidence = dataclasses.replace(QualityStatistics(), units=(*samples, (unit, 600)))
        assert len(quality_doubts(evidence, 1.8, np.array([20, 0]))) == doubts


def test_a_doubtful_scale_is_reported_beside_a_wrong_reference():
    """Forced: the doubt that names the vehicle width does not stand for one about the lane's width."""
    wide = 0.6 * np.sin(0.3 * T_EVIDENCE)
    narrow = drive_evidence(lane_offset=wide, lane_width=np.full(N, 2.4), yaw_rate=None, heading=None)
    texts = warnings(narrow)
    assert sum("a wheel is beyond a line" in text for text in texts) == 1
    assert sum("runs from 2.40 to 2.40 m" in text for text in texts) == 1


def offsets(**counts: int) -> np.ndarray:
    """Samples by offset, `l5=7` for seven of them 0.25 m to the left."""
    bins = np.zeros(OFFSET_BINS, dtype=np.int64)
    for name, count in counts.items():
        bins[OFFSET_BINS // 2 + int(name[1:]) * (1 if name[0] == "l" else -1)] = count
    return bins


BOTH = offsets(l5=50, r5=50)
ON_ONE_SIDE = {"stays_ns": (40e9, 0.0, 0.0), "grazes": (3, 100, 0), "offsets": offsets(l0=10, l1=89, l7=1)}


@pytest.mark.parametrize(
    ("silent", "warned", "words"),
    [
        # driven, beyond a line, and of that in long stays; [s] of at least 40
        ((40.0, 16.0, 0.0), (40.0, 16.1, 0.0), "a wheel is beyond a line in 40% of the time"),
        ((500.0, 40.0, 40.0), (500.0, 40.1, 40.1), "a wheel is beyond a line in 8% of the time"),
        ((1000.0, 80.0, 80.0), (1000.0, 80.1, 80.1), "a wheel is beyond a line in 8% of the time"),
        ((39.9, 39.7, 39.7), (40.0, 39.7, 39.7), "a wheel is beyond a line in 99% of the time"),
    ],
)
def test_too_much_of_the_time_beyond_a_line(silent, warned, words):
    no_texts, texts = (reported(stays_ns=np.array(seconds) * 1e9, offsets=BOTH) for seconds in (silent, warned))
    assert no_texts == ()
    assert [text.split(";")[0] for text in texts] == [f"column 'lane_offset': {words}"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stays_ns": (39.9e9, 0.0, 0.0)}, ""),
        ({}, "it turns back at zero and never lies to the right"),
        ({"offsets": ON_ONE_SIDE["offsets"][::-1], "grazes": (3, 0, 100)}, "at zero and never lies to the left"),
        ({"grazes": (2, 100, 0)}, ""),
        ({"grazes": (3, 99, 1)}, ""),
        ({"offsets": offsets(l0=10, l1=90, l7=1)}, ""),  # less than one in a hundred further than 0.3 m away
        ({"offsets": offsets(l0=10, l1=99, l6=10)}, ""),
        ({"offsets": offsets(l0=10, l1=50, l3=50, l7=2)}, "it turns back at zero"),
        ({"offsets": offsets(l0=10, l1=50, l3=51, l7=2)}, ""),  # few are at zero itself
        ({"grazes": (0, 60, 20), "offsets": offsets(l11=60, r1=20)}, ""),
        ({"grazes": (0, 60, 20), "offsets": offsets(l12=60, r1=20)}, "vehicle is more than 0.60 m to the left"),
        ({"grazes": (0, 20, 60), "offsets": offsets(r12=60, l1=20)}, "is more than 0.60 m to the right"),
        ({"grazes": (0, 60, 61), "offsets": offsets(l12=60, r1=61)}, ""),
    ],
)  # fmt: skip
def test_an_offset_without_its_sign_or_beside_the_lane(changes, words):
    texts = reported(**(ON_ONE_SIDE | changes))
    assert [words in text for text in texts] == [True] * bool(words)


def staying(samples: int, *, rows: int = 321, **changes: Any) -> Recording:
    """At 8 Hz, so many samples beyond the left line, reached and left slowly."""
    row = np.arange(rows)
    offset = np.interp(row, [80, 99, 99 + samples + 1, 120 + samples], [0.0, 0.85, 0.85, 0.0])
    offset += 0.01 * np.sin(row) + 0.1 * ((row >= 100) & (row < 100 + samples))
    return drive("a", 0.125 * np.arange(rows), **({"lane_offset": offset} | changes))


@pytest.mark.parametrize(
    ("recording", "driven", "beyond", "long"),
    [
        (staying(0), 40.0, 0.0, 0.0),
        (staying(40), 40.0, 5.0, 0.0),
        (staying(41), 40.0, 5.125, 5.125),
        # whatever became of it, but not in a lane change
        (staying(41, speed=4.0), 40.0, 5.125, 5.125),
        (staying(41, lane=np.arange(321) > 110), 40.0, 0.0, 0.0),
        (staying(41, engaged=np.arange(321) > 280), 35.0, 5.125, 5.125),
        # of drives of 20 s and more
        (staying(41, rows=161), 20.0, 5.125, 5.125),
        (staying(41, rows=160), 0.0, 0.0, 0.0),
    ],
)
def test_the_time_beyond_a_line(recording, driven, beyond, long):
    evidence = extract_items([recording], Criteria(1.8), Preparation()).evidence
    assert evidence.stays_ns.tolist() == [driven * 1e9, beyond * 1e9, long * 1e9]
    assert evidence.offsets.sum() == (recording.samples if driven else 0)


def test_a_quarter_of_the_samples_is_enough():
    assert few_usable(100, 25) == ()
    assert few_usable(100, 24) == (
        "only 24 of 100 samples can be used (24.0%): in the others the lane, the speed or the yaw rate is missing, or "
        "the source itself distrusts them",
    )


@pytest.mark.parametrize(
    ("name", "most", "words"),
    [
        ("speed > 60", 10, "above 60 m/s"), ("speed > 47", 500, "above 47 m/s"), ("speed > 1000", 500, "mm/s"),
        ("speed < 0", 500, "negative"), ("width > 1000", 500, "looks like mm"), ("width > 100", 500, "looks like cm"),
        ("width > 6", 500, "feet"), ("width < 2", 500, "not half"), ("width <= vehicle", 500, "no wider"),
        ("offset > 10", 500, "beyond 10"), ("offset > width", 50, "further than a lane width"),
        ("step > 12", 20, "above 12"), ("step < 0.002", 20, "below 0.002"), ("curvature > 0.2", 10, "beyond 0.2 1/m"),
        ("yaw rate > 1.5", 10, "beyond 1.5 rad/s"), ("tight c > 0.006", 30, "have a radius under 167 m"),
        ("tight r > 0.006", 30, "ask for a radius under 167 m"), ("heading > 40", 10, "column 'heading'"),
        ("steering > 40", 10, "column 'steering'"), ("coarse offset > 0", 500, "in steps of 0.1 m or more"),
    ],
)  # fmt: skip
def test_shares_of_samples_or_recordings(name, most, words):
    counts = {"samples": 1000, "recordings": 40}
    assert unit_warnings(counts | {name: most}, 1.8) == {}
    (warning,) = unit_warnings(counts | {name: most + 1}, 1.8).values()
    assert words in warning


@pytest.mark.parametrize(
    ("column", "limit", "name"),
    [
        ("speed", 60.0, "speed > 60"), ("speed", 47.0, "speed > 47"), ("speed", 1000.0, "speed > 1000"),
        ("lane_width", 1000.0, "width > 1000"), ("lane_width", 100.0, "width > 100"), ("lane_width", 6.0, "width > 6"),
        ("lane_offset", -10.0, "offset > 10"), ("lane_offset", 3.6, "offset > width"),
        ("curvature", -0.2, "curvature > 0.2"), ("yaw_rate", -1.5, "yaw rate > 1.5"),
        # more than 3 m/s^2 at 4 m/s, and a radius under 167 m at 64 m/s
        ("curvature", -0.1875, "tight c > 0.006"), ("yaw_rate", -0.75, "tight r > 0.006"),
        ("curvature", 0.006, "tight c > 0.006"), ("yaw_rate", 64.0 * 0.006, "tight r > 0.006"),
        ("heading", -40.0, "heading > 40"), ("steering", 40.0, "steering > 40"),
    ],
)  # fmt: skip
def test_values_are_counted_beyond_their_limit(column, limit, name):
    columns = {"lane_offset": 0.0, "speed": 64.0 if limit in (0.006, 64.0 * 0.006) else 4.0}
    columns |= {"curvature": None} if column == "yaw_rate" else {}
    for value, counted in ((limit, 0), (np.nextafter(limit, np.sign(limit) * np.inf), 3)):
        recording = drive(t=[0.0, 0.1, 0.2], **(columns | {column: value}))
        table = RecordingTable.of([recording])
        assert dict(unit_counts(table, usable_samples(table), np.array([0.1]), 1.8, [recording]))[name] == counted


def test_a_coarse_offset():
    def counted(step: float, n: int = 400) -> int:
        t = 0.1 * np.arange(n)
        recording = drive(t=t, lane_offset=np.round(0.4 * np.sin(t) / step) * step)
        table = RecordingTable.of([recording])
        return dict(unit_counts(table, usable_samples(table), np.array([0.1]), 1.8, [recording]))["coarse offset > 0"]

    assert (counted(0.1), counted(0.09), counted(0.05)) == (400, 0, 0)
    # of each recording by itself: half of the samples
    t = 0.1 * np.arange(400)
    fine = drive("b", t=t, lane_offset=0.4 * np.sin(t + 1.0))
    coarse = drive("a", t=t, lane_offset=np.round(4.0 * np.sin(t)) / 10.0)
    coarsest = "column 'lane_offset': it comes in steps of 0.1 m or more"
    for several, warned in (
        ([coarse, fine], False),
        ([coarse, fine, dataclasses.replace(coarse, name="c", t=t + 1)], True),
    ):
        assert any(coarsest in words for words in warnings(*several)) == warned


def test_values_that_are_counted_below_a_limit():
    def counted(step: float = 0.1, **columns: float) -> dict[str, int]:
        recording = RecordingTable.of([drive(t=[0.0, 0.1, 0.2], lane_offset=0.0, **columns)])
        return dict(unit_counts(recording, usable_samples(recording), np.array([step, np.nan]), 1.8))

    below = np.nextafter(2.0, 0.0)
    assert (counted(lane_width=2.0)["width < 2"], counted(lane_width=below)["width < 2"]) == (0, 3)
    assert (counted(lane_width=1.8)["width <= vehicle"], counted(lane_width=1.81)["width <= vehicle"]) == (3, 0)
    assert (counted(speed=0.0)["speed < 0"], counted(speed=-0.1)["speed < 0"]) == (0, 3)
    assert (counted(12.0)["step > 12"], counted(12.1)["step > 12"]) == (0, 1)
    assert (counted(0.002)["step < 0.002"], counted(0.0019)["step < 0.002"]) == (0, 1)
