"""The Pareto front against all pairs, one after the other."""

from __future__ import annotations

import tracemalloc

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit.errors import InputError, UnknownNameError
from studies.ranking.pareto import pareto_costs, pareto_front


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
    """Large enough that the divide and conquer divides."""
    costs = np.random.default_rng(seed).integers(values, size=(d, k)).astype(float)
    costs[costs == 0], costs[costs == values - 1] = -np.inf, np.inf
    smaller = (costs[:, None] <= costs[None]).all(axis=2) & (costs[:, None] < costs[None]).any(axis=2)
    assert pareto_front(costs).tolist() == (~smaller.any(axis=0)).tolist()


@pytest.mark.parametrize("k", [4, 5, 6])
@pytest.mark.parametrize("seed", range(3))
def test_large_fronts_with_a_column_of_few_values(k: int, seed: int) -> None:
    """Points near a simplex, many of them dominated from afar, with two columns in which most numbers are the same."""
    generator = np.random.default_rng(seed)
    points = generator.dirichlet(np.ones(k), size=1500) * generator.choice([1.0, 1.1, 1.3], size=(1500, 1))
    points[:, 1] = generator.random(1500) < 0.8
    points[:, 2] = generator.choice([0.0, 0.5, 0.5, 0.5], size=1500)
    points = generator.permutation(points, axis=1)
    smaller = (points[:, None] <= points[None]).all(axis=2) & (points[:, None] < points[None]).any(axis=2)
    assert pareto_front(points).tolist() == (~smaller.any(axis=0)).tolist()


@pytest.mark.parametrize("k", [3, 4, 5])
def test_a_front_that_holds_everything(k: int) -> None:
    """Points of the simplex: none dominates another."""
    points = np.random.default_rng(k).dirichlet(np.ones(k), size=3000)
    whole = np.round(points * 2**30)
    whole[:, 0] = 2**31 - whole[:, 1:].sum(axis=1)  # the same sum exactly
    assert pareto_front(whole).all()
    assert pareto_front(np.r_[whole, whole + 1.0]).tolist() == [True] * 3000 + [False] * 3000


def test_memory_grows_with_the_number_of_designs_and_not_with_its_square() -> None:
    costs = np.random.default_rng(0).dirichlet(np.ones(4), size=20_000)
    tracemalloc.start()
    pareto_front(costs)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20 * costs.nbytes  # a table of all pairs would take 600 times that


def test_one_column_keeps_all_smallest() -> None:
    costs = np.r_[np.full(3, 2.0), 1.0, np.arange(1.0, 200.0)]
    assert np.flatnonzero(pareto_front(costs[:, None])).tolist() == [3, 4]


def test_nothing_and_wrong_shapes() -> None:
    assert pareto_front(np.zeros((0, 3))).tolist() == []
    assert pareto_front(np.full((2, 2), np.nan)).tolist() == [False, False]
    for shape in ((3,), (3, 0), (2, 2, 2)):
        with pytest.raises(InputError, match="costs: shape"):
            pareto_front(np.zeros(shape))


def test_costs_turn_figures_of_which_more_is_better() -> None:
    columns = {"S": np.array([1.0, 2.0, 2.0]), "within_dtle": np.array([0.5, 0.9, 0.5])}
    costs = pareto_costs(["S", "dtle_0p3_share"], columns)
    assert costs.tolist() == [[1.0, -0.5], [2.0, -0.9], [2.0, -0.5]]
    assert pareto_front(costs).tolist() == [True, True, False]
    with pytest.raises(UnknownNameError, match="did you mean 'S'"):
        pareto_costs(["SS"], columns)
    with pytest.raises(InputError, match="no figures"):
        pareto_costs([], columns)
