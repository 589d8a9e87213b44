"""What a simulation returns: raw runs, and outcomes scored over a window."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit import metrics
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus, SolverLog
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.notebook import outcome_html
from ldctoolkit.simulation.takeover import Takeover

Window = Literal["departure", "control"]


@dataclasses.dataclass(frozen=True)
class Trajectories:
    """Paths of c chosen scenarios at the controller's samples and at the departure's end T.

    NaN after the end of the settling horizon, after the last sample inside the bound where a scenario diverged, and
    everywhere where it never triggered.
    """

    rows: IntArray  # (c,) int Row numbers of the scenarios
    t: FloatArray  # (c, k) [s] Time since the departure's start; the first column is the trigger
    x: FloatArray  # (c, k, 4) State (e_y, de_y/dt, e_psi, de_psi/dt)
    delta: FloatArray  # (c, k) [rad] Steering angle of the wheel just after that time; in the last entry, at it


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Scores of one design on n scenarios."""

    window: Window  # Over which S is integrated: [0, T], or from the trigger to T
    S: FloatArray  # (n,) [m s] Integral of |e_y| under the design
    S_uncorrected: FloatArray  # (n,) [m s] The same of the recorded path
    triggered: BoolArray  # (n,) bool
    status: npt.NDArray[np.int8]  # (n,) int8 `EventStatus`
    t_s: FloatArray  # (n,) [s] Trigger time, infinite where never triggered
    companions: metrics.MetricValues  # Depth, way back, acceleration, jerk and steering, arrays of n
    failed_solves: IntArray  # (n,) int Commands that came from the fallback law
    # [s] Wall time of the law's own steps, all scenarios together, not reproducible; 0 for a linear law
    law_seconds: float
    # On request; None where no control acted, since there is no path but the recorded one
    trajectories: Trajectories | None
    # Every solver call of a law that has a solver
    solver_log: SolverLog = dataclasses.field(default_factory=lambda: SolverLog.of([]))
    side: IntArray | None = None  # (n,) int ``LEFT`` (+1) or ``RIGHT`` (-1), the scenarios' own

    def _repr_html_(self) -> str:
        """What a notebook shows; means leave out scenarios that cannot be driven."""
        scores = self.S, self.S_uncorrected, self.deepest
        return outcome_html(self.window, *scores, self.status, self.failed_solves, self.side)

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


@dataclasses.dataclass(frozen=True)
class Run:
    """One design driven from the trigger on: m triggered scenarios in the takeover's order."""

    takeover: Takeover
    area: FloatArray | None  # (m,) [m s] Integral of |e_y| from the trigger to T; None where no control acted
    status: npt.NDArray[np.int8]  # As in `Outcome`, arrays of m
    failed_solves: IntArray  # As in `Outcome`, arrays of m
    companions: metrics.MetricValues  # As in `Outcome`, arrays of m
    law_seconds: float  # As in `Outcome`, arrays of m
    trajectories: Trajectories | None  # Of chosen ones of all n scenarios
    solver_log: SolverLog = dataclasses.field(default_factory=lambda: SolverLog.of([]))  # As in `Outcome`, arrays of m

    def columns(self, windows: Sequence[Window]) -> FloatArray:
        """S and S_uncorrected of each of w windows, then the c companions, of the recorded paths, (2 w + c, n)."""
        over = self.takeover
        scores = [over.S_uncorrected - (over.S_before if window == "control" else 0.0) for window in windows]
        recorded = [getattr(over.recorded, name) for name in metrics.METRIC_UNITS]
        return np.stack([*(S for S in scores for _ in range(2)), *recorded])

    def fill(self, out: FloatArray, windows: Sequence[Window]) -> None:
        """Write this run's numbers over those of `columns`: the same bits as in `outcome`, without its copies."""
        over, rows = self.takeover, self.takeover.rows
        if self.area is not None:
            for w, window in enumerate(windows):
                out[2 * w, rows] = self.area + (over.S_before[rows] if window == "departure" else 0.0)
        for i, name in enumerate(metrics.METRIC_UNITS, start=2 * len(windows)):
            out[i, rows] = getattr(self.companions, name)

    def outcome(self, window: Window) -> Outcome:
        """Score the run over a window, with the scenarios in their own order; raises InputError for an unknown one."""
        if window not in get_args(Window):
            raise InputError(f"window: {window!r}; {nearest(str(window), get_args(Window))}")
        over, rows = self.takeover, self.takeover.rows
        values = self.columns((window,))
        self.fill(values, (window,))
        status = np.where(over.valid, EventStatus.NEVER_TRIGGERED, EventStatus.INVALID).astype(np.int8)
        status[rows] = self.status
        failed = np.zeros(over.scenarios.n, dtype=np.int64)
        failed[rows] = self.failed_solves
        return Outcome(
            window=window,
            # copies: a caller that keeps S alone does not keep the rest
            S=values[0].copy(),
            S_uncorrected=values[1].copy(),
            triggered=np.isfinite(over.t_s),
            status=status,
            t_s=over.t_s,
            companions=metrics.MetricValues(**dict(zip(metrics.METRIC_UNITS, values[2:], strict=True))),
            failed_solves=failed,
            law_seconds=self.law_seconds,
            trajectories=self.trajectories,
            solver_log=self.solver_log.renamed(rows),
            side=over.scenarios.side,
        )
