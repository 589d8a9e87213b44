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
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import LdcError
from ldctoolkit.scenario_model import Given, ScenarioModel
from ldctoolkit.scenario_model.refit import NOT_KEPT, refit, uncertainty
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover, Window

from ..design import Design
from ..results import FAILED_STATUSES, RefitScores, status_among
from ..storage.folder_files import write_fields
from ..storage.store import REFITS_FILE, read_refits
from ..study_file import Study
from .campaign import laws_to_send
from .dispatch import Executor, Lost, Progress, Work, run_works
from .tasks import drive_each, learn

_LEAST, _ENOUGH, _MOST = 300, 1000, 4000  # departures of a draw
_OF_SLOW: Final = 100  # of a law whose batches are small
_USUAL_BATCH, _SLOW_BATCH = 1000, 100  # with smaller ones than the second no law is driven again
_STREAM: Final = 0x72656373  # keeps these departures apart from those that designs were chosen on


@dataclasses.dataclass(frozen=True, eq=False)
class RefitTask(Work):
    """Some designs on two independent draws from one refit; the draws of all refits follow from the same numbers."""

    designs: tuple[Design, ...]
    model: ScenarioModel
    counts: tuple[int, int]  # left and right departures of a draw
    given: Given
    setup: Setup
    window: Window
    laws: bytes  # controllers that no installed package offers
    limit: float  # [s]
    refit: int

    @property
    def time_limit(self) -> float:
        """The limit [s]."""
        return self.limit

    def make_ready(self, cache: dict[str, Any]) -> None:  # noqa: ARG002
        """Make the controllers known."""
        learn(self.laws)

    def run(self, cache: dict[str, Any]) -> FloatArray:  # noqa: ARG002
        """Mean S of each design and then without control, of both draws: (designs + 1, 2); NaN where it failed."""
        try:
            return self._means(refit(self.model, self.refit))
        except (LdcError, np.linalg.LinAlgError):
            return np.full((len(self.designs) + 1, 2), np.nan)  # counted as failed

    def _means(self, model: ScenarioModel) -> FloatArray:
        sequences = (np.random.SeedSequence([self.setup.seed, _STREAM, draw]) for draw in range(2))
        seeds = (int(sequence.generate_state(1, np.uint64)[0] >> 1) for sequence in sequences)
        draws = [model.sample(*self.counts, seed=seed, given=self.given) for seed in seeds]
        # both in one go: a law that is called sample by sample is called half as often
        names = ("side", *PARAMETER_NAMES)
        drawn = Scenarios.drawn(**{name: np.concatenate([getattr(draw, name) for draw in draws]) for name in names})
        columns = []
        for design in self.designs:
            (run,) = drive_each([design], Takeover.build(drawn, self.setup, y_s=design.y_s), self.setup.convention)
            if isinstance(run, str):
                raise LdcError(design.label, run)
            outcome = run.outcome(self.window)
            S, without = outcome.S, outcome.S_uncorrected
            columns += [np.where(status_among(outcome.status, FAILED_STATUSES), np.maximum(S, without), S)]
        halves = np.split(np.stack([*columns, without]), 2, axis=1)
        return np.stack([half[:, np.isfinite(half).all(axis=0)].mean(axis=1) for half in halves], axis=1)


def scores_of_refits(
    study: Study, designs: Sequence[Design], model: ScenarioModel, folder: Path, executor: Executor,
    progress: Progress, *, refits: int, time_limit: float,
) -> RefitScores:  # fmt: skip
    """Mean S of some designs on so many refits: what DIR/refits.json holds of just these, else driven and stored."""
    ids, recorded, isolated = tuple(design.id for design in designs), model.provenance.recorded, executor.isolated
    identity = hashlib.sha256(repr(recorded).encode()).hexdigest()
    key = study.ranked_as, model.content_hash, identity, str(refits)
    stored = read_refits(folder, *key)
    if stored is not None and stored.designs == ids:
        return stored
    (folder / REFITS_FILE).unlink(missing_ok=True)  # of another winner or model
    means, factor, df, text, doubt = np.empty((0, len(ids) + 1, 2)), math.nan, math.nan, NOT_KEPT, ""
    batch = min((design.batch for design in designs), default=0)
    if recorded is not None and batch < _SLOW_BATCH:
        text = "its law takes too long to be driven on refits of the model"
    elif recorded is not None:
        # with twice as many as were recorded, the sampling error of the draws is small beside the spread of the refits
        n = len(recorded.side)
        drawn = min(max(_LEAST, min(2 * n, _ENOUGH), n), _MOST) if batch >= _USUAL_BATCH else _OF_SLOW
        left, right = (math.ceil(drawn * count / sum(study.scenarios.counts)) for count in study.scenarios.counts)
        laws, limit = (laws_to_send(study.classes.values()), time_limit) if isolated else (b"", 0.0)
        how = (left, right), study.scenarios.given, study.setup(), study.simulation.window
        tasks = [RefitTask(tuple(designs), model, *how, laws, limit, i) for i in range(refits)]
        progress.stage("refits of the model", refits)
        results = {}
        for task, result in run_works(executor, tasks):
            progress.advance(1)
            if not isinstance(result, Lost) and np.isfinite(result).all():
                results[task.refit] = result
        means = np.array([results[i] for i in sorted(results)]).reshape(-1, *means.shape[1:])
        factor, df = uncertainty(recorded, len(means))
        text, doubt = recorded.clusters.text, recorded.clusters.doubt
    scores = RefitScores(ids, means, refits - len(means), factor, df, key, text, doubt)
    if math.isfinite(factor) and math.isnan(scores.half_width(scores.S[:, -1], 0.95)):
        scores = dataclasses.replace(scores, text=f"{scores.failed} of {refits} refits failed")
    write_fields(folder / REFITS_FILE, scores)
    return scores
