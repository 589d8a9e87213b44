"""The nonlinear plant: compiled against CasADi, its linearisation, its symmetry, its tyres, another library's model."""

import inspect
import math
from typing import Any

import casadi
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st
from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

from helpers.grids import grid
from helpers.tools import tool
from ldctoolkit import BicycleModel, VehicleParameters
from ldctoolkit.vehicle import _nonlinear_compiled
from ldctoolkit.vehicle.bicycle import GRAVITY

INPUTS, PARAMETERS = tool("nonlinear_plant").INPUTS, tool("nonlinear_plant").PARAMETERS
DYNAMICS = tool("nonlinear_plant").nonlinear_dynamics()
SYMBOLS = [casadi.SX.sym(name) for name in DYNAMICS.name_in()]
JACOBIAN = casadi.Function(
    "J", SYMBOLS, [casadi.jacobian(casadi.vertcat(*DYNAMICS(*SYMBOLS)), casadi.vertcat(*SYMBOLS[:5]))]
)

nonlinear_rhs = _nonlinear_compiled.nonlinear_rhs.py_func
"""The generated lines as Python evaluates them; compiled they are tested in the closed loop."""

OTHER = VehicleParameters(C_af=61000.0, C_ar=93000.0, l_f=1.1, l_r=1.7, m=1573.0, I_z=2873.0)
MU, SHAPE = 0.9, 1.3


def numbers(p: VehicleParameters, mu: float = MU, shape: float = SHAPE) -> tuple[float, ...]:
    """The plant's parameters in its order."""
    return (p.C_af, p.C_ar, p.l_f, p.l_r, p.m, p.I_z, mu, shape)


def grip(p: VehicleParameters, mu: float) -> npt.NDArray[np.float64]:
    """Friction times static load of the front and the rear axle, from the moment balance about the other axle."""
    length = p.l_f + p.l_r
    return mu * p.m * 9.81 * np.array([p.l_r, p.l_f]) / length


def axle_forces(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float = SHAPE) -> np.ndarray:
    """Front force along the wheel's axis and rear force, from the accelerations that they cause."""
    _, yaw, a_y = nonlinear_rhs(*motion, v, 0.0, *numbers(p, mu, shape))
    front, rear = p.m * a_y * p.l_r + p.I_z * yaw, p.m * a_y * p.l_f - p.I_z * yaw
    return np.array([front / math.cos(motion[3]), rear]) / (p.l_f + p.l_r)


vehicles = st.builds(
    VehicleParameters, C_af=st.floats(3e4, 2e5), C_ar=st.floats(3e4, 2e5), l_f=st.floats(0.8, 2.0),
    l_r=st.floats(0.8, 2.0), m=st.floats(700.0, 3000.0), I_z=st.floats(800.0, 6000.0),
)  # fmt: skip
# e_y_rate, e_psi, e_psi_rate, delta, r: everything that is mirrored
motions = st.tuples(*(st.floats(-size, size) for size in (5.0, 0.5, 1.0, 0.6, 0.6)))
speeds, friction, shapes = st.floats(2.0, 60.0), st.floats(0.05, 1.5), st.floats(1.0, 2.0)


def test_the_compiled_function_has_the_order_of_casadis() -> None:
    assert list(inspect.signature(nonlinear_rhs).parameters) == [*INPUTS, *PARAMETERS]
    assert list(DYNAMICS.name_in()) == [*INPUTS, *PARAMETERS]


@given(motion=motions, v=speeds, dv=st.floats(-5.0, 5.0), p=vehicles, mu=friction, shape=shapes)
def test_compiled_is_casadis(motion: Any, v: float, dv: float, p: VehicleParameters, mu: float, shape: float) -> None:
    arguments = (*motion, v, dv, *numbers(p, mu, shape))
    ours, theirs = np.array(nonlinear_rhs(*arguments)), np.array(DYNAMICS(*arguments)).ravel()
    # relative to the terms that are added up: where they cancel, nothing is left to be relative to
    front, rear = grip(p, mu)
    force = (front + rear) / p.m
    size = np.array([force + v * (abs(motion[2]) + abs(motion[4])), (p.l_f * front + p.l_r * rear) / p.I_z, force])
    assert np.all(np.abs(ours - theirs) <= 1e-13 * (np.abs(theirs) + size))


@pytest.mark.parametrize("p", [VehicleParameters(), OTHER])
@pytest.mark.parametrize("v", [3.0, 13.7, 28.0, 60.0])
@pytest.mark.parametrize(("mu", "shape"), [(0.9, 1.3), (0.3, 1.9)])
def test_straight_driving_has_rajamanis_matrices(p: VehicleParameters, v: float, mu: float, shape: float) -> None:
    dv = -0.7
    J = np.array(JACOBIAN(0.0, 0.0, 0.0, 0.0, 0.0, v, dv, *numbers(p, mu, shape)))
    A, B, E = (matrix[0] for matrix in BicycleModel(p).matrices(v))
    force = np.array([1 / v, 1.0, (p.l_f + p.l_r) / v, 1.0, (p.l_f + p.l_r) / v]) * 2 * (p.C_af + p.C_ar)
    for row, ours, terms in ((1, J[0], force / p.m + v), (3, J[1], force * (p.l_f + p.l_r) / p.I_z)):
        expected = np.array([*A[row, 1:], B[row], E[row]])
        if row == 1:
            expected[1] += dv  # the heading error turns the speed's rate into the lane's frame
        # to rounding of the axles' terms, which nearly cancel in a neutral vehicle
        assert np.all(np.abs(ours - expected) <= 1e-15 * terms)
    # a_y is what is left of e_y'' when the frame's own motion is taken out: v r, and dv turned by e_psi
    np.testing.assert_allclose(J[2], J[0] + [0.0, -dv, 0.0, 0.0, v], rtol=1e-12, atol=1e-11)


@given(motion=motions, v=speeds, dv=st.floats(-5.0, 5.0), p=vehicles, mu=friction, shape=shapes)
def test_mirrored_motions(motion: Any, v: float, dv: float, p: VehicleParameters, mu: float, shape: float) -> None:
    ours = np.array(nonlinear_rhs(*motion, v, dv, *numbers(p, mu, shape)))
    mirrored = np.array(nonlinear_rhs(*(-value for value in motion), v, dv, *numbers(p, mu, shape)))
    np.testing.assert_array_equal(mirrored, -ours)  # sine, arctangent and every sum are odd to the bit


@given(motion=motions, v=speeds, p=vehicles, mu=friction, shape=shapes)
def test_no_axle_exceeds_its_grip(motion: Any, v: float, p: VehicleParameters, mu: float, shape: float) -> None:
    # rounding of a moment in which both axles' forces cancel
    assert np.all(np.abs(axle_forces(motion, v, p, mu, shape)) <= grip(p, mu) + 1e-12 * grip(p, mu).sum())


@given(motion=motions, v=speeds, dv=st.floats(-5.0, 5.0), p=vehicles, mu=friction, shape=shapes)
def test_large_angles_by_hand(motion: Any, v: float, dv: float, p: VehicleParameters, mu: float, shape: float) -> None:
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
    moved = (v + dv * h) * np.sin(e_psi + e_psi_rate * h) + (v_y + v_y_rate * h) * np.cos(e_psi + e_psi_rate * h)
    expected = np.array([moved.imag / h.imag, moment / p.I_z, total.imag / p.m])
    size = np.abs([v * omega, 0.0, 0.0]) + np.array([1 / p.m, 3.0 / p.I_z, 1 / p.m]) * sum(grip(p, mu))
    ours = np.array(nonlinear_rhs(*motion, v, dv, *numbers(p, mu, shape)))
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
        e_y_acceleration, e_psi_acceleration, _ = nonlinear_rhs(*x[1:], delta(t), 0.0, v, 0.0, *numbers(p, mu))
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
