"""Embedded paths, read back from their bytes, against paths from `simulate`."""

from __future__ import annotations

import base64
import dataclasses
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.reports import invented_scenarios, report_input, run
from ldctoolkit import Outcome, Setup, VehicleParameters, simulate
from ldctoolkit.departures import curvature, lateral, lateral_acceleration, speed
from studies.design import Design
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.embedded.departures import BUDGET, embedded_departures, grids, trimmed, weight
from studies.report.embedded.packed import script_json
from studies.report.replay.paths import replay
from studies.report.replay.picks import chosen_designs, picked_departures
from studies.results import Case, StudyResults

Array = npt.NDArray[np.float64]


def read(one: Mapping[str, str]) -> Array:
    return np.frombuffer(base64.b64decode(one["data"]), dtype=f"<{one['type']}").astype(np.float64)


@dataclasses.dataclass
class Held:
    """What the page holds, as plain arrays."""

    data: dict[str, Any]

    @property
    def index(self) -> list[int]:
        return [int(i) for i in read(self.data["departures"]["index"])]

    def column(self, part: str, name: str) -> Array:
        kept = self.data[part][name]  # of the driven ones, a list a design
        return np.concatenate([read(one) for one in kept]) if isinstance(kept, list) else read(kept)

    def lines(self, part: str, *names: str) -> Iterator[dict[str, Array]]:
        count = read(self.data[part]["count"]).astype(int)
        ends = np.cumsum(count)
        columns = {name: self.column(part, name) * self.data["resolution"][name] for name in names}
        for n, end in zip(count, ends, strict=True):
            yield {name: column[end - n : end] for name, column in columns.items()}


def held(report: ReportInput, every: int = 1, count: int = 120) -> tuple[Context, Held]:
    context = Context.of(report)
    designs = chosen_designs(context)
    replayed = replay(context, picked_departures(context, designs, count), designs)
    return context, Held(json.loads(script_json(embedded_departures(context, replayed, every))))


def outcomes(context: Context) -> dict[int, Outcome]:
    return {
        one.row.index: simulate(
            one.row.design.controller(),
            context.scenarios,
            y_s=one.row.design.y_s,
            settle=context.report.setup.settle,
            trajectories=True,
        )
        for one in chosen_designs(context)
    }


@pytest.mark.parametrize("every", [1, 4])
def test_paths_are_those_of_simulate_to_the_resolution(report: ReportInput, every: int) -> None:
    context, page = held(report, every)
    assert page.data["step"] == pytest.approx(0.05 * every)
    rows, lines = page.index, list(page.lines("paths", "y", "delta", "a_y"))
    start = read(page.data["paths"]["start"])
    assert sorted(rows) == list(range(100))  # fewer than would fit: all of them
    some, worst = iter(range(len(lines))), 0.0
    for design, outcome in outcomes(context).items():
        kept = outcome.trajectories
        assert kept is not None
        for row in rows:
            i = next(some)
            line = lines[i]
            if not outcome.triggered[row]:
                assert line["y"].size == 0
                continue
            t = outcome.t_s[row] + page.data["step"] * np.arange(line["y"].size)
            assert start[i] == pytest.approx(outcome.t_s[row], rel=1e-6)
            known = np.isfinite(kept.t[row])
            at = np.abs(kept.t[row, known][:, None] - t).argmin(axis=0)
            assert kept.t[row, at] == pytest.approx(t, abs=1e-9)
            assert kept.t[row, known][-1] - t[-1] < page.data["step"] + 1e-9  # up to the end of the horizon
            assert line["y"] == pytest.approx(kept.x[row, at, 0] - 0.85, abs=0.5001e-3)
            assert line["delta"] == pytest.approx(np.degrees(kept.delta[row, at]), abs=0.5001e-3)
            largest, peak = np.abs(line["a_y"]).max(), outcome.companions.a_y_peak[row]
            # the stored peak also looks just before each command, where the force of the front axle has not jumped yet
            vehicle = VehicleParameters()
            jump = 2 * vehicle.C_af / vehicle.m * outcome.companions.delta_rate_peak[row] * 0.05
            assert largest <= peak + 0.5001e-3
            if every == 1:
                assert largest >= peak - jump - 0.5001e-3
                worst = max(worst, (peak - largest) / peak)
        assert design in {one.row.index for one in chosen_designs(context)}
    assert worst < 0.2


def test_recorded_paths_are_the_closed_form(report: ReportInput) -> None:
    context, page = held(report)
    lines = list(page.lines("recorded", "y", "a_y"))
    for row, line in zip(page.index, lines, strict=True):
        one = context.scenarios.take([row])
        t = np.minimum(0.05 * np.arange(line["y"].size), one.T[0])
        assert t[-1] == one.T[0]
        assert line["y"] == pytest.approx(lateral(one, t), abs=0.5001e-3)
        expected = lateral_acceleration(one, t) + speed(one, t) ** 2 * curvature(one, t)
        assert line["a_y"] == pytest.approx(expected, abs=0.5001e-3)


def test_facts_are_the_stored_ones(report: ReportInput) -> None:
    context, page = held(report)
    assert page.data["own_window"] is False
    case, rows = context.case, page.index
    designs = [one.row.index for one in chosen_designs(context)]
    for name in ("S", "S_uncorrected", "deepest", "a_y_peak", "jerk_peak", "delta_peak", "t_back", "status"):
        table = getattr(case, name) if hasattr(case, name) else getattr(case.companions, name)
        shown = read(page.data["facts"][name]).reshape(len(designs), len(rows))
        assert shown == pytest.approx(table[np.ix_(designs, rows)], rel=1e-6)
    for name in ("T", "d_y", "v_mean", "a_mean", "c_0", "dc", "sigma_y", "sigma_v", "side"):
        assert read(page.data["departures"][name]) == pytest.approx(getattr(context.scenarios, name)[rows], rel=1e-6)


def test_numbers_beyond_16_bits_are_kept() -> None:
    design = Design.of(PreviewProportional(K_psi=-5.0, K_y=-1.0), 0.05)  # unstable
    scenarios = invented_scenarios(3, 0)
    scenarios = dataclasses.replace(scenarios, T=np.full(3, 9.0), d_y=np.full(3, 0.4), v_mean=np.full(3, 36.0))
    results = run([design], scenarios, [Case("departure", "consistent")])
    context, page = held(report_input(results))
    assert page.data["paths"]["delta"][0]["type"] == "i4"
    assert page.data["paths"]["y"][0]["type"] == "i2"
    kept = simulate(design.controller(), scenarios, y_s=0.05, trajectories=True).trajectories
    assert kept is not None
    first = next(page.lines("paths", "delta"))["delta"]
    row = page.index[0]
    samples = np.abs((kept.t[row] - kept.t[row, 0]) / 0.05 % 1.0 - 0.5) > 0.499
    assert first == pytest.approx(np.degrees(kept.delta[row, samples]), abs=0.5001e-3)
    assert context.scenarios.n == 3


def test_no_control_and_laws_without_paths_are_not_held() -> None:
    results = run(
        [Design.of(LQR(), 0.1), Design.of(NoControl(), 0.1)], invented_scenarios(5, 5), [Case("control", "consistent")]
    )
    context, page = held(report_input(results))
    assert len(list(page.lines("paths", "y"))) == 10
    assert page.data["own_window"] is True
    shown = read(page.data["facts"]["S_uncorrected"])
    assert shown == pytest.approx(context.case.S_uncorrected[chosen_designs(context)[0].row.index][page.index])


def test_long_studies_are_cut_to_the_budget(results: StudyResults) -> None:
    long = dataclasses.replace(results.scenarios, T=np.full(results.scenarios.n, 10.0))
    long_results = dataclasses.replace(results, scenarios=long)
    report = report_input(long_results, setup=Setup(settle=60.0), departures=(17, 80))
    context = Context.of(report)
    designs = chosen_designs(context)
    coarsest = grids(0.05)[-1].every
    assert coarsest * 0.05 <= 0.2
    assert grids(1.0)[-1].every == 1  # a slow clock is not made slower
    every = picked_departures(context, designs, 100)
    assert [pick.row for pick in every][:2] == [17, 80]
    assert weight(context, every, designs, 1) > BUDGET
    kept = trimmed(context, every, designs, 1)
    assert weight(context, kept, designs, 1) <= BUDGET < weight(context, every[: len(kept) + 1], designs, 1)
    assert trimmed(context, every, designs * 500, 1) == every[:2]  # those asked for stay
