"""Bits that flip, and files that are cut: one sentence, or the numbers that were written."""

import dataclasses
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.bits import LONG, assert_same_bits
from helpers.closed_loop import known
from helpers.models import one_component_model
from helpers.recordings import OFFSET, drive
from ldctoolkit import Controller, LdcError, LinearLaw, Plant
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings import extract_departures, read_departures, write_departures
from ldctoolkit.scenario_model import load_model
from ldctoolkit.studies import Study, StudyResults, rank_study, read_manifest, read_results, run_study
from ldctoolkit.studies.risk import estimate_risk
from ldctoolkit.studies.robustness import RobustnessTask, robustness_of, stored_of
from ldctoolkit.studies.storage.scenario_source import read_model
from ldctoolkit.studies.storage.store import Store

DAMAGES = 600 if LONG else 60


@dataclasses.dataclass(frozen=True)
class Fails(Controller):
    name = "fails"
    title = "Fails"

    def prepare(self, plant: Plant) -> LinearLaw:
        raise ZeroDivisionError("no stiffness")


DESIGNS = [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.3], "gains": {"r_delta": [50, 5000]}}]


def study_of(folder: Path, **content: Any) -> Study:
    usual = {"name": "s", "ranking": {"bootstrap": 100, "finalists": 3}, "design": DESIGNS}
    return Study.from_dict(usual | content, folder=folder)


def zoo_of(folder: Path) -> Study:
    both = {"left": 60, "right": 60, "departures": "d.parquet"}
    designs = [*DESIGNS, {"law": "fails", "y_s": 0.1}]
    return study_of(folder, scenarios={"model": "reference"} | both, design=designs)


def risk_of(folder: Path, n: int = 100) -> Any:
    study = study_of(folder, name="risk")
    return estimate_risk(study.designs[1:2], study, n=n, chunk=50, workers=1, directory=folder / "risk").tally


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Every kind of file: departures with signals, a model, an estimate of risk; studies with fresh scores,
    replayed ones, a design that fails, other plants and recorded paths.
    """
    folder = tmp_path_factory.mktemp("room")
    drives = [drive(f"r{i}", lane_offset=(-1) ** i * (OFFSET + 0.002 * i)) for i in range(12)]
    found = extract_departures(drives, vehicle_width=1.8, keep_signals=True)
    write_departures(folder / "d.parquet", found.departures, found.provenance)
    one_component_model().save(folder / "model.json")
    with known(Fails):
        study = zoo_of(folder)
        results = run_study(study, directory=folder / "zoo", workers=1)
        robustness_of(folder / "zoo", RobustnessTask.of(results, rank_study(results, study), study.setup()))
        paths = study_of(folder, scenarios={"departures": "d.parquet", "path": "recorded"})
        run_study(paths, directory=folder / "paths", workers=1)
        risk_of(folder)
        yield folder


def content_of(folder: Path) -> Any:
    """What reports and rankings of a study's folder are made from."""
    results = read_results(folder)
    store = Store.open(folder)
    store.load(results.designs)
    manifest = read_manifest(folder)
    model = read_model(folder, manifest)
    ranking = rank_study(results, manifest.read_study())
    task = RobustnessTask.of(results, ranking, manifest.read_study().setup())
    plants = stored_of(folder, task)
    scenarios = {f"{f.name}": getattr(results.scenarios, f.name) for f in dataclasses.fields(results.scenarios)}
    return plants, manifest, model and model.content_hash, store.times, store.failures, scenarios, scores_of(results)


def scores_of(results: StudyResults | None) -> Any:
    if results is None:
        return None
    numbers = results.S, results.S_uncorrected, results.status, vars(results.metrics)
    return (
        results.designs,
        results.failed,
        dict(results.measures),
        numbers,
        scores_of(results.fresh),
        scores_of(results.replayed),
    )


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """One bit is another, or the end is missing."""
    at = int(rng.integers(len(data)))
    return data[:at] + (b"" if rng.random() < 0.2 else bytes([data[at] ^ 1 << int(rng.integers(8))]) + data[at + 1 :])


def model_of(path: Path) -> Any:
    model = load_model(path)
    return model.content_hash, model.provenance


def readers(room: Path) -> dict[Path, Callable[[], Any]]:
    """What reads each file."""
    found: dict[Path, Callable[[], Any]] = {room / "model.json": lambda: model_of(room / "model.json")}
    for name in ("d.parquet", "d.signals.parquet"):
        found[room / name] = lambda: read_departures(room / "d.parquet", signals=True)
    for path in (room / "risk" / "risk.parts").glob("*.json"):
        found[path] = lambda: risk_of(room)
    for folder in (room / "zoo", room / "paths"):
        for path in sorted(folder.rglob("*.*")):
            if path.suffix in (".json", ".parquet"):
                found[path] = lambda folder=folder: content_of(folder)  # type: ignore[misc]
    return found


@pytest.mark.slow
def test_damage_is_one_sentence_or_changes_no_number(room: Path, capfd: pytest.CaptureFixture[str]) -> None:
    read = readers(room)
    kinds = {path.name[: 5 if path.name.startswith("part-") else None] for path in read}
    assert kinds == {
        "d.parquet", "d.signals.parquet", "model.json", "manifest.json", "designs.parquet", "measures.parquet",
        "scenarios.parquet", "scenarios.signals.parquet", "part-", "timing.json", "failures.json", "refits.json",
        "robustness.json",
    }  # fmt: skip
    rng = np.random.default_rng(20)
    files = list(read)
    sound = {path: read[path]() for path in files}
    assert sound[room / "zoo" / "manifest.json"][-1][-2:] != (None, None)
    refused = 0
    for k in range(DAMAGES):
        path = files[k % len(files)]
        data = path.read_bytes()
        path.write_bytes(damaged(data, rng))
        try:
            found, sentence = read[path](), ""
        except LdcError as error:
            found, sentence = None, str(error)
        finally:
            path.write_bytes(data)
        refused += bool(sentence)
        assert "\n" not in sentence
        assert not sentence or path.name in sentence
        if not sentence:
            # other plants are worked out anew where their file is broken
            one, other = (value[1:] if path.name == "robustness.json" else value for value in (found, sound[path]))
            assert_same_bits(one, other, f"{path.relative_to(room)}, damage {k}")
    assert refused > 0.7 * DAMAGES
    assert "panicked" not in capfd.readouterr().err


def test_a_run_into_a_damaged_folder_is_one_sentence_or_gives_the_same_numbers(room: Path, tmp_path: Path) -> None:
    """What is damaged is made anew, but for the manifest, which says what the folder is."""
    wanted, study, rng = scores_of(read_results(room / "zoo")), zoo_of(room), np.random.default_rng(3)
    files = [path.relative_to(room / "zoo") for path in readers(room) if path.is_relative_to(room / "zoo")]
    for i, file in enumerate(files[:: 1 if LONG else 3]):
        folder = shutil.copytree(room / "zoo", tmp_path / str(i))
        (folder / file).write_bytes(damaged((folder / file).read_bytes(), rng))
        if file.name == "manifest.json":
            with pytest.raises(StoreError, match=r"manifest\.json: "):
                run_study(study, directory=folder, workers=1)
            continue
        assert_same_bits(scores_of(run_study(study, directory=folder, workers=1)), wanted, str(file))
        assert_same_bits(scores_of(read_results(folder)), wanted, str(file))
