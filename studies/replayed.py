"""Recorded departures as the scenarios of a study: which rows of which table are replayed."""

from __future__ import annotations

import dataclasses
import hashlib
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

    name: str  # Of its file
    scenarios: Scenarios  # All of its rows that can be driven
    weights: FloatArray | None = None  # (n,) Events that each stands for
    notes: tuple[str, ...] = ()  # Where they come from, for readers
    warnings: tuple[str, ...] = ()  # What of them is left out
    source: dict[str, Any] = dataclasses.field(default_factory=dict)  # What is known of them, as a model's source

    @property
    def content_hash(self) -> str:
        """SHA-256 of all that is replayed."""
        digest = hashlib.sha256(b"" if self.weights is None else self.weights.tobytes())
        for array in self.scenarios.arrays():
            digest.update(array.tobytes())
        return digest.hexdigest()

    def counts(self, left: int | None, right: int | None, given: Given | None) -> tuple[int, int]:
        """Departures of each side to replay: those requested, else all; with weights, as many as they are worth."""
        found = []
        for side, wanted in ((LEFT, left), (RIGHT, right)):
            rows = self._rows(side, given)
            w = None if self.weights is None else self.weights[rows]
            worth = rows.size if w is None else round(float(w.sum()) ** 2 / float(w @ w)) if w.any() else 0
            if wanted is not None and (wanted > rows.size if w is None else wanted and not worth):
                key = "left" if side == LEFT else "right"
                raise InputError(
                    f"scenarios.{key}", value=wanted, allowed=f"up to {rows.size}, which {self.name} holds"
                )
            found.append(worth if wanted is None else wanted)
        if not sum(found):
            raise InputError("scenarios", f"{self.name} holds no departure to replay under the study's conditions")
        return found[0], found[1]

    def sample(self, n_left: int, n_right: int, seed: int, given: Given | None = None) -> Scenarios:
        """Rows of the table, left ones first; fewer than all are chosen at random, in proportion to the weights."""
        chosen = []
        for side, n in ((LEFT, n_left), (RIGHT, n_right)):
            rows, rng = self._rows(side, given), np.random.default_rng([seed, side == RIGHT])
            if self.weights is not None and n:
                # systematic: each row as often as its weight asks for, to within one
                share = np.cumsum(self.weights[rows]) / self.weights[rows].sum()
                rows = rows[
                    np.searchsorted(share, (np.arange(n) + rng.random()) / n, side="right").clip(0, rows.size - 1)
                ]
            elif n < rows.size:
                rows = rows[np.sort(rng.permutation(rows.size)[:n])]
            chosen.append(rows)
        rows = np.concatenate(chosen)
        # a scenario's number is its row in the table; with weights a row may be there more than once
        index = rows if self.weights is None else np.arange(rows.size)
        return dataclasses.replace(self.scenarios.take(rows), index=index)

    def _rows(self, side: int, given: Given | None) -> IntArray:
        keep = self.scenarios.side == side
        for one in conditions(given):
            column = getattr(self.scenarios, one.name)
            keep &= (column >= one.low) & (column <= one.high)
        return np.flatnonzero(keep)


def read_replayed(study: Study) -> ReplayedDepartures:
    """Read and check the table that a study replays.

    Raises `RecordingError` naming file, column and row; `InputError` for a value outside what can be driven.
    """
    wanted = study.scenarios
    path, name = study.folder / wanted.replayed, Path(wanted.replayed).name
    warnings: tuple[str, ...] = ()
    source: dict[str, Any] = {}
    if wanted.departures:
        found, provenance = read_departures(path, signals=wanted.path == "recorded")
        drivable = slowest_speed(found.v_mean, found.a_mean, found.T) >= SPEED_FLOOR
        weights = None
        if wanted.weights:
            known = {column.name: column.values for column in found.extra if column.values.dtype.kind == "f"}
            if wanted.weights not in known:
                raise RecordingError(name, "is no column of numbers", value=wanted.weights, allowed=known)
            weights = np.asarray(known[wanted.weights], dtype=np.float64)
        notes = [f"Recorded departures, replayed: {found.n:,} of {name}, found in {provenance.hours:,.4g} h."]
        if wanted.path == "recorded":
            notes.append("Without control their recorded y(t), v(t) and c(t) are driven, not the fitted parabola.")
        if slow := int((~drivable).sum()):
            warnings = (f"{slow:,} of them fall below {SPEED_FLOOR:g} m/s, cannot be driven, and are left out",)
        source = {
            "criteria": dataclasses.asdict(provenance.criteria),
            "nominal_lane_width": provenance.preparation.nominal_lane_width,
        }
        scenarios = _checked(name, lambda: Scenarios.from_departures(found.take(drivable), path=wanted.path))
        weights = None if weights is None else weights[drivable]
    else:
        table, _ = read_table(path, "a table of departures")
        columns: dict[str, Any] = {own: column_of(name, table, column) for own, column in PARAMETER_COLUMNS.items()}
        if "side" not in table.columns:
            raise RecordingError(name, "column 'side' is missing", allowed="left, right")
        weights = column_of(name, table, wanted.weights) if wanted.weights else None
        scenarios = _checked(name, lambda: Scenarios.from_arrays(side=table["side"].to_list(), **columns))
        notes = [f"{scenarios.n:,} departures of {name}."]
    if weights is not None and not ((weights >= 0.0) & np.isfinite(weights)).all():
        raise RecordingError(name, f"column {wanted.weights!r} holds {weights.min():g}", allowed="finite, at least 0")
    return ReplayedDepartures(name, scenarios, weights, tuple(notes), warnings, source)


def _checked(name: str, make: Any) -> Scenarios:
    try:
        made: Scenarios = make()
    except LdcError as error:
        raise InputError(name, f"{error}") from None
    return made
