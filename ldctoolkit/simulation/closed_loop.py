"""The closed loop over all scenarios at once: linear laws in one tight loop, other laws through `SteeringLaw.step`.

State is kept as four arrays of n and every product is an elementwise operation, so that a scenario's numbers cannot
depend on which others run beside it.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller, EventStatus, LinearLaw, RecordedPath, SteeringLaw
from ldctoolkit.law_checks import check_controller, check_law, check_step
from ldctoolkit.simulation.crossings import absolute_area
from ldctoolkit.simulation.outcome import Run, Trajectories
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.vehicle import Discretization

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

BOUND = 20.0
"""|e_y| [m] at which a scenario counts as diverged; from there on the bound itself is scored, so S stays finite."""


def drive(controller: Controller, takeover: Takeover, *, trajectories: bool = False) -> Run:
    """Drive one design from the trigger to the end of every departure.

    Parameters
    ----------
    controller : Controller
        The design.
    takeover : Takeover
        Scenarios at their triggers.
    trajectories : bool
        Keep the paths.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If the design, its law or the result of a step is not what the interface promises.
    """
    check_controller(controller)
    law = check_law(controller.prepare(takeover.plant), takeover.m, controller.name)
    if isinstance(law, RecordedPath):
        zeros = np.zeros(takeover.m, dtype=np.int64)
        return Run(takeover, None, zeros.astype(np.int8), zeros, takeover.triggered.d_y.copy(), None)
    loop = _Loop.start(takeover, trajectories)
    if isinstance(law, LinearLaw):
        _drive_linear(law, takeover, loop)
    else:
        _drive_general(law, takeover, loop, controller.name)
    return loop.finish()


@dataclasses.dataclass
class _Loop:
    """Working arrays of one run; local to it."""

    takeover: Takeover
    x: list[FloatArray]
    delta_prev: FloatArray
    area: FloatArray
    deepest: FloatArray
    alive: npt.NDArray[np.bool_]
    all_alive: bool
    failed: IntArray
    log: _Log | None

    @classmethod
    def start(cls, takeover: Takeover, trajectories: bool) -> _Loop:
        m = takeover.m
        x = [np.array(column) for column in takeover.x_0.T]
        return cls(
            takeover=takeover,
            x=x,
            delta_prev=takeover.delta_0.copy(),
            area=np.zeros(m),
            deepest=x[0].copy(),
            alive=np.ones(m, dtype=bool),
            all_alive=True,
            failed=np.zeros(m, dtype=np.int64),
            log=_Log.start(takeover) if trajectories else None,
        )

    def advance(self, step: Discretization, delta: FloatArray, t: FloatArray, h: FloatArray) -> None:
        """One step of the first ``delta.size`` scenarios."""
        k = delta.size
        x0, x1, x2, x3 = (column[:k] for column in self.x)
        r_0 = self.takeover.yaw_rate(t, k)
        r_1 = self.takeover.yaw_rate(t + h, k)
        A, B, E_0, E_1, area_x = step.A[:k], step.B[:k], step.E_0[:k], step.E_1[:k], step.area_x[:k]
        # e_y feeds back into nothing: the first column of A is (1, 0, 0, 0)
        new = [
            A[:, i, 1] * x1 + A[:, i, 2] * x2 + A[:, i, 3] * x3 + B[:, i] * delta + E_0[:, i] * r_0 + E_1[:, i] * r_1
            for i in range(4)
        ]
        new[0] += x0
        signed = area_x[:, 0] * x0 + area_x[:, 1] * x1 + area_x[:, 2] * x2 + area_x[:, 3] * x3
        signed += step.area_delta[:k] * delta + step.area_r_0[:k] * r_0 + step.area_r_1[:k] * r_1
        if not np.max(np.abs(new[0]), initial=0.0) <= BOUND:  # also true for NaN
            self._end_diverged(new, t)
        if not self.all_alive:
            for column in (*new, signed):
                column[~self.alive[:k]] = 0.0
        part = np.abs(signed)
        rows = np.flatnonzero(x0 * new[0] < 0)
        if rows.size:
            start, end = (np.column_stack([column[rows] for column in state]) for state in ((x0, x1, x2, x3), new))
            v, model = self.takeover.plant.v[rows], self.takeover.plant.model
            part[rows] = absolute_area(model, v, start, end, signed[rows], delta[rows], r_0[rows], r_1[rows], h[rows])
        self.area[:k] += part
        for column, value in zip(self.x, new, strict=True):
            column[:k] = value
        self.deepest[:k] = np.maximum(self.deepest[:k], new[0])
        self.delta_prev[:k] = delta

    def _end_diverged(self, new: list[FloatArray], t: FloatArray) -> None:
        """Score the bound from the start of the step that leaves it."""
        k = new[0].size
        rows = np.flatnonzero(self.alive[:k] & ~(np.abs(new[0]) <= BOUND))
        self.area[rows] += BOUND * (self.takeover.triggered.T[rows] - t[rows])
        inwards = new[0][rows] < 0
        self.deepest[rows] = np.where(inwards, self.deepest[rows], BOUND)
        self.alive[rows] = False
        self.all_alive = False

    def record(self, sample: IntArray | int, rows: IntArray, t: FloatArray, delta: FloatArray) -> None:
        """Command from `sample` on, and the state it led to at time t, for those that have not diverged."""
        if self.log is not None:
            alive = self.alive[rows]
            at = sample if isinstance(sample, int) else sample[alive]
            self.log.put(at, rows[alive], t[alive], self.x, delta[alive])

    def finish(self) -> Run:
        status = np.where(self.failed > 0, EventStatus.SOLVER_FAILED, EventStatus.OK)
        status = np.where(self.alive, status, EventStatus.DIVERGED).astype(np.int8)
        edge = self.takeover.plant.model.parameters.edge_offset
        paths = None if self.log is None else Trajectories(self.log.t, self.log.x, self.log.delta)
        return Run(self.takeover, self.area, status, self.failed, self.deepest - edge, paths)


@dataclasses.dataclass
class _Log:
    """Paths of a run, filled step by step."""

    t: FloatArray
    x: FloatArray
    delta: FloatArray

    @classmethod
    def start(cls, takeover: Takeover) -> _Log:
        longest = int(takeover.full_steps[0]) + 2 if takeover.m else 1
        shape = (takeover.m, longest)
        log = cls(np.full(shape, np.nan), np.full((*shape, 4), np.nan), np.full(shape, np.nan))
        log.t[:, 0] = takeover.start
        log.x[:, 0] = takeover.x_0
        return log

    def put(self, k: IntArray | int, rows: IntArray, t: FloatArray, x: list[FloatArray], delta: FloatArray) -> None:
        """Command `delta` from sample k on, which leads to state x at time t of sample k + 1."""
        self.delta[rows, k] = delta
        self.t[rows, k + 1] = t
        for i, column in enumerate(x):
            self.x[rows, k + 1, i] = column[rows]


def _counts(takeover: Takeover) -> IntArray:
    """How many scenarios still have a whole step at each sample; they are the first ones, the order is descending."""
    longest = int(takeover.full_steps[0]) if takeover.m else 0
    return np.searchsorted(-takeover.full_steps, -np.arange(longest), side="left")


def _drive_linear(law: LinearLaw, takeover: Takeover, loop: _Loop) -> None:
    dt, step = takeover.plant.dt, _contiguous(takeover.plant.step)
    F = np.ascontiguousarray(law.F.T)
    G_rate, G_heading = np.ascontiguousarray(law.G_yaw_rate.T), np.ascontiguousarray(law.G_heading.T)
    uses_rate, uses_heading = bool(np.any(G_rate)), bool(np.any(G_heading))
    uses_previous = bool(np.any(law.f_u))

    def command(k: int, t: FloatArray, driven: npt.NDArray[np.bool_]) -> FloatArray:
        x0, x1, x2, x3 = (column[:k] for column in loop.x)
        delta = F[0, :k] * x0 + F[1, :k] * x1 + F[2, :k] * x2 + F[3, :k] * x3
        if uses_rate or uses_heading:
            preview = takeover.preview(t, law.preview_times, k)
            for j in range(law.preview_times.size):
                if uses_rate:
                    delta += G_rate[j, :k] * preview.yaw_rate[:, j]
                if uses_heading:
                    delta += G_heading[j, :k] * preview.heading[:, j]
        if uses_previous:
            delta += law.f_u[:k] * loop.delta_prev[:k]
        if not np.isfinite(delta).all():
            bad = ~np.isfinite(delta)
            delta[bad] = loop.delta_prev[:k][bad]
            loop.failed[:k][bad & loop.alive[:k] & driven[:k]] += 1
        return delta

    everyone = np.ones(takeover.m, dtype=bool)
    for sample, k in enumerate(_counts(takeover)):
        t = takeover.start[:k] + sample * dt
        delta = command(int(k), t, everyone)
        h = np.full(int(k), dt)
        loop.advance(step, delta, t, h)
        loop.record(sample, np.arange(int(k)), t + dt, delta)
    end = takeover.start + takeover.full_steps * dt
    _last_step(takeover, loop, command(takeover.m, end, takeover.rest > 0))


def _last_step(takeover: Takeover, loop: _Loop, delta: FloatArray) -> None:
    """The step of length `rest` that brings every scenario to its own T."""
    t = takeover.start + takeover.full_steps * takeover.plant.dt
    loop.advance(_contiguous(takeover.last), delta, t, takeover.rest)
    rows = np.flatnonzero(takeover.rest > 0)
    loop.record(takeover.full_steps[rows], rows, takeover.triggered.T[rows], delta[rows])


def _contiguous(step: Discretization) -> Discretization:
    """The same step with the scenario axis last in memory: columns of n are read in one go."""

    def turn(values: FloatArray) -> FloatArray:
        return np.moveaxis(np.ascontiguousarray(np.moveaxis(values, 0, -1)), -1, 0)

    return Discretization(**{f.name: turn(getattr(step, f.name)) for f in dataclasses.fields(step)})


def _drive_general(law: SteeringLaw, takeover: Takeover, loop: _Loop, name: str) -> None:
    m, dt, step = takeover.m, takeover.plant.dt, _contiguous(takeover.plant.step)
    times = law.preview_times
    state = law.init(m)
    last = takeover.delta_0.copy()
    counts = _counts(takeover)
    for sample in range(counts.size + 1):
        k = int(counts[sample]) if sample < counts.size else 0
        # a scenario takes part while it has a whole step or its last one left
        part = (takeover.full_steps > sample) | ((takeover.full_steps == sample) & (takeover.rest > 0))
        t = takeover.start + np.minimum(sample, takeover.full_steps) * dt
        preview = takeover.preview(t, times)
        x = np.column_stack(loop.x)
        idle = ~(part & loop.alive)
        x[idle] = 0.0
        preview.yaw_rate[idle] = 0.0
        preview.heading[idle] = 0.0
        result = law.step(t, x, preview, np.where(idle, 0.0, loop.delta_prev), state)
        delta, state, status = check_step(result, m, name)
        bad = ~np.isfinite(delta)
        delta[bad] = loop.delta_prev[bad]
        loop.failed[(bad | (status == EventStatus.SOLVER_FAILED)) & ~idle] += 1
        last = np.where(takeover.full_steps == sample, delta, last)
        if k:
            loop.advance(step, delta[:k], t[:k], np.full(k, dt))
            loop.record(sample, np.arange(k), t[:k] + dt, delta[:k])
    _last_step(takeover, loop, last)
