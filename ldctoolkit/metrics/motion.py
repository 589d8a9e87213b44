"""What the occupants feel: lateral acceleration, and lateral jerk as a moving average.

The steering angle jumps at a sample where the actuator is ideal, and the lateral acceleration with it. So it has two
limits at every sample: the left one, just before, and the right one, just after.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.metrics.samples import SAME_TIME, largest, last_used, per_path, per_sample, positive, used_samples

if TYPE_CHECKING:
    from ldctoolkit.vehicle import BicycleModel

FloatArray = npt.NDArray[np.float64]


def lateral_acceleration(e_y_acceleration: npt.ArrayLike, v: npt.ArrayLike, yaw_rate: npt.ArrayLike) -> FloatArray:
    """Lateral acceleration of the vehicle: a_y = d2e_y/dt2 + v dpsi_l/dt.

    Parameters
    ----------
    e_y_acceleration : (..., k) [m/s^2]
        Second derivative of e_y.
    v : (...), (..., k) or float [m/s]
        Speed.
    yaw_rate : (..., k) [rad/s]
        Yaw rate of the lane, dpsi_l/dt: v times its curvature.

    Returns
    -------
    (..., k) [m/s^2]

    Raises
    ------
    InputError
        For shapes that do not fit.

    References
    ----------
    R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 2.5: d2e_y/dt2 = a_y - v dpsi_l/dt at constant speed.

    Examples
    --------
    >>> lateral_acceleration([0.0, 1.0], 20.0, [0.05, 0.05])
    array([1., 2.])
    """
    second, rate = np.asarray(e_y_acceleration, dtype=np.float64), np.asarray(yaw_rate, dtype=np.float64)
    if second.shape != rate.shape:
        raise InputError(f"yaw_rate: shape {rate.shape}; allowed: that of e_y_acceleration, {second.shape}")
    speed = np.asarray(v, dtype=np.float64)
    if speed.shape != second.shape:
        speed = per_path("v", speed, second)[..., None]
    return second + speed * rate


def linear_lateral_acceleration(
    model: BicycleModel,
    v: npt.ArrayLike,
    x: npt.ArrayLike,
    delta: npt.ArrayLike,
    yaw_rate: npt.ArrayLike,
    delta_0: npt.ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """Both limits of the lateral acceleration of a linear vehicle whose steering angle is constant between samples.

    Parameters
    ----------
    model : BicycleModel
        The vehicle.
    v : (n,) [m/s]
        Speed, constant.
    x : (n, k, 4)
        State at the samples, (e_y, de_y/dt, e_psi, de_psi/dt).
    delta : (n, k) [rad]
        Steering angle from each sample on; the last one, at the end, may be NaN.
    yaw_rate : (n, k) [rad/s]
        Yaw rate of the lane at the samples.
    delta_0 : (n,) [rad]
        Steering angle before the first sample.

    Returns
    -------
    left, right : (n, k) [m/s^2]
        Just before and just after each sample. At the end, where delta is NaN, both are the left one.

    Raises
    ------
    InputError
        For shapes that do not fit.

    References
    ----------
    Rajamani, eq. 2.45, the row of d2e_y/dt2, and `lateral_acceleration`.

    Examples
    --------
    >>> from ldctoolkit import BicycleModel
    >>> straight, angle = np.zeros((1, 2)), np.array([[0.01, np.nan]])
    >>> linear_lateral_acceleration(BicycleModel(), [20.0], np.zeros((1, 2, 4)), angle, straight, [0.0])[0].round(6)
    array([[0. , 1.6]])
    """
    state, angle = np.asarray(x, dtype=np.float64), np.asarray(delta, dtype=np.float64)
    if angle.ndim != 2 or state.shape != (*angle.shape, 4):
        raise InputError(f"x: shape {state.shape}, delta: shape {angle.shape}; allowed: (n, k, 4) and (n, k)")
    rate, speed = per_sample("yaw_rate", yaw_rate, angle), per_path("v", v, angle)
    A, B, E = model.matrices(speed)
    free = np.sum(A[:, None, 1, :] * state, axis=-1) + E[:, None, 1] * rate
    before = np.column_stack([per_path("delta_0", delta_0, angle), angle])[:, :-1]
    after = np.where(np.isnan(angle), before, angle)
    left, right = (lateral_acceleration(free + B[:, None, 1] * wheel, speed, rate) for wheel in (before, after))
    return left, right


def acceleration_peak(t: npt.ArrayLike, a_left: npt.ArrayLike, a_right: npt.ArrayLike) -> FloatArray:
    """Largest |a_y| at the samples, either limit.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    a_left, a_right : (..., k) [m/s^2]
        Lateral acceleration just before and just after each sample. The first left one is from before the trajectory
        and does not count; the last right one may be NaN: as the left one.

    Returns
    -------
    (...) [m/s^2]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    References
    ----------
    ISO 11270:2014, 5.4: what a lane keeping action brings about stays within 3 m/s^2.

    Examples
    --------
    >>> float(acceleration_peak([0.0, 0.1], [0.0, 1.0], [-2.0, 1.5]))
    2.0
    """
    times, used = used_samples(t)
    left, right = _limits(times, a_left, a_right)
    left[..., :1] = right[..., :1]
    return largest(np.maximum(np.abs(left), np.abs(right)), used, 0.0)


def moving_average_jerk(
    t: npt.ArrayLike,
    a_left: npt.ArrayLike,
    a_right: npt.ArrayLike,
    *,
    before: npt.ArrayLike,
    window: float = 0.5,
) -> tuple[FloatArray, FloatArray]:
    """Lateral jerk as a moving average over the last `window`: (a_y(t) - a_y(t - window))/window, at the samples.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    a_left, a_right : (..., k) [m/s^2]
        Lateral acceleration just before and just after each sample. The first left one is `before`, whatever it says;
        the last right one may be NaN: as the left one.
    before : (...) or float [m/s^2]
        Lateral acceleration before the first sample, constant.
    window : float [s]
        Length of the average.

    Returns
    -------
    left, right : (..., k) [m/s^3]
        Just before and just after each sample, where a_y(t - window) is taken on the same side; NaN after the end.

    Raises
    ------
    InputError
        For shapes that do not fit, times that do not rise, or a window that is not > 0.

    Notes
    -----
    The mean of the jerk over a window is the change of a_y over it, jumps included. Between samples a_y is the
    straight line from the right limit of one to the left limit of the next.

    References
    ----------
    ISO 11270:2014, 5.4: the average over half a second stays within 5 m/s^3.

    Examples
    --------
    >>> t = np.array([0.0, 0.25, 0.5, 0.75])
    >>> moving_average_jerk(t, 2 * t, 2 * t, before=0.0)[1]
    array([0., 1., 2., 2.])
    """
    times, used = used_samples(t)
    left, right = _limits(times, a_left, a_right)
    constant = per_path("before", before, times)[..., None]
    length = positive("window", window, "s")
    if length <= SAME_TIME:
        raise InputError(f"window: {window!r} s; allowed: more than {SAME_TIME:g} s")
    if times.shape[-1] == 0:
        return left, right
    left[..., :1] = np.where(used[..., :1], constant, np.nan)

    earlier = times - length
    i = _last_not_after(times, earlier + SAME_TIME)
    start, end = np.maximum(i, 0), np.minimum(i + 1, times.shape[-1] - 1)

    def at(values: FloatArray, k: npt.NDArray[np.intp]) -> FloatArray:
        return np.take_along_axis(values, k, axis=-1)

    since, h = earlier - at(times, start), at(times, end) - at(times, start)
    share = np.divide(since, h, out=np.zeros_like(h), where=h > 0)
    change = share * (at(left, end) - at(right, start))
    # on a sample up to rounding: its own side of the jump there
    from_left = np.where(since <= SAME_TIME, at(left, start), at(right, start))
    then_left = np.where(i < 0, constant, from_left + change)
    then_right = np.where(i < 0, constant, at(right, start) + change)
    return (
        np.where(used, (left - then_left) / length, np.nan),
        np.where(used, (right - then_right) / length, np.nan),
    )


def jerk_peak(
    t: npt.ArrayLike,
    a_left: npt.ArrayLike,
    a_right: npt.ArrayLike,
    *,
    before: npt.ArrayLike,
    window: float = 0.5,
) -> FloatArray:
    """Largest of the lateral jerk, without its sign: `moving_average_jerk` at the samples, either limit.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    a_left, a_right : (..., k) [m/s^2]
        Lateral acceleration just before and just after each sample, as there.
    before : (...) or float [m/s^2]
        Lateral acceleration before the first sample.
    window : float [s]
        Length of the average.

    Returns
    -------
    (...) [m/s^3]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, times that do not rise, or a window that is not > 0.

    References
    ----------
    ISO 11270:2014, 5.4: 5 m/s^3 as an average over half a second.

    Examples
    --------
    >>> float(jerk_peak([0.0, 0.25], [0.0, 1.0], [1.0, 1.0], before=0.0))
    2.0
    """
    times, used = used_samples(t)
    left, right = moving_average_jerk(times, a_left, a_right, before=before, window=window)
    return largest(np.maximum(np.abs(left), np.abs(right)), used, 0.0)


def _limits(t: FloatArray, a_left: npt.ArrayLike, a_right: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Both limits, as copies; the last right one as the left one where it is NaN."""
    left, right = per_sample("a_left", a_left, t).copy(), per_sample("a_right", a_right, t)
    return left, np.where(last_used(~np.isnan(t)) & np.isnan(right), left, right)


def _last_not_after(t: FloatArray, query: FloatArray) -> npt.NDArray[np.intp]:
    """Index of the last of t that is not after the query, -1 before the first; both rise along the last axis."""
    both = np.concatenate([t, query], axis=-1)
    order = np.argsort(both, axis=-1, kind="stable")  # equal times: those of t come first; NaN last
    seen = np.cumsum(order < t.shape[-1], axis=-1)
    count = np.empty_like(order)
    np.put_along_axis(count, order, seen, axis=-1)
    return count[..., t.shape[-1] :] - 1
