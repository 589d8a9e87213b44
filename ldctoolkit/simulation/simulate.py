"""One design on many scenarios, in one call."""

from __future__ import annotations

from ldctoolkit.control import Controller
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation.closed_loop import drive
from ldctoolkit.simulation.outcome import Outcome, Window
from ldctoolkit.simulation.takeover import InitialYawRate, Takeover
from ldctoolkit.vehicle import BicycleModel, VehicleParameters


def simulate(
    controller: Controller,
    scenarios: Scenarios,
    *,
    vehicle: VehicleParameters | BicycleModel | None = None,
    y_s: float = 0.2,
    dt: float = 0.05,
    window: Window = "departure",
    initial_yaw_rate: InitialYawRate = "path",
    trajectories: bool = False,
) -> Outcome:
    """Run one controller design on all scenarios and score it.

    Parameters
    ----------
    controller : Controller
        The design.
    scenarios : Scenarios
        n departures.
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
    trajectories : bool
        Keep the paths.

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
    model = vehicle if isinstance(vehicle, BicycleModel) else BicycleModel(vehicle or VehicleParameters())
    takeover = Takeover.build(scenarios, model, y_s=y_s, dt=dt, initial_yaw_rate=initial_yaw_rate)
    return drive(controller, takeover, trajectories=trajectories).outcome(window)
