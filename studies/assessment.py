"""Assess a design in the tests of a regulation or of Euro NCAP: cells as stated, and at the corners of tolerances."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import Controller, EventStatus
from ldctoolkit.declared import checked_whole
from ldctoolkit.errors import LdcError, expect
from ldctoolkit.law_checks import check_controller, raised
from ldctoolkit.plant_options import INTENTS, Driver, Mismatch, Residuals
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Outcome, Takeover, drive

from .design import Design
from .standards import KM_H, OF_A_DRIVER, VEHICLES, Cells, QuantityName, Standard, load_standard
from .storage.folder_files import write_text
from .storage.measure_table import remembered
from .tables import Column, Row, Table, to_csv

LightName = Literal["green", "amber", "red"]

SEEDS: Final = 3  # of the camera's noise, for every corner and vehicle

_AFTER: Final = 2.0  # [s] from the largest lateral position, or the violation of the limit, to the end of a test
_BEFORE: Final = 3.0  # [s] from the start of the filters to the trigger
_RATE: Final = 200.0  # [Hz] sampling rate of the filters; the standards ask for at least 100
_WHEEL_CUTOFF, _WHEEL_ORDER = 10.0, 6  # [Hz] Butterworth, forwards and backwards: 12 poles and no phase
_JERK_CUTOFF, _JERK_ORDER = 0.5, 4  # [Hz]
_JERK_WINDOW: Final = 0.5  # [s] moving average of the jerk
_TURNED: Final = 5.0  # [deg] change of the steering wheel angle from which on its rate counts


# ------------------------------------------------------------------------------------------------ one drive


@dataclasses.dataclass(frozen=True)
class _Drive:
    """n cells driven under a variant, sample by sample; before the trigger, or without a trigger, along the drift."""

    over: Takeover
    outcome: Outcome
    t: FloatArray  # (n, e + k) [s] e samples before the trigger; the last time repeats after the end
    x: FloatArray  # (n, e + k, 4) State
    delta: FloatArray  # (n, k) [rad] Steering angle, from the trigger on
    delta_0: FloatArray  # (n,) [rad] Until the trigger
    limit: FloatArray  # (n,) [m] DTLE at which the test is failed; -inf without such a condition

    @classmethod
    def of(cls, controller: Controller, takeover: Takeover, limit: FloatArray) -> _Drive:
        outcome = drive(controller, takeover, trajectories=True).outcome("departure")
        T, n, trajectories = takeover.path.scenarios.T, takeover.scenarios.n, outcome.trajectories
        # where the law never intervenes, the vehicle follows the drift for T
        k = math.ceil(float(T.max()) / takeover.setup.dt) + 1
        k = k if trajectories is None else max(k, trajectories.t.shape[1])
        t, delta, x = np.full((n, k), np.nan), np.zeros((n, k)), np.zeros((n, k, 4))
        if trajectories is not None:
            sampled = slice(trajectories.t.shape[1])
            t[:, sampled], x[:, sampled], delta[:, sampled] = trajectories.t, trajectories.x, trajectories.delta
        never = ~np.isfinite(t[:, 0])
        if never.any():
            times = T[:, None] * np.linspace(0.0, 1.0, k)
            t[never], x[never], delta[never] = times[never], takeover.recorded_motion(times)[0][never], 0.0
        last = np.isfinite(t).sum(axis=1) - 1
        sample, rows = np.minimum(np.arange(k), last[:, None]), np.arange(n)[:, None]
        delta_0 = np.zeros(n)
        delta_0[takeover.rows] = takeover.delta_0
        earlier = t[:, :1] * np.linspace(0.0, 1.0, max(math.ceil(t[:, 0].max() / takeover.setup.dt), 1), endpoint=False)
        x = np.concatenate([takeover.recorded_motion(earlier)[0], x[rows, sample]], axis=1)
        return cls(takeover, outcome, np.c_[earlier, t[rows, sample]], x, delta[rows, sample], delta_0, limit)

    def cubics(self, arm: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Position of an axle's edge beyond the line [m]: coefficients of u^0 to u^3 by interval, (n, e + k - 1)."""
        f = self.x[:, :, 0] + arm * self.x[:, :, 2] - self.over.setup.vehicle.edge_offset
        rise, slope, h = np.diff(f, axis=1), self.x[:, :, 1] + arm * self.x[:, :, 3], np.diff(self.t, axis=1)
        m_0, m_1 = slope[:, :-1] * h, slope[:, 1:] * h
        return f[:, :-1], m_0, 3.0 * rise - 2.0 * m_0 - m_1, m_0 + m_1 - 2.0 * rise

    def beyond(self, arm: float, end: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Largest position of an axle's edge [m] in each interval until `end` (n,), and when, (n, e + k - 1)."""
        (f_0, m_0, b, a), t, h = self.cubics(arm), self.t[:, :-1], np.diff(self.t, axis=1)
        until = np.clip(np.divide(end[:, None] - t, h, out=np.zeros_like(h), where=h > 0.0), 0.0, 1.0)
        root = np.sqrt(np.maximum(b**2 - 3.0 * a * m_0, 0.0)) - b
        peak = np.clip(np.divide(m_0, root, out=np.zeros_like(root), where=root > 0.0), 0.0, 1.0)
        last = np.where(until * (m_0 + until * (b + until * a)) > 0.0, until, 0.0)
        u = np.where((m_0 > 0.0) & (m_0 + 2.0 * b + 3.0 * a < 0.0) & (peak <= until), peak, last)
        return np.where(t <= end[:, None], f_0 + u * (m_0 + u * (b + u * a)), -np.inf), t + u * h

    @functools.cached_property
    def largest(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Largest position of the front tyre's outer edge beyond the line until the test ends, when, and the end."""
        t, row, l_f = self.t, np.arange(len(self.t)), self.over.setup.vehicle.l_f
        peaks, when = self.beyond(l_f, t[:, -1])
        deepest = np.maximum.accumulate(peaks, axis=1)
        reached = np.maximum.accumulate(np.where(peaks >= deepest, when, 0.0), axis=1)
        before = np.c_[t[:, :1], reached[:, :-1]]
        settled = np.where(peaks >= deepest, when, t[:, 1:]) - before >= _AFTER
        end = np.where(settled.any(axis=1), before[row, np.argmax(settled, axis=1)] + _AFTER, t[:, -1])
        interval = np.argmax(deepest > -self.limit[:, None], axis=1)
        f_0, m_0, b, a = (part[row, interval] for part in self.cubics(l_f))
        low, high = t[row, interval], when[row, interval]
        h = np.maximum(t[row, interval + 1] - low, 1e-300)
        for _ in range(50):  # bisection: the limit is first exceeded between these times
            middle = 0.5 * (low + high)
            u = (middle - t[row, interval]) / h
            over = f_0 + u * (m_0 + u * (b + u * a)) > -self.limit
            low, high = np.where(over, low, middle), np.where(over, middle, high)
        end = np.where(deepest[:, -1] > -self.limit, np.minimum(end, high + _AFTER), end)
        peaks, when = self.beyond(l_f, end)
        interval = np.argmax(peaks, axis=1)
        return peaks[row, interval], when[row, interval], end

    @property
    def start(self) -> FloatArray:
        """The trigger, (n, 1) [s]."""
        return self.t[:, self.t.shape[1] - self.delta.shape[1], None]

    def resampled(self, values: FloatArray, left: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (n, k) resampled to 200 Hz, (n, m), and times since the trigger; before it the values are `left`."""
        since = self.t[:, -values.shape[1] :] - self.start
        times = np.arange(math.ceil((float(since.max()) + _BEFORE) * _RATE) + 1) / _RATE - _BEFORE
        rows = zip(since, values, left, strict=True)
        return np.array([np.interp(times, t, row, left=before) for t, row, before in rows]), times

    def response(self, times: FloatArray) -> BoolArray:
        """Whether times since the trigger (m,) lie between the trigger and the end of the test, (n, m)."""
        return np.asarray((times >= 0.0) & (times <= self.largest[2][:, None] - self.start))


def _dtle(run: _Drive) -> FloatArray:
    """Smallest distance of the front tyre's outer edge to the line until the test ends [m]."""
    return -run.largest[0]


def _tyre_distance(run: _Drive) -> FloatArray:
    """Smallest distance of any tyre to the line [m]: in a bend the rear tyres are further out."""
    rear, _ = run.beyond(-run.over.setup.vehicle.l_r, run.largest[2])
    return np.asarray(np.minimum(_dtle(run), -rear.max(axis=1)))


def _wheel_rate(run: _Drive) -> FloatArray:
    """Largest rate of the steering wheel [deg/s], filtered; NaN where it turns by less than 5 degrees."""
    from scipy.signal import butter, sosfiltfilt

    ratio = math.degrees(run.over.setup.vehicle.steering_ratio)
    wheel, times = run.resampled(ratio * run.delta, ratio * run.delta_0)
    response = run.response(times)
    until_end = np.where(response | (times < 0.0), wheel, wheel[:, :1])
    turned = until_end.max(axis=1) - until_end.min(axis=1)
    rate = np.diff(wheel, axis=1, append=wheel[:, -1:]) * _RATE
    filtered: FloatArray = sosfiltfilt(butter(_WHEEL_ORDER, _WHEEL_CUTOFF, fs=_RATE, output="sos"), rate, axis=1)
    fastest = np.where(response, np.abs(filtered), 0.0).max(axis=1)
    return np.asarray(np.where(turned >= _TURNED, fastest, np.nan))


def _jerk(run: _Drive) -> FloatArray:
    """Largest lateral jerk [m/s^3]: moving average over 0.5 s of the filtered lateral acceleration."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    p, window = run.over.path.scenarios, round(_JERK_WINDOW * _RATE)
    driven = run.x[:, -run.delta.shape[1] :, 1]
    rate, times = run.resampled(driven, driven[:, 0])
    before = run.over.path.lateral_acceleration(run.start[:, 0])  # until the trigger the vehicle is on its path
    a_y = np.where(times < 0.0, before[:, None], np.diff(rate, axis=1, append=rate[:, -1:]) * _RATE)
    a_y += (p.v_mean**2 * p.c_0)[:, None]
    sos = butter(_JERK_ORDER, _JERK_CUTOFF, fs=_RATE, output="sos")
    filtered, _ = sosfilt(sos, a_y, axis=1, zi=sosfilt_zi(sos)[:, None, :] * a_y[None, :, :1])
    jerk = np.zeros_like(filtered)
    jerk[:, window:] = (filtered[:, window:] - filtered[:, :-window]) / _JERK_WINDOW
    return np.asarray(np.where(run.response(times), np.abs(jerk), 0.0).max(axis=1))


def _lateral_velocity_after(run: _Drive) -> FloatArray:
    """Magnitude of the lateral velocity two seconds after the smallest DTLE [m/s]."""
    t = np.minimum(run.largest[1] + _AFTER, run.t[:, -1])
    row, j = np.arange(len(t)), np.maximum((run.t < t[:, None]).sum(axis=1) - 1, 0)
    _, m_0, b, a = (part[row, j] for part in run.cubics(0.0))
    h = run.t[row, j + 1] - run.t[row, j]
    u = (t - run.t[row, j]) / h
    return np.asarray(np.abs(m_0 + u * (2.0 * b + 3.0 * u * a)) / h)


@dataclasses.dataclass(frozen=True)
class Quantity:
    """A quantity that conditions limit."""

    title: str
    unit: str
    at_least: bool  # Whether the limit is a lower one
    digits: int
    of: Callable[[_Drive], FloatArray] | None = None  # None for the metric of that name


QUANTITIES: Final[Mapping[QuantityName, Quantity]] = {
    "dtle": Quantity("DTLE", "m", True, 2, _dtle),
    "tyre_distance": Quantity("Tyres to the line", "m", True, 2, _tyre_distance),
    "opposite_crossing": Quantity("Opposite line crossed by", "m", False, 2),
    "a_y_added_peak": Quantity("Added a_y", "m/s²", False, 2),
    "jerk_added_peak": Quantity("Added jerk", "m/s³", False, 2),
    "jerk": Quantity("Lateral jerk", "m/s³", False, 2, _jerk),
    "steering_wheel_rate": Quantity("Steering wheel velocity", "°/s", False, 1, _wheel_rate),
    "lateral_velocity_after": Quantity("Lateral velocity 2 s after", "m/s", False, 2, _lateral_velocity_after),
    "driver_torque_peak": Quantity("Overriding torque", "N·m", False, 2),
    "against_parallel": Quantity("Against the driver once parallel", "s", False, 2),
}
"""Every quantity of a condition by its name."""


# ------------------------------------------------------------------------------------------------ the assessment


@dataclasses.dataclass(frozen=True)
class Assessment:
    """A design in n cells of a standard, c conditions, under w variants; the first is the cell as stated.

    As stated, the vehicle is the nominal one and the camera has no noise.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> ldc.assess(ldc.NoControl(), "euroncap-2026-elk-road-edge", tolerances=False).passed.any()
    np.False_
    """

    standard: Standard
    cells: Cells
    variants: tuple[str, ...]  # Differences from the cell as stated; empty for the cell itself
    values: FloatArray  # (w, c, n) In the units of `QUANTITIES`; NaN where a condition does not apply
    limits: FloatArray  # (w, c, n)
    met: BoolArray  # (w, c, n)
    diverged: BoolArray  # (w, n) The vehicle left the road: no condition is met
    failed_solves: IntArray  # (w, n) Commands that came from the fallback law
    # Of the conditions on a driver's torque; the others are without one
    driver: Driver = dataclasses.field(default_factory=Driver)

    @property
    def _enough(self) -> BoolArray:
        """Where as many conditions are met as the standard requires, all where fewer can be assessed, (w, n)."""
        conditions = self.met.shape[1]
        required = conditions if self.standard.required is None else min(self.standard.required[0], conditions)
        return np.asarray(self.met.sum(axis=1) >= required)

    @property
    def passed(self) -> BoolArray:
        """Cells in which the conditions that are required are met as stated, (n,)."""
        return np.asarray(self._enough[0])

    @property
    def robust(self) -> BoolArray:
        """Cells in which they are met under every variant, (n,)."""
        return np.asarray(self._enough.all(axis=0))

    @property
    def held(self) -> int:
        """Number of conditions that are met in every standard cell as stated."""
        return int(self.met[0][:, ~self.cells.extended].all(axis=1).sum())

    @property
    def lights(self) -> tuple[LightName, ...]:
        """Green, amber (passes as stated, fails under some variant) or red, of each cell."""
        pairs = zip(self.passed.tolist(), self.robust.tolist(), strict=True)
        return tuple("green" if robust else "amber" if passed else "red" for passed, robust in pairs)

    @property
    def score(self) -> float:
        """Share of the standard cells that pass as stated."""
        return float(self.passed[~self.cells.extended].mean())

    @property
    def robust_score(self) -> float:
        """Share of the standard cells that pass under every variant."""
        return float(self.robust[~self.cells.extended].mean())

    @property
    def extended_score(self) -> float:
        """Part of the points of the extended range; NaN where there is none, 0 where the standard range has too few."""
        if not self.cells.extended.any():
            return math.nan
        share = float(self.passed[self.cells.extended].mean())
        reached = [points for least, points in self.standard.extended_points if share >= least - 1e-9]
        return max(reached, default=0.0) if self.score >= self.standard.extended_from else 0.0

    def worst(self, condition: int) -> tuple[FloatArray, IntArray]:
        """The worst value of a condition over all variants, (n,), and which one has it; NaN where it never applies."""
        values, sign = self.values[:, condition], -1.0 if self._of(condition).at_least else 1.0
        cost = np.where(self.diverged, np.inf, np.where(np.isnan(values), -np.inf, sign * values))
        which = np.argmax(cost, axis=0)
        return values[which, np.arange(self.cells.n)], which

    def _of(self, condition: int) -> Quantity:
        return QUANTITIES[self.standard.condition[condition].quantity]

    def reason(self, i: int) -> str:
        """Why a cell is not green: what misses which limit, and under which variant; empty where it is green."""
        parts = []
        for c in range(len(self.standard.condition)):
            missed = ~self.met[:, c, i]
            if missed.any():
                of = self._of(c)
                excess = (-1.0 if of.at_least else 1.0) * (self.values[:, c, i] - self.limits[:, c, i])
                excess = np.where(self.diverged[:, i], np.inf, np.where(missed, excess, -np.inf))
                variant = 0 if missed[0] else int(np.argmax(excess))
                value = f"{of.title} {self.values[variant, c, i]:.{of.digits}f} {of.unit}"
                observed = "diverged" if self.diverged[variant, i] else value
                where = f" ({self.variants[variant]})" if variant else ""
                parts.append(f"{observed}, limit {self.limits[variant, c, i]:.{of.digits}f} {of.unit}{where}")
        return "; ".join(parts).replace("-", "\u2212")


def assess(
    controller: Controller,
    standard: str | Path | Standard,
    setup: Setup | None = None,
    *,
    y_s: float = 0.2,
    tolerances: bool = True,
    seeds: int = SEEDS,
) -> Assessment:
    """Run one design through the cells of a standard.

    Raises `UnknownNameError` for an unknown standard; `InputError` for arguments outside what is allowed; `LdcError`
    where the law raised.

    Parameters
    ----------
    controller : Controller
        The design.
    standard : str, path or Standard
        Name in the catalog, a TOML file, or what `load_standard` gives.
    setup : Setup, optional
        Vehicle, plant, clock, trigger and seed. The lane is cut to the width that the standard allows; the vehicles
        that the plant draws are replaced by the named ones of the variants. A driver of the plant holds the wheel for
        the conditions on a driver's torque only, which are not assessable without one.
    y_s : float [m]
        Trigger threshold; below 0 before the line.
    tolerances : bool
        Run the variants too: corners of the tolerances of speed and lateral velocity, by vehicles (nominal, light,
        heavy, soft, stiff), by seeds of the camera's noise.
    seeds : int
        How many of these.

    Notes
    -----
    A test ends two seconds after the largest lateral position, or two seconds after its DTLE limit was broken. DTLE is
    the distance of the front tyre's outer edge, at the width of the vehicle, to the line.

    Examples
    --------
    >>> from ldctoolkit import NoControl
    >>> assess(NoControl(), "euroncap-2026-elk-road-edge", tolerances=False).score
    0.0
    """
    check_controller(controller)
    expect("standard", standard, str | Path | Standard)
    test = standard if isinstance(standard, Standard) else load_standard(standard)
    expect("setup", setup, Setup | None)
    seeds = checked_whole("seeds", seeds, lower=1)
    runs = _Runs.of(test, setup or Setup(), seeds if tolerances else 0)
    return runs.judged(runs.driven(controller, y_s))


def stored_assessment(folder: Path | None, design: Design, name: str, setup: Setup, *, tolerances: bool) -> Assessment:
    """The assessment of a design of a study; its numbers are computed once and stored in the study's folder."""
    runs = _Runs.of(load_standard(name), setup, SEEDS if tolerances else 0)
    controller = design.controller(setup.convention)
    key = [design.id, runs.test.model_dump(mode="json"), dataclasses.asdict(setup), tolerances]
    return runs.judged(remembered(folder, f"standard-{name}", key, lambda: runs.driven(controller, design.y_s)))


@dataclasses.dataclass(frozen=True)
class _Runs:
    """The runs of a test: w variants of its n cells, in batches."""

    test: Standard  # With the conditions that can be assessed
    driver: Driver
    cells: Cells
    batches: list[tuple[list[str], Setup, Scenarios]]  # Names of variants, setup, and n scenarios for each name
    limits: FloatArray  # (c, n) Limits of the conditions as stated

    @classmethod
    def of(cls, test: Standard, given: Setup, seeds: int) -> _Runs:
        """The runs of a test, with the lane width limited to the range that it allows."""
        width = min(max(given.vehicle.w_l, test.lane_width_m[0]), test.lane_width_m[1])
        driver, test = given.options.driver, test.assessable(given.options.driver)
        vehicle, options = dataclasses.replace(given.vehicle, w_l=width), given.options
        given = dataclasses.replace(given, vehicle=vehicle, options=dataclasses.replace(options, driver=Driver()))
        cells = test.every_cell
        limits = np.array([test.limits(condition, cells) for condition in test.condition])
        return cls(test, driver, cells, list(_variants(test, cells, given, seeds)), limits)

    def driven(self, controller: Controller, y_s: float) -> dict[str, FloatArray]:
        """Values and limits (w, c, n), status and failed solves (w, n)."""
        test, n = self.test, self.cells.n
        broken = next(
            (self.limits[c] for c, condition in enumerate(test.condition) if condition.quantity == "dtle"),
            np.full(n, -np.inf),
        )
        parts: dict[str, list[Any]] = {"values": [], "limits": [], "status": [], "failed_solves": []}
        for _, on, scenarios in self.batches:
            count = scenarios.n // n
            try:
                run = _Drive.of(controller, Takeover.build(scenarios, on, y_s=y_s), np.tile(broken, count))
                with_driver, more_failed = self._with_driver(controller, scenarios, on, y_s)
            except (LdcError, KeyboardInterrupt, GeneratorExit):
                raise
            except BaseException as error:  # a controller may be third-party code
                raise LdcError(f"law {controller.name!r} in {test.name}", f"{raised(error)}") from None
            metrics = vars(run.outcome.metrics) | with_driver
            quantities = ((condition.quantity, QUANTITIES[condition.quantity].of) for condition in test.condition)
            values = [metrics[name] if of is None else of(run) for name, of in quantities]
            limits = np.repeat(self.limits[None], count, axis=0)
            for c, condition in enumerate(test.condition):
                if condition.quantity == "lateral_velocity_after" and scenarios.drift is not None:
                    # the limit is at least the lateral velocity of the drift
                    rate = scenarios.drift.lateral_velocity.reshape(-1, n)
                    limits[:, c] = np.maximum(self.limits[c].min(), rate)
            parts["values"].append(np.array(values).reshape(len(values), -1, n).swapaxes(0, 1))
            parts["limits"].append(limits)
            parts["status"].append(run.outcome.status.reshape(-1, n))
            parts["failed_solves"].append((run.outcome.failed_solves + more_failed).reshape(-1, n))
        return {name: np.concatenate(arrays) for name, arrays in parts.items()}

    def _with_driver(
        self, controller: Controller, scenarios: Scenarios, on: Setup, y_s: float
    ) -> tuple[dict[QuantityName, FloatArray], IntArray]:
        """Quantities of a driver: overriding torque of one who means to leave the lane, else the largest of all.

        Every cell is driven with each of the plant's intents, whatever its share. (n,) each, and failed solves (n,).
        """
        shares = dict(zip(INTENTS, self.driver.shares, strict=True))
        intents = {"driver_torque_peak": ["against"], "against_parallel": [name for name in INTENTS if shares[name]]}
        asked = {c.quantity: intents[c.quantity] for c in self.test.condition if c.quantity in OF_A_DRIVER}
        outcomes = {}
        for intent in dict.fromkeys(itertools.chain(*asked.values())):
            alone: dict[str, Any] = {name: float(name == intent) for name in INTENTS}
            driver = dataclasses.replace(self.driver, **alone)
            over = Takeover.build(scenarios, on.on(dataclasses.replace(on.options, driver=driver)), y_s=y_s)
            outcomes[intent] = drive(controller, over).outcome("departure")
        values = {name: np.max([getattr(outcomes[i].metrics, name) for i in of], axis=0) for name, of in asked.items()}
        failed = sum((outcome.failed_solves for outcome in outcomes.values()), np.zeros(scenarios.n, dtype=np.int64))
        return values, failed

    def judged(self, driven: Mapping[str, FloatArray]) -> Assessment:
        """The assessment of driven values."""
        conditions = self.test.condition
        slow = np.array([self.cells.speed / KM_H < condition.from_speed_km_h - 1e-6 for condition in conditions])
        values, limits = np.where(slow, np.nan, driven["values"]), driven["limits"]
        lower = np.array([QUANTITIES[condition.quantity].at_least for condition in conditions])[:, None]
        beyond = np.where(lower, limits - values, values - limits)
        diverged = driven["status"] == EventStatus.DIVERGED
        met = (np.isnan(beyond) | (beyond <= 1e-9)) & ~diverged[:, None]
        names = tuple(name for batch, _, _ in self.batches for name in batch)
        solves = driven["failed_solves"].astype(np.int64)
        return Assessment(self.test, self.cells, names, values, limits, met, diverged, solves, self.driver)


def _variants(test: Standard, cells: Cells, setup: Setup, seeds: int) -> Iterator[tuple[list[str], Setup, Scenarios]]:
    """The cells as stated, then each vehicle at all corners with all seeds: names, setup, and the cells for each name.

    As stated, the vehicle is the nominal one and the camera has no noise.
    """
    speed, rate, sensors = test.speed_tolerance_km_h, test.lateral_velocity_tolerance_m_s, setup.options.sensors
    silent = dataclasses.replace(sensors, e_y_noise=0.0, e_psi_noise=0.0, curvature_noise=0.0)
    options = dataclasses.replace(setup.options, mismatch=Mismatch(), sensors=silent, residuals=Residuals())
    yield [""], setup.on(options), test.scenarios(cells, setup.vehicle.edge_offset)
    if not seeds:
        return
    noisy = sensors.e_y_noise or sensors.e_psi_noise or sensors.curvature_noise
    corners = list(dict.fromkeys(itertools.product((-speed, speed), (-rate, rate)))) * (seeds if noisy else 1)
    off = np.repeat(np.array(corners), cells.n, axis=0)
    offset = setup.vehicle.edge_offset
    scenarios = test.scenarios(cells.times(len(corners)), offset, off[:, 0] * KM_H, off[:, 1])
    names = [f", {a:+g} km/h, {b:+g} m/s" if a or b else "" for a, b in corners]
    for vehicle in ("nominal", *VEHICLES):
        fixed = {quantity: (factor, factor) for quantity, factor in VEHICLES.get(vehicle, {}).items()}
        options = dataclasses.replace(setup.options, mismatch=Mismatch(**fixed), residuals=Residuals())
        yield [f"{vehicle} vehicle{name}" for name in names], setup.on(options), scenarios


PREDICTIONS: Final = (
    "label", "standard", "range", "speed_km_h", "lateral_velocity_m_s", "lateral_acceleration_m_s2", "predicted",
    "light", "quantity", "value", "limit", "worst", "worst_case",
)  # fmt: skip
"""Columns of a table of predictions: a row for each cell and condition."""


def write_predictions(assessments: Sequence[tuple[str, Assessment]], path: str | Path) -> None:
    """Write the predictions of virtual testing for every cell and named design as a CSV file, whole or not at all."""
    rows = []
    for design, assessment in assessments:
        for c, condition in enumerate(assessment.standard.condition):
            worst, which = assessment.worst(c)
            for i in range(assessment.cells.n):
                second, bend = f"{assessment.cells.second[i]:g}", bool(assessment.cells.bend[i])
                numbers = (assessment.values[0, c, i], assessment.limits[0, c, i], worst[i])
                shown = ["" if math.isnan(number) else f"{number:.6g}" for number in numbers]
                rows.append(Row([
                    design, assessment.standard.name, "extended" if assessment.cells.extended[i] else "standard",
                    f"{assessment.cells.speed[i] / KM_H:g}", *(("", second) if bend else (second, "")),
                    "pass" if assessment.passed[i] else "fail", assessment.lights[i], condition.quantity, *shown,
                    assessment.variants[which[i]],
                ]))  # fmt: skip
    write_text(Path(path), to_csv(Table("", [Column(name) for name in PREDICTIONS], rows)))
