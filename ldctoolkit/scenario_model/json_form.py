"""The JSON form of a scenario model: writing, and reading with a check of every value."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS
from ldctoolkit.errors import InputError, ModelError, nearest
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model._reader import Reader, is_number, parse, short
from ldctoolkit.scenario_model.card import ModelProvenance
from ldctoolkit.scenario_model.card_json import card_from_json, card_to_json
from ldctoolkit.scenario_model.parts import LEAST_LOWER, SideModel, check_usable

FORMAT: Final = "ldctoolkit-scenario-model"
VERSION: Final = 3

_HASHED_VERSION: Final = 1
"""Stands in the hashed content and never changes: studies resume by the hash."""

_SIDE_KEYS: Final = ("parameters", "constants", "transform", "lower", "upper", "weights", "means", "covariances")


def _open(bound: FloatArray) -> list[float | None]:
    return [float(b) if np.isfinite(b) else None for b in bound]


def side_to_json(side: SideModel) -> dict[str, Any]:
    """One side as JSON values; an open bound is null."""
    lower, upper = side.bounds()
    m = side.mixture
    return {
        "parameters": list(side.names),
        "constants": dict(side.constants),
        "transform": list(side.transform()),
        "lower": _open(lower),
        "upper": _open(upper),
        "weights": m.weights_.tolist(),
        "means": m.means_.tolist(),
        "covariances": m.covariances_.tolist(),
    }


def model_to_json(left: SideModel, right: SideModel, provenance: ModelProvenance) -> dict[str, Any]:
    """The whole file as JSON values."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": dict(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)),
        "sides": {"left": side_to_json(left), "right": side_to_json(right)},
        "provenance": card_to_json(provenance),
    }


def content_hash(left: SideModel, right: SideModel) -> str:
    """SHA-256 over all that sampling depends on; the card and the file's version are left out."""
    content = {"format": FORMAT, "version": _HASHED_VERSION, "left": _hashed(left), "right": _hashed(right)}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _hashed(side: SideModel) -> dict[str, Any]:
    """One side; transforms only where there are any."""
    content = side_to_json(side)
    if all(kind == "none" for kind in content["transform"]):
        del content["transform"]
    return content


def read_json(text: str, file: str) -> Mapping[str, Any]:
    """Parse, and check format and version."""
    reader = Reader(file)
    data = parse(text, file)
    if not isinstance(data, dict):
        raise ModelError(f"{file}: not a scenario model; the file must hold a JSON object")
    if data.get("format") != FORMAT:
        raise reader.wrong("format", f"{short(data.get('format'))}; allowed: {FORMAT!r}")
    version = data.get("version")
    if type(version) is not int or version != VERSION:
        newer = isinstance(version, int) and version > VERSION
        hint = ": the file is newer, update ldctoolkit" if newer else ""
        raise reader.wrong("version", f"{short(version)}; this program reads version {VERSION}{hint}")
    return data


def model_from_json(data: Mapping[str, Any], file: str) -> tuple[SideModel, SideModel, ModelProvenance]:
    """Check and build both sides and the card."""
    reader = Reader(file)
    reader.only(data, "", ("format", "version", "units", "sides", "provenance"))
    sides = reader.member(data, "sides", "", dict, "an object")
    reader.only(sides, "sides", ("left", "right"))
    units = reader.member(data, "units", "", dict, "an object")
    reader.only(units, "units", PARAMETER_NAMES)
    for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True):
        if units.get(name) != unit:
            raise reader.wrong(f"units.{name}", f"{short(units.get(name))}; allowed: {unit!r}")
    built = [
        _side(reader, reader.member(sides, name, "sides", dict, "an object"), f"sides.{name}")
        for name in ("left", "right")
    ]
    return built[0], built[1], card_from_json(reader, reader.member(data, "provenance", "", dict, "an object"))


def _side(reader: Reader, data: Mapping[str, Any], path: str) -> SideModel:
    reader.only(data, path, _SIDE_KEYS)
    names, constants = _parameters(reader, data, path)
    d = len(names)
    lower, upper = _bound(reader, data, path, "lower", names), _bound(reader, data, path, "upper", names)
    transform = reader.member(data, "transform", path, list, "a list of names")
    if len(transform) != d or not all(kind in ("none", "log", "logit") for kind in transform):
        raise reader.wrong(f"{path}.transform", f"{short(transform)}; allowed: {d} of 'none', 'log', 'logit'")
    weights, means, covariances = _components(reader, data, path, d)
    try:
        with np.errstate(all="ignore"):  # absurd numbers overflow; what comes out is checked below
            mixture = BoundedGaussianMixture.from_parameters(
                weights, means, covariances, lower=lower, upper=upper, transform=transform, names=names
            )
        check_usable(mixture)
    except (InputError, ModelError) as error:
        raise reader.wrong(path, str(error)) from None
    return SideModel(
        mixture, names, tuple((name, float(constants[name])) for name in PARAMETER_NAMES if name in constants)
    )


def _parameters(reader: Reader, data: Mapping[str, Any], path: str) -> tuple[tuple[str, ...], dict[str, Any]]:
    names = tuple(reader.member(data, "parameters", path, list, "a list of parameter names"))
    constants: dict[str, Any] = reader.member(data, "constants", path, dict, "an object")
    for name in (*names, *constants):
        if name not in PARAMETER_NAMES:
            raise reader.wrong(f"{path}.parameters", f"{short(name)}; {nearest(str(name), PARAMETER_NAMES)}")
    if sorted((*names, *constants)) != sorted(PARAMETER_NAMES) or not names:
        raise reader.wrong(
            f"{path}.parameters", f"must name each of {', '.join(PARAMETER_NAMES)} once, or constants must"
        )
    for name, value in constants.items():
        if not is_number(value) or (name in LEAST_LOWER and value < LEAST_LOWER[name]):
            raise reader.wrong(f"{path}.constants.{name}", f"{short(value)}; allowed: a finite number in range")
    return names, constants


def _components(
    reader: Reader, data: Mapping[str, Any], path: str, d: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weights, means and covariances."""
    K = len(reader.member(data, "weights", path, list, "a list of numbers"))
    if K == 0:
        raise reader.wrong(f"{path}.weights", "empty; allowed: at least one component")
    weights = reader.array(data, "weights", path, (K,))
    means = reader.array(data, "means", path, (K, d))
    covariances = reader.array(data, "covariances", path, (K, d, d))
    if np.any(weights < 0) or abs(weights.sum() - 1.0) > 1e-9:
        raise reader.wrong(f"{path}.weights", f"sum {weights.sum():.12g}; allowed: shares >= 0 that sum to one")
    for k in range(K):
        where = f"{path}.covariances[{k}]"
        S = covariances[k]
        size = np.sqrt(np.abs(np.diagonal(S)))
        if np.any(np.diagonal(S) <= 0) or np.any(np.abs(S - S.T) > 1e-9 * np.outer(size, size)):
            raise reader.wrong(where, "not positive definite (or not symmetric)")
        if np.linalg.eigvalsh(S / np.outer(size, size))[0] < 1e-13:
            raise reader.wrong(where, "not positive definite")
    return weights, means, covariances


def _bound(reader: Reader, data: Mapping[str, Any], path: str, key: str, names: tuple[str, ...]) -> FloatArray:
    raw = reader.member(data, key, path, list, f"{len(names)} numbers, null for open")
    fill = -np.inf if key == "lower" else np.inf
    finite = reader.array({key: [0.0 if value is None else value for value in raw]}, key, path, (len(names),))
    out = np.where([value is None for value in raw], fill, finite)
    for j, name in enumerate(names):
        if key == "lower" and name in LEAST_LOWER and out[j] < LEAST_LOWER[name]:
            raise reader.wrong(f"{path}.lower[{j}]", f"{name} below {LEAST_LOWER[name]:g} cannot be replayed")
    return out
