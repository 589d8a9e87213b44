"""The worst departures of a design, and what tells them from the others."""

from __future__ import annotations

import numpy as np
import pytest

from ldctoolkit import Scenarios
from studies.report.tables.worst_departures import worst_departures


def scenarios(n: int, seed: int = 0) -> Scenarios:
    rng = np.random.default_rng(seed)
    return Scenarios.from_arrays(
        T=rng.uniform(1.0, 5.0, n), d_y=rng.uniform(0.1, 1.0, n), v_mean=rng.uniform(10.0, 30.0, n),
        side=np.where(np.arange(n) < n // 2, 1, -1),
    )  # fmt: skip


def test_the_cause_is_named_first_and_measured() -> None:
    some = scenarios(400)
    S = some.d_y**3 + 1e-3 * some.T
    found = worst_departures(some, S)
    assert found is not None
    assert found.count == 20
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
    found = worst_departures(some, np.where(some.side == 1, 2.0, 1.0))
    assert found is not None
    assert (found.left, found.every_left) == (1.0, 0.5)


def test_nothing_to_tell() -> None:
    assert worst_departures(scenarios(39), np.arange(39.0)) is None
    assert worst_departures(scenarios(100), np.ones(100)) is None
