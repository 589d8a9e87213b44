"""A driver at the wheel, against an independent integration of column, arms and assist, and in closed form."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers import reference_driver, reference_loop
from helpers.bits import assert_same_bits
from helpers.closed_loop import METRICS, Constant, Stepped, assert_same_rows, make_scenarios, some, with_residuals
from helpers.errors import refused
from helpers.reference_driver import Driven, Person
from helpers.vehicle_models import Bicycle
from ldctoolkit import AssistState, Controller, Outcome, Scenarios, Setup, simulate
from ldctoolkit.controllers import LQR, PreviewProportional
from ldctoolkit.metrics import DRIVER_METRICS
from ldctoolkit.paths.uncorrected import RandomStream, UncorrectedPath, normals, uniforms
from ldctoolkit.plant_options import Actuator, Driver, Mismatch, PlantOptions, Residuals, Sensors, Tyres
from ldctoolkit.simulation import Takeover

SEED, Y_S, DT, SETTLE = 11, 0.1, 0.05, 1.0

ALL = {"recorded": 0.2, "straight": 0.2, "follows": 0.2, "against": 0.2, "returns": 0.2}
GRIP = Driver(**ALL)
ARMS = Driver(model="arms", **ALL)
BACK = {"override_torque": 2.0, "override_time": 0.1, "ramp": 0.2, "return_after": 0.3}
NEVER = {"override_torque": 100.0, "torque_max": 2.0}
MAGIC = Tyres(model="magic_formula", mu=0.6, shape=1.4)
DRAWN = Mismatch(m=(0.8, 1.4), I_z=(0.9, 1.2), C_af=(0.7, 1.0), C_ar=(0.8, 1.2))
STEERING = Actuator(delta_max=0.05, rate_max=0.3, lag=0.07, delay=0.083)
CAMERA = Sensors(e_y_bias=0.04, e_psi_bias=-0.004, period=2 * DT, delay=DT, curvature_gain=0.1, curvature_noise=3e-4)
RESIDUALS = Residuals(v=True)  # nobody steers that of y
EVERYTHING: dict[str, Any] = {
    "speed": "profile", "actuator": STEERING, "mismatch": DRAWN, "tyres": MAGIC, "sensors": CAMERA,
    "residuals": RESIDUALS,
}  # fmt: skip

CASES = {
    "grip": PlantOptions(driver=GRIP),
    "arms": PlantOptions(driver=ARMS),
    "grip, the assist comes back": PlantOptions(driver=dataclasses.replace(GRIP, **BACK), actuator=Actuator(lag=0.1)),
    "arms, the assist comes back": PlantOptions(driver=dataclasses.replace(ARMS, **BACK), actuator=Actuator(lag=0.1)),
    "grip, never overridden": PlantOptions(driver=dataclasses.replace(GRIP, **NEVER), speed="profile"),
    "arms, never overridden": PlantOptions(driver=dataclasses.replace(ARMS, **NEVER), speed="profile"),
    "grip, magic formula": PlantOptions(driver=GRIP, tyres=MAGIC, actuator=STEERING),
    "arms, magic formula": PlantOptions(driver=ARMS, tyres=MAGIC, actuator=STEERING),
    "grip, everything": PlantOptions(driver=dataclasses.replace(GRIP, **BACK), **EVERYTHING),
    "arms, everything": PlantOptions(driver=dataclasses.replace(ARMS, **BACK), **EVERYTHING),
}


def departures(n: int, seed: int = 3) -> Scenarios:
    """To both sides and in bends, with at most half of the friction of `MAGIC`; every other ends at a sample, or 0.1 µs
    before it: were it the same number, the last place would decide whether the recorded path goes on for a sample."""
    rng = np.random.default_rng(seed)
    v, d_y, side = rng.uniform(8.0, 40.0, n), rng.uniform(0.15, 0.6, n), rng.choice([-1, 1], n)
    share = 0.5 * (1.0 + np.sqrt(1.0 - Y_S / d_y))  # of the departure that is after the trigger, at constant speed
    T, at_a_sample = np.sqrt(8.0 * d_y / rng.uniform(0.3, 1.2, n)), np.arange(n) % 2 == 0
    T = np.where(at_a_sample, (np.round(T * share / DT) * DT - 1e-7) / share, T)
    bend = rng.uniform(-1.5, 1.5, n) / v**2
    return Scenarios.from_arrays(
        side=side, T=T, d_y=d_y, v_mean=v, a_mean=np.where(at_a_sample, 0.0, rng.uniform(-0.6, 0.6, n)), c_0=bend,
        dc=rng.uniform(-1.0, 0.2, n) * bend, sigma_y=rng.uniform(0.0, 0.02, n), sigma_v=rng.uniform(0.0, 0.1, n),
    )  # fmt: skip


def expected(scenarios: Scenarios, options: PlantOptions, i: int, law: reference_loop.Law, **more: Any) -> Driven:
    """The reference's drive of scenario i, with the package's draws."""
    uncorrected = UncorrectedPath.of(scenarios, options.residuals, SEED)
    nominal = reference_loop.Vehicle(mu=options.tyres.mu)
    names = [field.name for field in dataclasses.fields(Mismatch)]
    draws = uniforms(SEED, scenarios.index, RandomStream.MISMATCH, len(names))[i]
    ranges = [getattr(options.mismatch, name) for name in names]
    factors = {name: low + (high - low) * u for name, (low, high), u in zip(names, ranges, draws, strict=True)}
    draw = normals(SEED, scenarios.index, RandomStream.CURVATURE, 1)[i, 0]
    driven = reference_driver.drive(
        reference_loop.Path.of(scenarios, i, uncorrected.modes_y[i], uncorrected.modes_v[i]), law,
        Person.drawn(options.driver, SEED, scenarios.index, i), options=options, vehicle=nominal,
        true=nominal.times(**factors), curvature_draw=options.sensors.curvature_noise * draw,
        **{"y_s": Y_S, "dt": DT, "settle": SETTLE} | more,
    )  # fmt: skip
    assert driven is not None
    return driven


def run(law: Controller, options: PlantOptions, scenarios: Scenarios, **more: Any) -> Outcome:
    given = {"y_s": Y_S, "dt": DT, "seed": SEED, "settle": SETTLE} | more
    return simulate(law, scenarios, options=options, trajectories=True, **given)


QUICK = {"grip": 6, "arms, everything": 3}


@pytest.mark.parametrize(
    ("case", "n"), [*QUICK.items(), *(pytest.param(case, 20, marks=pytest.mark.slow) for case in CASES)]
)
def test_random_departures_equal_the_reference(case: str, n: int) -> None:
    """S within 1e-4, the largest torque within 1 %; half of them under each law. Where a torque at a sample comes
    within 0.3 % of the limit, either may be said to have overridden the assist. Of twenty, every second is compared;
    one may be beyond, by half as much again at most: that of "everything" whose S is 1.1e-4 off, that of "never
    overridden" with 1.4 %."""
    options, scenarios, compared, beyond = CASES[case], departures(n), 0, 0
    every = 2 if n > 6 else 1
    over = Takeover.build(scenarios, Setup(options=options, seed=SEED), y_s=Y_S)
    for parity, design in enumerate((LQR(r_delta=3000.0), PreviewProportional())):
        law, out = design.prepare(over.plant), run(design, options, scenarios)
        for j in np.flatnonzero((over.rows // 2 % 2 == parity) & (over.rows % every == 0)):
            i = int(over.rows[j])
            reference = expected(scenarios, options, i, reference_loop.of_row(law, j))
            if reference.margin > 3e-3:
                at_a_sample, compared = i % 2 == 0 and options.residuals.ideal, compared + 1
                try:
                    assert_same(out, i, reference, ends_at_a_sample=at_a_sample)
                except AssertionError:
                    beyond += 1
                    assert_same(out, i, reference, ends_at_a_sample=at_a_sample, times=1.5)
    assert beyond <= n // 20
    assert compared >= 0.8 * n / every


def assert_same(out: Outcome, i: int, reference: Driven, *, ends_at_a_sample: bool, times: float = 1.0) -> None:
    """The torques at the samples before T within 1 % of the largest, the states of the assist, and the other metrics
    within 1 % or 10 mN m; times within a substep at either edge. Between T and the next sample the recorded path may go
    on as it was: a torque that is largest there is not compared."""
    assert out.S[i] == pytest.approx(reference.S, rel=1e-4 * times, abs=1e-4 * times)
    for name, value in reference.metrics.items():
        least = 0.06 if name.startswith("against") else 0.01 if name.endswith(("mean", "step")) else 1e-6
        if ends_at_a_sample or name != "driver_torque_peak":
            assert getattr(out.metrics, name)[i] == pytest.approx(value, rel=0.01 * times, abs=least), name
    count = len(reference.states)
    names = "assist_state", "authority", "driver_torque", "assist_torque", "t"
    states, authority, driver, assist, t = (at_samples(out, i, name)[:count] for name in names)
    np.testing.assert_array_equal(states, reference.states)
    np.testing.assert_allclose(authority, reference.authority, rtol=0, atol=1e-9)
    before = t <= reference.T + 1e-9
    for found, expected_torque in ((driver, reference.torque[:, 0, 0]), (assist, reference.torque[:, 0, 1])):
        most = 0.01 * np.abs(expected_torque).max()
        np.testing.assert_allclose(found[before], expected_torque[before], rtol=0, atol=most)


def at_samples(out: Outcome, i: int, name: str) -> np.ndarray:
    """A path of scenario i without the row at T, where that is no sample."""
    after = (out.trajectories.t[i] - out.trajectories.t[i, 0]) / DT
    rows = np.abs(after - np.round(after)) < 1e-7  # False for NaN
    _, first = np.unique(np.round(after[rows]), return_index=True)
    return np.asarray(getattr(out.trajectories, name)[i, rows][first])


# in closed form

STRAIGHT_ON = Scenarios.from_arrays(T=[3.0, 3.5], d_y=[0.3, 0.4], v_mean=[20.0, 25.0], side=[1, -1])
HELD = 0.004  # angle that is commanded [rad]
COMMAND = Stepped(Constant(), fault=lambda delta, _: np.full_like(delta, HELD))
STRONG = {"torque_max": 100.0, "override_torque": 100.0}
RATIO = 15.0


def at_the_end(options: PlantOptions) -> tuple[np.ndarray, ...]:
    """(steering angle at the trigger, at the end, and the driver's torque there) of `STRAIGHT_ON`."""
    out = run(COMMAND, options, STRAIGHT_ON)
    paths = out.trajectories
    last = (~np.isnan(paths.t)).sum(axis=1) - 1
    rows = np.arange(2)
    assert paths.driver_torque is not None
    return paths.delta[:, 0], paths.delta[rows, last], paths.driver_torque[rows, last]


def test_held_wheel_divides_as_the_stiffnesses() -> None:
    """A driver who holds on against a command that is held: the torque is that of the spring."""
    for k_d, k_a in ((15.0, 40.0), (30.0, 20.0)):
        g, stiffness = k_d / (k_a + k_d), {"assist_stiffness": k_a, **STRONG}
        for driver in (
            Driver(straight=1.0, grip=(g, g), **stiffness),
            Driver(model="arms", straight=1.0, stiffness=(k_d, k_d), **stiffness),
        ):
            before, after, torque = at_the_end(PlantOptions(driver=driver))
            np.testing.assert_allclose(after, (k_a * HELD + k_d * before) / (k_a + k_d), rtol=1e-4)
            np.testing.assert_allclose(torque, k_d * RATIO * (before - after), rtol=1e-3)


def test_assist_at_its_limit_holds_against_arms_and_tyres() -> None:
    """The arms, the aligning torque of a steady turn, and all the torque that the assist has are in balance."""
    k_d, most, trail, boost = 20.0, 0.6, 0.08, 0.3
    limits = {"torque_max": most, "override_torque": 100.0}
    v, m, l_f, l_r, C = STRAIGHT_ON.v_mean, 1000.0, 1.43, 1.47, 80000.0
    per_a_y = (l_f + l_r) / v**2 + m * (l_r - l_f) / (2.0 * C * (l_f + l_r))  # steering angle of a turn
    arms = Driver(
        model="arms", straight=1.0, stiffness=(k_d, k_d), trail=trail, boost=boost, wheel_damping=3.0, **limits
    )
    before, after, torque = at_the_end(PlantOptions(driver=arms))
    aligning = (1.0 - boost) * trail / RATIO * m * l_r / (l_f + l_r) / per_a_y
    np.testing.assert_allclose(after, (k_d * RATIO * before + most) / (k_d * RATIO + aligning), rtol=1e-4)
    np.testing.assert_allclose(torque, k_d * RATIO * (before - after), rtol=1e-3)

    g, k_a = 1.0 / 3.0, 40.0
    before, after, torque = at_the_end(
        PlantOptions(driver=Driver(straight=1.0, grip=(g, g), assist_stiffness=k_a, **limits))
    )
    np.testing.assert_allclose(after - before, (1.0 - g) / g * most / (k_a * RATIO), rtol=1e-6)
    np.testing.assert_allclose(torque, -most, rtol=1e-12)


BEYOND = Stepped(Constant(), fault=lambda delta, _: np.full_like(delta, 0.02))
CAUTIOUS = Driver(straight=1.0, grip=(0.4, 0.4), assist_stiffness=60.0, torque_max=4.0, ramp=0.3, return_after=0.25)


@pytest.mark.parametrize("samples", [1, 5, 6, 10])
def test_assist_leaves_within_its_ramp_and_comes_back(samples: int) -> None:
    """Torque beyond the limit at samples 1 to 4 is 0.2 s; it is gone so many samples later, and after five without
    torque, the one of the release among them, the assist rises again."""
    driver = dataclasses.replace(CAUTIOUS, ramp=samples * DT)
    out, end = run(BEYOND, PlantOptions(driver=driver), STRAIGHT_ON), 4 + samples
    active, overridden, released = AssistState.ACTIVE, AssistState.OVERRIDDEN, AssistState.RELEASED
    for i in range(2):
        state, authority, torque = (at_samples(out, i, name) for name in ("assist_state", "authority", "assist_torque"))
        assert state[: end + 6].tolist() == [active] * 4 + [overridden] * samples + [released] * 4 + [active] * 2
        fall = 1.0 - np.arange(samples + 1) / samples
        np.testing.assert_allclose(authority[: end + 5], [*np.ones(4), *fall, *np.zeros(4)], rtol=0, atol=1e-12)
        assert authority[end + 5] == pytest.approx(1.0 / samples)
        np.testing.assert_allclose(torque[4 : end + 1], 4.0 * fall, rtol=1e-9, atol=1e-12)
        assert (torque[end + 1 : end + 5] == 0.0).all()
        assert torque[end + 5] > 0.1
    assert (out.metrics.overridden == 1.0).all()
    np.testing.assert_allclose(out.metrics.handover_step, 4.0 * min(1.0, 2.0 / samples), rtol=1e-9)


def test_driver_keeps_the_wheel_after_an_override() -> None:
    """What held the turn at the trigger holds it again, at once or as arms and tyres come to rest."""
    once = dataclasses.replace(CAUTIOUS, return_after=0.0)
    gone = run(BEYOND, PlantOptions(driver=once), STRAIGHT_ON)
    assert (gone.assist_state == AssistState.RELEASED).all()
    held = gone.trajectories.delta[0]
    np.testing.assert_allclose(held[np.isfinite(held)][-1], held[0], rtol=1e-6)
    arms = Driver(model="arms", straight=1.0, stiffness=(40.0, 40.0), ramp=0.0, override_time=0.0)
    gone = run(BEYOND, PlantOptions(driver=arms), STRAIGHT_ON)
    assert (gone.assist_state == AssistState.RELEASED).all()
    for i in range(2):
        held, torque = at_samples(gone, i, "delta"), at_samples(gone, i, "assist_torque")
        np.testing.assert_allclose(held[-1], held[0], rtol=1e-3)
        assert (torque[-20:] == 0.0).all()


def test_no_grip_is_the_plant_without_a_driver() -> None:
    """To the bit, but for the metrics of the driver, which are zero."""
    scenarios = with_residuals(make_scenarios(60, seed=8))
    everything = {**EVERYTHING, "tyres": Tyres(model="magic_formula"), "residuals": Residuals(y=True, v=True)}
    for more in ({}, {"actuator": STEERING}, everything):
        for law in (LQR(r_delta=100.0), Stepped(LQR(r_delta=100.0), drops=True)):
            alone, driven = (
                run(law, PlantOptions(driver=driver, **more), scenarios)
                for driver in (Driver(), Driver(grip=(0.0, 0.0), **ALL))
            )
            assert alone.triggered.sum() > 30
            assert_same_bits(driven.S, alone.S)
            for name in METRICS:
                assert_same_bits(getattr(driven.metrics, name), getattr(alone.metrics, name), name)
            for name in ("t", "x", "delta", "a_y"):
                assert_same_bits(getattr(driven.trajectories, name), getattr(alone.trajectories, name), name)
            for name in DRIVER_METRICS:
                assert np.isnan(getattr(alone.metrics, name)).all()
                assert (getattr(driven.metrics, name)[driven.status == 0] == 0.0).all(), name
            assert alone.assist_state is None


ON_THE_PATH = {
    "linear": PlantOptions(),
    "magic formula": PlantOptions(tyres=MAGIC),
    "profile, lag": PlantOptions(speed="profile", actuator=Actuator(lag=0.1)),
    "residuals": PlantOptions(residuals=RESIDUALS),
    "everything": PlantOptions(**EVERYTHING),
}


@pytest.mark.parametrize("case", some(ON_THE_PATH, "linear", "everything"))
def test_driver_with_all_the_grip_stays_on_the_recorded_path(case: str) -> None:
    """Within 1 mm up to T, whatever the assist commands."""
    scenarios, driver = departures(40), Driver(recorded=1.0, grip=(1.0, 1.0))
    out = run(LQR(r_delta=100.0), dataclasses.replace(ON_THE_PATH[case], driver=driver), scenarios)
    paths = out.trajectories
    off = np.abs(paths.x[:, :, 0] - paths.path.lateral(np.nan_to_num(paths.t)) - 0.85)
    assert out.triggered.all()
    assert np.nanmax(np.where(paths.t <= scenarios.T[:, None] + 1e-9, off, 0.0)) < 1e-3
    np.testing.assert_allclose(out.S, out.S_uncorrected, rtol=0, atol=2e-3)


def test_residual_of_the_path_is_not_steered() -> None:
    """With all the grip, the way is that of the fitted path from where the vehicle is at the trigger, within 1 mm."""
    scenarios, driver = departures(40), Driver(recorded=1.0, grip=(1.0, 1.0))
    out = run(LQR(r_delta=100.0), PlantOptions(driver=driver, residuals=Residuals(y=True)), scenarios)
    paths, rows = out.trajectories, np.flatnonzero(out.triggered)
    t = np.nan_to_num(paths.t)
    off = paths.x[:, :, 0] - UncorrectedPath.of(scenarios, Residuals(), SEED).lateral(t) - 0.85
    off = np.where(t <= scenarios.T[:, None], off - off[:, :1], 0.0)[rows]
    assert rows.size > 30
    assert np.nanmax(np.abs(off)) < 1e-3
    assert np.abs(paths.x[rows, 0, 0] - paths.path.lateral(out.t_s[:, None])[rows, 0] - 0.85).max() < 1e-12


def test_stiffer_arms_leave_the_assist_less() -> None:
    """Each departure lasts longer beyond its line, the stiffer the arms that steer on along the recorded path, and ends
    at the recorded score."""
    scenarios, law = departures(40), LQR(r_delta=1000.0)
    alone = run(law, PlantOptions(), scenarios)
    helped = alone.S_uncorrected - alone.S > 0.05
    assert helped.sum() > 30
    none, ends = {"inertia": 0.0, "damping": 0.0}, []
    for stiffer in (
        [Driver(recorded=1.0, grip=(g, g), **STRONG) for g in (0.0, 0.1, 0.3, 0.6, 0.9, 1.0)],
        [Driver(model="arms", recorded=1.0, stiffness=(k, k), **STRONG, **none) for k in (0.0, 5.0, 20.0, 80.0, 400.0)],
    ):
        scores = np.array([run(law, PlantOptions(driver=driver), scenarios).S for driver in stiffer])
        assert (np.diff(scores[:, helped], axis=0) > 0.0).all()
        assert (scores[-1, helped] < alone.S_uncorrected[helped] + 2e-3).all()
        ends.append(scores)
    np.testing.assert_allclose(ends[0][0], alone.S, rtol=1e-5)


@pytest.mark.parametrize("model", ["grip", "arms"])
def test_mirrored_departures_are_mirrored(model: str) -> None:
    """The frame is outward: the bits are the same on the other side, with the curvature that is outward there."""
    scenarios = departures(30)
    other = dataclasses.replace(scenarios, side=-scenarios.side)
    options = PlantOptions(
        driver=dataclasses.replace(GRIP if model == "grip" else ARMS, **BACK), speed="profile", actuator=STEERING,
        tyres=MAGIC, residuals=RESIDUALS,
    )  # fmt: skip
    one, mirrored = (run(PreviewProportional(), options, each) for each in (scenarios, other))
    assert_same_rows(mirrored, one)
    for name in ("x", "delta", "driver_torque", "assist_torque", "authority", "assist_state"):
        assert_same_bits(getattr(mirrored.trajectories, name), getattr(one.trajectories, name), name)


def test_intents_are_drawn_by_their_shares() -> None:
    """The same departure, the same driver, whatever the other ranges are; each intent as if it were the only one."""
    scenarios = departures(40)
    shares = {"straight": 0.25, "against": 0.5, "returns": 0.25}
    mixed = run(PreviewProportional(), PlantOptions(driver=Driver(**shares)), scenarios)
    intents = np.array([Person.drawn(Driver(**shares), SEED, scenarios.index, i).intent for i in range(40)])
    for intent, share in shares.items():
        rows = np.flatnonzero(intents == intent)
        assert abs(rows.size / 40 - share) < 0.2
        alone = run(PreviewProportional(), PlantOptions(driver=Driver(**{intent: 1.0})), scenarios)
        assert_same_rows(mixed, alone, rows, rows)


def test_driver_and_vehicle_model_are_refused() -> None:
    with refused("driver", value=GRIP, allowed=""):
        Setup(vehicle_model=Bicycle(), options=PlantOptions(driver=GRIP))
