"""The closed loop: trigger, simulation of all scenarios at once, outcomes."""

from ldctoolkit.simulation.loop import Run, drive, drive_many, simulate
from ldctoolkit.simulation.outcome import Outcome, Trajectories, Window
from ldctoolkit.simulation.takeover import BOUND, Takeover

__all__ = ["BOUND", "Outcome", "Run", "Takeover", "Trajectories", "Window", "drive", "drive_many", "simulate"]
