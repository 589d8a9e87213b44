"""The JSON form of a scenario model: writing, and reading with a check of every value."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from ldctoolkit.arrays import FloatArray
from ldctoolkit.checked_files import CHECKSUM, NOT_AS_WRITTEN, digest, parse_json, text_of
from ldctoolkit.declared import checked_number
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, PARAMETER_UNITS, RIGHT, Plausibility, check_parameters
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    UNIT,
    ModelProvenance,
    RecordedDepartures,
    SideModel,
    SourceSummary,
    check_usable,
)
from ldctoolkit.validation import Part, first_problem

FORMAT: Final = "ldctoolkit-scenario-model"
VERSION: Final = 5
_READABLE: Final = (4, VERSION)

_HASHED_VERSION: Final = 1  # stands in the hashed content and never changes: studies resume by the hash
_WHOLE_DIGITS: Final = 18  # longest whole number of a file: it must fit a float and 64 bits


def side_to_json(side: SideModel) -> dict[str, Any]:
    """One side as JSON values; an open bound is null."""
    bounds = [[float(b) if np.isfinite(b) else None for b in bound] for bound in side.bounds()]
    m = side.mixture
    return {
        "parameters": list(side.names),
        "constants": dict(side.constants),
        "transform": list(side.transform()),
        "lower": bounds[0],
        "upper": bounds[1],
        "weights": m.weights_.tolist(),
        "means": m.means_.tolist(),
        # a single one where all components share it, as smoothed departures do
        "covariances": m.covariances_[: 1 if (m.covariances_ == m.covariances_[0]).all() else None].tolist(),
    }


def parts_to_json(
    left: SideModel, right: SideModel, provenance: ModelProvenance, plausibility: Plausibility | None
) -> dict[str, Any]:
    """The whole file as JSON values; the cells of a pair are one string, a tenth of the size of a list."""
    content = dataclasses.asdict(provenance)
    for side in _fitted(content):
        if summary := side["source_summary"]:
            summary["cells"] = [" ".join(map(str, row)) for row in summary["cells"]]
    return {
        "format": FORMAT,
        "version": VERSION,
        "units": dict(zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True)),
        "sides": {"left": side_to_json(left), "right": side_to_json(right)},
        "plausibility": plausibility and dataclasses.asdict(plausibility),
        "provenance": content,
    }


def _fitted(provenance: Any) -> Iterator[dict[str, Any]]:
    """How each side was fitted, where that is known."""
    for side in ("left", "right") if isinstance(provenance, dict) else ():
        if isinstance(provenance.get(side), dict):
            yield provenance[side]


def content_hash(left: SideModel, right: SideModel, plausibility: Plausibility | None) -> str:
    """SHA-256 over all that sampling depends on; the provenance and the file's version are left out."""
    content: dict[str, Any] = {"format": FORMAT, "version": _HASHED_VERSION}
    for name, side in (("left", left), ("right", right)):
        content[name] = side_to_json(side)
        if all(kind == "none" for kind in content[name]["transform"]):
            del content[name]["transform"]
    if plausibility is not None:
        content["plausibility"] = dataclasses.asdict(plausibility)
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _parse(text: str | bytes, file: str) -> Any:
    """The JSON values of a file, with finite numbers only."""
    try:
        content = text if isinstance(text, str) else text_of(text)
        return parse_json(content, parse_constant=_finite, parse_int=_whole, parse_float=_finite)
    except json.JSONDecodeError as error:
        raise ModelError(f"{file}, line {error.lineno}, column {error.colno}", f"broken JSON ({error.msg})") from None
    except InputError as error:
        raise ModelError.of(error.at(file)) from None
    except ValueError as error:
        raise ModelError(file, f"broken JSON ({error})") from None


def _finite(token: str) -> float:
    """A number of a file; also of the words ``NaN`` and ``Infinity``, which are refused."""
    if not math.isfinite(value := float(token)):
        raise InputError(value=token, allowed="finite numbers, null for an open bound")
    return value


def _whole(token: str) -> int:
    if len(token.lstrip("-")) > _WHOLE_DIGITS:
        raise InputError(value=token, allowed=f"whole numbers of at most {_WHOLE_DIGITS} digits")
    return int(token)


def parts_from_json(text: str | bytes, file: str) -> tuple[SideModel, SideModel, ModelProvenance, Plausibility | None]:
    """Check and build both sides, the provenance and the limits."""
    data = _parse(text, file)
    if not isinstance(data, dict):
        raise ModelError(file, "not a scenario model", hint="the file must hold a JSON object")
    if data.get("format") != FORMAT:
        raise ModelError(f"{file}: format", value=data.get("format"), allowed=repr(FORMAT))
    version = data.get("version")
    if type(version) is not int or version not in _READABLE:
        newer = isinstance(version, int) and version > VERSION
        hint = "the file is newer, update ldctoolkit" if newer else ""
        allowed = f"version {_READABLE[0]} to {VERSION}, which this program reads"
        raise ModelError(f"{file}: version", value=version, allowed=allowed, hint=hint)
    written, content = data.pop(CHECKSUM, None), digest(data)
    for side in _fitted(data.get("provenance")):
        summary = side.get("source_summary")
        if isinstance(summary, dict) and isinstance(cells := summary.get("cells"), list):
            summary["cells"] = [_shares(text) for text in cells]
    try:
        # as JSON: lists are tuples there, which strict Python values are not
        parsed = _File.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise ModelError.of(first_problem(error, data, _File, "file").within(file, ": ")) from None
    try:
        _check_units(parsed.units)
        for name in ("left", "right"):
            _check_side(f"sides.{name}", getattr(parsed.sides, name))
        _check_provenance(parsed.provenance)
        left, right = (_built(getattr(parsed.sides, name), f"sides.{name}") for name in ("left", "right"))
    except (InputError, ModelError) as error:
        raise ModelError.of(error.within(file, ": ")) from None
    limits = None if parsed.plausibility is None else Plausibility(**dict(parsed.plausibility))
    if written not in (None, content):  # last: of what was changed by hand, a value that is not allowed says more
        raise ModelError(file, NOT_AS_WRITTEN, hint=f"if it was changed on purpose, remove the key '{CHECKSUM}'")
    return left, right, parsed.provenance, limits


def _shares(text: Any) -> Any:
    """The shares of a pair's cells; what is not a text of whole numbers stays, for the check to refuse it."""
    cells = text.split() if isinstance(text, str) else []
    digits = "".join(cells)
    return list(map(int, cells)) if digits.isascii() and digits.isdigit() else str(text)


class _Side(Part):
    """One side: a mixture of K components over d parameters."""

    parameters: tuple[str, ...]
    constants: dict[str, float]
    transform: tuple[Literal["none", "log", "logit"], ...]
    lower: tuple[float | None, ...]
    upper: tuple[float | None, ...]
    weights: tuple[float, ...] = Field(min_length=1)
    means: tuple[tuple[float, ...], ...]
    covariances: tuple[tuple[tuple[float, ...], ...], ...]

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds, infinite where they are open."""
        lower = np.array([-np.inf if value is None else value for value in self.lower])
        return lower, np.array([np.inf if value is None else value for value in self.upper])


class _Sides(Part):
    left: _Side
    right: _Side


class _Limits(Part):
    """Limits of plausibility, null for none; a model without this part has none at all."""

    y_rate: float | None = Field(gt=0.0)
    y_acceleration: float | None = Field(gt=0.0)
    a_y: float | None = Field(gt=0.0)


class _File(Part):
    """The content of a model file."""

    format: str
    version: int
    units: dict[str, str]
    sides: _Sides
    plausibility: _Limits | None = None
    provenance: ModelProvenance


def _check_units(units: dict[str, str]) -> None:
    for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True):
        if units.get(name) != unit:
            raise InputError(f"units.{name}", value=units.get(name), allowed=repr(unit))


def _check_side(path: str, side: _Side) -> None:
    K, d = len(side.weights), len(side.parameters)
    check_parameters(f"{path}.parameters", side.parameters)
    check_parameters(f"{path}.constants", side.constants)
    if sorted((*side.parameters, *side.constants)) != sorted(PARAMETER_NAMES) or not d:
        allowed = f"each of {', '.join(PARAMETER_NAMES)} once, here or among the constants"
        raise InputError(f"{path}.parameters", value=side.parameters, allowed=allowed)
    for name, value in side.constants.items():
        checked_number(f"{path}.constants.{name}", value, lower=LEAST_LOWER.get(name, -np.inf))
    for key, shape in {
        "transform": (d,), "lower": (d,), "upper": (d,), "means": (K, d),
        "covariances": (1 if len(side.covariances) == 1 else K, d, d),
    }.items():  # fmt: skip
        _check_shape(f"{path}.{key}", getattr(side, key), shape)
    for j, (name, low) in enumerate(zip(side.parameters, side.bounds()[0], strict=True)):
        if low < LEAST_LOWER.get(name, -np.inf):
            raise InputError(f"{path}.lower[{j}]", f"{name} below {LEAST_LOWER[name]:g} cannot be replayed")
    weights, covariances = np.array(side.weights), np.array(side.covariances)
    if np.any(weights < 0) or abs(weights.sum() - 1.0) > 1e-9:
        raise InputError(f"{path}.weights", f"sum {weights.sum():.12g}", allowed="shares >= 0 that sum to one")
    for k, S in enumerate(covariances):
        variances = np.diagonal(S)
        size = np.sqrt(np.outer(np.abs(variances), np.abs(variances)))
        if np.any(variances <= 0) or np.any(np.abs(S - S.T) > 1e-9 * size):
            raise InputError(f"{path}.covariances[{k}]", "not positive definite (or not symmetric)")
        if np.linalg.eigvalsh(S / size)[0] < 1e-13:
            raise InputError(f"{path}.covariances[{k}]", "not positive definite")


def _check_shape(path: str, value: Any, shape: tuple[int, ...]) -> None:
    try:
        actual = np.array(value, dtype=object).shape
    except ValueError:
        raise InputError(path, "lists of different lengths", allowed=f"shape {shape}") from None
    if actual != shape:
        raise InputError(path, f"shape {actual}", allowed=f"{shape}")


def _check_provenance(provenance: ModelProvenance) -> None:
    for key, value in (("hours", provenance.hours), ("distance", provenance.distance)):
        if value is not None:
            checked_number(f"provenance.{key}", value, above=0.0)
    if provenance.recorded is not None:
        _check_recorded("provenance.recorded", provenance.recorded)
    for name, side in provenance.sides:
        path, tried = f"provenance.{name}", len(side.n_components)
        for key in ("bic", "log_likelihood", "n_parameters"):
            count = len(getattr(side, key))
            if count != tried and (count or key != "n_parameters"):
                raise InputError(f"{path}.{key}", f"shape ({count},)", allowed=f"({tried},)")
        for key in ("moved_inside", "bounds_from"):
            check_parameters(f"{path}.{key}", (parameter for parameter, *_ in getattr(side, key)))
        if side.source_summary is not None:
            _check_summary(f"{path}.source_summary", side.source_summary)


def _check_recorded(path: str, recorded: RecordedDepartures) -> None:
    n, clusters = len(recorded.side), set(recorded.cluster)
    if sorted(recorded.columns) != sorted(PARAMETER_NAMES):
        raise InputError(f"{path}.columns", value=tuple(recorded.columns), allowed=PARAMETER_NAMES)
    for key in ("side", "weight", "cluster"):
        _check_shape(f"{path}.{key}", getattr(recorded, key), (n,))
    for name, column in recorded.columns.items():
        _check_shape(f"{path}.columns.{name}", column, (n,))
    if set(recorded.side) != {LEFT, RIGHT}:
        raise InputError(f"{path}.side", allowed=f"{LEFT} and {RIGHT}, both of them")
    if not min(recorded.weight) > 0.0:
        raise InputError(f"{path}.weight", value=min(recorded.weight), allowed="above 0")
    if clusters != set(range(len(clusters))):
        raise InputError(f"{path}.cluster", "leaves out a number", allowed="each from 0 on")


def _check_summary(path: str, summary: SourceSummary) -> None:
    d, m = len(summary.names), len(summary.quantiles[0]) if summary.quantiles else 0
    pairs = d * (d - 1) // 2
    check_parameters(f"{path}.names", summary.names)
    if not d or len(set(summary.names)) < d:
        raise InputError(f"{path}.names", value=summary.names, allowed="each parameter once, at least one")
    checked_number(f"{path}.departures", summary.departures, above=0.0)
    checked_number(f"{path}.effective", summary.effective, above=0.0)
    if m < 2:
        raise InputError(f"{path}.quantiles", allowed=f"{d} lists of two or more numbers")
    _check_shape(f"{path}.quantiles", summary.quantiles, (d, m))
    for j, row in enumerate(summary.quantiles):
        if np.any(np.diff(row) < 0.0):
            raise InputError(f"{path}.quantiles[{j}]", "not ascending")
    _check_shape(f"{path}.rank_correlations", summary.rank_correlations, (pairs,))
    for i, value in enumerate(summary.rank_correlations):
        checked_number(f"{path}.rank_correlations[{i}]", value, lower=-1.0, upper=1.0)
    allowed = f"{pairs} strings, each of the same b x b shares in 1/{UNIT} that sum to {UNIT} at most"
    if len(summary.cells) != pairs:
        raise InputError(f"{path}.cells", f"{len(summary.cells)} strings", allowed=allowed)
    for i, shares in enumerate(summary.cells):
        square = shares and math.isqrt(len(shares)) ** 2 == len(shares) == len(summary.cells[0])
        if not square or min(shares) < 0 or sum(shares) > UNIT:
            raise InputError(f"{path}.cells[{i}]", value=" ".join(map(str, shares)), allowed=allowed)


def _built(side: _Side, path: str) -> SideModel:
    lower, upper = side.bounds()
    try:
        with np.errstate(all="ignore"):  # absurd numbers overflow; what comes out is checked below
            covariances = np.array(side.covariances)
            if len(covariances) < len(side.weights):  # a single one that all share
                covariances = np.repeat(covariances, len(side.weights), axis=0)
            mixture = BoundedGaussianMixture.from_parameters(
                side.weights, side.means, covariances,
                lower=lower, upper=upper, transform=side.transform, names=side.parameters,
            )  # fmt: skip
        check_usable(mixture)
    except (InputError, ModelError) as error:
        raise error.within(path, ": ") from None
    constants = tuple((name, side.constants[name]) for name in PARAMETER_NAMES if name in side.constants)
    return SideModel(mixture, side.parameters, constants)
