"""The closed loop over all scenarios at once: linear laws in compiled loops, other laws through `SteeringLaw.step`.

A scenario is driven by itself, whichever loop drives it, so that its numbers cannot depend on which others run beside
it, on their order or on the number of threads.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import LANES, BoolArray, FloatArray, Frame, IntArray, ReadOnly, facts_html, unmasked
from ldctoolkit.control import (
    AssistState,
    Controller,
    EventStatus,
    Law,
    LinearLaw,
    LinearSteps,
    Preview,
    RecordedPath,
    SolverCalls,
    SolverLog,
    SteeringLaw,
)
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, expect
from ldctoolkit.law_checks import check_calls, check_controller, check_law, check_step, check_taken
from ldctoolkit.metrics import DRIVER_METRICS, METRIC_COLUMNS, METRIC_UNITS, MetricValues
from ldctoolkit.metrics import reduction as metric_reduction
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import SETTLE, TTLC, InitialYawRate, PlantKnowledge, Setup, Start, Trigger
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.stretches import SCENARIOS_A_TASK, in_threads, stretches
from ldctoolkit.simulation.takeover import KeptPaths, Takeover, law_tables, shape_of
from ldctoolkit.vehicle import BicycleModel, VehicleParameters

if TYPE_CHECKING:
    import polars as pl

    from ldctoolkit.paths.uncorrected import UncorrectedPath

Window = Literal["departure", "control"]
_FINE: Final = 0.01  # [s] Step of the integrals along the lane
STATUS_NAMES = np.array([status.name.lower() for status in EventStatus])  # By status number

_SHOWN: Final = {
    EventStatus.OK: "taken over and driven to the end",
    EventStatus.NEVER_TRIGGERED: "never triggered",
    EventStatus.SOLVER_FAILED: "solver failed",
    EventStatus.DIVERGED: "diverged",
    EventStatus.TIMED_OUT: "timed out",
    EventStatus.INVALID: "cannot be driven",
    EventStatus.CRASHED: "crashed",
    EventStatus.BEYOND_DELTA_MAX: "taken over beyond delta_max, driven to the end",
}
FAILURES: Final = (EventStatus.SOLVER_FAILED, EventStatus.DIVERGED, EventStatus.TIMED_OUT, EventStatus.CRASHED)


@dataclasses.dataclass(frozen=True, repr=False)
class Trajectories(ReadOnly):
    """Paths of c chosen scenarios at the controller's samples and at the departure's end T.

    `x`, `delta` and `a_y` are in the outward frame of the departure: those to the right are mirrored, so that e_y,
    e_psi, the steering angle and a_y are positive to the right there. `world` gives them on their true side.

    NaN after the end of the settling horizon, after the last sample inside the bound where a scenario diverged, and
    everywhere where it never triggered.
    """

    rows: IntArray  # (c,) Row numbers of the scenarios
    t: FloatArray  # (c, k) [s] Time since the departure's start; the first column is the trigger
    x: FloatArray  # (c, k, 4) State (e_y, de_y/dt, e_psi, de_psi/dt)
    delta: FloatArray  # (c, k) [rad] Steering angle of the wheel just after that time; in the last entry, at it
    a_y: FloatArray  # (c, k) [m/s^2] Lateral acceleration, axle forces over mass, at the moment of `delta`
    path: UncorrectedPath  # Of the chosen scenarios, with the lane and the speed that are driven
    v: FloatArray  # (c,) [m/s] Speed where the plant keeps that of the trigger; NaN where it follows the path's
    # (c, k) Torques at the steering wheel [N m] just before the command, 0 at the trigger; authority of the assist from
    # 0 to 1, and its `AssistState`, from then on; None without a driver
    driver_torque: FloatArray | None = None
    assist_torque: FloatArray | None = None
    authority: FloatArray | None = None
    assist_state: FloatArray | None = None

    def world(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position and heading in the plane, on the true side and along the lane's curvature; axes as in ISO 8855.

        The origin is the lane's centre beside the vehicle at the trigger, x points along the lane there and y to the
        left. Like the plant, this passes the lane's centre line at the vehicle's speed.

        Returns
        -------
        x, y, heading : (c, k) [m], [m], [rad]
            Centre of gravity, and the angle of the body from the x axis, positive to the left; NaN as in `x`.

        Examples
        --------
        >>> import ldctoolkit as ldc
        >>> right = ldc.Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=25.0, side=-1)
        >>> paths = ldc.simulate(ldc.LQR(), right, trajectories=True).trajectories
        >>> x, y, heading = paths.world()
        >>> bool(paths.x[0, 0, 0] > 0.0), bool(y[0, 0] < 0.0)
        (True, True)
        """
        finite = np.isfinite(self.t)
        step = float(np.diff(self.t).max(initial=_FINE, where=finite[:, 1:]))
        parts = math.ceil(step / _FINE)
        last = np.where(finite, self.t, 0.0).max(axis=1)[:, None]
        t = np.where(finite, self.t, last + step * np.arange(finite.shape[1]))  # unknown times go on rising
        inside = t[:, :-1, None] + np.diff(t)[:, :, None] * (np.arange(parts) / parts)
        fine = np.column_stack([inside.reshape(t.shape[0], -1), t[:, -1]])
        v = np.where(np.isnan(self.v)[:, None], self.path.speed(fine), self.v[:, None])
        side = self.path.scenarios.side[:, None]
        _, x, y, lane = lane_centre(fine, v, side * self.path.curvature(fine))[:, :, ::parts]
        e_y, e_psi = side * self.x[:, :, 0], side * self.x[:, :, 2]
        return x - e_y * np.sin(lane), y + e_y * np.cos(lane), lane + e_psi


def lane_centre(t: FloatArray, v: FloatArray, curvature: FloatArray) -> FloatArray:
    """Way, x, y and heading of what passes a lane's centre line from the origin on, at times t (n, k), (4, n, k)."""
    from scipy.integrate import cumulative_simpson

    turn = cumulative_simpson(v * curvature, x=t, initial=0.0)
    rates = np.stack([v, v * np.cos(turn), v * np.sin(turn)])
    return np.concatenate([cumulative_simpson(rates, x=np.stack([t] * 3), initial=0.0), turn[None]])


@dataclasses.dataclass(frozen=True, repr=False)
class Outcome(Frame):
    """Scores of one design on n scenarios.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> outcome = ldc.simulate(ldc.LQR(), ldc.load_model("reference").sample(5, 5, seed=1), y_s=0.1)
    >>> outcome.S.shape, bool(outcome.mean_reduction > 0)
    ((10,), True)
    """

    window: Window  # Over which S is integrated: [0, T], or from the trigger to T
    S: FloatArray  # (n,) [m s] Integral of |e_y| under the design
    S_uncorrected: FloatArray  # (n,) [m s] The same of the recorded path
    triggered: BoolArray  # (n,)
    status: npt.NDArray[np.int8]  # (n,) `EventStatus`
    t_s: FloatArray  # (n,) [s] Trigger time, infinite where never triggered
    metrics: MetricValues  # Depth, way back, acceleration, jerk and steering, arrays of n
    failed_solves: IntArray  # (n,) Commands that came from the fallback law
    # [s] Wall time of the law's own steps, all scenarios together, not reproducible; 0 for a linear law
    law_seconds: float
    # On request; None where no control acted, since there is no path but the recorded one
    trajectories: Trajectories | None
    # Every solver call of a law that has a solver
    solver_log: SolverLog = dataclasses.field(default_factory=lambda: SolverLog.of([]))
    side: IntArray | None = None  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1), the scenarios' own
    assist_state: IntArray | None = None  # (n,) `AssistState` at the end; None without a driver

    def _repr_html_(self) -> str:
        """What a notebook shows; means leave out scenarios that cannot be driven."""
        driven, lines = self.status != EventStatus.INVALID, []
        groups = [("", driven)]
        for side, name in ((LEFT, "left"), (RIGHT, "right")) if self.side is not None else ():
            rows = driven & (self.side == side)
            groups.append((f", {name} ({np.count_nonzero(rows):,})", rows))
        for group, rows in groups:
            if rows.any():
                S, S_uncorrected = float(np.mean(self.S[rows])), float(np.mean(self.S_uncorrected[rows]))
                change = f", {100.0 * (S / S_uncorrected - 1.0):+.1f} %" if S_uncorrected > 0 else ""
                lines.append((f"mean S with control{group}", f"{S:.4f} m s{change}".replace("-", "\u2212")))
                lines.append((f"mean S without control{group}", f"{S_uncorrected:.4f} m s"))
        if np.isfinite(self.deepest[driven]).any():
            row = int(np.flatnonzero(driven)[np.nanargmax(self.deepest[driven])])
            lines.append(("deepest beyond the line", f"{self.deepest[row]:.3f} m (no. {row})".replace("-", "\u2212")))
        counts = {status: np.count_nonzero(self.status == status) for status in EventStatus}
        lines += [(_SHOWN[status], f"{count:,}") for status, count in counts.items() if count]
        lines.append(("failures", f"{sum(counts[status] for status in FAILURES):,}"))
        if self.failed_solves.any():
            lines.append(("commands from a fallback", f"{int(self.failed_solves.sum()):,}"))
        n = self.S.size
        title = f"Outcome of {n:,} scenario{'' if n == 1 else 's'}, {self.window} window"
        return facts_html(title, lines, "text-align:right;white-space:nowrap")

    def to_polars(self) -> pl.DataFrame:
        """One row a scenario: scores, trigger time (infinite where never triggered), status and every metric."""
        import polars as pl

        scores = {f"S_{self.window}_m_s": self.S, f"S_uncorrected_{self.window}_m_s": self.S_uncorrected}
        return pl.DataFrame(
            ({} if self.side is None else {"side": np.where(self.side == LEFT, "left", "right")})
            | scores
            | {"t_s_s": self.t_s}
            | {"status": STATUS_NAMES[self.status], "failed_solves": self.failed_solves}
            | {
                column: getattr(self.metrics, name)
                for name, column in METRIC_COLUMNS.items()
                if self.assist_state is not None or name not in DRIVER_METRICS
            }
        )

    def __repr__(self) -> str:
        counts = {status.name.lower(): self.count(status) for status in EventStatus if status}
        bad = (f", {count:,} {name}" for name, count in counts.items() if count)
        return (
            f"<Outcome of {self.S.size:,} scenarios, {self.window} window: mean S {np.mean(self.S):.4f} m s, "
            f"{np.mean(self.S_uncorrected):.4f} m s without control{''.join(bad)}>"
        )

    @property
    def deepest(self) -> FloatArray:
        """Deepest position of the edge beyond the line, (n,) [m]."""
        return self.metrics.deepest

    @property
    def reduction(self) -> FloatArray:
        """1 - S/S_uncorrected per scenario, 0 where there was nothing to reduce."""
        return metric_reduction(self.S, self.S_uncorrected)

    @property
    def mean_reduction(self) -> float:
        """1 - mean S / mean S_uncorrected over all scenarios, as in the paper; NaN where a scenario is not valid."""
        total = float(np.sum(self.S_uncorrected))
        if math.isnan(total):
            return math.nan
        return 1.0 - float(np.sum(self.S)) / total if total > 0 else 0.0

    def count(self, status: EventStatus) -> int:
        """Number of scenarios with that status."""
        return int(np.sum(self.status == status))


@dataclasses.dataclass(frozen=True)
class Run:
    """One design driven from the trigger on: m triggered scenarios in the takeover's order."""

    takeover: Takeover
    area: FloatArray | None  # (m,) [m s] Integral of |e_y| from the trigger to T; None where no control acted
    # As in `Outcome`, arrays of m
    status: npt.NDArray[np.int8]
    failed_solves: IntArray
    metrics: MetricValues
    step_seconds: FloatArray  # (k,) [s] Wall time of each call of the law's step; empty for a linear law
    # On request: paths (c, entries, PATH) as the compiled loops write them, of which rows, and which of these triggered
    paths: KeptPaths | None = None
    solver_log: SolverLog = dataclasses.field(default_factory=lambda: SolverLog.of([]))
    # On request, for each sample: row numbers of the scenarios that go on, and their plans as of `SteeringLaw.plan`
    planned: Sequence[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = ()
    assist_state: IntArray | None = None  # (m,) As in `Outcome`

    @property
    def trajectories(self) -> Trajectories | None:
        """The paths in the order of their rows."""
        return self.paths and _trajectories(self.takeover, *self.paths)

    @property
    def law_seconds(self) -> float:
        """Wall time of all steps together [s]."""
        return float(self.step_seconds.sum())

    def columns(self, windows: Sequence[Window]) -> FloatArray:
        """S and S_uncorrected of each of w windows, then the c metrics, of the recorded paths, (2 w + c, n)."""
        over = self.takeover
        scores = [over.S_uncorrected - (over.S_before if window == "control" else 0.0) for window in windows]
        recorded = [getattr(over.recorded, name) for name in METRIC_UNITS]
        return np.stack([*(S for S in scores for _ in range(2)), *recorded])

    def fill(self, out: FloatArray, windows: Sequence[Window]) -> None:
        """Write this run's numbers over those of `columns`: the same bits as in `outcome`, without its copies."""
        over, rows = self.takeover, self.takeover.rows
        if self.area is not None:
            for w, window in enumerate(windows):
                out[2 * w, rows] = self.area + (over.S_before[rows] if window == "departure" else 0.0)
        for i, name in enumerate(METRIC_UNITS, start=2 * len(windows)):
            out[i, rows] = getattr(self.metrics, name)

    def outcome(self, window: Window) -> Outcome:
        """Score the run over a window, with the scenarios in their own order; raises InputError for an unknown one."""
        if window not in get_args(Window):
            raise InputError("window", value=window, allowed=get_args(Window))
        over, rows = self.takeover, self.takeover.rows
        values = self.columns((window,))
        self.fill(values, (window,))
        values.flags.writeable = False  # metrics are views of it
        status = np.where(over.valid, EventStatus.NEVER_TRIGGERED, EventStatus.INVALID).astype(np.int8)
        status[rows] = self.status
        failed = np.zeros(over.scenarios.n, dtype=np.int64)
        failed[rows] = self.failed_solves
        state = (
            None if over.setup.options.driver.ideal else np.full(over.scenarios.n, AssistState.ARMED, dtype=np.int64)
        )
        if state is not None and self.assist_state is not None:
            state[rows] = self.assist_state
        return Outcome(
            window=window,
            # copies: a caller that keeps S alone does not keep the rest
            S=values[0].copy(),
            S_uncorrected=values[1].copy(),
            triggered=np.isfinite(over.t_s),
            status=status,
            t_s=over.t_s,
            metrics=MetricValues(**dict(zip(METRIC_UNITS, values[2:], strict=True))),
            failed_solves=failed,
            law_seconds=self.law_seconds,
            trajectories=self.trajectories,
            solver_log=self.solver_log.renamed(rows),
            side=over.scenarios.side,
            assist_state=state,
        )


PathChoice = bool | npt.ArrayLike

_MOST_SCORES: Final = 2**21  # Scores of linear laws that one call of the compiled loop holds
_DROP_BELOW: Final = 0.9  # Share of a batch that still runs, below which the others are dropped from it


def simulate(
    controller: Controller,
    scenarios: Scenarios,
    y_s: float = 0.2,
    *,
    setup: Setup | None = None,
    vehicle: VehicleParameters | BicycleModel | None = None,
    dt: float = 0.05,
    window: Window = "departure",
    initial_yaw_rate: InitialYawRate = "path",
    start: Start = "steady",
    options: PlantOptions | None = None,
    seed: int = 0,
    settle: float = SETTLE,
    plant_knowledge: PlantKnowledge = "nominal",
    trigger: Trigger = "distance",
    ttlc: float = TTLC,
    trajectories: bool | npt.ArrayLike = False,
    threads: int | None = None,
) -> Outcome:
    """Run one controller design on all scenarios and score it.

    Raises `InputError` for arguments outside what is allowed.

    Parameters
    ----------
    controller : Controller
        The design.
    scenarios : Scenarios
        n departures.
    y_s : float [m]
        Trigger threshold: control starts when the edge is further than this beyond the line; before it where negative.
    setup : Setup, optional
        Instead of the arguments below that are its fields.
    vehicle : VehicleParameters or BicycleModel, optional
        Table I by default; a `BicycleModel` also chooses the convention.
    window : {"departure", "control"}
        Integrate |e_y| over the whole departure, or from the trigger on (the paper's; not comparable between y_s).
    dt, initial_yaw_rate, start, options, seed, settle, plant_knowledge, trigger, ttlc
        See `Setup`.
    trajectories : bool or (c,) int
        Keep the paths: of all scenarios, or of those with these row numbers.
    threads : int, optional
        All cores this process may use by default. It changes no number.

    Returns
    -------
    Outcome
        Arrays of n in the order of `scenarios`.

    References
    ----------
    Zhao, Wang, LeBlanc (2017), section IV; the consistent reading integrates over the whole departure.

    Examples
    --------
    >>> from ldctoolkit import NoControl, PreviewProportional, Scenarios, simulate
    >>> scenarios = Scenarios.from_arrays(T=[2.0, 4.0], d_y=[0.3, 0.5], v_mean=[20.0, 28.0])
    >>> simulate(NoControl(), scenarios).reduction
    array([0., 0.])
    >>> simulate(PreviewProportional(), scenarios, y_s=0.1).triggered
    array([ True,  True])
    """
    if isinstance(controller, Scenarios):
        raise InputError("controller, scenarios", "swapped", allowed="simulate(controller, scenarios)")
    if not isinstance(scenarios, Scenarios):
        allowed = "Scenarios.from_arrays(...), ScenarioModel.sample(...)"
        raise InputError("scenarios", f"an object of type {type(scenarios).__name__}", allowed=allowed)
    expect("setup", setup, Setup | None)
    if vehicle is not None and not isinstance(vehicle, BicycleModel | VehicleParameters):
        raise InputError("vehicle", value=vehicle, allowed="VehicleParameters(...), BicycleModel(...), or None")
    model = vehicle if isinstance(vehicle, BicycleModel) else BicycleModel(vehicle or VehicleParameters())
    single = Setup(
        vehicle=model.parameters,
        convention=model.convention,
        options=PlantOptions() if options is None else options,
        seed=seed,
        dt=dt,
        initial_yaw_rate=initial_yaw_rate,
        start=start,
        settle=settle,
        plant_knowledge=plant_knowledge,
        trigger=trigger,
        ttlc=ttlc,
    )
    if setup is not None and single != Setup():
        raise InputError("setup", "given together with values that it holds", allowed="one of the two")
    takeover = Takeover.build(scenarios, single if setup is None else setup, y_s=y_s)
    return drive(controller, takeover, trajectories=trajectories, threads=threads).outcome(window)


def drive(
    controller: Controller, takeover: Takeover, *, trajectories: PathChoice = False, threads: int | None = None,
    plans: bool = False,
) -> Run:  # fmt: skip
    """Drive one design from the trigger to the end of every departure and of the settling horizon.

    Raises `InputError` if the design, its law or the result of a step is not what the interface promises.

    Parameters
    ----------
    controller, trajectories, threads
        As in `simulate`.
    takeover : Takeover
        Scenarios at their triggers.
    plans : bool
        Keep the plans of a law that defines `plan`.
    """
    rows = path_rows(trajectories, takeover.scenarios.n)
    law = _checked_law(controller, takeover)
    if isinstance(law, SteeringLaw):
        return _drive_general(law, takeover, controller.name, rows, threads, plans=plans)
    if isinstance(law, RecordedPath):
        return recorded_run(takeover)
    return _drive_linear([law], takeover, rows, threads)[0]


def drive_many(
    controllers: Iterable[Controller], takeover: Takeover, *, paths: bool = False, threads: int | None = None
) -> Iterator[Run]:
    """Drive several designs; linear laws go through the compiled loop together, so that scenarios are read once.

    Parameters
    ----------
    controllers : iterable of Controller
    takeover, threads
        As in `drive`.
    paths : bool
        Keep the paths of all that triggered, in the takeover's order, until the next design is driven.

    Yields
    ------
    Run
        In the order of the designs; the same bits, and the same errors, as from `drive`.
    """
    rows, most = (takeover.rows, 1) if paths else (None, max(1, _MOST_SCORES // max(1, takeover.m * data.SCORES)))
    waiting: list[LinearLaw] = []
    for controller in controllers:
        law = _checked_law(controller, takeover)
        if waiting and not (
            isinstance(law, LinearLaw)
            and len(waiting) < most
            and shape_of(law) == shape_of(waiting[0])
            and law.knows_actuator == waiting[0].knows_actuator
        ):
            yield from _drive_linear(waiting, takeover, rows, threads)
            waiting = []
        if isinstance(law, LinearLaw):
            waiting.append(law)
        elif isinstance(law, SteeringLaw):
            yield _drive_general(law, takeover, controller.name, rows, threads)
        else:
            yield recorded_run(takeover)
    if waiting:
        yield from _drive_linear(waiting, takeover, rows, threads)


def _checked_law(controller: Controller, takeover: Takeover) -> Law:
    check_controller(controller)
    law = check_law(controller.prepare(takeover.plant), takeover.m, controller.name)
    if isinstance(law, LinearLaw) and takeover.setup.vehicle_model is not None:  # sample by sample, as any other
        return dataclasses.replace(LinearSteps.of(law, takeover.plant), measured=True)
    return law


def _drive_linear(laws: list[LinearLaw], takeover: Takeover, rows: IntArray | None, threads: int | None) -> list[Run]:
    from ldctoolkit.simulation.kernel import entry

    d, m = len(laws), takeover.m
    exactly = takeover.stiff < m and not laws[0].knows_actuator
    times = np.array([law.preview_times for law in laws], dtype=np.float64)
    lookaheads, past = shape_of(laws[0])
    table = law_tables(laws, takeover.scratch(d * m * (data.LAW + 2 * lookaheads + past)))
    scene, setting, bend = takeover.scene, takeover.setting.copy(), takeover.recorded_bend
    setting[data.COMMAND_RING] = max(setting[data.COMMAND_RING], past + 2)
    score = np.full((d, data.SCORES, m), np.nan)  # a scenario that is left out stays visible
    diverged, failed = np.zeros((d, m), dtype=np.bool_), np.zeros((d, m), dtype=np.int64)
    paths, path_row, kept = takeover.empty_paths(rows, reused=rows is takeover.rows)
    steps = scene[:, data.STEPS]

    def drive_any(rows: IntArray, score: FloatArray, diverged: BoolArray, failed: IntArray) -> None:
        """The blocks of these rows, by the method of Runge and Kutta."""
        blocks = np.unique(rows // LANES)

        def work(first: int, last: int) -> None:
            rows = (blocks[first:last, None] * LANES + np.arange(LANES)).ravel()
            most = int(steps[rows[rows < m]].max(initial=0))
            work = entry.scratch(setting, table, lookaheads, most, float(scene[:, data.SUBSTEPS].max(initial=1.0)))
            out = score, diverged, failed, work, np.zeros(most + 1, dtype=np.int64)
            inputs = scene, setting, table, times, bend, takeover.recorded_steering, paths, path_row
            entry.drive_any(*inputs, blocks[first:last], *out)

        in_threads(work, blocks.size, threads, SCENARIOS_A_TASK // 4 // LANES)

    if not exactly:
        drive_any(np.arange(m), score, diverged, failed)
    elif m:
        exact, stiff = takeover.exact, np.arange(takeover.stiff)
        exact_path_row = path_row.copy()
        exact_path_row[stiff], path_row[stiff.size :] = -1, -1  # a block may hold rows of both kinds

        def work(first: int, last: int) -> None:
            most = int(steps[first * LANES : last * LANES].max(initial=0))
            out = score, diverged, failed, entry.scratch(setting, table, lookaheads, most)
            inputs = scene, exact, setting, table, times, bend, paths, exact_path_row
            entry.drive_lanes(*inputs, first, last, *out)

        in_threads(work, -(-m // LANES), threads, SCENARIOS_A_TASK // LANES)
        if stiff.size:
            stiff_score, stiff_diverged, stiff_failed = np.empty_like(score), diverged.copy(), failed.copy()
            drive_any(stiff, stiff_score, stiff_diverged, stiff_failed)
            score[:, :, stiff], diverged[:, stiff] = stiff_score[:, :, stiff], stiff_diverged[:, stiff]
            failed[:, stiff] = stiff_failed[:, stiff]
    return [_run_of_scores(takeover, score[i], diverged[i], failed[i], np.zeros(0), kept) for i in range(d)]


# ---------------------------------------------------------------------- a law that is called sample by sample


def _drive_general(
    law: SteeringLaw, takeover: Takeover, name: str, rows: IntArray | None, threads: int | None, *, plans: bool = False
) -> Run:
    """Drive a law, solved for the m triggered scenarios: one call a sample for all that still go on, in this thread."""
    m = takeover.m
    paths, path_row, kept = takeover.empty_paths(rows, reused=rows is takeover.rows)
    plants = stretches(takeover, paths, path_row, threads)
    times = np.ascontiguousarray(law.preview_times, dtype=np.float64)
    last, failed = takeover.delta_0.copy(), np.zeros(m, dtype=np.int64)
    beyond, alive = np.zeros(m, dtype=np.bool_), np.ones(m, dtype=np.bool_)
    # the scenarios that the law still holds: the first ones, unless others ended before them; which of them go on
    batch: IntArray | slice = slice(0, m)
    start, end, going = takeover.start, m, alive
    options = takeover.setup.options
    filtered, held = options.sensors.kalman is not None, not options.driver.ideal
    may_yield = held or options.actuator.delta_max is not None
    state, unseen = law.init(m), np.zeros((2, m))
    linear = isinstance(law, LinearSteps) and law.measured  # whose time is not a law's own
    step_seconds: list[float] = []
    sample, count = -1, m
    calls: list[tuple[IntArray, int, SolverCalls]] = []
    planned: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
    while count:
        # made anew: the law may keep them, and write into them
        shown = [np.zeros((end, 4)), np.zeros((end, times.size)), np.zeros((end, times.size)), np.zeros(end)]
        shown += list(np.zeros((2, end)) if may_yield else unseen)
        for plant in plants:
            plant.go_on(sample, last, alive, times, shown)
        sample += 1
        going = alive[batch]
        count_before, count = count, int(np.count_nonzero(going))
        if not count:
            break
        if count < min(count_before, _DROP_BELOW * start.size):
            active = np.flatnonzero(going)
            rows_left = np.arange(m)[batch][active]
            smaller = check_taken(law.take(active, state), count, name, times)
            if smaller is not None:
                law, state = smaller
                end = int(rows_left[-1]) + 1
                batch = slice(0, end) if end == count else rows_left
                start, going = takeover.start[batch], alive[batch]
        frame = np.concatenate([plant.new_frame(sample) for plant in plants])[batch] if filtered else None
        x, yaw_rate, heading, wheel, torque, yields = (values[batch] for values in shown)
        preview = Preview(
            yaw_rate, heading, wheel, frame, torque if held else None, yields > 0.0 if may_yield else None
        )
        t, previous = start + sample * takeover.setup.dt, np.where(going, last[batch], 0.0)
        started = time.perf_counter()
        result = law.step(t, x, preview, previous, state)
        step_seconds += [] if linear else [time.perf_counter() - started]
        delta, after, status = check_step(result, start.size, name)
        if plans and (plan := law.plan((x, preview, np.where(going, last[batch], 0.0), state), after)) is not None:
            planned.append((takeover.rows[batch][going], plan[0], plan[1][going], plan[2][going]))
        state = after
        solved = law.solver_calls(state)
        if solved is not None:
            check_calls(solved, start.size, name)
            solved = solved.of(np.flatnonzero(going))
            if solved.position.size:
                calls.append((np.arange(m)[batch][solved.position], sample, solved))
        right = np.isfinite(delta)
        if status.any() or not right.all():
            delta = np.where(right, delta, last[batch])
            failed[batch] += going & (~right | (status == EventStatus.SOLVER_FAILED))
            beyond[batch] |= going & (status == EventStatus.BEYOND_DELTA_MAX)
        last[batch] = delta
    results = [plant.scores() for plant in plants]
    score, diverged = (np.concatenate(values, axis=-1) for values in zip(*results, strict=True))
    run = _run_of_scores(takeover, score, diverged, failed, np.array(step_seconds), kept)
    status = np.where(beyond & (run.status == EventStatus.OK), np.int8(EventStatus.BEYOND_DELTA_MAX), run.status)
    return dataclasses.replace(run, status=status, solver_log=SolverLog.of(calls), planned=planned)


# ------------------------------------------------------------------------------------------------ paths, threads, runs


def path_rows(trajectories: PathChoice, n: int, name: str = "trajectories") -> IntArray | None:
    """Row numbers of the scenarios whose paths are kept; None for no paths at all."""
    if isinstance(trajectories, bool | np.bool_):
        return np.arange(n) if trajectories else None
    rows = np.atleast_1d(np.asarray(unmasked(trajectories)))
    if rows.size == 0:
        rows = rows.astype(np.int64)
    if rows.ndim != 1 or rows.dtype.kind not in "iu":
        raise InputError(name, value=trajectories, allowed="true, false, or row numbers of scenarios")
    outside = (rows < 0) | (rows >= n)
    if outside.any():
        raise InputError(name, "is not the number of a scenario", value=int(rows[outside][0]), allowed=f"0 to {n - 1}")
    if np.unique(rows).size != rows.size:
        raise InputError(name, "a row number is given twice", allowed="each of them once")
    return rows.astype(np.int64)


def recorded_run(takeover: Takeover) -> Run:
    """The recorded paths."""
    rows, recorded = takeover.rows, takeover.recorded
    metrics = MetricValues(**{name: getattr(recorded, name)[rows] for name in METRIC_UNITS})
    zeros = np.zeros(takeover.m, dtype=np.int64)
    return Run(takeover, None, zeros.astype(np.int8), zeros, metrics, np.zeros(0), None)


def _run_of_scores(
    takeover: Takeover,
    score: FloatArray,
    diverged: BoolArray,
    failed: IntArray,
    step_seconds: FloatArray,
    paths: KeptPaths | None,
) -> Run:
    """A run from scores (SCORES, m), which scenarios diverged (m,), and failed commands (m,)."""
    status = np.where(failed > 0, EventStatus.SOLVER_FAILED, EventStatus.OK)
    status = np.where(diverged, EventStatus.DIVERGED, status).astype(np.int8)
    edge = takeover.setup.vehicle.edge_offset
    # before the trigger the vehicle was on the recorded path
    area, values, state = score[0], dict(zip(METRIC_UNITS, score[1:-1], strict=True)), None
    if takeover.setup.options.driver.ideal:
        values |= dict.fromkeys(DRIVER_METRICS, np.full(takeover.m, np.nan))
    else:
        state = score[-1].astype(np.int64)
        values["driver_torque_mean"] = values["driver_torque_mean"] / takeover.driven_for
    values["deepest"] = np.maximum(values["deepest"] - edge, takeover.deepest_before)
    values["dtle"] = -np.maximum(values["dtle"] - edge, takeover.front_before)
    values["opposite_crossing"] = np.maximum(values["opposite_crossing"] - edge, 0.0)
    # a trigger before the line: the edge may never be outside
    inside = (takeover.x_0[:, 0] < edge) & (values["deepest"] <= 0.0)
    values["t_back"] = np.where(inside, takeover.start, values["t_back"])
    metrics = MetricValues(**values)
    return Run(takeover, area, status, failed, metrics, step_seconds, paths, assist_state=state)


def _trajectories(over: Takeover, paths: FloatArray, rows: IntArray, triggered: IntArray) -> Trajectories:
    """Paths of the chosen rows; NaN where a scenario never triggered."""
    used = np.isfinite(paths[:, :, data.P_TIME]).sum(axis=1).max(initial=1)
    out = np.full((rows.size, int(used), data.PATH), np.nan)
    out[triggered] = paths[:, : int(used)]
    at_trigger = np.full(over.scenarios.n, np.nan)
    if over.setup.options.speed == "frozen":
        at_trigger[over.rows] = over.plant.v
    # after the trigger the loop drives the fitted speed and curvature, of recorded paths too
    path = dataclasses.replace(over.path.take(rows), recorded=None)
    x = out[:, :, data.P_X : data.P_DELTA]
    t, delta, a_y = (out[:, :, column] for column in (data.P_TIME, data.P_DELTA, data.P_A_Y))
    columns = data.P_TORQUE, data.P_ASSIST, data.P_AUTHORITY, data.P_STATE
    held = () if over.setup.options.driver.ideal else (out[:, :, column] for column in columns)
    return Trajectories(rows, t, x, delta, a_y, path, at_trigger[rows], *held)
