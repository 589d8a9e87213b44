"""Events as a diagnosis needs them: inside the box, with weights, and a count of what was left out."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import Distribution
from ldctoolkit.mixture.bounded_events import inside_bounds
from ldctoolkit.mixture.checks import check_weights
from ldctoolkit.mixture.events import Events as Rows

LEAST_EVENTS: Final = 10


@dataclasses.dataclass(frozen=True)
class Events:
    """Events strictly inside the box.

    Attributes
    ----------
    x : (n, d)
        Rows.
    weight : (n,)
        Events that each row stands for.
    weighted : bool
        Whether the caller gave weights.
    outside : tuple of (str, int)
        Rows left out since they lie outside a bound, per parameter.
    """

    x: FloatArray
    weight: FloatArray
    weighted: bool
    outside: tuple[tuple[str, int], ...]

    @property
    def share(self) -> FloatArray:
        """Weights that sum to one."""
        out: FloatArray = self.weight / self.weight.sum()
        return out

    @property
    def effective(self) -> float:
        """Kish's effective number of events."""
        return float(self.weight.sum() ** 2 / (self.weight**2).sum())


def checked_events(
    distribution: Distribution, names: tuple[str, ...], X: npt.ArrayLike, weights: npt.ArrayLike | None
) -> Events:
    """Check, leave out what is outside the box, and move what is on a bound just inside, as the fit does.

    Raises
    ------
    InputError
        On a wrong shape, a value that is not finite, wrong weights, or fewer than ten events inside.
    """
    try:
        x = np.array(X, dtype=float)
    except (TypeError, ValueError):
        raise InputError("X: not a table of numbers; allowed: (n, d), one row an event") from None
    d = distribution.dimension
    if x.ndim != 2 or x.shape[1] != d:
        raise InputError(f"X: shape {x.shape}; allowed: (n, {d}), the columns {', '.join(names)}")
    if not np.isfinite(x).all():
        row, j = (int(i) for i in np.argwhere(~np.isfinite(x))[0])
        raise InputError(f"X: {names[j]} = {float(x[row, j])!r} in row {row}; allowed: finite numbers")
    weight = np.ones(x.shape[0]) if weights is None else check_weights(weights, x.shape[0], "weights")
    low, high = distribution.transform.lower, distribution.transform.upper
    beyond = (x < low) | (x > high)
    keep = ~beyond.any(axis=1) & (weight > 0.0)
    counts = tuple((names[j], int(beyond[:, j].sum())) for j in np.flatnonzero(beyond.any(axis=0)))
    x, weight = x[keep], weight[keep]
    if x.shape[0] < LEAST_EVENTS:
        raise InputError(
            f"X: {x.shape[0]} of {keep.size} events lie inside the model's bounds; allowed: {LEAST_EVENTS} or more"
        )
    inside = inside_bounds(Rows(x, weight), low, high, names, keep_constant=True)
    return Events(inside.events.x, weight, weights is not None, counts)
