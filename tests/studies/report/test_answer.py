# ruff: noqa: RUF001 - the page shows true minus signs
"""The answer says what the ranking says: winner, set of best, fresh scores, requirements, Pareto front, race."""

from __future__ import annotations

import dataclasses
import re
from typing import Any

import numpy as np
import pytest

from controllers import LQR, PreviewProportional
from helpers.reports import PRIMARY, invented_scenarios, page_of, report_input, run, said_in, scored, section_of
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.report.sections import answer
from studies.results import Dropped, Race, StudyResults
from studies.robustness.robustness import Robustness


@pytest.fixture(scope="module")
def alone(results: StudyResults) -> StudyResults:
    """The primary case only."""
    return dataclasses.replace(results, cases=results.cases[:1])


@pytest.fixture(scope="module")
def plain(alone: StudyResults) -> Ranking:
    return Ranking.of(alone, alone.cases[0], bootstrap=100)


def report_of(results: StudyResults, ranking: Ranking, **changes: Any) -> ReportInput:
    return dataclasses.replace(report_input(results), rankings=(ranking,), **changes)


def said(results: StudyResults, ranking: Ranking, **changes: Any) -> str:
    return said_in(answer.section, report_of(results, ranking, **changes))


def names(ranking: Ranking, count: int) -> list[str]:
    """The first designs of the ranking, as the answer writes them."""
    given = {"y_s": "ys", "K_y": "Ky", "K_psi": "Kψ", "r_delta": "rδ", "-": "−"}
    shown = []
    for design in ranking.designs[:count]:
        label = re.sub("|".join(given), lambda m: given[m[0]], design.label)
        shown.append(re.sub(r"=([^,]*)", r" = \1", label).removesuffix(" m"))
    return shown


def with_fresh(ranking: Ranking, winner: int | None, **changes: Any) -> Ranking:
    """Four finalists, with fresh scores that no one could take for those of the search."""
    d = len(ranking)

    def spread(values: Any) -> np.ndarray:
        out = np.full(d, np.nan)
        out[:4] = values
        return out

    given: dict[str, Any] = {"fresh_scenarios": 77, "winner": winner, "set_of_best": np.arange(d) < 3}
    for name, values in (("fresh_S", [7.0, 6.0, 8.0, 9.0]), ("fresh_difference", [0.0, -1.0, 1.0, 2.0])):
        low, high = name.removesuffix("_S") + "_low", name.removesuffix("_S") + "_high"
        given |= {name: spread(values), low: spread(values) - 0.25, high: spread(values) + 0.25}
    given |= {"optimism": spread(0.5), "optimism_low": spread(0.125), "optimism_high": spread(0.875)}
    return dataclasses.replace(ranking, **(given | changes))


def test_worse_than_no_control_has_its_interval_the_right_way_round() -> None:
    """S is 1.2 S_0 on average. Residuals S - 1.2 S_0 of -0.1, 0.2 on the left and 0.1, -0.2 on the right.

    Each side has variance 0.045, so the mean has standard error sqrt(0.18) / 4 and the ratio that over 1.5: 0.0707.
    """
    worse = scored([1.1, 2.6, 1.3, 2.2], [1.0, 2.0, 1.0, 2.0], [Design.of(LQR(), 0.05)])
    text = said_in(answer.section, report_input(worse))
    assert "Against no control (1.500 m·s) that is 20.0 % more (interval 6.1 % to 33.9 %)." in text
    assert "+20.0 %against no controlinterval 6.1 to 33.9" in text
    assert "1.800 m·smean score S of" in text
    better = scored([0.9, 1.4, 0.7, 1.8], [1.0, 2.0, 1.0, 2.0], [Design.of(LQR(), 0.05)])
    text = said_in(answer.section, report_input(better))
    assert "Against no control (1.500 m·s) that is 20.0 % less (interval 6.1 % to 33.9 %)." in text
    assert "−20.0 %against no controlinterval −33.9 to −6.1" in text


def test_worse_than_the_papers_controller_where_designs_were_chosen() -> None:
    """As above, of a winner that the fresh departures chose."""
    designs = [Design.of(PreviewProportional(), 0.2), Design.of(LQR(), 0.05)]
    study = scored([[1.0, 2.0, 1.0, 2.0], [1.1, 2.6, 1.3, 2.2]], [3.0, 3.0, 3.0, 3.0], designs)
    ranking = Ranking.of(study, study.cases[0], bootstrap=50)
    text = said(study, dataclasses.replace(ranking, winner=1))
    assert "Against the paper’s controller, Table I (Preview P, ys = 0.2 m; rank 1, 1.500 m·s)" in text
    assert "it is 0.300 m·s or 20.0 % more (interval 6.1 % to 33.9 %)" in text
    text = said(study, dataclasses.replace(ranking, set_of_best=np.array([True, False])))
    assert "Against the best design of any other law (LQR, ys = 0.05 m; rank 2, 1.800 m·s) it is 0.300 m·s or" in text


@pytest.mark.slow
def test_the_winner_need_not_be_the_first(alone: StudyResults, plain: Ranking) -> None:
    ranking = with_fresh(plain, winner=1)
    first, second = names(ranking, 2)
    text = said(alone, ranking)
    assert f"{second} 1/rad² is the winner: on 77 fresh departures" in text
    assert "S = 6.000 m·s (95 % interval 5.750 to 6.250, for all finalists at once)" in text
    assert (
        f"has {first} 1/rad², which is worse on the fresh departures "
        "(difference of the winner to it −1.250 to −0.750 m·s)" in text
    )
    assert "m·s), where designs were chosen, that is" in text  # no fresh scores of no control are at hand
    assert "+0.500 m·s" not in text
    assert "0.500 m·s better there than on the fresh ones (interval +0.125 to +0.875), more than chance" in text
    assert "2 other designs are in the set of best with it" in text
    assert "2other designs in the set of best" in text
    assert f"The others: {first} 1/rad² (rank 1); " in text
    worse = dataclasses.replace(
        ranking, optimism=-ranking.optimism, optimism_low=-ranking.optimism_high, optimism_high=-ranking.optimism_low
    )
    assert "0.500 m·s worse there than on the fresh ones (interval −0.875 to −0.125)" in said(alone, worse)
    within = with_fresh(plain, winner=1, optimism_low=np.full(len(plain), -0.1))
    assert "no more than chance explains" in said(alone, within)
    # figures, limits and the table follow the winner too
    page = page_of(report_of(alone, ranking))
    (table,) = page.headed("Rank", "Gains")
    assert [("winner" in row[1], "set of best" in row[1]) for row in table[1:5]] == [
        (False, True), (True, False), (False, True), (False, False)]  # fmt: skip
    assert page.html.partition('<table class="ranking">')[2].partition("</table>")[0].count('<tr class="best">') == 1
    assert "the winner, keeps the front" in page.words("trade-offs")


def test_a_first_that_misses_a_requirement_on_fresh_departures(alone: StudyResults, plain: Ranking) -> None:
    unmet = (("deeper <= 0.1",), *((),) * (len(plain) - 1))
    text = said(alone, with_fresh(plain, winner=1, fresh_unmet=unmet))
    assert "which misses deeper <= 0.1 on the fresh departures" in text


@pytest.mark.slow
def test_ranked_designs_without_a_winner(alone: StudyResults) -> None:
    ranking = Ranking.of(alone, alone.cases[0], bootstrap=100, require=["deeper <= 0.9"])
    report = report_of(alone, with_fresh(ranking, winner=None))
    _, page = section_of(answer.section, report)
    assert "There is no winner: no finalist meets the requirements (deeper <= 0.9)" in page.words()
    assert "is the winner" not in page.words()
    assert "0finalists meet the requirements on fresh departures" in page.words()
    assert 'class="tag strong"' not in page_of(report).html


def test_requirements_say_of_how_many_and_at_what_price(alone: StudyResults) -> None:
    S, d = np.sort(alone.cases[0].S.mean(axis=1)), len(alone.designs)
    text = said(alone, Ranking.of(alone, alone.cases[0], bootstrap=100, require=[f"S >= {float(S[2:4].mean())!r}"]))
    assert f"lowest mean score of the {d - 3} designs that meet the requirements, of {d} tried" in text
    assert f"3 of {d} designs miss a requirement and are not ranked" in text
    lowest = f"Of the designs that miss a requirement 3 have a lower mean S than the winner, the lowest {S[0]:.3f} m·s"
    assert lowest in text
    met = Ranking.of(alone, alone.cases[0], bootstrap=100, require=["S >= 0"])
    assert f"All {d} designs meet the requirements" in said(alone, met)
    one = Ranking.of(alone, alone.cases[0], bootstrap=100, require=[f"S >= {float(S[-2:].mean())!r}"])
    text = said(alone, one)
    assert f"is the only design that meets the requirements, of {d} tried, with mean score: S = " in text
    units = Ranking.of(alone, alone.cases[0], bootstrap=100, require=["a_y_peak_p95 <= 0", "deeper <= 0.9"])
    assert "No design meets the requirements (a_y_peak_p95 <= 0 m/s² and deeper <= 0.9)" in said(alone, units)


def test_pareto_front_and_baseline(alone: StudyResults) -> None:
    ranking = Ranking.of(
        alone, alone.cases[0], bootstrap=100, pareto=["S", "effort_mean"], baseline="preview_proportional"
    )
    shifted = {"baseline_difference": -0.5, "baseline_difference_low": -0.75, "baseline_difference_high": -0.25}
    ranking = dataclasses.replace(ranking, **{name: np.full(len(ranking), v) for name, v in shifted.items()})
    report = report_of(alone, ranking)
    made, page = section_of(answer.section, report)
    text = page.words()
    assert f"The Pareto front over mean S, mean steering effort holds {ranking.pareto.sum()} designs of the" in text
    assert f"of the {len(ranking)} ranked" in text
    assert "difference to the baseline, Preview P, ys = 0.2 m" in text
    assert "is −0.500 m·s (interval −0.750 to −0.250 m·s" in text
    # what is asked for stands folded, what limits the choice does not
    assert "The Pareto front" in made.body.partition('<details class="more">')[2].partition("</details>")[0]
    assert made.body.index("sits at the end of what was tried") < made.body.index("<details")
    whole = page_of(report).html
    assert whole.count('<span class="tag">Pareto</span>') == ranking.pareto.sum()
    assert whole.count('<span class="tag">baseline</span>') == 1


@pytest.mark.slow
def test_a_race_is_told_and_counts_what_it_gave_up(alone: StudyResults) -> None:
    """One LQR design is left: what it sweeps, and where it ends, is that of all that were tried."""
    lqr = [i for i, d in enumerate(alone.designs) if d.law == "lqr"]
    keep = np.array([i for i in range(len(alone.designs)) if i == lqr[-1] or alone.designs[i].law == "none"])
    gone = [i for i in range(len(alone.designs)) if i not in keep]
    paper = next(design for design in alone.designs if design.law == "preview_proportional")
    dropped = (
        Dropped(one, 2, 100, 1.0, 0.5, 0.1) if one is paper else Dropped(one, 1, 50, 9.0, 8.0, 7.0)
        for one in (alone.designs[i] for i in gone)
    )
    race = Race((100, 200), (5, 2), tuple(dropped), 300, 1000)
    case = alone.cases[0]
    rows = {name: getattr(case, name)[keep] for name in ("S", "S_uncorrected", "status", "failed_solves", "law_time")}
    companions = type(case.companions)(
        **{f.name: getattr(case.companions, f.name)[keep] for f in dataclasses.fields(case.companions)}
    )
    case = dataclasses.replace(case, **rows, companions=companions)
    raced = dataclasses.replace(alone, designs=tuple(alone.designs[i] for i in keep), cases=(case,), race=race)
    page, d = page_of(report_of(raced, Ranking.of(raced, case, bootstrap=100))), len(alone.designs)
    text = page.words("answer")
    assert f"lowest mean score of the 2 designs that a race left of {d} tried" in text
    assert f"{len(gone)} of {d} designs were given up" in text
    assert "5 after 100, 2 after 200. That took 30.0 % of the runs" in text
    assert "No design is left of: Preview P." in text
    label = paper.label.replace("y_s", "ys").replace("K_y", "Ky").replace("K_psi", "Kψ")
    assert f"Of the paper’s law {label} stayed longest: when it was given up, its mean S on 100 departures" in text
    assert "was 1.000 m·s, 0.500 m·s above that of the best design then" in text
    assert "at least 90 % for race and ranking together" in text
    assert "ys (highest tried)" in text
    assert "ys = 0.2 m, rδ = 300" in text  # swept in the study, if not among those left
    assert f"· {d} designs ·" in page.words()
    assert f"{len(gone)} designs given up in a race" in page.words()
    assert "The race left one design of each law at most" in page.all_words
    assert f"lowest mean S of {d} designs" in page.words("failures")
    assert "A race gives up designs on few departures" in page.words("failures")


def test_a_winner_outside_the_set_of_best_is_not_told_to_be_in_it(alone: StudyResults, plain: Ranking) -> None:
    ranking = with_fresh(plain, winner=3)
    text = said(alone, ranking)
    listed = text.split("The winner is not in the set of best, which holds 3 designs: ")[1].split(". The truly best")[0]
    assert [re.sub(r" 1/rad².*| \(rank.*", "", one) for one in listed.split("; ")] == names(ranking, 3)
    assert [one[-8:] for one in listed.split("; ")] == ["(rank 1)", "(rank 2)", "(rank 3)"]
    assert "in the set of best with it" not in text
    assert "3designs in the set of best, without the winner" in text
    two = said(alone, dataclasses.replace(plain, set_of_best=np.arange(len(plain)) < 2))
    assert "1 other design is in the set of best with it" in two
    assert "do not tell which. The other: " in two


def test_the_gain_is_that_of_the_fresh_departures(alone: StudyResults) -> None:
    """Against the stored scores of the fresh departures, and their paired bootstrap."""
    designs = [alone.designs[i] for i in (0, 9, 10, 11, 12)]
    fresh = run(designs, invented_scenarios(60, 40, seed=5), [PRIMARY])
    report = report_input(dataclasses.replace(alone, fresh=fresh))
    ranking = report.rankings[0]
    assert ranking.winner is not None
    i = next(k for k, one in enumerate(fresh.designs) if one == ranking.designs[ranking.winner])
    S, S_0, side = fresh.cases[0].S[i], fresh.cases[0].S_uncorrected[i], fresh.scenarios.side
    gain, old = 1 - S.mean() / S_0.mean(), ranking.reduction[ranking.winner]
    assert f"{gain:.3f}" != f"{old:.3f}"
    text = said_in(answer.section, report)
    found = re.search(
        r"no control there \((\S+) m·s\) that is (\S+) % less \(interval (\S+) % to (\S+) %\); "
        r"where designs were chosen it was (\S+) % less",
        text,
    )
    assert found is not None
    assert found.groups()[:2] == (f"{S_0.mean():.3f}", f"{100 * gain:.1f}")
    assert found[5] == f"{100 * old:.1f}"
    rng = np.random.default_rng(3)
    draws = np.concatenate([rng.choice(np.flatnonzero(side == s), (1000, (side == s).sum())) for s in (1, -1)], axis=1)
    ends = 100 * np.quantile(1 - S[draws].mean(axis=1) / S_0[draws].mean(axis=1), [0.025, 0.975])
    assert [float(found[3]), float(found[4])] == pytest.approx(ends, abs=0.25 * (ends[1] - ends[0]))
    assert f"−{100 * gain:.1f} %against no control on the fresh departures" in text
    assert f"−{100 * old:.1f} % where designs were chosen" in text
    assert "deeper than 0.5 m, where designs were chosen" in text
    assert "comfort limits of ISO 11270, where designs were chosen" in text


def test_cost_and_what_tyres_cannot_give(alone: StudyResults, plain: Ranking) -> None:
    def told(a_y: float, comfortable: float = 0.75) -> str:
        release = dataclasses.replace(
            plain.release, a_y_peak_max=np.full(len(plain), a_y),
            a_y_added_peak_max=np.full(len(plain), 2.2), delta_rate_peak_max=np.full(len(plain), 0.5),
            comfortable=np.full(len(plain), comfortable), needless=np.full(len(plain), 0.125),
        )  # fmt: skip
        deeper = np.full(len(plain), 0.0625)
        return said(alone, dataclasses.replace(plain, release=release, deeper=deeper))

    text = told(8.8)
    assert "peak ay up to 8.8 m/s², steering rate up to 28.6 °/s, 75.0 % of interventions within" in text
    assert "needless interventions in 12.5 % of all departures (not deeper than 0.3 m without control)" in text
    assert "75.0 %of interventions within the comfort limits of ISO 11270up to 2.2 m/s² more than the rec" in text
    assert "6.2 %of departures deeper than 0.5 m6.2 % without control" in text
    assert "not to be had" not in text
    assert "8.9 m/s² is not to be had on a road: the plant’s tyres do not saturate" in told(8.9)
    assert "What it costs" not in told(np.nan, np.nan)


def test_laws_without_a_ranked_design_are_told_in_the_caption(alone: StudyResults, plain: Ranking) -> None:
    assert "where none of a law" not in said(alone, plain)
    S = np.array([alone.cases[0].S[i].mean() for i, one in enumerate(alone.designs) if one.law != "lqr"])
    only_lqr = Ranking.of(alone, alone.cases[0], bootstrap=100, require=[f"S <= {float(S.min()) - 1e-6!r}"])
    assert "where none of a law meets the requirements, the one with the lowest mean S" in said(alone, only_lqr)


def test_small_differences_have_two_digits() -> None:
    designs = [Design.of(LQR(), 0.05), Design.of(LQR(), 0.06), Design.of(PreviewProportional(), 0.2)]
    study = scored([[1.0, 1.0, 1.0, 1.0], [1.0, 1.00056, 1.0, 1.0], [2.0, 2.0, 2.0, 2.0]], [3.0] * 4, designs)
    ranking = Ranking.of(study, study.cases[0], bootstrap=100, baseline=designs[1].id)
    assert "difference to the baseline, LQR, ys = 0.06 m, is −1.4e−04 m·s" in said(study, ranking)


def test_other_plants_in_a_sentence(alone: StudyResults, plain: Ranking) -> None:
    names = ("study", "actuator", "tyres", "together")
    p, best = len(names), plain.designs[0]
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
    assert (
        "“Slippery <road>” hurts it most: +0.300 m·s (30.0 % of its S), interval +0.250 to +0.350; it has rank 2 of 2 "
        "there. Of 10 departures it fails in none there, and in 3 on “Many at once” (robustness)."
    ) in said(alone, plain, robustness=robustness)
    other = dataclasses.replace(robustness, designs=("other", best.id))
    assert "On other plants" not in said(alone, plain, robustness=other)
    better = dataclasses.replace(robustness, change=-robustness.change)
    text = said(alone, plain, robustness=better)
    assert "one option at a time, none of 2 makes its mean S worse" in text
