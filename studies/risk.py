"""The tail: how often departures end deep beyond the line, counted over as many generated ones as a small share needs.

Departures are drawn and driven in chunks, which are all that is kept in memory; their counts are merged and stored.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import itertools
import json
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit import EventStatus, LdcError, Scenarios, Setup
from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, PARAMETER_NAMES, PARAMETER_UNITS, RIGHT
from ldctoolkit.errors import InputError, StoreError, nearest
from ldctoolkit.scenario_model import ScenarioModel
from studies.design import NO_CONTROL, Design
from studies.ranking.tail import exact_interval, paired_sign
from studies.ranking.verdict import Light, State
from studies.runner import study_source
from studies.running.campaign import Progress, default_progress, laws_of_this_process
from studies.running.chunks import BIN, BINS, QUANTITIES, STEPS, ChunkJob, ChunkTask, Tally, quantities
from studies.running.executors import Executor, make_executor
from studies.running.tasks import Faults
from studies.storage.files import locked, read_bytes, remove_unfinished, write_text
from studies.study_file import Study

DEPTHS: Final = (0.3, 0.5, 0.8, 1.0, 1.75)  # [m] beyond the line
DTLE_LIMITS: Final = (-0.1, -0.3)  # [m]
MOST: Final = 10**9  # departures

CHUNK: Final = 8192  # departures in a chunk: what the model draws of a side in one block
_SLOW_CHUNK: Final = 512  # with a law that takes long, which says so by a smaller batch than is usual
_USUAL_BATCH: Final = 1000

_ENOUGH: Final = 20  # departures beyond a depth from which on these are looked at, and not the worst alone
_POPULATION: Final = 4  # chunks behind the population's mean and standard deviation
_MANY: Final = 0.25  # share of the worst departures at an end of what is known that is worth a warning
_STORE_EVERY: Final = 5.0  # seconds
FILE: Final = "risk.json"

Side = Literal["left", "right"]
_SIDES: Final = {None: slice(0, 2), "left": slice(0, 1), "right": slice(1, 2)}


# ------------------------------------------------------------------------------------------------ the result


@dataclasses.dataclass(frozen=True)
class Probability:
    """Probability of an event in a departure, with its exact 95 % interval."""

    count: int
    n: int
    low: float
    high: float

    @property
    def value(self) -> float:
        """The share; 0 of no departure."""
        return self.count / max(self.n, 1)


@dataclasses.dataclass(frozen=True)
class Pairing:
    """A design against no control on the same departures."""

    design_only: int  # departures with the event under the design alone
    no_control_only: int
    sign: int  # 1: the design has it more often, -1: less often, 0: not separable at 5 %

    @property
    def text(self) -> str:
        """In a few letters."""
        return {1: "worse", -1: "better", 0: "not separable"}[self.sign]


@dataclasses.dataclass(frozen=True)
class Common:
    """What the worst departures of a design have in common."""

    which: str  # which departures these are
    names: tuple[str, ...]  # (q,) largest difference first
    differences: FloatArray  # (q,) mean of these minus mean of all, in standard deviations of all
    mean: FloatArray  # (q,) of these, SI units
    population: FloatArray  # (q,) mean of all
    warnings: tuple[str, ...]  # where the worst lie at the end of what is known


@dataclasses.dataclass(frozen=True, eq=False)
class Risk:
    """How often events happen with d designs, no control first; made by `estimate_risk`."""

    job: ChunkJob
    tally: Tally
    designs: tuple[Design, ...]  # no control first
    events: tuple[str, ...]  # as "depth > 0.8 m", "DTLE < -0.3 m", "opposite line crossed", "diverged"
    setup: Setup  # what departures were driven with

    @property
    def n(self) -> int:
        """Departures that were driven."""
        return int(self.tally.n.sum())

    @functools.cached_property
    def population(self) -> FloatArray:
        """Mean and standard deviation of `QUANTITIES` over the first chunks, (2, q): the same wherever these ran."""
        some = np.concatenate([quantities(self.job.scenarios(k, self.job.chunk)) for k in range(_POPULATION)])
        return np.stack([some.mean(axis=0), some.std(axis=0)])

    def row(self, design: Design) -> int:
        """Its place among `designs`."""
        if design not in self.designs:
            raise InputError(f"design: {design.label!r}; {nearest(design.label, [one.label for one in self.designs])}")
        return self.designs.index(design)

    def _event(self, event: str) -> int:
        if event not in self.events:
            raise InputError(f"event: {event!r}; {nearest(event, self.events)}")
        return self.events.index(event)

    def probability(self, design: Design, event: str, side: Side | None = None) -> Probability:
        """How often an event happens in a departure of both sides, or of one, which is ``"left"`` or ``"right"``."""
        counts = self.tally.counts[self.row(design), self._event(event), _SIDES[side]]
        # sides are drawn in proportion: the variance of the sum is at most binomial, the exact interval a little wide
        count, n = int(counts.sum()), int(self.tally.n[_SIDES[side]].sum())
        return Probability(count, n, *exact_interval(count, n))

    def against_no_control(self, design: Design, event: str, side: Side | None = None) -> Pairing:
        """The same departures with the design and without control."""
        i, j, some = self.row(design), self._event(event), _SIDES[side]
        b = int(self.tally.only[i, j, some].sum())
        c = int(self.tally.counts[0, j, some].sum() - self.tally.counts[i, j, some].sum()) + b
        return Pairing(b, c, paired_sign(b, c))

    def light(self, design: Design) -> Light:
        """Whether the tail is better than without control; red where it is worse in depth or DTLE, or diverges more."""
        found = {1: list[str](), -1: list[str](), 0: list[str]()}
        for event in self.events:
            pair = self.against_no_control(design, event)
            if pair.design_only or pair.no_control_only:
                shares = (self.probability(one, event).value for one in (design, self.designs[0]))
                found[pair.sign].append(f"{event} ({' against '.join(f'{share:.3g}' for share in shares)})")
        worse, better, open_ = (", ".join(found[sign]) for sign in (1, -1, 0))
        titles = {"worse than no control": worse, "better": better, "not separable": open_}
        text = "; ".join(f"{title}: {events}" for title, events in titles.items() if events) or "no event differs"
        red = any(not event.startswith("opposite") for event in found[1])
        state: State = "bad" if red else "good" if better and not worse else "warning"
        return Light("Tail", state, f"{text[0].upper()}{text[1:]}.")

    def exceedance(self, design: Design) -> tuple[FloatArray, FloatArray]:
        """Depths [m], and the share of departures that reach each of them."""
        deeper = self.tally.histogram[self.row(design)].sum(axis=0)[::-1].cumsum()[::-1]
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
        source = f"scenario model {self.job.model.content_hash[:12]}, seed {self.job.seed}"
        yield f"{self.n:,} departures ({left:,} left, {right:,} right), {source}: {resolution(self.n)}."
        if tally.invalid.any():
            yield f"{tally.invalid.sum():,} more cannot be driven and are in no number."
        for i, design in enumerate(self.designs):
            failed, steps = tally.status[i, EventStatus.SOLVER_FAILED], tally.failed_solves[i]
            if steps:
                yield f"{design.label}: {steps:,} failed solves, in {failed:,} departures or more; all count."
        if self.departure_rates():
            yield "Rates take the number of departures per hour and per km as known; their intervals are those of P."
        else:
            yield "No rates per hour or 1,000 km: not known for these departures."

    def worst(self, design: Design) -> Scenarios:
        """The worst departures of a design, deepest first.

        `simulate` with ``setup=risk.setup`` and the design's y_s drives them to the same bits.
        """
        kept = self.tally.worst[self.row(design)]
        side, *columns = kept[kept[:, 1] >= 0.0].T[2:]
        made = Scenarios.drawn(side=side, **dict(zip(PARAMETER_NAMES, columns, strict=True)))
        return dataclasses.replace(made, index=kept[: side.size, 1].astype(np.int64))

    def worst_rows(self, *designs: Design) -> Iterator[dict[str, Any]]:
        """One row for each of the worst departures of some designs, of all by default, as ``worst.csv`` holds them."""
        for design in designs or self.designs:
            for rank, row in enumerate(self.tally.worst[self.row(design)].tolist()):
                depth, index, side, *parameters = row
                if index >= 0.0:
                    one = {"design": design.label, "id": design.id, "rank": rank + 1, "depth_m": depth}
                    one |= {"scenario": int(index), "side": "left" if side == LEFT else "right"}
                    yield one | dict(zip(PARAMETER_COLUMNS.values(), parameters, strict=True))

    def in_common(self, design: Design) -> Common:
        """What departures beyond the largest depth that has 20 of them have in common, or else the worst ones."""
        i, worst = self.row(design), self.worst(design)
        beyond = self.tally.counts[i, : len(self.job.depths)].sum(axis=1)
        if (beyond >= _ENOUGH).any():
            j = int(np.flatnonzero(beyond >= _ENOUGH)[-1])
            mean = self.tally.sums[i, j] / STEPS / beyond[j]
            which = f"the {beyond[j]:,} departures beyond {self.job.depths[j]:g} m"
        else:
            mean, which = quantities(worst).sum(axis=0) / max(worst.n, 1), f"the {worst.n} worst departures"
        usual, sd = self.population
        apart = np.divide(mean - usual, sd, out=np.zeros_like(mean), where=sd > 0.0)
        order = np.argsort(-np.abs(apart), kind="stable")
        warnings = tuple(_at_the_ends(self.job.model, worst))
        names = tuple(QUANTITIES[q] for q in order)
        return Common(which, names, apart[order], mean[order], usual[order], warnings)

    @staticmethod
    def common_sentence(common: Common, most: int = 3) -> str:
        """The largest differences in one sentence."""
        shown = zip(common.names[:most], common.differences, common.mean, common.population, strict=False)
        units = dict(zip(QUANTITIES, (*PARAMETER_UNITS, "m/s^2"), strict=True))
        parts = (
            f"{name} {mean:.3g} instead of {all_:.3g} {units[name]} ({d:+.1f} sd)" for name, d, mean, all_ in shown
        )
        return f"In common to {common.which}: {', '.join(parts)}."

    def rows(self) -> Iterator[dict[str, Any]]:
        """One row for every design, event and side, as ``risk.csv`` holds them."""
        for design, event, side in itertools.product(self.designs, self.events, _SIDES):
            found, row = self.probability(design, event, side), {"design": design.label, "id": design.id}
            row |= {"y_s_m": design.y_s, "event": event, "side": side or "both", "count": found.count, "n": found.n}
            shares = {"": found.value, "_low": found.low, "_high": found.high}
            for name, rate in {"probability": 1.0, **self.departure_rates(side)}.items():
                row |= {f"{name}{end}": rate * share for end, share in shares.items()}
            if not design.is_baseline:
                pair = self.against_no_control(design, event, side)
                row |= {"design_only": pair.design_only, "no_control_only": pair.no_control_only}
                row |= {"against_no_control": pair.text}
            yield row


def resolution(n: int) -> str:
    """What n departures cannot show: without any event, its probability is below 3/n with 95 % confidence."""
    return f"with n = {n:,} nothing below {3.0 / max(n, 1):.1e} can be seen"


def _recorded(model: ScenarioModel) -> tuple[int, ...] | None:
    """Recorded departures of the left and right side that a model knows of, or those that they stand for."""
    sides = [side for side in (model.provenance.left, model.provenance.right) if side is not None]
    counts = tuple(round(side.weight or side.events) for side in sides)
    return counts if len(counts) == 2 and any(counts) else None


def _at_the_ends(model: ScenarioModel, worst: Scenarios) -> Iterator[str]:
    """Where many of the worst departures lie at the model's bounds, or beyond what was recorded."""
    near, beyond = dict.fromkeys(PARAMETER_NAMES, 0), dict.fromkeys(PARAMETER_NAMES, 0)
    for key, origin in ((LEFT, model.provenance.left), (RIGHT, model.provenance.right)):
        side, own = model.side(key), worst.take(np.flatnonzero(worst.side == key))
        for name, low, high in zip(side.names, *side.bounds(), strict=True):
            values, margin = getattr(own, name), 0.01 * (high - low)
            if np.isfinite(margin):
                near[name] += int(((values < low + margin) | (values > high - margin)).sum())
        summary = None if origin is None else origin.source_summary
        for name, known in () if summary is None else zip(summary.names, summary.quantiles, strict=True):
            values = getattr(own, name)
            beyond[name] += int(((values < known[0]) | (values > known[-1])).sum())
    ends = {"within 1 % of the model's bounds, which decide this tail": near}
    ends |= {"beyond the outermost quantiles of the fitted departures, where the model extrapolates": beyond}
    for where, counts in ends.items():
        for name, count in counts.items():
            if count and count >= _MANY * worst.n:
                yield f"{count} of the {worst.n} worst departures have {name} {where}"


# ------------------------------------------------------------------------------------------------ the run


class _Estimation:
    """Chunks that are done, and what was counted; kept in a file, if there is a folder."""

    def __init__(self, job: ChunkJob, n: int, folder: Path | None) -> None:
        self.job, self.n, self.path = job, n, None if folder is None else folder / FILE
        self.done: set[int] = set()
        self.tally = self.rest = job.empty  # of whole chunks, and of the last one where it is not whole
        self.stored = time.monotonic()
        if self.path is not None and self.path.exists():
            self._read(self.path)

    def _read(self, path: Path) -> None:
        try:
            stored = json.loads(read_bytes(path))
            differ = [name for name, value in self.job.identity().items() if stored["identity"].get(name) != value]
            if not differ:
                self.done = {k for first, end in stored["chunks"] for k in range(first, end)}
                self.tally = self.tally.from_json(stored["tally"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(f"{path}: broken: {error}; remove it to begin again") from None
        if differ:
            raise StoreError(f"{path}: holds another estimate, of other {', '.join(differ)}; choose another folder")
        if len(self.done) > self.n // self.job.chunk:
            least = len(self.done) * self.job.chunk
            raise StoreError(f"{path}: holds {least:,} departures; allowed: n of as many or more, or another folder")

    def tasks(self) -> list[ChunkTask]:
        """What is left to be done."""
        whole, rest = divmod(self.n, self.job.chunk)
        tasks = [ChunkTask(self.job, k, self.job.chunk) for k in range(whole) if k not in self.done]
        return tasks + ([ChunkTask(self.job, whole, rest)] if rest else [])

    def take(self, task: ChunkTask, tally: Tally) -> None:
        """Take the counts of a chunk in."""
        if task.size == self.job.chunk:
            self.tally = self.tally.plus(tally)
            self.done.add(task.k)
        else:
            self.rest = tally
        if time.monotonic() - self.stored > _STORE_EVERY:
            self.store()

    def store(self, found: Risk | None = None) -> None:
        """Write the file, whole or not at all."""
        if self.path is None:
            return
        first = sorted(k for k in self.done if k - 1 not in self.done)
        last = sorted(k + 1 for k in self.done if k + 1 not in self.done)
        content = {"identity": self.job.identity(), "n": self.n, "chunks": list(zip(first, last, strict=True))}
        content |= {"tally": {name: array.tolist() for name, array in vars(self.tally).items()}}
        content |= {"results": None if found is None else list(found.rows())}
        write_text(self.path, json.dumps(content, allow_nan=False) + "\n")
        self.stored = time.monotonic()

    def result(self) -> Risk:
        """The whole."""
        return Risk(self.job, self.tally.plus(self.rest), self.job.designs, self.job.events, self.job.setup)


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
        Vehicle, plant, scenario model and first convention.
    n : int
        Departures, up to 1e9; left and right as they were recorded, if the model knows that, else half and half.
    seed : int, optional
        Of the departures and their plants; the study's by default.
    model : path, str or ScenarioModel, optional
        Instead of the study's.
    directory : path, optional
        Folder of ``risk.json``: a run that was stopped goes on where it was, and one that is done to a larger n.
    workers, executor, dask, progress
        As in `run_study`; no number depends on them.
    depths, dtle_limits : sequence of float [m]
        Depths beyond the line and distances to the lane edge whose probabilities are estimated.
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
    >>> from studies import Study
    >>> from studies.risk import estimate_risk
    >>> study = Study.from_dict({"name": "tail", "design": [{"law": "lqr", "y_s": 0.1}]})
    >>> risk = estimate_risk(study.designs, study, n=500, workers=1)
    >>> risk.designs[0].law, risk.n, risk.events[2]
    ('none', 500, 'depth > 0.8 m')
    >>> risk.against_no_control(study.designs[0], "depth > 0.3 m").text
    'better'
    """
    for name, value, most in (("n", n, MOST), ("chunk", CHUNK if chunk is None else chunk, MOST)):
        if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
            raise InputError(f"{name}: {value!r}; allowed: a whole number from 1 to {most:.0e}")
    job = _job(designs, study, study.seed if seed is None else seed, model, chunk, depths, dtle_limits)
    chosen = make_executor(executor, workers, dask)
    shown = progress if not isinstance(progress, bool | None) else default_progress(progress)
    try:
        if chosen.isolated:
            job = dataclasses.replace(job, laws=laws_of_this_process(), token=time.time_ns())
        if directory is None:
            return _estimate(_Estimation(job, n, None), chosen, shown, notice)
        folder = Path(directory)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StoreError(f"{folder}: cannot be made: {error.strerror or error}") from None
        with locked(folder):
            remove_unfinished(folder / FILE)
            return _estimate(_Estimation(job, n, folder), chosen, shown, notice)
    finally:
        shown.close()


def _job(
    designs: Sequence[Design], study: Study, seed: int, model: str | Path | ScenarioModel | None, chunk: int | None,
    depths: Sequence[float], dtle_limits: Sequence[float],
) -> ChunkJob:  # fmt: skip
    source = study_source(study, model)
    if not isinstance(source, ScenarioModel):
        raise InputError(
            f"study {study.name}: replays recorded departures, which have no tail beyond themselves; give model"
        )
    for name, values, least in (("depths", depths, 0.0), ("dtle_limits", dtle_limits, -np.inf)):
        if not all(least < x < np.inf for x in values):
            raise InputError(f"{name}: {list(values)}; allowed: numbers{' > 0' if least == 0.0 else ''} [m]")
    active = tuple({one.id: one for one in designs if not one.is_baseline}.values())
    slow = any(design.batch < _USUAL_BATCH for design in active)
    return ChunkJob(
        designs=(Design.from_gains(NO_CONTROL, active[0].y_s if active else 0.2, {}), *active),
        setup=dataclasses.replace(study.setup(), seed=seed),
        model=source,
        given=study.scenarios.given or None,
        seed=seed,
        chunk=chunk or (_SLOW_CHUNK if slow else CHUNK),
        share=_recorded(source) or (1, 1),
        depths=tuple(sorted({float(x) for x in depths})),
        dtle_limits=tuple(sorted({float(x) for x in dtle_limits}, reverse=True)),
    )


def _estimate(work: _Estimation, executor: Executor, progress: Progress, notice: Callable[[str], None] | None) -> Risk:
    tasks = work.tasks()
    total, orderly = sum(task.size for task in tasks), False
    progress.stage("departures", total)
    if notice is not None and not tasks:
        notice(f"all departures were driven before; {resolution(work.n)}")
    try:
        for i, (task, tally, seconds) in enumerate(_run(tasks, executor)):
            work.take(task, tally)
            progress.advance(task.size)
            # the first chunk of a worker also loads the compiled loops
            if notice is not None and i == min(executor.workers, len(tasks) - 1):
                whole = total * seconds / task.size / executor.workers
                shown = f"{whole:.0f} s" if whole < 120.0 else f"{whole / 60.0:,.0f} min"
                notice(f"{total:,} departures take about {shown}; {resolution(work.n)}")
        orderly = True
    finally:
        executor.close(orderly=orderly)
        if not orderly:
            with contextlib.suppress(StoreError):  # why the run ended says more
                work.store()
    found = work.result()
    work.store(found)
    return found


def _run(tasks: Sequence[ChunkTask], executor: Executor) -> Iterator[tuple[ChunkTask, Tally, float]]:
    """Run chunks; one that was under way when a worker died is run once more alone."""
    waiting, suspects, under_way, faults = deque(tasks), set[int](), 0, Faults()
    while waiting or under_way:
        most = 1 if suspects or executor.workers == 1 else 2 * executor.workers
        while waiting and under_way < most:
            executor.start(waiting.popleft())
            under_way += 1
        came = executor.wait()
        faults.came_back(came)
        for one in came:
            under_way -= 1
            if one.done is None:
                if one.fault is not None and faults.guilty(one.task, one.fault, certain=one.certain):
                    raise LdcError(f"a design ends its worker process among departures of chunk {one.task.k}")
                suspects |= {one.task.number} if one.fault is not None else set()
                waiting.appendleft(one.task)
                continue
            faults.ended_well()
            suspects.discard(one.task.number)
            tally, reason, seconds = one.done
            if tally is None:
                raise LdcError(reason)
            yield one.task, tally, seconds
