"""Lane departures as eight parameters, and as the signals y(t), v(t), c(t): both ways, for all events at once.

Everything here is in the *outward* frame: y >= 0 is beyond the line on the departed side, and curvature is positive
when the lane bends towards that side. For a left departure this is the road frame of ISO 8855; a right departure is
its mirror image. Source: Zhao, Wang, LeBlanc (2017), section III.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, Frame, IntArray, Rows, row_index, unmasked
from ldctoolkit.declared import checked_number
from ldctoolkit.errors import CheckedArguments, InputError

if TYPE_CHECKING:
    import polars as pl


@dataclasses.dataclass(frozen=True)
class ExtraColumn(Rows):
    """A column of the source table that travels along with n departures."""

    name: str  # of the column in a departures table; a number's name ends with its unit
    # (n,) text, empty where it is not known, or numbers, NaN where they are not
    values: npt.NDArray[np.str_] | FloatArray


LEFT: Final = 1
RIGHT: Final = -1
SIDES: Final = {"left": LEFT, "right": RIGHT}

PARAMETER_NAMES: Final = ("T", "d_y", "sigma_y", "v_mean", "a_mean", "sigma_v", "c_0", "dc")
"""The eight parameters, in the order of the paper's vector xi."""

PARAMETER_UNITS: Final = ("s", "m", "m", "m/s", "m/s^2", "m/s", "1/m", "1/m")

PARAMETER_COLUMNS: Final = {
    name: f"{name}_{unit.replace('/', '_').replace('^', '')}"
    for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)
}
"""Parameter -> its column in a stored table, the unit at the end: ``v_mean_m_s``."""


def check_parameters(path: str, names: Iterable[str]) -> None:
    """Raise `InputError` at `path` for a name that is none of the eight parameters."""
    for name in names:
        if name not in PARAMETER_NAMES:
            raise InputError(path, "is not a parameter of departures", value=name, allowed=PARAMETER_NAMES)


@dataclasses.dataclass(frozen=True, repr=False)
class DepartureParameters(Rows, Frame):
    """The eight parameters of n departures and the side each went to.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> drawn = ldc.load_model("reference").sample(2, 1, seed=0)
    >>> drawn.side.tolist(), drawn.matrix().shape
    ([1, 1, -1], (3, 8))
    """

    side: IntArray  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1)
    T: FloatArray  # (n,) [s] Duration
    d_y: FloatArray  # (n,) [m] Peak lateral departure of the fitted parabola
    sigma_y: FloatArray  # (n,) [m] Standard deviation of y about the parabola
    v_mean: FloatArray  # (n,) [m/s] Mean speed
    a_mean: FloatArray  # (n,) [m/s^2] Mean acceleration
    sigma_v: FloatArray  # (n,) [m/s] Standard deviation of v about its straight line
    c_0: FloatArray  # (n,) [1/m] Lane curvature at the start, outward frame
    dc: FloatArray  # (n,) [1/m] Change of curvature from start to end, outward frame

    @property
    def n(self) -> int:
        """Number of departures."""
        return int(self.side.shape[0])

    def __len__(self) -> int:
        return self.n

    def matrix(self) -> FloatArray:
        """Columns side by side, (n, 8), in the order of `PARAMETER_NAMES`."""
        return np.column_stack([getattr(self, name) for name in PARAMETER_NAMES])

    def to_polars(self) -> pl.DataFrame:
        """One row a departure: its number or where it was recorded, ``side`` and the parameters, ``v_mean_m_s``."""
        import polars as pl

        columns = {"recording": "recording", "start_time_s": "start_time", "scenario": "index"}
        values = {column: getattr(self, name) for column, name in columns.items() if hasattr(self, name)}
        side = np.where(self.side == LEFT, "left", "right")
        return pl.DataFrame(values | {"side": side} | {c: getattr(self, n) for n, c in PARAMETER_COLUMNS.items()})

    def __repr__(self) -> str:
        left = int((self.side == LEFT).sum())
        return f"<{type(self).__name__}: {left:,} left, {self.n - left:,} right>"


@dataclasses.dataclass(frozen=True, repr=False)
class Departures(DepartureParameters):
    """Departures found in recordings: the parameters and where each came from.

    Examples
    --------
    >>> import numpy as np
    >>> import ldctoolkit as ldc
    >>> from ldctoolkit.recordings import Recording
    >>> t = np.arange(0, 10, 0.1)
    >>> beyond, ones = np.clip(0.3 - 0.3 * (t - 5) ** 2, -0.5, None), np.ones(t.size)
    >>> drive = Recording("a", t, beyond + 0.85, 3.6 * ones, 25.0 * ones, ones > 0, curvature=0.0 * ones)
    >>> ldc.extract_departures([drive]).departures.recording
    array(['a'], dtype='<U1')
    """

    recording: npt.NDArray[np.str_]  # (n,) Identifier of the recording
    start_time: FloatArray  # (n,) [s] Interpolated time of the crossing outwards, on the recording's own clock
    samples: IntArray  # (n,) Recorded samples inside the event (the two interpolated crossings are not counted)
    extra: tuple[ExtraColumn, ...] = ()  # Further columns of the source, such as driver or road
    signals: DepartureSignals | None = None  # y(t), v(t) and c(t) of each, where they were kept


@dataclasses.dataclass(frozen=True)
class DepartureSignals(Rows):
    """Signals of n departures, one after the other in flat arrays (events differ in length).

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> signals = ldc.rebuild_signals(ldc.Scenarios.from_arrays(T=[2.0, 3.0], d_y=0.3, v_mean=25.0), dt=0.5)
    >>> signals.offsets
    array([ 0,  5, 12])
    """

    # (n + 1,) Event i owns the rows ``offsets[i]:offsets[i + 1]``; the first is the crossing outwards (t = 0, y =
    # 0), the last the crossing back (t = T, y = 0), the ones between are samples
    offsets: IntArray
    t: FloatArray  # (m,) [s] Time since the event's start
    y: FloatArray  # (m,) [m] Distance of the vehicle's edge beyond the line, outward
    v: FloatArray  # (m,) [m/s] Speed
    c: FloatArray  # (m,) [1/m] Lane curvature, outward frame

    @property
    def n(self) -> int:
        """Number of departures."""
        return int(self.offsets.shape[0]) - 1

    @property
    def samples(self) -> IntArray:
        """Samples between the two crossings, (n,)."""
        return np.diff(self.offsets) - 2

    def take(self, rows: npt.ArrayLike | slice) -> Self:
        """The signals of chosen departures: an index array, a mask or a slice."""
        events = np.arange(self.n)[row_index(rows)]
        length = np.diff(self.offsets)[events]
        offsets = np.concatenate([[0], np.cumsum(length)])
        samples = np.arange(offsets[-1]) + np.repeat(self.offsets[events] - offsets[:-1], length)
        return type(self)(offsets, self.t[samples], self.y[samples], self.v[samples], self.c[samples])

    def integral(self, values: FloatArray) -> FloatArray:
        """Integral over time of values (m,) since each event's start, (m,), by the trapezoid rule."""
        step = np.zeros_like(values)
        step[1:] = 0.5 * (values[1:] + values[:-1]) * np.diff(self.t)
        step[self.offsets[:-1]] = 0.0
        # a cumulative sum per event: one over everything would carry the first event's rounding into the last
        out = np.empty_like(step)
        length = np.diff(self.offsets)
        width = int(np.max(length, initial=1))
        block = max(1, 2**21 // width)  # bounds the padded table's memory
        for first in range(0, self.n, block):
            count = length[first : first + block]
            rows = slice(int(self.offsets[first]), int(self.offsets[first + count.size]))
            inside = np.arange(width) < count[:, None]
            padded = np.zeros(inside.shape)
            padded[inside] = step[rows]
            out[rows] = np.cumsum(padded, axis=1)[inside]
        return out


def reduce_signals(signals: DepartureSignals, side: npt.ArrayLike) -> DepartureParameters:
    """Reduce signals to the eight parameters.

    Raises `InputError` if an event has fewer than three samples or a duration that is not positive.

    Parameters
    ----------
    signals : DepartureSignals
        n events of at least three samples each between the crossings.
    side : (n,) int
        `LEFT` or `RIGHT`; carried along, the signals are outward already.

    Returns
    -------
    DepartureParameters
        n rows.

    Notes
    -----
    Distance d_x is the trapezoid rule over v(t) with both crossings. d_y is the least-squares amplitude of the parabola
    through y = 0 at both ends, sigma_y and sigma_v are sample standard deviations (L - 1) over the L samples; the
    two crossings are interpolated, not measured, and stay out of the regressions and the residuals.

    Examples
    --------
    >>> import numpy as np
    >>> from ldctoolkit.scenarios import Scenarios
    >>> scenario = Scenarios.from_arrays(T=[2.0], d_y=[0.3], v_mean=[20.0], a_mean=[0.1], c_0=[1e-3], dc=[5e-4])
    >>> reduced = reduce_signals(rebuild_signals(scenario, dt=0.01), scenario.side)
    >>> bool(abs(reduced.d_y[0] - 0.3) < 1e-6)
    True
    """
    starts, last = signals.offsets[:-1], signals.offsets[1:] - 1
    sides = np.asarray(unmasked(side))
    if (wrong := ~np.isin(sides, (LEFT, RIGHT))).any():
        raise InputError("side", value=sides[wrong][0], allowed=f"{LEFT} or {RIGHT}")
    sides = sides.astype(np.int64)
    if signals.n == 0:
        return DepartureParameters(sides, *([np.empty(0)] * len(PARAMETER_NAMES)))
    count = signals.samples
    duration = signals.t[last]
    for name, values, bad, allowed in (
        ("samples between its crossings", count, count < 3, "3 or more"),
        ("duration", duration, ~(duration > 0), "> 0 s"),
    ):
        if bad.any():
            i = int(np.argmax(bad))
            raise InputError(f"signals: event {i}: {name}", value=values[i], allowed=allowed)

    event = np.repeat(np.arange(signals.n), np.diff(signals.offsets))
    x = signals.integral(signals.v)
    d_x = x[last]
    sampled = np.ones(signals.t.size)
    sampled[starts] = sampled[last] = 0.0

    share = x / d_x[event]
    parabola = 4.0 * share * (1.0 - share) * sampled
    tau = signals.t - 0.5 * duration[event]

    def total(values: FloatArray) -> FloatArray:
        """Sums of values (m,) over each event, (n,)."""
        return np.add.reduceat(values, starts)

    def line(values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope of the regression over tau, and its value at tau = 0."""
        mean_tau, mean = total(tau * sampled) / count, total(values * sampled) / count
        centred = (tau - mean_tau[event]) * sampled
        slope = total(centred * (values - mean[event])) / total(centred**2)
        return slope, mean - slope * mean_tau

    def deviation(residual: FloatArray) -> FloatArray:
        mean = total(residual) / count
        return np.sqrt(total(((residual - mean[event]) * sampled) ** 2) / (count - 1))

    d_y = total(signals.y * parabola) / total(parabola**2)
    v_mean = d_x / duration
    a_mean, _ = line(signals.v)
    slope_c, c_middle = line(signals.c)
    return DepartureParameters(
        side=sides,
        T=duration,
        d_y=d_y,
        sigma_y=deviation((signals.y - d_y[event] * parabola) * sampled),
        v_mean=v_mean,
        a_mean=a_mean,
        sigma_v=deviation((signals.v - a_mean[event] * tau - v_mean[event]) * sampled),
        c_0=c_middle - 0.5 * slope_c * duration,
        dc=slope_c * duration,
    )


def speed(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Speed v(t) = v_mean + a_mean (t - T/2) [m/s]; `t` broadcasts against (n,)."""
    return p.v_mean + p.a_mean * (t - 0.5 * p.T)


def position(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Distance x(t) = v_mean t + a_mean (t^2 - T t)/2 [m] since the start; x(T) = v_mean T."""
    return p.v_mean * t + 0.5 * p.a_mean * (t - p.T) * t


def lateral(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Distance y(x(t)) [m] of the edge beyond the line on the fitted parabola."""
    share = position(p, t) / (p.v_mean * p.T)
    return 4.0 * p.d_y * share * (1.0 - share)


def lateral_rate(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Lateral speed dy/dt [m/s] along the parabola."""
    d_x = p.v_mean * p.T
    return 4.0 * p.d_y / d_x * (1.0 - 2.0 * position(p, t) / d_x) * speed(p, t)


def lateral_acceleration(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Second derivative d2y/dt2 [m/s^2] along the parabola, relative to the lane."""
    d_x = p.v_mean * p.T
    bend = -8.0 * p.d_y / d_x**2 * speed(p, t) ** 2
    return bend + 4.0 * p.d_y / d_x * (1.0 - 2.0 * position(p, t) / d_x) * p.a_mean


def lateral_integral(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Integral of y from 0 to t [m s], in closed form (y is a quartic in t)."""
    d_x = p.v_mean * p.T
    alpha = (p.v_mean - 0.5 * p.a_mean * p.T) / d_x
    beta = 0.5 * p.a_mean / d_x
    first = alpha / 2.0 + beta / 3.0 * t
    second = alpha**2 / 3.0 + t * (alpha * beta / 2.0 + beta**2 / 5.0 * t)
    return 4.0 * p.d_y * t**2 * (first - t * second)


def curvature(p: DepartureParameters, t: FloatArray) -> FloatArray:
    """Lane curvature c(t) = c_0 + dc t/T [1/m], outward; held at its last value beyond T, where nothing was seen."""
    return p.c_0 + p.dc * np.minimum(t / p.T, 1.0)


def crossing_time(p: DepartureParameters, y_s: float) -> FloatArray:
    """First time at which y(t) exceeds y_s >= 0 [m], (n,) [s]; infinite where the departure never gets that far.

    y(x) = y_s gives x_s = d_x/2 (1 - sqrt(1 - y_s/d_y)); x(t) = x_s is a quadratic in t, solved in the form that
    does not cancel for small a_mean. 0 for y_s = 0.
    """
    triggered = p.d_y > y_s
    ratio = np.divide(y_s, p.d_y, out=np.ones_like(p.d_y), where=triggered)
    # 1 - sqrt(1 - r) = r / (1 + sqrt(1 - r)): exact for small thresholds too
    x_s = 0.5 * p.v_mean * p.T * ratio / (1.0 + np.sqrt(1.0 - ratio))
    v_0 = p.v_mean - 0.5 * p.a_mean * p.T
    root = np.sqrt(np.maximum(v_0**2 + 2.0 * p.a_mean * x_s, 0.0))
    return np.where(triggered, 2.0 * x_s / (v_0 + root), np.inf)


def bend_polynomial(p: DepartureParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients of 1, t and t^2 of d2y/dt2 along the parabola: y = 4 d_y s (1 - s), s = x(t)/d_x."""
    d_x, v_0, a = p.v_mean * p.T, p.v_mean - 0.5 * p.a_mean * p.T, p.a_mean
    scale = 4.0 * p.d_y / d_x
    return scale * (a - 2.0 * v_0**2 / d_x), scale * (-6.0 * v_0 * a / d_x), scale * (-3.0 * a**2 / d_x)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plausibility(CheckedArguments):
    """What the path of a departure may ask of driver and vehicle; beyond it no departure happened, nor can happen.

    Raises `InputError` for a limit that is not above zero. An infinite one is no limit, and is kept as None.

    Examples
    --------
    >>> from ldctoolkit import Scenarios
    >>> two = Scenarios.from_arrays(T=[0.5, 2.0], d_y=[0.9, 0.3], v_mean=25.0)
    >>> Plausibility().holds(two)
    array([False,  True])
    """

    y_rate: float | None = 2.0  # [m/s] Of 4 d_y/T, the lateral speed at the line
    y_acceleration: float | None = 4.0  # [m/s^2] Of the largest |d2y/dt2| along the parabola
    a_y: float | None = 6.0  # [m/s^2] Of the largest |v^2 c + d2y/dt2|, that of the bend included

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            limit = getattr(self, field.name)
            if limit is not None:
                limit = checked_number(f"plausibility.{field.name}", limit, above=0.0, finite=False)
                object.__setattr__(self, field.name, limit if np.isfinite(limit) else None)

    def __str__(self) -> str:
        limits = zip(("4 d_y/T", "|y''|", "|a_y|"), dataclasses.astuple(self), ("m/s", "m/s^2", "m/s^2"), strict=True)
        return ", ".join(f"{name} = {limit:g} {unit}" for name, limit, unit in limits if limit is not None)

    def holds(self, p: DepartureParameters) -> BoolArray:
        """Which departures keep all limits, (n,); exact for the path without residuals."""
        q_0, q_1, q_2 = bend_polynomial(p)
        ends = np.stack([q_0, q_0 + (q_1 + q_2 * p.T) * p.T])  # the vertex of d2y/dt2 is where the vehicle stands
        # v^2 c + d2y/dt2 is a cubic in t: its extremes are at the ends, or where its slope is zero
        v_0, slope = p.v_mean - 0.5 * p.a_mean * p.T, p.dc / p.T
        k_0, k_1 = q_0 + v_0**2 * p.c_0, q_1 + v_0 * (2.0 * p.a_mean * p.c_0 + v_0 * slope)
        k_2, k_3 = q_2 + p.a_mean * (p.a_mean * p.c_0 + 2.0 * v_0 * slope), p.a_mean**2 * slope
        with np.errstate(divide="ignore", invalid="ignore"):
            # in the form that does not cancel for small k_3
            half = -(k_2 + np.copysign(np.sqrt(k_2**2 - 3.0 * k_3 * k_1), k_2))
            inner = np.stack([half / (3.0 * k_3), k_1 / half])
        t = np.stack([np.zeros(p.n), p.T, *np.clip(np.nan_to_num(inner), 0.0, p.T)])
        a_y = np.abs(k_0 + t * (k_1 + t * (k_2 + t * k_3))).max(axis=0)
        demands = zip((4.0 * p.d_y / p.T, np.abs(ends).max(axis=0), a_y), dataclasses.astuple(self), strict=True)
        within = [value <= most for value, most in demands if most is not None]
        return np.asarray(np.logical_and.reduce([p.T > 0.0, *within]))


def rebuild_signals(p: DepartureParameters, dt: float) -> DepartureSignals:
    """Rebuild the signals of every departure from its parameters, without the residuals.

    Raises `InputError` if dt is not positive.

    Parameters
    ----------
    p : DepartureParameters
        n departures.
    dt : float [s]
        Time step; each event also ends exactly at T.

    Returns
    -------
    DepartureSignals
        Samples at 0, dt, 2 dt, ... below T, and at T.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.rebuild_signals(ldc.Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=25.0), dt=0.5).y.round(3)
    array([0.   , 0.225, 0.3  , 0.225, 0.   ])
    """
    dt = checked_number("dt", dt, above=0.0, unit="s")
    count = np.maximum(np.ceil(p.T / dt - 1e-9).astype(np.int64), 1) + 1
    offsets = np.concatenate([[0], np.cumsum(count)])
    event = np.repeat(np.arange(p.n), count)
    repeated = p.take(event)
    t = np.minimum((np.arange(event.size) - offsets[:-1][event]) * dt, repeated.T)
    t[offsets[1:] - 1] = p.T
    return DepartureSignals(offsets, t, lateral(repeated, t), speed(repeated, t), curvature(repeated, t))


def no_departures() -> Departures:
    """A departures table without rows."""
    whole = np.empty(0, dtype=np.int64)
    numbers: dict[str, Any] = dict.fromkeys((*PARAMETER_NAMES, "start_time"), np.empty(0))
    return Departures(side=whole, recording=np.empty(0, dtype=np.str_), samples=whole, **numbers)


def combined_departures(parts: Sequence[Departures]) -> Departures:
    """Departures one after the other; an extra column that a part lacks is empty there, one that is text anywhere is
    text. Signals are kept where every departure has them.
    """
    parts = parts or [no_departures()]

    def joined(name: str, tables: Sequence[Any] = parts) -> Any:
        return np.concatenate([getattr(table, name) for table in tables])

    extra = []
    for name in dict.fromkeys(column.name for part in parts for column in part.extra):
        pieces = [
            next((column.values for column in part.extra if column.name == name), np.full(part.n, np.nan))
            for part in parts
        ]
        if any(values.dtype.kind == "U" for values in pieces):
            pieces = [v if v.dtype.kind == "U" else np.where(np.isnan(v), "", v.astype(np.str_)) for v in pieces]
        extra.append(ExtraColumn(name, np.concatenate(pieces)))
    recorded, signals = [part.signals for part in parts if part.signals is not None], None
    if recorded and sum(table.n for table in recorded) == sum(part.n for part in parts):
        length = np.concatenate([np.diff(table.offsets) for table in recorded])
        offsets = np.concatenate([[0], np.cumsum(length)])
        signals = DepartureSignals(offsets, *(joined(name, recorded) for name in "tyvc"))
    names = [field.name for field in dataclasses.fields(Departures) if field.name not in ("extra", "signals")]
    columns: dict[str, Any] = {name: joined(name) for name in names}
    return Departures(**columns, extra=tuple(extra), signals=signals)
