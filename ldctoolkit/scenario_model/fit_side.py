"""Fit one side of a scenario model: how many components the data carry, and which of them to take."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import Selection, select_components
from ldctoolkit.scenario_model.card import SideSummary
from ldctoolkit.scenario_model.parts import SideModel, check_usable
from ldctoolkit.scenario_model.settings import SideSettings
from ldctoolkit.scenario_model.side_events import SideEvents
from ldctoolkit.scenario_model.source_summary import summarize_events

Progress = Callable[[str, int, int], None]

EVENTS_PER_PARAMETER: Final = 2
"""A range of K is cut where fewer events than this would stand behind each free parameter."""

_SETTINGS: Final = ("criterion", "slack", "indifference", "prior_strength", "tol", "n_init", "max_iter", "n_jobs")
"""A complaint about one of these is none about the departures."""


@dataclasses.dataclass(frozen=True)
class SideFit:
    """A fitted side, how it was fitted, and what a user should know."""

    side: SideModel
    summary: SideSummary
    warnings: tuple[str, ...]


def fit_side(
    events: SideEvents,
    carried: tuple[tuple[int, ...], tuple[str, ...]],
    settings: SideSettings,
    progress: Progress | None,
) -> SideFit:
    """Fit the departures of one side, with the K that they carry."""
    label, n = events.label, events.rows
    notes = [
        f"{label}: {name} is {value:g} in every event and is kept as a constant" for name, value in events.constants
    ]
    notes += [
        f"{label}: {count} events had {name} exactly on a bound, moved just inside" for name, count in events.moved
    ]
    tried, cut = carried
    notes += cut
    selection, failed = _select(events, tried, settings, progress)
    best = selection.best
    notes += [f"{label}: K = {K} could not be fitted ({message})" for K, message in failed]
    notes += [f"{label}: {sentence}" for sentence in best.warnings_]
    several = len(tried) > 1
    why = "as asked" if isinstance(settings.components, int) else "the only one of the range that the events carry"
    summary = SideSummary(
        events=n,
        n_components=tuple(int(K) for K in selection.n_components),
        bic=_curve(selection.bic),
        log_likelihood=_curve(selection.log_likelihood),
        converged=best.converged_,
        moved_inside=events.moved,
        redrawn_share=0.0,
        n_parameters=tuple(int(p) for p in selection.n_parameters),
        aic=_curve(selection.aic),
        icl=_curve(selection.icl),
        held_out=_curve(selection.held_out),
        criterion=selection.criterion if several else "",
        reason=selection.reason if several else f"K = {tried[0]}, {why}",
        failed=failed,
        passes=best.n_iter_,
        stop_reason=best.stop_reason_,
        weight=events.weight,
        bounds_from=events.box.origins,
        source_summary=summarize_events(events.events, events.names),
    )
    return SideFit(SideModel(best, events.names, events.constants), summary, tuple(notes))


def _curve(values: FloatArray) -> tuple[float, ...]:
    """A criterion of each K; empty where it was not computed."""
    return tuple(values.tolist()) if np.isfinite(values).all() else ()


def carried_components(
    components: int | tuple[int, ...], events: SideEvents
) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """The K that the events of a side carry, and what to say if these are not all.

    Raises
    ------
    InputError
        If they carry none of a range.
    """
    n, d, label = events.rows, len(events.names), events.label
    if isinstance(components, int):
        return (components,), ()
    most = max(1, n // (EVENTS_PER_PARAMETER * (1 + d + d * (d + 1) // 2)))
    tried = tuple(K for K in components if most >= K)
    if not tried:
        raise InputError(
            f"components: {components[0]} and more; allowed: a range that begins at {most} or below, "
            f"{n} {label} departures carry no more"
        )
    if len(tried) == len(components):
        return tried, ()
    return tried, (f"{label}: {n} events carry no more than K = {most}; larger K were not tried",)


def _select(
    events: SideEvents, tried: tuple[int, ...], settings: SideSettings, progress: Progress | None
) -> tuple[Selection, tuple[tuple[int, str], ...]]:
    """The fits, and the K that gave no usable one; an error where none did."""
    label, varies = events.label, events.inside.varies
    arguments: dict[str, Any] = settings.selection() | {
        "progress": None if progress is None else lambda text, done, total: progress(f"{label}: {text}", done, total),
        "sample_weight": events.events.weight,
        "lower": events.box.lower[varies],
        "upper": events.box.upper[varies],
        "transform": [settings.transform[name] for name in events.names],
        "names": events.names,
    }
    failed: list[tuple[int, str]] = []
    while True:
        try:
            selection = select_components(events.events.x, tried, **arguments)
        except (InputError, ModelError) as error:
            if str(error).partition(":")[0] in _SETTINGS:
                raise
            raise type(error)(f"departures ({label}): {error}") from None
        failed += [(f.n_components, f.message) for f in selection.failures]
        taken = int(selection.n_components[selection.chosen])
        try:
            check_usable(selection.best)
        except ModelError as error:
            tried = tuple(int(K) for K in selection.n_components if taken != K)
            if not tried:
                raise ModelError(f"departures ({label}): {error}") from None
            failed.append((taken, str(error)))
        else:
            return selection, tuple(sorted(failed))
