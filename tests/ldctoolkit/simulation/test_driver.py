"""A driver at the wheel, against an independent integration of column, arms and assist, and in closed form."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers import reference_driver, reference_loop
from helpers.bits import assert_same_bits
from helpers.closed_loop import (
    METRICS,
    Constant,
    Stepped,
    assert_same_rows,
    assert_within_the_bound,
    make_scenarios,
    some,
    with_residuals,
)
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
RESIDUALS = Residuals(y=True, v=True)
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
    """To both sides and in bends, with at most half of the friction of `MAGIC`; every other ends at a sample."""
    rng = np.random.default_rng(seed)
    v, d_y, side = rng.uniform(8.0, 40.0, n), rng.uniform(0.15, 0.6, n), rng.choice([-1, 1], n)
    share = 0.5 * (1.0 + np.sqrt(1.0 - Y_S / d_y))  # of the departure that is after the trigger, at constant speed
    T, at_a_sample = np.sqrt(8.0 * d_y / rng.uniform(0.3, 1.2, n)), np.arange(n) % 2 == 0
    T = np.where(at_a_sample, np.round(T * share / DT) * DT / share, T)
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


def at_T(scenarios: Scenarios, out: Outcome, i: int) -> bool:
    """A sample is at T: nothing is recorded from there on."""
    after = (scenarios.T[i] - out.t_s[i]) / DT
    return abs(after - round(after)) < 1e-9


QUICK = ("grip", "arms", "grip, everything", "arms, everything")


@pytest.mark.parametrize(
    ("case", "n"), [*((case, 6) for case in QUICK), *(pytest.param(case, 40, marks=pytest.mark.slow) for case in CASES)]
)
def test_random_departures_equal_the_reference(case: str, n: int) -> None:
    """S within 1e-4, the largest torque within 1 %; half of them under each law. Where a torque at a sample comes within
    0.01 % of the limit, either may be said to have overridden the assist."""
    options, scenarios, compared = CASES[case], departures(n), 0
    over = Takeover.build(scenarios, Setup(options=options, seed=SEED), y_s=Y_S)
    for parity, design in enumerate((LQR(r_delta=3000.0), PreviewProportional())):
        law, out = design.prepare(over.plant), run(design, options, scenarios)
        for j in np.flatnonzero(over.rows // 2 % 2 == parity):
            i = int(over.rows[j])
            reference = expected(scenarios, options, i, reference_loop.of_row(law, j))
            if reference.margin > 1e-4:
                assert_same(out, i, reference)
                compared += 1
    assert compared > 0.8 * n


def assert_same(out: Outcome, i: int, reference: Driven) -> None:
    assert out.S[i] == pytest.approx(reference.S, rel=1e-4, abs=1e-4)
    assert out.metrics.driver_torque_peak[i] == pytest.approx(reference.metrics["driver_torque_peak"], rel=0.01)
