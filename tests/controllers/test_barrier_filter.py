"""Barrier filter: its closed form against a QP, what it promises in the closed loop, and the laws inside."""

import dataclasses
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
import pytest
import qpsolvers
import scipy.sparse as sp

from helpers.closed_loop import DT, Stepped, Unsighted, known, some
from helpers.errors import assert_fields, refused
from ldctoolkit import BicycleModel, Plant, Scenarios, gain, simulate
from ldctoolkit.control import Controller, EventStatus, LinearLaw, Preview, RecordedPath, SteeringLaw
from ldctoolkit.controllers import LQR, LinearMPC, PreviewProportional
from ldctoolkit.controllers.barrier_filter import BarrierFilter
from ldctoolkit.controllers.lqi import LQI
from ldctoolkit.controllers.preview_lqr import PreviewLQR
from ldctoolkit.errors import LdcError, StudyError
from ldctoolkit.plant_options import Actuator, KalmanFilter, PlantOptions, Sensors
from ldctoolkit.studies import Study


@dataclasses.dataclass(frozen=True)
class DriftingLaw(SteeringLaw):
    """A law with state, a status and no `take` unless asked for; it gives NaN at one sample."""

    K: float
    cut: bool
    broken_at: int

    @property
    def preview_times(self) -> np.ndarray:
        return np.array([0.3, 0.0])

    def init(self, n: int) -> Any:
        return np.zeros(n), 0

    def step(self, t: Any, x: Any, preview: Preview, delta_prev: Any, state: Any) -> Any:
        drift, k = state
        assert preview.yaw_rate.shape == (t.size, 2)
        delta = self.K * x[:, 0] + drift + 0.01 * preview.heading[:, 0] + 0.1 * delta_prev
        if k == self.broken_at:
            delta = np.full(t.size, np.nan)
        status = np.where(x[:, 0] > 1.2, EventStatus.SOLVER_FAILED, EventStatus.OK)
        return delta, (drift + 1e-4 * x[:, 0], k + 1), status

    def take(self, rows: Any, state: Any) -> Any:
        return (self, (state[0][rows], state[1])) if self.cut else None


@dataclasses.dataclass(frozen=True)
class Drifting(Controller):
    """A third party's law."""

    name: ClassVar[str] = "drifting"
    title: ClassVar[str] = "Drifting"

    K: float = gain(-0.005, unit="rad/m", lower=-1.0, upper=0.0, description="gain on e_y")
    cut: bool = gain(True, unit="1", description="can be cut down")
    broken_at: int = gain(-1, unit="1", lower=-1, upper=1000, description="sample at which it gives NaN")

    def prepare(self, plant: Plant) -> Any:
        return DriftingLaw(self.K, self.cut, self.broken_at)


@dataclasses.dataclass(frozen=True)
class LeavesAlone(Controller):
    """A third party's law that has no command."""

    name: ClassVar[str] = "leaves_alone"
    title: ClassVar[str] = "Leaves alone"

    def prepare(self, plant: Plant) -> RecordedPath:
        return RecordedPath()


@dataclasses.dataclass(frozen=True)
class OneForAllLaw(Unsighted):
    """One number where n are due."""

    def step(self, t: Any, x: Any, preview: Preview, delta_prev: Any, state: Any) -> Any:
        return np.float64(0.01), state, np.zeros(t.size, dtype=np.int8)


@dataclasses.dataclass(frozen=True)
class OneForAll(Controller):
    """A third party's law that is broken."""

    name: ClassVar[str] = "one_for_all"
    title: ClassVar[str] = "One for all"

    def prepare(self, plant: Plant) -> OneForAllLaw:
        return OneForAllLaw()


@dataclasses.dataclass(frozen=True)
class EveryWeight(Controller):
    """A linear law that uses all that a linear law may."""

    name: ClassVar[str] = "every_weight"
    title: ClassVar[str] = "Every weight"

    def prepare(self, plant: Plant) -> LinearLaw:
        scale = np.sqrt(plant.v / 20.0)[:, None]  # another for every scenario
        return LinearLaw(
            F=scale * [-0.02, -0.03, -0.2, -0.01], preview_times=np.array([0.0, 0.4]), G_yaw_rate=scale * [0.05, 0.02],
            G_heading=scale * [0.0, 0.1], f_u=0.3 * scale[:, 0], f_i=-0.004 * scale[:, 0],
        )  # fmt: skip


@pytest.fixture(autouse=True)
def third_parties() -> Iterator[None]:
    with known(Drifting, LeavesAlone, OneForAll, EveryWeight):
        yield


def situations(n: int, seed: int, size: float = 1.0) -> tuple[Plant, np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    plant = Plant.build(BicycleModel(), rng.uniform(7, 36, n), DT)
    x = size * rng.normal(size=(n, 4)) * [1.0, 0.5, 0.03, 0.1]
    return plant, x, rng.normal(0, 0.05, (n, 2)), rng.uniform(-0.05, 0.05, n)


def ahead(times: np.ndarray, r: np.ndarray) -> Preview:
    """A lane whose yaw rate goes from r_0 to r_1 in a sample and stays there; the turn is made up."""
    share = np.minimum(times / DT, 1.0)
    yaw_rate = r[:, :1] * (1.0 - share) + r[:, 1:] * share
    return Preview(yaw_rate, r[:, 1:] * times)


def command(design: BarrierFilter, plant: Plant, x: np.ndarray, r: np.ndarray, prev: np.ndarray) -> np.ndarray:
    law = design.prepare(plant)
    delta, _, _ = law.step(np.zeros(plant.n), x, ahead(law.preview_times, r), prev, law.init(plant.n))
    return delta


@pytest.mark.parametrize(("gamma_1", "gamma_2", "delta_max"), [(0.2, 0.3, 0.1), (0.05, 0.9, 0.03), (1.0, 1.0, 1.0)])
def test_the_closed_form_is_the_solution_of_the_qp(gamma_1: float, gamma_2: float, delta_max: float) -> None:
    """Clarabel on the QP with both barriers and the limit written out one by one; at tolerances of 1e-12 on the square
    of the distance, whose root is the command's, and with rows scaled to one, 1e-6 rad."""
    design = BarrierFilter(
        inner="lqr", inner_gains="r_delta=100", gamma_1=gamma_1, gamma_2=gamma_2, delta_max=delta_max
    )
    plant, x, r, prev = situations(150, seed=1, size=0.8)
    delta = command(design, plant, x, r, prev)
    law = LQR(r_delta=100.0).prepare(plant)
    expected = (law.F * x).sum(axis=1) + law.G_yaw_rate[:, 0] * r[:, 0]
    step, e = plant.step, design.e_y_max
    compared = moved = 0
    for i in range(plant.n):
        free = step.A[i] @ x[i] + step.E_0[i] * r[i, 0] + step.E_1[i] * r[i, 1]
        G, h = [], []
        for side in (1.0, -1.0):
            now = gamma_1 * (e - side * x[i, 0]) - DT * side * x[i, 1]
            after = gamma_1 * (e - side * free[0]) - DT * side * free[1]  # and -side (gamma_1 B_0 + dt B_1) delta
            G.append(side * (gamma_1 * step.B[i, 0] + DT * step.B[i, 1]))
            h.append(after - (1.0 - gamma_2) * now)
        # rows of comparable size: the solver's tolerance is absolute
        G, h = np.array(G) / abs(G[0]), np.array(h) / abs(G[0])
        box = delta_max * np.ones(1)
        problem = qpsolvers.Problem(
            sp.csc_matrix([[2.0]]), np.array([-2.0 * expected[i]]), sp.csc_matrix(G[:, None]), h, lb=-box, ub=box
        )
        least, most = -h[1], h[0]
        assert least < most  # both sides at once can always be met
        if least > delta_max or most < -delta_max:
            assert delta[i] == (delta_max if least > delta_max else -delta_max)
            continue
        best = qpsolvers.solve_problem(problem, solver="clarabel", tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
        assert best.found
        assert delta[i] == pytest.approx(best.x[0], abs=1e-6)
        compared += 1
        moved += abs(delta[i] - expected[i]) > 1e-3
    assert compared > 60
    assert moved > 10


def departures(n: int, seed: int, side: int = 1) -> Scenarios:
    rng = np.random.default_rng(seed)
    return Scenarios.from_arrays(
        side=np.full(n, side), T=rng.uniform(1.5, 6, n), d_y=rng.uniform(0.3, 0.9, n), v_mean=rng.uniform(6, 38, n),
        c_0=rng.normal(0, 1e-3, n), dc=rng.normal(0, 1e-3, n),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("gammas", "beyond"),
    [
        pytest.param({}, 1e-4, marks=pytest.mark.slow),
        ({"gamma_1": 0.2, "gamma_2": 0.3}, 1e-4),
        pytest.param({"gamma_1": 0.5, "gamma_2": 0.5}, 1e-3, marks=pytest.mark.slow),
    ],
)
def test_the_corridor_holds_where_it_can(gammas: dict[str, float], beyond: float) -> None:
    """From psi >= 0 at the trigger, on the ideal plant, with an angle that suffices. psi >= 0 holds at every sample, up
    to the corner that the curvature has at T, inside one of them; |e_y| <= e_y_max also in between, up to what the bend
    of dh/dt within a sample may add. The law inside, alone, leaves the corridor in many of the same departures."""
    design = BarrierFilter(inner_gains="K_y=-0.01", delta_max=1.0, **gammas)
    scenarios = departures(500, seed=2)
    out = simulate(design, scenarios, settle=8.0, trajectories=True)
    alone = simulate(PreviewProportional(K_y=-0.01), scenarios, settle=8.0)
    paths = out.trajectories
    e_y, rate = paths.x[:, :, 0], paths.x[:, :, 1]
    psi = np.stack([design.gamma_1 * (design.e_y_max - s * e_y) - DT * s * rate for s in (1.0, -1.0)])
    feasible = np.flatnonzero((psi[:, :, 0] >= 0.0).all(axis=0))
    assert feasible.size > 30
    # T, where a sample ends early, is in the paths but no sample
    k = np.rint((paths.t - paths.t[:, :1]) / DT)
    at_sample = np.abs((paths.t - paths.t[:, :1]) / DT - k) < 1e-6
    assert np.nanmin(np.where(at_sample[feasible], psi[:, feasible], np.nan)) >= -1e-5
    rows = paths.rows[feasible]
    deepest = np.maximum(out.metrics.deepest + 0.85, out.metrics.opposite_crossing + 0.85)[rows]
    assert deepest.max() <= design.e_y_max + beyond
    unfiltered = (alone.metrics.deepest + 0.85)[rows]
    assert (unfiltered > design.e_y_max + 0.05).sum() > 5


def test_outside_the_corridor_it_comes_back_exponentially() -> None:
    """Where psi < 0 at the trigger it shrinks by gamma_2 a sample, and h by about gamma_1 then."""
    design = BarrierFilter(e_y_max=1.0, inner_gains="K_y=0, K_psi=0", gamma_1=0.2, gamma_2=0.3, delta_max=1.0)
    plant = Plant.build(BicycleModel(), [10.0, 20.0, 35.0], DT)
    law = design.prepare(plant)
    x, r = np.tile([1.5, 0.3, 0.01, 0.0], (3, 1)), np.full((3, 2), 0.02)
    psi = []
    for _ in range(60):
        psi.append(design.gamma_1 * (1.0 - x[:, 0]) - DT * x[:, 1])
        lane = ahead(law.preview_times, r)
        delta, _, _ = law.step(np.zeros(3), x, lane, np.zeros(3), law.init(3))
        step = plant.step
        x = np.einsum("nij,nj->ni", step.A, x) + step.B * delta[:, None] + (step.E_0 + step.E_1) * 0.02
    expected = psi[0] * (1.0 - design.gamma_2) ** np.arange(60)[:, None]
    assert (np.array(psi) >= expected - 1e-12).all()
    # as an equation while the law inside, which does nothing, would go further out
    np.testing.assert_allclose(psi[:4], expected[:4], rtol=1e-9)
    assert (x[:, 0] < 1.01).all()


@pytest.mark.parametrize("dt", some([0.01, 0.05, 0.1], 0.05))
def test_behind_an_active_barrier_the_vehicle_is_stable(dt: float) -> None:
    """With one condition held as an equation the four states go on as a linear system; its modes decay at all speeds
    and settings, so the filter does not buy the corridor with a growing oscillation."""
    v = np.exp(np.linspace(0.0, np.log(90.0), 25))
    plant = Plant.build(BicycleModel(), v, dt)
    for gamma_1 in (0.02, 0.2, 0.6, 1.0):
        for gamma_2 in (0.05, 0.3, 1.0):
            law = BarrierFilter(gamma_1=gamma_1, gamma_2=gamma_2).prepare(plant)
            loop = plant.step.A + plant.step.B[:, :, None] * law.centre[:, None, :4]
            assert np.abs(np.linalg.eigvals(loop)).max() < 0.9999


LATE = PlantOptions(actuator=Actuator(lag=0.1, delay=0.07), sensors=Sensors(delay=0.05, kalman=KalmanFilter()))


@pytest.mark.parametrize(
    ("inner", "gains", "alone", "options"),
    [
        ("preview_proportional", "K_y=-0.02, T_lp=0.5, convention=as_printed",
         PreviewProportional(K_y=-0.02, T_lp=0.5, convention="as_printed"), PlantOptions()),
        ("lqi", "q_i=1", LQI(q_i=1.0), PlantOptions()),
        ("lqi", "", LQI(), LATE),
        pytest.param("preview_lqr", "", PreviewLQR(), LATE, marks=pytest.mark.slow),
        pytest.param("preview_lqr", " horizon = 7 ", PreviewLQR(horizon=7), PlantOptions(), marks=pytest.mark.slow),
        ("every_weight", "", EveryWeight(), PlantOptions()),
        ("drifting", "", Drifting(), PlantOptions()),
        pytest.param("drifting", "cut=false", Drifting(cut=False), PlantOptions(), marks=pytest.mark.slow),
        ("linear_mpc", "horizon=4", LinearMPC(horizon=4), PlantOptions()),
    ],
)  # fmt: skip
def test_far_from_the_corridor_it_is_the_law_inside(
    inner: str, gains: str, alone: Controller, options: PlantOptions
) -> None:
    """A corridor of 10 m. A law that is stepped: the same bits. A linear one, which knows the actuator: its sum, added
    up in another order."""
    wide = BarrierFilter(inner=inner, inner_gains=gains, e_y_max=10.0, gamma_1=1.0, gamma_2=1.0, delta_max=1.0)
    linear = isinstance(alone.prepare(Plant.build(BicycleModel(), [20.0], DT)), LinearLaw)
    other = Stepped(alone) if linear else alone  # in the same loop
    given: Any = {"trajectories": True, "settle": 1.0, "options": options}
    ours, theirs = (simulate(design, departures(12, seed=3), **given) for design in (wide, other))
    S, delta = ({"rtol": 1e-10}, {"atol": 1e-11}) if linear else ({"rtol": 0.0}, {"atol": 0.0, "rtol": 0.0})
    np.testing.assert_allclose(ours.S, theirs.S, **S)
    np.testing.assert_allclose(ours.trajectories.delta, theirs.trajectories.delta, **delta)
    np.testing.assert_array_equal(ours.status, theirs.status)
    np.testing.assert_array_equal(ours.failed_solves, theirs.failed_solves)


def test_a_command_that_is_not_finite_is_held_filtered_and_counted() -> None:
    """The command before, moved into the corridor's interval: not merely held, as it is for the law alone."""
    plant, x, r, prev = situations(40, seed=6)
    design = BarrierFilter(inner="drifting", inner_gains="broken_at=0", e_y_max=0.8)
    law = design.prepare(plant)
    delta, _, status = law.step(np.zeros(40), x, ahead(law.preview_times, r), prev, law.init(40))
    assert (status == EventStatus.SOLVER_FAILED).all()
    lower, upper = law.interval(x, r)
    np.testing.assert_array_equal(delta, np.clip(np.clip(prev, lower, upper), -0.1, 0.1))
    assert (delta != prev).sum() > 5
    out = simulate(dataclasses.replace(design, inner_gains="broken_at=3"), departures(5, seed=7))
    assert (out.failed_solves[out.triggered] >= 1).all()


def test_where_the_law_inside_cannot_be_cut_down_nor_can_the_filter() -> None:
    plant, *_ = situations(4, seed=9)
    law = BarrierFilter(inner="drifting", inner_gains="cut=false").prepare(plant)
    assert law.take(np.array([1]), law.init(4)) is None


def test_the_limit_has_priority_and_points_to_the_corridor() -> None:
    """Far outside, with little angle: the limit on the side that leads back."""
    plant = Plant.build(BicycleModel(), [20.0, 20.0], DT)
    x = np.array([[3.0, 1.0, 0.0, 0.0], [-3.0, -1.0, 0.0, 0.0]])
    delta = command(BarrierFilter(gamma_1=0.2, gamma_2=0.3, delta_max=0.02), plant, x, np.zeros((2, 2)), np.zeros(2))
    np.testing.assert_array_equal(delta, [-0.02, 0.02])


ACTUATORS = (Actuator(lag=0.2), Actuator(lag=0.05, delay=0.05), Actuator(lag=0.1, delay=0.1))


@pytest.mark.parametrize("actuator", some(ACTUATORS, ACTUATORS[2]))
def test_the_defaults_stand_a_real_actuator(actuator: Actuator) -> None:
    """Behind a lag and a delay the corridor is no longer exact, but the filter must not swing the vehicle out of it."""
    scenarios, options = departures(80, seed=12), PlantOptions(actuator=actuator)
    out, alone = (simulate(d, scenarios, options=options) for d in (BarrierFilter(), PreviewProportional()))
    assert out.count(EventStatus.DIVERGED) == 0
    for name in ("deepest", "opposite_crossing"):
        # where the start already leads out of the corridor both are alike
        assert getattr(out.metrics, name).max() <= getattr(alone.metrics, name).max() + 0.05
    assert out.metrics.opposite_crossing.max() < 0.7  # the corridor is 0.5 m beyond the line


GAINS = "barrier_filter.inner_gains"


@pytest.mark.parametrize(
    ("given", "path", "value"),
    [
        ({"inner": "lqq"}, "barrier_filter.inner", "lqq"),
        ({"inner": "none"}, "barrier_filter.inner", "none"),
        ({"inner": "barrier_filter"}, "barrier_filter.inner", "barrier_filter"),
        ({"inner": 3}, "barrier_filter.inner", 3),
        ({"inner_gains": None}, GAINS, None),
        ({"inner_gains": "K_x=-0.1"}, f"{GAINS}: preview_proportional.K_x", ...),
        ({"inner_gains": "K_y"}, GAINS, "K_y"),
        ({"inner_gains": "K_y=-0.1,,"}, GAINS, ""),
        ({"inner_gains": "K_y=-0.1, K_y=-0.2"}, f"{GAINS}: preview_proportional.K_y", ...),
        ({"inner_gains": "K_y=fast"}, f"{GAINS}: preview_proportional.K_y", "fast"),
        ({"inner_gains": "K_y=0.5"}, f"{GAINS}: preview_proportional.K_y", 0.5),
        ({"inner_gains": "convention=new"}, f"{GAINS}: preview_proportional.convention", "new"),
        ({"inner": "drifting", "inner_gains": "cut=yes"}, f"{GAINS}: drifting.cut", "yes"),
        ({"inner": "drifting", "inner_gains": "broken_at=1.5"}, f"{GAINS}: drifting.broken_at", 1.5),
    ],
)
def test_mistakes_are_named(given: dict[str, Any], path: str, value: Any) -> None:
    with pytest.raises(LdcError) as caught:
        BarrierFilter(**given)
    assert_fields(caught.value, path, value)
    assert caught.value.allowed


def test_a_third_party_that_does_not_fit_is_named() -> None:
    plant, x, r, prev = situations(3, seed=12)
    with refused("barrier_filter.inner", value="leaves_alone"):
        BarrierFilter(inner="leaves_alone").prepare(plant)
    with refused("law 'one_for_all'", allowed="(3,)"):
        command(BarrierFilter(inner="one_for_all"), plant, x, r, prev)


def test_a_study_file_may_set_and_sweep_the_law_inside() -> None:
    block = {"law": "barrier_filter", "gains": {"inner": "lqr", "inner_gains": ["r_delta=100", "r_delta=3000"]}}
    designs = Study.from_dict({"name": "small", "design": [block]}).designs
    assert [d.controller() for d in designs] == [
        BarrierFilter(inner="lqr", inner_gains=f"r_delta={r}") for r in (100, 3000)
    ]
    block["gains"]["inner"] = 3  # type: ignore[index]
    with refused("study: design[0].gains.inner", value=3, allowed="text", kind=StudyError):
        Study.from_dict({"name": "small", "design": [block]})
