"""Departures that were found against those that were planted."""

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT, RIGHT, DepartureParameters, Departures

from .das1 import trip_name
from .drive import Drive

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

NEAR = 0.5  # largest distance [s] between the starts of a departure and of the planted one that it is


@dataclasses.dataclass(frozen=True)
class Comparison:
    """k departures found again.

    Attributes
    ----------
    found, planted : (k,) int
        Row in the departures found, and in those planted.
    lost : int
        Planted departures that were not found.
    surplus : int
        Departures that were not planted.
    """

    found: IntArray
    planted: IntArray
    lost: int
    surplus: int


def compare(departures: Departures, drive: Drive) -> Comparison:
    """Pair departures by trip, side and start."""
    truth = drive.planted.parameters
    names = np.array(trip_name(np.arange(drive.trip[-1] + 1)))
    order = np.argsort(names)
    trip = order[np.searchsorted(names[order], departures.recording)]
    # one long clock, a stretch of it for each trip and side
    span = 10.0 * NEAR + float(drive.start_time.max())
    theirs = (2 * drive.event_trip + (truth.side == RIGHT)) * span + drive.start_time
    ours = (2 * trip + (departures.side == RIGHT)) * span + departures.start_time
    sort = np.argsort(theirs)
    after = np.searchsorted(theirs[sort], ours)
    before, after = np.maximum(after - 1, 0), np.minimum(after, truth.n - 1)
    nearer = np.abs(theirs[sort][before] - ours) <= np.abs(theirs[sort][after] - ours)
    planted = sort[np.where(nearer, before, after)]
    close = np.flatnonzero(np.abs(theirs[planted] - ours) <= NEAR)
    # of two that are near one planted departure the longer one is it
    close = close[np.argsort(-departures.T[close], kind="stable")]
    _, first = np.unique(planted[close], return_index=True)
    found = np.sort(close[first])
    return Comparison(found, planted[found], truth.n - found.size, departures.n - found.size)


def kolmogorov(one: DepartureParameters, other: DepartureParameters) -> dict[str, FloatArray]:
    """Kolmogorov distances of the eight parameters' distributions, each side, (8,)."""
    distances = {}
    for name, side in (("left", LEFT), ("right", RIGHT)):
        a, b = (p.take(p.side == side).matrix() for p in (one, other))
        distances[name] = np.array([_distance(a[:, k], b[:, k]) for k in range(a.shape[1])])
    return distances


def _distance(a: FloatArray, b: FloatArray) -> float:
    every = np.concatenate([a, b])
    steps = [np.searchsorted(np.sort(values), every, "right") / values.size for values in (a, b)]
    return float(np.abs(steps[0] - steps[1]).max())
