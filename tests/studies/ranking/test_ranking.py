"""Ranking: means, paired differences, intervals against independent routes, ties, warnings, the CSV."""

import csv
import dataclasses
import math
import statistics
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from helpers.bits import assert_same_bits
from helpers.results import results_of as given_results
from ldctoolkit import EventStatus, Scenarios, Setup, simulate
from ldctoolkit.controllers import NoControl
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.metrics import RELEASE_METRICS, MetricValues
from ldctoolkit.plant_options import Driver, PlantOptions
from ldctoolkit.studies import Design, Ranking, StudyResults
from ldctoolkit.studies.ranking.inference import bootstrap_means, check_confidence
from ldctoolkit.studies.ranking.ranking import write_csv


def results_of(
    S: np.ndarray, *, left: int, window: Any = "departure", y_s: float | None = None, law: str = "none"
) -> StudyResults:
    """Every metric its own positive numbers of a plausible size."""
    generator = np.random.default_rng(7)
    metrics = {f.name: generator.gamma(2.0, 1.0, S.shape) for f in dataclasses.fields(MetricValues)}
    metrics["deepest"] = np.tile(np.linspace(0.0, 1.0, S.shape[1]), (len(S), 1))
    metrics["dtle"] = 0.3 - metrics["dtle"]
    metrics["opposite_crossing"] = np.maximum(0.0, metrics["opposite_crossing"] - 2.0)
    designs = [Design.from_gains(law, 0.1 * (i + 1) if y_s is None else y_s, {}) for i in range(len(S))]
    return given_results(S, designs, left=left, window=window, uncorrected=S.max(axis=0) + 1.0, metrics=metrics)


pytestmark = pytest.mark.usefixtures("laws")


HANDS = Setup(options=PlantOptions(driver=Driver(straight=1.0)))


def rank(results: StudyResults, **settings: object) -> Ranking:
    return Ranking.of(results, **settings)  # type: ignore[arg-type]


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
    np.testing.assert_array_equal(ranking.metrics.S, sorted_scores.mean(axis=1))
    np.testing.assert_array_equal(ranking.metrics.S_left, sorted_scores[:, :150].mean(axis=1))
    np.testing.assert_array_equal(ranking.metrics.S_right, sorted_scores[:, 150:].mean(axis=1))
    before = scores.max(axis=0) + 1.0
    np.testing.assert_allclose(ranking.metrics.reduction, 1 - sorted_scores.sum(axis=1) / before.sum(), rtol=1e-12)
    np.testing.assert_allclose(
        ranking.metrics.reduction_right, 1 - sorted_scores[:, 150:].sum(axis=1) / before[150:].sum(), rtol=1e-12
    )
    np.testing.assert_allclose(
        ranking.inference.difference, (sorted_scores - sorted_scores[0]).mean(axis=1), rtol=1e-12
    )
    assert ranking.metrics.deeper.tolist() == [0.5] * 4


def t_interval(values: np.ndarray, left: int) -> tuple[float, float]:
    """Student's interval of a stratified mean, one design by itself."""
    parts = [part for part in (values[:left], values[left:]) if part.size]
    error = math.sqrt(sum(part.size * part.var(ddof=1) for part in parts)) / values.size
    return scipy.stats.t.interval(0.95, values.size - len(parts), values.mean(), error)


def test_for_one_comparison_the_intervals_are_students(scores: np.ndarray) -> None:
    """One mean, or one difference: nothing to correct for. 5,000 resamples know a 95 % quantile to about 3 %."""
    left = 150
    one = rank(results_of(scores[:1], left=left), bootstrap=5_000).inference
    low, high = t_interval(scores[0], left)
    assert abs(one.S_low[0] - low) < 0.03 * (high - low)
    assert abs(one.S_high[0] - high) < 0.03 * (high - low)
    two = rank(results_of(scores[:2], left=left), bootstrap=5_000).inference
    low, high = t_interval(scores[0] - scores[1], left)
    assert abs(two.difference_low[1] - low) < 0.03 * (high - low)
    assert abs(two.difference_high[1] - high) < 0.03 * (high - low)


def test_weights_are_stratified_and_the_same_for_every_design() -> None:
    side = np.array([1, 1, 1, -1, -1])
    indicator = np.stack([(side == 1).astype(float), np.arange(5.0), np.arange(5.0) + 3.0])
    means = bootstrap_means(indicator, side, samples=500, seed=1)
    np.testing.assert_allclose(means[:, 0], 3 / 5, rtol=1e-12)  # every resample has three left ones
    np.testing.assert_allclose(means[:, 2] - means[:, 1], 3.0, rtol=1e-12)
    assert means[:, 1].std() > 0


def test_weights_depend_on_the_seed_only() -> None:
    values, side = np.random.default_rng(0).normal(size=(3, 50)), np.repeat([1, -1], 25)
    one = bootstrap_means(values, side, samples=200, seed=1)
    np.testing.assert_array_equal(one, bootstrap_means(values, side, samples=200, seed=1))
    assert not np.array_equal(one, bootstrap_means(values, side, samples=200, seed=2))
    assert not np.array_equal(one, bootstrap_means(values, side, samples=200, seed=1, stream=1))


def test_equal_scores_share_a_rank_and_keep_the_study_order() -> None:
    S = np.random.default_rng(2).gamma(2.0, 1.0, 60)
    ranking = rank(results_of(np.stack([S + 1.0, S, S, S]), left=30))
    assert (ranking.index.tolist(), ranking.rank.tolist()) == ([1, 2, 3, 0], [1, 1, 1, 4])
    assert ranking.inference.set_of_best.tolist() == [True, True, True, False]
    assert ranking.inference.difference[:3].tolist() == [0.0, 0.0, 0.0]


def test_one_side_only_has_no_figure_for_the_other() -> None:
    ranking = rank(results_of(np.ones((2, 10)), left=10))
    assert np.isnan(ranking.metrics.S_right).all()
    assert np.isnan(ranking.metrics.reduction_right).all()
    assert (ranking.metrics.S_left == 1.0).all()


def test_failures_count_in_means_and_are_told() -> None:
    results = results_of(np.array([[1.0, 40.0], [2.0, 2.0]]), left=1)
    status = np.array(
        [[EventStatus.OK, EventStatus.DIVERGED], [EventStatus.SOLVER_FAILED, EventStatus.NEVER_TRIGGERED]]
    )
    ranking = rank(dataclasses.replace(results, status=status, failed_solves=np.array([[0, 0], [7, 0]])))
    # S without control is 3 and 41: what failed counts as that, the rest as it is
    assert (ranking.metrics.S.tolist(), ranking.metrics.S_left.tolist()) == ([2.5, 21.0], [3.0, 1.0])
    assert (ranking.metrics.diverged.tolist(), ranking.metrics.solver_failed.tolist()) == ([0, 1], [1, 0])
    assert (ranking.metrics.failed_solves.tolist(), ranking.metrics.triggered.tolist()) == ([7, 0], [0.5, 1.0])


def test_scores_that_are_not_finite_are_refused() -> None:
    with pytest.raises(InputError, match="not finite"):
        rank(results_of(np.array([[1.0, np.nan]]), left=1))


def quantile(values: list[float], share: float) -> float:
    """The linear rule by hand: position share (n - 1) between the sorted values."""
    ordered = sorted(values)
    place = share * (len(ordered) - 1)
    low = math.floor(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


def by_hand(results: StudyResults, i: int) -> dict[str, float]:
    """The columns beside S of one design, one scenario after the other."""
    d_y = results.scenarios.d_y
    values = {f.name: [float(x) for x in getattr(results.metrics, f.name)[i]] for f in dataclasses.fields(MetricValues)}
    n = len(d_y)
    recorded = simulate(NoControl(), results.scenarios).metrics.dtle
    acted = [k for k in range(n) if results.status[i, k] not in (EventStatus.NEVER_TRIGGERED, EventStatus.INVALID)]

    def of(name: str) -> list[float]:
        return [values[name][k] for k in acted]

    wanted = {
        "deepest_mean_m": sum(values["deepest"]) / n,
        "deepest_p95_m": quantile(values["deepest"], 0.95),
        "dtle_mean_m": sum(values["dtle"]) / n,
        "dtle_p5_m": quantile(values["dtle"], 0.05),
        "dtle_min_m": min(values["dtle"]),
        "tail_0p8_share": sum(x > 0.8 for x in values["deepest"]) / n,
        "within_dtle_share": sum(x >= -0.3 for x in values["dtle"]) / n,
        "within_dtle_gain": sum(x >= -0.3 for x in values["dtle"]) / n - (recorded >= -0.3).sum() / n,
        "lost": 0.0,
        "needless_share": sum(d_y[k] <= 0.3 for k in acted) / n,
        "opposite_crossed_share": sum(x > 0 for x in of("opposite_crossing")) / len(acted),
        "opposite_crossing_max_m": max(of("opposite_crossing")),
        "back_inside_share": sum(x < math.inf for x in of("t_back")) / len(acted),
        "t_back_median_s": statistics.median(of("t_back")),
        "comfortable_share": sum(
            a <= 3 and j <= 5 for a, j in zip(of("a_y_added_peak"), of("jerk_added_peak"), strict=True)
        )
        / len(acted),
        "delta_peak_max_rad": max(of("delta_peak")),
        "delta_rate_peak_max_rad_s": max(of("delta_rate_peak")),
        "effort_mean_rad2_s": sum(of("effort")) / len(acted),
        "travel_mean_rad": sum(of("travel")) / len(acted),
        "driver_torque_peak_mean_N_m": sum(of("driver_torque_peak")) / len(acted),
        "driver_torque_peak_p95_N_m": quantile(of("driver_torque_peak"), 0.95),
        "driver_torque_peak_max_N_m": max(of("driver_torque_peak")),
        "driver_torque_mean_mean_N_m": sum(of("driver_torque_mean")) / len(acted),
        "against_time_mean_s": sum(of("against_time")) / len(acted),
        "against_time_p95_s": quantile(of("against_time"), 0.95),
        "against_parallel_p95_s": quantile(of("against_parallel"), 0.95),
        "against_parallel_max_s": max(of("against_parallel")),
        "overridden_mean": sum(of("overridden")) / len(acted),
        "handover_step_p95_N_m": quantile(of("handover_step"), 0.95),
        "handover_step_max_N_m": max(of("handover_step")),
    }
    for name in ("a_y_peak", "jerk_peak", "a_y_added_peak", "jerk_added_peak"):
        unit = "m_s3" if "jerk" in name else "m_s2"
        wanted[f"{name}_mean_{unit}"] = sum(of(name)) / len(acted)
        wanted[f"{name}_p95_{unit}"] = quantile(of(name), 0.95)
        wanted[f"{name}_max_{unit}"] = max(of(name))
    return wanted


def test_the_columns_beside_S_are_those_counted_by_hand(scores: np.ndarray, tmp_path: Path) -> None:
    results = results_of(scores, left=150, law="toy")
    generator = np.random.default_rng(11)
    d_y = generator.gamma(2.0, 0.2, 400)
    scenarios = Scenarios.from_arrays(T=2.0, d_y=d_y, v_mean=20.0, side=results.scenarios.side)
    status = generator.choice([EventStatus.OK, EventStatus.NEVER_TRIGGERED], size=results.status.shape)
    t_back = np.where(generator.random(results.status.shape) < 0.2, np.inf, results.metrics.t_back)
    t_back[3] = np.inf  # not back after most: the median is infinite too
    metrics = dataclasses.replace(results.metrics, t_back=t_back)
    results = dataclasses.replace(results, scenarios=scenarios, metrics=metrics, status=status, setup=HANDS)
    ranking = rank(results)
    write_csv(ranking, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row, i in zip(rows, ranking.index, strict=True):
        wanted = by_hand(results, int(i))
        loop = {"gain_margin", "phase_margin_rad", "S_worst_m_s", "comfortable_worst_share"}
        assert set(wanted) == {one.column for one in RELEASE_METRICS.values()} - loop
        for name, value in wanted.items():
            if math.isnan(value):
                assert row[name] == "", name
            else:
                # sums in another order: a few roundings of 400 numbers
                assert float(row[name]) == pytest.approx(value, rel=1e-12), name
    assert rows[-1]["t_back_median_s"] == "inf"


def test_who_never_acts_has_no_figures_of_interventions(scores: np.ndarray) -> None:
    """The baseline, and a design that never took over: nothing, not zero, and not a mean over nobody."""
    baseline = rank(results_of(scores[:1], left=150)).metrics.beside
    results = results_of(scores[:1], left=150, law="toy")
    results = dataclasses.replace(results, status=np.full_like(results.status, EventStatus.NEVER_TRIGGERED))
    for figures in (baseline, rank(results).metrics.beside):
        empty = {name for name, values in figures.items() if np.isnan(values).all()}
        assert empty == {
            "opposite_crossed_share", "opposite_crossing_max", "back_inside", "t_back_median", "comfortable",
            "delta_peak_max", "delta_rate_peak_max", "effort_mean", "travel_mean", "gain_margin", "phase_margin",
            "S_worst", "comfortable_worst",
            *(f"{name}_{word}" for name in ("a_y_peak", "jerk_peak", "a_y_added_peak", "jerk_added_peak")
              for word in ("mean", "p95", "max")),
        }  # fmt: skip


def test_scenarios_that_cannot_be_driven_are_left_out_for_all_and_told(scores: np.ndarray) -> None:
    """As if they had not been drawn: every figure of every design, and the pairing, on those that remain."""
    results = results_of(scores, left=150, law="toy")
    status, S = results.status.copy(), results.S.copy()
    status[1, [3, 200]] = status[2, 399] = EventStatus.INVALID
    for array in (S, *(getattr(results.metrics, f.name) for f in dataclasses.fields(MetricValues))):
        array[1, [3, 200]] = array[2, 399] = np.nan
    results = dataclasses.replace(results, status=status, S=S, setup=HANDS)
    ranking = rank(results)
    kept = np.setdiff1d(np.arange(400), [3, 200, 399])
    few = rank(results.take(np.isin(np.arange(400), kept)))
    assert ranking.metrics.invalid.tolist() == [{1: 2, 2: 1}.get(i, 0) for i in ranking.index.tolist()]
    assert "3 of 400 scenarios cannot be driven" in ranking.warnings[0]
    assert ranking.warnings[1:] == few.warnings
    same = dataclasses.replace(ranking.metrics, invalid=few.metrics.invalid)
    assert_same_bits(dataclasses.replace(ranking, metrics=same, warnings=few.warnings), few)
    for name in RELEASE_METRICS:
        assert name.endswith(("margin", "worst")) or np.isfinite(ranking.metrics.beside[name]).all()


def test_nothing_that_can_be_driven_is_refused() -> None:
    results = results_of(np.full((1, 3), np.nan), left=1)
    results = dataclasses.replace(results, status=np.full_like(results.status, EventStatus.INVALID))
    with pytest.raises(InputError, match="no scenario could be driven"):
        rank(results)


def test_the_control_window_warns_where_y_s_varies(scores: np.ndarray) -> None:
    assert "not comparable" in rank(results_of(scores, left=150, window="control")).warnings[0]
    assert not rank(results_of(scores, left=150, window="control", y_s=0.2)).warnings
    assert not rank(results_of(scores, left=150)).warnings


@pytest.mark.parametrize("confidence", [0.0, 1.0, -1.0, float("nan")])
def test_a_confidence_outside_its_range_is_refused(confidence: float) -> None:
    with pytest.raises(InputError, match="confidence"):
        check_confidence(confidence)


def test_the_csv_names_units_and_keeps_every_digit(tmp_path: Path, scores: np.ndarray) -> None:
    results = results_of(scores[:2], left=9)
    lqr = Design.from_gains("lqr", 0.1, {"r_delta": 1 / 3})
    results = dataclasses.replace(results, designs=(results.designs[0], lqr))
    ranking = rank(results)
    write_csv(ranking, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert (len(rows), [row["rank"] for row in rows]) == (2, ["1", "2"])
    assert [float(row["S_m_s"]) for row in rows] == ranking.metrics.S.tolist()
    by_law = {row["law"]: row for row in rows}
    assert float(by_law["lqr"]["gain_r_delta_1_per_rad2"]) == 1 / 3
    assert by_law["none"]["gain_r_delta_1_per_rad2"] == ""
    columns = "window convention y_s_m S_left_m_s set_of_best best_frequency S_cvar95_m_s crashed beyond_delta_max"
    assert set(columns.split()) <= set(rows[0])
    assert list(tmp_path.iterdir()) == [tmp_path / "r.csv"]


def test_a_csv_that_cannot_be_written_is_named(tmp_path: Path, scores: np.ndarray) -> None:
    with pytest.raises(StoreError, match=r"nowhere/r\.csv: cannot be written"):
        write_csv(rank(results_of(scores, left=9)), tmp_path / "nowhere" / "r.csv")


def test_the_order_of_designs_in_the_study_changes_no_bit() -> None:
    generator = np.random.default_rng(3)
    S = generator.gamma(1.0, 1.0, 120) + 0.3 * generator.gamma(1.0, 1.0, (9, 120))
    results = results_of(S, left=50, law="toy")
    results = dataclasses.replace(results, designs=(Design.from_gains("none", 0.2, {}), *results.designs[1:]))
    order = np.array([4, 8, 0, 2, 6, 1, 7, 3, 5])
    parts = {
        name: getattr(results, name)[order] for name in ("S", "S_uncorrected", "status", "failed_solves", "law_time")
    }
    metrics = MetricValues(
        **{f.name: getattr(results.metrics, f.name)[order] for f in dataclasses.fields(MetricValues)}
    )
    designs = tuple(results.designs[i] for i in order)
    other = dataclasses.replace(results, designs=designs, **parts, metrics=metrics)
    settings = {"pareto": ("S", "dtle_mean"), "require": ("deeper <= 0.5",)}
    one, two = (Ranking.of(r, **settings) for r in (results, other))  # type: ignore[arg-type]
    assert (one.designs, two.index.tolist()) == (two.designs, [order.tolist().index(i) for i in one.index])
    assert_same_bits(dataclasses.replace(one, index=two.index), two)


def test_differences_to_a_named_baseline(scores: np.ndarray) -> None:
    results = results_of(scores, left=150, law="toy")
    none = Design.from_gains("none", 0.2, {})
    results = dataclasses.replace(results, designs=(*results.designs[:3], none))
    by_law = rank(results)
    assert by_law.designs[by_law.baseline or 0].is_baseline
    for ranking, index in ((by_law, 3), (rank(results, baseline="toy"), 0), (rank(results, baseline=none.id[:7]), 3)):  # type: ignore[arg-type]
        assert ranking.index[ranking.baseline] == index
        wanted = (scores - scores[index]).mean(axis=1)[ranking.index]
        np.testing.assert_allclose(ranking.inference.baseline_difference, wanted, rtol=1e-12, atol=1e-15)
        others = ranking.index != index
        assert (ranking.inference.baseline_difference_low < ranking.inference.baseline_difference)[others].all()
        assert (
            ranking.inference.baseline_difference_low[~others]
            == ranking.inference.baseline_difference_high[~others]
            == 0.0
        )
    assert np.isnan(rank(results_of(scores, left=150, law="toy")).inference.baseline_difference).all()


def test_a_requirement_takes_the_rank_and_not_the_row(scores: np.ndarray, tmp_path: Path) -> None:
    """Design 1 is the best by S but misses; design 2 is then the best, and all comparisons are with it."""
    results = results_of(scores, left=150, law="toy")
    peaks = results.metrics.a_y_peak
    peaks[:] = np.array([1.0, 9.0, 2.0, 3.0], dtype=np.float32)[:, None]
    ranking = rank(results, require=("ay_p95 <= 3.0",), pareto=("S", "a_y_peak_max"))
    assert (ranking.index.tolist(), ranking.rank.tolist(), ranking.ranked) == ([2, 0, 3, 1], [1, 2, 3, 0], 3)
    assert (ranking.unmet, ranking.inference.difference[0]) == (((), (), (), ("a_y_peak_p95 <= 3",)), 0.0)
    assert ranking.inference.difference[3] == pytest.approx((scores[1] - scores[2]).mean(), rel=1e-12)
    assert ranking.inference.set_of_best.tolist() == [True, False, False, False]
    assert ranking.inference.best_frequency.tolist() == [1.0, 0.0, 0.0, 0.0]
    # 0 is worse by S, better by its peak; 3 is worse in both
    assert (ranking.pareto.tolist(), ranking.winner) == ([True, True, False, False], 0)
    write_csv(ranking, tmp_path / "r.csv")
    with (tmp_path / "r.csv").open(newline="") as stream:
        last = list(csv.DictReader(stream))[-1]
    assert (last["rank"], last["unmet"]) == ("", "a_y_peak_p95 <= 3")
    assert float(last["S_m_s"]) == scores[1].mean()


def test_requirements_that_nobody_meets_rank_nobody_and_say_so(scores: np.ndarray) -> None:
    ranking = rank(results_of(scores, left=150, law="toy"), require=("S <= 1e-3", "ay_max < 1e-3"))  # type: ignore[arg-type]
    assert (ranking.rank.tolist(), ranking.metrics.S.tolist()) == ([0, 0, 0, 0], sorted(scores.mean(axis=1)))
    assert not ranking.inference.set_of_best.any()
    assert not ranking.inference.best_frequency.any()
    assert ranking.winner is None
    assert all({miss.requirement.text for miss in some} == {"S <= 0.001", "a_y_peak_max < 0.001"} or some
               for some in ranking.missed)  # fmt: skip
    assert "none is ranked" in repr(ranking)
