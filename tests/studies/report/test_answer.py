# ruff: noqa: RUF001 - the page shows true minus signs
"""The answer says what the ranking says: winner, set of best, fresh scores, requirements, Pareto front, race."""

from __future__ import annotations

import dataclasses
import html
import re
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.context import Context
from studies.report.page import make_page
from studies.report.sections import answer as answer_section
from studies.report.tables.tabulate import case_table
from studies.report.words.answer import answer
from studies.report.words.prose import design_text, limitations
from studies.results import Dropped, Race, StudyResults
from studies.robustness.robustness import Robustness


@pytest.fixture(scope="module")
def plain(results: StudyResults) -> Ranking:
    return Ranking.of(results, results.cases[0], bootstrap=100)


def said(report: ReportInput) -> str:
    """The answer as one text, with plain spaces."""
    found = answer(Context.of(report))
    return " ".join(" ".join(one.striptags() for one in (*(p.text for p in found.shown), *found.more)).split())


def shown(report: ReportInput) -> str:
    """What stands there without being asked for."""
    return " ".join(" ".join(one.text.striptags() for one in answer(Context.of(report)).shown).split())


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
    assert text.startswith(f"{second} is the winner: on 77 fresh departures")
    assert "S = 6.000 m·s (95 % interval 5.750 to 6.250, for all finalists at once)" in text
    assert (
        f"has {first}, which is worse on the fresh departures (difference of the winner to it −1.250 to −0.750" in text
    )
    assert "m·s), where designs were chosen, that is" in text  # no fresh scores of no control are at hand
    assert "+0.500 m·s" not in text
    assert "0.500 m·s better there than on the fresh ones (interval +0.125 to +0.875), more than chance" in text
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
    assert (
        f"Of the designs that miss a requirement 3 have a lower mean S than the winner, the lowest {S[0]:.3f} m·s"
        in text
    )
    met = Ranking.of(results, results.cases[0], bootstrap=100, require=["S >= 0"])
    assert f"All {d} designs meet the requirements" in said(input_of(make, results, met))


def test_pareto_front_and_baseline(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(
        results, results.cases[0], bootstrap=100, pareto=["S", "effort_mean"], baseline="preview_proportional"
    )
    text = said(input_of(make, results, ranking))
    assert "The Pareto front over mean S, mean steering effort holds" in text
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
    paper = next(design for design in results.designs if design.law == "preview_proportional")
    label = paper.label.replace("y_s", "ys").replace("K_y", "Ky").replace("K_psi", "Kψ")
    assert f"Of the paper’s law {label} stayed longest: when it was given up, its mean S on 100 departures" in text
    assert "was 1.000 m·s, 0.500 m·s above that of the best design then" in text
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


def test_a_winner_outside_the_set_of_best_is_not_told_to_be_in_it(
    make: ModuleType, results: StudyResults, plain: Ranking
) -> None:
    ranking = with_fresh(plain, winner=3)
    report = input_of(make, results, ranking)
    text, table = shown(report), Context.of(report).primary
    listed = "; ".join(" ".join(design_text(row).striptags().split()) + f" (rank {row.rank})" for row in table.rows[:3])
    assert f"The winner is not in the set of best, which holds 3 designs: {listed}. The truly best design" in text
    assert "in the set of best with it" not in text
    assert "cannot be told apart" not in text
    assert "3 designs in the set of best, without the winner" in answer_words(report)
    inside = answer_words(input_of(make, results, with_fresh(plain, winner=1)))
    assert "2 other designs in the set of best" in inside


def answer_words(report: ReportInput) -> str:
    """The section, without its tags."""
    body = answer_section.section(Context.of(report)).body
    return " ".join(html.unescape(re.sub(r"<[^>]*>", " ", body)).split())


def with_finalists(make: ModuleType, results: StudyResults) -> ReportInput:
    designs = [results.designs[i] for i in (0, 9, 10, 11, 12)]
    first = dataclasses.replace(results, cases=results.cases[:1])
    fresh = make.run(designs, make.invented_scenarios(60, 40, seed=5), [first.cases[0].case])
    report: ReportInput = make.report_input(dataclasses.replace(first, fresh=fresh))
    return report


def test_the_gain_is_that_of_the_fresh_departures(make: ModuleType, results: StudyResults) -> None:
    """Against the stored scores of the fresh departures, and their paired bootstrap."""
    report = with_finalists(make, results)
    ranking, fresh = report.rankings[0], report.results.fresh
    assert fresh is not None
    assert ranking.winner is not None
    i = next(k for k, one in enumerate(fresh.designs) if one == ranking.designs[ranking.winner])
    S, S_0, side = fresh.cases[0].S[i], fresh.cases[0].S_uncorrected[i], fresh.scenarios.side
    gain, old = 1 - S.mean() / S_0.mean(), ranking.reduction[ranking.winner]
    assert f"{gain:.3f}" != f"{old:.3f}"
    text = shown(report).replace("\u00a0", " ")
    found = re.search(
        r"no control there \((\S+) m·s\) that is (\S+) % less \(interval (\S+) % to (\S+) %\); "
        r"where designs were chosen it was (\S+) % less",
        text,
    )
    assert found is not None
    assert found.groups()[:2] == (f"{S_0.mean():.3f}", f"{100 * gain:.1f}")
    assert found[5] == f"{100 * old:.1f}"
    rng = np.random.default_rng(3)
    draws = np.concatenate([rng.choice(np.flatnonzero(side == s), (4000, (side == s).sum())) for s in (1, -1)], axis=1)
    ends = 100 * np.quantile(1 - S[draws].mean(axis=1) / S_0[draws].mean(axis=1), [0.025, 0.975])
    assert [float(found[3]), float(found[4])] == pytest.approx(ends, abs=0.25 * (ends[1] - ends[0]))
    words = answer_words(report)
    assert f"−{100 * gain:.1f} % against no control on the fresh departures" in words
    assert f"−{100 * old:.1f} % where designs were chosen" in words
    assert "deeper than 0.5 m, where designs were chosen" in words
    assert "comfort limits of ISO 11270, where designs were chosen" in words


def test_cost_and_what_tyres_cannot_give(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    def told(a_y: float) -> tuple[str, list[str]]:
        release = dataclasses.replace(
            plain.release, a_y_peak_max=np.full(len(plain), a_y), delta_rate_peak_max=np.full(len(plain), 0.5),
            comfortable=np.full(len(plain), 0.75), needless=np.full(len(plain), 0.125),
        )  # fmt: skip
        report = input_of(make, results, dataclasses.replace(plain, release=release))
        warnings = [one.text.striptags() for one in answer(Context.of(report)).shown if one.warning]
        return shown(report).replace("\u00a0", " "), warnings

    text, warnings = told(8.8)
    assert "peak ay up to 8.8 m/s², steering rate up to 28.6 °/s, 75.0 % of interventions within" in text
    assert "needless interventions in 12.5 % of all departures" in text
    assert not warnings
    (warning,) = told(8.9)[1]
    assert "8.9 m/s² is not to be had on a road: the plant’s tyres do not saturate" in warning.replace("\u00a0", " ")
    best = results.designs[int(plain.index[0])]
    never = input_of(
        make, results, dataclasses.replace(plain, release=dataclasses.replace(
            plain.release, comfortable=np.full(len(plain), np.nan), a_y_peak_max=np.full(len(plain), np.nan))),
    )  # fmt: skip
    assert not best.is_baseline
    assert "What it costs" not in shown(never)


def test_units_of_requirements(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(results, results.cases[0], bootstrap=100, require=["a_y_peak_p95 <= 0", "deeper <= 0.9"])
    text = shown(input_of(make, results, ranking))
    assert "No design meets the requirements (a_y_peak_p95 <= 0 m/s² and deeper <= 0.9)" in text


def test_the_only_design_is_not_the_lowest_of_one(make: ModuleType, results: StudyResults) -> None:
    S = np.sort(results.cases[0].S.mean(axis=1))
    one = Ranking.of(results, results.cases[0], bootstrap=100, require=[f"S >= {float(S[-2:].mean())!r}"])
    text, d = shown(input_of(make, results, one)), len(results.designs)
    assert f"is the only design that meets the requirements, of {d} tried, with mean score: S = " in text
    alone = make.run(results.designs[-1:], results.scenarios, [results.cases[0].case])
    text = shown(make.report_input(alone))
    assert "is the only design, with mean score: S = " in text
    assert "1 design" not in text


def test_laws_without_a_ranked_design_are_told_in_the_caption(
    make: ModuleType, results: StudyResults, plain: Ranking
) -> None:
    assert "where none of a law" not in answer_words(input_of(make, results, plain))
    S = np.array([results.cases[0].S[i].mean() for i, one in enumerate(results.designs) if one.law != "lqr"])
    only_lqr = Ranking.of(results, results.cases[0], bootstrap=100, require=[f"S <= {float(S.min()) - 1e-6!r}"])
    words = answer_words(input_of(make, results, only_lqr))
    assert "where none of a law meets the requirements, the one with the lowest mean S" in words


def test_small_differences_have_two_digits(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    design = next(design for design in results.designs if design.law == "lqr")
    r = dict(design.gains)["r_delta"]
    assert isinstance(r, float)
    near = dataclasses.replace(design, gains=tuple((k, r * 1.0005 if k == "r_delta" else v) for k, v in design.gains))
    paper = next(one for one in results.designs if one.law == "preview_proportional")
    made = make.run([design, near, paper], results.scenarios, [results.cases[0].case])
    ranking = Ranking.of(made, made.cases[0], bootstrap=100)
    small = abs(float(np.diff(made.cases[0].S[:2].mean(axis=1))[0]))
    assert 1e-6 < small < 1e-3
    baseline = Ranking.of(made, made.cases[0], bootstrap=100, baseline=made.designs[int(ranking.index[1])].id)
    assert f"is −{small:.1e}".replace("e-", "e−") in said(input_of(make, made, baseline))


def test_other_plants_in_a_sentence(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    one = dataclasses.replace(results, cases=results.cases[:1])
    names = ("study", "actuator", "tyres", "together")
    p, best = len(names), one.designs[int(plain.index[0])]
    column = {"low": [0.0, 0.05, 0.25, 0.5], "high": [0.0, 0.15, 0.35, 1.5], "change": [0.0, 0.1, 0.3, 1.0]}
    given: dict[str, Any] = dict(
        key="", designs=(best.id, "other"), contends=np.array([True, True]), slow=(), unsafe=(), more=0, plants=names,
        titles=("Study", "Slow actuator", "Slippery <road>", "Many at once"), differences=("",) * p, left_out=(),
        left=6, right=4, S=np.ones((p, 2)), S_uncorrected=np.ones((p, 2)),
        rank=np.array([[1, 2], [1, 2], [2, 1], [1, 2]]),
        failures=np.array([[0, 0], [0, 0], [0, 0], [3, 0]]), diverged=np.zeros((p, 2), dtype=int),
        rival=np.ones(p, dtype=np.int64), lead=np.zeros(p), lead_low=np.zeros(p), lead_high=np.zeros(p), raised=(),
        v=np.zeros(0), margins=(), **{name: np.array([[v, 0.0] for v in values]) for name, values in column.items()},
    )  # fmt: skip
    rest = {field.name: np.zeros((p, 2)) for field in dataclasses.fields(Robustness) if field.name not in given}
    robustness = Robustness(**given, **rest)
    report = dataclasses.replace(input_of(make, one, plain), robustness=robustness)
    text = shown(report).replace("\u00a0", " ")
    assert (
        "“Slippery <road>” hurts it most: +0.300 m·s (30.0 % of its S), interval +0.250 to +0.350; it has rank 2 of 2 "
        "there. Of 10 departures it fails in none there, and in 3 on “Many at once” (robustness)."
    ) in html.unescape(text)
    assert "<road>" not in answer_section.section(Context.of(report)).body
    other = dataclasses.replace(robustness, designs=("other", best.id))
    assert "On other plants" not in shown(dataclasses.replace(report, robustness=other))
    better = dataclasses.replace(robustness, change=-robustness.change)
    assert "one option at a time, none of 2 makes its mean S worse" in shown(
        dataclasses.replace(report, robustness=better)
    )


def test_what_is_asked_for_stands_folded(make: ModuleType, results: StudyResults) -> None:
    ranking = Ranking.of(results, results.cases[0], bootstrap=100, pareto=["S", "effort_mean"])
    body = answer_section.section(Context.of(input_of(make, results, ranking))).body
    assert "The Pareto front" in body.partition('<details class="more">')[2].partition("</details>")[0]
    assert body.index("sits at the end of what was tried") < body.index("<details")


def test_one_other_design_in_the_set_is_the_other(make: ModuleType, results: StudyResults, plain: Ranking) -> None:
    two = dataclasses.replace(plain, set_of_best=np.arange(len(plain)) < 2)
    text = shown(input_of(make, results, two))
    assert "1 other design is in the set of best with it" in text
    assert "do not tell which. The other: " in text
