"""Departures kept with their signals: the right ones, whatever the split."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from ldctoolkit.departures import LEFT, RIGHT, DepartureSignals, reduce_signals
from ldctoolkit.recordings import Criteria, Drawn, Preparation, Recording
from ldctoolkit.recordings.drawn import KEPT
from ldctoolkit.recordings.extract_part import extract_items
from ldctoolkit.recordings.part_result import joined_results

CRITERIA = Criteria(1.8)
T = np.arange(200) * 0.1


def drives(count: int, sources: int, seed: int = 0) -> list[Recording]:
    """Two departures each, one to either side, of random depth."""
    rng = np.random.default_rng(seed)
    made = []
    for i in range(count):
        offset = np.zeros(200)
        for start, side in ((5.0, 1.0), (15.0, -1.0)):
            bump = rng.uniform(0.05, 0.6) * (1.0 - ((T - start) / rng.uniform(0.5, 2.0)) ** 2)
            offset += side * np.where(np.abs(T - start) < 5.0, 0.9 + np.clip(bump, -0.5, None), 0.0)
        columns: dict[str, Any] = {"lane_offset": offset, "lane_width": np.full(200, 3.6)}
        columns |= {"speed": 25.0 + 0.01 * T, "valid": np.ones(200, bool), "curvature": rng.normal(0.0, 1e-3, 200)}
        made.append(Recording(f"r{i}", T, **columns, source=f"s{i % sources}"))
    return made


def signatures(drawn: Drawn) -> list[list[tuple[Any, ...]]]:
    return [
        [
            (
                *(one.source, one.recording, one.side, one.start_time, one.lot, *one.parameters.tolist()),
                *(getattr(one, name).tobytes() for name in ("t", "y", "v", "c")),
            )
            for one in events
        ]
        for events in (drawn.deepest, drawn.by_lot)
    ]


@pytest.mark.parametrize("sources", [1, 3])
def test_the_deepest_are_the_deepest(sources):
    result = extract_items(drives(40, sources), CRITERIA, Preparation())
    d = result.departures
    assert d.n > 60
    of = next(column.values for column in d.extra if column.name == "source")
    for source in (f"s{i}" for i in range(sources)):
        kept = [one for one in result.drawn.deepest if one.source == source]
        depths = [float(one.parameters[1]) for one in kept]
        assert depths == sorted(d.d_y[of == source].tolist(), reverse=True)[:KEPT]
        lots = [one for one in result.drawn.by_lot if one.source == source]
        assert len(lots) == min(KEPT, int((of == source).sum()))
        assert [one.lot for one in lots] == sorted(one.lot for one in lots)
        assert {(one.recording, one.start_time) for one in lots} != {(one.recording, one.start_time) for one in kept}


def test_signals_are_the_departures_own():
    """Reduced again, they give the parameters; both sides are outward."""
    result = extract_items(drives(10, 1), CRITERIA, Preparation())
    d = result.departures
    assert {one.side for one in result.drawn.by_lot} == {LEFT, RIGHT}
    for one in (*result.drawn.deepest, *result.drawn.by_lot):
        row = np.flatnonzero((d.recording == one.recording) & (d.start_time == one.start_time) & (d.side == one.side))
        assert row.size == 1
        np.testing.assert_array_equal(d.matrix()[row[0]], one.parameters)
        signals = DepartureSignals(np.array([0, one.t.size]), one.t, one.y, one.v, one.c)
        np.testing.assert_allclose(
            reduce_signals(signals, [one.side]).matrix()[0], one.parameters, rtol=1e-9, atol=1e-12
        )
        assert one.t[0] == one.y[0] == one.y[-1] == 0.0
        assert (one.y[1:-1] > 0.0).all()


@pytest.mark.parametrize("cuts", [[1], [5, 11], [3, 4, 20, 39], list(range(1, 40))])
def test_any_split_keeps_the_same(cuts):
    recordings = drives(40, 2)
    whole = extract_items(recordings, CRITERIA, Preparation()).drawn
    ends = zip([0, *cuts], [*cuts, 40], strict=True)
    parts = [extract_items(recordings[a:b], CRITERIA, Preparation()) for a, b in ends]
    assert signatures(joined_results(parts).drawn) == signatures(whole)


def test_the_lot_is_blind():
    """The share of left departures among the drawn is that of all, about; a lot is not sorted by time or name."""
    result = extract_items(drives(300, 25, seed=5), CRITERIA, Preparation())
    lots = result.drawn.by_lot
    assert len(lots) == 25 * KEPT
    left = np.mean([one.side == LEFT for one in lots])
    assert abs(left - np.mean(result.departures.side == LEFT)) < 3.0 * 0.5 / np.sqrt(len(lots))
    names = [int(one.recording[1:]) for one in lots]
    assert abs(np.corrcoef(names, range(len(names)))[0, 1]) < 0.3


def test_equal_depths_are_told_apart_by_name_and_time():
    one = drives(1, 1)[0]
    recordings = [dataclasses.replace(one, name=f"twin{i:02d}") for i in range(30)]
    forward = extract_items(recordings, CRITERIA, Preparation()).drawn
    backward = extract_items(recordings[::-1], CRITERIA, Preparation()).drawn
    assert signatures(forward) == signatures(backward)
    assert [event.recording for event in forward.deepest] == [f"twin{i:02d}" for i in range(KEPT)]


def test_none():
    assert extract_items([], CRITERIA, Preparation()).drawn == Drawn()
