"""The JSON form of a model's card, under the key ``provenance``."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.scenario_model._reader import Reader, is_number, is_whole, short
from ldctoolkit.scenario_model.card import FitSettings, ModelProvenance, SideSummary
from ldctoolkit.scenario_model.source_summary_json import source_summary_from_json, source_summary_to_json

PATH: Final = "provenance"


def _names(kind: type) -> list[str]:
    return [field.name for field in dataclasses.fields(kind)]


def card_to_json(provenance: ModelProvenance) -> dict[str, Any]:
    """The card as JSON values."""
    out = dataclasses.asdict(provenance)
    for label, summary in (("left", provenance.left), ("right", provenance.right)):
        if summary is not None:
            out[label]["source_summary"] = source_summary_to_json(summary.source_summary)
    return out


def card_from_json(reader: Reader, data: Mapping[str, Any]) -> ModelProvenance:
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
