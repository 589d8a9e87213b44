"""Identification of steering actuator and vehicle from logs, by the output-error method.

A model is driven with what was measured at its input, and fitted to what was measured at its output (L. Ljung, *System
Identification*, 2nd ed., 1999, sections 7.5 and 9.6). Intervals take the residuals' autocorrelation into account. A
value whose interval is too wide to be of use is refused, with the reason.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

import control
import numba
import numpy as np
import scipy.optimize
import scipy.signal

from ldctoolkit.arrays import BoolArray, FloatArray, unmasked
from ldctoolkit.declared import checked_number
from ldctoolkit.errors import InputError, expect
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.plant_options import Actuator
from ldctoolkit.recordings.preparation import without_codes
from ldctoolkit.recordings.recording import LARGEST, Recording, read_recordings
from ldctoolkit.vehicle.bicycle import VehicleParameters

__all__ = ["Estimate", "Identification", "identify"]

COLUMNS: Final = ("speed", "yaw_rate", "steering", "steering_command")
SETTLING: Final = 1.0  # [s] after the begin of a stretch that do not count: the initial state is not known
FEWEST: Final = 100  # samples that count
SLOWEST: Final = 3.0  # [m/s] below which the single track does not hold
LARGEST_GRADIENT: Final = 0.02  # [rad/(m/s^2)] 11 deg/g; cars have -0.002 to 0.008
LARGEST_A_Y: Final = 4.0  # [m/s^2] up to which tyres are about linear (ISO 4138)
LEAST_EXPLAINED: Final = 0.5  # share of the measured signal's variance; less is another channel
QUANTILE: Final = 1.959964  # of 95 % intervals
UNLIMITED: Final = 1e3  # [rad/s] a rate that no actuator reaches
IMMEDIATE: Final = 2e-4  # [s] a shorter lag is none
FLOORS: Final = {"lag": 0.02, "delay": 0.02, "understeer_gradient": 1e-3}
"""Half widths of intervals that are good enough, however small the value; of the others half of the value is."""

ACTUATOR: Final = {"lag": "s", "delay": "s", "rate_max": "rad/s"}
SINGLE_TRACK: Final = {"understeer_gradient": "rad/(m/s^2)", "wheelbase": "m"}
STIFFNESSES: Final = {"understeer_gradient": "rad/(m/s^2)", "C_af": "N/rad", "C_ar": "N/rad", "I_z": "kg m^2"}


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value that was identified, or the reason why the log does not tell it."""

    name: str  # That of a field of `Actuator` or `VehicleParameters`, ``understeer_gradient`` or ``wheelbase``
    unit: str
    value: float | None = None  # None where the log does not tell it
    interval: tuple[float, float] | None = None  # Of 95 %
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class Identification:
    """What a log tells of actuator and vehicle."""

    estimates: tuple[Estimate, ...]
    notes: tuple[str, ...]  # How well the models fit, and what was left out
    given: VehicleParameters | None  # The vehicle that was given
    # Axle stiffnesses over the mass [m/s^2/rad], axle distances [m], square of the radius of gyration [m^2]
    single_track: tuple[float, ...] | None

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; raises `KeyError`."""
        return {estimate.name: estimate for estimate in self.estimates}[name]

    def fields(self, owner: type) -> dict[str, float]:
        """What was identified of the fields of `Actuator` or `VehicleParameters`."""
        names = {field.name for field in dataclasses.fields(owner)}
        return {one.name: one.value for one in self.estimates if one.name in names and one.value is not None}

    @property
    def actuator(self) -> Actuator:
        """The actuator, with the defaults for what the log does not tell."""
        return Actuator(**self.fields(Actuator))

    @property
    def vehicle(self) -> VehicleParameters:
        """The vehicle that was given, or the default one, with what was identified of it."""
        return dataclasses.replace(self.given or VehicleParameters(), **self.fields(VehicleParameters))

    def yaw_response(self, v: float) -> control.TransferFunction:
        """Transfer function from wheel angle to yaw rate at a speed [m/s]; raises `InputError` where there is none."""
        if self.single_track is None:
            raise InputError("yaw_response", self["understeer_gradient"].reason)
        v = checked_number("v", v, above=0.0, unit="m/s")
        c_f, c_r, l_f, l_r, k2 = self.single_track
        a_1 = (c_f + c_r + (l_f**2 * c_f + l_r**2 * c_r) / k2) / v
        a_0 = c_f * c_r * (l_f + l_r) ** 2 / (k2 * v**2) + (l_r * c_r - l_f * c_f) / k2
        return control.TransferFunction([l_f * c_f / k2, c_f * c_r * (l_f + l_r) / (k2 * v)], [1.0, a_1, a_0])


def identify(
    log: Any,
    vehicle: VehicleParameters | None = None,
    *,
    steering_ratio: float = 1.0,
    channels: str | os.PathLike[str] | None = None,
) -> Identification:
    """Identify actuator and vehicle from a log.

    Lag, delay and rate limit of the actuator come from commanded and measured wheel angle, the understeer gradient and
    the yaw response from speed, wheel angle and yaw rate; with a `vehicle`, whose mass and axle distances no log tells,
    also cornering stiffnesses and yaw inertia. Offsets of the sensors are fitted, too. What the log does not tell is
    refused, value by value. Raises `InputError` for what is no log, `RecordingError` as `read_recordings`.

    Parameters
    ----------
    log : path, Recording, iterable of Recording, or columns
        Columns of a dictionary or data frame, in SI and positive to the left: `t` and what there is of `speed`,
        `yaw_rate`, `steering` (measured) and `steering_command`, which is held until the next sample.
    vehicle : VehicleParameters, optional
        Its `m`, `l_f` and `l_r` are taken as known.
    steering_ratio : float
        Angles of the log over those of the front wheels.
    channels : path, optional
        Channel map of MDF logs.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.arange(0.0, 60.0, 0.02)
    >>> command, wheel = (0.02 * np.sign(np.sin(2.0 * (t - late))) for late in (0.0, 0.08))
    >>> found = identify({"t": t, "steering_command": command, "steering": wheel})
    >>> round(found["delay"].value, 2), found["rate_max"].reason[:13], found["understeer_gradient"].reason
    (0.08, 'never reached', 'the log has no speed and no yaw_rate')
    """
    expect("vehicle", vehicle, VehicleParameters | None)
    ratio = checked_number("steering_ratio", steering_ratio, above=0.0)
    recordings = list(_recordings(log, channels))
    notes: list[str] = []
    single_track = None
    try:
        estimates = _actuator(*_samples(recordings, ("steering_command", "steering"), ratio), notes)
    except _UntoldError as error:
        estimates = [Estimate(name, unit, reason=error.problem) for name, unit in ACTUATOR.items()]
    try:
        samples = _samples(recordings, ("speed", "steering", "yaw_rate"), ratio)
        dynamics, single_track = _dynamics(*samples, vehicle, notes)
    except _UntoldError as error:
        units = SINGLE_TRACK if vehicle is None else STIFFNESSES
        dynamics = [Estimate(name, unit, reason=error.problem) for name, unit in units.items()]
    return Identification((*estimates, *dynamics), tuple(notes), vehicle, single_track)


class _UntoldError(InputError):
    """Why a log does not tell the values of a model."""


def _recordings(log: Any, channels: str | os.PathLike[str] | None) -> Iterator[Recording]:
    """The recordings of a log in any form."""
    if isinstance(log, str | os.PathLike):
        yield from read_recordings(log, channels=channels, lane=False)
    elif hasattr(log, "keys") or hasattr(log, "columns"):
        names = [str(name) for name in getattr(log, "columns", log)]
        if "t" not in names or not {*COLUMNS} & {*names}:
            raise InputError("log", "of other columns", value=names, allowed=f"t, and of {', '.join(COLUMNS)}")
        columns = {}
        for name in ("t", *COLUMNS):
            try:
                columns |= {name: np.asarray(unmasked(log[name]), dtype=np.float64)} if name in names else {}
            except (TypeError, ValueError):
                raise InputError(f"log[{name!r}]", value=log[name], allowed="numbers") from None
        none = np.full(columns["t"].shape, np.nan)
        columns = {"speed": none, "lane_offset": none, "lane_width": none} | columns
        yield Recording("log", valid=np.ones(none.shape, bool), **columns)
    else:
        for recording in [log] if isinstance(log, Recording) or not isinstance(log, Iterable) else log:
            expect("log", recording, Recording)
            yield recording


def _samples(
    recordings: Sequence[Recording], names: Sequence[str], ratio: float
) -> tuple[FloatArray, BoolArray, BoolArray, list[FloatArray]]:
    """Times, where a stretch without gaps begins, what counts behind its settling, inputs and output; of samples that
    have all inputs. Missing outputs are interpolated, and do not count.
    """
    parts: list[FloatArray] = [np.empty((len(names) + 2, 0))]
    absent = {*names}
    for number, recording in enumerate(recordings):
        one = without_codes(recording, names)
        columns = {name: x for name in names if (x := getattr(one, name)) is not None and np.isfinite(x).any()}
        absent -= {*columns}
        if len(columns) == len(names):
            cuts = np.zeros(one.samples) if one.cut is None else one.cut
            parts.append(np.stack([one.t, number + np.cumsum(cuts) / (one.samples + 1.0), *columns.values()]))
    if absent:
        raise _UntoldError(problem=f"the log has no {' and no '.join(name for name in names if name in absent)}")
    table = np.concatenate(parts, axis=1)
    table[2:][np.abs(table[2:]) >= LARGEST] = np.nan
    whole = np.isfinite(table[2:-1]).all(axis=0)
    if names[0] == "speed":
        whole &= table[2] > SLOWEST
    table = table[:, whole]
    table = table[:, np.append(True, (np.diff(table[0]) > 0.0) | (np.diff(table[1]) > 0.0))[: table.shape[1]]]
    t, piece, *columns_in, output = table
    step, joined = np.diff(t), np.diff(piece) == 0.0
    new = np.append(True, ~joined | (step > 5.0 * np.median(step[joined]) if joined.any() else True))[: t.size]
    use = np.isfinite(output) & (t - t[np.flatnonzero(new)[np.cumsum(new) - 1]] >= SETTLING)
    if (count := np.count_nonzero(use)) < FEWEST:
        what = f"{count} samples have {', '.join(names)}, {SETTLING:g} s or more behind a gap"
        slow = f", at more than {SLOWEST:g} m/s" if names[0] == "speed" else ""
        raise _UntoldError(problem=f"{what}{slow}; needed: {FEWEST}")
    output = np.interp(np.arange(t.size), np.flatnonzero(np.isfinite(output)), output[np.isfinite(output)])
    values = [*columns_in, output]
    for name, value in zip(names, values, strict=True):
        if name != "speed" and np.ptp(value[use]) == 0.0:
            raise _UntoldError(problem=f"{name} never moves")
    scale = (ratio if name.startswith("steering") else 1.0 for name in names)
    return t, new, use, [value / size for value, size in zip(values, scale, strict=True)]


@numba.njit(**OPTIONS, cache=True)
def _wheel(t, new, command, begin, lag, delay, rate):
    """Wheel angle of an actuator: d delta/dt = (u - delta)/lag, cut off at rate; the command is held between samples.

    `begin` has the angle at the begin of each stretch.
    """
    out = np.empty(t.size)
    j, x = 0, 0.0
    for i in range(t.size):
        if new[i]:
            j, x, now = i, begin[i], t[i]
        while now < t[i]:
            while j < i and t[j + 1] + delay <= now:
                j += 1
            end = min(t[i], t[j + 1] + delay) if j < i else t[i]
            far = command[j] - x
            ramp = min(max((abs(far) - rate * lag) / rate, 0.0), end - now)
            far -= np.sign(far) * rate * ramp
            x = command[j] - far * np.exp(-(end - now - ramp) / lag)
            now = end
        if lag < IMMEDIATE and rate > 0.5 * UNLIMITED:  # the command itself
            while j < i and t[j + 1] + delay <= t[i] + IMMEDIATE:
                j += 1
            x = command[j]
        out[i] = x
    return out


@numba.njit(**OPTIONS, cache=True)
def _yaw_rate(t, new, v, delta, begin, c_f, c_r, l_f, l_r, k2):
    """Yaw rate of the single track by the midpoint rule; speed and wheel angle are straight lines between samples.

        dv_y/dt = f + g - v r,    dr/dt = (l_f f - l_r g)/k2,
        f = c_f (delta - (v_y + l_f r)/v),    g = -c_r (v_y - l_r r)/v,

    where c_f and c_r are axle stiffnesses over the mass, and k2 is the square of the radius of gyration.
    """
    out = np.empty(t.size)
    y, r = 0.0, 0.0
    fastest = c_f + c_r + (l_f * l_f * c_f + l_r * l_r * c_r) / k2
    for i in range(t.size):
        if new[i]:
            r = begin[i]
            y = (l_r - l_f * v[i] * v[i] / (c_r * (l_f + l_r))) * r  # as in a steady turn
        else:
            steps = min(int(20.0 * (t[i] - t[i - 1]) * fastest / v[i]) + 1, 1000)
            h = (t[i] - t[i - 1]) / steps
            for s in range(steps):
                a, b = y, r
                for at in (float(s), s + 0.5):
                    speed = v[i - 1] + at / steps * (v[i] - v[i - 1])
                    f = c_f * (delta[i - 1] + at / steps * (delta[i] - delta[i - 1]) - (a + l_f * b) / speed)
                    g = -c_r * (a - l_r * b) / speed
                    part = 0.5 * h if at == s else h
                    a, b = y + part * (f + g - speed * b), r + part * (l_f * f - l_r * g) / k2
                y, r = a, b
        out[i] = r
    return out


@dataclasses.dataclass(frozen=True)
class _Fit:
    """The best fit by least squares."""

    x: FloatArray  # (p,) parameters
    residual: FloatArray  # (n,)
    jacobian: FloatArray  # (n, p)

    @classmethod
    def of(
        cls, model: Callable[..., FloatArray], measured: FloatArray, starts: Iterable[Any], bounds: Any, what: str
    ) -> tuple[_Fit, str]:
        """The fit from the best of each row of starts, and how good it is; of fits that are about as good the first."""

        def residual(x: Any) -> FloatArray:
            return np.clip(np.nan_to_num(model(*x) - measured, nan=1e3), -1e3, 1e3)

        best = None
        for row in starts:
            start = min(row, key=lambda x: float(np.sum(residual(x) ** 2)))
            found = scipy.optimize.least_squares(
                residual, start, "3-point", bounds, x_scale="jac", max_nfev=60, xtol=1e-7, ftol=1e-9
            )
            if found.status > 0 and (best is None or found.cost < best.cost * (1.0 - 10.0 / measured.size)):
                best = found
        explained = -np.inf if best is None else 1.0 - 2.0 * best.cost / (measured.size * np.var(measured))
        if explained < LEAST_EXPLAINED:
            raise _UntoldError(problem=f"no model explains more than {max(explained, 0.0):.0%} of the {what}")
        note = f"{explained:.2%} of the {what} are explained, in {measured.size:,} samples"
        return cls(best.x, best.fun, best.jac), note

    def estimates(self, units: dict[str, str], derived: Callable[[FloatArray], Sequence[float]]) -> list[Estimate]:
        """The quantities derived from the parameters, with their intervals, or refused.

        Errors are linear in the residual, whose autocovariance is taken as it is, in Bartlett's window.
        """
        steps = 1e-5 * np.eye(self.x.size)
        gradients = np.array([np.subtract(derived(self.x + h), derived(self.x - h)) / 2e-5 for h in steps]).T
        scale = np.linalg.norm(self.jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        left, size, right = np.linalg.svd(self.jacobian / scale, full_matrices=False)
        keep, toward = size > 1e-6 * size[0], (gradients / scale) @ right.T
        lost = (np.abs(toward[:, ~keep]) > 1e-3 * np.linalg.norm(toward, axis=1, keepdims=True)).any(axis=1)
        n, residual = self.residual.size, self.residual - self.residual.mean()
        covariance = scipy.signal.correlate(residual, residual, method="fft")[n - 1 :] / (n - self.x.size)
        small = np.abs(covariance) < 2.0 * covariance[0] / np.sqrt(n)
        lags = min(max(3 * int(np.argmax(small)), 50), n // 4)
        window = (
            covariance[: lags + 1] * (1.0 - np.arange(lags + 1) / (lags + 1.0)) * np.append(1.0, np.full(lags, 2.0))
        )
        estimates = []
        influence = (toward[:, keep] / size[keep]) @ left[:, keep].T
        for (name, unit), value, gone, weights in zip(units.items(), derived(self.x), lost, influence, strict=True):
            products = scipy.signal.correlate(weights, weights, method="fft")[n - 1 :][: lags + 1]
            half = np.inf if gone else QUANTILE * float(np.sqrt(max(window @ products, 0.0)))
            if half <= 0.5 * abs(value) + FLOORS.get(name, 0.0):
                least = 0.0 if name in ACTUATOR else -np.inf
                interval = (max(float(value - half), least), float(value + half))
                estimates.append(Estimate(name, unit, float(value), interval))
            else:
                width = f" (95 % interval: {value:.3g} +- {half:.2g} {unit})" if half < np.inf else ""
                estimates.append(Estimate(name, unit, reason=f"too little excitation{width}"))
        return estimates


def _actuator(
    t: FloatArray, new: BoolArray, use: BoolArray, columns: list[FloatArray], notes: list[str]
) -> list[Estimate]:
    """Lag, delay and rate limit; a factor and an offset of the measured angle are fitted, too."""
    command, measured = columns

    def model(lag: float, delay: float, factor: float, offset: float, log_rate: float) -> FloatArray:
        begin = (measured - offset) / (factor or 1.0)
        wheel: FloatArray = _wheel(t, new, command, begin, lag, delay, np.exp(log_rate))
        return factor * wheel[use] + offset

    dt = float(np.median(np.diff(t)))
    ahead = max(1, round(0.1 / dt))
    slope = np.quantile(np.abs(measured[ahead:] - measured[:-ahead]) / np.abs(t[ahead:] - t[:-ahead]), 0.99)
    grid = [(lag, delay) for delay in (0.01, 0.05, 0.15, 0.4) for lag in (0.02, 0.1, 0.4)]
    late = [(0.5 * IMMEDIATE, delay) for delay in np.arange(0.0, 1.0, dt)]
    starts = [
        [[*times, factor, 0.0, np.log(rate)] for times in row for factor in (1.0, -1.0)]
        for row, rate in ((late, UNLIMITED), (grid, UNLIMITED), (grid, max(slope, 2e-3)))
    ]
    bounds = (
        [0.25 * IMMEDIATE, -IMMEDIATE, -np.inf, -np.inf, np.log(1e-3)],
        [5.0, 2.0, np.inf, np.inf, np.log(UNLIMITED) + 1.0],
    )
    fit, note = _Fit.of(model, measured[use], starts, bounds, "measured wheel angle")
    if abs(fit.x[2] - 1.0) > 0.2:
        what = f"the measured angle is {fit.x[2]:.3g} times the command"
        raise _UntoldError(problem=f"{what}: another unit, ratio or sign?")
    notes.append(note)
    lag, delay, rate = fit.estimates(ACTUATOR, lambda x: [x[0], x[1], x[2] * np.exp(x[4])])
    if fit.x[0] < dt:  # what happens between two samples is not seen
        times = np.maximum(fit.x[:2] * (fit.x[:2] > 1e-3), 0.0)
        lag, delay = (
            dataclasses.replace(
                one, value=float(time), interval=(max(float(time) - dt, 0.0), float(time) + dt), reason=""
            )
            for one, time in zip((lag, delay), times, strict=True)
        )
    if np.array_equal(model(*fit.x), model(*fit.x[:4], np.log(UNLIMITED))):
        fastest = np.max(np.abs(np.diff(model(*fit.x)) / np.diff(t[use])))
        rate = dataclasses.replace(rate, reason=f"never reached: the wheel turned at up to {fastest:.2g} rad/s")
    return [lag, delay, rate]


def _dynamics(
    t: FloatArray,
    new: BoolArray,
    use: BoolArray,
    columns: list[FloatArray],
    vehicle: VehicleParameters | None,
    notes: list[str],
) -> tuple[list[Estimate], tuple[float, ...]]:
    """Understeer gradient, single track; offsets of wheel angle and yaw rate are fitted, too."""
    v, delta, r = columns
    linear = np.abs(v * r) <= LARGEST_A_Y
    beyond, use = np.count_nonzero(use & ~linear), use & linear
    if np.count_nonzero(use) < FEWEST:
        raise _UntoldError(problem=f"nearly all is above {LARGEST_A_Y:g} m/s^2, where tyres are not linear")
    curvature, angle = r[use] / v[use], delta[use] - np.mean(delta[use])
    curvature -= curvature.mean()
    length = float(curvature @ angle / max(float(curvature @ curvature), 1e-300))  # about wheelbase + K v^2
    if curvature @ angle < -0.5 * np.sqrt((curvature @ curvature) * (angle @ angle)):
        raise _UntoldError(problem="the yaw rate turns against the wheel angle: one of them is positive to the right")
    other = ": that of the steering wheel (steering_ratio), or another unit?"
    if length > 20.0:
        what = f"the wheel angle is {length:.3g} m times the curvature of the path (cars: 2 to 8)"
        raise _UntoldError(problem=f"{what}{other}")

    def single_track(x: FloatArray) -> tuple[float, ...]:
        # the yaw rate hardly shows where the centre of gravity is, and not at all at a dynamic index of 1
        half = 0.5 * float(np.exp(x[-1]))
        l_f, l_r = (half, half) if vehicle is None else (vehicle.l_f, vehicle.l_r)
        return float(np.exp(x[0])), float(np.exp(x[1])), l_f, l_r, float(np.exp(x[2]))

    def model(*x: float) -> FloatArray:
        yaw_rate: FloatArray = _yaw_rate(t, new, v, delta - x[3], r - x[4], *single_track(np.array(x)))
        return yaw_rate[use] + x[4]

    def derived(x: FloatArray) -> list[float]:
        c_f, c_r, l_f, l_r, k2 = single_track(x)
        gradient = (l_r / c_f - l_f / c_r) / (l_f + l_r)
        known = [0.5 * vehicle.m * c_f, 0.5 * vehicle.m * c_r, vehicle.m * k2] if vehicle else [l_f + l_r]
        return [gradient, *known]

    count = 6 if vehicle is None else 5
    low, start, high = (
        np.array([*np.log(sizes[:3]), offset, offset, np.log(sizes[3])])[:count]
        for sizes, offset in (
            ((2.0, 2.0, 0.05, 0.5), -0.3),
            ((80.0, 100.0, 1.8, 2.7), 0.0),
            ((1e3, 1e3, 30.0, 20.0), 0.3),
        )
    )
    fit, note = _Fit.of(model, r[use], [[start]], (low, high), "yaw rate")
    notes.append(note + (f"; {beyond:,} above {LARGEST_A_Y:g} m/s^2 do not count" if beyond else ""))
    estimates = fit.estimates(SINGLE_TRACK if vehicle is None else STIFFNESSES, derived)
    gradient = derived(fit.x)[0]
    if not abs(gradient) < LARGEST_GRADIENT:
        raise _UntoldError(problem=f"the wheel angle would grow by {gradient:.2g} rad a m/s^2{other}")
    ahead = max(1, round(0.25 / float(np.median(np.diff(t)))))
    noise = 0.6 * float(np.median(np.abs(np.diff(delta, 2))))  # standard deviation, as second differences show it
    if vehicle is not None and np.std(delta[ahead:] - delta[:-ahead]) < 5.0 * 2.0**0.5 * noise:
        reason = "too little excitation: within 0.25 s the wheel hardly moves by more than its noise"
        estimates[1:] = [Estimate(one.name, one.unit, reason=reason) for one in estimates[1:]]
    slow, fast = np.quantile(v[use], [0.02, 0.98])
    if vehicle is None and fast < 1.2 * slow:
        reason = f"the speed did not vary ({slow:.3g} to {fast:.3g} m/s); a vehicle with its axle distances is needed"
        estimates = [Estimate(one.name, one.unit, reason=reason) for one in estimates]
    return estimates, single_track(fit.x)
