"""The results of a study in memory, which workers send, the store reads, and ranking and report use."""

from __future__ import annotations

import dataclasses
import functools
import math
import statistics
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, Frame, IntArray, facts_html
from ldctoolkit.clusters import with_tails_of_t
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import InputError
from ldctoolkit.metrics import METRIC_COLUMNS, SCENARIO_METRICS, MetricValues, UserMetric, measured_on
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenario_model.refit import FEWEST
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Window
from ldctoolkit.simulation.loop import STATUS_NAMES
from ldctoolkit.vehicle import Convention

from .design import Design

if TYPE_CHECKING:
    import polars as pl

FAILED_STATUSES: Final = (EventStatus.SOLVER_FAILED, EventStatus.DIVERGED, EventStatus.TIMED_OUT, EventStatus.CRASHED)
"""A scenario with one of these is a failure of the design: it is penalised and counted, and never left out."""


def score_label(window: Window, convention: Convention) -> str:
    """Window of S and reading of the paper: ``"departure window, signs consistent"``."""
    return f"{window} window, signs {convention.replace('_', ' ')}"


def status_among(status: npt.NDArray[np.int8], which: Sequence[EventStatus]) -> BoolArray:
    """Where a status is among those given, in the shape of `status`; takes a tenth of the memory of `numpy.isin`."""
    result = np.zeros(status.shape, dtype=np.bool_)
    for event_status in which:
        result |= status == event_status
    return result


def _take_columns(values: FloatArray, columns: BoolArray) -> FloatArray:
    """Select columns; rows that share their memory still do so in the result."""
    if values.shape[0] and values.strides[0] == 0:
        row = values[0, columns]
        return np.broadcast_to(row, (values.shape[0], row.size))
    return values[:, columns]


def per_scenario(metrics: MetricValues, change: Any) -> MetricValues:
    """Metrics with a function applied to every array."""
    values: dict[str, Any] = {
        field.name: change(getattr(metrics, field.name)) for field in dataclasses.fields(MetricValues)
    }
    return MetricValues(**values)


@dataclasses.dataclass(frozen=True, eq=False)
class TaskResult:
    """Results of k designs on m scenarios."""

    ids: tuple[str, ...]  # (k,) Identifiers of the designs
    rows: IntArray  # (m,) Row numbers of the scenarios in the study
    values: FloatArray  # (c, k, m) S, S_uncorrected, the metrics of `MetricValues`, then those of the designer
    status: npt.NDArray[np.int8]  # (k, m)
    failed_solves: npt.NDArray[np.int32]  # (k, m)
    law_seconds: FloatArray  # (k,) [s] Wall time inside the laws' own steps
    commands: IntArray  # (k,) Number of commands, over scenarios and samples

    def take(self, positions: list[int]) -> TaskResult:
        """The results of the designs at the given positions."""
        return dataclasses.replace(
            self,
            ids=tuple(self.ids[i] for i in positions),
            values=self.values[:, positions],
            status=self.status[positions],
            failed_solves=self.failed_solves[positions],
            law_seconds=self.law_seconds[positions],
            commands=self.commands[positions],
        )

    def sorted_by_row(self) -> TaskResult:
        """The same with rising row numbers."""
        order = np.argsort(self.rows)
        return dataclasses.replace(
            self,
            rows=self.rows[order],
            values=self.values[:, :, order],
            status=self.status[:, order],
            failed_solves=self.failed_solves[:, order],
        )


@dataclasses.dataclass(frozen=True)
class FailedRun:
    """A run that an error of the law ended."""

    id: str  # Identifier of the design
    batch: int  # Number of the batch of scenarios in which the law failed
    reason: str  # One sentence


@dataclasses.dataclass(frozen=True)
class FailedDesign:
    """A design without results, because its law raised an error or returned an invalid result."""

    design: Design
    reason: str  # One sentence: what happened

    @property
    def sentence(self) -> str:
        """The design and the reason: ``"design 0123456789ab (Boom, y_s=0.2 m, K=5): ZeroDivisionError: K is 5"``."""
        return f"design {self.design.id} ({self.design.label}): {self.reason}"


@dataclasses.dataclass(frozen=True, eq=False)
class RefitScores:
    """Mean S of d designs, the winner and the baseline, on departures of r models refitted to resampled clusters."""

    designs: tuple[str, ...]  # (d,) Identifiers
    S: FloatArray  # (r, d + 1, 2) [m s] Two independent draws of each; without control last
    failed: int  # Refits that could not be made, or driven
    factor: float  # Of standard deviations over refits, for few and unequal clusters
    df: float  # Degrees of freedom
    key: tuple[str, ...]  # What they follow from: ranking, model, recordings and number
    text: str  # What the recorded departures come from; without refits why there are none
    doubt: str  # Why their interval cannot be trusted; may be empty

    def half_width(self, values: FloatArray, confidence: float) -> float:
        """Half the width of the interval of what has the values (r, 2); NaN with few refits.

        The two draws show their own error, which is taken off.
        """
        r = len(values)
        if r <= self.failed or r < FEWEST:
            return math.nan
        variance = values.mean(axis=1).var(ddof=1) - 0.25 * (values[:, 0] - values[:, 1]).var(ddof=1)
        z = statistics.NormalDist().inv_cdf(0.5 * (1.0 + confidence))
        return float(with_tails_of_t(z, self.df)) * self.factor * math.sqrt(max(variance, 0.0))


@dataclasses.dataclass(frozen=True, repr=False)
class StudyResults(Frame):
    """The results of a finished study: all d designs on all n scenarios.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> results.S.shape, len(results.designs), results.scenarios.n, results.failed
    ((2, 40), 2, 40, ())
    """

    designs: tuple[Design, ...]  # d designs, in the study's order, without those that failed
    scenarios: Scenarios  # The n scenarios that every design was run on: left ones first
    window: Window  # Of S
    convention: Convention  # Reading of the paper
    S: FloatArray  # (d, n) [m s] NaN in a scenario that cannot be driven (`EventStatus.INVALID`), and nowhere else
    # (d, n) [m s] The recorded path's score over the same window; equal for all designs in the departure window (they
    # may then be one row in memory, not to be written into), dependent on the design's y_s in the control window
    S_uncorrected: FloatArray
    status: npt.NDArray[np.int8]  # (d, n) `ldctoolkit.EventStatus`
    metrics: MetricValues  # Arrays (d, n)
    failed_solves: npt.NDArray[np.int32]  # (d, n)
    # (d,) [s] Mean wall time of the law's own step per command; 0 for a linear law, which has none, NaN where it was
    # not measured. The only number here that another run does not reproduce.
    law_time: FloatArray
    failed: tuple[FailedDesign, ...] = ()  # Designs whose law failed: they are in no array here, and never ranked
    # Name of a measure -> (d,) further numbers of the designs; `ldctoolkit.studies.measures` has the names
    measures: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    fresh: StudyResults | None = None  # The finalists, some of the designs, on scenarios that no design was chosen on
    replayed: StudyResults | None = None  # The finalists on recorded departures
    refits: RefitScores | None = None  # The winner and the baseline on refitted models; None where left out
    setup: Setup | None = None  # Of the runs; None where it is not known
    # Name -> (d, n) of each metric of the designer's, as it counts: in a departure that failed at least as bad as on
    # its recorded path. NaN where it gave none
    user_metrics: Mapping[str, FloatArray] = dataclasses.field(default_factory=dict)
    user_rows: Mapping[str, UserMetric] = dataclasses.field(default_factory=dict)  # What they are called and mean

    def _repr_html_(self) -> str:
        """HTML for a notebook, without the tables of numbers, which may be large."""
        return facts_html("Study results", self._lines(), "text-align:left")

    def __repr__(self) -> str:
        return f"<StudyResults: {'; '.join(f'{name} {value}' for name, value in self._lines())}>"

    @property
    def label(self) -> str:
        """Window of S and reading of the paper: ``"departure window, signs consistent"``."""
        return score_label(self.window, self.convention)

    @property
    def options(self) -> PlantOptions | None:
        """The plant of the runs; None where it is not known."""
        return None if self.setup is None else self.setup.options

    @property
    def failed_runs(self) -> BoolArray:
        """Runs in which a design failed, (d, n): a solve failed, it diverged, took too long or crashed."""
        return status_among(self.status, FAILED_STATUSES)

    @functools.cached_property
    def unsafe(self) -> tuple[Design, ...]:
        """Designs that ended or held up a worker process: nothing drives them in this process again."""
        rows = status_among(self.status, (EventStatus.CRASHED, EventStatus.TIMED_OUT)).any(axis=1)
        return tuple(self.designs[i] for i in np.flatnonzero(rows))

    @functools.cached_property
    def counted(self) -> FloatArray:
        """S as it counts in a ranking, (d, n) [m s]: a failed scenario at least as bad as without control.

        It is S itself where nothing failed. Not to be written into.
        """
        failed = self.failed_runs
        if not failed.any():
            return self.S
        counted = self.S.copy()
        # row by row: S_uncorrected may be a single row in memory
        for i in np.flatnonzero(failed.any(axis=1)).tolist():
            counted[i, failed[i]] = np.maximum(self.S[i, failed[i]], self.S_uncorrected[i, failed[i]])
        return counted

    def of_scenarios(self, name: str) -> FloatArray:
        """A metric of the scenarios by its name, the toolkit's or the designer's, (d, n)."""
        values: FloatArray | None = (
            getattr(self.metrics, name) if name in METRIC_COLUMNS else self.user_metrics.get(name)
        )
        if values is None:
            hint = "run the study with it in metrics into the same folder"
            raise InputError("metric", "was not measured in this run", value=name, hint=hint)
        return values

    def costs(self, rank_by: str) -> FloatArray:
        """What a ranking is made of, (d, n): S as it counts, or a designer's metric, negative where more is better.

        Raises `InputError` where a value is not finite. Not to be written into.
        """
        if rank_by == "S":
            return self.counted
        values, sign = self.of_scenarios(rank_by), -1.0 if self.user_rows[rank_by].better == "more" else 1.0
        wrong = ~np.isfinite(values) & (self.status != EventStatus.INVALID)
        if (rows := np.flatnonzero(wrong.any(axis=1))).size:
            counted = f"{wrong[rows[0]].sum():,} departures of {self.designs[rows[0]].label}"
            hint = "a mean would drop or hide it: let the metric be a number everywhere"
            raise InputError("ranking.rank_by", f"not finite in {counted}", value=rank_by, hint=hint)
        return sign * values

    @functools.cached_property
    def drivable(self) -> BoolArray:
        """Scenarios that every design could be driven on, (n,). Not to be written into."""
        result: BoolArray = (self.status != EventStatus.INVALID).all(axis=0)
        return result

    def take(self, columns: BoolArray) -> StudyResults:
        """The results on the scenarios of a mask, (n,)."""
        changes: dict[str, Any] = {name: getattr(self, name)[:, columns] for name in ("S", "status", "failed_solves")}
        changes["S_uncorrected"] = _take_columns(self.S_uncorrected, columns)
        changes["metrics"] = per_scenario(self.metrics, lambda a: a[:, columns])
        changes["user_metrics"] = {name: values[:, columns] for name, values in self.user_metrics.items()}
        return dataclasses.replace(self, scenarios=self.scenarios.take(np.flatnonzero(columns)), **changes)

    def on_drivable(self) -> StudyResults:
        """The results on the drivable scenarios; the object itself if these are all."""
        rows = self.drivable
        return self if rows.all() else self.take(rows)

    def to_polars(self) -> pl.DataFrame:
        """One row for each design and scenario: score, status and every metric.

        Columns have the names of the stored parts.
        """
        import polars as pl

        tables, sides = [], np.where(self.scenarios.side == LEFT, "left", "right")
        columns: dict[str, Any] = {f"{name}_{self.window}_m_s": getattr(self, name) for name in ("S", "S_uncorrected")}
        measured = measured_on(self.options, SCENARIO_METRICS)
        columns |= {METRIC_COLUMNS[name]: getattr(self.metrics, name) for name in measured}
        columns |= {self.user_rows[name].column(name): values for name, values in self.user_metrics.items()}
        columns |= {"status": STATUS_NAMES[self.status], "failed_solves": self.failed_solves}
        for i, design in enumerate(self.designs):
            facts = {"design": design.id, "label": design.label, "law": design.law, "y_s_m": design.y_s}
            facts |= {"scenario": self.scenarios.index, "side": sides}
            tables.append(pl.DataFrame(facts | {name: array[i] for name, array in columns.items()}))
        return pl.concat(tables)

    def _lines(self) -> Iterator[tuple[str, str]]:
        laws = Counter(design.law for design in self.designs)
        listed = ", ".join(f"{law} ({count:,})" for law, count in laws.items())
        yield "designs", f"{len(self.designs):,}: {listed}" if listed else "0"
        left = int((self.scenarios.side == LEFT).sum())
        yield "scenarios", f"{self.scenarios.n:,} ({left:,} left, {self.scenarios.n - left:,} right)"
        yield "S", self.label
        if failed := int(self.failed_runs.sum()):
            yield "failed runs", f"{failed:,} of {self.status.size:,}"
        if self.failed:
            yield "designs that failed", f"{len(self.failed):,}"
        if self.fresh is not None:
            yield "finalists", f"{len(self.fresh.designs):,} on {self.fresh.scenarios.n:,} fresh scenarios"
