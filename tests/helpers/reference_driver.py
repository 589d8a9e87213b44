"""An independent closed loop with a driver at the wheel, for tests: the plant of `reference_loop`, and on its wheels
the steering column, the driver's arms, and the assist, integrated by scipy with them.

The wheel's angle is no longer what the actuator makes of the command: that is only where the assist's position loop
wants it. What the driver means to steer comes from an inverse of the plant along the recorded path: the yaw motion is
integrated with e_y, e_y' and e_y'' imposed, the front force follows from the balance of lateral forces, and the
steering angle from inverting the tyre. Like the rest it runs in the road frame; q and the torques that come out are
outward."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from helpers.reference_loop import G, Law, Path, Piece, Vehicle, _Loop, absolute_area, phases
from ldctoolkit import AssistState
from ldctoolkit.paths.uncorrected import RandomStream, uniforms
from ldctoolkit.plant_options import Driver, PlantOptions

NEUROMUSCULAR = 0.1  # time constant of q [s]
RELAXED, RELAXING = 0.05, 0.3  # share of the arms that is left, and how long it takes [s]
FELT = 1.0  # torque against the assist that counts [N m]
MOST_RETURNING = 2.0  # acceleration of a driver who corrects [m/s^2]
STEP = 1e-3  # of the splines through what the driver means [s]


@dataclasses.dataclass(frozen=True)
class Person:
    """The driver of one departure; `share` is that of the arms in the stiffness, `stiffness` theirs."""

    intent: str
    share: float = 0.0
    stiffness: float = 0.0
    reaction: float = 0.0
    across: float = 0.0
    frequency: float = 0.0

    @classmethod
    def drawn(cls, driver: Driver, seed: int, index: np.ndarray, i: int) -> Person:
        """That of scenario i."""
        u = uniforms(seed, index, RandomStream.DRIVER, 5)[i]
        shares = {name: getattr(driver, name) for name in ("recorded", "straight", "follows", "against", "returns")}
        intent = next(name for name, end in zip(shares, np.cumsum([*shares.values()]), strict=True) if u[0] < end)
        ranges = (driver.grip, driver.stiffness, driver.reaction, driver.across, driver.frequency)
        numbers = [low + (high - low) * part for (low, high), part in zip(ranges, u[[1, 1, 2, 3, 4]], strict=True)]
        return cls(intent, *numbers)


@dataclasses.dataclass(frozen=True)
class Driven:
    """What came out, outward; rows of `x` are (e_y, de_y/dt, e_psi, de_psi/dt), those of `torque` hold that of driver
    and assist just before and just after each sample (k, 2, 2)."""

    S: float
    T: float
    t: np.ndarray
    x: np.ndarray
    delta: np.ndarray
    torque: np.ndarray
    states: list[AssistState]
    authority: np.ndarray
    metrics: dict[str, float]
    margin: float
    """How close a torque at a sample came to the threshold of the override, as a share of it."""
    saturated: float
    """How long the assist was at its limit [s]."""


class _Column(_Loop):
    """The closed loop with two more states: z, or the angle of the steering wheel and its rate."""

    def __init__(self, person: Person, ratio: float, *rest: Any) -> None:
        super().__init__(*rest)
        self.driver, self.person, self.ratio = self.options.driver, person, ratio
        self.arms = self.driver.model == "arms"
        self.state = np.array([*self.state, ratio * self.delta_0 if self.arms else 0.0, 0.0])
        self.assist, self.beyond, self.below, self.was_overridden = AssistState.ACTIVE, 0, 0, False
        self.closeness = math.inf
        self.authority_0 = self.authority_1 = 1.0
        self.k, self.t_k, self.q_k, self.q_target = 0, self.t_s, 0.0, 0.0
        self.handovers: list[float] = []
        self.rows_torque: list[tuple[tuple[float, float], tuple[float, float]]] = []
        self.dense: list[tuple[np.ndarray, ...]] = []  # times, torques of driver and assist, de_y/dt, at the limit
        self.rows_state: list[AssistState] = []
        self.rows_authority: list[float] = []
        self.inside = True  # before T
        self.at_t, self.then = math.nan, (0.0, 0.0, 0.0)  # what was meant last, and when
        p, v = self.true, self.v_s
        L = p.l_f + p.l_r
        # bicycle model: delta = L kappa + K a_y, kappa = a_y/v^2
        self.gain = L / v**2 + p.m * (p.l_r * p.C_ar - p.l_f * p.C_af) / (2 * p.C_af * p.C_ar * L)
        self._invert()

    # what the driver means

    def _along(self, t: float, attitude: np.ndarray, inside: bool) -> tuple[float, float, float]:
        """(e_psi'', steering angle, force of the front tyres) with which the recorded path is driven."""
        path, p, tyres, (e_psi, d_e_psi) = self.path, self.true, self.options.tyres, attitude.tolist()
        v, omega = self.v(t), d_e_psi + self.yaw_rate(t)
        rate, bend = (path.side * value for value in self.recorded_motion(t, inside))
        dv = self.dv(t, inside)
        if tyres.model == "linear":
            v_y = rate - v * e_psi
            d_v_y = bend - dv * e_psi - v * d_e_psi
            rear = -2 * p.C_ar * (v_y - p.l_r * omega) / v
            front = p.m * (d_v_y + v * omega) - rear
            delta, force = front / (2 * p.C_af) + (v_y + p.l_f * omega) / v, front
        else:
            sine, cosine = math.sin(e_psi), math.cos(e_psi)
            v_y = (rate - v * sine) / cosine
            d_v_y = (bend - (dv - v_y * d_e_psi) * sine) / cosine - v * d_e_psi
            load_f, load_r = (p.mu * p.m * G * arm / (p.l_f + p.l_r) for arm in (p.l_r, p.l_f))
            slip = -math.atan2(v_y - p.l_r * omega, v)
            rear = load_r * math.sin(tyres.shape * math.atan(2 * p.C_ar / (tyres.shape * load_r) * slip))
            front = p.m * (d_v_y + v * omega) - rear
            delta = 0.0
            for _ in range(60):
                share = min(max(front / math.cos(delta) / load_f, -1.0), 1.0)
                slip = math.tan(math.asin(share) / tyres.shape) * tyres.shape * load_f / (2 * p.C_af)
                before, delta = delta, slip + math.atan2(v_y + p.l_f * omega, v)
                if abs(delta - before) < 1e-16:
                    break
            force = share * load_f
            front = force * math.cos(delta)
        return (p.l_f * front - p.l_r * rear) / p.I_z, delta, force

    def _invert(self) -> None:
        """Steering angle and front force over time, before and after T."""
        T, end = self.path.T, self.path.T + max(self.more, 1) * self.dt
        attitude = np.array([self.state[1], self.state[3] - self.yaw_rate(self.t_s)])
        self.meant: list[CubicSpline] = []
        for low, high, inside in ((self.t_s, T, True), (T, end, False)):
            found = solve_ivp(
                lambda t, x, inside=inside: [x[1], self._along(t, x, inside)[0]], (low, high), attitude,
                method="DOP853", rtol=1e-12, atol=1e-14, dense_output=True, max_step=0.02,
            )  # fmt: skip
            assert found.success
            attitude = found.y[:, -1]
            times = np.linspace(low, high, max(math.ceil((high - low) / STEP), 8) + 1)
            self.meant.append(CubicSpline(times, [self._along(float(t), found.sol(t), inside)[1:] for t in times]))
        self.F_0 = float(self.meant[0](self.t_s)[1])

    def recorded_motion(self, t: float, inside: bool) -> tuple[float, float]:
        """y' and y'' of the recorded path, outward; after T the second fades, at first with the slope that it had."""
        path = self.path
        if inside:
            return float(path.dy(t)), float(path.ddy(t))
        tau, T, s = 0.2, path.T, t - path.T
        rate, bend, left = float(path.dy(T)), float(path.ddy(T)), math.exp(-s / tau)
        b = bend / tau + (bend - float(path.ddy(T - 1e-4))) / 1e-4
        return rate + tau * (bend + b * tau) * (1.0 - left) - tau * b * s * left, (bend + b * s) * left

    def _intend(self, k: int, t: float, x: np.ndarray) -> None:
        """q at the sample, and where it goes during it."""
        self.q_k = self.q(t) if k > 0 else 0.0
        self.t_k, self.k, intent = t, k, self.person.intent
        self.q_target, bend = 0.0, self.recorded_motion(t, t <= self.path.T)[1]
        if intent == "against":
            self.q_target = self.person.across * (k * self.dt < 1.0 - 1e-9) - bend
        elif intent == "returns" and k * self.dt >= self.person.reaction - 1e-9:
            w = self.person.frequency
            e_y, rate = self.path.side * x[:2]
            wanted = -(w**2 * e_y + 2 * self.driver.return_damping * w * rate)
            self.q_target = min(max(wanted, -MOST_RETURNING), MOST_RETURNING) - bend

    def q(self, t: float) -> float:
        return self.q_target + (self.q_k - self.q_target) * math.exp(-(t - self.t_k) / NEUROMUSCULAR)

    def intended(self, t: float) -> tuple[float, float, float]:
        """(steering angle, its rate, front force) that the driver means."""
        if self.person.intent == "straight":
            return self.delta_0, 0.0, self.F_0
        if t is not self.at_t:
            self.at_t, self.then = t, self._intended(t)
        return self.then

    def _intended(self, t: float) -> tuple[float, float, float]:
        spline = self.meant[0 if self.inside else 1]
        (delta, force), rate, q = spline(t), spline(t, 1)[0], self.path.side * self.q(t)
        d_q = (self.path.side * self.q_target - q) / NEUROMUSCULAR
        share = self.true.l_r / (self.true.l_f + self.true.l_r)
        return delta + self.gain * q, rate + self.gain * d_q, force + self.true.m * share * q

    def strength(self, t: float) -> float:
        """s, like the authority along a straight line from sample to sample."""
        if self.person.intent != "follows":
            return 1.0
        gone = (self.k * self.dt + np.array([0.0, self.dt]) - self.person.reaction) / RELAXING
        now, then = 1.0 - (1.0 - RELAXED) * gone.clip(0.0, 1.0)
        return float(now + (then - now) * (t - self.t_k) / self.dt)

    def authority(self, t: float) -> float:
        return self.authority_0 + (self.authority_1 - self.authority_0) * (t - self.t_k) / self.dt

    # the column

    def angle(self, t: float, state: np.ndarray) -> float:
        if len(state) == 5:  # of the recorded path
            return state[4]
        if self.arms:
            return state[5] / self.ratio
        if self.person.share == 0:
            return state[4]
        return self.intended(t)[0] + state[5]

    def demand(self, t: float, state: np.ndarray) -> float:
        """Torque of the assist with all authority and no limit."""
        d = self.driver
        if self.arms:
            to_go = self.ratio * state[4] - state[5]
            return d.assist_stiffness * to_go - d.assist_damping * state[6] + self.aligning(t, state)
        if self.person.share == 0:
            return 0.0
        return d.assist_stiffness * self.ratio * (state[4] - self.intended(t)[0] - state[5])

    def aligning(self, t: float, state: np.ndarray) -> float:
        angle = self.angle(t, state)
        along = math.cos(angle) if self.options.tyres.model != "linear" else 1.0
        return (1 - self.driver.boost) * self.driver.trail * self.forces(t, state)[0] / along / self.ratio

    def torques(self, t: float, state: np.ndarray) -> tuple[float, float]:
        """Of driver and assist."""
        most, a = self.driver.torque_max, self.authority(t)
        assist = a * min(max(self.demand(t, state), -most), most)
        if not self.arms:
            return -assist, assist
        delta, rate, force = self.intended(t)
        arms = self.person.stiffness * (self.ratio * delta - state[5])
        arms += self.driver.damping * (self.ratio * rate - state[6])
        ahead = (1 - self.driver.boost) * self.driver.trail * force / self.ratio
        return self.strength(t) * arms + (1 - a) * ahead, assist

    def derivative(self, t: float, state: np.ndarray, inside: bool, wheel: Any) -> np.ndarray:
        plant = super().derivative(t, state, inside, wheel)
        if len(state) == 5:
            return plant
        state, d = state.tolist(), self.driver
        if self.arms:
            driver, assist = self.torques(t, state)
            torque = driver + assist - self.aligning(t, state) - d.wheel_damping * state[6]
            return np.array([*plant, state[6], torque / (d.wheel_inertia + d.inertia)])
        g, s = self.person.share, self.strength(t)
        if g == 0:
            return np.array([*plant, 0.0, 0.0])
        # the spring of the assist against spring and damper of the arms, over the stiffness of both
        assist = self.torques(t, state)[1] / (d.assist_stiffness * self.ratio)
        return np.array([*plant, ((1 - g) * assist / (s * g) - state[5]) / d.arm_lag, 0.0])

    # time

    def _command(self, k: int, t: float, x: np.ndarray) -> None:
        before = self.torques(t, self.state) if k > 0 else (0.0, 0.0)
        self.authority_0 = self.authority_1
        self._supervise(abs(before[0]), abs(before[1]))
        moved = self.dt / self.driver.ramp if self.driver.ramp > 0 else 1.0
        rises = self.assist == AssistState.ACTIVE
        super()._command(k, t, x)
        after = self.authority_0 + (moved if rises else -moved)
        self.authority_1 = 0.0 if after < 1e-9 else 1.0 if after > 1.0 - 1e-9 else after
        self._intend(k, t, x)
        self.inside, self.at_t = t < self.path.T - 1e-12, math.nan
        self.rows_torque.append((before, (math.nan, math.nan)))
        self.rows_state.append(self.assist)
        self.rows_authority.append(self.authority_0)

    def _supervise(self, driver: float, assist: float) -> None:
        d = self.driver
        if self.assist != AssistState.OVERRIDDEN:
            self.closeness = min(self.closeness, abs(driver / d.override_torque - 1.0))
        if self.assist == AssistState.ACTIVE:
            self.beyond = self.beyond + 1 if driver > d.override_torque else 0
            if self.beyond > 0 and self.beyond * self.dt >= d.override_time - 1e-9:
                self.assist, self.beyond, self.was_overridden = AssistState.OVERRIDDEN, 0, True
                self.handovers.append(assist)
        if self.assist == AssistState.OVERRIDDEN and self.authority_0 == 0:
            self.assist, self.below = AssistState.RELEASED, 0
        if self.assist == AssistState.RELEASED and d.return_after > 0:
            self.below = 0 if driver > d.override_torque else self.below + 1
            if self.below * self.dt >= d.return_after - 1e-9:
                self.assist, self.beyond = AssistState.ACTIVE, 0

    def _drive(self, low: float, high: float, u: float) -> None:
        inside = self.inside = high <= self.path.T + 1e-12
        self.at_t = math.nan
        for end, wheel in phases(self.options.actuator, self.state[4], u, low, high):
            solution = solve_ivp(
                self.derivative, (low, end), self.state, args=(inside, wheel), method="DOP853",
                rtol=self.rtol, atol=1e-2 * self.rtol, dense_output=True, max_step=max((end - low) / 4, 1e-9),
            )  # fmt: skip
            assert solution.success
            self.pieces.append(self._piece(low, end, solution.sol))
            self.state = solution.y[:, -1].copy()
            low = end
        if abs(high - self.path.T) < 1e-12:
            at_a_sample = self.rest == 0 or self.t_s + len(self.commands) * self.dt - high < 1e-12
            if not at_a_sample and self.more > 0:
                self._row(high)

    def _piece(self, low: float, high: float, sol: Any) -> Piece:
        """What is not smooth over a sample is looked up now: torques, and whether the assist is at its limit."""
        grid = np.linspace(low, high, 33)
        side, most = self.path.side, self.driver.torque_max
        rows = [
            (*self.torques(t, x), self.lateral_rate(t, x[1], x[2]), self.angle(t, x), abs(self.demand(t, x)) >= most)
            for t, x in zip(grid.tolist(), sol(grid).T.tolist(), strict=True)
        ]
        driver, assist, rates, angles, limited = np.array(rows).T
        torques, rates = side * np.column_stack([driver, assist]), side * rates
        delta = CubicSpline(grid, angles) if high > low + 1e-9 else lambda t: np.interp(t, grid, angles)
        piece = Piece(low, high, lambda t: sol(t)[0], lambda t: sol(t)[1], delta)
        self.dense.append((grid, torques, rates, limited))
        if low == self.t_k:
            self.rows_torque[-1] = (self.rows_torque[-1][0], tuple(side * torques[0]))
        return piece

    def driver_metrics(self) -> dict[str, float]:
        t, driver, assist = (np.concatenate(column) for column in zip(
            *((grid, torques[:, 0], torques[:, 1]) for grid, torques, _, _ in self.dense), strict=True
        ))  # fmt: skip
        rates = np.concatenate([rates for _, _, rates, _ in self.dense])
        parallel = np.flatnonzero(rates <= 0)
        first = t[parallel[0]] if parallel.size else math.inf
        if parallel.size and parallel[0] > 0 and rates[parallel[0] - 1] > 0:
            i = parallel[0]
            first = t[i - 1] + (t[i] - t[i - 1]) * rates[i - 1] / (rates[i - 1] - rates[i])
        against = np.where(driver * assist < 0, np.abs(driver), 0.0) - FELT
        total, longest, running = 0.0, 0.0, 0.0
        for i in range(1, t.size):
            a, b, h = against[i - 1], against[i], t[i] - t[i - 1]
            # part of the step that is above zero, and where it lies
            from_, to = 0.0, 1.0
            if a <= 0 and b <= 0:
                from_ = to = 0.0
            elif a <= 0 < b:
                from_ = a / (a - b)
            elif b <= 0 < a:
                to = a / (a - b)
            total += (to - from_) * h
            start, stop = max(t[i - 1] + from_ * h, first), t[i - 1] + to * h
            if h > 0:
                running = (running if a > 0 else 0.0) + max(stop - start, 0.0)
                longest = max(longest, running)
            if b <= 0:
                running = 0.0
        ends = [*self.handovers, abs(assist[-1])] if self.assist == AssistState.ACTIVE else self.handovers
        quick = min(1.0, 0.1 / self.driver.ramp) if self.driver.ramp > 0 else 1.0
        return {
            "driver_torque_peak": float(np.abs(driver).max()),
            "driver_torque_mean": float(np.trapezoid(np.abs(driver), t) / (t[-1] - t[0])),
            "against_time": total,
            "against_parallel": longest,
            "overridden": float(self.was_overridden),
            "handover_step": max(ends, default=0.0) * quick,
        }


def drive(
    path: Path, law: Law, person: Person, *, options: PlantOptions, vehicle: Vehicle | None = None,
    true: Vehicle | None = None, ratio: float = 15.0, y_s: float = 0.2, dt: float = 0.05, settle: float = 0.0,
    curvature_draw: float = 0.0, known: bool = True, rtol: float = 1e-10,
) -> Driven | None:  # fmt: skip
    """Drive one departure; None where it never triggers. What is not said here is as in `reference_loop.drive`."""
    vehicle = Vehicle() if vehicle is None else vehicle
    t_s = path.trigger(y_s)
    if math.isinf(t_s):
        return None
    true = vehicle if true is None else true
    loop = _Column(person, ratio, path, law, options, vehicle, true, t_s, dt, settle, curvature_draw, {}, known, rtol)
    loop.run()
    before = Piece(0.0, t_s, path.e_y, path.course)
    limited = sum(float(np.trapezoid(flags, grid)) for grid, _, _, flags in loop.dense)
    return Driven(
        S=absolute_area([before, *(piece for piece in loop.pieces if piece.end <= path.T + 1e-12)]),
        T=path.T,
        t=np.array(loop.rows_t),
        x=np.array(loop.rows_x),
        delta=np.array(loop.rows_delta),
        torque=path.side * np.array(loop.rows_torque),
        states=loop.rows_state,
        authority=np.array(loop.rows_authority),
        metrics=loop.driver_metrics(),
        margin=loop.closeness,
        saturated=limited,
    )
