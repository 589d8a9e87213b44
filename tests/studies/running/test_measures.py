"""What a run measures beside its scenario runs: driven once, stored, and judged without another drive."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ldctoolkit.studies.measures as measures
from ldctoolkit.control import EventStatus
from ldctoolkit.controllers import LQR
from ldctoolkit.errors import InputError, StoreError, StudyError
from ldctoolkit.studies import Study, rank_study, read_results, run_study
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.sensitivity.winner_profile import winner_profile
from ldctoolkit.studies.storage.manifest import read_manifest
from ldctoolkit.studies.storage.measure_table import MeasureTable
from ldctoolkit.studies.study_file import toml_text

STANDARD = "euroncap-2026-elk-road-edge"
CONTENT: dict[str, Any] = {
    "name": "measured",
    "scenarios": {"left": 12, "right": 10},
    "ranking": {"bootstrap": 100, "finalists": 2, "vehicles": ["heavy"], "require": [f"{STANDARD} >= 0"]},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [100.0, 1000.0]}}],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("measured") / "run"
    run_study(Study.from_dict(CONTENT), folder, workers=1)
    return folder


@pytest.fixture
def no_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever drives a design raises."""

    def driven(*_: Any, **__: Any) -> None:
        raise AssertionError("a design is driven")

    simulation, run = "ldctoolkit.simulation", "ldctoolkit.studies.measures"
    # the simulation last: a module that is first imported here takes the sound functions from it
    for name in (f"{run}.drive", f"{run}.assess", f"{run}.design_margins", "ldctoolkit.studies.assessment.drive",
                 "ldctoolkit.studies.pages.replay.drive", "ldctoolkit.studies.robustness.design_margins",
                 f"{simulation}.loop.drive_many", f"{simulation}.drive"):  # fmt: skip
        monkeypatch.setattr(name, driven)


@pytest.mark.usefixtures("no_drive")
def test_a_finished_run_is_ranked_without_a_drive(folder: Path) -> None:
    results, study = read_results(folder), read_manifest(folder).read_study()
    ranking = rank_study(results, study)
    lqr = [i for i, design in enumerate(ranking.designs) if not design.is_baseline]
    assert np.isfinite(ranking.metrics.beside["gain_margin"][lqr]).all()
    assert np.isfinite(ranking.metrics.beside["S_worst"]).all()
    assert np.isfinite(ranking.metrics.beside[STANDARD]).all()
    rank_study(results, study.changed(ranking={"require": ["comfort"], "confidence": 0.9}))


def test_a_report_after_the_run_drives_nothing(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Also with paths of departures in the explorer, and a standard at its corners: the same page."""
    file, out = tmp_path / "s.toml", tmp_path / "out"
    file.write_text(toml_text(Study.from_dict(CONTENT)), encoding="utf-8")
    assert main(["run", str(file), "-o", str(out), "--workers", "1", "--quiet"]) == 0
    first = (out / "report.html").read_text(encoding="utf-8")
    request.getfixturevalue("no_drive")
    assert main(["rank", str(out), "--quiet"]) == 0
    assert main(["report", str(out)]) == 0
    assert (out / "report.html").read_text(encoding="utf-8") == first


@pytest.mark.usefixtures("no_drive")
@pytest.mark.parametrize(
    ("ranking", "missing"), [({"vehicles": ["soft"]}, "soft"), ({"require": ["un-r79-b1"]}, "un-r79-b1")]
)
def test_what_was_not_measured_is_named(folder: Path, ranking: dict[str, Any], missing: str) -> None:
    study = read_manifest(folder).read_study().changed(ranking=ranking)
    with pytest.raises(InputError) as caught:
        rank_study(read_results(folder), study)
    assert (caught.value.path, caught.value.value) == ("ranking", missing)
    assert "run the study" in caught.value.hint


def test_a_run_measures_what_is_missing_and_nothing_else(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another vehicle, then nothing new: the same numbers as in one run of all."""
    shutil.copytree(folder, tmp_path / "copy")
    driven: list[list[str]] = []
    drive_on_plants = measures.drive_on_plants

    def counted(designs: Any, *more: Any) -> Any:
        driven.append([design.id for design in designs])
        return drive_on_plants(designs, *more)

    monkeypatch.setattr(measures, "drive_on_plants", counted)
    both = Study.from_dict(CONTENT | {"ranking": CONTENT["ranking"] | {"vehicles": ["heavy", "soft"]}})
    results = run_study(both, tmp_path / "copy", workers=1)
    assert driven == [[design.id for design in both.designs]]
    whole = run_study(both, tmp_path / "whole", workers=1)
    assert results.measures.keys() == whole.measures.keys()
    for name, values in whole.measures.items():
        np.testing.assert_array_equal(results.measures[name], values)
    driven.clear()
    run_study(both, tmp_path / "copy", workers=1)
    assert driven == []


@pytest.mark.parametrize("status", [EventStatus.CRASHED, EventStatus.TIMED_OUT])
def test_a_design_that_ended_or_held_up_its_process_is_not_driven_again(
    folder: Path, status: EventStatus, monkeypatch: pytest.MonkeyPatch
) -> None:
    results, study = read_results(folder), read_manifest(folder).read_study()
    statuses = results.status.copy()
    statuses[1, 3] = status
    faulty = dataclasses.replace(results, status=statuses)
    prepared: list[float] = []
    prepare = LQR.prepare

    def noted(law: LQR, plant: Any) -> Any:
        prepared.append(law.r_delta)
        return prepare(law, plant)

    monkeypatch.setattr(LQR, "prepare", noted)
    measured = measures.measured(faulty, MeasureTable(), study.setup(), ["heavy"], [STANDARD]).measures
    assert set(prepared) == {1000.0}
    for name, values in results.measures.items():
        np.testing.assert_array_equal(np.delete(measured[name], 1), np.delete(values, 1))
        assert np.isnan(measured[name][1])
    with pytest.raises(InputError) as caught:
        winner_profile(faulty, study, faulty.designs[1])
    assert (caught.value.path, caught.value.value) == ("winner", faulty.designs[1].label)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"vehicle": {"m": 1400.0}}, "vehicle.m"),
        ({"vehicle": {"steering_ratio": 20.0}}, "vehicle.steering_ratio"),  # it decides the scores in standards alone
        ({"plant": {"speed": "profile"}}, "plant.speed"),
        ({"simulation": {"dt": 0.02}}, "simulation.dt"),
    ],
)
def test_a_ranking_for_another_vehicle_than_that_of_the_run_is_refused(
    folder: Path, changes: dict[str, Any], key: str
) -> None:
    results, study = read_results(folder), read_manifest(folder).read_study()
    with pytest.raises(StudyError) as caught:
        rank_study(results, study.changed(**changes))
    table, _, name = key.partition(".")
    assert (caught.value.path, caught.value.value) == (f"study measured: {key}", changes[table][name])


def test_another_steering_ratio_is_measured_again(tmp_path: Path) -> None:
    """It decides no scenario run, but the steering wheel velocity of a standard."""
    standard = "euroncap-2026-driveability"
    ranking = {"bootstrap": 100, "finalists": 0, "require": [f"{standard} >= 0"]}
    design = {"law": "lqr", "y_s": -0.4, "gains": {"r_delta": 100_000.0}}
    study = Study.from_dict(CONTENT | {"ranking": ranking, "design": [design]})
    other = study.changed(vehicle={"steering_ratio": 150.0})
    first = run_study(study, tmp_path / "out", workers=1).measures[standard]
    again = run_study(other, tmp_path / "out", workers=1).measures[standard]
    assert again == run_study(other, tmp_path / "other", workers=1).measures[standard] < first


def test_a_run_without_its_measures_says_so_and_is_continued(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As one that was killed after its last scenario."""
    shutil.copytree(folder, tmp_path / "copy")
    (tmp_path / "copy" / "measures.parquet").unlink()
    assert not read_results(tmp_path / "copy").measures
    assert "no loop margins of these designs yet; run the study again to have them" in caplog.text
    study = Study.from_dict(CONTENT)
    again, first = run_study(study, tmp_path / "copy", workers=1), read_results(folder)
    for name, values in first.measures.items():
        np.testing.assert_array_equal(again.measures[name], values)


def test_damaged_measures_are_named_and_made_anew(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "copy")
    path = tmp_path / "copy" / "measures.parquet"
    path.write_bytes(path.read_bytes()[::-1])
    with pytest.raises(StoreError) as caught:
        read_results(tmp_path / "copy")
    assert caught.value.path.endswith("measures.parquet")
    assert run_study(Study.from_dict(CONTENT), tmp_path / "copy", workers=1).measures
