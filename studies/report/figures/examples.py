"""Example departures: chosen by rule, driven again to get their paths."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit import BicycleModel, EventStatus, Outcome
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.simulation import Takeover, drive
from ldctoolkit.simulation.uncorrected import UncorrectedPath
from studies.design import Design
from studies.report.figures.path_figures import ControlledPath, Example
from studies.report.inputs import ReportInput
from studies.report.look.style import LineStyle
from studies.report.words.text import number
from studies.results import CaseResults

IntArray = npt.NDArray[np.int64]
SIDE_NAMES = {LEFT: "Left", RIGHT: "Right"}

_ROLES = ("least reduction", "median reduction", "greatest reduction")


@dataclasses.dataclass(frozen=True)
class Replay:
    """Example departures and how well driving them again met the stored scores.

    Attributes
    ----------
    examples : tuple of Example
    mismatch : float
        Largest relative difference between a score from the replay and the stored one.
    """

    examples: tuple[Example, ...]
    mismatch: float


def choose(reduction: npt.NDArray[np.float64], candidates: IntArray) -> list[tuple[int, str]]:
    """Candidates with the least, the median and the greatest reduction; on a tie the earliest; each scenario once.

    Examples
    --------
    >>> choose(np.array([0.3, 0.1, 0.2]), np.array([0, 1, 2]))
    [(1, 'least reduction'), (2, 'median reduction'), (0, 'greatest reduction')]
    """
    if not candidates.size:
        return []
    order = candidates[np.argsort(reduction[candidates], kind="stable")]
    greatest = int(candidates[np.argmax(reduction[candidates])])
    chosen = [int(order[0]), int(order[(order.size - 1) // 2]), greatest]
    first = dict(reversed(list(zip(chosen, _ROLES, strict=True))))
    return [(row, first[row]) for row in dict.fromkeys(chosen)]


def replay(report: ReportInput, results: CaseResults, shown: Sequence[tuple[int, Design, str, LineStyle]]) -> Replay:
    """Choose departures by the first design's reduction on each side and drive all shown designs on them.

    Parameters
    ----------
    report : ReportInput
        Scenarios, vehicle, plant and clock of the study.
    results : CaseResults
        The primary case.
    shown : sequence of (index, Design, label, LineStyle)
        Designs to be drawn, the winner first; index is the row in `results`.

    Returns
    -------
    Replay
        Up to three examples a side, of departures in which the first design took over.
    """
    scenarios, edge_offset = report.results.scenarios, report.vehicle.edge_offset
    S, S_0 = results.S[shown[0][0]], results.S_uncorrected[shown[0][0]]
    reduction = 1.0 - np.divide(S, S_0, out=np.ones_like(S), where=S_0 > 0)
    took_over = results.status[shown[0][0]] != EventStatus.NEVER_TRIGGERED
    picks = [
        (row, side, role)
        for side in (LEFT, RIGHT)
        for row, role in choose(reduction, np.flatnonzero((scenarios.side == side) & took_over))
    ]
    if not picks:
        return Replay((), 0.0)
    chosen = scenarios.take([row for row, _, _ in picks])
    model = BicycleModel(report.vehicle, convention=results.case.convention)
    paths: list[list[ControlledPath]] = [[] for _ in picks]
    recorded = UncorrectedPath.of(chosen, report.options.residuals, report.seed)
    mismatch = 0.0
    for index, design, label, style in shown:
        if design.is_baseline:
            continue
        takeover = Takeover.build(
            chosen,
            model,
            y_s=design.y_s,
            dt=report.dt,
            initial_yaw_rate=report.initial_yaw_rate,
            options=report.options,
            settle=report.settle,
            seed=report.seed,
        )
        run = drive(design.controller(results.case.convention), takeover, trajectories=True)
        outcome = run.outcome(results.case.window)
        stored = results.S[index][[row for row, _, _ in picks]]
        mismatch = max(mismatch, float(np.max(np.abs(outcome.S - stored) / np.maximum(np.abs(stored), 1e-9))))
        for k in range(len(picks)):
            paths[k].append(_path(outcome, k, label, style, edge_offset))
    examples = []
    for k, (row, side, role) in enumerate(picks):
        one = chosen.take([k])
        t = np.linspace(0.0, float(one.T[0]), 121)
        facts = (
            f"T = {number(float(one.T[0]), 2)} s, v_mean = {number(float(one.v_mean[0]), 1)} m/s, "
            f"d_y = {number(float(one.d_y[0]), 2)} m, scenario {one.index[0]}"
        )
        examples.append(
            Example(
                row,
                SIDE_NAMES[side],
                role,
                facts,
                float(reduction[row]),
                t,
                recorded.take([k]).lateral(t[None, :])[0],
                -2.0 * edge_offset,
                tuple(paths[k]),
            )
        )
    return Replay(tuple(examples), mismatch)


def _path(outcome: Outcome, k: int, label: str, style: LineStyle, edge_offset: float) -> ControlledPath:
    if outcome.trajectories is None:  # the law never intervenes
        empty = np.empty(0)
        return ControlledPath(label, style, empty, empty, empty)
    kept = outcome.trajectories
    driven = np.isfinite(kept.t[k])
    return ControlledPath(label, style, kept.t[k, driven], kept.x[k, driven, 0] - edge_offset, kept.delta[k, driven])
