"""A study that grows: more scenarios in the same folder; scenarios that keep their numbers and their paths."""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.results import assert_same_results
from ldctoolkit.studies.running import tasks

NOISY = {
    "actuator": {"lag": 0.1, "delay": 0.07},
    "sensors": {"e_y_noise": 0.05, "e_psi_noise": 0.003},
    "mismatch": {"m": [0.9, 1.1]},
    "residuals": {"y": True, "v": True},
}


def noisy(left: int, right: int, **tables: Any) -> ldc.Study:
    return ldc.study(
        ldc.NoControl, ldc.LQR, {"law": "pid", "y_s": [0.05, 0.1]}, plant=NOISY, name="noisy", left=left, right=right,
        ranking={"finalists": 2, "bootstrap": 100}, **tables,
    )  # fmt: skip


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Scenarios of each run of a design."""
    counts: list[int] = []
    drive_many = tasks.drive_many

    def watched(controllers: Any, takeover: Any, **named: Any) -> Any:
        counts.extend(takeover.scenarios.n for _ in controllers)
        return drive_many(controllers, takeover, **named)

    monkeypatch.setattr(tasks, "drive_many", watched)
    return counts


def test_more_scenarios_are_those_of_a_study_that_began_with_them(
    tmp_path: Path, driven: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    small = ldc.run_study(noisy(6, 9), tmp_path / "out", workers=1)
    whole = ldc.run_study(noisy(15, 10), tmp_path / "whole", workers=1)
    with caplog.at_level(logging.WARNING):
        grown = ldc.run_study(noisy(15, 10), tmp_path / "out", workers=1)
    assert not caplog.records
    assert_same_results(grown, whole)
    assert_same_results(ldc.read_results(tmp_path / "out"), whole)
    rows = np.flatnonzero(np.isin(whole.scenarios.index, small.scenarios.index))
    assert rows.size == 15
    np.testing.assert_array_equal(grown.S[:, rows], small.S)
    driven.clear()
    ldc.run_study(noisy(15, 10), tmp_path / "out", workers=1)
    assert driven == []
    # and back: what is there of more scenarios is not in the way
    assert_same_results(ldc.run_study(noisy(6, 9), tmp_path / "out", workers=1), small)
    assert driven == []
    assert_same_results(ldc.read_results(tmp_path / "out"), small)


def test_batches_that_are_there_are_not_driven_again(
    tmp_path: Path, driven: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ldc.Controller, "batch", 10)
    ldc.run_study(noisy(20, 20), tmp_path / "out", workers=1)
    before = sum(driven)
    ldc.run_study(noisy(20, 40), tmp_path / "out", workers=1)
    assert sum(driven) - before == 4 * 20 + 3 * 20  # four designs, and three finalists with the baseline


def test_two_sizes_are_compared_on_what_both_have(tmp_path: Path) -> None:
    for name, counts in (("small", (8, 6)), ("large", (12, 20))):
        ldc.run_study(noisy(*counts), tmp_path / name, workers=1)
    compared = ldc.compare(tmp_path / "small", tmp_path / "large")
    assert (compared.shared.left, compared.shared.right, compared.shared.other_draws) == (8, 6, 0)
    assert (compared.S.difference == 0.0).all()
    assert compared.differences == ("scenarios.left: 8 -> 12", "scenarios.right: 6 -> 20")


def scenarios_of(how: str) -> ldc.Scenarios:
    if how == "drift":
        return ldc.Scenarios.from_drifts(
            v=[20.0, 25.0, 22.0], lateral_velocity=[0.4, 0.5, 0.6], radius=1200.0, distance=[0.5, 0.4, 0.3], T=6.0,
            side=[-1, 1, 1],
        )  # fmt: skip
    drawn = ldc.load_model("reference").sample(3, 3, seed=2)
    return drawn.take(np.array([3, 0, 4, 1, 5, 2]))  # right ones at even rows


@pytest.mark.parametrize("how", ["drawn", "drift"])
def test_given_scenarios_are_read_back(tmp_path: Path, how: str, make_study: Callable[..., ldc.Study]) -> None:
    given = scenarios_of(how)
    results = ldc.run_study(noisy(1, 1), tmp_path, scenarios=given, workers=1)
    back = ldc.read_results(tmp_path)
    assert_same_results(back, results)
    assert (
        back.scenarios.index.tolist()
        == results.scenarios.index.tolist()
        == np.argsort(-given.side, kind="stable").tolist()
    )
    for design, S in zip(back.designs, back.S, strict=True):
        again = ldc.simulate(design.controller(), back.scenarios, design.y_s, setup=noisy(1, 1).setup())
        np.testing.assert_array_equal(again.S, S)
    assert (back.scenarios.drift is None) == (how == "drawn")
