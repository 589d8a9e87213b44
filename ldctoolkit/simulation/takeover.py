"""The moment the controller takes over: trigger time, start state, what was scored before (paper, section IV)."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Preview
from ldctoolkit.departures import (
    crossing_time,
    curvature,
    curvature_integral,
    lateral,
    lateral_acceleration,
    lateral_integral,
    lateral_rate,
    speed,
)
from ldctoolkit.errors import InputError, nearest
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.vehicle import BicycleModel, Discretization, Plant

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
InitialYawRate = Literal["path", "zero"]

# a remainder shorter than this is rounding of T - t_s, not a step to be driven
_SHORTEST_STEP = 1e-12


@dataclasses.dataclass(frozen=True)
class Takeover:
    """The m triggered of n scenarios at their trigger times, sorted so that the longest control comes first.

    Attributes
    ----------
    scenarios : Scenarios
        All n.
    y_s : float [m]
        Trigger threshold.
    rows : (m,) int
        Which scenarios triggered, in the order used by every array below.
    t_s : (n,) [s]
        Trigger time, infinite where never triggered.
    S_uncorrected : (n,) [m s]
        Score of the recorded path over the whole departure.
    S_before : (n,) [m s]
        Its part before the trigger; all of it where never triggered.
    triggered : Scenarios
        The m rows.
    start : (m,) [s]
        Their trigger times.
    x_0 : (m, 4)
        Start states.
    delta_0 : (m,) [rad]
        Steady steering angle of the recorded path at the trigger: the command before the first.
    full_steps : (m,) int
        Whole steps of dt until the departure ends; descending.
    rest : (m,) [s]
        What remains after them, 0 <= rest < dt.
    plant : Plant
        Discretised at the trigger speeds.
    last : Discretization
        The step of length `rest`.
    """

    scenarios: Scenarios
    y_s: float
    rows: IntArray
    t_s: FloatArray
    S_uncorrected: FloatArray
    S_before: FloatArray
    triggered: Scenarios
    start: FloatArray
    x_0: FloatArray
    delta_0: FloatArray
    full_steps: IntArray
    rest: FloatArray
    plant: Plant
    last: Discretization

    @property
    def m(self) -> int:
        """Number of triggered scenarios."""
        return int(self.rows.shape[0])

    @classmethod
    def build(
        cls,
        scenarios: Scenarios,
        model: BicycleModel,
        *,
        y_s: float,
        dt: float,
        initial_yaw_rate: InitialYawRate = "path",
    ) -> Takeover:
        """Prepare scenarios for a trigger threshold; shared by every design with that threshold.

        Parameters
        ----------
        scenarios : Scenarios
            n departures.
        model : BicycleModel
            Vehicle, lane and convention.
        y_s : float [m]
            Trigger threshold, >= 0.
        dt : float [s]
            Sample time of the controller, > 0.
        initial_yaw_rate : {"path", "zero"}
            de_psi/dt at the trigger: that of the recorded path, (d2y/dt2)/v, or zero.

        Returns
        -------
        Takeover

        Raises
        ------
        InputError
            For a threshold, step or option outside what is allowed.
        """
        if not (isinstance(y_s, int | float) and math.isfinite(y_s) and y_s >= 0):
            raise InputError(f"y_s: {y_s!r} m; allowed: a finite number >= 0")
        if not (isinstance(dt, int | float) and math.isfinite(dt) and dt > 0):
            raise InputError(f"dt: {dt!r} s; allowed: a finite number > 0")
        if initial_yaw_rate not in get_args(InitialYawRate):
            raise InputError(
                f"initial_yaw_rate: {initial_yaw_rate!r}; {nearest(str(initial_yaw_rate), get_args(InitialYawRate))}"
            )
        offset = model.parameters.edge_offset
        t_s = crossing_time(scenarios, y_s)
        triggered = t_s < scenarios.T
        t_s = np.where(triggered, t_s, np.inf)
        S_uncorrected = recorded_area(scenarios, scenarios.T, offset)
        S_before = np.where(triggered, recorded_area(scenarios, np.minimum(t_s, scenarios.T), offset), S_uncorrected)

        remaining = np.where(triggered, scenarios.T - np.where(triggered, t_s, 0.0), -1.0)
        full = np.floor(remaining / dt).astype(np.int64)
        order = np.argsort(-full, kind="stable")
        rows = order[: int(triggered.sum())]
        chosen, start, full_steps = scenarios.take(rows), t_s[rows], full[rows]
        rest = remaining[rows] - full_steps * dt
        rest = np.where(rest > _SHORTEST_STEP, rest, 0.0)

        v = speed(chosen, start)
        x_0 = np.column_stack(
            [
                lateral(chosen, start) + offset,
                lateral_rate(chosen, start),
                np.arctan2(lateral_rate(chosen, start), v),
                lateral_acceleration(chosen, start) / v if initial_yaw_rate == "path" else np.zeros_like(v),
            ]
        )
        plant = Plant.build(model, v, dt)
        path_yaw_rate = v * curvature(chosen, start) + lateral_acceleration(chosen, start) / v
        delta_0 = plant.steady_state().delta * path_yaw_rate
        return cls(
            scenarios=scenarios,
            y_s=float(y_s),
            rows=rows,
            t_s=t_s,
            S_uncorrected=S_uncorrected,
            S_before=S_before,
            triggered=chosen,
            start=start,
            x_0=x_0,
            delta_0=delta_0,
            full_steps=full_steps,
            rest=rest,
            plant=plant,
            last=model.discretize(v, rest),
        )

    def yaw_rate(self, t: FloatArray, first: int | None = None) -> FloatArray:
        """Lane yaw rate v c(t) [rad/s] of the first scenarios (all by default) at their times t."""
        return np.asarray(self.plant.v[:first] * curvature(self.triggered.take(slice(first)), t), dtype=np.float64)

    def preview(self, t: FloatArray, times: FloatArray, first: int | None = None) -> Preview:
        """The lane ahead of the first scenarios (all by default) at their times t, at the lookahead `times` (p,)."""
        column = _columns(self.triggered.take(slice(first)))
        ahead = t[:, None] + times
        v = self.plant.v[:first, None]
        turned = curvature_integral(column, ahead) - curvature_integral(column, t[:, None])
        return Preview(yaw_rate=v * curvature(column, ahead), heading=v * turned)


def _columns(scenarios: Scenarios) -> Scenarios:
    """The same scenarios with columns of shape (m, 1), to broadcast against lookahead times."""
    return dataclasses.replace(
        scenarios, **{f.name: getattr(scenarios, f.name)[:, None] for f in dataclasses.fields(scenarios)}
    )


def recorded_area(scenarios: Scenarios, t: FloatArray, edge_offset: float) -> FloatArray:
    """Integral of |e_y| along the recorded path from 0 to t [m s]; e_y = y + (w_l - w_v)/2 > 0 there."""
    return lateral_integral(scenarios, t) + edge_offset * t
