"""Small plots as inline SVG whose colours are the page's own, light and dark; a few hundred bytes a curve."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
from markupsafe import Markup, escape

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES
from studies.fit_page.style import MEANINGS, UNITS
from studies.report.words.text import SYMBOL, figure, number, printable, symbol_parts


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One kind of numbers."""

    name: str  # ``"d_y"``
    meaning: str  # a few words
    unit: str  # as shown
    scale: float = 1.0  # shown values are this many times those in SI units
    least: float = 0.1  # smallest range of an axis, in the unit shown, so that noise does not fill it
    digits: int = 2  # decimals of a median, in the unit shown

    @property
    def label(self) -> str:
        """Name and unit: ``d_y [m]``."""
        return f"{self.name} [{self.unit}]"

    def shown(self, values: FloatArray) -> FloatArray:
        """Values in SI units, in the unit shown."""
        return self.scale * values


# curvature in 1/m would need a power of ten at every number
CURVATURE_UNIT: Final = "1/km"
CURVATURE_SCALE: Final = 1000.0

_DIGITS: Final = {"sigma_y": 3, "v_mean": 1}


def _parameter(name: str) -> Quantity:
    if UNITS[name] == "1/m":
        return Quantity(name, MEANINGS[name], CURVATURE_UNIT, CURVATURE_SCALE)
    least = 0.01 if name == "sigma_y" else 0.1
    return Quantity(name, MEANINGS[name], UNITS[name], least=least, digits=_DIGITS.get(name, 2))


PARAMETERS: Final = tuple(map(_parameter, PARAMETER_NAMES))
"""The eight parameters in the paper's order."""

# counted in bins of 0.1 m: a median has no more digits
LANE_WIDTH: Final = Quantity("lane width", "width of the lane, valid samples", "m", digits=1)


_LARGEST_PLAIN = 1e5


@dataclasses.dataclass(frozen=True)
class Axis:
    """Range of an axis."""

    low: float  # finite, low < high
    high: float

    @classmethod
    def around(cls, values: FloatArray, *, least: float, margin: float = 0.05) -> Axis:
        """All finite values with a margin; at least `least` wide, also for none."""
        known = values[np.isfinite(values)]
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
        width = max(high - low, least, 1e-9 * max(abs(low), abs(high)))
        middle, half = 0.5 * (low + high), (0.5 + margin) * width
        return cls(middle - half, middle + half)

    def ticks(self, most: int) -> tuple[float, ...]:
        """At most `most` + 1 round numbers inside, evenly spaced."""
        step = self.step(most)
        first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
        return tuple(k * step for k in range(first, min(last, first + most) + 1))

    def label(self, tick: float, most: int) -> str:
        """A tick as text, with the decimals that its step needs."""
        if max(abs(self.low), abs(self.high)) >= _LARGEST_PLAIN:
            return figure(tick)
        return number(tick, max(0, -math.floor(math.log10(self.step(most)) + 1e-9)))

    def step(self, most: int) -> float:
        """The round number 1, 2 or 5 times a power of ten that is passed at most `most` times."""
        least = (self.high - self.low) / most
        base = 10.0 ** math.floor(math.log10(least))
        return next(k * base for k in (1, 2, 5, 10, 20) if k * base >= least * (1.0 - 1e-9))


def picture(width: float, height: float, alt: str, *parts: str, kind: str = "plot") -> Markup:
    """An ``svg`` element that a screen reader takes for one image."""
    head = Markup('<svg class="{}" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">')
    return head.format(kind, width, height, printable(alt)) + Markup("".join(parts)) + Markup("</svg>")


def svg_text(words: str) -> Markup:
    """Words of a drawing; symbols as a letter with an index."""
    out, end, low = Markup(), 0, False
    for match in SYMBOL.finditer(words):
        base, index = symbol_parts(match)
        out += _level(words[end : match.start()] + base, low)
        out += Markup('<tspan dy=".22em" class="sub">{}</tspan>').format(index)
        end, low = match.end(), True
    # the text after an index goes back up; an empty shift would be lost
    return out + (_level(words[end:], low) if end < len(words) else Markup())


def _level(words: str, raised: bool) -> Markup:
    return Markup('<tspan dy="-.17em">{}</tspan>').format(words) if raised else escape(words)


@dataclasses.dataclass(frozen=True)
class Frame:
    """A rectangle of a drawing with its two axes."""

    left: float  # in the drawing's coordinates
    top: float  # in the drawing's coordinates
    width: float  # in the drawing's coordinates
    height: float  # in the drawing's coordinates
    x: Axis  # ranges of what is drawn in it; values beyond are drawn on its edge
    y: Axis  # ranges of what is drawn in it; values beyond are drawn on its edge

    def _across(self, x: FloatArray) -> FloatArray:
        share = (np.clip(x, self.x.low, self.x.high) - self.x.low) / (self.x.high - self.x.low)
        return np.round(self.left + share * self.width, 1)

    def _down(self, y: FloatArray) -> FloatArray:
        share = (np.clip(y, self.y.low, self.y.high) - self.y.low) / (self.y.high - self.y.low)
        return np.round(self.top + (1.0 - share) * self.height, 1)

    def grid(self, *, x_ticks: int, y_ticks: int, x_label: str = "", y_label: str = "") -> Markup:
        """Grid lines, numbers and names of the axes; without a name of x its numbers are left out too."""
        bottom, right = self.top + self.height, self.left + self.width
        lines, words = [], []
        ticks = self.x.ticks(x_ticks)
        for tick, at in zip(ticks, self._across(np.array(ticks)), strict=True):
            lines.append(f"M{at:g} {self.top:g}V{bottom:g}")
            if x_label:
                words.append(_words(at, bottom + 15, self.x.label(tick, x_ticks), "middle"))
        ticks = self.y.ticks(y_ticks)
        for tick, at in zip(ticks, self._down(np.array(ticks)), strict=True):
            lines.append(f"M{self.left:g} {at:g}H{right:g}")
            words.append(_words(self.left - 6, at + 4, self.y.label(tick, y_ticks), "end"))
        if x_label:
            words.append(_words(self.left + self.width / 2, bottom + 32, x_label, "middle", "name"))
        if y_label:
            words.append(_words(self.left, self.top - 8, y_label, "start", "name"))
        grid = Markup('<path class="grid" d="{}"/>').format("".join(lines))
        frame = Markup('<path class="edge" d="M{:g} {:g}V{:g}H{:g}"/>').format(self.left, self.top, bottom, right)
        return grid + frame + Markup("").join(words)

    def steps(self, edges: FloatArray, heights: FloatArray, kind: str) -> Markup:
        """A histogram's outline, closed along the zero line."""
        across, down = self._across(edges), self._down(heights)
        ground = float(self._down(np.zeros(1))[0])
        corners = "".join(f"V{y:g}H{x:g}" for x, y in zip(across[1:], down, strict=True))
        return _path(f"M{across[0]:g} {ground:g}{corners}V{ground:g}", kind)

    def line(self, x: FloatArray, y: FloatArray, kind: str) -> Markup:
        """Points joined by straight lines."""
        points = "L".join(f"{a:g} {b:g}" for a, b in zip(self._across(x), self._down(y), strict=True))
        return _path(f"M{points}", kind) if points else Markup()

    def dots(self, x: FloatArray, y: FloatArray, kind: str) -> Markup:
        """Points, not joined."""
        points = "".join(f"M{a:g} {b:g}h0" for a, b in zip(self._across(x), self._down(y), strict=True))
        return _path(points, kind) if points else Markup()


def _path(d: str, kind: str) -> Markup:
    return Markup('<path class="{}" d="{}"/>').format(kind, d)


def _words(x: float, y: float, words: str, anchor: str, kind: str = "") -> Markup:
    shown = Markup(' class="{}"').format(kind) if kind else Markup()
    return Markup('<text x="{:g}" y="{:g}" text-anchor="{}"{}>{}</text>').format(x, y, anchor, shown, svg_text(words))
