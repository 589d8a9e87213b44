"""The Pareto front against all pairs, one after the other."""

import tracemalloc

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit.errors import InputError, UnknownNameError
from studies.ranking.design_metrics import pareto_costs, pareto_front


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


def test_costs_turn_figures_of_which_more_is_better() -> None:
    columns = {"S": np.array([1.0, 2.0, 2.0]), "within_dtle": np.array([0.5, 0.9, 0.5])}
    costs = pareto_costs(["S", "dtle_0p3_share"], columns)
    assert costs.tolist() == [[1.0, -0.5], [2.0, -0.9], [2.0, -0.5]]
    assert pareto_front(costs).tolist() == [True, True, False]
    with pytest.raises(UnknownNameError, match="did you mean 'S'"):
        pareto_costs(["SS"], columns)
    with pytest.raises(InputError, match="no figures"):
        pareto_costs([], columns)
