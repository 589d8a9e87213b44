"""Masked entries are missing, wherever arrays come in; arrays of frozen values cannot be written to."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from helpers.models import varied_departures
from ldctoolkit import (
    BicycleModel,
    BoundedGaussianMixture,
    LinearLaw,
    Plant,
    Scenarios,
    rebuild_signals,
    reduce_signals,
    simulate,
)
from ldctoolkit.controllers import LQR
from ldctoolkit.errors import LdcError
from ldctoolkit.mixture.truncated_normal import TruncatedNormal
from ldctoolkit.recordings import Recording
from ldctoolkit.scenario_model import fit_scenario_model

SOME = Scenarios.from_arrays(T=[3.0, 4.0, 5.0], d_y=[0.4, 0.5, 0.6], v_mean=[25.0, 18.0, 30.0], side=[1, -1, 1])
TABLE = varied_departures(40)
ROWS = np.random.default_rng(0).normal(size=(60, 2))


def masked(values: Any, index: int = 1) -> Any:
    return np.ma.masked_array(values, mask=np.arange(np.size(values)).reshape(np.shape(values)) == index)


def drifts(**given: Any) -> Scenarios:
    defaults = {"v": 20.0, "lateral_velocity": 0.5, "radius": 1200.0, "distance": 1.1, "T": [8.0, 8.0]}
    return Scenarios.from_drifts(**(defaults | given))


class _Half(LQR):
    """A law with a masked gain."""

    def prepare(self, plant: Plant) -> LinearLaw:
        return LinearLaw(masked(np.tile([-0.02, 0.0, -0.3, 0.0], (plant.n, 1))))


BOX = {"lower": [-9.0, -9.0], "upper": [9.0, 9.0]}


@pytest.mark.parametrize(
    ("call", "path"),
    [
        (lambda: Scenarios.from_arrays(T=masked([3.0, 4.0]), d_y=0.4, v_mean=25.0), "scenarios.T[1]"),
        (lambda: Scenarios.from_arrays(T=3.0, d_y=0.4, v_mean=25.0, side=masked([1, -1])), "scenarios.side[1]"),
        (lambda: Scenarios.from_arrays(T=3.0, d_y=0.4, v_mean=25.0, side=masked(["left", "right"])),
         "scenarios.side[1]"),
        (lambda: drifts(radius=masked([600.0, 600.0])), "scenarios.radius[1]"),
        (lambda: Scenarios.from_departures(dataclasses.replace(SOME, c_0=masked(SOME.c_0))), "scenarios.c_0[1]"),
        (lambda: reduce_signals(rebuild_signals(SOME, 0.1), masked([1, -1, 1])), "side"),
        (lambda: simulate(LQR(), SOME, trajectories=masked([0, 1])), "trajectories"),
        (lambda: simulate(_Half(), SOME, 0.1), "controller 'lqr': F"),
        (lambda: fit_scenario_model(dataclasses.replace(TABLE, d_y=masked(TABLE.d_y)), components=1),
         "departures (left): d_y"),
        (lambda: fit_scenario_model(TABLE, components=1, weights=masked(np.ones(TABLE.n))), "weights: departure 1"),
        (lambda: BoundedGaussianMixture(1, **BOX).fit(masked(ROWS)), "X: column 1, row 0"),
        (lambda: BoundedGaussianMixture(1, **BOX).fit(ROWS, sample_weight=masked(np.ones(60))),
         "sample_weight: row 1"),
        (lambda: TruncatedNormal(masked([[0.0, 0.0]]), [np.eye(2)], *BOX.values()), "truncated normal"),
        (lambda: Plant.build(BicycleModel(), masked([20.0, 30.0]), 0.05), "v[1]"),
        (lambda: Recording("a", masked(np.arange(3.0)), *[np.ones(3)] * 3, np.ones(3, bool)), "recording 'a'"),
    ],
)  # fmt: skip
def test_a_masked_entry_is_refused_as_nan_is(call: Any, path: str) -> None:
    with pytest.raises(LdcError) as caught:
        call()
    assert caught.value.path == path


def test_an_array_without_masked_entries_is_a_plain_one() -> None:
    scenarios = Scenarios.from_arrays(T=np.ma.masked_array(SOME.T), d_y=SOME.d_y, v_mean=SOME.v_mean, side=SOME.side)
    assert type(scenarios.T) is np.ndarray
    np.testing.assert_array_equal(scenarios.T, SOME.T)


def test_masked_samples_of_a_recording_are_missing() -> None:
    recording = Recording("a", np.arange(3.0), masked(np.ones(3)), *[np.ones(3)] * 2, masked(np.ones(3, bool), 2))
    assert np.isnan(recording.lane_offset).tolist() == [False, True, False]
    assert recording.valid.tolist() == [True, True, False]


def holders() -> dict[str, Any]:
    outcome = simulate(LQR(), SOME, 0.1, trajectories=True)
    return {
        "scenarios": SOME, "taken": SOME.take([0, 2]), "departures": TABLE, "signals": rebuild_signals(SOME, 0.1),
        "drifts": drifts().drift, "outcome": outcome, "metrics": outcome.metrics,
        "trajectories": outcome.trajectories,
        "recording": Recording("a", np.arange(3.0), *[np.ones(3)] * 3, np.ones(3, bool)),
    }  # fmt: skip


@pytest.mark.parametrize("name", holders())
def test_arrays_of_frozen_values_cannot_be_written_to(name: str) -> None:
    value = holders()[name]
    arrays = [a for f in dataclasses.fields(value) if isinstance(a := getattr(value, f.name), np.ndarray) and a.size]
    assert arrays
    for array in arrays:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]


def test_the_callers_own_arrays_stay_writable_and_the_scenarios_as_they_were() -> None:
    T = np.array([3.0, 4.0])
    scenarios = Scenarios.from_arrays(T=T, d_y=0.4, v_mean=25.0)
    t = np.arange(3.0)
    Recording("a", t, *[np.ones(3)] * 3, np.ones(3, bool))
    T[0] = t[0] = -1.0
    assert scenarios.T.tolist() == [3.0, 4.0]
