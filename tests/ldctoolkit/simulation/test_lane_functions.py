"""Functions that the lanes of the compiled loops share, against NumPy and scipy."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from ldctoolkit import lane_functions as lanes


def test_arc_tangent_sine_cosine_and_decay() -> None:
    """Over all that a plant may ask for; the errors are those that the functions state."""
    wide = np.concatenate([np.linspace(-20, 20, 4001), [-1e300, -1e9, 1e9, 1e300]])
    assert max(abs(lanes.arctan(x) - np.arctan(x)) for x in wide) < 3e-10
    turn = np.linspace(-np.pi, np.pi, 4001)
    assert max(abs(lanes.sine(x) - np.sin(x)) for x in turn) < 3e-11
    assert max(abs(lanes.cosine(x) - np.cos(x)) for x in turn) < 3e-11
    falling = np.linspace(-60.0, 0.0, 4001)
    assert max(abs(lanes.decay(x) / np.exp(x) - 1.0) for x in falling) < 1e-12
    assert lanes.decay(-1e6) < 1e-25


@pytest.mark.parametrize(
    ("x_0", "x_1", "n_0", "n_1"),
    [
        (0.3, -0.5, -0.2, -0.4), (-0.1, 0.2, 0.4, -0.3), (0.02, -1.0, 0.03, 1.2), (0.4, -0.1, 0.3, -0.2),
        (0.1, -0.3, 0.2, 0.4),
    ],
)  # fmt: skip
def test_the_integral_of_the_absolute_value_is_the_quartics(x_0: float, x_1: float, n_0: float, n_1: float) -> None:
    """One crossing, over and back, none: against a fine sum on a cubic, which is a quartic without its last term."""
    h = 0.4
    curve = CubicHermiteSpline([0.0, h], [x_0, n_0], [x_1, n_1])
    t = np.linspace(0.0, h, 400_001)
    expected = float(np.trapezoid(np.abs(curve(t)), t))
    assert lanes.absolute_area(x_0, x_1, n_0, n_1, float(curve.integrate(0.0, h)), h) == pytest.approx(
        expected, abs=1e-10
    )
