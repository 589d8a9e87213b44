"""Colours and words of the fit page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ldctoolkit.departures import PARAMETER_NAMES, PARAMETER_UNITS
from studies.report.words.text import unit_text

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

# the first two colours of the report (Okabe and Ito 2008)
COLORS: Final = {"left": "#0072B2", "right": "#D55E00"}
"""Events of a side; the model is always `MODEL`."""

DASHES: Final[dict[str, tuple[float, ...]]] = {"left": (), "right": (5.0, 1.6)}
"""Where both sides are drawn as lines."""

MODEL: Final = "#222222"

TITLES: Final = {"left": "Left", "right": "Right"}

UNITS: Final = dict(zip(PARAMETER_NAMES, map(unit_text, PARAMETER_UNITS), strict=True))

MEANINGS: Final = {
    "T": "duration",
    "d_y": "peak lateral departure",
    "sigma_y": "lateral residual",
    "v_mean": "mean speed",
    "a_mean": "mean acceleration",
    "sigma_v": "speed residual",
    "c_0": "initial curvature, outward",
    "dc": "change of curvature, outward",
}


def axis_label(name: str) -> str:
    """Name and unit of a parameter: ``d_y [m]``."""
    return f"{name} [{UNITS[name]}]" if name in UNITS else name


def color_map(side: str) -> Colormap:
    """From white to a side's colour and on to near black: light where events are rare."""
    from matplotlib.colors import LinearSegmentedColormap

    dark = {"left": "#00253b", "right": "#4a1f00"}[side]
    return LinearSegmentedColormap.from_list(side, ["#f4f6f8", COLORS[side], dark])
