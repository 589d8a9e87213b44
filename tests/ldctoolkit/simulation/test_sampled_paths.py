"""Paths as designers' metrics see them, the values of these, and their contract test."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import ldctoolkit as ldc
from ldctoolkit import Actuator, EventStatus, LdcError, Paths, PlantOptions, Scenarios, Setup
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import UserMetric
from ldctoolkit.scenarios import Scenarios as AnyScenarios
from ldctoolkit.simulation import Run, Takeover, drive, drive_many
from ldctoolkit.simulation.sampled_paths import PathSampler
from ldctoolkit.testing import ContractError, check_metric

SCENARIOS = Scenarios.from_arrays(
    T=[3.02, 4.0, 2.5, 9.0, 3.02, 4.0], d_y=[0.5, 0.6, 0.1, 0.4, 0.5, 0.5], v_mean=[25.0, 18.0, 30.0, 22.0, 25.0, 20.0],
    a_mean=[0.5, 0.0, 0.0, -0.3, 0.5, 0.0], c_0=[1e-3, 0.0, 0.0, -5e-4, 1e-3, 0.0], side=[1, 1, 1, -1, -1, 1],
)  # fmt: skip
NEVER, INVALID = 2, 5
SCENARIOS = dataclasses.replace(SCENARIOS, v_mean=np.where(np.arange(6) == INVALID, np.nan, SCENARIOS.v_mean))
SETUPS = [Setup(), Setup(options=PlantOptions(speed="profile", actuator=Actuator(lag=0.2, delay=0.1)))]


@ldc.metric(unit="m", over="all")
def depth_of(paths: Paths) -> Any:
    return np.nanmax(np.where(paths.t <= paths.T[:, None], -paths.distance, np.nan), axis=1)


@ldc.metric(unit="s", better="more", over="all")
def last(paths: Paths) -> Any:
    return np.nanmax(paths.t, axis=1)


def sampled(
    law: ldc.Controller, setup: Setup = SETUPS[0], scenarios: AnyScenarios = SCENARIOS, *metrics: UserMetric
) -> tuple[Takeover, Run, dict[int, Paths], Any]:
    """Takeover and run of a law, the path of each scenario that can be driven, and the values of the metrics."""
    over = Takeover.build(scenarios, setup, y_s=0.2)
    sampler = PathSampler(over, metrics)
    (run,) = drive_many([law], over, paths=True, threads=1)
    each = {int(row): paths.take([i]) for rows, paths in sampler.parts(run) for i, row in enumerate(rows)}
    return over, run, each, sampler.values(run)


@pytest.mark.parametrize("law", [ldc.LQR(), ldc.PID()], ids=["linear", "general"])
@pytest.mark.parametrize("setup", SETUPS, ids=["ideal", "lag"])
def test_paths_are_the_recorded_ones_then_those_of_the_run(law: ldc.Controller, setup: Setup) -> None:
    over, _, each, _ = sampled(law, setup)
    driven = drive(law, over, trajectories=True, threads=1).trajectories
    assert driven is not None
    assert sorted(each) == [0, 1, 2, 3, 4]
    for row in (0, 1, 3, 4):
        paths, t_s = each[row], over.t_s[row]
        t, before = paths.t[0], paths.t[0] < t_s - 1e-9
        count = int(np.isfinite(t).sum())
        assert np.isnan(t[count:]).all()
        np.testing.assert_allclose(np.diff(t[:count]), 0.05, rtol=0, atol=1e-12)
        assert 0.0 <= t[0] < 0.05
        np.testing.assert_array_equal(paths.controlled[0][:count], ~before[:count])
        times = t[None, before]
        path = over.path.take([row])
        np.testing.assert_allclose(paths.e_y[0, before], path.lateral(times)[0] + 0.85, rtol=0, atol=1e-12)
        np.testing.assert_allclose(paths.e_y_rate[0, before], path.lateral_rate(times)[0], rtol=0, atol=1e-12)
        a_y = path.lateral_acceleration(times) + path.speed(times) ** 2 * path.curvature(times)
        np.testing.assert_allclose(paths.a_y[0, before], a_y[0], rtol=0, atol=1e-12)
        # every sample of the run but T itself, which lies between two, and a last shorter step
        on_grid = np.abs((driven.t[row] - t_s) / 0.05 - np.rint((driven.t[row] - t_s) / 0.05)) < 1e-6
        np.testing.assert_allclose(t[:count][~before[:count]], driven.t[row][on_grid], rtol=0, atol=1e-9)
        for name, column in (("e_y", 0), ("e_y_rate", 1), ("e_psi", 2), ("e_psi_rate", 3)):
            values = getattr(paths, name)[0, :count][~before[:count]]
            np.testing.assert_array_equal(values, driven.x[row][on_grid][:, column])
        for name in ("delta", "a_y"):
            values = getattr(paths, name)[0, :count][~before[:count]]
            np.testing.assert_array_equal(values, getattr(driven, name)[row][on_grid])
        v = path.speed(t[None, :count])[0]
        if setup.options.speed == "frozen":
            v = np.where(before[:count], v, path.speed(np.array([[t_s]]))[0])
        np.testing.assert_allclose(paths.v[0, :count], v, rtol=0, atol=1e-12)
        np.testing.assert_allclose(paths.curvature[0, :count], path.curvature(t[None, :count])[0], rtol=0, atol=1e-15)
        to_T = t <= paths.T[0]
        recorded = path.lateral(t[None, to_T])[0] + 0.85
        np.testing.assert_allclose(paths.e_y_recorded[0, to_T], recorded, rtol=0, atol=1e-12)
        assert np.isnan(paths.e_y_recorded[0, ~to_T]).all()
        assert np.isfinite(paths.command[0, :count]).all()
    same = dataclasses.replace(each[4], side=each[0].side)
    for field in dataclasses.fields(Paths):  # right as left, in the outward frame
        np.testing.assert_array_equal(getattr(same, field.name), getattr(each[0], field.name))


def test_what_is_commanded_differs_from_the_wheel_behind_a_lag() -> None:
    for setup, same in zip(SETUPS, (True, False), strict=True):
        _, _, each, _ = sampled(ldc.LQR(), setup)
        paths = each[1]
        steered = paths.controlled[0] & np.isfinite(paths.t[0])
        steered[np.flatnonzero(steered)[-1]] = False  # the last sample has no command of its own
        assert np.array_equal(paths.command[0, steered], paths.delta[0, steered]) == same
    # a lag of the first order between the samples once a delay of two samples has passed
    k = np.flatnonzero(steered)[4:40]
    expected = paths.command[0, k - 2] + (paths.delta[0, k] - paths.command[0, k - 2]) * np.exp(-0.05 / 0.2)
    np.testing.assert_allclose(paths.delta[0, k + 1], expected, rtol=0, atol=1e-9)


def test_departures_without_an_intervention_and_without_control() -> None:
    over, _, each, (depth, end) = sampled(ldc.LQR(), SETUPS[0], SCENARIOS, depth_of, last)
    assert each[NEVER].t_s[0] == np.inf
    assert not each[NEVER].controlled.any()
    assert end[NEVER] == pytest.approx(2.5)
    assert depth[NEVER] == pytest.approx(0.1, abs=1e-3)
    assert np.isnan(depth[INVALID])
    np.testing.assert_allclose(end[:2], [3.02 + 3.0, 4.0 + 3.0], rtol=0, atol=0.05)  # with the settling horizon
    sampler = PathSampler(over, (depth_of, last))
    (run,) = drive_many([ldc.NoControl()], over, paths=True)
    without, ends = sampler.values(run)
    np.testing.assert_allclose(without[:5], over.recorded.deepest[:5], rtol=0, atol=1e-3)
    np.testing.assert_allclose(ends[:5], SCENARIOS.T[:5], rtol=0, atol=0.05)
    assert list(sampler.parts(run)) == []


class Away(ldc.LQR):
    """Steers off the road."""

    name = "away"

    def prepare(self, plant: ldc.Plant) -> ldc.LinearLaw:
        law = super().prepare(plant)
        assert isinstance(law, ldc.LinearLaw)
        return dataclasses.replace(law, F=-law.F)


def test_a_departure_that_diverged_is_no_better_than_its_recorded_path() -> None:
    over, run, each, (depth, end) = sampled(Away(), SETUPS[0], SCENARIOS, depth_of, last)
    diverged = over.rows[run.status == EventStatus.DIVERGED]
    assert diverged.size
    for row in diverged.tolist():
        paths = each[row]
        lasts = int(np.flatnonzero(np.isfinite(paths.e_y[0]))[-1])
        for name in ("t", "e_y", "v", "curvature", "command", "a_y"):
            assert np.isnan(getattr(paths, name)[0, lasts + 1 :]).all()
            assert np.isfinite(getattr(paths, name)[0, : lasts + 1]).all()
        # more is better of `last`: the smaller of where it ended, and T; less of `deepest`: the larger
        recorded_end = np.floor(SCENARIOS.T[row] / 0.05 + 1e-9) * 0.05
        assert end[row] == pytest.approx(min(paths.t[0, lasts], recorded_end))
        assert depth[row] >= over.recorded.deepest[row] - 1e-3


@pytest.mark.parametrize("setup", SETUPS, ids=["ideal", "lag"])
def test_no_number_depends_on_the_other_departures(setup: Setup) -> None:
    _, _, _, together = sampled(ldc.LQR(), setup, SCENARIOS, depth_of, last)
    for order in ([4, 3, 2, 1, 0], [3], [0, 2], [2], [INVALID], []):
        _, _, _, some = sampled(ldc.LQR(), setup, SCENARIOS.take(order), depth_of, last)
        np.testing.assert_array_equal(some, together[:, order])


def wrong(function: Callable[[Paths], Any]) -> UserMetric:
    return ldc.metric(unit="s")(function)


def raises(paths: Paths) -> Any:
    raise ZeroDivisionError("no such thing")


def writes(paths: Paths) -> Any:
    paths.e_y[:] = 0.0
    return paths.T


@pytest.mark.parametrize(
    "function",
    [
        raises,
        writes,
        lambda p: p.e_y,
        lambda p: 1.0,
        lambda p: None,
        lambda p: np.array(["a"] * p.n),
        lambda p: p.T[1:],
    ],
)
def test_a_wrong_metric_is_named(function: Any) -> None:
    function.__name__ = "strange"
    with pytest.raises(LdcError) as caught:
        sampled(ldc.LQR(), SETUPS[0], SCENARIOS, wrong(function))
    assert caught.value.path == "metric strange"
    with pytest.raises(ContractError) as contract:
        check_metric(wrong(function))
    assert {(fault.design, fault.check) for fault in contract.value.faults} == {("strange", "values")}


COUNTED = [0]


def counts(paths: Paths) -> Any:
    COUNTED[0] += 1
    return np.full(paths.n, float(COUNTED[0]))


@pytest.mark.parametrize(
    ("function", "checks"),
    [
        (lambda p: np.nanmax(p.e_y, axis=1), set()),
        (lambda p: np.nanmax(p.e_y, axis=1) - np.nanmean(p.e_y), {"alone"}),
        (lambda p: p.side * 1.0, {"side"}),
        (lambda p: p.T > 2.0, set()),
        (lambda p: np.max(p.e_y, axis=1), {"known"}),
        (lambda p: np.arange(p.n), {"neighbours", "alone"}),
        (counts, {"repeated", "neighbours", "alone", "side", "worker"}),
    ],
)
def test_the_contract(function: Any, checks: set[str]) -> None:
    function.__name__ = "tried"
    if not checks:
        check_metric(wrong(function))
        return
    with pytest.raises(ContractError) as caught:
        check_metric(wrong(function))
    assert {fault.check for fault in caught.value.faults} >= checks - {"worker"}
    assert "known" not in {fault.check for fault in caught.value.faults} or "known" in checks


def test_the_contract_is_about_metrics_alone() -> None:
    with pytest.raises(InputError):
        check_metric(counts)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("S", {}), ("deepest", {}), ("a_y_peak", {}), ("effort", {}), ("ay", {"better": "most"}),
        ("mine", {"over": "some"}), ("mine", {"unit": 3}), ("mine", {"title": None}),
    ],
)  # fmt: skip
def test_a_metric_is_declared_well_or_not_at_all(name: str, arguments: dict[str, Any]) -> None:
    def function(paths: Paths) -> Any:
        return paths.T

    function.__name__ = name
    with pytest.raises(InputError):
        ldc.metric(**{"unit": "s"} | arguments)(function)
