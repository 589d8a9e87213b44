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
from ldctoolkit.recordings.find_departures import REASONS, find_departures
from ldctoolkit.recordings.quality import EXAMPLES, WIDTH_BINS, share_of_widths
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
    for one in recordings:
        empty = {"recordings": 0, "samples": 0, "usable": 0, "read": 0.0, "valid": 0.0, "um": 0, "widths": Counter()}
        account = accounts.setdefault((one.source, one.labels), empty | {"widths": Counter(), "found": Counter()})
        bend = np.zeros(one.samples) if one.curvature is None else one.curvature
        good = [
            bool(one.valid[i]) and one.lane_width[i] > 0 and bool(np.isfinite([one.speed[i], bend[i]]).all())
            for i in range(one.samples)
        ]
        account["recordings"] += 1
        account["samples"] += one.samples
        account["usable"] += sum(good)
        steps = [one.t[i] - one.t[i - 1] for i in range(1, one.samples)]
        limit = max(0.25, 2.5 * float(np.median(steps))) if steps else 0.0
        metres = 0.0
        for i, step in enumerate(steps, start=1):
            if step <= limit:
                account["read"] += step
                by_driver = one.engaged is None or not one.engaged[i - 1 : i + 1].any()
                if good[i] and good[i - 1] and by_driver:
                    account["valid"] += step
                    metres += 0.5 * (abs(one.speed[i]) + abs(one.speed[i - 1])) * step
        account["um"] += round(metres * 1e6)
        for i, width in enumerate(one.lane_width.tolist()):
            if good[i]:
                account["widths"][int(width / 0.1)] += 1
        # alone in a table: its candidates are then known by themselves
        found = find_departures(RecordingTable.of([one]), CRITERIA)
        for reason, side in zip(found.reason.tolist(), found.side.tolist(), strict=True):
            account["found"][("left" if side == LEFT else "right", (*REASONS, "departure")[reason])] += 1
    return accounts


@examples(40)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 12))
def test_equals_the_count_by_hand(seed, count):
    recordings = wandering(seed, count)
    result = extract_items(recordings, CRITERIA, Preparation())
    wanted = by_hand(recordings)
    assert [(one.origin.source, one.origin.labels) for one in result.accounts] == list(wanted)
    for account, hand in zip(result.accounts, wanted.values(), strict=True):
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
        assert (+reported, account.candidates.sum()) == (hand["found"], sum(hand["found"].values()))


def alike(found: Any) -> Any:
    """Texts of extra columns as wide as they need to be."""
    columns = tuple(ExtraColumn(one.name, np.array(one.values.tolist())) for one in found.departures.extra)
    return dataclasses.replace(found, departures=dataclasses.replace(found.departures, extra=columns))


@examples(30)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1), step=st.sampled_from([None, 0.1]))
def test_any_split_gives_the_same_bits(data, seed, step):
    """Batches of any size, parts cut anywhere: departures and their columns, accounts, drawn events, evidence."""
    recordings = [
        dataclasses.replace(one, cut=np.arange(one.samples) % 37 == 36 if i % 2 else None)
        for i, one in enumerate(wandering(seed, 8))
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
    one, two = (merge_results(results, CRITERIA, preparation, force=True) for results in ([whole], parts))
    assert_same_bits(alike(one), alike(two))


def test_the_provenance_is_the_sum_of_the_accounts():
    found = extract_departures(wandering(3, 40), vehicle_width=2.0, force=True)
    accounts, provenance = found.accounts, found.provenance
    assert len(accounts) > 4
    assert provenance.recordings == sum(account.recordings for account in accounts) == 40
    assert provenance.samples == sum(account.samples for account in accounts)
    assert provenance.invalid_samples == sum(account.samples - account.usable for account in accounts)
    assert provenance.hours == pytest.approx(sum(account.hours_valid for account in accounts), rel=1e-12)
    assert provenance.distance == sum(account.valid_um for account in accounts) / 1e6 > 1000.0
    refused = np.sum([account.refused for account in accounts], axis=(0, 1))
    assert [count for _, count in provenance.refused.items()] == refused.tolist()
    assert len(found.departures) == sum(int(account.departures.sum()) for account in accounts)
    assert found.candidates == sum(int(account.candidates.sum()) for account in accounts)
    # the columns of the departures lead to the same groups
    columns = {column.name: column.values.tolist() for column in found.departures.extra}
    groups = Counter(zip(columns["source"], columns["road"], found.departures.side.tolist(), strict=True))
    wanted: Counter[Any] = Counter()
    for account in accounts:
        road = account.origin.labels[0].value if account.origin.labels else ""
        for side, count in zip((1, -1), account.departures.tolist(), strict=True):
            wanted[account.origin.source, road, side] += count
    assert groups == +wanted


def test_pieces_of_a_recording_count_once():
    one = drive(lane_offset=np.zeros(100), cut=np.isin(np.arange(100), [20, 70]), source="x")
    found = extract_departures([one, drive("b", lane_offset=np.zeros(100), source="y")])
    assert [(account.origin.source, account.recordings, account.samples) for account in found.accounts] == [
        ("x", 1, 100), ("y", 1, 100),
    ]  # fmt: skip
    assert found.recordings == 2
    assert [account.read_ns for account in found.accounts] == [9_700_000_000, 9_900_000_000]


def test_nothing_at_all():
    found = extract_departures([])
    assert (found.accounts, found.hours, found.distance, found.recordings, found.candidates) == ((), 0.0, 0.0, 0, 0)
    assert (len(found.departures), found.refused, found.warnings) == (0, Refused(), ())
    assert merge_results([PartResult()], Criteria(), Preparation()).accounts == ()


def test_absurd_times_do_not_overflow():
    t = np.array([0.0, 1e300, 2e300, 3e300])
    (account,) = extract_departures([drive(t=t, lane_offset=0.0)], force=True).accounts
    assert account.read_ns == account.valid_ns == 10**17
    fast = drive(t=1e7 * t, lane_offset=0.0, speed=100.0)  # the product is more than a number of 64 bits holds
    for one in (drive(t=t, lane_offset=0.0), fast):
        assert extract_departures([one], force=True).distance == 1e10


def test_the_last_bin_holds_what_is_wider():
    width = [0.05, 3.45, 7.95, 8.2, 900.0]
    one = drive(t=range(5), lane_offset=0.0, lane_width=width)
    (account,) = extract_departures([one], min_lane_width=0.01, max_lane_width=1000.0, force=True).accounts
    assert {int(i): int(account.widths[i]) for i in np.flatnonzero(account.widths)} == {0: 1, 34: 1, WIDTH_BINS - 1: 3}
    edges, share = share_of_widths(account.widths)
    assert (edges.size, edges[34], share[34]) == (81, pytest.approx(3.4), 0.2)
    assert share_of_widths(np.zeros(80, dtype=np.int64))[1].sum() == 0.0


CRITERIA_DRAWN = Criteria(1.8)
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
    result = extract_items(drives(40 * sources, sources), CRITERIA_DRAWN, Preparation())
    d = result.departures
    assert d.n > 60
    of = next(column.values for column in d.extra if column.name == "source")
    groups = [(f"s{i}", side) for i in range(sources) for side in (LEFT, RIGHT)]
    for source, side in groups:
        mine = (of == source) & (d.side == side)
        assert mine.sum() > EXAMPLES
        kept = [one for one in result.drawn.deepest if (one.source, one.side) == (source, side)]
        depths = [float(one.parameters[1]) for one in kept]
        assert depths == sorted(d.d_y[mine].tolist(), reverse=True)[:EXAMPLES]
        lots = [one for one in result.drawn.by_lot if (one.source, one.side) == (source, side)]
        assert (len(lots), [one.lot for one in lots]) == (EXAMPLES, sorted(one.lot for one in lots))
        assert {(one.recording, one.start_time) for one in lots} != {(one.recording, one.start_time) for one in kept}
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert list(dict.fromkeys((one.source, one.side) for one in events)) == groups
        assert len(events) == EXAMPLES * len(groups)


def test_a_side_with_few_keeps_all_and_takes_nothing_from_the_other():
    """Left departures are far deeper and many; the five to the right are all kept."""
    recordings = drives(30, 1)
    for i, one in enumerate(recordings):
        offset = np.where(one.lane_offset > 0.0, one.lane_offset + 0.2, one.lane_offset * (i < 5))
        recordings[i] = dataclasses.replace(one, lane_offset=offset)
    result = extract_items(recordings, CRITERIA_DRAWN, Preparation())
    right = result.departures.d_y[result.departures.side == RIGHT]
    assert 0 < right.size <= 5
    for events in (result.drawn.deepest, result.drawn.by_lot):
        assert [one.side for one in events] == [LEFT] * EXAMPLES + [RIGHT] * right.size
        assert sorted(float(one.parameters[1]) for one in events if one.side == RIGHT) == sorted(right.tolist())


def test_signals_are_the_departures_own():
    """Reduced again, they give the parameters; both sides are outward."""
    result = extract_items(drives(10, 1), CRITERIA_DRAWN, Preparation())
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
    whole = extract_items(recordings, CRITERIA_DRAWN, Preparation()).drawn
    ends = zip([0, *cuts], [*cuts, 40], strict=True)
    parts = [extract_items(recordings[a:b], CRITERIA_DRAWN, Preparation()) for a, b in ends]
    assert signatures(combined_results(parts).drawn) == signatures(whole)
    # in any order: the same ones, but for the order of the sources
    turned = signatures(combined_results(parts[::-1]).drawn)
    assert [sorted(one) for one in turned] == [sorted(one) for one in signatures(whole)]


def test_the_lot_is_blind():
    """A lot is sorted neither by name nor by depth; 600 departures, drawn of 25 sources and two sides."""
    result = extract_items(drives(600, 25, seed=5), CRITERIA_DRAWN, Preparation())
    lots = result.drawn.by_lot
    assert len(lots) == 2 * 25 * EXAMPLES
    order = np.tile(np.arange(EXAMPLES), 2 * 25)
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
    forward = extract_items(recordings, CRITERIA_DRAWN, Preparation()).drawn
    backward = extract_items(recordings[::-1], CRITERIA_DRAWN, Preparation()).drawn
    assert signatures(forward) == signatures(backward)
    assert [event.recording for event in forward.deepest] == 2 * [f"twin{i:02d}" for i in range(EXAMPLES)]


def test_none():
    assert extract_items([], CRITERIA_DRAWN, Preparation()).drawn == Drawn()
