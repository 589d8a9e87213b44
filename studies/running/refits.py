"""The winner and the baseline on departures of refitted models: what the recordings leave open, kept in a file."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import LdcError
from ldctoolkit.scenario_model import Given, ScenarioModel
from ldctoolkit.scenario_model.refit import NOT_KEPT, Uncertainty, refit
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
    counts: tuple[int, int]  # left and right departures of a half
    given: Given | None
    refit: int

    @property
    def time_limit(self) -> float:
        """The limit of the job [s]."""
        return self.job.time_limit

    def make_ready(self, cache: dict[str, Any]) -> None:
        """Make the controllers of the job known, once."""
        if cache.get("refits") != self.job.token:
            learn(self.job.laws)
            cache["refits"] = self.job.token

    def run(self, cache: dict[str, Any]) -> tuple[FloatArray]:  # noqa: ARG002
        """Mean S of each design and then without control, of both halves: (designs + 1, 2); NaN where it failed."""
        means = np.full((len(self.designs) + 1, 2), np.nan)
        try:
            again = refit(self.model, self.refit)
            for half in range(2):
                seed = np.random.SeedSequence([self.job.setup.seed, _STREAM, half]).generate_state(1, np.uint64)[0]
                drawn = again.sample(*self.counts, seed=int(seed >> 1), given=self.given)
                rows = np.arange(drawn.n)
                drawn = dataclasses.replace(drawn, index=rows + half * drawn.n)
                scores = []
                for design in self.designs:
                    task = Task(self.job, (design,), rows, drawn, 0, drawn.n)
                    result = Simulator(self.job).run(task).result
                    if result is None:
                        return (means,)
                    S, without = result.values[0, 0], result.values[1, 0]
                    failed = status_among(result.status[0], FAILED_STATUSES)
                    scores.append(np.where(failed, np.maximum(S, without), S))
                columns = np.stack([*scores, without])
                means[:, half] = columns[:, np.isfinite(columns).all(axis=0)].mean(axis=1)
        except (LdcError, np.linalg.LinAlgError, FloatingPointError):
            means[:] = np.nan  # it is counted as failed
        return (means,)


def scores_of_refits(
    study: Study,
    designs: Sequence[Design],
    model: ScenarioModel,
    folder: Path,
    executor: Executor,
    progress: Progress,
    *,
    refits: int,
    time_limit: float,
) -> RefitScores:
    """Mean S of some designs on so many refits: what DIR/refits.json holds of just these, else driven and stored."""
    ids, recorded = tuple(design.id for design in designs), model.recorded
    key = [study.ranked_as, model.content_hash, recorded and recorded.digest, list(ids), refits, dict(versions())]
    stored = read_refits(folder, key)
    if stored is not None:
        return stored
    (folder / REFITS_FILE).unlink(missing_ok=True)  # of another winner, model or version
    means, uncertainty, text = np.empty((0, len(ids) + 1, 2)), Uncertainty(math.nan, math.nan), NOT_KEPT
    slow = [design.label for design in designs if design.batch < _SLOW_BATCH]
    if recorded is not None and slow:
        text = f"not driven on refits of the model, {slow[0]} takes too long"
    elif recorded is not None:
        counts, isolated = study.scenarios.counts, executor.isolated
        usual = min(design.batch for design in designs) >= _USUAL_BATCH
        half = min(max(_LEAST, recorded.departures.n), _MOST) if usual else _OF_SLOW
        left, right = (math.ceil(half * count / sum(counts)) for count in counts)
        job = Job(
            token=study.ranked_as,
            setup=study.setup(),
            window=study.simulation.window,
            laws=laws_to_send(study.classes.values()) if isolated else b"",
            time_limit=time_limit if isolated else 0.0,
        )
        given = study.scenarios.given or None
        tasks = [RefitTask(job, tuple(designs), model, (left, right), given, i) for i in range(refits)]
        progress.stage("refits of the model", refits)
        results = {}
        for task, result in run_works(executor, tasks):
            progress.advance(1)
            if not isinstance(result, Lost):
                results[task.refit] = result[0]
        means = np.array([results[i] for i in sorted(results) if np.isfinite(results[i]).all()])
        means = means.reshape(-1, len(ids) + 1, 2)
        uncertainty, text = Uncertainty.of(recorded, len(means)), recorded.clusters.text
    scores = RefitScores(ids, means, refits - len(means), uncertainty.factor, uncertainty.df, text)
    content = vars(scores) | {"S": means.tolist(), "factor": str(scores.factor), "df": str(scores.df)}
    write_json(folder / REFITS_FILE, {"key": key, "scores": content}, indent=None)
    return scores
