"""Small-signal margins of predictive controllers: their first move around straight driving as a linear law."""

import dataclasses
from typing import Any, ClassVar

import casadi as ca
import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.closed_loop import Prepared, make_scenarios
from ldctoolkit import BicycleModel, LinearSteps, Plant, PredictiveController, Preview, Soft, Stage, gain, simulate
from ldctoolkit.controllers import LQR, PID, LinearMPC, NonlinearMPC
from ldctoolkit.controllers._mpc_kernel import sweep
from ldctoolkit.plant_options import Actuator, PlantOptions, Sensors
from ldctoolkit.review import design_margins, review
from ldctoolkit.review.law_model import linear_view

MARGINS = ("radius", "gain_margin", "gain_reduction_margin", "phase_margin", "delay_margin", "disk_margin")
SPEEDS = (12.0, 25.0, 40.0)
R_DELTA = 3000.0
PLANTS = {
    "ideal": PlantOptions(),
    "delay": PlantOptions(actuator=Actuator(delay=0.1)),
    "camera": PlantOptions(sensors=Sensors(delay=0.1)),
}


@dataclasses.dataclass(frozen=True)
class Quadratic(PredictiveController):
    """The cost of the LQR on the linear bicycle; with a time constant also the wheels behind their lag."""

    name: ClassVar[str] = "quadratic"
    title: ClassVar[str] = "Quadratic"
    horizon: int = gain(8, unit="samples", lower=1, upper=100, description="prediction horizon")
    move_blocks: int = gain(0, unit="1", lower=0, upper=100, description="number of free moves")
    r: float = gain(R_DELTA, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on steering")
    tau: float = gain(0.08, unit="s", lower=0.01, upper=1.0, description="time constant")

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return vehicle.linear(x, u.delta, lane)

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        return Stage(
            x.e_y**2 + (x.e_psi - lane.steady_e_psi) ** 2 + self.r * (u.delta - lane.steady_delta) ** 2,
            hard=[(u.delta, -0.1, 0.1), (u.change, -0.01, 0.01)],
            soft=[Soft(x.jerk, -3.0, 3.0)],
        )


@dataclasses.dataclass(frozen=True)
class Lagging(Quadratic):
    """The same with the wheels' angle as a state."""

    states: ClassVar[tuple[str, ...]] = ("wheel",)

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return {**vehicle.linear(x, x.wheel, lane), "wheel": (u.delta - x.wheel) / self.tau}


@dataclasses.dataclass(frozen=True)
class Integrating(Quadratic):
    """With a leaking integral of e_y, and a cost of changes: the command before is a state, too."""

    states: ClassVar[tuple[str, ...]] = ("area",)
    hessian: ClassVar[str] = "gauss_newton"

    def dynamics(self, x: Any, u: Any, lane: Any, vehicle: Any) -> Any:
        return {**vehicle.nonlinear(x, u.delta, lane), "area": x.e_y - 0.1 * x.area}

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + x.e_psi**2 + 0.1 * x.area**2 + self.r * u.delta**2 + 1e4 * u.change**2
        return Stage(cost, soft=[Soft(x.a_y, -3.0, 3.0)])


@dataclasses.dataclass(frozen=True)
class Kinked(Quadratic):
    """Not linear at straight driving, in one of three ways, or with a kink elsewhere."""

    kind: str = ldc.option("none", choices=("none", "sided", "absolute", "hard", "soft"), description="where")

    def stage(self, x: Any, u: Any, lane: Any, k: Any) -> Stage:
        cost = x.e_y**2 + x.e_psi**2 + self.r * u.delta**2
        if self.kind == "sided":
            cost += ca.fmax(x.e_y, 0.0) ** 2
        if self.kind == "absolute":
            cost += 0.05 * ca.fabs(x.e_y - 0.05)
        hard = [(u.delta, 0.0 if self.kind == "hard" else -0.1, 0.1)]
        return Stage(cost, hard, [Soft(x.e_y, upper=0.0)] if self.kind == "soft" else [])

    def terminal(self, x: Any, lane: Any) -> Any:
        return 100.0 * x.e_y**2 + 100.0 * x.e_psi**2


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("design", [Quadratic(), LinearMPC(r_delta=R_DELTA, jerk_max=3.0)], ids=lambda d: d.name)
def test_a_quadratic_formulation_has_the_margins_of_its_lqr(name: str, design: Any) -> None:
    """Its limits are far; commands on their way, of which a delay of 0.1 s leaves two, count."""
    mpc, lqr = (review(d, options=PLANTS[name], speeds=SPEEDS).loop for d in (design, LQR(r_delta=R_DELTA)))
    for margin in MARGINS:
        np.testing.assert_allclose(getattr(mpc, margin), getattr(lqr, margin), rtol=1e-6, err_msg=margin)
    other = review(LQR(r_delta=1.01 * R_DELTA), options=PLANTS[name], speeds=SPEEDS).loop
    assert (abs(mpc.gain_margin / other.gain_margin - 1.0) > 1e-4).all()


def test_a_measured_wheel_counts_and_a_predicted_one_does_not() -> None:
    """Behind a lag the LQR and a formulation with the state `wheel` see it, `linear_mpc` predicts it: the same nominal
    poles, but the loop opened at the command differs."""
    lagging = PlantOptions(actuator=Actuator(lag=0.08, delay=0.05))
    seen, lqr, predicted = (
        review(d, options=lagging, speeds=SPEEDS).loop
        for d in (Lagging(), LQR(r_delta=R_DELTA), LinearMPC(r_delta=R_DELTA))
    )
    for margin in MARGINS:
        np.testing.assert_allclose(getattr(seen, margin), getattr(lqr, margin), rtol=1e-6, err_msg=margin)
    np.testing.assert_allclose(predicted.radius, lqr.radius, rtol=1e-9)
    assert (predicted.phase_margin < 0.98 * lqr.phase_margin).all()


@pytest.mark.parametrize(
    "design",
    [NonlinearMPC(horizon=8), Integrating(), Quadratic(move_blocks=3), LinearMPC(blocks=4, r_delta=R_DELTA)],
    ids=lambda d: d.name,
)
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_sensitivities_are_the_differences_of_steps(design: Any, delay: float) -> None:
    """The law's own solves after pulses of 1 mm and 0.1 mrad, and what its memory does later. Tolerance: tyres are not
    linear over a pulse."""
    plant = Plant.build(BicycleModel(), SPEEDS, 0.05, delay=delay)
    view = linear_view(design, plant)
    assert design.prepare(plant).linearised() is not None
    assert view.order == round(delay / 0.05) + isinstance(design, Integrating)
    assert (view.kink < 1e-5).all()
    assert (view.unexplained < 1e-5).all()


def test_pulses_start_when_a_law_knows_what_was_before() -> None:
    """At its first sample a law takes the command before for all commands on their way, of which a delay has several:
    the LQR's steps, probed, have the weights of the LQR."""
    plant = Plant.build(BicycleModel(), SPEEDS, 0.05, delay=0.15, lag=0.1)

    def steps(plant: Plant) -> LinearSteps:
        return dataclasses.replace(LinearSteps.of(LQR().prepare(plant), plant), measured=True)

    probed, exact = linear_view(Prepared(steps), plant), linear_view(LQR(), plant)
    z = np.exp(1j * np.array([0.1, 1.0, 3.0]))
    for a, b in zip(probed.models, exact.models, strict=True):
        for point in z:
            H, exactly = (m.D + m.C @ np.linalg.solve(point * np.eye(len(m.A)) - m.A, m.B) for m in (a, b))
            np.testing.assert_allclose(H, exactly, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("kind", "linear"), [("none", True), ("sided", False), ("absolute", True), ("hard", False),
                                              ("soft", False)])  # fmt: skip
def test_a_kink_at_straight_driving_has_a_sentence_and_no_margins(kind: str, linear: bool) -> None:
    design = Kinked(kind=kind)
    reviewed = review(design, speeds=SPEEDS)
    gain, phase = design_margins([design], ldc.Setup(), SPEEDS)
    kinks = [finding for finding in reviewed.findings if finding.name == "kink"]
    assert (reviewed.loop is not None) == linear == (not kinks)
    assert np.isfinite([gain, phase]).all() == linear
    assert np.isnan([gain, phase]).all() != linear
    if kinks:
        assert (kinks[0].severity, kinks[0].allowed) == ("warning", 0.02)
        assert kinks[0].value > 0.02


def test_a_review_compiles_nothing_that_a_drive_has_compiled() -> None:
    """Arrays of another layout, such as a column of a table, would have the kernel compiled once more."""
    simulate(LinearMPC(), make_scenarios(4))
    before = [*sweep.signatures]
    review(LinearMPC(r_delta=200.0), speeds=[20.0, 30.0])
    assert [*sweep.signatures] == before


def test_margins_of_a_formulation_for_rankings() -> None:
    """Their factor and angle, of formulation and LQR alike; other laws that call no solver have none."""
    gain, phase = design_margins([Quadratic(), LQR(r_delta=R_DELTA), PID()], ldc.Setup(options=PLANTS["delay"]), SPEEDS)
    np.testing.assert_allclose([gain[0], phase[0]], [gain[1], phase[1]], rtol=1e-6)
    assert (gain[0] > 1.0).all()
    assert np.isnan([gain[2], phase[2]]).all()


@pytest.mark.parametrize(("kind", "one"), [("none", True), ("absolute", False)])
def test_a_cost_with_a_kink_is_no_quadratic_program(kind: str, one: bool) -> None:
    """Its second derivatives are constant, but where the plan crosses e_y = 0.05 m one QP is not all; a quadratic cost
    needs no second one."""
    law = Kinked(kind=kind).prepare(Plant.build(BicycleModel(), [25.0], 0.05))
    lane = np.zeros((1, law.preview_times.size))
    x = np.array([[0.1, -1.0, 0.0, 0.0]])
    _, state, _ = law.step(np.zeros(1), x, Preview(lane, lane, np.zeros(1)), np.zeros(1), law.init(1))
    calls = law.solver_calls(state)
    assert calls is not None
    assert bool(calls.iterations[0] <= 1) == one  # none where no limit is broken
