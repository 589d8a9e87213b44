"""Bundled models, and models by name or path."""

from __future__ import annotations

import importlib.resources
import os
from pathlib import Path

from ldctoolkit.errors import ModelError, UnknownNameError, nearest
from ldctoolkit.scenario_model.model import ScenarioModel


def bundled_models() -> tuple[str, ...]:
    """Names of the models that come with the toolkit.

    Examples
    --------
    >>> bundled_models()
    ('reference',)
    """
    folder = importlib.resources.files("ldctoolkit") / "models"
    return tuple(sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".json")))


def load_model(name_or_path: str | os.PathLike[str]) -> ScenarioModel:
    """A bundled model by its name, or a model file by its path.

    Parameters
    ----------
    name_or_path : str or path
        ``"reference"``, or a path to a JSON file.

    Returns
    -------
    ScenarioModel
        The model.

    Raises
    ------
    UnknownNameError
        If it is neither a bundled name nor a file; the message lists the names.
    ModelError
        If the file is broken.

    Examples
    --------
    >>> load_model("reference").provenance.synthetic
    True
    """
    name = os.fspath(name_or_path)
    names = bundled_models()
    if name in names:
        text = (importlib.resources.files("ldctoolkit") / "models" / f"{name}.json").read_text(encoding="utf-8")
        return ScenarioModel._parse(text, f"{name}.json")
    path = Path(name)
    try:
        there = path.exists() and name != ""
    except OSError as error:  # a name too long for a file
        raise ModelError(f"{name[:60]}...: cannot read the scenario model ({error.strerror})") from None
    if there:
        return ScenarioModel.load(path)
    if path.suffix == ".json" or path.name != name or not isinstance(name_or_path, str):
        raise ModelError(f"{name}: no such file; bundled models: {', '.join(names)}")
    raise UnknownNameError(f"scenario model {name!r}: neither a bundled model nor a file; {nearest(name, names)}")
