"""Where the scenarios of a study come from: recorded departures that are replayed, or a model, kept in its folder."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.clusters import Clusters
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import InputError, LdcError, ModelError, RecordingError, StoreError
from ldctoolkit.recordings import read_departures
from ldctoolkit.recordings.departures_table import column_of, read_table
from ldctoolkit.scenario_model import Given, ScenarioModel, SideModel, SideSummary, conditions
from ldctoolkit.scenario_model.model import meeting, outside_fit
from ldctoolkit.scenarios import SPEED_FLOOR, Scenarios, slowest_speed
from ldctoolkit.vehicle.bicycle import VehicleParameters

from ..study_file import Study
from .manifest import Manifest

_log = logging.getLogger("studies")


@dataclasses.dataclass(frozen=True)
class ReplayedDepartures:
    """A table of departures to be replayed."""

    name: str  # Name of its file
    scenarios: Scenarios  # All of its rows that can be driven
    weights: FloatArray | None = None  # (n,) Number of events that each departure represents
    notes: tuple[str, ...] = ()  # Their origin, for readers
    warnings: tuple[str, ...] = ()  # Departures that are left out
    source: dict[str, Any] = dataclasses.field(default_factory=dict)  # Criteria and lane width, as a model's source

    @property
    def content_hash(self) -> str:
        """SHA-256 of scenarios and weights."""
        digest = hashlib.sha256(b"" if self.weights is None else self.weights.tobytes())
        for array in self.scenarios.arrays():
            digest.update(array.tobytes())
        return digest.hexdigest()

    def counts(self, left: int | None, right: int | None, given: Given | None) -> tuple[int, int]:
        """Departures of each side to replay: as requested, else all, or with weights the effective sample size."""
        counts = []
        for side, requested in ((LEFT, left), (RIGHT, right)):
            rows = self._rows(side, given)
            w = None if self.weights is None else self.weights[rows]
            available = rows.size if w is None else round(float(w.sum()) ** 2 / float(w @ w)) if w.any() else 0
            if requested is not None and (requested > rows.size if w is None else requested and not available):
                key = "left" if side == LEFT else "right"
                raise InputError(
                    f"scenarios.{key}", value=requested, allowed=f"up to {rows.size}, which {self.name} holds"
                )
            counts.append(available if requested is None else requested)
        if not sum(counts):
            raise InputError("scenarios", f"{self.name} holds no departure to replay under the study's conditions")
        return counts[0], counts[1]

    def sample(self, n_left: int, n_right: int, seed: int, given: Given | None = None) -> Scenarios:
        """Rows of the table, left ones first; a part of them is drawn at random, in proportion to the weights."""
        sampled = []
        for side, n in ((LEFT, n_left), (RIGHT, n_right)):
            rows, rng = self._rows(side, given), np.random.default_rng([seed, side == RIGHT])
            if self.weights is not None and n:
                # systematic sampling: the count of each row is proportional to its weight, to within one
                share = np.cumsum(self.weights[rows]) / self.weights[rows].sum()
                rows = rows[
                    np.searchsorted(share, (np.arange(n) + rng.random()) / n, side="right").clip(0, rows.size - 1)
                ]
            elif n < rows.size:
                rows = rows[np.sort(rng.permutation(rows.size)[:n])]
            sampled.append(rows)
        rows = np.concatenate(sampled)
        # a scenario's number is its row in the table; with weights a row may occur more than once
        index = rows if self.weights is None else np.arange(rows.size)
        return dataclasses.replace(self.scenarios.take(rows), index=index)

    def _rows(self, side: int, given: Given | None) -> IntArray:
        return np.flatnonzero((self.scenarios.side == side) & meeting(self.scenarios, conditions(given)))


def read_replayed(study: Study) -> ReplayedDepartures:
    """Read and check the departures that a study replays.

    Raises `RecordingError` naming file, column and row; `InputError` for a value outside what can be driven.
    """
    settings = study.scenarios
    path, name = study.folder / settings.replayed, Path(settings.replayed).name
    warnings: tuple[str, ...] = ()
    source: dict[str, Any] = {}
    if settings.departures:
        departures, provenance = read_departures(path, signals=settings.path == "recorded")
        drivable = slowest_speed(departures.v_mean, departures.a_mean, departures.T) >= SPEED_FLOOR
        weights = None
        if settings.weights:
            numeric = {column.name: column.values for column in departures.extra if column.values.dtype.kind == "f"}
            if settings.weights not in numeric:
                raise RecordingError(name, "is not a column of numbers", value=settings.weights, allowed=numeric)
            weights = np.asarray(numeric[settings.weights], dtype=np.float64)
        notes = [f"Recorded departures, replayed: {departures.n:,} of {name}, found in {provenance.hours:,.4g} h."]
        if settings.path == "recorded":
            notes.append("Without control their recorded y(t), v(t) and c(t) are driven, not the fitted parabola.")
        if slow := int((~drivable).sum()):
            warnings = (f"{slow:,} of them fall below {SPEED_FLOOR:g} m/s, cannot be driven, and are left out",)
        source = {
            "criteria": dataclasses.asdict(provenance.criteria),
            "nominal_lane_width": provenance.preparation.nominal_lane_width,
        }
        departures = departures.take(drivable)
        scenarios = _checked(name, lambda: Scenarios.from_departures(departures, path=settings.path))
        clusters = Clusters.of(departures)
        weights = None if weights is None else weights[drivable]
    else:
        table, _ = read_table(path, "a table of departures")
        columns: dict[str, Any] = {field: column_of(name, table, key) for field, key in PARAMETER_COLUMNS.items()}
        if "side" not in table.columns:
            raise RecordingError(name, "column 'side' is missing", allowed="left, right")
        weights = column_of(name, table, settings.weights) if settings.weights else None
        scenarios = _checked(name, lambda: Scenarios.from_arrays(side=table["side"].to_list(), **columns))
        notes = [f"{scenarios.n:,} departures of {name}."]
        recording, driver = (
            table[key].cast(str).fill_null("").to_numpy() if key in table.columns else None
            for key in ("recording", "driver")
        )
        clusters = Clusters.of_names(scenarios.n, recording, driver)
        scenarios = dataclasses.replace(scenarios, cluster=clusters.numbers)
    notes.append(f"Intervals are of {clusters.text}.")
    if weights is not None and not ((weights >= 0.0) & np.isfinite(weights)).all():
        raise RecordingError(name, f"column {settings.weights!r} holds {weights.min():g}", allowed="finite, at least 0")
    return ReplayedDepartures(name, scenarios, weights, tuple(notes), warnings, source)


def _checked(name: str, make: Callable[[], Scenarios]) -> Scenarios:
    """Scenarios that `make` gives; its error names the source."""
    try:
        return make()
    except LdcError as error:
        raise InputError.of(error.within(name, ": ")) from None


MODEL: Final = "model.json"


def write_model(folder: Path, model: ScenarioModel) -> bool:
    """Write or replace a folder's model, whole or not at all; whether the same file was there before.

    A model in memory may hold what JSON does not know. Its scores are no worse for that: what is lost is a part of the
    report, and a warning says so.
    """
    path = folder / MODEL
    before = path.read_bytes() if path.is_file() else b""
    try:
        model.save(path)
    except ModelError as error:
        _log.warning("%s: the report will not show the scenario model (%s)", folder, error)
        return False
    return path.read_bytes() == before


def read_model(folder: str | Path, manifest: Manifest) -> ScenarioModel | None:
    """Read a folder's model; None where it has none, as folders of earlier versions."""
    path = Path(folder) / MODEL
    if not path.exists():
        return None
    try:
        model = ScenarioModel.load(path)
    except ModelError as error:
        raise StoreError.of(error.hinted("run the study into this folder again to write it anew")) from None
    if model.content_hash != manifest.model_hash:
        raise StoreError(
            path,
            f"holds the model {model.content_hash[:12]}, the study's is {manifest.model_hash[:12]}",
            hint="run the study into this folder again to write it anew",
        )
    return model


_LONGEST: Final = 400  # characters of a note

Source = ScenarioModel | ReplayedDepartures
"""What the scenarios of a study come from."""


def model_notes(model: Source, given: Given | None = None) -> tuple[str, ...]:
    """Source and size of the fit of a model, one sentence or line each; with conditions, which departures are drawn."""
    drawn = "; ".join(map(str, conditions(given)))
    notes = (f"Only departures with {drawn} are taken.",) if drawn else ()
    return (*notes, *(_notes(model) if isinstance(model, ScenarioModel) else model.notes))


def model_warnings(
    model: Source, vehicle: VehicleParameters | None = None, given: Given | None = None
) -> Iterator[str]:
    """What the fit warned of, and what it does not know of the departures under conditions.

    With a vehicle, also whether its width is the one that the departures were found with: a departure is where the
    vehicle's edge is beyond the line.
    """
    if isinstance(model, ScenarioModel):
        yield from (*model.provenance.warnings, *outside_fit(model, given))
    else:
        yield from model.warnings
    width = _recorded_widths(model)["w_v"]
    if vehicle is not None and isinstance(width, int | float) and abs(width - vehicle.w_v) >= 1e-9:
        yield (
            f"departures were found with a vehicle {width:g} m wide, the study drives one of w_v = {vehicle.w_v:g} m "
            f"in a lane of w_l = {vehicle.w_l:g} m"
        )


def _recorded_widths(model: Source) -> dict[str, Any]:
    """Widths of the vehicle and of the lane that departures were found with, where that is known."""
    source = model.provenance.source if isinstance(model, ScenarioModel) else model.source
    criteria = source.get("criteria")
    width = criteria.get("vehicle_width") if isinstance(criteria, Mapping) else None
    return {"w_v": width, "w_l": source.get("nominal_lane_width")}


def with_counts(study: Study, model: Source) -> Study:
    """The study with the number of departures of each side, where it takes all of a table, or is given a model."""
    source = study.scenarios
    if not isinstance(model, ScenarioModel):
        left, right = model.counts(source.left, source.right, source.given)
        changes: dict[str, Any] = {"left": left, "right": right}
    elif source.model:
        return study
    else:  # the table is for its finalists then
        left, right = (500 if n is None else n for n in (source.left, source.right))
        changes = {"model": "given", "left": left, "right": right}
    return study.changed(scenarios=changes)


def with_recorded_widths(study: Study, model: Source, vehicle_width: float | None = None) -> Study:
    """The study with the vehicle and the lane that its departures were found with, where that is known. A departure is
    where the vehicle's edge is beyond the line: another width would not see the same ones.
    """
    usual = VehicleParameters()
    changed = {}
    for name, recorded in _recorded_widths(model).items():
        width = getattr(study.vehicle, name)
        if name == "w_v" and vehicle_width is not None:
            changed[name] = float(vehicle_width)
        elif isinstance(recorded, int | float) and abs(recorded - width) > 1e-9:
            if width != getattr(usual, name):
                raise InputError(
                    f"vehicle.{name}",
                    f"m in the study, {recorded:g} m in the recordings behind its departures",
                    value=width,
                    allowed=f"{recorded:g}, or --vehicle-width to decide",
                )
            changed[name] = float(recorded)
    return study.changed(vehicle=changed) if changed else study


def _notes(model: ScenarioModel) -> Iterator[str]:
    origin = model.provenance
    if origin.synthetic and not str(origin.source.get("description", "")).lower().startswith("synthetic"):
        yield "Synthetic: fitted to departures drawn from a stated population, not to recorded driving."
    for key, value in _flat(origin.source):
        text = f"{key}: {value}" if key else str(value)
        if value not in ("", None):
            yield text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
    for name, side, summary in (("left", model.left_side, origin.left), ("right", model.right_side, origin.right)):
        K, smoothed = side.mixture.n_components, summary is not None and summary.kind == "smoothed"
        kind = "smoothed departures" if smoothed else f"{K} component{'s' * (K > 1)}"
        yield f"{name}: {kind}{_fit_text(summary)}"
        yield from (f"{name}: {text}" for text in (_box(side, summary), _map_text(side)) if text)
    if origin.software:
        yield f"fitted with {origin.software}, seed {origin.seed}, {origin.created}".rstrip(", ")
    if origin.versions:
        yield ", ".join(f"{name} {version}" for name, version in origin.versions.items())


def _fit_text(summary: SideSummary | None) -> str:
    if summary is None:
        return ""
    weight = "" if summary.weight is None else f" that stand for {summary.weight:,.6g}"
    text = f" from {summary.events:,} departures{weight}"
    return f"{text}: {summary.reason}" if summary.reason else text


def _box(side: SideModel, summary: SideSummary | None) -> str:
    """Bounds, and where they come from; nothing of models that do not tell."""
    if summary is None or not summary.bounds_from:
        return ""
    origins = {name: (low, high) for name, low, high in summary.bounds_from}
    texts = []
    for name, low, high in zip(side.names, *side.bounds(), strict=True):
        below, above = origins.get(name, ("", ""))
        ends = " to ".join("open" if math.isinf(end) else f"{end:.4g}" for end in (low, high))
        texts.append(f"{name} {ends} ({below if below == above else f'{below}, {above}'})")
    return f"bounds {'; '.join(texts)}"


def _map_text(side: SideModel) -> str:
    mapped = [f"{name} by {kind}" for name, kind in zip(side.names, side.transform(), strict=True) if kind != "none"]
    return f"fitted after a map of {', '.join(mapped)}" if mapped else ""


def _flat(source: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Entries of a model's source, a table's on one line."""
    for key, value in source.items():
        if isinstance(value, Mapping):
            yield key, ", ".join(f"{name} {_plain(item)}" for name, item in value.items() if item not in ("", None))
        else:
            yield "" if key == "description" else key, _plain(value)


def _plain(value: Any) -> Any:
    """A value of a model's source on one line."""
    if isinstance(value, Mapping):
        return " ".join(f"{name} {_plain(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(str(_plain(item)) for item in value)
    return f"{value:g}" if isinstance(value, float) else value
