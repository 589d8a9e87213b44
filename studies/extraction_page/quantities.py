"""What is drawn along the axes: the eight parameters and the lane's width, with units that give short numbers."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Final

from ldctoolkit.departures import PARAMETER_NAMES
from studies.fit_page.style import MEANINGS, UNITS

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    FloatArray = npt.NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Quantity:
    """One kind of numbers.

    Attributes
    ----------
    name : str
        ``"d_y"``.
    meaning : str
        A few words.
    unit : str
        As shown.
    scale : float
        Shown values are this many times those in SI units.
    least : float
        Smallest range of an axis, in the unit shown, so that noise does not fill it.
    digits : int
        Decimals of a median, in the unit shown.
    """

    name: str
    meaning: str
    unit: str
    scale: float = 1.0
    least: float = 0.1
    digits: int = 2

    @property
    def label(self) -> str:
        """Name and unit: ``d_y [m]``."""
        return f"{self.name} [{self.unit}]"

    def shown(self, values: FloatArray) -> FloatArray:
        """Values in SI units, in the unit shown."""
        return self.scale * values


# curvature in 1/m would need a power of ten at every number
CURVATURE_UNIT: Final = "1/km"
CURVATURE_SCALE: Final = 1000.0

_DIGITS: Final = {"sigma_y": 3, "v_mean": 1}


def _parameter(name: str) -> Quantity:
    if UNITS[name] == "1/m":
        return Quantity(name, MEANINGS[name], CURVATURE_UNIT, CURVATURE_SCALE)
    least = 0.01 if name == "sigma_y" else 0.1
    return Quantity(name, MEANINGS[name], UNITS[name], least=least, digits=_DIGITS.get(name, 2))


PARAMETERS: Final = tuple(map(_parameter, PARAMETER_NAMES))
"""The eight parameters in the paper's order."""

# counted in bins of 0.1 m: a median has no more digits
LANE_WIDTH: Final = Quantity("lane width", "width of the lane, valid samples", "m", digits=1)
