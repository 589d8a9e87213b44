"""The JSON form of a scenario model: writing, and reading with a check of every value."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import math
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal, NoReturn

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, field_validator, model_validator

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS, Plausibility
from ldctoolkit.errors import InputError, ModelError, nearest, short
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model.provenance import (
    LEAST_LOWER,
    UNIT,
    ModelProvenance,
    SideModel,
    SideSummary,
    SourceSummary,
    check_usable,
)
from ldctoolkit.validation import Part, fail, first_problem
from ldctoolkit.whole_file import CHECKSUM, NOT_AS_WRITTEN, digest, parse_json, text_of

FORMAT: Final = "ldctoolkit-scenario-model"
VERSION: Final = 3

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
        # of smoothed departures one, which all share
        "covariances": m.covariances_[: 1 if (m.covariances_ == m.covariances_[0]).all() else None].tolist(),
    }


def model_to_json(
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
    """JSON with finite numbers only."""

    def refuse(token: str, allowed: str = "finite numbers, null for an open bound") -> NoReturn:
        shown = token if len(token) <= 60 else token[:57] + "..."
        what = "" if allowed.startswith("whole") else " is not a finite number"
        raise ModelError(file, f"{shown}{what}", allowed=allowed)

    def whole(token: str) -> int:
        if len(token.lstrip("-")) > _WHOLE_DIGITS:
            refuse(token, f"whole numbers of at most {_WHOLE_DIGITS} digits")
        return int(token)

    def number(token: str) -> float:
        value = float(token)
        return value if math.isfinite(value) else refuse(token)

    try:
        content = text if isinstance(text, str) else text_of(text)
        return parse_json(content, parse_constant=refuse, parse_int=whole, parse_float=number)
    except json.JSONDecodeError as error:
        message = f"{file}, line {error.lineno}, column {error.colno}: broken JSON ({error.msg})"
        raise ModelError(message) from None
    except ModelError:
        raise
    except ValueError as error:
        raise ModelError(file, f"broken JSON ({error})") from None


def model_from_json(text: str | bytes, file: str) -> tuple[SideModel, SideModel, ModelProvenance, Plausibility | None]:
    """Check and build both sides, the provenance and the limits."""
    data = _parse(text, file)
    if not isinstance(data, dict):
        raise ModelError(file, "not a scenario model", hint="the file must hold a JSON object")
    if data.get("format") != FORMAT:
        raise ModelError(file, f"format: {short(data.get('format'))}", allowed=f"{FORMAT!r}")
    version = data.get("version")
    if type(version) is not int or version != VERSION:
        newer = isinstance(version, int) and version > VERSION
        hint = ": the file is newer, update ldctoolkit" if newer else ""
        raise ModelError(file, f"version: {short(version)}", hint=f"this program reads version {VERSION}{hint}")
    written, content = data.pop(CHECKSUM, None), digest(data)
    for side in _fitted(data.get("provenance")):
        summary = side.get("source_summary")
        if isinstance(summary, dict) and isinstance(cells := summary.get("cells"), list):
            summary["cells"] = [_shares(text) for text in cells]
    try:
        # as JSON: lists are tuples there, which strict Python values are not
        found = _File.model_validate_json(json.dumps(data))
    except ValidationError as error:
        raise ModelError(file, f"{first_problem(error, data, _File, 'file')}") from None
    left, right = (_built(getattr(found.sides, name), f"{file}: sides.{name}") for name in ("left", "right"))
    limits = None if found.plausibility is None else Plausibility(**dict(found.plausibility))
    if written not in (None, content):  # last: of what was changed by hand, a value that is not allowed says more
        raise ModelError(file, NOT_AS_WRITTEN, hint=f"if it was changed on purpose, remove the key '{CHECKSUM}'")
    return left, right, found.provenance, limits


def _shares(text: Any) -> Any:
    """The shares of a pair's cells; what is no text of whole numbers stays, for the check to name it."""
    cells = text.split() if isinstance(text, str) else []
    return list(map(int, cells)) if all(cell.isascii() and cell.isdigit() for cell in cells) and cells else str(text)


def _parameter(name: str) -> str:
    if name not in PARAMETER_NAMES:
        raise fail("", f"{short(name)}; {nearest(name, PARAMETER_NAMES)}")
    return name


Parameter = Annotated[str, AfterValidator(_parameter)]


class _Side(Part):
    """One side: a mixture of K components over d parameters."""

    parameters: tuple[Parameter, ...]
    constants: dict[Parameter, float]
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

    @model_validator(mode="after")
    def _fits(self) -> _Side:
        K, d = len(self.weights), len(self.parameters)
        if sorted((*self.parameters, *self.constants)) != sorted(PARAMETER_NAMES) or not d:
            raise fail("parameters", f"must name each of {', '.join(PARAMETER_NAMES)} once, or constants must")
        for name, value in self.constants.items():
            if value < LEAST_LOWER.get(name, -np.inf):
                raise fail(f"constants.{name}", f"{value!r}; allowed: a finite number in range")
        for key, shape in {
            "transform": (d,), "lower": (d,), "upper": (d,), "means": (K, d),
            "covariances": (1 if len(self.covariances) == 1 else K, d, d),
        }.items():  # fmt: skip
            _shaped(getattr(self, key), shape, key)
        for j, (name, low) in enumerate(zip(self.parameters, self.bounds()[0], strict=True)):
            if low < LEAST_LOWER.get(name, -np.inf):
                raise fail(f"lower[{j}]", f"{name} below {LEAST_LOWER[name]:g} cannot be replayed")
        weights, covariances = np.array(self.weights), np.array(self.covariances)
        if np.any(weights < 0) or abs(weights.sum() - 1.0) > 1e-9:
            raise fail("weights", f"sum {weights.sum():.12g}; allowed: shares >= 0 that sum to one")
        for k, S in enumerate(covariances):
            variances = np.diagonal(S)
            size = np.sqrt(np.outer(np.abs(variances), np.abs(variances)))
            if np.any(variances <= 0) or np.any(np.abs(S - S.T) > 1e-9 * size):
                raise fail(f"covariances[{k}]", "not positive definite (or not symmetric)")
            if np.linalg.eigvalsh(S / size)[0] < 1e-13:
                raise fail(f"covariances[{k}]", "not positive definite")
        return self


def _shaped(value: Any, shape: tuple[int, ...], path: str) -> None:
    """Refuse lists of another shape."""
    try:
        found = np.array(value, dtype=object).shape
    except ValueError:
        raise fail(path, f"lists of different lengths; allowed: shape {shape}") from None
    if found != shape:
        raise fail(path, f"shape {found}; allowed: {shape}")


class _Sides(Part):
    left: _Side
    right: _Side


class _Limits(Part):
    """Limits of plausibility, null for none; a model without this part has none at all."""

    y_rate: float | None = Field(gt=0.0)
    y_acceleration: float | None = Field(gt=0.0)
    a_y: float | None = Field(gt=0.0)


class _File(Part):
    """The whole file."""

    format: str
    version: int
    units: dict[str, str]
    sides: _Sides
    plausibility: _Limits | None = None
    provenance: ModelProvenance

    @field_validator("units")
    @classmethod
    def _si(cls, units: dict[str, str]) -> dict[str, str]:
        for name, unit in zip(PARAMETER_NAMES, PARAMETER_UNITS, strict=True):
            if units.get(name) != unit:
                raise fail(name, f"{short(units.get(name))}; allowed: {unit!r}")
        return units

    @field_validator("provenance")
    @classmethod
    def _checked(cls, provenance: ModelProvenance) -> ModelProvenance:
        for key, value in (("hours", provenance.hours), ("distance", provenance.distance)):
            if value is not None and not value > 0.0:
                raise fail(key, f"{value:g}; allowed: a number above 0, or null where it is not known")
        for name, side in (("left", provenance.left), ("right", provenance.right)):
            if side is not None:
                _check_side(side, name)
                if side.source_summary is not None:
                    _check_summary(side.source_summary, f"{name}.source_summary")
        return provenance


def _check_side(side: SideSummary, path: str) -> None:
    tried = len(side.n_components)
    for key in ("bic", "log_likelihood", "aic", "n_parameters"):
        count = len(getattr(side, key))
        if count != tried and (count or key in ("bic", "log_likelihood")):
            raise fail(f"{path}.{key}", f"shape ({count},); allowed: ({tried},)")
    for key in ("moved_inside", "bounds_from"):
        for name, *_ in getattr(side, key):
            if name not in PARAMETER_NAMES:
                raise fail(f"{path}.{key}", f"{short(name)}; {nearest(name, PARAMETER_NAMES)}")


def _check_summary(summary: SourceSummary, path: str) -> None:
    d, m = len(summary.names), len(summary.quantiles[0]) if summary.quantiles else 0
    pairs = d * (d - 1) // 2
    for name in summary.names:
        if name not in PARAMETER_NAMES:
            raise fail(f"{path}.names", f"{short(name)}; {nearest(name, PARAMETER_NAMES)}")
    if not d or len(set(summary.names)) < d:
        raise fail(f"{path}.names", f"{short(list(summary.names))}; allowed: each parameter once, at least one")
    for key in ("departures", "effective"):
        if not (count := getattr(summary, key)) > 0:
            raise fail(f"{path}.{key}", f"{count:g}; allowed: a number above 0")
    if m < 2:
        raise fail(f"{path}.quantiles", f"allowed: {d} lists of two or more numbers")
    _shaped(summary.quantiles, (d, m), f"{path}.quantiles")
    for j, row in enumerate(summary.quantiles):
        if any(a > b for a, b in itertools.pairwise(row)):
            raise fail(f"{path}.quantiles[{j}]", "not ascending")
    _shaped(summary.rank_correlations, (pairs,), f"{path}.rank_correlations")
    for i, value in enumerate(summary.rank_correlations):
        if abs(value) > 1.0:
            raise fail(f"{path}.rank_correlations[{i}]", f"{value:g}; allowed: -1 to 1")
    allowed = f"{pairs} strings, each of the same b x b shares in 1/{UNIT} that sum to {UNIT} at most"
    if len(summary.cells) != pairs:
        raise fail(f"{path}.cells", f"{len(summary.cells)} strings; allowed: {allowed}")
    for i, shares in enumerate(summary.cells):
        square = shares and math.isqrt(len(shares)) ** 2 == len(shares) == len(summary.cells[0])
        if not square or min(shares) < 0 or sum(shares) > UNIT:
            raise fail(f"{path}.cells[{i}]", f"{short(' '.join(map(str, shares)))}; allowed: {allowed}")


def _built(side: _Side, where: str) -> SideModel:
    lower, upper = side.bounds()
    try:
        with np.errstate(all="ignore"):  # absurd numbers overflow; what comes out is checked below
            covariances = np.array(side.covariances)
            if len(covariances) < len(side.weights):  # one that all share
                covariances = np.repeat(covariances, len(side.weights), axis=0)
            mixture = BoundedGaussianMixture.from_parameters(
                side.weights, side.means, covariances,
                lower=lower, upper=upper, transform=side.transform, names=side.parameters,
            )  # fmt: skip
        check_usable(mixture)
    except (InputError, ModelError) as error:
        raise ModelError(where, f"{error}") from None
    constants = tuple((name, side.constants[name]) for name in PARAMETER_NAMES if name in side.constants)
    return SideModel(mixture, side.parameters, constants)
