"""Recorded departures as the scenarios of a study: the table, and the rows of it that are replayed."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, RIGHT
from ldctoolkit.errors import InputError, LdcError, RecordingError
from ldctoolkit.recordings import read_departures
from ldctoolkit.recordings.departures_table import column_of, read_table
from ldctoolkit.scenario_model import Given, conditions
from ldctoolkit.scenarios import SPEED_FLOOR, Scenarios, slowest_speed

from .study_file import Study


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
        keep = self.scenarios.side == side
        for condition in conditions(given):
            column = getattr(self.scenarios, condition.name)
            keep &= (column >= condition.low) & (column <= condition.high)
        return np.flatnonzero(keep)


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
                raise RecordingError(name, "is no column of numbers", value=settings.weights, allowed=numeric)
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
        scenarios = _checked(name, lambda: Scenarios.from_departures(departures.take(drivable), path=settings.path))
        weights = None if weights is None else weights[drivable]
    else:
        table, _ = read_table(path, "a table of departures")
        columns: dict[str, Any] = {field: column_of(name, table, key) for field, key in PARAMETER_COLUMNS.items()}
        if "side" not in table.columns:
            raise RecordingError(name, "column 'side' is missing", allowed="left, right")
        weights = column_of(name, table, settings.weights) if settings.weights else None
        scenarios = _checked(name, lambda: Scenarios.from_arrays(side=table["side"].to_list(), **columns))
        notes = [f"{scenarios.n:,} departures of {name}."]
    if weights is not None and not ((weights >= 0.0) & np.isfinite(weights)).all():
        raise RecordingError(name, f"column {settings.weights!r} holds {weights.min():g}", allowed="finite, at least 0")
    return ReplayedDepartures(name, scenarios, weights, tuple(notes), warnings, source)


def _checked(name: str, make: Callable[[], Scenarios]) -> Scenarios:
    try:
        return make()
    except LdcError as error:
        raise InputError.of(error.within(name, ": ")) from None
