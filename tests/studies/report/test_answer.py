# ruff: noqa: RUF001 - the page shows true minus signs
"""The answer says what the ranking says: winner, set of best, fresh scores, requirements, Pareto front, race."""

from __future__ import annotations

import dataclasses
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.page import make_page
from studies.report.tables.tabulate import case_table
from studies.report.words.answer import answer
from studies.report.words.prose import design_text, limitations
from studies.results import Dropped, Race, StudyResults


@pytest.fixture(scope="module")
def plain(results: StudyResults) -> Ranking:
    return Ranking.of(results, results.cases[0], bootstrap=100)


def said(report: ReportInput) -> str:
    """The answer as one text, with plain spaces."""
    return " ".join(" ".join(one.striptags() for one in answer(Context.of(report))).split())


def input_of(make: ModuleType, results: StudyResults, ranking: Ranking) -> ReportInput:
    report = make.report_input(dataclasses.replace(results, cases=results.cases[:1]))
    return dataclasses.replace(report, rankings=(ranking,))


def with_fresh(ranking: Ranking, winner: int | None, **changes: Any) -> Ranking:
    """Four finalists, with fresh scores that no one could take for those of the search."""
    d = len(ranking)
    finalists = np.arange(4)

    def spread(values: Any) -> np.ndarray:
        out = np.full(d, np.nan)
        out[finalists] = values
        return out

    given: dict[str, Any] = {"fresh_scenarios": 77, "winner": winner, "set_of_best": np.arange(d) < 3}
    for name, values in (("fresh_S", [7.0, 6.0, 8.0, 9.0]), ("fresh_difference", [0.0, -1.0, 1.0, 2.0])):
        low, high = name.removesuffix("_S") + "_low", name.removesuffix("_S") + "_high"
        given |= {name: spread(values), low: spread(values) - 0.25, high: spread(values) + 0.25}
    given |= {"optimism": spread(0.5), "optimism_low": spread(0.125), "optimism_high": spread(0.875)}
    return dataclasses.replace(ranking, **(given | changes))


def test_the_winner_need_not_be_the_first(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    report = input_of(make, results, with_fresh(plain, winner=1))
    table = case_table(report.results, 0, report.rankings[0])
    first, second = (" ".join(design_text(row).striptags().split()) for row in table.rows[:2])
    text = said(report)
    assert text.startswith(f"{second} is the winner. On 77 fresh departures")
    assert "S = 6.000 m·s (95 % interval 5.750 to 6.250, for all finalists at once)" in text
    assert (
        f"has {first}, which is worse on the fresh departures (difference of the winner to it −1.250 to −0.750" in text
    )
    assert "0.500 m·s better there than on the fresh ones (interval 0.125 to 0.875), more than chance" in text
    assert "2 other designs are in the set of best with it" in text
    assert f"The others: {first} (rank 1); " in text
    within = with_fresh(plain, winner=1, optimism_low=np.full(len(plain), -0.1))
    assert "no more than chance explains" in said(input_of(make, results, within))
    # figures, limits and the table follow the winner too
    page = make_page(report).html
    table_of_ranking = page.partition('<table class="ranking">')[2].partition("</table>")[0]
    assert table_of_ranking.count('<tr class="best">') == 1
    assert page.index('<span class="tag strong">winner') > page.index('<span class="tag">set of best')
    assert "the winner, keeps the front" in page


def test_the_gain_over_the_papers_controller_has_an_interval(
    make: ModuleType, results: StudyResults, plain: Ranking
) -> None:
    """The interval against a direct computation: a ratio of paired means, by the delta method."""
    S, side = results.cases[0].counted, results.scenarios.side
    paper = next(i for i, d in enumerate(results.designs) if d.law == "preview_proportional" and d.y_s == 0.2
                 and dict(d.gains)["K_y"] == -0.005 and dict(d.gains)["K_psi"] == -0.2)  # fmt: skip
    best = S[int(plain.index[0])]
    ratio = best.mean() / S[paper].mean()
    residual = best - ratio * S[paper]
    variance = sum(part.size * part.var(ddof=1) for part in (residual[side == 1], residual[side == -1]))
    error = 1.959964 * np.sqrt(variance) / side.size / S[paper].mean()
    low, high = (f"{100 * (1 - ratio + sign * error):.1f}" for sign in (-1, 1))
    text = said(input_of(make, results, plain)).replace("\u00a0", " ")
    assert "Against the paper’s controller, Table I (Preview P, ys = 0.2 m" in text
    assert f"or {100 * (1 - ratio):.1f} % less (interval {low} % to {high} %)" in text


def test_a_first_that_misses_a_requirement_on_fresh_departures(
    make: ModuleType, results: StudyResults, plain: Ranking
) -> None:
    unmet = (("deeper <= 0.1",), *((),) * (len(plain) - 1))
    text = said(input_of(make, results, with_fresh(plain, winner=1, fresh_unmet=unmet)))
    assert "which misses deeper <= 0.1 on the fresh departures" in text


def test_ranked_designs_without_a_winner(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(results, results.cases[0], bootstrap=100, require=["deeper <= 0.9"])
    report = input_of(make, results, with_fresh(ranking, winner=None))
    text = said(report)
    assert text.startswith("There is no winner: no finalist meets the requirements (deeper <= 0.9)")
    assert "is the winner" not in text
    page = make_page(report).html
    assert 'class="tag strong"' not in page
    assert "finalists meet the requirements on fresh departures" in page


def test_requirements_say_of_how_many_and_at_what_price(make: ModuleType, results: StudyResults) -> None:
    S = np.sort(results.cases[0].S.mean(axis=1))
    bound = float(S[2:4].mean())
    ranking = Ranking.of(results, results.cases[0], bootstrap=100, require=[f"S >= {bound!r}"])
    text = said(input_of(make, results, ranking))
    d = len(results.designs)
    assert f"lowest mean score of the {d - 3} designs that meet the requirements, of {d} tried" in text
    assert f"3 of {d} designs miss a requirement and are not ranked" in text
    assert f"3 of these have a lower mean S than the winner, the lowest {S[0]:.3f} m·s" in text
    met = Ranking.of(results, results.cases[0], bootstrap=100, require=["S >= 0"])
    assert f"All {d} designs meet the requirements" in said(input_of(make, results, met))


def test_pareto_front_and_baseline(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(
        results, results.cases[0], bootstrap=100, pareto=["S", "effort_mean"], baseline="preview_proportional"
    )
    text = said(input_of(make, results, ranking))
    assert f"holds {ranking.pareto.sum()} designs of the {len(ranking)} ranked" in text
    assert ranking.baseline is not None
    low = f"{ranking.baseline_difference_low[0]:.3f}".replace("-", "−")
    assert "difference to the baseline, Preview P, ys = 0.2 m" in text
    assert f"(interval {low} to" in text
    page = make_page(input_of(make, results, ranking)).html
    assert page.count('<span class="tag">Pareto</span>') == ranking.pareto.sum()
    assert page.count('<span class="tag">baseline</span>') == 1


def test_a_race_is_told_and_counts_what_it_gave_up(make: ModuleType, results: StudyResults) -> None:
    """One LQR design is left: what it sweeps, and where it ends, is that of all that were tried."""
    lqr = [i for i, d in enumerate(results.designs) if d.law == "lqr"]
    keep = np.array([i for i in range(len(results.designs)) if i == lqr[-1] or results.designs[i].law == "none"])
    gone = [i for i in range(len(results.designs)) if i not in keep]
    race = Race((100, 200), (5, 2), tuple(Dropped(results.designs[i], 1, 100, 1.0, 0.5, 0.1) for i in gone), 300, 1000)
    case = results.cases[0]
    rows = {name: getattr(case, name)[keep] for name in ("S", "S_uncorrected", "status", "failed_solves", "law_time")}
    companions = type(case.companions)(
        **{f.name: getattr(case.companions, f.name)[keep] for f in dataclasses.fields(case.companions)}
    )
    raced = dataclasses.replace(
        results,
        designs=tuple(results.designs[i] for i in keep),
        cases=(dataclasses.replace(case, **rows, companions=companions),),
        race=race,
    )
    ranking = Ranking.of(raced, raced.cases[0], bootstrap=100)
    report = input_of(make, raced, ranking)
    text, d = said(report), len(results.designs)
    assert f"lowest mean score of the 2 designs that a race left of {d} tried" in text
    assert f"{len(gone)} of {d} designs were given up" in text
    assert "5 after 100, 2 after 200. That took 30.0 % of the runs" in text
    assert "No design is left of: Preview P." in text
    assert "at least 90 % for race and ranking together" in text
    assert "ys (highest tried)" in text
    assert "ys = 0.2 m, rδ = 300" in text  # swept in the study, if not among those left
    page = make_page(report).html
    assert f"· {d} designs ·" in page
    assert f"{len(gone)} designs given up in a race" in page
    assert "The race left one design of each law at most" in page
    limits = " ".join(one.striptags() for one in limitations(report, case_table(raced, 0, ranking)))
    assert f"lowest mean S of {d} designs" in limits
    assert "A race gives up designs on few departures" in limits


def test_chance_is_told_as_it_is(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    page = make_page(input_of(make, results, plain)).html
    assert "not corrected" not in page
    assert "holds zero" not in page
    assert "They are simultaneous" in page
