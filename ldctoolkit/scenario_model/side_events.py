"""The events of one side made ready for its fit: the box, constant columns, values on a bound, what is outside."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import ArrayEvents, EventSource, InsideBounds, inside_bounds
from ldctoolkit.mixture.sources import Profile, profile_of
from ldctoolkit.scenario_model.bounds import Box, WantedBounds, box_of
from ldctoolkit.scenario_model.settings import SideSettings, check_transform

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]


@dataclasses.dataclass(frozen=True)
class SideEvents:
    """What the mixture of a side is fitted to.

    Attributes
    ----------
    label : str
        ``"left"`` or ``"right"``.
    inside : InsideBounds
        The parameters that vary, none on a bound.
    weighted : bool
        Whether the events have weights.
    box : Box
        Of all eight parameters.
    """

    label: str
    inside: InsideBounds
    weighted: bool
    box: Box

    @property
    def source(self) -> EventSource:
        """Where the events lie."""
        return self.inside.source

    @property
    def rows(self) -> int:
        """Departures, each counted once whatever its weight."""
        return self.inside.profile.rows

    @property
    def weight(self) -> float | None:
        """Sum of the weights, if there are any."""
        return self.inside.profile.events if self.weighted else None

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


def side_events(source: EventSource, label: str, settings: SideSettings) -> SideEvents:
    """Look at all events of a side (columns as `PARAMETER_NAMES`), and put those on a bound inside.

    Raises
    ------
    InputError
        For a value that is not finite or outside its bounds (naming parameter, event and count), equal events, a box
        that is to be found in events that are not in memory, or a transform that the box does not allow.
    """
    if not isinstance(source, ArrayEvents):
        _refuse_auto(settings.bounds)  # before the first pass
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(source)
    _check_finite(source, profile, label)
    x = source.x if isinstance(source, ArrayEvents) else np.empty((0, len(PARAMETER_NAMES)))
    box = box_of(settings.bounds, x)
    _check_inside(source, profile, box, label)
    check_transform(settings.transform, box.lower, box.upper)
    inside = inside_bounds(source, box.lower, box.upper, PARAMETER_NAMES, profile=profile)
    if not inside.varies.any():
        raise InputError(f"departures ({label}): all {profile.rows} events are equal; there is nothing to fit")
    weighted = source.take(np.zeros(1, dtype=np.int64))[1] is not None
    return SideEvents(label, inside, weighted, box)


def _refuse_auto(wanted: WantedBounds) -> None:
    for name, ends in wanted.items():
        if any(end.auto for end in ends):
            raise InputError(
                f"bounds[{name!r}]: 'auto' for departures in files; allowed: 'physical' or (lower, upper), or "
                "departures in memory"
            )


def _check_finite(source: EventSource, profile: Profile, label: str) -> None:
    bad = ~(np.isfinite(profile.least) & np.isfinite(profile.most))
    everywhere = np.full(bad.size, np.finfo(float).max)
    if bad.any():
        _complain(source, int(np.argmax(bad)), -everywhere, everywhere, "finite numbers", label)


def _check_inside(source: EventSource, profile: Profile, box: Box, label: str) -> None:
    outside = (profile.least < box.lower) | (profile.most > box.upper)
    if outside.any():
        j = int(np.argmax(outside))
        _complain(source, j, box.lower, box.upper, f"{box.lower[j]:g} to {box.upper[j]:g}", label)
    for name in ("T", "v_mean"):  # as in a departures table
        j = PARAMETER_NAMES.index(name)
        if profile.least[j] <= 0.0:
            least = np.full(box.lower.size, np.nextafter(0.0, 1.0))
            _complain(source, j, least, box.upper, "above 0", label)


@dataclasses.dataclass(frozen=True)
class _Outside:
    """Work that finds the values of a column beyond two ends: rows, how many are beyond, the first of them."""

    column: int
    lower: float
    upper: float

    def __call__(self, x: FloatArray, weight: FloatArray | None) -> tuple[int, int, int, float]:
        del weight
        values = x[:, self.column]
        beyond = ~((values >= self.lower) & (values <= self.upper))
        first = int(np.argmax(beyond))
        return values.size, int(beyond.sum()), first, float(values[first])


def _complain(source: EventSource, j: int, lower: FloatArray, upper: FloatArray, allowed: str, label: str) -> None:
    """Raise for a column: its first value beyond the two ends and how many there are."""
    rows, count, event, value = 0, 0, 0, 0.0
    for block, beyond, first, found in source.map_blocks(_Outside(j, float(lower[j]), float(upper[j]))):
        if beyond and not count:
            event, value = rows + first, found
        rows, count = rows + block, count + beyond
    raise InputError(
        f"departures ({label}): {PARAMETER_NAMES[j]} = {value!r} in event {event}; allowed: {allowed} "
        f"({count} of {rows} events)"
    )
