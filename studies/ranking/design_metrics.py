"""Metrics of the designs of a study: means, tails, shares, counts, what a release requires, and the Pareto front."""

from __future__ import annotations

import dataclasses
import functools
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.clusters import design_effect, several
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import DTLE_LIMIT, MEAN_OF_ALL, METRICS, Interventions, Metric, measured_on, share_within_dtle
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover
from ldctoolkit.vehicle import VehicleModel

from ..design import NO_CONTROL, Design
from ..measures import DEPARTURES, first_of_each_side, vehicle_measures
from ..requirements import friction, metric, metric_values
from ..results import StudyResults, status_among
from ..storage.run_table import release
from .inference import binomial_interval, order_statistics, row_blocks, row_means

_FEW = 8  # order statistics up to which a partial sort is faster than a full sort


def masked_mean(values: FloatArray, among: BoolArray) -> FloatArray:
    """Mean of the marked values in each row; NaN for a row without any."""
    count = among.sum(axis=1)
    total = np.where(among, values, 0.0).sum(axis=1)
    result: FloatArray = np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)
    return result


def masked_max(values: FloatArray, among: BoolArray) -> FloatArray:
    """Largest marked value in each row; NaN for a row without any."""
    largest = np.where(among, values, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(among.any(axis=1), largest, np.nan)


def masked_quantile(values: FloatArray, among: BoolArray, share: float) -> FloatArray:
    """Quantile of the marked values in each row, linear between neighbours; NaN for a row without any.

    Infinite values are allowed: between a finite and an infinite neighbour it is infinite.
    """
    count = among.sum(axis=1)
    ordered = np.where(among, values, np.inf)
    position = share * np.maximum(count - 1, 0)
    low = np.floor(position).astype(np.int64)
    high = np.minimum(low + 1, np.maximum(count - 1, 0))
    needed = np.unique([low, high])
    if 0 < needed.size <= _FEW:
        ordered.partition(needed, axis=1)  # three times faster than a full sort
    else:
        ordered.sort(axis=1)
    rows = np.arange(len(count))
    below, above, part = ordered[rows, low], ordered[rows, high], position - low
    with np.errstate(invalid="ignore"):  # inf - inf: the branch is not taken
        between = below + (above - below) * part
    result = np.where((part == 0) | (below == above), below, between)
    # NaN is sorted behind the infinities that replace unmarked values
    return np.where((count > 0) & ~np.isnan(ordered).any(axis=1), result, np.nan)


Values = dict[str, FloatArray]

_BLOCK_ENTRIES: Final = 500_000  # runs in a block (4 MB for each metric); results do not depend on it

_MOST_THREADS: Final = 4


def release_metrics(results: StudyResults, *, D_y: float) -> Values:
    """All metrics of the designs that are derived from metrics of their scenarios."""
    acted, d_y = _acted(results), results.scenarios.d_y

    def of(group: Sequence[Metric], names: Sequence[str]) -> Callable[..., Values]:
        def values(acted: BoolArray, *columns: FloatArray) -> Values:
            by, values_of = Interventions(acted, d_y, D_y), dict(zip(names, columns, strict=True))
            return {metric.name: _aggregated(metric, by, *(values_of[name] for name in metric.of)) for metric in group}

        return values

    metrics: Values = {}
    for group in _groups(results):
        names = tuple(dict.fromkeys(name for metric in group for name in metric.of))
        metrics |= _by_blocks(of(group, names), acted, [results.of_scenarios(name) for name in names])
    return metrics


def _acted(results: StudyResults) -> BoolArray:
    acted = ~status_among(results.status, (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID))
    acted[[design.is_baseline for design in results.designs]] = False
    return acted


def _recorded_dtle(results: StudyResults, setup: Setup | None) -> FloatArray:
    """DTLE without control, (n,)."""
    for i, design in enumerate(results.designs):
        if design.is_baseline:
            dtle: FloatArray = results.metrics.dtle[i]
            return dtle
    setup = setup or Setup(convention=results.convention)
    return Takeover.build(results.scenarios, setup, y_s=0.0).recorded.dtle


def sampling_intervals(
    results: StudyResults, metrics: DesignMetrics, names: list[str], D_y: float, level: float, setup: Setup | None
) -> FloatArray:
    """Values of k metrics with the ends of pointwise intervals, which quantiles and shares have, (k, 3, d).

    The intervals are those of the population that the scenarios are drawn from. An end is infinite if there are too few
    scenarios. Departures that weights repeat in the sample count with Kish's effective number.
    """
    d_y = results.scenarios.d_y
    departures = np.stack([getattr(results.scenarios, name) for name in ("side", *PARAMETER_NAMES)], axis=1)
    _, inverse, copies = np.unique(departures, axis=0, return_inverse=True, return_counts=True)
    order, starts = np.argsort(inverse, kind="stable"), np.cumsum(copies) - copies
    without = _recorded_dtle(results, setup)
    cluster = several(results.scenarios.cluster)

    def ends(metric: Metric, acted: BoolArray, *columns: FloatArray) -> Values:
        if metric.share is not None:  # 0 or 1 for a single departure, or NaN if the share does not count it
            alone = Interventions(acted.reshape(-1, 1), np.tile(d_y, len(acted))[:, None], D_y)
            values = np.reshape(metric.share(alone, *(column.reshape(-1, 1) for column in columns)), acted.shape)
        else:
            values = columns[0] if metric.over == "all" else np.where(acted, columns[0], np.nan)
        known = ~np.isnan(values)
        times = known if starts.size == order.size else np.add.reduceat(known[:, order], starts, axis=1, dtype=np.int64)
        count, squares = times.sum(axis=1), (times * times).sum(axis=1)
        n = np.divide(count**2, squares, out=np.zeros(len(count)), where=squares > 0)
        if cluster is not None:
            n = count / _design_effect(values, _quantile_of(metric), cluster)
        if p := _quantile_of(metric):
            first, last = order_statistics(np.floor(n), p, level)
            ordered, rows, each = np.sort(values, axis=1), np.arange(len(count)), count / np.maximum(np.floor(n), 1.0)
            below, above = np.floor(first * each).astype(np.int64), np.ceil(last * each).astype(np.int64)
            low = np.where(below > 0, ordered[rows, below - 1], -np.inf)
            high = np.where(above <= count, ordered[rows, np.minimum(above, count) - 1], np.inf)
        elif metric.name == "within_dtle_gain":  # by Bonferroni, from the shares of gains and of losses
            shares = np.stack([(values > 0).mean(axis=1), (values < 0).mean(axis=1)])
            least, most = binomial_interval(shares * n, n, 0.5 * (1.0 + level))
            low, high = least[0] - most[1], most[0] - least[1]
        else:
            low, high = binomial_interval(np.nansum(values, axis=1) / np.maximum(count, 1) * n, n, level)
        return {"low": np.where(count > 0, low, np.nan), "high": np.where(count > 0, high, np.nan)}

    within = [1.0 * (dtle >= DTLE_LIMIT) for dtle in (results.metrics.dtle, without)]
    intervals = np.full((len(names), 3, len(results.designs)), np.nan)
    for row, definition in zip(intervals, map(metric, names), strict=True):
        row[0] = metric_values(definition.name, metrics)
        columns = {"S_p95": [results.counted], "triggered": [results.status != EventStatus.NEVER_TRIGGERED],
                   "within_dtle_gain": [within[0] - within[1]]}.get(definition.name)  # fmt: skip
        if columns is None and (definition.share is not None or _quantile_of(definition)):
            columns = [results.of_scenarios(name) for name in definition.of]
        if definition.name == "comfortable_worst":  # whether it acts does not depend on the vehicle
            driven = np.isin(results.scenarios.index, first_of_each_side(results.scenarios, DEPARTURES).index)
            n = _acted(results)[:, driven].sum(axis=1)
            row[1:] = np.array(binomial_interval(row[0] * n, n, level)) + 0.0 * row[0]
        elif columns is not None:
            intervals_of = _by_blocks(functools.partial(ends, definition), _acted(results), columns)
            row[1:] = intervals_of["low"], intervals_of["high"]
    return intervals


def _design_effect(values: FloatArray, p: float, cluster: IntArray) -> FloatArray:
    """How many recorded departures of one trip tell as much as one independent one, of a share or the p-quantile."""
    known = ~np.isnan(values)
    if p:
        rank = np.maximum(np.ceil(p * known.sum(axis=1)) - 1, 0).astype(np.int64)[:, None]
        values = np.where(known, values > np.take_along_axis(np.sort(values, axis=1), rank, axis=1), np.nan)
    share = np.nansum(values, axis=1) / np.maximum(known.sum(axis=1), 1)
    return design_effect(np.where(known, values - share[:, None], 0.0), cluster)


def _quantile_of(metric: Metric) -> float:
    """Which quantile a metric is; 0 for none."""
    text = {"S_p95": "p95", "median": "p50"}.get(metric.aggregate or metric.name, metric.aggregate)
    return float(text[1:]) / 100.0 if re.fullmatch(r"p\d+", text) else 0.0


def _groups(results: StudyResults) -> list[list[Metric]]:
    """Group the metrics that share a metric of the scenarios, so that each of the latter is read once."""
    groups: list[list[Metric]] = []
    users = (row for metric in results.user_rows.values() for row in metric.rows.values())
    for added in (*measured_on(results.options, METRICS).values(), *users):
        if added.aggregate or added.share is not None:
            joined = [group for group in groups if any(set(added.of) & set(other.of) for other in group)]
            groups = [group for group in groups if group not in joined]
            groups.append([*(other for group in joined for other in group), added])
    return groups


def _aggregated(metric: Metric, by: Interventions, *values: FloatArray) -> FloatArray:
    """Values of a metric of designs, over all departures or the interventions."""
    if metric.share is not None:
        return np.asarray(metric.share(by, *values))
    (only,) = values
    of_all = metric.over == "all"
    if metric.aggregate in ("mean", MEAN_OF_ALL):
        return np.asarray(only.mean(axis=1)) if of_all else masked_mean(only, by.acted)
    if metric.aggregate == "max":
        return np.asarray(only.max(axis=1)) if of_all else masked_max(only, by.acted)
    if metric.aggregate == "min":
        return np.asarray(only.min(axis=1)) if of_all else -masked_max(-only, by.acted)
    share = 0.5 if metric.aggregate == "median" else float(metric.aggregate[1:]) / 100.0
    return np.asarray(np.quantile(only, share, axis=1)) if of_all else masked_quantile(only, by.acted, share)


def _by_blocks(function: Callable[..., Values], acted: BoolArray, columns: Sequence[FloatArray]) -> Values:
    """Evaluate metrics by blocks of designs in threads, from interventions and metrics of scenarios, (d, n)."""

    def evaluate(first: int) -> Values:
        rows = slice(first, first + size)
        # contiguous rows: the last bit of a row's sum depends on the memory layout
        return function(acted[rows], *(np.ascontiguousarray(column[rows], dtype=np.float64) for column in columns))

    size = max(1, _BLOCK_ENTRIES // acted.shape[1])
    starts = range(0, acted.shape[0], size)
    with ThreadPoolExecutor(max(1, min(_MOST_THREADS, os.cpu_count() or 1, len(starts)))) as pool:
        blocks = list(pool.map(evaluate, starts))
    for column in columns:
        release(column)
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


_FEWEST_DIGITS = 6  # of an identifier, so that no law's name is read as an identifier


def find_baseline(baseline: str, results: StudyResults) -> int | None:
    """Position of the baseline in `results.designs`; None where it failed, or there is none."""
    matching = _matching(baseline or NO_CONTROL, results.designs)
    if matching:
        return matching[0]
    failed = [failure.design for failure in results.failed]
    if not baseline or _matching(baseline, failed):
        return None
    laws = list(dict.fromkeys(design.law for design in (*results.designs, *failed)))
    raise InputError(
        "ranking.baseline",
        f"is neither a law of this study nor the start of a design's identifier ({_FEWEST_DIGITS} digits or more)",
        value=baseline,
        allowed=laws,
    )


def _matching(baseline: str, designs: Sequence[Design]) -> list[int]:
    of_law = [i for i, design in enumerate(designs) if design.law == baseline]
    if of_law or not re.fullmatch(rf"[0-9a-f]{{{_FEWEST_DIGITS},12}}", baseline):
        return of_law
    of_start = [i for i, design in enumerate(designs) if design.id.startswith(baseline)]
    if len(of_start) > 1:
        raise InputError(
            "ranking.baseline",
            f"is the start of {len(of_start)} identifiers",
            value=baseline,
            allowed=f"more digits, as {designs[of_start[0]].id!r}",
        )
    return of_start


def tail_metrics(values: FloatArray, percent: int = 95) -> tuple[FloatArray, FloatArray]:
    """Quantile of every row, and mean of its worst (100 - percent) %, the last value weighted with its share.

    The latter is CVaR (R. Rockafellar, S. Uryasev, J. Banking and Finance 26, 2002).
    """
    d, n = values.shape
    quantile, cvar = np.empty(d), np.empty(d)
    whole, rest = divmod(n * (100 - percent), 100)  # in whole numbers: 0.05 n is not exact
    size = max(1, _BLOCK_ENTRIES // n)
    position = percent * (n - 1) / 100
    low = math.floor(position)
    high = min(low + 1, n - 1)
    needed = sorted({low, high, max(n - whole - 1, 0), min(n - whole, n - 1)})
    for first in range(0, d, size):
        ordered = np.partition(values[first : first + size], needed, axis=1)
        rows = slice(first, first + size)
        quantile[rows] = ordered[:, low] + (ordered[:, high] - ordered[:, low]) * (position - low)
        # sorted: the last bit of a sum depends on the order
        worst = np.ascontiguousarray(np.sort(ordered[:, n - whole :], axis=1)).sum(axis=1)
        if rest:
            worst = worst + ordered[:, n - whole - 1] * (rest / 100)
        cvar[rows] = worst * (100 / (n * (100 - percent)))
    return quantile, cvar


@dataclasses.dataclass(frozen=True)
class DesignMetrics:
    """Metrics of d designs, arrays of d. S is S as it counts: a failed scenario (solver failed, diverged, timed out,
    crashed) at least as bad as without control, and never left out. Scenarios that cannot be driven under some
    design have no S: they are left out for all designs and counted in `invalid`.
    """

    # (d,) [m s] Mean over all scenarios and over those of a side; NaN for a side without scenarios
    S: FloatArray
    S_left: FloatArray
    S_right: FloatArray
    # (d,) [m s] 95 % quantile of S, and mean of the worst 5 %
    S_p95: FloatArray
    S_cvar95: FloatArray
    S_uncorrected: FloatArray  # (d,) [m s] Mean without control, over the same window
    # (d,) 1 - mean S / mean S_uncorrected
    reduction: FloatArray
    reduction_left: FloatArray
    reduction_right: FloatArray
    triggered: FloatArray  # (d,) Share of scenarios in which the design took over
    deeper: FloatArray  # (d,) Share of scenarios deeper than D_y
    # (d,) Scenarios with that status
    solver_failed: IntArray
    diverged: IntArray
    timed_out: IntArray
    crashed: IntArray
    beyond_delta_max: IntArray
    invalid: IntArray
    failed_solves: IntArray  # (d,) Commands that were not finite, or came from a fallback
    # Name -> (d,) every other metric: those taken over interventions are NaN where a design never intervened; of each
    # standard that was asked for the share of its cells that pass
    beside: Mapping[str, FloatArray]

    def take(self, order: IntArray) -> DesignMetrics:
        """The metrics of the given designs, in the order given."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        beside = {name: column[order] for name, column in values.pop("beside").items()}
        return DesignMetrics(**{name: column[order] for name, column in values.items()}, beside=beside)


def drivable_results(results: StudyResults) -> StudyResults:
    """The results on the scenarios that can be driven under every design; raises `InputError` if there are none."""
    drivable = results.on_drivable()
    if not drivable.scenarios.n:
        raise InputError("results", "no scenario could be driven under every design", hint="there is nothing to rank")
    if not np.isfinite(drivable.counted).all():
        raise InputError("results", "S is not finite in some scenario", hint="a mean would drop or hide it")
    return drivable


_MARGINS: Final = ("gain_margin", "phase_margin")
_OF_VEHICLES: Final = ("S_worst", "comfortable_worst")


def measures_of(results: StudyResults, vehicles: Sequence[str | VehicleModel], standards: Sequence[str]) -> Values:
    """Margins, the worst numbers of named vehicles and shares of standards' cells, each (d,), as the run measured them.

    A number that is unknown on any of the vehicles is NaN. Raises `InputError` for what was not measured.
    """

    def measure(name: str, asked: str | VehicleModel) -> FloatArray:
        if name not in results.measures:
            hint = "run the study with it in [ranking] into the same folder: only that is driven"
            raise InputError("ranking", "was not measured in this run", value=asked, hint=hint)
        return results.measures[name]

    values = {name: results.measures[name] for name in _MARGINS if name in results.measures}
    if vehicles:
        pairs = [
            [measure(name, str(asked)) for name in vehicle_measures(asked, results.scenarios)] for asked in vehicles
        ]
        S, comfortable = np.array(pairs).swapaxes(0, 1)
        values |= {"S_worst": S.max(axis=0), "comfortable_worst": comfortable.min(axis=0)}
    return values | {name: measure(name, name) for name in standards}


def design_metrics(
    every_run: StudyResults, results: StudyResults, D_y: float, measures: Values, setup: Setup | None = None
) -> DesignMetrics:
    """Metrics of the designs, in the order of the results.

    Statuses are counted in `every_run`, all else is taken over the drivable `results`. Without `setup`, friction allows
    every recorded path.
    """
    scenarios, counted = results.scenarios, results.counted
    every = np.ones(len(scenarios), dtype=np.bool_)
    rows = (every, scenarios.side == LEFT, scenarios.side == RIGHT)
    S, S_left, S_right = (_mean(counted, side) for side in rows)
    before, before_left, before_right = (_mean(results.S_uncorrected, side) for side in rows)
    S_p95, S_cvar95 = tail_metrics(counted)
    derived = release_metrics(results, D_y=D_y)
    derived["within_dtle_gain"] = derived["within_dtle"] - share_within_dtle(_recorded_dtle(results, setup))
    allowed = np.ones(len(scenarios), dtype=np.bool_) if setup is None else ~beyond_friction(scenarios, setup)
    derived["lost"] = ((results.status == EventStatus.DIVERGED) & allowed).sum(axis=1).astype(np.float64)
    derived |= dict.fromkeys((*_MARGINS, *_OF_VEHICLES), np.full(len(results.designs), np.nan))

    def count(status: EventStatus) -> IntArray:
        result: IntArray = (every_run.status == status).sum(axis=1).astype(np.int64)
        return result

    return DesignMetrics(
        S=S,
        S_left=S_left,
        S_right=S_right,
        S_p95=S_p95,
        S_cvar95=S_cvar95,
        S_uncorrected=before,
        reduction=mean_reduction(S, before),
        reduction_left=mean_reduction(S_left, before_left),
        reduction_right=mean_reduction(S_right, before_right),
        triggered=(results.status != EventStatus.NEVER_TRIGGERED).mean(axis=1),
        deeper=derived.pop("deeper"),
        solver_failed=count(EventStatus.SOLVER_FAILED),
        diverged=count(EventStatus.DIVERGED),
        timed_out=count(EventStatus.TIMED_OUT),
        crashed=count(EventStatus.CRASHED),
        beyond_delta_max=count(EventStatus.BEYOND_DELTA_MAX),
        invalid=count(EventStatus.INVALID),
        failed_solves=results.failed_solves.sum(axis=1).astype(np.int64),
        beside=derived | measures,
    )


def beyond_friction(scenarios: Scenarios, setup: Setup) -> BoolArray:
    """Departures whose recorded path alone needs more than the tyres of a plant give, (n,)."""
    path = UncorrectedPath.of(scenarios, setup.options.residuals, setup.seed)
    t = np.linspace(0.0, 1.0, 33) * scenarios.T[:, None]
    a_y = path.lateral_acceleration(t) + path.speed(t) ** 2 * path.curvature(t)
    result: BoolArray = np.abs(a_y).max(axis=1) > friction(setup.options)
    return result


def _mean(values: FloatArray, rows: BoolArray) -> FloatArray:
    if not rows.any():
        return np.full(values.shape[0], np.nan)
    if rows.all():
        return row_means(values)
    result = np.empty(values.shape[0])
    for block_rows, block in row_blocks(values):
        result[block_rows] = row_means(block[:, rows])
    return result


def mean_reduction(S: FloatArray, before: FloatArray) -> FloatArray:
    """Reduction 1 - S/before of means; 0 where there was nothing to reduce, NaN where there are no scenarios."""
    out = np.where(np.isnan(before), np.nan, 0.0)
    return 1.0 - np.divide(S, before, out=1.0 - out, where=before > 0)


_BLOCK: Final = 64  # rows that are compared with the front at once


def pareto_costs(names: Sequence[str], metrics: DesignMetrics | Mapping[str, FloatArray]) -> FloatArray:
    """Metrics as costs: metrics of which more is better change their sign."""
    if not names:
        raise InputError("Pareto front", "no metrics", allowed="one or more")
    signs = {"less": 1.0, "more": -1.0}
    return np.stack([signs[metric(name).better] * metric_values(name, metrics) for name in names], axis=1)


def pareto_front(costs: npt.ArrayLike) -> BoolArray:
    """Which rows are not dominated: no other row is at most as large in every column and smaller in one."""
    values = np.asarray(costs, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] < 1:
        raise InputError("costs", f"shape {values.shape}", allowed="(d, k) with k >= 1")
    front = np.zeros(values.shape[0], dtype=np.bool_)
    rows = np.flatnonzero(~np.isnan(values).any(axis=1))
    rows = rows[np.lexsort(values[rows].T[::-1])]  # now no row dominates an earlier row
    undominated = rows[:0]
    for first in range(0, rows.size, _BLOCK):
        block = rows[first : first + _BLOCK]
        block = block[~_dominated(values[block], values[undominated])]
        undominated = np.concatenate([undominated, block[~_dominated(values[block], values[block])]])
    front[undominated] = True
    return front


def _dominated(rows: FloatArray, by: FloatArray) -> BoolArray:
    """Rows for which a row of `by` is at most as large in every column and smaller in one."""
    no_larger, smaller = (np.full((len(rows), len(by)), start) for start in (True, False))
    for values, others in zip(rows.T, by.T, strict=True):
        no_larger &= others <= values[:, None]
        smaller |= others < values[:, None]
    return np.asarray((no_larger & smaller).any(axis=1))
