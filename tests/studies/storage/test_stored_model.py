"""The model in a study's folder: there after a run, checked on reading, lost without harm."""

import dataclasses
import logging
from pathlib import Path

import pytest

from ldctoolkit import Scenarios, load_model
from ldctoolkit.errors import StoreError
from studies import Study, run_study
from studies.storage.files import read_scenarios, scenario_table
from studies.storage.manifest import read_manifest
from studies.storage.stored_model import MODEL, read_model

STUDY = {"name": "small", "scenarios": {"left": 4, "right": 4}, "design": [{"law": "none"}]}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run_study(Study.from_dict(STUDY), directory=tmp_path / "o", workers=1)
    return tmp_path / "o"


def test_a_run_leaves_its_model(folder: Path) -> None:
    model = read_model(folder, read_manifest(folder))
    assert model.content_hash == load_model("reference").content_hash == read_manifest(folder).model_hash
    assert model.provenance == load_model("reference").provenance
    before = (folder / MODEL).read_bytes()
    run_study(Study.from_dict(STUDY), directory=folder, workers=1)
    assert (folder / MODEL).read_bytes() == before


def test_an_older_folder_has_none(folder: Path) -> None:
    (folder / MODEL).unlink()
    assert read_model(folder, read_manifest(folder)) is None


def test_another_or_a_broken_model_is_refused(folder: Path) -> None:
    manifest = read_manifest(folder)
    other = manifest.model_copy(update={"model_hash": "0" * 64})
    with pytest.raises(StoreError, match=r"model\.json: holds the model \w{12}, the study's is 000000000000; run"):
        read_model(folder, other)
    (folder / MODEL).write_text("{")
    with pytest.raises(StoreError, match=r"model\.json, line 1.*run the study into this folder again"):
        read_model(folder, manifest)


def test_a_model_that_json_does_not_know_runs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = load_model("reference")
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"x": object()}))
    with caplog.at_level(logging.WARNING, logger="studies"):
        run_study(Study.from_dict(STUDY), directory=tmp_path / "o", model=odd, workers=1)
    assert "the report will not show the scenario model" in caplog.text
    assert not (tmp_path / "o" / MODEL).exists()


def test_stored_scenarios_beyond_the_limits_of_new_ones_are_read(tmp_path: Path) -> None:
    odd = Scenarios.drawn(T=2.0, d_y=30.0, v_mean=120.0, a_mean=0.0, c_0=0.1, dc=0.0, sigma_y=0.0, sigma_v=0.0, side=1)
    scenario_table(odd).write_parquet(tmp_path / "scenarios.parquet")
    found = read_scenarios(tmp_path / "scenarios.parquet")
    assert (found.v_mean.tolist(), found.d_y.tolist()) == ([120.0], [30.0])
