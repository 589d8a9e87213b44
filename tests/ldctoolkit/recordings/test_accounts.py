"""The account of an extraction, and the events that are kept to be looked at."""

import dataclasses
import sys
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import assert_same_bits, examples
from helpers.recordings import drive
from ldctoolkit.departures import LEFT, RIGHT, DepartureSignals, ExtraColumn, reduce_signals
from ldctoolkit.recordings import Criteria, Drawn, Label, PartResult, Preparation, Recording, Refused
from ldctoolkit.recordings.departures_table import combined_results
from ldctoolkit.recordings.extract import extract_departures, extract_items, merge_results
from ldctoolkit.recordings.extraction_statistics import EXAMPLES, WIDTH_BINS, share_of_widths
from ldctoolkit.recordings.find_departures import REASONS, find_departures
from ldctoolkit.recordings.recording import RecordingTable

MODULE = sys.modules["ldctoolkit.recordings.extract"]
CRITERIA = Criteria(2.0)
SOURCES = ("one.csv", "two.csv", "")
ROADS = ("motorway", "secondary")


def wander(rng: np.random.Generator, name: str) -> Recording:
    """A drive that crosses lines, with holes, gaps, jumps, lane changes, turn signals."""
    n = int(rng.integers(1, 120))
    t = np.cumsum(rng.choice([0.125, 0.25, 0.5], n, p=[0.9, 0.08, 0.02]))
    lane = np.cumsum(rng.random(n) < 0.02)
    offset = 1.4 * np.sin(np.cumsum(rng.normal(0.0, 0.3, n)))
    speed = rng.uniform(0.0, 30.0) + rng.normal(0.0, 0.5, n)
    speed[rng.random(n) < 0.01] = np.nan
    labels = (Label("road", str(rng.choice(ROADS))),) if rng.random() < 0.7 else ()
    return Recording(
        name, t, offset, rng.uniform(2.9, 3.9, n), speed, rng.random(n) > 0.02,
        curvature=rng.normal(0.0, 1e-3, n) if rng.random() < 0.7 else None, lane=lane if rng.random() < 0.5 else None,
        turn_signal=rng.choice([-1, 0, 1], n, p=[0.02, 0.96, 0.02]), labels=labels, source=str(rng.choice(SOURCES)),
        lane_scale=float(rng.choice([1.0, 1.0, 1.25])), engaged=rng.random(n) < 0.05 if rng.random() < 0.5 else None,
    )  # fmt: skip


def wandering(seed: int, count: int) -> list[Recording]:
    rng = np.random.default_rng(seed)
    return [wander(rng, f"r{i}") for i in range(count)]


def by_hand(recordings: list[Recording]) -> dict[Any, dict[str, Any]]:
    """One recording after the other, one sample after the other."""
    accounts: dict[Any, dict[str, Any]] = {}
    for recording in recordings:
        empty = {"recordings": 0, "samples": 0, "usable": 0, "read": 0.0, "valid": 0.0, "um": 0}
        empty |= {"widths": Counter()}
        account = accounts.setdefault((recording.source, recording.labels), empty | {"candidates": Counter()})
        bend = np.zeros(recording.samples) if recording.curvature is None else recording.curvature
        good = [
            bool(recording.valid[i])
            and recording.lane_width[i] > 0
            and bool(np.isfinite([recording.speed[i], bend[i]]).all())
            for i in range(recording.samples)
        ]
        account["recordings"] += 1
        account["samples"] += recording.samples
        account["usable"] += sum(good)
        steps = [recording.t[i] - recording.t[i - 1] for i in range(1, recording.samples)]
        limit = max(0.25, 2.5 * float(np.median(steps))) if steps else 0.0
        metres = 0.0
        for i, step in enumerate(steps, start=1):
            if step <= limit:
                account["read"] += step
                by_driver = recording.engaged is None or not recording.engaged[i - 1 : i + 1].any()
                if good[i] and good[i - 1] and by_driver:
                    account["valid"] += step
                    metres += 0.5 * (abs(recording.speed[i]) + abs(recording.speed[i - 1])) * step
        account["um"] += round(metres * 1e6)
        for i, width in enumerate(recording.lane_width.tolist()):
            if good[i]:
                account["widths"][int(width / 0.1)] += 1
        # alone in a table: its candidates are then known by themselves
        search = find_departures(RecordingTable.of([recording]), CRITERIA)
        for reason, side in zip(search.reason.tolist(), search.side.tolist(), strict=True):
            account["candidates"][("left" if side == LEFT else "right", (*REASONS, "departure")[reason])] += 1
    return accounts


@examples(40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_equals_the_count_by_hand(seed, count):
    recordings = wandering(seed, count)
    result = extract_items(recordings, CRITERIA, Preparation())
    expected = by_hand(recordings)
    assert [(counted.origin.source, counted.origin.labels) for counted in result.accounts] == list(expected)
    for account, hand in zip(result.accounts, expected.values(), strict=True):
        assert (account.recordings, account.samples, account.usable) == (
            hand["recordings"],
            hand["samples"],
            hand["usable"],
        )
        assert (account.read_ns, account.valid_ns) == (round(hand["read"] * 1e9), round(hand["valid"] * 1e9))
        assert account.valid_um == hand["um"]
        assert {int(i): int(account.widths[i]) for i in np.flatnonzero(account.widths)} == dict(hand["widths"])
        reported = Counter()
        for row, side in enumerate(("left", "right")):
            reported[side, "departure"] = int(account.departures[row])
            reported.update({(side, reason): int(account.refused[row, i]) for i, reason in enumerate(REASONS)})
        assert (+reported, account.candidates.sum()) == (hand["candidates"], sum(hand["candidates"].values()))


def alike(extraction: Any) -> Any:
    """Texts of extra columns as wide as they need to be."""
    departures = extraction.departures
    columns = tuple(ExtraColumn(column.name, np.array(column.values.tolist())) for column in departures.extra)
    return dataclasses.replace(extraction, departures=dataclasses.replace(departures, extra=columns))


@examples(30)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1), step=st.sampled_from([None, 0.1]))
def test_any_split_gives_the_same_bits(data, seed, step):
    """Batches of any size, parts cut anywhere: departures and their columns, accounts, drawn events, evidence."""
    recordings = [
        dataclasses.replace(recording, cut=np.arange(recording.samples) % 37 == 36 if i % 2 else None)
        for i, recording in enumerate(wandering(seed, 8))
    ]
    # parts come in a fixed order, but how recordings are shared out does not show
    preparation = Preparation(step, nominal_lane_width=data.draw(st.sampled_from([None, 3.4])))
    whole = extract_items(recordings, CRITERIA, preparation)
    assert whole.problems == ()
    cuts = sorted(data.draw(st.sets(st.integers(1, 7), max_size=4)))
    before = MODULE.BATCH
    try:
        MODULE.BATCH = data.draw(st.integers(1, 400))
        parts = [
            extract_items(recordings[a:b], CRITERIA, preparation) for a, b in zip([0, *cuts], [*cuts, 8], strict=True)
        ]
    finally:
        MODULE.BATCH = before
    split = combined_results(parts)
    for name in ("departures", "accounts", "drawn", "problems", "evidence"):
        assert_same_bits(getattr(alike(whole), name), getattr(alike(split), name))
    at_once, in_parts = (merge_results(results, CRITERIA, preparation, force=True) for results in ([whole], parts))
    assert_same_bits(alike(at_once), alike(in_parts))


def test_the_provenance_is_the_sum_of_the_accounts():
    extraction = extract_departures(wandering(3, 40), vehicle_width=2.0, force=True)
    accounts, provenance = extraction.accounts, extraction.provenance
    assert len(accounts) > 4
    assert provenance.recordings == sum(account.recordings for account in accounts) == 40
    assert provenance.samples == sum(account.samples for account in accounts)
    assert provenance.invalid_samples == sum(account.samples - account.usable for account in accounts)
    assert provenance.hours == pytest.approx(sum(account.hours_valid for account in accounts), rel=1e-12)
    assert provenance.distance == sum(account.valid_um for account in accounts) / 1e6 > 1000.0
    refused = np.sum([account.refused for account in accounts], axis=(0, 1))
    assert [count for _, count in provenance.refused.items()] == refused.tolist()
    assert len(extraction.departures) == sum(int(account.departures.sum()) for account in accounts)
    assert extraction.candidates == sum(int(account.candidates.sum()) for account in accounts)
    # the columns of the departures lead to the same groups
    columns = {column.name: column.values.tolist() for column in extraction.departures.extra}
    groups = Counter(zip(columns["source"], columns["road"], extraction.departures.side.tolist(), strict=True))
    expected: Counter[Any] = Counter()
    for account in accounts:
        road = account.origin.labels[0].value if account.origin.labels else ""
        for side, count in zip((1, -1), account.departures.tolist(), strict=True):
            expected[account.origin.source, road, side] += count
    assert groups == +expected


def test_pieces_of_a_recording_count_once():
    recording = drive(lane_offset=np.zeros(100), cut=np.isin(np.arange(100), [20, 70]), source="x")
    extraction = extract_departures([recording, drive("b", lane_offset=np.zeros(100), source="y")])
    assert [(account.origin.source, account.recordings, account.samples) for account in extraction.accounts] == [
        ("x", 1, 100), ("y", 1, 100),
    ]  # fmt: skip
    assert extraction.recordings == 2
    assert [account.read_ns for account in extraction.accounts] == [9_700_000_000, 9_900_000_000]


def test_nothing_at_all():
    extraction = extract_departures([])
    names = ("accounts", "hours", "distance", "recordings", "candidates", "refused", "warnings")
    assert [getattr(extraction, name) for name in names] == [(), 0.0, 0.0, 0, 0, Refused(), ()]
    assert len(extraction.departures) == 0
    assert merge_results([PartResult()], Criteria(), Preparation()).accounts == ()


def test_absurd_times_do_not_overflow():
    t = np.array([0.0, 1e300, 2e300, 3e300])
    (account,) = extract_departures([drive(t=t, lane_offset=0.0)], force=True).accounts
    assert account.read_ns == account.valid_ns == 10**17
    fast = drive(t=1e7 * t, lane_offset=0.0, speed=100.0)  # the product is more than a number of 64 bits holds
    for recording in (drive(t=t, lane_offset=0.0), fast):
        assert extract_departures([recording], force=True).distance == 1e10


def test_the_last_bin_holds_what_is_wider():
    width = [0.05, 3.45, 7.95, 8.2, 900.0]
    recording = drive(t=range(5), lane_offset=0.0, lane_width=width)
    (account,) = extract_departures([recording], min_lane_width=0.01, max_lane_width=1000.0, force=True).accounts
    assert {int(i): int(account.widths[i]) for i in np.flatnonzero(account.widths)} == {0: 1, 34: 1, WIDTH_BINS - 1: 3}
    edges, share = share_of_widths(account.widths)
    assert (edges.size, edges[34], share[34]) == (81, pytest.approx(3.4), 0.2)
    assert share_of_widths(np.zeros(80, dtype=np.int64))[1].sum() == 0.0


CRITERIA_DRAWN = Criteria(1.8)
T = np.arange(200) * 0.1


def drives(count: int, sources: int, seed: int = 0) -> list[Recording]:
    """Two departures each, one to either side, of random depth."""
    rng = np.random.default_rng(seed)
    recordings = []
    for i in range(count):
        offset = np.zeros(200)
        for start, side in ((5.0, 1.0), (15.0, -1.0)):
            bump = rng.uniform(0.05, 0.6) * (1.0 - ((T - start) / rng.uniform(0.5, 2.0)) ** 2)
            offset += side * np.where(np.abs(T - start) < 5.0, 0.9 + np.clip(bump, -0.5, None), 0.0)
        columns: dict[str, Any] = {"lane_offset": offset, "lane_width": np.full(200, 3.6)}
        columns |= {"speed": 25.0 + 0.01 * T, "valid": np.ones(200, bool), "curvature": rng.normal(0.0, 1e-3, 200)}
        recordings.append(Recording(f"r{i}", T, **columns, source=f"s{i % sources}"))
    return recordings


def signatures(drawn: Drawn) -> list[list[tuple[Any, ...]]]:
    return [
        [
            (
                *(event.source, event.recording, event.side, event.start_time, event.lot, *event.parameters.tolist()),
                *(getattr(event, name).tobytes() for name in ("t", "y", "v", "c")),
            )
            for event in events
        ]
        for events in (drawn.deepest, drawn.by_lot)
    ]


@pytest.mark.parametrize("sources", [1, 3])
def test_the_deepest_are_the_deepest(sources):
    result = extract_items(drives(40 * sources, sources), CRITERIA_DRAWN, Preparation())
    d = result.departures
    assert d.n > 60
    of = next(column.values for column in d.extra if column.name == "source")
    groups = [(f"s{i}", side) for i in range(sources) for side in (LEFT, RIGHT)]
    for source, side in groups:
        mine = (of == source) & (d.side == side)
        assert mine.sum() > EXAMPLES
        deepest = [event for event in result.drawn.deepest if (event.source, event.side) == (source, side)]
        depths = [float(event.parameters[1]) for event in deepest]
        assert depths == sorted(d.d_y[mine].tolist(), reverse=True)[:EXAMPLES]
        lots = [event for event in result.drawn.by_lot if (event.source, event.side) == (source, side)]
        assert (len(lots), [event.lot for event in lots]) == (EXAMPLES, sorted(event.lot for event in lots))
        assert {(event.recording, event.start_time) for event in lots} != {
            (event.recording, event.start_time) for event in deepest
        }
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert list(dict.fromkeys((event.source, event.side) for event in events)) == groups
        assert len(events) == EXAMPLES * len(groups)


def test_a_side_with_few_keeps_all_and_takes_nothing_from_the_other():
    """Left departures are far deeper and many; the five to the right are all kept."""
    recordings = drives(30, 1)
    for i, recording in enumerate(recordings):
        offset = np.where(recording.lane_offset > 0.0, recording.lane_offset + 0.2, recording.lane_offset * (i < 5))
        recordings[i] = dataclasses.replace(recording, lane_offset=offset)
    result = extract_items(recordings, CRITERIA_DRAWN, Preparation())
    right = result.departures.d_y[result.departures.side == RIGHT]
    assert 0 < right.size <= 5
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert [event.side for event in events] == [LEFT] * EXAMPLES + [RIGHT] * right.size
        assert sorted(float(event.parameters[1]) for event in events if event.side == RIGHT) == sorted(right.tolist())


def test_signals_are_the_departures_own():
    """Reduced again, they give the parameters; both sides are outward."""
    result = extract_items(drives(10, 1), CRITERIA_DRAWN, Preparation())
    d = result.departures
    assert {event.side for event in result.drawn.by_lot} == {LEFT, RIGHT}
    for event in (*result.drawn.deepest, *result.drawn.by_lot):
        same_start = (d.recording == event.recording) & (d.start_time == event.start_time)
        row = np.flatnonzero(same_start & (d.side == event.side))
        assert row.size == 1
        np.testing.assert_array_equal(d.matrix()[row[0]], event.parameters)
        signals = DepartureSignals(np.array([0, event.t.size]), event.t, event.y, event.v, event.c)
        np.testing.assert_allclose(
            reduce_signals(signals, [event.side]).matrix()[0], event.parameters, rtol=1e-9, atol=1e-12
        )
        assert event.t[0] == event.y[0] == event.y[-1] == 0.0
        assert (event.y[1:-1] > 0.0).all()


@pytest.mark.parametrize("cuts", [[1], [5, 11], [3, 4, 20, 39], list(range(1, 40))])
def test_any_split_keeps_the_same(cuts):
    recordings = drives(40, 2)
    whole = extract_items(recordings, CRITERIA_DRAWN, Preparation()).drawn
    ends = zip([0, *cuts], [*cuts, 40], strict=True)
    parts = [extract_items(recordings[a:b], CRITERIA_DRAWN, Preparation()) for a, b in ends]
    assert signatures(combined_results(parts).drawn) == signatures(whole)
    # in any order: the same ones, but for the order of the sources
    turned = signatures(combined_results(parts[::-1]).drawn)
    assert [sorted(signature) for signature in turned] == [sorted(signature) for signature in signatures(whole)]


def test_the_lot_is_blind():
    """A lot is sorted neither by name nor by depth; 600 departures, drawn of 25 sources and two sides."""
    result = extract_items(drives(600, 25, seed=5), CRITERIA_DRAWN, Preparation())
    lots = result.drawn.by_lot
    assert len(lots) == 2 * 25 * EXAMPLES
    order = np.tile(np.arange(EXAMPLES), 2 * 25)
    limit = 4.0 / np.sqrt(len(lots))  # four standard deviations of the correlation of unrelated numbers
    for values in ([int(event.recording[1:]) for event in lots], [float(event.parameters[1]) for event in lots]):
        assert abs(np.corrcoef(values, order)[0, 1]) < limit
    # the drawn ones are about as deep as all
    d_y = result.departures.d_y
    mean = np.mean([event.parameters[1] for event in lots])
    assert abs(mean - d_y.mean()) < 4.0 * d_y.std() / np.sqrt(len(lots))


def test_equal_depths_are_told_apart_by_name_and_time():
    recording = drives(1, 1)[0]
    recordings = [dataclasses.replace(recording, name=f"twin{i:02d}") for i in range(30)]
    forward = extract_items(recordings, CRITERIA_DRAWN, Preparation()).drawn
    backward = extract_items(recordings[::-1], CRITERIA_DRAWN, Preparation()).drawn
    assert signatures(forward) == signatures(backward)
    assert [event.recording for event in forward.deepest] == 2 * [f"twin{i:02d}" for i in range(EXAMPLES)]


def test_none():
    assert extract_items([], CRITERIA_DRAWN, Preparation()).drawn == Drawn()
