"""Interpolants over speed: exact for smooth functions, refused for others, made once."""

import dataclasses

import numpy as np
import pytest

from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE, scheduled


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
    together = scheduled(_Smooth(1.0), v, "values")
    alone = np.concatenate([scheduled(_Smooth(1.0), v[i : i + 1], "values") for i in range(v.size)])
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("v", [0.99, 90.1, float("nan")])
def test_speeds_outside_the_range_are_named(v: float) -> None:
    with pytest.raises(InputError, match=rf"{v:g} m/s; allowed for scheduled gains: 1 to 90"):
        scheduled(_Smooth(1.0), np.array([20.0, v]), "values")


def test_a_kink_is_refused() -> None:
    with pytest.raises(LdcError, match="gains of a kink change too sharply with speed"):
        scheduled(lambda v: np.abs(v - 20.0)[:, None], np.array([20.0]), "gains of a kink")


def test_some_columns_have_the_bits_of_all() -> None:
    v = np.random.default_rng(2).uniform(*SPEED_RANGE, 30)
    whole = scheduled(_Smooth(1.0), v, "values")
    np.testing.assert_array_equal(scheduled(_Smooth(1.0), v, "values", columns=slice(1, 3)), whole[:, 1:3])
