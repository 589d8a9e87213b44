"""Ranking: means, paired differences, intervals against independent routes, ties, warnings, the CSV."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.errors import InputError, StoreError
from studies import Case, CaseResults, Design, Ranking, StudyResults
from studies.bootstrap import bootstrap_means, percentile_interval
from studies.ranking import write_csv


def results_of(S: np.ndarray, *, left: int, window: str = "departure", y_s: float | None = None) -> StudyResults:
    d, n = S.shape
    side = np.where(np.arange(n) < left, 1, -1)
    case = CaseResults(
        case=Case(window, "consistent"),  # type: ignore[arg-type]
        S=S,
        S_uncorrected=np.broadcast_to(S.max(axis=0) + 1.0, S.shape),
        status=np.zeros((d, n), dtype=np.int8),
        deepest=np.tile(np.linspace(0.0, 1.0, n), (d, 1)),
        failed_solves=np.zeros((d, n), dtype=np.int64),
    )
    designs = tuple(Design.from_gains("none", 0.1 * (i + 1) if y_s is None else y_s, {}) for i in range(d))
    return StudyResults(designs, Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=20.0, side=side), (case,))


def rank(results: StudyResults, **settings: float) -> Ranking:
    return Ranking.of(results, results.cases[0], **settings)  # type: ignore[arg-type]


@pytest.fixture
def scores() -> np.ndarray:
    generator = np.random.default_rng(5)
    common = generator.gamma(2.0, 1.0, 400)
    return np.stack([common + shift + 0.1 * generator.normal(size=400) for shift in (0.5, 0.0, 0.004, 2.0)])


def test_order_means_and_reductions(scores: np.ndarray) -> None:
    ranking = rank(results_of(scores, left=150))
    assert ranking.index.tolist() == np.argsort(scores.mean(axis=1)).tolist()
    assert ranking.rank.tolist() == [1, 2, 3, 4]
    sorted_scores = scores[ranking.index]
    np.testing.assert_array_equal(ranking.S, sorted_scores.mean(axis=1))
    np.testing.assert_array_equal(ranking.S_left, sorted_scores[:, :150].mean(axis=1))
    np.testing.assert_array_equal(ranking.S_right, sorted_scores[:, 150:].mean(axis=1))
    before = scores.max(axis=0) + 1.0
    np.testing.assert_allclose(ranking.reduction, 1 - sorted_scores.sum(axis=1) / before.sum(), rtol=1e-12)
    np.testing.assert_allclose(
        ranking.reduction_right, 1 - sorted_scores[:, 150:].sum(axis=1) / before[150:].sum(), rtol=1e-12
    )
    np.testing.assert_allclose(ranking.difference, (sorted_scores - sorted_scores[0]).mean(axis=1), rtol=1e-12)
    assert ranking.deeper.tolist() == [0.5] * 4


def test_intervals_agree_with_scipy_and_with_the_normal_ones(scores: np.ndarray) -> None:
    """One stratum: scipy's percentile bootstrap. Two strata: the analytic standard error of a stratified mean."""
    B = 20_000
    ranking = rank(results_of(scores, left=400), bootstrap=B)
    for i in (0, 1, 3):
        other = scipy.stats.bootstrap(
            (scores[ranking.index[i]],), np.mean, n_resamples=B, method="percentile", rng=np.random.default_rng(1)
        ).confidence_interval
        # two bootstraps of B resamples differ by their own noise, about 1.5 % of the half width at B = 20,000
        half = 0.5 * (other.high - other.low)
        assert abs(ranking.S_low[i] - other.low) < 0.06 * half
        assert abs(ranking.S_high[i] - other.high) < 0.06 * half
        paired = scores[ranking.index[i]] - scores[ranking.index[0]]
        if i:
            low, high = scipy.stats.norm.interval(0.95, paired.mean(), paired.std() / np.sqrt(paired.size))
            width = high - low
            assert abs(ranking.difference_low[i] - low) < 0.05 * width
            assert abs(ranking.difference_high[i] - high) < 0.05 * width

    two = rank(results_of(scores, left=150), bootstrap=B)
    S = scores[two.index[0]]
    error = np.sqrt(150 * S[:150].var() + 250 * S[150:].var()) / 400
    low, high = scipy.stats.norm.interval(0.95, S.mean(), error)
    assert abs(two.S_low[0] - low) < 0.05 * (high - low)
    assert abs(two.S_high[0] - high) < 0.05 * (high - low)


def test_pairing_separates_designs_whose_own_intervals_overlap(scores: np.ndarray) -> None:
    ranking = rank(results_of(scores, left=200))
    # designs 1 and 2 differ by less than their noise; design 0 is worse by 0.5 in every scenario
    assert ranking.tied_with_best.tolist() == [True, True, False, False]
    assert ranking.S_low[2] < ranking.S_high[0] + 0.5
    assert ranking.difference_low[2] > 0.4


def test_weights_are_stratified_and_the_same_for_every_design() -> None:
    side = np.array([1, 1, 1, -1, -1])
    indicator = np.stack([(side == 1).astype(float), np.arange(5.0), np.arange(5.0) + 3.0])
    means = bootstrap_means(indicator, side, samples=500, seed=1)
    np.testing.assert_allclose(means[:, 0], 3 / 5, rtol=1e-12)  # every resample has three left ones
    np.testing.assert_allclose(means[:, 2] - means[:, 1], 3.0, rtol=1e-12)
    assert means[:, 1].std() > 0


def test_weights_depend_on_the_seed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    values, side = np.random.default_rng(0).normal(size=(3, 50)), np.repeat([1, -1], 25)
    one = bootstrap_means(values, side, samples=200, seed=1)
    np.testing.assert_array_equal(one, bootstrap_means(values, side, samples=200, seed=1))
    assert not np.array_equal(one, bootstrap_means(values, side, samples=200, seed=2))
    # blocks change the order of random draws between strata, so the block is part of the definition; its memory is not
    few = bootstrap_means(values[:1], side, samples=200, seed=1)
    np.testing.assert_allclose(few[:, 0], one[:, 0], rtol=1e-12)


def test_equal_scores_share_a_rank_and_keep_the_study_order() -> None:
    S = np.random.default_rng(2).gamma(2.0, 1.0, 60)
    ranking = rank(results_of(np.stack([S + 1.0, S, S, S]), left=30))
    assert ranking.index.tolist() == [1, 2, 3, 0]
    assert ranking.rank.tolist() == [1, 1, 1, 4]
    assert ranking.tied_with_best.tolist() == [True, True, True, False]
    assert ranking.difference[:3].tolist() == [0.0, 0.0, 0.0]


def test_one_side_only_has_no_figure_for_the_other() -> None:
    ranking = rank(results_of(np.ones((2, 10)), left=10))
    assert np.isnan(ranking.S_right).all()
    assert np.isnan(ranking.reduction_right).all()
    assert (ranking.S_left == 1.0).all()


def test_nothing_to_reduce_is_a_reduction_of_zero() -> None:
    results = results_of(np.zeros((1, 4)), left=2)
    case = results.cases[0]
    still = CaseResults(case.case, case.S, np.zeros((1, 4)), case.status, case.deepest, case.failed_solves)
    assert Ranking.of(results, still).reduction.tolist() == [0.0]


def test_failures_count_in_means_and_are_told() -> None:
    results = results_of(np.array([[1.0, 40.0], [2.0, 2.0]]), left=1)
    case = results.cases[0]
    case.status[0, 1] = EventStatus.DIVERGED
    case.status[1] = (EventStatus.SOLVER_FAILED, EventStatus.NEVER_TRIGGERED)
    case.failed_solves[1, 0] = 7
    ranking = rank(results)
    assert ranking.S.tolist() == [2.0, 20.5]
    assert ranking.diverged.tolist() == [0, 1]
    assert ranking.solver_failed.tolist() == [1, 0]
    assert ranking.failed_solves.tolist() == [7, 0]
    assert ranking.triggered.tolist() == [0.5, 1.0]


def test_scores_that_are_not_finite_are_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        rank(results_of(np.array([[1.0, np.nan]]), left=1))


def test_the_control_window_warns_where_y_s_varies(scores: np.ndarray) -> None:
    assert "not comparable" in rank(results_of(scores, left=9, window="control")).warnings[0]
    assert not rank(results_of(scores, left=9, window="control", y_s=0.2)).warnings
    assert not rank(results_of(scores, left=9)).warnings


@pytest.mark.parametrize("confidence", [0.0, 1.0, -1.0, float("nan")])
def test_a_confidence_outside_its_range_is_refused(confidence: float) -> None:
    with pytest.raises(InputError, match="confidence"):
        percentile_interval(np.zeros((3, 1)), confidence)


def test_the_csv_names_units_and_keeps_every_digit(tmp_path: Path, scores: np.ndarray) -> None:
    results = results_of(scores[:2], left=9)
    lqr = Design.from_gains("lqr", 0.1, {"r_delta": 1 / 3})
    results = StudyResults((results.designs[0], lqr), results.scenarios, results.cases)
    ranking = rank(results)
    write_csv([ranking, ranking], tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 4
    assert [row["rank"] for row in rows] == ["1", "2", "1", "2"]
    assert [float(row["S_m_s"]) for row in rows[:2]] == ranking.S.tolist()
    by_law = {row["law"]: row for row in rows}
    assert float(by_law["lqr"]["gain_r_delta_1_per_rad2"]) == 1 / 3
    assert by_law["none"]["gain_r_delta_1_per_rad2"] == ""
    assert {"window", "convention", "y_s_m", "S_left_m_s", "tied_with_best"} <= set(rows[0])
    assert list(tmp_path.iterdir()) == [tmp_path / "r.csv"]


def test_a_csv_that_cannot_be_written_is_named(tmp_path: Path, scores: np.ndarray) -> None:
    with pytest.raises(StoreError, match=r"nowhere/r\.csv: cannot be written"):
        rank(results_of(scores, left=9)).to_csv(tmp_path / "nowhere" / "r.csv")


def test_differences_below_a_solvers_tolerance_are_ties(scores: np.ndarray) -> None:
    """5e-9 m s at every scenario is nobody's design; 5e-6 is."""
    ranking = rank(results_of(np.stack([scores[0], scores[0] + 5e-9, scores[0] + 5e-6]), left=150))
    assert ranking.tied_with_best.tolist() == [True, True, False]
