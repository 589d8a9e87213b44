"""Time of a law's step for one vehicle: measured on this machine, never a result."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover

from .design import Design
from .ranking.verdict import StepTimes
from .results import StudyResults
from .running.tasks import drive_each
from .storage.measure_table import Arrays, remembered

_STEPS: Final = 300  # timed at least, where the departures have so many
_DEPARTURES: Final = 12  # driven at most
_SECONDS: Final = 2.0  # in steps, after which no further departure is driven


def step_times(results: StudyResults, setup: Setup, designs: Sequence[Design], folder: Path | None = None) -> StepTimes:
    """Of those of the designs whose laws are stepped; what a folder holds of them, else measured and stored there.

    A linear law has no step, and a law that ended or held up a worker process is not driven here.
    """
    left_out = {results.designs[i].id for i in np.flatnonzero(results.law_time == 0.0)}
    left_out |= {design.id for design in results.unsafe}
    timed = [design for design in designs if design.id not in left_out]
    if not timed:
        return {}

    def measure() -> Arrays:
        scenarios = results.scenarios.take(results.drivable)
        singles = {y_s: _singles(Takeover.build(scenarios, setup, y_s=y_s), y_s) for y_s in {d.y_s for d in timed}}
        return {design.id: np.array(list(_seconds(design, singles[design.y_s]))) for design in timed}

    seconds = remembered(folder, "step-times", [design.id for design in timed], measure)
    return {id: (float(np.median(of)), float(np.quantile(of, 0.99))) for id, of in seconds.items() if of.size}


def _singles(over: Takeover, y_s: float) -> list[Takeover]:
    """Departures spread over those that trigger, each alone."""
    rows = np.unique(np.linspace(0, over.m - 1, min(_DEPARTURES, over.m)).astype(np.int64))
    return [Takeover.build(over.scenarios.take(over.rows[[row]]), over.setup, y_s=y_s) for row in rows]


def _seconds(design: Design, singles: Sequence[Takeover]) -> Iterator[float]:
    """Seconds of single steps.

    Each is driven twice, and the shorter time of a step counts: loading code, and what else a machine does, is not the
    law's.
    """
    count, spent = 0, 0.0
    for single in singles:
        runs = [drive_each([design], single, single.setup.convention)[0] for _ in range(2)]
        twice = [run.step_seconds for run in runs if not isinstance(run, str)]
        most = min(map(len, twice)) if len(twice) == 2 else 0  # of a law that is not the same twice
        yield from np.minimum(*(seconds[:most] for seconds in twice)).tolist() if most else ()
        count, spent = count + most, spent + sum(float(seconds.sum()) for seconds in twice)
        if not most or count >= _STEPS or spent > _SECONDS:
            return
