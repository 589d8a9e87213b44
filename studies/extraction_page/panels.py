"""Histograms of the page: the eight parameters of all departures and of each source, and lane widths."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, RIGHT, Departures
from studies.extraction_page.axis_ticks import Axis
from studies.extraction_page.counts import SIDES, Row
from studies.extraction_page.histograms import (
    Shares,
    beyond_note,
    histogram,
    shared_edges,
    small_histogram,
    width_shares,
)
from studies.extraction_page.quantities import LANE_WIDTH, PARAMETERS, Quantity
from studies.report.words.text import number, shorten

MOST_WIDTHS = 12
"""Sources whose lane widths get a panel of their own."""

QUANTILES = (0.05, 0.5, 0.95)

_SIDES = dict(zip(SIDES, (LEFT, RIGHT), strict=True))


@dataclasses.dataclass(frozen=True)
class Panel:
    """One figure and the words under it."""

    svg: Markup
    note: str = ""


@dataclasses.dataclass(frozen=True)
class Head:
    """Head of a column of small histograms: what, and the range of its axis."""

    label: str
    ends: str


def parameter_panels(departures: Departures) -> list[Panel]:
    """One panel a parameter, both sides in it."""
    out = []
    for quantity in PARAMETERS:
        values = quantity.shown(getattr(departures, quantity.name))
        sides = _by_side(values, departures.side, shared_edges(values, quantity.least))
        out.append(Panel(histogram(quantity, sides, "All departures"), beyond_note(sides)))
    return out


def quantile_rows(departures: Departures) -> list[tuple[Quantity, FloatArray, FloatArray]]:
    """Quantiles of each parameter, left and right; NaN where a side has no departures."""
    out = []
    for quantity in PARAMETERS:
        values = quantity.shown(getattr(departures, quantity.name))
        left, right = (_quantiles(values[departures.side == side]) for side in _SIDES.values())
        out.append((quantity, left, right))
    return out


def _quantiles(values: FloatArray) -> FloatArray:
    return np.quantile(values, QUANTILES) if values.size else np.full(len(QUANTILES), np.nan)


def _by_side(values: FloatArray, sides: npt.NDArray[np.int64], edges: FloatArray) -> dict[str, Shares]:
    return {name: Shares.of(values[sides == side], edges) for name, side in _SIDES.items()}


def small_table(
    departures: Departures, source: npt.NDArray[np.str_], rows: Sequence[Row]
) -> tuple[list[Head], list[tuple[str, list[tuple[Markup, str]]]]]:
    """Histograms of each parameter and of the lane's width, a row a source, one axis a column.

    Parameters
    ----------
    departures : Departures
        n departures.
    source : (n,) str
        Source of each.
    rows : sequence of Row
        Sources.

    Returns
    -------
    heads : list of Head
    rows : list of (str, list of (Markup, str))
        Title, and drawing and medians of each cell.
    """
    place = {name: i for i, row in enumerate(rows) for name in row.sources}
    names, inverse = np.unique(source, return_inverse=True)
    owner = np.array([place.get(str(name), -1) for name in names], dtype=np.int64)[inverse]
    members = [np.flatnonzero(owner == i) for i in range(len(rows))]
    heads, columns = [], []
    for quantity in PARAMETERS:
        values = quantity.shown(getattr(departures, quantity.name))
        edges = shared_edges(values, quantity.least, len(rows))
        heads.append(_head(quantity, edges))
        cells = []
        for mine in members:
            sides = _by_side(values[mine], departures.side[mine], edges)
            medians = " / ".join(number(one.median, quantity.digits) for one in sides.values())
            cells.append((small_histogram(quantity, sides), medians))
        columns.append(cells)
    shares = width_shares([row.account.widths for row in rows])
    heads.append(_head(LANE_WIDTH, shares[0].edges))
    columns.append(
        [(small_histogram(LANE_WIDTH, {"all": one}), number(one.median, LANE_WIDTH.digits)) for one in shares]
    )
    return heads, [(row.title, [cells[i] for cells in columns]) for i, row in enumerate(rows)]


def _head(quantity: Quantity, edges: FloatArray) -> Head:
    axis = Axis(float(edges[0]), float(edges[-1]))
    low, high = (axis.label(end, 2 * edges.size) for end in (axis.low, axis.high))
    return Head(quantity.label, f"{low} to {high}")


def width_panels(whole: Row, rows: Sequence[Row]) -> list[Panel]:
    """Lane widths of all valid samples, and of each source where there are several but not too many."""
    shown = [whole, *rows] if 1 < len(rows) <= MOST_WIDTHS else [whole]
    if not whole.account.widths.any():
        return []
    out = []
    for row, shares in zip(shown, width_shares([row.account.widths for row in shown]), strict=True):
        title = "All recordings" if row is whole else shorten(row.title, 200)
        median = number(shares.median, LANE_WIDTH.digits)
        note = f"{title}: median {median} m" if shares.n else f"{title}: no valid samples"
        out.append(Panel(histogram(LANE_WIDTH, {"all": shares}, title), note))
    return out
