"""Departures kept with their signals: the right ones, whatever the split."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from ldctoolkit.departures import LEFT, RIGHT, DepartureSignals, reduce_signals
from ldctoolkit.recordings import Criteria, Drawn, Preparation, Recording
from ldctoolkit.recordings.departures_table import combined_results
from ldctoolkit.recordings.extract import extract_items
from ldctoolkit.recordings.quality import KEPT

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
    result = extract_items(drives(40 * sources, sources), CRITERIA, Preparation())
    d = result.departures
    assert d.n > 60
    of = next(column.values for column in d.extra if column.name == "source")
    groups = [(f"s{i}", side) for i in range(sources) for side in (LEFT, RIGHT)]
    for source, side in groups:
        mine = (of == source) & (d.side == side)
        assert mine.sum() > KEPT
        kept = [one for one in result.drawn.deepest if (one.source, one.side) == (source, side)]
        depths = [float(one.parameters[1]) for one in kept]
        assert depths == sorted(d.d_y[mine].tolist(), reverse=True)[:KEPT]
        lots = [one for one in result.drawn.by_lot if (one.source, one.side) == (source, side)]
        assert (len(lots), [one.lot for one in lots]) == (KEPT, sorted(one.lot for one in lots))
        assert {(one.recording, one.start_time) for one in lots} != {(one.recording, one.start_time) for one in kept}
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert list(dict.fromkeys((one.source, one.side) for one in events)) == groups
        assert len(events) == KEPT * len(groups)


def test_a_side_with_few_keeps_all_and_takes_nothing_from_the_other():
    """Left departures are far deeper and many; the five to the right are all kept."""
    recordings = drives(30, 1)
    for i, one in enumerate(recordings):
        offset = np.where(one.lane_offset > 0.0, one.lane_offset + 0.2, one.lane_offset * (i < 5))
        recordings[i] = dataclasses.replace(one, lane_offset=offset)
    result = extract_items(recordings, CRITERIA, Preparation())
    right = result.departures.d_y[result.departures.side == RIGHT]
    assert 0 < right.size <= 5
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert [one.side for one in events] == [LEFT] * KEPT + [RIGHT] * right.size
        assert sorted(float(one.parameters[1]) for one in events if one.side == RIGHT) == sorted(right.tolist())


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
    assert signatures(combined_results(parts).drawn) == signatures(whole)
    # in any order: the same ones, but for the order of the sources
    turned = signatures(combined_results(parts[::-1]).drawn)
    assert [sorted(one) for one in turned] == [sorted(one) for one in signatures(whole)]


def test_the_lot_is_blind():
    """A lot is sorted neither by name nor by depth; 600 departures, drawn of 25 sources and two sides."""
    result = extract_items(drives(600, 25, seed=5), CRITERIA, Preparation())
    lots = result.drawn.by_lot
    assert len(lots) == 2 * 25 * KEPT
    order = np.tile(np.arange(KEPT), 2 * 25)
    limit = 4.0 / np.sqrt(len(lots))  # four standard deviations of the correlation of unrelated numbers
    for values in ([int(one.recording[1:]) for one in lots], [float(one.parameters[1]) for one in lots]):
        assert abs(np.corrcoef(values, order)[0, 1]) < limit
    # the drawn ones are about as deep as all
    d_y = result.departures.d_y
    mean = np.mean([one.parameters[1] for one in lots])
    assert abs(mean - d_y.mean()) < 4.0 * d_y.std() / np.sqrt(len(lots))


def test_equal_depths_are_told_apart_by_name_and_time():
    one = drives(1, 1)[0]
    recordings = [dataclasses.replace(one, name=f"twin{i:02d}") for i in range(30)]
    forward = extract_items(recordings, CRITERIA, Preparation()).drawn
    backward = extract_items(recordings[::-1], CRITERIA, Preparation()).drawn
    assert signatures(forward) == signatures(backward)
    assert [event.recording for event in forward.deepest] == 2 * [f"twin{i:02d}" for i in range(KEPT)]


def test_none():
    assert extract_items([], CRITERIA, Preparation()).drawn == Drawn()
