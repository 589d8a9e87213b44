"""Resampling against a walk through every window, and what must never be made up."""

import math
import statistics
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.errors import InputError, RecordingError
from ldctoolkit.recordings import Recording
from ldctoolkit.recordings.preparation import resample

SETTINGS = examples(80)
EPS = 1e-6  # share of a step that the edge of a window is wider


def recording(t: Any, **changes: Any) -> Recording:
    n = len(t)
    columns: dict[str, Any] = {"lane_offset": 0.01 * np.arange(n), "lane_width": np.full(n, 3.6)}
    columns |= {"speed": np.full(n, 25.0), "valid": np.ones(n, bool)}
    return Recording("a", np.asarray(t, dtype=float), **(columns | changes))


def random_recording(seed: int, step: float) -> Recording:
    """Irregular, repeated and jittered times, gaps, invalid and missing samples, jumps, lanes. Times lie on a grid of
    2^-9 s that no edge of a window lies on but those of the multiples, so it is clear what is in."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 80))
    ticks = rng.choice([0, 3, 17, 17, 17, 51, 90, 128, 200, 3000], n)
    t = 7.0 + np.cumsum(ticks) / 512.0
    if rng.random() < 0.2:  # on the multiples of the step, and half-way between them
        t = 7.0 + np.cumsum(rng.choice([0.5, 1.0, 2.0, 3.0], n)) * step
    offset = np.cumsum(rng.normal(0.0, 0.05, n)) + 3.5 * np.cumsum(rng.choice([-1, 0, 1], n, p=[0.05, 0.9, 0.05]))
    speed = rng.uniform(10.0, 30.0, n)
    speed[rng.random(n) < 0.05] = rng.choice([np.nan, np.inf, 1e9])
    width = np.where(rng.random(n) < 0.05, rng.choice([0.0, -1.0, np.nan]), rng.uniform(3.0, 4.0, n))
    yaw_rate = rng.normal(0.0, 0.01, n)
    yaw_rate[rng.random(n) < 0.05] = np.nan
    return Recording(
        "a",
        t,
        offset,
        width,
        speed,
        rng.random(n) > 0.1,
        yaw_rate=yaw_rate if rng.random() < 0.7 else None,
        lane=np.cumsum(rng.random(n) < 0.05) if rng.random() < 0.5 else None,
        turn_signal=rng.integers(-1, 2, n) if rng.random() < 0.5 else None,
        heading=np.where(rng.random(n) < 0.3, np.nan, rng.uniform(-3.0, 3.0, n)) if rng.random() < 0.5 else None,
    )


def one_by_one(given: Recording, step: float, max_gap: float) -> list[dict[str, Any]]:
    """The docstring of `resample`, in plain loops over every multiple of the step."""

    def known(value: float) -> bool:
        return math.isfinite(value) and abs(value) < 1e9

    t = [float(time) - float(given.t[0]) for time in given.t]
    numbers = [name for name in ("lane_offset", "lane_width", "speed", "yaw_rate") if getattr(given, name) is not None]
    good = [
        i
        for i in range(len(t))
        if given.valid[i] and all(known(getattr(given, name)[i]) for name in numbers) and given.lane_width[i] > 0
    ]
    out = []
    for k in range(round(t[-1] / step) + 2):
        centre = k * step
        if centre > t[-1] + 0.5 * step:
            break
        reach = (0.5 + EPS) * step
        window = [i for i in good if centre - reach <= t[i] < centre + reach or t[i] == centre + reach]
        row: dict[str, Any] = {"t": float(given.t[0]) + centre, "valid": True}
        nearest = min(good, key=lambda i: abs(t[i] - centre), default=None)
        if given.lane is not None and window:
            # only the neighbours in the nearest sample's lane, without another one in between
            place = good.index(nearest)
            low = high = place
            while low > 0 and given.lane[good[low - 1]] == given.lane[nearest]:
                low -= 1
            while high < len(good) - 1 and given.lane[good[high + 1]] == given.lane[nearest]:
                high += 1
            window = [i for i in window if i in good[low : high + 1]]
        before = [i for i in good if t[i] < centre - reach]
        after = [i for i in good if t[i] > centre + reach]
        if window:
            for name in numbers:
                values = sorted(float(getattr(given, name)[i]) for i in window)
                row[name] = statistics.median(values)
                a, b = values[(len(values) - 1) // 2], values[len(values) // 2]
                if name == "lane_offset" and b - a > 0.6:
                    near = float(given.lane_offset[nearest])
                    row[name] = a if abs(a - near) <= abs(b - near) else b
        elif (
            before
            and after
            and t[after[0]] - t[before[-1]] <= max_gap * (1.0 + EPS)
            and abs(given.lane_offset[after[0]] - given.lane_offset[before[-1]]) <= 0.6
            and (given.lane is None or given.lane[after[0]] == given.lane[before[-1]])
        ):
            i, j = before[-1], after[0]
            for name in numbers:
                row[name] = np.interp(centre, [t[i], t[j]], [getattr(given, name)[i], getattr(given, name)[j]])
        elif any(abs(time - centre) <= reach for time in t):
            row["valid"] = False
        else:
            continue
        if row["valid"]:
            for name in ("lane", "turn_signal", "heading"):
                if getattr(given, name) is not None:
                    row[name] = getattr(given, name)[nearest]
        out.append(row)
    return out


@SETTINGS
@given(
    seed=st.integers(0, 2**32 - 1),
    step=st.sampled_from([0.05, 0.1, 0.125, 0.3, 1.0]),
    max_gap=st.sampled_from([0.03, 0.25, 1.0]),
)
def test_equals_the_walk_through_every_window(seed, step, max_gap):
    made = random_recording(seed, step)
    rows = one_by_one(made, step, max_gap)
    result = resample(made, step, max_gap)
    assert result.valid.tolist() == [row["valid"] for row in rows]
    np.testing.assert_allclose(result.t, [row["t"] for row in rows], rtol=1e-12)
    for name in ("lane_offset", "lane_width", "speed", "yaw_rate", "lane", "turn_signal", "heading"):
        values = getattr(result, name)
        assert (values is None) == (getattr(made, name) is None)
        if values is None:
            continue
        wanted = [row[name] for row in rows if row["valid"]]
        np.testing.assert_allclose(values[result.valid], wanted, rtol=1e-9, atol=1e-12)
        if name in ("lane_offset", "lane_width", "speed", "yaw_rate"):
            assert np.isnan(values[~result.valid]).all()


@pytest.mark.parametrize("origin", [0.0, 3.3, 1e5 + 0.7, 1.7e9])
def test_samples_at_the_multiples_keep_their_bits(origin):
    rng = np.random.default_rng(0)
    t = origin + np.arange(200) / 10.0
    columns = {name: rng.normal(5.0, 1.0, 200) for name in ("lane_offset", "lane_width", "speed", "yaw_rate")}
    one = recording(t, **columns, turn_signal=rng.integers(-1, 2, 200))
    kept = rng.random(200) > 0.1
    kept[0] = True
    one = one.take(kept)
    result = resample(one, 0.1, max_gap=0.11)
    for name in Recording.COLUMNS:
        if getattr(one, name) is not None and (name != "t" or origin < 1e6):
            np.testing.assert_array_equal(getattr(result, name), getattr(one, name))
    # a clock of years resolves 2e-7 s
    np.testing.assert_allclose(result.t, one.t, rtol=0.0, atol=5e-7)
    again = resample(result, 0.1, max_gap=0.11)
    np.testing.assert_array_equal(again.lane_offset, result.lane_offset)
    np.testing.assert_array_equal(again.t, result.t)


def test_one_sample_and_none():
    one = recording([5.0], lane_offset=np.array([0.4]))
    result = resample(one, 0.1)
    assert (result.t.tolist(), result.lane_offset.tolist(), result.valid.tolist()) == ([5.0], [0.4], [True])
    assert resample(one.take(slice(0, 0)), 0.1).samples == 0
    nothing = recording(np.arange(20) / 20.0, valid=np.zeros(20, bool), lane=np.ones(20, dtype=np.int64))
    result = resample(nothing, 0.1)
    assert not result.valid.any()
    assert result.samples in (10, 11)
    assert np.isnan(result.speed).all()
    same = resample(recording(np.full(5, 3.0), lane_offset=np.array([0.5, 0.1, 0.2, 0.4, 0.3])), 0.1)
    assert same.lane_offset.tolist() == [0.3]


def test_a_huge_gap_costs_nothing():
    t = np.concatenate([np.arange(50) / 10.0, 1e6 + np.arange(50) / 10.0, 1e12 + np.arange(50) / 10.0])
    tracemalloc.start()
    result = resample(recording(t), 0.01)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6
    np.testing.assert_array_equal(np.unique(np.round(result.t[result.t > 10.0] / 1e6)), [1.0, 1e6])


@pytest.mark.parametrize("t", [[0.0, 1e300], [-1e308, 1e308]])
def test_absurd_times_are_told(t):
    with pytest.raises(RecordingError, match=r"recording 'a': from t = .* too long to be brought to steps of 0\.1 s"):
        resample(recording(t), 0.1)


def test_absurd_numbers_are_no_part_of_a_median():
    offset = np.array([0.1, 1e12, 1.5e308, 0.2, 1.5e308])
    result = resample(recording([0.0, 0.01, 0.02, 0.1, 0.11], lane_offset=offset), 0.1)
    assert result.lane_offset.tolist() == [0.1, 0.2]


@pytest.mark.parametrize(
    ("step", "max_gap"), [(0.0, 0.25), (-0.1, 0.25), (math.nan, 0.25), (0.1, 0.0), (0.1, math.inf)]
)
def test_steps_that_are_refused(step, max_gap):
    with pytest.raises(InputError, match="allowed: more than 0, finite"):
        resample(recording([0.0, 0.1]), step, max_gap)
