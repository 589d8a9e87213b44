"""An independent closed loop with every plant option, for tests: one departure at a time, integrated by scipy.

Nothing is shared with the package but the frozen options and the law's formula. Everything runs in the road frame of
ISO 8855 (a right departure is negative there), and the plant is integrated in the vehicle's own coordinates (e_y,
e_psi, lateral velocity v_y, yaw rate omega) with the wheel's angle as a fifth state. The integration stops wherever the
right-hand side is not smooth: at samples, where a delayed command arrives, where the actuator leaves its rate limit,
and at T."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.linalg import expm
from scipy.optimize import brentq, minimize_scalar, root

from ldctoolkit import LinearLaw, Scenarios
from ldctoolkit.plant_options import Actuator, KalmanFilter, PlantOptions, Sensors

G = 9.81
W_L, W_V = 3.6, 1.9
OFFSET = (W_L - W_V) / 2
JERK_WINDOW = 0.5
BOUND, SPUN = 20.0, 1.5  # |e_y| [m] and, on saturating tyres, |e_psi| [rad] beyond which a departure is lost

Times = Any  # one time or an array of times [s]; and what belongs to them
Law = Callable[..., float]
"""(x, yaw rate ahead, heading change ahead, command before, those before it, wheel angle) -> command, as seen."""


def of_row(law: LinearLaw, j: int) -> Law:
    """That of one scenario."""
    past, wheel = (0.0 if given is None else given[j] for given in (law.f_past, law.f_wheel))

    def command(x: np.ndarray, rate: Any, heading: Any, before: float, earlier: list[float], angle: float) -> float:
        ahead = [(rate(s), heading(s)) for s in law.preview_times]
        lane = sum(law.G_yaw_rate[j, p] * r + law.G_heading[j, p] * turn for p, (r, turn) in enumerate(ahead))
        sent = np.dot(past, earlier[: np.size(past)]).sum()
        return float(law.F[j] @ x + lane + law.f_u[j] * before + sent + wheel * angle)

    return command


@dataclasses.dataclass(frozen=True)
class Vehicle:
    """Table I of the paper."""

    m: float = 1000.0
    I_z: float = 3344.0
    C_af: float = 80000.0
    C_ar: float = 80000.0
    l_f: float = 1.43
    l_r: float = 1.47
    mu: float = 0.9
    as_printed: bool = False

    def times(
        self, *, m: float = 1.0, I_z: float = 1.0, C_af: float = 1.0, C_ar: float = 1.0, mu: float = 1.0
    ) -> Vehicle:
        return dataclasses.replace(
            self, m=m * self.m, I_z=I_z * self.I_z, C_af=C_af * self.C_af, C_ar=C_ar * self.C_ar, mu=mu * self.mu
        )

    def matrices(self, v: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rajamani's eq. 2.45, for the Kalman filter."""
        C_f, C_r, l_f, l_r, m, I_z = 2 * self.C_af, 2 * self.C_ar, self.l_f, self.l_r, self.m, self.I_z
        moment, damping = C_f * l_f - C_r * l_r, C_f * l_f**2 + C_r * l_r**2
        slip = C_f * l_f + C_r * l_r if self.as_printed else moment
        A = np.array(
            [
                [0, 1, 0, 0], [0, -(C_f + C_r) / (m * v), (C_f + C_r) / m, -slip / (m * v)], [0, 0, 0, 1],
                [0, -moment / (I_z * v), moment / I_z, -damping / (I_z * v)],
            ]
        )  # fmt: skip
        B = np.array([0, C_f / m, 0, C_f * l_f / I_z])
        E = np.array([0, -moment / (m * v) - v, 0, -damping / (I_z * v)])
        return A, B, E


@dataclasses.dataclass(frozen=True)
class Path:
    """The recorded departure in the road frame: y, speed, and the lane's curvature, all with their derivatives. `c_0`
    and `dc` are positive to the left; `a` and `b` are the amplitudes of the residuals' modes 1, 2, ..., those of y in
    the outward direction."""

    side: int
    T: float
    d_y: float
    v_mean: float
    a_mean: float = 0.0
    c_0: float = 0.0
    dc: float = 0.0
    a: tuple[float, ...] = ()
    b: tuple[float, ...] = ()

    @classmethod
    def of(cls, scenarios: Scenarios, i: int, a: Iterable[float] = (), b: Iterable[float] = ()) -> Path:
        """Scenario i, whose curvature is outward there."""
        side = int(scenarios.side[i])
        p = {name: float(getattr(scenarios, name)[i]) for name in ("T", "d_y", "v_mean", "a_mean", "c_0", "dc")}
        p |= {"c_0": side * p["c_0"], "dc": side * p["dc"]}
        return cls(side=side, **p, a=tuple(a), b=tuple(b))

    def _wave(self, amplitudes: tuple[float, ...], order: int, t: Times) -> Times:
        """Sum of amplitude times w^order sin(w t + order pi/2); order 1 and its kin are the derivatives of order 0."""
        if not amplitudes:
            return 0.0 * t
        w = np.arange(1, len(amplitudes) + 1) * np.pi / self.T
        return (np.array(amplitudes) * w**order) @ np.sin(np.multiply.outer(w, t) + order * np.pi / 2)

    def v(self, t: Times) -> Times:
        b_over_w = tuple(b * self.T / (j * np.pi) for j, b in enumerate(self.b, 1))
        return self.v_mean + self.a_mean * (t - self.T / 2) + self._wave(b_over_w, 1, t)

    def dv(self, t: Times) -> Times:
        b_over_w = tuple(b * self.T / (j * np.pi) for j, b in enumerate(self.b, 1))
        return self.a_mean + self._wave(b_over_w, 2, t)

    def x(self, t: Times) -> Times:
        b_over_w = tuple(b * self.T / (j * np.pi) for j, b in enumerate(self.b, 1))
        return self.v_mean * t + self.a_mean * (t**2 - self.T * t) / 2 + self._wave(b_over_w, 0, t)

    def _parabola(self, t: Times) -> tuple[Times, Times, float]:
        """Value, first and second derivative with respect to x."""
        d_x = self.v_mean * self.T
        s = self.x(t) - d_x / 2
        k = -4 * self.d_y / d_x**2
        return k * s**2 + self.d_y, 2 * k * s, 2 * k

    def y(self, t: Times) -> Times:
        """Outward."""
        return self._parabola(t)[0] + self._wave(self.a, 0, t)

    def dy(self, t: Times) -> Times:
        return self._parabola(t)[1] * self.v(t) + self._wave(self.a, 1, t)

    def ddy(self, t: Times) -> Times:
        _, slope, bend = self._parabola(t)
        return bend * self.v(t) ** 2 + slope * self.dv(t) + self._wave(self.a, 2, t)

    def c(self, t: Times) -> Times:
        share = t / self.T
        return self.c_0 + self.dc * (min(share, 1.0) if isinstance(share, float) else np.minimum(share, 1.0))

    def e_y(self, t: Times) -> Times:
        return self.side * (self.y(t) + OFFSET)

    def course(self, t: Times) -> Times:
        return self.side * np.arctan2(self.dy(t), self.v(t))

    def trigger(self, y_s: float) -> float:
        """First time at which y exceeds y_s."""
        if y_s <= 0:
            return 0.0
        grid = np.linspace(0.0, self.T, 4001)
        above = self.y(grid) > y_s
        if not above.any():
            return math.inf
        i = int(np.argmax(above))
        return float(brentq(lambda t: self.y(t) - y_s, grid[i - 1], grid[i], xtol=1e-15, rtol=1e-14))


@dataclasses.dataclass(frozen=True)
class Piece:
    """A stretch of time in which everything is smooth: e_y and e_psi as functions of t, and the wheel's angle."""

    start: float
    end: float
    e_y: Callable[[Times], Times]
    e_psi: Callable[[Times], Times]
    delta: Callable[[Times], Times] = lambda t: 0.0 * t


@dataclasses.dataclass(frozen=True)
class Drive:
    """What came out, in the outward frame; rows of `x` are (e_y, de_y/dt, e_psi, de_psi/dt)."""

    t_s: float
    S: float
    S_recorded: float
    x_T: np.ndarray
    x_end: np.ndarray
    t: np.ndarray
    x: np.ndarray
    delta: np.ndarray
    a_y: np.ndarray
    seen: np.ndarray
    commands: np.ndarray
    metrics: dict[str, float]
    margin: float = math.inf
    """How close a value came to where it is rounded the other way, in steps."""


def drive(
    path: Path, law: Law, *, options: PlantOptions | None = None, vehicle: Vehicle | None = None,
    true: Vehicle | None = None, y_s: float = 0.2, dt: float = 0.05, settle: float = 0.0, curvature_draw: float = 0.0,
    noise: Mapping[int, np.ndarray] | None = None, known: bool = True, rtol: float = 1e-13,
) -> Drive:  # fmt: skip
    """Drive one departure. `true` is the vehicle on the road, `vehicle` the one that the filter knows; `known` are to
    it lag and delays too. Stochastic options are taken for what they are given as: `true`, the amplitudes in `path`,
    `curvature_draw`, and `noise`, a frame's number -> its two standard normal numbers; none without it. With `rtol`
    above 1e-12 the metrics beside S are left out."""
    options = PlantOptions() if options is None else options
    vehicle = Vehicle() if vehicle is None else vehicle
    true = vehicle if true is None else true
    t_s = path.trigger(y_s)
    first = min(t_s, path.T) if math.isinf(t_s) else t_s
    loop = _Loop(path, law, options, vehicle, true, first, dt, settle, curvature_draw, noise or {}, known, rtol)
    times = np.linspace(0.0, path.T, 81)  # several to each half wave of a residual
    nearly = CubicSpline(times, [loop.attitude(t)[0] for t in times]) if rtol < 1e-12 else path.course

    def heading(t: Times) -> Times:
        return loop.attitude(float(t))[0] if np.ndim(t) == 0 else nearly(t)

    before = [Piece(0.0, min(t_s, path.T), path.e_y, heading)]
    S_recorded = absolute_area([Piece(0.0, path.T, path.e_y, heading)])
    if math.isinf(t_s):
        return _never_triggered(path, before, S_recorded, true)
    loop.run()
    departure = before + [piece for piece in loop.pieces if piece.end <= path.T]
    return Drive(
        t_s=t_s, S=absolute_area(departure), S_recorded=S_recorded, x_T=loop.x_T, x_end=loop.rows_x[-1],
        t=np.array(loop.rows_t), x=np.array(loop.rows_x), delta=np.array(loop.rows_delta), a_y=np.array(loop.rows_a_y),
        seen=np.array(loop.seen), commands=path.side * np.array(loop.commands), margin=loop.margin,
        metrics=_metrics(path, departure, loop) if rtol < 1e-12 else {},
    )  # fmt: skip


class LostError(Exception):
    """The vehicle left the road or spun."""


class _Loop:
    def __init__(
        self, path: Path, law: Law, options: PlantOptions, vehicle: Vehicle, true: Vehicle,
        t_s: float, dt: float, settle: float, curvature_draw: float, noise: Mapping[int, np.ndarray], known: bool,
        rtol: float,
    ) -> None:  # fmt: skip
        self.path, self.law, self.options, self.true = path, law, options, true
        self.t_s, self.dt, self.v_s = t_s, dt, path.v(t_s)
        self.frozen = options.speed == "frozen"
        self.at: tuple[Times, Times] = (None, None)  # the last time and the speed then
        self.curvature_draw, self.rtol = curvature_draw, rtol
        self.full = math.floor((path.T - t_s) / dt)
        self.rest = path.T - t_s - self.full * dt
        self.rest = self.rest if self.rest > 1e-12 else 0.0
        self.more = math.ceil(settle / dt - 1e-9)
        x_0, self.delta_0 = self.recorded(t_s), self.attitude(t_s)[1]
        self.state = np.append(self.vehicle_coordinates(t_s, x_0), self.delta_0)
        self.camera, self.noise, self.margin = _Camera(options.sensors, dt), noise, math.inf
        self.age = self.camera.age * known
        self.known_delay = options.actuator.delay * known + self.age
        self.filter = None
        if options.sensors.kalman is not None:
            lag, first = options.actuator.lag * known, self.recorded(t_s - self.age)
            self.filter = _Filter(vehicle, path.v(t_s), dt, self.camera.samples, options.sensors.kalman, first, lag)
        self.commands: list[float] = []
        self.wheels: list[float] = []
        self.pieces: list[Piece] = []
        self.x_T = np.full(4, np.nan)
        # rows of the trajectory, outward
        self.rows_t: list[float] = []
        self.rows_x: list[np.ndarray] = []
        self.rows_delta: list[float] = []
        self.rows_a_y: list[float] = []
        self.seen: list[np.ndarray] = []
        # at each sample and at the end: time, a_y before and after, the wheel's angle after; then a_y without v^2 c
        self.nodes: list[tuple[float, float, float, float]] = []
        self.own: list[tuple[float, float]] = []
        self.own_T = 0.0

    # the lane and the speed, as they are and as the law sees them

    def recorded(self, t: float) -> np.ndarray:
        path = self.path
        rates = path.side * path.dy(t), path.side * path.ddy(t) / path.v(t)
        return np.array([path.e_y(t), rates[0], self.attitude(t)[0], rates[1]])

    def v(self, t: Times) -> Times:
        if self.frozen:
            return self.v_s
        if t is not self.at[0]:
            self.at = t, self.path.v(np.minimum(t, self.path.T))
        return self.at[1]

    def dv(self, t: float, inside: bool) -> float:
        return self.path.dv(t) if inside and not self.frozen else 0.0

    def yaw_rate(self, t: Times) -> Times:
        return self.v(t) * self.path.c(t)

    def yaw_acceleration(self, t: float, inside: bool) -> float:
        bend = self.path.dc / self.path.T if inside else 0.0
        return self.dv(t, inside) * self.path.c(t) + self.v(t) * bend

    def yaw_rate_seen(self, t: Times) -> Times:
        sensors = self.options.sensors
        error = sensors.curvature_bias + self.curvature_draw
        return self.v(t) * ((1.0 + sensors.curvature_gain) * self.path.c(t) + error)

    def heading_seen(self, t: float, ahead: float) -> float:
        end = t + ahead
        if end <= self.path.T:
            return gauss(self.yaw_rate_seen, t, end)
        if t >= self.path.T:
            return gauss(self.yaw_rate_seen, t, end)
        return gauss(self.yaw_rate_seen, t, self.path.T) + gauss(self.yaw_rate_seen, self.path.T, end)

    # the plant

    def attitude(self, t: float) -> tuple[float, float]:
        """(e_psi, steering angle) at which the forces give the recorded path's e_y'', and no e_psi''."""
        true, kept, self.v_s = self.true, self.v_s, self.path.v(t)
        v, dv, bend = self.v_s, self.dv(t, True), self.path.side * self.path.ddy(t)
        x = np.array([self.path.e_y(t), self.path.side * self.path.dy(t), 0.0, bend / v])

        def left_over(angles: np.ndarray) -> tuple[float, float]:
            e_psi, delta = angles
            x[2] = e_psi
            state = np.append(self.vehicle_coordinates(t, x), delta)
            _, d_e_psi, d_v_y, d_omega, _ = self.derivative(t, state, True, lambda delta: 0.0)
            if self.options.tyres.model == "linear":
                found = d_v_y + dv * e_psi + v * d_e_psi
            else:
                sine, cosine = math.sin(e_psi), math.cos(e_psi)
                found = (d_v_y + v * d_e_psi) * cosine + (dv - state[2] * d_e_psi) * sine
            return found - bend, d_omega - self.yaw_acceleration(t, True)

        turn = (self.yaw_rate(t) + bend / v) / v
        angles = np.array([self.path.course(t) - math.atan(true.l_r * turn), math.atan((true.l_f + true.l_r) * turn)])
        for more in (8.0, 2.0, 1.0):  # with little friction there are solutions beyond the peak of the force too
            self.true = true.times(mu=more)
            angles = root(left_over, angles, tol=1e-14).x
        self.true, self.v_s = true, kept
        return float(angles[0]), float(angles[1])

    def vehicle_coordinates(self, t: float, x: np.ndarray) -> np.ndarray:
        e_y, de_y, e_psi, de_psi = x
        if self.options.tyres.model == "linear":
            v_y = de_y - self.v(t) * e_psi
        else:
            v_y = (de_y - self.v(t) * math.sin(e_psi)) / math.cos(e_psi)
        return np.array([e_y, e_psi, v_y, de_psi + self.yaw_rate(t)])

    def lane_coordinates(self, t: float, state: np.ndarray) -> np.ndarray:
        e_y, e_psi, v_y, omega = state[:4]
        return np.array([e_y, self.lateral_rate(t, e_psi, v_y), e_psi, omega - self.yaw_rate(t)])

    def lateral_rate(self, t: float, e_psi: float, v_y: float) -> float:
        if self.options.tyres.model == "linear":
            return v_y + self.v(t) * e_psi
        return v_y * math.cos(e_psi) + self.v(t) * math.sin(e_psi)

    def angle(self, t: float, state: np.ndarray) -> float:
        """Steering angle of the wheels."""
        return state[4]

    def forces(self, t: float, state: np.ndarray) -> tuple[float, float]:
        """Lateral force of the front axle along the vehicle's y, and of the rear axle."""
        _, _, v_y, omega = state[:4]
        p, v, delta = self.true, self.v(t), self.angle(t, state)
        if self.options.tyres.model == "linear":
            return (2 * p.C_af * (delta - (v_y + p.l_f * omega) / v), -2 * p.C_ar * (v_y - p.l_r * omega) / v)
        alpha_f = delta - math.atan2(v_y + p.l_f * omega, v)
        alpha_r = -math.atan2(v_y - p.l_r * omega, v)
        wheelbase, shape = p.l_f + p.l_r, self.options.tyres.shape
        peak_f = p.mu * p.m * G * p.l_r / wheelbase  # both wheels of the axle
        peak_r = p.mu * p.m * G * p.l_f / wheelbase
        F_f = peak_f * math.sin(shape * math.atan(2 * p.C_af / (shape * peak_f) * alpha_f))
        F_r = peak_r * math.sin(shape * math.atan(2 * p.C_ar / (shape * peak_r) * alpha_r))
        return F_f * math.cos(delta), F_r

    def a_y(self, t: float, state: np.ndarray) -> float:
        return sum(self.forces(t, state)) / self.true.m + self._slip_of_the_print(t, state)

    def _slip_of_the_print(self, t: float, state: np.ndarray) -> float:
        if not (self.true.as_printed and self.options.tyres.model == "linear"):
            return 0.0
        p = self.true
        return -4 * p.C_ar * p.l_r / (p.m * self.v(t)) * (state[3] - self.yaw_rate(t))

    def derivative(self, t: float, state: np.ndarray, inside: bool, wheel: Callable[[float], float]) -> np.ndarray:
        state = state.tolist()  # ten times as fast as numbers out of an array
        _, e_psi, v_y, omega, delta = state[:5]
        F_f, F_r = self.forces(t, state)
        a_y = (F_f + F_r) / self.true.m + self._slip_of_the_print(t, state)
        de_y = self.lateral_rate(t, e_psi, v_y)
        # the lane's yaw acceleration is left out of e_psi'' = omega' - psi_l'', so it is put into omega'
        d_omega = (self.true.l_f * F_f - self.true.l_r * F_r) / self.true.I_z + self.yaw_acceleration(t, inside)
        return np.array([de_y, omega - self.yaw_rate(t), a_y - self.v(t) * omega, d_omega, wheel(delta)])

    # time

    def run(self) -> None:
        steps = self.full + self.more + (self.rest > 0)
        for k in range(steps):
            t = self.t_s + k * self.dt
            x = self.lane_coordinates(t, self.state)
            self._command(k, t, x)
            arrived = self._switches(k)
            before = self.state.copy()
            self._advance_wheel_at_once(arrived[0][1])
            self._node(t, before, self.state)
            self._row(t)
            end = t + self.dt if k < self.full + self.more else self.path.T + self.more * self.dt
            times = [*(t + late for late, _ in arrived), end]
            for (_, u), low, high in zip(arrived, times[:-1], times[1:], strict=True):
                if low < end:
                    self._advance_wheel_at_once(u)
                    for a, b in self._split_at_T(low, min(high, end)):
                        self._drive(a, b, u)
        self._node(self.pieces[-1].end, self.state, self.state)
        self._row(self.pieces[-1].end)

    def _split_at_T(self, low: float, high: float) -> Iterator[tuple[float, float]]:
        T = self.path.T
        if low + 1e-12 < T < high - 1e-12:
            yield low, T
            yield T, high
        elif abs(high - T) <= 1e-12:
            yield low, T
        elif abs(low - T) <= 1e-12:
            yield T, high
        else:
            yield low, high

    def _command(self, k: int, t: float, x: np.ndarray) -> None:
        number = self.camera.latest(k)
        frame = self._frame(number)
        seen = np.array([frame[0], x[1], frame[1], x[3]])
        self.wheels.append(self.angle(t, self.state))
        wheels = np.interp(np.array([k - 1, k]) - self.age / self.dt, range(k + 1), self.wheels)
        if self.filter is not None:
            if k > 0:
                ends = [t - self.dt - self.age, t - self.age]
                self.filter.predict(wheels[0], self._arriving(k - 1, self.known_delay), *map(self.yaw_rate_seen, ends))
            if k == 0 or number > self.camera.latest(k - 1):
                self.filter.correct(frame)
            seen = self.filter.z
        self.seen.append(self.path.side * seen)
        command = self.law(
            seen, lambda ahead: self.yaw_rate_seen(t + ahead), lambda ahead: self.heading_seen(t, ahead),
            self._commanded(k - 1), [self._commanded(k - 2 - j) for j in range(8)], wheels[1],
        )  # fmt: skip
        self.commands.append(float(command))

    def _frame(self, number: int) -> np.ndarray:
        """e_y and e_psi as the camera sends them."""
        t, s = self.t_s + float(number * self.camera.p), self.options.sensors
        if number <= 0:
            true = self.path.e_y(t), self.attitude(t)[0]
        else:
            piece = next(piece for piece in self.pieces if t <= piece.end + 1e-12)
            true = piece.e_y(t), piece.e_psi(t)
        drawn = self.path.side * self.noise.get(number, np.zeros(2))
        exact = true + drawn * [s.e_y_noise, s.e_psi_noise] + [s.e_y_bias, s.e_psi_bias]
        frame = np.array([rounded(exact[0], s.e_y_step), rounded(exact[1], s.e_psi_step)])
        for off, step in zip(np.abs(exact - frame), (s.e_y_step, s.e_psi_step), strict=True):
            self.margin = min(self.margin, 0.5 - off / step if step > 0 else math.inf)
        return frame

    def _switches(self, k: int) -> list[tuple[float, float]]:
        """(time after the sample, delayed and limited command from there on) in step k."""
        limit = self.options.actuator.delta_max or math.inf
        arriving = self._arriving(k, self.options.actuator.delay)
        # the angle at the trigger is not limited
        return [(late, u if u == self.delta_0 else min(max(u, -limit), limit)) for late, u in arriving]

    def _arriving(self, k: int, delay: float) -> list[tuple[float, float]]:
        """(time after the sample, delayed command from there on) in step k."""
        whole = math.floor(delay / self.dt + 1e-9)
        late = delay - whole * self.dt
        if late < 1e-12:
            return [(0.0, self._commanded(k - whole))]
        return [(0.0, self._commanded(k - whole - 1)), (late, self._commanded(k - whole))]

    def _commanded(self, number: int) -> float:
        return self.delta_0 if number < 0 else self.commands[number]

    def _advance_wheel_at_once(self, u: float) -> None:
        if self.options.actuator.lag == 0 and self.options.actuator.rate_max is None:
            self.state[4] = u

    def _drive(self, low: float, high: float, u: float) -> None:
        """From `low` to `high` under one delayed command, phase by phase of the actuator."""
        inside = high <= self.path.T
        for end, wheel in phases(self.options.actuator, self.state[4], u, low, high):
            solution = solve_ivp(
                self.derivative, (low, end), self.state, args=(inside, wheel), method="DOP853",
                rtol=self.rtol, atol=0.1 * self.rtol, dense_output=True,
                max_step=max((end - low) / 2, 1e-9) if self.rtol < 1e-12 else math.inf,
            )  # fmt: skip
            assert solution.success
            sol = solution.sol
            self.pieces.append(
                Piece(low, end, lambda t, s=sol: s(t)[0], lambda t, s=sol: s(t)[1], lambda t, s=sol: s(t)[4])
            )
            self.state = solution.y[:, -1].copy()
            low = end
            if abs(self.state[0]) > BOUND or (self.options.tyres.model != "linear" and abs(self.state[1]) > SPUN):
                raise LostError
        if high == self.path.T:
            self.x_T = self.path.side * self.lane_coordinates(high, self.state)
            self.own_T = self.a_y(high, self.state) - self.v(high) * self.yaw_rate(high)
            at_a_sample = self.rest == 0 or self.t_s + len(self.commands) * self.dt - high < 1e-12
            last = self.more == 0
            if not (at_a_sample or last):
                self._row(high)

    def _row(self, t: float) -> None:
        self.rows_t.append(t)
        self.rows_x.append(self.path.side * self.lane_coordinates(t, self.state))
        self.rows_delta.append(self.path.side * self.angle(t, self.state))
        self.rows_a_y.append(self.path.side * self.a_y(t, self.state))

    def _node(self, t: float, before: np.ndarray, after: np.ndarray) -> None:
        self.nodes.append((t, self.a_y(t, before), self.a_y(t, after), self.angle(t, after)))
        lane = self.v(t) * self.yaw_rate(t)
        self.own.append((self.path.side * (self.nodes[-1][1] - lane), self.path.side * (self.nodes[-1][2] - lane)))


def phases(
    actuator: Actuator, delta: float, u: float, low: float, high: float
) -> Iterator[tuple[float, Callable[[float], float]]]:
    """(end, d delta/dt as a function of delta) of each phase of the wheel on its way to u."""
    rate, lag = actuator.rate_max, actuator.lag
    way = u - delta
    if rate is None and lag == 0:
        yield high, lambda delta: 0.0
        return
    if rate is not None and abs(way) > rate * lag:
        speed = math.copysign(rate, way)
        end = low + (abs(way) - rate * lag) / rate
        yield min(end, high), lambda delta: speed
        if end >= high:
            return
    if lag == 0:
        yield high, lambda delta: 0.0
    else:
        yield high, lambda delta: (u - delta) / lag


class _Camera:
    """Frames every p from the trigger on, seen d later, in exact fractions of a second; `age` is what they are then."""

    def __init__(self, sensors: Sensors, dt: float) -> None:
        period, self.d, self.dt = (Fraction(t).limit_denominator(10**6) for t in (sensors.period, sensors.delay, dt))
        self.p = period or self.dt
        self.samples = max(round(self.p / self.dt), 1)
        first_seen = [k for k in range(1, 601) if self.latest(k) > self.latest(k - 1)]
        self.age = float(sum(k * self.dt - self.latest(k) * self.p for k in first_seen) / len(first_seen))

    def latest(self, k: int) -> int:
        return math.floor((k * self.dt - self.d) / self.p)


def rounded(value: float, step: float) -> float:
    return step * round(value / step) if step > 0 else value


class _Filter:
    def __init__(
        self, vehicle: Vehicle, v: float, dt: float, p: int, kalman: KalmanFilter, z: np.ndarray, lag: float
    ) -> None:
        A, B, E = vehicle.matrices(v)
        M = np.zeros((8, 8))  # x, wheel, r, slope of r, command
        M[:4, :4], M[:4, 4 if lag else 7], M[:4, 5], M[5, 6] = A, B, E, 1.0
        if lag:
            M[4, 4], M[4, 7] = -1.0 / lag, 1.0 / lag
        self.dt, self.z, self.over = dt, z, functools.cache(lambda s: expm(s * M))
        self.gain = stationary_gain(expm(dt * A), dt, p, kalman)

    def predict(self, wheel: float, arriving: list[tuple[float, float]], r_0: float, r_1: float) -> None:
        s = np.array([*self.z, wheel, r_0, (r_1 - r_0) / self.dt, 0.0])
        ends = [*(late for late, _ in arriving[1:]), self.dt]
        for (late, s[7]), end in zip(arriving, ends, strict=True):
            s = self.over(end - late) @ s
        self.z = s[:4]

    def correct(self, frame: np.ndarray) -> None:
        self.z = self.z + self.gain @ (frame - self.z[[0, 2]])


def stationary_gain(A: np.ndarray, dt: float, p: int, kalman: KalmanFilter) -> np.ndarray:
    """Where the gain settles when the filter's covariance is run frame by frame."""
    C = np.eye(4)[[0, 2]]
    Q = dt * np.diag([0.0, kalman.q_y**2, 0.0, kalman.q_psi**2])
    R = np.diag([kalman.r_y**2, kalman.r_psi**2])
    P = np.diag([1.0, 1.0, 0.1, 0.1])
    gain, change = np.zeros((4, 2)), math.inf
    for _ in range(5000):
        following = P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
        change, gain = np.abs(following - gain).max(), following
        if change < 1e-14:
            return gain
        J = np.eye(4) - gain @ C
        P = J @ P @ J.T + gain @ R @ gain.T
        for _ in range(p):
            P = A @ P @ A.T + Q
    assert change < 1e-12, "the filter's covariance did not settle"
    return gain


# integrals and extremes by brute force

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)


def gauss(f: Callable[[Times], Times], low: float, high: float) -> float:
    half = 0.5 * (high - low)
    return half * float(_WEIGHTS @ f(half * _NODES + 0.5 * (low + high)))


def absolute_area(pieces: list[Piece]) -> float:
    """Integral of |e_y|, every change of sign located."""
    total = 0.0
    for piece in pieces:
        grid = np.linspace(piece.start, piece.end, 41)
        e = piece.e_y(grid)
        roots = [brentq(piece.e_y, grid[i], grid[i + 1], xtol=1e-15) for i in np.flatnonzero(e[:-1] * e[1:] < 0)]
        edges = [piece.start, *roots, piece.end]
        total += sum(abs(gauss(piece.e_y, low, high)) for low, high in itertools.pairwise(edges))
    return total


def largest(pieces: list[Piece], f: Callable[[Piece, Times], Times]) -> float:
    """Largest value of a function over the pieces, ends included: a fine grid, and a search where it is nearly best."""
    grids = [np.linspace(piece.start, piece.end, 41 if piece.end - piece.start < 0.2 else 401) for piece in pieces]
    values = [f(piece, grid) for piece, grid in zip(pieces, grids, strict=True)]
    best = highest = max(float(value.max()) for value in values)
    for piece, grid, value in zip(pieces, grids, values, strict=True):
        i = int(np.argmax(value))
        bounds = grid[max(i - 1, 0)], grid[min(i + 1, grid.size - 1)]
        if value[i] > highest - 1e-3 and bounds[1] > bounds[0]:
            inner = minimize_scalar(
                lambda t, p=piece: -f(p, t), bounds=bounds, method="bounded", options={"xatol": 1e-9}
            )
            best = max(best, -float(inner.fun))
    return best


def _edge(path: Path) -> Callable[[Piece, Times], Times]:
    return lambda piece, t: path.side * piece.e_y(t) - OFFSET


def _front(path: Path, vehicle: Vehicle) -> Callable[[Piece, Times], Times]:
    return lambda piece, t: path.side * (piece.e_y(t) + vehicle.l_f * piece.e_psi(t)) - OFFSET


def _first_inside(path: Path, pieces: list[Piece]) -> float:
    edge = _edge(path)
    for piece in pieces:
        grid = np.linspace(piece.start, piece.end, 41)
        inside = edge(piece, grid) <= 0
        if inside.any():
            i = int(np.argmax(inside))
            if i == 0:
                return float(grid[0])
            return float(brentq(lambda t, p=piece: edge(p, t), grid[i - 1], grid[i], xtol=1e-15))
    return math.inf


def _metrics(path: Path, departure: list[Piece], loop: _Loop) -> dict[str, float]:
    t, a_before, a_after, delta = (np.array(column) for column in zip(*loop.nodes, strict=True))
    own = np.array(loop.own).T

    def recorded(s: np.ndarray, left: bool) -> np.ndarray:
        return np.where(s <= path.T + 1e-9 if left else s < path.T - 1e-9, path.ddy(s), 0.0)

    changes = [
        np.abs(_change(t, *own, left, recorded)) - np.abs(recorded(t, left) - recorded(t - JERK_WINDOW, left))
        for left in (True, False)
    ]
    added = [*(np.abs(own[0]) - np.abs(recorded(t, True)))[1:], *(np.abs(own[1]) - np.abs(recorded(t, False)))]
    change = np.abs(np.diff(delta, prepend=loop.delta_0))
    effort = sum(gauss(lambda t, p=piece: p.delta(t) ** 2, piece.start, piece.end) for piece in loop.pieces)
    # the wheel is monotone within a piece, and jumps between pieces at most
    angles = np.array([piece.delta(s) for piece in loop.pieces for s in (piece.start, piece.end)])
    return {
        "deepest": largest(departure, _edge(path)),
        "dtle": -largest(departure, _front(path, loop.true)),
        "t_back": _first_inside(path, loop.pieces),
        "opposite_crossing": max(0.0, largest(loop.pieces, lambda piece, t: -path.side * piece.e_y(t) - OFFSET)),
        # the limit from before t_s is before the window
        "a_y_peak": float(np.abs([*a_before[1:], *a_after]).max()),
        "jerk_peak": max(float(np.abs(_change(t, a_before, a_after, left)).max()) for left in (True, False))
        / JERK_WINDOW,
        "a_y_added_peak": max(0.0, abs(loop.own_T), *added),
        "jerk_added_peak": max(0.0, *changes[0], *changes[1]) / JERK_WINDOW,
        "delta_peak": float(np.abs(angles).max()),
        "delta_rate_peak": float(change.max()) / loop.dt,
        "effort": effort,
        "travel": float(np.abs(np.diff(angles, prepend=loop.delta_0)).sum()),
    }


def _change(
    t: np.ndarray, before: np.ndarray, after: np.ndarray, left: bool,
    recorded: Callable[[np.ndarray, bool], np.ndarray] | None = None,
) -> np.ndarray:  # fmt: skip
    """Change over half a second before each time, of what is linear between samples and jumps at them. Before the first
    it is constant, or as recorded."""

    def at(s: float) -> float:
        if s < t[0] - 1e-9 or (left and s < t[0] + 1e-9):
            return float(before[0] if recorded is None else recorded(np.array(s), left))
        k = int(np.argmin(np.abs(t - s)))
        if abs(t[k] - s) < 1e-9:
            return float(before[k] if left else after[k])
        k = int(np.searchsorted(t, s)) - 1
        share = (s - t[k]) / (t[k + 1] - t[k])
        return float((1 - share) * after[k] + share * before[k + 1])

    return (before if left else after) - np.array([at(s) for s in t - JERK_WINDOW])


def _never_triggered(path: Path, recorded: list[Piece], S: float, vehicle: Vehicle) -> Drive:
    nothing = np.full(4, np.nan)
    none = np.zeros(0)
    calm = ("opposite_crossing", "a_y_peak", "jerk_peak", "a_y_added_peak", "jerk_added_peak", "delta_peak")
    calm += ("delta_rate_peak", "effort", "travel")
    metrics = {
        "deepest": largest(recorded, _edge(path)), "dtle": -largest(recorded, _front(path, vehicle)), "t_back": path.T,
        **dict.fromkeys(calm, 0.0),
    }  # fmt: skip
    return Drive(math.inf, S, S, nothing, nothing, none, np.zeros((0, 4)), none, none, none, none, metrics)
