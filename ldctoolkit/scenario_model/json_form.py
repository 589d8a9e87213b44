"""The JSON form of a scenario model: writing, and reading with a check of every value."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS
from ldctoolkit.errors import InputError, ModelError, nearest
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model.parts import LEAST_LOWER, ModelProvenance, SideModel, SideSummary, check_usable

FloatArray = npt.NDArray[np.float64]

FORMAT: Final = "ldctoolkit-scenario-model"
VERSION: Final = 1

_SIDE_KEYS: Final = ("parameters", "constants", "lower", "upper", "weights", "means", "covariances")

_WHOLE_DIGITS: Final = 18
"""Longest whole number of a file: it must fit a float and 64 bits."""


def _open(bound: FloatArray) -> list[float | None]:
    return [float(b) if np.isfinite(b) else None for b in bound]


def side_to_json(side: SideModel) -> dict[str, Any]:
    """One side as JSON values; an open bound is null."""
    lower, upper = side.bounds()
    m = side.mixture
    return {
        "parameters": list(side.names),
        "constants": dict(side.constants),
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
        "provenance": dataclasses.asdict(provenance),
    }


def content_hash(left: SideModel, right: SideModel) -> str:
    """SHA-256 over all that sampling depends on; provenance is left out."""
    content = {"format": FORMAT, "version": VERSION, "left": side_to_json(left), "right": side_to_json(right)}
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


class _Reader:
    """Values of one file; every complaint names the file and the key path."""

    def __init__(self, file: str) -> None:
        self.file = file

    def wrong(self, path: str, message: str) -> ModelError:
        return ModelError(f"{self.file}: {path}: {message}")

    def member(self, owner: Mapping[str, Any], key: str, path: str, kind: type | tuple[type, ...], what: str) -> Any:
        here = f"{path}.{key}" if path else key
        if key not in owner:
            near = nearest(key, owner) if owner else "the object is empty"
            raise self.wrong(here, f"missing; {near}")
        value = owner[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.wrong(here, f"{_short(value)}; allowed: {what}")
        return value

    def only(self, owner: Mapping[str, Any], path: str, keys: Iterable[str]) -> None:
        """Refuse unknown keys: a mistyped one would be passed over."""
        known = tuple(keys)
        for key in owner:
            if key not in known:
                raise self.wrong(f"{path}.{key}" if path else _clipped(key), f"not known; {nearest(key, known)}")

    def array(self, owner: Mapping[str, Any], key: str, path: str, shape: tuple[int, ...]) -> FloatArray:
        value = self.member(owner, key, path, list, f"numbers of shape {shape}")
        here = f"{path}.{key}"
        try:
            cells = np.array(value, dtype=object)
        except ValueError:
            raise self.wrong(here, f"not numbers of shape {shape}") from None
        for at, cell in zip(np.ndindex(cells.shape), cells.flat, strict=True):
            if cell is None:
                raise self.wrong(here + "".join(f"[{i}]" for i in at), "null is not a finite number")
            if not _is_number(cell):
                raise self.wrong(here, f"not numbers of shape {shape}: {_short(cell)}")
        if cells.shape != shape:
            raise self.wrong(here, f"shape {cells.shape}; allowed: {shape}")
        return cells.astype(float)


def _is_number(value: object) -> bool:
    """A JSON number; `read_json` has seen to it that all of them are finite."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_whole(value: object) -> bool:
    """A count."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _short(value: object) -> str:
    return _clipped(repr(value))


def _clipped(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."


def read_json(text: str, file: str) -> Mapping[str, Any]:
    """Parse, and check format and version."""

    def refuse(token: str) -> float:
        raise ModelError(
            f"{file}: {_clipped(token)} is not a finite number; allowed: finite numbers, null for an open bound"
        )

    def whole(token: str) -> int:
        if len(token.lstrip("-")) > _WHOLE_DIGITS:
            raise ModelError(f"{file}: {_clipped(token)}; allowed: whole numbers of at most {_WHOLE_DIGITS} digits")
        return int(token)

    def number(token: str) -> float:
        value = float(token)
        return value if math.isfinite(value) else refuse(token)

    try:
        data = json.loads(text, parse_constant=refuse, parse_int=whole, parse_float=number)
    except json.JSONDecodeError as error:
        message = f"{file}, line {error.lineno}, column {error.colno}: broken JSON ({error.msg})"
        raise ModelError(message) from None
    except RecursionError:
        raise ModelError(f"{file}: broken JSON (nested too deeply)") from None
    reader = _Reader(file)
    if not isinstance(data, dict):
        raise ModelError(f"{file}: not a scenario model; the file must hold a JSON object")
    if data.get("format") != FORMAT:
        raise reader.wrong("format", f"{_short(data.get('format'))}; allowed: {FORMAT!r}")
    version = data.get("version")
    if version != VERSION or isinstance(version, bool):
        raise reader.wrong("version", f"{_short(version)}; this program reads version {VERSION}")
    return data


def model_from_json(data: Mapping[str, Any], file: str) -> tuple[SideModel, SideModel, ModelProvenance]:
    """Check and build both sides and the provenance."""
    reader = _Reader(file)
    reader.only(data, "", ("format", "version", "units", "sides", "provenance"))
    sides = reader.member(data, "sides", "", dict, "an object")
    reader.only(sides, "sides", ("left", "right"))
    units = reader.member(data, "units", "", dict, "an object")
    reader.only(units, "units", PARAMETER_NAMES)
    for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True):
        if units.get(name) != unit:
            raise reader.wrong(f"units.{name}", f"{_short(units.get(name))}; allowed: {unit!r}")
    built = [
        _side(reader, reader.member(sides, name, "sides", dict, "an object"), f"sides.{name}")
        for name in ("left", "right")
    ]
    return built[0], built[1], _provenance(reader, reader.member(data, "provenance", "", dict, "an object"))


def _side(reader: _Reader, data: Mapping[str, Any], path: str) -> SideModel:
    reader.only(data, path, _SIDE_KEYS)
    names = tuple(reader.member(data, "parameters", path, list, "a list of parameter names"))
    constants = reader.member(data, "constants", path, dict, "an object")
    for name in (*names, *constants):
        if name not in PARAMETER_NAMES:
            raise reader.wrong(f"{path}.parameters", f"{_short(name)}; {nearest(str(name), PARAMETER_NAMES)}")
    if sorted((*names, *constants)) != sorted(PARAMETER_NAMES) or not names:
        raise reader.wrong(
            f"{path}.parameters", f"must name each of {', '.join(PARAMETER_NAMES)} once, or constants must"
        )
    for name, value in constants.items():
        if not _is_number(value) or (name in LEAST_LOWER and value < LEAST_LOWER[name]):
            raise reader.wrong(f"{path}.constants.{name}", f"{_short(value)}; allowed: a finite number in range")
    d = len(names)
    lower, upper = _bound(reader, data, path, "lower", names), _bound(reader, data, path, "upper", names)
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
    try:
        with np.errstate(all="ignore"):  # absurd numbers overflow; what comes out is checked below
            mixture = BoundedGaussianMixture.from_parameters(
                weights, means, covariances, lower=lower, upper=upper, names=names
            )
        check_usable(mixture)
    except (InputError, ModelError) as error:
        raise reader.wrong(path, str(error)) from None
    return SideModel(
        mixture, names, tuple((name, float(constants[name])) for name in PARAMETER_NAMES if name in constants)
    )


def _bound(reader: _Reader, data: Mapping[str, Any], path: str, key: str, names: tuple[str, ...]) -> FloatArray:
    raw = reader.member(data, key, path, list, f"{len(names)} numbers, null for open")
    fill = -np.inf if key == "lower" else np.inf
    finite = reader.array({key: [0.0 if value is None else value for value in raw]}, key, path, (len(names),))
    out = np.where([value is None for value in raw], fill, finite)
    for j, name in enumerate(names):
        if key == "lower" and name in LEAST_LOWER and out[j] < LEAST_LOWER[name]:
            raise reader.wrong(f"{path}.lower[{j}]", f"{name} below {LEAST_LOWER[name]:g} cannot be replayed")
    return out


def _provenance(reader: _Reader, data: Mapping[str, Any]) -> ModelProvenance:
    path = "provenance"
    reader.only(data, path, (field.name for field in dataclasses.fields(ModelProvenance)))
    left, right = (_summary(reader, data.get(side), f"{path}.{side}") for side in ("left", "right"))
    return ModelProvenance(
        source=reader.member(data, "source", path, dict, "an object"),
        synthetic=reader.member(data, "synthetic", path, bool, "true or false"),
        created=reader.member(data, "created", path, str, "a string"),
        software=reader.member(data, "software", path, str, "a string"),
        seed=reader.member(data, "seed", path, int, "an integer"),
        warnings=tuple(str(w) for w in reader.member(data, "warnings", path, list, "a list of strings")),
        left=left,
        right=right,
    )


def _summary(reader: _Reader, data: object, path: str) -> SideSummary | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise reader.wrong(path, f"{_short(data)}; allowed: an object or null")
    reader.only(data, path, (field.name for field in dataclasses.fields(SideSummary)))
    tried = reader.member(data, "n_components", path, list, "a list of integers")
    m = (len(tried),)
    moved = reader.member(data, "moved_inside", path, list, "a list of [name, count]")
    for pair in moved:
        if not (isinstance(pair, list) and len(pair) == 2 and pair[0] in PARAMETER_NAMES and _is_whole(pair[1])):
            raise reader.wrong(f"{path}.moved_inside", f"{_short(pair)}; allowed: a list of [name, count]")
    for K in tried:
        if not _is_whole(K):
            raise reader.wrong(f"{path}.n_components", f"{_short(K)}; allowed: a list of integers")
    return SideSummary(
        events=reader.member(data, "events", path, int, "an integer"),
        n_components=tuple(tried),
        bic=tuple(reader.array(data, "bic", path, m).tolist()),
        log_likelihood=tuple(reader.array(data, "log_likelihood", path, m).tolist()),
        converged=reader.member(data, "converged", path, bool, "true or false"),
        moved_inside=tuple((name, count) for name, count in moved),
        redrawn_share=float(reader.member(data, "redrawn_share", path, (int, float), "a number")),
    )


def read_text(path: Path) -> str:
    """The file's text; a file that cannot be read is a ModelError."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ModelError(f"{path}: cannot read the scenario model (not UTF-8 text)") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise ModelError(f"{_clipped(str(path))}: cannot read the scenario model ({reason})") from None
