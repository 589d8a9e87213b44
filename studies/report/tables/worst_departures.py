"""Where a design is worst: what tells its worst departures from all of them."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.departures import LEFT, PARAMETER_NAMES

WORST: Final = 0.05
"""Share of the departures that counts as worst."""

_FEWEST: Final = 40
"""Departures below which a share of them says nothing."""

_APART: Final = 0.2
"""Distance of two distributions from which a parameter is worth naming, whatever chance makes."""

_CHANCE: Final = 0.05
"""Probability that chance alone names any of the parameters."""


@dataclasses.dataclass(frozen=True)
class Spread:
    """Median and the quantiles of 10 % and 90 %."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: npt.NDArray[np.float64]) -> Spread:
        """Of values (n,)."""
        low, median, high = (float(v) for v in np.quantile(values, [0.1, 0.5, 0.9]))
        return cls(median, low, high)


@dataclasses.dataclass(frozen=True)
class ParameterLine:
    """One parameter of the departures.

    Attributes
    ----------
    name : str
    worst, every : Spread
        Over the worst departures and over all of them, in the parameter's SI unit.
    distance : float
        Largest difference between both distribution functions (Kolmogorov), from 0 to 1.
    apart : bool
        Whether the worst departures differ in it by more than chance makes.
    """

    name: str
    worst: Spread
    every: Spread
    distance: float
    apart: bool


@dataclasses.dataclass(frozen=True)
class WorstDepartures:
    """What the departures with the largest S have in common.

    Attributes
    ----------
    count : int
        How many they are.
    share_of_S : float
        Their part of the sum of S.
    left : float
        Share of them to the left, and `every_left` that of all.
    every_left : float
    lines : tuple of ParameterLine
        The parameters that vary, most telling first.
    """

    count: int
    share_of_S: float
    left: float
    every_left: float
    lines: tuple[ParameterLine, ...]

    @property
    def telling(self) -> tuple[ParameterLine, ...]:
        """The parameters in which the worst departures differ."""
        return tuple(line for line in self.lines if line.apart)


def worst_departures(scenarios: Scenarios, S: npt.NDArray[np.float64]) -> WorstDepartures | None:
    """Compare the departures with the largest 5 % of S with all of them.

    Parameters
    ----------
    scenarios : Scenarios
        n departures.
    S : (n,) [m s]
        Of one design.

    Returns
    -------
    WorstDepartures or None
        None where there are fewer than 40 departures, or all have the same S.

    Examples
    --------
    >>> scenarios = Scenarios.from_arrays(T=np.linspace(1.0, 5.0, 100), d_y=0.3, v_mean=25.0)
    >>> found = worst_departures(scenarios, scenarios.T)
    >>> found.count, found.telling[0].name, round(found.telling[0].worst.median, 2)
    (5, 'T', 4.92)
    """
    n = S.size
    if n < _FEWEST or not np.ptp(S) > 0:
        return None
    count = max(1, round(WORST * n))
    rows = np.argsort(-S, kind="stable")[:count]
    total = float(S.sum())
    varying = [name for name in PARAMETER_NAMES if np.ptp(getattr(scenarios, name)) > 0]
    # Smirnov's asymptotic bound, shared out over the parameters
    chance = math.sqrt(-0.5 * math.log(0.5 * _CHANCE / max(len(varying), 1)) * (1.0 / count + 1.0 / n))
    lines = []
    for name in varying:
        values = getattr(scenarios, name)
        distance = _distance(values[rows], values)
        apart = distance > max(chance, _APART)
        lines.append(ParameterLine(name, Spread.of(values[rows]), Spread.of(values), distance, apart))
    return WorstDepartures(
        count=count,
        share_of_S=float(S[rows].sum()) / total if total > 0 else 0.0,
        left=float((scenarios.side[rows] == LEFT).mean()),
        every_left=float((scenarios.side == LEFT).mean()),
        lines=tuple(sorted(lines, key=lambda line: -line.distance)),
    )


def _distance(some: npt.NDArray[np.float64], every: npt.NDArray[np.float64]) -> float:
    from scipy.stats import ks_2samp

    return float(ks_2samp(some, every, method="asymp").statistic)
