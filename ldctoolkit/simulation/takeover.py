"""The moment the controller takes over: trigger time, start state, what was scored before (paper, section IV)."""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import LinearLaw
from ldctoolkit.declared import checked_number, checked_seed
from ldctoolkit.departures import bend_polynomial
from ldctoolkit.metrics import DRIVER_METRICS, JERK_WINDOW, METRIC_UNITS, MetricValues
from ldctoolkit.paths.uncorrected import RandomStream, UncorrectedPath, harmless, normals, uniforms
from ldctoolkit.plant_options import Mismatch, Tyres, whole_multiple
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation.kernel import data
from ldctoolkit.vehicle import Convention, Plant, SteadyState, VehicleParameters, discretize
from ldctoolkit.vehicle.bicycle import GRAVITY, checked_speeds, error_dynamics_matrices, steady_cornering
from ldctoolkit.vehicle.kalman_filter import filter_columns
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE
from ldctoolkit.vehicle.vehicle_model import RecordedTurn, VehicleModel, equations

KeptPaths = tuple[FloatArray, IntArray, IntArray]  # paths of chosen rows, these, and which of them triggered


@dataclasses.dataclass(frozen=True)
class TrueVehicles:
    """The vehicle of each of n scenarios; the axles stand where they do on the nominal one."""

    m: FloatArray  # (n,) [kg] Mass
    I_z: FloatArray  # (n,) [kg m^2] Yaw inertia
    # (n,) [N/rad] Cornering stiffness of one front and one rear tyre
    C_af: FloatArray
    C_ar: FloatArray
    mu: FloatArray  # (n,) Friction coefficient; linear tyres have no use for it
    # [m] Distance from the centre of gravity to the front and rear axle
    l_f: float
    l_r: float

    def matrices(self, v: npt.ArrayLike, convention: Convention) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Continuous-time A (n, 4, 4), B and E (n, 4) of Rajamani's eq. 2.45, each vehicle at its own speed [m/s]."""
        return error_dynamics_matrices(self, checked_speeds(v), convention)

    def columns(self, rows: IntArray | slice) -> TrueVehicles:
        """Chosen vehicles as columns (n, 1), which broadcast against (n, k)."""
        return dataclasses.replace(self, **{name: getattr(self, name)[rows, None] for name in _DRAWN})

    def steady_state(self, v: npt.ArrayLike, convention: Convention) -> SteadyState:
        """Steering angle and heading error that hold a bend on linear tyres, per unit of lane yaw rate."""
        return steady_cornering(*self.matrices(v, convention))

    def turn(self, at: RecordedTurn, tyres: Tyres, convention: Convention, *, steered: bool = True) -> RecordedTurn:
        """With e_psi and steering angle at which e_y'' is the path's and e_psi'' is 0; the angle only if `steered`.

        Where tyres saturate, a turn beyond the friction is that of the largest force.
        """
        v, dv, rate, bend, yaw_error = at.v, at.v_rate, at.e_y_rate, at.e_y_acceleration, at.e_psi_rate
        wheelbase, shape, omega = self.l_f + self.l_r, tyres.shape, at.yaw_rate + yaw_error
        if tyres.ideal:
            # the two force balances of Rajamani's eq. 2.45, for e_y'' that of the path and e_psi'' = 0
            slip_per_a_y = self.m * self.l_f / (2.0 * self.C_ar * wheelbase)  # of the rear axle
            v_y = self.l_r * omega  # of a rear axle without slip
            if convention == "as_printed":
                v_y = v_y - 2.0 * self.l_r * self.l_f / wheelbase * yaw_error
            e_psi = ((rate - v_y) / v + slip_per_a_y * (bend + v * at.yaw_rate)) / (1.0 + slip_per_a_y * dv)
            moment = self.C_af * self.l_f - self.C_ar * self.l_r
            damping = self.C_af * self.l_f**2 + self.C_ar * self.l_r**2
            delta = (damping * omega / v - moment * (e_psi - rate / v)) / (self.C_af * self.l_f)
            return dataclasses.replace(at, e_psi=e_psi, delta=delta)

        def slip(stiffness: FloatArray, arm: float, share: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Slip angle at which an axle uses this share of its friction, and its slope; beyond, of the largest."""
            used = np.clip(share, -1.0, 1.0)
            tangent, rest = np.tan(np.arcsin(used) / shape), 1.0 - used * used
            peak = self.mu * self.m * (GRAVITY * arm / (2.0 * wheelbase)) / stiffness
            slope = peak * (1.0 + tangent * tangent) / np.sqrt(np.where(rest > 0.0, rest, np.inf))
            return shape * peak * tangent, slope

        # without yaw acceleration both axles use the same share, which hardly depends on v_y: Newton's method, from
        # small angles on linear tyres
        across = bend - yaw_error * v - dv * rate / v
        v_y = self.l_r * omega - (v * omega + across) * v * self.m * (self.l_f / (2.0 * wheelbase)) / self.C_ar
        grip = self.mu * GRAVITY
        gap = astray = np.zeros_like(v)
        for step in range(_NEWTON_STEPS + 8 * _ITERATIONS):
            if step == _NEWTON_STEPS:  # close to the friction a few of Newton's steps may go to and fro
                astray = np.where(np.abs(gap) > _ASTRAY, 1.0, 0.0)
                if not astray.any():
                    break
            ahead = np.sqrt(np.maximum(v * v + v_y * v_y - rate * rate, _TINY * v * v))  # along the lane
            squared = ahead * ahead + rate * rate
            sine, cosine = (rate * v - v_y * ahead) / squared, (v * ahead + rate * v_y) / squared  # of e_psi
            across = (bend - dv * sine - yaw_error * ahead) / cosine
            share = (v * omega + across) / grip
            share_slope = (dv * cosine - across * sine - yaw_error * v_y / cosine) / (ahead * grip)
            angle, slope = slip(self.C_ar, self.l_f, share)
            behind = np.tan(angle)
            gap, gap_slope = v_y - self.l_r * omega + v * behind, v * (1.0 + behind * behind) * slope * share_slope
            v_y = v_y - (gap / np.maximum(1.0 + gap_slope, 0.5) if step < _NEWTON_STEPS else astray * gap)
        # where no heading has this lateral speed, across the lane
        e_psi = np.arcsin(np.clip(rate / np.sqrt(v * v + v_y * v_y), -1.0, 1.0)) - np.arctan(v_y / v)
        if not steered:
            return dataclasses.replace(at, e_psi=e_psi)
        delta = along = np.arctan((v_y + self.l_f * omega) / v)
        for _ in range(_ITERATIONS):
            delta = along + slip(self.C_af, self.l_r, share / np.cos(delta))[0]
        return dataclasses.replace(at, e_psi=e_psi, delta=delta)


_NEWTON_STEPS = 4  # To rounding up to 0.95 of the friction
_ASTRAY = 1e-3  # [m/s] of the lateral speed before the last step, beyond which Newton's method has not converged
_TINY = 1e-12  # Share of the squared speed that is left along the lane at least
_ITERATIONS = 8  # Fixed-point steps from the small steering angles to the large ones of saturating tyres
_DRAWN = ("m", "I_z", "C_af", "C_ar", "mu")  # Quantities with a factor, in the order of the random numbers


def true_vehicles(
    parameters: VehicleParameters, mismatch: Mismatch, tyres: Tyres, scenarios: Scenarios, seed: int
) -> TrueVehicles:
    """Draw the true vehicle of every scenario: the nominal one times factors, uniform on their ranges.

    A range (1, 1) leaves the nominal number as it is, to the bit.
    """
    nominal = {name: getattr(parameters, name) for name in _DRAWN[:-1]} | {"mu": tyres.mu}
    if mismatch.ideal:
        checked_seed(seed)
        draws = np.zeros((scenarios.n, len(_DRAWN)))
    else:
        draws = uniforms(seed, scenarios.index, RandomStream.MISMATCH, len(_DRAWN))
    columns = {}
    for j, name in enumerate(_DRAWN):
        low, high = getattr(mismatch, name)
        factor = np.minimum(low + (high - low) * draws[:, j], high)  # rounding must not leave the range
        columns[name] = nominal[name] * factor
    return TrueVehicles(**columns, l_f=parameters.l_f, l_r=parameters.l_r)


BOUND = 20.0
"""|e_y| [m] at which a scenario counts as diverged; from there on the bound itself is scored, so S stays finite."""

_LEAST_GRIP = 1e-9  # Of a driver who holds the wheel at all: less has no numbers
_SHORTEST_STEP = 1e-12  # [s] A shorter remainder is rounding of T - t_s, not a step to be driven
_SPEED_STEP = 1e-4  # [s] Step of the difference quotient of the recorded speed

# Longest substep of the Runge-Kutta method, in units of the fastest time constant; where tyres saturate, the loop takes
# shorter ones by itself
_REACH, _REACH_OF_TYRES = 0.25, 0.3


@dataclasses.dataclass(frozen=True)
class Takeover:
    """The m triggered of n scenarios at their trigger times, in an order that suits the compiled loops."""

    scenarios: Scenarios  # All n
    setup: Setup  # Vehicle, plant, clock and seed
    y_s: float  # [m] Trigger threshold
    valid: BoolArray  # (n,) Scenarios that can be driven at all
    path: UncorrectedPath  # Recorded paths of all n
    rows: IntArray  # (m,) Which scenarios triggered, in the order used by every array of m
    t_s: FloatArray  # (n,) [s] Trigger time, infinite where never triggered
    S_uncorrected: FloatArray  # (n,) [m s] Score of the recorded path over the whole departure; NaN where not valid
    S_before: FloatArray  # (n,) [m s] Its part before the trigger; all of it where never triggered
    driven: UncorrectedPath  # The m rows of `path`
    vehicles: TrueVehicles  # What is driven, m rows
    start: FloatArray  # (m,) [s] Trigger times
    x_0: FloatArray  # (m, 4) Start states
    # (m,) [rad] Steady steering angle of the recorded path at the trigger: the command before the first
    delta_0: FloatArray
    # (m,) Whole steps of dt until the departure ends; descending among scenarios that take as many substeps
    full_steps: IntArray
    rest: FloatArray  # (m,) [s] What remains after them, 0 <= rest < dt
    plant: Plant  # The nominal vehicle at the trigger speeds: what a design is prepared with
    states: FloatArray  # (m, q) Start states of a vehicle model beyond the four; q = 0 without one
    spare: threading.local = dataclasses.field(default_factory=threading.local, repr=False, compare=False)

    @property
    def m(self) -> int:
        """Number of triggered scenarios."""
        return int(self.rows.shape[0])

    @property
    def triggered(self) -> Scenarios:
        """The m scenarios that are driven."""
        return self.driven.scenarios

    @functools.cached_property
    def setting(self) -> FloatArray:
        """Numbers of a run as the compiled loops read them, see `kernel.data`; as all that follows built once."""
        modes = self.driven.modes_v.shape[1]
        return data.setting_row(self.setup, self.plant, modes=modes, bound=BOUND, window=JERK_WINDOW)

    @functools.cached_property
    def scene(self) -> FloatArray:
        """Numbers of the driven scenarios as the compiled loops read them, (m, c), see `kernel.data`."""
        return _scene(self)

    @functools.cached_property
    def exact(self) -> FloatArray:
        """The ideal plant over a whole step, and over both parts of the one that T cuts, (3, m, `data.EXACT`)."""
        dt, matrices = self.setup.dt, self.vehicles.matrices(self.plant.v, self.setup.convention)
        whole = self.plant.step if self.setup.options.mismatch.ideal else discretize(*matrices, dt)
        steps = whole, discretize(*matrices, self.rest), discretize(*matrices, dt - self.rest)
        inputs = ((s.B, s.E_0, s.E_1, s.area_x, s.area_delta, s.area_r_0, s.area_r_1) for s in steps)
        states = (step.A[:, :, 1:].reshape(-1, 12) for step in steps)
        return np.stack([np.column_stack([A, *columns]) for A, columns in zip(states, inputs, strict=True)])

    def scratch(self, size: int, use: str = "laws") -> FloatArray:
        """At least `size` numbers that one thread may use again and again: fresh memory costs more than filling it."""
        array: FloatArray | None = getattr(self.spare, use, None)
        if array is None or array.size < size:
            array = np.empty(size)
            setattr(self.spare, use, array)
        return array

    @functools.cached_property
    def recorded_bend(self) -> FloatArray:
        """Unless it is a parabola, y'' of the recorded path at the samples to T and a jerk window before, (m, k, 2)."""
        if not (self.driven.modes_y.size or self.driven.modes_v.size or self.scenarios.drift is not None):
            return np.zeros((0, 0, 2))
        samples = np.arange(self.full_steps.max() + math.ceil(JERK_WINDOW / self.setup.dt) + 2)
        t = self.start[:, None] + self.setup.dt * samples
        return np.stack([self.driven.lateral_acceleration(t - back) for back in (0.0, JERK_WINDOW)], axis=-1)

    @functools.cached_property
    def recorded_steering(self) -> FloatArray:
        """With a driver, and unless it is a parabola: y' and y'' of the path meant at half samples, (m, k, 2)."""
        path = _meant(self.driven, self.setup)
        if not (path.modes_v.size or self.scenarios.drift is not None) or not self.setup.options.driver.holds:
            return np.zeros((0, 0, 2))
        half, T = 0.5 * self.setup.dt, self.triggered.T[:, None]
        lag, tail = data.STRAIGHTENS_IN, math.ceil(60.0 * data.STRAIGHTENS_IN / half)
        t = self.start[:, None] + half * np.arange(2 * (self.full_steps.max() + 2) + tail)
        inside = np.minimum(t, T)
        bend, after, fallen = path.lateral_acceleration(inside), t - inside, np.exp((inside - t) / lag)
        slope = (bend - path.lateral_acceleration(inside - _SPEED_STEP)) / _SPEED_STEP
        steep = np.where(after > 0.0, bend / lag + slope, 0.0)  # as in `kernel.driver`
        fading = lag * ((bend + lag * steep) * (1.0 - fallen) - steep * after * fallen)
        rate = path.lateral_rate(inside) + np.where(after > 0.0, fading, 0.0)
        return np.stack([rate, (bend + steep * after) * fallen], axis=-1)

    @functools.cached_property
    def stiff(self) -> int:
        """Leading rows that take Runge-Kutta steps: all but on the ideal plant, where a step hides what is fast."""
        options = self.setup.options
        if not (options.drives_exactly and options.sensors.ideal) or self.setup.vehicle_model is not None:
            return self.m
        return int((_substeps(self.setup, self.plant.v) > data.STIFF).sum())

    def empty_paths(
        self, rows: IntArray | None, *, reused: bool = False
    ) -> tuple[FloatArray, IntArray, KeptPaths | None]:
        """An array for the paths of chosen scenarios (c, entries, columns), its row of each driven scenario (m,) or -1,
        and the array with `rows` and the positions in these that triggered. It may be `reused` for the next design.
        """
        path_row = np.full(self.m, -1, dtype=np.int64)
        if rows is None:
            return np.zeros((0, 0, data.PATH)), path_row, None
        driven_row = np.full(self.scenarios.n, -1, dtype=np.int64)
        driven_row[self.rows] = np.arange(self.m)
        triggered = np.flatnonzero(driven_row[rows] >= 0)
        with_path = driven_row[rows[triggered]]
        path_row[with_path] = np.arange(with_path.size)
        longest = int(self.scene[with_path, data.STEPS].max(initial=0)) + 2
        shape = with_path.size, longest, data.PATH
        paths = (
            self.scratch(math.prod(shape), "paths")[: math.prod(shape)].reshape(shape) if reused else np.empty(shape)
        )
        paths.fill(np.nan)
        return paths, path_row, (paths, rows, triggered)

    @property
    def steps(self) -> IntArray:
        """Steps to the end of the settling horizon, a last shorter one of the departure included, (m,)."""
        settle = math.ceil(whole_multiple(self.setup.settle, self.setup.dt) / self.setup.dt - 1e-9)
        return self.full_steps + settle + (self.rest > 0.0)

    @property
    def driven_for(self) -> FloatArray:
        """Time from the trigger to the end of the settling horizon, (m,) [s]."""
        return self.setup.dt * (self.steps - (self.rest > 0.0)) + self.rest

    @functools.cached_property
    def recorded(self) -> MetricValues:
        """Metrics of the recorded path, arrays of n; NaN where not valid, 0 for what only a system can cause."""
        T = self.path.scenarios.T
        measured = {
            "deepest": self.path.deepest(T),
            "dtle": -_front_deepest(self.path, self.every_vehicle, self.setup, T),
            "t_back": self.path.back,
        }
        columns = {name: measured.get(name, np.zeros(T.size)) for name in METRIC_UNITS}
        if self.setup.options.driver.ideal:
            columns |= dict.fromkeys(DRIVER_METRICS, np.full(T.size, np.nan))
        return MetricValues(**{name: np.where(self.valid, column, np.nan) for name, column in columns.items()})

    def recorded_motion(self, t: FloatArray, rows: IntArray | slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """State (n, k, 4) and steering angle (n, k) of recorded paths in their steady turns at times t (n, k)."""
        return _state(self.path.take(rows), self.every_vehicle.columns(rows), _steady(self.setup), t)

    @functools.cached_property
    def turn(self) -> RecordedTurn:
        """The recorded paths at their triggers, with attitude and steering angle as they are taken over."""
        turn = _turn(self.driven, self.vehicles, self.setup, self.start, self.setup.vehicle.edge_offset)
        return dataclasses.replace(turn, e_psi=self.x_0[:, 2], e_psi_rate=self.x_0[:, 3], delta=self.delta_0)

    @functools.cached_property
    def deepest_before(self) -> FloatArray:
        """Deepest position of the edge before the trigger, (m,) [m]."""
        return self.driven.deepest(self.start)

    @functools.cached_property
    def front_before(self) -> FloatArray:
        """Deepest position of the front axle's edge before the trigger, (m,) [m]."""
        return _front_deepest(self.driven, self.vehicles, self.setup, self.start)

    @functools.cached_property
    def every_vehicle(self) -> TrueVehicles:
        """The vehicles of all n scenarios."""
        options, scenarios = self.setup.options, self.path.scenarios
        return true_vehicles(self.setup.vehicle, options.mismatch, options.tyres, scenarios, self.setup.seed)

    @classmethod
    def build(cls, scenarios: Scenarios, setup: Setup, *, y_s: float) -> Takeover:
        """Prepare scenarios for a trigger threshold; shared by every design with that threshold.

        Raises `InputError` for a threshold outside what is allowed.

        Parameters
        ----------
        scenarios, setup, y_s
            As in `Takeover`; y_s >= -10.
        """
        y_s = checked_number("y_s", y_s, lower=-10.0, unit="m")
        model, options, dt, seed = setup.model, setup.options, setup.dt, setup.seed
        offset = model.parameters.edge_offset
        whole = UncorrectedPath.of(scenarios, options.residuals, seed)
        valid = whole.drivable()
        # rows that cannot be driven are carried along as a departure that never triggers
        path = whole if valid.all() else UncorrectedPath.of(harmless(scenarios, valid), options.residuals, seed)
        t_s = path.crossing_time(y_s, setup.ahead)
        T = path.scenarios.T
        S_uncorrected = path.score(T, offset)
        at_trigger = path.speed(np.minimum(t_s, T))
        valid = valid & np.isfinite(S_uncorrected) & (at_trigger <= SPEED_RANGE[1])
        triggered = valid & (t_s < T - _SHORTEST_STEP)
        t_s = np.where(triggered, t_s, np.inf)
        ended = np.minimum(t_s, T)
        S_before = np.where(triggered, path.score(ended, offset), S_uncorrected)

        remaining = np.where(triggered, T - np.where(triggered, t_s, 0.0), -1.0)
        full = np.floor(remaining / dt).astype(np.int64)
        # neighbours share the lanes of the compiled loops: they should take as many substeps, and last about as long
        stiffness = _substeps(setup, np.where(triggered, at_trigger, np.inf))
        if options.drives_exactly and setup.vehicle_model is None:
            stiffness = np.where(stiffness > data.STIFF, stiffness, 0.0)
        order = np.lexsort((-full, -stiffness, ~triggered))
        rows = order[: int(triggered.sum())]
        driven, start, full_steps = path.take(rows), t_s[rows], full[rows]
        rest = remaining[rows] - full_steps * dt
        rest = np.where(rest > _SHORTEST_STEP, rest, 0.0)

        v = driven.speed(start)
        vehicles = true_vehicles(model.parameters, options.mismatch, options.tyres, driven.scenarios, seed)
        meant = _meant(driven, setup)
        x_0, delta_0 = _state(meant, vehicles, setup, start)
        if meant is not driven:
            x_0[:, 0] = driven.lateral(start) + offset
        S_uncorrected, S_before = np.where(valid, [S_uncorrected, S_before], np.nan)
        return cls(
            scenarios, setup, y_s, valid, path, rows, t_s, S_uncorrected, S_before, driven, vehicles, start,
            x_0[:, :4], delta_0, full_steps, rest, setup.plant(v), x_0[:, 4:],
        )  # fmt: skip


def _meant(path: UncorrectedPath, setup: Setup) -> UncorrectedPath:
    """The recorded paths as a driver means and steers them: without the drawn residual of y, which nobody steers."""
    residuals = setup.options.residuals
    if not (residuals.y and setup.options.driver.holds):
        return path
    return UncorrectedPath.of(path.scenarios, dataclasses.replace(residuals, y=False), setup.seed)


def _state(
    path: UncorrectedPath, car: TrueVehicles, setup: Setup, t: FloatArray, *, steered: bool = True
) -> tuple[FloatArray, FloatArray]:
    """State (m, 4) and steering angle (m,) with which the recorded path is driven at times t (m,); or (m, k).

    With a vehicle model, also its own states in the columns after the four.
    """
    turn = _turn(path, car, setup, t, setup.vehicle.edge_offset, steered=steered)
    if setup.vehicle_model is not None:
        return equations(setup.vehicle_model).start(turn)
    return np.stack([turn.e_y, turn.e_y_rate, turn.e_psi, turn.e_psi_rate], axis=-1), turn.delta


def _turn(
    path: UncorrectedPath, car: TrueVehicles, setup: Setup, t: FloatArray, offset: float, *, steered: bool = True
) -> RecordedTurn:
    """The recorded paths at times t, (m,) or (m, k), as the single track takes them; e_y = y + offset."""
    v, rate, bend = path.speed(t), path.lateral_rate(t), path.lateral_acceleration(t)
    lane, zero, e_y = v * path.curvature(t), np.zeros_like(v), path.lateral(t) + offset
    yaw_error = bend / v if setup.initial_yaw_rate == "path" else zero
    dv = (v - path.speed(t - _SPEED_STEP)) / _SPEED_STEP if setup.options.speed == "profile" else zero
    turn = RecordedTurn(e_y, rate, bend, yaw_error, v, dv, lane, zero, zero)
    if setup.start == "printed":
        delta = car.steady_state(v, setup.convention).delta * (lane + bend / v)
        return dataclasses.replace(turn, e_psi=np.arctan2(rate, v), delta=delta)
    steered = steered or setup.vehicle_model is not None  # where the model's search starts
    return car.turn(turn, setup.options.tyres, setup.convention, steered=steered)


def _steady(setup: Setup) -> Setup:
    """For the recorded path itself, whatever state the loop starts from, and on the single track."""
    if (setup.start, setup.initial_yaw_rate, setup.vehicle_model) == ("steady", "path", None):
        return setup
    return dataclasses.replace(setup, start="steady", initial_yaw_rate="path", vehicle_model=None)


def _model_substeps(over: Takeover, model: VehicleModel, slowest: FloatArray) -> FloatArray:
    """Substeps a sample on a vehicle model, by its fastest time constant at the trigger and in straight driving."""
    eq, turn, zero = equations(model), over.turn, np.zeros(over.m)
    rate = np.full(over.m, _REACH / model.longest_step)
    if not model.advances:
        straight = RecordedTurn(zero, zero, zero, zero, slowest, zero, zero, zero, zero)
        for x, delta, at in (
            (np.column_stack([over.x_0, over.states]), over.delta_0, turn), (*eq.start(straight), straight),
        ):  # fmt: skip
            rate = np.maximum(rate, eq.fastest(x, np.column_stack([at.v, at.v_rate, at.yaw_rate, delta])))
    return np.asarray(np.ceil(over.setup.dt * rate / _REACH))


def _front_deepest(path: UncorrectedPath, car: TrueVehicles, setup: Setup, t_end: FloatArray) -> FloatArray:
    """Largest distance y + l_f e_psi of the front axle's edge beyond the line over [0, t_end], (n,) [m]."""
    steady = _steady(setup)

    def front(part: UncorrectedPath, rows: IntArray, t: FloatArray) -> FloatArray:
        turn = _turn(part, car.columns(rows), steady, t, 0.0, steered=False)
        return turn.e_y + car.l_f * turn.e_psi

    return path.highest(front, np.zeros_like(t_end), t_end)


def _substeps(setup: Setup, v: FloatArray) -> FloatArray:
    """Substeps a sample at speeds (m,) that follow the nominal vehicle's fastest time constant."""
    p = setup.vehicle
    fastest = max((p.C_af + p.C_ar) / p.m, (p.C_af * p.l_f**2 + p.C_ar * p.l_r**2) / p.I_z)
    return np.ceil(setup.dt * 2.0 * fastest / v / _REACH)


def _scene(over: Takeover) -> FloatArray:
    """What the compiled loops read of each scenario, a row of (m, k)."""
    p, setup, car, v, m = over.triggered, over.setup, over.vehicles, over.plant.v, over.m
    l_f, l_r = setup.vehicle.l_f, setup.vehicle.l_r
    A, B, E = car.matrices(v, setup.convention)
    lateral = 2.0 * (car.C_af + car.C_ar) / car.m
    yaw = 2.0 * (car.C_af * l_f**2 + car.C_ar * l_r**2) / car.I_z
    sensors, bias = setup.options.sensors, np.full(m, setup.options.sensors.curvature_bias)
    if sensors.curvature_noise > 0:
        bias += sensors.curvature_noise * normals(setup.seed, p.index, RandomStream.CURVATURE, 1)[:, 0]
    reach = _REACH if setup.options.tyres.ideal else _REACH_OF_TYRES
    slowest = v if setup.options.speed == "frozen" else over.driven.slowest_speed(over.start, p.T)
    columns = {
        data.START: over.start,
        data.T_END: p.T,
        data.FULL: over.full_steps,
        data.REST: over.rest,
        data.STEPS: over.steps,
        data.SIDE: p.side,
        data.INDEX: p.index,
        data.SPEED: v,
        data.V_MEAN: p.v_mean,
        data.A_MEAN: p.a_mean,
        data.C_0: p.c_0,
        data.DC: p.dc,
        data.DELTA_0: over.delta_0,
        data.SUBSTEPS: np.maximum(
            setup.dt * np.maximum(np.maximum(lateral, yaw) / slowest / reach, 1.0 / data.LONGEST),
            data.column_steps(setup),
        ),
        data.C_AF: car.C_af,
        data.C_AR: car.C_ar,
        data.L_F: l_f,
        data.L_R: l_r,
        data.MASS: car.m,
        data.I_Z: car.I_z,
        data.MU: car.mu,
        data.PRINTED: 4.0 * car.C_ar * l_r / car.m if setup.convention == "as_printed" else 0.0,
        data.CURVATURE_BIAS: p.side * bias,
        **dict(enumerate(_driver(over), start=data.DRIVER)),
        data.B_1: B[:, 1],
        data.E_1: E[:, 1],
    }
    if setup.vehicle_model is not None:
        columns[data.SUBSTEPS] = _model_substeps(over, setup.vehicle_model, slowest)
    columns |= {data.A_11 + j: A[:, 1, j + 1] for j in range(3)}
    columns |= {data.BEND + j: coefficient for j, coefficient in enumerate(bend_polynomial(p))}
    tail = [over.driven.modes_v, _earlier_frames(over), _filter(over)]
    scene = np.zeros((m, data.SCENE + sum(part.shape[1] for part in tail)))
    for column, values in columns.items():
        scene[:, column] = values
    scene[:, data.X_0 : data.X_0 + 4] = over.x_0
    scene[:, data.SCENE :] = np.concatenate(tail, axis=1)
    return scene


def _driver(over: Takeover) -> list[FloatArray]:
    """Columns of the driver of each scenario, in the order of `kernel.data`; without one, nothing to draw."""
    driver, car, setup = over.setup.options.driver, over.vehicles, over.setup
    if driver.ideal:
        return []
    draws = uniforms(setup.seed, over.triggered.index, RandomStream.DRIVER, 5)
    intent = np.searchsorted(np.cumsum(driver.shares)[:-1], draws[:, 0], side="right").astype(np.float64)
    strength = driver.grip if driver.model == "grip" else driver.stiffness
    ranges = np.array([strength, driver.reaction, driver.across, driver.frequency])
    drawn = np.minimum(ranges[:, :1] + (ranges[:, 1:] - ranges[:, :1]) * draws[:, 1:].T, ranges[:, 1:])
    drawn[0] = np.maximum(drawn[0], _LEAST_GRIP) if driver.model == "grip" else drawn[0]
    v, wheelbase = over.plant.v, car.l_f + car.l_r
    trail = (1.0 - driver.boost) * driver.trail * car.m / setup.vehicle.steering_ratio
    per_a_y = car.steady_state(v, setup.convention).delta / v, np.full(over.m, car.l_r / wheelbase)
    return [intent, *drawn, *per_a_y, trail]


def _earlier_frames(over: Takeover) -> FloatArray:
    """(e_y, e_psi) of the recorded path in the frames before the trigger that still reach the law, latest first."""
    sensors, dt = over.setup.options.sensors, over.setup.dt
    period = sensors.period or dt
    frames = np.zeros((over.m, 2 * math.ceil(sensors.delay / period - 1e-9)))
    for j in range(frames.shape[1] // 2):
        frames[:, 2 * j : 2 * j + 2] = _before(over, (j + 1) * period)[:, [0, 2]]
    return frames


def _before(over: Takeover, age: float) -> FloatArray:
    """States of the recorded path so long before the trigger, (m, 4) or more."""
    return _state(over.driven, over.vehicles, over.setup, over.start - age, steered=False)[0]


def _filter(over: Takeover) -> FloatArray:
    """The Kalman filter's gain and model; no columns without one."""
    sensors = over.setup.options.sensors
    if sensors.kalman is None:
        return np.zeros((over.m, 0))
    first = _before(over, over.plant.age)[:, :4] if over.plant.age > 0.0 else over.x_0
    frame_samples = max(1, round(sensors.period / over.setup.dt))
    return np.concatenate([filter_columns(over.plant, sensors.kalman, frame_samples), first], axis=1)


def law_tables(laws: Sequence[LinearLaw], scratch: FloatArray) -> FloatArray:
    """Linear laws of one shape for the compiled loops, (d, m, `data.LAW` + 2 p + q); into `scratch`."""
    p, q = shape_of(laws[0])
    shape = (len(laws), laws[0].F.shape[0], data.LAW + 2 * p + q)
    tables = scratch[: math.prod(shape)].reshape(shape)
    for table, law in zip(tables, laws, strict=True):
        table[:, data.LAW_F : data.LAW_U] = law.F
        table[:, data.LAW_U] = law.f_u
        table[:, data.LAW_I] = 0.0 if law.f_i is None else law.f_i
        table[:, data.LAW_WHEEL] = 0.0 if law.f_wheel is None else law.f_wheel
        table[:, data.LAW_CONDITIONED] = law.conditioned
        table[:, data.LAW : data.LAW + 2 * p : 2] = law.G_yaw_rate
        table[:, data.LAW + 1 : data.LAW + 2 * p : 2] = law.G_heading
        if law.f_past is not None:
            table[:, data.LAW + 2 * p :] = law.f_past
    return tables


def shape_of(law: LinearLaw) -> tuple[int, int]:
    """Lookahead times p, and past commands q."""
    return law.preview_times.size, 0 if law.f_past is None else law.f_past.shape[1]
