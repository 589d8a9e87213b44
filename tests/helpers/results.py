"""Comparison of the results of two runs of a study."""

from __future__ import annotations

import dataclasses

from helpers.bits import assert_same_bits
from studies import CaseResults, StudyResults


def assert_same_results(one: StudyResults, other: StudyResults) -> None:
    """Fail unless designs, scenarios and every number have the same bits; times, which no run gives again, aside."""
    assert one.designs == other.designs
    assert_same_bits(one.scenarios, other.scenarios)
    for a, b in zip(one.cases, other.cases, strict=True):
        for field in dataclasses.fields(CaseResults):
            if field.name != "law_time":
                assert_same_bits(getattr(a, field.name), getattr(b, field.name), f"{a.case.label}: {field.name}")
