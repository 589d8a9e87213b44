"""Recorded paths: closed forms against quadrature and differences, residuals against what they must reduce to."""

from typing import Any

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import brentq

from helpers.bits import examples
from helpers.closed_loop import grid, some
from ldctoolkit import DepartureSignals, Scenarios, reduce_signals
from ldctoolkit import departures as dep
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import Residuals

OFF = Residuals()
BOTH = Residuals(y=True, v=True)
KINDS = (OFF, Residuals(y=True), Residuals(v=True), BOTH, Residuals(y=True, v=True, bandwidth=3.0))


def mixed(n: int, seed: int = 0) -> Scenarios:
    rng = np.random.default_rng(seed)
    T = rng.uniform(0.5, 10.0, n)
    return Scenarios.from_arrays(
        T=T, d_y=rng.uniform(0.05, 0.8, n), v_mean=rng.uniform(15.0, 40.0, n), a_mean=rng.uniform(-1.0, 1.0, n),
        c_0=rng.uniform(-0.004, 0.004, n), dc=rng.uniform(-0.004, 0.004, n), sigma_y=rng.uniform(0.0, 0.08, n),
        sigma_v=rng.uniform(0.0, 0.6, n), side=rng.choice([-1, 1], n),
    )  # fmt: skip


FEW = mixed(12)
MANY = mixed(300)


def dense(path: UncorrectedPath, k: int = 4001) -> np.ndarray:
    return path.scenarios.T[:, None] * np.linspace(0.0, 1.0, k)


def at(path: UncorrectedPath, i: int, name: str) -> Any:
    """One row's method as a scalar function."""
    row = path.take([i])
    return lambda t: float(getattr(row, name)(np.array([t]))[0])


# --- without residuals: the functions of `departures`, to the bit
@pytest.mark.parametrize("shape", [(), (7,)])
def test_without_residuals_every_bit_is_that_of_the_closed_forms(shape: tuple[int, ...]) -> None:
    path = UncorrectedPath.of(MANY, OFF, seed=5)
    rng = np.random.default_rng(1)
    T = MANY.T.reshape(-1, *(1,) * len(shape))
    t = rng.uniform(-0.2, 1.0, (MANY.n, *shape)) * T
    p = MANY if not shape else Scenarios(**{k: v[:, None] for k, v in vars(MANY).items() if v is not None})
    for name in ("position", "speed", "lateral", "lateral_rate", "lateral_acceleration", "curvature"):
        np.testing.assert_array_equal(getattr(path, name)(t), getattr(dep, name)(p, t), err_msg=name)
    np.testing.assert_array_equal(path.area(t), dep.lateral_integral(p, t))
    np.testing.assert_array_equal(path.crossing_time(0.2), dep.crossing_time(MANY, 0.2))


def test_beyond_the_end_speed_and_curvature_are_held() -> None:
    for residuals in (OFF, BOTH):
        path = UncorrectedPath.of(FEW, residuals, seed=5)
        later = FEW.T * 1.7
        np.testing.assert_array_equal(path.speed(later), path.speed(FEW.T))
        np.testing.assert_array_equal(path.curvature(later), path.curvature(FEW.T))


@pytest.mark.parametrize("residuals", [OFF, BOTH])
@given(st.floats(0.0, 1.2))
@examples(40)
def test_extremes_in_closed_form_and_searched_equal_a_dense_search(residuals: Residuals, share: float) -> None:
    path = UncorrectedPath.of(FEW, residuals, seed=8)
    end = share * FEW.T
    t = np.minimum(share, 1.0) * dense(path)
    y = path.lateral(t)
    start = np.zeros(FEW.n)
    # a peak between two of 4,000 points lies at most half the second derivative times (T/8000)^2 above them; modes
    # have j <= 20, amplitudes together are below 0.4 m and 2 m/s
    bend = 0.5 * (20.0 * np.pi / 8000.0) ** 2
    for ours, samples, size in (
        (path.deepest(end), y, 0.4),
        (path.highest(lambda some, _, t: some.lateral_rate(t) ** 2, start, end), path.lateral_rate(t) ** 2, 40.0),
        (-path.slowest_speed(start, end), -path.speed(t), 2.0),
    ):
        assert np.all(ours >= samples.max(axis=1) - 1e-13)
        assert np.all(ours <= samples.max(axis=1) + size * bend)


@pytest.mark.parametrize("peak", [0.01, 0.499, 0.5, 0.56, 0.97])
def test_the_highest_value_of_curves_with_a_known_peak(peak: float) -> None:
    path = UncorrectedPath.of(FEW, OFF, seed=0)
    start, end, T, some = 0.1 * FEW.T, 0.8 * FEW.T, FEW.T[:, None], np.array([3, 1])

    def share(t: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return (t / T[rows] - 0.1) / 0.7 - peak

    shapes = {
        "smooth": lambda x: np.cos(x) + 0.1 * np.sin(x) ** 3,
        "a kink": lambda x: 1.0 - np.where(x > 0.0, 2.0, 0.3) * np.abs(x),
        "a jump of the curvature": lambda x: 1.0 - np.where(x > 0.0, 3.0, 0.1) * x * x,
        "flat": lambda x: np.ones_like(x),
        "rising to the end": lambda x: x - 1.0 + peak + 1.0,
    }
    for name, shape in shapes.items():
        found = path.highest(lambda _, rows, t, shape=shape: shape(share(t, rows)), start, end)
        assert np.all(np.abs(found - 1.0) < 1e-9), name
        alone = path.take(some).highest(
            lambda _, rows, t, shape=shape: shape(share(t, some[rows])), start[some], end[some]
        )
        np.testing.assert_array_equal(alone, found[some])


# --- closed forms with residuals
@pytest.mark.parametrize("residuals", KINDS)
def test_derivatives_equal_central_differences(residuals: Residuals) -> None:
    path = UncorrectedPath.of(MANY, residuals, seed=2)
    t = MANY.T * np.random.default_rng(3).uniform(-0.1, 0.98, MANY.n)
    h = 1e-4
    for value, rate in (("position", "speed"), ("lateral", "lateral_rate"), ("lateral_rate", "lateral_acceleration")):
        f = getattr(path, value)
        difference = (f(t + h) - f(t - h)) / (2.0 * h)
        exact = getattr(path, rate)(t)
        # truncation h^2/6 of a third derivative up to (2 pi 3 Hz)^3 0.8 = 5e3 (m, or m/s), four times that in y'';
        # rounding of x near 400 m: 6e-14/h
        np.testing.assert_allclose(difference, exact, rtol=0, atol=5e-5, err_msg=value)


SHARES = (-0.1, 0.3, 1.0)


@pytest.mark.parametrize(
    ("residuals", "share"), grid(KINDS, SHARES, (OFF, 0.3), (KINDS[2], 0.3), (BOTH, -0.1), (BOTH, 1.0))
)
def test_area_and_distance_equal_quadrature(residuals: Residuals, share: float) -> None:
    path = UncorrectedPath.of(FEW, residuals, seed=2)
    t = share * FEW.T
    area, position = path.area(t), path.position(t)
    for i in range(0, FEW.n, 3):
        expected, _ = quad(at(path, i, "lateral"), 0.0, t[i], epsabs=1e-13, epsrel=1e-13, limit=400)
        assert area[i] == pytest.approx(expected, abs=1e-12)
        travelled, _ = quad(at(path, i, "speed"), 0.0, t[i], epsabs=1e-11, epsrel=1e-13, limit=400)
        assert position[i] == pytest.approx(travelled, abs=1e-10)


# --- what the residuals are
@pytest.mark.parametrize("residuals", some(KINDS[1:], BOTH))
def test_reducing_the_path_gives_its_parameters_back(residuals: Residuals) -> None:
    k = 4001
    few = MANY.take(slice(60))
    path = UncorrectedPath.of(few, residuals, seed=11)
    t = dense(path, k)
    signals = DepartureSignals(
        np.arange(few.n + 1) * k, t.ravel(), path.lateral(t).ravel(), path.speed(t).ravel(), path.curvature(t).ravel()
    )
    back = reduce_signals(signals, few.side)
    np.testing.assert_array_equal(back.T, few.T)
    # sums over 4,000 samples in place of integrals, without the two ends, and L - 1: relative errors of 1/4,000
    sigma_y = few.sigma_y if residuals.y else 0.0 * few.sigma_y
    sigma_v = few.sigma_v if residuals.v else 0.0 * few.sigma_v
    np.testing.assert_allclose(back.sigma_y, sigma_y, rtol=1e-3, atol=1e-6)
    np.testing.assert_allclose(back.sigma_v, sigma_v, rtol=2e-3, atol=1e-9)
    # the trapezoid rule's distance: h^2/12 of the change of dv/dt
    np.testing.assert_allclose(back.v_mean, few.v_mean, rtol=0, atol=1e-5)
    # eps_y is 0 at the ends, so leaving them out costs nothing
    np.testing.assert_allclose(back.d_y, few.d_y, rtol=0, atol=1e-6)
    # eps_v is not: two samples of 4,000 with up to 2 m/s, on a lever of T/2, against 4,000 T^2/12
    np.testing.assert_allclose(back.a_mean * few.T, few.a_mean * few.T, rtol=0, atol=0.01)
    np.testing.assert_allclose(back.c_0, few.c_0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(back.dc, few.dc, rtol=0, atol=1e-12)


@pytest.mark.parametrize("bandwidth", [0.2, 1.0, 5.0])
def test_projections_are_exact(bandwidth: float) -> None:
    path = UncorrectedPath.of(FEW, Residuals(y=True, v=True, bandwidth=bandwidth), seed=11)
    plain = UncorrectedPath(FEW, path.modes_y[:, :0], path.modes_v)  # its parabola, with eps_v in x(t)
    u, weight = np.polynomial.legendre.leggauss(700)  # up to 300 half waves in a product
    t = 0.5 * FEW.T[:, None] * (1.0 + u)
    eps_y = path.lateral(t) - plain.lateral(t)
    eps_v = path.speed(t) - UncorrectedPath.of(FEW, OFF, seed=0).speed(t)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(values @ weight / 2.0)

    # rounding of the sums: 1e-15 of values up to 1 m, and of speeds up to 40 m/s
    np.testing.assert_allclose(mean(eps_y * plain.lateral(t)), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.sqrt(mean(eps_y**2) - mean(eps_y) ** 2), FEW.sigma_y, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(mean(eps_v), 0.0, atol=1e-13)
    np.testing.assert_allclose(mean(eps_v * u), 0.0, atol=1e-13)
    np.testing.assert_allclose(np.sqrt(mean(eps_v**2)), FEW.sigma_v, rtol=1e-11)


@pytest.mark.parametrize("residuals", KINDS)
def test_the_path_starts_and_ends_on_the_line(residuals: Residuals) -> None:
    path = UncorrectedPath.of(MANY, residuals, seed=4)
    np.testing.assert_array_equal(path.lateral(np.zeros(MANY.n)), 0.0)
    # rounding: j pi times 1e-16 of a mode, up to 60 of them
    np.testing.assert_allclose(path.lateral(MANY.T), 0.0, atol=1e-14)
    np.testing.assert_allclose(path.position(MANY.T), MANY.v_mean * MANY.T, rtol=1e-14)


@pytest.mark.parametrize("bandwidth", [0.5, 5.0])
def test_no_mode_above_the_bandwidth_but_always_three(bandwidth: float) -> None:
    path = UncorrectedPath.of(MANY, Residuals(y=True, v=True, bandwidth=bandwidth), seed=4)
    for modes in (path.modes_y, path.modes_v):
        frequency = np.arange(1, modes.shape[1] + 1) / (2.0 * MANY.T[:, None])
        used = modes != 0.0
        assert np.all((frequency <= np.maximum(bandwidth, 1.5 / MANY.T)[:, None])[used])
        np.testing.assert_array_equal(used.sum(axis=1), np.clip(np.floor(2.0 * MANY.T * bandwidth), 3, 100))
    # and seen from outside: a long residual's spectrum, its even extension made of whole waves
    longest = int(np.argmax(MANY.T))
    T = MANY.T[longest]
    k = 4096
    t = (np.arange(k) + 0.5) / k * T
    eps = path.take([longest]).speed(t[None, :]) - dep.speed(MANY.take([longest]), t)
    spectrum = np.abs(np.fft.rfft(np.concatenate([eps[0], eps[0, ::-1]]))) / k
    beyond = np.arange(spectrum.size) / (2.0 * T) > bandwidth
    assert spectrum[beyond].max() < 1e-12
    assert spectrum[~beyond].max() > 0.01 * MANY.sigma_v[longest]


@pytest.mark.slow
def test_residuals_over_many_scenarios() -> None:
    n = 20_000
    same = Scenarios.from_arrays(T=np.full(n, 4.0), d_y=0.4, v_mean=25.0, sigma_y=0.05, sigma_v=0.3)
    path = UncorrectedPath.of(same, BOTH, seed=6)
    assert path.modes_y.shape == path.modes_v.shape == (n, 8)
    for modes, sigma, fixed in ((path.modes_y, 0.05, 0), (path.modes_v, 0.3, None)):
        free = [j for j in range(1, 8) if j != fixed]
        for j in free:
            # symmetric about 0: as many above as below, within four standard deviations
            assert abs(np.mean(modes[:, j] > 0) - 0.5) < 4 * 0.5 / np.sqrt(n)
            assert abs(np.mean(modes[:, j])) < 4 * np.std(modes[:, j]) / np.sqrt(n)
        # even modes are free of every projection: the share of one direction of seven in a random unit vector
        power = modes[:, 1::2] ** 2 / (2.0 * sigma**2)
        expected = scipy.stats.beta(0.5, 3.0)
        if sigma == 0.3:
            for column in power.T:
                assert scipy.stats.kstest(column, expected.cdf).pvalue > 1e-3
        # and no two of them go together
        assert np.abs(np.corrcoef(modes[:, free].T) - np.eye(len(free)))[1::2, 1::2].max() < 4 / np.sqrt(n)
    # orthogonality to the parabola takes the first mode away almost wholly: it is -a_3/27 - a_5/125 - a_7/343
    assert np.std(path.modes_y[:, 0]) < 0.06 * np.std(path.modes_y[:, 1])
    # in the middle about normal: seven directions of fixed length have a kurtosis of -2/3 at most
    t, plain = np.full(n, 1.7), UncorrectedPath(same, path.modes_y[:, :0], path.modes_v)
    middle = path.lateral(t) - plain.lateral(t)
    assert abs(scipy.stats.skew(middle)) < 4 * np.sqrt(6 / n)
    assert -0.8 < scipy.stats.kurtosis(middle) < 0.0


def test_the_seed_decides_and_residuals_have_nothing_in_common() -> None:
    path = UncorrectedPath.of(MANY, BOTH, seed=6)
    again, other = (UncorrectedPath.of(MANY, BOTH, seed=seed) for seed in (6, 7))
    np.testing.assert_array_equal(again.modes_y, path.modes_y)
    np.testing.assert_array_equal(again.modes_v, path.modes_v)
    drawn = (path.modes_y != 0.0) & (other.modes_y != 0.0)
    assert not np.any(path.modes_y[drawn] == other.modes_y[drawn])
    # the two residuals of a scenario have nothing in common
    correlation = np.corrcoef(path.modes_y[:, 1] / MANY.sigma_y, path.modes_v[:, 1] / MANY.sigma_v)
    assert abs(correlation[0, 1]) < 4 / np.sqrt(300)


# --- the trigger
@pytest.mark.parametrize(("residuals", "y_s"), grid(KINDS[1:], [0.0, 0.05, 0.2, 0.5], (BOTH, 0.0), (BOTH, 0.2)))
def test_crossing_equals_brute_force(residuals: Residuals, y_s: float) -> None:
    path = UncorrectedPath.of(MANY.take(slice(60)), residuals, seed=9)
    t = dense(path, 20_001)
    beyond = path.lateral(t) > y_s
    first = np.argmax(beyond, axis=1)
    seen = beyond.any(axis=1)
    crossing = path.crossing_time(y_s)
    # a peak above y_s that stays between two of 20,000 samples would be missed by brute force, not by the search
    np.testing.assert_array_equal(np.isfinite(crossing), seen)
    rows = np.flatnonzero(seen)
    upper = t[rows, first[rows]]
    lower = t[rows, np.maximum(first[rows] - 1, 0)]
    assert np.all(crossing[rows] <= upper)
    assert np.all(crossing[rows] >= lower)
    if y_s == 0.0:  # at once, and exactly, where the path starts outwards
        outwards = path.lateral_rate(np.zeros(path.n)) > 0.0
        np.testing.assert_array_equal(crossing == 0.0, outwards)
    # there y = y_s, to 1e-13 s of its slope and rounding
    crossed = path.take(rows)
    slope = np.abs(crossed.lateral_rate(crossing[rows]))
    assert np.all(np.abs(crossed.lateral(crossing[rows]) - y_s) <= 1e-13 * slope + 1e-15)


def test_a_peak_inside_one_cell_is_a_crossing() -> None:
    for i in range(0, FEW.n, 3):
        path = UncorrectedPath.of(FEW.take([i]), BOTH, seed=9)
        top = float(path.deepest(path.scenarios.T)[0])
        # just under the peak: the path is above for a few microseconds
        below = float(path.crossing_time(top - 1e-11)[0])
        assert np.isfinite(below)
        assert at(path, 0, "lateral")(below) == pytest.approx(top, abs=1e-10)
        assert np.isinf(path.crossing_time(top + 1e-11)[0])


def test_a_path_that_first_goes_inwards_triggers_when_it_is_back() -> None:
    one = Scenarios.from_arrays(T=[4.0], d_y=[0.1], v_mean=[20.0])
    # dy/dt(0) = pi/4 (2 a_2) + 4 d_y/T < 0
    path = UncorrectedPath(one, np.array([[0.0, -0.2]]), np.zeros((1, 0)))
    assert path.lateral_rate(np.zeros(1))[0] < 0
    crossing = path.crossing_time(0.0)
    # 0.4 u (1 - u) = 0.2 sin(2 pi u), from where on the parabola is larger
    u = brentq(lambda u: 0.4 * u * (1.0 - u) - 0.2 * np.sin(2.0 * np.pi * u), 0.25, 0.5, xtol=1e-15)
    assert crossing[0] == pytest.approx(4.0 * u, abs=1e-13)
