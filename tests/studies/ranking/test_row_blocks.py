"""Tables larger than a block: every row is as if it stood alone, to the last bit."""

import dataclasses

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from helpers.results import case_of
from ldctoolkit import EventStatus
from studies import CaseResults
from studies.ranking.design_metrics import tail_metrics
from studies.ranking.inference import bootstrap_deviations, row_blocks, row_means


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


def invented() -> CaseResults:
    generator = np.random.default_rng(5)
    kinds = np.array([EventStatus.OK, EventStatus.SOLVER_FAILED], dtype=np.int8)
    case = case_of(generator.gamma(1.0, 1.0, (6, 50)), status=generator.choice(kinds, (6, 50), p=(0.9, 0.1)))
    depth = generator.gamma(1.0, 1.0, 50)
    return dataclasses.replace(case, S_uncorrected=np.broadcast_to(depth, case.S.shape))


def test_counted_is_s_or_what_is_worse_without_control() -> None:
    case = invented()
    failed = case.status == EventStatus.SOLVER_FAILED
    assert failed.any()
    wanted = np.where(failed, np.fmax(case.S, case.S_uncorrected), case.S)
    np.testing.assert_array_equal(case.counted, wanted)
    assert case.counted is case.counted
    fine = dataclasses.replace(case, status=np.zeros_like(case.status))
    assert fine.counted is fine.S


def test_one_row_of_scores_without_control_stays_one() -> None:
    case = invented()
    columns = np.arange(50) % 2 > 0
    taken = case.take(columns)
    assert taken.S_uncorrected.strides[0] == 0
    np.testing.assert_array_equal(taken.S_uncorrected, case.S_uncorrected[:, columns])
