"""The recorded path of a departure, with its residuals, and the streams of random numbers of a scenario."""

from __future__ import annotations

import dataclasses
import enum
import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
import numpy.typing as npt

import ldctoolkit.departures as dep
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, row_index
from ldctoolkit.declared import checked_seed
from ldctoolkit.departures import PARAMETER_NAMES, DepartureParameters, DepartureSignals
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import Residuals
from ldctoolkit.scenarios import SPEED_CEILING, SPEED_FLOOR, Drifts, Scenarios, slowest_speed

if TYPE_CHECKING:
    from ldctoolkit.paths.kernels import Path


class RandomStream(enum.IntEnum):
    """Which quantity is drawn; streams are independent of each other."""

    MISMATCH = 1
    RESIDUAL_Y = 2
    RESIDUAL_V = 3
    CAMERA = 4
    CURVATURE = 5
    DRIVER = 6


def uniforms(seed: int, index: npt.ArrayLike, stream: int, count: int) -> FloatArray:
    """Independent uniform numbers on (0, 1), (n, count), for scenarios `index` (n,); no column depends on `count`.

    Column j is element j % 2 of the pair at counter j // 2. Philox4x32-10 (Salmon et al., SC11, 2011), 53 bits each;
    0 and 1 themselves do not occur.
    """
    return _drawn(seed, index, stream, count, normal=False)


def normals(seed: int, index: npt.ArrayLike, stream: int, count: int) -> FloatArray:
    """Independent standard normal numbers, (n, count), for scenarios `index` (n,); no column depends on `count`.

    The transform of Box and Muller (Ann. Math. Statist. 29, 1958) of the uniform numbers; none is beyond 8.6.
    """
    return _drawn(seed, index, stream, count, normal=True)


def _drawn(seed: int, index: npt.ArrayLike, stream: int, count: int, *, normal: bool) -> FloatArray:
    """Random numbers of scenarios, (n, count), that depend on seed, scenario and stream alone."""
    from ldctoolkit.paths.kernels import fill_pairs

    numbers = np.asarray(index)
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
        raise InputError("index", f"{numbers.ndim} dimensions of {numbers.dtype}", allowed="(n,) whole numbers")
    numbers = np.array(numbers, dtype=np.int64)  # a copy: compiled functions take no read-only arrays
    if np.any(numbers < 0):
        i = int(np.argmax(numbers < 0))
        raise InputError(f"index[{i}]", value=int(numbers[i]), allowed="a whole number >= 0")
    if count < 0:
        raise InputError("count", value=count, allowed=">= 0")
    out = np.empty((numbers.size, count))
    fill_pairs(checked_seed(seed), numbers, int(stream), normal, out)
    return out


FEWEST_MODES: Final = 3
"""A residual has at least this many modes: fewer would leave no freedom beside what the parameters fix already."""

MOST_MODES: Final = 100

_BLOCK: Final = 1024  # Paths of a block

# rows that cannot be driven give NaN in silence: they are marked elsewhere
_quiet = np.errstate(divide="ignore", invalid="ignore", over="ignore")


@dataclasses.dataclass(frozen=True)
class Recorded:
    """Recorded signals of n departures as functions of time: straight lines between the samples, held beyond them."""

    signals: DepartureSignals
    y_area: FloatArray  # (m,) [m s] Integral of y from the start to each sample

    @classmethod
    def of(cls, signals: DepartureSignals) -> Self:
        """Recorded signals, made ready."""
        return cls(signals, signals.integral(signals.y))

    def take(self, rows: IntArray | BoolArray | slice) -> Self:
        """Those of chosen departures."""
        return type(self).of(self.signals.take(rows))

    def times(self, rows: IntArray) -> FloatArray:
        """Times of the samples of departures (k,), side by side, (k, most); the last is repeated."""
        first, last = self.signals.offsets[rows], self.signals.offsets[rows + 1] - 1
        sample = np.minimum(first[:, None] + np.arange(np.max(last - first, initial=0) + 1), last[:, None])
        t: FloatArray = self.signals.t[sample]
        return t

    def _before(self, t: FloatArray) -> tuple[FloatArray, IntArray]:
        """Times t (n,) or (n, k) held within the departure, and the sample before each, never the last one."""
        s = self.signals
        number = np.arange(s.n) if t.ndim == 1 else np.arange(s.n)[:, None]
        first, last = s.offsets[number], s.offsets[number + 1] - 1
        held = np.clip(t, 0.0, s.t[last])
        # departures one after the other on one axis; rounding there is undone by a step
        span = 1.0 + float(s.t.max(initial=0.0))
        axis = s.t + span * np.repeat(np.arange(s.n), np.diff(s.offsets))
        sample = np.searchsorted(axis, held + span * number, side="right") - 1
        sample = np.clip(sample, first, last - 1)
        sample = np.clip(sample - (s.t[sample] > held), first, last - 1)
        return held, sample

    def signal(self, name: str, t: FloatArray) -> FloatArray:
        """A signal at times t, (n,) or (n, k)."""
        t, i = self._before(t)
        time, values = self.signals.t, getattr(self.signals, name)
        out: FloatArray = values[i] + (t - time[i]) / (time[i + 1] - time[i]) * (values[i + 1] - values[i])
        return out

    def area(self, t: FloatArray) -> FloatArray:
        """Integral of y from 0 to t, (n,) or (n, k) [m s]."""
        end = self.signal("y", t)
        t, i = self._before(t)
        out: FloatArray = self.y_area[i] + 0.5 * (t - self.signals.t[i]) * (self.signals.y[i] + end)
        return out

    def crossing_time(self, y_s: float) -> FloatArray:
        """First time at which y exceeds y_s, (n,) [s]; infinite where it never does."""
        s, out = self.signals, np.full(self.signals.n, np.inf)
        if s.n == 0:
            return out
        beyond = np.where(s.y > y_s, np.arange(s.y.size), s.y.size)
        after = np.minimum.reduceat(beyond, s.offsets[:-1])
        crossing = np.flatnonzero(after < s.y.size)
        b = after[crossing]
        a = np.maximum(b - 1, s.offsets[crossing])
        rise = s.y[b] - s.y[a]
        share = np.divide(y_s - s.y[a], rise, out=np.zeros_like(rise), where=rise > 0.0)
        out[crossing] = s.t[a] + share * (s.t[b] - s.t[a])
        return out


Curve = Callable[["UncorrectedPath", IntArray, FloatArray], FloatArray]  # of paths, their rows and times (n, k); (n, k)


@dataclasses.dataclass(frozen=True)
class UncorrectedPath:
    """Paths of n scenarios without control, functions of the time t since the departure's start.

    Built with `of`. Times are (n,) or (n, k); results have their shape. What a kind of path has to know: position,
    lateral rate and acceleration, its area, when it crosses a threshold and how deep it gets. Here it is the recorded
    parabola with its residuals, or the recorded signals; `DriftPath` is a departure that does not return.
    """

    scenarios: Scenarios  # n departures
    # (n, J_y) [m] Amplitudes a_j of eps_y(t) = sum a_j sin(j pi t/T); no columns without this residual
    modes_y: FloatArray
    # (n, J_v) [m/s] Amplitudes b_j of eps_v(t) = sum b_j cos(j pi t/T); no columns without this residual
    modes_v: FloatArray
    # Recorded y, v and c with straight lines between the samples; the modes then are fitted, and give what needs a
    # slope: lateral speed and acceleration, and the speed after the trigger
    recorded: Recorded | None = None

    @classmethod
    @_quiet
    def of(cls, scenarios: Scenarios, residuals: Residuals, seed: int) -> UncorrectedPath:
        """Draw the residuals of every scenario, or take the recorded path where the scenarios hold it.

        Raises `InputError` for a seed outside what is allowed.

        Parameters
        ----------
        scenarios : Scenarios
            n departures.
        residuals : Residuals
            Which residuals, and their bandwidth.
        seed : int
            0 to 2^63 - 1; with a scenario's number it fixes the residuals.

        Notes
        -----
        A scenario has the modes j/(2 T) <= bandwidth, at least 3 and at most 100. Amplitudes are independent normal
        numbers, projected so that reducing the path gives the eight parameters back: eps_v is orthogonal over [0, T]
        to a straight line in t (a_mean, v_mean), eps_y to the path's own parabola 4 s (1 - s), s = x(t)/d_x (d_y). The
        latter is 4 u (1 - u), u = t/T, only at constant speed; x(t) is what the regression sees, so x(t) it is. Then
        each is scaled to the scenario's sigma: its standard deviation in time over [0, T], about its own mean, as in
        `reduce_signals`. y is zero at both ends and may be negative between.

        Examples
        --------
        >>> import numpy as np
        >>> scenario = Scenarios.from_arrays(T=[4.0], d_y=[0.3], v_mean=[20.0], sigma_y=[0.02])
        >>> path = UncorrectedPath.of(scenario, Residuals(y=True), seed=1)
        >>> path.modes_y.shape, path.modes_v.shape
        ((1, 8), (1, 0))
        >>> eps = path.lateral(np.linspace(0.0, 4.0, 1001)[None, :]) - 0.3 * (1 - np.linspace(-1, 1, 1001) ** 2)
        >>> round(float(np.std(eps)), 4)
        0.02
        """
        seed = checked_seed(seed)
        none = np.zeros((scenarios.n, 0))
        path = cls(scenarios, none, none)
        if scenarios.drift is not None:
            return DriftPath(scenarios, none, none)
        if scenarios.signals is not None:
            return path._fitted(Recorded.of(scenarios.signals), residuals.bandwidth)
        if residuals.ideal:
            return path
        from ldctoolkit.paths.kernels import shape_lateral_modes, shape_speed_modes

        count = _mode_count(scenarios.T, residuals.bandwidth)
        most = int(count.max(initial=0))
        if residuals.v:
            modes = normals(seed, scenarios.index, RandomStream.RESIDUAL_V, most)
            shape_speed_modes(np.array(scenarios.sigma_v), count, modes)
            path = dataclasses.replace(path, modes_v=modes)
        if residuals.y:
            modes = normals(seed, scenarios.index, RandomStream.RESIDUAL_Y, most)
            shape_lateral_modes(path.columns(), np.array(scenarios.sigma_y), count, modes)
            path = dataclasses.replace(path, modes_y=modes)
        return path

    def _fitted(self, recorded: Recorded, bandwidth: float) -> UncorrectedPath:
        """With the modes up to the bandwidth, half as many as samples at most, that are nearest to the samples."""
        T, most = self.scenarios.T, np.maximum(recorded.signals.samples // 2, 1)
        count = np.minimum(_mode_count(T, bandwidth), most)
        modes_y, modes_v = np.zeros((2, self.n, int(count.max(initial=1))))
        path = dataclasses.replace(self, modes_y=modes_y, modes_v=modes_v)
        for first in range(0, self.n, _BLOCK):
            rows = np.arange(first, min(first + _BLOCK, self.n))
            part, t = recorded.take(rows), recorded.times(rows)
            used = np.arange(1, modes_y.shape[1] + 1) <= count[rows, None]
            angle = np.pi * (t / T[rows, None])[:, :, None] * np.arange(1, modes_y.shape[1] + 1)
            weight = ((t > 0.0) & (t < T[rows, None]))[:, :, None] * used[:, None, :]
            for modes, wave, name in ((modes_v, np.cos, "v"), (modes_y, np.sin, "y")):
                plain = path.take(rows)  # y is seen along the x of the speed that is fitted first
                gap = part.signal(name, t) - (plain.speed(t) if name == "v" else plain.lateral(t))
                basis = wave(angle) * weight
                normal = basis.transpose(0, 2, 1) @ basis + np.eye(used.shape[1]) * np.where(used, 1e-9, 1.0)[:, None]
                modes[rows] = np.linalg.solve(normal, basis.transpose(0, 2, 1) @ gap[:, :, None])[:, :, 0]
        return dataclasses.replace(path, recorded=recorded)

    @property
    def n(self) -> int:
        """Number of scenarios."""
        return self.scenarios.n

    def take(self, rows: npt.ArrayLike | slice) -> Self:
        """The chosen paths: an index array, a mask or a slice."""
        index = row_index(rows)
        return dataclasses.replace(
            self,
            scenarios=self.scenarios.take(index),
            modes_y=self.modes_y[index],
            modes_v=self.modes_v[index],
            recorded=self.recorded and self.recorded.take(index),
        )

    @_quiet
    def position(self, t: FloatArray) -> FloatArray:
        """Distance x(t) along the lane [m]; x(T) = v_mean T, with residuals too."""
        return self._values("POSITION", dep.position, t, self._varied)

    @_quiet
    def speed(self, t: FloatArray) -> FloatArray:
        """Speed v(t) [m/s]; v(T) beyond T."""
        if self.recorded is not None:
            return self.recorded.signal("v", t)
        return self._values("SPEED", dep.speed, np.minimum(t, _like(self.scenarios.T, t)), self._varied)

    @_quiet
    def lateral(self, t: FloatArray) -> FloatArray:
        """Distance y(t) of the edge beyond the line [m]."""
        if self.recorded is not None:  # what was before the departure is not known: the parabola, and its modes
            return np.where(t < 0.0, self._values("LATERAL", dep.lateral, t, True), self.recorded.signal("y", t))
        return self._values("LATERAL", dep.lateral, t, self._disturbed)

    @_quiet
    def lateral_rate(self, t: FloatArray) -> FloatArray:
        """Lateral speed dy/dt [m/s]."""
        return self._values("LATERAL_RATE", dep.lateral_rate, t, self._disturbed)

    @_quiet
    def lateral_acceleration(self, t: FloatArray) -> FloatArray:
        """Second derivative d2y/dt2 [m/s^2], relative to the lane."""
        return self._values("LATERAL_ACCELERATION", dep.lateral_acceleration, t, self._disturbed)

    @_quiet
    def curvature(self, t: FloatArray) -> FloatArray:
        """Lane curvature c(t) [1/m], outward; c(T) beyond T. It has no drawn residual."""
        if self.recorded is not None:
            return self.recorded.signal("c", t)
        return dep.curvature(self._shaped(t), t)

    @_quiet
    def area(self, t: FloatArray) -> FloatArray:
        """Integral of y from 0 to t [m s]: closed form, or a Gauss rule that is exact to rounding where v has eps_v."""
        if self.recorded is not None:
            return self.recorded.area(t)
        if not self._disturbed:
            return dep.lateral_integral(self._shaped(t), t)
        from ldctoolkit.paths.kernels import areas

        out = np.empty(_time_table(t).shape)
        areas(self.columns(), _time_table(t), out)
        return out.reshape(t.shape)

    def score(self, t: FloatArray, offset: float) -> FloatArray:
        """Integral of |e_y| from 0 to t, (n,) [m s], with e_y = y + offset, which a departure has on one side."""
        return self.area(t) + offset * t

    @property
    def back(self) -> FloatArray:
        """When the edge is back at the line, (n,) [s]."""
        return self.scenarios.T

    @_quiet
    def crossing_time(self, y_s: float, lead_time: float = 0.0) -> FloatArray:
        """First time at which y + lead_time dy/dt exceeds a threshold y_s [m], (n,) [s]; infinite where it never does.

        With `lead_time` [s] it is the time at which the threshold is that many seconds away at the present lateral
        speed. Searched for with 16 cells for each half wave of the highest mode, a peak inside a cell included, then a
        root to 1e-14 T; in closed form for the parabola's position, on the samples for that of recorded signals.
        """
        if self.recorded is not None and not lead_time:
            return self.recorded.crossing_time(y_s)
        if not (self._disturbed or lead_time):
            return dep.crossing_time(self.scenarios, y_s) if y_s >= 0.0 else np.zeros(self.n)
        from ldctoolkit.paths.kernels import crossings

        out = np.empty(self.n)
        crossings(self.columns(), float(lead_time), float(y_s), out)
        return out

    @_quiet
    def deepest(self, t_end: FloatArray) -> FloatArray:
        """Largest y over [0, t_end] [m]; `t_end` (n,) is cut off at T."""
        end = np.minimum(t_end, self.scenarios.T)
        if self._disturbed:
            return self.highest(lambda path, _, t: path.lateral(t), np.zeros_like(end), end)
        p = self.scenarios
        past = dep.position(p, end) >= 0.5 * p.v_mean * p.T
        return np.where(past, p.d_y, np.maximum(dep.lateral(p, end), 0.0))

    @_quiet
    def highest(self, curve: Curve, t_0: FloatArray, t_1: FloatArray) -> FloatArray:
        """Largest value of a smooth curve over [t_0, t_1], (n,); both (n,) [s], cut off at T.

        It is taken at the samples of recorded signals, or at 16 points for each half wave of the highest mode, and at
        the peak of the polynomial through five; where the curve is not that smooth, again at points around the highest.
        """
        out, starts, ends = np.full(self.n, -np.inf), *np.minimum([t_0, t_1], self.scenarios.T)
        # cells of each path by itself: no number depends on which others stand beside it
        cells = np.maximum(16 * np.maximum(_used(self.modes_y), _used(self.modes_v)), 8) * (self.recorded is None)
        groups = [np.flatnonzero(cells == count) for count in np.unique(cells)]
        for rows in (group[i : i + _BLOCK] for group in groups for i in range(0, group.size, _BLOCK)):
            count, start, end = cells[rows[0]], starts[rows, None], ends[rows, None]
            for _ in range(16 if self.recorded is None else 3):
                path = self.take(rows)
                if path.recorded is not None and not count:
                    t = np.clip(path.recorded.times(np.arange(path.n)), start, end)
                    f = curve(path, rows, t)
                    column, settled = np.argmax(f, axis=1)[:, None], np.zeros(path.n, dtype=np.bool_)
                else:
                    t = start + (end - start) * np.linspace(0.0, 1.0, count + 1)
                    f = curve(path, rows, t)
                    column, peak, settled = _peak(f)
                    f = np.c_[f, curve(path, rows, start + (end - start) * (peak / count))]
                out[rows] = np.maximum(out[rows], f.max(axis=1))
                if settled.all():
                    break
                around = np.clip(column + np.array([-1, 1]), 0, t.shape[1] - 1)
                start, end = np.take_along_axis(t, around, axis=1)[~settled].T[:, :, None]
                rows, count = rows[~settled], 8
        return out

    def slowest_speed(self, t_0: FloatArray, t_1: FloatArray) -> FloatArray:
        """Lowest speed over [t_0, t_1] [m/s], both (n,), t_0 <= t_1; with eps_v searched like `crossing_time`."""
        start, end = np.minimum(t_0, self.scenarios.T), np.minimum(t_1, self.scenarios.T)
        if self._varied:
            return -self.highest(lambda path, _, t: -path.speed(t), start, end)
        return np.minimum(dep.speed(self.scenarios, start), dep.speed(self.scenarios, end))

    def drivable(self) -> BoolArray:
        """Scenarios whose numbers are finite and have their signs, and whose speed stays where plant and gains are."""
        p = self.scenarios
        finite = np.isfinite(p.matrix()).all(axis=1)
        with np.errstate(invalid="ignore"):
            sound = finite & (p.T > 0) & (p.d_y >= 0) & (p.sigma_y >= 0) & (p.sigma_v >= 0)
            slowest = slowest_speed(p.v_mean, p.a_mean, p.T)
            fast = sound & (slowest >= SPEED_FLOOR) & (2.0 * p.v_mean - slowest <= SPEED_CEILING)
        if self.modes_v.shape[1] and fast.any():
            rows = np.flatnonzero(fast)
            path = self.take(rows)
            fast[rows] = path.slowest_speed(np.zeros(rows.size), path.scenarios.T) >= SPEED_FLOOR
        return np.asarray(fast, dtype=bool)

    def columns(self) -> Path:
        """The columns for compiled functions."""
        from ldctoolkit.paths.kernels import Path

        p = self.scenarios
        T, d_y, v_mean, a_mean = (np.array(column) for column in (p.T, p.d_y, p.v_mean, p.a_mean))
        modes_y, modes_v = np.ascontiguousarray(self.modes_y), np.ascontiguousarray(self.modes_v)
        return Path(T, d_y, v_mean, a_mean, modes_y, modes_v, _used(modes_y), _used(modes_v))

    @property
    def _varied(self) -> bool:
        """The speed has a residual."""
        return bool(self.modes_v.shape[1])

    @property
    def _disturbed(self) -> bool:
        """The lateral path is not the plain parabola."""
        return self._varied or bool(self.modes_y.shape[1])

    def _shaped(self, t: FloatArray) -> DepartureParameters:
        """The parameters as columns that broadcast against t."""
        return self.scenarios if t.ndim == 1 else self._wide

    @functools.cached_property
    def _wide(self) -> DepartureParameters:
        columns = {name: getattr(self.scenarios, name)[:, None] for name in PARAMETER_NAMES}
        return dataclasses.replace(self.scenarios, **columns)

    def _values(
        self, what: str, plain: Callable[[DepartureParameters, FloatArray], FloatArray], t: FloatArray, moved: bool
    ) -> FloatArray:
        if not moved:
            return plain(self._shaped(t), t)
        from ldctoolkit.paths import kernels

        out = np.empty(_time_table(t).shape)
        kernels.values(self.columns(), getattr(kernels, what), _time_table(t), out)
        return out.reshape(t.shape)


@dataclasses.dataclass(frozen=True)
class DriftPath(UncorrectedPath):
    """Departures that do not return, in closed form: see `Drifts`. They have no residuals; y never falls."""

    @property
    def drift(self) -> Drifts:
        """Their numbers."""
        assert self.scenarios.drift is not None
        return self.scenarios.drift

    def lateral(self, t: FloatArray) -> FloatArray:
        """Distance y(t) of the edge beyond the line [m]."""
        return self.drift.motion(self.scenarios.v_mean, t)[0]

    def lateral_rate(self, t: FloatArray) -> FloatArray:
        """Lateral speed dy/dt [m/s]."""
        return self.drift.motion(self.scenarios.v_mean, t)[1]

    def lateral_acceleration(self, t: FloatArray) -> FloatArray:
        """Second derivative d2y/dt2 [m/s^2], relative to the lane."""
        return self.drift.motion(self.scenarios.v_mean, t)[2]

    def area(self, t: FloatArray) -> FloatArray:
        """Integral of y from 0 to t >= 0 [m s]."""
        drift, v = self.drift, self.scenarios.v_mean
        end, deep = drift.arc(v)
        columns = v, drift.radius, drift.lateral_velocity, drift.distance, end, deep
        v, radius, rate, distance, end, deep = (_like(column, t) for column in columns)
        inside, after = np.minimum(t, end), np.maximum(t - end, 0.0)
        arc = radius * (inside - radius / v * np.sin(v * inside / radius))
        return arc + after * (deep + 0.5 * rate * after) - distance * t

    def score(self, t: FloatArray, offset: float) -> FloatArray:
        """Integral of |e_y| from 0 to t, (n,) [m s]: the vehicle may start beyond the middle of its lane."""
        inside = np.minimum(self.crossing_time(-offset), t)
        return self.area(t) + offset * t - 2.0 * (self.area(inside) + offset * inside)

    @property
    def back(self) -> FloatArray:
        """It never is."""
        return np.full(self.n, np.inf)

    def crossing_time(self, y_s: float, lead_time: float = 0.0) -> FloatArray:
        """First time at which y + lead_time dy/dt exceeds y_s, (n,) [s]; infinite where that is after T."""
        drift, v = self.drift, self.scenarios.v_mean
        end, deep = drift.arc(v)
        way, q = drift.distance + y_s, lead_time * v / drift.radius
        # 1 - cos a + q sin a = way/radius, for the tangent of a/2
        part = np.maximum(way / drift.radius, 0.0)
        half = np.arctan(part / np.maximum(q + np.sqrt(np.maximum(q**2 + part * (2.0 - part), 0.0)), 1e-300))
        arc = 2.0 * half * drift.radius / v
        straight = end + (way - deep) / drift.lateral_velocity - lead_time
        t = np.where(way < 0.0, 0.0, np.where(arc <= end, arc, straight))
        return np.where(t <= self.scenarios.T, t, np.inf)

    def deepest(self, t_end: FloatArray) -> FloatArray:
        """Largest y over [0, t_end] [m]; `t_end` (n,) is cut off at T."""
        return self.lateral(np.minimum(t_end, self.scenarios.T))


def _peak(f: FloatArray) -> tuple[IntArray, FloatArray, BoolArray]:
    """Where curves with values f (n, k) at equal distances are highest: the column and, between columns, the peak near
    it, both (n, 1), and whether the curve is so smooth that its value there is the highest to 1e-12, (n,).
    """
    last = f.shape[1] - 1
    # of the parabolas through a point and its neighbours, or the next two at an end
    k = np.diff(f, 2, axis=1)[:, [0, *range(last - 1), -1]]
    s = np.gradient(f, axis=1, edge_order=2)
    s[:, 0], s[:, -1] = np.maximum(s[:, 0], 0.0), np.minimum(s[:, -1], 0.0)
    column = np.argmax(f + np.where(np.abs(s) < -0.75 * k, -0.5 * s**2 / k, 0.0), axis=1)[:, None]
    middle = np.clip(column, 2, last - 2)
    a, b, c, d, e = (np.take_along_axis(f, middle + j, axis=1) for j in range(-2, 3))
    first, second = (8.0 * (d - b) - (e - a)) / 12.0, (16.0 * (b + d) - 30.0 * c - (a + e)) / 12.0
    third, fourth = 0.5 * (e - a) - (d - b), a + e - 4.0 * (b + d) + 6.0 * c
    low, high, x = np.maximum(column - 1, 0) - middle, np.minimum(column + 1, last) - middle, 1.0 * (column - middle)
    for _ in range(6):  # Newton's method
        slope = first + x * (second + x * (0.5 * third + x * fourth / 6.0))
        bend = second + x * (third + 0.5 * x * fourth)
        x = np.clip(x - slope / np.minimum(bend, -1e-300), low, high)
    peak, error = middle + x, np.abs(np.diff(f, 5, axis=1)).max(axis=1, keepdims=True) / 20.0  # of the slope
    outward = ((peak == 0) & (slope < -error)) | ((peak == last) & (slope > error))
    wrong = np.where(outward, error, np.abs(slope) + error)
    settled = wrong**2 <= 2e-12 * np.maximum(np.abs(bend), 1e-12)
    return column, peak, settled[:, 0]


def _mode_count(T: FloatArray, bandwidth: float) -> IntArray:
    """Number of modes of each scenario; none where T is not a duration."""
    valid = np.isfinite(T) & (T > 0)
    most = np.floor(2.0 * np.where(valid, T, 0.0) * bandwidth)
    return np.where(valid, np.clip(most, FEWEST_MODES, MOST_MODES), 0).astype(np.int64)


def _used(modes: FloatArray) -> IntArray:
    """Columns up to the last that is not zero, (n,)."""
    last = np.max(np.where(modes != 0.0, np.arange(1, modes.shape[1] + 1), 0), axis=1, initial=0)
    return np.asarray(last, dtype=np.int64)


def _like(column: FloatArray, t: FloatArray) -> FloatArray:
    """A column of n scenarios to combine with times of (n,) or (n, k)."""
    return column if t.ndim == 1 else column[:, None]


def _time_table(t: FloatArray) -> FloatArray:
    """Times of (n,) or (n, k) as a contiguous table, (n, k)."""
    return np.ascontiguousarray(t if t.ndim == 2 else t[:, None], dtype=np.float64)


def harmless(scenarios: Scenarios, valid: BoolArray) -> Scenarios:
    """The same with a flat departure in place of the rows that cannot be driven."""
    flat = {"T": 1.0, "v_mean": 20.0}
    columns: dict[str, Any] = {
        name: np.where(valid, getattr(scenarios, name), flat.get(name, 0.0)) for name in PARAMETER_NAMES
    }
    return dataclasses.replace(scenarios, **columns)
