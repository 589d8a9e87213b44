"""The controller zoo: one law per file, its registry key the file's name."""

from controllers.barrier_filter import BarrierFilter
from controllers.linear_mpc import LinearMPC
from controllers.lqi import LQI
from controllers.lqr import LQR
from controllers.none import NoControl
from controllers.nonlinear_mpc import NonlinearMPC
from controllers.pid import PID
from controllers.preview_lqr import PreviewLQR
from controllers.preview_proportional import PreviewProportional
from controllers.pure_pursuit import PurePursuit
from controllers.sliding_mode import SlidingMode
from controllers.stanley import Stanley
from ldctoolkit.control import check_class

__all__ = [
    "LQI",
    "LQR",
    "PID",
    "BarrierFilter",
    "LinearMPC",
    "NoControl",
    "NonlinearMPC",
    "PreviewLQR",
    "PreviewProportional",
    "PurePursuit",
    "SlidingMode",
    "Stanley",
]

for _name in __all__:
    check_class(globals()[_name])  # their documentation then lists their gains
