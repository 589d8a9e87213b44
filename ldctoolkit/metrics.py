"""The score S and its parts: pure functions of trajectories."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def _per_scenario(unit: str) -> Any:
    return dataclasses.field(metadata={"unit": unit})


@dataclasses.dataclass(frozen=True)
class Companions:
    """What is reported beside S, one number a scenario: arrays of n, or of (d, n) for d designs.

    The first two are about the departure, [0, T]; the others about everything that was driven, [t_s, T + settle].

    Attributes
    ----------
    deepest : [m]
        Deepest position of the edge beyond the line.
    dtle : [m]
        Smallest distance of the front axle's edge to the line, negative beyond it.
    t_back : [s]
        Time since the departure's start at which the edge is first back inside after the trigger; infinite where it is
        not back by the end.
    overshoot : [m]
        How far the opposite edge gets beyond the opposite line; 0 where it does not.
    a_y_peak : [m/s^2]
        Largest lateral acceleration.
    jerk_peak : [m/s^3]
        Largest lateral jerk, as a moving average over 0.5 s.
    delta_peak : [rad]
        Largest steering angle of the wheel.
    delta_rate_peak : [rad/s]
        Largest change of that angle from one sample to the next, over dt.
    effort : [rad^2 s]
        Integral of the squared steering angle.
    travel : [rad]
        Sum of the changes of the steering angle, without their signs.
    """

    deepest: FloatArray = _per_scenario("m")
    dtle: FloatArray = _per_scenario("m")
    t_back: FloatArray = _per_scenario("s")
    overshoot: FloatArray = _per_scenario("m")
    a_y_peak: FloatArray = _per_scenario("m/s^2")
    jerk_peak: FloatArray = _per_scenario("m/s^3")
    delta_peak: FloatArray = _per_scenario("rad")
    delta_rate_peak: FloatArray = _per_scenario("rad/s")
    effort: FloatArray = _per_scenario("rad^2 s")
    travel: FloatArray = _per_scenario("rad")


COMPANION_UNITS: Final = {field.name: str(field.metadata["unit"]) for field in dataclasses.fields(Companions)}
"""Companion -> its unit."""

COMPANION_COLUMNS: Final = {
    name: f"{name}_{unit.replace('/', '_').replace('^', '').replace(' ', '_')}" for name, unit in COMPANION_UNITS.items()
}
"""Companion -> its column in a stored table, the unit at the end: ``a_y_peak_m_s2``."""


def crossing_of_step(
    e_0: FloatArray, rate_0: FloatArray, e_1: FloatArray, rate_1: FloatArray, area: FloatArray, h: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where e changes its sign within a step, and the integral of e up to there.

    Parameters
    ----------
    e_0, e_1 : (n,) [m]
        Values at the start and the end of the step, of opposite signs.
    rate_0, rate_1 : (n,) [m/s]
        Slopes there.
    area : (n,) [m s]
        Exact integral of e over the step.
    h : (n,) [s]
        Length of the step.

    Returns
    -------
    s : (n,) [s]
        Time of the crossing since the step's start.
    before : (n,) [m s]
        Integral of e over [0, s]. The integral of |e| over the step is |before| + |area - before|.

    Notes
    -----
    e is replaced by the quartic with the same end values, end slopes and integral: the Hermite cubic plus a multiple of
    u^2 (1 - u)^2, u = s/h. Since e is zero at the crossing, an error in s enters only squared. A path that touches zero
    twice inside one step is not seen.

    Examples
    --------
    >>> import numpy as np
    >>> one = np.array([1.0])
    >>> s, before = crossing_of_step(one, -2 * one, -one, -2 * one, 0 * one, one)  # 1 - 2 s
    >>> float(s[0]), float(before[0])
    (0.5, 0.25)
    """
    m_0, m_1 = rate_0 * h, rate_1 * h
    a = 2.0 * (e_0 - e_1) + m_0 + m_1
    b = 3.0 * (e_1 - e_0) - 2.0 * m_0 - m_1
    q = 30.0 * (area / h - (0.5 * (e_0 + e_1) + (m_0 - m_1) / 12.0))
    c_2, c_3, c_4 = b + q, a - 2.0 * q, q
    low, high = np.zeros_like(e_0), np.ones_like(e_0)
    u = e_0 / (e_0 - e_1)
    for _ in range(60):  # Newton kept inside a shrinking bracket: safe for any polynomial, a few passes for most
        value = e_0 + u * (m_0 + u * (c_2 + u * (c_3 + u * c_4)))
        slope = m_0 + u * (2.0 * c_2 + u * (3.0 * c_3 + u * 4.0 * c_4))
        beyond = value * e_0 < 0
        high = np.where(beyond, u, high)
        low = np.where(beyond, low, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = u - value / slope
        inside = (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        following = np.where((value == 0) | (np.abs(following - u) < 1e-15), u, following)
        if np.array_equal(following, u):
            break
        u = following
    before = u * (e_0 + u * (m_0 / 2.0 + u * (c_2 / 3.0 + u * (c_3 / 4.0 + u * c_4 / 5.0))))
    return u * h, before * h


def reduction(S: FloatArray, S_uncorrected: FloatArray) -> FloatArray:
    """Reduction 1 - S/S_uncorrected, per scenario; 0 where there was nothing to reduce.

    Parameters
    ----------
    S, S_uncorrected : (n,) [m s]

    Returns
    -------
    (n,) [1]
    """
    ratio = np.divide(S, S_uncorrected, out=np.ones_like(S), where=S_uncorrected > 0)
    return 1.0 - ratio


def share_deeper(deepest: FloatArray, D_y: float) -> float:
    """Share of departures whose edge goes deeper than D_y beyond the line (0 for no departures).

    Parameters
    ----------
    deepest : (n,) [m]
        Deepest position of the edge beyond the line.
    D_y : float [m]
        Depth, Table I: 0.5 m.
    """
    return float(np.mean(deepest > D_y)) if deepest.size else 0.0
