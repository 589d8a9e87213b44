"""Trajectories as arrays, samples along the last axis, NaN after the end: what every metric checks and shares."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

SAME_TIME: Final = 1e-9
"""Two times [s] closer than this are one: t_s + k dt and the end T are rounded."""


def used_samples(t: npt.ArrayLike) -> tuple[FloatArray, BoolArray]:
    """Times as an array, and which of them belong to the trajectory.

    Parameters
    ----------
    t : (..., k) [s]
        Times of the samples, rising, NaN after the end.

    Returns
    -------
    t : (..., k) [s]
    used : (..., k) bool

    Raises
    ------
    InputError
        For times that do not rise, are infinite, or go on after a NaN.

    Examples
    --------
    >>> used_samples([0.0, 0.1, float("nan")])[1]
    array([ True,  True, False])
    """
    times = _array("t", t)
    if times.ndim == 0:
        raise InputError("t: one number; allowed: an array with the samples along its last axis")
    used = ~np.isnan(times)
    _refuse("t", times, np.isinf(times), "finite times, NaN after the end")
    gap = np.zeros_like(used)
    gap[..., 1:] = used[..., 1:] & ~used[..., :-1]
    _refuse("t", times, gap, "NaN only after the end")
    falling = np.zeros_like(used)
    falling[..., 1:] = used[..., 1:] & used[..., :-1] & ~(times[..., 1:] > times[..., :-1])
    _refuse("t", times, falling, "rising times")
    return times, used


def per_sample(name: str, values: npt.ArrayLike, t: FloatArray) -> FloatArray:
    """Values as an array, one for each sample of t.

    Parameters
    ----------
    name : str
        What a message calls them.
    values : (..., k)
    t : (..., k) [s]

    Returns
    -------
    (..., k)

    Raises
    ------
    InputError
        For another shape than that of t.

    Examples
    --------
    >>> per_sample("e_y", [0.2, 0.3], np.array([0.0, 0.1]))
    array([0.2, 0.3])
    """
    array = _array(name, values)
    if array.shape != t.shape:
        raise InputError(f"{name}: shape {array.shape}; allowed: that of t, {t.shape}")
    return array


def per_path(name: str, values: npt.ArrayLike, t: FloatArray) -> FloatArray:
    """One value a trajectory: the leading axes of t, or one number for all.

    Parameters
    ----------
    name : str
        What a message calls them.
    values : (...) or float
    t : (..., k) [s]

    Returns
    -------
    (...)

    Raises
    ------
    InputError
        For a shape that does not fit.

    Examples
    --------
    >>> per_path("T", 2.0, np.zeros((3, 5)))
    array([2., 2., 2.])
    """
    array = _array(name, values)
    if array.shape not in ((), t.shape[:-1]):
        raise InputError(f"{name}: shape {array.shape}; allowed: {t.shape[:-1]}, one value a trajectory, or one number")
    return np.broadcast_to(array, t.shape[:-1])


def positive(name: str, value: float, unit: str) -> float:
    """A finite number above 0.

    Parameters
    ----------
    name, unit : str
        What a message calls it.
    value : float

    Returns
    -------
    float

    Raises
    ------
    InputError
        For anything else.

    Examples
    --------
    >>> positive("dt", 0.05, "s")
    0.05
    """
    number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    if not (number and 0.0 < value < np.inf):
        raise InputError(f"{name}: {value!r} {unit}; allowed: a finite number > 0")
    return float(value)


def largest(values: FloatArray, used: BoolArray, least: float) -> FloatArray:
    """Largest value along the last axis; `least` where nothing is used. A NaN among the used ones gives NaN.

    Parameters
    ----------
    values : (..., k)
    used : (..., k) bool
    least : float

    Returns
    -------
    (...)

    Examples
    --------
    >>> largest(np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([[True, False], [False, False]]), 0.0)
    array([1., 0.])
    """
    result: FloatArray = np.asarray(np.max(np.where(used, values, least), axis=-1, initial=least))
    return result


def last_used(used: BoolArray) -> BoolArray:
    """Which sample is the last of its trajectory.

    Parameters
    ----------
    used : (..., k) bool

    Returns
    -------
    (..., k) bool

    Examples
    --------
    >>> last_used(np.array([True, True, False]))
    array([False,  True, False])
    """
    last = used.copy()
    last[..., :-1] &= ~used[..., 1:]
    return last


def _array(name: str, values: npt.ArrayLike) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: not an array of numbers") from None


def _refuse(name: str, values: FloatArray, bad: BoolArray, allowed: str) -> None:
    if bad.any():
        place = tuple(int(i) for i in np.argwhere(bad)[0])
        where = ", ".join(map(str, place))
        raise InputError(f"{name}[{where}] = {float(values[place]):g}; allowed: {allowed}")
