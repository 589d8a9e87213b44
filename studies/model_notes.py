"""What a reader of a report or a list must know about a scenario model, in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ldctoolkit import VehicleParameters
from ldctoolkit.scenario_model import ScenarioModel, SideSummary

_LONGEST = 400


WARNING = "warning: "
"""How a note that is a warning begins."""


def model_notes(model: ScenarioModel, vehicle: VehicleParameters | None = None) -> tuple[str, ...]:
    """Source, size of the fit and warnings of a model, one sentence or line each.

    With a vehicle, also whether its width is the one that the departures were found with: a departure is where the
    vehicle's edge is beyond the line.
    """
    notes = tuple(_notes(model))
    criteria = model.provenance.source.get("criteria")
    width = criteria.get("vehicle_width") if isinstance(criteria, Mapping) else None
    if vehicle is None or not isinstance(width, int | float) or abs(width - vehicle.w_v) < 1e-9:
        return notes
    said = f"departures were found with a vehicle {width:g} m wide, the study drives one of w_v = {vehicle.w_v:g} m"
    return (*notes, f"{WARNING}{said} in a lane of w_l = {vehicle.w_l:g} m")


def _notes(model: ScenarioModel) -> Iterator[str]:
    origin = model.provenance
    if origin.synthetic and not str(origin.source.get("description", "")).lower().startswith("synthetic"):
        yield "Synthetic: fitted to departures drawn from a stated population, not to recorded driving."
    for key, value in _flat(origin.source):
        text = f"{key}: {value}" if key else str(value)
        if value not in ("", None):
            yield text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
    for name, side, summary in (
        ("left", model.left_side, origin.left),
        ("right", model.right_side, origin.right),
    ):
        count = len(side.mixture.weights_)
        yield f"{name}: {count} component{'s' if count > 1 else ''}{_fitted(summary)}"
    if origin.software:
        yield f"fitted with {origin.software}, seed {origin.seed}, {origin.created}".rstrip(", ")
    yield from (f"{WARNING}{text}" for text in origin.warnings)


def _fitted(summary: SideSummary | None) -> str:
    if summary is None:
        return ""
    tried = f", chosen by BIC among K = {_numbers(summary.n_components)}" if len(summary.n_components) > 1 else ""
    return f" from {summary.events:,} departures{tried}"


def _numbers(values: tuple[int, ...]) -> str:
    if values == tuple(range(values[0], values[-1] + 1)):
        return f"{values[0]} to {values[-1]}"
    return ", ".join(map(str, values))


def _flat(source: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in source.items():
        if isinstance(value, Mapping):
            yield (
                f"{key}",
                ", ".join(f"{name} {_plain(item)}" for name, item in value.items() if item not in ("", None)),
            )
        else:
            yield "" if key == "description" else key, _plain(value)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return " ".join(f"{name} {_plain(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(str(_plain(item)) for item in value)
    return f"{value:g}" if isinstance(value, float) else value
