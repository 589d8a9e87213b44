"""The tables ``[ranking]`` and ``[search]`` of a study file."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field

from ldctoolkit import LdcError
from studies.ranking.requirements import SETS, metric, parse_requirement
from studies.study_file._part import Part, fail

T = TypeVar("T")

VehicleName = Literal["light", "heavy", "soft", "stiff"]


def _names(entry: Any) -> Any:
    values = (entry,) if isinstance(entry, str) else entry
    if isinstance(values, list | tuple) and len(set(map(str, values))) != len(values):
        raise fail("", f"{entry!r}; allowed: each once")
    return tuple(values) if isinstance(values, list | tuple) else entry


def _requirements(texts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(text if text in SETS else _checked(parse_requirement, text).text for text in texts)


def _figures(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(_checked(metric, name).name for name in names)


def _checked(check: Callable[[str], T], text: str) -> T:
    try:
        return check(text)
    except LdcError as error:
        raise fail("", str(error)) from None


class RankingSettings(Part):
    """``[ranking]``."""

    bootstrap: int = Field(default=2000, ge=100, le=1_000_000)  # Resamples of the scenarios behind every interval
    confidence: float = Field(default=0.95, gt=0, lt=1)  # Of the intervals, all designs together
    # The design that all others are compared with beside the best: a law's name (its first design), or the start of a
    # design's identifier; empty for the design without control, if there is one
    baseline: str = ""
    # What a design must meet to be ranked: ``"a_y_peak_p95 <= 3.0"``, or the name of a set: ``"comfort"``
    require: Annotated[tuple[str, ...], BeforeValidator(_names), AfterValidator(_requirements)] = ()
    pareto: Annotated[tuple[str, ...], BeforeValidator(_names), AfterValidator(_figures)] = (
        "S",
        "needless",
        "a_y_peak_mean",
        "effort_mean",
    )  # Metrics of the Pareto front
    # Named vehicles that `S_worst` and `comfortable_worst` are the worst of. Empty for none; where a requirement, the
    # front or the search asks for one of the two, for all
    vehicles: Annotated[tuple[VehicleName, ...], BeforeValidator(_names)] = ()
    # At most so many of the best designs are scored again on fresh scenarios; 0 for none
    finalists: int = Field(default=10, ge=0, le=1000)


class SearchSettings(Part):
    """``[search]``: designs are not written down but asked for, one batch after the other."""

    method: Literal["optuna"] = "optuna"
    sampler: Literal["tpe", "random", "nsga2"] = "tpe"
    trials: int = Field(default=200, ge=1, le=100_000)  # Designs to try in all
    batch: int = Field(default=16, ge=1, le=10_000)  # Designs asked for at once; they run in parallel
    objectives: Annotated[tuple[str, ...], BeforeValidator(_names), AfterValidator(_figures), Field(min_length=1)] = (
        "S",
    )  # Metrics to make small (or large, where more is better): one, or several for a Pareto front
