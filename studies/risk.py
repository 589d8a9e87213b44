"""The tail: how often departures end deep beyond the line, counted over as many generated ones as a small share needs.

Departures are drawn and driven in chunks, which are all that is kept in memory; their counts are merged and stored.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.clusters import with_tails_of_t
from ldctoolkit.control import EventStatus
from ldctoolkit.declared import checked_whole
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, PARAMETER_NAMES, PARAMETER_UNITS, SIDES, DepartureParameters
from ldctoolkit.errors import InputError, LdcError, StoreError
from ldctoolkit.metrics import USER_GROUP
from ldctoolkit.scenario_model import ScenarioModel, conditions
from ldctoolkit.scenario_model.model import meeting
from ldctoolkit.scenario_model.refit import FEWEST, NOT_KEPT, REFITS, uncertainty
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup

from .design import NO_CONTROL, Design
from .ranking.inference import exact_interval, paired_sign
from .ranking.verdict import Light, State
from .requirements import parse_requirement
from .runner import study_source
from .running.campaign import laws_to_send, metrics_to_send
from .running.chunks import BIN, BINS, ChunkJob, ChunkTask, Tally
from .running.dispatch import Executor, Lost, Progress, closing, displayed, run_works
from .running.executors import make_executor
from .running.tasks import load_loops
from .storage.checked_parts import Parts, planned_parts, remove_unfinished
from .storage.folder_files import output_folder, write_json
from .study_file import Study

BY_MODEL: Final = "by the model"
DEPTHS: Final = (0.3, 0.5, 0.8, 1.0, 1.75)  # [m] beyond the line
DTLE_LIMITS: Final = (-0.1, -0.3)  # [m]
MOST: Final = 10**9  # departures

CHUNK: Final = 8192  # departures in a chunk: what the model draws of a side in one block
_SLOW_CHUNK: Final = 512  # with a law that takes long, which says so by a smaller batch than is usual
_USUAL_BATCH: Final = 1000

_POPULATION: Final = 32_768  # departures behind the population's mean and standard deviation
_MANY: Final = 0.25  # share of the worst departures at an end of what is known that is worth a warning
_STORE_EVERY: Final = 5.0  # seconds
FILE: Final = "risk.json"
PARTS: Final = "risk.parts"

Side = Literal["left", "right"]
_SIDES: Final = {None: slice(0, 2), "left": slice(0, 1), "right": slice(1, 2)}

_QUANTITIES: Final = dict(zip((*PARAMETER_NAMES, "v^2 c"), (*PARAMETER_UNITS, "m/s^2"), strict=True))
"""What departures are described by: the parameters, and the lane's mean lateral acceleration, outward; units."""


def _quantities(p: DepartureParameters) -> FloatArray:
    return np.column_stack([*(getattr(p, name) for name in PARAMETER_NAMES), p.v_mean**2 * (p.c_0 + 0.5 * p.dc)])


# ------------------------------------------------------------------------------------------------ the result


@dataclasses.dataclass(frozen=True)
class Event:
    """How often an event happens with a design, with its exact 95 % interval, and against no control."""

    count: int
    n: int  # departures
    low: float
    high: float
    design_only: int  # departures with the event under the design alone
    no_control_only: int
    sign: int  # 1: the design has it more often than no control, -1: less often, 0: not separable at 5 %
    outside: int  # departures with the event that lie beyond the recorded depths, durations or speeds
    recorded: int  # departures that the model was fitted to; 0 where they are not known, or none are
    refits: tuple[float, float]  # interval of what refits to resampled recordings say; NaN without such recordings

    @property
    def probability(self) -> float:
        """The share; 0 of no departure."""
        return self.count / max(self.n, 1)

    @property
    def by_model(self) -> bool:
        """Whether it is rarer than the recordings can show: below 3/(number of recorded departures)."""
        return self.recorded > 0 and self.probability * self.recorded < 3.0

    @property
    def interval(self) -> tuple[float, float]:
        """The exact interval; that of refits where the model decides."""
        return self.refits if self.by_model else (self.low, self.high)

    @property
    def text(self) -> str:
        """The comparison in a few letters."""
        return {1: "worse", -1: "better", 0: "not separable"}[self.sign]


@dataclasses.dataclass(frozen=True)
class Common:
    """What the worst departures of a design have in common, q quantities, largest difference first."""

    names: tuple[str, ...]  # (q,)
    differences: FloatArray  # (q,) Mean of these minus mean of all, in standard deviations of all
    mean: FloatArray  # (q,) Of these, SI units
    population: FloatArray  # (q,) Of all
    sentence: str  # The largest three
    warnings: tuple[str, ...]  # Where the worst lie at the end of what is known


@dataclasses.dataclass(frozen=True, eq=False)
class Risk:
    """How often events happen with d designs, no control first; made by `estimate_risk`."""

    job: ChunkJob
    tally: Tally

    @property
    def designs(self) -> tuple[Design, ...]:
        """The designs, no control first."""
        return self.job.designs

    @property
    def events(self) -> tuple[str, ...]:
        """What is counted: ``"depth > 0.8 m"``, ``"DTLE < -0.3 m"``, ``"opposite line crossed"``, ``"diverged"``."""
        return self.job.events

    @property
    def setup(self) -> Setup:
        """What departures were driven with."""
        return self.job.setup

    @property
    def n(self) -> int:
        """Departures that were driven."""
        return int(self.tally.n.sum())

    @functools.cached_property
    def population(self) -> FloatArray:
        """Mean and standard deviation of the departures' quantities, (2, q)."""
        job = dataclasses.replace(self.job, n=_POPULATION, chunk=_POPULATION)
        values = _quantities(job.scenarios(0))
        return np.stack([values.mean(axis=0), values.std(axis=0)])

    def row(self, design: Design) -> int:
        """Position of a design in `designs`."""
        if design not in self.designs:
            raise InputError("design", value=design.label, allowed=[held.label for held in self.designs])
        return self.designs.index(design)

    def event(self, design: Design, event: str, side: Side | None = None) -> Event:
        """How often an event happens in a departure of both sides, or of one, which is ``"left"`` or ``"right"``."""
        if event not in self.events:
            raise InputError("event", value=event, allowed=self.events)
        i, j, sides = self.row(design), self.events.index(event), _SIDES[side]
        # sides are drawn in proportion: the variance of the sum is at most binomial, the exact interval a little wide
        count, n = int(self.tally.counts[i, j, sides].sum()), int(self.tally.n[sides].sum())
        only = int(self.tally.only[i, j, sides].sum())
        others = int(self.tally.counts[0, j, sides].sum()) - count + only
        refits = self._of_refits(i, j, sides)
        outside, recorded = int(self.tally.outside[i, j, sides].sum()), self.recorded(side)
        sign = paired_sign(only, others)
        return Event(count, n, *exact_interval(count, n), only, others, sign, outside, recorded, refits)

    def _of_refits(self, i: int, j: int, sides: slice) -> tuple[float, float]:
        """95 % interval of a probability from what refits differ by, beyond what counting explains; on a log scale."""
        n, count = self.tally.refit_n[:, sides].sum(axis=1), self.tally.refit_counts[:, i, j, sides].sum(axis=1)
        n, count = n[n > 0], count[n > 0]
        recorded = self.job.model.provenance.recorded
        if recorded is None or n.size < FEWEST:
            return math.nan, math.nan
        if not count.any():
            return 0.0, exact_interval(0, int(n.sum()))[1]
        factor, df = uncertainty(recorded, n.size)
        mean = float(count.sum() / n.sum())
        variance = max(float((count / n).var(ddof=1)) - mean * float((1.0 / n).mean()), 0.0) * factor**2
        sigma = math.sqrt(math.log1p(variance / mean**2 + 1.0 / float(count.sum())))
        wide = math.exp(float(with_tails_of_t(1.96, df)) * sigma)
        return mean / wide, min(mean * wide, 1.0)

    def recorded(self, side: Side | None = None, deeper: float = -math.inf) -> int:
        """Departures that the model was fitted to, with depths beyond a limit [m]; 0 of a model that was not."""
        origin = self.job.model.provenance
        if (known := origin.recorded) is None:
            return 0 if origin.synthetic else sum(fit.events for name, fit in origin.sides if side in (None, name))
        meets = meeting(known.departures, conditions(self.job.given)) & (known.departures.d_y > deeper)
        return int((meets & (True if side is None else known.departures.side == SIDES[side])).sum())

    def light(self, design: Design) -> Light:
        """Whether the tail is better than without control; red where it is worse in depth or DTLE, or diverges more."""
        by_sign = {1: list[str](), -1: list[str](), 0: list[str]()}
        for event in self.events:
            pair, without = self.event(design, event), self.event(self.designs[0], event)
            if pair.design_only or pair.no_control_only:
                shown = (BY_MODEL if x.by_model else f"{x.probability:.3g}" for x in (pair, without))
                by_sign[pair.sign].append(f"{event} ({' against '.join(dict.fromkeys(shown))})")
        titles = {"worse than no control": by_sign[1], "better": by_sign[-1], "not separable": by_sign[0]}
        text = "; ".join(f"{title}: {', '.join(events)}" for title, events in titles.items() if events)
        red = any(event.startswith(("depth", "DTLE", "diverged")) for event in by_sign[1])
        state: State = "bad" if red else "good" if by_sign[-1] and not by_sign[1] else "warning"
        return Light("Tail", state, f"{text[0].upper()}{text[1:]}." if text else "No event differs.")

    def exceedance(self, design: Design) -> tuple[FloatArray, FloatArray]:
        """Depths [m], and the share of departures that reach each of them."""
        deeper = self.tally.histogram[self.row(design)][::-1].cumsum()[::-1]
        return BIN * np.arange(1.0, BINS + 1.0), np.asarray(deeper[1:] / max(self.n, 1))

    def departure_rates(self, side: Side | None = None) -> dict[str, float]:
        """Recorded departures ``per_1000_km`` and ``per_hour``, where the model knows what it was recorded on.

        Empty under conditions: how many of the recorded departures meet them is not known.
        """
        origin, counts = self.job.model.provenance, _recorded(self.job.model)
        if counts is None or self.job.given:
            return {}
        total, driven = float(np.sum(counts[_SIDES[side]])), {"per_1000_km": origin.distance, "per_hour": origin.hours}
        return {name: (1e6 if name == "per_1000_km" else 1.0) * total / much for name, much in driven.items() if much}

    def notes(self) -> Iterator[str]:
        """What a reader of the numbers has to know, one sentence each."""
        tally, (left, right) = self.tally, self.tally.n
        source = f"scenario model {self.job.model.content_hash[:12]}, seed {self.setup.seed}"
        yield f"{self.n:,} departures ({left:,} left, {right:,} right), {source}: {resolution(self.n)}."
        if (recorded := self.job.model.provenance.recorded) is not None:
            n, deeper = self.recorded(), ((x, self.recorded(deeper=x)) for x in self.job.depths)
            limits = (f"{k:,} beyond {x:g} m (upper limit {exact_interval(k, n)[1]:.2g})" for x, k in deeper)
            yield f"The model rests on {recorded.clusters.text}. Of {n:,} recorded departures, {', '.join(limits)}."
        elif not self.job.model.provenance.synthetic:
            yield f"What the recordings know of these is not known: {NOT_KEPT}."
        if any(self.event(design, event).by_model for design in self.designs for event in self.events):
            n = self.recorded()
            yield (
                f"{BY_MODEL.capitalize()}: below 3/{n:,} = {3.0 / n:.2g} a probability is decided by the model, not by "
                "the recordings; its interval is that of models refitted to resampled recordings."
            )
        if tally.invalid.any():
            yield f"{tally.invalid.sum():,} more cannot be driven and are in no number."
        for design, status, solves in zip(self.designs, tally.status, tally.failed_solves, strict=True):
            if solves:
                failed = status[EventStatus.SOLVER_FAILED]
                yield f"{design.label}: {solves:,} failed solves, in {failed:,} departures or more; all count."
        if self.departure_rates():
            yield "Rates take the number of departures per hour and per km as known; their intervals are those of P."
        else:
            yield "No rates per hour or 1,000 km: not known for these departures."

    def worst(self, design: Design) -> Scenarios:
        """The worst departures of a design, deepest first.

        `simulate` with ``setup=risk.setup`` and the design's y_s drives them to the same bits.
        """
        _, index, side, *columns = self.tally.worst_of(self.row(design)).T
        drawn = Scenarios.drawn(side=side, **dict(zip(PARAMETER_NAMES, columns, strict=True)))
        return dataclasses.replace(drawn, index=index.astype(np.int64))

    def worst_rows(self, *designs: Design) -> Iterator[dict[str, Any]]:
        """One row for each of the worst departures of some designs, of all by default, as ``worst.csv`` holds them."""
        for design in designs or self.designs:
            for rank, (depth, index, side, *values) in enumerate(self.tally.worst_of(self.row(design)).tolist(), 1):
                row = {"design": design.id, "label": design.label, "rank": rank}
                row |= {"deepest_m": depth, "scenario": int(index), "side": "left" if side == LEFT else "right"}
                yield row | dict(zip(PARAMETER_COLUMNS.values(), values, strict=True))

    def in_common(self, design: Design) -> Common:
        """What the worst departures of a design have in common: where their mean is furthest from that of all."""
        worst, (population_mean, sd) = self.worst(design), self.population
        mean = _quantities(worst).sum(axis=0) / max(worst.n, 1)
        standardised = np.divide(mean - population_mean, sd, out=np.zeros_like(mean), where=sd > 0.0)
        order = np.argsort(-np.abs(standardised), kind="stable")
        names = tuple(tuple(_QUANTITIES)[q] for q in order)
        parts = (
            f"{name} {mean[q]:.3g} instead of {population_mean[q]:.3g} {_QUANTITIES[name]} ({standardised[q]:+.1f} sd)"
            for name, q in zip(names[:3], order, strict=False)
        )
        sentence = f"In common to the {worst.n} worst departures: {', '.join(parts)}."
        warnings = tuple(_at_the_ends(self.job.model, worst))
        return Common(names, standardised[order], mean[order], population_mean[order], sentence, warnings)

    def rows(self) -> Iterator[dict[str, Any]]:
        """One row for every design, event and side, as ``risk.csv`` holds them."""
        for design, event, side in itertools.product(self.designs, self.events, _SIDES):
            counted, row = self.event(design, event, side), {"design": design.id, "label": design.label}
            row |= {"y_s_m": design.y_s, "event": event, "side": side or "both", "count": counted.count, "n": counted.n}
            if counted.recorded:
                row |= {"decided_by": "model" if counted.by_model else "recordings", "outside": counted.outside}
            shares = dict(zip(("", "_low", "_high"), (counted.probability, *counted.interval), strict=True))
            if counted.by_model:
                shares[""] = math.nan
            for name, rate in {"probability": 1.0, **self.departure_rates(side)}.items():
                row |= {f"{name}{end}": rate * x if math.isfinite(x) else None for end, x in shares.items()}
            if not design.is_baseline:
                row |= {"design_only": counted.design_only, "no_control_only": counted.no_control_only}
                row |= {"against_no_control": counted.text}
            yield row


def resolution(n: int) -> str:
    """What n departures cannot show: without any event, its probability is below 3/n with 95 % confidence."""
    return f"with n = {n:,} nothing below {3.0 / max(n, 1):.1e} can be detected"


def _recorded(model: ScenarioModel) -> tuple[int, ...] | None:
    """Recorded departures of the left and right side that a model knows of, or those that they stand for."""
    counts = tuple(round(side.weight or side.events) for _, side in model.provenance.sides)
    return counts if len(counts) == 2 and any(counts) else None


def _at_the_ends(model: ScenarioModel, worst: Scenarios) -> Iterator[str]:
    """Where many of the worst departures lie at the model's bounds, or beyond what was recorded."""
    near, beyond = dict.fromkeys(PARAMETER_NAMES, 0), dict.fromkeys(PARAMETER_NAMES, 0)
    summaries = dict(model.provenance.sides)
    for label, key in SIDES.items():
        side, departures, origin = model.side(key), worst.take(worst.side == key), summaries.get(label)
        for name, low, high in zip(side.names, *side.bounds(), strict=True):
            values, margin = getattr(departures, name), 0.01 * (high - low)
            if np.isfinite(margin):
                near[name] += int(((values < low + margin) | (values > high - margin)).sum())
        summary = None if origin is None else origin.source_summary
        for name, quantiles in () if summary is None else zip(summary.names, summary.quantiles, strict=True):
            values = getattr(departures, name)
            beyond[name] += int(((values < quantiles[0]) | (values > quantiles[-1])).sum())
    ends = {"within 1 % of the model's bounds, which decide this tail": near}
    ends |= {"beyond the outermost quantiles of the fitted departures, where the model extrapolates": beyond}
    for where, counts in ends.items():
        for name, count in counts.items():
            if count and count >= _MANY * worst.n:
                yield f"{count} of the {worst.n} worst departures have {name} {where}"


# ------------------------------------------------------------------------------------------------ the run


def estimate_risk(
    designs: Sequence[Design],
    study: Study,
    *,
    n: int,
    seed: int | None = None,
    model: str | Path | ScenarioModel | None = None,
    directory: str | Path | None = None,
    workers: int | None = None,
    executor: Literal["serial", "processes", "dask"] | None = None,
    dask: str | None = None,
    progress: bool | Progress | None = None,
    depths: Sequence[float] = DEPTHS,
    dtle_limits: Sequence[float] = DTLE_LIMITS,
    metric_limits: Sequence[str] = (),
    chunk: int | None = None,
    notice: Callable[[str], None] | None = None,
) -> Risk:
    """Count rare events over n generated departures, with some designs and always without control.

    Raises `InputError` for arguments outside what is allowed, or a study that replays a table, which has no tail beyond
    itself; `LdcError` naming the design whose law raises; `StoreError` if the folder holds another estimate or is used.

    Parameters
    ----------
    designs : sequence of Design
        What is driven, all on the same departures.
    study : Study
        Vehicle, plant, scenario model and convention.
    n : int
        Departures, up to 1e9; left and right as they were recorded, if the model knows that, else half and half.
    seed : int, optional
        Of the departures and their plants; the study's by default.
    model : path, str or ScenarioModel, optional
        Instead of the study's.
    directory : path, optional
        Folder of ``risk.json``; what is counted waits in ``risk.parts`` there, and a run that was stopped goes on.
    workers, executor, dask, progress
        As in `run_study`; no number depends on them.
    depths, dtle_limits : sequence of float [m]
        Depths beyond the line and distances to the lane edge whose probabilities are estimated.
    metric_limits : sequence of str
        The same of the study's own metrics, as ``"time_outside > 1.0"``.
    chunk : int, optional
        Departures that are drawn and driven together; numbers depend on it as on a seed.
    notice : callable, optional
        Called once with a line on how long it takes and what n can show.

    Returns
    -------
    Risk
        Counts, probabilities with exact intervals, and the worst departures.

    Examples
    --------
    >>> from ldctoolkit import Study
    >>> from ldctoolkit.studies.risk import estimate_risk
    >>> study = Study.from_dict({"name": "tail", "design": [{"law": "lqr", "y_s": 0.1}]})
    >>> risk = estimate_risk(study.designs, study, n=500, workers=1)
    >>> risk.designs[0].law, risk.n, risk.events[2]
    ('none', 500, 'depth > 0.8 m')
    >>> risk.event(study.designs[0], "depth > 0.3 m").text
    'better'
    """
    for name, value in (("n", n), ("chunk", CHUNK if chunk is None else chunk)):
        checked_whole(name, value, lower=1, upper=MOST)
    source = study_source(study, model)
    if not isinstance(source, ScenarioModel):
        raise InputError(
            f"study {study.name}", "replays recorded departures: none is rarer than those", hint="give a model"
        )
    for name, values, least in (("depths", depths, 0.0), ("dtle_limits", dtle_limits, -np.inf)):
        if not all(least < x < np.inf for x in values):
            raise InputError(name, value=list(values), allowed=f"numbers{' > 0' if least == 0.0 else ''} [m]")
    active = tuple({design.id: design for design in designs if not design.is_baseline}.values())
    limits = tuple(map(parse_requirement, metric_limits))
    known = {metric.name: metric for metric in study.metrics}
    for of, text in zip(limits, metric_limits, strict=True):
        if of.metric.group != USER_GROUP or of.metric.aggregate != "mean" or of.metric.of[0] not in known:
            raise InputError("metric_limits", value=text, allowed=[f"{name} > NUMBER" for name in known] or "no metric")
    metrics = tuple(known[name] for name in dict.fromkeys(of.metric.of[0] for of in limits))
    slow = bool(metrics) or any(design.batch < _USUAL_BATCH for design in active)
    runs_on = make_executor(executor, workers, dask)
    job = ChunkJob(
        designs=(Design.from_gains(NO_CONTROL, active[0].y_s if active else 0.2, {}), *active),
        setup=dataclasses.replace(study.setup(), seed=study.seed if seed is None else seed),
        model=source,
        given=study.scenarios.given or None,
        n=n,
        chunk=chunk or (_SLOW_CHUNK if slow else CHUNK),
        share=_recorded(source) or (1, 1),
        depths=tuple(sorted({float(x) for x in depths})),
        dtle_limits=tuple(sorted({float(x) for x in dtle_limits}, reverse=True)),
        refits=0 if source.provenance.recorded is None else REFITS,
        laws=laws_to_send(design.kind for design in active) if runs_on.isolated else b"",
        metrics=metrics_to_send(metrics) if metrics and runs_on.isolated else metrics,
        limits=limits,
        token=time.time_ns(),
    )
    folder = None if directory is None else output_folder(Path(directory))
    if folder is not None and (folder / FILE).exists() and not (folder / PARTS).exists():
        raise StoreError(folder / FILE, f"there is no {PARTS} beside it to go on with", hint="remove it to begin again")
    with (
        displayed(progress) as shown,
        closing(runs_on),
        planned_parts(folder and folder / PARTS, job.identity(), {"Tally": Tally}, replace=False) as parts,
    ):
        risk = Risk(job, _counted(job, parts, runs_on, shown, notice))
        if folder is not None:
            remove_unfinished(folder, FILE)
            write_json(folder / FILE, {"identity": job.identity(), "results": list(risk.rows())}, indent=None)
    return risk


def _counted(
    job: ChunkJob, parts: Parts, executor: Executor, progress: Progress, notice: Callable[[str], None] | None
) -> Tally:
    """What is counted over all chunks: of the parts that are there, and of the chunks that are in none of them."""
    tally, done = job.empty, set[int]()
    for number in parts.finished:
        chunks, counted = parts.read(number)
        tally, done = tally.plus(counted), done | set(chunks)
    own, each = job.sizes
    tasks = [ChunkTask(job, chunk) for chunk in range(own + job.refits * each) if chunk not in done]
    if tasks:
        y_s = min(design.y_s for design in job.designs)
        load_loops({design.law for design in job.designs}, job.scenarios(0), job.setup, y_s)
    elif notice is not None:
        notice(f"all departures were driven before; {resolution(job.n)}")
    progress.stage("departures", len(tasks) * job.chunk)
    waiting, part, stored = list[int](), job.empty, time.monotonic()

    def store() -> None:
        nonlocal tally, waiting, part, stored
        if waiting:
            parts.write(min(waiting), (waiting, part))
        tally, waiting, part, stored = tally.plus(part), [], job.empty, time.monotonic()

    try:
        for i, (task, result) in enumerate(run_works(executor, tasks)):
            if isinstance(result, Lost):
                problem = f"a worker process ended among departures of chunk {task.chunk}"
                raise LdcError(problem=problem, hint="run it again to go on")
            counted, seconds = result
            if isinstance(counted, LdcError):
                raise counted
            part = part.plus(counted)
            waiting.append(task.chunk)
            if time.monotonic() - stored > _STORE_EVERY:
                store()
            progress.advance(job.chunk)
            # the first chunk of a worker also loads the compiled loops
            if notice is not None and i == min(executor.workers, len(tasks) - 1):
                whole = len(tasks) * seconds / executor.workers
                time_text = f"{whole:.0f} s" if whole < 120.0 else f"{whole / 60.0:,.0f} min"
                notice(f"{job.n:,} departures take about {time_text}; {resolution(job.n)}")
    except BaseException:
        with contextlib.suppress(StoreError):  # why the run ended says more
            store()
        raise
    store()
    return tally
