"""Mean S over (y_s, gains), arranged for the figures."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit import controller_class
from ldctoolkit.gains import GainValue
from studies.design import Design
from studies.report.figures.landscape_figures import Axis, Landscape

FloatArray = npt.NDArray[np.float64]


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
    declared = {g.name: g.unit for g in controller_class(designs[0].law).gains()}
    axes = []
    for name, unit in {"y_s": "m", **declared}.items():
        seen: list[GainValue] = list(dict.fromkeys(values_of(d)[name] for d in designs))
        if len(seen) > 1:
            numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in seen)
            axes.append(Axis(name, unit, tuple(sorted(seen, key=float) if numeric else seen)))
    return tuple(axes)


def landscapes(
    designs: Sequence[Design], S_mean: FloatArray, winner: int, framed: Collection[int] = ()
) -> Iterator[Landscape]:
    """The panels of every law: y_s against each swept gain, or a profile where one quantity is swept.

    Parameters
    ----------
    designs : sequence of Design
        d designs.
    S_mean : (d,) [m s]
    winner : int
        Index of the best design.
    framed : collection of int
        Indices of the best designs of the other laws; of a law without one the least `S_mean` is taken.

    Yields
    ------
    Landscape
        Each cell is the least mean S over everything that the panel does not show.
    """
    for law in dict.fromkeys(d.law for d in designs):
        members = [i for i, d in enumerate(designs) if d.law == law]
        axes = swept_axes([designs[i] for i in members])
        best = winner if winner in members else min(members, key=lambda i: (i not in framed, S_mean[i]))
        title = controller_class(law).title
        if not axes:
            continue
        pairs: list[tuple[Axis, Axis | None]] = [(axes[0], None)]
        if len(axes) > 1:
            pairs = [(axes[0], other) for other in axes[1:]]
        for x, y in pairs:
            grid = np.full((len(y.values) if y else 1, len(x.values)), np.inf)
            for i in members:
                row, column = _place(designs[i], x, y)
                grid[row, column] = min(grid[row, column], S_mean[i])
            grid[~np.isfinite(grid)] = np.nan
            yield Landscape(law, title, x, y, grid, _place(designs[best], x, y), best == winner)


def _place(design: Design, x: Axis, y: Axis | None) -> tuple[int, int]:
    values = values_of(design)
    return (y.values.index(values[y.name]) if y else 0), x.values.index(values[x.name])


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


def color_range(panels: Sequence[Landscape], uncorrected: float) -> tuple[float, float]:
    """Ends of one colour scale for all panels [m s]: from the best to the worst that is no worse than no control."""
    values = np.concatenate([panel.S.ravel() for panel in panels])
    values = values[np.isfinite(values)]
    useful = values[values <= uncorrected * (1.0 + 1e-9)]
    shown = useful if useful.size else values
    return (float(shown.min()), float(shown.max())) if shown.size else (0.0, 1.0)


def is_full_grid(designs: Sequence[Design]) -> bool:
    """Whether every combination of the swept values of a law was run."""
    axes = swept_axes(designs)
    combinations = set(itertools.product(*(axis.values for axis in axes)))
    return combinations == {tuple(values_of(d)[axis.name] for axis in axes) for d in designs}
