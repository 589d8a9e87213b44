"""Identification of steering actuator and vehicle from logs: models are driven with what the log holds, and fitted.

Output-error method (L. Ljung, *System Identification*, 2nd ed., 1999, chapters 7 and 9): the residual is what was
measured minus what the model, driven by the measured input alone, gives. Intervals take the residuals' autocorrelation
into account. A value whose interval is too wide to be of use is refused, with the reason.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final

import control
import numba
import numpy as np
import scipy.optimize
import scipy.signal

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.declared import checked_number
from ldctoolkit.errors import InputError
from ldctoolkit.numba_internals import OPTIONS
from ldctoolkit.plant_options import Actuator
from ldctoolkit.recordings.preparation import without_codes
from ldctoolkit.recordings.recording import LARGEST, Recording, read_recordings
from ldctoolkit.vehicle.bicycle import VehicleParameters

if TYPE_CHECKING:
    from control import TransferFunction

__all__ = ["Estimate", "Identification", "identify"]

SETTLING: Final = 1.0  # [s] after the begin of a stretch that do not count: its initial state is not known
SHORTEST: Final = 100  # residuals
SLOWEST: Final = 3.0  # [m/s] below which the single track does not hold
LARGEST_A_Y: Final = 4.0  # [m/s^2] up to which tyres are about linear (ISO 4138)
QUANTILE: Final = 1.959964  # of the 95 % intervals
LEAST_EXPLAINED: Final = 0.8  # share of the measured signal's variation that a model has to explain


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A value that was identified, or the reason why the log cannot tell it."""

    name: str  # as in `Actuator` and `VehicleParameters`, or `understeer_gradient`, `yaw_gain`, ...
    unit: str
    value: float | None  # None where the log cannot tell it
    interval: tuple[float, float] | None  # of 95 %
    reason: str = ""  # why the log cannot tell it


@dataclasses.dataclass(frozen=True)
class Identification:
    """What a log tells of actuator and vehicle."""

    estimates: tuple[Estimate, ...]
    notes: tuple[str, ...]  # how well the models fit, and what was left out
    # Axle stiffnesses over the mass [m/s^2/rad], distances of the axles [m], square of the radius of gyration [m^2]
    _single_track: tuple[float, ...] | None
    _vehicle: VehicleParameters | None

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name; raises `KeyError`."""
        return {estimate.name: estimate for estimate in self.estimates}[name]

    def values(self, owner: type) -> dict[str, float]:
        """What was identified of the fields of `Actuator` or `VehicleParameters`."""
        names = {field.name for field in dataclasses.fields(owner)}
        return {one.name: one.value for one in self.estimates if one.name in names and one.value is not None}

    @property
    def actuator(self) -> Actuator:
        """The actuator, with the defaults for what the log cannot tell."""
        return Actuator(**self.values(Actuator))

    @property
    def vehicle(self) -> VehicleParameters | None:
        """The vehicle that was given, with what was identified of it; None where none was given."""
        given = self._vehicle
        return None if given is None else dataclasses.replace(given, **self.values(VehicleParameters))

    def yaw_response(self, v: float) -> TransferFunction:
        """Transfer function of wheel angle to yaw rate at a speed [m/s]; raises `InputError` where there is none."""
        if self._single_track is None:
            raise InputError("yaw_response", "the log does not tell it", hint="notes and reasons say why")
        return _yaw_response(self._single_track, checked_number("v", v, above=0.0, unit="m/s"))


def identify(
    log: Any,
    vehicle: VehicleParameters | None = None,
    *,
    steering_ratio: float = 1.0,
    channels: str | os.PathLike[str] | None = None,
) -> Identification:
    """Identify actuator and vehicle from a log.

    Lag, delay and rate limit of the actuator come from commanded and measured wheel angle; understeer gradient and yaw
    response from speed, wheel angle and yaw rate; with a `vehicle` that gives mass and axle distances also the
    cornering stiffnesses and the yaw inertia. A value that the log cannot tell is refused by itself, with a reason.

    Raises `InputError` for a log without times or with nothing else, `RecordingError` as `read_recordings`.

    Parameters
    ----------
    log : path, Recording, iterable of Recording, or columns
        Columns of a dictionary or data frame in SI, positive to the left: `t` and what there is of `speed`, `yaw_rate`,
        `steering` (measured) and `steering_command`, which is held until the next sample.
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
    >>> command = 0.02 * np.sign(np.sin(2.0 * t))
    >>> wheel = 0.02 * np.sign(np.sin(2.0 * (t - 0.08)))  # 0.08 s late
    >>> found = identify({"t": t, "steering_command": command, "steering": wheel})
    >>> round(found["delay"].value, 2), found["rate_max"].reason[:13]
    (0.08, 'never reached')
    """
    ratio = checked_number("steering_ratio", steering_ratio, above=0.0)
    signals = _Signals.of(list(_recordings(log, channels)), ratio)
    notes: list[str] = []
    actuator = _actuator(signals, notes)
    yaw, single_track = _vehicle(signals, vehicle, notes)
    return Identification((*actuator, *yaw), tuple(notes), single_track, vehicle)


COLUMNS: Final = ("speed", "yaw_rate", "steering", "steering_command")


def _recordings(log: Any, channels: str | os.PathLike[str] | None) -> Iterator[Recording]:
    """The recordings of a log in any form."""
    if isinstance(log, str | os.PathLike):
        yield from read_recordings(log, channels=channels)
        return
    if isinstance(log, Recording):
        log = [log]
    if isinstance(log, Iterable) and not hasattr(log, "keys") and not hasattr(log, "columns"):
        for recording in log:
            if not isinstance(recording, Recording):
                raise InputError("log", f"holds a {type(recording).__name__}", allowed="instances of Recording")
            yield recording
        return
    names = [str(name) for name in getattr(log, "columns", log)]
    if "t" not in names or not {*COLUMNS} & {*names}:
        raise InputError("log", f"has the columns {', '.join(names)[:200]}", allowed=f"t, and of {', '.join(COLUMNS)}")
    columns = {name: np.asarray(log[name], dtype=np.float64) for name in ("t", *COLUMNS) if name in names}
    lane = np.full(columns["t"].shape, np.nan)
    yield Recording(
        "log", lane_offset=lane, lane_width=lane, valid=np.ones(lane.shape, bool), **{"speed": lane} | columns
    )


@dataclasses.dataclass(frozen=True)
class _Signals:
    """Samples of all recordings one behind the other; NaN for a missing value."""

    t: FloatArray  # (n,) [s]
    new: BoolArray  # (n,) nothing joins the sample with the one before
    columns: dict[str, FloatArray]  # (n,) each, of those that any recording has

    @classmethod
    def of(cls, recordings: list[Recording], ratio: float) -> _Signals:
        recordings = [without_codes(one, ("speed", "yaw_rate", "steering", "steering_command")) for one in recordings]
        if not sum(one.samples for one in recordings):
            raise InputError("log", "has no samples")
        t, cut = (
            np.concatenate(parts)
            for parts in zip(
                *((one.t, one.cut if one.cut is not None else np.zeros(one.samples, bool)) for one in recordings),
                strict=True,
            )
        )
        cut[np.cumsum([0, *(one.samples for one in recordings[:-1] if one.samples)])] = True
        columns = {}
        for name in COLUMNS:
            parts = [getattr(one, name) for one in recordings]
            values = [
                np.full(one.samples, np.nan) if x is None else x for one, x in zip(recordings, parts, strict=True)
            ]
            column = np.concatenate(values) / (ratio if name.startswith("steering") else 1.0)
            if np.isfinite(column).any():
                columns[name] = np.where(np.abs(column) < LARGEST, column, np.nan)
        return cls(t, cut, columns)

    def stretches(self, *names: str) -> tuple[FloatArray, BoolArray, BoolArray, list[FloatArray]]:
        """Times, where a stretch begins, what counts behind its settling, and columns, of the samples that have all."""
        columns = [self.columns[name] for name in names]
        whole = np.isfinite(np.sum(columns, axis=0))
        if "speed" in names:
            whole &= self.columns["speed"] > SLOWEST
        piece = np.cumsum(self.new)[whole]
        t = self.t[whole]
        step = np.diff(t)
        fresh = np.append(True, (step > 0.0) | (np.diff(piece) > 0))  # of samples that share a time the first counts
        t, piece = t[fresh], piece[fresh]
        step, joined = np.diff(t), np.diff(piece) == 0
        gap = 5.0 * float(np.median(step[joined])) if joined.any() else 0.0
        new = np.append(True, ~joined | (step > gap))
        start = np.flatnonzero(new)[np.cumsum(new) - 1]
        return t, new, t - t[start] >= SETTLING, [column[whole][fresh] for column in columns]


@numba.njit(**OPTIONS)
def _wheel(t, new, command, begin, lag, delay, rate):
    """Wheel angle of an actuator whose command is held between samples; d delta/dt = (u - delta)/lag, cut off at rate.

    `begin` holds the angle at the beginning of each stretch.
    """
    out = np.empty(t.size)
    j, x = 0, 0.0
    for i in range(t.size):
        if new[i]:
            j, x = i, begin[i]
        else:
            now = t[i - 1]
            while now < t[i]:
                while j < i and t[j + 1] + delay <= now:
                    j += 1
                end = min(t[i], t[j + 1] + delay) if j < i else t[i]
                far, h = command[j] - x, end - now
                ramp = min(max((abs(far) - rate * lag) / rate, 0.0), h)
                corner = x + np.sign(far) * rate * ramp
                x = command[j] - (command[j] - corner) * np.exp(-(h - ramp) / lag)
                now = end
        out[i] = x
    return out


@numba.njit(**OPTIONS)
def _yaw_rate(t, new, v, delta, begin, c_f, c_r, l_f, l_r, k2):
    """Yaw rate of the single track with straight lines of speed and wheel angle between samples, by RK4.

        dv_y/dt = c_f alpha_f + c_r alpha_r - v r,    dr/dt = (l_f c_f alpha_f - l_r c_r alpha_r)/k2,
        alpha_f = delta - (v_y + l_f r)/v,            alpha_r = -(v_y - l_r r)/v,

    where c_f and c_r are axle stiffnesses over the mass and k2 is the square of the radius of gyration.
    """
    out = np.empty(t.size)
    y, r = 0.0, 0.0
    fastest = c_f + c_r + (l_f * l_f * c_f + l_r * l_r * c_r) / k2
    for i in range(t.size):
        if new[i]:
            r = begin[i]
            y = (l_r - l_f * v[i] * v[i] / (c_r * (l_f + l_r))) * r  # as in a steady turn
        else:
            h = t[i] - t[i - 1]
            steps = min(int(h * fastest / v[i]) + 1, 1000)
            h /= steps
            for s in range(steps):
                a, b = y, r
                dy, dr = 0.0, 0.0
                for stage in range(4):
                    at = (s + 0.5 * ((stage + 1) // 2)) / steps
                    speed = v[i - 1] + at * (v[i] - v[i - 1])
                    front = c_f * (delta[i - 1] + at * (delta[i] - delta[i - 1]) - (a + l_f * b) / speed)
                    rear = -c_r * (a - l_r * b) / speed
                    da, db = front + rear - speed * b, (l_f * front - l_r * rear) / k2
                    weight = 1.0 if stage == 0 or stage == 3 else 2.0
                    dy += weight * da
                    dr += weight * db
                    part = h if stage == 2 else 0.5 * h
                    a, b = y + part * da, r + part * db
                y += h * dy / 6.0
                r += h * dr / 6.0
        out[i] = r
    return out


@dataclasses.dataclass(frozen=True)
class _Fit:
    """A fit by least squares."""

    x: FloatArray  # (p,) parameters
    residual: FloatArray  # (n,)
    jacobian: FloatArray  # (n, p)
    explained: float  # share of the measured signal's variation

    @classmethod
    def of(
        cls, model: Callable[..., FloatArray], measured: FloatArray, start: FloatArray, low: Any, high: Any
    ) -> _Fit | None:
        """The best fit from a start; None where the search does not converge."""

        def residual(x: FloatArray) -> FloatArray:
            with np.errstate(all="ignore"):
                return np.clip(np.nan_to_num(model(*x) - measured, nan=1e3), -1e3, 1e3)

        found = scipy.optimize.least_squares(
            residual, start, jac="3-point", bounds=(low, high), x_scale="jac", max_nfev=60, xtol=1e-7, ftol=1e-9
        )
        if found.status <= 0:
            return None
        spread = float(np.sum((measured - measured.mean()) ** 2))
        return cls(found.x, found.fun, found.jac, 1.0 - 2.0 * found.cost / max(spread, 1e-300))

    def errors(self, gradients: FloatArray) -> FloatArray:
        """Standard errors of quantities with these gradients (q, p) over the parameters; infinite if not identifiable.

        The residual is taken as stationary with the autocovariance that it shows, in Bartlett's window.
        """
        scale = np.linalg.norm(self.jacobian, axis=0)
        scale[scale == 0.0] = 1.0
        left, size, right = np.linalg.svd(self.jacobian / scale, full_matrices=False)
        keep = size > 1e-6 * max(size[0], 1e-300)
        toward = (gradients / scale) @ right.T
        lost = (np.abs(toward[:, ~keep]) > 1e-3 * np.linalg.norm(toward, axis=1, keepdims=True)).any(axis=1)
        weights = (toward[:, keep] / size[keep]) @ left[:, keep].T  # (q, n): an error is their sum over residuals
        n = self.residual.size
        residual = self.residual - self.residual.mean()
        covariance = scipy.signal.correlate(residual, residual, method="fft")[n - 1 :] / (n - self.x.size)
        small = np.abs(covariance) < 2.0 * covariance[0] / np.sqrt(n)
        lags = min(2 * int(np.argmax(small)) if small.any() else n, n // 4)
        window = covariance[: lags + 1] * (1.0 - np.arange(lags + 1) / (lags + 1.0))
        variance = np.zeros(len(gradients))
        for q, row in enumerate(weights):
            own = scipy.signal.correlate(row, row, method="fft")[n - 1 :][: lags + 1]
            variance[q] = own[0] * window[0] + 2.0 * own[1:] @ window[1:]
        return np.where(lost, np.inf, np.sqrt(np.maximum(variance, 0.0)))


def _estimate(name: str, unit: str, value: float, error: float, floor: float = 0.0, least: float = -np.inf) -> Estimate:
    """The value with its interval, or refused where that is wider than half of the value and the floor."""
    half = QUANTILE * error
    if not half <= 0.5 * abs(value) + floor:
        width = f"the 95 % interval would be {value:.3g} +- {half:.2g} {unit}" if np.isfinite(half) else "nothing of it"
        return Estimate(name, unit, None, None, f"too little excitation: {width}")
    return Estimate(name, unit, value, (max(value - half, least), value + half))


def _refused(names: dict[str, str], reason: str) -> tuple[Estimate, ...]:
    return tuple(Estimate(name, unit, None, None, reason) for name, unit in names.items())


def _missing(signals: _Signals, *names: str) -> str:
    """Why there is nothing to fit; empty where there is."""
    absent = [name for name in names if name not in signals.columns]
    if absent:
        return f"the log has no {' and no '.join(absent)}"
    _, _, use, columns = signals.stretches(*names)
    if (count := np.count_nonzero(use)) < SHORTEST:
        return f"{count} samples have {', '.join(names)} more than {SETTLING:g} s behind a gap; needed: {SHORTEST}"
    still = [name for name, x in zip(names, columns, strict=True) if name != "speed" and np.ptp(x[use]) == 0.0]
    return f"{still[0]} never moves" if still else ""


_ACTUATOR: Final = {"lag": "s", "delay": "s", "rate_max": "rad/s"}
_FAST: Final = 1e3  # [rad/s] of no limit


def _actuator(signals: _Signals, notes: list[str]) -> tuple[Estimate, ...]:
    """Lag, delay and rate limit; a factor and an offset of the measured angle are fitted, too."""
    if reason := _missing(signals, "steering", "steering_command"):
        return _refused(_ACTUATOR, reason)
    t, new, use, (measured, command) = signals.stretches("steering", "steering_command")

    def model(lag: float, delay: float, factor: float, offset: float, log_rate: float = np.log(_FAST)) -> FloatArray:
        return (
            factor * _wheel(t, new, command, (measured - offset) / factor, lag, delay, np.exp(log_rate))[use] + offset
        )

    y, slope = measured[use], 0.0
    ahead = max(1, round(0.1 / float(np.median(np.diff(t)))))
    if t.size > ahead:
        slope = float(np.quantile(np.abs(measured[ahead:] - measured[:-ahead]) / (t[ahead:] - t[:-ahead]), 0.99))
    starts = []
    for lag in (0.02, 0.1, 0.4):
        for delay in (0.0, 0.05, 0.15, 0.4):
            for rate in (_FAST, max(slope, 1e-3)):
                x = _wheel(t, new, command, measured, lag, delay, rate)[use]
                factor = float(np.mean((x - x.mean()) * (y - y.mean())) / max(float(np.var(x)), 1e-300)) or 1e-9
                offset = float(y.mean() - factor * x.mean())
                cost = float(np.sum((y - factor * x - offset) ** 2))
                starts.append((cost, rate, np.array([lag, delay, factor, offset, np.log(rate)])))
    low, high = [1e-4, 0.0, -np.inf, -np.inf, np.log(1e-3)], [5.0, 2.0, np.inf, np.inf, np.log(_FAST)]
    free = _Fit.of(model, y, min(one for one in starts if one[1] == _FAST)[2][:4], low[:4], high[:4])
    limited = _Fit.of(model, y, min((one for one in starts if one[1] < _FAST), key=lambda one: one[0])[2], low, high)
    fits = [fit for fit in (free, limited) if fit is not None]
    if not fits:
        return _refused(_ACTUATOR, "the fit does not converge")
    fit = fits[0]
    if limited is not None and np.sum(limited.residual**2) < np.sum(fit.residual**2) * (1.0 - 10.0 / y.size):
        fit = limited
    factor = fit.x[2]
    notes.append(f"actuator: the model explains {fit.explained:.2%} of the measured angle, in {y.size:,} samples")
    if fit.explained < LEAST_EXPLAINED:
        return _refused(_ACTUATOR, f"the model explains only {fit.explained:.0%} of the measured angle")
    if abs(factor - 1.0) > 0.2:
        return _refused(
            _ACTUATOR, f"the measured angle is {factor:.3g} times the command: another unit, sign or ratio?"
        )
    errors = fit.errors(np.eye(fit.x.size))
    lag = _estimate("lag", "s", float(fit.x[0]), errors[0], 0.02, 0.0)
    if lag.value is not None and lag.value < 1e-3:
        lag = dataclasses.replace(lag, value=0.0)
    delay = _estimate("delay", "s", float(fit.x[1]), errors[1], 0.02, 0.0)
    if fit.x.size == 4:
        reached = np.abs(np.diff(model(*fit.x))) / np.diff(t[use])
        reason = f"never reached: the wheel turned at up to {float(np.max(reached)):.2g} rad/s"
        return lag, delay, Estimate("rate_max", "rad/s", None, None, reason)
    rate = float(factor * np.exp(fit.x[4]))
    return lag, delay, _estimate("rate_max", "rad/s", rate, rate * errors[4])


_YAW: Final = {"understeer_gradient": "rad/(m/s^2)", "yaw_gain": "1/s", "yaw_frequency": "rad/s", "yaw_damping": "1"}
_KNOWN: Final = {"C_af": "N/rad", "C_ar": "N/rad", "I_z": "kg m^2"}


def _coefficients(c_f: float, c_r: float, l_f: float, l_r: float, k2: float, v: float) -> tuple[float, ...]:
    """b_1, b_0, a_1, a_0 of the yaw rate's transfer function (b_1 s + b_0)/(s^2 + a_1 s + a_0)."""
    a_1 = (c_f + c_r + (l_f**2 * c_f + l_r**2 * c_r) / k2) / v
    a_0 = c_f * c_r * (l_f + l_r) ** 2 / (k2 * v**2) + (l_r * c_r - l_f * c_f) / k2
    return l_f * c_f / k2, c_f * c_r * (l_f + l_r) / (k2 * v), a_1, a_0


def _yaw_response(single_track: tuple[float, ...], v: float) -> TransferFunction:
    b_1, b_0, a_1, a_0 = _coefficients(*single_track, v)
    return control.TransferFunction([b_1, b_0], [1.0, a_1, a_0], inputs="delta", outputs="yaw_rate")


def _vehicle(
    signals: _Signals, vehicle: VehicleParameters | None, notes: list[str]
) -> tuple[tuple[Estimate, ...], tuple[float, ...] | None]:
    """Understeer gradient and yaw response, and the single track; offsets of both sensors are fitted, too."""
    units = _YAW | ({"wheelbase": "m"} if vehicle is None else _KNOWN)
    if reason := _missing(signals, "speed", "steering", "yaw_rate"):
        return _refused(units, reason), None
    t, new, use, (v, delta, r) = signals.stretches("speed", "steering", "yaw_rate")
    linear = np.abs(v * r) <= LARGEST_A_Y
    use, left_out = use & linear, np.count_nonzero(use & ~linear)
    if np.count_nonzero(use) < SHORTEST:
        return _refused(units, f"nearly all of it is above {LARGEST_A_Y:g} m/s^2, where tyres are not linear"), None
    curvature = (r / v)[use] - np.mean((r / v)[use])
    length = float(curvature @ delta[use] / max(float(curvature @ curvature), 1e-300))  # about L + K v^2
    if length < 0.0:
        return _refused(units, "the yaw rate turns against the wheel angle: one is positive to the right"), None
    if not 0.5 < length < 20.0:
        what = f"the wheel angle is about {length:.3g} m times the path's curvature (of cars 2 to 8)"
        return _refused(units, f"{what}: that of the steering wheel (steering_ratio), or another unit?"), None

    def single_track(x: FloatArray) -> tuple[float, ...]:
        # where the dynamic index is 1 the yaw rate does not depend on where the centre of gravity is, else hardly
        l_f, l_r = (vehicle.l_f, vehicle.l_r) if vehicle is not None else [0.5 * float(np.exp(x[5]))] * 2
        return *np.exp(x[:2]), l_f, l_r, float(np.exp(x[2]))

    def model(*x: float) -> FloatArray:
        c_f, c_r, l_f, l_r, k2 = single_track(np.array(x))
        return _yaw_rate(t, new, v, delta - x[3], r - x[4], c_f, c_r, l_f, l_r, k2)[use] + x[4]

    low, high, start = [2.0, 2.0, 0.05], [1e3, 1e3, 30.0], [80.0, 100.0, 1.8]
    free = 1 if vehicle is None else 0
    low, high, start = (
        np.concatenate([np.log(x[:3]), offsets, np.log(length)[:free]])
        for x, offsets, length in (
            (low, [-0.3, -0.3], [0.5]), (high, [0.3, 0.3], [20.0]), (start, [0.0, 0.0], [2.7]),
        )
    )  # fmt: skip
    fit = _Fit.of(model, r[use], start, low, high)
    if fit is None:
        return _refused(units, "the fit does not converge"), None
    beyond = f"; {left_out:,} above {LARGEST_A_Y:g} m/s^2 do not count" if left_out else ""
    notes.append(f"vehicle: the model explains {fit.explained:.2%} of the yaw rate, in {use.sum():,} samples{beyond}")
    if fit.explained < LEAST_EXPLAINED:
        return _refused(units, f"the model explains only {fit.explained:.0%} of the yaw rate"), None
    middle = float(np.median(v[use]))
    notes.append(f"yaw gain, natural frequency and damping ratio are those at the median speed, {middle:.3g} m/s")

    def derived(x: FloatArray) -> FloatArray:
        c_f, c_r, l_f, l_r, k2 = single_track(x)
        _, b_0, a_1, a_0 = _coefficients(c_f, c_r, l_f, l_r, k2, middle)
        m = 0.0 if vehicle is None else vehicle.m
        size = [l_f + l_r] if vehicle is None else [0.5 * m * c_f, 0.5 * m * c_r, m * k2]
        with np.errstate(invalid="ignore"):  # above the critical speed of an oversteering vehicle
            own = np.sqrt(a_0)
        return np.array([(l_r / c_f - l_f / c_r) / (l_f + l_r), b_0 / a_0, own, 0.5 * a_1 / own, *size])

    steps = 1e-5 * np.eye(fit.x.size)
    gradients = np.stack([(derived(fit.x + h) - derived(fit.x - h)) / 2e-5 for h in steps], axis=1)
    errors = fit.errors(np.nan_to_num(gradients))
    floors = {"understeer_gradient": 1e-3}
    estimates = [
        _estimate(name, unit, float(value), float(error), floors.get(name, 0.0))
        for (name, unit), value, error in zip(units.items(), derived(fit.x), errors, strict=True)
    ]
    slow, fast = np.quantile(v[use], [0.02, 0.98])
    if vehicle is None and estimates[0].value is None and fast < 1.2 * slow:
        reason = f"the speed never varied ({slow:.3g} to {fast:.3g} m/s): a vehicle with its axle distances is needed"
        estimates = [
            dataclasses.replace(one, reason=reason)
            if one.value is None and one.name in ("understeer_gradient", "wheelbase")
            else one
            for one in estimates
        ]
    return tuple(estimates), single_track(fit.x)
