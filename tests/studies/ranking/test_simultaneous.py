"""Simultaneous intervals and the set of best: by hand on few designs, and their coverage where the truth is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import examples
from ldctoolkit.errors import InputError
from ldctoolkit.studies.ranking.inference import (
    Resampled,
    Separation,
    bootstrap_deviations,
    compare_with_best,
    exact_grid,
    infer,
    simultaneous_interval,
    weight_blocks,
    with_tails_of_t,
)

DESIGNS = 128
CONFIDENCE = 0.95


def separable(scores: np.ndarray, side: np.ndarray, *, seed: int, confidence: float, samples: int) -> Separation:
    return compare_with_best(Resampled.of(scores, side, seed=seed, samples=samples), confidence)


@dataclasses.dataclass(frozen=True)
class Truth:
    """Designs with known mean S, and scenarios drawn for them. S >= 0 is a scenario's own depth, which all designs
    share in their own measure, plus three further traits of the scenario that designs react to differently, plus what
    is between this design and this scenario alone. All are skewed (2, and 6.6 for the last), left departures are worse
    than right ones, and S correlates between designs."""

    mean: np.ndarray
    depth: np.ndarray
    loads: np.ndarray
    own: np.ndarray

    @classmethod
    def of(cls, d: int, spread: float) -> Truth:
        generator = np.random.default_rng(3)
        loads = 0.03 * np.abs(generator.normal(size=(d, 3)))
        own = 0.02 * (1.0 + generator.random(d))
        mean = 0.40 + spread * generator.permutation(np.linspace(0.0, 1.0, d))
        return cls(mean, mean - loads.sum(axis=1) - own, loads, own)

    def draw(self, n: int, seed: list[int]) -> tuple[np.ndarray, np.ndarray]:
        generator = np.random.default_rng(seed)
        left = int(0.6 * n)
        side = np.where(np.arange(n) < left, 1, -1)
        # 0.6 x 1.2 + 0.4 x 0.7 = 1: the mean over both sides is that of the design
        depth = generator.exponential(size=n) * np.where(side == 1, 1.2, 0.7)
        own = generator.standard_exponential((len(self.mean), n))
        own *= own
        own *= 0.5 * self.own[:, None]
        return self.depth[:, None] * depth + self.loads @ generator.exponential(size=(3, n)) + own, side


@dataclasses.dataclass
class Coverage:
    """Share of repetitions in which a family of intervals holds all truths."""

    S: float = 0.0
    baseline: float = 0.0
    best: float = 0.0
    set_of_best: float = 0.0
    size: float = 0.0


def coverage(truth: Truth, n: int, repetitions: int, samples: int, first: int = 0) -> Coverage:
    held = Coverage()
    mean, baseline, best = truth.mean, 0, int(truth.mean.argmin())
    for repetition in range(first, first + repetitions):
        scores, side = truth.draw(n, [n, repetition])
        resampled = Resampled.of(scores, side, seed=repetition, samples=samples)
        inference = infer(resampled, ranked=len(mean), baseline=baseline, confidence=CONFIDENCE)
        held.S += all_in(mean, inference.S_low, inference.S_high)
        held.baseline += all_in(
            mean - mean[baseline], inference.baseline_difference_low, inference.baseline_difference_high
        )
        chosen = int(scores.mean(axis=1).argmin())
        held.best += all_in(mean - mean[chosen], inference.difference_low, inference.difference_high)
        held.set_of_best += bool(inference.set_of_best[best])
        held.size += inference.set_of_best.mean()
    return Coverage(*(value / repetitions for value in dataclasses.astuple(held)))


def all_in(truth: np.ndarray, low: np.ndarray, high: np.ndarray) -> bool:
    # the difference of a design to itself is an interval of length 0
    return bool(((low <= truth + 1e-15) & (truth <= high + 1e-15)).all())


@pytest.mark.slow
def test_coverage_at_1000_scenarios() -> None:
    """300 repetitions see a coverage of 0.95 with a standard error of 0.013, from 500 resamples each.
    docs/explanation/statistics.md has the figures of some thousand repetitions."""
    held = coverage(Truth.of(DESIGNS, 0.03), 1_000, repetitions=300, samples=500)
    assert 0.93 <= held.S <= 0.97
    assert 0.93 <= held.baseline <= 0.97
    assert held.best >= 0.93
    assert held.set_of_best >= 0.95
    assert held.size < 0.6  # a set of everything would hold the best too


@pytest.mark.slow
def test_coverage_at_200_scenarios() -> None:
    held = coverage(Truth.of(DESIGNS, 0.03), 200, repetitions=150, samples=500)
    assert held.S >= 0.90
    assert held.baseline >= 0.90
    assert held.best >= 0.93
    assert held.set_of_best >= 0.95


@pytest.fixture
def scores() -> tuple[np.ndarray, np.ndarray]:
    return Truth.of(6, 0.004).draw(300, [7])


def by_hand(values: np.ndarray, side: np.ndarray, seed: int, samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, standard error and resampled means, one design and one resample after the other."""
    weights = np.concatenate(list(weight_blocks(side, samples=samples, seed=seed)))
    n = side.size
    error = np.array([
        np.sqrt(sum((side == s).sum() * np.var(row[side == s], ddof=1) for s in (1, -1))) / n for row in values
    ])  # fmt: skip
    means = np.array([[np.average(row, weights=w) for row in values] for w in weights])
    return values.mean(axis=1), error, means


def reach_by_hand(row: np.ndarray, side: np.ndarray, error: float, c: float) -> tuple[float, float]:
    """How far an interval goes below and above: Edgeworth's terms, one scenario after the other."""
    if error == 0:
        return 0.0, 0.0
    third = 0.0
    for s in (1, -1):
        part = row[side == s]
        third += sum((x - part.mean()) ** 3 for x in part.tolist()) * (part.size / (part.size - 1)) ** 1.5
    g = third / row.size**3 / error**3
    even = c + min(c, g * g * c * (c**4 + 2 * c**2 - 3) / 18)
    odd = g * (1 + 2 * c**2) / 6
    return (even + max(0.0, -odd)) * error, (even + max(0.0, odd)) * error


def test_intervals_are_max_t_by_hand(scores: tuple[np.ndarray, np.ndarray]) -> None:
    """Sums in another order: some roundings of 300 numbers, divided by a standard error."""
    values, side = scores
    resampled = Resampled.of(values, side, seed=4, samples=199)
    for reference in (None, 2):
        shifted = values if reference is None else values - values[reference]
        mean, error, means = by_hand(shifted, side, 4, 199)
        keep = error > 0
        largest = np.sort(np.max(np.abs(means - mean)[:, keep] / error[keep], axis=1))
        # 0.95 of 200 is a whole number: the 190th of 199
        critical = scipy.stats.t.isf(scipy.stats.norm.sf(largest[189]), 298)
        interval = simultaneous_interval(resampled, 0.95, reference)
        np.testing.assert_allclose(interval.centre, mean, rtol=1e-10, atol=1e-15)
        reach = [reach_by_hand(row, side, e, critical) for row, e in zip(shifted, error, strict=True)]
        below, above = np.array(reach).T
        np.testing.assert_allclose(interval.low, mean - below, rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(interval.high, mean + above, rtol=1e-9, atol=1e-15)


def test_the_set_of_best_is_hsus_by_hand(scores: tuple[np.ndarray, np.ndarray]) -> None:
    """Every pair, every resample; no design is so bad here that it could not be the best."""
    values, side = scores
    B, d = 199, len(values)
    separation = separable(values, side, seed=4, confidence=0.95, samples=B)
    single = np.zeros((d, B))
    either = np.zeros(B)
    pairs = {}
    for r in range(d):
        for j in set(range(d)) - {r}:
            mean, error, means = by_hand((values[r] - values[j])[None], side, 4, B)
            t = ((means - mean) / error)[:, 0]
            single[r] = np.maximum(single[r], np.abs(t))
            either = np.maximum(either, np.abs(t))
            pairs[r, j] = mean[0], error[0]
    critical = max(with_tails_of_t(np.sort(row)[189], 298) for row in single)
    of_all = with_tails_of_t(np.sort(either)[189], 298)
    best = separation.best
    low = [max([pairs[i, r][0] - critical * pairs[i, r][1] for r in range(d) if r != i] + [0.0] * (i == best))
           for i in range(d)]  # fmt: skip
    assert separation.best == values.mean(axis=1).argmin()
    np.testing.assert_allclose(separation.critical, critical, rtol=1e-9)
    np.testing.assert_allclose(separation.critical_of_all, of_all, rtol=1e-9)
    np.testing.assert_allclose(separation.low, low, rtol=1e-8, atol=1e-14)
    others = np.arange(d) != separation.best
    reach = [reach_by_hand(values[i] - values[separation.best], side, pairs[i, separation.best][1], of_all)
             for i in range(d) if i != separation.best]  # fmt: skip
    below, above = np.array(reach).T
    np.testing.assert_allclose(separation.high_of_all[others] - separation.difference[others], above, rtol=1e-9)
    np.testing.assert_allclose(separation.difference[others] - separation.low_of_all[others], below, rtol=1e-9)


def test_a_design_beside_others_keeps_every_bit(scores: tuple[np.ndarray, np.ndarray]) -> None:
    """Sums of whole numbers: neither the rows beside a design, nor their order, nor the BLAS decide a bit."""
    values, side = scores
    every = bootstrap_deviations(values, side, samples=100, seed=1)
    for i in range(len(values)):
        alone = bootstrap_deviations(values[i : i + 1], side, samples=100, seed=1)
        np.testing.assert_array_equal(alone[:, 0], every[:, i])
    order = [3, 0, 5, 1, 4, 2]
    one, other = (separable(v, side, seed=1, confidence=0.9, samples=200) for v in (values, values[order]))
    for name in ("mean", "difference", "error", "low", "low_of_all", "high_of_all"):
        np.testing.assert_array_equal(getattr(one, name)[order], getattr(other, name), err_msg=name)
    assert (one.critical, one.critical_of_all) == (other.critical, other.critical_of_all)


@examples(50)
@given(st.integers(1, 60), st.integers(-200, 200), st.integers(0, 10**6))
def test_weighted_sums_on_the_grid_are_exact(n: int, scale: int, seed: int) -> None:
    """Against whole numbers of Python, which never round."""
    generator = np.random.default_rng(seed)
    values = np.ldexp(generator.normal(size=(1, n)), scale)
    grid, unit = exact_grid(values, n)
    # half a unit of 2^-46 or finer of the largest
    assert np.abs(grid * unit - values).max() <= 2.0**-46 * np.abs(values).max()
    weights = generator.multinomial(n, np.full(n, 1.0 / n))
    exact = sum(int(w) * int(x) for w, x in zip(weights, grid[0], strict=True))
    assert int((grid @ weights.astype(float))[0]) == exact


@pytest.mark.slow
def test_few_references_stand_for_many() -> None:
    """60 designs on 100,000 scenarios are too many pairs: 16 are references, critical values nearly the same."""
    generator = np.random.default_rng(5)
    values = generator.exponential(size=100_000) + 0.1 * generator.standard_exponential((60, 100_000))
    some = separable(values, np.repeat([1, -1], 50_000), seed=1, confidence=0.95, samples=200)
    few = separable(values[:, ::8], np.repeat([1, -1], 6_250), seed=1, confidence=0.95, samples=200)
    assert (some.references, few.references) == (100 // 6, few.may_be_best)
    assert some.may_be_best > 16
    assert not some.clear[some.best]
    assert 0.85 * few.critical_of_all < some.critical_of_all < 1.15 * few.critical_of_all


def test_solver_tolerance_is_no_difference() -> None:
    S = np.random.default_rng(0).gamma(2.0, 1.0, 60)
    side = np.repeat([1, -1], 30)
    separation = separable(np.stack([S + 5e-6, S, S + 5e-7, S]), side, seed=1, confidence=0.95, samples=200)
    assert (separation.clear.tolist(), separation.difference[3]) == ([True, False, False, False], 0.0)
    assert separation.low[3] == separation.high_of_all[3] == 0.0


def test_who_cannot_be_the_best_does_not_decide_who_is(scores: tuple[np.ndarray, np.ndarray]) -> None:
    """Designs behind the contenders: compared, but neither best nor a reason to leave the set."""
    values, side = scores
    resampled = Resampled.of(np.concatenate([values, 0.5 * values[:, ::-1] - 0.2]), side, seed=1, samples=200)
    separation = compare_with_best(resampled, 0.95, contenders=6)
    alone = compare_with_best(Resampled.of(values, side, seed=1, samples=200), 0.95)
    assert (separation.best, separation.critical) == (alone.best, alone.critical)
    assert separation.critical_of_all > alone.critical_of_all  # one more interval that has to hold
    np.testing.assert_array_equal(separation.low[:6], alone.low)
    assert (separation.difference[6:] < -0.1).all()
    assert (separation.low_of_all < separation.difference)[6:].all()
    assert (separation.high_of_all[6:] < 0).all()


@pytest.mark.parametrize("n", [1, 2, 3, 40])
def test_a_side_of_one_scenario_has_no_interval_and_tells_nothing_apart(n: int) -> None:
    values = np.arange(4.0 * n).reshape(4, n) ** 2
    values[3] = values[1]
    side = np.where(np.arange(n) < 1, 1, -1)
    inference = infer(Resampled.of(values, side, seed=0, samples=100), ranked=4, baseline=1, confidence=0.95)
    assert inference.set_of_best.all()
    assert (inference.S_low == -np.inf).all()
    assert (inference.S_high == np.inf).all()
    assert inference.difference_low.tolist() == [0.0, *[-np.inf] * 3]
    assert inference.difference_high.tolist() == [0.0, *[np.inf] * 3]
    # the difference of equal scores is known
    assert inference.baseline_difference_low.tolist() == [-np.inf, 0.0, -np.inf, 0.0]
    assert inference.baseline_difference_high.tolist() == [np.inf, 0.0, np.inf, 0.0]


def test_two_scenarios_of_each_side_have_intervals() -> None:
    values = np.arange(12.0).reshape(3, 4) ** 2
    resampled = Resampled.of(values, np.array([1, 1, -1, -1]), seed=0, samples=100)
    inference = infer(resampled, ranked=3, baseline=1, confidence=0.95)
    for field in dataclasses.fields(inference):
        assert np.isfinite(getattr(inference, field.name)).all(), field.name
    assert inference.set_of_best[0]


def test_frequencies_are_shared_by_equals_and_sum_to_one() -> None:
    S = np.random.default_rng(0).gamma(2.0, 1.0, (2, 80))
    side = np.repeat([1, -1], 40)
    values = np.stack([S[0], S[0], S[1], S[0], S[1] + 9.0])
    inference = infer(Resampled.of(values, side, seed=0, samples=300), ranked=5, baseline=None, confidence=0.95)
    means = np.concatenate(list(weight_blocks(side, samples=300, seed=0))) @ S.T
    first = (means[:, 0] < means[:, 1]).mean()
    np.testing.assert_allclose(inference.best_frequency, [first / 3, first / 3, 1 - first, first / 3, 0.0], atol=1e-12)
    assert 0 < first < 1
    assert np.isnan(inference.baseline_difference).all()


@pytest.mark.parametrize("confidence", [0.0, 1.0, -0.1, 1.1, float("nan")])
def test_a_confidence_outside_its_range_is_refused(confidence: float) -> None:
    with pytest.raises(InputError, match="confidence"):
        separable(np.ones((2, 4)), np.array([1, 1, -1, -1]), seed=0, confidence=confidence, samples=100)


def test_no_resamples_are_refused() -> None:
    with pytest.raises(InputError, match="0 samples"):
        separable(np.ones((2, 4)), np.array([1, 1, -1, -1]), seed=0, confidence=0.9, samples=0)
