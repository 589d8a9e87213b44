"""Studies on vehicle models of a designer's: files, identity, workers, other plants."""

from pathlib import Path

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.errors import refused
from ldctoolkit.errors import InputError, StoreError, StudyError
from ldctoolkit.studies import load_study, rank_study, read_results, run_study
from ldctoolkit.studies.catalog import my_car
from ldctoolkit.studies.robustness import RobustnessTask, work_out
from ldctoolkit.studies.study_file import CATALOG, toml_text

STUDY = """
name = "mine"
scenarios = {{ left = 8, right = 8 }}
{vehicle}
ranking = {{ finalists = 0{ranking} }}
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [0.1, 0.3]
[[design]]
law = "pid"
y_s = 0.1
"""


def written(folder: Path, vehicle: str = 'vehicle = { model = "my_car.py:Car" }', ranking: str = "") -> Path:
    text = (CATALOG / "my_car.py").read_text(encoding="utf-8")
    (folder / "my_car.py").write_text(text, encoding="utf-8")
    (folder / "mine.toml").write_text(STUDY.format(vehicle=vehicle, ranking=ranking), encoding="utf-8")
    return folder / "mine.toml"


@pytest.mark.slow
def test_an_edit_of_the_vehicle_is_run_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, out = written(tmp_path), tmp_path / "out"
    monkeypatch.chdir(tmp_path)
    study = load_study(path.name)
    first = run_study(study, directory=out, workers=1)
    monkeypatch.chdir("/")  # results open wherever one is
    np.testing.assert_array_equal(read_results(out).S, first.S)
    np.testing.assert_array_equal(run_study(study, directory=tmp_path / "two", workers=2).S, first.S)
    car = tmp_path / "my_car.py"
    car.write_text("# a comment\n" + car.read_text(encoding="utf-8"), encoding="utf-8")
    assert load_study(path).hash == study.hash
    car.write_text(car.read_text(encoding="utf-8").replace("relaxation: float = 0.4", "relaxation: float = 2.0"))
    with pytest.raises(StoreError):
        read_results(out)
    edited = load_study(path)
    assert edited.hash != study.hash == study.with_content(study.content()).hash
    again = run_study(edited, directory=out, workers=1)
    fresh = run_study(edited, directory=tmp_path / "fresh", workers=1)
    np.testing.assert_array_equal(again.S, fresh.S)
    assert not np.array_equal(again.S, first.S)
    np.testing.assert_array_equal(run_study(study, directory=tmp_path / "old", workers=1).S, first.S)
    with pytest.raises(StoreError):  # another vehicle is another study
        run_study(load_study(written(tmp_path, vehicle="")), directory=out, workers=1)


def test_a_study_made_in_python_and_one_of_the_catalog(tmp_path: Path) -> None:
    study = ldc.study(ldc.NoControl, ldc.LQR, left=5, right=5, vehicle_model=my_car.Car(mu=0.8), y_s=0.1)
    setup = study.setup()
    assert setup.vehicle_model == my_car.Car(mu=0.8)
    run_study(study, directory=tmp_path, workers=1)
    assert read_results(tmp_path).setup == setup
    catalog = load_study("my-vehicle")
    assert "my_car.py:Car" in toml_text(catalog)
    car = catalog.setup().vehicle_model
    assert car is not None
    fitted = car.single_track(catalog.vehicle)
    np.testing.assert_allclose(fitted.C_af, catalog.vehicle.C_af, rtol=2e-3)
    np.testing.assert_allclose(fitted.I_z, catalog.vehicle.I_z, rtol=2e-3)


def test_the_ranking_on_another_vehicle(tmp_path: Path) -> None:
    """A study on the built-in plant scores its designs on the vehicle model too; the report drives the best on it."""
    study = load_study(written(tmp_path, vehicle="", ranking=', vehicles = ["light", "my_car.py:Car"]'))
    results = run_study(study, directory=tmp_path / "out", workers=1)
    ranking = rank_study(results, study)
    (measure,) = (name for name in results.measures if name.startswith("S of Car"))
    for design, S in zip(results.designs, results.measures[measure], strict=True):
        on_car = ldc.Setup(vehicle_model=my_car.Car())
        alone = ldc.simulate(design.controller("consistent"), results.scenarios, design.y_s, setup=on_car)
        assert pytest.approx(alone.S.mean(), rel=1e-12) == S
    robustness = work_out(RobustnessTask.of(results, ranking, study.setup(), per_side=4, vehicles=study.vehicles))
    assert "Vehicle Car" in robustness.titles
    assert not np.isnan(robustness.S[robustness.titles.index("Vehicle Car")]).any()
    on_model = load_study(written(tmp_path))
    results = run_study(on_model, directory=tmp_path / "model", workers=1)
    both = [my_car.Car(mu=0.5), my_car.Car(mu=0.6)]
    task = RobustnessTask.of(results, ranking, study.setup(), per_side=2, vehicles=both)
    assert [plant.name for plant in task.plants][1:3] == ["model-Car", "model-Car-2"]
    task = RobustnessTask.of(results, rank_study(results, on_model), on_model.setup(), per_side=2)
    assert "Single track" in [plant.title for plant in task.plants]
    assert "Saturating tyres" in [title for title, _ in task.left_out]


@pytest.mark.parametrize(
    ("model", "path"),
    [("my_car.py:Cab", "vehicle.model"), ("other.py:Car", "vehicle.model"), ("Car", "vehicle.model"),
     ("my_car.py:ca", "vehicle.model")],
)  # fmt: skip
def test_names_that_are_no_vehicle_model(model: str, path: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError) as caught:
        load_study(written(tmp_path, vehicle=f'vehicle = {{ model = "{model}" }}'))
    assert caught.value.path.endswith(path)
    with pytest.raises(StudyError):
        load_study(written(tmp_path, vehicle="", ranking=f', vehicles = ["{model}"]'))


@pytest.mark.parametrize("ranking", [', vehicles = ["light"]', ', require = ["S_worst <= 3"]'])
def test_named_vehicles_are_changes_of_the_single_track(ranking: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError) as caught:
        load_study(written(tmp_path, ranking=ranking))
    assert caught.value.path.endswith("ranking.vehicles")
    load_study(written(tmp_path, ranking=', vehicles = ["my_car.py:Car"], require = ["S_worst <= 3"]'))


def test_a_vehicle_file_that_raises(tmp_path: Path) -> None:
    path = written(tmp_path)
    (tmp_path / "my_car.py").write_text("1 / 0")
    with refused(f"{path}: vehicle.model", StudyError, value="my_car.py:Car"):
        load_study(path)
    with refused("vehicle_model", InputError):
        ldc.Setup(vehicle_model=3)  # type: ignore[arg-type]
