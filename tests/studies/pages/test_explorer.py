# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The departures explorer: which departures and designs, what the script reads, what a user asks for."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from controllers import LQR, NoControl
from helpers.pages import unpacked
from helpers.reports import invented_scenarios, only, report_input, section_of
from ldctoolkit.errors import InputError
from studies.design import Design
from studies.pages import explorer
from studies.pages.context import Context, ReportInput
from studies.pages.replay import chosen_designs, designs_of_ids, picked_departures, replay, rows_of_numbers
from studies.results import StudyResults


def data_of(report: ReportInput) -> dict[str, Any]:
    one, _ = section_of(explorer.section, report)
    assert one.data is not None
    return dict(one.data)


def test_departures_are_named_by_the_shown_designs_scores(report: ReportInput) -> None:
    context = Context.of(report)
    picks = picked_departures(context, chosen_designs(context))
    roles = {role: pick.row for pick in picks for role in pick.roles}
    S, side = context.S(context.shown), context.scenarios.side
    for which, name in ((1, "left"), (-1, "right")):
        rows = np.flatnonzero(side == which)
        assert roles[f"largest S, {name}"] == rows[S[rows].argmax()]
        order = rows[np.argsort(S[rows], kind="stable")]
        assert roles[f"median S, {name}"] == order[(rows.size - 1) // 2]
    assert len({pick.row for pick in picks}) == len(picks)


def test_designs_are_the_shown_one_the_best_of_each_law_and_table_1(report: ReportInput) -> None:
    context = Context.of(report)
    chosen = chosen_designs(context)
    assert chosen[0].place == context.shown
    laws = [context.ranking.designs[one.place].law for one in chosen]
    assert {"lqr", "preview_proportional"} <= set(laws)
    assert "none" not in laws
    assert "Table I of the paper" in [one.why for one in chosen] or any(
        one.why == "best of its law" and context.ranking.designs[one.place].law == "preview_proportional"
        for one in chosen
    )


def test_what_a_user_asks_for_is_there(report: ReportInput) -> None:
    wanted = report.results.designs[-1]
    given = dataclasses.replace(report, departures=(7, 93), shown_designs=(wanted.id[:8],))
    data = data_of(given)
    assert [one["number"] for one in data["departures"][:2]] == ["7", "93"]
    assert "requested" in data["departures"][0]["name"]
    assert "requested" in [one["why"] for one in data["designs"]]


def test_asked_for_but_not_there(results: StudyResults) -> None:
    with pytest.raises(InputError, match=r"departure: 100; allowed: 0 to 99, the nearest is 99"):
        rows_of_numbers(results.scenarios, [100])
    with pytest.raises(InputError, match=r"design: 'zz'; no design begins like this, the nearest is \w+; allowed"):
        designs_of_ids(results.designs, ["zz"])
    same = [dataclasses.replace(results.designs[0]), results.designs[0]]
    with pytest.raises(InputError, match=r"allowed: more digits"):
        designs_of_ids(same, [same[0].id[:6]])


def test_the_script_draws_what_was_driven(report: ReportInput) -> None:
    context = Context.of(report)
    designs = chosen_designs(context)
    picks = picked_departures(context, designs)
    again, data = replay(context, picks, designs), data_of(report)
    assert again.mismatch < 1e-9
    count, start = unpacked(data["count"]), unpacked(data["start"])
    y, a_y = (unpacked(data["paths"][name]) * data["resolution"][name] for name in ("y", "a_y"))
    first = np.concatenate([[0], np.cumsum(count)])
    for i, k in ((0, 0), (1, 5), (len(designs) - 1, len(picks) - 1)):
        at, paths = i * len(picks) + k, again.paths[i]
        t = start[at] + data["step"] * np.arange(count[at])
        known = np.isfinite(paths.t[k])
        for name, drawn in (("y", y), ("a_y", a_y)):
            exact = np.interp(t, paths.t[k][known], getattr(paths, name)[k][known])
            assert drawn[first[at] : first[at + 1]] == pytest.approx(exact, abs=data["resolution"][name])


def test_no_axis_cuts_what_is_drawn(report: ReportInput) -> None:
    """The default axis cut an acceleration at -5.5 of 43 m/s^2."""
    data = data_of(report)
    for name in ("y", "delta", "a_y"):
        values = unpacked(data["paths"][name]) * data["resolution"][name]
        low, high = min(0.0, values.min()), max(0.0, values.max())
        assert any(one["low"] <= low and high <= one["high"] for one in data["scales"][name])
        for one in data["scales"][name]:
            assert all(one["low"] <= value <= one["high"] for value, _ in one["ticks"])
            assert 2 <= len(one["ticks"]) <= 12


def test_facts_are_the_stored_ones(report: ReportInput) -> None:
    context, data = Context.of(report), data_of(report)
    designs = chosen_designs(context)
    picks = picked_departures(context, designs)
    S = context.S(designs[0].place)[picks[3].row]
    assert data["facts"][0][3][0] == f"{S:.3f}"
    assert re.fullmatch(r"[\d.−–]+", data["facts"][0][3][3])


def test_recorded_paths_begin_and_end_on_the_line(report: ReportInput) -> None:
    data = data_of(report)
    count = unpacked(data["recorded"]["count"])
    y = unpacked(data["recorded"]["y"]) * data["resolution"]["y"]
    ends = np.cumsum(count)
    assert np.abs(y[np.concatenate([[0], ends[:-1]])]).max() < 0.002
    assert np.abs(y[ends - 1]).max() < 0.002


def test_a_study_of_no_control_has_no_explorer() -> None:
    one, page = section_of(explorer.section, only(Design.of(NoControl(), 0.2)))
    assert one.data is not None or "No design intervenes" in page.words()


def test_another_machines_scores_are_reported(results: StudyResults) -> None:
    case = dataclasses.replace(results.cases[0], S=1.01 * results.cases[0].S)
    given = report_input(dataclasses.replace(results, cases=(case, *results.cases[1:])))
    _, page = section_of(explorer.section, given)
    assert "differ from the stored scores by up to 1.0 %" in page.words()


def test_distributions_hold_every_value(report: ReportInput) -> None:
    one, _ = section_of(explorer.section, report)
    names = [chart.name for chart in one.charts]
    assert names == [
        "distribution-S-left", "distribution-S-right", "distribution-deepest", "distribution-dtle",
        "distribution-a-y-added-peak", "distribution-jerk-added-peak",
    ]  # fmt: skip
    assert "ISO 11270" in one.charts[4].body
    assert "Euro NCAP" in one.charts[3].body


def test_the_worst_part_of_S() -> None:
    scenarios = invented_scenarios(40, 40)
    given = only(Design.of(LQR(r_delta=100.0), 0.1), scenarios=scenarios)
    context = Context.of(given)
    S = np.sort(context.S(0))[::-1]
    share = 100 * S[:4].sum() / S.sum()
    assert f"The worst 5 % of departures (4) make up {share:.0f}\u00a0% of the sum" in explorer.worst_sentence(context)
