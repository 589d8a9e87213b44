"""Every deterministic plant option, alone and together, against an independent closed loop; both loops alike.

The reference integrates each departure with scipy to 1e-13, in other coordinates and in the road frame."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers import reference_loop as reference
from helpers.closed_loop import METRICS, Prepared, Stepped, assert_within_the_bound, grid, some
from ldctoolkit import BicycleModel, Controller, LinearLaw, Outcome, Plant, Scenarios, Setup, simulate
from ldctoolkit.controllers import LQR, PreviewProportional
from ldctoolkit.paths.uncorrected import RandomStream, UncorrectedPath, normals, uniforms
from ldctoolkit.plant_options import Actuator, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import Takeover, takeover

SEED = 11
Y_S, DT, SETTLE = 0.1, 0.05, 1.0


# a law that uses everything a linear law can see
F = (-0.02, -0.01, -0.25, -0.03)
TIMES, G_YAW_RATE, G_HEADING = (0.0, 0.35, 1.2), (0.02, 0.01, 0.0), (0.0, -0.05, -0.2)
F_U = 0.2


def formula(x: np.ndarray, yaw_rate: Any, heading: Any, before: float, *_: Any) -> float:
    ahead = sum(
        g * yaw_rate(s) + h * (heading(s) if h else 0.0) for s, g, h in zip(TIMES, G_YAW_RATE, G_HEADING, strict=True)
    )
    return float(np.dot(F, x)) + ahead + F_U * before


def everything(plant: Plant) -> LinearLaw:
    F_n, yaw_rate, heading, f_u = (np.tile(row, (plant.n, 1)) for row in (F, G_YAW_RATE, G_HEADING, [F_U]))
    return LinearLaw(F_n, np.array(TIMES), yaw_rate, heading, f_u[:, 0])


EVERYTHING = Prepared(everything)
BOTH_LOOPS = (EVERYTHING, Stepped(EVERYTHING, drops=True))


SCENARIOS = Scenarios.from_arrays(
    side=[-1, 1, 1], T=[1.43, 1.0, 0.83], d_y=[0.45, 0.3, 0.06], v_mean=[27.0, 12.0, 20.0], a_mean=[-0.8, 0.6, 0.0],
    c_0=[1.2e-3, -2e-3, 1e-3], dc=[-8e-4, 3e-3, 0.0], sigma_y=[0.03, 0.015, 0.0], sigma_v=[0.12, 0.2, 0.0],
)  # fmt: skip
"""The last one never triggers."""

MAGIC = Tyres(model="magic_formula", mu=0.35, shape=1.4)
CAMERA = Sensors(
    e_y_bias=0.04, e_psi_bias=-0.004, e_y_step=0.01, e_psi_step=0.001, period=2 * DT, delay=DT, curvature_gain=0.1,
    curvature_bias=2e-4, curvature_noise=3e-4,
)  # fmt: skip
NOISY = dataclasses.replace(CAMERA, e_y_step=0.0, e_psi_step=0.0, e_y_noise=0.03, e_psi_noise=0.003)
FILTERED = dataclasses.replace(CAMERA, delay=0.0, kalman=KalmanFilter())
DRAWN = Mismatch(m=(0.8, 1.4), I_z=(0.9, 1.2), C_af=(0.7, 1.0), C_ar=(0.8, 1.2))
STEERING = Actuator(delta_max=0.03, rate_max=0.25, lag=0.07, delay=0.083)
RESIDUALS = Residuals(y=True, v=True, bandwidth=2.0)

CASES = {
    "ideal": PlantOptions(),
    "profile": PlantOptions(speed="profile"),
    "delta_max": PlantOptions(actuator=Actuator(delta_max=0.012)),
    "lag": PlantOptions(actuator=Actuator(lag=0.12)),
    "rate": PlantOptions(actuator=Actuator(rate_max=0.2)),
    "lag of a tenth of a substep": PlantOptions(actuator=Actuator(lag=2e-3, rate_max=0.2)),
    "lag and rate": PlantOptions(actuator=Actuator(lag=0.06, rate_max=0.2)),
    "delay of two samples": PlantOptions(actuator=Actuator(delay=2 * DT)),
    "delay between samples": PlantOptions(actuator=Actuator(delay=0.073)),
    "actuator": PlantOptions(actuator=STEERING),
    "mismatch": PlantOptions(mismatch=DRAWN),
    "magic formula": PlantOptions(tyres=MAGIC),
    "magic formula, profile": PlantOptions(tyres=MAGIC, speed="profile"),
    "friction drawn": PlantOptions(tyres=MAGIC, mismatch=dataclasses.replace(DRAWN, mu=(0.5, 1.0))),
    "bias": PlantOptions(sensors=Sensors(e_y_bias=0.05, e_psi_bias=-0.01)),
    "steps": PlantOptions(sensors=Sensors(e_y_step=0.03, e_psi_step=0.002)),
    "slow camera": PlantOptions(sensors=Sensors(period=3 * DT, delay=2 * DT)),
    "noise": PlantOptions(sensors=Sensors(e_y_noise=0.05, e_psi_noise=0.005)),
    "curvature": PlantOptions(sensors=Sensors(curvature_gain=-0.2, curvature_bias=4e-4, curvature_noise=5e-4)),
    "camera": PlantOptions(sensors=CAMERA),
    "filter": PlantOptions(sensors=Sensors(kalman=KalmanFilter(q_y=1.0)), mismatch=DRAWN),
    "camera and filter": PlantOptions(sensors=FILTERED),
    "noise and filter": PlantOptions(sensors=dataclasses.replace(NOISY, kalman=KalmanFilter())),
    "late filter": PlantOptions(
        actuator=Actuator(lag=0.07, delay=0.083), sensors=Sensors(delay=3 * DT, kalman=KalmanFilter())
    ),
    "all, late filter": PlantOptions(
        speed="profile", actuator=STEERING, mismatch=DRAWN, sensors=dataclasses.replace(CAMERA, kalman=KalmanFilter())
    ),
    "30 frames a second": PlantOptions(
        sensors=Sensors(fps=30, delay=0.07, e_y_noise=0.03, e_psi_noise=0.003, e_psi_bias=0.002)
    ),
    "30 frames a second and filter": PlantOptions(
        actuator=Actuator(lag=0.07, delay=0.083),
        sensors=Sensors(fps=30, delay=0.07, e_y_noise=0.03, e_psi_noise=0.003, kalman=KalmanFilter()),
    ),
    "8 frames a second and filter": PlantOptions(sensors=Sensors(fps=8, delay=0.12, kalman=KalmanFilter())),
    "residual of y": PlantOptions(residuals=Residuals(y=True)),
    "residual of v": PlantOptions(residuals=Residuals(v=True), speed="profile"),
    "residuals, speed frozen": PlantOptions(residuals=RESIDUALS),
    "all, linear tyres": PlantOptions(
        speed="profile", actuator=STEERING, mismatch=DRAWN, sensors=FILTERED, residuals=RESIDUALS
    ),
    "all, magic formula": PlantOptions(
        speed="profile", actuator=STEERING, mismatch=DRAWN, tyres=MAGIC, sensors=NOISY, residuals=RESIDUALS
    ),
    "frozen speed, magic formula, actuator, filter": PlantOptions(tyres=MAGIC, actuator=STEERING, sensors=FILTERED),
}

STATES = 1e-4  # how far a state may be from the reference, in parts of its range


SCORED = (
    "ideal", "actuator", "friction drawn", "camera", "30 frames a second", "camera and filter", "all, linear tyres",
    "all, magic formula", "profile", "lag", "rate", "delay of two samples", "magic formula, profile",
    "residuals, speed frozen",
)  # fmt: skip


def driven(
    scenarios: Scenarios, options: PlantOptions, i: int, *, dt: float = DT, as_printed: bool = False,
    law: reference.Law = formula, **more: Any,
) -> Any:  # fmt: skip
    """The reference's drive of scenario i, with the package's draws."""
    a, b = (), ()
    if not options.residuals.ideal:
        uncorrected = UncorrectedPath.of(scenarios, options.residuals, SEED)
        a, b = tuple(uncorrected.modes_y[i]), tuple(uncorrected.modes_v[i])
    nominal = reference.Vehicle(mu=options.tyres.mu, as_printed=as_printed)
    names = [field.name for field in dataclasses.fields(Mismatch)]
    draws = uniforms(SEED, scenarios.index, RandomStream.MISMATCH, len(names))[i]
    ranges = [getattr(options.mismatch, name) for name in names]
    factors = {name: low + (high - low) * u for name, (low, high), u in zip(names, ranges, draws, strict=True)}
    draw = normals(SEED, scenarios.index, RandomStream.CURVATURE, 1)[i, 0]
    frames = normals(SEED, scenarios.index[i : i + 1], RandomStream.CAMERA, 2**21 + 400)[0].reshape(-1, 2)
    return reference.drive(
        reference.Path.of(scenarios, i, a, b), law, options=options, vehicle=nominal,
        true=nominal.times(**factors), y_s=Y_S, dt=dt, curvature_draw=options.sensors.curvature_noise * draw,
        noise={j: frames[2**20 + j] for j in range(-100, 200)}, **{"settle": SETTLE} | more,
    )  # fmt: skip


def run(law: Controller, options: PlantOptions, scenarios: Scenarios, **more: Any) -> Outcome:
    given = {"y_s": Y_S, "dt": DT, "seed": SEED, "settle": SETTLE} | more
    return simulate(law, scenarios, options=options, trajectories=True, **given)


def rows_of(out: Outcome, i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    driven = ~np.isnan(out.trajectories.t[i])
    return tuple(getattr(out.trajectories, name)[i, driven] for name in ("t", "x", "delta"))  # type: ignore[return-value]


@pytest.mark.parametrize("case", some(SCORED, *SCORED[:8]))
def test_both_loops_equal_the_reference(case: str) -> None:
    """The other metrics too."""
    options = CASES[case]
    linear, general = (run(law, options, SCENARIOS) for law in BOTH_LOOPS)
    assert linear.triggered[:2].all()
    for i in range(2):
        expected = driven(SCENARIOS, options, i)
        for out in (linear, general):
            assert out.S_uncorrected[i] == pytest.approx(expected.S_recorded, abs=1e-9)
            assert out.t_s[i] == pytest.approx(expected.t_s, abs=1e-12)
            assert_same_drive(out, i, expected)
            t, x, _ = rows_of(out, i)
            size = np.abs(expected.x).max(axis=0)
            assert (np.abs(x[t == SCENARIOS.T[i]][0] - expected.x_T) < STATES * size).all()
            assert (np.abs(x[-1] - expected.x_end) < STATES * size).all()
    assert_within_the_bound(general, linear)


def various(options: PlantOptions, n: int) -> Scenarios:
    """Departures at 5 to 60 m/s in bends, to both sides, with 80 % of the friction at most when they start."""
    rng = np.random.default_rng(8)
    most = 5.0 if options.tyres.ideal else min(5.0, 9.81 * options.tyres.mu * options.mismatch.mu[0])
    v, d_y = rng.uniform(5.0, 60.0, n), rng.uniform(0.12, 0.4, n)
    bend = rng.uniform(-0.3, 0.3, n) * most / v**2
    return Scenarios.from_arrays(
        side=rng.choice([-1, 1], n), T=np.sqrt(8.0 * d_y / rng.uniform(0.15, 0.5, n) / most), d_y=d_y, v_mean=v,
        a_mean=rng.uniform(-0.8, 0.8, n), c_0=bend, dc=rng.uniform(-1.0, 0.2, n) * bend,
        sigma_y=rng.uniform(0.0, 3e-3, n), sigma_v=rng.uniform(0.0, 0.2, n),
    )  # fmt: skip


QUICK = [
    ("late filter", 10, True), ("all, late filter", 10, False), ("mismatch", 20, True),
    ("all, magic formula", 15, True),
]  # fmt: skip


@pytest.mark.parametrize(
    ("case", "n", "known"), [*QUICK, *(pytest.param(case, 25, True, marks=pytest.mark.slow) for case in CASES)]
)
def test_random_departures_equal_the_reference(case: str, n: int, known: bool) -> None:
    """S within 1e-5, states and steering angle within 1e-4 of their range; half of them under each law."""
    options, settle, compared = CASES[case], 0.2, 0
    scenarios = various(options, n)
    knowledge: Any = "nominal" if known else "ideal"
    over = Takeover.build(scenarios, Setup(options=options, seed=SEED, plant_knowledge=knowledge), y_s=Y_S)
    for parity, design in enumerate((LQR(r_delta=100.0), PreviewProportional())):
        law, out = design.prepare(over.plant), run(design, options, scenarios, settle=settle, plant_knowledge=knowledge)
        for j in np.flatnonzero(over.rows % 2 == parity):
            i = int(over.rows[j])
            expected = driven(
                scenarios, options, i, law=reference.of_row(law, j), known=known, settle=settle, rtol=1e-10
            )
            if expected.margin > 1e-3:  # else the camera's rounding may make a large difference of a small one
                assert_same_path(out, i, expected)
                compared += 1
    assert compared > 0.8 * n


@pytest.mark.parametrize("case", ["lag and rate", "magic formula, profile"])
def test_half_the_substep_has_a_sixteenth_of_the_error(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = various(CASES[case], 40)
    slow = slow.take(slow.v_mean < 20.0)

    def states(reach: float) -> np.ndarray:
        monkeypatch.setattr(takeover, "_REACH", reach)
        monkeypatch.setattr(takeover, "_REACH_OF_TYRES", reach)
        paths = run(LQR(r_delta=100.0), CASES[case], slow, dt=0.2).trajectories
        return paths.x

    finest = states(1 / 64)
    errors = [np.nanmax(np.abs(states(reach) - finest)) for reach in (1 / 2, 1 / 4, 1 / 8)]
    assert 12.0 < errors[0] / errors[1] < 24.0
    # of tyres, the formula's approximation is left
    assert (8.0 if "formula" in case else 12.0) < errors[1] / errors[2] < 24.0


@pytest.mark.parametrize("case", ["ideal", "all, magic formula"])
def test_never_triggered_is_the_recorded_path(case: str) -> None:
    """Its deepest points are no interpolant; nobody steered."""
    gentle = dataclasses.replace(SCENARIOS, d_y=np.array([0.07, 0.05, 0.06]), sigma_y=np.array([0.002, 0.005, 0.0]))
    for law in BOTH_LOOPS:
        out = run(law, CASES[case], gentle)
        assert not out.triggered.any()
        for i in range(gentle.n):
            expected = driven(gentle, CASES[case], i)
            assert np.isinf(expected.t_s)
            assert (out.S[i], out.S_uncorrected[i]) == (pytest.approx(expected.S, abs=1e-9), out.S[i])
            for name in METRICS:
                size = 1e-7 if name == "dtle" else 1e-9  # the rate of the speed is a quotient over 0.1 ms
                assert getattr(out.metrics, name)[i] == pytest.approx(expected.metrics[name], abs=size), name


def assert_same_path(out: Outcome, i: int, expected: Any) -> None:
    t, x, delta = rows_of(out, i)
    np.testing.assert_allclose(t, expected.t, rtol=0, atol=1e-12)
    assert (np.abs(x - expected.x) < STATES * np.abs(expected.x).max(axis=0)).all()
    np.testing.assert_allclose(delta, expected.delta, rtol=0, atol=STATES * np.abs(expected.delta).max())
    assert out.S[i] == pytest.approx(expected.S, rel=1e-5)


def assert_same_drive(out: Outcome, i: int, expected: Any) -> None:
    """The other metrics too, within 1e-4."""
    assert_same_path(out, i, expected)
    for name in METRICS:
        value = expected.metrics[name]
        assert getattr(out.metrics, name)[i] == pytest.approx(value, rel=1e-4, abs=5e-5), name


def test_as_printed_equals_the_reference() -> None:
    options = PlantOptions(speed="profile", actuator=Actuator(lag=0.05))
    out = run(EVERYTHING, options, SCENARIOS, vehicle=BicycleModel(convention="as_printed"))
    for i in range(2):
        assert_same_drive(out, i, driven(SCENARIOS, options, i, as_printed=True))


LOOSE = {
    "linear": PlantOptions(actuator=Actuator(delay=0.31)),
    "actuator": PlantOptions(actuator=Actuator(lag=0.2, rate_max=0.03, delay=0.04)),
    "profile": PlantOptions(speed="profile", actuator=Actuator(delay=0.31)),
    "magic formula": PlantOptions(tyres=MAGIC, speed="profile", actuator=Actuator(rate_max=0.1)),
}


CRAWLING = dataclasses.replace(
    SCENARIOS, v_mean=np.array([2.6, 2.0, 2.0]), a_mean=np.array([-0.8, 0.6, 0.0]), d_y=np.array([0.25, 0.2, 0.06])
).take([0, 1])


@pytest.mark.parametrize(("case", "crawling"), grid(LOOSE, [False, True], ("actuator", False)))
def test_samples_longer_than_the_departure_and_low_speed(case: str, crawling: bool) -> None:
    """Of a departure before T and few after it, the last step cut short; at 2 m/s the lateral mode dies within a tenth
    of a sample."""
    scenarios, dt = (CRAWLING, DT) if crawling else (SCENARIOS, 1.45)
    outs = [run(law, LOOSE[case], scenarios, dt=dt) for law in BOTH_LOOPS]
    for i in range(2):
        expected = driven(scenarios, LOOSE[case], i, dt=dt)
        for out in outs:
            assert_same_drive(out, i, expected)
