"""Compare lane departure correction designs on realistic, generated lane departures."""

import sys
from pathlib import Path

_folder = Path(__file__).resolve().parent

_started_by_name = " -m ldctoolkit" in " ".join(sys.orig_argv) and not sys.flags.safe_path
if _started_by_name and Path(sys.path[0]) == Path.cwd() != _folder.parent:
    del sys.path[0]  # `python -m` looks for modules in the working directory first, which `ldc` does not
if not (_folder / "studies").is_dir():
    __path__.append(str(_folder.parent))  # a checkout, where `controllers` and `studies` lie beside this package

import importlib
from typing import TYPE_CHECKING, Any

from ldctoolkit.control import (
    AssistState,
    Controller,
    EventStatus,
    LinearLaw,
    LinearSteps,
    Preview,
    RecordedPath,
    SolverCalls,
    SteeringLaw,
)
from ldctoolkit.declared import Gain, gain, option
from ldctoolkit.departures import (
    DepartureParameters,
    Departures,
    DepartureSignals,
    Plausibility,
    rebuild_signals,
    reduce_signals,
)
from ldctoolkit.errors import LdcError
from ldctoolkit.metrics import metric
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.plant_options import Actuator, Driver, KalmanFilter, Mismatch, PlantOptions, Residuals, Sensors, Tyres
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
from ldctoolkit.simulation import Outcome, Paths, Plans, plans, simulate
from ldctoolkit.vehicle import BicycleModel, Plant, VehicleModel, VehicleParameters
from ldctoolkit.vehicle.speed_schedule import SPEED_RANGE, scheduled
from ldctoolkit.version import __version__

if TYPE_CHECKING:
    from ldctoolkit.controllers import *
    from ldctoolkit.identification import Identification, identify
    from ldctoolkit.studies import *

__all__ = [
    "LQI", "LQR", "PID", "SPEED_RANGE", "Actuator", "Assessment", "AssistState", "BarrierFilter", "BicycleModel",
    "BoundedGaussianMixture", "CLaw", "Comparison", "Controller", "DepartureParameters", "DepartureSignals",
    "Departures", "Design", "Driver", "EventStatus", "FmuLaw", "FmuVehicle", "Gain", "Identification",
    "KalmanFilter", "LdcError", "LinearLaw", "LinearMPC", "LinearSteps", "Mismatch", "NoControl", "NonlinearMPC",
    "Outcome", "Paths", "Plans", "Plant", "PlantOptions", "Plausibility", "PredictiveController", "Preview",
    "PreviewLQR", "PreviewProportional", "PurePursuit", "Ranking", "RecordedPath", "Residuals", "ScenarioModel",
    "Scenarios", "Sensors", "Setup", "SlidingMode", "Soft", "SolverCalls", "Stage", "Stanley", "SteeringLaw",
    "Study", "StudyResults", "Tyres", "VehicleModel", "VehicleParameters", "__version__", "assess",
    "bundled_models", "check_fidelity", "compare", "controller_class", "controller_names", "controllers",
    "estimate_risk", "export_c", "extract_departures", "fit_scenario_model", "from_opti", "gain", "identify",
    "load_model", "load_study", "metric", "open_recordings", "option", "plans", "plot_convergence",
    "plot_departure", "plot_distribution", "plot_landscape", "plot_ranking", "plot_trade_off", "rank_study",
    "read_departures", "read_recordings", "read_results", "rebuild_signals", "reduce_signals", "register",
    "run_study", "scheduled", "simulate", "studies", "study", "write_departures",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Laws and studies are loaded when they are first used."""
    if name in ("controllers", "studies"):
        return importlib.import_module(f"{__name__}.{name}")
    for package in ("controllers", "studies", "identification") if name in __all__ else ():
        module = importlib.import_module(f"{__name__}.{package}")
        if name in module.__all__:
            return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}", name=name, obj=sys.modules[__name__])


def __dir__() -> list[str]:
    return __all__
