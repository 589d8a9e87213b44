"""Which panels of the gain landscape are drawn: those that say most, and not more than a reader takes in."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.report.figures.landscape import LawDesigns
from studies.report.figures.landscape_figures import Axis, Landscape
from studies.report.figures.sample_figure import MOST_POINTS, Sample

MOST_PANELS: Final = 12
"""Of the whole section."""

PANELS_OF_A_LAW: Final = 3

_MOST_CELLS = 600
_FILLED = 0.3
"""Below this share of cells with a design a map would be mostly holes."""


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """What a law sweeps and no panel shows.

    Attributes
    ----------
    title : str
        The law's name for people.
    names : tuple of str
        Empty where no panel of the law is shown.
    """

    title: str
    names: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Panels:
    """The gain landscape.

    Attributes
    ----------
    shown : tuple of Landscape or Sample
        Law by law, the winner's first.
    left_out : tuple of LeftOut
    """

    shown: tuple[Landscape | Sample, ...]
    left_out: tuple[LeftOut, ...]

    @property
    def samples(self) -> tuple[Sample, ...]:
        """Those with one point a design."""
        return tuple(panel for panel in self.shown if isinstance(panel, Sample))

    @property
    def maps(self) -> tuple[Landscape, ...]:
        """Those with a cell for each combination of two values."""
        return tuple(panel for panel in self.shown if isinstance(panel, Landscape) and panel.y is not None)

    @property
    def thinned(self) -> bool:
        """Whether some panel has more designs than points."""
        return any(panel.S.size > MOST_POINTS for panel in self.samples)


def landscape_panels(
    designs: Sequence[Design],
    S_mean: FloatArray,
    winner: int,
    framed: Collection[int] = (),
    weights: Mapping[str, Mapping[str, float]] | None = None,
) -> Panels:
    """Choose what to draw.

    Parameters
    ----------
    designs : sequence of Design
        d designs.
    S_mean : (d,) [m s]
    winner : int
        Index of the best design.
    framed : collection of int
        Indices of the best designs of the other laws; of a law without one the least `S_mean` is taken.
    weights : mapping of law to mapping of name to float, optional
        How much each quantity matters, where that is known; else it is estimated from the designs.

    Returns
    -------
    Panels
        Of each law the threshold, or without one the most influential gain, against the most influential others. Where
        there are too many, every law gets its first panel before one gets a second.
    """
    best_first = sorted(dict.fromkeys(d.law for d in designs), key=lambda law: _best(designs, S_mean, winner, law))
    chosen: list[tuple[int, int, Landscape | Sample]] = []
    laws: list[tuple[LawDesigns, list[Axis]]] = []
    for law in best_first:
        members = LawDesigns.of(designs, S_mean, winner, law, framed)
        if members.axes:
            laws.append((members, _by_influence(members, (weights or {}).get(law))))
    for turn in range(PANELS_OF_A_LAW):
        for k, (members, axes) in enumerate(laws):
            pair = (axes[0], None) if len(axes) == 1 else (axes[0], axes[turn + 1]) if turn + 1 < len(axes) else None
            if pair is not None and (turn == 0 or pair[1] is not None) and len(chosen) < MOST_PANELS:
                chosen.append((k, turn, _panel(members, *pair)))
    left_out = []
    for k, (members, axes) in enumerate(laws):
        panels = [panel for which, _, panel in chosen if which == k]
        drawn = {axis.name for panel in panels for axis in (panel.x, panel.y) if axis is not None}
        if len(drawn) < len(axes):
            names = tuple(axis.name for axis in axes if axis.name not in drawn) if panels else ()
            left_out.append(LeftOut(members.title, names))
    return Panels(tuple(panel for *_, panel in sorted(chosen, key=lambda one: one[:2])), tuple(left_out))


def _best(designs: Sequence[Design], S_mean: FloatArray, winner: int, law: str) -> tuple[bool, float]:
    least = min(float(S_mean[i]) for i, design in enumerate(designs) if design.law == law)
    return designs[winner].law != law, least


def _by_influence(members: LawDesigns, known: Mapping[str, float] | None) -> list[Axis]:
    """The threshold first, then what matters most."""

    def weight(axis: Axis) -> float:
        if known is not None and axis.name in known:
            return known[axis.name]
        return influence([values[axis.name] for values in members.values], members.S)

    return sorted(members.axes, key=lambda axis: (axis.name != "y_s", -weight(axis)))


def _panel(members: LawDesigns, x: Axis, y: Axis | None) -> Landscape | Sample:
    if y is None or not _is_sparse(members, x, y):
        return members.landscape(x, y)
    at = np.stack([axis.positions([values[axis.name] for values in members.values]) for axis in (x, y)], axis=1)
    return Sample(members.law, members.title, x, y, at, members.S, members.best, members.winner)


def _is_sparse(members: LawDesigns, x: Axis, y: Axis) -> bool:
    cells = len(x.values) * len(y.values)
    filled = len({(values[x.name], values[y.name]) for values in members.values})
    return cells > _MOST_CELLS or (cells > 9 and filled < _FILLED * cells)


_MOST_GROUPS = 8


def influence(values: Sequence[GainValue], S: npt.NDArray[np.float64]) -> float:
    """Part of the variance of S between groups of designs with the same, or nearly the same, value.

    Parameters
    ----------
    values : sequence of m values
        Of one quantity, one a design.
    S : (m,) [m s]

    Returns
    -------
    float
        From 0 to 1: the correlation ratio, with numbers in up to eight groups of about the same size.

    Examples
    --------
    >>> influence([0.1, 0.1, 0.2, 0.2], np.array([1.0, 1.0, 2.0, 2.0]))
    1.0
    """
    found, group = np.unique([str(v) for v in values], return_inverse=True)
    if len(found) > _MOST_GROUPS and not any(isinstance(v, str | bool) for v in values):
        numbers = np.array([float(v) for v in values])
        inner = np.quantile(numbers, np.linspace(0.0, 1.0, _MOST_GROUPS + 1)[1:-1])
        group = np.searchsorted(inner, numbers, side="left")
    size = np.bincount(group)
    mean = np.bincount(group, weights=S)[size > 0] / size[size > 0]
    between = float(np.average((mean - S.mean()) ** 2, weights=size[size > 0]))
    return min(between / float(S.var()), 1.0) if S.var() > 0 else 0.0
