# ruff: noqa: RUF001 - the page shows true minus signs
"""Rivals of the first: ranked ones, apart where the interval leaves zero out on either side."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from helpers.reports import report_input
from studies.ranking.ranking import Ranking
from studies.report.context import Context
from studies.report.tables.rivals import Rival, rivals
from studies.report.tables.row import Interval
from studies.report.words.enough_scenarios import enough_sentence
from studies.results import StudyResults


def test_designs_that_miss_a_requirement_are_no_rivals(results: StudyResults) -> None:
    one = dataclasses.replace(results, cases=results.cases[:1])
    S = np.sort(one.cases[0].S.mean(axis=1))
    for require, ranked in (
        (f"S >= {float(S[-2:].mean())!r}", 1),
        (f"S >= {float(S[-3:-1].mean())!r}", 2),
        ("S <= 0", 0),
    ):
        ranking = Ranking.of(one, one.cases[0], bootstrap=100, require=[require])
        assert ranking.ranked == ranked
        context = Context.of(dataclasses.replace(report_input(one), rankings=(ranking,)))
        found = rivals(context)
        assert all(rival.row.rank for rival in found) == (ranked > 0)
        assert bool(found) == (ranked != 1)


@pytest.mark.parametrize(
    ("difference", "apart", "words"),
    [
        (Interval(0.2, 0.1, 0.3), True, "0.200 m·s above that of the winner, difference +0.100 to +0.300"),
        (Interval(-0.2, -0.3, -0.1), True, "0.200 m·s below that of the winner, difference −0.300 to −0.100"),
        (Interval(-0.2, -0.5, 0.1), False, "0.200 m·s below that of the winner, difference −0.500 to +0.100"),
        (Interval(3.21e-4, -1e-4, 7.4e-4), False, "3.2e−04 m·s above that of the winner, difference −1.0e−04 to"),
    ],
)
def test_apart_means_that_zero_is_outside(results: StudyResults, difference: Interval, apart: bool, words: str) -> None:
    context = Context.of(report_input(results))
    rival: Rival = dataclasses.replace(rivals(context)[0], difference=difference)
    assert rival.apart == apart
    said = enough_sentence(rival, "the winner", 100).striptags()
    assert words in said
    assert ("They are told apart" in said) == apart
