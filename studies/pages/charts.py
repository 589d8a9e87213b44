"""Charts of the pages as SVG: lines, dots with interval, bars, heat map, empirical distribution, scatter.

A chart is text that is made once: it stands in the page as it is, and with `Chart.document` as a file. Colours are
classes, so that the page's style sheet sets them for light, dark and print.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape

from ldctoolkit.arrays import BoolArray, FloatArray

from ..design import NO_CONTROL
from .text import compact, printable, shorten, symbols_svg

WIDTH: Final = 420.0  # units of a chart's width: text of 12 units is 10 px high on the narrowest phone

COLORS: Final = ("#0072b2", "#d55e00", "#009e73", "#b5548f", "#b07900", "#3b8fc2")
"""Okabe and Ito's colours, the light ones darkened until they stand out from white."""

_DASHES: Final = ("", "7 3", "2 2.5", "9 3 2 3", "5 2 5 6")
_MARKERS: Final = "osdvx^"
_LEFT, _RIGHT, _TOP, _BOTTOM = 58.0, 10.0, 10.0, 44.0
_CHARACTER: Final = 6.4  # width of a character of the labels [units]


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


RECORDED: Final = Style(-1, "2 2.5", "|")  # the departure as it was recorded, without control


def law_styles(laws: Iterable[str]) -> dict[str, Style]:
    """One style a law, in the order in which the laws first appear; a colour repeats only with another dash."""
    styles: dict[str, Style] = {}
    for law in laws:
        if law not in styles:
            k = len(styles) - (NO_CONTROL in styles)
            dash = _DASHES[(k + k // len(COLORS)) % len(_DASHES)]
            own = Style(k % len(COLORS), dash, _MARKERS[k % len(_MARKERS)])
            styles[law] = RECORDED if law == NO_CONTROL else own
    return styles


@dataclasses.dataclass(frozen=True)
class Chart:
    """A chart."""

    name: str  # Letters, digits and dashes; the file's name
    title: str  # For a screen reader
    height: float
    body: str  # SVG elements
    width: float = WIDTH

    @property
    def svg(self) -> Markup:
        """The chart as an element of a page."""
        return Markup(
            f'<svg class="chart" role="img" viewBox="0 0 {self.width:g} {self.height:g}" '
            f'aria-label="{escape(printable(self.title))}">{self.body}</svg>'
        )

    @property
    def document(self) -> str:
        """The chart as a file of its own."""
        style = "".join(f".c{i}{{--c:{color}}}" for i, color in enumerate(COLORS))
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" class="chart" width="{1.6 * self.width:g}" '
            f'height="{1.6 * self.height:g}" viewBox="0 0 {self.width:g} {self.height:g}">'
            f"<title>{escape(printable(self.title))}</title><style>{style}{FILE_STYLE}</style>"
            f'<rect width="100%" height="100%" fill="#fff"/>{self.body}</svg>\n'
        )


FILE_STYLE: Final = (
    ".chart{font:12px sans-serif;--ink:#222;--soft:#666;--grid:#ddd;--paper:#fff;--bad:#b3261e;--shade:#f3d9d6}"
    ".recorded{--c:#595959}text{fill:var(--ink)}.soft{fill:var(--soft)}.grid{stroke:var(--grid);fill:none}"
    ".axis{stroke:var(--soft);fill:none}.curve{stroke:var(--c);fill:none;stroke-width:1.8}"
    ".band{fill:var(--c);opacity:.16}.mark{stroke:var(--c);fill:var(--c)}.open{fill:var(--paper)}"
    ".bar{fill:var(--c);opacity:.45}.limit{stroke:var(--bad);fill:none;stroke-dasharray:8 3 2 3}"
    ".on-dark{fill:#fff}.on-light{fill:#000}.shade{fill:var(--shade);opacity:.6}.front{stroke:var(--soft);fill:none}.ring{stroke:var(--ink);fill:none}"
)
"""Rules for the elements of charts; the page's style sheet has the same with other colours in the dark."""


# ------------------------------------------------------------------------------------------------ axes


@dataclasses.dataclass(frozen=True)
class Axis:
    """One axis."""

    label: str  # Quantity and unit
    # Its ends
    low: float
    high: float
    log: bool = False
    categories: tuple[str, ...] = ()  # Names at 0, 1, ... instead of numbers

    @classmethod
    def around(cls, label: str, *values: npt.ArrayLike, zero: bool = False, log: bool = False) -> Axis:
        """An axis that holds all finite values with some room; `zero` begins it at 0."""
        known = np.concatenate([np.ravel(np.asarray(one, dtype=np.float64)) for one in values] or [np.empty(0)])
        known = known[np.isfinite(known) & (known > 0 if log else True)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        if log:
            return cls(label, low / 1.15, high * 1.15, log=True)
        low = min(low, 0.0) if zero else low
        room = 0.05 * (high - low) or 0.5 * abs(high) or 0.5
        return cls(label, low if zero and low == 0.0 else low - room, high + room)

    def at(self, values: npt.ArrayLike) -> FloatArray:
        """Place between 0 and 1 along the axis; what lies outside is put at its end."""
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
            return [(float(i), name) for i, name in enumerate(self.categories) if i % every == 0]
        if self.log:
            tens = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            near = [m * 10.0**k for k in tens for m in ((1, 2, 5) if len(tens) < 4 else (1,))]
            return [(one, compact(one)) for one in near if self.low <= one <= self.high]
        step = nice_step(self.high - self.low, max(2, int(room / 55)))
        first = math.ceil(self.low / step - 1e-9)
        digits = max(0, -math.floor(math.log10(step) + 1e-9))
        values = [k * step for k in range(first, math.floor(self.high / step + 1e-9) + 1)]
        return [(one, f"{one:.{digits}f}".replace("-", "\u2212") if abs(one) > 1e-12 else "0") for one in values]


def nice_step(span: float, most: int) -> float:
    """1, 2 or 5 times a power of ten that divides a span into at most so many steps."""
    rough = max(span, 1e-300) / most
    ten = 10.0 ** math.floor(math.log10(rough))
    return next(m * ten for m in (1.0, 2.0, 5.0, 10.0) if m * ten >= rough * (1 - 1e-9))


class _Frame:
    """The area of a chart that the axes span, and the elements drawn into it."""

    def __init__(self, x: Axis, y: Axis, height: float, *, left: float | None = None, top: float = _TOP) -> None:
        self.depth = height - top - _BOTTOM
        if left is None:
            longest = max((len(text) for _, text in y.ticks(1.4 * self.depth)), default=0)
            left = max(_LEFT, 28.0 + _CHARACTER * longest)
        self.x, self.y, self.left, self.top = x, y, left, top
        self.width, self.height = WIDTH - left - _RIGHT, height
        self.parts: list[str] = []

    def px(self, values: npt.ArrayLike) -> FloatArray:
        return self.left + self.width * self.x.at(values)

    def py(self, values: npt.ArrayLike) -> FloatArray:
        return self.top + self.depth * (1.0 - self.y.at(values))

    def axes(self, *, grid_y: bool = True) -> None:
        bottom, right = self.top + self.depth, self.left + self.width
        lines, end = "", -math.inf
        for value, text in self.x.ticks(self.width):
            at, half = float(self.px(value)), 0.5 * _CHARACTER * len(text) + 3
            shown = min(at, WIDTH - half)
            lines += f"M{at:.1f} {self.top:g}V{bottom:g}"
            if shown - half > end:
                self.parts.append(
                    f'<text x="{shown:.1f}" y="{bottom + 15:g}" text-anchor="middle">{escape(text)}</text>'
                )
                end = shown + half
        for value, text in self.y.ticks(1.4 * self.depth):
            at = float(self.py(value))
            if grid_y:
                lines += f"M{self.left:g} {at:.1f}H{right:g}"
            self.parts.append(
                f'<text x="{self.left - 6:g}" y="{at + 4:.1f}" text-anchor="end">{symbols_svg(text)}</text>'
            )
        self.parts.insert(0, f'<path class="grid" d="{lines}"/>')
        self.parts.append(f'<path class="axis" d="M{self.left:g} {self.top:g}V{bottom:g}H{right:g}"/>')
        middle = self.left + 0.5 * self.width
        if self.x.label:
            self.parts.append(
                f'<text class="soft" x="{middle:g}" y="{bottom + 34:g}" text-anchor="middle">'
                f"{symbols_svg(self.x.label)}</text>"
            )
        if self.y.label:
            y = self.top + 0.5 * self.depth
            self.parts.append(
                f'<text class="soft" transform="translate(13 {y:g}) rotate(-90)" text-anchor="middle">'
                f"{symbols_svg(self.y.label)}</text>"
            )

    def path(self, x: npt.ArrayLike, y: npt.ArrayLike, *, steps: bool = False) -> str:
        """A line through the finite points."""
        px, py = self.px(x), self.py(y)
        known = np.isfinite(px) & np.isfinite(py)
        px, py = px[known], py[known]
        if not px.size:
            return ""
        if steps:
            rest = "".join(f"H{a:.1f}V{b:.1f}" for a, b in zip(px[1:].tolist(), py[1:].tolist(), strict=True))
            return f"M{px[0]:.1f} {py[0]:.1f}{rest}"
        return "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(px.tolist(), py.tolist(), strict=True))

    def limit_x(self, value: float, text: str, *, beyond: bool = True) -> None:
        """A limit on the horizontal axis; what lies beyond is shaded."""
        at, right = float(self.px(value)), self.left + self.width
        if beyond and at < right:
            self.parts.append(
                f'<rect class="shade" x="{at:.1f}" y="{self.top:g}" width="{right - at:.1f}" height="{self.depth:g}"/>'
            )
        self.parts.append(f'<path class="limit" d="M{at:.1f} {self.top:g}V{self.top + self.depth:g}"/>')
        end = "end" if at + _CHARACTER * len(text) > right else "start"
        shift = -4 if end == "end" else 4
        self.parts.append(
            f'<text class="soft" x="{at + shift:.1f}" y="{self.top + 12:g}" text-anchor="{end}">{escape(text)}</text>'
        )

    def chart(self, name: str, title: str) -> Chart:
        return Chart(name, title, self.height, "".join(self.parts))


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


# ------------------------------------------------------------------------------------------------ the six charts


@dataclasses.dataclass(frozen=True)
class Series:
    """One curve, with a band where `low` and `high` are given."""

    label: str
    x: FloatArray
    y: FloatArray
    style: Style
    low: FloatArray | None = None
    high: FloatArray | None = None
    points: bool = False
    steps: bool = False


def lines(
    name: str,
    title: str,
    series: Sequence[Series],
    x: Axis,
    y: Axis,
    *,
    limit: tuple[float, str] | None = None,
    level: float | None = None,
    ring: tuple[float, float] | None = None,
    height: float = 270.0,
) -> Chart:
    """Curves; `limit` is upright with its text, `level` a horizontal dashed line, `ring` marks a point."""
    frame = _Frame(x, y, height)
    frame.axes()
    if limit is not None:
        frame.limit_x(*limit)
    if level is not None:
        at, right = float(frame.py(level)), frame.left + frame.width
        frame.parts.append(
            f'<path class="curve recorded" stroke-dasharray="2 2.5" d="M{frame.left:g} {at:.1f}H{right:g}"/>'
        )
    for one in series:
        if one.low is not None and one.high is not None:
            there = np.isfinite(one.low) & np.isfinite(one.high)
            across = np.concatenate([one.x[there], one.x[there][::-1]])
            around = frame.path(across, np.concatenate([one.high[there], one.low[there][::-1]]))
            if around:
                frame.parts.append(f'<path class="band {one.style.name}" d="{around}Z"/>')
        dash = f' stroke-dasharray="{one.style.dash}"' if one.style.dash else ""
        frame.parts.append(
            f'<path class="curve {one.style.name}"{dash} d="{frame.path(one.x, one.y, steps=one.steps)}">'
            f"<title>{escape(printable(one.label))}</title></path>"
        )
        if one.points:
            places = zip(frame.px(one.x).tolist(), frame.py(one.y).tolist(), strict=True)
            frame.parts += [marker(one.style, a, b, 3.0) for a, b in places if math.isfinite(a + b)]
    if ring is not None:
        frame.parts.append(f'<circle class="ring" cx="{frame.px(ring[0]):.1f}" cy="{frame.py(ring[1]):.1f}" r="7"/>')
    return frame.chart(name, title)


def ecdf(
    name: str,
    title: str,
    samples: Sequence[tuple[str, FloatArray, Style]],
    x: Axis,
    y_label: str,
    *,
    limit: tuple[float, str] | None = None,
) -> Chart:
    """Empirical distribution functions, at 200 quantiles where there are more values."""
    series = []
    for label, values, style in samples:
        known = np.sort(values[~np.isnan(values)])
        if known.size:
            share = np.arange(1, known.size + 1) / known.size
            some = np.unique(np.linspace(0, known.size - 1, min(known.size, 200)).astype(int))
            series.append(Series(label, np.append(x.low, known[some]), np.append(0.0, share[some]), style, steps=True))
    return lines(name, title, series, x, Axis(y_label, 0.0, 1.0), limit=limit)


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


def dots(
    name: str, title: str, rows: Sequence[Sequence[Dot]], x: Axis, *, at: float | None = None, at_text: str = ""
) -> Chart:
    """Values with intervals, a row each, several in one row below each other; `at` is an upright dashed line."""
    step = 14.0
    depth = max(sum(step * len(row) + 8.0 for row in rows), 60.0)
    labels = [shorten(row[0].label, 34) for row in rows]
    left = min(30.0 + _CHARACTER * max(map(len, labels), default=0), 0.55 * WIDTH)
    frame = _Frame(x, Axis("", 0.0, 1.0, categories=("",)), depth + _BOTTOM + 22.0, left=left, top=22.0)
    frame.axes(grid_y=False)
    if at is not None:
        place = float(frame.px(at))
        frame.parts.append(
            f'<path class="curve recorded" stroke-dasharray="2 2.5" d="M{place:.1f} 22V{22 + depth:g}"/>'
        )
        anchor = "end" if place > 0.75 * WIDTH else "middle"
        frame.parts.append(f'<text class="soft" x="{place:.1f}" y="14" text-anchor="{anchor}">{escape(at_text)}</text>')
    y = 22.0 + 4.0
    for row, label in zip(rows, labels, strict=True):
        frame.parts.append(
            f'<text x="{left - 8:g}" y="{y + 0.5 * step * len(row) + 4:.1f}" '
            f'text-anchor="end">{symbols_svg(label)}</text>'
        )
        for one in row:
            middle = y + 0.5 * step
            if math.isfinite(one.low + one.high):
                a, b = float(frame.px(one.low)), float(frame.px(one.high))
                frame.parts.append(f'<path class="curve {one.style.name}" d="M{a:.1f} {middle:.1f}H{b:.1f}"/>')
            if math.isfinite(one.value):
                place = float(frame.px(one.value))
                frame.parts.append(marker(one.style, place, middle, filled=not one.open, tip=one.tip or one.label))
            y += step
        y += 8.0
    return frame.chart(name, title)


def bars(
    name: str,
    title: str,
    edges: FloatArray,
    shares: Sequence[tuple[str, FloatArray, Style]],
    x_label: str,
    y_label: str,
    *,
    outlines: Sequence[tuple[str, FloatArray, Style]] = (),
    height: float = 200.0,
) -> Chart:
    """Histograms as bars, and others over the same bins as outlines."""
    highest = max((float(np.max(one, initial=0.0)) for _, one, _ in (*shares, *outlines)), default=0.0)
    axis = Axis(x_label, float(edges[0]), float(edges[-1]))
    frame = _Frame(axis, Axis(y_label, 0.0, 1.06 * highest or 1.0), height)
    frame.axes()
    for outlined, some in ((False, shares), (True, outlines)):
        for _, values, style in some:
            around = frame.path(np.repeat(edges, 2), np.concatenate([[0.0], np.repeat(values, 2), [0.0]]))
            dash = f' stroke-dasharray="{style.dash}"' if outlined and style.dash else ""
            kind = "curve" if outlined else "bar"
            frame.parts.append(f'<path class="{kind} {style.name}"{dash} d="{around}"/>')
    return frame.chart(name, title)


_VIRIDIS: Final = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725")


def heat_map(
    name: str,
    title: str,
    values: FloatArray,
    texts: Sequence[Sequence[str]],
    x: tuple[str, Sequence[str]],
    y: tuple[str, Sequence[str]],
    *,
    ring: tuple[int, int] | None = None,
    open_cells: BoolArray | None = None,
) -> Chart:
    """Cells with their numbers: dark is small; a ring marks one, a cross those of `open_cells`; NaN stays empty."""
    rows, columns = values.shape
    left = min(30.0 + _CHARACTER * max(len(one) for one in y[1]), 150.0)
    height = _TOP + _BOTTOM + max(26.0 * rows, 60.0)
    frame = _Frame(Axis(x[0], 0.0, 1.0), Axis(y[0], 0.0, 1.0), height, left=max(left, _LEFT))
    width, depth = frame.width / columns, frame.depth / rows
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    room = max(len(text) for line in texts for text in line) * _CHARACTER < width - 2
    for i in range(rows):
        for j in range(columns):
            if not math.isfinite(values[i, j]):
                continue
            share = (values[i, j] - low) / ((high - low) or 1.0)
            a, b = frame.left + j * width, frame.top + (rows - 1 - i) * depth
            frame.parts.append(
                f'<rect x="{a:.1f}" y="{b:.1f}" width="{width + 0.3:.1f}" height="{depth + 0.3:.1f}" '
                f'fill="{_VIRIDIS[min(int(8 * share), 7)]}"><title>{escape(texts[i][j])}</title></rect>'
            )
            ink = "#fff" if share < 0.62 else "#000"
            if room:
                frame.parts.append(
                    f'<text x="{a + 0.5 * width:.1f}" y="{b + 0.5 * depth + 4:.1f}" text-anchor="middle" '
                    f'class="{"on-dark" if share < 0.62 else "on-light"}">{escape(texts[i][j])}</text>'
                )
            if open_cells is not None and open_cells[i, j]:
                frame.parts.append(f'<path d="M{a + 3:.1f} {b + 3:.1f}l7 7m0 -7l-7 7" stroke="{ink}" fill="none"/>')
            if ring == (i, j):
                frame.parts.append(
                    f'<rect x="{a + 1.5:.1f}" y="{b + 1.5:.1f}" width="{width - 3:.1f}" height="{depth - 3:.1f}" '
                    f'fill="none" stroke="{ink}" stroke-width="2.5"/>'
                )
    end = -math.inf
    for j, text in enumerate(x[1]):
        at = frame.left + (j + 0.5) * width
        if at - 0.5 * _CHARACTER * len(text) > end:
            frame.parts.append(
                f'<text x="{at:.1f}" y="{frame.top + frame.depth + 15:.1f}" text-anchor="middle">{escape(text)}</text>'
            )
            end = at + 0.5 * _CHARACTER * len(text) + 3
    for i, text in enumerate(y[1]):
        at = frame.top + (rows - 0.5 - i) * depth
        frame.parts.append(
            f'<text x="{frame.left - 6:g}" y="{at + 4:.1f}" text-anchor="end">{escape(shorten(text, 18))}</text>'
        )
    middle, bottom = frame.left + 0.5 * frame.width, frame.top + frame.depth
    frame.parts.append(
        f'<text class="soft" x="{middle:g}" y="{bottom + 34:g}" text-anchor="middle">{symbols_svg(x[0])}</text>'
    )
    if y[0]:
        frame.parts.append(
            f'<text class="soft" transform="translate(13 {frame.top + 0.5 * frame.depth:g}) rotate(-90)" '
            f'text-anchor="middle">{symbols_svg(y[0])}</text>'
        )
    return frame.chart(name, title)


@dataclasses.dataclass(frozen=True)
class Cloud:
    """Points of one law; those that meet the limits are filled."""

    x: FloatArray
    y: FloatArray
    style: Style
    filled: BoolArray
    tips: tuple[str, ...]


def scatter(
    name: str,
    title: str,
    clouds: Sequence[Cloud],
    x: Axis,
    y: Axis,
    *,
    limit: tuple[float, str] | None = None,
    front: tuple[FloatArray, FloatArray] | None = None,
    ring: tuple[float, float] | None = None,
    diagonal: FloatArray | None = None,
    height: float = 290.0,
) -> Chart:
    """Points of designs, a limit with what lies beyond it shaded, the front of the two, a ring around one point."""
    frame = _Frame(x, y, height)
    frame.axes()
    if diagonal is not None:
        frame.parts.append(f'<path class="front" d="{frame.path(diagonal, diagonal)}"/>')
    if limit is not None:
        frame.limit_x(*limit)
    if front is not None and front[0].size > 1:
        frame.parts.append(f'<path class="front" d="{frame.path(*front, steps=True)}"/>')
    for above in (False, True):  # filled points lie above hollow ones
        for cloud in clouds:
            places = zip(
                frame.px(cloud.x).tolist(), frame.py(cloud.y).tolist(), cloud.filled.tolist(), cloud.tips, strict=True
            )
            frame.parts += [
                marker(cloud.style, a, b, 3.6, filled=filled, tip=tip)
                for a, b, filled, tip in places
                if math.isfinite(a + b) and bool(filled) == above
            ]
    if ring is not None and math.isfinite(ring[0] + ring[1]):
        frame.parts.append(f'<circle class="ring" cx="{frame.px(ring[0]):.1f}" cy="{frame.py(ring[1]):.1f}" r="8"/>')
    return frame.chart(name, title)
