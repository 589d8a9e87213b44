"""Departures and designs of the explorer: their selection by a stated rule, and their simulated motion."""

import dataclasses
import hashlib
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.control import Controller, EventStatus
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import Plans, Takeover, drive

from ..design import PAPER_LAW, is_paper_design, named_designs
from ..results import FAILED_STATUSES
from ..storage.measure_table import remembered
from .charts import Axis, Chart, Series, law_styles
from .context import Context

MOST_DESIGNS: Final = 8
COUNT: Final = 60  # departures in the explorer beside those requested

STATUS_TEXT: Final = {
    EventStatus.OK: "driven to the end",
    EventStatus.NEVER_TRIGGERED: "no intervention",
    EventStatus.SOLVER_FAILED: "a solve failed, the fallback steered",
    EventStatus.DIVERGED: "diverged",
    EventStatus.TIMED_OUT: "ended by the time limit",
    EventStatus.INVALID: "cannot be driven",
    EventStatus.CRASHED: "the law crashed",
    EventStatus.BEYOND_DELTA_MAX: "taken over beyond delta_max, driven to the end",
}
"""Text of each status of a departure."""

_NOT_AGAIN: Final = (EventStatus.TIMED_OUT, EventStatus.CRASHED)
_GOLDEN: Final = 0.6180339887498949
"""Fractional parts of its first multiples are spread evenly for every number of multiples."""


def rows_of_numbers(scenarios: Scenarios, numbers: Sequence[int]) -> tuple[int, ...]:
    """Rows of the scenarios with these numbers, without repetitions."""
    rows = []
    for number in numbers:
        matching = np.flatnonzero(scenarios.index == number)
        if not matching.size:
            near = int(scenarios.index[np.argmin(np.abs(scenarios.index - number))])
            raise InputError(
                "departure", value=number, hint=f"no departure with this number can be simulated; the nearest is {near}"
            )
        rows.append(int(matching[0]))
    return tuple(dict.fromkeys(rows))


@dataclasses.dataclass(frozen=True)
class ExplorerDesign:
    """A design of the explorer: its position in the ranking, and the reason for its selection."""

    position: int
    reason: str


@dataclasses.dataclass(frozen=True)
class ExplorerDeparture:
    """A departure of the explorer: its row, and its roles; those that are spread over S have none."""

    row: int
    roles: tuple[str, ...]


def explorer_designs(context: Context) -> tuple[ExplorerDesign, ...]:
    """The shown design, those requested, the baseline, the best of each law, Table I, the second of the ranking."""
    ranking = context.ranking
    requested = named_designs(ranking.designs, context.report.shown_designs)
    paper = [i for i, design in enumerate(ranking.designs) if is_paper_design(design)]
    paper_law = [i for i, design in enumerate(ranking.designs) if design.law == PAPER_LAW][:1]
    reasons = (
        (context.shown_name.removeprefix("the "), [context.shown]),
        ("requested", [ranking.designs.index(design) for design in requested]),
        ("baseline", [] if ranking.baseline is None else [ranking.baseline]),
        ("best of its law", [*context.best_of_each_law[1:6], *paper_law]),
        ("Table I of the paper", paper),
        ("second of the ranking", [1] if len(ranking) > 1 else []),
    )
    selection: dict[int, ExplorerDesign] = {}
    for reason, positions in reasons:
        for position in positions:
            passive = ranking.designs[position].is_baseline and position != context.shown
            if not passive and (reason == "requested" or len(selection) < MOST_DESIGNS):
                selection.setdefault(position, ExplorerDesign(position, reason))
    return tuple(selection.values())


def explorer_departures(
    context: Context, designs: Sequence[ExplorerDesign], count: int = COUNT
) -> tuple[ExplorerDeparture, ...]:
    """The requested departures, then those with a role, then others evenly over the ranks of S."""
    n = context.scenarios.n
    roles: dict[int, list[str]] = {}
    for row in rows_of_numbers(context.scenarios, context.report.departures):
        roles[row] = ["requested"]
    for row, role in _named(context, designs):
        roles.setdefault(row, []).append(role)
    S = context.S(designs[0].position)
    order, room = np.argsort(S, kind="stable"), max(count - len(roles), 0)
    ranks = np.arange(n) if n <= count else np.unique(np.rint(np.linspace(0, n - 1, room)).astype(np.int64))
    ranks = ranks[np.argsort((np.arange(ranks.size) * _GOLDEN) % 1.0, kind="stable")]
    for row in order[ranks].tolist():
        roles.setdefault(row, [])
    return tuple(ExplorerDeparture(row, tuple(names)) for row, names in roles.items())


def _named(context: Context, designs: Sequence[ExplorerDesign]) -> list[tuple[int, str]]:
    """Rows and roles: failures of all designs, then extreme and median departures of the first design on each side."""
    results, position = context.results, designs[0].position
    index, S = int(context.ranking.index[position]), context.S(position)
    deepest, a_y = results.metrics.deepest[index], results.metrics.a_y_added_peak[index]
    acted = results.status[index] != EventStatus.NEVER_TRIGGERED
    named = []
    for entry in designs:
        status = results.status[int(context.ranking.index[entry.position])]
        rows = np.flatnonzero(np.isin(status, FAILED_STATUSES))
        if rows.size:
            design = context.ranking.designs[entry.position]
            named.append((int(rows[0]), f"{STATUS_TEXT[EventStatus(int(status[rows[0]]))]} ({design.law})"))
    for side, name in ((LEFT, "left"), (RIGHT, "right")):
        side_rows = np.flatnonzero(context.scenarios.side == side)
        if not side_rows.size:
            continue
        order = side_rows[np.argsort(S[side_rows], kind="stable")]
        named += [(int(order[-1]), f"largest S, {name}"), (int(order[(order.size - 1) // 2]), f"median S, {name}")]
        named += [(int(side_rows[np.argmax(deepest[side_rows])]), f"deepest, {name}")]
        driven = side_rows[acted[side_rows] & np.isfinite(a_y[side_rows])]
        if driven.size:
            named.append((int(driven[np.argmax(a_y[driven])]), f"largest added a_y, {name}"))
    return named


# ------------------------------------------------------------------------------------------------ driven again


class DesignPaths(NamedTuple):
    """A design on the p picked departures; arrays (p, k), NaN after the end and where there is no path."""

    # (p, s, N + 2) of every `plan_stride`-th sample: seconds from it to its plan's begin, and y along it; NaN: no plan
    plan: FloatArray
    t: FloatArray  # [s] Time since the crossing: the controller's samples from the trigger on, T, and the end
    y: FloatArray  # [m] Edge beyond the line, outward
    delta: FloatArray  # [rad] Steering angle of the wheel just after that time
    a_y: FloatArray  # [m/s^2] Lateral acceleration just after it


def plan_stride(dt: float) -> int:
    """Samples between two plans that are shown: a quarter of a second."""
    return max(1, round(0.25 / dt))


@dataclasses.dataclass(frozen=True)
class Replay:
    """Simulated departures; `mismatch` is the largest relative difference between a new and a stored score."""

    departures: tuple[ExplorerDeparture, ...]
    designs: tuple[ExplorerDesign, ...]
    scenarios: Scenarios
    recorded: UncorrectedPath
    paths: tuple[DesignPaths, ...]
    mismatch: float


def replay(
    context: Context, departures: Sequence[ExplorerDeparture], designs: tuple[ExplorerDesign, ...], name: str = "paths"
) -> Replay:
    """Paths of designs with vehicle, plant, seed and clock of the study: simulated once, then read from DIR/NAME."""
    scenarios = context.scenarios.take([departure.row for departure in departures])
    setup, ids = context.report.setup, [context.ranking.designs[entry.position].id for entry in designs]

    def drive_all() -> dict[str, FloatArray]:
        driven = [_driven(context, departures, scenarios, entry) for entry in designs]
        arrays = {id: np.stack(paths[1:]) for id, (paths, _) in zip(ids, driven, strict=True)}
        arrays |= {f"{id} plan": paths.plan for id, (paths, _) in zip(ids, driven, strict=True)}
        return arrays | {"mismatch": np.array(max((mismatch for _, mismatch in driven), default=0.0))}

    content = hashlib.sha256(b"".join(array.tobytes() for array in scenarios.arrays())).hexdigest()
    key = [ids, content, dataclasses.asdict(setup), context.results.window, DesignPaths._fields]
    arrays = remembered(context.report.folder, name, key, drive_all)
    paths = tuple(DesignPaths(arrays[f"{id} plan"], *arrays[id]) for id in ids)
    recorded = UncorrectedPath.of(scenarios, setup.options.residuals, setup.seed)
    return Replay(tuple(departures), designs, scenarios, recorded, paths, float(arrays["mismatch"]))


def _driven(
    context: Context, departures: Sequence[ExplorerDeparture], scenarios: Scenarios, entry: ExplorerDesign
) -> tuple[DesignPaths, float]:
    """Driven paths of a design, and the largest relative deviation of S from the stored one."""
    setup, results, design = context.report.setup, context.results, context.ranking.designs[entry.position]
    index = int(context.ranking.index[entry.position])
    rows = np.array([departure.row for departure in departures], dtype=np.int64)
    to_drive = ~np.isin(results.status[index][rows], _NOT_AGAIN)
    if design.batch < Controller.batch:  # slow laws declare a small batch
        to_drive[design.batch :] = False
    driven_rows = np.flatnonzero(to_drive)
    none = np.zeros((len(departures), 0))
    no_paths = DesignPaths(none[:, :, None], *([none] * 4))
    if not driven_rows.size:
        return no_paths, 0.0
    over = Takeover.build(scenarios.take(driven_rows), setup, y_s=design.y_s)
    run = drive(design.controller(setup.convention), over, trajectories=True, plans=True)
    outcome = run.outcome(results.window)
    stored = results.S[index][rows[driven_rows]]
    off = float(np.max(np.abs(outcome.S - stored) / np.maximum(np.abs(stored), 1e-9)))
    paths = outcome.trajectories
    if paths is None:  # the law never intervenes
        return no_paths, off
    shown = run.planned[:: plan_stride(setup.dt)]
    plan = np.full((len(departures), len(shown), shown[0][1].size + 1 if shown else 1), np.nan)
    for j, (planned, times, states, _) in enumerate(shown):
        plan[driven_rows[planned], j, 0] = times[0]
        plan[driven_rows[planned], j, 1:] = states[:, :, 0] - setup.vehicle.edge_offset
    t, y, delta, a_y = (np.full((len(departures), paths.t.shape[1]), np.nan) for _ in range(4))
    t[driven_rows], delta[driven_rows] = paths.t, paths.delta
    y[driven_rows] = paths.x[:, :, 0] - setup.vehicle.edge_offset
    a_y[driven_rows] = paths.a_y
    return DesignPaths(plan, t, y, delta, a_y), off


def plan_chart(plans: Plans, i: int) -> Chart:
    """The plan of the trigger of scenario i, and thin those of later samples, over what came of them."""
    rows, paths, edge = np.flatnonzero(plans.row == i), plans.outcome.trajectories, plans.setup.vehicle.edge_offset
    if not rows.size or paths is None:
        raise InputError("i", "has no plans", value=i, allowed="a scenario that triggers")
    driven, planned = law_styles(["driven", "planned"]).values()
    t, y = plans.t[rows], plans.x[rows, :, 0] - edge
    later = [Series("", t[k], y[k], planned, kind="thin") for k in range(0, rows.size, plan_stride(plans.setup.dt))]
    came = Series("driven", paths.t[i], paths.x[i, :, 0] - edge, driven)
    series = [came, *later, Series("planned at the trigger", t[0], y[0], planned, kind="started")]
    x_axis = Axis.around("Time since the crossing [s]", t, came.x)
    y_axis = Axis.around("Edge beyond the line [m]", y, came.y)
    return Chart("plan", "Plans and what came of them", x_axis, y_axis, series, level=0.0)
