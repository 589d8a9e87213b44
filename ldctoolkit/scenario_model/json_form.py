"""The JSON form of a scenario model: writing, and reading with a check of every value."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS
from ldctoolkit.errors import InputError, ModelError, nearest
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    UNIT,
    FitSettings,
    ModelProvenance,
    SideModel,
    SideSummary,
    SourceSummary,
    check_usable,
)

_WHOLE_DIGITS: Final = 18  # longest whole number of a file: it must fit a float and 64 bits


class Reader:
    """Values of one file."""

    def __init__(self, file: str) -> None:
        self.file = file

    def wrong(self, path: str, message: str) -> ModelError:
        """What to raise for a value."""
        return ModelError(f"{self.file}: {path}: {message}")

    def member(self, owner: Mapping[str, Any], key: str, path: str, kind: type | tuple[type, ...], what: str) -> Any:
        """A value that must be there, of a kind."""
        here = f"{path}.{key}" if path else key
        if key not in owner:
            near = nearest(key, owner) if owner else "the object is empty"
            raise self.wrong(here, f"missing; {near}")
        value = owner[key]
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise self.wrong(here, f"{short(value)}; allowed: {what}")
        return value

    def only(self, owner: Mapping[str, Any], path: str, keys: Iterable[str]) -> None:
        """Refuse unknown keys: a mistyped one would be passed over."""
        known = tuple(keys)
        for key in owner:
            if key not in known:
                raise self.wrong(f"{path}.{key}" if path else clipped(key), f"not known; {nearest(key, known)}")

    def array(self, owner: Mapping[str, Any], key: str, path: str, shape: tuple[int, ...]) -> FloatArray:
        """Finite numbers of a shape."""
        value = self.member(owner, key, path, list, f"numbers of shape {shape}")
        here = f"{path}.{key}"
        try:
            cells = np.array(value, dtype=object)
        except ValueError:
            raise self.wrong(here, f"not numbers of shape {shape}") from None
        for at, cell in zip(np.ndindex(cells.shape), cells.flat, strict=True):
            if cell is None:
                raise self.wrong(here + "".join(f"[{i}]" for i in at), "null is not a finite number")
            if not is_number(cell):
                raise self.wrong(here, f"not numbers of shape {shape}: {short(cell)}")
        if cells.shape != shape:
            raise self.wrong(here, f"shape {cells.shape}; allowed: {shape}")
        return cells.astype(float)

    def rows(self, owner: Mapping[str, Any], key: str, path: str, kinds: tuple[type, ...], what: str) -> Any:
        """A list of short lists, each with values of these kinds, as a tuple of tuples."""
        out = self.member(owner, key, path, list, what)
        for row in out:
            good = isinstance(row, list) and len(row) == len(kinds)
            if not good or not all(
                is_whole(cell) if kind is int else isinstance(cell, kind) for cell, kind in zip(row, kinds, strict=True)
            ):
                raise self.wrong(f"{path}.{key}", f"{short(row)}; allowed: {what}")
        return tuple(tuple(row) for row in out)


def is_number(value: object) -> bool:
    """A JSON number; `parse` has seen to it that all of them are finite."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def is_whole(value: object) -> bool:
    """A count."""
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def short(value: object) -> str:
    """A value for a message."""
    return clipped(repr(value))


def clipped(text: str) -> str:
    """A text for a message."""
    return text if len(text) <= 60 else text[:57] + "..."


def parse(text: str, file: str) -> object:
    """JSON with finite numbers only."""

    def refuse(token: str) -> float:
        raise ModelError(
            f"{file}: {clipped(token)} is not a finite number; allowed: finite numbers, null for an open bound"
        )

    def whole(token: str) -> int:
        if len(token.lstrip("-")) > _WHOLE_DIGITS:
            raise ModelError(f"{file}: {clipped(token)}; allowed: whole numbers of at most {_WHOLE_DIGITS} digits")
        return int(token)

    def number(token: str) -> float:
        value = float(token)
        return value if math.isfinite(value) else refuse(token)

    try:
        return json.loads(text, parse_constant=refuse, parse_int=whole, parse_float=number)
    except json.JSONDecodeError as error:
        message = f"{file}, line {error.lineno}, column {error.colno}: broken JSON ({error.msg})"
        raise ModelError(message) from None
    except RecursionError:
        raise ModelError(f"{file}: broken JSON (nested too deeply)") from None


def read_text(path: Path) -> str:
    """The file's text; a file that cannot be read is a ModelError."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ModelError(f"{path}: cannot read the scenario model (not UTF-8 text)") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path
        reason = error.strerror if isinstance(error, OSError) else error
        raise ModelError(f"{clipped(str(path))}: cannot read the scenario model ({reason})") from None


FORMAT: Final = "ldctoolkit-scenario-model"
VERSION: Final = 3

_HASHED_VERSION: Final = 1  # stands in the hashed content and never changes: studies resume by the hash

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
    # the card as JSON values
    out = dataclasses.asdict(provenance)
    for label, summary in (("left", provenance.left), ("right", provenance.right)):
        if summary is not None:
            out[label]["source_summary"] = source_summary_to_json(summary.source_summary)
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": dict(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)),
        "sides": {"left": side_to_json(left), "right": side_to_json(right)},
        "provenance": out,
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
    """Check and build both sides and the provenance."""
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
    provenance = reader.member(data, "provenance", "", dict, "an object")
    return built[0], built[1], model_provenance_from_json(reader, provenance)


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


PATH: Final = "provenance"


def _names(kind: type) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def model_provenance_from_json(reader: Reader, data: Mapping[str, Any]) -> ModelProvenance:
    """Check and build the card."""
    reader.only(data, PATH, _names(ModelProvenance))
    left, right = (_summary(reader, data.get(side), f"{PATH}.{side}") for side in ("left", "right"))
    versions = reader.member(data, "versions", PATH, dict, "an object")
    for name in versions:
        reader.member(versions, name, f"{PATH}.versions", str, "a string")
    return ModelProvenance(
        source=reader.member(data, "source", PATH, dict, "an object"),
        synthetic=reader.member(data, "synthetic", PATH, bool, "true or false"),
        created=reader.member(data, "created", PATH, str, "a string"),
        software=reader.member(data, "software", PATH, str, "a string"),
        seed=reader.member(data, "seed", PATH, int, "an integer"),
        warnings=tuple(str(w) for w in reader.member(data, "warnings", PATH, list, "a list of strings")),
        left=left,
        right=right,
        versions=versions,
        settings=_settings(reader, data.get("settings"), f"{PATH}.settings"),
    )


def _settings(reader: Reader, data: object, path: str) -> FitSettings | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise reader.wrong(path, f"{short(data)}; allowed: an object or null")
    reader.only(data, path, _names(FitSettings))

    def number(key: str) -> float:
        return float(reader.member(data, key, path, (int, float), "a number"))

    return FitSettings(
        criterion=reader.member(data, "criterion", path, str, "a string"),
        slack=None if data.get("slack") is None else number("slack"),
        indifference=number("indifference"),
        prior_strength=number("prior_strength"),
        tol=number("tol"),
        n_init=reader.member(data, "n_init", path, int, "an integer"),
        max_iter=reader.member(data, "max_iter", path, int, "an integer"),
    )


def _summary(reader: Reader, data: object, path: str) -> SideSummary | None:
    if data is None:
        return None
    if not isinstance(data, dict):
        raise reader.wrong(path, f"{short(data)}; allowed: an object or null")
    reader.only(data, path, _names(SideSummary))
    tried = _wholes(reader, data, "n_components", path)

    def curve(key: str, *, may_lack: bool = True) -> tuple[float, ...]:
        lacks = may_lack and data.get(key) == []
        return () if lacks else tuple(reader.array(data, key, path, (len(tried),)).tolist())

    moved = reader.rows(data, "moved_inside", path, (str, int), "a list of [name, count]")
    origins = reader.rows(data, "bounds_from", path, (str, str, str), "a list of [name, lower from, upper from]")
    for key, rows in (("moved_inside", moved), ("bounds_from", origins)):
        for name, *_ in rows:
            if name not in PARAMETER_NAMES:
                raise reader.wrong(f"{path}.{key}", f"{short(name)}; allowed: {', '.join(PARAMETER_NAMES)}")
    parameters = _wholes(reader, data, "n_parameters", path)
    if len(parameters) not in (0, len(tried)):
        raise reader.wrong(f"{path}.n_parameters", f"{len(parameters)} numbers; allowed: 0 or {len(tried)}")
    passes, weight = data.get("passes"), data.get("weight")
    if not (passes is None or is_whole(passes)):
        raise reader.wrong(f"{path}.passes", f"{short(passes)}; allowed: an integer >= 0, or null")
    if not (weight is None or is_number(weight)):
        raise reader.wrong(f"{path}.weight", f"{short(weight)}; allowed: a number, or null")
    return SideSummary(
        events=reader.member(data, "events", path, int, "an integer"),
        n_components=tried,
        bic=curve("bic", may_lack=False),
        log_likelihood=curve("log_likelihood", may_lack=False),
        converged=reader.member(data, "converged", path, bool, "true or false"),
        moved_inside=moved,
        redrawn_share=float(reader.member(data, "redrawn_share", path, (int, float), "a number")),
        n_parameters=parameters,
        aic=curve("aic"),
        icl=curve("icl"),
        held_out=curve("held_out"),
        criterion=reader.member(data, "criterion", path, str, "a string"),
        reason=reader.member(data, "reason", path, str, "a string"),
        failed=reader.rows(data, "failed", path, (int, str), "a list of [K, reason]"),
        passes=passes,
        stop_reason=reader.member(data, "stop_reason", path, str, "a string"),
        weight=None if weight is None else float(weight),
        bounds_from=origins,
        source_summary=source_summary_from_json(reader, data.get("source_summary"), f"{path}.source_summary"),
    )


def _wholes(reader: Reader, data: Mapping[str, Any], key: str, path: str) -> tuple[int, ...]:
    values = reader.member(data, key, path, list, "a list of integers")
    for value in values:
        if not is_whole(value):
            raise reader.wrong(f"{path}.{key}", f"{short(value)}; allowed: a list of integers")
    return tuple(values)


def source_summary_to_json(summary: SourceSummary | None) -> dict[str, Any] | None:
    """JSON values; the cells of a pair are one string, a tenth of the size of a list."""
    if summary is None:
        return None
    return dataclasses.asdict(summary) | {"cells": [" ".join(map(str, row)) for row in summary.cells]}


def source_summary_from_json(reader: Reader, data: object, path: str) -> SourceSummary | None:
    """Check and build it; None where the file has none."""
    if data is None:
        return None
    if not isinstance(data, dict):
        raise reader.wrong(path, f"{short(data)}; allowed: an object or null")
    reader.only(data, path, [field.name for field in dataclasses.fields(SourceSummary)])
    names = tuple(reader.member(data, "names", path, list, "a list of parameter names"))
    for name in names:
        if name not in PARAMETER_NAMES:
            raise reader.wrong(f"{path}.names", f"{short(name)}; {nearest(str(name), PARAMETER_NAMES)}")
    if not names or len(set(names)) < len(names):
        raise reader.wrong(f"{path}.names", f"{short(list(names))}; allowed: each parameter once, at least one")
    d = len(names)
    rows = reader.member(data, "quantiles", path, list, f"{d} lists of numbers")
    m = len(rows[0]) if rows and isinstance(rows[0], list) else 0
    if m < 2:
        raise reader.wrong(f"{path}.quantiles", f"allowed: {d} lists of two or more numbers")
    quantiles = reader.array(data, "quantiles", path, (d, m)).tolist()
    for j, row in enumerate(quantiles):
        if any(a > b for a, b in itertools.pairwise(row)):
            raise reader.wrong(f"{path}.quantiles[{j}]", "not ascending")
    pairs = d * (d - 1) // 2
    correlations = reader.array(data, "rank_correlations", path, (pairs,)).tolist() if pairs else []
    for i, value in enumerate(correlations):
        if abs(value) > 1.0:
            raise reader.wrong(f"{path}.rank_correlations[{i}]", f"{value:g}; allowed: -1 to 1")
    departures, effective = (data.get(key) for key in ("departures", "effective"))
    if not is_whole(departures):
        raise reader.wrong(f"{path}.departures", f"{short(departures)}; allowed: an integer >= 0")
    if not (is_number(effective) and effective > 0):  # type: ignore[operator]
        raise reader.wrong(f"{path}.effective", f"{short(effective)}; allowed: a number above 0")
    return SourceSummary(
        names,
        departures,  # type: ignore[arg-type]
        float(effective),  # type: ignore[arg-type]
        tuple(map(tuple, quantiles)),
        tuple(correlations),
        _cells(reader, data, path, pairs),
    )


def _cells(reader: Reader, data: dict[str, Any], path: str, pairs: int) -> tuple[tuple[int, ...], ...]:
    allowed = f"a list of {pairs} strings, each of b x b shares in 1/{UNIT} that sum to {UNIT} at most"
    texts = reader.member(data, "cells", path, list, allowed)
    here = f"{path}.cells"
    if len(texts) != pairs:
        raise reader.wrong(here, f"{len(texts)} strings; allowed: {allowed}")
    out: list[tuple[int, ...]] = []
    for i, text in enumerate(texts):
        cells = text.split() if isinstance(text, str) else ["?"]
        shares = tuple(int(cell) for cell in cells if cell.isascii() and cell.isdigit() and len(cell) <= len(str(UNIT)))
        b = math.isqrt(len(cells))
        if len(shares) != len(cells) or not b or b * b != len(cells) or sum(shares) > UNIT:
            raise reader.wrong(f"{here}[{i}]", f"{short(text)}; allowed: {allowed}")
        if out and len(out[0]) != len(shares):
            raise reader.wrong(f"{here}[{i}]", f"{len(shares)} cells; allowed: {len(out[0])}, as in the first")
        out.append(shares)
    return tuple(out)
