"""Reduction against no control: where its spread is not known, it has no interval."""

from __future__ import annotations

import math

import numpy as np
import pytest

from studies.report.tables.reduction import ratio_interval
from studies.report.words.prose import between_percent


@pytest.mark.parametrize("side", [[1], [1, -1], [1, 1, 1, -1]])
def test_a_side_of_one_departure_leaves_the_ends_unknown(side: list[int]) -> None:
    S_0 = np.arange(1.0, 1.0 + len(side))
    found = ratio_interval(0.75 * S_0 + 0.01 * S_0**2, S_0, np.array(side))
    assert found.value == pytest.approx(0.25 - 0.01 * (S_0**2).sum() / S_0.sum())
    assert math.isnan(found.low)
    assert math.isnan(found.high)
    assert between_percent(found) == "not known"


def test_two_of_each_side_have_an_interval() -> None:
    found = ratio_interval(np.array([1.0, 1.5, 2.0, 2.0]), np.array([2.0, 2.0, 3.0, 4.0]), np.array([1, 1, -1, -1]))
    assert found.low < found.value < found.high
