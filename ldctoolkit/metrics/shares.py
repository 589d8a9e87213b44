"""Of how many scenarios something holds: flags a scenario, and shares.

Arrays of n scenarios, or of (d, n) for d designs: everything is taken along the last axis, so a share is one number or
d of them. Arguments are broadcast, so values of the scenarios alone stay (n,).

Two rules hold for every share. A share of all scenarios is 0 where there are none; a share of the interventions is NaN
where nobody intervened, since it is then a share of nothing. And no scenario is dropped in silence: a NaN among the
values counted gives NaN.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

DTLE_LIMIT: Final = -0.3
"""Distance to lane edge [m] that is still allowed: 0.3 m beyond the line (Euro NCAP LSS; EU 2021/646)."""

A_Y_LIMIT: Final = 3.0
"""Largest lateral acceleration [m/s^2] of a lane keeping action (ISO 11270:2014, 5.4)."""

JERK_LIMIT: Final = 5.0
"""Largest lateral jerk [m/s^3] of a lane keeping action, averaged over 0.5 s (ISO 11270:2014, 5.4)."""


def intervention_share(triggered: npt.ArrayLike) -> float | FloatArray:
    """Share of all scenarios in which the design took over.

    Parameters
    ----------
    triggered : (n,) or (d, n) bool

    Returns
    -------
    float or (d,) [1]
        Of all n; 0 for no scenarios. A scenario that cannot be driven counts as not taken over: leave such rows out.

    Raises
    ------
    InputError
        For anything but booleans.

    Examples
    --------
    >>> intervention_share([True, False, False, True])
    0.5
    """
    (flags,) = _together(triggered=triggered)
    return _share_of_all(flags, np.zeros_like(flags))


def share_deeper(deepest: FloatArray, D_y: float) -> float:
    """Share of departures whose edge goes deeper than D_y beyond the line.

    Parameters
    ----------
    deepest : (n,) [m]
        Deepest position of the edge beyond the line, of one design.
    D_y : float [m]
        Depth, Table I: 0.5 m.

    Returns
    -------
    float [1]
        Of all n; 0 for no departures.

    Raises
    ------
    InputError
        If D_y is not a number.

    Examples
    --------
    >>> share_deeper(np.array([0.2, 0.5, 0.7, 0.8]), 0.5)
    0.5
    """
    (values,) = _together(deepest=deepest)
    if values.ndim != 1:
        raise InputError(f"deepest: shape {values.shape}; allowed: (n,)")
    return float(_share_of_all(values > _number("D_y", D_y), np.isnan(values)))


def share_within_dtle(dtle: npt.ArrayLike, limit: float = DTLE_LIMIT) -> float | FloatArray:
    """Share of scenarios whose distance to lane edge never falls below a limit: dtle >= limit.

    Parameters
    ----------
    dtle : (n,) or (d, n) [m]
        Smallest distance of the front axle's edge to the line, negative beyond it.
    limit : float [m]

    Returns
    -------
    float or (d,) [1]
        Of all n; 0 for no scenarios.

    Raises
    ------
    InputError
        If the limit is not a number.

    References
    ----------
    Euro NCAP, Test Protocol - Lane Support Systems; Commission Implementing Regulation (EU) 2021/646: 0.3 m beyond.

    Examples
    --------
    >>> share_within_dtle([0.1, -0.3, -0.31, -0.5])
    0.5
    """
    (values,) = _together(dtle=dtle)
    return _share_of_all(values >= _number("limit", limit), np.isnan(values))


def comfortable(
    a_y_peak: npt.ArrayLike, jerk_peak: npt.ArrayLike, a_y_limit: float = A_Y_LIMIT, jerk_limit: float = JERK_LIMIT
) -> BoolArray:
    """Which scenarios stay within both limits: a_y_peak <= a_y_limit and jerk_peak <= jerk_limit.

    Parameters
    ----------
    a_y_peak : (n,) or (d, n) [m/s^2]
    jerk_peak : (n,) or (d, n) [m/s^3]
        As a moving average over 0.5 s.
    a_y_limit : float [m/s^2]
    jerk_limit : float [m/s^3]

    Returns
    -------
    (n,) or (d, n) bool
        False for a NaN.

    Raises
    ------
    InputError
        For shapes that do not fit, or limits that are no numbers.

    References
    ----------
    ISO 11270:2014, 5.4: 3 m/s^2, and 5 m/s^3 averaged over half a second.

    Examples
    --------
    >>> comfortable([3.0, 1.0, 4.0], [5.0, 6.0, 1.0])
    array([ True, False, False])
    """
    a_y, jerk = _together(a_y_peak=a_y_peak, jerk_peak=jerk_peak)
    result: BoolArray = (a_y <= _number("a_y_limit", a_y_limit)) & (jerk <= _number("jerk_limit", jerk_limit))
    return result


def comfortable_share(
    a_y_peak: npt.ArrayLike,
    jerk_peak: npt.ArrayLike,
    triggered: npt.ArrayLike,
    a_y_limit: float = A_Y_LIMIT,
    jerk_limit: float = JERK_LIMIT,
) -> float | FloatArray:
    """Share of the interventions that stay within the limits of lateral acceleration and jerk.

    Parameters
    ----------
    a_y_peak : (n,) or (d, n) [m/s^2]
    jerk_peak : (n,) or (d, n) [m/s^3]
    triggered : (n,) or (d, n) bool
    a_y_limit : float [m/s^2]
    jerk_limit : float [m/s^3]

    Returns
    -------
    float or (d,) [1]
        Of the triggered scenarios; NaN where nobody intervened.

    Raises
    ------
    InputError
        For shapes that do not fit, or limits that are no numbers.

    References
    ----------
    ISO 11270:2014, 5.4.

    Examples
    --------
    >>> comfortable_share([3.0, 1.0, 0.0], [5.0, 6.0, 0.0], [True, True, False])
    0.5
    """
    a_y, jerk, flags = _together(a_y_peak=a_y_peak, jerk_peak=jerk_peak, triggered=triggered)
    within = comfortable(a_y, jerk, a_y_limit, jerk_limit)
    return _share_of_interventions(within, np.isnan(a_y) | np.isnan(jerk), flags)


def needless(triggered: npt.ArrayLike, d_y: npt.ArrayLike, D_y: float) -> BoolArray:
    """Which interventions were needless: triggered, though the recorded departure itself stays below D_y.

    Parameters
    ----------
    triggered : (n,) or (d, n) bool
    d_y : (n,) [m]
        Peak of the recorded departure beyond the line.
    D_y : float [m]
        Depth from which a departure counts as deep; Table I: 0.5 m.

    Returns
    -------
    (n,) or (d, n) bool
        Triggered and d_y < D_y; False for a NaN.

    Raises
    ------
    InputError
        For shapes that do not fit, or a D_y that is no number.

    Examples
    --------
    >>> needless([True, True, False], [0.3, 0.6, 0.1], 0.5)
    array([ True, False, False])
    """
    depth, flags = _together(d_y=d_y, triggered=triggered)
    result: BoolArray = flags & (depth < _number("D_y", D_y))
    return result


def needless_share(triggered: npt.ArrayLike, d_y: npt.ArrayLike, D_y: float) -> float | FloatArray:
    """Share of all scenarios in which the intervention was needless.

    Parameters
    ----------
    triggered : (n,) or (d, n) bool
    d_y : (n,) [m]
        Peak of the recorded departure beyond the line.
    D_y : float [m]
        Depth from which a departure counts as deep; Table I: 0.5 m.

    Returns
    -------
    float or (d,) [1]
        Of all n, not of the interventions, so that a design cannot make it smaller by triggering more; 0 for no
        scenarios. A scenario that cannot be driven counts as not taken over: leave such rows out.

    Raises
    ------
    InputError
        For shapes that do not fit, or a D_y that is no number.

    Examples
    --------
    >>> needless_share([True, True, False, False], [0.3, 0.6, 0.1, 0.9], 0.5)
    0.25
    """
    depth, flags = _together(d_y=d_y, triggered=triggered)
    return _share_of_all(needless(flags, depth, D_y), flags & np.isnan(depth))


def back_inside_share(t_back: npt.ArrayLike, triggered: npt.ArrayLike) -> float | FloatArray:
    """Share of the interventions after which the edge is back inside by the end of the settling horizon.

    Parameters
    ----------
    t_back : (n,) or (d, n) [s]
        Time until back inside, infinite where it is not.
    triggered : (n,) or (d, n) bool

    Returns
    -------
    float or (d,) [1]
        Of the triggered scenarios; NaN where nobody intervened.

    Raises
    ------
    InputError
        For shapes that do not fit.

    Examples
    --------
    >>> back_inside_share([2.5, float("inf"), 4.0], [True, True, False])
    0.5
    """
    time, flags = _together(t_back=t_back, triggered=triggered)
    return _share_of_interventions(np.isfinite(time), np.isnan(time), flags)


def overshoot_share(overshoot: npt.ArrayLike, triggered: npt.ArrayLike) -> float | FloatArray:
    """Share of the interventions that take the vehicle beyond the opposite line: overshoot > 0.

    Parameters
    ----------
    overshoot : (n,) or (d, n) [m]
    triggered : (n,) or (d, n) bool

    Returns
    -------
    float or (d,) [1]
        Of the triggered scenarios; NaN where nobody intervened.

    Raises
    ------
    InputError
        For shapes that do not fit.

    Examples
    --------
    >>> overshoot_share([0.2, 0.0, 0.0], [True, True, False])
    0.5
    """
    past, flags = _together(overshoot=overshoot, triggered=triggered)
    return _share_of_interventions(past > 0, np.isnan(past), flags)


def _share_of_all(holds: BoolArray, unknown: BoolArray) -> float | FloatArray:
    return _share(holds, unknown, np.ones_like(holds), 0.0)


def _share_of_interventions(holds: BoolArray, unknown: BoolArray, triggered: BoolArray) -> float | FloatArray:
    return _share(holds, unknown, triggered, np.nan)


def _share(holds: BoolArray, unknown: BoolArray, among: BoolArray, of_none: float) -> float | FloatArray:
    total = np.sum(among, axis=-1)
    count = np.sum(holds & among, axis=-1)
    share = np.divide(count, total, out=np.full(total.shape, of_none), where=total > 0)
    share = np.where(np.any(unknown & among, axis=-1), np.nan, share)
    return float(share) if share.ndim == 0 else share


def _together(**named: npt.ArrayLike) -> tuple[Any, ...]:
    """Arguments as arrays of one shape: floats, and booleans for `triggered`."""
    arrays = []
    for name, values in named.items():
        try:
            array = np.asarray(values) if name == "triggered" else np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise InputError(f"{name}: not an array of numbers") from None
        if name == "triggered" and array.size and array.dtype != np.bool_:
            raise InputError(f"triggered: an array of {array.dtype}; allowed: booleans")
        arrays.append(array.astype(bool) if name == "triggered" else array)
    shapes = {array.shape for array in arrays}
    largest = max(shapes, key=len)
    if not largest or any(shape not in (largest, largest[-1:]) for shape in shapes):
        text = ", ".join(f"{name} {array.shape}" for name, array in zip(named, arrays, strict=True))
        raise InputError(f"shapes: {text}; allowed: (n,) or (d, n), with the same n")
    return tuple(np.broadcast_to(array, largest) for array in arrays)


def _number(name: str, value: float) -> float:
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool) or np.isnan(value):
        raise InputError(f"{name}: {value!r}; allowed: a number")
    return float(value)
