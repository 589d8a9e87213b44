"""Scale, yaw rate and common step of recordings."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from helpers.recordings import OFFSET, T, drive
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Preparation, Recording, extract_departures, read_departures, write_departures
from ldctoolkit.recordings.preparation import NONE, prepare


def scale_of(found: Any) -> list[float]:
    return next((column.values.tolist() for column in found.departures.extra if column.name == "lane_scale"), [])


@pytest.mark.parametrize(("jump", "max_jump", "bridged"), [
    (0.5, 0.6, True), (0.7, 0.6, False), (0.7, 0.8, True), (0.5, 0.4, False), (0.3, 0.4, True),
])  # fmt: skip
def test_the_criterions_jump_is_the_preparations(jump, max_jump, bridged):
    """A sample is missing where the offset steps up, beyond the line."""
    offset = np.interp(T, [3.0, 4.9, 5.1, 8.0], [0.2, 1.2, 1.2 + jump, 0.2])
    one = drive(lane_offset=offset).take(np.arange(100) != 50)
    prepared = prepare(one, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.samples == 99 + bridged
    if bridged:
        assert prepared.lane_offset[50] == pytest.approx(1.2 + 0.5 * jump)
    found = extract_departures([one], vehicle_width=1.8, max_jump=max_jump, preparation=Preparation(step=0.1))
    assert found.departures.n == bridged
    assert found.refused.gap + found.refused.jump == found.refused.total == (not bridged)


@pytest.mark.parametrize("max_jump", [0.6, 2.0])
def test_two_middle_offsets_a_jump_apart(max_jump):
    """Their mean lies where the vehicle never was; it is taken only if the criterion sees no jump between them."""
    t = np.array([0.0, 0.06, 0.1, 0.14, 0.2])
    full = np.full(5, 25.0)
    one = Recording("a", t, np.array([0.0, 0, 0, 1, 1]), full - 21.4, full, full > 0.0).take(np.array([0, 1, 3, 4]))
    prepared = prepare(one, Preparation(step=0.1), max_jump=max_jump)
    assert prepared.lane_offset.tolist() == [0.0, 0.5 if max_jump == 2.0 else 0.0, 1.0]


@pytest.mark.parametrize("seen", [2.5, 3.5, 4.2])
def test_the_nominal_width(seen, tmp_path):
    """A camera that sees everything `seen`/3.5 times as large as it is."""
    true = drive(lane_offset=OFFSET - 0.05, lane_width=np.full(100, 3.5))
    factor = 3.5 / seen
    wrong = dataclasses.replace(true, lane_offset=true.lane_offset / factor, lane_width=true.lane_width / factor)
    preparation = Preparation(nominal_lane_width=3.5)
    prepared = prepare(wrong, preparation)
    assert (prepared.lane_scale, np.median(prepared.lane_width)) == (pytest.approx(factor), pytest.approx(3.5))
    np.testing.assert_allclose(prepared.lane_offset, true.lane_offset)

    right = extract_departures([true], vehicle_width=1.8)
    found = extract_departures([wrong], vehicle_width=1.8, preparation=preparation)
    assert len(right.departures) == len(found.departures) == 1
    np.testing.assert_allclose(found.departures.matrix(), right.departures.matrix(), rtol=1e-9, atol=1e-12)
    # told even where the factor is 1: it was asked for; never told where it was not
    assert scale_of(found) == pytest.approx([factor])
    assert scale_of(right) == []
    write_departures(tmp_path / "d.parquet", found.departures, found.provenance)
    departures, provenance = read_departures(tmp_path / "d.parquet")
    assert (provenance.preparation, departures.extra[-1].name) == (preparation, "lane_scale")
    assert departures.extra[-1].values.tolist() == scale_of(found)


def test_the_median_is_that_of_usable_samples():
    width = np.full(100, 2.8)
    width[:80] = 9.0
    valid = np.arange(100) >= 30
    speed = np.full(100, 25.0)
    speed[30:80] = np.nan
    assert prepare(
        drive(lane_width=width, valid=valid, speed=speed), Preparation(nominal_lane_width=3.5)
    ).lane_scale == (pytest.approx(1.25))
    nothing = drive(valid=np.zeros(100, bool))
    assert prepare(nothing, Preparation(nominal_lane_width=3.5)) is nothing
    # a reader that has scaled already
    assert prepare(drive(lane_scale=2.0), Preparation(nominal_lane_width=3.6)).lane_scale == pytest.approx(2.0)


def test_the_yaw_rate_factor():
    yaw_rate = np.full(100, 0.02)
    one = drive(curvature=None, yaw_rate=-yaw_rate)
    found = extract_departures([one], vehicle_width=1.8, preparation=Preparation(yaw_rate_factor=-1.0))
    np.testing.assert_allclose(found.departures.c_0, 0.02 / 25.0)
    measured = drive(curvature=np.full(100, 1e-3))
    assert prepare(measured, Preparation(yaw_rate_factor=-1.0)) == measured


def test_absurd_numbers_do_no_harm():
    """Not even a floating point warning, which the tests turn into errors."""
    offset, width = OFFSET.copy(), np.full(100, 3.6)
    offset[3], width[4], width[5] = 1e308, 1e308, math.inf
    yaw_rate = np.full(100, 1e308)
    one = drive(lane_offset=offset, lane_width=width, curvature=None, yaw_rate=yaw_rate, heading=yaw_rate)
    with np.errstate(all="raise", under="ignore"):
        for preparation in (Preparation(0.1), Preparation(0.05, 0.25, 6.0, 1e300), Preparation(None, 0.25, 2.0, -5.0)):
            # without a yaw rate that anybody can believe, the lane counts as straight
            found = extract_departures([one], preparation=preparation)
            assert np.isfinite(found.departures.matrix()).all()
            assert found.warnings[-1] == f"{NONE}: 1 of 1 recordings"


def test_the_gap_of_the_criteria_rules_resampled_recordings():
    """A stricter one bridges less; a wider one lets a hole pass, but makes nothing up in it."""
    t = np.arange(200) * 0.05
    offset = 0.9 + np.clip(0.3 * (1.0 - ((t - 5.0) / 0.95) ** 2), -0.4, None)
    columns = {"lane_offset": offset, "lane_width": np.full(200, 3.6), "speed": np.full(200, 25.0)}
    one = Recording("a", t, valid=np.ones(200, bool), curvature=np.zeros(200), **columns)

    def found(hole: float, **criteria: Any) -> tuple[int, dict[str, int]]:
        holed = one.take(np.abs(t - 5.0) >= 0.5 * hole - 1e-9)
        result = extract_departures([holed], vehicle_width=1.8, preparation=Preparation(0.1), **criteria)
        samples = int(result.departures.samples[0]) if len(result.departures) else 0
        return samples, {reason: count for reason, count in result.refused.items() if count}

    assert found(0.2) == (19, {})
    assert found(0.2, max_gap=0.15) == (0, {"gap": 1})
    assert found(0.6) == (0, {"gap": 1})
    assert found(0.6, max_gap=0.7) == (14, {})


def test_a_recording_that_cannot_be_prepared_is_a_problem():
    endless = drive("endless", t=np.linspace(0.0, 1e300, 100), source="x.csv")
    found = extract_departures([endless, drive("b")], vehicle_width=1.8, preparation=Preparation(0.1))
    assert found.departures.recording.tolist() == ["b"]
    (problem,) = found.problems
    assert str(problem).startswith("x.csv: recording 'endless': from t = 0.0 to 1e+300 s; too long")
    assert found.provenance.problems == (str(problem),)


def test_things_that_are_no_recordings():
    with pytest.raises(InputError, match="recordings: an item is a str; allowed: Recording"):
        extract_departures(["drive.csv"])  # type: ignore[list-item]
