"""The scenario model of a study, kept in its folder: a report can be made elsewhere."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Final

from ldctoolkit.errors import ModelError, StoreError
from ldctoolkit.scenario_model import ScenarioModel
from studies.storage.manifest import Manifest

_log = logging.getLogger("studies")

MODEL: Final = "model.json"


def write_model(folder: Path, model: ScenarioModel) -> None:
    """Write or replace a folder's model, whole or not at all.

    A model in memory may hold what JSON does not know. Its scores are no worse for that: what is lost is a part of the
    report, and a warning says so.
    """
    try:
        model.save(folder / MODEL)
    except ModelError as error:
        _log.warning("%s: the report will not show the scenario model (%s)", folder, error)


def read_model(folder: str | Path, manifest: Manifest) -> ScenarioModel | None:
    """Read a folder's model; None where it has none, as folders of earlier versions.

    Parameters
    ----------
    folder : path
    manifest : Manifest
        Of the folder.

    Raises
    ------
    StoreError
        If the file is broken, or holds another model than the manifest names.
    """
    path = Path(folder) / MODEL
    if not path.exists():
        return None
    try:
        model = ScenarioModel.load(path)
    except ModelError as error:
        raise StoreError(f"{error}; run the study into this folder again to write it anew") from None
    if model.content_hash != manifest.model_hash:
        raise StoreError(
            f"{path}: holds the model {model.content_hash[:12]}, the study's is {manifest.model_hash[:12]}; run the "
            "study into this folder again to write it anew"
        )
    return model
