"""Metrics of designs: tails, shares, the Pareto front, the baseline, few scenarios."""

import contextlib
import dataclasses
import math
import tracemalloc
import types
from pathlib import Path

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.results import results_of
from ldctoolkit import EventStatus
from ldctoolkit.errors import InputError, LdcError, UnknownNameError
from ldctoolkit.metrics import METRICS
from ldctoolkit.studies import Design, StudyResults, rank_study, read_manifest, read_results
from ldctoolkit.studies.ranking.design_metrics import (
    find_baseline,
    masked_max,
    masked_mean,
    masked_quantile,
    mean_reduction,
    pareto_costs,
    pareto_front,
    tail_metrics,
)
from ldctoolkit.studies.ranking.inference import (
    Inference,
    Resampled,
    bootstrap_deviations,
    infer,
    row_blocks,
    row_means,
)
from ldctoolkit.studies.ranking.ranking import warnings_of_sample, write_csv
from ldctoolkit.studies.requirements import metric, metric_values, parse_requirement
from ldctoolkit.studies.results import FailedDesign


@given(st.integers(1, 70), st.integers(0, 10**6), st.sampled_from([50, 90, 95, 99]))
def test_tails_are_those_of_the_definition(n: int, seed: int, percent: int) -> None:
    """Rockafellar and Uryasev: the least of c + mean(max(x - c, 0)) / (1 - share), at one of the values."""
    values = np.random.default_rng(seed).gamma(0.5, 1.0, (3, n)).round(1)  # many equal ones
    quantile, cvar = tail_metrics(values, percent)
    for row, q, worst in zip(values, quantile, cvar, strict=True):
        wanted = min(c + np.maximum(row - c, 0.0).mean() / (1 - percent / 100) for c in row)
        # 1 - share is known to 1e-14 of itself, sums to a few roundings
        assert worst == pytest.approx(wanted, rel=1e-11, abs=1e-13)
        assert q == pytest.approx(np.quantile(row, percent / 100), rel=1e-12, abs=1e-15)
        assert row.mean() * (1 - 1e-12) <= worst <= row.max() * (1 + 1e-12)


def test_tails_by_literals() -> None:
    """Of 1 to 30 m s the worst 5 % are one and a half: 30, and half of 29; of 20 and of 40 they are whole numbers."""
    for n, quantile, cvar in ((30, 28.55, (30 + 0.5 * 29) / 1.5), (20, 19.05, 20.0), (40, 38.05, 39.5), (1, 1.0, 1.0)):
        found = tail_metrics(np.random.default_rng(n).permutation(np.arange(1.0, n + 1))[None])
        assert [one.item() for one in found] == pytest.approx([quantile, cvar], rel=1e-12), n


@given(st.integers(1, 30), st.integers(0, 10**6), st.sampled_from([0.05, 0.5, 0.95]))
def test_marked_columns_are_as_if_the_others_were_not_there(n: int, seed: int, share: float) -> None:
    generator = np.random.default_rng(seed)
    values = generator.gamma(1.0, 1.0, (4, n))
    values[generator.random((4, n)) < 0.1] = np.inf
    among = generator.random((4, n)) < generator.random((4, 1))
    found = masked_mean(values, among), masked_max(values, among), masked_quantile(values, among, share)
    for i in range(4):
        kept = np.sort(values[i, among[i]])
        if not kept.size:
            assert all(math.isnan(one[i]) for one in found)
            continue
        place = share * (kept.size - 1)
        low, high = kept[math.floor(place)], kept[math.ceil(place)]
        part = place - math.floor(place)
        quantile = low if low == high else low + (high - low) * part
        for one, wanted in zip(found, (kept.mean(), kept.max(), quantile), strict=True):
            assert one[i] == pytest.approx(wanted, rel=1e-12)


def by_pairs(costs: np.ndarray) -> list[bool]:
    def dominated(i: int) -> bool:
        return any(all(a <= b for a, b in zip(x, costs[i], strict=True)) and tuple(x) != tuple(costs[i]) for x in costs)

    whole = ~np.isnan(costs).any(axis=1)
    everyone, costs = costs, costs[whole]
    kept = iter([not dominated(i) for i in range(len(costs))])
    return [next(kept) if whole[i] else False for i in range(len(everyone))]


# few different values: ties, duplicates and chains are common; infinities and both zeros are among them
_TIED = st.sampled_from([-np.inf, -1.0, -0.0, 0.0, 0.5, 1.0, 2.0, np.inf, np.nan])


@given(hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12), elements=_TIED))
def test_small_tables_with_ties(costs: np.ndarray) -> None:
    assert pareto_front(costs).tolist() == by_pairs(costs)


@given(st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([2, 5, 40, 10**6]), st.integers(65, 400))
def test_larger_tables_with_and_without_ties(seed: int, k: int, values: int, d: int) -> None:
    costs = np.random.default_rng(seed).integers(values, size=(d, k)).astype(float)
    costs[costs == 0], costs[costs == values - 1] = -np.inf, np.inf
    smaller = (costs[:, None] <= costs[None]).all(axis=2) & (costs[:, None] < costs[None]).any(axis=2)
    assert pareto_front(costs).tolist() == (~smaller.any(axis=0)).tolist()


def test_a_front_that_holds_everything() -> None:
    """Points of the simplex: none dominates another."""
    points = np.random.default_rng(4).dirichlet(np.ones(4), size=1000)
    whole = np.round(points * 2**30)
    whole[:, 0] = 2**31 - whole[:, 1:].sum(axis=1)  # the same sum exactly
    assert pareto_front(np.r_[whole, whole + 1.0]).tolist() == [True] * 1000 + [False] * 1000


def test_memory_grows_with_the_number_of_designs_and_not_with_its_square() -> None:
    costs = np.random.default_rng(0).dirichlet(np.ones(4), size=8_000)
    tracemalloc.start()
    pareto_front(costs)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * costs.nbytes  # a table of all pairs would take 250 times that


def test_one_column_keeps_all_smallest() -> None:
    costs = np.r_[np.full(3, 2.0), 1.0, np.arange(1.0, 200.0)]
    assert np.flatnonzero(pareto_front(costs[:, None])).tolist() == [3, 4]


def test_nothing_and_wrong_shapes() -> None:
    assert pareto_front(np.zeros((0, 3))).tolist() == []
    assert pareto_front(np.full((2, 2), np.nan)).tolist() == [False, False]
    for shape in ((3,), (3, 0), (2, 2, 2)):
        with pytest.raises(InputError, match="costs: shape"):
            pareto_front(np.zeros(shape))


def test_costs_turn_metrics_of_which_more_is_better() -> None:
    columns = {"S": np.array([1.0, 2.0, 2.0]), "within_dtle": np.array([0.5, 0.9, 0.5])}
    costs = pareto_costs(["S", "dtle_0p3_share"], columns)
    assert costs.tolist() == [[1.0, -0.5], [2.0, -0.9], [2.0, -0.5]]
    assert pareto_front(costs).tolist() == [True, True, False]
    with pytest.raises(UnknownNameError, match="did you mean 'S'"):
        pareto_costs(["SS"], columns)
    with pytest.raises(InputError, match="no metrics"):
        pareto_costs([], columns)


NONE = Design.from_gains("none", 0.2, {})
LQR = tuple(Design.from_gains("lqr", y_s, {}) for y_s in (0.1, 0.2))


def results(*designs: Design, failed: tuple[Design, ...] = ()) -> StudyResults:
    parts = {"failed": tuple(FailedDesign(one, "it broke") for one in failed)}
    return results_of(np.ones((len(designs), 2)), designs, parts=parts)


def test_a_law_an_identifier_or_no_word() -> None:
    every = results(*LQR, NONE)
    assert find_baseline("", every) == 2
    assert find_baseline("none", every) == 2
    assert find_baseline("lqr", every) == 0
    assert find_baseline(LQR[1].id, every) == find_baseline(LQR[1].id[:6], every) == 1
    assert find_baseline("", results(*LQR)) is None


def test_a_baseline_that_failed_is_no_mistake_of_the_file() -> None:
    assert find_baseline("none", results(*LQR, failed=(NONE,))) is None
    assert find_baseline("lqr", results(LQR[1], NONE, failed=(LQR[0],))) == 0


@pytest.mark.parametrize("word", ["lqq", "f00baa", LQR[0].id[:5]])
def test_anything_else_is_refused_with_the_nearest(word: str) -> None:
    with pytest.raises(InputError, match=rf"ranking\.baseline: '{word}' is neither a law .*allowed: lqr, none"):
        find_baseline(word, results(*LQR, NONE))


def test_the_start_of_two_identifiers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Design, "id", property(lambda self: f"abcdef{self.y_s:06.0f}"))
    with pytest.raises(InputError, match="'abcdef' is the start of 2 identifiers; allowed: more digits"):
        find_baseline("abcdef", results(*LQR))


def test_no_row_depends_on_the_rows_beside_it() -> None:
    """2,600 rows of 1,000 are several blocks of means, of tails and of resamples; three of them, alone and turned."""
    values, side = np.random.default_rng(0).gamma(1.0, 1.0, (2600, 1000)), np.repeat([1, -1], 500)
    some = np.array([2599, 0, 1300])
    few = np.ascontiguousarray(values[some])
    np.testing.assert_array_equal(row_means(values)[some], row_means(few))
    np.testing.assert_array_equal(row_means(values, some), row_means(few))
    for whole, alone in zip(tail_metrics(values), tail_metrics(few), strict=True):
        np.testing.assert_array_equal(whole[some], alone)
    whole = bootstrap_deviations(values, side, samples=8, seed=1)
    np.testing.assert_array_equal(whole[:, some], bootstrap_deviations(few, side, samples=8, seed=1))
    chosen = bootstrap_deviations(values, side, samples=8, seed=1, rows=some)
    np.testing.assert_array_equal(whole[:, some], chosen)


@given(st.integers(1, 9), st.integers(0, 4), st.integers(1, 40), st.data())
def test_blocks_are_the_rows_that_were_asked_for(d: int, n: int, entries: int, data: st.DataObject) -> None:
    values = np.arange(d * n, dtype=np.float64).reshape(d, n)
    rows = data.draw(st.none() | st.lists(st.integers(0, d - 1), min_size=1).map(np.array))
    wanted = values if rows is None else values[rows]
    found = np.full(wanted.shape, -1.0)
    for places, block in row_blocks(values, rows, entries=entries):
        assert block.size <= max(entries, n)
        found[places] = block
    np.testing.assert_array_equal(found, wanted)


def invented() -> StudyResults:
    generator = np.random.default_rng(5)
    kinds = np.array([EventStatus.OK, EventStatus.SOLVER_FAILED], dtype=np.int8)
    S, designs = generator.gamma(1.0, 1.0, (6, 50)), [Design.from_gains("none", 0.1 * (i + 1), {}) for i in range(6)]
    results = results_of(S, designs, status=generator.choice(kinds, (6, 50), p=(0.9, 0.1)))
    depth = generator.gamma(1.0, 1.0, 50)
    return dataclasses.replace(results, S_uncorrected=np.broadcast_to(depth, results.S.shape))


def test_counted_is_s_or_what_is_worse_without_control() -> None:
    results = invented()
    failed = results.status == EventStatus.SOLVER_FAILED
    assert failed.any()
    wanted = np.where(failed, np.fmax(results.S, results.S_uncorrected), results.S)
    np.testing.assert_array_equal(results.counted, wanted)
    assert results.counted is results.counted
    fine = dataclasses.replace(results, status=np.zeros_like(results.status))
    assert fine.counted is fine.S


def test_one_row_of_scores_without_control_stays_one() -> None:
    results = invented()
    columns = np.arange(50) % 2 > 0
    taken = results.take(columns)
    assert taken.S_uncorrected.strides[0] == 0
    np.testing.assert_array_equal(taken.S_uncorrected, results.S_uncorrected[:, columns])


@pytest.fixture
def inference() -> Inference:
    S = np.random.default_rng(1).gamma(2.0, 1.0, (3, 20))
    resampled = Resampled.of(S, np.repeat([1, -1], 10), seed=0, samples=50)
    return infer(resampled, ranked=3, baseline=None, confidence=0.95)


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        (25, 24, "too short with so few scenarios (25 left and 24 right)"),
        (91, 9, "too short with so few scenarios (91 left and 9 right)"),
        (0, 49, "too short with so few scenarios (49 right)"),
        (99, 1, "no interval and no designs are separated: a side has one scenario only (99 left and 1 right)"),
        (40, 10, ""),
        (50, 0, ""),
    ],
)
def test_small_samples_are_told(inference: Inference, left: int, right: int, words: str) -> None:
    found = list(warnings_of_sample(np.repeat([1, -1], [left, right]), inference))
    assert len(found) == bool(words)
    assert all(words in text for text in found)
    if "too short" in words:
        assert found[0].endswith("None of them counts the sampling error of the scenario model itself.")


def test_left_out_references_are_told(inference: Inference) -> None:
    side = np.repeat([1, -1], 30)
    assert not list(warnings_of_sample(side, inference))
    (text,) = warnings_of_sample(side, dataclasses.replace(inference, references=20, may_be_best=600))
    assert "from 20 of 600 designs that may be the best" in text


NAN = math.nan


def test_every_metric_answers_to_its_column() -> None:
    for name, one in METRICS.items():
        assert metric(one.column) is metric(name) is one
    assert len({one.column for one in METRICS.values()}) == len(METRICS)


def test_names_of_a_ranking_csv_row_are_all_aliases() -> None:
    assert metric("S_m_s").name == "S"
    assert metric("a_y_peak_p95_m_s2").name == metric("ay_p95").name == "a_y_peak_p95"
    assert metric("ay_added_max").name == "a_y_added_peak_max"
    # what earlier versions called it
    assert metric("overshoot_max").name == metric("overshoot_max_m").name == "opposite_crossing_max"
    assert metric("overshoot_share").name == "opposite_crossed_share"
    assert metric("dtle_0p3_share").name == metric("within_dtle_share").name == "within_dtle"
    assert metric("deeper_than_D_y_share").name == "deeper"


def test_an_unknown_name_is_answered_with_the_nearest() -> None:
    for name, near in (("t_back_medain", "t_back_median"), ("S_lef", "S_left")):
        with pytest.raises(UnknownNameError) as caught:
            metric(name)
        assert (caught.value.path, caught.value.value) == ("metric", name)
        assert f"did you mean '{near}'" in caught.value.hint


def test_values_come_from_a_ranking_or_its_metrics() -> None:
    beside = {"a_y_peak_p95": np.array([2.0, 3.0])}
    metrics = types.SimpleNamespace(S=np.array([0.1, 0.2]), crashed=np.array([0, 4]), beside=beside)
    for source in (metrics, types.SimpleNamespace(metrics=metrics), vars(metrics) | beside):
        assert metric_values("ay_p95", source).tolist() == [2.0, 3.0]
        assert metric_values("crashed", source).tolist() == [0.0, 4.0]
        assert metric_values("crashed", source).dtype == np.float64
        with pytest.raises(InputError, match="metric effort_mean: not among these results"):
            metric_values("effort", source)


@pytest.mark.parametrize(
    ("text", "canonical"),
    [
        ("ay_p95 <= 3.0", "a_y_peak_p95 <= 3"), ("dtle_0p3_share>=0.99", "within_dtle >= 0.99"), ("  S<.5 ", "S < 0.5"),
        ("dtle_min > -0.3", "dtle_min > -0.3"), ("jerk_peak_max_m_s3 <= 1e2", "jerk_peak_max <= 100"),
        ("crashed <= 0", "crashed <= 0"), ("reduction >= -1e-12", "reduction >= -1e-12"),
    ],
)  # fmt: skip
def test_requirements_are_read(text: str, canonical: str) -> None:
    assert parse_requirement(text).text == canonical
    assert parse_requirement(canonical).text == canonical


@pytest.mark.parametrize(
    "text", ["", "S", "S <=", "<= 3", "3 >= S", "S == 3", "S <= 3 m s", "S <= 3, S <= 4", "S =< 3"]
)
def test_what_is_no_requirement_is_named(text: str) -> None:
    with pytest.raises(InputError, match="cannot be read") as caught:
        parse_requirement(text)
    assert (caught.value.path, caught.value.value) == ("requirement", text)


def test_an_unknown_figure_of_a_requirement_is_named_with_its_text() -> None:
    for name, text in (("ay_p59", "ay_p59 <= 3"), ("comfortble", "comfortble >= 0.5"), ("law_time", "law_time <= 5")):
        with pytest.raises(UnknownNameError) as caught:
            parse_requirement(text)
        assert (caught.value.path, caught.value.value) == (f"requirement {text!r}: metric", name)


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("S <= inf", "a finite number"), ("S <= nan", "a finite number"), ("S <= three", "a finite number"),
        ("within_dtle >= 99", "a share from 0 to 1"), ("crashed <= -1", "a number >= 0"),
    ],
)  # fmt: skip
def test_a_limit_that_makes_no_sense_is_refused(text: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_requirement(text)
    assert (caught.value.path, caught.value.value) == (f"requirement {text!r}: limit", text.split()[-1])
    assert caught.value.allowed == allowed


def test_a_figure_that_a_design_lacks_meets_nothing() -> None:
    values = [1.0, 2.0, 3.0, math.nan, math.inf, -math.inf]
    for operator, met in {
        "<=": [True, True, False, False, False, True],
        "<": [True, False, False, False, False, True],
        ">=": [False, True, True, False, True, False],
        ">": [False, False, True, False, True, False],
    }.items():
        assert parse_requirement(f"t_back_median {operator} 2").met(values).tolist() == met


@given(
    st.sampled_from(sorted(name for name, one in METRICS.items() if one.unit not in ("share", "count"))),
    st.sampled_from(["<=", "<", ">=", ">"]),
    st.floats(allow_nan=False, allow_infinity=False),
)
def test_the_text_reads_back_to_the_same(name: str, operator: str, limit: float) -> None:
    one = parse_requirement(f"{name} {operator} {limit!r}")
    assert (parse_requirement(one.text), one.limit) == (one, limit)


@given(st.text(max_size=30))
def test_any_text_is_read_or_refused_as_input(text: str) -> None:
    with contextlib.suppress(LdcError):
        assert parse_requirement(text).text


def test_a_ranking_and_its_table_hold_every_figure(small_run: Path, tmp_path: Path) -> None:
    ranking = rank_study(read_results(small_run), read_manifest(small_run).read_study())
    write_csv(ranking, tmp_path / "ranking.csv")
    header = (tmp_path / "ranking.csv").read_text().partition("\n")[0].split(",")
    for name, one in METRICS.items():
        if there := one.group != "driver":  # nobody holds the wheel
            assert metric_values(name, ranking).shape == (len(ranking),)
        assert (one.column in header) == there


def test_nothing_to_reduce_is_a_reduction_of_nothing() -> None:
    found = mean_reduction(np.array([0.0, 0.2, 0.1, NAN]), np.array([0.0, 0.0, 0.4, NAN]))
    np.testing.assert_array_equal(found, [0.0, 0.0, 0.75, NAN])
