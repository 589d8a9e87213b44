"""The companions of S: what each is called, its unit, and all of them from trajectories."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.metrics.motion import acceleration_peak, jerk_peak
from ldctoolkit.metrics.position import deepest_position, distance_to_lane_edge, overshoot, time_back_inside
from ldctoolkit.metrics.samples import SAME_TIME, BoolArray, last_used, per_path, per_sample, positive, used_samples
from ldctoolkit.metrics.steering import steering_effort, steering_peak, steering_rate_peak, steering_travel

FloatArray = npt.NDArray[np.float64]


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

    deepest: FloatArray = dataclasses.field(metadata={"unit": "m"})
    dtle: FloatArray = dataclasses.field(metadata={"unit": "m"})
    t_back: FloatArray = dataclasses.field(metadata={"unit": "s"})
    overshoot: FloatArray = dataclasses.field(metadata={"unit": "m"})
    a_y_peak: FloatArray = dataclasses.field(metadata={"unit": "m/s^2"})
    jerk_peak: FloatArray = dataclasses.field(metadata={"unit": "m/s^3"})
    delta_peak: FloatArray = dataclasses.field(metadata={"unit": "rad"})
    delta_rate_peak: FloatArray = dataclasses.field(metadata={"unit": "rad/s"})
    effort: FloatArray = dataclasses.field(metadata={"unit": "rad^2 s"})
    travel: FloatArray = dataclasses.field(metadata={"unit": "rad"})


COMPANION_UNITS: Final = {field.name: str(field.metadata["unit"]) for field in dataclasses.fields(Companions)}
"""Companion -> its unit."""

COMPANION_COLUMNS: Final = {
    name: f"{name}_{unit.replace('/', '_').replace('^', '').replace(' ', '_')}"
    for name, unit in COMPANION_UNITS.items()
}
"""Companion -> its column in a stored table, the unit at the end: ``a_y_peak_m_s2``."""


def companions(
    t: npt.ArrayLike,
    x: npt.ArrayLike,
    delta: npt.ArrayLike,
    a_left: npt.ArrayLike,
    a_right: npt.ArrayLike,
    *,
    T: npt.ArrayLike,
    t_s: npt.ArrayLike,
    dt: float,
    delta_0: npt.ArrayLike,
    a_before: npt.ArrayLike,
    edge_offset: float,
    l_f: float,
    deepest_before: npt.ArrayLike | None = None,
    dtle_before: npt.ArrayLike | None = None,
) -> Companions:
    """All companions of S from trajectories: the readable form of what the closed loop computes on its way.

    Parameters
    ----------
    t : (n, k) [s]
        Time since the departure's start: the samples t_s + j dt, T where it is none, and the end; NaN after the end.
    x : (n, k, 4)
        State there, (e_y, de_y/dt, e_psi, de_psi/dt), outward frame.
    delta : (n, k) [rad]
        Steering angle of the wheel from that time on, constant in between; NaN at the end: held.
    a_left, a_right : (n, k) [m/s^2]
        Lateral acceleration just before and just after that time. The first left one does not count, it is `a_before`;
        the last right one may be NaN: as the left one.
    T : (n,) [s]
        The departure's end.
    t_s : (n,) [s]
        Trigger time; infinite where never triggered, t is NaN throughout there.
    dt : float [s]
        Sample time of the controller.
    delta_0 : (n,) [rad]
        Steering angle before the trigger.
    a_before : (n,) [m/s^2]
        Lateral acceleration before the trigger.
    edge_offset : float [m]
        e_y with the edge on the line, (w_l - w_v)/2.
    l_f : float [m]
        From the centre of gravity to the front axle.
    deepest_before, dtle_before : (n,) [m], optional
        Depth and distance to lane edge of the recorded path at its worst before the trigger, up to T where never
        triggered. Without them only what is driven counts, and every scenario must be triggered.

    Returns
    -------
    Companions
        Arrays of n. Where never triggered: the recorded path's depth and distance, t_back = T, and 0 for the others.

    Raises
    ------
    InputError
        For shapes that do not fit, or times that are not those above.

    Notes
    -----
    Positions are taken along the whole path, also between samples; acceleration, jerk and steering at the samples and
    at the end, without a T in between.

    Examples
    --------
    >>> t, still = np.array([[1.0, 1.5, 2.0]]), np.zeros((1, 3))
    >>> e_y = np.array([[1.0, 0.875, 0.75]])
    >>> x = np.stack([e_y, still - 0.25, still, still], axis=-1)
    >>> result = companions(t, x, still + 0.5, still, still, T=[2.0], t_s=[1.0], dt=0.5, delta_0=[0.25],
    ...                     a_before=[0.0], edge_offset=0.875, l_f=1.5)
    >>> result.deepest, result.t_back, result.delta_rate_peak, result.effort
    (array([0.125]), array([1.5]), array([0.5]), array([0.25]))
    """
    times, used = used_samples(t)
    if times.ndim != 2:
        raise InputError(f"t: shape {times.shape}; allowed: (n, k)")
    state = np.asarray(x, dtype=np.float64)
    if state.shape != (*times.shape, 4):
        raise InputError(f"x: shape {state.shape}; allowed: {(*times.shape, 4)}")
    step = positive("dt", dt, "s")
    end, start, before = per_path("T", T, times), per_path("t_s", t_s, times), per_path("a_before", a_before, times)
    triggered = np.isfinite(start)
    deepest = _recorded(deepest_before, -np.inf, "deepest_before", times, triggered)
    dtle = _recorded(dtle_before, np.inf, "dtle_before", times, triggered)
    keep = _at_samples(times, used, start, end, step)

    e_y, e_y_rate, e_psi, e_psi_rate = (state[..., i] for i in range(4))
    driven = deepest_position(times, e_y, e_y_rate, T=end, edge_offset=edge_offset)
    distance = distance_to_lane_edge(times, e_y, e_y_rate, e_psi, e_psi_rate, T=end, edge_offset=edge_offset, l_f=l_f)
    back = time_back_inside(times, e_y, e_y_rate, edge_offset=edge_offset)

    at, angle = _moved_up(times, keep), _moved_up(per_sample("delta", delta, times), keep)
    left, right = (_moved_up(per_sample(n, a, times), keep) for n, a in (("a_left", a_left), ("a_right", a_right)))
    return Companions(
        deepest=np.maximum(driven, deepest),
        dtle=np.minimum(distance, dtle),
        t_back=np.where(triggered, back, end),
        overshoot=overshoot(times, e_y, e_y_rate, edge_offset=edge_offset),
        a_y_peak=acceleration_peak(at, left, right),
        jerk_peak=jerk_peak(at, left, right, before=before),
        delta_peak=steering_peak(at, angle),
        delta_rate_peak=steering_rate_peak(at, angle, delta_0=delta_0, dt=step),
        effort=steering_effort(at, angle),
        travel=steering_travel(at, angle, delta_0=delta_0),
    )


def _recorded(
    values: npt.ArrayLike | None, without: float, name: str, t: FloatArray, triggered: BoolArray
) -> FloatArray:
    if values is None and not triggered.all():
        raise InputError(f"{name}: not given; needed for the scenarios that never triggered")
    return per_path(name, without if values is None else values, t)


def _at_samples(t: FloatArray, used: BoolArray, t_s: FloatArray, T: FloatArray, dt: float) -> BoolArray:
    """Which times are samples or the end; refuses a first one that is not t_s, and any other that is not T."""
    triggered = np.isfinite(t_s)
    first = np.where(used[:, :1].any(axis=1), t[:, :1].max(axis=1, initial=-np.inf), np.inf)
    wrong = np.where(triggered, ~(np.abs(first - np.where(triggered, t_s, 0.0)) <= SAME_TIME), np.isfinite(first))
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(f"t[{i}, 0] = {first[i]:g}; allowed: t_s[{i}] = {t_s[i]:g}, no times where never triggered")
    since = t - np.where(triggered, t_s, 0.0)[:, None]
    keep = used & (np.abs(since - dt * np.round(since / dt)) <= SAME_TIME) | last_used(used)
    odd = used & ~keep & ~(np.abs(t - T[:, None]) <= SAME_TIME)
    if odd.any():
        i, j = (int(k) for k in np.argwhere(odd)[0])
        raise InputError(f"t[{i}, {j}] = {t[i, j]:g}; allowed: t_s + a multiple of dt = {dt:g} s, T, or the last time")
    return keep


def _moved_up(values: FloatArray, keep: BoolArray) -> FloatArray:
    """The kept values of each row at its start, NaN after them."""
    order = np.argsort(~keep, axis=1, kind="stable")
    return np.where(np.take_along_axis(keep, order, axis=1), np.take_along_axis(values, order, axis=1), np.nan)
