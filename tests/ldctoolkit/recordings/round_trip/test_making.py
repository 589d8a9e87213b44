"""The recordings are what they are said to be: against the plain reduction of signals, and sample by sample."""

from __future__ import annotations

import numpy as np
import pytest

from helpers import round_trip as making
from ldctoolkit import DepartureSignals, load_model, reduce_signals

N = 600


@pytest.fixture(scope="module")
def parameters():
    return load_model("reference").sample(N // 2, N // 2, seed=3)


@pytest.fixture(scope="module")
def driven(parameters):
    return making.drive(parameters, 4, events_a_trip=25)


def signals_of(planted):
    """The planted samples with the exact crossings around them."""
    p = planted.parameters
    rows = []
    for i in range(p.n):
        inside = planted.inside[i]
        t = np.concatenate([[0.0], planted.first[i] + 0.1 * np.arange(inside.sum()), [p.T[i]]])
        y = np.concatenate([[0.0], planted.y[i][inside], [0.0]])
        v = np.concatenate([planted.v_ends[i][:1], planted.v[i][inside], planted.v_ends[i][1:]])
        c = np.concatenate([p.c_0[i : i + 1], planted.c[i][inside], (p.c_0 + p.dc)[i : i + 1]])
        rows.append((t, y, v, c))
    offsets = np.cumsum([0] + [row[0].size for row in rows])
    return DepartureSignals(offsets, *(np.concatenate(column) for column in zip(*rows, strict=True)))


def test_samples_reduce_to_the_parameters(driven):
    p = driven.planted.parameters
    back = reduce_signals(signals_of(driven.planted), p.side)
    for name in ("T", "d_y", "a_mean", "sigma_v", "c_0", "dc"):
        np.testing.assert_allclose(getattr(back, name), getattr(p, name), rtol=1e-8, atol=1e-10, err_msg=name)
    # the trapezoid rule goes over the residual of v as well
    np.testing.assert_allclose(back.v_mean, p.v_mean, atol=0.2 * p.sigma_v.max())
    reached = driven.planted.reached
    assert np.mean(reached) > 0.97
    np.testing.assert_allclose(back.sigma_y[reached], p.sigma_y[reached], rtol=1e-8)
    assert (back.sigma_y[~reached] < p.sigma_y[~reached]).all()


def test_every_model_event_is_driven_once(driven, parameters):
    np.testing.assert_array_equal(
        np.sort(driven.planted.parameters.matrix(), axis=0), np.sort(parameters.matrix(), axis=0)
    )
    assert set(driven.planted.parameters.side.tolist()) == {-1, 1}


def test_yaw_rate_turns_the_heading_and_is_held(driven):
    exact = making.measure(driven, making.Noise.none(), 1)
    same = np.diff(driven.trip) == 0
    turned = -np.diff(exact.heading)
    turned = (turned + 180.0) % 360.0 - 180.0
    np.testing.assert_allclose(turned[same], 0.1 * exact.yaw_rate[1:][same], atol=1e-9)
    np.testing.assert_allclose(np.radians(exact.yaw_rate), driven.speed * driven.curvature, atol=1e-12)
    np.testing.assert_allclose(exact.left + exact.right, 2.0 * driven.lane_offset, atol=1e-12)
    noisy = making.measure(driven, making.Noise(), 1)
    odd = np.flatnonzero(driven.tick % 2 == 1)
    np.testing.assert_array_equal(noisy.yaw_rate[odd], noisy.yaw_rate[odd - 1])
    error = noisy.left - exact.left
    assert error.std() == pytest.approx(np.hypot(0.004, 1.0 / 256.0 / np.sqrt(12.0)), rel=0.02)
    np.testing.assert_array_equal(noisy.left * 256.0, np.rint(noisy.left * 256.0))
