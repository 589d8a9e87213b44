"""What a path does between two samples, from polynomials through both: roots, the largest value, near misses."""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import math
from typing import Final

import numba

from ldctoolkit.simulation.kernel.plant import OPTIONS

_MOST_PASSES: Final = 30
_NEXT_TERM: Final = (2.0 / 9.0) ** 4 / 54.0
"""Largest value of (u (1 - u))^4 |u - 1/2| / 9, at u = 1/3: what follows a last term of 1 for a mode that dies once a
step."""


@numba.njit(inline="always", **OPTIONS)
def hermite_peak(f_0, m_0, f_1, m_1, h):
    """Largest value of the cubic with these ends and slopes, where it rises first and falls last."""
    peak = max(f_0, f_1)
    if m_0 > 0.0 > m_1:
        m_0, m_1, rise = m_0 * h, m_1 * h, f_1 - f_0
        a, b = m_0 + m_1 - 2.0 * rise, 3.0 * rise - 2.0 * m_0 - m_1
        # 3 a u^2 + 2 b u + m_0 = 0 between 0 and 1, in the form that does not cancel
        root = math.sqrt(max(b * b - 3.0 * a * m_0, 0.0))
        u = m_0 / (root - b) if b < 0.0 else (-(b + root) / (3.0 * a) if a != 0.0 else 0.0)
        if 0.0 < u < 1.0:
            peak = max(peak, f_0 + u * (m_0 + u * (b + u * a)))
    return peak


@numba.njit(inline="always", **OPTIONS)
def quartic_root(f_0, m_0, f_1, m_1, mean):
    """Root between 0 and 1 of the quartic with these ends, of opposite signs, slopes and mean."""
    q = 30.0 * (mean - 0.5 * (f_0 + f_1) - (m_0 - m_1) / 12.0)
    a, b = 2.0 * (f_0 - f_1) + m_0 + m_1 - 2.0 * q, 3.0 * (f_1 - f_0) - 2.0 * m_0 - m_1 + q
    u = f_0 / (f_0 - f_1)
    for _ in range(4):
        value = f_0 + u * (m_0 + u * (b + u * (a + u * q)))
        following = u - value / (m_0 + u * (2.0 * b + u * (3.0 * a + u * 4.0 * q)))
        if not 0.0 < following < 1.0:
            return u
        if abs(following - u) < 1e-3:
            return following
        u = following
    return u


@numba.njit(inline="always", **OPTIONS)
def crossing(level, h, x_0, v_0, a_0, j_0, x_1, v_1, a_1, j_1, area, within):
    """Where e_y is at a level between two samples on different sides of it.

    On the polynomial of degree 8 with e_y and three derivatives of both samples and the integral between them, all
    known. Returns the time since the first sample, the integral of e_y up to it, and how far the polynomial may be
    from the path, to be multiplied by the step in units of the fastest mode's time constant.
    """
    f_0, f_1, m_0, m_1 = x_0 - level, x_1 - level, h * v_0, h * v_1
    h_2, h_3 = h * h, h * h * h
    b_0, b_1, g_0, g_1 = h_2 * a_0, h_2 * a_1, h_3 * j_0, h_3 * j_1
    # Hermite's polynomial of degree 7, and q (u (1 - u))^4 with its mean of q / 630
    mean = 0.5 * (f_0 + f_1) + 3.0 / 28.0 * (m_0 - m_1) + (b_0 + b_1) / 84.0 + (g_0 - g_1) / 1680.0
    q = 630.0 * (area / h - level - mean)
    c_2, c_3 = 0.5 * b_0, g_0 / 6.0
    r_0 = f_1 - f_0 - (m_0 + c_2 + c_3)
    r_1 = m_1 - (m_0 + b_0 + 3.0 * c_3)
    r_2, r_3 = b_1 - (b_0 + g_0), g_1 - g_0
    c_4 = 35.0 * r_0 - 15.0 * r_1 + 2.5 * r_2 - r_3 / 6.0 + q
    c_5 = -84.0 * r_0 + 39.0 * r_1 - 7.0 * r_2 + 0.5 * r_3 - 4.0 * q
    c_6 = 70.0 * r_0 - 34.0 * r_1 + 6.5 * r_2 - 0.5 * r_3 + 6.0 * q
    c_7 = -20.0 * r_0 + 10.0 * r_1 - 2.0 * r_2 + r_3 / 6.0 - 4.0 * q
    low, high = 0.0, 1.0
    u = f_0 / (f_0 - f_1)
    for _ in range(_MOST_PASSES):
        tail = c_4 + u * (c_5 + u * (c_6 + u * (c_7 + u * q)))
        turn = 4.0 * c_4 + u * (5.0 * c_5 + u * (6.0 * c_6 + u * (7.0 * c_7 + u * 8.0 * q)))
        value = f_0 + u * (m_0 + u * (c_2 + u * (c_3 + u * tail)))
        slope = m_0 + u * (b_0 + u * (3.0 * c_3 + u * turn))
        if value * f_0 > 0.0:
            low = u
        else:
            high = u
        change = value / slope
        u -= change
        if not low <= u <= high:
            u = 0.5 * (low + high)
        elif abs(change) <= within:
            break
    tail = 0.2 * c_4 + u * (c_5 / 6.0 + u * (c_6 / 7.0 + u * (0.125 * c_7 + u * q / 9.0)))
    before = u * (f_0 + u * (0.5 * m_0 + u * (c_2 / 3.0 + u * (0.25 * c_3 + u * tail))))
    return h * u, h * (before + level * u), _NEXT_TERM * abs(q)


@numba.njit(inline="always", **OPTIONS)
def touches(e_0, rate_0, e_1, rate_1, h):
    """Whether a path with both ends on one side turns so close to zero in between that it may reach over."""
    turns = e_0 * e_1 >= 0.0 and e_0 * rate_0 < 0.0 < e_1 * rate_1
    return turns and min(abs(e_0), abs(e_1)) < h * (abs(rate_0) + abs(rate_1))
