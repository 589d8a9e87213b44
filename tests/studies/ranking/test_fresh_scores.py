"""Finalists on fresh scenarios: scores and differences by another route, the winner, and none of both."""

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from helpers.bits import assert_same_bits
from helpers.results import results_of as given_results
from ldctoolkit.studies import Design, Ranking, StudyResults
from ldctoolkit.studies.ranking.finalists import choose_winner, lost
from ldctoolkit.studies.ranking.inference import Resampled
from ldctoolkit.studies.ranking.ranking import write_csv
from ldctoolkit.studies.results import FailedDesign

pytestmark = pytest.mark.usefixtures("laws")

LEFT = 150


def design(i: int) -> Design:
    return Design.from_gains("none" if i == 3 else "toy", 0.1 * (i + 1), {})


def results_of(S: np.ndarray, designs: tuple[int, ...]) -> StudyResults:
    return given_results(S, [design(i) for i in designs], left=LEFT, uncorrected=S + 1.0)


@pytest.fixture
def scores() -> np.ndarray:
    """Four designs: 1 and 2 are not separated, 3 is the one without control."""
    generator = np.random.default_rng(5)
    common = generator.gamma(2.0, 1.0, 400)
    return np.stack([common + shift + 0.1 * generator.normal(size=400) for shift in (0.5, 0.0, 0.004, 2.0)])


@pytest.fixture
def again() -> np.ndarray:
    """The same designs on other scenarios."""
    generator = np.random.default_rng(6)
    common = generator.gamma(2.0, 1.0, 400)
    return np.stack([common + shift + 0.1 * generator.normal(size=400) for shift in (0.5, 0.006, 0.0, 2.0)])


def rank(scores: np.ndarray, again: np.ndarray, finalists: tuple[int, ...] = (1, 2, 0, 3), **more: object) -> Ranking:
    results = results_of(scores, (0, 1, 2, 3))
    fresh = results_of(again[list(finalists)], finalists)
    results = dataclasses.replace(results, fresh=fresh)
    return Ranking.of(results, **more)  # type: ignore[arg-type]


def t_width(values: np.ndarray) -> float:
    """Half of Student's interval of a stratified mean."""
    parts = (values[:LEFT], values[LEFT:])
    error = np.sqrt(sum(part.size * part.var(ddof=1) for part in parts)) / values.size
    return float(scipy.stats.t.isf(0.025, values.size - 2) * error)


def test_the_first_stays_winner_where_fresh_scenarios_part_it_from_none(scores: np.ndarray, again: np.ndarray) -> None:
    """Taking the smallest fresh score would choose by luck once more."""
    ranking = rank(scores, again)
    assert ranking.index.tolist() == [1, 2, 0, 3]
    assert ranking.fresh.S[1] < ranking.fresh.S[0]
    assert ranking.fresh.difference_high[1] > 0
    assert (ranking.fresh.best, ranking.winner) == (1, 0)
    # the search's own figures are as without fresh ones
    results = results_of(scores, (0, 1, 2, 3))
    alone = Ranking.of(results)
    assert_same_bits(ranking.metrics, alone.metrics)
    assert_same_bits(ranking.inference, alone.inference)
    assert (alone.winner, alone.fresh.best, alone.fresh.scenarios) == (0, None, 0)


def test_a_finalist_that_fresh_scenarios_part_from_the_first_wins(scores: np.ndarray, again: np.ndarray) -> None:
    again[2] -= 0.1
    ranking = rank(scores, again)
    assert ranking.fresh.difference_high[1] < 0
    assert ranking.winner == 1
    # but none that the search had already told apart from its best
    again[0] -= 2.0
    ranking = rank(scores, again)
    assert (ranking.winner, ranking.fresh.best) == (1, 2)


def test_fresh_differences_are_paired_and_simultaneous(scores: np.ndarray, again: np.ndarray) -> None:
    """Means by hand; half widths between Student's alone and Bonferroni's for the number of differences."""
    ranking = rank(scores, again)
    for name, reference, among in (("difference", 1, (2, 0)), ("baseline_difference", 3, (1, 2, 0))):
        value, low, high = (getattr(ranking.fresh, name + end) for end in ("", "_low", "_high"))
        for i in among:
            place = ranking.index.tolist().index(i)
            assert value[place] == pytest.approx((again[i] - again[reference]).mean(), rel=1e-12)
            alone = t_width(again[i] - again[reference])
            bonferroni = alone * scipy.stats.norm.isf(0.025 / len(among)) / 1.96
            # 2,000 resamples know a 95 % quantile to some per cent
            assert 0.95 * alone < 0.5 * (high[place] - low[place]) < 1.05 * bonferroni
    np.testing.assert_allclose(ranking.fresh.S, again.mean(axis=1)[[1, 2, 0, 3]], rtol=1e-12)
    np.testing.assert_allclose(ranking.fresh.reduction, 1 - ranking.fresh.S / again[3].mean(), rtol=1e-12)
    assert ranking.fresh.difference[0] == ranking.fresh.difference_low[0] == 0.0


def test_the_baseline_is_a_finalist_only_in_the_set_of_best(scores: np.ndarray, again: np.ndarray) -> None:
    again[3] -= 9.0
    ranking = rank(scores, again, (1, 2, 3))
    assert (ranking.fresh.best, ranking.winner) == (1, 0)
    assert np.isnan(ranking.fresh.difference[2:]).all()
    assert np.isnan(ranking.fresh.optimism[2:]).all()
    assert ranking.fresh.S[3] == pytest.approx(again[3].mean())
    assert rank(scores, again, (1, 2, 3), baseline=design(2).id).fresh.best == 3


def test_optimism_is_that_of_two_independent_samples(scores: np.ndarray, again: np.ndarray) -> None:
    """One finalist: Student's interval with the standard errors of both samples."""
    ranking = rank(scores, again, (1,))
    assert not ranking.fresh.optimism_paired
    assert ranking.fresh.optimism[0] == pytest.approx(again[1].mean() - scores[1].mean(), rel=1e-9)
    width = np.hypot(t_width(scores[1]), t_width(again[1]))
    # 2,000 resamples know a 95 % quantile to some per cent
    assert 0.5 * (ranking.fresh.optimism_high[0] - ranking.fresh.optimism_low[0]) == pytest.approx(width, rel=0.06)
    assert ranking.fresh.optimism_low[0] < 0 < ranking.fresh.optimism_high[0]


def test_optimism_against_a_baseline_leaves_the_draw_of_scenarios_out(scores: np.ndarray, again: np.ndarray) -> None:
    again += 1.0  # all designs meet harder scenarios: nobody was optimistic
    plain, paired = rank(scores, again).fresh, rank(scores, again, baseline=design(0).id).fresh
    assert plain.optimism_low[0] > 0
    assert paired.optimism_paired
    wanted = (again[1] - again[0]).mean() - (scores[1] - scores[0]).mean()
    assert paired.optimism[0] == pytest.approx(wanted, rel=1e-9)
    assert abs(paired.optimism[0]) < 0.03 < 0.5 < plain.optimism[0]
    assert paired.optimism_high[0] - paired.optimism_low[0] < 0.2 * (plain.optimism_high[0] - plain.optimism_low[0])
    assert np.isnan(paired.optimism[2])


@pytest.mark.slow
def test_what_is_lost_covers_what_two_draws_do() -> None:
    """Equal truths: 0 is in all ten intervals in 95 % of 200 repetitions, seen with a standard error of 1.5 %."""
    inside = 0
    for repetition in range(200):
        generator = np.random.default_rng(repetition)
        draws = [generator.gamma(2.0, 1.0, 200) + 0.5 * generator.gamma(2.0, 1.0, (10, 200)) for _ in range(2)]
        side = np.repeat([1, -1], 100)
        one, two = (Resampled.of(S, side, seed=repetition, samples=200, stream=k) for k, S in enumerate(draws))
        interval = lost(one, two, 0.95)
        inside += bool(((interval.low < 0) & (interval.high > 0)).all())
    assert 0.90 <= inside / 200 <= 0.99


def test_the_winner_meets_requirements_on_fresh_ones_too(scores: np.ndarray, again: np.ndarray, tmp_path: Path) -> None:
    again[1] += 0.4
    again[2] += 0.2
    limit = float(again[2].mean()) + 0.1
    ranking = rank(scores, again, (1, 2), require=(f"S <= {limit!r}",))
    text = f"S <= {limit!r}"
    assert (ranking.fresh.unmet[:2], ranking.winner) == (((text,), ()), 1)
    assert ranking.warnings[0] == f"Design # 1 misses {text} on the fresh scenarios and is not the winner."
    write_csv(ranking, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["fresh_unmet"] for row in rows[:2]] == [text, ""]
    assert [row["winner"] for row in rows[:2]] == ["false", "true"]
    assert float(rows[1]["fresh_difference_to_first_m_s"]) == ranking.fresh.difference[1]
    assert float(rows[0]["optimism_high_m_s"]) == ranking.fresh.optimism_high[0]
    assert [row["optimism_of"] for row in rows] == ["S", "S", "", ""]


def test_where_no_finalist_meets_the_requirements_there_is_no_winner(scores: np.ndarray, again: np.ndarray) -> None:
    limit = float(scores[1].mean()) + 0.2
    ranking = rank(scores, again + 1.0, (1, 2), require=(f"S <= {limit!r}",))
    assert ranking.winner is None
    assert (
        f"No finalist meets the requirements on the fresh scenarios (each misses S <= {limit!r})" in ranking.warnings[0]
    )


def test_a_finalist_outside_the_set_wins_where_nobody_in_it_meets_the_requirements() -> None:
    S = np.random.default_rng(0).gamma(2.0, 1.0, (3, 100))
    resampled = Resampled.of(S, np.repeat([1, -1], 50), seed=1, samples=100)
    in_set = np.array([True, False, False])
    assert choose_winner(resampled, in_set, np.array([False, True, True]), 0.95) == 1
    assert choose_winner(resampled, in_set, np.array([True, True, True]), 0.95) == 0
    assert choose_winner(resampled, in_set, np.zeros(3, dtype=np.bool_), 0.95) is None


@pytest.mark.parametrize(("by", "winner"), [(5e-7, 0), (1.5e-6, 1)])
def test_a_solvers_tolerance_makes_no_winner(by: float, winner: int) -> None:
    """The same amount in every fresh scenario, which the scores part without a doubt."""
    S = np.random.default_rng(0).gamma(2.0, 1.0, 100)
    resampled = Resampled.of(np.stack([S, S - by]), np.repeat([1, -1], 50), seed=1, samples=100)
    both = np.ones(2, dtype=np.bool_)
    assert choose_winner(resampled, both, both, 0.95) == winner


def test_a_first_that_was_no_finalist_stays_winner_without_a_fresh_score(scores: np.ndarray, again: np.ndarray) -> None:
    ranking = rank(scores, again, (2, 0))
    assert ranking.winner == 0
    assert np.isnan(ranking.fresh.S[0])
    assert np.isnan(ranking.fresh.difference).all()


def test_where_the_first_fails_on_fresh_scenarios_the_next_one_wins(scores: np.ndarray, again: np.ndarray) -> None:
    fresh = dataclasses.replace(results_of(again[[2, 0]], (2, 0)), failed=(FailedDesign(design(1), "boom"),))
    results = dataclasses.replace(results_of(scores, (0, 1, 2, 3)), fresh=fresh)
    ranking = Ranking.of(results)
    assert (ranking.winner, ranking.fresh.difference[1]) == (1, 0.0)
