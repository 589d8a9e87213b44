"""The vehicle: linear bicycle, saturating tyres, speeds."""

import dataclasses
import math
import pickle
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import numpy.typing as npt
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from helpers.closed_loop import grid
from helpers.errors import refused
from ldctoolkit import BicycleModel, Plant, VehicleParameters
from ldctoolkit.casadi_code import Names
from ldctoolkit.controllers._prediction_model import STATES, Vehicle
from ldctoolkit.declared import UnitWarning
from ldctoolkit.errors import LdcError
from ldctoolkit.vehicle import discretize
from ldctoolkit.vehicle.bicycle import GRAVITY
from ldctoolkit.vehicle.discretization import augmented, expm
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE, scheduled

SPEEDS = np.array([1.0, 5.0, 13.7, 28.0, 60.0])
OTHER = VehicleParameters(C_af=61000.0, C_ar=93000.0, l_f=1.1, l_r=1.7, m=1573.0, I_z=2873.0)


@pytest.mark.parametrize("p", [VehicleParameters(), OTHER])
@pytest.mark.parametrize("v", SPEEDS)
def test_every_entry_is_rajamanis(p: VehicleParameters, v: float) -> None:
    A, B, E = (matrix[0] for matrix in BicycleModel(p).matrices([v]))
    Caf, Car, lf, lr, m, Iz = p.C_af, p.C_ar, p.l_f, p.l_r, p.m, p.I_z
    # eq. 2.45 as printed in the book, entry by entry
    book_A = [
        [0, 1, 0, 0],
        [0, -(2 * Caf + 2 * Car) / (m * v), (2 * Caf + 2 * Car) / m, (-2 * Caf * lf + 2 * Car * lr) / (m * v)],
        [0, 0, 0, 1],
        [
            0, -(2 * Caf * lf - 2 * Car * lr) / (Iz * v), (2 * Caf * lf - 2 * Car * lr) / Iz,
            -(2 * Caf * lf**2 + 2 * Car * lr**2) / (Iz * v),
        ],
    ]  # fmt: skip
    book_B = [0, 2 * Caf / m, 0, 2 * Caf * lf / Iz]
    book_E = [0, -(2 * Caf * lf - 2 * Car * lr) / (m * v) - v, 0, -(2 * Caf * lf**2 + 2 * Car * lr**2) / (Iz * v)]
    np.testing.assert_allclose(A, book_A, rtol=1e-14)
    np.testing.assert_allclose(B, book_B, rtol=1e-14)
    np.testing.assert_allclose(E, book_E, rtol=1e-14)


def test_as_printed_changes_one_entry() -> None:
    p, v = VehicleParameters(), 20.0
    ours, printed = (BicycleModel(p, c).matrices([v])[0][0] for c in ("consistent", "as_printed"))
    assert printed[1, 3] == pytest.approx(-(2 * p.C_af * p.l_f + 2 * p.C_ar * p.l_r) / (p.m * v), rel=1e-14)
    changed = ours != printed
    assert np.argwhere(changed).tolist() == [[1, 3]]


@pytest.mark.parametrize("dt", [0.0, 0.01, 0.05, 0.2])
def test_discretisation_equals_scipys_exponential(dt: float) -> None:
    model = BicycleModel(OTHER)
    A, B, E = model.matrices(SPEEDS)
    step = model.discretize(SPEEDS, dt)
    for i in range(SPEEDS.size):
        # x, delta, r, slope of r: the classic augmentation in unscaled time
        M = np.zeros((7, 7))
        M[:4, :4], M[:4, 4], M[:4, 5], M[5, 6] = A[i], B[i], E[i], 1.0
        phi = scipy.linalg.expm(M * dt)
        E_1 = phi[:4, 6] / dt if dt else np.zeros(4)
        # measured against the size of the terms: entries of B reach 10
        pairs = (step.A, phi[:4, :4]), (step.B, phi[:4, 4]), (step.E_0, phi[:4, 5] - E_1), (step.E_1, E_1)
        for ours, theirs in pairs:
            np.testing.assert_allclose(ours[i], theirs, rtol=1e-12, atol=1e-12)


def test_area_weights_equal_quadrature() -> None:
    model, dt = BicycleModel(), 0.05
    step = model.discretize([17.0], dt)
    A, B, E = (matrix[0] for matrix in model.matrices([17.0]))
    x_0, delta, r_0, r_1 = np.array([0.9, 0.3, -0.02, 0.1]), 0.03, 0.05, 0.08

    def e_y(s: float) -> float:
        M = np.zeros((7, 7))
        M[:4, :4], M[:4, 4], M[:4, 5], M[5, 6] = A, B, E, 1.0
        return float((scipy.linalg.expm(M * s) @ [*x_0, delta, r_0, (r_1 - r_0) / dt])[0])

    expected, _ = quad(e_y, 0.0, dt, epsabs=1e-14)
    area = step.area_x[0] @ x_0 + step.area_delta[0] * delta + step.area_r_0[0] * r_0 + step.area_r_1[0] * r_1
    assert area == pytest.approx(expected, abs=1e-13)


def test_a_result_does_not_depend_on_the_stack() -> None:
    rng = np.random.default_rng(0)
    M = rng.normal(size=(40, 8, 8)) * rng.uniform(0.01, 30, (40, 1, 1))
    whole = expm(M)
    for i in (0, 13, 39):
        np.testing.assert_array_equal(expm(M[i : i + 1])[0], whole[i])
    assert expm(M[:0]).shape == (0, 8, 8)


def test_steady_state_holds_a_bend() -> None:
    model = BicycleModel(OTHER)
    A, B, E = model.matrices(SPEEDS)
    steady = model.steady_state(SPEEDS)
    x = np.zeros((SPEEDS.size, 4))
    x[:, 2] = steady.e_psi
    rest = np.einsum("nij,nj->ni", A, x) + B * steady.delta[:, None] + E
    np.testing.assert_allclose(rest, 0.0, atol=1e-9)
    # Rajamani eq. 3.12: delta = L/R + K_V a_y, per unit of yaw rate v/R
    p, v, length = OTHER, SPEEDS, OTHER.l_f + OTHER.l_r
    K_V = p.l_r * p.m / (2 * p.C_af * length) - p.l_f * p.m / (2 * p.C_ar * length)
    np.testing.assert_allclose(steady.delta, length / v + K_V * v, rtol=1e-12)
    # and its heading error -l_r/R + l_f m v^2 / (2 C_ar L R)
    np.testing.assert_allclose(steady.e_psi, -p.l_r / v + p.l_f * p.m * v / (2 * p.C_ar * length), rtol=1e-11)


@pytest.mark.parametrize(
    ("call", "path", "value"),
    [
        *((lambda v=v: BicycleModel().matrices([20.0, v]), "v[1]", v) for v in (0.0, -3.0, np.nan, np.inf)),
        (lambda: BicycleModel(convention="printed"), "convention", "printed"),  # type: ignore[arg-type]
        (lambda: VehicleParameters(m=-1.0), "vehicle.m", -1.0),
        (lambda: VehicleParameters(I_z="3"), "vehicle.I_z", "3"),  # type: ignore[arg-type]
        (lambda: VehicleParameters(l_f=True), "vehicle.l_f", True),
        (lambda: VehicleParameters(w_v=4.0), "vehicle.w_v", 4.0),
        (lambda: discretize(np.zeros((1, 4, 4)), np.zeros((1, 4)), np.zeros((1, 4)), -0.1), "dt[0]", -0.1),
        *((lambda v=v: scheduled(_Smooth(1.0), np.array([20.0, v]), "values"), "speed at the trigger", v)
          for v in (0.99, 90.1, np.nan)),
        (lambda: scheduled(lambda v: np.abs(v - 20.0)[:, None], np.array([20.0]), "gains"), "gains", ...),
    ],
)  # fmt: skip
def test_bad_input_is_named(call: Callable[[], object], path: str, value: Any) -> None:
    with refused(path, value=value, kind=LdcError):
        call()


def test_defaults_are_table_i() -> None:
    table = {"C_af": 80000, "C_ar": 80000, "l_f": 1.43, "l_r": 1.47, "m": 1000, "I_z": 3344, "w_l": 3.6, "w_v": 1.9}
    assert dataclasses.asdict(VehicleParameters()) == table | {"steering_ratio": 15}


MOTION, V, VEHICLE = casadi.SX.sym("motion", 5), casadi.SX.sym("v"), casadi.SX.sym("vehicle", 8)
PARAMETERS = ("C_af", "C_ar", "l_f", "l_r", "m", "I_z", "mu")
RATES = Vehicle("vehicle", v=V, **dict(zip(PARAMETERS, casadi.vertsplit(VEHICLE[:7]), strict=True))).nonlinear(
    Names("x", **dict(zip(STATES, casadi.vertsplit(casadi.vertcat(0.0, MOTION[:3])), strict=True))),
    MOTION[3], Names("lane", yaw_rate=MOTION[4]), shape=VEHICLE[7],
)  # fmt: skip
ACCELERATIONS = casadi.vertcat(RATES["e_y_rate"], RATES["e_psi_rate"], RATES["a_y"] + V * MOTION[4])
PLANT = casadi.Function("plant", [MOTION, V, VEHICLE], [ACCELERATIONS])
JACOBIAN = casadi.Function("J", [MOTION, V, VEHICLE], [casadi.jacobian(ACCELERATIONS, MOTION)])

MU, SHAPE = 0.9, 1.3


def numbers(p: VehicleParameters, mu: float = MU, shape: float = SHAPE) -> tuple[float, ...]:
    """The plant's parameters in its order."""
    return (p.C_af, p.C_ar, p.l_f, p.l_r, p.m, p.I_z, mu, shape)


def grip(p: VehicleParameters, mu: float) -> npt.NDArray[np.float64]:
    """Friction times static load of the front and the rear axle, from the moment balance about the other axle."""
    length = p.l_f + p.l_r
    return mu * p.m * 9.81 * np.array([p.l_r, p.l_f]) / length


def nonlinear(motion: Any, v: float, p: VehicleParameters, mu: float = MU, shape: float = SHAPE) -> np.ndarray:
    """e_y'', e_psi'' and a_y of the nonlinear bicycle in a motion (e_y', e_psi, e_psi', delta, r)."""
    return PLANT(motion, v, numbers(p, mu, shape)).full().ravel()


def axle_forces(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float = SHAPE) -> np.ndarray:
    """Front force along the wheel's axis and rear force, from the accelerations that they cause."""
    _, yaw, a_y = nonlinear(motion, v, p, mu, shape)
    front, rear = p.m * a_y * p.l_r + p.I_z * yaw, p.m * a_y * p.l_f - p.I_z * yaw
    return np.array([front / math.cos(motion[3]), rear]) / (p.l_f + p.l_r)


vehicles = st.builds(
    VehicleParameters, C_af=st.floats(3e4, 2e5), C_ar=st.floats(3e4, 2e5), l_f=st.floats(0.8, 2.0),
    l_r=st.floats(0.8, 2.0), m=st.floats(700.0, 3000.0), I_z=st.floats(800.0, 6000.0),
)  # fmt: skip
# e_y_rate, e_psi, e_psi_rate, delta, r: everything that is mirrored
motions = st.tuples(*(st.floats(-size, size) for size in (5.0, 0.5, 1.0, 0.6, 0.6)))
speeds, friction, shapes = st.floats(2.0, 60.0), st.floats(0.05, 1.5), st.floats(1.0, 2.0)


@pytest.mark.parametrize("p", [VehicleParameters(), OTHER])
@pytest.mark.parametrize("v", [3.0, 13.7, 28.0, 60.0])
@pytest.mark.parametrize(("mu", "shape"), [(0.9, 1.3), (0.3, 1.9)])
def test_straight_driving_has_rajamanis_matrices(p: VehicleParameters, v: float, mu: float, shape: float) -> None:
    J = np.array(JACOBIAN(np.zeros(5), v, numbers(p, mu, shape)))
    A, B, E = (matrix[0] for matrix in BicycleModel(p).matrices(v))
    force = np.array([1 / v, 1.0, (p.l_f + p.l_r) / v, 1.0, (p.l_f + p.l_r) / v]) * 2 * (p.C_af + p.C_ar)
    for row, ours, terms in ((1, J[0], force / p.m + v), (3, J[1], force * (p.l_f + p.l_r) / p.I_z)):
        expected = np.array([*A[row, 1:], B[row], E[row]])
        # to rounding of the axles' terms, which nearly cancel in a neutral vehicle
        assert np.all(np.abs(ours - expected) <= 1e-15 * terms)
    # e_y'' is relative to the lane's frame, which turns with r
    np.testing.assert_allclose(J[2], J[0] + [0.0, 0.0, 0.0, 0.0, v], rtol=1e-12, atol=1e-11)


@given(motion=motions, v=speeds, p=vehicles, mu=friction, shape=shapes)
def test_mirrored_motions(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float) -> None:
    mirrored = nonlinear([-value for value in motion], v, p, mu, shape)
    np.testing.assert_array_equal(
        mirrored, -nonlinear(motion, v, p, mu, shape)
    )  # sine, arctangent and every sum are odd to the bit


@given(motion=motions, v=speeds, p=vehicles, mu=friction, shape=shapes)
def test_no_axle_exceeds_its_grip(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float) -> None:
    # rounding of a moment in which both axles' forces cancel
    assert np.all(np.abs(axle_forces(motion, v, p, mu, shape)) <= grip(p, mu) + 1e-12 * grip(p, mu).sum())


@given(motion=motions, v=speeds, p=vehicles, mu=friction, shape=shapes)
def test_large_angles_by_hand(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float) -> None:
    """Forces along the wheels' axes, moments as cross products, de_y/dt differentiated by a complex step."""
    e_y_rate, e_psi, e_psi_rate, delta, r = motion
    omega = e_psi_rate + r
    v_y = (e_y_rate - v * math.sin(e_psi)) / math.cos(e_psi)
    total, moment = 0j, 0.0
    for x, C_alpha, angle, most in zip((p.l_f, -p.l_r), (p.C_af, p.C_ar), (delta, 0.0), grip(p, mu), strict=True):
        velocity = v + 1j * (v_y + omega * x)
        D, B = most, 2 * C_alpha / (shape * most)
        force = D * math.sin(shape * math.atan(B * (angle - np.angle(velocity)))) * 1j * np.exp(1j * angle)
        total += force
        moment += (x * force).imag
    v_y_rate, h = total.imag / p.m - v * omega, 1e-30j
    moved = v * np.sin(e_psi + e_psi_rate * h) + (v_y + v_y_rate * h) * np.cos(e_psi + e_psi_rate * h)
    expected = np.array([moved.imag / h.imag, moment / p.I_z, total.imag / p.m])
    size = np.abs([v * omega, 0.0, 0.0]) + np.array([1 / p.m, 3.0 / p.I_z, 1 / p.m]) * sum(grip(p, mu))
    ours = nonlinear(motion, v, p, mu, shape)
    # the force's argument carries the rounding of the slip angles, times the slope of the force
    slope = 2 * (p.C_af + p.C_ar) * np.array([1 / p.m, 3.0 / p.I_z, 1 / p.m])
    assert np.all(np.abs(ours - expected) <= 1e-14 * (size + slope + abs(v) + abs(v_y)))


@pytest.mark.parametrize("p", [VehicleParameters(), OTHER])
@pytest.mark.parametrize("shape", [1.0, 1.3, 2.0])
def test_the_curve_of_the_force(p: VehicleParameters, shape: float) -> None:
    """Slope at zero, first bend, height and place of the peak; by steering alone, so that alpha_f = delta."""

    def front(alpha: float) -> float:
        return float(axle_forces((0.0, 0.0, 0.0, alpha, 0.0), 20.0, p, 0.3, shape)[0])

    most = grip(p, 0.3)[0]
    small = 1e-6
    assert front(small) / small == pytest.approx(2 * p.C_af, rel=1e-7)  # the next term is of the order small^2
    # sin(C atan(x/C)) = x - x^3 (1/3 + C^2/6)/C^2 + ..., x = force of the linear tyre over its grip
    x = 0.02
    bend = (most * x - front(x * most / (2 * p.C_af))) / (most * x**3)
    assert bend == pytest.approx((1 / 3 + shape**2 / 6) / shape**2, rel=2e-3)  # next term of relative order x^2
    if shape > 1.0:
        peak = shape * math.tan(math.pi / (2 * shape)) * most / (2 * p.C_af)
        assert front(peak) == pytest.approx(most, rel=1e-12)
        assert front(0.9 * peak) < most
        assert front(1.1 * peak) < most


def drive(p: VehicleParameters, v: float, delta: Any, end: float, mu: float, times: npt.NDArray[np.float64]) -> Any:
    """The nonlinear plant on a straight lane at constant speed, from straight driving: (e_y, e_y', e_psi, e_psi')."""

    def rate(t: float, x: npt.NDArray[np.float64]) -> list[float]:
        e_y_acceleration, e_psi_acceleration, _ = nonlinear([*x[1:], delta(t), 0.0], v, p, mu)
        return [x[1], e_y_acceleration, x[3], e_psi_acceleration]

    return solve_ivp(rate, (0.0, end), np.zeros(4), "DOP853", t_eval=times, rtol=1e-12, atol=1e-15)


def commonroad(p: VehicleParameters, shift: float) -> Any:
    """The other library's vehicle with our mass, inertia, lengths and axle stiffnesses. Its axle stiffness is -p_ky1
    times the axle's load, p_ky1 one number for both axles: with static loads this makes a neutral vehicle. For another
    one the load is shifted: `shift` is longitudinal acceleration times height [m^2/s^2]."""
    other = setup_vehicle_parameters(vehicle_id=2)
    other.a, other.b, other.m, other.I_z, other.h_s = p.l_f, p.l_r, p.m, p.I_z, shift
    other.tire.p_ky1 = -2 * (p.C_af + p.C_ar) / (p.m * GRAVITY)
    return other


def drive_commonroad(
    p: VehicleParameters, v: float, delta: Any, steering_rate: Any, end: float, times: npt.NDArray[np.float64]
) -> Any:
    """(yaw rate, side slip, lateral position) of `vehicle_dynamics_st` from straight driving at constant speed."""
    # axle loads m (g l_r - shift)/L and m (g l_f + shift)/L in the ratio of our stiffnesses
    shift = GRAVITY * (p.C_ar * p.l_r - p.C_af * p.l_f) / (p.C_af + p.C_ar)
    other = commonroad(p, shift)

    def rate(t: float, z: npt.NDArray[np.float64]) -> list[float]:
        derivative = vehicle_dynamics_st([*z[:2], delta(t), *z[3:]], [steering_rate(t), 1.0], other)
        derivative[3] = 0.0  # the acceleration of 1 m/s^2 stands for its load transfer only; the speed is constant
        return list(derivative)

    start = [0.0, 0.0, delta(0.0), v, 0.0, 0.0, 0.0]
    z = solve_ivp(rate, (0.0, end), start, "DOP853", t_eval=times, rtol=1e-12, atol=1e-15).y
    return np.array([z[5], z[6], z[1]])


NEUTRAL = VehicleParameters(C_af=8e4 * 1.47 / 1.43, C_ar=8e4)


@pytest.mark.parametrize(
    ("p", "mu"), grid([NEUTRAL, OTHER, VehicleParameters()], [0.9, 1e6], (OTHER, 0.9), (VehicleParameters(), 1e6))
)
def test_a_lane_change_equals_commonroads_single_track_model(p: VehicleParameters, mu: float) -> None:
    """Two models of one vehicle: what differs is of third order in the steering angle. `vehicle_dynamics_st` has tyres
    linear in alpha = delta - beta - l_f omega/v and keeps the speed of the centre of gravity constant, so m v (beta' +
    omega) = F_f + F_r with no cos delta. Ours keeps the component along the vehicle constant and has v_y = v tan beta,
    arctangents, cos delta and the tyres' bend. Every one of these is odd and differs from the first order by a third
    order; the bend of the tyres goes away as mu grows."""
    v, end = 20.0, 3.0
    times, frequency = np.linspace(0.0, end, 61), 2 * math.pi / 2.0
    differences, sizes = [], []
    for amplitude in (0.02, 0.01, 0.005):

        def delta(t: float, amplitude: float = amplitude) -> float:
            return amplitude * math.sin(frequency * t)

        def steering_rate(t: float, amplitude: float = amplitude) -> float:
            return amplitude * frequency * math.cos(frequency * t)

        theirs = drive_commonroad(p, v, delta, steering_rate, end, times)
        e_y, e_y_rate, e_psi, e_psi_rate = drive(p, v, delta, end, mu, times).y
        beta = np.arctan((e_y_rate - v * np.sin(e_psi)) / (v * np.cos(e_psi)))
        differences.append(np.abs(np.array([e_psi_rate, beta, e_y]) - theirs).max(axis=1))
        sizes.append(np.abs(theirs).max(axis=1))
    order = np.log2(np.array(differences[:-1]) / np.array(differences[1:]))
    # the next order is the fifth: what the third leaves over falls to a quarter from one halving to the next
    assert np.all(np.abs(order - 3.0) < [[0.03], [0.0075]])
    # yaw rate, side slip, lateral position at 0.02 rad: 2.5 m/s^2, where the tyres' bend is seen in the side slip
    at_most = [0.01, 0.06, 0.005] if mu < 1.0 else [2e-4, 2e-4, 1e-4]
    assert np.all(differences[0] / sizes[0] < at_most)


@dataclasses.dataclass(frozen=True)
class _Smooth:
    scale: float

    def __call__(self, v: np.ndarray) -> np.ndarray:
        return np.column_stack([self.scale / v, np.exp(-v / 30.0), np.zeros_like(v)])


def test_a_smooth_function_comes_back_to_rounding() -> None:
    v = np.concatenate([SPEED_RANGE, np.random.default_rng(0).uniform(*SPEED_RANGE, 50)])
    values = scheduled(_Smooth(3.0), v, "values")
    assert values.flags.c_contiguous
    # Clenshaw's recurrence with 48 terms multiplies roundings at the ends of the range
    np.testing.assert_allclose(values, _Smooth(3.0)(v), rtol=0, atol=1e-12)


def test_equal_functions_share_one_interpolant_and_others_do_not() -> None:
    calls = []

    @dataclasses.dataclass(frozen=True)
    class Counted(_Smooth):
        def __call__(self, v: np.ndarray) -> np.ndarray:
            calls.append(v.size)
            return super().__call__(v)

    v = np.array([20.0])
    first, second, other = (scheduled(Counted(scale), v, "values") for scale in (2.0, 2.0, 4.0))
    assert len(calls) == 2
    np.testing.assert_array_equal(first, second)
    assert other[0, 0] == pytest.approx(0.2, abs=1e-12)


def test_a_speed_has_the_same_bits_in_any_set() -> None:
    v = np.random.default_rng(1).uniform(*SPEED_RANGE, 70)
    whole = scheduled(_Smooth(1.0), v, "values")
    alone = np.concatenate([scheduled(_Smooth(1.0), v[i : i + 1], "values") for i in range(v.size)])
    np.testing.assert_array_equal(whole, alone)


def test_some_columns_have_the_bits_of_all() -> None:
    v = np.random.default_rng(2).uniform(*SPEED_RANGE, 30)
    whole = scheduled(_Smooth(1.0), v, "values")
    np.testing.assert_array_equal(scheduled(_Smooth(1.0), v, "values", columns=slice(1, 3)), whole[:, 1:3])


@pytest.mark.parametrize(("dt", "lag", "delay"), [(0.05, 0.0, 0.0), (0.05, 0.1, 0.12), (0.2, 0.02, 0.25)])
@pytest.mark.parametrize("model", [BicycleModel(), BicycleModel(OTHER)])
def test_a_sampled_plant_is_the_exponential_to_rounding(
    model: BicycleModel, dt: float, lag: float, delay: float
) -> None:
    v = np.concatenate([[0.5, 95.0], SPEED_RANGE, np.random.default_rng(3).uniform(*SPEED_RANGE, 200)])
    ours = Plant.build(model, v, dt, lag=lag, delay=delay).augmented
    exact = augmented(*model.matrices(v), dt, lag=lag, delay=delay)
    alone = Plant.build(model, v[4:5], dt, lag=lag, delay=delay).augmented
    assert (ours.whole, ours.split) == (exact.whole, exact.split)
    for name in ("A", "B", "B_old", "E_0", "E_1"):
        values, expected = getattr(ours, name), getattr(exact, name)
        np.testing.assert_array_equal(values[:2], expected[:2])
        np.testing.assert_array_equal(values[4:5], getattr(alone, name))
        assert np.all(np.abs(values - expected)[2:] <= 5e-13 * np.abs(expected[2:]).max(axis=0))


def test_a_plant_that_rounding_spoils_is_not_interpolated() -> None:
    # at walking pace the printed matrix diverges by twelve orders of magnitude within a sample
    v, numbers = np.array([3.0, 20.0]), {"lag": 0.01, "delay": 0.013}
    model = BicycleModel(convention="as_printed")
    ours = Plant.build(model, v, 0.5, **numbers).augmented
    np.testing.assert_array_equal(ours.B, augmented(*model.matrices(v), 0.5, **numbers).B)


SHEET = {"mass": 1650.0, "front_load": 910.0, "wheelbase": 2.8, "understeer_gradient": 0.003}


def sheet(**changes: Any) -> VehicleParameters:
    return VehicleParameters.from_data_sheet(**(SHEET | changes))


@pytest.mark.parametrize("coefficient", [None, 12.0, 25.0])
@pytest.mark.parametrize("gradient", [-0.001, 0.0, 0.003])
def test_a_data_sheets_vehicle_has_its_understeer_gradient(gradient: float, coefficient: float | None) -> None:
    vehicle = sheet(understeer_gradient=gradient, rear_cornering_coefficient=coefficient)
    assert (vehicle.m, vehicle.l_f + vehicle.l_r) == (1650.0, pytest.approx(2.8))
    assert vehicle.m * vehicle.l_r / 2.8 == pytest.approx(910.0)  # the front axle's load
    steady = BicycleModel(vehicle).steady_state(SPEEDS).delta
    np.testing.assert_allclose((steady * SPEEDS - 2.8) / SPEEDS**2, gradient, atol=1e-12)
    assert 2.0 * vehicle.C_ar == pytest.approx((coefficient or 20.0) * 740.0 * 9.81)
    assert pytest.approx(1650.0 * vehicle.l_f * vehicle.l_r) == vehicle.I_z


def test_what_a_data_sheet_assumes_is_said() -> None:
    full = sheet(yaw_inertia=2800.0, rear_cornering_coefficient=18.0, steering_ratio=15.2, width=1.85, lane_width=3.5)
    assert full.notes == VehicleParameters().notes == ()
    assert (full.I_z, full.steering_ratio, full.w_v, full.w_l) == (2800.0, 15.2, 1.85, 3.5)
    notes = sheet().notes
    for note, name in zip(notes, ("I_z", "cornering stiffness", "steering_ratio", "w_v"), strict=True):
        assert name in note
        assert "usual" in note
    assert dataclasses.replace(sheet(), I_z=3000.0).notes == ()
    assert sheet() == VehicleParameters(**dataclasses.asdict(sheet()))
    assert pickle.loads(pickle.dumps(sheet())).notes == notes


def test_axle_loads_in_kg_and_as_shares() -> None:
    expected = sheet()
    for loads in (
        {"front_load": 910.0 / 1650.0}, {"front_load": None, "rear_load": 740.0}, {"rear_load": 740.0},
        {"front_load": None, "rear_load": 740.0 / 1650.0}, {"rear_load": 740.0 / 1650.0},
        {"front_load": 919.1, "rear_load": 747.4},  # 1 % more, in the same proportion
    ):  # fmt: skip
        vehicle = sheet(**loads)
        assert vehicle.l_f == pytest.approx(expected.l_f)
        assert vehicle.C_af == pytest.approx(expected.C_af)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"rear_load": 760.0}, "rear_load"), ({"rear_load": 720.0}, "rear_load"), ({"rear_load": 0.43}, "rear_load"),
        ({"front_load": None}, "front_load"), ({"front_load": 55.0}, "front_load"),
        ({"front_load": 0.05}, "front_load"), ({"front_load": 1650.0}, "front_load"),
        ({"front_load": 8927.0}, "front_load"), ({"front_load": -1.0}, "front_load"),
        ({"front_load": None, "rear_load": 1.65}, "rear_load"), ({"mass": None}, "mass"), ({"mass": math.nan}, "mass"),
        ({"mass": 1.65}, "front_load"), ({"wheelbase": "2.8"}, "wheelbase"), ({"yaw_inertia": 0.0}, "yaw_inertia"),
        ({"understeer_gradient": None}, "understeer_gradient"), ({"width": True}, "width"),
        ({"understeer_gradient": -0.0051}, "understeer_gradient"),
        ({"rear_cornering_coefficient": 145000.0}, "rear_cornering_coefficient"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::ldctoolkit.declared.UnitWarning")
def test_a_data_sheet_that_cannot_be_is_refused(changes: dict[str, Any], field: str) -> None:
    with refused(f"data_sheet.{field}"):
        sheet(**changes)


@pytest.mark.parametrize(
    ("changes", "meant"),
    [
        ({"understeer_gradient": 1.7}, "0.003025 rad/(m/s^2)"), ({"understeer_gradient": 0.17}, "0.002967 rad/(m/s^2)"),
        ({"wheelbase": 2800.0}, "2.8 m"), ({"wheelbase": 280.0}, "2.8 m"), ({"yaw_inertia": 2.8}, "2800 kg m^2"),
        ({"mass": 1.65, "front_load": 0.55}, "1650 kg"), ({"rear_cornering_coefficient": 0.2}, "11.46 1/rad"),
    ],
)  # fmt: skip
def test_a_data_sheets_likely_slip_of_unit_gives_one_warning(changes: dict[str, Any], meant: str) -> None:
    with pytest.warns(UnitWarning) as caught:
        sheet(**changes)
    assert [str(one.message).partition(":")[0] for one in caught] == [f"data_sheet.{next(iter(changes))}"]
    assert str(caught[0].message).endswith(f" {meant}")
    assert caught[0].filename == __file__
