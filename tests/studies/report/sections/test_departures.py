"""The section in every kind of study: readable without script, and what the script reads."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from controllers import LQR, NonlinearMPC, PreviewProportional
from helpers.reports import invented_scenarios, only, report_input, section_of
from ldctoolkit import EventStatus
from ldctoolkit.errors import InputError
from studies.design import Design
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.replay.picks import chosen_designs, picked_departures
from studies.report.section import Section
from studies.report.sections.departures import section
from studies.results import StudyResults


def made(report: ReportInput | Context) -> tuple[Section, str]:
    one, page = section_of(section, report)
    assert page.words().startswith("Departures ")
    assert ("explorer" in str(one.body)) == (one.data is not None) == bool(one.scripts)
    return one, page.words()


def roles(one: Section) -> list[list[str]]:
    assert one.data is not None
    return one.data["departures"]["roles"]  # type: ignore[index, no-any-return]


def titles(one: Section) -> list[str]:
    assert one.data is not None
    return [design["title"] for design in one.data["designs"]]  # type: ignore[attr-defined]


def test_an_ordinary_study(report: ReportInput) -> None:
    one, words = made(report)
    assert "all 100 departures of the study" in words
    assert "Their scores equal the stored ones." in words
    assert [d.name for d in one.drawings] == [
        f"departure-{side}-{role}-reduction" for side in ("left", "right") for role in ("least", "median", "greatest")
    ]
    assert 'class="explorer needs-script"' in str(one.body)
    assert str(one.body).count('name="explorer-design"') == len(titles(one))
    assert str(one.body).count(" checked") == 2
    for label in ("explorer-role", "explorer-number", "explorer-time"):
        assert f'for="{label}"' in str(one.body)
    for side in (slice(0, 60), slice(60, 100)):
        case, best = report.results.cases[0], report.rankings[0].index[0]
        S, a_y = case.S[best][side], case.companions.a_y_peak[best][side]
        first, rows = side.start, dict(zip(_rows(report), roles(one), strict=True))
        assert "worst S" in rows[first + int(S.argmax())]
        assert "best S" in rows[first + int(S.argmin())]
        assert "median S" in rows[first + int(np.argsort(S, kind="stable")[(S.size - 1) // 2])]
        assert "largest lateral acceleration" in rows[first + int(a_y.argmax())]


def _rows(report: ReportInput) -> list[int]:
    context = Context.of(report)
    return [pick.row for pick in picked_departures(context, chosen_designs(context), 120)]


def test_designs_are_the_winner_the_second_and_the_best_of_each_law(report: ReportInput) -> None:
    context = Context.of(report)
    chosen = chosen_designs(context)
    ranking = report.rankings[0]
    assert [one.row.place for one in chosen[:2]] == [0, 1]
    assert [one.why for one in chosen[:2]] == ["winner", "second of the ranking"]
    assert all(one.row.design.law != "none" for one in chosen)
    paper = next(one for one in chosen if one.why.endswith("Table I"))
    assert dict(paper.row.design.gains)["K_y"] == -0.005
    best = min(k for k, d in enumerate(ranking.designs) if d.law == "preview_proportional")
    assert best in [one.row.place for one in chosen]


def test_finalists_and_the_pareto_front_fill_up_by_rank(report: ReportInput) -> None:
    context = Context.of(report)
    table = context.primary
    fresh = table.rows[9].S
    rows = tuple(
        dataclasses.replace(row, pareto=row.place in (4, 5, 11), fresh=fresh if row.place == 7 else None)
        for row in table.rows
    )
    context = dataclasses.replace(context, tables=(dataclasses.replace(table, rows=rows, winner=rows[0]),))
    core = [one.row.place for one in chosen_designs(Context.of(report)) if not one.further]
    chosen = chosen_designs(context)
    assert [one.row.place for one in chosen] == core + [k for k in (7, 4, 5, 11) if k not in core]
    assert [one.why for one in chosen if one.row.place == 7] == ["finalist"]
    crowd = tuple(dataclasses.replace(row, pareto=True) for row in rows)
    context = dataclasses.replace(context, tables=(dataclasses.replace(table, rows=crowd, winner=crowd[0]),))
    assert len(chosen_designs(context)) == 12


def test_the_paper_stands_beside_the_winner(report: ReportInput) -> None:
    def drawn(given: ReportInput) -> list[str]:
        one, _ = made(given)
        assert one.data is not None
        boxes = re.findall(r'name="explorer-design" value="\d+"( checked)?', str(one.body))
        return [d["id"] for d, box in zip(one.data["designs"], boxes, strict=True) if box]  # type: ignore[call-overload]

    winner, table = report.rankings[0].designs[0].id, Design.of(PreviewProportional(), 0.2).id
    assert drawn(report) == [winner, table]
    hers, worse, other = Design.of(LQR(), 0.05), Design.of(LQR(), 0.2), Design.of(PreviewProportional(), 0.3)
    assert set(drawn(only(hers, worse, other))) == {hers.id, other.id}  # the best of the paper's law
    assert set(drawn(only(hers, worse))) == {hers.id, worse.id}


def test_departures_and_designs_that_were_asked_for(report: ReportInput) -> None:
    last = report.rankings[0].designs[-2]
    asked = dataclasses.replace(report, departures=(33, 71), shown_designs=(last.id[:9],))
    one, words = made(asked)
    assert [some[:1] for some in roles(one)[:2]] == [["asked for"], ["asked for"]]
    assert _rows(asked)[:2] == [33, 71]
    assert "asked for" in words
    assert one.data is not None
    assert last.id in [design["id"] for design in one.data["designs"]]  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="departure: 100; allowed: 0 to 99"):
        section(Context.of(dataclasses.replace(report, departures=(100,))))


def test_many_departures_are_spread_over_the_ranks_of_the_score() -> None:
    report = only(Design.of(LQR(), 0.1), scenarios=invented_scenarios(300, 200))
    context = Context.of(report)
    picks = picked_departures(context, chosen_designs(context), 120)
    assert 110 <= len(picks) <= 120
    assert len({pick.row for pick in picks}) == len(picks)
    S = report.results.cases[0].S[0]
    ranks = np.argsort(np.argsort(S, kind="stable"))
    spread = [int(ranks[pick.row]) for pick in picks if not pick.roles]
    assert np.diff(np.sort(spread)).max() <= 3 * 500 / len(spread)
    half = np.sort(spread[: len(spread) // 2])  # wherever the list is cut off, it is even
    assert np.diff(half).max() <= 4 * 500 / len(half)


def test_crashes_and_time_limits_are_not_driven_again(results: StudyResults) -> None:
    case = results.cases[0]
    status = np.where(np.arange(100) % 2, EventStatus.CRASHED, EventStatus.TIMED_OUT).astype(np.int8)
    crashed = dataclasses.replace(case, status=np.broadcast_to(status, case.status.shape))
    one, words = made(report_input(dataclasses.replace(results, cases=(crashed,))))
    assert "Their scores equal the stored ones." in words  # nothing is said to differ: nothing was driven
    assert one.data is not None
    assert {part["data"] for part in one.data["paths"]["y"]} == {""}  # type: ignore[index]
    assert "ended by the time limit" in " ".join(role for some in roles(one) for role in some)


def test_text_of_a_user_is_text(results: StudyResults) -> None:
    context = Context.of(report_input(results))
    evil = "<script>alert(1)</script>"
    rows = tuple(dataclasses.replace(row, title=evil) for row in context.primary.rows)
    table = dataclasses.replace(context.primary, rows=rows, winner=rows[0], baseline=None)
    one, words = made(dataclasses.replace(context, tables=(table, *context.tables[1:])))
    assert "<script" not in str(one.body)
    assert evil in words
    assert set(titles(one)) == {evil}


@pytest.mark.slow
def test_a_law_that_takes_long_is_driven_on_the_first_departures_only() -> None:
    designs = (Design.of(NonlinearMPC(horizon=4), 0.1), Design.of(LQR(), 0.1))
    scenarios = invented_scenarios(14, 10)
    one, words = made(only(*designs, scenarios=scenarios))
    assert "Nonlinear MPC takes long to compute and was driven on the first 20 departures of this list only." in words
    assert "Their scores equal the stored ones." in words
    assert len(roles(one)) == 24
