"""The controller zoo: one law per file, its registry key the file's name."""

from controllers.linear_mpc import LinearMPC
from controllers.lqr import LQR
from controllers.none import NoControl
from controllers.preview_proportional import PreviewProportional

__all__ = ["LQR", "LinearMPC", "NoControl", "PreviewProportional"]
