"""The closed loop: trigger, simulation of all scenarios at once, outcomes."""

from ldctoolkit.simulation.closed_loop import BOUND, drive, drive_many
from ldctoolkit.simulation.departure_plot import plot_departure
from ldctoolkit.simulation.outcome import Outcome, Run, Trajectories, Window
from ldctoolkit.simulation.simulate import simulate
from ldctoolkit.simulation.takeover import Takeover

__all__ = [
    "BOUND",
    "Outcome",
    "Run",
    "Takeover",
    "Trajectories",
    "Window",
    "drive",
    "drive_many",
    "plot_departure",
    "simulate",
]
