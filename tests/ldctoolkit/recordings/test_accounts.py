"""Accounts against counts by hand, and the same for any split of the work."""

import dataclasses
import sys
from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import assert_same_bits
from helpers.examples import examples
from helpers.recordings import drive
from ldctoolkit.departures import LEFT, ExtraColumn
from ldctoolkit.recordings import Account, Criteria, Label, PartResult, Preparation, Recording, Refused
from ldctoolkit.recordings.departures_table import combined_results
from ldctoolkit.recordings.extract import extract_departures, extract_items, merge_results, table_of
from ldctoolkit.recordings.find_departures import REASONS, find_departures
from ldctoolkit.recordings.quality import WIDTH_BINS, share_of_widths

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
        lane_scale=float(rng.choice([1.0, 1.0, 1.25])),
    )  # fmt: skip


def wandering(seed: int, count: int) -> list[Recording]:
    rng = np.random.default_rng(seed)
    return [wander(rng, f"r{i}") for i in range(count)]


def by_hand(recordings: list[Recording]) -> dict[Any, dict[str, Any]]:
    """One recording after the other, one sample after the other."""
    accounts: dict[Any, dict[str, Any]] = {}
    for one in recordings:
        empty = {"recordings": 0, "samples": 0, "usable": 0, "read": 0.0, "valid": 0.0, "widths": Counter()}
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
        for i, step in enumerate(steps, start=1):
            if step <= limit:
                account["read"] += step
                account["valid"] += step * (good[i] and good[i - 1])
        for i, width in enumerate(one.lane_width.tolist()):
            if good[i]:
                account["widths"][int(width / 0.1)] += 1
        # alone in a table: its candidates are then known by themselves
        found = find_departures(table_of([one]), CRITERIA)
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
    recordings = wandering(seed, 8)
    # parts come in a fixed order, but how recordings are shared out does not show
    preparation = Preparation(step, nominal_lane_width=data.draw(st.sampled_from([None, 3.4])))
    whole = extract_items(recordings, CRITERIA, preparation)
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
    for name in ("departures", "accounts", "drawn", "problems"):
        assert_same_bits(getattr(alike(whole), name), getattr(alike(split), name))
    one, two = (merge_results(results, CRITERIA, preparation) for results in ([whole], parts))
    assert_same_bits(alike(one), alike(two))


def test_the_provenance_is_the_sum_of_the_accounts():
    found = extract_departures(wandering(3, 40), vehicle_width=2.0)
    accounts, provenance = found.accounts, found.provenance
    assert len(accounts) > 4
    assert provenance.recordings == sum(account.recordings for account in accounts) == 40
    assert provenance.samples == sum(account.samples for account in accounts)
    assert provenance.invalid_samples == sum(account.samples - account.usable for account in accounts)
    assert provenance.hours == pytest.approx(sum(account.hours_valid for account in accounts), rel=1e-12)
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


def test_numbers_are_whole():
    (account, *_) = extract_items(wandering(5, 6), CRITERIA, Preparation()).accounts
    for field in dataclasses.fields(Account):
        value = getattr(account, field.name)
        assert field.name == "origin" or isinstance(value, int) or value.dtype == np.int64


def test_nothing_at_all():
    found = extract_departures([])
    assert (found.accounts, found.hours, found.recordings, found.candidates) == ((), 0.0, 0, 0)
    assert (len(found.departures), found.refused, found.warnings) == (0, Refused(), ())
    assert merge_results([PartResult()], Criteria(), Preparation()).accounts == ()


def test_absurd_times_do_not_overflow():
    t = np.array([0.0, 1e300, 2e300, 3e300])
    (account,) = extract_departures([drive(t=t, lane_offset=0.0)]).accounts
    assert account.read_ns == account.valid_ns == 10**17


def test_the_last_bin_holds_what_is_wider():
    width = [0.05, 3.45, 7.95, 8.2, 900.0]
    (account,) = extract_departures([drive(t=range(5), lane_offset=0.0, lane_width=width)]).accounts
    assert {int(i): int(account.widths[i]) for i in np.flatnonzero(account.widths)} == {0: 1, 34: 1, WIDTH_BINS - 1: 3}
    edges, share = share_of_widths(account.widths)
    assert (edges.size, edges[34], share[34]) == (81, pytest.approx(3.4), 0.2)
    assert share_of_widths(np.zeros(80, dtype=np.int64))[1].sum() == 0.0
