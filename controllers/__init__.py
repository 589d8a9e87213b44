"""The controller zoo: one law per file, its registry key the file's name."""

if __name__ == "controllers":  # in a checkout, whose root is on Python's path
    raise ImportError("controllers: the name of this package is ldctoolkit.controllers", name="controllers")

from ldctoolkit.control import check_class

from .barrier_filter import BarrierFilter
from .external import CLaw
from .fmu import FmuLaw, FmuVehicle
from .from_opti import from_opti
from .linear_mpc import LinearMPC
from .lqi import LQI
from .lqr import LQR
from .none import NoControl
from .nonlinear_mpc import NonlinearMPC
from .pid import PID
from .predictive import PredictiveController, Soft, Stage
from .preview_lqr import PreviewLQR
from .preview_proportional import PreviewProportional
from .pure_pursuit import PurePursuit
from .sliding_mode import SlidingMode
from .stanley import Stanley

__all__ = [
    "LQI",
    "LQR",
    "PID",
    "BarrierFilter",
    "CLaw",
    "FmuLaw",
    "FmuVehicle",
    "LinearMPC",
    "NoControl",
    "NonlinearMPC",
    "PredictiveController",
    "PreviewLQR",
    "PreviewProportional",
    "PurePursuit",
    "SlidingMode",
    "Soft",
    "Stage",
    "Stanley",
    "from_opti",
]

for _name in {*__all__} - {"CLaw", "FmuLaw", "FmuVehicle", "PredictiveController", "Soft", "Stage", "from_opti"}:
    check_class(globals()[_name])  # their documentation then lists their gains
