"""The section in every kind of study: readable without script, and what the script reads."""

from __future__ import annotations

import dataclasses
import re
from html.parser import HTMLParser
from types import ModuleType

import numpy as np
import pytest
from markupsafe import Markup

from controllers import LQR, NoControl, NonlinearMPC, PreviewProportional
from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.errors import InputError
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.embedded.departures import bytes_of, weight
from studies.report.embedded.fitting import fitted_departures
from studies.report.replay.picks import chosen_designs, picked_departures
from studies.report.section import Section
from studies.report.sections.departures import section
from studies.results import Case, StudyResults

PRIMARY = Case("departure", "consistent")


@pytest.fixture(autouse=True)
def _undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawing takes seconds and has its own tests."""
    monkeypatch.setattr("studies.report.section.Drawing.svg", Markup("<svg></svg>"))


class Text(HTMLParser):
    """What stands in the section, and which tags are open."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.words, self.open, self.labels, self.ids = "", [], set(), []  # type: ignore[var-annotated]
        self.feed(html)
        self.close()
        assert self.open == []
        assert len(self.ids) == len(set(self.ids))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in ("input", "br"):
            self.open.append(tag)
        if "id" in given:
            self.ids.append(given["id"])
        if tag == "label":
            self.labels.add(given.get("for"))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


def made(report: ReportInput) -> tuple[Section, str]:
    one = section(Context.of(report))
    assert one.id == "departures"
    words = " ".join(Text(str(one.body)).words.split())
    assert words.startswith("Departures ")
    assert ("explorer" in str(one.body)) == (one.data is not None) == bool(one.scripts)
    return one, words


def only(make: ModuleType, *designs: Design, scenarios: Scenarios | None = None) -> ReportInput:
    report: ReportInput = make.report_input(make.run(designs, scenarios or make.invented_scenarios(12, 9), [PRIMARY]))
    return report


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
    labels = Text(str(one.body)).labels
    assert {"explorer-role", "explorer-number", "explorer-time"} <= labels
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


def test_further_designs_give_way_to_departures(report: ReportInput, monkeypatch: pytest.MonkeyPatch) -> None:
    context = Context.of(report)
    rows = tuple(dataclasses.replace(row, pareto=True) for row in context.primary.rows)
    context = dataclasses.replace(context, tables=(dataclasses.replace(context.primary, rows=rows),))
    every = chosen_designs(context)
    core = tuple(one for one in every if not one.further)
    assert len(core) + 3 < len(every)
    monkeypatch.setattr("studies.report.embedded.fitting.BUDGET", 10_000_000)
    monkeypatch.setattr("studies.report.embedded.fitting.MOST", 10_000_000)
    assert len(fitted_departures(context, every)[1].designs) == len(every)
    picks = picked_departures(context, core, 120)
    two_more = weight(context, picks, every[: len(core) + 2], 1)
    monkeypatch.setattr("studies.report.embedded.fitting.BUDGET", two_more + 1.0)
    step, replayed, data = fitted_departures(context, every)
    assert (step, len(replayed.picks)) == (1, 100)
    assert [one.chosen for one in replayed.designs] == list(every[: len(core) + 2])
    monkeypatch.setattr("studies.report.embedded.fitting.MOST", bytes_of(data) - 1)
    _, replayed, _ = fitted_departures(context, every)
    assert (len(replayed.designs), len(replayed.picks)) == (len(core) + 1, 100)


def test_the_paper_stands_beside_the_winner(report: ReportInput, make: ModuleType) -> None:
    def drawn(given: ReportInput) -> list[str]:
        one = section(Context.of(given))
        assert one.data is not None
        boxes = re.findall(r'name="explorer-design" value="\d+"( checked)?', str(one.body))
        return [d["id"] for d, box in zip(one.data["designs"], boxes, strict=True) if box]  # type: ignore[call-overload]

    winner, table = report.rankings[0].designs[0].id, Design.of(PreviewProportional(), 0.2).id
    assert drawn(report) == [winner, table]
    hers, worse, other = Design.of(LQR(), 0.05), Design.of(LQR(), 0.2), Design.of(PreviewProportional(), 0.3)
    assert set(drawn(only(make, hers, worse, other))) == {hers.id, other.id}  # the best of the paper's law
    assert set(drawn(only(make, hers, worse))) == {hers.id, worse.id}


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


def test_many_departures_are_spread_over_the_ranks_of_the_score(make: ModuleType) -> None:
    report = only(make, Design.of(LQR(), 0.1), scenarios=make.invented_scenarios(300, 200))
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


def test_one_design(make: ModuleType) -> None:
    one, _ = made(only(make, Design.of(PreviewProportional(), 0.2)))
    assert len(titles(one)) == 1
    assert str(one.body).count(" checked") == 1


@pytest.mark.parametrize(
    "designs",
    [(Design.of(NoControl(), 0.2),), (Design.of(PreviewProportional(), 5.0), Design.of(NoControl(), 5.0))],
    ids=["only no control", "nothing triggered"],
)
def test_nobody_took_over(make: ModuleType, designs: tuple[Design, ...]) -> None:
    one, words = made(only(make, *designs))
    assert words == "Departures No design took over in any departure, so there is no corrected path to show."
    assert one.drawings == ()


@pytest.mark.parametrize(("left", "right"), [(9, 0), (0, 9), (1, 0)])
def test_one_side_and_one_scenario(make: ModuleType, left: int, right: int) -> None:
    one, words = made(only(make, Design.of(LQR(), 0.02), scenarios=make.invented_scenarios(left, right)))
    shown = "left" if left else "right"
    assert {d.name.split("-")[1] for d in one.drawings} == {shown}
    assert len(roles(one)) == left + right
    assert ("on the one departure of the study" in words) == (left + right == 1)


def test_all_failures(make: ModuleType, with_failures: StudyResults) -> None:
    one, words = made(make.report_input(with_failures))
    assert "differ from the stored ones" in words
    said = " ".join(role for some in roles(one) for role in some)
    assert "a solve failed" in said
    assert "left the bound" in said


def test_crashes_and_time_limits_are_not_driven_again(make: ModuleType, results: StudyResults) -> None:
    case = results.cases[0]
    status = np.where(np.arange(100) % 2, EventStatus.CRASHED, EventStatus.TIMED_OUT).astype(np.int8)
    crashed = dataclasses.replace(case, status=np.broadcast_to(status, case.status.shape))
    one, words = made(make.report_input(dataclasses.replace(results, cases=(crashed,))))
    assert "Their scores equal the stored ones." in words  # nothing is said to differ: nothing was driven
    assert one.data is not None
    assert {part["data"] for part in one.data["paths"]["y"]} == {""}  # type: ignore[index]
    assert "ended by the time limit" in " ".join(role for some in roles(one) for role in some)


def test_nothing_ranked(make: ModuleType, results: StudyResults) -> None:
    rankings = tuple(Ranking.of(results, case, bootstrap=100, require=["S <= 0"]) for case in results.cases)
    _, words = made(dataclasses.replace(make.report_input(results), rankings=rankings))
    assert "by the scores of the design with the lowest mean S" in words
    assert "winner" not in words


def test_text_of_a_user_is_text(make: ModuleType, results: StudyResults) -> None:
    context = Context.of(make.report_input(results))
    evil = "<script>alert(1)</script>"
    rows = tuple(dataclasses.replace(row, title=evil) for row in context.primary.rows)
    table = dataclasses.replace(context.primary, rows=rows, winner=rows[0], baseline=None)
    one = section(dataclasses.replace(context, tables=(table, *context.tables[1:])))
    assert "<script" not in re.sub(r"<svg.*?</svg>", "", str(one.body), flags=re.DOTALL)
    assert evil in Text(str(one.body)).words
    assert set(titles(one)) == {evil}


def test_a_law_that_takes_long_is_driven_on_the_first_departures_only(make: ModuleType) -> None:
    designs = (Design.of(NonlinearMPC(horizon=4), 0.1), Design.of(LQR(), 0.1))
    scenarios = make.invented_scenarios(14, 10)
    one, words = made(only(make, *designs, scenarios=scenarios))
    assert "Nonlinear MPC takes long to compute and was driven on the first 20 departures of this list only." in words
    assert "Their scores equal the stored ones." in words
    assert len(roles(one)) == 24


def test_the_same_study_gives_the_same_section(report: ReportInput) -> None:
    first, second = (section(Context.of(report)) for _ in range(2))
    assert first.data == second.data
    assert first.body == second.body
