"""Tables in blocks: no figure of a ranking depends on how large they are, not in the last bit."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from studies import Case, CaseResults, Design, Ranking, StudyResults
from studies.ranking import bootstrap, release, resampled, row_blocks


def invented(d: int, n: int) -> StudyResults:
    """Some scenarios cannot be driven, some fail, two designs are equal; two of them are finalists on others."""
    generator = np.random.default_rng(5)
    designs = (
        Design.from_gains("none", 0.2, {}),
        *(Design.from_gains("lqr", 0.1 + 0.01 * i, {}) for i in range(d - 1)),
    )

    def sample(some: tuple[Design, ...]) -> StudyResults:
        size = len(some)
        depth = generator.gamma(1.0, 1.0, n)
        S = (0.3 + 0.1 * generator.random(size))[:, None] * depth + 0.05 * generator.gamma(0.5, 2.0, (size, n))
        S[-1] = S[1 % size]
        chances = (0.85, 0.1, 0.05)
        kinds = (EventStatus.OK, EventStatus.NEVER_TRIGGERED, EventStatus.SOLVER_FAILED)
        status = generator.choice(np.array(kinds, dtype=np.int8), (size, n), p=chances)
        status[:, :2], S[:, :2] = EventStatus.INVALID, np.nan
        companions: dict[str, Any] = {name: generator.gamma(2.0, 1.0, (size, n)) for name in COMPANION_UNITS}
        case = CaseResults(
            case=Case("departure", "consistent"),
            S=S,
            S_uncorrected=np.broadcast_to(depth, S.shape),
            status=status,
            companions=Companions(**companions),
            failed_solves=(generator.random((size, n)) < 0.1).astype(np.int32),
            law_time=np.zeros(size),
        )
        side = np.where(np.arange(n) < 0.6 * n, 1, -1)
        scenarios = Scenarios.from_arrays(T=2.0, d_y=generator.gamma(2.0, 0.3, n), v_mean=20.0, side=side)
        return StudyResults(some, scenarios, (case,))

    return dataclasses.replace(sample(designs), fresh=sample((designs[1], designs[3])))


def ranked(results: StudyResults) -> dict[str, bytes]:
    ranking = Ranking.of(results, results.cases[0], bootstrap=50, require=("a_y_peak_p95 <= 6",), pareto=("S",))
    parts = {"": ranking, "release": ranking.release}
    found = {
        f"{which}.{field.name}": getattr(part, field.name)
        for which, part in parts.items()
        for field in dataclasses.fields(part)
    }
    return {name: value.tobytes() for name, value in found.items() if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("entries", [1, 300, 1000])
def test_no_figure_depends_on_the_size_of_a_block(monkeypatch: pytest.MonkeyPatch, entries: int) -> None:
    results = invented(40, 100)
    whole = ranked(results)
    assert len(whole) > 60
    monkeypatch.setattr(row_blocks, "_BLOCK_ENTRIES", entries)
    monkeypatch.setattr(bootstrap, "_GRID_ENTRIES", entries)
    monkeypatch.setattr(bootstrap, "_KEPT_ENTRIES", entries)
    monkeypatch.setattr(resampled, "_KEPT_ENTRIES", 0)
    monkeypatch.setattr(release, "_BLOCK_ENTRIES", entries)
    parted = ranked(invented(40, 100))
    assert [name for name in whole if parted[name] != whole[name]] == []


@given(st.integers(1, 9), st.integers(0, 4), st.integers(1, 40), st.data())
def test_blocks_are_the_rows_that_were_asked_for(d: int, n: int, entries: int, data: st.DataObject) -> None:
    values = np.arange(d * n, dtype=np.float64).reshape(d, n)
    rows = data.draw(st.none() | st.lists(st.integers(0, d - 1), min_size=1).map(np.array))
    wanted = values if rows is None else values[rows]
    found = np.full(wanted.shape, -1.0)
    for places, block in row_blocks.row_blocks(values, rows, entries=entries):
        assert block.size <= max(entries, n)
        found[places] = block
    np.testing.assert_array_equal(found, wanted)


def test_counted_is_s_or_what_is_worse_without_control() -> None:
    case = invented(6, 50).cases[0]
    failed = case.status == EventStatus.SOLVER_FAILED
    assert failed.any()
    wanted = np.where(failed, np.fmax(case.S, case.S_uncorrected), case.S)
    np.testing.assert_array_equal(case.counted, wanted)
    assert case.counted is case.counted
    fine = dataclasses.replace(case, status=np.where(failed, EventStatus.OK, case.status).astype(np.int8))
    assert fine.counted is fine.S


def test_one_row_of_scores_without_control_stays_one() -> None:
    case = invented(6, 50).cases[0]
    columns = np.arange(50) % 2 > 0
    taken = case.take(columns)
    assert taken.S_uncorrected.strides[0] == 0
    np.testing.assert_array_equal(taken.S_uncorrected, case.S_uncorrected[:, columns])
