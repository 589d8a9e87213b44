"""Vehicle models of a designer's: the built-in plant written as one, own states, errors, another process."""

import dataclasses
import pickle
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ldctoolkit as ldc
from helpers.errors import refused
from helpers.vehicle_models import PARAMETERS, Bicycle, Drift, MultiBody, NumPyBicycle, SelfDriven
from ldctoolkit import Actuator, EventStatus, KalmanFilter, PlantOptions, Scenarios, Sensors, Setup, Tyres, simulate
from ldctoolkit.errors import LdcError
from ldctoolkit.simulation import takeover
from ldctoolkit.studies.catalog.my_car import Car
from ldctoolkit.testing import ContractError, check_vehicle_model
from ldctoolkit.vehicle import RecordedTurn
from ldctoolkit.vehicle.vehicle_model import equations

DRIVEN: dict[str, dict[str, Any]] = {
    "nothing else": {},
    "everything": {
        "speed": "profile",
        "actuator": Actuator(lag=0.1, rate_max=0.4, delay=0.07),
        "sensors": Sensors(fps=30, delay=0.1, e_y_noise=0.03, e_psi_noise=0.003, kalman=KalmanFilter()),
    },
}


def departures(v: float, n: int = 60, seed: int = 0) -> Scenarios:
    """Both sides, bends to both, braking and accelerating."""
    rng = np.random.default_rng(seed)
    bend = min(3.0 / v**2, 0.02)
    return Scenarios.from_arrays(
        T=rng.uniform(1.5, 6.0, n), d_y=rng.uniform(0.2, 1.2, n), v_mean=np.full(n, v),
        a_mean=rng.uniform(-0.4, 0.4, n), c_0=rng.uniform(-bend, bend, n), dc=rng.uniform(-bend, bend, n) / 3,
        side=rng.choice([-1, 1], n),
    )  # fmt: skip


@pytest.mark.parametrize("options", DRIVEN)
@pytest.mark.parametrize(("v", "mu"), [(6.0, 0.9), (25.0, 0.25), (60.0, 0.3)])
def test_the_bicycle_of_ones_own_scores_like_the_built_in_one(
    v: float, mu: float, options: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At low and high speed, in bends, on tyres beyond their peak, for laws of either kind; both with short steps."""
    for reach in ("_REACH", "_REACH_OF_TYRES"):
        monkeypatch.setattr(takeover, reach, 1.0 / 16.0)
    setup = Setup(options=PlantOptions(tyres=Tyres(model="magic_formula", mu=mu), **DRIVEN[options]))
    own = dataclasses.replace(setup, vehicle_model=Bicycle(mu=mu))
    for law in (ldc.LQR(), ldc.PID()):
        expected, outcome = (simulate(law, departures(v), y_s=0.1, setup=s) for s in (setup, own))
        np.testing.assert_array_equal(outcome.status, expected.status)
        # at 60 m/s, with delays and noise, the loops are close to instability and enlarge what differs
        np.testing.assert_allclose(
            outcome.S, expected.S, rtol=0, atol=1e-4 if v > 50.0 and options != "nothing else" else 5e-6
        )
        for name in ("deepest", "dtle", "a_y_peak", "jerk_peak", "delta_peak", "effort", "travel", "t_back"):
            np.testing.assert_allclose(
                getattr(outcome.metrics, name), getattr(expected.metrics, name), rtol=1e-3, atol=1e-4
            )
        assert law.name != "lqr" or outcome.law_seconds == 0.0
        if (v, mu) == (25.0, 0.25):
            assert expected.count(EventStatus.DIVERGED)


def test_arrays_and_symbols_are_the_same_vehicle() -> None:
    casadi, numpy = (simulate(ldc.LQR(), departures(20.0), y_s=0.1, setup=Setup(vehicle_model=car))
                     for car in (Bicycle(), NumPyBicycle()))  # fmt: skip
    np.testing.assert_allclose(casadi.S, numpy.S, rtol=0, atol=1e-11)


@pytest.mark.parametrize("car", [Bicycle(), NumPyBicycle(), Car()])
def test_a_scenario_is_driven_by_itself(car: ldc.VehicleModel) -> None:
    scenarios, setup = departures(15.0, n=1100), Setup(vehicle_model=car, settle=0.2)
    both = [simulate(ldc.LQR(), scenarios, y_s=0.3, setup=setup, threads=threads).S for threads in (1, 3)]
    np.testing.assert_array_equal(*both)
    rows = np.array([3, 700, 1099])
    np.testing.assert_array_equal(simulate(ldc.LQR(), scenarios.take(rows), y_s=0.3, setup=setup).S, both[0][rows])


@pytest.mark.slow
def test_states_of_ones_own_against_solve_ivp() -> None:
    """The paths between samples, by another integrator, with tyre forces that lag behind."""
    setup = Setup(options=PlantOptions(speed="profile"), vehicle_model=Car())
    scenarios = departures(20.0, n=6)
    paths = simulate(ldc.PID(), scenarios, y_s=0.1, setup=setup, trajectories=True).trajectories
    assert paths is not None
    eq = equations(Car())

    def moment(i: int, s: float, delta: float) -> np.ndarray:
        path, t = paths.path.take(np.array([i])), np.array([[s]])
        v, a = path.speed(t)[0, 0], float(scenarios.a_mean[i]) if s < scenarios.T[i] else 0.0
        return np.array([[v, a, v * path.curvature(t)[0, 0], delta]])

    def onwards(i: int, z: np.ndarray, t: np.ndarray, delta: float) -> np.ndarray:
        def slope(s: float, z: np.ndarray) -> np.ndarray:
            return eq.rates(z[None], moment(i, s, delta))[0]

        return solve_ivp(slope, tuple(t), z, rtol=1e-10, atol=1e-10).y[:, -1]

    for i in np.flatnonzero(np.isfinite(paths.t[:, 0]))[:2]:
        t, x = paths.t[i][np.isfinite(paths.t[i])], paths.x[i]
        bend = paths.path.take(np.array([i])).lateral_acceleration(t[:1])
        p = moment(i, t[0], 0.0)
        turn = RecordedTurn(x[0, :1], x[0, 1:2], bend, x[0, 3:4], *p.T[:3], x[0, 2:3], np.zeros(1))
        state = eq.start(turn)[0][0]
        np.testing.assert_allclose(state[:4], x[0], rtol=0, atol=1e-9)
        for k in range(t.size - 1):
            state = onwards(i, state, t[k : k + 2], paths.delta[i, k])
            np.testing.assert_allclose(state[:4], x[k + 1], rtol=0, atol=2e-6)


@pytest.mark.slow
def test_a_model_that_advances_itself() -> None:
    scenarios, tyres = departures(20.0, n=20), Tyres(model="magic_formula")  # from the start that initial() leaves
    options = PlantOptions(speed="profile", actuator=Actuator(lag=0.1, delay=0.03), tyres=tyres)
    expected, outcome = (
        simulate(ldc.PID(), scenarios, y_s=0.1, setup=Setup(options=options, vehicle_model=car))
        for car in (NumPyBicycle(), SelfDriven())
    )
    np.testing.assert_allclose(outcome.S, expected.S, rtol=0, atol=2e-3)
    np.testing.assert_allclose(outcome.metrics.a_y_peak, expected.metrics.a_y_peak, rtol=0, atol=0.05)
    check_vehicle_model(SelfDriven)


def test_the_single_track_of_a_model() -> None:
    """On linear tyres all but exactly the parameters that the model was written with."""
    like = ldc.VehicleParameters(C_af=50000.0, C_ar=95000.0, I_z=2500.0)
    track = Bicycle(mu=1.2, C_f=150000.0, C_r=130000.0, I_z=3000.0).single_track(like)
    np.testing.assert_allclose([track.C_af, track.C_ar, track.I_z], [75000.0, 65000.0, 3000.0], rtol=1e-5)
    assert (track.m, track.w_v) == (1000.0, 1.9)


# ------------------------------------------------------------------------------------------------ errors


def model(derivatives: Callable[..., Any], **attributes: Any) -> ldc.VehicleModel:
    kind = type("Bad", (ldc.VehicleModel,), {"derivatives": derivatives, **attributes})
    return dataclasses.dataclass(frozen=True)(kind)()


def rates(**changed: Any) -> dict[str, Any]:
    return {"e_y_rate": 0.0, "e_psi_rate": 0.0} | changed


@pytest.mark.parametrize(
    ("derivatives", "path", "attributes"),
    [
        (lambda *_: 3, "Bad.derivatives", {}),
        (lambda *_: {"e_y_rate": 0.0}, "Bad.derivatives['e_psi_rate']", {}),
        (lambda *_: rates(roll=0.0), "Bad.derivatives.roll", {}),
        (lambda _, x, *__: rates(e_psi_rate=x.roll), "Bad.x.roll", {}),
        (lambda _, x, delta, v, v_rate, lane: rates(e_psi_rate=lane.curv), "Bad.lane.curv", {}),
        (lambda *_: rates(e_psi_rate=ca.SX.sym("free")), "Bad.derivatives['e_psi_rate']", {}),
        (lambda _, x, delta, v, *__: rates(e_psi_rate=ca.vertcat(v, v)), "Bad.derivatives['e_psi_rate']", {}),
        (lambda *_: rates(e_psi_rate=float("nan")), "Bad.derivatives['e_psi_rate']", {}),
        (lambda _, x, *__: rates(e_psi_rate=ca.sqrt(x.e_psi - 1.0)), "Bad.derivatives", {}),
        (lambda _, x, *__: rates(e_psi_rate=1.0 if x.e_psi > 0 else 0.0), "Bad.derivatives", {}),
        (lambda *_: rates(e_psi_rate=np.zeros(3)), "Bad.derivatives['e_psi_rate']", {"symbolic": False}),
        (lambda _, x, *__: rates(e_psi_rate=np.negative(x.e_psi, out=x.e_psi)), "Bad.derivatives", {"symbolic": False}),
        (lambda _, x, *__: rates(e_psi_rate=1j * x.e_psi), "Bad.derivatives['e_psi_rate']", {"symbolic": False}),
        (lambda _, x, delta, *__: rates(e_psi_rate=1e5 * (delta - x.e_psi_rate)), "Bad.derivatives", {}),
    ],
)
def test_what_a_model_must_not_give(derivatives: Callable[..., Any], path: str, attributes: dict[str, Any]) -> None:
    with pytest.raises(LdcError) as caught:
        simulate(ldc.LQR(), departures(20.0, n=4), y_s=0.1, setup=Setup(vehicle_model=model(derivatives, **attributes)))
    assert caught.value.path == path
    assert "\n" not in str(caught.value)


def test_states_that_become_nan() -> None:
    """An upright vehicle's are the model's fault, a spinning one's are a divergence."""
    good = Bicycle(mu=0.2)

    def lost(_: Any, x: Any, *moment: Any) -> dict[str, Any]:
        return dict(good.derivatives(x, *moment)) | {
            "e_psi_rate": ca.if_else(x.e_y > 1.1, ca.sqrt(-1.0 - x.e_y**2), 0.0)
        }

    with refused("Bad.derivatives", LdcError):
        simulate(ldc.LQR(), departures(20.0), y_s=0.1, setup=Setup(vehicle_model=model(lost)))

    def spun(_: Any, x: Any, *moment: Any) -> dict[str, Any]:
        rates = dict(good.derivatives(x, *moment))
        return rates | {"e_psi_rate": ca.if_else(ca.fabs(x.e_psi) > 0.6, ca.sqrt(-(x.e_psi**2)), rates["e_psi_rate"])}

    outcome = simulate(ldc.LQR(), departures(35.0), y_s=0.1, setup=Setup(vehicle_model=model(spun)))
    assert outcome.count(EventStatus.DIVERGED)
    assert np.isfinite(outcome.S).all()
    assert np.isfinite(outcome.metrics.a_y_peak).all()


def test_what_a_class_and_a_setup_must_be() -> None:
    class Bare(Bicycle):
        pass

    with refused("Bare"):
        Bare()
    with refused("Bad.states", value="e_y"):
        model(lambda *_: rates(), states=("e_y",))
    with refused("Bad.longest_step", value=0.0):
        model(lambda *_: rates(), longest_step=0.0)
    with refused("like"):
        Bicycle().single_track(None)  # type: ignore[arg-type]
    with refused("Bad"):
        dataclasses.dataclass(frozen=True)(type("Bad", (ldc.VehicleModel,), {}))()
    with refused("Bicycle.m"):
        Bicycle(m=np.ones(2))  # type: ignore[arg-type]
    with refused("vehicle_model"):
        Setup(vehicle_model=Bicycle)  # type: ignore[arg-type]
    with refused("mismatch"):
        Setup(vehicle_model=Bicycle(), options=PlantOptions(mismatch=ldc.Mismatch(m=(1.0, 1.3))))


@pytest.mark.parametrize("count", [0, 1])
def test_few_scenarios(count: int) -> None:
    few = departures(20.0, n=4).take(np.arange(count))
    for y_s in (0.1, 5.0):  # never deeper than 5 m
        outcome = simulate(ldc.LQR(), few, y_s=y_s, setup=Setup(vehicle_model=Car()), trajectories=True)
        assert outcome.S.shape == (count,)
        assert np.isfinite(outcome.S).all()


def test_the_contract() -> None:
    for car in (Bicycle, NumPyBicycle, Car()):
        check_vehicle_model(car)
    mean = model(lambda _, x, *__: rates(e_psi_rate=-x.e_psi_rate, e_y_rate=-x.e_y_rate.mean()), symbolic=False)
    with pytest.raises(ContractError) as caught:
        check_vehicle_model(mean)
    assert {fault.check for fault in caught.value.faults} == {"repeats"}


def test_another_process_gets_the_model_by_value() -> None:
    car = Car(relaxation=0.7)
    sent = pickle.loads(pickle.dumps(car))
    assert sent.identity == car.identity != Car().identity
    assert sent.relaxation == 0.7


# ------------------------------------------------------------------------------------------------ published models


@pytest.mark.slow
@pytest.mark.parametrize(("car", "best"), [(Drift(), "lqr"), (MultiBody(), "pure_pursuit")])
def test_rankings_on_published_models(car: ldc.VehicleModel, best: str) -> None:
    """50 departures behind a lag and a delay that laws do not know: the best law that never fails is another one on the
    model than on its single track, where the order of mean S is the same."""
    p = PARAMETERS
    like = ldc.VehicleParameters(m=p.m, I_z=p.I_z, l_f=p.a, l_r=p.b, C_af=60000.0, C_ar=60000.0)
    options = PlantOptions(speed="profile", actuator=Actuator(lag=0.15, delay=0.1))
    track = Setup(vehicle=car.single_track(like), options=options, plant_knowledge="ideal")
    scenarios, laws = (
        ldc.load_model("reference").sample(25, 25, seed=3),
        (ldc.Stanley(), ldc.LQR(r_delta=2000.0), ldc.PurePursuit()),
    )
    for setup, expected in ((track, "stanley"), (dataclasses.replace(track, vehicle_model=car), best)):
        outcomes = [simulate(law, scenarios, y_s=0.1, setup=setup) for law in laws]
        S = [outcome.S.mean() for outcome in outcomes]
        assert sorted(S) == S
        safe = [
            law.name for law, outcome in zip(laws, outcomes, strict=True) if not outcome.count(EventStatus.DIVERGED)
        ]
        assert safe[0] == expected
