"""Charts as values: axes, series, rows of intervals, cells and limits; and their drawing as SVG for the pages.

A page holds `Chart.svg`, a file `Chart.document`, and `ldctoolkit.studies.plotting` draws the same value on matplotlib
axes. Colours of the SVG are classes, so that the page's style sheet sets them for light, dark and print.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Final, Literal

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape

from ldctoolkit.arrays import BoolArray, FloatArray

from ..design import NO_CONTROL
from ..text import compact, printable, shorten, symbols_svg

WIDTH: Final = 420.0  # units of a chart's width: text of 12 units is 10 px high on the narrowest phone

COLORS: Final = ("#0072b2", "#d55e00", "#009e73", "#b5548f", "#b07900", "#3b8fc2")
"""Okabe and Ito's colours, the light ones darkened until they stand out from white."""

LEFT_IS_BETTER: Final = ": \u2190 better, worse \u2192"
"""End of the label of an axis of S, or of a difference of S."""

_DASHES: Final = ("", "7 3", "2 2.5", "9 3 2 3", "5 2 5 6")
_MARKERS: Final = "osdvx^"
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 10.0, 10.0, 44.0
_CHARACTER: Final = 6.4  # width of a character of the labels [units]
_ROW, _BETWEEN_ROWS, _ROWS_TOP = 14.0, 8.0, 22.0  # of a chart of intervals [units]
_VIRIDIS: Final = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725")


@dataclasses.dataclass(frozen=True)
class Style:
    """How a law is drawn: number of its colour, dash, marker; ``color`` -1 is the recorded path."""

    color: int
    dash: str
    marker: str

    @property
    def name(self) -> str:
        """Class of the style sheet."""
        return "recorded" if self.color < 0 else f"c{self.color}"

    @property
    def hex(self) -> str:
        """The colour on white."""
        return "#595959" if self.color < 0 else COLORS[self.color]


RECORDED: Final = Style(-1, "2 2.5", "|")  # the departure as it was recorded, without control


def law_styles(laws: Iterable[str]) -> dict[str, Style]:
    """One style a law, in the order in which the laws first appear; a colour repeats only with another dash."""
    styles: dict[str, Style] = {}
    for law in laws:
        if law not in styles:
            k = len(styles) - (NO_CONTROL in styles)
            dash = _DASHES[(k + k // len(COLORS)) % len(_DASHES)]
            style = Style(k % len(COLORS), dash, _MARKERS[k % len(_MARKERS)])
            styles[law] = RECORDED if law == NO_CONTROL else style
    return styles


# ------------------------------------------------------------------------------------------------ values


@dataclasses.dataclass(frozen=True)
class Axis:
    """One axis: label with its unit, and its ends."""

    label: str
    low: float  # infinite ends: matplotlib chooses them
    high: float
    log: bool = False
    categories: tuple[str, ...] = ()  # names at 0, 1, ... instead of numbers

    @classmethod
    def around(cls, label: str, *values: npt.ArrayLike, zero: bool = False, log: bool = False) -> Axis:
        """An axis that holds all finite values with some room; `zero` begins it at 0."""
        finite = np.concatenate([np.ravel(np.asarray(part, dtype=np.float64)) for part in values] or [np.empty(0)])
        finite = finite[np.isfinite(finite) & (finite > 0 if log else True)]
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        if log:
            return cls(label, low / 1.15, high * 1.15, log=True)
        low = min(low, 0.0) if zero else low
        room = 0.05 * (high - low) or 0.5 * abs(high) or 0.5
        return cls(label, low if zero and low == 0.0 else low - room, high + room)

    @classmethod
    def of_names(cls, label: str, names: Sequence[str]) -> Axis:
        """An axis of categories, a unit each."""
        return cls(label, -0.5, len(names) - 0.5, categories=tuple(names))

    def fraction(self, values: npt.ArrayLike) -> FloatArray:
        """Position between 0 and 1 along the axis; what lies outside is put at its end."""
        with np.errstate(divide="ignore", invalid="ignore"):
            x = np.asarray(values, dtype=np.float64)
            low, high = self.low, self.high
            if self.log:
                x, low, high = np.log(np.maximum(x, 1e-300)), math.log(low), math.log(high)
            return np.asarray(np.clip((x - low) / ((high - low) or 1.0), 0.0, 1.0))

    def ticks(self, room: float) -> list[tuple[float, str]]:
        """Values and their text, as many as the length [units] has room for."""
        if self.categories:
            every = max(1, math.ceil(len(self.categories) * 15 / room))
            return [(float(i), shorten(name, 18)) for i, name in enumerate(self.categories) if i % every == 0]
        if self.log:
            tens = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            near = [m * 10.0**k for k in tens for m in ((1, 2, 5) if len(tens) < 4 else (1,))]
            return [(value, compact(value)) for value in near if self.low <= value <= self.high]
        step = nice_step(self.high - self.low, max(2, int(room / 55)))
        first = math.ceil(self.low / step - 1e-9)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        values = [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]
        return [(x, f"{x:.{digits}f}".replace("-", "\u2212") if abs(x) > 1e-12 else "0") for x in values]


def nice_step(span: float, most: int) -> float:
    """1, 2 or 5 times a power of ten that divides a span into at most so many steps."""
    rough = max(span, 1e-300) / most
    ten = 10.0 ** math.floor(math.log10(rough))
    return next(m * ten for m in (1.0, 2.0, 5.0, 10.0) if m * ten >= rough * (1 - 1e-9))


Kind = Literal["line", "thin", "steps", "marked", "started", "points", "bars", "outline"]
"""A line, one of many, with steps, all points or the first one marked; points alone; a filled histogram or its line."""


@dataclasses.dataclass(frozen=True)
class Series:
    """Numbers that are drawn in one style."""

    label: str
    x: FloatArray  # (n,), of a histogram the n + 1 edges of its bins
    y: FloatArray  # (n,)
    style: Style
    low: FloatArray | None = None  # (n,) ends of a band around a line
    high: FloatArray | None = None
    kind: Kind = "line"
    filled: BoolArray | None = None  # (n,) points that are filled; all by default
    tips: tuple[str, ...] = ()  # text that a point shows under the pointer


@dataclasses.dataclass(frozen=True)
class Dot:
    """A value with its interval beside a label; `open` draws the marker without filling."""

    label: str
    value: float
    low: float
    high: float
    style: Style
    open: bool = False
    tip: str = ""
    beside: tuple[float, Style] | None = None  # another value on the same line


@dataclasses.dataclass(frozen=True)
class Cells:
    """Values of a heat map (r, c) with their texts; NaN stays empty, `crossed` cells have a cross."""

    values: FloatArray
    texts: Sequence[Sequence[str]]
    crossed: BoolArray | None = None
    label: str = ""  # what they are, with the unit


@dataclasses.dataclass(frozen=True, eq=False)
class Chart:
    """A chart. It holds series, or rows of intervals, or the cells of a heat map."""

    name: str  # letters, digits and dashes; the file's name
    title: str  # for a screen reader
    x: Axis
    y: Axis
    series: Sequence[Series] = ()
    rows: Sequence[Sequence[Dot]] = ()  # several in one row stand below each other; `y` is not used
    cells: Cells | None = None
    limit: tuple[float, str] | None = None  # upright, with its text; what lies beyond is shaded
    level: float | None = None  # a dashed line across
    upright: tuple[float, str] | None = None  # a dashed upright line with its text
    front: tuple[FloatArray, FloatArray] | None = None  # corners of a Pareto front
    diagonal: bool = False
    ring: tuple[float, float, str] | None = None  # the point that is marked, and what it is
    height: float = 270.0

    @property
    def frame(self) -> _Frame:
        """The drawing."""
        if self.rows:
            return _intervals(self)
        frame = _Frame(self.x, self.y, self.height)
        return _heat_map(self, self.cells, frame) if self.cells is not None else _curves(self, frame)

    @property
    def body(self) -> str:
        """SVG elements."""
        return "".join(self.frame.parts)

    @property
    def svg(self) -> Markup:
        """The chart as an element of a page."""
        frame = self.frame
        return Markup(
            f'<svg class="chart" role="img" viewBox="0 0 {WIDTH:g} {frame.height:g}" '
            f'aria-label="{escape(printable(self.title))}">{"".join(frame.parts)}</svg>'
        )

    @property
    def document(self) -> str:
        """The chart as a file of its own."""
        frame, style = self.frame, "".join(f".c{i}{{--c:{color}}}" for i, color in enumerate(COLORS))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" width="{1.6 * WIDTH:g}" '
            f'height="{1.6 * frame.height:g}" viewBox="0 0 {WIDTH:g} {frame.height:g}">'
            f"<title>{escape(printable(self.title))}</title><style>{style}{FILE_STYLE}</style>"
            f'<rect width="100%" height="100%" fill="#fff"/>{"".join(frame.parts)}</svg>\n'
        )


def ecdf(
    name: str, title: str, samples: Sequence[tuple[str, FloatArray, Style]], x: Axis, y_label: str,
    *, limit: tuple[float, str] | None = None, most: int = 200,
) -> Chart:  # fmt: skip
    """Empirical distribution functions, at `most` quantiles where there are more values."""
    series = []
    for label, values, style in samples:
        ordered = np.sort(values[~np.isnan(values)])
        if ordered.size:
            share = np.arange(1, ordered.size + 1) / ordered.size
            rows = np.unique(np.linspace(0, ordered.size - 1, min(ordered.size, most)).astype(int))
            steps = np.append(x.low, ordered[rows]), np.append(0.0, share[rows])
            series.append(Series(label, *steps, style, kind="steps"))
    return Chart(name, title, x, Axis(y_label, 0.0, 1.0), series, limit=limit)


def bars(
    name: str, title: str, edges: FloatArray, shares: Sequence[tuple[str, FloatArray, Style]], x_label: str,
    y_label: str, *, outlines: Sequence[tuple[str, FloatArray, Style]] = (), height: float = 200.0,
) -> Chart:  # fmt: skip
    """Histograms as bars, and others over the same bins as outlines."""
    series = [Series(label, edges, values, style, kind="bars") for label, values, style in shares]
    series += [Series(label, edges, values, style, kind="outline") for label, values, style in outlines]
    highest = max((float(np.max(drawn.y, initial=0.0)) for drawn in series), default=0.0)
    x = Axis(x_label, float(edges[0]), float(edges[-1]))
    return Chart(name, title, x, Axis(y_label, 0.0, 1.06 * highest or 1.0), series, height=height)


def dots(
    name: str, title: str, rows: Sequence[Sequence[Dot]], x: Axis, *, upright: tuple[float, str] | None = None
) -> Chart:
    """Values with intervals, a row each; `upright` is a dashed line with its text."""
    return Chart(name, title, x, Axis("", 0.0, 1.0), rows=rows, upright=upright)


def heat_map(
    name: str, title: str, values: FloatArray, texts: Sequence[Sequence[str]], x: tuple[str, Sequence[str]],
    y: tuple[str, Sequence[str]], *, ring: tuple[int, int] | None = None, open_cells: BoolArray | None = None,
    label: str = "",
) -> Chart:  # fmt: skip
    """Cells with their numbers: dark is small; a ring marks row and column of one, a cross those of `open_cells`."""
    height = _TOP + _BOTTOM + max(26.0 * len(values), 60.0)
    marked = None if ring is None else (float(ring[1]), float(ring[0]), "")
    cells = Cells(values, texts, open_cells, label)
    return Chart(name, title, Axis.of_names(*x), Axis.of_names(*y), cells=cells, ring=marked, height=height)


# ------------------------------------------------------------------------------------------------ SVG

FILE_STYLE: Final = (
    ".chart{font:12px sans-serif;--ink:#222;--soft:#666;--grid:#ddd;--paper:#fff;--bad:#b3261e;--shade:#f3d9d6}"
    ".recorded{--c:#595959}text{fill:var(--ink)}.soft{fill:var(--soft)}.grid{stroke:var(--grid);fill:none}"
    ".axis{stroke:var(--soft);fill:none}.curve{stroke:var(--c);fill:none;stroke-width:1.8}"
    ".thin{stroke:var(--c);fill:none;stroke-width:.7;opacity:.45}.band{fill:var(--c);opacity:.16}.mark{stroke:var(--c);fill:var(--c)}.open{fill:var(--paper)}"
    ".bar{fill:var(--c);opacity:.45}.limit{stroke:var(--bad);fill:none;stroke-dasharray:8 3 2 3}"
    ".on-dark{fill:#fff}.on-light{fill:#000}.shade{fill:var(--shade);opacity:.6}.front{stroke:var(--soft);fill:none}.ring{stroke:var(--ink);fill:none}"
)
"""Rules for the elements of charts; the page's style sheet has the same with other colours in the dark."""


class _Frame:
    """The area of a chart that the axes span, and the elements drawn into it."""

    def __init__(self, x: Axis, y: Axis, height: float, *, left: float | None = None, top: float = _TOP) -> None:
        self.depth = height - top - _BOTTOM
        if left is None:
            longest = max((len(text) for _, text in y.ticks(1.4 * self.depth)), default=0)
            left = max(_LEFT, 34.0 + _CHARACTER * longest)
        self.x, self.y, self.left, self.top = x, y, left, top
        self.width, self.height = WIDTH - left - _RIGHT, height
        self.bottom, self.right = top + self.depth, WIDTH - _RIGHT
        self.parts: list[str] = []

    def px(self, values: npt.ArrayLike) -> FloatArray:
        return self.left + self.width * self.x.fraction(values)

    def py(self, values: npt.ArrayLike) -> FloatArray:
        return self.top + self.depth * (1.0 - self.y.fraction(values))

    def text(self, x: float, y: float, text: str, anchor: str = "middle", kind: str = "") -> None:
        named = f' class="{kind}"' if kind else ""
        self.parts.append(f'<text{named} x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{symbols_svg(text)}</text>')

    def draw(self, kind: str, path: str, style: Style | None = None, label: str = "", *, dashed: bool = True) -> None:
        """A path of a class, in a style."""
        dash = f' stroke-dasharray="{style.dash}"' if dashed and style is not None and style.dash else ""
        title = f"<title>{escape(printable(label))}</title>" if label else ""
        name = f"{kind} {style.name}" if style is not None else kind
        self.parts.append(f'<path class="{name}"{dash} d="{path}"' + (f">{title}</path>" if title else "/>"))

    def axes(self, *, grid_x: bool = True, grid_y: bool = True) -> None:
        grid, end = "", -math.inf
        for value, text in self.x.ticks(self.width):
            tick, half = float(self.px(value)), 0.5 * _CHARACTER * len(text) + 3
            shown = min(tick, WIDTH - half)
            grid += f"M{tick:.1f} {self.top:g}V{self.bottom:g}" if grid_x else ""
            if shown - half > end:
                self.text(shown, self.bottom + 15, text)
                end = shown + half
        for value, text in self.y.ticks(1.4 * self.depth):
            tick = float(self.py(value))
            grid += f"M{self.left:g} {tick:.1f}H{self.right:g}" if grid_y else ""
            self.text(self.left - 6, tick + 4, text, "end")
        if grid:
            self.parts.insert(0, f'<path class="grid" d="{grid}"/>')
        self.draw("axis", f"M{self.left:g} {self.top:g}V{self.bottom:g}H{self.right:g}")
        if self.x.label:
            middle = min(self.left + 0.5 * self.width, WIDTH - 0.5 * _CHARACTER * len(self.x.label))
            self.text(middle, self.bottom + 34, self.x.label, kind="soft")
        if self.y.label:
            self.parts.append(
                f'<text class="soft" transform="translate(13 {self.top + 0.5 * self.depth:g}) rotate(-90)" '
                f'text-anchor="middle">{symbols_svg(self.y.label)}</text>'
            )

    def path(self, x: npt.ArrayLike, y: npt.ArrayLike, *, steps: bool = False) -> str:
        """A line through the finite points."""
        px, py = self.px(x), self.py(y)
        finite = np.isfinite(px) & np.isfinite(py)
        pairs = list(zip(px[finite].tolist(), py[finite].tolist(), strict=True))
        if steps and pairs:
            return f"M{pairs[0][0]:.1f} {pairs[0][1]:.1f}" + "".join(f"H{a:.1f}V{b:.1f}" for a, b in pairs[1:])
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in pairs) if pairs else ""

    def limit(self, value: float, text: str) -> None:
        """A limit on the horizontal axis; what lies beyond is shaded."""
        upright = float(self.px(value))
        if upright < self.right:
            width = self.right - upright
            self.parts.append(
                f'<rect class="shade" x="{upright:.1f}" y="{self.top:g}" width="{width:.1f}" height="{self.depth:g}"/>'
            )
        self.draw("limit", f"M{upright:.1f} {self.top:g}V{self.bottom:g}")
        end = upright + _CHARACTER * len(text) > self.right
        self.text(upright - 4 if end else upright + 4, self.top + 12, text, "end" if end else "start", "soft")


def _curves(chart: Chart, frame: _Frame) -> _Frame:
    """Curves, points and histograms."""
    frame.axes()
    if chart.diagonal:
        corners = [chart.x.low, chart.x.high]
        frame.draw("front", frame.path(corners, corners))
    if chart.limit is not None:
        frame.limit(*chart.limit)
    if chart.front is not None and chart.front[0].size > 1:
        frame.draw("front", frame.path(*chart.front, steps=True))
    if chart.level is not None:
        frame.draw("curve", f"M{frame.left:g} {float(frame.py(chart.level)):.1f}H{frame.right:g}", RECORDED)
    for series in chart.series:
        if series.low is not None and series.high is not None:
            finite = np.isfinite(series.low) & np.isfinite(series.high)
            x, ends = series.x[finite], (series.high[finite], series.low[finite][::-1])
            if around := frame.path(np.concatenate([x, x[::-1]]), np.concatenate(ends)):
                frame.draw("band", f"{around}Z", series.style, dashed=False)
        if series.kind in ("bars", "outline"):
            heights = np.concatenate([[0.0], np.repeat(series.y, 2), [0.0]])
            filled = series.kind == "bars"
            around = frame.path(np.repeat(series.x, 2), heights)
            frame.draw("bar" if filled else "curve", around, series.style, dashed=not filled)
        elif series.kind != "points":
            path = frame.path(series.x, series.y, steps=series.kind == "steps")
            many = series.kind == "thin"
            frame.draw("thin" if many else "curve", path, series.style, series.label, dashed=not many)
            if series.kind in ("marked", "started"):
                points = list(_positions(frame, series))
                shown = points if series.kind == "marked" else points[:1]
                frame.parts += [marker(series.style, a, b, 3.0) for a, b, _, _ in shown]
    for above in (False, True):  # filled points lie above hollow ones
        frame.parts += [
            marker(series.style, a, b, 3.6, filled=filled, tip=tip)
            for series in chart.series
            if series.kind == "points"
            for a, b, filled, tip in _positions(frame, series)
            if filled == above
        ]
    if chart.ring is not None and math.isfinite(sum(chart.ring[:2])):
        x, y = frame.px(chart.ring[0]), frame.py(chart.ring[1])
        frame.parts.append(f'<circle class="ring" cx="{x:.1f}" cy="{y:.1f}" r="8"/>')
    return frame


def _positions(frame: _Frame, series: Series) -> Iterator[tuple[float, float, bool, str]]:
    """Where the finite points of a series are, whether each is filled, and its tip."""
    n = series.x.size
    filled = [True] * n if series.filled is None else series.filled.tolist()
    for a, b, *shown in zip(
        frame.px(series.x).tolist(), frame.py(series.y).tolist(), filled, series.tips or ("",) * n, strict=True
    ):
        if math.isfinite(a + b):
            yield a, b, *shown


def _intervals(chart: Chart) -> _Frame:
    """Values with intervals, the rows from the top."""
    depth = max(sum(_ROW * len(row) + _BETWEEN_ROWS for row in chart.rows), 60.0)
    labels = [shorten(row[0].label, 34) for row in chart.rows]
    left = min(30.0 + _CHARACTER * max(map(len, labels), default=0), 0.55 * WIDTH)
    height = depth + _BOTTOM + _ROWS_TOP
    frame = _Frame(chart.x, Axis("", 0.0, 1.0, categories=("",)), height, left=left, top=_ROWS_TOP)
    frame.axes(grid_y=False)
    if chart.upright is not None:
        upright = float(frame.px(chart.upright[0]))
        frame.draw("curve", f"M{upright:.1f} {frame.top:g}V{frame.bottom:g}", RECORDED)
        frame.text(upright, 14, chart.upright[1], "end" if upright > 0.75 * WIDTH else "middle", "soft")
    y = frame.top + 4.0
    for row, label in zip(chart.rows, labels, strict=True):
        frame.text(left - 8, y + 0.5 * _ROW * len(row) + 4, label, "end")
        for dot in row:
            middle = y + 0.5 * _ROW
            if math.isfinite(dot.low + dot.high):
                a, b = frame.px([dot.low, dot.high])
                frame.draw("curve", f"M{a:.1f} {middle:.1f}H{b:.1f}", dot.style, dashed=False)
            if math.isfinite(dot.value):
                x, tip = float(frame.px(dot.value)), dot.tip or dot.label
                frame.parts.append(marker(dot.style, x, middle, filled=not dot.open, tip=tip))
            if dot.beside is not None:
                frame.parts.append(marker(dot.beside[1], float(frame.px(dot.beside[0])), middle, tip=dot.tip))
            y += _ROW
        y += _BETWEEN_ROWS
    return frame


def _heat_map(chart: Chart, cells: Cells, frame: _Frame) -> _Frame:
    """Cells with their numbers: dark is small."""
    frame.axes(grid_x=False, grid_y=False)
    rows, columns = cells.values.shape
    width, depth = frame.width / columns, frame.depth / rows
    finite = cells.values[np.isfinite(cells.values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    room = max(len(text) for line in cells.texts for text in line) * _CHARACTER < width - 2
    for i, j in np.argwhere(np.isfinite(cells.values)).tolist():
        share = (cells.values[i, j] - low) / ((high - low) or 1.0)
        a, b = frame.left + j * width, frame.top + (rows - 1 - i) * depth
        dark, text = share < 0.62, cells.texts[i][j]
        ink = "#fff" if dark else "#000"
        frame.parts.append(
            f'<rect x="{a:.1f}" y="{b:.1f}" width="{width + 0.3:.1f}" height="{depth + 0.3:.1f}" '
            f'fill="{_VIRIDIS[min(int(8 * share), 7)]}"><title>{escape(text)}</title></rect>'
        )
        if room and text:
            frame.text(a + 0.5 * width, b + 0.5 * depth + 4, text, kind="on-dark" if dark else "on-light")
        if cells.crossed is not None and cells.crossed[i, j]:
            frame.parts.append(f'<path d="M{a + 3:.1f} {b + 3:.1f}l7 7m0 -7l-7 7" stroke="{ink}" fill="none"/>')
        if chart.ring is not None and chart.ring[:2] == (j, i):
            frame.parts.append(
                f'<rect x="{a + 1.5:.1f}" y="{b + 1.5:.1f}" width="{width - 3:.1f}" height="{depth - 3:.1f}" '
                f'fill="none" stroke="{ink}" stroke-width="2.5"/>'
            )
    return frame


def marker(style: Style, x: float, y: float, size: float = 4.0, *, filled: bool = True, tip: str = "") -> str:
    """A point with the marker of a style."""
    s = size
    shapes = {
        "o": f"M{x - s:.1f} {y:.1f}a{s:g} {s:g} 0 1 0 {2 * s:g} 0a{s:g} {s:g} 0 1 0 {-2 * s:g} 0z",
        "s": f"M{x - s:.1f} {y - s:.1f}h{2 * s:g}v{2 * s:g}h{-2 * s:g}z",
        "d": f"M{x:.1f} {y - 1.3 * s:.1f}l{1.2 * s:g} {1.3 * s:g}l{-1.2 * s:g} {1.3 * s:g}l{-1.2 * s:g} {-1.3 * s:g}z",
        "^": f"M{x:.1f} {y - 1.2 * s:.1f}l{1.2 * s:g} {2.1 * s:g}h{-2.4 * s:g}z",
        "v": f"M{x:.1f} {y + 1.2 * s:.1f}l{1.2 * s:g} {-2.1 * s:g}h{-2.4 * s:g}z",
        "x": f"M{x - s:.1f} {y - s:.1f}l{2 * s:g} {2 * s:g}m0 {-2 * s:g}l{-2 * s:g} {2 * s:g}",
        "|": f"M{x:.1f} {y - 1.4 * s:.1f}v{2.8 * s:g}",
    }
    title = f"<title>{escape(printable(tip))}</title>" if tip else ""
    return f'<path class="mark {style.name}{"" if filled else " open"}" d="{shapes[style.marker]}">{title}</path>'


def legend(entries: Sequence[tuple[str, Style]], *, points: bool = False) -> Markup:
    """A legend as a list of the page; only what is drawn should be in it."""
    items = []
    for label, style in entries:
        dash = f' stroke-dasharray="{style.dash}"' if style.dash else ""
        line = "" if points else f'<path class="curve {style.name}" d="M0 7H30"{dash}/>'
        mark = marker(style, 15, 7) if points or style.marker == "|" else ""
        items.append(
            f'<li><svg aria-hidden="true" width="30" height="14" class="key">{line}{mark}</svg>'
            f"{escape(shorten(label, 60))}</li>"
        )
    return Markup(f'<ul class="legend">{"".join(items)}</ul>')
