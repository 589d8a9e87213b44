"""Vehicle models that a study names: loaded from files, or known to this process."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from ldctoolkit.code_content import from_file
from ldctoolkit.errors import InputError, raised
from ldctoolkit.vehicle import VehicleModel

from .standards import VEHICLES

MODEL: Final = "FILE.py:NAME of a VehicleModel, or an object of one"
_OTHER: Final = "an object that another process made is known again after ldc.study(..., vehicle_model=...) with it"
_models: Final[dict[str, VehicleModel]] = {}  # of this process, by what studies call them


def load_vehicle_model(path: str, entry: Any, folder: Path | None, known: dict[str, VehicleModel]) -> str:
    """What a study calls a vehicle model, given as an object, a class or FILE.py:NAME; the model into `known`.

    Without a folder of files it is one that this process knows already.
    """
    text, model = (entry, known.get(entry)) if isinstance(entry, str) else ("", entry)
    if isinstance(entry, str) and model is None:
        model = _models.get(entry) if folder is None or ".py:" not in entry else None
        if model is None and ".py:" not in entry:
            raise InputError(path, value=entry, allowed=MODEL, hint=_OTHER if " " in entry else "")
        model = from_file(path, entry, folder or Path(), MODEL) if model is None else model
    if isinstance(model, type) and issubclass(model, VehicleModel):
        try:
            model = model()
        except TypeError as error:
            raise InputError(path, raised(error), value=entry, allowed="a class whose fields have defaults") from None
    if not isinstance(model, VehicleModel):
        raise InputError(path, value=entry, allowed=MODEL)
    text = text or f"{type(model).__name__} {model.identity}"
    known[text] = _models[text] = model
    return text


def with_models(content: dict[str, Any], folder: Path | None, known: dict[str, VehicleModel]) -> dict[str, Any]:
    """What a study file holds, with texts for its vehicle models."""
    vehicle, ranking = content.get("vehicle"), content.get("ranking")
    path, model = "vehicle_model", content.get("vehicle_model") or None
    if isinstance(vehicle, dict) and "model" in vehicle:
        path, model = "vehicle.model", vehicle["model"]
        content = content | {"vehicle": {key: value for key, value in vehicle.items() if key != "model"}}
    if model is not None:
        content = content | {"vehicle_model": load_vehicle_model(path, model, folder, known)}
    names = ranking.get("vehicles") if isinstance(ranking, dict) else None
    if isinstance(ranking, dict) and isinstance(names, list | tuple):
        models = [
            load_vehicle_model(f"ranking.vehicles[{i}]", name, folder, known)
            if not isinstance(name, str) or ":" in name or name in known
            else name
            for i, name in enumerate(names)
        ]
        content = content | {"ranking": ranking | {"vehicles": models}}
    return content


def vehicle_name(name: str) -> str:
    """The name of a vehicle or of a vehicle model; raises `InputError` for any other."""
    if name not in VEHICLES and name not in _models:
        raise InputError(value=name, allowed=(*VEHICLES, "FILE.py:NAME of a VehicleModel"))
    return name
