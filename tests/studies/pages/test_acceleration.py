"""Against what the closed loop itself found, and against the linear model's matrices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from controllers import LQR, LinearMPC, PreviewProportional
from helpers.reports import invented_scenarios
from ldctoolkit import Controller, Setup
from ldctoolkit.plant_options import Actuator, Mismatch, PlantOptions, Residuals, Tyres
from ldctoolkit.simulation import Takeover, drive
from studies.pages.replay import path_acceleration

PLANTS = {
    "ideal": PlantOptions(),
    "profile": PlantOptions(speed="profile", residuals=Residuals(y=True, v=True)),
    "lag": PlantOptions(actuator=Actuator(lag=0.1, rate_max=0.5)),
    "whole delay": PlantOptions(actuator=Actuator(delay=0.1)),
    "part of a delay": PlantOptions(actuator=Actuator(delay=0.07)),
    "other vehicles": PlantOptions(mismatch=Mismatch(m=(0.8, 1.3), C_af=(0.7, 1.2))),
    "tyres": PlantOptions(
        tyres=Tyres(model="magic_formula", mu=0.5), speed="profile", mismatch=Mismatch(mu=(0.6, 1.0))
    ),
}


def driven(controller: Controller, options: PlantOptions, convention: str = "consistent"):  # type: ignore[no-untyped-def]
    scenarios = invented_scenarios(8, 7)
    scenarios = dataclasses.replace(scenarios, sigma_y=np.full(15, 0.02), sigma_v=np.full(15, 0.2))
    setup = Setup(convention=convention, options=options, seed=3)  # type: ignore[arg-type]
    over = Takeover.build(scenarios, setup, y_s=0.05)
    run = drive(controller, over, trajectories=True)
    kept = run.trajectories
    assert kept is not None
    paths = kept.t[over.rows], kept.x[over.rows], kept.delta[over.rows]
    return over, run, paths, path_acceleration(over, np.arange(over.m), *paths)


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("controller", [LQR(r_delta=100.0), LinearMPC(r_delta=100.0)], ids=["linear", "steps"])
def test_the_largest_is_the_stored_peak(plant: str, controller: Controller) -> None:
    over, run, (t, _, _), a_y = driven(controller, PLANTS[plant])
    assert over.m > 8
    # T between two samples is no sample of the closed loop: its peak leaves it out, so ours may only be larger there
    since = (t - t[:, :1]) / over.setup.dt
    last = t == np.nanmax(t, axis=1, keepdims=True)
    sample = (np.abs(since - np.rint(since)) < 1e-7) | last
    peak = np.nanmax(np.where(sample, np.abs(a_y), np.nan), axis=1)
    stored = run.companions.a_y_peak
    # up to the rounding of another order of operations; where the wheel jumps at a sample, the loop sees both sides
    assert (peak <= stored * (1 + 1e-9) + 1e-9).all()
    if plant in ("lag", "part of a delay"):
        assert peak == pytest.approx(stored, rel=1e-9, abs=1e-9)
    assert np.array_equal(np.isnan(a_y), np.isnan(t))


@pytest.mark.parametrize("convention", ["consistent", "as_printed"])
def test_it_is_that_of_the_linear_model(convention: str) -> None:
    over, _, (t, x, delta), a_y = driven(PreviewProportional(), PlantOptions(), convention)
    v = over.plant.v
    lane = v[:, None] * over.driven.curvature(np.where(np.isnan(t), 0.0, t))
    A, B, E = over.setup.model.matrices(v)
    # Rajamani, eq. 2.45, the row of d2e_y/dt2; a_y = d2e_y/dt2 + v dpsi_l/dt
    free = np.sum(A[:, None, 1] * np.nan_to_num(x), axis=-1) + (E[:, 1] + v)[:, None] * lane
    wheel = np.column_stack([delta[:, 0], delta])
    held = np.where(np.isnan(delta), wheel[:, :-1], delta)
    known = np.isfinite(t)
    assert a_y[known] == pytest.approx((free + B[:, 1:2] * held)[known], abs=1e-9)
