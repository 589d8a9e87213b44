"""Compare lane departure correction designs on realistic, generated lane departures."""

from ldctoolkit.control import (
    Controller,
    EventStatus,
    LinearLaw,
    LinearSteps,
    Preview,
    RecordedPath,
    SolverCalls,
    SteeringLaw,
)
from ldctoolkit.departure_plot import plot_departure
from ldctoolkit.departures import (
    DepartureParameters,
    Departures,
    DepartureSignals,
    Plausibility,
    rebuild_signals,
    reduce_signals,
)
from ldctoolkit.errors import LdcError
from ldctoolkit.gains import Gain, gain, option
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.recordings import (
    extract_departures,
    open_recordings,
    read_departures,
    read_recordings,
    write_departures,
)
from ldctoolkit.registry import controller_class, controller_names, register
from ldctoolkit.scenario_model import ScenarioModel, bundled_models, check_fidelity, fit_scenario_model, load_model
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation import Outcome, simulate
from ldctoolkit.vehicle import BicycleModel, Plant, VehicleParameters
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE, scheduled
from ldctoolkit.version import __version__

__all__ = [
    "SPEED_RANGE",
    "BicycleModel",
    "BoundedGaussianMixture",
    "Controller",
    "DepartureParameters",
    "DepartureSignals",
    "Departures",
    "EventStatus",
    "Gain",
    "LdcError",
    "LinearLaw",
    "LinearSteps",
    "Outcome",
    "Plant",
    "Plausibility",
    "Preview",
    "RecordedPath",
    "ScenarioModel",
    "Scenarios",
    "Setup",
    "SolverCalls",
    "SteeringLaw",
    "VehicleParameters",
    "__version__",
    "bundled_models",
    "check_fidelity",
    "controller_class",
    "controller_names",
    "extract_departures",
    "fit_scenario_model",
    "gain",
    "load_model",
    "open_recordings",
    "option",
    "plot_departure",
    "read_departures",
    "read_recordings",
    "rebuild_signals",
    "reduce_signals",
    "register",
    "scheduled",
    "simulate",
    "write_departures",
]
