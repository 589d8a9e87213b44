"""The review finds what was planted, and leaves sound designs alone."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any, ClassVar

import control
import numpy as np
import pytest

from helpers.closed_loop import ZOO
from helpers.errors import refused
from ldctoolkit import (
    BicycleModel,
    Controller,
    EventStatus,
    LdcError,
    LinearLaw,
    Plant,
    Preview,
    SteeringLaw,
    controller_class,
    gain,
    option,
)
from ldctoolkit.controllers import LQR, BarrierFilter, LinearMPC, NoControl, PreviewProportional
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, PlantOptions, Sensors
from ldctoolkit.review import Finding, Review, Thresholds, review
from ldctoolkit.review.design_review import limit_of, plant_notes
from ldctoolkit.review.law_model import System, linear_view

FEW = (10.0, 25.0, 40.0)


def named(result: Review, name: str) -> Finding:
    return next(finding for finding in result.findings if finding.name == name)


def names(result: Review) -> set[str]:
    return {finding.name for finding in result.findings if finding.severity != "note"}


def test_what_arms_make_worse_is_found_once() -> None:
    """Softer and later: the phase margin of a stiff LQR; where the loop was bad without arms it is not said again."""
    given: dict[str, Any] = {"speeds": [30.0, 35.0]}
    late = Actuator(lag=0.1, delay=0.05)
    options = PlantOptions(actuator=late, driver=Driver(model="arms", straight=1.0))
    alone, held = (review(LQR(r_delta=300.0), options=o, **given) for o in (PlantOptions(actuator=late), options))
    assert (alone.held, len(held.held), "phase_margin" in names(alone)) == ((), 2, False)
    np.testing.assert_array_equal(held.loop.phase_margin, alone.loop.phase_margin)
    found = named(held, "phase_margin_held")
    arms = dict(held.held)["arms relaxed (k = 10 N m/rad)"]
    assert (found.severity, found.value) == ("warning", arms.phase_margin.min())
    assert found.sentence.startswith("With arms relaxed (k = 10 N m/rad), at 35 m/s the loop has a phase margin of ")
    assert math.radians(15.0) < found.value < math.radians(30.0) < alone.loop.phase_margin.min()
    assert [f.name for f in held.findings].count("phase_margin_held") == 1
    assert np.isnan([arms.e_y_bend, arms.e_y_bend_mismatched, arms.hessian_condition]).all()
    assert "driver" in named(held, "left_out").sentence
    bad = review(PreviewProportional(K_y=-0.01, K_psi=-0.3), options=options, **given)
    assert (named(bad, "phase_margin").severity, "phase_margin_held" in names(bad)) == ("fault", False)
    assert [named(bad, name).severity for name in ("gain_margin", "gain_margin_held")] == ["warning", "fault"]


@pytest.mark.slow
def test_a_sound_design_has_no_findings() -> None:
    sound = review(LQR(r_delta=100.0))
    assert sound.findings == ()
    assert sound.loop.stable.all()
    assert (sound.loop.gain_margin > 6).all()
    # a full-state LQR in continuous time has at least 60 deg; sampling takes half a sample of phase
    lost = sound.loop.crossover * 0.5 * sound.dt
    assert (sound.loop.phase_margin > math.pi / 3 - 1.2 * lost - 0.02).all()


def test_planted_an_unstable_gain() -> None:
    unstable = review(PreviewProportional(K_y=-1.0, K_psi=-0.05), speeds=FEW)
    fault = named(unstable, "stability")
    assert (fault.severity, fault.v in FEW, fault.value > 1) == ("fault", True, True)
    assert "Lower K_y, K_psi" in fault.sentence
    assert np.isnan(unstable.loop.gain_margin[~unstable.loop.stable]).all()


def test_planted_an_initial_angle_beyond_the_limits() -> None:
    """At 10 m/s a bend of 2 m/s^2 takes delta = 2.9 m/(50 m) + ..., far beyond 0.02 + 0.1 0.05 rad."""
    reviewed = review(LinearMPC(delta_max=0.02, rate_max=0.1, r_delta=100.0), speeds=[10.0, 20.0])
    fault = named(reviewed, "initial_angle")
    needed = float(BicycleModel().steady_state([10.0]).delta[0]) * 0.2
    assert (fault.severity, fault.value) == ("fault", pytest.approx(needed, rel=1e-12))
    assert f"for {math.ceil((needed - 0.02) / 0.005)} samples (its horizon is 20 samples)" in fault.sentence
    assert named(reviewed, "angle_in_bend").severity == "fault"
    assert not names(review(LinearMPC(r_delta=100.0), speeds=[10.0, 20.0]))


def test_an_initial_angle_that_is_given() -> None:
    """|delta_prev| = 0.11 and delta_max = 0.1: within reach of one sample at 0.2 rad/s, not at 0.19."""
    design = LinearMPC(rate_max=0.2, r_delta=100.0)
    assert not names(review(design, delta_prev=(0.11, 22.0), speeds=[20.0]))
    reviewed = review(LinearMPC(rate_max=0.19, r_delta=100.0), delta_prev=(0.11, 22.0), speeds=[20.0])
    assert named(reviewed, "initial_angle").v == 22.0
    # one departure of 200 is rare, two are not
    angles = np.zeros(200)
    angles[7] = -0.3
    rare = named(review(design, delta_prev=(angles, np.full(200, 20.0)), speeds=[20.0]), "initial_angle")
    assert rare.severity == "warning"
    assert "(so in 1 of 200 departures)" in rare.sentence
    angles[8] = 0.2
    often = named(review(design, delta_prev=(angles, np.full(200, 20.0)), speeds=[20.0]), "initial_angle")
    assert (often.severity, often.value) == ("fault", 0.3)


def test_planted_a_bandwidth_above_nyquist() -> None:
    design = PreviewProportional(K_y=-1.0, K_psi=-5.0)
    assert "sampling" not in {f.name for f in review(design, dt=0.01, speeds=FEW).findings}
    fault, between = (named(review(design, dt=dt, speeds=FEW), "sampling") for dt in (0.2, 0.05))
    assert (fault.severity, fault.value > 0.5) == ("fault", True)
    assert "above the Nyquist frequency" in fault.sentence
    assert (between.severity, between.allowed) == ("warning", 0.1)


@dataclasses.dataclass(frozen=True)
class NoFeedforward(Controller):
    """An LQR that does not look at the lane; its bias follows by hand."""

    name: ClassVar[str] = "no_feedforward"
    title: ClassVar[str] = "No feedforward"
    r_delta: float = gain(100.0, unit="1/rad^2", lower=1.0, upper=1e6, description="weight on delta^2")

    def prepare(self, plant: Plant) -> LinearLaw:
        law = LQR(r_delta=self.r_delta).prepare(plant)
        return dataclasses.replace(law, G_yaw_rate=np.zeros((plant.n, 1)))


def test_planted_a_bias_in_a_bend() -> None:
    """Steady cornering: F_y e_y + F_psi e_psi_ss r = delta_ss r."""
    v = 30.0
    biased = review(NoFeedforward(), speeds=[v])
    plant = Plant.build(BicycleModel(), [v], 0.05)
    F, steady = NoFeedforward().prepare(plant).F[0], plant.steady_state()
    by_hand = (steady.delta[0] - F[2] * steady.e_psi[0]) / F[0] * 2.0 / v
    assert biased.loop.e_y_bend[0] == pytest.approx(by_hand, rel=1e-9)
    assert review(LQR(r_delta=100.0), speeds=[v]).findings == ()
    fault = named(review(NoFeedforward(r_delta=1000.0), speeds=[10.0]), "bend")
    assert (fault.severity, fault.value > 0.3) == ("fault", True)


def test_delay_and_lag_are_in_the_loop() -> None:
    """A whole delay costs its own time of the delay margin, and enough of it makes the loop unstable, unless known."""
    given: dict[str, Any] = {"speeds": [30.0], "plant_knowledge": "ideal"}
    bare = review(LQR(r_delta=100.0), **given).loop
    late = review(LQR(r_delta=100.0), options=PlantOptions(actuator=Actuator(delay=0.05)), **given).loop
    frames = review(LQR(r_delta=100.0), options=PlantOptions(sensors=Sensors(delay=0.2)), **given)
    assert late.delay_margin[0] == pytest.approx(bare.delay_margin[0] - 0.05, abs=1e-4)
    assert late.gain_margin[0] < bare.gain_margin[0]
    too_late = PlantOptions(actuator=Actuator(delay=float(bare.delay_margin[0]) + 0.01))
    assert named(review(LQR(r_delta=100.0), options=too_late, **given), "stability").severity == "fault"
    assert review(LQR(r_delta=100.0), speeds=[30.0], options=too_late).faults == ()
    assert frames.faults
    assert "left_out" not in {finding.name for finding in frames.findings}


@pytest.mark.parametrize(
    ("given", "left_out"),
    [
        ({"delay": 0.05, "kalman": KalmanFilter()}, False), ({"e_y_noise": 0.05}, True), ({"e_psi_bias": 0.01}, True),
        ({"e_y_step": 0.01}, True), ({"curvature_gain": -0.1}, True),
    ],
)  # fmt: skip
def test_what_the_loop_holds_of_a_camera_is_not_left_out(given: dict[str, Any], left_out: bool) -> None:
    notes = list(plant_notes(PlantOptions(sensors=Sensors(**given))))
    assert [("curvature of the camera" in note.sentence) for note in notes] == [True] * left_out


def test_margins_below_their_thresholds() -> None:
    """The same number is a warning or a fault as the thresholds say, and the sentence names value and bound."""

    def reviewed(**given: Any) -> Review:
        return review(LQR(r_delta=100.0), speeds=[40.0], **given)

    value = float(reviewed().loop.gain_margin[0])  # type: ignore[union-attr]
    # a threshold itself is still allowed
    for warning, fault, severity in ((1, -1, "warning"), (2, 1, "fault"), (1, 0, "warning")):
        result = reviewed(thresholds=Thresholds(gain_margin=(value + warning, value + fault)))
        finding = named(result, "gain_margin")
        assert (finding.severity, finding.value, finding.allowed) == (severity, pytest.approx(value), value + warning)
        assert f"{value:.3g} dB; allowed: at least {value + warning:.3g} dB" in finding.sentence
        assert "Raise r_delta" in finding.sentence
    assert "gain_margin" not in names(reviewed(thresholds=Thresholds(gain_margin=(value, value))))


@pytest.mark.parametrize(
    ("limits", "expected"), [((0.08, 0.15), {"actuator_angle", "actuator_rate"}), ((0.1, 0.2), set())]
)
def test_limits_against_the_actuator(limits: tuple[float, float], expected: set[str]) -> None:
    options = PlantOptions(actuator=Actuator(delta_max=limits[0], rate_max=limits[1]))
    assert names(review(LinearMPC(r_delta=100.0), options=options, speeds=[25.0])) == expected


@dataclasses.dataclass(frozen=True)
class Soft(NoFeedforward):
    """Declares limits, and does not keep them: the review reads what is declared."""

    name: ClassVar[str] = "soft"
    delta_max: float = gain(0.1, unit="rad", lower=0.0, upper=1.0, description="limit")
    rate_max: float = gain(1.0, unit="rad/s", lower=0.0, upper=1.0, description="limit")
    a_y_max: float = gain(0.0, unit="m/s^2", lower=0.0, upper=100.0, description="soft limit, 0 for none")
    jerk_max: float = gain(0.0, unit="m/s^3", lower=0.0, upper=1.0, description="soft limit, 0 for none")
    e_y_max: float = gain(0.0, unit="m", lower=0.0, upper=10.0, description="corridor, 0 for none")


def test_soft_limits_that_contradict() -> None:
    assert not {"corridor", "acceleration_limit"} & {f.name for f in review(Soft(), speeds=[20.0]).findings}
    reviewed = review(Soft(e_y_max=1.0), y_s=0.2, speeds=[20.0])
    assert named(reviewed, "corridor").allowed == pytest.approx(0.85 + 0.2)
    assert "corridor" not in names(review(Soft(e_y_max=1.1), y_s=0.2, speeds=[20.0]))
    assert "corridor" in names(review(Soft(e_y_max=BicycleModel().parameters.edge_offset), speeds=[20.0]))
    # delta_max = 0.1 rad at 10 m/s reaches 0.1/delta_ss v = 3.4 m/s^2
    note = named(review(Soft(a_y_max=4.0), speeds=[10.0, 30.0]), "acceleration_limit")
    assert note.severity == "note"
    assert note.value == pytest.approx(0.1 / BicycleModel().steady_state([10.0]).delta[0] * 10.0, rel=1e-9)


def test_the_condensed_hessian_is_that_of_the_cost() -> None:
    """Its entries by differences of the cost itself, which is quadratic: exact up to rounding."""
    v, N, r = 33.0, 6, 4.0
    loop = review(LinearMPC(horizon=N, r_delta=r, q_psi=2.0), speeds=[v]).loop
    plant = Plant.build(BicycleModel(), [v], 0.05)
    A, B, Q = plant.step.A[0], plant.step.B[0], np.diag([1.0, 0.0, 2.0, 0.0])
    P = control.dlqr(A, B[:, None], Q, [[r]])[1]

    def cost(u: np.ndarray) -> float:
        x, total = np.zeros(4), 0.0
        for k in range(N):
            x = A @ x + B * u[k]
            total += float(x @ (P if k == N - 1 else Q) @ x) + r * u[k] ** 2
        return total

    unit = np.eye(N)
    H = np.array([[cost(a + b) - cost(a) - cost(b) for b in unit] for a in unit]) / 2.0
    assert loop.hessian_condition[0] == pytest.approx(np.linalg.cond(H), rel=1e-6)
    assert named(review(LinearMPC(horizon=100, r_delta=1e-3, q_y=1e6), speeds=[40.0]), "hessian").value > 1e6
    assert np.isnan(review(LQR(r_delta=100.0), speeds=[40.0]).loop.hessian_condition).all()  # type: ignore[union-attr]


def test_the_mpc_is_its_lqr_near_straight_driving() -> None:
    """Numerically linearised, the MPC far from its limits has the LQR's loop; tolerance: differences at 1e-3."""
    mpc, lqr = (review(law(r_delta=300.0), speeds=FEW).loop for law in (LinearMPC, LQR))
    for name in ("radius", "gain_margin", "phase_margin", "disk_margin", "bandwidth"):
        np.testing.assert_allclose(getattr(mpc, name), getattr(lqr, name), rtol=1e-6)


def test_a_design_without_control_has_no_loop() -> None:
    result = review(NoControl())
    assert (result.loop, [finding.name for finding in result.findings]) == (None, ["recorded_path"])


@dataclasses.dataclass(frozen=True)
class RememberingLaw(SteeringLaw):
    """PI on the offset with a first-order filter on the heading and a weight on its previous command."""

    dt: float
    n: int
    constant: float
    broken: bool

    @property
    def preview_times(self) -> np.ndarray:
        return np.array([0.0, 1.0])

    def init(self, n: int) -> Any:
        return np.zeros((n, 2))

    def step(self, t: Any, x: Any, preview: Preview, delta_prev: Any, state: Any) -> Any:
        integral, slow = state[:, 0], state[:, 1]
        delta = -0.1 * x[:, 0] - 0.02 * x[:, 1] - 0.03 * integral - 0.8 * slow - 0.3 * x[:, 2] + 0.2 * delta_prev
        delta = delta + 0.1 * preview.yaw_rate[:, 0] + 0.05 * preview.heading[:, 1] + self.constant
        if self.broken:
            delta = delta * np.nan
        following = np.column_stack([integral + self.dt * x[:, 0], 0.7 * slow + 0.3 * x[:, 2]])
        return delta, following, np.full(delta.size, EventStatus.OK, dtype=np.int8)


@dataclasses.dataclass(frozen=True)
class Remembering(Controller):
    """See `RememberingLaw`."""

    name: ClassVar[str] = "remembering"
    title: ClassVar[str] = "Remembering"
    constant: float = gain(0.0, unit="rad", lower=-1.0, upper=1.0, description="what it adds to every command")
    broken: bool = gain(False, unit="1", description="give NaN")

    def prepare(self, plant: Plant) -> RememberingLaw:
        return RememberingLaw(plant.dt, plant.n, self.constant, self.broken)


def test_a_memory_is_identified_from_pulses() -> None:
    """Transfer function of the identified model against the law's own, written down; all six inputs."""
    dt = 0.05
    view = linear_view(Remembering(), Plant.build(BicycleModel(), [15.0, 30.0], dt))
    assert view.order == 2
    for model in view.models:
        for z in np.exp(1j * np.array([0.05, 0.4, 1.5, 3.0])):
            H = model.D + model.C @ np.linalg.solve(z * np.eye(2) - model.A, model.B)
            by_hand = [-0.1 - 0.03 * dt / (z - 1), -0.02, -0.3 - 0.24 / (z - 0.7), 0.0, 0.2, 0.1 + 0.05 * 1.0, 0.0]
            np.testing.assert_allclose(H, by_hand, atol=1e-8)  # the pulses' size over rounding
    assert np.all(view.unexplained < 1e-8)


def test_an_integral_takes_the_bias_away() -> None:
    """Remembering integrates e_y: no offset in a bend, on any tyres."""
    loop = review(Remembering(), speeds=[10.0, 15.0]).loop
    assert loop.stable.all()
    np.testing.assert_allclose([loop.e_y_bend, loop.e_y_bend_mismatched], 0.0, atol=1e-7)


def test_laws_that_steer_for_nothing_or_give_no_numbers() -> None:
    assert named(review(Remembering(constant=0.01), speeds=[20.0]), "quiet").severity == "fault"
    broken = review(Remembering(broken=True), speeds=[20.0])
    assert (named(broken, "finite").severity, broken.loop) == ("fault", None)


@dataclasses.dataclass(frozen=True)
class RaisingLaw(SteeringLaw):
    """Raises in one of its parts."""

    where: str
    error: BaseException

    @property
    def preview_times(self) -> np.ndarray:
        if self.where == "preview_times":
            raise self.error
        return np.zeros(1)

    def init(self, n: int) -> Any:
        if self.where == "init":
            raise self.error

    def step(self, t: Any, x: Any, preview: Preview, delta_prev: Any, state: Any) -> Any:
        raise self.error


@dataclasses.dataclass(frozen=True)
class Raising(Controller):
    """Raises in `prepare`, or has a law that raises."""

    name: ClassVar[str] = "raising"
    title: ClassVar[str] = "Raising"
    where: str = option("prepare", choices=("prepare", "preview_times", "init", "step"), description="where")
    error: ClassVar[BaseException] = RuntimeError("no map")

    def prepare(self, plant: Plant) -> SteeringLaw:
        if self.where == "prepare":
            raise self.error
        return RaisingLaw(self.where, self.error)


@pytest.mark.parametrize("where", ["prepare", "preview_times", "init", "step"])
@pytest.mark.parametrize(
    ("error", "text"), [(RuntimeError("no map"), "RuntimeError: no map"), (SystemExit(3), "SystemExit: 3")]
)
def test_raising_laws_are_named(where: str, error: BaseException, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Raising, "error", error)
    with pytest.raises(LdcError, match=rf"{where} raised {text} \(test_review\.py, line \d+\)") as caught:
        review(Raising(where=where))
    assert caught.value.path == "controller 'raising'"
    monkeypatch.setattr(Raising, "error", KeyboardInterrupt())
    with pytest.raises(KeyboardInterrupt):
        review(Raising(where=where))


def test_a_limit_of_zero_is_off_only_where_zero_says_so() -> None:
    """delta_max = 0 forbids steering; a_y_max, jerk_max and e_y_max of 0 are none."""
    design = Soft(delta_max=0.0, rate_max=0.0)
    limits = {name: limit_of(design, name) for name in ("delta_max", "rate_max", "e_y_max", "a_y_max", "jerk_max")}
    assert limits == {"delta_max": 0.0, "rate_max": 0.0, "e_y_max": None, "a_y_max": None, "jerk_max": None}
    reviewed = review(design, speeds=[20.0])
    assert named(reviewed, "angle_in_bend").allowed == 0.0
    assert "for all samples" in named(reviewed, "initial_angle").sentence
    assert limit_of(Soft(e_y_max=1.0), "e_y_max") == 1.0


def test_a_bound_on_the_offset_is_no_offset_in_a_bend() -> None:
    """The filter keeps |e_y| below 1.35 m: the linear loop's several metres are left out, and both are told."""
    inner = review(PreviewProportional(T_lp=0.5), speeds=[10.0])
    reviewed = review(BarrierFilter(inner_gains="T_lp=0.5"), speeds=[10.0])
    assert (np.abs(inner.loop.e_y_bend) > 1.35).all()
    assert np.isnan(reviewed.loop.e_y_bend).all()
    assert np.isnan(reviewed.loop.e_y_bend_mismatched).all()
    assert named(reviewed, "bend_not_linear").value == reviewed.loop.bend_error.max() > 0.05
    assert "|e_y| <= e_y_max = 1.35 m" in named(reviewed, "bound").sentence
    assert "bend" not in {finding.name for finding in reviewed.findings}
    # where the bound is far, the number is that of the law inside
    wide = review(BarrierFilter(inner="lqr", e_y_max=10.0), speeds=[30.0]).loop
    alone = review(LQR(), speeds=[30.0]).loop
    np.testing.assert_allclose(wide.e_y_bend_mismatched, alone.e_y_bend_mismatched, rtol=1e-6)
    assert inner.loop.bend_error.max() == 0.0


def test_a_response_of_many_states_is_worked_out_in_blocks() -> None:
    """900 states of their own: H(z) = sum of c b/(z - a); four points fit in a block."""
    rng = np.random.default_rng(1)
    a, b, c = rng.uniform(-0.9, 0.9, 900), rng.normal(size=900), rng.normal(size=900)
    z = np.exp(1j * np.linspace(0.1, 3.0, 7))
    result = System(np.diag(a), b[:, None], c[None, :], np.full((1, 1), 0.5)).response(z)
    np.testing.assert_allclose(result[:, 0, 0], 0.5 + (b * c / (z[:, None] - a)).sum(axis=1), rtol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "path", "value"),
    [
        ({"dt": 0.0}, "dt", 0.0),
        ({"a_y": -1.0}, "a_y", -1.0),
        ({"plant_knowledge": "all"}, "plant_knowledge", "all"),
        ({"speeds": [0.5, 20.0]}, "speeds[0]", 0.5),
        ({"y_s": -0.1}, "y_s", -0.1),
        ({"speeds": [0.0]}, "v[0]", 0.0),
        ({"speeds": [20.0, 100.0]}, "speeds[1]", 100.0),
        ({"speeds": []}, "speeds", []),
        ({"delta_prev": ([0.1, 0.2], [20.0])}, "delta_prev", ...),
        ({"dt": 1e-6, "options": PlantOptions(actuator=Actuator(delay=0.05))}, "actuator.delay", 0.05),
        ({"dt": 1e-6, "options": PlantOptions(sensors=Sensors(delay=0.05))}, "sensors.delay", 0.05),
    ],
)
def test_wrong_arguments_are_named(wrong: dict[str, Any], path: str, value: Any) -> None:
    with refused(path, value=value):
        review(LQR(r_delta=100.0), **wrong)
    with refused("a_y", allowed="a finite number > 0 m/s^2"):
        review(LQR(), a_y=0.0)
    with refused("controller"):
        review(LQR)  # type: ignore[arg-type]


@pytest.mark.parametrize("pair", [(3.0, 6.0), (6.0,), (0.0, 0.0), ("a", "b"), 6.0])
def test_wrong_thresholds_are_named(pair: Any) -> None:
    with refused("thresholds.gain_margin", value=pair, allowed="two descending numbers > 0 dB"):
        Thresholds(gain_margin=pair)
    with refused("thresholds.bend", value=(0.3, 0.1)):
        Thresholds(bend=(0.3, 0.1))
    assert Thresholds(bend=[np.float32(0.25), 1]).bend == (0.25, 1.0)  # type: ignore[arg-type]


PAGE = Path(__file__).resolve().parents[2] / "docs/how-to/reviewing-a-design.md"


def test_the_pages_table_is_that_of_the_thresholds() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+?) \|", text, flags=re.M))
    t = Thresholds()
    assert rows["gain_margin"] == f"{t.gain_margin[0]:g} dB"
    assert rows["phase_margin"] == f"{math.degrees(t.phase_margin[0]):g}°"
    assert rows["slowest_pole"] == f"{t.slowest[0]:g} s"
    assert (rows["disk_margin"], rows["sampling"]) == (f"{t.disk_margin[0]:g}", f"{t.sampling[0]:g}")
    assert rows["bend"] == f"{t.bend[0]:g} m"


@pytest.mark.slow
@pytest.mark.parametrize("name", ZOO)
def test_every_law_can_be_reviewed(name: str) -> None:
    """By default gains: numbers, and no loop that is unstable on the ideal plant."""
    result = review(controller_class(name)(), speeds=FEW)
    if result.loop is None:
        return
    names = {finding.name for finding in result.findings}
    assert not names & {"stability", "finite"}
    left_out = result.loop.bend_error > 0.05
    assert np.isfinite(result.loop.e_y_bend[~left_out]).all()
    assert left_out.any() == ("bend_not_linear" in names)
