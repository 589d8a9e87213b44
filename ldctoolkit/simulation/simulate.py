"""One design on many scenarios, in one call."""

from __future__ import annotations

import numpy.typing as npt

from ldctoolkit.control import Controller
from ldctoolkit.errors import InputError
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import SETTLE, InitialYawRate, Setup, Start
from ldctoolkit.simulation.closed_loop import drive
from ldctoolkit.simulation.outcome import Outcome, Window
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.vehicle import BicycleModel, VehicleParameters


def simulate(
    controller: Controller,
    scenarios: Scenarios,
    *,
    setup: Setup | None = None,
    vehicle: VehicleParameters | BicycleModel | None = None,
    y_s: float = 0.2,
    dt: float = 0.05,
    window: Window = "departure",
    initial_yaw_rate: InitialYawRate = "path",
    start: Start = "printed",
    options: PlantOptions | None = None,
    seed: int = 0,
    settle: float = SETTLE,
    trajectories: bool | npt.ArrayLike = False,
    threads: int | None = None,
) -> Outcome:
    """Run one controller design on all scenarios and score it.

    Parameters
    ----------
    controller : Controller
        The design.
    scenarios : Scenarios
        n departures.
    setup : Setup, optional
        Instead of `vehicle`, `dt`, `initial_yaw_rate`, `start`, `options`, `seed` and `settle`.
    vehicle : VehicleParameters or BicycleModel, optional
        Table I by default; a `BicycleModel` also chooses the convention.
    y_s : float [m]
        Trigger threshold: control starts when the edge is further than this beyond the line.
    dt : float [s]
        Sample time of the controller.
    window : {"departure", "control"}
        Integrate |e_y| over the whole departure, or from the trigger on (the paper's; not comparable between y_s).
    initial_yaw_rate : {"path", "zero"}
        de_psi/dt at the trigger.
    start : {"printed", "steady"}
        Heading error and steering angle at the trigger: the paper's, or those of the steady turn of the recorded path.
    options : PlantOptions, optional
        In what the plant differs from the ideal linear one.
    seed : int
        Of what is drawn for each scenario; with the scenario's number (`Scenarios.index`) it decides every draw.
    settle : float [s]
        How long the loop goes on after the departure, rounded up to whole samples: overshoot, acceleration and
        steering are watched until then. S always ends at T.
    trajectories : bool or (c,) int
        Keep the paths: of all scenarios, or of those with these row numbers.
    threads : int, optional
        All cores this process may use by default. It changes no number.

    Returns
    -------
    Outcome
        Arrays of n in the order of `scenarios`.

    Raises
    ------
    InputError
        For arguments outside what is allowed.

    References
    ----------
    Zhao, Wang, LeBlanc (2017), section IV; the consistent reading integrates over the whole departure.

    Examples
    --------
    >>> from controllers import NoControl, PreviewProportional
    >>> from ldctoolkit import Scenarios, simulate
    >>> scenarios = Scenarios.from_arrays(T=[2.0, 4.0], d_y=[0.3, 0.5], v_mean=[20.0, 28.0])
    >>> simulate(NoControl(), scenarios).reduction
    array([0., 0.])
    >>> simulate(PreviewProportional(), scenarios, y_s=0.1).triggered
    array([ True,  True])
    """
    if vehicle is not None and not isinstance(vehicle, BicycleModel | VehicleParameters):
        raise InputError(f"vehicle: {vehicle!r}; allowed: VehicleParameters(...), BicycleModel(...), or None")
    model = vehicle if isinstance(vehicle, BicycleModel) else BicycleModel(vehicle or VehicleParameters())
    single = Setup(
        vehicle=model.parameters,
        convention=model.convention,
        options=PlantOptions() if options is None else options,
        seed=seed,
        dt=dt,
        initial_yaw_rate=initial_yaw_rate,
        start=start,
        settle=settle,
    )
    if setup is not None and single != Setup():
        raise InputError("setup: given together with values that it holds; allowed: one of the two")
    takeover = Takeover.build(scenarios, single if setup is None else setup, y_s=y_s)
    return drive(controller, takeover, trajectories=trajectories, threads=threads).outcome(window)
