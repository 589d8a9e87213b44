"""Two studies compared: shared scenarios, verdicts and their error rates, failures, refusals."""

import csv
import dataclasses
import json
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.results import per_scenario_numbers
from helpers.stored import rewrite_json
from ldctoolkit import EventStatus, Scenarios, load_model
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.paths.uncorrected import RandomStream
from ldctoolkit.plant_options import Mismatch, PlantOptions, Residuals, Sensors
from ldctoolkit.studies import Comparison, Manifest, Study, StudyResults, compare
from ldctoolkit.studies.comparison.comparison import COLUMNS, comparison_content, design_table, write_comparison
from ldctoolkit.studies.comparison.paired import (
    FinishedStudy,
    Verdict,
    drawn_streams,
    paired_differences,
    share_scenarios,
)
from ldctoolkit.studies.ranking.inference import weight_blocks
from ldctoolkit.studies.results import FailedDesign


def scenarios_of(n: int, left: int | None = None, seed: int = 0) -> Scenarios:
    generator = np.random.default_rng(seed)
    side = np.where(np.arange(n) < (n // 2 if left is None else left), 1, -1)
    return Scenarios.from_arrays(T=generator.uniform(1, 5, n), d_y=0.3, v_mean=25.0, side=side)


def study_of(d: int, **parts: Any) -> Study:
    designs = {"law": "none", "y_s": [round(0.001 * (i + 1), 6) for i in range(d)]}
    return Study.from_dict({"name": "synthetic", "ranking": {"bootstrap": 400}, "design": [designs]} | parts)


def finished(
    S: np.ndarray, *, source: str = "here", scenarios: Scenarios | None = None, status: np.ndarray | None = None,
    rows: Sequence[int] | None = None, of: int | None = None, **parts: Any,
) -> FinishedStudy:  # fmt: skip
    """A study whose scores are given; `rows` are the positions of its designs among `of` of them."""
    study = study_of(len(S) if of is None else of, **parts)
    designs = tuple(study.designs[i] for i in (range(len(S)) if rows is None else rows))
    if rows is not None:
        study = Study.from_dict(study.content() | {"design": [{"law": "none", "y_s": [d.y_s for d in designs]}]})
    where = scenarios_of(S.shape[1]) if scenarios is None else scenarios
    numbers = per_scenario_numbers(S, status=0 if status is None else status)
    results = StudyResults(designs, where, study.simulation.window, study.simulation.convention, **numbers)
    manifest = Manifest.of(study, model="reference", model_hash="0" * 64, model_notes=(), model_synthetic=True)
    return FinishedStudy(source, manifest, study, results)


def changed(side: FinishedStudy, **parts: Any) -> FinishedStudy:
    return dataclasses.replace(side, results=dataclasses.replace(side.results, **parts))


def verdicts(comparison: Comparison) -> list[str]:
    return [str(verdict) for verdict in comparison.S.verdict]


@pytest.fixture
def scores() -> np.ndarray:
    """Four designs on 400 scenarios, with much in common."""
    generator = np.random.default_rng(5)
    return generator.gamma(2.0, 1.0, 400) + 0.2 * generator.normal(size=(4, 400)) + 1.0


# shared scenarios
def test_draws_are_shared_with_seed_and_number_only() -> None:
    model = load_model("reference")
    small, large = model.sample(30, 50, seed=4), model.sample(70, 40, seed=4)
    every = share_scenarios(small, large)
    assert (every.left, every.right, every.other_draws) == (30, 40, 0)
    assert (small.matrix()[every.old] == large.matrix()[every.new]).all()
    assert every.new.tolist() == [*range(30), *range(70, 110)]
    shared = share_scenarios(small, large, both_draw=True)
    assert (shared.left, shared.right, shared.other_draws) == (30, 40, 0)  # a scenario's number is the same in both
    other_numbers = dataclasses.replace(large, index=np.where(large.side < 0, large.index + 2, large.index))
    shared = share_scenarios(small, other_numbers, both_draw=True)
    assert (shared.left, shared.right, shared.other_draws) == (30, 0, 40)
    assert (small.index[shared.old] == other_numbers.index[shared.new]).all()
    other = share_scenarios(small, large, both_draw=True, same_seed=False)
    assert (other.n, other.other_draws) == (0, 70)


@given(st.lists(st.integers(0, 9), max_size=12), st.lists(st.integers(0, 9), max_size=12))
def test_a_departure_is_shared_as_often_as_both_hold_it(old: list[int], new: list[int]) -> None:
    every = scenarios_of(10, seed=1)
    shared = share_scenarios(every.take(old), every.take(new))
    assert shared.n == sum(min(old.count(i), new.count(i)) for i in range(10))
    assert [old[i] for i in shared.old] == [new[i] for i in shared.new]
    assert len(set(shared.old.tolist())) == len(set(shared.new.tolist())) == shared.n


@pytest.mark.parametrize(
    ("options", "streams"),
    [
        (PlantOptions(), set()),
        (PlantOptions(mismatch=Mismatch(m=(1.2, 1.2)), sensors=Sensors(e_y_bias=0.1, delay=0.1)), set()),
        (PlantOptions(mismatch=Mismatch(I_z=(1.0, 1.2))), {RandomStream.MISMATCH}),
        (PlantOptions(residuals=Residuals(y=True)), {RandomStream.RESIDUAL_Y}),
        (PlantOptions(residuals=Residuals(v=True)), {RandomStream.RESIDUAL_V}),
        (PlantOptions(sensors=Sensors(e_psi_noise=0.1)), {RandomStream.CAMERA}),
        (PlantOptions(sensors=Sensors(curvature_noise=0.1)), {RandomStream.CURVATURE}),
    ],
)
def test_what_a_plant_draws(options: PlantOptions, streams: set[RandomStream]) -> None:
    assert drawn_streams(options) == streams


# verdicts
def test_known_shifts_get_their_verdicts(scores: np.ndarray) -> None:
    noise = 0.05 * np.random.default_rng(1).normal(size=scores.shape)
    noise -= noise.mean(axis=1, keepdims=True)
    new = scores + noise + np.array([0.05, -0.05, 0.0, 0.0])[:, None]
    new[3] = scores[3] + 5e-7  # the tolerance of a solver
    comparison = compare(finished(scores, source="old"), finished(new))
    assert verdicts(comparison) == ["worse", "better", "not separated", "same"]
    S = comparison.S
    np.testing.assert_allclose(S.difference[:3], [0.05, -0.05, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(S.S_new - S.S_old, S.difference, rtol=0, atol=1e-12)
    assert (S.low[:3] < S.difference[:3]).all()
    assert (S.difference[:3] < S.high[:3]).all()
    assert S.changed.tolist() == [400, 400, 400, 0]
    i = np.abs(new[0] - scores[0]).argmax()
    assert (S.largest_at[0], S.largest[0]) == (i, (new - scores)[0, i])
    assert comparison.any_worse
    assert (comparison.order[0], comparison.order[-1]) == (0, 3)
    assert "1 better, 1 worse, 1 not separated, 1 the same" in comparison.summary


def test_a_study_against_its_equal_is_the_same(scores: np.ndarray) -> None:
    comparison = compare(finished(scores, source="old"), finished(scores.copy()))
    assert (verdicts(comparison), comparison.differences) == (["same"] * 4, ())
    assert not comparison.any_worse
    winners = comparison.winners
    assert winners.verdict is Verdict.SAME
    assert winners.same_design


def test_the_interval_is_the_studentised_bootstrap_by_hand() -> None:
    """Resample by resample: the 95 % quantile of 99 is the 95th, a value that occurred."""
    generator, side = np.random.default_rng(2), np.repeat([1, -1], [60, 40])
    old = generator.gamma(2.0, 1.0, (1, 100))
    new = old + np.where(side > 0, 0.3, -0.1) * generator.gamma(1.0, 1.0, 100)
    found = paired_differences(old, new, side, seed=1, bootstrap=99)
    change = (new - old)[0]

    def mean_and_error(values: np.ndarray, sides: np.ndarray) -> tuple[float, float]:
        parts = [values[sides == which] for which in (1, -1)]
        return values.mean(), math.sqrt(sum(part.size * part.var(ddof=1) for part in parts)) / 100

    mean, error = mean_and_error(change, side)
    t = []
    for weights in next(weight_blocks(side, samples=99, seed=1, stream=0x636D70)).astype(int):
        again, spread = mean_and_error(np.repeat(change, weights), np.repeat(side, weights))
        t.append(abs(again - mean) / spread)
    half = sorted(t)[94] * error
    assert found.high[0] - found.difference[0] == pytest.approx(half, rel=1e-9)
    assert found.difference[0] - found.low[0] == pytest.approx(half, rel=1e-9)


def test_no_number_depends_on_the_rows_beside_it_but_the_common_width() -> None:
    generator, side = np.random.default_rng(3), np.repeat([1, -1], 8)
    old = generator.gamma(2.0, 1.0, (501, 16))
    new = old + 0.1 * generator.normal(size=old.shape)
    forward, backward = (paired_differences(old[::step], new[::step], side, seed=1, bootstrap=100) for step in (1, -1))
    for name in ("difference", "low", "high", "S_old", "largest"):
        np.testing.assert_array_equal(getattr(forward, name), getattr(backward, name)[::-1])
    alone = paired_differences(old[:1], new[:1], side, seed=1, bootstrap=100)
    assert alone.difference[0] == forward.difference[0]
    assert alone.high[0] < forward.high[0]  # one row alone needs less


@pytest.mark.parametrize(
    ("rows", "confidence", "fewest"), [(1, 0.95, 6), (4, 0.95, 8), (1, 0.5, 2), (2, 0.75, 4), (1, 0.999, 11)]
)
def test_the_fewest_changed_scenarios_that_an_interval_needs(rows: int, confidence: float, fewest: int) -> None:
    """Equal signs of m changes are chance in 2 of 2^m cases; k rows share 1 - confidence: m >= 1 + log2(k / share)."""
    old, side = np.ones((rows, 40)), np.repeat([1, -1], 20)
    for changed, known in ((fewest - 1, False), (fewest, True)):
        new = old.copy()
        new[:, :changed] += 1.0
        found = paired_differences(old, new, side, seed=1, bootstrap=50, confidence=confidence)
        assert np.isfinite(found.low).tolist() == np.isfinite(found.high).tolist() == [known] * rows
        assert found.changed.tolist() == [changed] * rows
        assert (found.high > found.difference).tolist() == [known] * rows
        assert known or found.verdict == (Verdict.NOT_SEPARATED,) * rows


def test_verdicts_at_the_tolerance_of_a_solver() -> None:
    """Constant shifts have no width: 1e-6 m s is the same still, a little more is not."""
    old, side = np.zeros((5, 40)), np.repeat([1, -1], 20)
    new = old + np.array([-1.1e-6, -1e-6, 0.0, 1e-6, 1.1e-6])[:, None]
    found = paired_differences(old, new, side, seed=1, bootstrap=50)
    assert [str(verdict) for verdict in found.verdict] == ["better", "same", "same", "same", "worse"]
    assert found.changed.tolist() == [40, 0, 0, 0, 40]
    assert found.largest.tolist() == [-1.1e-6, 0.0, 0.0, 0.0, 1.1e-6]
    # half of the scenarios: 1e-6 m s on average, within the interval on both sides of it
    half = np.tile([0.0, 2e-6], 20)
    found = paired_differences(old[:2], np.stack([half, -half]), side, seed=1, bootstrap=50)
    assert 0 < found.low[0] < 1e-6 < found.high[0]
    assert found.verdict == (Verdict.NOT_SEPARATED, Verdict.NOT_SEPARATED)


def test_a_constant_shift_needs_no_interval(scores: np.ndarray) -> None:
    new = scores + np.array([0.1, 0.0, 0.0, 0.0])[:, None]
    new[1] += 0.1 * np.random.default_rng(3).normal(size=400)
    side = np.repeat([1, -1], 200)
    found = paired_differences(scores, new, side, seed=1, bootstrap=300)
    assert found.low[0] == found.high[0] == pytest.approx(0.1)
    # its rounding has no share in the common width
    rest = paired_differences(scores[1:], new[1:], side, seed=1, bootstrap=300)
    assert found.high[1] == rest.high[0]


def test_one_scenario_of_a_side_tells_nothing(scores: np.ndarray) -> None:
    new = scores + 0.1 + 0.01 * np.random.default_rng(3).normal(size=scores.shape)
    one_left = scenarios_of(400, left=1)
    comparison = compare(finished(scores, scenarios=one_left), finished(new, scenarios=one_left))
    assert verdicts(comparison) == ["not separated"] * 4
    assert np.isinf(comparison.S.high).all()
    json.dumps(comparison_content(comparison), allow_nan=False)


def test_two_conventions_are_compared_as_an_input_that_differs(scores: np.ndarray) -> None:
    printed = finished(scores + 0.1, source="printed", simulation={"convention": "as_printed"})
    comparison = compare(finished(scores), printed)
    assert comparison.differences == ("simulation.convention: consistent -> as_printed",)
    assert comparison.label == "departure window, signs consistent -> as printed"
    np.testing.assert_allclose(comparison.S.difference, 0.1)
    assert compare(printed, finished(scores + 0.1, simulation={"convention": "as_printed"})).label == (
        "departure window, signs as printed"
    )


def test_failed_scenarios_count_at_least_as_without_control(scores: np.ndarray) -> None:
    status = np.zeros(scores.shape, dtype=np.int8)
    status[2, :50] = EventStatus.TIMED_OUT
    comparison = compare(finished(scores, source="old"), finished(scores, status=status))
    expected = np.concatenate([9.0 - scores[2, :50], np.zeros(350)]).mean()
    assert comparison.S.difference[2] == pytest.approx(expected)
    assert verdicts(comparison) == ["same", "same", "worse", "same"]
    assert (comparison.failed_old, comparison.failed_new) == ((0, 0, 0, 0), (0, 0, 50, 0))


def test_what_cannot_be_driven_counts_for_nobody(scores: np.ndarray) -> None:
    status = np.zeros(scores.shape, dtype=np.int8)
    status[1, 3] = EventStatus.INVALID
    new = scores.copy()
    new[1, 3] = np.nan
    comparison = compare(finished(scores, source="old"), finished(new, status=status))
    assert (verdicts(comparison), comparison.shared.n) == (["same"] * 4, 399)
    assert comparison.S.S_old[0] == pytest.approx(np.delete(scores[0], 3).mean())
    assert any("1 shared scenario cannot be driven" in warning for warning in comparison.warnings)


def draw(repetition: int, *, k: int, n: int, share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scores of two versions of k designs without any difference in truth; `share` of the scenarios change at all."""
    generator = np.random.default_rng([repetition, n, k])
    side = np.where(np.arange(n) < 0.4 * n, 1, -1)
    common = generator.gamma(2.0, 1.0, n)
    old = common + 0.2 * generator.normal(size=(k, n))
    change = 0.05 * (generator.gamma(1.0, 1.0, (k, n)) - 1.0) + 0.05 * generator.standard_t(4, size=n)
    return old, old + change * (generator.random(n) < share), side


@pytest.mark.slow
@pytest.mark.parametrize(("n", "share"), [(1000, 1.0), (200, 1.0), (1000, 0.05)])
def test_false_alarms_are_as_rare_as_promised(n: int, share: float) -> None:
    """40 designs, skewed and heavy-tailed changes with a common part: any design called better or worse is an error."""
    repetitions = 300
    alarms = 0
    for repetition in range(repetitions):
        old, new, side = draw(repetition, k=40, n=n, share=share)
        found = paired_differences(old, new, side, seed=repetition, bootstrap=500)
        alarms += Verdict.WORSE in found.verdict or Verdict.BETTER in found.verdict
    # 5 %, and three standard errors of 300 repetitions
    assert alarms / repetitions <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / repetitions)


@pytest.mark.slow
def test_the_winners_interval_minds_that_they_were_chosen() -> None:
    """20 designs, all equal in truth, other ones in the new study: the best by chance must not look better."""
    repetitions, alarms = 60, 0
    for repetition in range(repetitions):
        generator = np.random.default_rng(repetition)
        common = generator.gamma(2.0, 1.0, 300)
        old, new = common + 0.3 * generator.normal(size=(2, 20, 300))
        comparison = compare(
            finished(old[:1], source="old", rows=[0], of=40),
            finished(new, rows=range(20, 40), of=40, seed=0),
            bootstrap=300,
        )
        winners = comparison.winners
        alarms += winners.verdict is not Verdict.NOT_SEPARATED
    assert alarms / repetitions <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / repetitions)


# designs
def test_new_candidates_against_the_old_winner(scores: np.ndarray) -> None:
    generator = np.random.default_rng(6)
    better = scores[:2] - 0.3 + 0.05 * generator.normal(size=(2, 400))
    old = finished(scores, source="old", of=6, rows=range(4))
    comparison = compare(old, finished(better, rows=[4, 5], of=6))
    assert len(comparison) == 0
    winners = comparison.winners
    best_old, best_new = scores.mean(axis=1).argmin(), better.mean(axis=1).argmin()
    assert (winners.old, winners.new) == (old.results.designs[best_old], comparison.only_new[best_new])
    assert winners.difference == pytest.approx((better[best_new] - scores[best_old]).mean())
    assert winners.verdict is Verdict.BETTER
    assert (winners.same_design, winners.fresh, winners.scenarios) == (False, False, 400)
    assert len(comparison.only_old) == 4
    assert not comparison.any_worse
    assert compare(finished(better, rows=[4, 5], of=6), old).any_worse  # the other way round


def test_winners_meet_on_fresh_scenarios(scores: np.ndarray) -> None:
    scores = scores + np.array([0.0, 0.0, -0.05, -0.05])[:, None]
    fresh_scenarios = scenarios_of(300, seed=8)
    old, new = (finished(scores, source=name) for name in ("old", "new"))
    fresh = np.random.default_rng(9).gamma(2.0, 1.0, (2, 300))
    fresh[1] -= fresh[1].mean() - fresh[0].mean() - 1.0

    def with_fresh(side: FinishedStudy, S: np.ndarray) -> FinishedStudy:
        results = dataclasses.replace(
            side.results, designs=side.results.designs[2:], scenarios=fresh_scenarios, **per_scenario_numbers(S)
        )
        return changed(side, fresh=results)

    winners = compare(with_fresh(old, fresh), with_fresh(new, fresh - 0.5)).winners
    assert (winners.fresh, winners.scenarios, winners.old) == (True, 300, old.results.designs[2])
    assert winners.difference == pytest.approx(-0.5)
    assert winners.verdict is Verdict.BETTER
    one_sided = compare(with_fresh(old, fresh), new).winners
    assert not one_sided.fresh


def test_no_winner_where_no_design_meets_the_requirements(scores: np.ndarray) -> None:
    old, new = finished(scores, source="old"), finished(scores, ranking={"require": ["S <= 0.001"]})
    comparison = compare(old, new)
    assert comparison.winners is None
    assert any("no winner to compare" in warning for warning in comparison.warnings)
    assert "against the old one: no winner." in comparison.summary
    assert [row["compared"] for row in comparison_content(comparison)["rows"]] == ["design"] * 4


def test_the_winner_meets_the_requirements(scores: np.ndarray) -> None:
    """The best mean S belongs to a design that a requirement rules out."""
    old = finished(scores, source="old")
    status = np.zeros(scores.shape, dtype=np.int8)
    best, second = np.argsort(scores.mean(axis=1))[:2]
    status[best, 0] = EventStatus.TIMED_OUT
    new = finished(scores, status=status, ranking={"require": ["timed_out <= 0"]})
    winners = compare(old, new).winners
    assert (winners.old, winners.new) == (old.results.designs[best], old.results.designs[second])


def test_failed_designs(scores: np.ndarray) -> None:
    every = study_of(4).designs
    old = changed(finished(scores[:3], of=4, rows=[0, 1, 2]), failed=(FailedDesign(every[3], "it raised"),))
    new = changed(finished(scores[[1, 3]], of=4, rows=[1, 3]), failed=(FailedDesign(every[0], "it raises now"),))
    comparison = compare(old, new)
    assert [one.reason for one in comparison.new_failures] == ["it raises now"]
    assert [one.design for one in comparison.repaired] == [every[3]]
    assert comparison.any_worse  # though design 1 is the same
    assert verdicts(comparison) == ["same"]
    assert "1 failed only in the new study" in comparison.summary
    both = compare(old, changed(old, failed=old.results.failed))
    assert [one.design for one in both.failed_in_both] == [every[3]]
    assert not both.any_worse


@pytest.mark.parametrize(("d", "title"), [(1, "1 design in both studies"), (2, "2 designs in both studies")])
def test_one_design_is_told_as_one(scores: np.ndarray, d: int, title: str) -> None:
    table = design_table(compare(finished(scores[:d], source="old"), finished(scores[:d])), range(d))
    assert table.title.startswith(f"{title}, 400 shared scenarios")
    assert len(table.rows) == d


def test_inputs_that_differ_come_as_old_and_new(scores: np.ndarray) -> None:
    comparison = compare(
        finished(scores, source="old", plant={"sensors": {"kalman": {}}}),
        finished(scores[:2], vehicle={"m": 1100.0}, of=4, rows=[0, 1]),
    )
    assert comparison.differences[0] == "vehicle.m: 1000.0 -> 1100.0"
    assert comparison.differences[1].startswith("plant.sensors.kalman: {")
    assert comparison.differences[1].endswith("-> not set")
    assert comparison.differences[2:] == ("designs: 4 -> 2, 2 of them in both",)


def test_both_plants_draw(scores: np.ndarray) -> None:
    noise = {"sensors": {"e_y_noise": 0.01}}
    n = scores.shape[1]
    every = scenarios_of(n)
    # the same departures in another order: other numbers
    turned = Scenarios.from_arrays(side=every.side[::-1], T=every.T[::-1], d_y=0.3, v_mean=25.0)
    old, ideal = finished(scores, plant=noise, scenarios=every), finished(scores[:, ::-1], scenarios=turned)
    assert verdicts(compare(old, ideal)) == ["same"] * 4  # what one plant draws needs no partner
    with pytest.raises(InputError, match="400 departures are the same, but both plants draw"):
        compare(old, finished(scores[:, ::-1], plant=noise, scenarios=turned))
    with pytest.raises(InputError, match="both plants draw"):
        compare(old, finished(scores, plant=noise, scenarios=every, seed=1))
    other = {"mismatch": {"m": [1.0, 1.2]}}
    assert compare(old, finished(scores[:, ::-1], plant=other, scenarios=turned)).shared.n == n


@pytest.mark.parametrize(("n", "told"), [(50, True), (199, True), (200, False)])
def test_few_shared_scenarios_are_told(scores: np.ndarray, n: int, told: bool) -> None:
    old = finished(
        scores[:, :n],
        source="old",
        scenarios=scenarios_of(400).take(range(200 - min(50, n // 2), 200 - min(50, n // 2) + n)),
    )
    comparison = compare(old, finished(scores))
    assert (comparison.shared.left, comparison.shared.right) == (min(50, n // 2), n - min(50, n // 2))
    assert comparison.warnings == ((f"Only {n} shared scenarios: the intervals are rough.",) if told else ())


# refusals and files
def test_refusals_of_results(scores: np.ndarray) -> None:
    old = finished(scores, source="old")
    with pytest.raises(InputError, match=r"no scenario in both \(seed: 0 -> 1\)"):
        compare(old, finished(scores, scenarios=scenarios_of(400, seed=1), seed=1))
    with pytest.raises(InputError, match="S of the departure window in the old study, of the control window in the"):
        compare(old, finished(scores, simulation={"window": "control"}))
    with pytest.raises(InputError, match="no shared scenario could be driven"):
        compare(old, finished(scores, status=np.full(scores.shape, EventStatus.INVALID, dtype=np.int8)))
    for confidence in (1.5, 1.0, 0.0):
        with pytest.raises(InputError, match=f"confidence: {confidence}; allowed: between 0 and 1"):
            compare(old, finished(scores + 1.0), confidence=confidence)
    with pytest.raises(InputError, match="S is not finite"):
        compare(old, finished(np.where(scores > 5, np.nan, scores)))


def test_refusals_of_folders(tmp_path: Path, small_run: Path) -> None:
    folder = small_run
    (tmp_path / "link").symlink_to(folder)
    for again in (folder, tmp_path / "link", str(folder) + "/"):
        with pytest.raises(InputError, match="the same folder twice"):
            compare(folder, again)
    with pytest.raises(StoreError, match="is not the folder of a study"):
        compare(folder, tmp_path)
    (tmp_path / "two").mkdir()
    shutil.copy(folder / "manifest.json", tmp_path / "two")
    rewrite_json(tmp_path / "two" / "manifest.json", lambda manifest: manifest.update(finished=""))
    with pytest.raises(StoreError, match="two: the study is not finished"):
        compare(folder, tmp_path / "two")


def test_files_hold_every_row(tmp_path: Path, scores: np.ndarray) -> None:
    every = study_of(5).designs
    new = scores + 0.1 * np.random.default_rng(1).normal(size=scores.shape) + 0.1
    new[3] = scores[3]
    old = finished(scores, source="old", of=5, rows=range(4))
    # the fifth one ran in neither
    failed = (FailedDesign(every[4], 'a "reason", with a comma'),)
    comparison = compare(changed(old, failed=failed), changed(finished(new, of=5, rows=range(4)), failed=failed))
    write_comparison(comparison, tmp_path / "c.csv")
    with (tmp_path / "c.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == list(COLUMNS)
    assert [row["compared"] for row in rows] == ["design"] * 4 + ["winners", "failure"]
    assert rows[-1]["failure"] == failed[0].reason
    S = comparison.S
    for row, i in zip(rows, comparison.order, strict=False):
        assert row["design_new"] == comparison.designs[i].id
        assert float(row["difference_m_s"]) == S.difference[i]
        assert (float(row["difference_high_m_s"]), row["verdict"]) == (S.high[i], S.verdict[i])
    assert rows[3]["largest_change_scenario"] == ""
    assert int(rows[0]["largest_change_scenario"]) == np.abs(new - scores)[comparison.order[0]].argmax()
    content = json.loads(json.dumps(comparison_content(comparison), allow_nan=False))
    assert content["worse"] is True
    assert (content["summary"], len(content["rows"])) == (comparison.summary, len(rows))
