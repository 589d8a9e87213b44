"""Recordings made of a scenario model's departures: what a vehicle would have measured that drove them one by one.

`drive` strings planted departures together to trips, `measure` adds what the sensors do, `write_tables` writes the
tables DataLane and DataWsu, `compare` holds the departures that were found against the planted ones."""

from .compare import Comparison, compare, kolmogorov
from .das1 import write_tables
from .drive import Drive, drive
from .planted import Planted, plant
from .sensors import Measured, Noise, measure

__all__ = [
    "Comparison", "Drive", "Measured", "Noise", "Planted", "compare", "drive", "kolmogorov", "measure", "plant",
    "write_tables",
]  # fmt: skip
