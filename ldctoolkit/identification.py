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
from typing import Any, Final, NamedTuple

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

SETTLING: Final = 1.0  # [s] behind a gap that do not count: the initial state is not known
FEWEST: Final = 100  # samples that count
SLOWEST: Final = 3.0  # [m/s] below which the single track does not hold
LARGEST_A_Y: Final = 4.0  # [m/s^2] up to which tyres are about linear (ISO 4138)
LARGEST_GRADIENT: Final = 0.02  # [rad/(m/s^2)] 11 deg/g; cars have -0.002 to 0.008
LEAST_EXPLAINED: Final = 0.5  # share of the measured signal's variance; less is another channel
UNLIMITED: Final = 1e3  # [rad/s] a rate that no actuator reaches
IMMEDIATE: Final = 2e-4  # [s] a shorter lag is none
QUANTILE: Final = 1.959964  # of 95 % intervals
FLOORS: Final = {"lag": 0.02, "delay": 0.02, "understeer_gradient": 1e-3}
"""Half widths of intervals that are good enough, however small the value; of the others half of the value is."""

ACTUATOR: Final = {"lag": "s", "delay": "s", "rate_max": "rad/s"}
WITHOUT_VEHICLE: Final = {"understeer_gradient": "rad/(m/s^2)", "wheelbase": "m"}
WITH_VEHICLE: Final = {"understeer_gradient": "rad/(m/s^2)", "C_af": "N/rad", "C_ar": "N/rad", "I_z": "kg m^2"}


class Estimate(NamedTuple):
    """An identified value, or the reason why it is not identifiable."""

    name: str  # That of a field of `Actuator` or `VehicleParameters`, ``understeer_gradient`` or ``wheelbase``
    unit: str
    value: float | None = None  # None where it is not identifiable
    interval: tuple[float, float] | None = None  # Of 95 %
    reason: str = ""


@dataclasses.dataclass(frozen=True)
class Identification:
    """Actuator and vehicle as identified from a log.

    Examples
    --------
    >>> import numpy as np
    >>> identify({"t": np.arange(9.0), "speed": np.full(9, 20.0)})["lag"].reason
    'the log has no steering_command and no steering'
    """

    estimates: tuple[Estimate, ...]
    notes: tuple[str, ...]  # How well the models fit, and what was left out
    given: VehicleParameters | None  # The vehicle that was given
    # Axle stiffnesses over the mass [m/s^2/rad], axle distances [m], square of the radius of gyration [m^2]
    single_track: tuple[float, ...] | None

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; raises `KeyError`."""
        return {estimate.name: estimate for estimate in self.estimates}[name]

    def _fields(self, owner: type) -> dict[str, float]:
        names = {field.name for field in dataclasses.fields(owner)}
        return {name: value for name, _, value, *_ in self.estimates if name in names and value is not None}

    @property
    def actuator(self) -> Actuator:
        """The actuator, with the defaults for what is not identifiable."""
        return Actuator(**self._fields(Actuator))

    @property
    def vehicle(self) -> VehicleParameters:
        """The vehicle that was given, or the default one, with what was identified of it."""
        return dataclasses.replace(self.given or VehicleParameters(), **self._fields(VehicleParameters))

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
    log: Any, vehicle: VehicleParameters | None = None, *, steering_ratio: float = 1.0, channels: Any = None
) -> Identification:
    """Identify actuator and vehicle from a log.

    Lag, delay and rate limit of the actuator come from commanded and measured wheel angle, the understeer gradient and
    the yaw response from speed, wheel angle and yaw rate; with the mass and axle distances of a `vehicle` also
    cornering stiffnesses and yaw inertia. Offsets of the sensors are fitted, too. What is not identifiable is refused,
    value by value. Raises `InputError` for what is no log, `RecordingError` as `read_recordings`.

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
    >>> result = identify({"t": t, "steering_command": command, "steering": wheel})
    >>> round(result.actuator.delay, 2), result["rate_max"].reason[:13], result["understeer_gradient"].reason
    (0.08, 'never reached', 'the log has no speed and no yaw_rate')
    """
    expect("vehicle", vehicle, VehicleParameters | None)
    ratio = checked_number("steering_ratio", steering_ratio, above=0.0)
    recordings = list(_recordings(log, channels))
    notes: list[str] = []
    single_track = None
    try:
        actuator = _actuator(_Samples.of(recordings, ("steering_command", "steering"), ratio), notes)
    except _NotIdentifiableError as error:
        actuator = _refused(ACTUATOR, error.problem)
    try:
        samples = _Samples.of(recordings, ("speed", "steering", "yaw_rate"), ratio)
        dynamics, single_track = _dynamics(samples, vehicle, notes)
    except _NotIdentifiableError as error:
        dynamics = _refused(WITHOUT_VEHICLE if vehicle is None else WITH_VEHICLE, error.problem)
    return Identification((*actuator, *dynamics), tuple(notes), vehicle, single_track)


class _NotIdentifiableError(InputError):
    """The parameters of a model are not identifiable; `problem` is the reason."""


def _refused(units: dict[str, str], reason: str) -> list[Estimate]:
    return [Estimate(name, unit, reason=reason) for name, unit in units.items()]


def _recordings(log: Any, channels: Any) -> Iterator[Recording]:
    """The recordings of a log in any form."""
    if isinstance(log, str | os.PathLike):
        yield from read_recordings(log, channels=channels, lane=False)
    elif hasattr(log, "keys") or hasattr(log, "columns"):
        signals = ("t", "speed", "yaw_rate", "steering", "steering_command")
        names = [name for name in signals if name in getattr(log, "columns", log)]
        if names[:1] != ["t"] or not names[1:]:
            raise InputError("log", "lacks columns", allowed="t, and of speed, yaw_rate, steering, steering_command")
        try:
            columns: dict[str, Any] = {name: np.asarray(unmasked(log[name]), np.float64) for name in names}
        except (TypeError, ValueError):
            raise InputError("log", "holds a column of other values", allowed="numbers") from None
        none = np.full(columns["t"].shape, np.nan)
        columns = {"speed": none, "lane_offset": none, "lane_width": none} | columns
        yield Recording("log", valid=np.isnan(none), **columns)
    else:
        for recording in [log] if isinstance(log, Recording) or not isinstance(log, Iterable) else log:
            expect("log", recording, Recording)
            yield recording


class _Samples(NamedTuple):
    """Samples that have all inputs; missing outputs are interpolated, and do not count."""

    t: FloatArray  # (n,) [s]
    new: BoolArray  # (n,) a stretch without gaps begins
    use: BoolArray  # (n,) counts: an output, far enough behind a gap
    dt: float  # [s] usual step
    columns: list[FloatArray]  # (n,) each: the inputs, the output

    @classmethod
    def of(cls, recordings: Sequence[Recording], names: Sequence[str], ratio: float) -> _Samples:
        """The samples of all recordings; angles are divided by the ratio."""
        parts: list[FloatArray] = [np.empty((len(names) + 2, 0))]
        absent = {*names}
        for number, recording in enumerate(recordings):
            cleaned = without_codes(recording, names)
            columns = {name: x for name in names if (x := getattr(cleaned, name)) is not None and np.isfinite(x).any()}
            absent -= {*columns}
            if len(columns) == len(names):
                if "steering_command" in names and cleaned.engaged is not None:
                    columns["steering_command"] = np.where(cleaned.engaged, columns["steering_command"], np.nan)
                cuts = np.zeros(cleaned.samples) if cleaned.cut is None else np.cumsum(cleaned.cut, dtype=np.float64)
                parts.append(np.stack([cleaned.t, number + cuts / (cleaned.samples + 1.0), *columns.values()]))
        if absent:
            raise _NotIdentifiableError(
                problem=f"the log has no {' and no '.join(name for name in names if name in absent)}"
            )
        table = np.concatenate(parts, axis=1)
        table[2:][np.abs(table[2:]) >= LARGEST] = np.nan
        table = table[:, np.isfinite(table[2:-1]).all(axis=0) & ((names[0] != "speed") | (table[2] > SLOWEST))]
        table = table[:, np.append(True, (np.diff(table[:2]) > 0.0).any(axis=0))[: table.shape[1]]]
        t, piece, *values = table
        step, joined = np.diff(t), np.diff(piece) == 0.0
        dt = float(np.median(step[joined])) if joined.any() else 0.0
        new = np.append(True, ~joined | (step > 5.0 * dt))[: t.size]
        good = np.isfinite(values[-1])
        use = good & (t - t[np.flatnonzero(new)[np.cumsum(new) - 1]] >= SETTLING)
        if (count := np.count_nonzero(use)) < FEWEST:
            slow = f", at more than {SLOWEST:g} m/s" if names[0] == "speed" else ""
            what = f"{count} samples have {', '.join(names)}, {SETTLING:g} s or more behind a gap{slow}"
            raise _NotIdentifiableError(problem=f"{what}; needed: {FEWEST}")
        values[-1] = np.interp(np.arange(t.size), np.flatnonzero(good), values[-1][good])
        for i, name in enumerate(names):
            if name != "speed" and np.ptp(values[i][use]) == 0.0:
                raise _NotIdentifiableError(problem=f"{name} is constant")
            values[i] = np.asarray(values[i] / ratio) if name.startswith("steering") else values[i]
        return cls(t, new, use, dt, values)


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
    for i in range(t.size):
        if new[i]:
            r = begin[i]
            y = (l_r - l_f * v[i] * v[i] / (c_r * (l_f + l_r))) * r  # as in a steady turn
        else:
            steps = int(500.0 * (t[i] - t[i - 1]) * max(1.0, 20.0 / v[i])) + 1  # the same for all parameters
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


def _fit(
    model: Callable[..., FloatArray],
    measured: FloatArray,
    starts: Iterable[Any],
    bounds: Any,
    units: dict[str, str],
    derived: Callable[[FloatArray], Sequence[float]],
) -> tuple[FloatArray, list[Estimate], str]:
    """Parameters of the best fit, the quantities that are derived from them, and how good it is.

    Starts come in rows: the best of each is followed, and of fits that are about as good the first is taken. Errors are
    linear in the residual, whose autocovariance is taken as it is, in Bartlett's window.
    """

    def residual_of(x: Any) -> FloatArray:
        return np.clip(np.nan_to_num(model(*x) - measured, nan=1e3), -1e3, 1e3)

    best: Any = None
    n = measured.size
    for row in starts:
        start = min(row, key=lambda x: float(np.sum(residual_of(x) ** 2)))
        fit = scipy.optimize.least_squares(
            residual_of, start, "3-point", bounds, x_scale="jac", max_nfev=60, xtol=1e-7, ftol=1e-9
        )
        if fit.status > 0 and (best is None or fit.cost < best.cost * (1.0 - 10.0 / n)):
            best = fit
    explained = 0.0 if best is None else max(1.0 - 2.0 * best.cost / (n * np.var(measured)), 0.0)
    if explained < LEAST_EXPLAINED:
        raise _NotIdentifiableError(
            problem=f"no model explains more than {explained:.0%} of it; another channel, unit or sign?"
        )
    x = best.x
    gradients = np.array([np.subtract(derived(x + h), derived(x - h)) / 2e-5 for h in 1e-5 * np.eye(x.size)]).T
    scale = np.linalg.norm(best.jac, axis=0)
    scale[scale == 0.0] = 1.0
    U, s, Vt = np.linalg.svd(best.jac / scale, full_matrices=False)
    keep, projected = s > 1e-6 * s[0], (gradients / scale) @ Vt.T
    unobservable = (np.abs(projected[:, ~keep]) > 1e-3 * np.linalg.norm(projected, axis=1, keepdims=True)).any(axis=1)
    influence = (projected[:, keep] / s[keep]) @ U[:, keep].T  # (q, n) of the residuals on each quantity

    def products(series: FloatArray, lags: int) -> FloatArray:
        """Sums of products of a series with itself, later by 0 to `lags` samples."""
        return np.asarray(scipy.signal.correlate(series, series, method="fft")[n - 1 :][: lags + 1])

    covariance = products(best.fun - best.fun.mean(), n // 4) / (n - x.size)
    lags = min(max(3 * int(np.argmax(np.abs(covariance) < 2.0 * covariance[0] / np.sqrt(n))), 50), n // 4)
    window = 2.0 * covariance[: lags + 1] * (1.0 - np.arange(lags + 1) / (lags + 1.0))
    window[0] *= 0.5
    estimates = []
    for (name, unit), value, singular, weights in zip(
        units.items(), map(float, derived(x)), unobservable, influence, strict=True
    ):
        value = max(value, 0.0) if name in ACTUATOR else value
        half = np.inf if singular else QUANTILE * float(np.sqrt(max(window @ products(weights, lags), 0.0)))
        if half <= 0.5 * abs(value) + FLOORS.get(name, 0.0):
            low = max(value - half, 0.0) if name in ACTUATOR else value - half
            estimates.append(Estimate(name, unit, value, (low, value + half)))
        else:
            width = f" (95 % interval: {value:.3g} +- {half:.2g} {unit})" if half < np.inf else ""
            estimates.append(Estimate(name, unit, reason=f"not identifiable from this log{width}"))
    return x, estimates, f"the model explains {explained:.2%} of what was measured, in {n:,} samples"


def _actuator(samples: _Samples, notes: list[str]) -> list[Estimate]:
    """Lag, delay and rate limit; a factor and an offset of the measured angle are fitted, too."""
    t, new, use, dt, (command, measured) = samples

    def model(lag: float, delay: float, factor: float, offset: float, log_rate: float) -> FloatArray:
        begin = (measured - offset) / (factor or 1.0)
        wheel: FloatArray = _wheel(t, new, command, begin, lag, delay, np.exp(log_rate))
        return factor * wheel[use] + offset

    k = max(1, round(0.1 / dt))
    slope = np.quantile(np.abs((measured[k:] - measured[:-k]) / (t[k:] - t[:-k])), 0.99)
    late = [(0.5 * IMMEDIATE, delay) for delay in np.arange(0.0, 1.0, dt)]
    grid = [(lag, delay) for delay in (0.01, 0.05, 0.15, 0.4) for lag in (0.02, 0.1, 0.4)]
    starts = [
        [[*times, factor, 0.0, np.log(rate)] for times in row for factor in (1.0, -1.0)]
        for row, rate in ((late, UNLIMITED), (grid, UNLIMITED), (grid, max(slope, 2e-3)))
    ]
    low = [0.25 * IMMEDIATE, -IMMEDIATE, -np.inf, -np.inf, np.log(1e-3)]
    high = [5.0, 2.0, np.inf, np.inf, np.log(UNLIMITED) + 1.0]
    x, (lag, delay, rate), note = _fit(
        model, measured[use], starts, (low, high), ACTUATOR, lambda x: [x[0], x[1], x[2] * np.exp(x[4])]
    )
    if abs(x[2] - 1.0) > 0.2:
        what = f"the measured angle is {x[2]:.3g} times the command"
        raise _NotIdentifiableError(problem=f"{what}: another unit, ratio or sign?")
    notes.append(f"actuator: {note}")
    if x[0] < dt:  # what happens between two samples is not seen
        lag, delay = (
            Estimate(name, "s", time, (max(time - dt, 0.0), time + dt))
            for name, time in zip(("lag", "delay"), np.where(x[:2] > 1e-3, x[:2], 0.0).tolist(), strict=True)
        )
    wheel = model(*x)
    if np.array_equal(wheel, model(*np.append(x[:4], np.log(UNLIMITED)))):
        fastest = np.max(np.abs(np.diff(wheel) / np.diff(t[use])))
        rate = Estimate(*rate[:2], reason=f"never reached: the wheel turned at up to {fastest:.2g} rad/s")
    return [lag, delay, rate]


def _dynamics(
    samples: _Samples, vehicle: VehicleParameters | None, notes: list[str]
) -> tuple[list[Estimate], tuple[float, ...]]:
    """Understeer gradient, single track; offsets of wheel angle and yaw rate are fitted, too."""
    t, new, use, dt, (v, delta, r) = samples
    linear = np.abs(v * r) <= LARGEST_A_Y
    beyond, use = np.count_nonzero(use & ~linear), use & linear
    if np.count_nonzero(use) < max(FEWEST, int(beyond)):
        what = f"most samples are above {LARGEST_A_Y:g} m/s^2, where tyres are not linear"
        raise _NotIdentifiableError(problem=f"{what}; or is the speed or the yaw rate in another unit?")

    def single_track(x: FloatArray) -> tuple[float, ...]:
        # the yaw rate hardly shows where the centre of gravity is, and not at all at a dynamic index of 1
        l_f, l_r = (0.5 * float(np.exp(x[3])),) * 2 if vehicle is None else (vehicle.l_f, vehicle.l_r)
        return float(np.exp(x[0])), float(np.exp(x[1])), l_f, l_r, float(np.exp(x[2]))

    def model(*x: float) -> FloatArray:
        yaw_rate: FloatArray = _yaw_rate(t, new, v, delta - x[-2], r - x[-1], *single_track(np.array(x)))
        return yaw_rate[use] + x[-1]

    def derived(x: FloatArray) -> list[float]:
        c_f, c_r, l_f, l_r, k2 = single_track(x)
        known = [0.5 * vehicle.m * c_f, 0.5 * vehicle.m * c_r, vehicle.m * k2] if vehicle else [l_f + l_r]
        return [(l_r / c_f - l_f / c_r) / (l_f + l_r), *known]

    sizes = np.log([[2.0, 2.0, 0.05, 0.5], [80.0, 100.0, 1.8, 2.7], [1e3, 1e3, 30.0, 20.0]])
    low, start, high = np.hstack([sizes[:, : 4 if vehicle is None else 3], [[-0.3] * 2, [0.0] * 2, [0.3] * 2]])
    units = WITHOUT_VEHICLE if vehicle is None else WITH_VEHICLE
    x, estimates, note = _fit(model, r[use], [[start]], (low, high), units, derived)
    if not abs(gradient := derived(x)[0]) < LARGEST_GRADIENT:
        what = f"the understeer gradient would be {gradient:.2g} rad/(m/s^2)"
        raise _NotIdentifiableError(problem=f"{what}: angles of the steering wheel (steering_ratio), or another unit?")
    notes.append(f"vehicle: {note}" + (f"; {beyond:,} above {LARGEST_A_Y:g} m/s^2 do not count" if beyond else ""))
    k = max(1, round(0.25 / dt))
    noise = 0.6 * float(np.median(np.abs(np.diff(delta, 2))))  # standard deviation, as second differences show it
    slow, fast = np.quantile(v[use], [0.02, 0.98])
    if vehicle is None and fast < 1.2 * slow:
        reason = f"the speed did not vary ({slow:.3g} to {fast:.3g} m/s); a vehicle with its axle distances is needed"
        estimates = _refused(units, reason)
    elif vehicle is not None and np.std(delta[k:] - delta[:-k]) < 7.0 * noise:
        reason = "not identifiable: within 0.25 s the wheel angle changes little more than by its noise"
        estimates = [estimates[0], *_refused(units, reason)[1:]]
    return estimates, single_track(x)
