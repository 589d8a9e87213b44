# ruff: noqa: RUF001 - the page shows true minus signs
"""Confidence: widths and numbers of scenarios against independent arithmetic and simulated repetitions."""

from __future__ import annotations

import dataclasses
import math
import re

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.reports import PRIMARY, invented_scenarios, report_input, run, said_in, section_of
from studies.design import Design
from studies.report.context import Context
from studies.report.figures.precision import measured_errors, needed_scenarios, two_digits
from studies.report.inputs import ReportInput
from studies.report.sections import confidence
from studies.report.tables.rivals import rivals
from studies.results import StudyResults


def test_measured_errors_are_those_of_stratified_means() -> None:
    rng = np.random.default_rng(0)
    side = np.repeat([1, -1], [300, 100])
    values = np.where(side > 0, rng.normal(1.0, 2.0, 400), rng.normal(5.0, 0.5, 400))
    count, error = measured_errors(values, side)
    assert count.tolist() == [20, 50, 100, 200, 400]
    of_all = math.sqrt(
        sum((values[side == s].var(ddof=1) * (side == s).mean() ** 2 / (side == s).sum()) for s in (1, -1))
    )
    assert error[-1] == pytest.approx(of_all, rel=1e-12)
    for n, e in zip(count, error, strict=True):
        expected = math.sqrt((0.75 * 2.0**2 + 0.25 * 0.5**2) / n)  # of the population
        assert e == pytest.approx(expected, rel=0.12)


def test_few_scenarios_of_a_side_are_left_out() -> None:
    side = np.array([1] * 59 + [-1])
    assert measured_errors(np.arange(60.0), side)[0].size == 0  # one alone shows no spread
    side[:3] = -1
    assert measured_errors(np.arange(60.0), side)[0].tolist() == [50, 60]
    assert measured_errors(np.ones(1), np.ones(1, dtype=int))[0].size == 0


def test_needed_scenarios_tell_apart_as_often_as_said() -> None:
    rng = np.random.default_rng(1)
    n, difference, sigma, critical = 80, 0.05, 0.4, 2.6
    error = sigma / math.sqrt(n)
    needed = needed_scenarios(n, difference, critical * error, error)
    for count, share in ((needed.even, 0.5), (needed.likely, 0.9)):
        means = rng.normal(difference, sigma / math.sqrt(count), 20_000)
        assert np.mean(means > critical * sigma / math.sqrt(count)) == pytest.approx(share, abs=0.012)
    assert needed_scenarios(n, 0.0, 1.0, 1.0).even == math.inf
    assert needed_scenarios(n, 0.1, math.inf, math.inf).likely == math.inf


@pytest.mark.parametrize(("count", "shown"), [(3.2, 4), (99.1, 100), (101.0, 110), (123456.0, 130000), (0.0, 0)])
def test_numbers_of_scenarios_are_rounded_up(count: float, shown: int) -> None:
    assert two_digits(count) == shown


def test_rivals_are_the_second_and_the_best_of_another_law(report: ReportInput) -> None:
    context = Context.of(report)
    ranking = context.ranking
    first, *others = rivals(context)
    assert first.row.place == 1
    S = context.case.S[ranking.index]
    for one in (first, *others):
        k = one.row.place
        assert one.values == pytest.approx(S[k] - S[0], abs=1e-12)
        assert one.difference.value == pytest.approx(one.values.mean(), abs=1e-9)
        critical = one.half_width / one.error  # the ranking's own, for all designs at once
        assert 1.96 < critical < 6.0
        assert one.needed.even == pytest.approx(100 * (one.half_width / one.values.mean()) ** 2, rel=1e-6)
    laws, places = [design.law for design in ranking.designs], [one.row.place for one in others]
    other_law = next(k for k, law in enumerate(laws) if law not in (laws[0], "none"))
    may_be_best = np.flatnonzero(ranking.set_of_best)[1:2].tolist()
    assert places == sorted({other_law, *may_be_best} - {1})


def test_the_next_design_that_may_be_best_is_among_the_rivals(report: ReportInput) -> None:
    context = Context.of(report)
    rows = [dataclasses.replace(row, in_set=row.place in (0, 3)) for row in context.primary.rows]
    changed = dataclasses.replace(context, tables=(dataclasses.replace(context.primary, rows=tuple(rows)),))
    assert [one.row.place for one in rivals(changed)][:2] == [1, 3]
    assert "in the set of best" in said_in(confidence.section, changed)


def test_finalists_stand_with_both_scores(results: StudyResults) -> None:
    designs = [results.designs[i] for i in (0, 11, 12, 13, 14)]
    fresh = run(designs, invented_scenarios(60, 40, seed=5), [case.case for case in results.cases])
    report = report_input(dataclasses.replace(results, fresh=fresh))
    ranking = report.rankings[0]
    finalists = np.flatnonzero(np.isfinite(ranking.optimism))

    def spread(values: list[float]) -> np.ndarray:
        out = np.full(len(ranking), np.nan)
        out[finalists[:3]] = values
        return out

    known = {"S": 1.111, "S_low": 1.011, "S_high": 1.211}
    given = {name: np.full(len(ranking), value) for name, value in known.items()} | {
        "fresh_S": spread([2.222] * 3), "fresh_low": spread([2.122] * 3), "fresh_high": spread([2.322] * 3),
        "optimism": spread([0.3, 0.1, -0.3]), "optimism_low": spread([0.2, -0.1, -0.4]),
        "optimism_high": spread([0.4, 0.2, -0.2]),
    }  # fmt: skip
    ranking = dataclasses.replace(ranking, **given)
    made, page = section_of(confidence.section, dataclasses.replace(report, rankings=(ranking, report.rankings[1])))
    rows = page.captioned("Finalists on fresh departures")[1:]
    assert [row[2:4] + row[5:7] for row in rows] == [
        ["1.111 [1.011 to 1.211]", "2.222 [2.122 to 2.322]", optimism, verdict]
        for optimism, verdict in (
            ("+0.300 [+0.200 to +0.400]", "the search flattered it"),
            ("+0.100 [−0.100 to +0.200]", "within chance"),
            ("−0.300 [−0.400 to −0.200]", "better on the fresh departures"),
        )
    ]
    assert "finalists" in [drawing.name for drawing in made.drawings]


def test_frequencies_are_shares_of_resamples_and_sum_to_one(report: ReportInput) -> None:
    context = Context.of(report)
    ranking = context.ranking
    said = said_in(confidence.section, context)
    shares = [float(text) for text in re.findall(r"([\d.]+)\s%", said.split("Share of resamples")[-1])]
    assert sum(shares) == pytest.approx(100.0 + 100.0 * ("0 to 100" in said.split("Share of resamples")[-1]), abs=0.5)
    assert "not the probability that the design is the best" in said
    best = ranking.best_frequency[ranking.set_of_best].max()
    assert f"{100 * best:.1f}" in said
    assert "No finalist ran on fresh departures" in said


@pytest.mark.parametrize(("left", "right"), [(1, 0), (1, 1), (2, 1), (9, 0), (0, 9)])
def test_few_scenarios(left: int, right: int) -> None:
    designs = [Design.of(LQR(), 0.05), Design.of(PreviewProportional(), 0.05), Design.of(NoControl(), 0.05)]
    results = run(designs, invented_scenarios(left, right), [PRIMARY])
    said = said_in(confidence.section, report_input(results))
    assert "nan" not in said
    assert ("One departure only" in said) == (left + right == 1)
    assert ("shows no spread" in said) == (min(left, right) == 1 or left + right == 1)
