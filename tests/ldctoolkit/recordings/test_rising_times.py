"""The longest choice of rows whose times do not fall, against trying every choice."""

import itertools

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.preparation import rising_rows


def by_trial(times: list[int]) -> list[bool]:
    """Of all choices that do not fall a longest one; among these the one whose row numbers come first."""
    for length in range(len(times), 0, -1):
        for rows in itertools.combinations(range(len(times)), length):  # in the order of row numbers
            if all(times[a] <= times[b] for a, b in itertools.pairwise(rows)):
                return [row in rows for row in range(len(times))]
    return []


@examples(400)
@given(st.lists(st.integers(-3, 6), max_size=11))
def test_every_choice(times: list[int]) -> None:
    assert rising_rows(np.array(times, dtype=float)).tolist() == by_trial(times)
