import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.spmd_das1 import nearest_rows

Rows = list[tuple[int, float]]

near = st.integers(0, 60).map(float)
fine = st.integers(0, 3000).map(lambda value: value / 100.0)
far = st.sampled_from([-1e9, -7.0, 0.0, 99.0, 1e9, 1e10])
rows = st.lists(st.tuples(st.integers(0, 4), st.one_of(near, fine, far)), max_size=40).map(sorted)


def by_hand(left: Rows, right: Rows, tolerance: float) -> list[int]:
    """Every pair looked at; the earliest of those that are nearest."""
    result = []
    for trip, t in left:
        best = -1
        for i, (other, u) in enumerate(right):
            if other == trip and abs(u - t) <= tolerance and (best < 0 or abs(u - t) < abs(right[best][1] - t)):
                best = i
        result.append(best)
    return result


def columns(given_rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    return np.array([row[0] for row in given_rows], dtype=np.int64), np.array(
        [row[1] for row in given_rows], dtype=float
    )


@examples(400)
@given(left=rows, right=rows, tolerance=st.sampled_from([5.0, 0.5, 7.25, 40.0]))
def test_the_join_is_that_of_all_pairs(left: Rows, right: Rows, tolerance: float) -> None:
    assert nearest_rows(*columns(left), *columns(right), tolerance).tolist() == by_hand(left, right, tolerance)


def test_long_drives_keep_their_digits() -> None:
    t = np.tile(np.arange(0.0, 8.64e6, 80.0), 3)
    trip = np.repeat(np.arange(3), t.size // 3)
    shift = np.random.default_rng(1).uniform(-4.99, 4.99, t.size).round(2)
    assert nearest_rows(trip, t, trip, t + shift, 5.0).tolist() == list(range(t.size))
