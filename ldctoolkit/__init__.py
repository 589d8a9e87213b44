"""Compare lane departure correction designs on realistic, generated lane departures."""

from ldctoolkit.control import Controller, EventStatus, LinearLaw, Preview, RecordedPath, SteeringLaw
from ldctoolkit.departures import DepartureParameters, Departures, DepartureSignals, rebuild_signals, reduce_signals
from ldctoolkit.errors import LdcError
from ldctoolkit.gains import Gain, gain, option
from ldctoolkit.registry import controller_class, controller_names, register
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.simulation import Outcome, simulate
from ldctoolkit.vehicle import BicycleModel, Plant, VehicleParameters
from ldctoolkit.version import __version__

__all__ = [
    "BicycleModel",
    "Controller",
    "DepartureParameters",
    "DepartureSignals",
    "Departures",
    "EventStatus",
    "Gain",
    "LdcError",
    "LinearLaw",
    "Outcome",
    "Plant",
    "Preview",
    "RecordedPath",
    "Scenarios",
    "SteeringLaw",
    "VehicleParameters",
    "__version__",
    "controller_class",
    "controller_names",
    "gain",
    "option",
    "rebuild_signals",
    "reduce_signals",
    "register",
    "simulate",
]
