"""Designs in the tests of regulations and Euro NCAP."""

import dataclasses
import functools
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq
from scipy.signal import butter, filtfilt, lfilter

from helpers.bits import assert_same_bits
from helpers.closed_loop import Constant, Stepped
from ldctoolkit import Controller, Plant, Setup, VehicleParameters, simulate
from ldctoolkit.controllers import LQR, NoControl
from ldctoolkit.errors import NOT_GIVEN, LdcError
from ldctoolkit.plant_options import Driver, Mismatch
from ldctoolkit.simulation import Takeover
from ldctoolkit.studies.assessment import Assessment, assess
from ldctoolkit.studies.standards import Standard, load_standard, standard_names
from ldctoolkit.studies.study_file import load_study

ROAD_EDGE, DRIVEABILITY = "euroncap-2026-elk-road-edge", "euroncap-2026-driveability"
CELLS = load_standard(ROAD_EDGE).every_cell
CELL = 8  # 60 km/h, 0.5 m/s
HALF = 0.85  # m, from the edge to the line in the middle of a lane of 3.6 m
ALL = functools.partial(np.testing.assert_allclose, rtol=0)


@pytest.fixture(scope="module")
def built() -> Setup:
    """The plant of the catalog's study road-edge."""
    return load_study("road-edge").setup()


def stated(controller: Controller, standard: str | Standard, setup: Setup | None = None, *, y_s: float) -> Assessment:
    return assess(controller, standard, setup, y_s=y_s, tolerances=False)


def quiet(setup: Setup) -> Setup:
    """The nominal vehicle and a camera without noise."""
    sensors = dataclasses.replace(setup.options.sensors, e_y_noise=0.0, e_psi_noise=0.0, curvature_noise=0.0)
    return setup.on(dataclasses.replace(setup.options, sensors=sensors, mismatch=Mismatch()))


def dtle(y_s: float) -> float:
    cell = load_standard(ROAD_EDGE).scenarios(CELLS, HALF).take([CELL])
    return float(simulate(LQR(), cell, y_s=y_s).metrics.dtle[0])


def test_a_tenth_of_a_meter_is_the_limit() -> None:
    """The trigger for a DTLE just inside, and for 1 cm more, by bisection of the simulation."""
    for wanted, passes in ((-0.0999, True), (-0.1001, False), (-0.11, False)):
        y_s = brentq(lambda y: dtle(y) - wanted, -0.4, 0.2, xtol=1e-10)  # noqa: B023
        assessment = stated(LQR(), ROAD_EDGE, y_s=y_s)
        assert assessment.values[0, 0, CELL] == pytest.approx(wanted, abs=1e-5)
        assert bool(assessment.passed[CELL]) is passes
        assert assessment.lights[CELL] == ("green" if passes else "red")
        assert 0.3 < assessment.score < 1.0
    assert assessment.cells.name(CELL) == "60 km/h, 0.5 m/s"
    assert assessment.reason(CELL) == "DTLE \u22120.11 m, limit \u22120.10 m"
    assert assessment.reason(0) == ""


@pytest.mark.parametrize("name", ["ideal", "built"])
def test_dtle_is_that_of_the_simulation(name: str, built: Setup) -> None:
    """To 1e-4 m, of a law that brings the vehicle back at once."""
    setup = Setup() if name == "ideal" else quiet(built)
    assessment = stated(LQR(), ROAD_EDGE, setup, y_s=-0.3)
    driven = simulate(LQR(), load_standard(ROAD_EDGE).scenarios(CELLS, HALF), y_s=-0.3, setup=setup)
    ALL(assessment.values[0, 0], driven.metrics.dtle, atol=1e-4)


def test_a_test_goes_on_two_seconds_after_its_limit_was_broken() -> None:
    """Without control the edge is then 0.1 m + 2 s times the lateral velocity beyond the line."""
    assessment = stated(NoControl(), ROAD_EDGE, y_s=0.2)
    ALL(assessment.values[0, 0], -0.1 - 2.0 * CELLS.second, atol=1e-6)
    assert assessment.reason(0) == "DTLE \u22120.50 m, limit \u22120.10 m"
    assert assessment.score == assessment.robust_score == assessment.extended_score == 0.0
    ALL(stated(NoControl(), ROAD_EDGE, y_s=9.9).values, assessment.values, atol=1e-6)  # never triggered
    later = stated(NoControl(), "euroncap-2025-elk", y_s=0.2)
    ALL(later.values[0, 0], -0.3 - 2.0 * later.cells.second, atol=1e-6)
    late = stated(LQR(), ROAD_EDGE, y_s=0.55)  # at 0.2 m/s the test is over before the law takes over
    ALL(late.values[0, 0, CELLS.second == 0.2], -0.5, atol=1e-6)


def test_a_corner_may_keep_the_lateral_velocity_that_it_departs_with() -> None:
    """Without control the velocity stays: 0.65 m/s at the corner of the cell with 0.6 m/s."""
    assessment = assess(NoControl(), DRIVEABILITY)
    assert assessment.robust_score == 1.0
    assert assessment.limits[:, 1, :5].max(axis=0).tolist() == pytest.approx([0.3, 0.35, 0.45, 0.55, 0.65])
    assert assessment.limits[0, 1, :5].tolist() == [0.3, 0.3, 0.4, 0.5, 0.6]


def test_in_a_bend_the_rear_tyres_count(built: Setup) -> None:
    """The same drive of the catalog's test, from its trajectories: front and rear edges, to 1 mm."""
    standard = load_standard("un-r79-b1")
    scenarios = standard.scenarios(standard.every_cell, HALF)
    driven = simulate(LQR(r_delta=60000.0), scenarios, y_s=-0.44, setup=quiet(built), trajectories=True).trajectories
    assert driven is not None
    e_y, e_psi = driven.x[:, :, 0] - HALF, driven.x[:, :, 2]
    front, rear = np.nanmax(e_y + 1.43 * e_psi, axis=1), np.nanmax(e_y - 1.47 * e_psi, axis=1)
    assessment = stated(LQR(r_delta=60000.0), "un-r79-b1", built, y_s=-0.44).values[0, 0]
    ALL(assessment, -np.maximum(front, rear), atol=1e-3)
    assert ((rear > 0.005) & (front < 0.0)).any()


def test_each_cell_ends_by_its_own_limit() -> None:
    """With 0.1 m allowed at 0.2 m/s and 0.9 m at 0.5 m/s, the edge gets two seconds farther than each."""
    text = load_standard(ROAD_EDGE).model_dump()
    text["condition"] = ({"quantity": "dtle", "limit": (-0.1, -0.1, -0.1, -0.9, -0.1, -0.1)},)
    assessment = stated(NoControl(), Standard.model_validate(text), y_s=0.2)
    ALL(assessment.values[0, 0, [0, 3]], [-0.5, -1.9], atol=1e-6)


def test_a_command_that_acts_at_once_turns_the_wheel_from_where_it_stood() -> None:
    """Without lag the first command is a step; filtered at 10 Hz it is a rate of 20 times its height."""
    scenarios = load_standard(DRIVEABILITY).scenarios(load_standard(DRIVEABILITY).every_cell, HALF)
    takeover = Takeover.build(scenarios, Setup(), y_s=-0.4)
    assessment = stated(LQR(r_delta=500.0), DRIVEABILITY, y_s=-0.4)
    kept = simulate(LQR(r_delta=500.0), scenarios, y_s=-0.4, trajectories=True).trajectories
    assert kept is not None
    step = np.abs(kept.delta[takeover.rows, 0] - takeover.delta_0) * np.degrees(15.0)
    fast = np.isfinite(assessment.values[0, 0, takeover.rows])
    assert fast.sum() == 20
    assert (assessment.values[0, 0, takeover.rows][fast] > 15.0 * step[fast]).all()


def pulse(first: int) -> Stepped:
    """A law that steers back, and for a second from a sample on, steers out again."""
    return Stepped(inner=LQR(r_delta=500.0), fault=lambda delta, k: delta + (0.05 if first <= k < first + 20 else 0.0))


def test_a_test_ends_two_seconds_after_the_largest_lateral_position() -> None:
    plain = stated(LQR(r_delta=500.0), ROAD_EDGE, y_s=-0.4)
    late, early = (stated(pulse(first), ROAD_EDGE, y_s=-0.4) for first in (80, 20))
    ALL(late.values, plain.values, atol=1e-3)
    assert late.score == 1.0
    assert early.score < 0.5
    driven = simulate(pulse(80), load_standard(ROAD_EDGE).scenarios(CELLS, HALF), y_s=-0.4)
    assert (driven.metrics.dtle < -0.1).mean() > 0.5  # what was left out


@pytest.fixture(scope="module")
def runs(built: Setup) -> Any:
    """Two cells of a design that turns the wheel too fast, at 70 and 80 km/h."""
    setup, some = quiet(built), np.array([12, 18])
    scenarios = load_standard(ROAD_EDGE).scenarios(CELLS, HALF)
    kept = simulate(LQR(), scenarios, y_s=-0.4, setup=setup, trajectories=some).trajectories
    standard = load_standard(DRIVEABILITY)
    same = [next(i for i in range(30) if standard.every_cell.name(i) == CELLS.name(row)) for row in some]
    return kept, stated(LQR(), DRIVEABILITY, setup, y_s=-0.4), same


def signals(kept: Any, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Time since the trigger, state, wheel angle, and when the front tyre's edge is deepest."""
    own = np.isfinite(kept.t[i])
    t, x = kept.t[i, own] - kept.t[i, 0], kept.x[i, own]
    return t, x, kept.delta[i, own], t[np.argmax(x[:, 0] + 1.43 * x[:, 2])]


def test_the_steering_wheels_rate_is_filtered_without_phase(runs: Any) -> None:
    """By scipy's transfer function form, on an own grid of 1 kHz: to 2 %."""
    kept, assessment, same = runs
    for i, row in enumerate(same):
        t, _, delta, deepest = signals(kept, i)
        times = np.arange(-1.0, t[-1], 1e-3)
        rate = np.gradient(np.interp(times, t, 15.0 * np.degrees(delta)), times)
        filtered = filtfilt(*butter(6, 10.0, fs=1000.0), rate)
        inside = (times >= 0) & (times <= deepest + 2.0)
        assert assessment.values[0, 0, row] == pytest.approx(np.abs(filtered[inside]).max(), rel=0.02)
        assert assessment.values[0, 0, row] > 20.0


def test_the_ratio_of_the_steering_scales_its_rate(built: Setup) -> None:
    setup = dataclasses.replace(built, vehicle=VehicleParameters(steering_ratio=30.0))
    twice, once = (stated(LQR(), DRIVEABILITY, one, y_s=-0.4).values[0] for one in (setup, built))
    fast = np.isfinite(once[0])
    ALL(twice[0][fast], 2.0 * once[0][fast], atol=1e-9)
    np.testing.assert_array_equal(twice[1], once[1])
    assert not np.isfinite(twice[0][:10]).any()  # below 70 km/h
    assert np.isfinite(twice[0][10:]).all()  # twice the angle, beyond 5 degrees everywhere
    assert 10 < fast.sum() < 20


def test_the_lateral_velocity_is_that_of_two_seconds_after(runs: Any) -> None:
    """After the largest sample of the front tyre's edge: to 0.01 m/s."""
    kept, assessment, same = runs
    for i, row in enumerate(same):
        t, x, _, deepest = signals(kept, i)
        assert assessment.values[0, 1, row] == pytest.approx(abs(np.interp(deepest + 2.0, t, x[:, 1])), abs=0.01)


def test_the_extremum_itself_counts_and_not_the_sample_after_it(built: Setup) -> None:
    """At 80 km/h and 0.5 m/s, against scipy's cubics through the samples: to 1e-6."""
    assessment, cells = stated(LQR(), DRIVEABILITY, built, y_s=-0.4), load_standard(DRIVEABILITY).every_cell
    row = [i for i in range(cells.n) if cells.name(i) == "80 km/h, 0.5 m/s"]
    scenarios = load_standard(DRIVEABILITY).scenarios(cells, HALF).take(row)
    kept = simulate(LQR(), scenarios, y_s=-0.4, setup=quiet(built), trajectories=True).trajectories
    inside = np.isfinite(kept.t[0])
    t, x = kept.t[0, inside], kept.x[0, inside]
    front = CubicHermiteSpline(t, x[:, 0] + 1.43 * x[:, 2], x[:, 1] + 1.43 * x[:, 3])
    peaks = front.derivative().roots(extrapolate=False)
    after = peaks[np.argmax(front(peaks))] + 2.0
    wanted = abs(CubicHermiteSpline(t, x[:, 0], x[:, 1])(after, 1))
    ALL(assessment.values[0, 1, row], wanted, atol=1e-6)
    ALL(wanted, 0.2254, atol=5e-5)


def test_the_jerk_of_r79_is_that_of_the_filtered_acceleration(built: Setup) -> None:
    """Of the vehicle, bend included, by scipy's transfer function form on an own grid of 1 kHz: to 5 %."""
    setup, standard = quiet(built), load_standard("un-r79-b1")
    scenarios = standard.scenarios(standard.every_cell, HALF).take([2, 9])
    kept = simulate(LQR(), scenarios, y_s=-0.2, setup=setup, trajectories=True).trajectories
    assessment = stated(LQR(), "un-r79-b1", setup, y_s=-0.2).values[0, 2]
    for i, row in enumerate((2, 9)):
        t, x, _, deepest = signals(kept, i)
        times = np.arange(-6.0, t[-1], 1e-3)
        bend = scenarios.v_mean[i] ** 2 * scenarios.c_0[i]
        a_y = np.where(times < 0, 0.0, np.gradient(np.interp(times, t, x[:, 1]), times) + bend)  # straight on before
        filtered = lfilter(*butter(4, 0.5, fs=1000.0), a_y)
        jerk = np.abs(filtered[500:] - filtered[:-500]) / 0.5
        inside = (times[500:] >= 0) & (times[500:] <= deepest + 2.0)
        assert assessment[row] == pytest.approx(jerk[inside].max(), rel=0.05)


def test_one_design_passes_every_standard(built: Setup) -> None:
    for name in standard_names():
        assessment = stated(LQR(r_delta=60_000.0), name, built, y_s=-0.6)
        assert (name, assessment.score, set(assessment.lights)) == (name, 1.0, {"green"})


def test_every_standard_has_a_design_that_fails(built: Setup) -> None:
    without = {name: stated(NoControl(), name, built, y_s=0.2).score for name in standard_names()}
    hard = {name: stated(LQR(r_delta=500.0), name, built, y_s=-0.2) for name in (DRIVEABILITY, "iso-11270")}
    failed = {"euroncap-2025-elk": 0.0, ROAD_EDGE: 0.0, "un-r79-b1": 0.0}
    assert without == {DRIVEABILITY: 1.0, "iso-11270": 1.0, **failed}
    assert {name: round(one.score, 2) for name, one in hard.items()} == {DRIVEABILITY: 0.33, "iso-11270": 0.12}
    assert hard["iso-11270"].reason(24).startswith("Added a_y 3.37 m/s², limit 3.00 m/s²; Added jerk 9.27 m/s³")


def test_the_default_passes_at_every_corner(built: Setup) -> None:
    """Five vehicles at four corners with three seeds of noise."""
    assessment = assess(LQR(), ROAD_EDGE, built, y_s=-0.4)
    assert assessment.robust.all()
    assert (assessment.score, assessment.robust_score, assessment.extended_score) == (1.0, 1.0, 1.0)
    assert len(assessment.variants) == 61
    assert assessment.variants[:2] == ("", "nominal vehicle, -1 km/h, -0.05 m/s")
    corners = [f"{speed} km/h, {rate} m/s" for speed in ("-1", "+1") for rate in ("-0.05", "+0.05")]
    vehicles = ("nominal", "light", "heavy", "soft", "stiff")
    expected = [f"{one} vehicle, {corner}" for one in vehicles for _ in range(3) for corner in corners]
    assert sorted(assessment.variants[1:]) == sorted(expected)
    seeds = assessment.values[[i for i, one in enumerate(assessment.variants) if one == assessment.variants[1]], 0, 0]
    assert np.unique(seeds).size == 3
    value, which = assessment.worst(0)
    np.testing.assert_array_equal(value, assessment.values[:, 0].min(axis=0))
    np.testing.assert_array_equal(assessment.values[which, 0, np.arange(36)], value)
    assert_same_bits(assess(LQR(), ROAD_EDGE, built, y_s=-0.4), assessment)


def test_without_noise_seeds_are_no_variants() -> None:
    assert len(assess(LQR(), ROAD_EDGE, y_s=-0.4).variants) == 21
    names = tuple(f"{one} vehicle" for one in ("nominal", "light", "heavy", "soft", "stiff"))
    assert assess(LQR(), "un-r79-b1", y_s=-0.4).variants[1:] == names


def test_a_cell_that_fails_at_a_corner_is_amber(built: Setup) -> None:
    assessment = assess(LQR(r_delta=2000.0), ROAD_EDGE, built, y_s=0.05, seeds=1)
    assert [assessment.lights.count(light) for light in ("green", "amber", "red")] == [5, 4, 27]
    amber = assessment.lights.index("amber")
    assert assessment.reason(amber).startswith("DTLE \u22120.1")
    assert assessment.reason(amber).endswith(", limit \u22120.10 m (heavy vehicle, \u22121 km/h, +0.05 m/s)")
    assert assessment.robust_score < assessment.score


@pytest.mark.parametrize(
    ("standard", "extended", "points"),
    [(30, 2, 0.0), (30, 3, 0.5), (30, 4, 0.5), (30, 5, 0.75), (30, 6, 1.0), (8, 6, 1.0), (7, 6, 0.0), (8, 0, 0.0)],
)
def test_the_points_of_the_extended_range(standard: int, extended: int, points: float) -> None:
    """Half of them from half of its cells on, three quarters from three quarters, all of all; from 25 % on."""
    assessment = stated(LQR(), ROAD_EDGE, y_s=-0.4)
    met = np.zeros_like(assessment.met)
    met[0, 0, np.flatnonzero(~CELLS.extended)[:standard]] = True
    met[0, 0, np.flatnonzero(CELLS.extended)[:extended]] = True
    changed = dataclasses.replace(assessment, met=met)
    assert (changed.score, changed.extended_score) == (standard / 30, points)
    assert np.isnan(stated(LQR(), "euroncap-2025-elk", y_s=-0.4).extended_score)
    # from exactly so many on
    at = dataclasses.replace(changed, standard=assessment.standard.model_copy(update={"extended_from": standard / 30}))
    assert at.extended_score == {0: 0.0, 2: 0.0, 3: 0.5, 4: 0.5, 5: 0.75, 6: 1.0}[extended]


def test_a_vehicle_that_leaves_the_road_meets_nothing() -> None:
    assessment = stated(Constant(F=(0.5, 0.0, 0.0, 0.0)), ROAD_EDGE, y_s=-0.4)
    assert assessment.diverged.any()
    i = int(np.argmax(assessment.diverged[0]))
    assert (assessment.lights[i], assessment.reason(i)) == ("red", "diverged, limit \u22120.10 m")
    calm = stated(Constant(F=(0.5, 0.0, 0.0, 0.0)), DRIVEABILITY, y_s=-0.4)  # at 50 km/h the wheel is not assessed
    assert not calm.met[0, 0, calm.diverged[0]].any()


# ------------------------------------------------------------------------------------------------ a driver
HANDS = Driver(straight=0.75, against=0.25, override_torque=2.0)


def held(setup: Setup, driver: Driver) -> Setup:
    return setup.on(dataclasses.replace(setup.options, driver=driver))


def metric_of(name: str, standard: str, setup: Setup, driver: Driver, y_s: float) -> np.ndarray:
    """A metric of the cells as stated, by the simulation."""
    test = load_standard(standard)
    scenarios = test.scenarios(test.every_cell, HALF)
    return np.asarray(getattr(simulate(LQR(), scenarios, y_s=y_s, setup=held(quiet(setup), driver)).metrics, name))


@pytest.mark.parametrize("name", ["ideal", "built"])
def test_a_driver_counts_only_where_a_torque_is_asked_for(name: str, built: Setup) -> None:
    """Passive hands else. The torque is that of one who means to leave the lane, the time the longest of all."""
    setup = Setup() if name == "ideal" else built
    alone = stated(LQR(), DRIVEABILITY, setup, y_s=-0.4)
    both = stated(LQR(), DRIVEABILITY, held(setup, HANDS), y_s=-0.4)
    assert (alone.values.shape[1], both.values.shape[1], both.driver) == (2, 4, HANDS)
    np.testing.assert_array_equal(both.values[:, :2], alone.values)
    against, straight = Driver(against=1.0, override_torque=2.0), Driver(straight=1.0, override_torque=2.0)
    torque = metric_of("driver_torque_peak", DRIVEABILITY, setup, against, -0.4)
    times = [metric_of("against_parallel", DRIVEABILITY, setup, one, -0.4) for one in (against, straight)]
    np.testing.assert_array_equal(both.values[0, 2], torque)
    np.testing.assert_array_equal(both.values[0, 3], np.maximum(*times))
    assert ((times[0] > times[1]).any(), (times[0] < times[1]).any()) == (True, True)
    assert torque.min() > 0.0


def test_the_torque_is_measured_whether_or_not_the_study_has_that_intent() -> None:
    """In bends too: UN R79 limits the force at the rim."""
    only = stated(LQR(), "un-r79-b1", held(Setup(), Driver(follows=1.0)), y_s=-0.4)
    np.testing.assert_array_equal(
        only.values[0, 3], metric_of("driver_torque_peak", "un-r79-b1", Setup(), Driver(against=1.0), -0.4)
    )
    assert only.limits[0, 3].tolist() == [9.5] * 14
    for name in (ROAD_EDGE, "iso-11270"):
        given, plain = (stated(LQR(), name, setup, y_s=-0.4) for setup in (held(Setup(), HANDS), Setup()))
        assert_same_bits(given.values, plain.values)


def test_every_corner_is_driven_with_the_driver(built: Setup) -> None:
    assessment = assess(LQR(), DRIVEABILITY, held(built, HANDS), y_s=-0.4, seeds=1)
    assert assessment.values.shape == (21, 4, 30)
    assert np.unique(assessment.values[:, 2, 7]).size > 10


@pytest.mark.parametrize(
    ("missed", "passes"), [((), True), ((0,), True), ((2,), True), ((3,), True), ((1, 3), False), ((0, 2, 3), False)]
)
def test_three_of_four_conditions_are_enough(missed: tuple[int, ...], passes: bool) -> None:
    assessment = stated(LQR(), DRIVEABILITY, held(Setup(), HANDS), y_s=-0.4)
    met = np.ones_like(assessment.met)
    met[0, missed, 4] = False
    changed = dataclasses.replace(assessment, met=met, diverged=np.zeros_like(assessment.diverged))
    assert bool(changed.passed[4]) == bool(changed.robust[4]) == passes
    assert (changed.score, changed.held) == (1.0 if passes else 29 / 30, 4 - len(missed))
    # without a driver both that are left
    alone = stated(LQR(), DRIVEABILITY, y_s=-0.4)
    met = np.ones_like(alone.met)
    met[0, 1, 4] = False
    assert not dataclasses.replace(alone, met=met).passed[4]


@dataclasses.dataclass(frozen=True)
class Boom(Controller):
    name = "boom"
    title = "Boom"

    def prepare(self, plant: Plant) -> Any:
        raise ZeroDivisionError("no speed")


def test_a_law_that_raises_is_named() -> None:
    with pytest.raises(LdcError) as caught:
        assess(Boom(), ROAD_EDGE, y_s=-0.4)
    message = rf"law 'boom' in {ROAD_EDGE}: ZeroDivisionError: no speed (test_assessment.py, line "
    assert str(caught.value).startswith(message)


@pytest.mark.parametrize(
    ("standard", "given", "path", "value"),
    [
        (ROAD_EDGE, {"setup": 3}, "setup", NOT_GIVEN),
        (ROAD_EDGE, {"seeds": 0}, "seeds", 0),
        (ROAD_EDGE, {"y_s": -11.0}, "y_s", -11.0),
        ("iso-11271", {}, "standard", "iso-11271"),
    ],
)
def test_bad_arguments_end_in_one_message(standard: str, given: dict[str, Any], path: str, value: object) -> None:
    with pytest.raises(LdcError) as caught:
        assess(LQR(), standard, **given)
    assert (caught.value.path, caught.value.value) == (path, value)
