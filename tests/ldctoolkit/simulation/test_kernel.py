"""The compiled loops against each other and against the plain reference; the same bits however the work is cut up."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers import closed_loop
from helpers.closed_loop import (
    EVERY_OPTION,
    METRICS,
    Constant,
    Stepped,
    assert_same_rows,
    assert_within_the_bound,
    grid,
    make_scenarios,
    with_residuals,
)
from helpers.errors import refused
from ldctoolkit import Controller, EventStatus, Scenarios, simulate
from ldctoolkit.controllers import LQR, LinearMPC, NoControl, PreviewProportional
from ldctoolkit.errors import NOT_GIVEN
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover, drive, drive_many
from ldctoolkit.vehicle import Convention

ONE_BY_ONE = PlantOptions(actuator=Actuator(delta_max=1e9))  # the ideal plant in effect, driven by the Runge-Kutta loop

CLOSED = {
    "preview": PreviewProportional(), "LQR": LQR(r_delta=100.0),
    "swings": PreviewProportional(K_y=-0.06, K_psi=-0.1, T_lp=0.0),
    "swings far": PreviewProportional(K_y=-0.12, K_psi=-0.02, T_lp=0.3),
    "late": PreviewProportional(K_y=-0.002, K_psi=-0.02), "memory": Constant((-0.02, -0.01, -0.3, 0.0), 0.4),
    "integral": Constant((-0.02, -0.03, -0.4, 0.0), 0.2, -0.01), "unstable": Constant((0.5, 0.0, 2.0, 0.0)),
    "spins": Constant((0.0, 0.0, 3.0, 0.5)),
}  # fmt: skip
SLOW = Scenarios.from_arrays(T=[3.0, 6.0, 9.0, 1.3], d_y=[0.3, 0.5, 0.9, 0.6], v_mean=[1.0, 1.5, 3.0, 4.0], c_0=1e-3)


def close(out: Any, expected: Any, between: float = 5e-4) -> None:
    """Two routes to the same numbers, within the bound of the Runge-Kutta loop."""
    np.testing.assert_array_equal(out.status, expected.status)
    # of scenarios that diverge, rounding has grown by twenty metres over a micrometre
    fine = out.status != EventStatus.DIVERGED
    assert_within_the_bound(out, expected, fine, between)
    np.testing.assert_allclose(out.S, expected.S, rtol=1e-3)


STEPS = ((0.05, 3.0), (0.05, 0.0), (0.01, 0.01), (0.3, 1.0), (0.5, 0.7))


@pytest.mark.parametrize(
    ("law", "step"), grid(CLOSED, STEPS, *((law, STEPS[0]) for law in CLOSED), *(("swings", step) for step in STEPS))
)
def test_exact_steps_equal_runge_kutta(law: str, step: tuple[float, float]) -> None:
    """Whole steps of the discretised plant, and substeps of the method of Runge and Kutta."""
    dt, settle = step
    for scenarios, y_s in ((make_scenarios(150, seed=2), 0.05), (SLOW, 0.0)):
        given = {"y_s": y_s, "dt": dt, "settle": settle}
        side_by_side = simulate(CLOSED[law], scenarios, **given)
        close(simulate(CLOSED[law], scenarios, options=ONE_BY_ONE, **given), side_by_side, between=4.0 * dt**3 + 1e-5)


@pytest.mark.parametrize(
    ("law", "drops"), grid(CLOSED, (False, True), ("LQR", False), ("integral", True), ("unstable", True))
)
def test_exact_steps_equal_the_general_loop(law: str, drops: bool) -> None:
    scenarios = make_scenarios(100, seed=6)
    general = simulate(Stepped(CLOSED[law], drops=drops), scenarios, y_s=0.05)
    close(general, simulate(CLOSED[law], scenarios, y_s=0.05))


def test_dropping_ended_scenarios_changes_no_bit() -> None:
    scenarios = make_scenarios(100, seed=7)
    camera = PlantOptions(sensors=Sensors(delay=0.1, kalman=KalmanFilter()))
    for options, inner in ((camera, CLOSED["preview"]), (PlantOptions(), CLOSED["unstable"])):
        whole, dropped = (
            simulate(Stepped(inner, drops=drops), scenarios, y_s=0.05, settle=0.4, options=options)
            for drops in (False, True)
        )
        assert_same_rows(dropped, whole)


# the same bits

HELD = Driver(recorded=0.2, straight=0.2, follows=0.2, against=0.2, returns=0.2, return_after=0.2)
OPTIONS = {
    "ideal": PlantOptions(),
    "mismatch": PlantOptions(mismatch=Mismatch(m=(0.8, 1.3), C_af=(0.7, 1.1))),
    "camera": PlantOptions(sensors=Sensors(e_y_noise=0.03, delay=0.1, period=0.1, kalman=KalmanFilter())),
    "all": EVERY_OPTION,
    "held": dataclasses.replace(EVERY_OPTION, driver=HELD),
    "held by arms": PlantOptions(driver=dataclasses.replace(HELD, model="arms")),
}
DESIGNS = {"linear": CLOSED["integral"], "general": Stepped(CLOSED["integral"], drops=True), "none": NoControl()}


def takeover(scenarios: Scenarios, options: PlantOptions, settle: float = 0.5, y_s: float = 0.02) -> Takeover:
    return closed_loop.takeover(scenarios, options, y_s=y_s, seed=5, settle=settle)


TWO_OF_EACH = grid(["ideal", "all"], ["linear", "general"], ("ideal", "linear"), ("all", "general"))


@pytest.mark.parametrize(
    ("options", "design"),
    grid(OPTIONS, ["linear", "general"], ("ideal", "linear"), ("camera", "general"), ("held by arms", "linear")),
)
def test_threads_change_no_bit(options: str, design: str) -> None:
    """More scenarios than a thread takes at a time, and a last stretch that is shorter."""
    over = takeover(with_residuals(make_scenarios(1210, seed=3)), OPTIONS[options], settle=0.1)
    assert over.m > 1100
    single_threaded, *several_threads = (drive(DESIGNS[design], over, threads=threads) for threads in (1, 2, 3))
    for run in several_threads:
        assert_same_rows(run, single_threaded)


@pytest.mark.parametrize(
    ("options", "design"),
    grid(
        OPTIONS,
        DESIGNS,
        ("ideal", "linear"),
        ("camera", "linear"),
        ("all", "linear"),
        ("camera", "general"),
        ("held", "general"),
    ),
)
def test_order_and_company_change_no_bit(options: str, design: str) -> None:
    scenarios = with_residuals(make_scenarios(90, seed=4))
    rng = np.random.default_rng(1)

    def run(rows: np.ndarray) -> Any:
        return drive(DESIGNS[design], takeover(scenarios.take(rows), OPTIONS[options], y_s=0.15)).outcome("departure")

    whole = run(np.arange(90))
    assert 60 < whole.triggered.sum() < 90
    some = rng.choice(90, 31, replace=False)
    for rows in (rng.permutation(90), some, np.arange(89), *np.array_split(np.arange(90), 5), np.array([17])):
        assert_same_rows(run(rows), whole, rows)


@pytest.mark.parametrize(
    ("options", "n"),
    grid(OPTIONS, [0, 1, 7, 8, 9, 16, 17], *(("ideal", n) for n in (0, 1, 9, 17)), ("all", 0), ("all", 9)),
)
def test_few_scenarios(options: str, n: int) -> None:
    """Around the number that goes side by side; with trajectories as without."""
    scenarios = with_residuals(make_scenarios(20, seed=5))
    for design in DESIGNS.values():
        whole = drive(design, takeover(scenarios, OPTIONS[options], y_s=0.0))
        assert whole.takeover.m == 20
        part = takeover(scenarios.take(np.arange(n)), OPTIONS[options], y_s=0.0)
        assert_same_rows(
            drive(design, part).outcome("control"), whole.outcome("control"), np.arange(n)
        )  # y_s = 0: the window starts at 0
        assert_same_rows(drive(design, part, trajectories=True), drive(design, part))


@pytest.mark.parametrize("options", ["ideal", pytest.param("mismatch", marks=pytest.mark.slow), "camera", "all"])
def test_many_designs_have_the_bits_of_each(options: str) -> None:
    designs: list[Controller] = [
        LQR(r_delta=100.0), PreviewProportional(), NoControl(), CLOSED["unstable"], CLOSED["memory"],
        PreviewProportional(K_y=-0.01, T_lp=0.4), DESIGNS["general"], PreviewProportional(K_y=-0.04),
        LinearMPC(horizon=4, r_delta=100.0),
    ]  # fmt: skip
    for y_s in (0.02, 9.0):
        over = takeover(with_residuals(make_scenarios(19, seed=6)), OPTIONS[options], y_s=y_s, settle=0.2)
        runs = list(drive_many(iter(designs), over, threads=2))
        assert len(runs) == len(designs)
        for design, run in zip(designs, runs, strict=True):
            assert_same_rows(run, drive(design, over))
            assert_same_rows(run.outcome("departure"), drive(design, over, threads=1).outcome("departure"))
    assert list(drive_many([], over)) == []


@pytest.mark.slow
def test_more_designs_than_go_through_in_one_call() -> None:
    """Some hundred thousand short drives."""
    n = 21_000
    rng = np.random.default_rng(6)
    over = takeover(Scenarios.from_arrays(T=rng.uniform(0.2, 0.4, n), d_y=0.3, v_mean=25.0), PlantOptions(), settle=0.0)
    designs = [PreviewProportional(K_y=-0.001 * k) for k in range(1, 25)]
    for design, run in zip(designs, drive_many(designs, over), strict=True):
        assert_same_rows(run, drive(design, over))


# edges
@pytest.mark.parametrize("design", DESIGNS)
@pytest.mark.parametrize("options", ["ideal", "all"])
@pytest.mark.parametrize("settle", [0.0, 3.0])
def test_nobody_triggers(options: str, design: str, settle: float) -> None:
    scenarios = with_residuals(make_scenarios(9, seed=7))
    out = drive(DESIGNS[design], takeover(scenarios, OPTIONS[options], y_s=50.0, settle=settle)).outcome("departure")
    assert out.count(EventStatus.NEVER_TRIGGERED) == 9
    assert not out.triggered.any()
    np.testing.assert_array_equal(out.S, out.S_uncorrected)
    np.testing.assert_array_equal(out.metrics.t_back, scenarios.T)
    for name in set(METRICS) - {"deepest", "dtle", "t_back"}:
        np.testing.assert_array_equal(getattr(out.metrics, name), 0.0)
    assert out.mean_reduction == 0.0


@pytest.mark.parametrize(("options", "design"), TWO_OF_EACH)
def test_the_horizon_is_rounded_up_and_leaves_the_score_alone(options: str, design: str) -> None:
    scenarios = with_residuals(make_scenarios(40, seed=11))
    late = CLOSED["late"] if design == "linear" else Stepped(CLOSED["late"])
    none, short, whole_sample, long = (
        simulate(late, scenarios, y_s=0.02, options=OPTIONS[options], seed=5, settle=settle, trajectories=True)
        for settle in (0.0, 0.01, 0.05, 3.0)
    )
    assert (long.status == EventStatus.OK).all()
    assert_same_rows(short, whole_sample)  # one sample either way
    for out, more in ((none, 0.0), (short, 0.05), (long, 3.0)):
        ends = np.nanmax(out.trajectories.t[out.triggered], axis=1)
        np.testing.assert_allclose(ends, scenarios.T[out.triggered] + more, rtol=0, atol=1e-12)
        for name in ("S", "t_s", "status"):
            np.testing.assert_array_equal(getattr(out, name), getattr(none, name))
        for name in ("deepest", "dtle"):  # up to T only
            np.testing.assert_array_equal(getattr(out.metrics, name), getattr(none.metrics, name))
        for name in ("delta_peak", "effort", "travel", "opposite_crossing"):
            assert (getattr(out.metrics, name) >= getattr(none.metrics, name)).all()
    assert np.isinf(none.metrics.t_back).sum() > np.isinf(long.metrics.t_back).sum()


def test_a_horizon_of_whole_samples_does_not_gain_a_sample_by_rounding() -> None:
    """0.14/0.02 is a little more than 7 in floating point."""
    for dt, settle, samples in ((0.02, 0.14, 7), (0.05, 0.6, 12), (0.05, 0.5501, 12), (0.05, 0.0, 0), (0.05, 1e-3, 1)):
        over = closed_loop.takeover(make_scenarios(3), dt=dt, settle=settle)
        assert (over.steps - over.full_steps - (over.rest > 0) == samples).all()


def test_the_trigger_at_the_very_start() -> None:
    """y_s = 0 triggers everybody at t = 0: nothing was scored before."""
    scenarios = make_scenarios(30, seed=9)
    for design in (DESIGNS["linear"], DESIGNS["general"]):
        departure, control = (simulate(design, scenarios, y_s=0.0, window=w) for w in ("departure", "control"))
        assert (departure.t_s == 0.0).all()
        assert_same_rows(departure, control)


# trajectories
@pytest.mark.parametrize(("options", "design"), TWO_OF_EACH)
def test_chosen_trajectories_are_rows_of_all(options: str, design: str) -> None:
    scenarios = with_residuals(make_scenarios(50, seed=10))
    over = takeover(scenarios, OPTIONS[options], y_s=0.2)
    bare = drive(DESIGNS[design], over)
    every = drive(DESIGNS[design], over, trajectories=True)
    assert bare.trajectories is None
    np.testing.assert_array_equal(every.trajectories.rows, np.arange(50))
    never = np.flatnonzero(np.isinf(over.t_s))
    assert never.size > 2
    started = np.flatnonzero(np.isfinite(over.t_s))
    mixed_rows = np.array([started[20], never[1], started[3], started[-1], never[0], started[0]])
    for rows in (mixed_rows, mixed_rows.tolist(), mixed_rows[:1], [], mixed_rows.astype(np.uint8), never):
        run = drive(DESIGNS[design], over, trajectories=rows, threads=2)
        assert_same_rows(run, bare)
        paths = run.trajectories
        np.testing.assert_array_equal(paths.rows, rows)
        length = paths.t.shape[1]
        for name in ("t", "x", "delta", "a_y"):
            ours, theirs = getattr(paths, name), getattr(every.trajectories, name)[paths.rows]
            np.testing.assert_array_equal(ours, theirs[:, :length])
            assert np.isnan(theirs[:, length:]).all()
            assert np.isnan(ours[np.isin(paths.rows, never)]).all()
            # an entry is there in all its columns or in none
            missing = np.isnan(ours) if ours.ndim == 2 else np.isnan(ours).any(axis=2)
            np.testing.assert_array_equal(missing, np.isnan(paths.t))
        first = np.where(np.isin(paths.rows, never), np.nan, over.t_s[paths.rows])
        np.testing.assert_array_equal(paths.t[:, 0], first)
    single = drive(DESIGNS[design], over, trajectories=4).trajectories
    np.testing.assert_array_equal(single.rows, [4])


@pytest.mark.parametrize(
    ("rows", "value"),
    [([1, 20], 20), ([-1], -1), ([3, 4, 3], NOT_GIVEN), ([0.0, 1.0], [0.0, 1.0]), ([[0, 1]], [[0, 1]]),
     ([True, False], [True, False]), ("all", "all")],
)  # fmt: skip
def test_rows_that_cannot_be_chosen_are_named(rows: Any, value: object) -> None:
    for design in DESIGNS.values():
        with refused("trajectories", value=value):
            simulate(design, make_scenarios(20), trajectories=rows)


def test_the_end_of_the_departure_is_an_entry_once() -> None:
    """Whether T is a sample or not; times rise from the trigger to the horizon's end."""
    scenarios = Scenarios.from_arrays(T=[1.0, 1.03, 2.0, 0.02], d_y=[0.4, 0.4, 0.4, 0.001], v_mean=20.0)
    for settle in (0.0, 0.05, 0.3):
        for design in (DESIGNS["linear"], DESIGNS["general"]):
            paths = simulate(design, scenarios, y_s=0.0, settle=settle, trajectories=True).trajectories
            for i, T in enumerate(scenarios.T):
                t = paths.t[i, ~np.isnan(paths.t[i])]
                assert (np.diff(t) > 1e-6).all()
                assert (t == T).sum() == 1
                samples = np.arange(t.size) * 0.05
                expected = np.unique(np.round(np.append(samples[samples < T + settle - 1e-9], [T, T + settle]), 9))
                np.testing.assert_allclose(t, expected, rtol=0, atol=1e-9)


PLANTS = {
    "ideal": PlantOptions(),
    "profile": PlantOptions(speed="profile", residuals=Residuals(y=True, v=True)),
    "lag": PlantOptions(actuator=Actuator(lag=0.1, rate_max=0.5)),
    "whole delay": PlantOptions(actuator=Actuator(delay=0.1)),
    "part of a delay": PlantOptions(actuator=Actuator(delay=0.07)),
    "different vehicles": PlantOptions(mismatch=Mismatch(m=(0.8, 1.3), C_af=(0.7, 1.2))),
    "tyres": PlantOptions(
        tyres=Tyres(model="magic_formula", mu=0.5), speed="profile", mismatch=Mismatch(mu=(0.6, 1.0))
    ),
}


def driven(controller: Controller, options: PlantOptions, convention: Convention = "consistent") -> Any:
    scenarios = with_residuals(make_scenarios(30, seed=12))
    over = Takeover.build(scenarios, Setup(convention=convention, options=options, seed=3), y_s=0.05)
    run = drive(controller, over, trajectories=True)
    paths = run.trajectories
    assert paths is not None
    return over, run, *(values[over.rows] for values in (paths.t, paths.x, paths.delta, paths.a_y))


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("controller", [LQR(r_delta=100.0), LinearMPC(r_delta=100.0)], ids=["linear", "steps"])
def test_the_largest_acceleration_of_a_path_is_the_stored_peak(plant: str, controller: Controller) -> None:
    over, run, t, _, _, a_y = driven(controller, PLANTS[plant])
    assert over.m > 8
    # T between two samples is no sample of the closed loop: its peak leaves it out
    since = (t - t[:, :1]) / over.setup.dt
    last = t == np.nanmax(t, axis=1, keepdims=True)
    sample = (np.abs(since - np.rint(since)) < 1e-7) | last
    peak = np.nanmax(np.where(sample, np.abs(a_y), np.nan), axis=1)
    stored = run.metrics.a_y_peak
    # where the wheel jumps at a sample, the loop sees both sides
    assert (peak <= stored).all()
    if plant in ("lag", "part of a delay"):
        assert peak == pytest.approx(stored, rel=1e-9, abs=1e-9)
    assert np.array_equal(np.isnan(a_y), np.isnan(t))


@pytest.mark.parametrize("options", [PlantOptions(), ONE_BY_ONE], ids=["exact", "Runge-Kutta"])
@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_acceleration_of_a_path_is_that_of_the_linear_model(options: PlantOptions, convention: Convention) -> None:
    over, _, t, x, delta, a_y = driven(PreviewProportional(), options, convention)
    v = over.plant.v
    lane = v[:, None] * over.driven.curvature(np.where(np.isnan(t), 0.0, t))
    A, B, E = over.setup.model.matrices(v)
    # Rajamani, eq. 2.45, the row of d2e_y/dt2; a_y = d2e_y/dt2 + v dpsi_l/dt
    free = np.sum(A[:, None, 1] * np.nan_to_num(x), axis=-1) + (E[:, 1] + v)[:, None] * lane
    wheel = np.column_stack([delta[:, 0], delta])
    held = np.where(np.isnan(delta), wheel[:, :-1], delta)
    finite = np.isfinite(t)
    assert a_y[finite] == pytest.approx((free + B[:, 1:2] * held)[finite], abs=1e-9)


@pytest.mark.parametrize("threads", [0, 2.5, "2", True])
def test_threads_must_be_a_number_of_threads(threads: Any) -> None:
    with refused("threads", value=threads, allowed="a whole number >= 1"):
        drive(LQR(r_delta=100.0), takeover(make_scenarios(20), PlantOptions()), threads=threads)
