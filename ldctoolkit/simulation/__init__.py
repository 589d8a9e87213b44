"""The closed loop: trigger, simulation of all scenarios at once, outcomes."""

from ldctoolkit.simulation.closed_loop import BOUND, drive, drive_many
from ldctoolkit.simulation.outcome import Outcome, Run, Trajectories, Window
from ldctoolkit.simulation.simulate import simulate
from ldctoolkit.simulation.takeover import SETTLE, InitialYawRate, Takeover

__all__ = [
    "BOUND",
    "SETTLE",
    "InitialYawRate",
    "Outcome",
    "Run",
    "Takeover",
    "Trajectories",
    "Window",
    "drive",
    "drive_many",
    "simulate",
]
