"""Curvature from the yaw rate: against plain least squares, and where it must not reach."""

import numpy as np

from helpers.recordings import drive
from ldctoolkit.recordings import extract_departures
from ldctoolkit.recordings.find_departures import SPEED_FLOOR, curvature_from_yaw_rate


def estimate(yaw_rate, speed, usable=None, first=None, half_width=5):
    n = len(speed)
    usable = np.ones(n, bool) if usable is None else usable
    starts = np.zeros(n, bool)
    starts[0] = True
    if first is not None:
        starts[first] = True
    return curvature_from_yaw_rate(yaw_rate, speed, usable, starts, np.full(n, half_width))


def test_equals_least_squares_in_every_window():
    rng = np.random.default_rng(1)
    v, r = rng.uniform(5, 30, 80), rng.normal(0, 0.05, 80)
    usable = rng.random(80) > 0.1
    c = estimate(r, v, usable, first=40)
    stretch = np.cumsum((np.arange(80) == 40) | ~usable)
    for i in range(80):
        if not usable[i]:
            assert np.isnan(c[i])
            continue
        same = np.flatnonzero(usable & (stretch == stretch[i]))
        here = int(np.flatnonzero(same == i)[0])
        window = same[max(here - 5, 0) : here + 6]
        expected = np.linalg.lstsq(v[window, None], r[window], rcond=None)[0][0]
        np.testing.assert_allclose(c[i], expected, rtol=1e-10)


def test_nothing_crosses_a_gap_or_an_invalid_sample():
    v = np.full(40, 20.0)
    r = np.where(np.arange(40) < 20, 0.02, -0.04)
    np.testing.assert_allclose(estimate(r, v, first=20), r / v, rtol=1e-12)
    usable = np.arange(40) != 20
    r[20] = np.nan
    np.testing.assert_allclose(estimate(r, v, usable), r / v, rtol=1e-12)


def test_low_speed_fades_out():
    # half a degree a second of sensor noise, at a speed of nearly nothing
    c = estimate(np.full(20, 0.01), np.full(20, 1e-3))
    assert np.abs(c).max() <= 0.01 * 1e-3 / SPEED_FLOOR**2 * (1.0 + 1e-12)
    assert estimate(np.full(20, 0.01), np.zeros(20)).tolist() == [0.0] * 20


def test_a_recording_with_yaw_rate():
    t = np.arange(100) * 0.1
    true = 1e-3 + 2e-4 * (t - 5.0)
    speed = 25.0 + 0.1 * (t - 5.0)
    straight = extract_departures([drive(curvature=true, speed=speed)], vehicle_width=1.8)
    found = extract_departures([drive(curvature=None, yaw_rate=true * speed, speed=speed)], vehicle_width=1.8)
    assert (found.provenance.curvature, found.warnings) == ("yaw_rate", ())
    # the window averages a straight line without bias but for its weights v^2: 1 % of speed over half a window
    np.testing.assert_allclose(found.departures.c_0, straight.departures.c_0, atol=1e-6)
    np.testing.assert_allclose(found.departures.dc, straight.departures.dc, atol=1e-6)
