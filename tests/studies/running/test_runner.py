"""Running and storing studies: the same bits however they are run, resumed, or read back."""

import dataclasses
import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.closed_loop import known
from helpers.results import assert_same_results
from helpers.stored import rewrite_json
from ldctoolkit import BicycleModel, Controller, EventStatus, LdcError, Plant, controller_class, simulate
from ldctoolkit.errors import InputError, StoreError, UnknownNameError
from ldctoolkit.metrics import METRIC_COLUMNS, METRIC_UNITS
from ldctoolkit.simulation import Run, Takeover, loop
from ldctoolkit.studies import Study, StudyResults, rank_study, read_manifest, read_results, run_study

pytestmark = pytest.mark.usefixtures("laws")

MakeStudy = Callable[..., Study]


@pytest.fixture
def reference(make_study: MakeStudy, tmp_path: Path) -> StudyResults:
    return run_study(make_study(), directory=tmp_path / "reference", workers=1)


@pytest.mark.parametrize(
    "settings", [{"workers": 2, "block_size": 3}, {"executor": "serial", "block_size": 2}], ids=str
)
def test_no_split_changes_a_bit(settings: Any, make_study: MakeStudy, reference: StudyResults, tmp_path: Path) -> None:
    folder = tmp_path / "other"
    assert_same_results(run_study(make_study(), directory=folder, **settings), reference)  # type: ignore[arg-type]
    assert_same_results(read_results(folder), reference)


def test_results_are_those_of_simulate(make_study: MakeStudy, reference: StudyResults) -> None:
    for window, convention in (("departure", "consistent"), ("control", "as_printed")):
        study = make_study(simulation={"window": window, "convention": convention})
        results = reference if window == "departure" else run_study(study, workers=1)
        assert (results.window, results.convention) == (window, convention)
        for i, design in enumerate(study.designs):
            outcome = simulate(
                design.controller(results.convention), results.scenarios, setup=study.setup(), y_s=design.y_s,
                window=results.window,
            )  # fmt: skip
            np.testing.assert_array_equal(results.S[i], outcome.S)
            np.testing.assert_array_equal(results.S_uncorrected[i], outcome.S_uncorrected)
            np.testing.assert_array_equal(results.status[i], outcome.status)
            for name in METRIC_UNITS:
                exact = getattr(outcome.metrics, name)
                np.testing.assert_array_equal(getattr(results.metrics, name)[i], exact)


def counting(drives: list[Controller]) -> Callable[..., Iterator[Run]]:
    """What drives several designs, with a note of every design."""

    def drive(controllers: list[Controller], takeover: Takeover, **settings: int) -> Iterator[Run]:
        drives.extend(controllers)
        return loop.drive_many(controllers, takeover, **settings)

    return drive


EVERYTHING_DRAWN = {
    "speed": "profile",
    "actuator": {"rate_max": 0.5, "lag": 0.1, "delay": 0.03},
    "mismatch": {"m": [1.0, 1.3], "C_af": [0.8, 1.2]},
    "sensors": {"e_y_noise": 0.03, "e_psi_noise": 0.003, "delay": 0.1, "curvature_noise": 2e-4, "kalman": {}},
    "residuals": {"y": True, "v": True},
}


@pytest.mark.slow
def test_no_drawn_number_depends_on_how_the_work_is_split(make_study: MakeStudy, tmp_path: Path) -> None:
    """Noise, mismatch and residuals belong to the scenario, whoever drives it; another seed draws others."""
    study = make_study(plant=EVERYTHING_DRAWN)
    one = run_study(study, directory=tmp_path / "a", workers=1, block_size=100)
    assert_same_results(run_study(study, directory=tmp_path / "b", workers=1, block_size=1), one)
    assert_same_results(read_results(tmp_path / "b"), one)
    ideal = run_study(make_study(), directory=tmp_path / "d", workers=1)
    assert not np.array_equal(ideal.S[1], one.S[1])
    design = study.designs[1]
    settings = {"vehicle": BicycleModel(study.vehicle), "y_s": design.y_s, "options": study.plant}
    for seed, same in ((study.seed, True), (study.seed + 1, False)):
        outcome = simulate(design.controller(), one.scenarios, seed=seed, **settings)  # type: ignore[arg-type]
        assert np.array_equal(outcome.S, one.S[1]) == same


def test_the_horizon_of_the_study_is_driven(make_study: MakeStudy, tmp_path: Path) -> None:
    """S ends with the departure; overshoot and steering go on."""
    longer = run_study(make_study(), directory=tmp_path / "a", workers=1)
    none = make_study(simulation={"settle": 0})
    shorter = run_study(none, directory=tmp_path / "b", workers=1)
    np.testing.assert_array_equal(longer.S, shorter.S)
    np.testing.assert_array_equal(longer.metrics.deepest, shorter.metrics.deepest)
    assert (longer.metrics.travel > shorter.metrics.travel).any()


def commands_of(study: Study, y_s: float, results: StudyResults) -> int:
    """One a sample: from each trigger to the end of the horizon, the last step of a departure may be shorter."""
    takeover = Takeover.build(results.scenarios, study.setup(), y_s=y_s)
    driven = takeover.triggered.T - takeover.start
    return sum(int(np.ceil(round(float(t) / 0.05, 6))) + 60 for t in driven)


def test_parts_hold_double_precision_and_no_times(make_study: MakeStudy, tmp_path: Path) -> None:
    """The same runs give the same file, byte by byte; the times, which no second run gives again, stand apart."""
    import polars as pl

    study = make_study(design=[{"law": "linear_mpc", "y_s": 0.1}, {"law": "lqr", "y_s": 0.1}])
    for folder in ("a", "b"):
        run_study(study, directory=tmp_path / folder, workers=1, block_size=2)  # else the clock decides
    (one,), (other,) = (list((tmp_path / folder / "results").iterdir()) for folder in ("a", "b"))
    assert (one.name, one.read_bytes()) == (other.name, other.read_bytes())
    schema = pl.read_parquet_schema(one)
    assert [schema[column] for column in METRIC_COLUMNS.values()] == [pl.Float64()] * len(METRIC_COLUMNS)
    assert schema["S_departure_m_s"] == pl.Float64()
    assert not [name for name in schema if "second" in name]

    content = json.loads((tmp_path / "a" / "timing.json").read_text())["designs"]
    mpc, lqr = (content[design.id] for design in study.designs)
    assert mpc["law_seconds"] > 0
    assert lqr["law_seconds"] == lqr["law_time_us"] == 0
    assert mpc["law_time_us"] == pytest.approx(1e6 * mpc["law_seconds"] / mpc["commands"], rel=1e-12)
    assert read_results(tmp_path / "a").law_time.tolist() == [mpc["law_seconds"] / mpc["commands"], 0.0]
    assert mpc["commands"] == commands_of(study, 0.1, read_results(tmp_path / "a"))


def test_what_a_resume_adds_up(make_study: MakeStudy, tmp_path: Path) -> None:
    """Interrupted between two batches: times and counts are those of both runs together, the numbers those of one."""
    prepared: list[int] = []

    class Metered(controller_class("failing")):  # type: ignore[misc]
        name = "metered"
        batch = 4

        def prepare(self, plant: Plant) -> Any:
            prepared.append(plant.n)
            if len(prepared) == 2:  # after the first batch
                raise KeyboardInterrupt
            return super().prepare(plant)

    with known(Metered):
        study = make_study(simulation={}, design=[{"law": "metered", "y_s": 0.0}])
        with pytest.raises(KeyboardInterrupt):
            run_study(study, directory=tmp_path / "s", workers=1)
        # as if the first run had taken long
        timing, manifest = tmp_path / "s" / "timing.json", tmp_path / "s" / "manifest.json"
        this = study.designs[0].id
        times_before = rewrite_json(timing, lambda x: x["designs"][this].update(law_seconds=500.0))
        first = times_before["designs"][this]["commands"]
        long_ago = {"wall_time_s": 1000.0, "created": "2020-01-01T00:00:00+00:00"}
        before = rewrite_json(manifest, lambda x: x.update(long_ago))
        resumed = run_study(study, directory=tmp_path / "s", workers=1)
        whole = run_study(study, directory=tmp_path / "whole", workers=1)
        after = read_manifest(tmp_path / "s")
    assert_same_results(resumed, whole)
    assert whole.failed_solves.any()
    assert 1000.0 < after.wall_time_s < 1600.0
    assert (after.created, before["finished"]) == ("2020-01-01T00:00:00+00:00", "")
    assert after.finished
    times = [
        json.loads((tmp_path / folder / "timing.json").read_text())["designs"][study.designs[0].id]
        for folder in ("s", "whole")
    ]
    assert 0 < first < times[0]["commands"] == times[1]["commands"] == commands_of(study, 0.0, whole)
    assert 500.0 < times[0]["law_seconds"] < 600.0


def test_times_are_kept_on_resuming(make_study: MakeStudy, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    study = make_study(design=[{"law": "failing", "y_s": [0.0, 0.1]}])
    run_study(study, directory=tmp_path, workers=1)
    path = tmp_path / "timing.json"
    before = path.read_text()
    run_study(study, directory=tmp_path, workers=1)
    assert path.read_text() == before
    # what is computed anew gets a new time, the rest keeps its own
    for part in (tmp_path / "results").iterdir():
        part.unlink()
    run_study(study, directory=tmp_path, workers=1)
    assert path.read_text() != before

    for broken in ("{", "[]", '{"designs": {"a": {"b": {"law_seconds": -1, "commands": 3}}}}', '{"designs": 3}'):
        path.write_text(broken)
        with pytest.raises(StoreError, match=r"timing\.json: broken; .*remove it to go on without") as caught:
            read_results(tmp_path)
        assert "\n" not in str(caught.value)
        caplog.clear()
        results = run_study(study, directory=tmp_path, workers=1)
        assert "timing.json: broken" in caplog.text
        assert np.isnan(results.law_time).all()
        assert not path.exists()
        assert np.isnan(read_results(tmp_path).law_time).all()


def test_what_is_undrivable_is_stored(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Regenerated speed that falls below the floor: NaN and a status, and the ranking tells."""
    from ldctoolkit.scenario_model import ScenarioModel

    sample = ScenarioModel.sample

    def wild(*a: object, **k: object) -> object:
        scenarios = sample(*a, **k)  # type: ignore[arg-type]
        return dataclasses.replace(scenarios, sigma_v=np.where(np.arange(12) % 4 == 1, 30.0, 0.0))

    monkeypatch.setattr(ScenarioModel, "sample", wild)
    study = make_study(plant={"speed": "profile", "residuals": {"v": True}})
    results = run_study(study, directory=tmp_path, workers=1)
    assert_same_results(read_results(tmp_path), results)
    invalid = results.status == EventStatus.INVALID
    assert invalid.tolist() == [[i % 4 == 1 for i in range(12)]] * len(study.designs)
    np.testing.assert_array_equal(np.isnan(results.S), invalid)
    np.testing.assert_array_equal(np.isnan(results.metrics.a_y_peak), invalid)
    ranking = rank_study(results, study)
    assert np.isfinite(ranking.metrics.S).all()
    assert ranking.metrics.invalid.tolist() == [3] * len(study.designs)
    assert "3 of 12 scenarios cannot be driven" in ranking.warnings[0]


def test_a_study_resumes_where_it_was_stopped(
    make_study: MakeStudy, reference: StudyResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An interrupt after a few designs; then only the rest is computed, with the same bits."""
    from ldctoolkit.studies.running import tasks

    drives: list[Controller] = []

    def interrupted(controllers: list[Controller], takeover: Takeover, **settings: int) -> Iterator[Run]:
        if len(drives) == 4:
            raise KeyboardInterrupt
        return counting(drives)(controllers, takeover, **settings)

    monkeypatch.setattr(tasks, "drive_many", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_study(make_study(), directory=tmp_path / "s", workers=1, block_size=1)
    assert read_manifest(tmp_path / "s").finished == ""
    with pytest.raises(StoreError, match=r"3 of 7 designs are not complete \(57 % of the scenario runs are there\)"):
        read_results(tmp_path / "s")

    monkeypatch.setattr(tasks, "drive_many", counting(drives))
    again = run_study(make_study(), directory=tmp_path / "s", workers=1)
    assert len(drives) == 7
    assert_same_results(again, reference)
    assert_same_results(read_results(tmp_path / "s"), reference)
    assert read_manifest(tmp_path / "s").finished

    run_study(make_study(title="new words"), directory=tmp_path / "s", workers=1)
    assert len(drives) == 7
    assert read_manifest(tmp_path / "s").study["title"] == "new words"


@pytest.mark.slow
def test_a_law_that_only_this_process_knows_reaches_the_workers(make_study: MakeStudy, tmp_path: Path) -> None:
    """A class inside a function: no other process could import it."""

    class Local(controller_class("toy")):  # type: ignore[name-defined,misc]
        name = "local"

    with known(Local):
        study = make_study(design=[{"law": "local", "gains": {"N": [1, 2, 3]}}])
        one = run_study(study, directory=tmp_path / "a", workers=1)
        assert_same_results(run_study(study, directory=tmp_path / "b", workers=2, block_size=1), one)


def test_a_law_that_cannot_be_sent_is_named(make_study: MakeStudy, tmp_path: Path) -> None:
    class Held(controller_class("toy")):  # type: ignore[name-defined,misc]
        name = "held"
        lock = threading.Lock()

    with known(Held), pytest.raises(LdcError, match=r"registered controllers \(.*Held.*\) cannot be sent to worker"):
        run_study(make_study(design=[{"law": "held"}]), directory=tmp_path, workers=2)


def test_designs_may_be_added_and_left_out(make_study: MakeStudy, reference: StudyResults, tmp_path: Path) -> None:
    """A folder belongs to its scenarios and plant; what it holds of a design is used again."""
    folder = tmp_path / "reference"
    before = {path.name for path in (folder / "results").iterdir()}
    fewer = make_study(design=[{"law": "none"}, {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [50, 500]}}])
    results = run_study(fewer, directory=folder, workers=1)
    assert {path.name for path in (folder / "results").iterdir()} == before
    assert [d.id for d in results.designs] == [d.id for d in fewer.designs]
    np.testing.assert_array_equal(results.S, reference.S[[0, 5, 6]])
    assert_same_results(read_results(folder), results)
    more = make_study(design=[{"law": "none"}, {"law": "lqr", "y_s": [0.1, 0.3], "gains": {"r_delta": [50, 500]}}])
    run_study(more, directory=folder, workers=1)
    added = {path.name for path in (folder / "results").iterdir()} - before
    assert len(added) == 1
    assert_same_results(run_study(make_study(), directory=folder, workers=1), reference)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"seed": 4}, r"holds another study \(small\): seed: 3 there, 4 now; choose another folder"),
        ({"vehicle": {"m": 900.0}}, r"vehicle\.m: 1000\.0 there, 900\.0 now"),
        ({"simulation": {"settle": 1}}, r"simulation\.settle: 3\.0 there, 1\.0 now; choose"),
        ({"plant": {"speed": "profile"}}, r"plant\.speed: 'frozen' there, 'profile' now; choose"),
        ({"plant": {"actuator": {"rate_max": 0.5}}}, r"plant\.actuator\.rate_max: not set there, 0\.5 now; choose"),
        ({"plant": {"sensors": {"kalman": {}}}}, r"plant\.sensors\.kalman: not set there, \{'q_y': 0\.5"),
        ({"simulation": {"window": "control"}}, r"simulation\.window: 'departure' there, 'control' now; choose"),
    ],
)  # fmt: skip
def test_a_folder_of_another_study_is_refused(
    other: dict[str, object], message: str, make_study: MakeStudy, reference: StudyResults, tmp_path: Path
) -> None:
    before = sorted((p, p.stat().st_mtime_ns) for p in (tmp_path / "reference").rglob("*"))
    with pytest.raises(StoreError, match=message):
        run_study(make_study(**other), directory=tmp_path / "reference")
    assert sorted((p, p.stat().st_mtime_ns) for p in (tmp_path / "reference").rglob("*")) == before


def test_another_model_is_refused(make_study: MakeStudy, reference: StudyResults, tmp_path: Path) -> None:
    path = tmp_path / "reference" / "manifest.json"
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"seed": 4}))
    with pytest.raises(StoreError, match=r"manifest\.json: broken: its content is not what was written"):
        run_study(make_study(), directory=tmp_path / "reference")
    path.write_text(json.dumps(content))  # another layout is the same content
    rewrite_json(path, lambda x: x.update(model_hash="0" * 64))
    with pytest.raises(StoreError, match=r"model: reference \(content 000000000000\) there, reference \(content"):
        run_study(make_study(), directory=tmp_path / "reference")


def test_a_folder_without_a_study_is_named(tmp_path: Path, make_study: MakeStudy) -> None:
    with pytest.raises(StoreError, match="is not the folder of a study"):
        read_results(tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "mine.txt").write_text("")
    with pytest.raises(StoreError, match="is not the folder of a study"):
        run_study(make_study(), directory=tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="is not the folder of a study"):
        run_study(make_study(), directory=tmp_path / "file")


def test_the_manifest_tells_what_ran(reference: StudyResults, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from ldctoolkit.studies.storage.manifest import _command

    text = (tmp_path / "reference" / "manifest.json").read_text()
    manifest = read_manifest(tmp_path / "reference")
    assert {"ldctoolkit", "numpy", "osqp"} <= set(manifest.versions)
    assert manifest.wall_time_s > 0
    assert manifest.seed == 3
    assert str(Path.home()) not in text
    assert str(tmp_path) not in text
    assert _command(["/usr/bin/ldc", "run", "/home/me/s.toml", "--model=/home/me/m.json", "-o", "out/x"]) == (
        "ldc run s.toml --model=m.json -o out/x"
    )


def test_wrong_arguments_are_named(make_study: MakeStudy, tmp_path: Path) -> None:
    wrong: dict[str, Any] = {"workers": 0, "executor": "process", "block_size": "a", "time_limit": -1}
    limits = (1e-9, 1e10, float("nan"), True, False, "a")
    for name, value in (*wrong.items(), *(("time_limit", limit) for limit in limits)):
        with pytest.raises(InputError) as refused:
            run_study(make_study(), directory=tmp_path, **{name: value})
        assert (refused.value.path, refused.value.value) == (name, pytest.approx(value, nan_ok=True))
    with pytest.raises(UnknownNameError, match="referenc"):
        run_study(make_study(scenarios={"model": "referenc"}), directory=tmp_path)
    assert not list(tmp_path.iterdir())
