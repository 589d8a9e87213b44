# ruff: noqa: RUF001 - the page shows true apostrophes
"""The source departures of one side: from a departures table, from the model's file, or why they are not known."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import Departures
from ldctoolkit.scenario_model import SideSummary, SourceSummary, summarize
from ldctoolkit.scenario_model.model import Condition
from studies.report.model_match.parts import Origin

LEAST: Final = 30
"""Departures that a comparison needs, as a fit does."""


@dataclasses.dataclass(frozen=True)
class Source:
    """Source departures of one side.

    Attributes
    ----------
    origin : {"table", "summary", "none"}
    count : int or None
        Departures.
    effective : float
        Kish's effective number.
    columns : dict of str to (n,)
        Of a table: each parameter.
    summary : SourceSummary or None
        Of a table's parameters, or what the model's file holds.
    reason : str
        Why there is nothing.
    """

    origin: Origin
    count: int | None = None
    effective: float = 0.0
    columns: dict[str, FloatArray] = dataclasses.field(default_factory=dict)
    summary: SourceSummary | None = None
    reason: str = ""

    def distance(self, name: str, column: FloatArray) -> float | None:
        """Kolmogorov distance of generated values (n,); from a summary at its quantiles only."""
        own = self.columns.get(name)
        ordered = np.sort(column)
        if own is not None:
            ends, base = np.concatenate([own, column]), np.sort(own)
            gap = _reached(base, ends) - _reached(ordered, ends)
        elif self.summary is not None and name in self.summary.names:
            row = np.array(self.summary.quantiles[self.summary.names.index(name)])
            gap = _reached(ordered, row) - self.summary.probabilities
        else:
            return None
        return float(np.abs(gap).max())

    def shares(self, name: str, edges: FloatArray) -> FloatArray | None:
        """Share in each bin."""
        own = self.columns.get(name)
        if own is not None:
            return np.asarray(np.diff(_reached(np.sort(own), edges)))
        if self.summary is None or name not in self.summary.names:
            return None
        row, shares = self.summary.quantiles[self.summary.names.index(name)], self.summary.probabilities
        below = np.interp(edges, _distinct(np.array(row)), shares)
        return np.asarray(np.diff(below))

    def at(self, name: str, probabilities: tuple[float, ...]) -> FloatArray | None:
        """Quantiles."""
        own = self.columns.get(name)
        if own is not None:
            return np.asarray(np.quantile(own, probabilities))
        if self.summary is None or name not in self.summary.names:
            return None
        j = self.summary.names.index(name)
        return np.array([self.summary.at(p)[j] for p in probabilities])


def _reached(ordered: FloatArray, x: FloatArray) -> FloatArray:
    """Share of ordered values at or below each x."""
    return np.asarray(np.searchsorted(ordered, x, side="right") / ordered.size)


def _distinct(row: FloatArray) -> FloatArray:
    """Ascending without ties, for interpolation."""
    return np.asarray(row + np.arange(row.size) * np.spacing(np.abs(row).max() + 1e-300))


def source_of_side(
    side: int,
    names: tuple[str, ...],
    table: Departures | None,
    fitted: SideSummary | None,
    wanted: tuple[Condition, ...],
) -> Source:
    """What is known of the departures that the model of a side was fitted to.

    Parameters
    ----------
    side : {LEFT, RIGHT}
    names : tuple of str
        Parameters that vary in the generated departures.
    table : Departures, optional
        Both sides together.
    fitted : SideSummary, optional
        How the side was fitted.
    wanted : tuple of Condition
        Which departures the study drew.
    """
    if table is not None:
        return _of_table(table.take(table.side == side), names, wanted)
    summary = None if fitted is None else fitted.source_summary
    if summary is None:
        return Source("none", reason="The scenario model’s file holds no summary of its source departures")
    if wanted:
        return Source(
            "none",
            reason="The model’s file sums up all of its source departures and not those that meet the study’s "
            "conditions; a departures table (--source) would be compared under them",
        )
    return Source("summary", summary.departures, summary.effective, summary=summary)


def _of_table(rows: Departures, names: tuple[str, ...], wanted: tuple[Condition, ...]) -> Source:
    values = [condition.name for condition in wanted if condition.low == condition.high]
    if values:
        return Source(
            "none",
            reason=f"The study draws departures at one value of {', '.join(values)}, which no recorded departure has "
            "exactly: there is nothing to compare with",
        )
    keep = np.ones(rows.n, dtype=bool)
    for condition in wanted:
        column = getattr(rows, condition.name)
        keep &= (column >= condition.low) & (column <= condition.high)
    rows = rows.take(keep)
    if rows.n < LEAST:
        under = " that meet the study’s conditions" if wanted else ""
        return Source(
            "none", reason=f"The departures table holds {rows.n} departures of this side{under}; {LEAST} are needed"
        )
    columns = {name: np.asarray(getattr(rows, name), dtype=float) for name in names}
    summary = summarize(np.column_stack([*columns.values()]), names=names) if names else None
    return Source("table", rows.n, float(rows.n), columns, summary)
