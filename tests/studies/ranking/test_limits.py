"""Intervals of limited metrics: textbook ends, repeated departures, coverage, and what verdict and tables show."""

import csv
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from helpers.results import page_of, report_input, results_of, scenarios_of
from ldctoolkit import EventStatus, Scenarios, Setup
from ldctoolkit.controllers import LQR, LinearMPC, NoControl
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.measures import measured
from ldctoolkit.studies.ranking.ranking import Ranking, write_csv
from ldctoolkit.studies.ranking.verdict import Light, OtherPlants, judged, more_lines, verdict, verdict_lines
from ldctoolkit.studies.requirements import Estimate
from ldctoolkit.studies.results import StudyResults
from ldctoolkit.studies.storage.measure_table import MeasureTable

DESIGNS = (Design.of(NoControl(), 0.2), Design.of(LQR(r_delta=100.0), 0.1))
JERK = "jerk_added_peak_p95"


def study(scenarios: Scenarios, status: Any = 0, S: float = 1.0, **metrics: Any) -> StudyResults:
    """No control, with a mean S of 9, and one LQR, whose metrics are given."""
    n = scenarios.n
    columns = {name: np.stack([np.zeros(n), np.broadcast_to(value, n)]) for name, value in metrics.items()}
    rows = np.outer([9.0, S], np.linspace(0.9, 1.1, n))
    results = results_of(rows, DESIGNS, status=status, metrics=columns)
    return dataclasses.replace(results, scenarios=scenarios)


def ranked(results: StudyResults, *require: str, fresh: StudyResults | None = None, **more: Any) -> Ranking:
    results = measured(dataclasses.replace(results, fresh=fresh), MeasureTable(), Setup())
    return Ranking.of(results, bootstrap=50, require=require, **more)


def estimate(ranking: Ranking, name: str) -> Estimate:
    i = next(k for k, design in enumerate(ranking.designs) if not design.is_baseline)
    return next(limited for limited in ranking.estimates(i) if limited.requirement.metric.name == name)


def ends_by_hand(values: np.ndarray, share: float, n: int) -> tuple[float, float]:
    """The order statistics whose binomial tails are 2.5 % at most, of n independent values."""
    ordered, cdf = np.sort(values), scipy.stats.binom(n, share).cdf(np.arange(-1, n + 1))
    below = max(k for k in range(n + 1) if cdf[k] <= 0.025)  # P(fewer than k values below the quantile)
    above = min([k for k in range(1, n + 1) if 1.0 - cdf[k] <= 0.025], default=n + 1)
    each = values.size / n
    low = ordered[int(below * each) - 1] if below else -np.inf
    return low, ordered[int(np.ceil(above * each)) - 1] if above <= n else np.inf


@pytest.mark.parametrize("n", [50, 71, 300, 1000])
def test_ends_of_a_quantile_are_order_statistics(n: int) -> None:
    """Of the interventions alone: the other departures have other numbers. Below 72 of them nothing lies above."""
    values = np.random.default_rng(n).gamma(2.0, 1.0, n + 30)
    status = np.zeros((2, n + 30), dtype=int)
    status[1, :30] = int(EventStatus.NEVER_TRIGGERED)
    ranking = ranked(study(scenarios_of(n + 30), status, jerk_added_peak=values), "t_back_median <= 3", "S_p95 <= 2")
    limited, stored = estimate(ranking, JERK), values[30:].astype(np.float32)
    assert (limited.low, limited.high) == ends_by_hand(stored, 0.95, n)
    assert limited.value == pytest.approx(np.quantile(stored.astype(float), 0.95))
    assert np.isinf(limited.high) == (n < 72)
    # S is that of all departures
    limited = estimate(ranking, "S_p95")
    assert (limited.low, limited.high) == ends_by_hand(np.linspace(0.9, 1.1, n + 30), 0.95, n + 30)


def test_ends_of_a_share_are_those_of_clopper_and_pearson() -> None:
    n = 240
    dtle = np.where(np.arange(n) < 30, -0.5, 0.1)
    status = np.zeros((2, n), dtype=int)
    status[1, 200:] = int(EventStatus.NEVER_TRIGGERED)
    t_back = np.where(np.arange(n) < 50, np.inf, 1.0)
    results = study(scenarios_of(n), status, dtle=dtle, t_back=t_back)
    ranking = ranked(results, "within_dtle >= 0.8", "back_inside >= 0.7", "triggered <= 0.9", "needless <= 1")
    counts = {"within_dtle": (210, n), "back_inside": (150, 200), "triggered": (200, n), "needless": (200, n)}
    for name, (count, of) in counts.items():
        exact, limited = scipy.stats.binomtest(count, of).proportion_ci(0.95, "exact"), estimate(ranking, name)
        assert (limited.low, limited.high) == pytest.approx((exact.low, exact.high), rel=1e-9)
        assert limited.value == pytest.approx(count / of)


def test_the_gain_of_a_share_is_paired() -> None:
    """Of 400 departures the design alone keeps 60 within, no control alone 20: Bonferroni by hand."""
    k, n = np.arange(400), 400
    columns = {"dtle": np.stack([np.where((k < 40) | (k >= 100), 0.0, -1.0), np.where(k >= 20, 0.0, -1.0)])}
    results = results_of(np.ones((2, n)), DESIGNS, metrics=columns)
    limited = estimate(ranked(results, "within_dtle_gain >= 0"), "within_dtle_gain")
    more, less = (scipy.stats.binomtest(count, n).proportion_ci(0.975, "exact") for count in (60, 20))
    assert (limited.low, limited.high) == pytest.approx((more.low - less.high, more.high - less.low), rel=1e-9)
    assert limited.value == pytest.approx(0.1)


def test_repeated_departures_count_as_kishs_number() -> None:
    """60 departures of weight 1 and 60 of weight 3, as often in the sample: 240 that are worth 96."""
    times = np.repeat([1, 3], 60)
    rows = np.repeat(np.arange(120), times)
    values = np.random.default_rng(3).gamma(2.0, 1.0, 120)
    scenarios = dataclasses.replace(scenarios_of(120).take(rows), index=np.arange(240))
    ranking = ranked(study(scenarios, jerk_added_peak=values[rows], dtle=np.where(rows < 90, -1.0, 0.0)),
                     "within_dtle >= 0.5")  # fmt: skip
    limited = estimate(ranking, JERK)
    assert (limited.low, limited.high) == ends_by_hand(values[rows].astype(np.float32), 0.95, 96)
    exact, limited = scipy.stats.binomtest(36, 96).proportion_ci(0.95, "exact"), estimate(ranking, "within_dtle")
    assert (limited.value, limited.low, limited.high) == pytest.approx((0.375, exact.low, exact.high), rel=1e-9)


def test_what_is_no_quantile_and_no_share_has_no_interval() -> None:
    """But mean S, which has that of the ranking."""
    ranking = ranked(study(scenarios_of(200)), "a_y_peak_max <= 5", "gain_margin >= 0", "S <= 2", setup=Setup())
    for name in ("a_y_peak_max", "gain_margin", "lost", "phase_margin"):
        limited = estimate(ranking, name)
        assert np.isnan([limited.low, limited.high]).all()
        assert not limited.uncertain
    limited = estimate(ranking, "S")
    i = next(k for k, design in enumerate(ranking.designs) if not design.is_baseline)
    assert (limited.low, limited.high) == (ranking.inference.S_low[i], ranking.inference.S_high[i])
    # a design that never intervened has no peaks
    never = np.full((2, 200), int(EventStatus.NEVER_TRIGGERED))
    assert np.isnan(estimate(ranked(study(scenarios_of(200), never)), JERK).low)


@pytest.mark.slow
@pytest.mark.parametrize("times", [np.ones(300, dtype=int), np.repeat([1, 3], 150)], ids=["alike", "1 and 3"])
def test_intervals_hold_as_often_as_they_say(times: np.ndarray) -> None:
    """1,000 draws from a known population, each departure as often as its weight (standard error 0.7 %)."""
    generator, rows = np.random.default_rng(0), np.repeat(np.arange(times.size), times)
    scenarios, inside = scenarios_of(times.size).take(rows), np.zeros((2, 1000), dtype=np.bool_)
    jerk, kept = scipy.stats.gamma(2.0).ppf(0.95), 0.93
    for k in range(1000):
        values, within = generator.gamma(2.0, 1.0, times.size), generator.random(times.size) < kept
        results = study(scenarios, jerk_added_peak=values[rows], dtle=np.where(within[rows], 0.0, -1.0))
        ranking = ranked(results, "within_dtle >= 0.9")
        for row, (name, truth) in enumerate(((JERK, jerk), ("within_dtle", kept))):
            limited = estimate(ranking, name)
            inside[row, k] = limited.low <= truth <= limited.high
    assert (inside.mean(axis=1) >= 0.94).all()
    assert (inside.mean(axis=1) <= 0.985).all()


@pytest.mark.slow
def test_winners_that_break_a_limit_in_truth_are_not_certain() -> None:
    """A fine sweep about a limit, 500 + 500 departures, 100 times: S falls as the jerk rises, so the winner is near."""
    generator, scale = np.random.default_rng(0), np.linspace(0.9, 1.1, 41)
    designs = tuple(Design.of(LQR(r_delta=100.0 + k), 0.1) for k in range(41))
    broken, amber = np.zeros(100, dtype=np.bool_), np.zeros(100, dtype=np.bool_)

    def driven() -> StudyResults:
        jerk = 5.0 / scipy.stats.gamma(4.0).ppf(0.95) * generator.gamma(4.0, 1.0, 500)
        columns = {"jerk_added_peak": scale[:, None] * jerk * (1.0 + 0.02 * generator.normal(size=(41, 500)))}
        S = (2.0 - scale[:, None]) * generator.gamma(9.0, 0.1, 500)
        return results_of(S, designs, metrics=columns)

    for k in range(100):
        ranking = ranked(driven(), "comfort", fresh=driven())
        if ranking.winner is not None:
            broken[k] = scale[ranking.index[ranking.winner]] > 1.0
            amber[k] = any(one.uncertain for one in ranking.estimates(ranking.winner))
    assert broken.mean() > 0.1
    assert amber[broken].mean() > 0.9


# ------------------------------------------------------------------------------------------------ what is said of them


def light(ranking: Ranking, results: StudyResults, name: str = "Limits") -> Light:
    (one,) = [one for one in verdict(ranking, results).lights if one.name == name]
    return one


def jerks(p95: float, n: int = 400) -> np.ndarray:
    """Evenly spread, with this 95 % quantile."""
    return np.linspace(0.0, p95 / 0.95, n)


@pytest.mark.parametrize(("p95", "state"), [(4.0, "good"), (4.95, "warning"), (5.02, "bad"), (8.0, "bad")])
def test_the_light_is_amber_where_the_limit_lies_inside(p95: float, state: str) -> None:
    results = study(scenarios_of(400), jerk_added_peak=jerks(p95), a_y_added_peak=1.0)
    ranking = ranked(results, "comfort")
    limited = estimate(ranking, JERK)
    assert limited.value == pytest.approx(p95, rel=1e-6)
    assert limited.uncertain == (4.9 < p95 < 5.1)
    one = light(ranking, results)
    assert one.state == state
    if state == "warning":
        assert one.text == (
            "Met on the 400 study scenarios, but not with certainty: Peak added jerk, 95 % quantile 4.95 m/s³, limit "
            f"5.00 m/s³, 95 % interval {limited.low:.2f} to {limited.high:.2f} m/s³."
        )
        assert judged(ranking, 0) == "winner, meets all, not with certainty"
    elif state == "good":
        assert judged(ranking, 0) == "winner, meets all"


def test_limits_that_are_not_required_are_amber_too() -> None:
    results = study(scenarios_of(400), jerk_added_peak=jerks(4.95), a_y_added_peak=jerks(4.0))
    assert light(ranked(results), results).text.startswith(
        "Not required, but beyond comfort: Peak added a_y, 95 % quantile 4.00 m/s², limit 3.00 m/s² (1.3 times). "
        "Met on the 400 study scenarios, but not with certainty: Peak added jerk"
    )


def fresh_of(n: int = 300, **metrics: Any) -> StudyResults:
    return study(scenarios_of(n), **metrics)


def test_verdict_and_lights_are_of_the_fresh_scenarios() -> None:
    """Each number of the sentence from one sample, which it names; 0.5 of 9 is 94.4 % less, 1 of 9 88.9 %."""
    results = study(scenarios_of(400), jerk_added_peak=jerks(4.0), a_y_added_peak=1.0)
    alone = verdict(ranked(results, "comfort"), results).sentences[0]
    assert alone.startswith("Mean S 1.000 m s on the 400 study scenarios (95 % interval 0.9")
    assert "), 88.9 % less than without control; control adds 1.00 m/s² of lateral acceleration and 4.0" in alone
    fresh = fresh_of(S=0.5, jerk_added_peak=jerks(4.9, 300), a_y_added_peak=2.0)
    ranking = ranked(results, "comfort", fresh=fresh)
    judgement = verdict(ranking, results)
    assert judgement.sentences[0].startswith("Mean S 0.500 m s on 300 fresh scenarios (95 % interval 0.4")
    assert judgement.sentences[0].endswith(
        "), 94.4 % less than without control; control adds 2.00 m/s² of lateral acceleration and 4.90 m/s³ of jerk "
        "(95 % quantiles). In 100.0 % of departures it intervenes needlessly: the recorded path stays within 0.3 m "
        "beyond the line."
    )
    assert light(ranking, results, "Score").text == "94.4 % less S than without control."
    assert light(ranking, results).state == "warning"
    assert "Met on 300 fresh scenarios" in light(ranking, results).text
    lines = [line for line in more_lines(ranking) if line.startswith("Required")]
    assert lines == [
        "Required of the winner, on 300 fresh scenarios: Peak added a_y, 95 % quantile 2.00 m/s², limit 3.00 m/s², "
        "95 % interval 2.00 to 2.00 m/s²; Peak added jerk, 95 % quantile 4.90 m/s³, limit 5.00 m/s³, "
        f"95 % interval {estimate(ranking, JERK).low:.2f} to {estimate(ranking, JERK).high:.2f} m/s³."
    ]


def with_deep(results: StudyResults, count: int) -> StudyResults:
    """The same with that many recorded paths 0.5 m beyond the line, deeper than a needless intervention's."""
    depth = np.where(np.arange(results.scenarios.n) < count, 0.5, 0.3)
    return dataclasses.replace(results, scenarios=dataclasses.replace(results.scenarios, d_y=depth))


def test_needless_interventions_are_those_of_the_sample_that_the_sentence_names() -> None:
    """100 of 400 study scenarios are deep, 240 of 300 fresh ones; no control intervenes in none."""
    results = with_deep(study(scenarios_of(400)), 100)
    alone = verdict(ranked(results), results).sentences
    assert "In 75.0 % of departures it intervenes needlessly" in alone[0]
    ranking = ranked(results, fresh=with_deep(fresh_of(), 240))
    (sentence,) = verdict(ranking, results).sentences
    assert "on 300 fresh scenarios" in sentence
    assert sentence.endswith(
        " In 20.0 % of departures it intervenes needlessly: the recorded path stays within 0.3 m beyond the line."
    )
    assert sentence in verdict_lines(verdict(ranking, results))  # of terminal and ranking.md
    assert [ranking.needless(i) for i in range(2)] == pytest.approx([0.2, 0.0])


def test_what_is_missed_on_fresh_scenarios_is_red() -> None:
    results = study(scenarios_of(400), jerk_added_peak=jerks(4.0))
    ranking = ranked(results, "comfort", fresh=fresh_of(jerk_added_peak=jerks(7.0, 300)))
    assert ranking.winner is None
    assert ranking.fresh.unmet[0] == ("jerk_added_peak_p95 <= 5",)
    assert light(ranking, results) == Light("Limits", "bad",
        "Peak added jerk, 95 % quantile 7.00 m/s³, limit 5.00 m/s³ (1.4 times).")  # fmt: skip


def test_table_and_csv_have_the_intervals(tmp_path: Path) -> None:
    results = study(scenarios_of(400), jerk_added_peak=jerks(4.0), a_y_added_peak=1.0)
    fresh = fresh_of(jerk_added_peak=jerks(4.95, 300), a_y_added_peak=2.0)
    ranking = ranked(results, "comfort", fresh=fresh)
    one = estimate(ranking, JERK)
    report = report_input(dataclasses.replace(results, fresh=fresh), require=("comfort",))
    page, title = page_of(report), "Peak added jerk, 95 % quantile"
    assert next(row for row in page.captioned("Limits") if row[0] == title)[3] == "4.00 m/s³"
    rows = page.captioned("Winner on 300 fresh scenarios, each metric with an interval of its own")
    assert rows[0] == ["Metric", "Limit", "Value", "95 % interval"]
    assert [title, "≤ 5 m/s³", "4.95 m/s³", f"{one.low:.2f} to {one.high:.2f} m/s³"] in rows
    write_csv(ranking, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        first = next(csv.DictReader(stream))
    assert float(first["fresh_jerk_added_peak_p95_low_m_s3"]) == one.low
    assert float(first["jerk_added_peak_p95_high_m_s3"]) == ranking.limited[1, 2, 0]
    assert "jerk_added_peak_p95_low_m_s3" in ranking.to_polars().columns


# ------------------------------------------------------------------------------------------------ other plants


def on_plants(S: list[float], adds: list[bool], diverged: list[int] | None = None) -> Light:
    """The light of one design on its own plant and others: mean S, without control 9, and departures that diverged."""
    results = study(scenarios_of(100))
    ranking, count = ranked(results), len(S)
    names = ("own", "lag", "soft", "easy", "wet")[:count]
    plants = OtherPlants(
        (DESIGNS[1].id,), names, tuple(name.capitalize() for name in names), tuple(adds), np.array(S)[:, None],
        np.array(diverged or [0] * count)[:, None], np.array(S)[:, None] - 9.0,
    )  # fmt: skip
    (light,) = [light for light in verdict(ranking, results, robustness=plants).lights if light.name == "Other plants"]
    return light


def test_the_light_of_other_plants_names_the_worst_that_adds_a_difficulty() -> None:
    harder = [False, True, True, False, True]
    light = on_plants([1.0, 1.2, 1.4, 3.0, 1.3], harder)
    assert (light.state, "plant: soft" in light.text, "40 % more S" in light.text) == ("good", True, True)
    light = on_plants([1.0, 1.2, 1.4, 3.0, 2.5], harder)
    assert (light.state, "plant: wet" in light.text, "2.5 times its S" in light.text) == ("warning", True, True)
    assert on_plants([1.0, 0.9, float("nan"), 3.0, 0.8], harder).text == "S rises on none of them."
    # what takes a difficulty away is not what it is about
    assert on_plants([1.0, 1.2, 1.4, 9.5, 1.1], harder, [0, 0, 0, 7, 0]).state == "good"
    assert on_plants([1.0, 1.2, 9.5, 1.0, 1.1], harder).text == "Worse than no control with: Soft."
    assert on_plants([1.0, 1.2, 1.4, 1.0, 1.1], harder, [1, 1, 2, 1, 3]).text == "It diverges with: Soft, Wet."


@pytest.mark.parametrize(("failing", "warned"), [(1, False), (2, True), (10, True)])
def test_a_tenth_of_the_interventions_with_a_failed_solve_is_warned_of(failing: int, warned: bool) -> None:
    designs = (DESIGNS[0], Design.of(LinearMPC(), 0.1))
    status = np.zeros((2, 30), dtype=int)
    status[1, 20:] = int(EventStatus.NEVER_TRIGGERED)
    failed_solves = np.zeros((2, 30), dtype=np.int32)
    failed_solves[1, :failing] = 3
    parts = {"failed_solves": failed_solves}
    ranking = ranked(results_of(np.ones((2, 30)), designs, status=status, parts=parts))
    text = f"Commands that were not finite, or came from a law's fallback: {designs[1].label} in {failing} of 20 interv"
    assert any(one.startswith(text) for one in ranking.warnings) == warned
