"""The closed loop: trigger, simulation of all scenarios at once, outcomes."""

from ldctoolkit.simulation.closed_loop import BOUND, drive
from ldctoolkit.simulation.outcome import Outcome, Run, Trajectories, Window
from ldctoolkit.simulation.simulate import simulate
from ldctoolkit.simulation.takeover import InitialYawRate, Takeover

__all__ = ["BOUND", "InitialYawRate", "Outcome", "Run", "Takeover", "Trajectories", "Window", "drive", "simulate"]
