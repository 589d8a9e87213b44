"""The departures of one side made ready for its fit: the box, constant columns, values on a bound, what is outside."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError
from ldctoolkit.mixture.bounded_events import InsideBounds, inside_bounds
from ldctoolkit.mixture.events import Events, profile_of
from ldctoolkit.scenario_model.bounds import Box, box_of
from ldctoolkit.scenario_model.settings import SideSettings, check_transform


@dataclasses.dataclass(frozen=True)
class SideEvents:
    """What the mixture of a side is fitted to.

    Attributes
    ----------
    label : str
        ``"left"`` or ``"right"``.
    inside : InsideBounds
        The parameters that vary, none on a bound.
    box : Box
        Of all eight parameters.
    """

    label: str
    inside: InsideBounds
    box: Box

    @property
    def events(self) -> Events:
        """Rows of the parameters that vary, with their weights if any."""
        return self.inside.events

    @property
    def rows(self) -> int:
        """Departures, each counted once whatever its weight."""
        return self.inside.profile.rows

    @property
    def weight(self) -> float | None:
        """Sum of the weights, if there are any."""
        return None if self.events.weight is None else self.inside.profile.events

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that vary."""
        return tuple(PARAMETER_NAMES[j] for j in np.flatnonzero(self.inside.varies))

    @property
    def constants(self) -> tuple[tuple[str, float], ...]:
        """The others with their value."""
        least = self.inside.profile.least
        return tuple((PARAMETER_NAMES[j], float(least[j])) for j in np.flatnonzero(~self.inside.varies))

    @property
    def moved(self) -> tuple[tuple[str, int], ...]:
        """Events that lay on a bound, per parameter."""
        moved = self.inside.moved
        return tuple((PARAMETER_NAMES[j], int(moved[j])) for j in np.flatnonzero(moved))


def side_events(events: Events, label: str, settings: SideSettings) -> SideEvents:
    """Look at the departures of a side (columns as `PARAMETER_NAMES`), and put those on a bound inside.

    Raises
    ------
    InputError
        For a value that is not finite or outside its bounds (naming parameter, event and count), equal events, or a
        transform that the box does not allow.
    """
    x = events.x
    for j in range(x.shape[1]):
        _check(x, j, np.isfinite(x[:, j]), "finite numbers", label)
    box = box_of(settings.bounds, x)
    for j, (low, high) in enumerate(zip(box.lower, box.upper, strict=True)):
        _check(x, j, (x[:, j] >= low) & (x[:, j] <= high), f"{low:g} to {high:g}", label)
    for name in ("T", "v_mean"):  # as in a departures table
        j = PARAMETER_NAMES.index(name)
        _check(x, j, x[:, j] > 0.0, "above 0", label)
    check_transform(settings.transform, box.lower, box.upper)
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(events)
    inside = inside_bounds(events, box.lower, box.upper, PARAMETER_NAMES, profile=profile)
    if not inside.varies.any():
        raise InputError(f"departures ({label}): all {profile.rows} events are equal; there is nothing to fit")
    return SideEvents(label, inside, box)


def _check(x: FloatArray, j: int, good: npt.NDArray[np.bool_], allowed: str, label: str) -> None:
    """Refuse a column with a bad value: the first of them and how many there are."""
    if not good.all():
        event = int(np.argmin(good))
        raise InputError(
            f"departures ({label}): {PARAMETER_NAMES[j]} = {float(x[event, j])!r} in event {event}; allowed: {allowed} "
            f"({int((~good).sum())} of {good.size} events)"
        )
