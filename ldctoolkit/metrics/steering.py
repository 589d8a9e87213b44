"""What the steering does: peak angle and rate, effort, travel. The angle is constant between samples."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics.samples import BoolArray, largest, last_used, per_path, per_sample, positive, used_samples

FloatArray = npt.NDArray[np.float64]


def steering_peak(t: npt.ArrayLike, delta: npt.ArrayLike) -> FloatArray:
    """Largest |delta| of the wheel.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    delta : (..., k) [rad]
        Steering angle from each sample on. At the last one, the end, it may be NaN: the angle is held.

    Returns
    -------
    (...) [rad]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Examples
    --------
    >>> float(steering_peak([0.0, 0.1, 0.2], [0.01, -0.03, float("nan")]))
    0.03
    """
    angle, used = _angle(t, delta)
    return largest(np.abs(angle), used, 0.0)


def steering_rate_peak(t: npt.ArrayLike, delta: npt.ArrayLike, *, delta_0: npt.ArrayLike, dt: float) -> FloatArray:
    """Largest |change of delta from one sample to the next|/dt, the first change from delta_0.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    delta : (..., k) [rad]
        Steering angle from each sample on; NaN at the end: held.
    delta_0 : (...) or float [rad]
        Steering angle before the first sample.
    dt : float [s]
        Sample time of the controller; also where the last step is shorter.

    Returns
    -------
    (...) [rad/s]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, times that do not rise, or a dt that is not > 0.

    Examples
    --------
    >>> float(steering_rate_peak([0.0, 0.5, 1.0], [0.25, 0.0, float("nan")], delta_0=0.125, dt=0.5))
    0.5
    """
    changes, used = _changes(t, delta, delta_0)
    return largest(changes, used, 0.0) / positive("dt", dt, "s")


def steering_effort(t: npt.ArrayLike, delta: npt.ArrayLike) -> FloatArray:
    """Integral of delta^2 over the trajectory, exact for an angle that is constant between samples.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    delta : (..., k) [rad]
        Steering angle from each sample on; that at the end does not count.

    Returns
    -------
    (...) [rad^2 s]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Examples
    --------
    >>> float(steering_effort([0.0, 0.5, 1.5], [0.5, 0.25, float("nan")]))
    0.1875
    """
    times, used = used_samples(t)
    angle = per_sample("delta", delta, times)
    return np.asarray(np.sum(angle[..., :-1] ** 2 * np.diff(times, axis=-1), axis=-1, where=used[..., 1:]))


def steering_travel(t: npt.ArrayLike, delta: npt.ArrayLike, *, delta_0: npt.ArrayLike) -> FloatArray:
    """Sum of |change of delta from one sample to the next|, the first change from delta_0.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, NaN after the end.
    delta : (..., k) [rad]
        Steering angle from each sample on; NaN at the end: held.
    delta_0 : (...) or float [rad]
        Steering angle before the first sample.

    Returns
    -------
    (...) [rad]
        0 for a trajectory without samples.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that do not rise.

    Examples
    --------
    >>> float(steering_travel([0.0, 0.1, 0.2], [0.25, -0.25, float("nan")], delta_0=0.125))
    0.625
    """
    changes, used = _changes(t, delta, delta_0)
    return np.asarray(np.sum(changes, axis=-1, where=used))


def _angle(t: npt.ArrayLike, delta: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
    """Angle from each sample on, that before the end held there if it is NaN; and which samples are used."""
    times, used = used_samples(t)
    angle = per_sample("delta", delta, times).copy()
    held = (last_used(used) & np.isnan(angle))[..., 1:]
    angle[..., 1:] = np.where(held, angle[..., :-1], angle[..., 1:])
    return angle, used


def _changes(t: npt.ArrayLike, delta: npt.ArrayLike, delta_0: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
    angle, used = _angle(t, delta)
    start = per_path("delta_0", delta_0, angle)[..., None]
    return np.abs(np.diff(angle, axis=-1, prepend=start)), used
