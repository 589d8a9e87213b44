"""Eight numbers as one value in compiled code, and the functions of vector_math on them."""

import math

import numba
import numpy as np
import pytest

from ldctoolkit.arrays import LANES
from ldctoolkit.lanes import any_lane, below, ceil, fma, largest, rint, select, smallest, table, zeros
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.vector_math import arctan, arctan_near, sine_and_cosine, tyre_force, tyre_series

A = np.array([-2.5, -0.0, 0.0, 0.5, 1.0, 3.5, np.inf, np.nan])
B = np.array([1.0, -1.0, 0.0, 0.5, np.nan, -3.0, 2.0, 1.0])


@numba.njit(**OPTIONS)  # type: ignore[untyped-decorator]
def _everything(memory, c):  # type: ignore[no-untyped-def]
    w = table(memory)
    a, b = w[0], w[1]
    w[2], w[3], w[4], w[5] = a + b, c - a, a * b, a / 2.0
    w[6], w[7], w[8] = fma(a, b, c), max(a, b), min(a, 1.0)
    w[9], w[10], w[11] = abs(a), -a, math.copysign(c, a)
    w[12], w[13] = rint(b), ceil(b)
    inside = (a > -1.0) & (a <= 1.0) | ~(b == b)
    w[14] = select(inside, a, 7.0)
    w[15] = select(inside & (c > 0.0), 1.0, 0.0)
    w[16] = select(c > 0.0, b, a)
    w[17] = 1.0 if any_lane(a > 3.0) else 0.0
    w[18] = 1.0 if any_lane(a < -3.0) else 0.0
    w[19, 3] = w[1, 3] + c
    a *= 2.0
    a -= b
    w[20] = a
    below(w, 21)[0] = largest(w[22]) - smallest(w[22])


def test_lanes_calculate_like_eight_numbers() -> None:
    w = zeros(23, LANES)
    w[0], w[1], w[22] = A, B, np.arange(LANES)
    _everything(w, 2.0)
    inside = ((A > -1.0) & (A <= 1.0)) | np.isnan(B)
    with np.errstate(invalid="ignore"):
        expected = [
            A + B, 2.0 - A, A * B, A / 2.0, A * B + 2.0, np.where(A > B, A, B), np.where(A < 1.0, A, 1.0),
            np.abs(A), -A,
            np.copysign(2.0, A), np.rint(B), np.ceil(B), np.where(inside, A, 7.0), np.where(inside, 1.0, 0.0), B,
            np.ones(8), np.zeros(8), np.where(np.arange(8) == 3, B + 2.0, 0.0), 2.0 * A - B, np.full(8, 7.0),
        ]  # fmt: skip
    np.testing.assert_array_equal(w[2:22], expected)
    np.testing.assert_array_equal(np.signbit(w[10]), np.signbit(-A))
    assert w.ctypes.data % 64 == 0


@numba.njit(**OPTIONS)  # type: ignore[untyped-decorator]
def _functions(memory, series):  # type: ignore[no-untyped-def]
    w = table(memory)
    x = w[0]
    w[1], w[2], w[3] = tyre_force(series, 0, x), arctan(x), arctan_near(x)
    w[4], w[5] = sine_and_cosine(x)


def functions(x: np.ndarray, shape: float = 1.3) -> np.ndarray:
    w = zeros(6, LANES)
    w[0] = x
    _functions(w, tyre_series(shape))
    return w


@pytest.mark.parametrize("shape", [1.0, 1.3, 1.65, 2.0])
def test_the_magic_formula_up_to_and_beyond_its_peak(shape: float) -> None:
    points = np.concatenate([np.linspace(-1.0, 1.0, 801)[:-1], np.geomspace(1.0, 1e6, 800)])
    for x in points.reshape(-1, LANES):
        force = functions(x, shape)[1]
        np.testing.assert_allclose(force, np.sin(shape * np.arctan(x)), rtol=0, atol=2e-9)
        np.testing.assert_array_equal(functions(-x, shape)[1], -force)


def test_angles() -> None:
    for x in np.linspace(-1.57, 1.57, 800).reshape(-1, LANES):
        w = functions(x)
        for row, exact in ((2, np.arctan(x)), (4, np.sin(x)), (5, np.cos(x))):
            np.testing.assert_allclose(w[row], exact, rtol=0, atol=4e-10)


def test_a_short_cut_has_the_bits_of_the_long_way() -> None:
    near = np.linspace(-0.41, 0.41, LANES)
    mixed = near.copy()
    mixed[0] = 50.0  # one lane that needs the long way
    a, b = functions(near), functions(mixed)
    np.testing.assert_array_equal(a[1:, 1:], b[1:, 1:])
    np.testing.assert_array_equal(a[2], a[3])
