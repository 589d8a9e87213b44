"""The worst departures of a design, and what tells them from the others."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from ldctoolkit import Scenarios
from studies.report.tables.worst_departures import WorstDepartures, worst_departures

Array = npt.NDArray[np.bool_]


def scenarios(n: int, seed: int = 0) -> Scenarios:
    rng = np.random.default_rng(seed)
    return Scenarios.from_arrays(
        T=rng.uniform(1.0, 5.0, n), d_y=rng.uniform(0.1, 1.0, n), v_mean=rng.uniform(10.0, 30.0, n),
        side=np.where(np.arange(n) < n // 2, 1, -1),
    )  # fmt: skip


def compared(
    some: Scenarios, S: npt.NDArray[np.float64], took_over: Array | None = None, failed: Array | None = None
) -> WorstDepartures | None:
    every = np.ones(S.size, dtype=bool)
    return worst_departures(some, S, every if took_over is None else took_over, ~every if failed is None else failed)


def test_the_cause_is_named_first_and_measured() -> None:
    some = scenarios(400)
    S = some.d_y**3 + 1e-3 * some.T
    found = compared(some, S)
    assert found is not None
    assert (found.count, found.untouched, found.failed) == (20, 0, 0)
    assert found.first == tuple(sorted(range(400), key=lambda k: -S[k])[:5])
    worst = np.sort(S)[-20:]
    assert found.share_of_S == pytest.approx(worst.sum() / S.sum())
    first = found.lines[0]
    assert (first.name, first.apart) == ("d_y", True)
    # by definition of the Kolmogorov distance: all worst ones lie above a share of the others
    rows = np.argsort(-S)[:20]
    grid = np.sort(some.d_y)
    below = [abs((some.d_y[rows] <= x).mean() - (some.d_y <= x).mean()) for x in grid]
    assert first.distance == pytest.approx(max(below))
    assert first.worst.median == pytest.approx(np.median(some.d_y[rows]))
    assert [line.name for line in found.telling] == ["d_y"]
    assert {line.name for line in found.lines} == {"T", "d_y", "v_mean"}  # the others do not vary


def test_sides_are_counted() -> None:
    some = scenarios(100)
    found = compared(some, np.where(some.side == 1, 2.0, 1.0))
    assert found is not None
    assert (found.left, found.every_left) == (1.0, 0.5)


def test_nothing_to_tell() -> None:
    assert compared(scenarios(39), np.arange(39.0)) is None
    assert compared(scenarios(100), np.ones(100)) is None


def test_departures_without_control_do_not_hide_the_cause() -> None:
    some = scenarios(400)
    took_over = some.d_y > 0.4
    # S is large where nobody acts and T is long, and where somebody acts and v_mean is high
    S = np.where(took_over, some.v_mean > 28.0, some.T > 4.5) + 1e-3 * some.v_mean
    failed = some.v_mean > 29.9
    found = compared(some, S, took_over, failed)
    assert found is not None
    rows = sorted(range(400), key=lambda k: -S[k])[: found.count]
    assert found.untouched == sum(not took_over[k] for k in rows)
    assert found.failed == sum(bool(failed[k]) for k in rows)
    acted = [k for k in rows if took_over[k]]
    assert len(acted) > 0
    line = next(line for line in found.lines if line.name == "v_mean")
    assert line.worst.median == pytest.approx(np.median(some.v_mean[acted]))
    assert line.every.median == pytest.approx(np.median(some.v_mean[took_over]))
    assert [line.name for line in found.telling] == ["v_mean"]


def test_none_of_the_worst_was_taken_over() -> None:
    some = scenarios(100)
    took_over = some.d_y < 0.5
    found = compared(some, some.d_y, took_over)
    assert found is not None
    assert (found.untouched, found.lines) == (found.count, ())
    never = compared(some, some.d_y, np.zeros(100, dtype=bool))
    assert never is not None
    assert [line.name for line in never.telling] == ["d_y"]
