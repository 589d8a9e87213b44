"""A table whose rows are mostly one and the same, against a plain array."""

from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from studies.storage.run_table import SharedRows

D, N = 4, 6


@given(
    st.lists(
        st.tuples(
            st.integers(0, D - 1),
            st.one_of(st.slices(N).filter(lambda s: s.step in (None, 1)), st.lists(st.integers(0, N - 1), unique=True)),
            st.integers(0, 9),
        ),
        max_size=20,
    ),
    st.integers(0, 20),
)
def test_it_holds_what_was_put_in(steps: list[tuple[int, Any, int]], grown_at: int) -> None:
    """Nine of ten steps write the same row, -0.0 and NaN in it; a value that is put twice is the same twice."""
    usual = np.array([0.0, -0.0, np.nan, 3.0, np.inf, 5.0])
    rows, plain, there = SharedRows(D, N), np.zeros((2 * D, N)), np.zeros((2 * D, N), dtype=bool)
    size = D
    for k, (place, columns, odd) in enumerate(steps):
        if k == grown_at:
            size = 2 * D
            rows.grow(size)
        if isinstance(columns, list):
            columns = np.array(columns, dtype=np.int64)
        values = usual[columns] if odd else usual[columns] + 1.0
        rows.put(place, columns, values)
        plain[place, columns], there[place, columns] = values, True
    found = rows.take(None)
    assert found.shape == (size, N)
    same = found.view(np.int64) if found.strides[0] else np.ascontiguousarray(found).view(np.int64)
    assert (same == plain[:size].view(np.int64))[there[:size]].all()
    some, columns = np.array([2, 0]), np.array([5, 1])
    np.testing.assert_array_equal(rows.take(some, columns), found[some][:, columns])


def test_equal_rows_are_kept_once() -> None:
    rows = SharedRows(3, 2)
    for place in range(3):
        rows.put(place, slice(0, 2), np.array([np.nan, 1.0]))
    assert rows.take(None).strides == (0, 8)
    rows.put(1, np.array([1]), np.array([2.0]))
    np.testing.assert_array_equal(rows.take(None), [[np.nan, 1.0], [np.nan, 2.0], [np.nan, 1.0]])
