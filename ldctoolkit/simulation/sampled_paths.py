"""Paths as designers' metrics see them: departures from their start to their end on a grid of samples.

A metric gets the departures of about one length at a time, in arrays whose width follows from the departure's own
length alone: no number depends on which other departures are measured with it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray, Rows, unmasked
from ldctoolkit.errors import LdcError, first_line, short
from ldctoolkit.simulation.kernel import data
from ldctoolkit.simulation.loop import FAILURES, Run
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

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> @ldc.metric(unit="s")
    ... def time_outside(paths: ldc.Paths):
    ...     return paths.dt * (paths.distance < -0.2).sum(axis=1)
    >>> time_outside.rows["time_outside_p95"].column
    'time_outside_p95_s'
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
_DRIVEN: Final = {
    "e_y": data.P_X, "e_y_rate": data.P_X + 1, "e_psi": data.P_X + 2, "e_psi_rate": data.P_X + 3,
    "delta": data.P_DELTA, "command": data.P_COMMAND, "a_y": data.P_A_Y,
}  # fmt: skip
_SAME: Final = 1e-9  # of a sample, or a time [s]


@dataclasses.dataclass(frozen=True)
class _Batch:
    """Departures of about one length: their paths without control, and where the entries of a run's paths belong."""

    rows: IntArray  # (g,) Rows of the scenarios
    paths: Paths  # The recorded ones, up to the trigger where there is one
    # (e,) Entries of a run's paths: position in an array (m, entries), and in an array (g, k), that are laid flat
    source: IntArray
    place: IntArray

    def with_run(self, driven: FloatArray) -> Paths:
        """The paths with what a run drove, (m, entries, PATH)."""
        if not self.source.size:
            return self.paths
        entries = driven.reshape(-1, data.PATH).take(self.source, axis=0)
        arrays = {name: getattr(self.paths, name).copy() for name in _DRIVEN}
        for name, column in _DRIVEN.items():
            arrays[name].reshape(-1)[self.place] = entries[:, column]
        ended = np.isnan(entries[:, data.P_TIME])
        for name in _GRID if ended.any() else ():
            arrays[name] = getattr(self.paths, name).copy()
            arrays[name].reshape(-1)[self.place[ended]] = np.nan
        return dataclasses.replace(self.paths, **arrays)


class PathSampler:
    """The paths of the designs of one takeover, and what designers' metrics make of them; n scenarios."""

    def __init__(self, over: Takeover, metrics: Sequence[UserMetric], *, controlled: bool = True) -> None:
        self.over, self._metrics, self._controlled = over, metrics, controlled
        self._entries = int(over.steps.max(initial=0)) + 2  # of a path of a run

    @functools.cached_property
    def _batches(self) -> list[_Batch]:
        over, position = self.over, np.full(self.over.scenarios.n, -1)  # among the driven scenarios
        if self._controlled:
            position[over.rows] = np.arange(over.m)
        rows = np.flatnonzero(over.valid)
        # samples of the recorded path, and of all; a last step that is shorter ends beside the grid
        recorded, dt = np.where(position < 0, over.path.scenarios.T, over.t_s)[rows], over.setup.dt
        before = np.floor(recorded / dt + _SAME).astype(np.int64) + (position[rows] < 0)
        samples = before.copy()
        samples[position[rows] >= 0] += (over.steps + (over.rest == 0.0))[position[rows][position[rows] >= 0]]
        width, alone = -(-samples // _WIDTH) * _WIDTH, position[rows] < 0
        kinds = sorted({*zip(width.tolist(), alone.tolist(), strict=True)})
        parts = [(np.flatnonzero((width == k) & (alone == never)), k) for k, never in kinds]
        return [self._batch(rows[i], position[rows[i]], before[i], samples[i], k) for i, k in parts]

    def parts(self, run: Run) -> Iterator[tuple[IntArray, Paths]]:
        """Rows of the scenarios (g,) and their paths, of about one length at a time, of a run with paths."""
        if run.paths is not None:
            for batch in self._batches:
                yield batch.rows, batch.with_run(run.paths[0])

    @functools.cached_property
    def recorded(self) -> FloatArray:
        """Values of the c metrics on the recorded paths, from their start to T, (c, n)."""
        batches = PathSampler(self.over, self._metrics, controlled=False)._batches if self._metrics else []
        return self._measured((batch.rows, batch.paths) for batch in batches)

    def values(self, run: Run) -> FloatArray:
        """Values of the c metrics, (c, n), of a run with paths; NaN for a scenario that cannot be driven.

        In a departure that failed a value is at least as bad as that of its recorded path, as it is in S.
        """
        if run.paths is None:  # no control acted
            return self.recorded
        out = self._measured(self.parts(run))
        failed = self.over.rows[np.isin(run.status, FAILURES)]
        for metric, values, bound in zip(self._metrics, out, self.recorded if failed.size else out, strict=True):
            values[failed] = (np.maximum if metric.better == "less" else np.minimum)(values[failed], bound[failed])
        return out

    def _measured(self, parts: Iterable[tuple[IntArray, Paths]]) -> FloatArray:
        out = np.full((len(self._metrics), self.over.scenarios.n), np.nan)
        for rows, paths in parts:
            for values, metric in zip(out, self._metrics, strict=True):
                values[rows] = checked_values(metric, paths)
        return out

    def _batch(self, rows: IntArray, position: IntArray, before: IntArray, samples: IntArray, k: int) -> _Batch:
        """Scenarios `rows`, `position` among the driven ones or -1: `before` samples of the recorded path, `samples` in
        all, in arrays of k; (g,) each.
        """
        over, dt, number, path = self.over, self.over.setup.dt, np.arange(k), self.over.path.take(rows)
        t_s = np.where(position < 0, np.inf, over.t_s[rows])
        t = np.where(position < 0, 0.0, np.maximum(over.t_s[rows] - dt * before, 0.0))[:, None] + dt * number
        recorded, on_grid = number < before[:, None], number < samples[:, None]
        driven, T = on_grid & ~recorded & (position >= 0)[:, None], path.scenarios.T
        # the recorded path is known up to the trigger, its position up to T
        p, q = int(before.max()), min(int(T.max() / dt) + 2, k)
        v, curvature = path.speed(t), path.curvature(t)
        x, delta = over.recorded_motion(t[:, :p], rows)
        a_y = path.lateral_acceleration(t[:, :p]) + (v**2 * curvature)[:, :p]
        if path.recorded is not None:  # after the trigger the loop drives fitted signals
            fitted = dataclasses.replace(path, recorded=None)
            v, curvature = np.where(driven, [fitted.speed(t), fitted.curvature(t)], [v, curvature])
        if over.setup.options.speed == "frozen" and over.m:
            v = np.where(driven, over.plant.v[position][:, None], v)

        def kept(values: FloatArray, where: BoolArray) -> FloatArray:
            out = np.full(t.shape, np.nan)
            np.copyto(out[:, : values.shape[1]], values, where=where[:, : values.shape[1]])
            return out

        e_y, e_y_rate, e_psi, e_psi_rate, delta, a_y = (
            kept(values, recorded) for values in (*np.moveaxis(x, 2, 0), delta, a_y)
        )
        e_y_recorded = path.lateral(t[:, :q]) + over.setup.vehicle.edge_offset
        paths = Paths(
            kept(t, on_grid), e_y, e_y_rate, e_psi, e_psi_rate, delta, delta, a_y, kept(v, on_grid),
            kept(curvature, on_grid), kept(e_y_recorded, on_grid & (t <= T[:, None] + _SAME)), T, t_s,
            path.scenarios.side, dt, over.setup.vehicle,
        )  # fmt: skip
        i, place = np.nonzero(driven)
        row, column = position[i], place - before[i]
        # the paths of a run have T between two samples as an entry of its own
        column += (
            (column > over.full_steps[row]) & (over.rest[row] > 0.0) & (over.steps[row] - 1 > over.full_steps[row])
        )
        return _Batch(rows, paths, row * self._entries + column, i * k + place)


def checked_values(metric: UserMetric, paths: Paths) -> FloatArray:
    """What a metric gives for n departures, (n,); `LdcError` where it raises, or gives anything else."""
    try:
        values: Any = metric(paths)
    except LdcError as error:
        raise error if error.path == f"metric {metric.name}" else error.within(f"metric {metric.name}", ": ") from None
    except Exception as error:  # a metric may be third-party code
        raise LdcError(f"metric {metric.name}", f"{type(error).__name__}: {first_line(error)}") from error
    array = np.asarray(unmasked(values))
    if array.shape != (paths.n,) or array.dtype.kind not in "fiub":
        given = f"gives {array.dtype} of shape {array.shape}" if array.dtype != object else f"gives {short(values)}"
        raise LdcError(f"metric {metric.name}", given, allowed=f"numbers of shape ({paths.n},), one per departure")
    return array.astype(np.float64)
