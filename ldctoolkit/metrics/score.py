"""The score S: the integral of |e_y|, and how much of it a design takes away."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


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
    ratio = np.divide(S, S_uncorrected, out=np.ones_like(S), where=~(S_uncorrected <= 0))
    return 1.0 - ratio
