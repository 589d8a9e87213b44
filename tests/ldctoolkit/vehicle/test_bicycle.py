"""Error dynamics, discretisation and steady cornering against independent routes."""

import dataclasses

import numpy as np
import pytest
import scipy.linalg
from scipy.integrate import quad

from ldctoolkit import BicycleModel, VehicleParameters
from ldctoolkit.errors import InputError
from ldctoolkit.vehicle import discretize
from ldctoolkit.vehicle.discretization import expm

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
        for ours, theirs in (
            (step.A, phi[:4, :4]),
            (step.B, phi[:4, 4]),
            (step.E_0, phi[:4, 5] - E_1),
            (step.E_1, E_1),
        ):
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


@pytest.mark.parametrize("v", [0.0, -3.0, np.nan, np.inf])
def test_bad_speeds_are_named(v: float) -> None:
    with pytest.raises(InputError, match=r"v\[1\] = .* m/s; allowed: finite speeds > 0"):
        BicycleModel().matrices([20.0, v])


def test_other_bad_input_is_named() -> None:
    with pytest.raises(InputError, match=r"convention: 'printed'.*did you mean 'as_printed'"):
        BicycleModel(convention="printed")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"vehicle\.m: -1"):
        VehicleParameters(m=-1.0)
    with pytest.raises(InputError, match=r"vehicle\.I_z: '3'"):
        VehicleParameters(I_z="3")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"vehicle\.w_v: 4\.0 m; allowed: less than the lane's width"):
        VehicleParameters(w_v=4.0)
    with pytest.raises(InputError, match=r"dt\[0\] = -0\.1 s"):
        discretize(np.zeros((1, 4, 4)), np.zeros((1, 4)), np.zeros((1, 4)), -0.1)


def test_defaults_are_table_i() -> None:
    table = {"C_af": 80000, "C_ar": 80000, "l_f": 1.43, "l_r": 1.47, "m": 1000, "I_z": 3344, "w_l": 3.6, "w_v": 1.9}
    assert dataclasses.asdict(VehicleParameters()) == table
