"""Where the vehicle gets to across the lane: depth, distance to the lane's edge, overshoot, time until back inside.

Paths are known at samples, values and slopes; between two samples they are the cubic with these ends (cubic Hermite
interpolation, C. de Boor, *A Practical Guide to Splines*, chapter IV), so a peak between samples is seen. The outward
frame: the line that is departed over is at e_y = `edge_offset`, which is (w_l - w_v)/2.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics.samples import SAME_TIME, largest, per_path, per_sample, used_samples
from ldctoolkit.metrics.score import crossing_of_step

FloatArray = npt.NDArray[np.float64]


def largest_on_path(
    t: npt.ArrayLike, value: npt.ArrayLike, rate: npt.ArrayLike, until: npt.ArrayLike = np.inf
) -> FloatArray:
    """Largest value of a path, also between its samples.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    value : (..., k) [m]
        Values there.
    rate : (..., k) [m/s]
        Slopes there.
    until : (...) or float [s]
        Where the path is left, whether that is a sample or not; the trajectory's end if later.

    Returns
    -------
    (...) [m]
        Minus infinity for a trajectory without samples up to `until`. NaN where a value, a slope or `until` is NaN.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Notes
    -----
    Within a step the cubic c(u), u from 0 to 1, is compared at its ends and where c'(u) = 0.

    Examples
    --------
    >>> float(largest_on_path([0.0, 1.0], [0.0, 0.0], [1.0, -1.0]))  # t (1 - t)
    0.25
    """
    times, used = used_samples(t)
    e, slope, end = per_sample("value", value, times), per_sample("rate", rate, times), per_path("until", until, times)
    last = end[..., None] + SAME_TIME
    at_samples = largest(e, used & (times <= last), -np.inf)

    step = used[..., 1:] & (times[..., :-1] <= last)
    h = np.where(step, np.diff(times, axis=-1), 1.0)
    e_0, e_1 = e[..., :-1], e[..., 1:]
    m_0, m_1 = slope[..., :-1] * h, slope[..., 1:] * h
    c_2 = 3.0 * (e_1 - e_0) - 2.0 * m_0 - m_1
    c_3 = 2.0 * (e_0 - e_1) + m_0 + m_1
    reach = np.where(step, np.clip((end[..., None] - times[..., :-1]) / h, 0.0, 1.0), 0.0)
    # the two roots of m_0 + 2 c_2 u + 3 c_3 u^2, without cancellation; where there are none, any u in reach does
    root = np.sqrt(np.maximum(c_2 * c_2 - 3.0 * c_3 * m_0, 0.0))
    q = -(c_2 + np.copysign(root, c_2))
    highest = at_samples
    for above, below in ((q, 3.0 * c_3), (m_0, q), (reach, np.ones_like(q))):
        with np.errstate(over="ignore"):  # a root far outside
            u = np.divide(above, below, out=np.zeros_like(q), where=below != 0)
        u = np.clip(u, 0.0, reach)
        cubic = e_0 + u * (m_0 + u * (c_2 + u * c_3))
        highest = np.maximum(highest, largest(cubic, step, -np.inf))
    return np.where(np.isnan(end), np.nan, highest)


def deepest_position(
    t: npt.ArrayLike, e_y: npt.ArrayLike, e_y_rate: npt.ArrayLike, *, T: npt.ArrayLike, edge_offset: float
) -> FloatArray:
    """Deepest position of the edge beyond the line during the departure: max of e_y - edge_offset over t <= T.

    Parameters
    ----------
    t : (..., k) [s]
        Time since the departure's start, NaN after the end.
    e_y : (..., k) [m]
    e_y_rate : (..., k) [m/s]
    T : (...) [s]
        The departure's end.
    edge_offset : float [m]
        e_y with the edge on the line, (w_l - w_v)/2.

    Returns
    -------
    (...) [m]
        Positive beyond the line; minus infinity for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Examples
    --------
    >>> float(deepest_position([0.0, 1.0], [0.75, 0.75], [1.0, -1.0], T=1.0, edge_offset=0.75))
    0.25
    """
    return largest_on_path(t, e_y, e_y_rate, T) - edge_offset


def distance_to_lane_edge(
    t: npt.ArrayLike,
    e_y: npt.ArrayLike,
    e_y_rate: npt.ArrayLike,
    e_psi: npt.ArrayLike,
    e_psi_rate: npt.ArrayLike,
    *,
    T: npt.ArrayLike,
    edge_offset: float,
    l_f: float,
) -> FloatArray:
    """Distance to lane edge at its worst: min of edge_offset - (e_y + l_f e_psi) over t <= T.

    Of the front axle's outer edge, where the outermost tyre stands; negative beyond the line.

    Parameters
    ----------
    t : (..., k) [s]
        Time since the departure's start, NaN after the end.
    e_y : (..., k) [m]
    e_y_rate : (..., k) [m/s]
    e_psi : (..., k) [rad]
    e_psi_rate : (..., k) [rad/s]
    T : (...) [s]
        The departure's end.
    edge_offset : float [m]
        e_y with the edge on the line, (w_l - w_v)/2.
    l_f : float [m]
        From the centre of gravity to the front axle.

    Returns
    -------
    (...) [m]
        Infinite for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    References
    ----------
    Euro NCAP, Test Protocol - Lane Support Systems (DTLE); Commission Implementing Regulation (EU) 2021/646 (the same
    distance to the lane marking). Both allow 0.3 m beyond. The tyre is taken at the vehicle's width, e_psi as small.

    Examples
    --------
    >>> t, e_y, e_psi, flat = [0.0, 1.0], [1.0, 1.0], [0.125, 0.125], [0.0, 0.0]
    >>> float(distance_to_lane_edge(t, e_y, flat, e_psi, flat, T=1.0, edge_offset=0.5, l_f=1.0))
    -0.625
    """
    times, _ = used_samples(t)
    front = per_sample("e_y", e_y, times) + l_f * per_sample("e_psi", e_psi, times)
    front_rate = per_sample("e_y_rate", e_y_rate, times) + l_f * per_sample("e_psi_rate", e_psi_rate, times)
    return edge_offset - largest_on_path(times, front, front_rate, T)


def overshoot(t: npt.ArrayLike, e_y: npt.ArrayLike, e_y_rate: npt.ArrayLike, *, edge_offset: float) -> FloatArray:
    """How far the opposite edge gets beyond the opposite line: max(0, max of -e_y - edge_offset) over the trajectory.

    Parameters
    ----------
    t : (..., k) [s]
        Times from the trigger to the end of the settling horizon, NaN after the end.
    e_y : (..., k) [m]
    e_y_rate : (..., k) [m/s]
    edge_offset : float [m]
        (w_l - w_v)/2.

    Returns
    -------
    (...) [m]
        0 where it stays inside, and for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Examples
    --------
    >>> float(overshoot([0.0, 1.0], [0.5, -1.25], [0.0, 0.0], edge_offset=0.75))
    0.5
    """
    times, _ = used_samples(t)
    opposite = largest_on_path(times, -per_sample("e_y", e_y, times), -per_sample("e_y_rate", e_y_rate, times))
    return np.maximum(0.0, opposite - edge_offset)


def time_back_inside(
    t: npt.ArrayLike, e_y: npt.ArrayLike, e_y_rate: npt.ArrayLike, *, edge_offset: float
) -> FloatArray:
    """Time at which the edge is first back inside: e_y falls to edge_offset.

    Parameters
    ----------
    t : (..., k) [s]
        Time since the departure's start, from the trigger on, NaN after the end.
    e_y : (..., k) [m]
    e_y_rate : (..., k) [m/s]
    edge_offset : float [m]
        (w_l - w_v)/2.

    Returns
    -------
    (...) [s]
        On the clock of t. Infinite where the edge is never back, and for a trajectory without samples; the first
        time where it is inside at the first two samples, which only a trigger on the line itself gives.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Notes
    -----
    The first step that ends inside holds the crossing; it is the root of the step's cubic. A path that is inside
    between two samples only is not seen, as in S.

    Examples
    --------
    >>> float(time_back_inside([1.0, 2.0], [1.5, 0.5], [-1.0, -1.0], edge_offset=0.75))
    1.75
    """
    times, used = used_samples(t)
    e = per_sample("e_y", e_y, times) - edge_offset
    rate = per_sample("e_y_rate", e_y_rate, times)
    if times.shape[-1] < 2:
        return np.where(np.isnan(e).any(axis=-1, where=used), np.nan, np.inf)
    ends_inside = used[..., 1:] & (e[..., 1:] <= 0)
    back = ends_inside.any(axis=-1)
    i = np.argmax(ends_inside, axis=-1)[..., None]

    def at(values: FloatArray, k: npt.NDArray[np.intp]) -> FloatArray:
        return np.take_along_axis(values, k, axis=-1)[..., 0][back]

    t_0, h = at(times, i), at(times, i + 1) - at(times, i)
    e_0, e_1, rate_0, rate_1 = at(e, i), at(e, i + 1), at(rate, i), at(rate, i + 1)
    area = h * (0.5 * (e_0 + e_1) + h * (rate_0 - rate_1) / 12.0)  # of the cubic itself
    outside = e_0 > 0
    s = np.zeros_like(t_0)
    s[outside], _ = crossing_of_step(*(part[outside] for part in (e_0, rate_0, e_1, rate_1, area, h)))
    result = np.full(back.shape, np.inf)
    result[back] = t_0 + s
    return np.where(np.isnan(e + rate).any(axis=-1, where=used), np.nan, result)
