"""What a simulation returns: scores over a window, and paths."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import numpy.typing as npt

import ldctoolkit.metrics as metrics
from ldctoolkit.arrays import BoolArray, FloatArray, Frame, IntArray, ReadOnly
from ldctoolkit.control import EventStatus, SolverLog
from ldctoolkit.departures import LEFT
from ldctoolkit.notebook import outcome_html

if TYPE_CHECKING:
    import polars as pl

    from ldctoolkit.paths.uncorrected import UncorrectedPath

Window = Literal["departure", "control"]
STATUS_NAMES = np.array([one.name.lower() for one in EventStatus])  # by the number of each


@dataclasses.dataclass(frozen=True, repr=False)
class Trajectories(ReadOnly):
    """Paths of c chosen scenarios at the controller's samples and at the departure's end T.

    `x` and `delta` are in the outward frame of the departure: those to the right are mirrored, so that e_y, e_psi and
    the steering angle are positive to the right there. `world` gives them on their true side.

    NaN after the end of the settling horizon, after the last sample inside the bound where a scenario diverged, and
    everywhere where it never triggered.
    """

    rows: IntArray  # (c,) Row numbers of the scenarios
    t: FloatArray  # (c, k) [s] Time since the departure's start; the first column is the trigger
    x: FloatArray  # (c, k, 4) State (e_y, de_y/dt, e_psi, de_psi/dt)
    delta: FloatArray  # (c, k) [rad] Steering angle of the wheel just after that time; in the last entry, at it
    path: UncorrectedPath  # Of the chosen scenarios, with the lane and the speed that are driven
    v: FloatArray  # (c,) [m/s] Speed where the plant keeps that of the trigger; NaN where it follows the path's

    def world(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position and heading in the plane, on the true side and along the lane's curvature; axes as in ISO 8855.

        The origin is the lane's centre beside the vehicle at the trigger, x points along the lane there and y to the
        left. Like the plant, this passes the lane's centre line at the vehicle's speed.

        Returns
        -------
        x, y, heading : (c, k) [m], [m], [rad]
            Centre of gravity, and the angle of the body from the x axis, positive to the left; NaN as in `x`.

        Examples
        --------
        >>> import ldctoolkit as ldc
        >>> right = ldc.Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=25.0, side=-1)
        >>> paths = ldc.simulate(ldc.LQR(), right, trajectories=True).trajectories
        >>> x, y, heading = paths.world()
        >>> bool(paths.x[0, 0, 0] > 0.0), bool(y[0, 0] < 0.0)
        (True, True)
        """
        from scipy.integrate import cumulative_simpson

        known = np.isfinite(self.t)
        step = float(np.diff(self.t).max(initial=_FINE, where=known[:, 1:]))
        parts = math.ceil(step / _FINE)
        last = np.where(known, self.t, 0.0).max(axis=1)[:, None]
        t = np.where(known, self.t, last + step * np.arange(known.shape[1]))  # unknown times go on rising
        inside = t[:, :-1, None] + np.diff(t)[:, :, None] * (np.arange(parts) / parts)
        fine = np.column_stack([inside.reshape(t.shape[0], -1), t[:, -1]])
        v = np.where(np.isnan(self.v)[:, None], self.path.speed(fine), self.v[:, None])
        side = self.path.scenarios.side[:, None]
        turn = cumulative_simpson(side * v * self.path.curvature(fine), x=fine, initial=0.0)
        x, y = (cumulative_simpson(v * wave(turn), x=fine, initial=0.0)[:, ::parts] for wave in (np.cos, np.sin))
        lane, e_y, e_psi = turn[:, ::parts], side * self.x[:, :, 0], side * self.x[:, :, 2]
        return x - e_y * np.sin(lane), y + e_y * np.cos(lane), lane + e_psi


_FINE: Final = 0.01  # [s] step of the integrals along the lane


@dataclasses.dataclass(frozen=True, repr=False)
class Outcome(Frame):
    """Scores of one design on n scenarios.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> outcome = ldc.simulate(ldc.LQR(), ldc.load_model("reference").sample(5, 5, seed=1), y_s=0.1)
    >>> outcome.S.shape, bool(outcome.mean_reduction > 0)
    ((10,), True)
    """

    window: Window  # Over which S is integrated: [0, T], or from the trigger to T
    S: FloatArray  # (n,) [m s] Integral of |e_y| under the design
    S_uncorrected: FloatArray  # (n,) [m s] The same of the recorded path
    triggered: BoolArray  # (n,)
    status: npt.NDArray[np.int8]  # (n,) `EventStatus`
    t_s: FloatArray  # (n,) [s] Trigger time, infinite where never triggered
    companions: metrics.MetricValues  # Depth, way back, acceleration, jerk and steering, arrays of n
    failed_solves: IntArray  # (n,) Commands that came from the fallback law
    # [s] Wall time of the law's own steps, all scenarios together, not reproducible; 0 for a linear law
    law_seconds: float
    # On request; None where no control acted, since there is no path but the recorded one
    trajectories: Trajectories | None
    # Every solver call of a law that has a solver
    solver_log: SolverLog = dataclasses.field(default_factory=lambda: SolverLog.of([]))
    side: IntArray | None = None  # (n,) ``LEFT`` (+1) or ``RIGHT`` (-1), the scenarios' own

    def _repr_html_(self) -> str:
        """What a notebook shows; means leave out scenarios that cannot be driven."""
        scores = self.S, self.S_uncorrected, self.deepest
        return outcome_html(self.window, *scores, self.status, self.failed_solves, self.side)

    def to_polars(self) -> pl.DataFrame:
        """One row a scenario: scores, trigger time (infinite where never triggered), status and every metric."""
        import polars as pl

        scores = {f"S_{self.window}_m_s": self.S, f"S_uncorrected_{self.window}_m_s": self.S_uncorrected}
        return pl.DataFrame(
            ({} if self.side is None else {"side": np.where(self.side == LEFT, "left", "right")})
            | scores
            | {"t_s_s": self.t_s}
            | {"status": STATUS_NAMES[self.status], "failed_solves": self.failed_solves}
            | {column: getattr(self.companions, name) for name, column in metrics.METRIC_COLUMNS.items()}
        )

    def __repr__(self) -> str:
        counts = {one.name.lower(): np.count_nonzero(self.status == one) for one in EventStatus if one}
        bad = (f", {count:,} {name}" for name, count in counts.items() if count)
        return (
            f"<Outcome of {self.S.size:,} scenarios, {self.window} window: mean S {np.mean(self.S):.4f} m s, "
            f"{np.mean(self.S_uncorrected):.4f} m s without control{''.join(bad)}>"
        )

    @property
    def deepest(self) -> FloatArray:
        """Deepest position of the edge beyond the line, (n,) [m]."""
        return self.companions.deepest

    @property
    def reduction(self) -> FloatArray:
        """1 - S/S_uncorrected per scenario, 0 where there was nothing to reduce."""
        return metrics.reduction(self.S, self.S_uncorrected)

    @property
    def mean_reduction(self) -> float:
        """1 - mean S / mean S_uncorrected over all scenarios, as the paper reports it; NaN where one is not valid."""
        total = float(np.sum(self.S_uncorrected))
        if math.isnan(total):
            return math.nan
        return 1.0 - float(np.sum(self.S)) / total if total > 0 else 0.0

    def count(self, status: EventStatus) -> int:
        """Number of scenarios with that status."""
        return int(np.sum(self.status == status))
