"""Paths as designers' metrics see them: departures from their start to their end on a grid of samples.

A metric gets the departures of about one length at a time, in arrays whose width follows from the departure's own
length alone: no number depends on which other departures are measured with it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, Rows, unmasked
from ldctoolkit.errors import LdcError, first_line, short
from ldctoolkit.simulation.loop import FAILURES, Run, Trajectories
from ldctoolkit.simulation.takeover import Takeover

if TYPE_CHECKING:
    from ldctoolkit.metrics import UserMetric
    from ldctoolkit.vehicle import VehicleParameters

_WIDTH: Final = 128  # the number of samples of an array is a multiple of it


@dataclasses.dataclass(frozen=True)
class Paths(Rows):
    """Paths of n departures at k samples, `dt` apart: the recorded path up to the trigger, which is a sample, then the
    path under control to the end of the settling horizon. A departure that was never taken over has its recorded path,
    to T. All is in the outward frame: those to the right are mirrored, so that e_y, curvature and angles are positive
    towards the line that is crossed.

    NaN after the end of a departure, and after the last sample inside the bound where it diverged: a comparison is
    False there, and `numpy.nanmax` and the like leave it out. No array can be written into.
    """

    t: FloatArray  # (n, k) [s] Time since the departure's start
    e_y: FloatArray  # (n, k) [m] Offset of the centre of gravity from the lane's centre
    e_y_rate: FloatArray  # (n, k) [m/s]
    e_psi: FloatArray  # (n, k) [rad] Heading relative to the lane
    e_psi_rate: FloatArray  # (n, k) [rad/s]
    delta: FloatArray  # (n, k) [rad] Steering angle of the wheel
    command: FloatArray  # (n, k) [rad] What the law commands from that sample on; before the trigger it is `delta`
    a_y: FloatArray  # (n, k) [m/s^2] Lateral acceleration, that of the bend included
    v: FloatArray  # (n, k) [m/s] Speed
    curvature: FloatArray  # (n, k) [1/m] Of the lane
    e_y_recorded: FloatArray  # (n, k) [m] e_y of the recorded path; NaN after T
    T: FloatArray  # (n,) [s] End of the recorded departure
    t_s: FloatArray  # (n,) [s] Trigger; infinite where never taken over
    side: IntArray  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1)
    dt: float  # [s]
    vehicle: VehicleParameters  # Nominal, with the width of the lane

    @property
    def n(self) -> int:
        """Number of departures."""
        return int(self.T.size)

    @property
    def distance(self) -> FloatArray:
        """Distance of the outer edge to the line that the departure crosses, (n, k) [m]; negative beyond it."""
        return self.vehicle.edge_offset - self.e_y

    @property
    def opposite_distance(self) -> FloatArray:
        """The same of the other edge and the opposite line, (n, k) [m]."""
        return self.vehicle.edge_offset + self.e_y

    @property
    def controlled(self) -> BoolArray:
        """Samples from the trigger on, (n, k)."""
        return self.t >= self.t_s[:, None] - 0.5 * self.dt


_GRID: Final = ("t", "v", "curvature", "e_y_recorded")  # what no design changes


@dataclasses.dataclass(frozen=True)
class _Batch:
    """Departures of about one length: their paths without control, and where the entries of a run's paths belong."""

    rows: IntArray  # (g,) Rows of the scenarios
    paths: Paths  # The recorded ones, up to the trigger where there is one
    # (e,) Entries of a run: row and column in its arrays (m, .), and place in an array (g, k) that is laid flat
    row: IntArray
    column: IntArray
    place: IntArray

    def with_run(self, run: Trajectories) -> Paths:
        """The paths with what a run drove."""
        there = np.flatnonzero(self.column < run.t.shape[1])
        at, place = (self.row[there], self.column[there]), self.place[there]
        x = run.x[at]
        driven = {name: x[:, j] for j, name in enumerate(("e_y", "e_y_rate", "e_psi", "e_psi_rate"))}
        driven |= {name: getattr(run, name)[at] for name in ("delta", "command", "a_y")}
        ended = np.ones(self.place.size, dtype=np.bool_)
        ended[there] = np.isnan(driven["e_y"])
        driven |= dict.fromkeys(_GRID, np.array(np.nan)) if ended.any() else {}
        arrays = {name: getattr(self.paths, name).copy() for name in driven}
        for name, values in driven.items():
            arrays[name].flat[self.place[ended] if name in _GRID else place] = values
        return dataclasses.replace(self.paths, **arrays)


class PathSampler:
    """The paths of the designs of one takeover, and what designers' metrics make of them."""

    def __init__(self, over: Takeover, metrics: Sequence[UserMetric]) -> None:
        self._over, self._metrics, self._dt = over, metrics, over.setup.dt
        self._before = np.floor(over.start / self._dt + _SAME).astype(np.int64)  # samples before the trigger, (m,)
        samples = self._before + over.steps + (over.rest == 0.0)  # a last shorter step ends beside the grid
        self._batches = [self._of_triggered(*part) for part in _by_length(samples)]

    def values(self, run: Run) -> FloatArray:
        """Values of the c metrics, (c, n); NaN for a scenario that cannot be driven.

        In a departure that failed a value is at least as bad as that of its recorded path, as it is in S.
        """
        over, out = self._over, self._without.copy()
        if run.trajectories is None:  # no control acted
            out[:, over.rows] = self._of_recorded(over.rows)
            return out
        for batch in self._batches:
            out[:, batch.rows] = self._measured(batch.with_run(run.trajectories))
        failed = over.rows[np.isin(run.status, FAILURES)]
        recorded = self._of_recorded(failed)
        for metric, values, bound in zip(self._metrics, out, recorded, strict=True):
            values[failed] = (np.maximum if metric.better == "less" else np.minimum)(values[failed], bound)
        return out

    @functools.cached_property
    def _without(self) -> FloatArray:
        """Values of the departures that are never taken over, (c, n)."""
        out = np.full((len(self._metrics), self._over.scenarios.n), np.nan)
        rows = np.flatnonzero(self._over.valid & ~np.isfinite(self._over.t_s))
        out[:, rows] = self._of_recorded(rows)
        return out

    def _of_recorded(self, rows: IntArray) -> FloatArray:
        """Values of the recorded paths of some scenarios from their start to T, (c, r)."""
        out = np.empty((len(self._metrics), rows.size))
        samples = np.floor(self._over.path.scenarios.T[rows] / self._dt + _SAME).astype(np.int64) + 1
        for part, k in _by_length(samples):
            first, counts = np.zeros(part.size), samples[part]
            out[:, part] = self._measured(self._recorded(rows[part], first, counts, counts, k))
        return out

    def _measured(self, paths: Paths) -> FloatArray:
        return np.stack([checked_values(metric, paths) for metric in self._metrics])

    def _recorded(self, rows: IntArray, first: FloatArray, known: IntArray, samples: IntArray, k: int) -> Paths:
        """Recorded paths of g scenarios in arrays (g, k): a grid of `samples` (g,) from `first` (g,), a path `known`
        (g,) samples long.
        """
        over, path = self._over, self._over.path.take(rows)
        t, number = first[:, None] + self._dt * np.arange(k), np.arange(k)
        short = t[:, : int(known.max())]
        x, delta = over.recorded_motion(short, rows)
        v, curvature, T = path.speed(t), path.curvature(t), path.scenarios.T[:, None]
        a_y = path.lateral_acceleration(short) + (v**2 * curvature)[:, : short.shape[1]]

        def laid(values: FloatArray) -> FloatArray:
            out = np.full(t.shape, np.nan)
            out[:, : short.shape[1]] = np.where(number[: short.shape[1]] < known[:, None], values, np.nan)
            return out

        on_grid = number < samples[:, None]
        e_y, e_y_rate, e_psi, e_psi_rate = (laid(x[:, :, j]) for j in range(4))
        angle, e_y_recorded = laid(delta), path.lateral(t) + over.setup.vehicle.edge_offset
        return Paths(
            t=np.where(on_grid, t, np.nan),
            e_y=e_y,
            e_y_rate=e_y_rate,
            e_psi=e_psi,
            e_psi_rate=e_psi_rate,
            delta=angle,
            command=angle,
            a_y=laid(a_y),
            v=np.where(on_grid, v, np.nan),
            curvature=np.where(on_grid, curvature, np.nan),
            e_y_recorded=np.where(on_grid & (t <= T + _SAME), e_y_recorded, np.nan),
            T=T[:, 0],
            t_s=np.full(rows.size, np.inf),
            side=path.scenarios.side,
            dt=self._dt,
            vehicle=over.setup.vehicle,
        )

    def _of_triggered(self, part: IntArray, k: int) -> _Batch:
        """A batch of driven scenarios, by their positions among these."""
        over, rows, before = self._over, self._over.rows[part], self._before[part]
        full, rest, steps = over.full_steps[part], over.rest[part], over.steps[part]
        count = steps + (rest == 0.0)
        first = np.maximum(over.start[part] - self._dt * before, 0.0)
        paths = self._recorded(rows, first, before, before + count, k)
        driven = (np.arange(k) >= before[:, None]) & np.isfinite(paths.t)
        # after the trigger the loop drives the fitted speed and curvature, of recorded paths too
        fitted = dataclasses.replace(over.path.take(rows), recorded=None)
        v = over.plant.v[part][:, None] if over.setup.options.speed == "frozen" else fitted.speed(paths.t)
        curvature = fitted.curvature(paths.t) if over.path.recorded is not None else paths.curvature
        row, place = np.nonzero(driven)
        column = place - before[row]
        # the paths of a run have T between two samples as an entry of its own
        column += (column > full[row]) & ((rest > 0.0) & (steps - 1 > full))[row]
        return _Batch(
            rows,
            dataclasses.replace(
                paths,
                v=np.where(driven, v, paths.v),
                curvature=np.where(driven, curvature, paths.curvature),
                t_s=over.start[part],
            ),
            part[row],
            column,
            row * k + place,
        )


_SAME: Final = 1e-9  # of a sample, or a time [s]


def _by_length(samples: IntArray) -> Iterator[tuple[IntArray, int]]:
    """Positions of the departures of about one length, and the width of their arrays."""
    width = -(-samples // _WIDTH) * _WIDTH
    for k in np.unique(width).tolist():
        yield np.flatnonzero(width == k), k


def checked_values(metric: UserMetric, paths: Paths) -> FloatArray:
    """What a metric gives for n departures, (n,); `LdcError` where it raises, or gives anything else."""
    try:
        values: Any = metric(paths)
    except LdcError as error:
        raise error if error.path.startswith("metric ") else error.within(f"metric {metric.name}", ": ") from None
    except Exception as error:  # a metric may be third-party code
        raise LdcError(f"metric {metric.name}", f"{type(error).__name__}: {first_line(error)}") from error
    array = np.asarray(unmasked(values))
    if array.shape != (paths.n,) or array.dtype.kind not in "fiub":
        given = f"gives {array.dtype} of shape {array.shape}" if array.dtype != object else f"gives {short(values)}"
        raise LdcError(f"metric {metric.name}", given, allowed=f"numbers of shape ({paths.n},), one a departure")
    return array.astype(np.float64)
