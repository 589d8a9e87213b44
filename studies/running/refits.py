"""The winner and the baseline on departures of refitted models: what the recordings leave open, kept in a file."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import LdcError
from ldctoolkit.scenario_model import Given, ScenarioModel
from ldctoolkit.scenario_model.refit import NOT_KEPT, refit, uncertainty
from ldctoolkit.version import versions

from ..design import Design
from ..results import FAILED_STATUSES, RefitScores, status_among
from ..storage.folder_files import write_json
from ..storage.store import REFITS_FILE, read_refits
from ..study_file import Study
from .campaign import laws_to_send
from .dispatch import Executor, Lost, Progress, Work, run_works
from .tasks import Job, Simulator, Task, learn

_LEAST, _MOST = 1000, 4000  # departures of a half
_OF_SLOW: Final = 100  # of a law whose batches are small
_USUAL_BATCH, _SLOW_BATCH = 1000, 100  # with smaller ones than the second no law is driven again
_STREAM: Final = 0x72656373  # keeps these departures apart from those that designs were chosen on


@dataclasses.dataclass(frozen=True, eq=False)
class RefitTask(Work):
    """Some designs on two independent draws from one refit; the draws of all refits follow from the same numbers."""

    job: Job
    designs: tuple[Design, ...]
    model: ScenarioModel
    counts: tuple[int, int]  # left and right departures of a draw
    given: Given | None
    refit: int

    @property
    def time_limit(self) -> float:
        """The limit of the job [s]."""
        return self.job.time_limit

    def make_ready(self, cache: dict[str, Any]) -> None:  # noqa: ARG002
        """Make the controllers of the job known."""
        learn(self.job.laws)

    def run(self, cache: dict[str, Any]) -> FloatArray:  # noqa: ARG002
        """Mean S of each design and then without control, of both draws: (designs + 1, 2); NaN where it failed."""
        means = np.full((len(self.designs) + 1, 2), np.nan)
        try:
            again = refit(self.model, self.refit)
            for draw in range(2):
                means[:, draw] = self._means(again, draw)
        except (LdcError, np.linalg.LinAlgError):
            means[:] = np.nan  # counted as failed
        return means

    def _means(self, model: ScenarioModel, draw: int) -> FloatArray:
        seed = int(np.random.SeedSequence([self.job.setup.seed, _STREAM, draw]).generate_state(1, np.uint64)[0] >> 1)
        drawn = model.sample(*self.counts, seed=seed, given=self.given)
        rows, columns = np.arange(drawn.n), []
        drawn = dataclasses.replace(drawn, index=rows + draw * drawn.n)
        for design in self.designs:
            done = Simulator(self.job).run(Task(self.job, (design,), rows, drawn, 0, drawn.n))
            if done.result is None:
                raise LdcError(design.label, done.failed[0].reason)
            (S, without), failed = done.result.values[:2, 0], status_among(done.result.status[0], FAILED_STATUSES)
            columns += [np.where(failed, np.maximum(S, without), S)]
        scores = np.stack([*columns, without])
        return np.asarray(scores[:, np.isfinite(scores).all(axis=0)].mean(axis=1))


def scores_of_refits(
    study: Study, designs: Sequence[Design], model: ScenarioModel, folder: Path, executor: Executor,
    progress: Progress, *, refits: int, time_limit: float,
) -> RefitScores:  # fmt: skip
    """Mean S of some designs on so many refits: what DIR/refits.json holds of just these, else driven and stored."""
    ids, recorded, isolated = tuple(design.id for design in designs), model.provenance.recorded, executor.isolated
    identity = hashlib.sha256(repr(recorded).encode()).hexdigest()
    key = [study.ranked_as, model.content_hash, identity, list(ids), refits, dict(versions())]
    if (stored := read_refits(folder, key)) is not None:
        return stored
    (folder / REFITS_FILE).unlink(missing_ok=True)  # of another winner, model or version
    means, factor, df, text, doubt = np.empty((0, len(ids) + 1, 2)), math.nan, math.nan, NOT_KEPT, ""
    batch = min((design.batch for design in designs), default=0)
    if recorded is not None and batch < _SLOW_BATCH:
        text = "its law takes too long to be driven on refits of the model"
    elif recorded is not None:
        job = Job(
            study.ranked_as,
            study.setup(),
            study.simulation.window,
            laws_to_send(study.classes.values()) if isolated else b"",
            time_limit if isolated else 0.0,
        )
        half = min(max(_LEAST, len(recorded.side)), _MOST) if batch >= _USUAL_BATCH else _OF_SLOW
        left, right = (math.ceil(half * count / sum(study.scenarios.counts)) for count in study.scenarios.counts)
        given = study.scenarios.given or None
        tasks = [RefitTask(job, tuple(designs), model, (left, right), given, i) for i in range(refits)]
        progress.stage("refits of the model", refits)
        results = {}
        for task, result in run_works(executor, tasks):
            progress.advance(1)
            if not isinstance(result, Lost) and np.isfinite(result).all():
                results[task.refit] = result
        means = np.array([results[i] for i in sorted(results)]).reshape(-1, *means.shape[1:])
        factor, df = uncertainty(recorded, len(means))
        text, doubt = recorded.clusters.text, recorded.clusters.doubt
    scores = RefitScores(ids, means, refits - len(means), factor, df, text, doubt)
    numbers = {"S": means.tolist(), "factor": str(factor), "df": str(df)}  # JSON has no word for what is not a number
    write_json(folder / REFITS_FILE, {"key": key, "scores": vars(scores) | numbers}, indent=None)
    return scores
