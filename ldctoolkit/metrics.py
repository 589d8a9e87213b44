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
        |area| where e keeps its sign: exact. Where it changes sign, the crossing is the root of the cubic through
        values and slopes; since e is zero there, an error in the crossing enters only squared.

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
        before = _area_to_root(e_0[rows], rate_0[rows] * step, e_1[rows], rate_1[rows] * step) * step
        out[rows] = np.abs(before) + np.abs(area[rows] - before)
    return out


def _area_to_root(e_0: FloatArray, m_0: FloatArray, e_1: FloatArray, m_1: FloatArray) -> FloatArray:
    """Integral over the unit step up to the root of the Hermite cubic; the ends have opposite signs."""
    # e(s) = e_0 + m_0 s + b s^2 + a s^3
    a = 2.0 * (e_0 - e_1) + m_0 + m_1
    b = 3.0 * (e_1 - e_0) - 2.0 * m_0 - m_1
    low, high = np.zeros_like(e_0), np.ones_like(e_0)
    s = e_0 / (e_0 - e_1)
    for _ in range(60):  # Newton kept inside a shrinking bracket: safe for any cubic, a few passes for most
        value = e_0 + s * (m_0 + s * (b + s * a))
        slope = m_0 + s * (2.0 * b + 3.0 * s * a)
        beyond = value * e_0 < 0
        high = np.where(beyond, s, high)
        low = np.where(beyond, low, s)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = s - value / slope
        inside = (newton > low) & (newton < high)
        following = np.where(inside, newton, 0.5 * (low + high))
        settled = bool(np.all((np.abs(following - s) < 1e-15) | (value == 0)))
        s = np.where(value == 0, s, following)
        if settled:
            break
    return s * (e_0 + s * (m_0 / 2.0 + s * (b / 3.0 + s * a / 4.0)))


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
