"""Fit a scenario model to departures."""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Iterable, Mapping
from typing import Any, Final

from ldctoolkit.departures import LEFT, RIGHT, Departures
from ldctoolkit.errors import InputError
from ldctoolkit.scenario_model.card import ModelProvenance
from ldctoolkit.scenario_model.fit_side import LEAST_EVENTS, Progress, checked_bounds, component_numbers, fit_side
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.parts import whole_number
from ldctoolkit.version import __version__

_SEED_END: Final = 10**18


def fit_scenario_model(
    departures: Departures,
    *,
    components: int | Iterable[int] = range(1, 11),
    seed: int = 0,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    source_provenance: Mapping[str, Any] | str = "",
    synthetic: bool = False,
    progress: Progress | None = None,
) -> ScenarioModel:
    """Fit a scenario model to departures: one mixture a side, the number of components by BIC.

    Parameters
    ----------
    departures : Departures
        Both sides together.
    components : int or iterable of int
        K, or the K to choose from. A range is cut where the events no longer carry it (two events a free parameter).
        One K is fitted as asked.
    seed : int
        Seed of the fits.
    bounds : mapping, optional
        Parameter name -> (lower, upper) in SI units, in place of the entry in ``PHYSICAL_BOUNDS``.
    source_provenance : mapping or str
        JSON values that describe the data, kept in the model.
    synthetic : bool
        Whether the departures were drawn and not recorded.
    progress : callable, optional
        Called as ``progress("left: K = 3", done, total)``, first for the left side and then for the right one.

    Returns
    -------
    ScenarioModel
        What a user should know (constant parameters, values on a bound, a cut range) is in ``provenance.warnings``.

    Raises
    ------
    InputError
        Fewer than 30 departures on a side (the message gives both counts), a value outside the bounds, a range of
        which the events carry nothing, or a setting out of range.
    ModelError
        If the fitted mixture cannot be sampled.

    Notes
    -----
    A parameter with the same value in every event of a side is left out of the mixture and kept as a constant. A
    value exactly on a bound is moved inside by half the smallest other distance to it, at most a thousandth of the
    column's standard deviation.
    """
    seed = whole_number("seed", seed)
    if seed >= _SEED_END:
        raise InputError(f"seed: {seed}; allowed: below 10^18, the longest whole number of a model file")
    box = checked_bounds(bounds)
    wanted = component_numbers(components)
    rows = {"left": departures.side == LEFT, "right": departures.side == RIGHT}
    counts = {label: int(mask.sum()) for label, mask in rows.items()}
    if min(counts.values()) < LEAST_EVENTS:
        raise InputError(
            f"departures: {counts['left']} left and {counts['right']} right; allowed: at least {LEAST_EVENTS} a side"
        )
    fits = {label: fit_side(departures.take(mask), label, wanted, seed, box, progress) for label, mask in rows.items()}
    source = {"description": source_provenance} if isinstance(source_provenance, str) else source_provenance

    provenance = ModelProvenance(
        source=source,
        synthetic=synthetic,
        created=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        software=f"ldctoolkit {__version__}",
        seed=seed,
        warnings=tuple(note for fit in fits.values() for note in fit.warnings),
    )
    model = ScenarioModel(fits["left"].side, fits["right"].side, provenance)
    left, right = (
        dataclasses.replace(fits[label].summary, redrawn_share=model.redrawn_share(side))
        for label, side in (("left", LEFT), ("right", RIGHT))
    )
    return dataclasses.replace(model, provenance=dataclasses.replace(provenance, left=left, right=right))
