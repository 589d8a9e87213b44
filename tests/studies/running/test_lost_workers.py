"""A law that ends or stops its worker: the scenario at fault is found, and everything else is as without it."""

import dataclasses
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import Unsighted, known
from ldctoolkit import Controller, EventStatus, LdcError, Plant, Scenarios, gain, option
from ldctoolkit.studies import Study, StudyResults, read_results, run_study
from ldctoolkit.studies.runner import study_source
from ldctoolkit.studies.running import dispatch, executors

MakeStudy = Callable[..., Study]

LIMIT = 600.0  # seconds that a task may take

FAULTY: list[float] = []  # speeds of the scenarios at fault; sent to workers along with the class


@dataclasses.dataclass(frozen=True)
class FaultLaw(Unsighted):
    how: str
    speeds: Any
    marker: str

    def take(self, rows: Any, state: Any) -> Any:
        return dataclasses.replace(self, speeds=self.speeds[rows]), state

    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        if self.how == "once" and not Path(self.marker).exists():
            Path(self.marker).touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if np.isin(self.speeds, FAULTY).any():
            if self.how == "dies":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.how == "hangs":
                # the end of its time comes forward: no other task can be late on a machine that does other things
                me = threading.get_ident()
                assert time.monotonic() < executors._deadlines[me] <= time.monotonic() + LIMIT
                executors._watch(me, 0.0)
                time.sleep(10 * LIMIT)
        return -0.02 * x[:, 0], state, np.full(t.size, EventStatus.OK, dtype=np.int8)


@dataclasses.dataclass(frozen=True)
class Fault(Controller):
    name = "fault"
    title = "Fault"
    batch = 8

    how: str = option("none", choices=("none", "dies", "hangs", "once"), description="what it does")
    marker: str = option("-", choices=None, description="a file")
    K: float = gain(0.0, unit="1", lower=0.0, upper=9.0, description="tells designs apart")

    def prepare(self, plant: Plant) -> FaultLaw:
        return FaultLaw(self.how, np.array(plant.v), self.marker)


@pytest.fixture(autouse=True)
def fault() -> Iterator[None]:
    FAULTY.clear()
    with known(Fault):
        yield


def scenarios(study: Study) -> Scenarios:
    return study_source(study).sample(study.scenarios.left, study.scenarios.right, seed=study.seed)


def triggered(study: Study, y_s: float) -> tuple[Any, Any]:
    """Rows that trigger, and the speeds that a law is prepared for."""
    from ldctoolkit.simulation import Takeover

    takeover = Takeover.build(scenarios(study), study.setup(), y_s=y_s)
    return takeover.rows, takeover.plant.v


def small(make_study: MakeStudy, how: str, marker: Path | str = "-", K: Any = 0.0) -> Study:
    designs = [
        {"law": "none"},
        {"law": "fault", "y_s": 0.05, "gains": {"how": how, "K": K, "marker": str(marker)}},
        {"law": "lqr", "y_s": 0.1},
    ]
    return make_study(design=designs, scenarios={"left": 12, "right": 12}, simulation={})


def assert_same_but(one: StudyResults, other: StudyResults, design: int, rows: list[int]) -> None:
    """The same numbers, one design's in some scenarios apart."""
    keep = np.ones(one.S.shape, dtype=bool)
    keep[design, rows] = False
    for name in ("S", "status", "failed_solves"):
        np.testing.assert_array_equal(getattr(one, name)[keep], getattr(other, name)[keep])
    np.testing.assert_array_equal(one.metrics.travel[keep], other.metrics.travel[keep])


@pytest.mark.slow
@pytest.mark.parametrize(("how", "status"), [("dies", EventStatus.CRASHED), ("hangs", EventStatus.TIMED_OUT)])
def test_the_scenario_at_fault_is_found(make_study: MakeStudy, tmp_path: Path, how: str, status: EventStatus) -> None:
    study = small(make_study, how)
    sound = run_study(small(make_study, "none"), directory=tmp_path / "sound", workers=1)
    rows, speeds = triggered(study, 0.05)
    at_fault = int(rows[2])
    FAULTY.append(float(speeds[2]))
    results = run_study(study, directory=tmp_path / "fault", workers=2, time_limit=LIMIT)
    assert not results.failed
    assert np.flatnonzero(results.status[1] == status).tolist() == [at_fault]
    assert_same_but(results, sound, 1, [at_fault])
    # what counts there is the path without control, told as a failure
    assert results.S[1, at_fault] == results.S_uncorrected[1, at_fault] == results.S[0, at_fault]
    assert results.metrics.delta_peak[1, at_fault] == 0.0
    assert results.failed_runs[1, at_fault]
    np.testing.assert_array_equal(read_results(tmp_path / "fault").S, results.S)


@pytest.mark.slow
def test_a_worker_that_dies_once_is_bad_luck(make_study: MakeStudy, tmp_path: Path) -> None:
    sound = run_study(small(make_study, "none"), directory=tmp_path / "sound", workers=1)
    study = small(make_study, "once", tmp_path / "marker")
    results = run_study(study, directory=tmp_path / "once", workers=2)
    assert (tmp_path / "marker").exists()
    assert not results.failed
    np.testing.assert_array_equal(results.S, sound.S)
    assert not (results.status == EventStatus.CRASHED).any()


@pytest.mark.slow
def test_a_design_with_many_faults_has_failed(make_study: MakeStudy, tmp_path: Path) -> None:
    study = small(make_study, "dies")
    rows, speeds = triggered(study, 0.05)
    FAULTY.extend(speeds[:6].tolist())
    results = run_study(study, directory=tmp_path, workers=2)
    (failed,) = results.failed
    assert failed.design.law == "fault"
    assert failed.reason.startswith("ends or stops its worker process in scenarios ")
    assert failed.reason.count("(ends its worker process)") == 4
    named = {int(word) for word in failed.reason.replace(",", " ").split() if word.isdigit()}
    assert named <= set(rows[:6].tolist())
    assert [design.law for design in results.designs] == ["none", "lqr"]


@pytest.mark.slow
def test_a_map_over_workers_survives_one_that_dies_once(tmp_path: Path) -> None:
    executor = executors.ProcessExecutor(2)
    with dispatch.closing(executor):
        assert sorted(dispatch.map_on(executor, abs, [-3, 1, -2])) == [1, 2, 3]
        assert list(dispatch.map_on(executor, die_once, [tmp_path / "marker"])) == ["alive"]
        with pytest.raises(LdcError, match="a worker process ended abruptly"):
            list(dispatch.map_on(executor, os._exit, [3]))


def die_once(marker: Path) -> str:
    if not marker.exists():
        marker.touch()
        os._exit(1)
    return "alive"
