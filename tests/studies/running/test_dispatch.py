"""The dispatcher against an executor that kills workers by plan: what is found and stored depends on the plan alone."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Unsighted, known
from helpers.executors import DyingWorkers
from ldctoolkit import Controller, EventStatus, Plant, gain
from ldctoolkit.errors import LdcError
from ldctoolkit.studies import Study, read_results, run_study, runner
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.running.tasks import Task

MakeStudy = Callable[..., Study]


class Stepped(Unsighted):
    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        return -0.02 * x[:, 0], state, np.zeros(t.size, dtype=np.int8)


@dataclasses.dataclass(frozen=True)
class Small(Controller):
    name = "small"
    title = "Small"
    batch = 5

    K: float = gain(0.0, unit="1", lower=0.0, upper=9.0, description="raises at 9, in the fast scenarios")

    def prepare(self, plant: Plant) -> Stepped:
        if self.K == 9 and plant.v.max() > FAST[0]:
            raise ZeroDivisionError("too fast")
        return Stepped()


FAST = [np.inf]


@pytest.fixture(autouse=True)
def small() -> Iterator[None]:
    FAST[0] = np.inf
    with known(Small):
        yield


Plan = dict[float, set[int]]
"""Rows that end a worker, by the design's K."""


def dying(seed: int, plan: Plan, workers: int = 2) -> DyingWorkers:
    def deadly(task: Task) -> bool:
        return any(plan.get(K_of(design), set()).intersection(task.rows.tolist()) for design in task.designs)

    return DyingWorkers(deadly, workers=workers, seed=seed)


def K_of(design: Design) -> float:
    return float(dict(design.gains).get("K", -1.0))


def small_study(make_study: MakeStudy, K: list[float], **parts: Any) -> Study:
    designs = [{"law": "small", "y_s": 0.0, "gains": {"K": K}}, {"law": "lqr", "y_s": 0.1}]
    return make_study(**{"design": designs, "scenarios": {"left": 9, "right": 8}, "simulation": {}} | parts)


def use(monkeypatch: pytest.MonkeyPatch, executor: DyingWorkers) -> None:
    monkeypatch.setattr(runner, "make_executor", lambda *words: executor)


@pytest.mark.parametrize(
    ("seed", "block_size"),
    [(1, 1), *(pytest.param(seed, k, marks=pytest.mark.slow) for seed in range(2, 8) for k in (None, 1, 3))],
)
def test_the_same_scenarios_are_found_whatever_ran_beside_them(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored_rows: Callable[..., Any], seed: int,
    block_size: int | None,
) -> None:  # fmt: skip
    """Two designs with a few scenarios at fault, one with too many; the rest as in one process."""
    plan = {1.0: {3}, 2.0: {0, 12}, 4.0: {2, 7, 8, 9, 13}}
    study = small_study(make_study, [0, 1, 2, 3, 4])
    sound = run_study(study, directory=tmp_path / "sound", workers=1)
    use(monkeypatch, dying(seed, plan))
    results = run_study(study, directory=tmp_path / "deadly", block_size=block_size)
    (failed,) = results.failed
    assert (dict(failed.design.gains)["K"], failed.reason.count("(ends its worker process)")) == (4.0, 4)
    for i, design in enumerate(results.designs):
        crashed = np.flatnonzero(results.status[i] == EventStatus.CRASHED)
        assert set(crashed.tolist()) == plan.get(K_of(design), set())
        others = np.setdiff1d(np.arange(17), crashed)
        j = sound.designs.index(design)
        np.testing.assert_array_equal(results.S[i, others], sound.S[j, others])
    rows = stored_rows(tmp_path / "deadly").filter(design=failed.design.id)
    # rows of first pieces (of 5, 4, 4 and 4 scenarios); which one was one too many is a matter of what ran first
    assert rows.height in (0, 5, 9, 13)
    assert set(rows["scenario"]) == set(results.scenarios.index[: rows.height].tolist())
    # a design that failed is tried again, and fails again, though nothing else is left to run
    use(monkeypatch, dying(seed + 100, plan))
    again = run_study(study, directory=tmp_path / "deadly", block_size=block_size)
    assert [one.design for one in again.failed] == [failed.design]
    np.testing.assert_array_equal(again.S, results.S)


@pytest.mark.slow
def test_one_death_among_many_is_no_end(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pool that breaks gives up all that it held, here more tasks than may be lost one after the other."""
    use(monkeypatch, dying(1, {1.0: {3}}, workers=30))
    results = run_study(small_study(make_study, [0.1 * i for i in range(40)]), directory=tmp_path, block_size=1)
    assert not results.failed
    assert int((results.status == EventStatus.CRASHED).sum()) == 1


def test_a_study_of_one_deadly_design(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = small_study(make_study, [1], design=[{"law": "small", "y_s": 0.0, "gains": {"K": 1}}])
    for _ in range(2):
        use(monkeypatch, dying(0, {1.0: set(range(17))}))
        with pytest.raises(LdcError, match=r"every design failed; the first, .*ends or stops its worker process"):
            run_study(study, directory=tmp_path)


def test_dying_workers_kill_no_designs(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, DyingWorkers(lambda _: True))
    with pytest.raises(LdcError, match="worker processes end whatever they run; what was stored is kept"):
        run_study(small_study(make_study, [1]), directory=tmp_path)


@pytest.mark.parametrize("how", [{"workers": 1, "block_size": 1}, pytest.param({"seed": 1}, marks=pytest.mark.slow)])
def test_what_is_stored_of_a_failing_design_is_no_accident(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored_rows: Callable[..., Any],
    how: dict[str, int],
) -> None:  # fmt: skip
    """The pieces before the first one that it fails on, however often it is run."""
    study = small_study(make_study, [0, 9], scenarios={"left": 20, "right": 20})
    from ldctoolkit.studies.runner import study_source

    speeds = study_source(study).sample(20, 20, seed=study.seed).v_mean
    FAST[0] = float(np.sort(speeds)[-3])
    counts = []
    for _ in range(2):
        named = dict(how)
        if "seed" in named:
            use(monkeypatch, dying(named.pop("seed"), {}, workers=4))
            named = {"block_size": 1}
        results = run_study(study, directory=tmp_path, **named)  # type: ignore[arg-type]
        (failed,) = results.failed
        counts.append(stored_rows(tmp_path).filter(design=failed.design.id).height)
    first = next(i for i in range(0, 40, 5) if speeds[i : i + 5].max() > FAST[0])
    assert counts[0] == counts[1]
    assert counts[0] <= first
    assert read_results(tmp_path).failed == results.failed
