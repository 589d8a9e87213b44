"""Small plots as inline SVG whose colours are the page's own, light and dark; a few hundred bytes a curve."""

from __future__ import annotations

import dataclasses

import numpy as np
from markupsafe import Markup, escape

from ldctoolkit.arrays import FloatArray
from studies.extraction_page.axis_ticks import Axis
from studies.report.words.text import SYMBOL, printable, symbol_parts


def picture(width: float, height: float, alt: str, *parts: str, kind: str = "plot") -> Markup:
    """An ``svg`` element that a screen reader takes for one image.

    Parameters
    ----------
    width, height : float
        Of its coordinates; on the page it is as wide as there is room for.
    alt : str
        What a screen reader says.
    *parts : str
        What `Frame` draws.
    kind : str
        Class of the element.
    """
    head = Markup('<svg class="{}" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}">')
    return head.format(kind, width, height, printable(alt)) + Markup("".join(parts)) + Markup("</svg>")


def svg_text(words: str) -> Markup:
    """Words of a drawing; symbols as a letter with an index.

    Examples
    --------
    >>> print(svg_text("d_y [m]"))
    d<tspan dy=".22em" class="sub">y</tspan><tspan dy="-.17em"> [m]</tspan>
    """
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
    """A rectangle of a drawing with its two axes.

    Attributes
    ----------
    left, top, width, height : float
        In the drawing's coordinates.
    x, y : Axis
        Ranges of what is drawn in it; values beyond are drawn on its edge.
    """

    left: float
    top: float
    width: float
    height: float
    x: Axis
    y: Axis

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
        """A histogram's outline, closed along the zero line.

        Parameters
        ----------
        edges : (n + 1,)
        heights : (n,)
        kind : str
            Class of the path.
        """
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
