"""Exported C code steers in the toolkit's closed loop: the same commands, scores and phases."""

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Constant, Table, make_scenarios, takeover
from helpers.errors import assert_fields
from helpers.predictive import Bent, Corridor, Fading, Held, Narrow, Quadratic, Rooted, Slow, Three
from ldctoolkit import Controller, EventStatus, Preview, Setup, VehicleParameters, simulate
from ldctoolkit.controllers import (
    LQI,
    LQR,
    PID,
    BarrierFilter,
    LinearMPC,
    NoControl,
    NonlinearMPC,
    PreviewLQR,
    PreviewProportional,
    PurePursuit,
    SlidingMode,
    Stanley,
)  # fmt: skip
from ldctoolkit.errors import LdcError
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, PlantOptions, Sensors
from ldctoolkit.studies.export import Origin, export_c, parameters
from ldctoolkit.studies.export.c_code import Code
from ldctoolkit.studies.export.law_tables import Schedule
from ldctoolkit.studies.export.loop_check import Check, Compiled, check, record, struct
from ldctoolkit.studies.study_file import load_study

REALISTIC = load_study("trigger-and-gains").setup()
LAWS: dict[str, Controller] = {
    "preview_proportional": PreviewProportional(), "lqr": LQR(), "lqi": LQI(), "preview_lqr": PreviewLQR(),
    "pid": PID(), "stanley": Stanley(k_d_steer=0.2), "pure_pursuit": PurePursuit(), "sliding_mode": SlidingMode(),
    "barrier": BarrierFilter(), "barrier around lqr": BarrierFilter(inner="lqi", e_y_max=1.0),
    "mpc": LinearMPC(), "mpc, one move": LinearMPC(horizon=1), "mpc, blocks": LinearMPC(horizon=30, blocks=8),
    "mpc, soft": LinearMPC(horizon=12, a_y_max=2.0, jerk_max=3.0, e_y_max=1.2), "table": Table(),
    "constant": Constant(F=(-0.01, -0.01, -0.3, -0.05), f_u=0.2, f_i=-0.001),
}  # fmt: skip


WITH_CODE = "a law that prepares a LinearLaw, pid, stanley, pure_pursuit, sliding_mode, barrier_filter, an MPC"


def compared(controller: Controller, setup: Setup, y_s: float = 0.1, n: int = 120, seed: int = 5) -> Check:
    result = check(record(Code.of(controller, setup, y_s), make_scenarios(n, seed)), ["cc"])
    double, single = (1e-7, 1e-3) if controller.name == "linear_mpc" else (1e-9, 1e-5)
    assert result.bounds == (double, single)
    assert result.steps > 20 * (result.departures - result.diverged) > 0
    assert max(result.delta, result.S) <= double
    assert result.phases == 0
    assert result.float_delta <= single
    assert result.float_S <= 1e-3
    assert result.passed
    return result


QUICK = ("lqi", "pid", "barrier around lqr", "table")  # in the shorter tier


@pytest.mark.parametrize("name", [*QUICK, *(pytest.param(x, marks=pytest.mark.slow) for x in LAWS if x not in QUICK)])
def test_every_law_on_the_realistic_plant(name: str) -> None:
    result = compared(LAWS[name], REALISTIC)
    assert (result.iterations > 0) == name.startswith("mpc")
    assert result.size > result.stack > 0
    if name == "table":  # gains with kinks are exported as they are
        assert result.delta < 1e-11


def random_design(controller: Controller, rng: np.random.Generator) -> Controller:
    """Gains within a factor of two of the given ones, whole numbers within a fifth."""
    changed = {}
    for gain in controller.gains():
        value = getattr(controller, gain.name)
        if isinstance(value, float) and value:
            changed[gain.name] = float(np.clip(value * math.exp(rng.uniform(-0.7, 0.7)), gain.lower, gain.upper))
        elif type(value) is int and value:
            changed[gain.name] = max(1, round(value * rng.uniform(0.8, 1.2)))
    return dataclasses.replace(controller, **changed)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_random_designs(name: str) -> None:
    """Three that keep at least 49 of 50 vehicles on the road: in a loop that is lost, differences grow without end."""
    rng, driven, n = np.random.default_rng(list(LAWS).index(name)), 0, 60 if name.startswith("mpc") else 150
    for seed in range(40):
        design, y_s, scenarios = random_design(LAWS[name], rng), rng.uniform(0.02, 0.3), make_scenarios(n, seed)
        lost = simulate(design, scenarios, setup=REALISTIC, y_s=y_s).status == EventStatus.DIVERGED
        if lost.sum() <= 0.02 * n:
            assert compared(design, REALISTIC, y_s=y_s, n=n, seed=seed).diverged == lost.sum()
            driven += 1
        if driven == 3:
            return
    pytest.fail(f"{driven} designs of 40")


SETUPS = {
    "ideal plant": Setup(),
    "a window that is no whole number of samples": Setup(dt=0.03, options=PlantOptions(actuator=Actuator(delay=0.03))),
    "another sample time and vehicle": Setup(
        dt=0.02, vehicle=VehicleParameters(m=1500.0, I_z=2500.0, l_f=1.1, w_l=3.2)
    ),
    "delay of a part of a sample": Setup(options=PlantOptions(actuator=Actuator(lag=0.1, delay=0.07, rate_max=0.4))),
    "delay without lag": Setup(options=PlantOptions(actuator=Actuator(delay=0.12))),
    "a slow camera": Setup(options=PlantOptions(sensors=Sensors(delay=0.08, period=0.15, kalman=KalmanFilter()))),
    "a filter without a camera": Setup(options=PlantOptions(sensors=Sensors(kalman=KalmanFilter(r_y=0.1)))),
    "a design that knows no delay": dataclasses.replace(REALISTIC, plant_knowledge="ideal"),
    "trigger by time": Setup(trigger="ttlc", ttlc=0.4),
    "trigger by time, filtered": dataclasses.replace(REALISTIC, trigger="ttlc", ttlc=0.4),
}


FAST = {
    ("mpc, soft", "ideal plant"),
    ("barrier around lqr", "delay of a part of a sample"),  # looks back further than its terms do
    *(("lqi", setup) for setup in ("a window that is no whole number of samples", "a slow camera", "trigger by time")),
}
CASES = [
    pytest.param(name, setup, marks=() if (name, setup) in FAST else pytest.mark.slow)
    for name in ("lqi", "barrier around lqr", "mpc, soft")
    for setup in SETUPS
]


@pytest.mark.parametrize(("name", "setup"), CASES)
def test_other_plants(name: str, setup: str) -> None:
    compared(LAWS[name], SETUPS[setup], y_s=0.2, n=60)


HELD = Driver(
    recorded=0.2, straight=0.2, follows=0.1, against=0.3, returns=0.2, override_torque=1.5, override_time=0.1, ramp=0.2,
    return_after=0.3,
)  # fmt: skip
ARMS = dataclasses.replace(HELD, model="arms", ramp=0.5)
LATE = Actuator(lag=0.1, delay=0.07, delta_max=0.02)
WAITING: dict[str, Controller] = {
    "lqi": LQI(conditioned=True), "pid": PID(conditioned=True),
    "barrier around lqr": BarrierFilter(inner="lqi", inner_gains="conditioned=true", e_y_max=1.0),
}  # fmt: skip


def with_driver(driver: Driver, actuator: Actuator = REALISTIC.options.actuator, dt: float = 0.05) -> Setup:
    options = dataclasses.replace(REALISTIC.options, driver=driver, actuator=actuator)
    return dataclasses.replace(REALISTIC, options=options, dt=dt)


@pytest.mark.parametrize(
    ("name", "setup"),
    [
        pytest.param("lqi", with_driver(HELD, dt=0.02), marks=pytest.mark.slow),
        ("pid", with_driver(ARMS, LATE)),
        pytest.param("pid", with_driver(HELD, LATE, dt=0.03), marks=pytest.mark.slow),
        pytest.param("lqi", with_driver(ARMS, LATE), marks=pytest.mark.slow),
        pytest.param("lqi", with_driver(dataclasses.replace(HELD, ramp=0.0)), marks=pytest.mark.slow),
        pytest.param("barrier around lqr", with_driver(HELD, LATE), marks=pytest.mark.slow),
        pytest.param("mpc", with_driver(ARMS), marks=pytest.mark.slow),
        pytest.param("stanley", with_driver(HELD, dt=0.01), marks=pytest.mark.slow),
        pytest.param("lqi", dataclasses.replace(with_driver(ARMS), options=dataclasses.replace(
            SETUPS["a slow camera"].options, driver=ARMS)), marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_a_driver_in_the_loop(name: str, setup: Setup) -> None:
    """State and authority of the assist are the loop's at every sample, in both precisions; it returns many times."""
    code = Code.of(WAITING.get(name, LAWS[name]), setup, 0.1)
    recording = record(code, make_scenarios(360, 5))
    state, authority = np.where(recording.counts, recording.assist, np.nan)
    returns = (state[1:] == 1) & (state[:-1] == 3)
    assert (returns.any(axis=0)).sum() > 50
    assert (authority[state == 3] == 0.0).all()
    rising = authority[state == 1] < 1.0
    assert (rising.sum() > 100) or setup.options.driver.ramp == 0.0
    result = check(recording, ["cc"])
    assert result.departures >= 300
    assert result.assist == 0
    assert result.passed
    assert "  driver: 0 states and authorities of the assist differ, in both precisions together" in result.lines
    if name in WAITING:
        assert recording.inputs["assist_saturated"].any()
    if name == "lqi":  # the torque is positive to the left, whichever side the departure is on
        scenarios = make_scenarios(360, 5)
        paths = simulate(code.controller, scenarios, setup=setup, y_s=0.1, trajectories=True).trajectories
        assert paths is not None
        assert paths.driver_torque is not None
        rows = recording.host.over.rows
        torque = scenarios.side[rows] * paths.driver_torque[rows, 1]
        np.testing.assert_allclose(recording.inputs["driver_torque"][5], torque, rtol=2e-6, atol=1e-9)
    if name == "lqi":  # one other state and one other authority are counted, in each precision
        recording.assist[:, *np.argwhere(recording.counts)[-1]] += 2e-6
        worse = check(recording, ["cc"])
        assert (worse.assist, worse.passed) == (4, False)


@pytest.mark.parametrize("name", ["lqi", "pid"])
def test_an_integral_waits_at_the_limit_of_the_actuator(name: str) -> None:
    """Without a driver too: from the limit of the command that has arrived, never that of the trigger's angle."""
    actuator = dataclasses.replace(LATE, delta_max=0.004, delay=0.12)
    code = Code.of(WAITING[name], with_driver(Driver(), actuator), 0.1)
    recording = record(code, make_scenarios(120, 5))
    assert (np.abs(recording.inputs["wheel"][4])[recording.counts[4]] > 0.004).sum() > 5
    result = check(recording, ["cc"])
    assert result.assist is None
    assert result.passed
    free = Code.of(LAWS[name], code.setup, 0.1)
    assert "yields" not in free.texts("")["ldc_controller.c"]
    other = dataclasses.replace(recording, host=dataclasses.replace(recording.host, code=free))
    assert check(other, ["cc"]).delta > 1e-6


@pytest.mark.parametrize("y_s", [0.0, -0.3])
def test_triggers_before_the_line(y_s: float) -> None:
    assert compared(LQR(), REALISTIC, y_s=y_s).departures == 120


@pytest.mark.parametrize(
    ("kind", "knots", "terms"),
    [
        ("interp", [1.0, 5.0, 15.3, 30.0, 90.0], 2),
        ("clip", [1.0, 5.0, 13.0, 27.7777777777778, 90.0], 17),  # 1/v needs a piece more
        ("step", [1.0, 20.0, 90.0], 1),
        ("bands", [1.0, 10.0, 13.8888888888889, 25.0, 90.0], 1),
        ("notch", [1.0, 20.0, 20.3, 90.0], 1),
    ],
)
def test_gains_with_kinks_and_steps(kind: str, knots: list[float], terms: int) -> None:
    """Tables between knots that are found, for the gains that need them; the others stay series. Both sides of each
    knot are right, to the last bit of the speed."""
    law = Table(kind)
    code, rng = Code.of(law, Setup(), 0.1), np.random.default_rng(2)
    schedule = code.schedule
    np.testing.assert_allclose(schedule.knots, knots, rtol=0.0, atol=1e-7)
    assert (schedule.kinked.tolist(), schedule.pieces.shape) == ([0, 2], (len(knots) - 1, terms, 2))
    assert schedule.error < 1e-10
    assert not schedule.coefficients[:, [0, 2]].any()
    assert schedule.coefficients[0, [1, 3]].all()
    for real, tolerance in ((np.float64, 3e-11), (np.float32, 2e-7)):
        edges = np.array(knots, dtype=real)
        around = np.concatenate([edges, np.nextafter(edges[1:], real(0)), np.nextafter(edges[:-1], real(99))])
        v = np.concatenate([around, rng.uniform(1.0, 90.0, 1000).astype(real)])
        compiled = Compiled(code, ["cc"], single=real is np.float32)
        for field, gain in (("e_y", 0), ("e_psi", 2)):
            row = np.zeros(v.size, dtype=struct(code.inputs))
            row["v"], row["engage"], row["line_left"], row[field] = v, 1, 1.0, 1.0
            exact = law.prepare(Setup().plant(v.astype(np.float64))).F[:, gain]
            np.testing.assert_allclose(
                compiled.step(row, compiled.begin(v.size))["delta"], exact, rtol=0.0, atol=tolerance
            )


def test_knots_in_header_and_parameters(tmp_path: Path) -> None:
    export_c(Table(), Setup(), 0.1, tmp_path, scenarios=make_scenarios(20), run_check=False)
    header = (tmp_path / "ldc_controller.h").read_text()
    assert " * of these, 2 with kinks or steps: polynomials over v in pieces, between\n" in header
    assert " *     1 m/s, 5 m/s, 15.3 m/s, 30 m/s\n *     90 m/s\n" in header
    content = json.loads(parameters(Code.of(Table(), Setup(), 0.1), "json"))
    speeds, F = content["speed_m_s"], content["over_speed"]["F"]["values"]
    assert (len(speeds), len(F)) == (91, 91)
    assert speeds[15] == pytest.approx(15.3, abs=1e-8)
    assert F[15][0] == pytest.approx(-0.01, abs=1e-10)


USUAL: dict[str, Any] = {
    "scenarios": 9, "departures": 9, "diverged": 0, "steps": 900, "delta": 1e-9, "S": 1e-9, "phases": 0, "failed": 0,
    "float_delta": 1e-5, "float_S": 1e-3, "iterations": 0, "median": 1e-7, "longest": 1e-6, "stack": 1, "size": 1,
    "state": 1, "bounds": (1e-9, 1e-5),
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "beyond"),
    [
        ("assist", 1),
        ("delta", 1.1e-9),
        ("S", 1.1e-9),
        ("phases", 1),
        ("failed", 1),
        ("float_delta", 1.1e-5),
        ("float_S", 1.1e-3),
    ],
)
def test_every_figure_of_the_check_counts(name: str, beyond: float) -> None:
    assert Check(**USUAL).passed
    assert not Check(**USUAL | {name: beyond}).passed
    assert not Check(**USUAL | {name: math.nan}).passed


def test_failed_solves_of_the_code_fail_the_check() -> None:
    """A solver that is stopped early; also where commands and S are within their bounds."""
    whole = Code.of(LAWS["mpc"], REALISTIC, 0.1)
    few = dataclasses.replace(whole.schedule.form, mpc=(whole.schedule.form.mpc or {}) | {"iterations": 1})
    short = dataclasses.replace(whole, schedule=dataclasses.replace(whole.schedule, form=few))
    result = check(record(short, make_scenarios(30)), ["cc"])
    assert result.failed > 0
    assert not result.passed
    assert f"failed in {result.failed} steps" in result.lines[3]


def test_the_departure_on_a_clock_of_its_own() -> None:
    """Sampled from the start of each recorded path, the code takes over at the first sample after the trigger time."""
    over, code = takeover(make_scenarios(200), y_s=0.1, dt=0.01), Code.of(LQR(), Setup(dt=0.01), 0.1)
    compiled = Compiled(code, ["cc"])
    path, side, state = over.driven, over.triggered.side.astype(float), compiled.begin(over.m)
    row, engaged_at = np.zeros(over.m, dtype=struct(code.inputs)), np.full(over.m, -1)
    row["v"], row["engage"] = over.plant.v, 1
    for k in range(int(over.triggered.T.max() / 0.01) + 1):
        y = path.lateral(np.full(over.m, k * 0.01))
        row["line_left"], row["line_right"] = np.where(side > 0, y, -1.0), np.where(side > 0, -1.0, y)
        out = compiled.step(row, state)
        engaged_at = np.where((engaged_at < 0) & (out["phase"] > 0), k, engaged_at)
        steering = (engaged_at >= 0) & (out["status"] == 0)  # far behind its end, a path is an unusable input
        assert (out["side"][steering] == side[steering]).all()
    expected = np.ceil(over.start / 0.01).astype(int)
    # an edge that is back below y_s before the next sample is no departure to a sampled controller
    seen = path.lateral(expected * 0.01) > 0.1
    assert seen.sum() > 150
    np.testing.assert_array_equal(engaged_at[seen], expected[seen])


def test_the_edge_is_back_when_the_loop_has_it_back() -> None:
    scenarios, setup = make_scenarios(200), Setup(dt=0.02)
    outcome = simulate(PID(), scenarios, setup=setup, y_s=0.1)
    recording = record(Code.of(PID(), setup, 0.1), scenarios)
    rows = recording.host.over.rows
    back = outcome.metrics.t_back[rows] - outcome.t_s[rows]
    expected = np.ceil(back / 0.02)
    released = (recording.phase[4:] == 2).argmax(axis=0)
    ever = np.isfinite(back) & (expected < recording.counts[4:].sum(axis=0))
    assert ever.sum() > 100
    np.testing.assert_array_equal(released[ever], expected[ever])


def test_left_and_right_are_the_same_to_the_bit() -> None:
    scenarios = make_scenarios(60)
    code = Code.of(LAWS["barrier around lqr"], REALISTIC, 0.1)
    recording = record(code, scenarios)
    compiled, mirror = Compiled(code, ["cc"]), recording.inputs.copy()
    for name in [name for name, _, kind in code.inputs if kind == "ldc_real"]:
        if name not in ("v", "line_left", "line_right"):
            mirror[name] *= -1.0
    mirror["line_left"], mirror["line_right"] = recording.inputs["line_right"], recording.inputs["line_left"]
    states = compiled.begin(recording.host.over.m), compiled.begin(recording.host.over.m)
    for rows, mirrored in zip(recording.inputs, mirror, strict=True):
        out, other = compiled.step(rows, states[0]), compiled.step(mirrored, states[1])
        for name, sign in (("delta", -1), ("side", -1), ("phase", 1)):
            np.testing.assert_array_equal(out[name], sign * other[name])


PREDICTIVE: dict[str, Controller] = {
    "nonlinear": NonlinearMPC(horizon=8),
    "whole": NonlinearMPC(),
    "limited": NonlinearMPC(a_y_max=2.0, jerk_max=3.0, e_y_max=1.2),
    "corridor": Corridor(), "held": Held(), "three": Three(), "slow": Slow(), "quadratic": Quadratic(),
    "narrow": Narrow(),
}  # fmt: skip
SHORT: dict[str, Controller] = {
    "limited, short": NonlinearMPC(horizon=8, a_y_max=2.0, jerk_max=3.0, e_y_max=1.2),
    "corridor, short": Corridor(horizon=8),
    "slow, short": Slow(horizon=5),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "setup"),
    [
        *((name, "realistic") for name in list(PREDICTIVE)[:-1]),
        *((f"{name}, short", "ideal plant") for name in ("limited", "slow")),
        ("corridor, short", "a window that is no whole number of samples"),
        ("slow, short", "delay without lag"),
    ],
)
def test_predictive_controllers(name: str, setup: str) -> None:
    code = Code.of((PREDICTIVE | SHORT)[name], REALISTIC if setup == "realistic" else SETUPS[setup], 0.1)
    result, sizes = check(record(code, make_scenarios(15, 5)), ["cc"]), code.schedule.form.sqp or {}
    assert result.passed
    assert result.steps > 20 * (result.departures - result.diverged) > 0
    assert max(result.delta, result.S) <= 1e-7
    assert result.float_delta <= 1e-3
    assert 0 < result.iterations <= sizes["programs"] * sizes["iterations"]
    assert sizes["programs"] == (3 if name == "three" else 60)


@pytest.mark.slow
@pytest.mark.parametrize("name", [x for x in PREDICTIVE if x != "three"])
def test_predictive_controllers_from_wild_states(name: str) -> None:
    """One step, in which many limits are active at once; commands where both are solutions."""
    setup = Setup(options=PlantOptions(actuator=Actuator(lag=0.1, delay=0.06)))
    code, rng, n = Code.of(PREDICTIVE[name], setup, 0.1), np.random.default_rng(4), 400
    v, last = rng.uniform(5.0, 50.0, n), rng.uniform(-0.13, 0.13, n)
    x = rng.normal(size=(n, 4)) * [1.0, 1.0, 0.05, 0.1] * rng.choice([0.1, 1.0, 3.0], (n, 1))
    law = PREDICTIVE[name].prepare(setup.plant(v))
    yaw_rate = rng.normal(0.0, 0.02, (n, law.preview_times.size))
    delta, _, status = law.step(np.zeros(n), x, Preview(yaw_rate, 0.0 * yaw_rate, last), last, law.init(n))
    row, compiled = np.zeros(n, dtype=struct(code.inputs)), Compiled(code, ["cc"])
    for field, values in zip(("e_y", "e_y_rate", "e_psi", "e_psi_rate"), x.T, strict=True):
        row[field] = values
    row["v"], row["wheel"], row["engage"], row["line_left"] = v, last, 1, 1.0
    row["curvature"] = yaw_rate / v[:, None]
    out = compiled.step(row, compiled.begin(n))
    solved = out["status"][status != EventStatus.SOLVER_FAILED] & 4 == 0
    beyond = (out["status"] == 8)[status != EventStatus.SOLVER_FAILED]
    np.testing.assert_array_equal(
        beyond[solved], (status == EventStatus.BEYOND_DELTA_MAX)[status != EventStatus.SOLVER_FAILED][solved]
    )
    assert (out["status"] == 8).sum() > 10
    failed = status == EventStatus.SOLVER_FAILED
    assert ((out["status"] & 4 != 0) & ~failed).sum() <= 0.01 * n
    good = ~failed & (out["status"] & 4 == 0)
    assert good.sum() > 0.7 * n
    apart = np.abs(out["delta"] - delta)[good]
    # with soft limits far exceeded a solve ends up to 1e-6 from the optimum, in Python too when it starts elsewhere
    soft = name in ("limited", "corridor", "held", "narrow")
    assert (apart <= (1e-6 if soft else 1e-7)).mean() > (0.98 if name == "limited" else 0.999)  # several optima
    assert (apart <= 1e-7).mean() > (0.98 if soft else 0.999)


@pytest.mark.parametrize("law", [pytest.param(Fading(), marks=pytest.mark.slow), Rooted()])
def test_weights_of_0_and_limits_that_are_no_numbers(law: Controller) -> None:
    """Which only the lane makes them: no limit; a failed solve."""
    setup = Setup(options=PlantOptions(actuator=Actuator(delay=0.05)))
    code, rng, n = Code.of(law, setup, 0.1), np.random.default_rng(4), 60
    v, x = rng.uniform(15.0, 40.0, n), rng.normal(size=(n, 4)) * [0.5, 0.3, 0.02, 0.05] + [1.0, 0.0, 0.0, 0.0]
    prepared, sharp = law.prepare(setup.plant(v)), np.arange(n) % 2 == 1
    yaw_rate = np.tile(np.where(sharp, 0.003, 0.001)[:, None] * v[:, None], (1, prepared.preview_times.size))
    zero = np.zeros(n)
    delta, _, status = prepared.step(zero, x, Preview(yaw_rate, 0.0 * yaw_rate, zero), zero, prepared.init(n))
    row, compiled = np.zeros(n, dtype=struct(code.inputs)), Compiled(code, ["cc"])
    for field, values in zip(("e_y", "e_y_rate", "e_psi", "e_psi_rate"), x.T, strict=True):
        row[field] = values
    row["v"], row["engage"], row["line_left"], row["curvature"] = v, 1, 1.0, yaw_rate / v[:, None]
    out = compiled.step(row, compiled.begin(n))
    failed = sharp & (law.name == "rooted")
    np.testing.assert_array_equal(status == EventStatus.SOLVER_FAILED, failed)
    np.testing.assert_array_equal(out["status"], np.where(failed, 4, 0))
    np.testing.assert_allclose(out["delta"], delta, rtol=0.0, atol=1e-9)


def test_gains_follow_the_exact_ones() -> None:
    for name in ("lqi", "mpc, blocks", "mpc, soft"):
        assert Schedule.of(LAWS[name], REALISTIC).error < 1e-11


@pytest.mark.parametrize(
    ("given", "path", "value", "allowed"),
    [
        ({"setup": None}, "setup", ..., "Setup"),
        ({"scenarios": [1]}, "scenarios", ..., "Scenarios or None"),
        ({"folder": ""}, "folder", "", "a path"),
        ({"y_s": 3.0}, "scenarios", ..., "one or more"),
        ({"controller": "lqr"}, "controller", ..., "a controller instance, e.g. controller_class('lqr')()"),
        ({"controller": NoControl()}, "law", "none", WITH_CODE),
        ({"controller": Bent(horizon=3)}, "law", "bent", ""),  # its own states are not linear in what it sees
        ({"controller": Table("noise")}, "gains of 'table'", ..., ""),  # they change too sharply with speed
    ],
)
def test_what_cannot_be_exported(given: dict[str, Any], path: str, value: Any, allowed: str, tmp_path: Path) -> None:
    usual = {"controller": LQR(), "setup": Setup(), "y_s": 0.1, "folder": tmp_path, "scenarios": make_scenarios(5)}
    with pytest.raises(LdcError) as caught:
        export_c(**(usual | given))
    assert_fields(caught.value, path, value, allowed)
    assert not list(tmp_path.iterdir())


def test_text_that_would_end_a_comment(tmp_path: Path) -> None:
    law = BarrierFilter(inner_gains="K_y=-0.01,\n K_psi=-0.3")
    origin = Origin("a */ b", "", "", "'??/")
    result = export_c(law, Setup(), 0.1, tmp_path, scenarios=make_scenarios(20), origin=origin).check
    assert result is not None
    assert result.passed
    header = (tmp_path / "ldc_controller.h").read_text()
    assert " * study: a * / b, hash" in header
    assert "K_y=-0.01, K_psi=-0.3" in header
    code = Code.of(law, Setup(), 0.1)
    assert "ldc.inner_gains = 'K_y=-0.01, K_psi=-0.3';\n" in parameters(code, "m")
