"""The score S and its parts: pure functions of trajectories."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def absolute_area_step(
    e_0: FloatArray, rate_0: FloatArray, e_1: FloatArray, rate_1: FloatArray, area: FloatArray, h: FloatArray | float
) -> FloatArray:
    """Integral of |e| over one step from its end values, end slopes and exact signed integral.

    Parameters
    ----------
    e_0, e_1 : (n,) [m]
        Values at the start and the end of the step.
    rate_0, rate_1 : (n,) [m/s]
        Slopes there.
    area : (n,) [m s]
        Exact integral of e over the step.
    h : float or (n,) [s]
        Length of the step.

    Returns
    -------
    (n,) [m s]
        |area| where e keeps its sign: exact. Where it changes sign, the crossing is the root of the quartic with the
        same end values, end slopes and area; since e is zero there, an error in the crossing enters only squared.

    Notes
    -----
    A path that touches zero twice inside one step is counted by its net area.

    Examples
    --------
    >>> import numpy as np
    >>> one = np.array([1.0])
    >>> absolute_area_step(one, -2 * one, -one, -2 * one, 0 * one, 1.0)  # 1 - 2 s crosses in the middle
    array([0.5])
    """
    out: FloatArray = np.abs(area)
    rows = np.flatnonzero(e_0 * e_1 < 0)
    if rows.size:
        step = np.broadcast_to(np.asarray(h, dtype=float), e_0.shape)[rows]
        before = _area_to_root(e_0[rows], rate_0[rows] * step, e_1[rows], rate_1[rows] * step, area[rows] / step) * step
        out[rows] = np.abs(before) + np.abs(area[rows] - before)
    return out


def _area_to_root(e_0: FloatArray, m_0: FloatArray, e_1: FloatArray, m_1: FloatArray, mean: FloatArray) -> FloatArray:
    """Integral over the unit step up to the root of the quartic with these end values, end slopes and mean."""
    # the Hermite cubic e_0 + m_0 s + b s^2 + a s^3, plus q s^2 (1 - s)^2, which changes the mean alone
    a = 2.0 * (e_0 - e_1) + m_0 + m_1
    b = 3.0 * (e_1 - e_0) - 2.0 * m_0 - m_1
    q = 30.0 * (mean - (0.5 * (e_0 + e_1) + (m_0 - m_1) / 12.0))
    c_2, c_3, c_4 = b + q, a - 2.0 * q, q
    low, high = np.zeros_like(e_0), np.ones_like(e_0)
    s = e_0 / (e_0 - e_1)
    for _ in range(60):  # Newton kept inside a shrinking bracket: safe for any polynomial, a few passes for most
        value = e_0 + s * (m_0 + s * (c_2 + s * (c_3 + s * c_4)))
        slope = m_0 + s * (2.0 * c_2 + s * (3.0 * c_3 + s * 4.0 * c_4))
        beyond = value * e_0 < 0
        high = np.where(beyond, s, high)
        low = np.where(beyond, low, s)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - value / slope
        inside = (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        following = np.where((value == 0) | (np.abs(following - s) < 1e-15), s, following)
        if np.array_equal(following, s):
            break
        s = following
    return s * (e_0 + s * (m_0 / 2.0 + s * (c_2 / 3.0 + s * (c_3 / 4.0 + s * c_4 / 5.0))))


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
