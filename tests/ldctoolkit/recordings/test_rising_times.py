"""The longest choice of rows whose times do not fall, against trying every choice."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.recordings.rising_times import rising_rows


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


STEPS = np.arange(600) * 0.1


@pytest.mark.parametrize(
    ("changed", "left"),
    [
        ({300: 900.0, 301: 900.1}, [300, 301]),  # two neighbours ahead
        ({300: 900.0, 301: 900.0}, [300, 301]),
        ({200: 900.0, 400: 0.05}, [200, 400]),  # one ahead, one behind
        ({0: 900.0, 599: -1.0}, [0, 599]),  # at the ends
        ({300: 30.1, 301: 30.0}, [301]),  # changed places
        ({300: STEPS[299]}, []),  # a repeated time
        ({300: -1e9, 301: 1e9, 302: -1e9}, [300, 301, 302]),
    ],
)
def test_a_few_odd_rows_cost_themselves_alone(changed: dict[int, float], left: list[int]) -> None:
    t = STEPS.copy()
    t[list(changed)] = list(changed.values())
    assert np.flatnonzero(~rising_rows(t)).tolist() == left


def test_no_rows_and_one() -> None:
    assert rising_rows(np.empty(0)).tolist() == []
    assert rising_rows(np.array([3.0])).tolist() == [True]
