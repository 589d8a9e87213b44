"""Results of a study whose scores are given, for tests of what is made of them."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from helpers.bits import assert_same_bits
from ldctoolkit import Outcome, Scenarios
from ldctoolkit.metrics import MetricValues
from studies import Case, CaseResults, Design, StudyResults

DEPARTURE, CONTROL = Case("departure", "consistent"), Case("control", "consistent")


def case_of(
    S: np.ndarray, *, case: Case = DEPARTURE, uncorrected: npt.ArrayLike = 9.0, status: npt.ArrayLike = 0,
    metrics: Mapping[str, npt.ArrayLike] | None = None,
) -> CaseResults:  # fmt: skip
    """Scores S (d, n); every other metric is 0 unless it is given, the score without control 9 m s."""
    given = dict.fromkeys((field.name for field in dataclasses.fields(MetricValues)), 0.0) | dict(metrics or {})
    companions: dict[str, Any] = {
        name: np.array(np.broadcast_to(value, S.shape), dtype=np.float32) for name, value in given.items()
    }
    return CaseResults(
        case=case,
        S=S,
        S_uncorrected=np.array(np.broadcast_to(np.asarray(uncorrected, dtype=np.float64), S.shape)),
        status=np.array(np.broadcast_to(np.asarray(status, dtype=np.int8), S.shape)),
        companions=MetricValues(**companions),
        failed_solves=np.zeros(S.shape, dtype=np.int32),
        law_time=np.full(len(S), np.nan),
    )


def case_of_outcomes(outcomes: Sequence[Outcome], case: Case = DEPARTURE) -> CaseResults:
    """What `simulate` gave for each design."""
    arrays = {
        name: np.stack([getattr(one, name) for one in outcomes])
        for name in ("S", "S_uncorrected", "status", "failed_solves")
    }
    names = [field.name for field in dataclasses.fields(MetricValues)]
    companions = {name: np.stack([getattr(one.companions, name) for one in outcomes]) for name in names}
    return CaseResults(case, **arrays, companions=MetricValues(**companions), law_time=np.zeros(len(outcomes)))


def scenarios_of(n: int, left: int | None = None) -> Scenarios:
    """Scenarios of which only side matters; half of them to the left unless that is given."""
    side = np.where(np.arange(n) < (n // 2 if left is None else left), 1, -1)
    return Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=20.0, side=side)


def results_of(
    S: np.ndarray, designs: Sequence[Design], *, left: int | None = None, cases: Sequence[Case] = (DEPARTURE,),
    parts: Mapping[str, Any] | None = None, **more: Any,
) -> StudyResults:  # fmt: skip
    """Scores (d, n) of d designs, the same in every case; `parts` go to `StudyResults`, the others to `case_of`."""
    found = tuple(case_of(S, case=case, **more) for case in cases)
    return StudyResults(tuple(designs), scenarios_of(S.shape[1], left), found, **dict(parts or {}))


def assert_same_results(one: StudyResults, other: StudyResults) -> None:
    """Fail unless designs, scenarios and every number have the same bits; times, which no run gives again, aside."""
    assert one.designs == other.designs
    assert_same_bits(one.scenarios, other.scenarios)
    for a, b in zip(one.cases, other.cases, strict=True):
        for field in dataclasses.fields(CaseResults):
            if field.name != "law_time":
                assert_same_bits(getattr(a, field.name), getattr(b, field.name), f"{a.case.label}: {field.name}")
