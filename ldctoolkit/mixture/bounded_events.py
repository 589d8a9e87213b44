"""Events made fit for a bounded fit, wherever they lie: constant columns left out, values on a bound moved inside."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, Generic

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.mixture.sources import ArrayEvents, EventSource, FloatArray, IntArray, Part, Profile, Work, profile_of

_FLAT: Final = 1e-12
"""A column whose range is this small beside its values is constant."""

_STEP: Final = 1e-3
"""A value on a bound moves inside by at most this part of the column's spread."""


@dataclasses.dataclass(frozen=True)
class InsideBounds:
    """Events without constant columns and without values on a bound.

    Attributes
    ----------
    source : EventSource
        The d' columns that vary, in order; values on a bound are moved inside block by block.
    profile : Profile
        Of all d columns as they were.
    varies : (d,) bool
        Columns that are in `source`.
    moved : (d,)
        Values of each column that were on a bound.
    """

    source: EventSource
    profile: Profile
    varies: npt.NDArray[np.bool_]
    moved: IntArray


def inside_bounds(
    source: EventSource,
    lower: FloatArray,
    upper: FloatArray,
    names: Sequence[str] | None = None,
    *,
    profile: Profile | None = None,
    keep_constant: bool = False,
) -> InsideBounds:
    """Leave constant columns out, and move values exactly on a bound inside.

    They move by half the smallest other distance to that bound, at most a thousandth of the standard deviation. It
    takes a pass over the events, and another one where values are on a bound. Values outside a bound or not finite
    stay as they are: a fit names them.

    Parameters
    ----------
    source : EventSource
        Events, d columns.
    lower, upper : (d,)
        The box; infinite entries are open.
    names : sequence of str, optional
        Column names for messages.
    profile : Profile, optional
        Of the source, where it is known: it saves a pass.
    keep_constant : bool
        Constant columns are kept, and their values on a bound moved as well.

    Raises
    ------
    InputError
        If there are no events, or a constant column's value is outside its bounds.

    Examples
    --------
    >>> x = np.array([[0.0, 7.0], [1.0, 7.0], [3.0, 7.0]])
    >>> events = inside_bounds(ArrayEvents(x), np.array([0.0, 0.0]), np.array([np.inf, np.inf]))
    >>> events.varies.tolist(), events.moved.tolist()
    ([True, False], [1, 0])
    >>> bool(0.0 < next(events.source.blocks())[0, 0] < 0.01)
    True
    """
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(source) if profile is None else profile
        size = np.maximum(np.abs(profile.least), np.abs(profile.most))
        varies = ~(profile.most - profile.least <= _FLAT * size)  # NaN varies: the fit is to name it
        scale = profile.scale
    varies |= keep_constant
    outside = ~varies & ((profile.least < lower) | (profile.most > upper))
    if outside.any():
        j = int(np.argmax(outside))
        name = f"column {j}" if names is None else f"column {names[j]!r}"
        raise InputError(
            f"X: {name} is {float(profile.least[j])!r} in all {profile.rows} rows; "
            f"allowed: {lower[j]:g} to {upper[j]:g}"
        )
    none = np.zeros(lower.size, dtype=np.int64)
    on_bound = varies & ((profile.least == lower) | (profile.most == upper))
    if not on_bound.any():
        kept = source if varies.all() else mapped(source, _Moved(varies, lower, upper, lower, upper))
        return InsideBounds(kept, profile, varies, none)
    ends = _Ends.zero(lower.size)
    for part in source.map_blocks(_EndsOf(lower, upper)):
        ends = ends + part
    with np.errstate(invalid="ignore"):  # nothing lies on an open end
        to_lower = np.maximum(lower + np.minimum(0.5 * ends.near_lower, _STEP * scale), np.nextafter(lower, np.inf))
        to_upper = np.minimum(upper - np.minimum(0.5 * ends.near_upper, _STEP * scale), np.nextafter(upper, -np.inf))
    moved = np.where(varies, ends.on_lower + ends.on_upper, none)
    return InsideBounds(mapped(source, _Moved(varies, lower, upper, to_lower, to_upper)), profile, varies, moved)


@dataclasses.dataclass(frozen=True)
class _Ends:
    """Values on each bound, and the smallest other distance to it, (d,)."""

    on_lower: IntArray
    on_upper: IntArray
    near_lower: FloatArray
    near_upper: FloatArray

    @classmethod
    def zero(cls, d: int) -> _Ends:
        none, far = np.zeros(d, dtype=np.int64), np.full(d, np.inf)
        return cls(none, none, far, far)

    def __add__(self, other: _Ends) -> _Ends:
        return _Ends(
            self.on_lower + other.on_lower,
            self.on_upper + other.on_upper,
            np.minimum(self.near_lower, other.near_lower),
            np.minimum(self.near_upper, other.near_upper),
        )


@dataclasses.dataclass(frozen=True)
class _EndsOf:
    """Work that looks at the bounds."""

    lower: FloatArray
    upper: FloatArray

    def __call__(self, x: FloatArray, weight: FloatArray | None) -> _Ends:
        del weight
        above, below = x - self.lower, self.upper - x
        return _Ends(
            (above == 0.0).sum(axis=0),
            (below == 0.0).sum(axis=0),
            np.where(above > 0.0, above, np.inf).min(axis=0),
            np.where(below > 0.0, below, np.inf).min(axis=0),
        )


@dataclasses.dataclass(frozen=True)
class _Moved:
    """Map of rows (m, d) to the kept columns (m, d'), with new places for values on a bound."""

    kept: npt.NDArray[np.bool_]
    lower: FloatArray
    upper: FloatArray
    to_lower: FloatArray
    to_upper: FloatArray

    def __call__(self, x: FloatArray) -> FloatArray:
        out = np.where(x == self.lower, self.to_lower, np.where(x == self.upper, self.to_upper, x))
        return np.ascontiguousarray(out[:, self.kept])


RowMap = Callable[[FloatArray], FloatArray]


@dataclasses.dataclass(frozen=True)
class _MappedWork(Generic[Part]):
    """Work on mapped rows."""

    rows: RowMap
    work: Work[Part]

    def __call__(self, x: FloatArray, weight: FloatArray | None) -> Part:
        return self.work(self.rows(x), weight)


@dataclasses.dataclass(frozen=True)
class MappedEvents:
    """A source seen through a map of its rows, block by block; the map can be pickled."""

    source: EventSource
    rows: RowMap
    dimension: int

    def map_blocks(self, work: Work[Part]) -> Iterable[Part]:
        """What `work` gives for each block of mapped rows, in order."""
        return self.source.map_blocks(_MappedWork(self.rows, work))

    def take(self, rows: IntArray) -> tuple[FloatArray, FloatArray | None]:
        """Mapped rows (m, d) by their ascending numbers, and their weights."""
        x, weight = self.source.take(rows)
        return self.rows(x), weight

    def blocks(self) -> Iterator[FloatArray]:
        """The mapped rows of each block, in order."""
        return map(self.rows, self.source.blocks())


def mapped(source: EventSource, rows: _Moved) -> EventSource:
    """The source through the map; an array is mapped once, a stream at every pass."""
    if isinstance(source, ArrayEvents):
        return dataclasses.replace(source, x=rows(source.x))
    return MappedEvents(source, rows, int(rows.kept.sum()))
