"""Scenarios that cannot be driven, and the log of solvers."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.bits import assert_same_bits
from helpers.closed_loop import (
    EVERY_OPTION,
    METRICS,
    Constant,
    Prepared,
    Stepped,
    Unsighted,
    assert_same_rows,
    grid,
    make_scenarios,
    takeover,
    with_residuals,
)
from helpers.errors import refused
from ldctoolkit import Outcome, Plant, Scenarios, simulate
from ldctoolkit.control import Controller, EventStatus, LinearLaw, Preview, SolverCalls, SteeringLaw
from ldctoolkit.controllers import LQR, BarrierFilter, LinearMPC, NoControl, PreviewProportional
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import KalmanFilter, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import BOUND, drive_many

N = 40
OPTIONS = {
    "ideal": PlantOptions(),
    "profile": PlantOptions(speed="profile"),
    "magic formula": PlantOptions(tyres=Tyres(model="magic_formula")),
    "filter": PlantOptions(sensors=Sensors(e_y_noise=0.02, delay=0.1, period=0.1, kalman=KalmanFilter())),
    "residuals": PlantOptions(residuals=Residuals(y=True, v=True), speed="profile"),
    "all": EVERY_OPTION,
}
SOUND = with_residuals(make_scenarios(N, seed=31))
DESIGNS: dict[str, Controller] = {
    "linear": PreviewProportional(), "general": Stepped(PreviewProportional(), drops=True),
    "solver": LinearMPC(horizon=4, r_delta=100.0), "none": NoControl(),
}  # fmt: skip
BAD_VALUES = [
    {"T": 0.0}, {"T": -1.0}, {"T": np.nan}, {"T": np.inf}, {"T": -np.inf}, {"v_mean": -20.0}, {"v_mean": 0.0},
    {"v_mean": 0.99}, {"v_mean": np.nan}, {"v_mean": np.inf}, {"v_mean": 5.0, "a_mean": 4.0, "T": 2.01},
    {"a_mean": np.nan}, {"a_mean": -np.inf}, {"d_y": np.nan}, {"d_y": np.inf}, {"c_0": np.nan}, {"c_0": -np.inf},
    {"dc": np.nan}, {"sigma_y": np.nan}, {"sigma_v": np.inf},
    dict.fromkeys(("T", "d_y", "v_mean", "a_mean", "c_0", "dc", "sigma_y", "sigma_v"), np.nan),
]  # fmt: skip


def spoiled(scenarios: Scenarios, rows: dict[int, dict[str, float]]) -> Scenarios:
    """Past the checks of `Scenarios.from_arrays`, as a damaged file or someone's own generator would."""
    columns = {name: array.copy() for name, array in vars(scenarios).items() if array is not None}
    for row, changes in rows.items():
        for name, value in changes.items():
            columns[name][row] = value
    return dataclasses.replace(scenarios, **columns)


def run(design: Controller, scenarios: Scenarios, options: PlantOptions, **more: Any) -> Outcome:
    given = {"y_s": 0.1, "seed": 3, "settle": 0.3} | more
    return simulate(design, scenarios, options=options, **given)


def assert_counted(out: Outcome, invalid: np.ndarray) -> None:
    """Every row has one status; the rows `invalid` are so, without a number, and no mean hides them."""
    assert sum(out.count(status) for status in EventStatus) == out.status.size
    np.testing.assert_array_equal(out.status == EventStatus.INVALID, invalid)
    np.testing.assert_array_equal(np.isnan(out.S), invalid)
    np.testing.assert_array_equal(np.isnan(out.S_uncorrected), invalid)
    assert not out.triggered[invalid].any()
    assert (out.failed_solves[invalid] == 0).all()
    assert np.isposinf(out.t_s[invalid]).all()
    for name in METRICS:
        np.testing.assert_array_equal(np.isnan(getattr(out.metrics, name)), invalid, err_msg=name)


FEW = (("ideal", "linear"), ("ideal", "none"), ("ideal", "solver"), ("filter", "general"), ("all", "linear"))


@pytest.mark.parametrize(("options", "design"), grid(OPTIONS, DESIGNS, *FEW))
def test_what_cannot_be_driven_is_counted_and_disturbs_no_other(options: str, design: str) -> None:
    places = np.random.default_rng(0).choice(N, len(BAD_VALUES), replace=False)
    bad = np.isin(np.arange(N), places)
    scenarios = spoiled(SOUND, {int(row): changes for row, changes in zip(places, BAD_VALUES, strict=True)})
    for window in ("departure", "control"):
        sound = run(DESIGNS[design], SOUND, OPTIONS[options], window=window)
        out = run(DESIGNS[design], scenarios, OPTIONS[options], window=window)
        assert sound.count(EventStatus.INVALID) == 0
        assert_counted(out, bad)
        assert np.isnan(out.mean_reduction)
        np.testing.assert_array_equal(np.isnan(out.reduction), bad)
        assert_same_rows(out, sound, ~bad, of=~bad)


@pytest.mark.parametrize("changes", BAD_VALUES, ids=lambda changes: ",".join(f"{k}={v}" for k, v in changes.items()))
def test_a_scenario_that_cannot_be_driven_alone(changes: dict[str, float]) -> None:
    scenarios = spoiled(SOUND.take([0]), {0: changes})
    for options in ("ideal", "all"):
        for design in DESIGNS.values():
            out = run(design, scenarios, OPTIONS[options], trajectories=True)
            assert_counted(out, np.ones(1, dtype=bool))
            assert np.isnan(out.mean_reduction)
            if out.trajectories is not None:
                assert np.isnan(out.trajectories.x).all()


def test_a_speed_residual_that_makes_it_too_slow() -> None:
    """The fitted line stays above 1 m/s; the line with its residual does not."""
    options = PlantOptions(speed="profile", residuals=Residuals(v=True))
    scenarios = Scenarios.from_arrays(T=3.0, d_y=0.3, v_mean=np.full(30, 2.0), sigma_v=0.6)
    out = run(PreviewProportional(), scenarios, options)
    invalid = out.status == EventStatus.INVALID
    assert 0 < invalid.sum() < 30
    assert_counted(out, invalid)
    assert run(PreviewProportional(), scenarios, PlantOptions()).count(EventStatus.INVALID) == 0


def test_a_speed_without_a_gain_is_invalid_for_every_law() -> None:
    """Some laws could drive it, but all of them are compared on the same scenarios; a wrong sign is invalid too."""
    sound = Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=[20.0, 20.0, 85.0])
    fast = dataclasses.replace(sound, v_mean=np.array([20.0, 95.0, 85.0]), a_mean=np.array([0.0, 0.0, 6.0]))
    wrong = dataclasses.replace(fast, v_mean=np.full(3, 20.0), a_mean=np.zeros(3), d_y=np.array([0.3, -0.3, 0.3]))
    wrong = dataclasses.replace(wrong, sigma_y=np.array([0.0, 0.0, -0.1]))
    for law in (LQR(r_delta=100.0), PreviewProportional()):
        for scenarios in (fast, wrong):
            assert_counted(run(law, scenarios, PlantOptions()), np.array([False, True, True]))


def test_a_step_longer_than_the_departure() -> None:
    scenarios = make_scenarios(30, seed=2)
    for options in OPTIONS.values():
        if options.sensors.kalman is not None:
            continue  # no gain for samples as long as this
        for name in ("linear", "general", "none"):
            for settle in (0.0, 3.0):
                out = run(DESIGNS[name], scenarios, options, dt=10.0, settle=settle)
                assert_counted(out, np.zeros(30, dtype=bool))
                assert np.isfinite(out.mean_reduction)


# laws that fail
def with_gain(value: float, field: str) -> Controller:
    """A linear law with this value in a field at speeds above 20 m/s."""

    def prepare(plant: Plant) -> LinearLaw:
        law = PreviewProportional().prepare(plant)
        array = getattr(law, field).copy()
        array[plant.v > 20.0] = value
        return dataclasses.replace(law, **{field: array})

    return Prepared(prepare)


BROKEN = pytest.mark.parametrize(
    ("value", "options"),
    grid([np.nan, np.inf, -np.inf], OPTIONS, (np.nan, "ideal"), (np.inf, "all"), (-np.inf, "filter")),
)


@BROKEN
def test_a_linear_law_with_gains_that_are_not_finite(value: float, options: str) -> None:
    usual = run(PreviewProportional(), SOUND, OPTIONS[options])
    for field in ("F", "f_u", "G_heading", "G_yaw_rate"):
        out = run(with_gain(value, field), SOUND, OPTIONS[options])
        assert_counted(out, np.zeros(N, dtype=bool))
        assert np.isfinite(out.mean_reduction)
        failed, left = out.status == EventStatus.SOLVER_FAILED, out.status == EventStatus.DIVERGED
        assert failed.sum() > 5
        np.testing.assert_array_equal(failed, (out.failed_solves > 0) & ~left)
        sound = (out.failed_solves == 0) & ~left
        assert sound.sum() > 5
        assert_same_rows(out, usual, sound, of=sound)


@BROKEN
def test_a_law_that_never_gives_a_number_holds_the_first_angle(value: float, options: str) -> None:
    """Linear and general alike: the wheel stays where the recorded path had it, and every command is counted."""
    never = Stepped(PreviewProportional(), lambda delta, k: np.full_like(delta, value))
    last = Constant(f_u=1.0)
    for design, same in ((never, Stepped(last)), (Constant((value,) * 4, value), last)):
        out, hold = run(design, SOUND, OPTIONS[options]), run(same, SOUND, OPTIONS[options])
        assert_counted(out, np.zeros(N, dtype=bool))
        np.testing.assert_allclose(out.S, hold.S, rtol=1e-12)
        for name in METRICS:
            ours, theirs = getattr(out.metrics, name), getattr(hold.metrics, name)
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12, err_msg=name)
        driven = out.triggered & (hold.status != EventStatus.DIVERGED)
        assert (out.status[driven] == EventStatus.SOLVER_FAILED).all()
        steps = np.ceil((SOUND.T[driven] - out.t_s[driven]) / 0.05 - 1e-9) + 6
        np.testing.assert_array_equal(out.failed_solves[driven], steps)


def test_a_law_that_fails_now_and_then_holds_its_last_command() -> None:
    """Row 0 at sample 2: against the same law made to repeat its command there."""
    scenarios = make_scenarios(30, seed=8)

    def law(value: float) -> Stepped:
        row_0 = np.arange(30) == 0
        return Stepped(LQR(r_delta=100.0), lambda u, k: np.where(row_0[: u.size] & (k == 2), value, u))

    usual = run(Stepped(LQR(r_delta=100.0)), scenarios, PlantOptions(), y_s=0.05)
    for value in (np.nan, np.inf, -np.inf):
        out = run(law(value), scenarios, PlantOptions(), y_s=0.05)
        assert_counted(out, np.zeros(30, dtype=bool))
        assert (out.failed_solves.sum(), out.count(EventStatus.SOLVER_FAILED)) == (1, 1)
        others = out.failed_solves == 0
        assert_same_rows(out, usual, others, of=others)
        (row,) = np.flatnonzero(~others)
        delta = run(law(value), scenarios, PlantOptions(), y_s=0.05, trajectories=[row]).trajectories.delta[0]
        assert delta[2] == delta[1] != delta[3]


def test_the_last_command_of_all_counts_too() -> None:
    """And none is asked for where T, or the end of the settling horizon, is a whole number of samples."""
    for T, settle, last in ((1.03, 0.0, 20), (1.03, 0.3, 26), (1.0, 0.0, 19), (1.0, 0.1, 21), (1.0, 0.12, 22)):
        scenarios = Scenarios.from_arrays(T=T, d_y=0.3, v_mean=20.0)
        usual = run(Stepped(LQR(r_delta=100.0)), scenarios, PlantOptions(), y_s=0.0, settle=settle)
        for sample, failures in ((last, 1), (last + 1, 0)):
            law = Stepped(LQR(r_delta=100.0), lambda delta, k, sample=sample: np.where(k == sample, np.nan, delta))
            out = run(law, scenarios, PlantOptions(), y_s=0.0, settle=settle)
            assert out.failed_solves[0] == failures
            assert out.status[0] == (EventStatus.SOLVER_FAILED if failures else EventStatus.OK)
            assert out.S[0] == pytest.approx(usual.S[0], rel=1e-3)
        assert usual.count(EventStatus.OK) == 1


def test_a_scenario_that_failed_and_left_counts_as_left() -> None:
    law = Stepped(Constant((0.5, 0.0, 2.0, 0.0)), lambda delta, k: np.where(k == 1, np.nan, delta))
    out = run(law, Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=20.0), PlantOptions())
    assert (out.failed_solves[0], out.status[0]) == (1, EventStatus.DIVERGED)


def test_what_a_law_raises_arrives_unchanged_and_harms_no_later_run() -> None:
    class OwnError(Exception):
        pass

    def fault(delta: np.ndarray, k: int) -> np.ndarray:
        if k == 3:
            raise OwnError("the law's own words")
        return delta

    over = takeover(SOUND)
    before = list(drive_many([LQR(r_delta=100.0), Stepped(LQR(r_delta=100.0))], over))
    runs = drive_many([LQR(r_delta=100.0), Stepped(LQR(r_delta=100.0), fault), LQR(r_delta=100.0)], over)
    assert_same_rows(next(runs), before[0])
    with pytest.raises(OwnError, match="the law's own words"):
        next(runs)
    for ours, theirs in zip(drive_many([LQR(r_delta=100.0), Stepped(LQR(r_delta=100.0))], over), before, strict=True):
        assert_same_rows(ours, theirs)
    assert not issubclass(OwnError, LdcError)


# paths that leave
@pytest.mark.parametrize(
    ("options", "design"),
    grid(
        ["ideal", "profile", "magic formula", "filter", "all"], ["linear", "general"], ("ideal", "linear"),
        ("ideal", "general"), ("all", "linear"),
    ),
)  # fmt: skip
def test_leaving_before_the_end_is_scored_and_after_it_is_not(options: str, design: str) -> None:
    unstable: Controller = Constant((0.03, 0.0, 0.2, 0.0))
    law = unstable if design == "linear" else Stepped(unstable, drops=True)
    scenarios = make_scenarios(60, seed=9)
    short, long = (run(law, scenarios, OPTIONS[options], y_s=0.05, settle=settle) for settle in (0.0, 3.0))
    for out in (short, long):
        assert_counted(out, np.zeros(60, dtype=bool))
        assert np.isfinite(out.mean_reduction)
        for name in set(METRICS) - {"t_back"}:
            assert np.isfinite(getattr(out.metrics, name)).all(), name
    before, at_last = short.status == EventStatus.DIVERGED, long.status == EventStatus.DIVERGED
    after = at_last & ~before
    assert before.sum() > 5
    assert after.sum() > 5
    assert (at_last | ~before).all()
    np.testing.assert_array_equal(long.S, short.S)
    np.testing.assert_array_equal(long.deepest, short.deepest)
    out_there = np.maximum(long.deepest, long.metrics.opposite_crossing + 0.0)
    assert (out_there[before] == BOUND - 0.85).all()
    # it left inwards after T, or stayed as deep as it was at T
    assert (long.deepest[after] < BOUND - 0.85).all()


SCENARIOS = Scenarios.from_arrays(
    T=[2.0, 4.0, 0.6, 3.0, 1.0], d_y=[0.3, 0.05, 0.5, 0.2, 0.6], v_mean=[30.0, 25.0, 20.0, 15.0, 35.0], c_0=0.0
)


def counting(wrong: Any = None) -> Controller:
    return Prepared(lambda plant: CountingLaw(np.arange(plant.n), wrong))


@dataclasses.dataclass(frozen=True)
class CountingLaw(Unsighted):
    """Steers a little; says that it solved for every second scenario of its batch."""

    number: np.ndarray
    wrong: Any

    def init(self, n: int) -> int:
        return 0

    def step(self, t: np.ndarray, x: np.ndarray, preview: Preview, delta_prev: np.ndarray, state: int) -> Any:
        return -0.02 * x[:, 0] - 0.05 * x[:, 1], state + 1, np.full(t.size, EventStatus.OK, dtype=np.int8)

    def take(self, rows: np.ndarray, state: int) -> tuple[SteeringLaw, int]:
        return CountingLaw(self.number[rows], self.wrong), state

    def solver_calls(self, state: int) -> Any:
        if self.wrong is not None:
            return self.wrong
        place = np.flatnonzero(self.number % 2 == 0)
        samples = np.full(place.size, state - 1)
        return SolverCalls(
            place, samples % 3, 10 * self.number[place] + samples, 0.5 * samples, np.full(place.size, 0.1)
        )


def test_calls_come_by_scenario_and_sample() -> None:
    """Scenarios that end early are dropped from the batch; the record keeps their own numbers."""
    out = simulate(counting(), SCENARIOS, y_s=0.1, dt=0.1, settle=0.5)
    log, triggered = out.solver_log, np.flatnonzero(out.triggered)
    assert triggered.tolist() == [0, 2, 3, 4]
    # places follow the length of what is left, longest first: the law numbered them so
    steps = {i: int(np.sum(log.row == i)) for i in set(log.row.tolist())}
    assert len(steps) == 2
    assert np.array_equal(np.lexsort((log.sample, log.row)), np.arange(log.row.size))
    for i, count in steps.items():
        mine = log.row == i
        assert log.sample[mine].tolist() == list(range(count))
        assert log.status[mine].tolist() == [sample % 3 for sample in range(count)]
        assert np.unique(log.iterations[mine] - log.sample[mine]).size == 1
        np.testing.assert_array_equal(log.primal_residual[mine], 0.5 * np.arange(count))
        left = SCENARIOS.T[i] - out.t_s[i] + 0.5
        assert count == pytest.approx(left / 0.1, abs=2)


def test_a_solver_that_is_always_called_is_in_the_log_at_every_sample() -> None:
    always = simulate(
        LinearMPC(horizon=5, always_solve=True, solver="daqp", r_delta=100.0), SCENARIOS, y_s=0.1, settle=0.2
    )
    log = always.solver_log
    assert set(log.row.tolist()) == set(np.flatnonzero(always.triggered).tolist())
    assert (log.status == 1).all()
    assert (log.primal_residual <= 1e-9).all()
    assert (log.dual_residual <= 1e-9).all()
    wrapped = BarrierFilter(
        inner="linear_mpc", inner_gains="horizon=5, always_solve=true, solver=daqp", e_y_max=9.0, delta_max=1.0
    )
    inside = simulate(wrapped, SCENARIOS, y_s=0.1, settle=0.2).solver_log
    assert (inside.row.tolist(), inside.sample.tolist()) == (log.row.tolist(), log.sample.tolist())


def test_the_log_does_not_depend_on_the_order_of_scenarios() -> None:
    order = np.array([3, 0, 4, 2, 1])
    law = LinearMPC(horizon=5, always_solve=True, rate_max=0.05, r_delta=100.0)
    logs = [simulate(law, SCENARIOS.take(rows), y_s=0.1).solver_log.renamed(rows) for rows in (np.arange(5), order)]
    assert_same_bits(*logs)
    without = simulate(LQR(r_delta=100.0), SCENARIOS).solver_log
    assert all(getattr(without, field.name).size == 0 for field in dataclasses.fields(without))


@pytest.mark.parametrize(
    ("wrong", "field", "problem", "value", "allowed"),
    [
        ([1, 2], "", "returned an object of type list", ..., "SolverCalls or None"),
        (SolverCalls(np.array([0]), *(np.zeros(2),) * 4), ": status", "shape (2,)", ..., "an array of shape (1,)"),
        (SolverCalls(np.array([99]), *(np.zeros(1),) * 4), ": position", "", np.int64(99), "whole numbers 0 to 3"),
        (SolverCalls(*(np.zeros(0),) * 5), ": position", "an array of shape (0,) and dtype float64", ...,
         "whole numbers 0 to 3"),
    ],
)  # fmt: skip
def test_what_is_no_record_is_named(wrong: Any, field: str, problem: str, value: Any, allowed: str) -> None:
    with refused(f"controller 'prepared': solver_calls{field}", problem=problem, value=value, allowed=allowed):
        simulate(counting(wrong), SCENARIOS, y_s=0.1)
