"""Histograms of the page: the eight parameters of all departures and of each source, and lane widths."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, RIGHT, Departures
from ldctoolkit.recordings.account import share_of_widths
from studies.extraction_page.counts import SIDES, Row
from studies.extraction_page.svg_plot import LANE_WIDTH, PARAMETERS, Axis, Frame, Quantity, picture
from studies.report.words.text import number, percent, shorten

MOST_BINS = 40
ENDS = 0.002
"""Share of the values at either end that the axis leaves out where there are many; what is left out is told."""

MANY = 500


@dataclasses.dataclass(frozen=True)
class Shares:
    """Shares of n values in equal bins."""

    n: int  # all values, also those beyond the bins
    edges: FloatArray  # (b + 1,)
    share: FloatArray  # (b,): of all n, so that they sum to less than 1 where some lie beyond
    median: float  # NaN for none

    @classmethod
    def of(cls, values: FloatArray, edges: FloatArray) -> Shares:
        """Count values; those that are not finite are left out."""
        known = values[np.isfinite(values)]
        # edges are multiples of a round number and may miss a value that lies on the last one by its last digit
        slack = 1e-6 * (edges[1] - edges[0])
        inside = known[(known >= edges[0] - slack) & (known <= edges[-1] + slack)]
        share = np.histogram(np.clip(inside, edges[0], edges[-1]), edges)[0] / max(known.size, 1)
        return cls(known.size, edges, share, float(np.median(known)) if known.size else float("nan"))

    @property
    def beyond(self) -> float:
        """Share of the values that no bin holds."""
        return max(0.0, 1.0 - float(self.share.sum())) if self.n else 0.0


def shared_edges(values: FloatArray, least: float, groups: int = 1) -> FloatArray:
    """Edges of bins of a round width over nearly all values."""
    known = values[np.isfinite(values)]
    ends = np.quantile(known, [ENDS, 1.0 - ENDS]) if known.size >= MANY else known
    axis = Axis.around(ends, least=least, margin=0.0)
    if axis.low < 0.0 and known.size and known.min() >= 0.0:  # what is never negative has no axis below zero
        axis = Axis(0.0, axis.high - axis.low)
    step = axis.step(int(np.clip(np.ceil(3.0 * np.cbrt(known.size / groups)), 8, MOST_BINS)))
    first, last = np.floor(axis.low / step + 1e-9), np.ceil(axis.high / step - 1e-9)
    return np.arange(first, max(last, first + 1) + 1) * step


def histogram(quantity: Quantity, sides: dict[str, Shares], title: str) -> Markup:
    """One panel: both sides over the same bins, with axes."""
    edges = next(iter(sides.values())).edges
    frame = Frame(42, 26, 246, 130, Axis(float(edges[0]), float(edges[-1])), _heights(sides))
    grid = frame.grid(x_ticks=5, y_ticks=5, x_label=quantity.label, y_label="Share per bin [%]")
    alt = f"{title}: {quantity.name}, {quantity.meaning}. {'; '.join(told(quantity, sides))}."
    return picture(300, 195, alt, grid, *_curves(frame, sides))


def small_histogram(quantity: Quantity, sides: dict[str, Shares]) -> Markup:
    """The same without axes, for a cell of a table."""
    edges = next(iter(sides.values())).edges
    frame = Frame(1, 1, 118, 40, Axis(float(edges[0]), float(edges[-1])), _heights(sides))
    ground = Markup('<path class="edge" d="M1 41H119"/>')
    return picture(120, 42, f"{quantity.name}: {'; '.join(told(quantity, sides))}", ground, *_curves(frame, sides),
                   kind="small-plot")  # fmt: skip


def told(quantity: Quantity, sides: dict[str, Shares]) -> list[str]:
    """Median of each side in words: what a histogram says to those who cannot see it."""
    return [
        f"{side} median {number(one.median, quantity.digits)} {quantity.unit}" if one.n else f"{side} none"
        for side, one in sides.items()
    ]


def width_shares(counts: Sequence[npt.NDArray[np.int64]]) -> list[Shares]:
    """Shares of samples by lane width, one for each account's `widths`, over the bins that hold nearly all of them."""
    every = np.sum(counts, axis=0)
    edges, _ = share_of_widths(every)
    inside = np.flatnonzero(
        (np.cumsum(every) > ENDS * every.sum()) & (np.cumsum(every[::-1])[::-1] > ENDS * every.sum())
    )
    first, last = (max(inside[0] - 1, 0), inside[-1] + 2) if inside.size else (20, 50)
    found = []
    for count in counts:
        n, below = int(count.sum()), np.concatenate([[0], np.cumsum(count)])
        median = float(np.interp(0.5 * n, below, edges)) if n else float("nan")
        found.append(Shares(n, edges[first : last + 1], share_of_widths(count)[1][first:last], median))
    return found


def beyond_note(sides: dict[str, Shares]) -> str:
    """What the axis leaves out; empty where it is nothing."""
    parts = [f"{percent(one.beyond)} {side}" for side, one in sides.items() if one.beyond > 5e-4]
    return f"not shown: {', '.join(parts)}" if parts else ""


def _heights(sides: dict[str, Shares]) -> Axis:
    highest = max((float(one.share.max()) for one in sides.values() if one.n), default=0.0)
    return Axis(0.0, 105.0 * highest if highest > 0.0 else 1.0)


def _curves(frame: Frame, sides: dict[str, Shares]) -> list[Markup]:
    return [frame.steps(one.edges, 100.0 * one.share, f"steps {side}") for side, one in sides.items() if one.n]


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
    """Histograms of each parameter and of the lane's width, a row a source, one axis a column."""
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
