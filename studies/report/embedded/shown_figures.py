"""Figures of merit as people read them: a title, a unit, how many digits, and which figures belong together."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from studies.ranking.figures import FIGURES, Better, figure_values, parse_requirement
from studies.ranking.ranking import Ranking
from studies.report.words.text import compact

GROUPS: Final[Mapping[str, str]] = {
    "score": "Score",
    "lane": "In the lane, all departures",
    "back": "Back to the lane, interventions",
    "comfort": "Comfort, interventions",
    "steering": "Steering, interventions",
    "interventions": "Interventions",
    "failures": "Failures",
}
"""Which figures belong together, in the order to be shown."""

_DEGREES: Final = math.degrees(1.0)

_SHOWN_UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "share": (100.0, "%"),
    "rad": (_DEGREES, "°"),
    "rad/s": (_DEGREES, "°/s"),
    "rad^2 s": (_DEGREES**2, "°²·s"),
    "m s": (1.0, "m·s"),
    "m/s^2": (1.0, "m/s²"),
    "m/s^3": (1.0, "m/s³"),
    "us": (1.0, "µs"),
    "count": (1.0, ""),
    "1": (1.0, ""),
}
"""Unit -> factor and unit on the page; others stand as they are."""

_WORDS: Final[Mapping[str, tuple[str, str, int]]] = {
    "S": ("score", "Mean S", 3),
    "S_left": ("score", "Mean S, left", 3),
    "S_right": ("score", "Mean S, right", 3),
    "S_p95": ("score", "S, 95 % quantile", 3),
    "S_cvar95": ("score", "S, mean of the worst 5 %", 3),
    "reduction": ("score", "Mean S saved against no control", 1),
    "reduction_left": ("score", "Saved, left", 1),
    "reduction_right": ("score", "Saved, right", 1),
    "deeper": ("lane", "Deeper than D_y", 1),
    "deepest_mean": ("lane", "Deepest crossing, mean", 3),
    "deepest_p95": ("lane", "Deepest crossing, 95 % quantile", 3),
    "dtle_mean": ("lane", "DTLE, mean", 3),
    "dtle_p5": ("lane", "DTLE, 5 % quantile", 3),
    "dtle_min": ("lane", "DTLE at its worst", 3),
    "within_dtle": ("lane", "DTLE stays above \u22120.3 m", 1),
    "back_inside": ("back", "Back inside", 1),
    "t_back_median": ("back", "Back inside after, median", 2),
    "overshoot_share": ("back", "Opposite line crossed", 1),
    "overshoot_max": ("back", "Opposite line crossed by at most", 3),
    "a_y_peak_mean": ("comfort", "Peak a_y, mean", 2),
    "a_y_peak_p95": ("comfort", "Peak a_y, 95 % quantile", 2),
    "a_y_peak_max": ("comfort", "Peak a_y, largest", 2),
    "jerk_peak_mean": ("comfort", "Peak lateral jerk, mean", 2),
    "jerk_peak_p95": ("comfort", "Peak lateral jerk, 95 % quantile", 2),
    "jerk_peak_max": ("comfort", "Peak lateral jerk, largest", 2),
    "comfortable": ("comfort", "Both limits of ISO 11270 kept", 1),
    "delta_peak_max": ("steering", "Steering angle, largest", 2),
    "delta_rate_peak_max": ("steering", "Steering rate, largest", 1),
    "effort_mean": ("steering", "Steering effort, mean", 3),
    "travel_mean": ("steering", "Steering travel, mean", 2),
    "triggered": ("interventions", "Taken over", 1),
    "needless": ("interventions", "Needless interventions", 1),
    "law_time": ("interventions", "Time of the law per command", 1),
    "solver_failed": ("failures", "Departures with a failed solve", 0),
    "diverged": ("failures", "Departures that diverged", 0),
    "timed_out": ("failures", "Departures that timed out", 0),
    "crashed": ("failures", "Departures that crashed", 0),
    "failed_solves": ("failures", "Failed solves [commands]", 0),
}
"""Figure -> group, title, digits."""

_OF_A_LAW_THAT_ACTS: Final = frozenset(("triggered", "needless", "law_time"))
"""Figures that no control has none of, whatever is stored."""

_PARTS: Final = frozenset(("reduction", "reduction_left", "reduction_right"))
"""Pure numbers that people read as per cent."""


@dataclasses.dataclass(frozen=True)
class ShownFigure:
    """How the page shows one figure.

    Attributes
    ----------
    name : str
        As in `studies.ranking.figures.FIGURES`.
    title, unit : str
    group : str
        A key of `GROUPS`.
    digits : int
        Decimals of what is shown.
    better : {"less", "more"}
    scale : float
        What is shown is the figure times this.
    """

    name: str
    title: str
    unit: str
    group: str
    digits: int
    better: Better
    scale: float

    @property
    def label(self) -> str:
        """Title and unit, for an axis."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


def shown_figure(name: str) -> ShownFigure:
    """How the page shows a figure of `studies.ranking.figures.FIGURES`.

    Examples
    --------
    >>> shown_figure("delta_peak_max").label
    'Steering angle, largest [°]'
    """
    figure = FIGURES[name]
    group, title, digits = _WORDS.get(name, ("score", name, 3))
    scale, unit = (100.0, "%") if name in _PARTS else _SHOWN_UNITS.get(figure.unit, (1.0, figure.unit))
    return ShownFigure(name, title, unit, group, digits, figure.better, scale)


def shown_values(name: str, ranking: Ranking) -> npt.NDArray[np.float64]:
    """Values of a figure as they stand, NaN where the page has none to show.

    A linear law has no time of its own: 0 is stored.

    Parameters
    ----------
    name : str
        As `shown_figure` takes it.
    ranking : Ranking
        Of d designs.

    Returns
    -------
    (d,)
        In the figure's unit.
    """
    values = figure_values(name, ranking)
    if name in _OF_A_LAW_THAT_ACTS:
        values = np.where([design.is_baseline for design in ranking.designs], np.nan, values)
    return np.where(values == 0.0, np.nan, values) if name == "law_time" else values


def shown_limits(require: Sequence[str]) -> dict[str, tuple[str, ...]]:
    r"""Limits of requirements by figure, in the units that are shown.

    Examples
    --------
    >>> shown_limits(["a_y_peak_p95 <= 3", "deeper < 0.1", "a_y_peak_p95 > 1"])
    {'a_y_peak_p95': ('≤ 3', '> 1'), 'deeper': ('< 10\xa0%',)}
    """
    limits: dict[str, tuple[str, ...]] = {}
    for text in require:
        one = parse_requirement(text)
        shown = shown_figure(one.figure.name)
        sign = one.operator.replace("<=", "\u2264").replace(">=", "\u2265")
        limit = f"{sign} {compact(one.limit * shown.scale)}" + ("\u00a0%" if shown.unit == "%" else "")
        limits[shown.name] = (*limits.get(shown.name, ()), limit)
    return limits


SHOWN: Final = tuple(sorted((shown_figure(name) for name in FIGURES), key=lambda one: tuple(GROUPS).index(one.group)))
"""All figures, group by group."""
