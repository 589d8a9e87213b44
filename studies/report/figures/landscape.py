"""Mean S over (y_s, gains), arranged for the figures."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Iterable, Sequence
from typing import Self

import numpy as np
import numpy.typing as npt

from ldctoolkit import controller_class
from ldctoolkit.arrays import FloatArray
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.report.figures.landscape_figures import Axis, Landscape
from studies.report.figures.sample_figure import Sample


def values_of(design: Design) -> dict[str, GainValue]:
    """The threshold and the gains of a design by name."""
    return {"y_s": design.y_s, **dict(design.gains)}


def swept_axes(designs: Sequence[Design]) -> tuple[Axis, ...]:
    """What the designs of one law differ in: y_s first, then gains in the law's own order.

    Parameters
    ----------
    designs : sequence of Design
        Of one law.

    Returns
    -------
    tuple of Axis
    """
    declared = {g.name: (g.unit, g.scale) for g in controller_class(designs[0].law).gains()}
    every = [values_of(design) for design in designs]
    axes = []
    for name, (unit, scale) in {"y_s": ("m", "linear"), **declared}.items():
        seen: list[GainValue] = list(dict.fromkeys(values[name] for values in every))
        if len(seen) > 1:
            numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in seen)
            axes.append(Axis(name, unit, tuple(sorted(seen, key=float) if numeric else seen), scale == "log"))
    return tuple(axes)


@dataclasses.dataclass(frozen=True)
class LawDesigns:
    """The m designs of one law, with their scores.

    Attributes
    ----------
    law, title : str
        Registry name and name for people.
    axes : tuple of Axis
        What they differ in.
    values : tuple of mappings
        Threshold and gains of each.
    S : (m,) [m s]
        Mean S.
    best : int
        Position of the law's best design.
    winner : bool
        Whether that is the best of the whole study.
    """

    law: str
    title: str
    axes: tuple[Axis, ...]
    values: tuple[dict[str, GainValue], ...]
    S: FloatArray
    best: int
    winner: bool

    @classmethod
    def of(
        cls, designs: Sequence[Design], S_mean: FloatArray, winner: int, law: str, framed: Collection[int] = ()
    ) -> Self:
        """Those of one law; `framed` are the best designs of the other laws, else the least `S_mean` is taken."""
        members = [i for i, d in enumerate(designs) if d.law == law]
        best = winner if winner in members else min(members, key=lambda i: (i not in framed, S_mean[i]))
        own = [designs[i] for i in members]
        return cls(
            law,
            controller_class(law).title,
            swept_axes(own),
            tuple(values_of(design) for design in own),
            S_mean[members],
            members.index(best),
            best == winner,
        )

    def landscape(self, x: Axis, y: Axis | None) -> Landscape:
        """Cells over two axes, or one."""
        rows, columns = self.places(y), self.places(x)
        grid = np.full((len(y.values) if y else 1, len(x.values)), np.inf)
        np.minimum.at(grid, (rows, columns), self.S)
        grid[~np.isfinite(grid)] = np.nan
        best = int(rows[self.best]), int(columns[self.best])
        return Landscape(self.law, self.title, x, y, grid, best, self.winner)

    def places(self, axis: Axis | None) -> npt.NDArray[np.int64]:
        """Where each design stands on an axis, (m,)."""
        if axis is None:
            return np.zeros(len(self.values), dtype=np.int64)
        # True equals 1 as a key, but one axis holds switches or numbers and never both
        place = {value: i for i, value in enumerate(axis.values)}
        return np.array([place[values[axis.name]] for values in self.values], dtype=np.int64)


def on_the_edge(designs: Sequence[Design], chosen: int) -> tuple[str, ...]:
    """Swept numbers for which a design sits at the end of what was tried, as ``y_s (lowest tried)``.

    The end of what is allowed does not count: there is nothing beyond it to try.
    """
    members = [d for d in designs if d.law == designs[chosen].law]
    bounds = {g.name: (g.lower, g.upper) for g in controller_class(designs[chosen].law).gains()}
    bounds["y_s"] = (0.0, math.inf)
    found = []
    for axis in swept_axes(members):
        value = values_of(designs[chosen])[axis.name]
        if axis.numeric and value in (axis.values[0], axis.values[-1]) and value not in bounds[axis.name]:
            found.append(f"{axis.name} ({'lowest' if value == axis.values[0] else 'highest'} tried)")
    return tuple(found)


def color_range(panels: Iterable[Landscape | Sample], uncorrected: float) -> tuple[float, float]:
    """Ends of one colour scale for all panels [m s]: from the best to the worst that is no worse than no control."""
    values = np.concatenate([panel.S.ravel() for panel in panels])
    values = values[np.isfinite(values)]
    useful = values[values <= uncorrected * (1.0 + 1e-9)]
    shown = useful if useful.size else values
    return (float(shown.min()), float(shown.max())) if shown.size else (0.0, 1.0)


def is_full_grid(designs: Sequence[Design]) -> bool:
    """Whether every combination of the swept values of a law was run."""
    axes = swept_axes(designs)
    found = {tuple(values[axis.name] for axis in axes) for values in map(values_of, designs)}
    return len(found) == math.prod(len(axis.values) for axis in axes)  # a sample has too many combinations to list
