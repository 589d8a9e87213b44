"""Time of a law's step for one vehicle: measured on this machine, never a result."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Takeover

from .design import Design
from .results import StudyResults
from .running.tasks import drive_each
from .storage.measure_table import remembered

_STEPS: Final = 300  # at least, of each design that has so many
_DEPARTURES: Final = 12  # at most
_SECONDS: Final = 2.0  # after which no further departure is driven

_NAME: Final = "step-times"  # of the file that a study's folder keeps them in


class StepTime(NamedTuple):
    """Wall time of a law's step, departures driven one at a time."""

    median: float  # [s]
    p99: float  # [s] 99 % quantile


def step_times(
    results: StudyResults, setup: Setup, designs: Sequence[Design], folder: Path | None = None
) -> dict[str, StepTime]:
    """Times of those of the designs whose laws are stepped, by identifier.

    A linear law has no step, and a law that ended or held up a worker process is not driven here. With a folder the
    times are those that it holds of these designs, else measured and stored there.
    """
    linear = {results.designs[i].id for i in np.flatnonzero(results.law_time == 0.0)}
    left_out = linear | {design.id for design in results.unsafe}
    stepped = [design for design in designs if design.id not in left_out]
    if not stepped:
        return {}
    scenarios = results.on_drivable().scenarios

    def measure() -> dict[str, FloatArray]:
        overs = {y_s: Takeover.build(scenarios, setup, y_s=y_s) for y_s in {design.y_s for design in stepped}}
        return {design.id: np.array(list(_seconds(design, overs[design.y_s]))) for design in stepped}

    seconds = remembered(folder, _NAME, [design.id for design in stepped], measure)
    return {id: StepTime(*np.quantile(of, [0.5, 0.99]).tolist()) for id, of in seconds.items() if of.size}


def _seconds(design: Design, over: Takeover) -> Iterator[float]:
    """Seconds of the steps on departures spread over those that trigger, until there are enough of them.

    Each is driven twice, and the shorter of the two times of a step counts: loading compiled code and what else the
    machine does are not the law's.
    """
    count, spent = 0, 0.0
    for row in np.unique(np.linspace(0, over.m - 1, min(_DEPARTURES, over.m)).astype(np.int64)):
        single = Takeover.build(over.scenarios.take(over.rows[[row]]), over.setup, y_s=design.y_s)
        twice = []
        for _ in range(2):
            (run,) = drive_each([design], single, over.setup.convention)
            if isinstance(run, str) or not run.step_seconds.size:
                return
            twice.append(run.step_seconds)
            spent += run.law_seconds
        most = min(map(len, twice))  # of a law that is not the same twice
        yield from np.minimum(*(seconds[:most] for seconds in twice)).tolist()
        count += most
        if count >= _STEPS or spent > _SECONDS:
            return
