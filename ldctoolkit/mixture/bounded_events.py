"""Events made fit for a bounded fit: constant columns left out, values on a bound moved inside."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture.events import Events, Profile, profile_of

_FLAT: Final = 1e-12
"""A column whose range is this small beside its values is constant."""

_STEP: Final = 1e-3
"""A value on a bound moves inside by at most this part of the column's spread."""


@dataclasses.dataclass(frozen=True)
class InsideBounds:
    """Events without constant columns and without values on a bound.

    Attributes
    ----------
    events : Events
        The d' columns that vary, in order.
    profile : Profile
        Of all d columns as they were.
    varies : (d,) bool
        Columns that are in `events`.
    moved : (d,)
        Values of each column that were on a bound.
    """

    events: Events
    profile: Profile
    varies: npt.NDArray[np.bool_]
    moved: IntArray


def inside_bounds(
    events: Events,
    lower: FloatArray,
    upper: FloatArray,
    names: Sequence[str] | None = None,
    *,
    profile: Profile | None = None,
    keep_constant: bool = False,
) -> InsideBounds:
    """Leave constant columns out, and move values exactly on a bound inside.

    They move by half the smallest other distance to that bound, at most a thousandth of the standard deviation. Values
    outside a bound or not finite stay as they are: a fit names them.

    Parameters
    ----------
    events : Events
        Rows and weights, d columns; they are not changed.
    lower, upper : (d,)
        The box; infinite entries are open.
    names : sequence of str, optional
        Column names for messages.
    profile : Profile, optional
        Of the events, where it is known: it saves a pass.
    keep_constant : bool
        Constant columns are kept, and their values on a bound moved as well.

    Raises
    ------
    InputError
        If there are no events, or a constant column's value is outside its bounds.

    Examples
    --------
    >>> x = np.array([[0.0, 7.0], [1.0, 7.0], [3.0, 7.0]])
    >>> found = inside_bounds(Events(x), np.array([0.0, 0.0]), np.array([np.inf, np.inf]))
    >>> found.varies.tolist(), found.moved.tolist()
    ([True, False], [1, 0])
    >>> bool(0.0 < found.events.x[0, 0] < 0.01)
    True
    """
    with np.errstate(over="ignore", invalid="ignore"):
        profile = profile_of(events) if profile is None else profile
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
    moved = np.zeros(lower.size, dtype=np.int64)
    on_bound = varies & ((profile.least == lower) | (profile.most == upper))
    if varies.all() and not on_bound.any():
        return InsideBounds(events, profile, varies, moved)
    x = np.array(events.x[:, varies], order="C")
    for column, j in enumerate(np.flatnonzero(varies).tolist()):
        if on_bound[j]:
            for bound, inwards in ((lower[j], 1.0), (upper[j], -1.0)):
                moved[j] += _move_inside(x[:, column], bound, inwards, _STEP * float(scale[j]))
    return InsideBounds(dataclasses.replace(events, x=x), profile, varies, moved)


def _move_inside(column: FloatArray, bound: float, inwards: float, most: float) -> int:
    """Move the values of a column that lie on a bound, in place, by at most `most`; how many these were."""
    distance = inwards * (column - bound)
    on = distance == 0.0
    if on.any():
        near = float(np.min(distance[distance > 0.0], initial=np.inf))
        place = bound + inwards * min(0.5 * near, most)
        column[on] = place if inwards * (place - bound) > 0.0 else np.nextafter(bound, inwards * np.inf)
    return int(on.sum())
