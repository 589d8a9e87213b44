"""The closed loop: trigger, simulation of all scenarios at once, outcomes."""

from ldctoolkit.simulation.loop import Outcome, Run, Trajectories, Window, drive, drive_many, simulate
from ldctoolkit.simulation.planned import Plans, plans
from ldctoolkit.simulation.sampled_paths import Paths
from ldctoolkit.simulation.takeover import BOUND, Takeover

__all__ = [
    "BOUND", "Outcome", "Paths", "Plans", "Run", "Takeover", "Trajectories", "Window", "drive", "drive_many", "plans",
    "simulate",
]  # fmt: skip
