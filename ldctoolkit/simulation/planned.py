"""What a predictive law planned at every sample of departures, beside what came of it."""

from __future__ import annotations

import dataclasses

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.control import Controller, SteeringLaw
from ldctoolkit.errors import InputError, expect
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation.loop import Outcome, drive
from ldctoolkit.simulation.takeover import Takeover


@dataclasses.dataclass(frozen=True)
class Plans:
    """The k plans of one design on scenarios, by scenario and then by sample, in the departures' outward frame.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> found = ldc.plans(ldc.NonlinearMPC(horizon=5), ldc.Scenarios.from_arrays(T=3.0, d_y=0.5, v_mean=25.0))
    >>> bool((found.row == 0).all()), found.x.shape[1:], found.delta.shape[1:]
    (True, (6, 4), (5,))
    """

    row: IntArray  # (k,) Row number of the scenario
    sample: IntArray  # (k,) 0 is the trigger
    t: FloatArray  # (k, N + 1) [s] Times of the states since the departure's start; the first command acts at the first
    x: FloatArray  # (k, N + 1, 4) Predicted states (e_y, de_y/dt, e_psi, de_psi/dt); NaN where a solve failed
    delta: FloatArray  # (k, N) [rad] Planned commands
    outcome: Outcome  # What came of them, with trajectories
    setup: Setup  # Vehicle, plant and clock


def plans(controller: Controller, scenarios: Scenarios, y_s: float = 0.2, *, setup: Setup | None = None) -> Plans:
    """Drive a design that plans, and keep its plans.

    Raises `InputError` for a design whose law has no `SteeringLaw.plan`, and as `simulate`.

    Parameters
    ----------
    controller : Controller
        A `PredictiveController`, or another controller whose law defines `plan`.
    scenarios : Scenarios
    y_s : float [m]
        Trigger threshold, >= 0.
    setup : Setup, optional
        Vehicle, plant and clock.

    Returns
    -------
    Plans
        No rows for scenarios that do not trigger.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> found = ldc.plans(ldc.NonlinearMPC(), ldc.Scenarios.from_arrays(T=3.0, d_y=0.5, v_mean=25.0), y_s=0.1)
    >>> came = found.outcome.trajectories
    >>> bool(abs(found.x[0, 1, 0] - came.x[0, 1, 0]) < 1e-3)  # e_y a sample later
    True
    """
    expect("scenarios", scenarios, Scenarios)
    setup = setup or Setup()
    over = Takeover.build(scenarios, setup, y_s=y_s)
    run = drive(controller, over, trajectories=True, plans=True)
    law = controller.prepare(over.plant)
    if not isinstance(law, SteeringLaw) or type(law).plan is SteeringLaw.plan:
        raise InputError("controller", "has no plans", value=controller.name, allowed="a PredictiveController")
    start = np.full(scenarios.n, np.nan)
    start[over.rows] = over.start
    nothing = np.zeros(0, dtype=np.int64), np.zeros(1), np.zeros((0, 1, 4)), np.zeros((0, 0))
    rows, times, *plan = zip(*(run.planned or [nothing]), strict=True)
    row, sample = np.concatenate(rows), np.repeat(np.arange(len(rows)), [part.size for part in rows])
    order = np.lexsort((sample, row))
    row, sample, x, delta = (values[order] for values in (row, sample, *map(np.concatenate, plan)))
    t = (start[row] + sample * setup.dt)[:, None] + times[0]
    return Plans(row, sample, t, x, delta, run.outcome("departure"), setup)
