"""Chosen designs driven again on chosen departures, and how well that met the stored scores."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit import EventStatus, Scenarios
from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.simulation import Takeover, drive
from studies.report.context import Context
from studies.report.replay.picks import Chosen, Pick, most_departures

_NOT_AGAIN = (EventStatus.TIMED_OUT, EventStatus.CRASHED)
"""What became of a departure that is not driven once more."""


@dataclasses.dataclass(frozen=True)
class DesignPaths:
    """One design on the p picked departures: NaN after the end, and throughout where there is no path.

    Attributes
    ----------
    chosen : Chosen
    tried : (p,) bool
        Departures that were driven again; a law that takes long is driven on the first ones only.
    t : (p, k) [s]
        Time since the crossing: the controller's samples from the trigger on, T, and the end.
    y : (p, k) [m]
        Edge beyond the line, outward.
    delta : (p, k) [rad]
        Steering angle of the wheel just after that time.
    a_before, a_y : (p, k) [m/s^2]
        Lateral acceleration just before and just after it.
    """

    chosen: Chosen
    tried: BoolArray
    t: FloatArray
    y: FloatArray
    delta: FloatArray
    a_before: FloatArray
    a_y: FloatArray


@dataclasses.dataclass(frozen=True)
class Replay:
    """Departures that were driven again.

    Attributes
    ----------
    picks : tuple of Pick
        p departures.
    scenarios : Scenarios
        Of them.
    recorded : UncorrectedPath
        Their paths without control.
    designs : tuple of DesignPaths
    mismatch : float
        Largest relative difference between a score from the replay and the stored one.
    """

    picks: tuple[Pick, ...]
    scenarios: Scenarios
    recorded: UncorrectedPath
    designs: tuple[DesignPaths, ...]
    mismatch: float

    def first(self, count: int) -> Replay:
        """The same for the first picks only."""
        some = slice(0, count)
        designs = tuple(
            DesignPaths(one.chosen, *(getattr(one, field.name)[some] for field in dataclasses.fields(one)[1:]))
            for one in self.designs
        )
        rows = np.arange(len(self.picks))[some]
        scenarios, recorded = self.scenarios.take(rows), self.recorded.take(rows)
        return Replay(self.picks[some], scenarios, recorded, designs, self.mismatch)


def replay(context: Context, picks: tuple[Pick, ...], designs: tuple[Chosen, ...]) -> Replay:
    """Drive designs again, with the vehicle, plant, seed and clock of the study.

    Parameters
    ----------
    context : Context
    picks : tuple of Pick
        p departures, the most important ones first.
    designs : tuple of Chosen

    Returns
    -------
    Replay
    """
    report = context.report
    scenarios = context.scenarios.take([pick.row for pick in picks])
    recorded = UncorrectedPath.of(scenarios, report.setup.options.residuals, report.setup.seed)
    driven = [_driven(context, picks, scenarios, chosen) for chosen in designs]
    mismatch = max((off for _, off in driven), default=0.0)
    return Replay(picks, scenarios, recorded, tuple(paths for paths, _ in driven), mismatch)


def _driven(
    context: Context, picks: tuple[Pick, ...], scenarios: Scenarios, chosen: Chosen
) -> tuple[DesignPaths, float]:
    report, case, design = context.report, context.case, chosen.row.design
    rows = np.array([pick.row for pick in picks], dtype=np.int64)
    tried = ~np.isin(case.status[chosen.row.index][rows], _NOT_AGAIN)
    most = most_departures(chosen)
    if most is not None:
        tried[most:] = False
    some = np.flatnonzero(tried)
    nothing = np.full((len(picks), 0), np.nan)
    if not some.size:
        return DesignPaths(chosen, tried, nothing, nothing, nothing, nothing, nothing), 0.0
    over = Takeover.build(scenarios.take(some), report.setup.under(case.case.convention), y_s=design.y_s)
    outcome = drive(design.controller(case.case.convention), over, trajectories=True).outcome(case.case.window)
    stored = case.S[chosen.row.index][rows[some]]
    off = float(np.max(np.abs(outcome.S - stored) / np.maximum(np.abs(stored), 1e-9)))
    kept = outcome.trajectories
    if kept is None:  # the law never intervenes
        return DesignPaths(chosen, tried, nothing, nothing, nothing, nothing, nothing), off
    shape = (len(picks), kept.t.shape[1])
    t, y, delta, a_before, a_y = (np.full(shape, np.nan) for _ in range(5))
    t[some], delta[some] = kept.t, kept.delta
    y[some] = kept.x[:, :, 0] - report.setup.vehicle.edge_offset
    a_before[some[over.rows]], a_y[some[over.rows]] = path_acceleration(
        over, np.arange(over.m), kept.t[over.rows], kept.x[over.rows], kept.delta[over.rows]
    )
    return DesignPaths(chosen, tried, t, y, delta, a_before, a_y), off


def path_acceleration(
    over: Takeover, places: IntArray, t: FloatArray, x: FloatArray, delta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Both limits of a_y at the samples of driven paths.

    Parameters
    ----------
    over : Takeover
        What was driven.
    places : (c,) int
        Of the paths' scenarios among the takeover's m.
    t : (c, k) [s]
        Times of the samples, NaN after the end.
    x : (c, k, 4)
        State (e_y, de_y/dt, e_psi, de_psi/dt).
    delta : (c, k) [rad]
        Steering angle of the wheel just after each sample.

    Returns
    -------
    left, right : (c, k) [m/s^2]
        Just before and just after each sample; the first left one is the right one. NaN where t is.

    Notes
    -----
    The steering angle jumps at a sample only where the actuator is at once and without a part of a sample as delay.
    """
    actuator, dt = over.setup.options.actuator, over.setup.dt
    part = actuator.delay - np.floor(actuator.delay / dt + 1e-9) * dt
    jumps = actuator.lag == 0.0 and actuator.rate_max is None and part <= 1e-9 * dt
    before = np.column_stack([delta[:, :1], delta[:, :-1]]) if jumps else delta
    left, right = (_acceleration(over, places, t, x, wheel) for wheel in (before, delta))
    return left, right


def _acceleration(over: Takeover, places: IntArray, t: FloatArray, x: FloatArray, wheel: FloatArray) -> FloatArray:
    """The sum of the axles' forces over the mass, of the true vehicles."""
    path, cars = over.driven.take(places), over.vehicles
    known = np.isfinite(t)
    times = np.where(known, t, 0.0)
    v = path.speed(times) if over.setup.options.speed == "profile" else over.plant.v[places][:, None] + 0.0 * times
    lane = v * path.curvature(times)
    m, I_z, C_af, C_ar, mu = (
        getattr(cars, name)[places][:, None] + 0.0 * times for name in ("m", "I_z", "C_af", "C_ar", "mu")
    )
    rate, heading, turning = x[..., 1], x[..., 2], x[..., 3]
    if over.setup.options.tyres.ideal:
        v_y, omega = rate - v * heading, turning + lane
        front = 2.0 * C_af * (wheel - (v_y + cars.l_f * omega) / v)
        rear = -2.0 * C_ar * (v_y - cars.l_r * omega) / v
        printed = 4.0 * C_ar * cars.l_r / m if over.setup.convention == "as_printed" else 0.0
        a_y = (front + rear) / m - printed * turning / v
    else:
        from ldctoolkit.vehicle._nonlinear_compiled import nonlinear_rhs

        every = np.vectorize(nonlinear_rhs, otypes=[np.float64] * 3)
        zero = 0.0 * times
        a_y = every(
            *(np.where(known, part, 0.0) for part in (rate, heading, turning, wheel)), lane, v, zero,
            C_af, C_ar, cars.l_f + zero, cars.l_r + zero, m, I_z, mu, over.setup.options.tyres.shape + zero,
        )[2]  # fmt: skip
    return np.where(known, a_y, np.nan)
