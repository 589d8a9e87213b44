"""Every solver call of a run, under the scenario and the sample that it was made for."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

import numpy as np
import pytest

from controllers import LQR, BarrierFilter, LinearMPC
from ldctoolkit import Controller, EventStatus, Plant, Preview, Scenarios, SolverCalls, SteeringLaw, simulate
from ldctoolkit.errors import InputError

SCENARIOS = Scenarios.from_arrays(
    T=[2.0, 4.0, 0.6, 3.0, 1.0], d_y=[0.3, 0.05, 0.5, 0.2, 0.6], v_mean=[30.0, 25.0, 20.0, 15.0, 35.0], c_0=0.0
)


@dataclasses.dataclass(frozen=True)
class Counting(Controller):
    """Steers a little; says that it solved for every second scenario of its batch."""

    name: ClassVar[str] = "counting"
    title: ClassVar[str] = "Counting"
    wrong: Any = None

    def prepare(self, plant: Plant) -> SteeringLaw:
        return CountingLaw(np.arange(plant.n), self.wrong)


@dataclasses.dataclass(frozen=True)
class CountingLaw(SteeringLaw):
    number: np.ndarray
    wrong: Any

    @property
    def preview_times(self) -> np.ndarray:
        return np.zeros(0)

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
    out = simulate(Counting(), SCENARIOS, y_s=0.1, dt=0.1, settle=0.5)
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
    one = simulate(law, SCENARIOS, y_s=0.1).solver_log
    other = simulate(law, SCENARIOS.take(order), y_s=0.1).solver_log.renamed(order)
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(other, field.name), getattr(one, field.name))


def test_a_law_without_a_solver_has_an_empty_log() -> None:
    log = simulate(LQR(r_delta=100.0), SCENARIOS).solver_log
    assert all(getattr(log, field.name).size == 0 for field in dataclasses.fields(log))


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ([1, 2], "solver_calls returned"),
        (SolverCalls(np.array([0]), *(np.zeros(2),) * 4), "status"),
        (SolverCalls(np.array([99]), *(np.zeros(1),) * 4), "place holds"),
    ],
)
def test_what_is_no_record_is_named(wrong: Any, words: str) -> None:
    with pytest.raises(InputError, match=words):
        simulate(Counting(wrong=wrong), SCENARIOS, y_s=0.1)
