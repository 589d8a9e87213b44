from __future__ import annotations

import numpy as np
import pytest

from controllers import LQR, PreviewProportional
from ldctoolkit import Scenarios
from ldctoolkit.errors import InputError
from studies.design import Design
from studies.report.replay.asked import asked_departures, asked_designs

DESIGNS = [Design.of(LQR(), y_s) for y_s in (0.05, 0.1, 0.2)] + [Design.of(PreviewProportional(), 0.2)]


def without_row_2() -> Scenarios:
    every = Scenarios.from_arrays(T=[2.0, 3.0, 4.0, 5.0], d_y=0.3, v_mean=25.0)
    return every.take(np.array([3, 0, 1]))


def test_departures_are_found_by_their_numbers_not_their_rows() -> None:
    assert asked_departures(without_row_2(), [3, 1, 3]) == (0, 2)
    assert asked_departures(without_row_2(), []) == ()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (9, "departure: 9; allowed: 0 to 3, the nearest is 3"),
        (2, "departure: 2; it is a scenario that cannot be driven"),
    ],
)
def test_other_numbers_are_refused(number: int, words: str) -> None:
    with pytest.raises(InputError, match=words):
        asked_departures(without_row_2(), [1, number])


def test_designs_are_found_by_the_beginning_of_their_ids() -> None:
    ids = [design.id for design in DESIGNS]
    assert asked_designs(DESIGNS, [ids[2], ids[0][:10].upper(), ids[2][:11]]) == (2, 0)


@pytest.mark.parametrize("prefix", ["zzz", ""])
def test_unknown_designs_are_refused_with_a_near_one(prefix: str) -> None:
    with pytest.raises(
        InputError, match=rf"design: '{prefix}'; no design begins like this, the nearest is [0-9a-f]{{12}}"
    ):
        asked_designs(DESIGNS, [prefix])


def test_a_near_identifier_is_the_one_that_is_meant() -> None:
    wanted = DESIGNS[1].id
    for given in ("x" + wanted[1:], wanted[:5] + "x"):
        with pytest.raises(InputError, match=f"nearest is {wanted}"):
            asked_designs(DESIGNS, [given])


def test_a_beginning_of_several_is_refused() -> None:
    many = [Design.of(LQR(), 0.01 * k) for k in range(1, 40)]
    first = max("0123456789abcdef", key=lambda digit: sum(d.id.startswith(digit) for d in many))
    count = sum(d.id.startswith(first) for d in many)
    assert count > 1
    with pytest.raises(InputError, match=f"{count} designs begin like this"):
        asked_designs(many, [first])
