"""The front of two figures against all pairs, and its line."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from studies.report.figures.trade_off_figure import front_of_two


@pytest.mark.parametrize("better", list(itertools.product(("less", "more"), repeat=2)))
def test_front_is_what_no_other_beats(better: tuple[str, str]) -> None:
    rng = np.random.default_rng(4)
    values = rng.integers(0, 12, (2, 60)).astype(float)
    values[1, 7] = np.nan
    ranked = rng.random(60) < 0.7
    signs = [1 if one == "less" else -1 for one in better]
    cost = {k: (signs[0] * values[0, k], signs[1] * values[1, k]) for k in np.flatnonzero(ranked).tolist() if k != 7}

    def beaten(k: int) -> bool:
        return any(a <= cost[k][0] and b <= cost[k][1] and (a, b) != cost[k] for a, b in cost.values())

    front = front_of_two(values, ranked, *better)  # type: ignore[arg-type]
    assert set(front.tolist()) == {k for k in cost if not beaten(k)}
    assert [cost[k] for k in front] == sorted(cost[k] for k in front)


def test_without_a_ranked_design_all_are_looked_at() -> None:
    values = np.array([[1.0, 2.0], [2.0, 3.0]])
    assert front_of_two(values, np.zeros(2, dtype=bool), "less", "less").tolist() == [0]
