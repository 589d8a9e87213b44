"""Look of the report's figures: one colour, dash and marker per law, and the settings of matplotlib."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Iterator
from typing import Any

from studies.design import NO_CONTROL

# Okabe and Ito (2008): distinguishable under the common colour vision deficiencies
_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES: tuple[tuple[float, ...], ...] = ((), (6.0, 2.0), (2.0, 1.5), (7.0, 2.0, 1.5, 2.0), (4.0, 1.5, 4.0, 4.0))
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")

PANEL = (4.5, 3.15)
"""Size of one panel [in]: small enough to be read on a phone, set side by side on wider screens."""


@dataclasses.dataclass(frozen=True)
class LineStyle:
    """How one law (or the recorded path) is drawn.

    Attributes
    ----------
    color : str
        ``#rrggbb``.
    dash : tuple of float
        On and off lengths in line widths; empty for a solid line.
    marker : str
        Matplotlib marker.
    """

    color: str
    dash: tuple[float, ...]
    marker: str

    def line(self) -> dict[str, Any]:
        """Keyword arguments of ``Axes.plot``."""
        return {"color": self.color, "linestyle": (0, self.dash) if self.dash else "-"}


RECORDED = LineStyle("#595959", (1.2, 1.4), "|")
"""The departure as it was recorded, without control."""


def law_styles(laws: Iterable[str]) -> dict[str, LineStyle]:
    """One style per law, in the order in which the laws first appear; colours repeat only with another dash."""
    styles: dict[str, LineStyle] = {}
    position = 0
    for law in laws:
        if law in styles:
            continue
        if law == NO_CONTROL:
            styles[law] = RECORDED
            continue
        dash = _DASHES[(position + position // len(_COLORS)) % len(_DASHES)]
        styles[law] = LineStyle(_COLORS[position % len(_COLORS)], dash, _MARKERS[position % len(_MARKERS)])
        position += 1
    return styles


@contextlib.contextmanager
def figure_settings() -> Iterator[None]:
    """Matplotlib's settings for making and saving a figure; the caller's own settings come back afterwards."""
    import matplotlib

    settings = {
        "axes.edgecolor": "#767676",
        "axes.grid": True,
        "axes.labelcolor": "#333333",
        "axes.labelpad": 6,
        "axes.labelsize": 9,
        "axes.linewidth": 0.8,
        "axes.spines.right": False,
        "axes.spines.top": False,
        "axes.titlelocation": "left",
        "axes.titlesize": 9.5,
        "axes.titleweight": "bold",
        "axes.unicode_minus": True,
        "figure.constrained_layout.h_pad": 0.05,
        "figure.constrained_layout.w_pad": 0.05,
        "figure.facecolor": "#ffffff",
        "font.family": "DejaVu Sans",
        "font.size": 9,
        "grid.color": "#e3e3e3",
        "grid.linewidth": 0.7,
        "axes.axisbelow": True,
        "legend.fontsize": 8.5,
        "legend.frameon": False,
        "legend.handlelength": 2.8,
        "lines.linewidth": 1.8,
        "path.simplify": True,
        "svg.fonttype": "none",
        "svg.hashsalt": "ldctoolkit",
        "text.color": "#222222",
        # a user's title may hold a dollar sign
        "text.parse_math": False,
        "xtick.color": "#555555",
        "xtick.labelsize": 8.5,
        "ytick.color": "#555555",
        "ytick.labelsize": 8.5,
    }
    with matplotlib.rc_context(settings):
        yield
