"""Chunks of generated departures: what is drawn, driven and counted of them, in this process or a worker.

Chunk k follows from the seed and k alone, and what is kept of it is counts and a few of its deepest departures, which
add up in any order: no number depends on workers, or on where a run was stopped.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import time
from typing import Any, Final, Self

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT
from ldctoolkit.errors import InputError, LdcError, ModelError
from ldctoolkit.metrics import UserMetric
from ldctoolkit.scenario_model import Given, ScenarioModel
from ldctoolkit.scenario_model.refit import refit
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Run, Takeover
from ldctoolkit.simulation.sampled_paths import PathSampler
from ldctoolkit.version import versions

from ..design import Design
from ..requirements import Requirement
from .dispatch import Work
from .tasks import drive_each, learn, unpickled

BIN, BINS = 0.05, 60  # [m] of the histogram of depths, and how many; one more is for what is deeper
_WORST: Final = 20  # worst departures of a design
_NONE: Final = -1e9  # where there are fewer
_STREAM: Final = 0x7269736B  # keeps these scenarios apart from those that designs were chosen on


@dataclasses.dataclass(frozen=True, eq=False)
class Tally:
    """What is counted of departures, for d designs (no control first) and e events; sides left, right."""

    n: IntArray  # (2,): departures that were driven
    invalid: IntArray  # (2,): departures that cannot be driven, which are in no other number
    counts: IntArray  # (d, e, 2): departures with the event
    only: IntArray  # (d, e, 2): those of them that do not have it without control
    outside: IntArray  # (d, e, 2): those with the event where no recorded departure is
    refit_n: IntArray  # (r, 2): departures of each refit
    refit_counts: IntArray  # (r, d, e, 2): those with the event
    histogram: IntArray  # (d, BINS + 1): depths
    status: IntArray  # (d, number of `EventStatus`)
    failed_solves: IntArray  # (d,)
    worst: FloatArray  # (d, _WORST, 3 + 8): depth [m], index, side, parameters; deepest first; or `_NONE`

    def plus(self, other: Self) -> Self:
        """The tally of both."""
        both = np.concatenate([self.worst, other.worst], axis=1)
        added = {name: getattr(self, name) + getattr(other, name) for name in vars(self) if name != "worst"}
        return dataclasses.replace(self, **added, worst=np.stack([rows[_deepest(*rows.T[:2])] for rows in both]))

    def worst_of(self, i: int) -> FloatArray:
        """The worst departures of design i."""
        rows: FloatArray = self.worst[i][self.worst[i, :, 0] > _NONE]
        return rows


def _deepest(depth: FloatArray, index: FloatArray | IntArray) -> IntArray:
    """Positions of the deepest departures, deepest first; of equal depths the smallest index first."""
    return np.lexsort((index, -depth))[:_WORST]


@dataclasses.dataclass(frozen=True, eq=False)
class ChunkJob:
    """What all chunks share."""

    designs: tuple[Design, ...]  # no control first
    setup: Setup
    model: ScenarioModel
    given: Given | None
    n: int  # departures in all
    chunk: int  # departures in a chunk; the last one may be smaller
    share: tuple[int, ...]  # left and right departures in proportion
    depths: tuple[float, ...]
    dtle_limits: tuple[float, ...]
    refits: int = 0  # of the model; on all of them half as many departures are driven
    laws: bytes = b""  # controllers that no installed package offers
    metrics: bytes | tuple[UserMetric, ...] = ()  # of a designer; pickled for another process
    limits: tuple[Requirement, ...] = ()  # on these metrics: a departure whose value meets one has the event
    token: int = 0  # of the run in its process

    @property
    def events(self) -> tuple[str, ...]:
        """Names of the events, in the order of all arrays."""
        depths, limits = (f"depth > {x:g} m" for x in self.depths), (f"DTLE < {x:g} m" for x in self.dtle_limits)
        users = (f"{of.metric.of[0]} {of.operator} {of.limit:g}" for of in self.limits)
        return (*depths, *limits, *users, "opposite line crossed", "diverged")

    @property
    def empty(self) -> Tally:
        """A tally of no departure."""
        d, e, r = len(self.designs), len(self.events), self.refits
        each, worst = (d, e, 2), np.full((d, _WORST, 3 + len(PARAMETER_NAMES)), _NONE)
        shapes = (2,), (2,), each, each, each, (r, 2), (r, *each), (d, BINS + 1), (d, len(EventStatus)), (d,)
        arrays: list[Any] = [*(np.zeros(shape, dtype=np.int64) for shape in shapes), worst]
        return Tally(*arrays)

    def identity(self) -> dict[str, Any]:
        """What decides the numbers."""
        setup = hashlib.sha256(repr(dataclasses.asdict(self.setup)).encode()).hexdigest()[:16]
        designs = [design.id for design in self.designs]
        same = {"versions": dict(versions()), "designs": designs, "setup": setup, "n": self.n}
        same |= {"model": self.model.content_hash, "given": self.given, "seed": self.setup.seed, "chunk": self.chunk}
        recorded = hashlib.sha256(repr(self.model.provenance.recorded).encode()).hexdigest()[:16]
        same |= {"metrics": [metric.code for metric in self._metrics]} if self.metrics else {}
        same |= {"left_right": self.share, "events": self.events, "refits": self.refits, "recorded": recorded}
        return dict(json.loads(json.dumps(same)))

    @property
    def _metrics(self) -> tuple[UserMetric, ...]:
        metrics: tuple[UserMetric, ...] = unpickled(self.metrics) if isinstance(self.metrics, bytes) else self.metrics
        return metrics

    def scenarios(self, k: int) -> Scenarios:
        """The departures of chunk k."""
        first, (share, whole) = k * self.chunk, (self.share[0], sum(self.share))
        last = min(first + self.chunk, self.n)
        begin, end = ((2 * m * share + whole) // (2 * whole) for m in (first, last))  # left ones among m
        seed = int(np.random.SeedSequence([self.setup.seed, _STREAM, k]).generate_state(1, np.uint64)[0] >> 1)
        drawn = self.model.sample(end - begin, last - first - (end - begin), seed=seed, given=self.given)
        # mismatch and camera noise follow from the setup's seed and this number
        return dataclasses.replace(drawn, index=np.arange(first, last))

    @property
    def sizes(self) -> tuple[int, int]:
        """Chunks of the model, and of each refit; they are numbered in this order."""
        return -(-self.n // self.chunk), -(-self._of_refit // self.chunk)

    @property
    def _of_refit(self) -> int:
        return -(-self.n // (2 * max(self.refits, 1)))

    def measure(self, k: int) -> Tally:
        """Drive all designs on a chunk; `LdcError` names a design whose law raises."""
        own, each = self.sizes
        if k < own:
            return self._counted(self.scenarios(k))
        tally, (number, j) = self.empty, divmod(k - own, each)
        with contextlib.suppress(InputError, ModelError, np.linalg.LinAlgError):  # one without departures has failed
            seed = np.random.SeedSequence([self.setup.seed, _STREAM, number, 1]).generate_state(1, np.uint64)[0]
            setup = dataclasses.replace(self.setup, seed=int(seed >> 1))
            again = dataclasses.replace(self, model=refit(self.model, number), setup=setup, n=self._of_refit, refits=0)
            counted = again._counted(again.scenarios(j))
            tally.refit_n[number], tally.refit_counts[number] = counted.n, counted.counts
        return tally

    def _counted(self, drawn: Scenarios) -> Tally:
        tally = self.empty
        over = {y_s: Takeover.build(drawn, self.setup, y_s=y_s) for y_s in {design.y_s for design in self.designs}}
        valid = np.logical_and.reduce([takeover.valid for takeover in over.values()])
        for j, side in enumerate((LEFT, RIGHT)):
            tally.n[j] = (valid & (drawn.side == side)).sum()
            tally.invalid[j] = (~valid & (drawn.side == side)).sum()
        metrics, y_0 = self._metrics, self.designs[0].y_s
        without = self._count(tally, 0, PathSampler(over[y_0], metrics), None, valid, None)
        for y_s, takeover in over.items():
            sampler = PathSampler(takeover, metrics)
            rows = [i for i, design in enumerate(self.designs) if i and design.y_s == y_s]
            for group in [[i] for i in rows] if metrics else [rows]:
                designs, convention = [self.designs[i] for i in group], self.setup.convention
                for i, run in zip(group, drive_each(designs, takeover, convention, paths=bool(metrics)), strict=True):
                    if isinstance(run, str):
                        raise LdcError(self.designs[i].label, run)
                    self._count(tally, i, sampler, run, valid, without)
        return tally

    def _outside(self, drawn: Scenarios) -> BoolArray:
        """Which departures (n,) lie beyond the recorded ones of their side in depth, duration or speed."""
        outside = np.zeros(drawn.n, dtype=np.bool_)
        if (recorded := self.model.provenance.recorded) is None:
            return outside
        for side in (LEFT, RIGHT):
            known = recorded.departures.take(recorded.departures.side == side)
            for name in ("d_y", "T", "v_mean"):
                x, ends = getattr(drawn, name), getattr(known, name)
                outside |= (drawn.side == side) & ((x < ends.min()) | (x > ends.max()))
        return outside

    def _count(
        self, tally: Tally, i: int, sampler: PathSampler, run: Run | None, valid: BoolArray, without: BoolArray | None
    ) -> BoolArray:
        """Count design i, `run` is None for no control; which events (e, n) happened."""
        over = sampler.over
        drawn, status = over.scenarios, np.full(over.scenarios.n, EventStatus.NEVER_TRIGGERED, dtype=np.int64)
        measured = {name: getattr(over.recorded, name).copy() for name in ("deepest", "dtle", "opposite_crossing")}
        if run is not None:
            status[over.rows] = run.status
            tally.failed_solves[i] = run.failed_solves[valid[over.rows]].sum()
            for name, column in measured.items():
                column[over.rows] = getattr(run.metrics, name)
        depth, dtle, opposite = measured.values()
        if any(np.isnan(column[valid]).any() for column in measured.values()):
            raise LdcError(self.designs[i].label, "a depth is not a number")
        values = sampler.recorded if run is None else sampler.values(run)
        users = {metric.name: column for metric, column in zip(self._metrics, values, strict=True)}
        if wrong := [name for name, column in users.items() if np.isnan(column[valid]).any()]:
            raise LdcError(self.designs[i].label, f"metric {wrong[0]} is not a number")
        beyond = [*(depth > x for x in self.depths), *(dtle < x for x in self.dtle_limits)]
        beyond += [limit.met(users[limit.metric.of[0]]) for limit in self.limits]
        events = np.stack([*beyond, opposite > 0.0, status == EventStatus.DIVERGED]) & valid
        outside = self._outside(drawn)
        for j, side in enumerate((LEFT, RIGHT)):
            tally.counts[i, :, j] = (events & (drawn.side == side)).sum(axis=1)
            tally.outside[i, :, j] = (events & outside & (drawn.side == side)).sum(axis=1)
            if without is not None:
                tally.only[i, :, j] = (events & ~without & (drawn.side == side)).sum(axis=1)
        tally.histogram[i] = np.bincount(np.clip(depth[valid] / BIN, 0, BINS).astype(int), minlength=BINS + 1)
        tally.status[i] = np.bincount(status[valid], minlength=len(EventStatus))
        rows = np.flatnonzero(valid)
        rows = rows[_deepest(depth[rows], drawn.index[rows])]
        columns = [depth, drawn.index, drawn.side, *(getattr(drawn, name) for name in PARAMETER_NAMES)]
        tally.worst[i, : rows.size] = np.column_stack(columns)[rows]
        return events


@dataclasses.dataclass(frozen=True, eq=False)
class ChunkTask(Work):
    """A chunk as work for an executor."""

    job: ChunkJob
    chunk: int

    def make_ready(self, cache: dict[str, Any]) -> None:
        """Make the controllers of the job known, once."""
        if cache.get("risk") != self.job.token:
            learn(self.job.laws)
            cache["risk"] = self.job.token

    def run(self, cache: dict[str, Any]) -> tuple[Tally | LdcError, float]:  # noqa: ARG002
        """The counts, or the error in their place, and the seconds that the drives took."""
        started = time.perf_counter()
        try:
            return self.job.measure(self.chunk), time.perf_counter() - started
        except LdcError as error:
            return error, 0.0
