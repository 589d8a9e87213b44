"""The closed loop over all scenarios at once: linear laws in compiled loops, other laws through `SteeringLaw.step`.

A scenario is driven by itself, whichever loop drives it, so that its numbers cannot depend on which others run beside
it, on their order or on the number of threads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import Controller, Law, LinearLaw, RecordedPath, SteeringLaw
from ldctoolkit.law_checks import check_controller, check_law
from ldctoolkit.simulation.general_loop import drive_general
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.outcome import Run
from ldctoolkit.simulation.runs import (
    SCENARIOS_A_TASK,
    Chosen,
    chosen_rows,
    in_threads,
    recorded_run,
    run_of_area,
    run_of_scores,
    trajectories_of,
)
from ldctoolkit.simulation.takeover import BOUND, STIFF, Takeover, law_tables, times_of

_TOGETHER = 2**21
"""Scores of linear laws that go through the compiled loop in one call, in numbers of scenarios times designs."""


def drive(
    controller: Controller, takeover: Takeover, *, trajectories: Chosen = False, threads: int | None = None
) -> Run:
    """Drive one design from the trigger to the end of every departure and of the settling horizon.

    Parameters
    ----------
    controller : Controller
        The design.
    takeover : Takeover
        Scenarios at their triggers.
    trajectories : bool or (c,) int
        Keep the paths: of all scenarios, or of those with these row numbers.
    threads : int, optional
        Of the compiled loops; all cores this process may use by default. It changes no number.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If the design, its law or the result of a step is not what the interface promises.
    """
    rows = chosen_rows(trajectories, takeover.scenarios.n)
    law = _prepared(controller, takeover)
    if isinstance(law, SteeringLaw):
        return drive_general(law, takeover, controller.name, rows, threads)
    if isinstance(law, RecordedPath):
        return recorded_run(takeover)
    return _drive_linear([law], takeover, rows, threads)[0]


def drive_many(
    controllers: Iterable[Controller], takeover: Takeover, *, score_only: bool = False, threads: int | None = None
) -> Iterator[Run]:
    """Drive several designs; linear laws go through the compiled loop together, so that scenarios are read once.

    Parameters
    ----------
    controllers : iterable of Controller
        The designs.
    takeover : Takeover
        Scenarios at their triggers.
    score_only : bool
        S is all that is wanted: linear laws on the ideal plant are then driven to T only, which takes less time, and
        their companions are NaN; what would diverge or fail after T is not seen. S is the same to rounding. Other laws
        and plants are driven as ever.
    threads : int, optional
        As in `drive`.

    Yields
    ------
    Run
        In the order of the designs; the same bits as from `drive`.

    Raises
    ------
    InputError
        As in `drive`.
    """
    most = max(1, _TOGETHER // max(1, takeover.m * data.SCORES))
    waiting: list[LinearLaw] = []
    for controller in controllers:
        law = _prepared(controller, takeover)
        if waiting and not (
            isinstance(law, LinearLaw)
            and len(waiting) < most
            and law.preview_times.size == waiting[0].preview_times.size
        ):
            yield from _drive_linear(waiting, takeover, None, threads, score_only)
            waiting = []
        if isinstance(law, LinearLaw):
            waiting.append(law)
        elif isinstance(law, SteeringLaw):
            yield drive_general(law, takeover, controller.name, None, threads)
        else:
            yield recorded_run(takeover)
    if waiting:
        yield from _drive_linear(waiting, takeover, None, threads, score_only)


def _prepared(controller: Controller, takeover: Takeover) -> Law:
    check_controller(controller)
    return check_law(controller.prepare(takeover.plant), takeover.m, controller.name)


def _drive_linear(
    laws: list[LinearLaw], takeover: Takeover, rows: IntArray | None, threads: int | None, score_only: bool = False
) -> list[Run]:
    from ldctoolkit.simulation.kernel import entry

    tables, d, m = takeover.tables, len(laws), takeover.m
    options = takeover.setup.options
    exactly = options.drives_exactly and options.sensors.ideal
    times = np.stack([times_of(law) for law in laws])
    table = law_tables(laws, tables.spare_room(d * m * (data.LAW + 2 * times.shape[1])))
    scene, setting = tables.scene_to_T if score_only and exactly else tables.scene, tables.setting
    score = np.full((d, data.SCORES, m), np.nan)  # a scenario that were left out would be seen
    diverged, failed = np.zeros((d, m), dtype=np.bool_), np.zeros((d, m), dtype=np.int64)
    paths, place, found = tables.paths(rows)

    def drive_any(places: IntArray, score: FloatArray, diverged: BoolArray, failed: IntArray) -> None:
        """The blocks of scenarios with these places, by the method of Runge and Kutta."""
        blocks = np.unique(places // data.LANES)

        def work(first: int, last: int) -> None:
            entry.drive_any(scene, setting, table, times, paths, place, blocks[first:last], score, diverged, failed)

        in_threads(work, blocks.size, threads, SCENARIOS_A_TASK // 4 // data.LANES)

    if not exactly:
        drive_any(np.arange(m), score, diverged, failed)
    elif m:
        exact = tables.exact

        def work(first: int, last: int) -> None:
            own = entry.scratch(setting, times.shape[1])
            entry.drive_lanes(
                scene, exact, setting, table, times, first, last, score, diverged, failed, own, score_only
            )

        in_threads(work, -(-m // data.LANES), threads, SCENARIOS_A_TASK // data.LANES)
        # a step that is long beside the fastest time constant hides what happens within it; paths are kept there too
        stiff = np.flatnonzero(scene[:, data.SUBSTEPS] > STIFF)
        again = np.union1d(stiff, np.flatnonzero(place >= 0))
        if again.size:
            other = np.empty_like(score), diverged.copy(), failed.copy()
            drive_any(again, *other)
            score[:, :, stiff], diverged[:, stiff] = other[0][:, :, stiff], other[1][:, stiff]
            failed[:, stiff] = other[2][:, stiff]
    if score_only and exactly:
        return [run_of_area(takeover, score[i, data.AREA], diverged[i], failed[i]) for i in range(d)]
    kept = trajectories_of(paths, rows, found)
    return [run_of_scores(takeover, score[i], diverged[i], failed[i], 0.0, kept) for i in range(d)]


__all__ = ["BOUND", "drive", "drive_many"]
