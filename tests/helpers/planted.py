"""Departures that are planted in recordings, and whether they come back."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ldctoolkit.departures import Departures


class Planted(NamedTuple):
    """A departure to the left (1) or the right (-1): where it crosses the line, for how long, and how deep."""

    side: int
    start: float
    T: float
    d_y: float

    def y(self, t: Any) -> Any:
        """Distance of the edge beyond the line [m]."""
        return self.d_y * (1.0 - ((t - self.start) / (0.5 * self.T) - 1.0) ** 2)


def assert_planted(
    departures: Departures, planted: Sequence[Planted], curvature: Callable[[np.ndarray], np.ndarray], *,
    clock: float = 0.0, step: float = 0.1, depth: float = 0.01, bend: float = 2e-4,
) -> None:  # fmt: skip
    """Side, start and duration to a step of time, depth, and the outward curvature with its change; `curvature` of the
    road is positive to the left, `clock` is the time that the planted ones count from."""
    side, start, T, d_y = (np.array(values) for values in zip(*planted, strict=True))
    assert departures.side.tolist() == side.tolist()
    np.testing.assert_allclose(departures.start_time, clock + start, atol=step)
    np.testing.assert_allclose(departures.T, T, atol=step)
    np.testing.assert_allclose(departures.d_y, d_y, atol=depth)
    c_0, c_1 = side * curvature(start), side * curvature(start + T)
    np.testing.assert_allclose(departures.c_0, c_0, atol=bend)
    np.testing.assert_allclose(departures.dc, c_1 - c_0, atol=2.0 * bend)
    sloping = np.abs(c_1 - c_0) > min(1e-4, 2.0 * bend)  # near the crest of a bend the slope says nothing
    assert (np.sign(departures.dc) == np.sign(c_1 - c_0))[sloping].all()
    bends = {*zip(side.tolist(), np.sign(curvature(start)).tolist(), strict=True)}
    assert len(planted) < 6 or bends == {(1, 1), (1, -1), (-1, 1), (-1, -1)}  # both sides in both bends
