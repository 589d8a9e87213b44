"""Fit one side of a scenario model: bounds, values on a bound, constant columns, how many components the data carry."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.errors import InputError, ModelError, nearest
from ldctoolkit.mixture import select_components
from ldctoolkit.scenario_model.card import SideSummary
from ldctoolkit.scenario_model.parts import LEAST_LOWER, PHYSICAL_BOUNDS, SideModel, check_usable

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]

LEAST_EVENTS: Final = 30
"""Departures a side needs."""

EVENTS_PER_PARAMETER: Final = 2
"""A range of K is cut where fewer events than this would stand behind each free parameter."""

_STOPPED: Final = {
    "max_iter": "had not converged",
    "stuck": "is not at a maximum: no step raised the likelihood",
    "collapsed": "is not at a maximum: a component became too thin for the arithmetic",
}


@dataclasses.dataclass(frozen=True)
class SideFit:
    """A fitted side, how it was fitted, and what a user should know."""

    side: SideModel
    summary: SideSummary
    warnings: tuple[str, ...]


def checked_bounds(bounds: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]]:
    """`PHYSICAL_BOUNDS` with the caller's changes."""
    out = dict(PHYSICAL_BOUNDS)
    for name, pair in (bounds or {}).items():
        if name not in PHYSICAL_BOUNDS:
            raise InputError(f"bounds: no parameter {name!r}; {nearest(name, PARAMETER_NAMES)}")
        try:
            low, high = (float(value) for value in pair)
        except (TypeError, ValueError):
            raise InputError(f"bounds[{name!r}]: {pair!r}; allowed: (lower, upper)") from None
        least = LEAST_LOWER.get(name, -np.inf)
        if not (low < high and low >= least):
            raise InputError(f"bounds[{name!r}]: {pair!r}; allowed: {least:g} <= lower < upper")
        out[name] = (low, high)
    return out


def component_numbers(components: int | Iterable[int]) -> int | tuple[int, ...]:
    """K, or the K to choose from, in ascending order."""
    allowed = "allowed: an integer >= 1, or several of them"
    given = (components,) if isinstance(components, int | np.integer) else components
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(f"components: {components!r}; {allowed}")
    numbers = tuple(given)
    for K in numbers:
        if isinstance(K, bool) or not isinstance(K, int | np.integer) or K < 1:
            raise InputError(f"components: {K!r}; {allowed}")
    if not numbers:
        raise InputError(f"components: an empty range; {allowed}")
    if isinstance(components, int | np.integer):
        return int(components)
    return tuple(sorted({int(K) for K in numbers}))


def fit_side(
    departures: Departures,
    label: str,
    components: int | tuple[int, ...],
    seed: int,
    bounds: Mapping[str, tuple[float, float]],
    progress: Progress | None,
) -> SideFit:
    """Fit the departures of one side (all rows are used)."""
    x = departures.matrix()
    n = x.shape[0]
    if not np.isfinite(x).all():
        row, j = np.argwhere(~np.isfinite(x))[0]
        raise InputError(
            f"departures ({label}): {PARAMETER_NAMES[j]}[{row}] = {float(x[row, j])!r}; allowed: finite numbers"
        )
    varies = np.array([np.ptp(x[:, j]) > 1e-12 * np.max(np.abs(x[:, j])) for j in range(x.shape[1])])
    constants = tuple((PARAMETER_NAMES[j], float(x[0, j])) for j in np.flatnonzero(~varies))
    names = tuple(PARAMETER_NAMES[j] for j in np.flatnonzero(varies))
    if not names:
        raise InputError(f"departures ({label}): all {n} events are equal; there is nothing to fit")
    notes = [f"{label}: {name} is {value:g} in every event and is kept as a constant" for name, value in constants]
    lower, upper = (np.array([bounds[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    moved: list[tuple[str, int]] = []
    for j in range(x.shape[1]):
        outside = (x[:, j] < lower[j]) | (x[:, j] > upper[j])
        if outside.any():
            row = int(np.argmax(outside))
            raise InputError(
                f"departures ({label}): {PARAMETER_NAMES[j]} = {float(x[row, j])!r} in event {row}; allowed: "
                f"{lower[j]:g} to {upper[j]:g} ({int(outside.sum())} of {n} events)"
            )
        if varies[j]:
            x[:, j], count = _inside(x[:, j], lower[j], upper[j])
            if count:
                moved.append((PARAMETER_NAMES[j], count))
                notes.append(f"{label}: {count} events had {PARAMETER_NAMES[j]} exactly on a bound, moved just inside")
    tried = (components,) if isinstance(components, int) else components
    if not isinstance(components, int):
        d = len(names)
        most = max(1, n // (EVENTS_PER_PARAMETER * (1 + d + d * (d + 1) // 2)))
        tried = tuple(K for K in components if most >= K)
        if not tried:
            raise InputError(
                f"components: {components[0]} and more; allowed: a range that begins at {most} or below, "
                f"{n} {label} departures carry no more"
            )
        if len(tried) < len(components):
            notes.append(f"{label}: {n} events carry no more than K = {most}; larger K were not tried")
    try:
        selection = select_components(
            x[:, varies],
            tried,
            progress=None if progress is None else lambda text, done, total: progress(f"{label}: {text}", done, total),
            lower=lower[varies],
            upper=upper[varies],
            random_state=seed,
            names=names,
        )
        check_usable(selection.best)
    except (InputError, ModelError) as error:
        raise type(error)(f"departures ({label}): {error}") from None
    best = selection.best
    if not best.converged_:
        notes.append(f"{label}: the fit stopped after {best.n_iter_} passes and {_STOPPED[best.stop_reason_]}")
    summary = SideSummary(
        events=n,
        n_components=tuple(int(K) for K in selection.n_components),
        bic=tuple(selection.bic.tolist()),
        log_likelihood=tuple(selection.log_likelihood.tolist()),
        converged=best.converged_,
        moved_inside=tuple(moved),
        redrawn_share=0.0,
    )
    return SideFit(SideModel(best, names, constants), summary, tuple(notes))


def _inside(column: FloatArray, lower: float, upper: float) -> tuple[FloatArray, int]:
    """Move values on a bound inside by half the smallest other distance, at most a thousandth of the spread."""
    out = column.copy()
    count = 0
    for bound, sign in ((lower, 1.0), (upper, -1.0)):
        distance = sign * (column - bound)
        on = distance == 0.0
        if on.any():
            count += int(on.sum())
            out[on] = bound + sign * min(0.5 * float(distance[~on].min()), 1e-3 * float(column.std()))
    return out, count
