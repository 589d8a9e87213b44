"""Where a design is worst: where it never acts, and what tells its other worst departures from those it took over."""

from __future__ import annotations

import dataclasses
import math
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import Scenarios
from ldctoolkit.arrays import BoolArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES

WORST: Final = 0.05
"""Share of the departures that counts as worst."""

_FEWEST: Final = 40
"""Departures below which a share of them says nothing."""

_APART: Final = 0.2
"""Distance of two distributions from which a parameter is worth naming, whatever chance makes."""

NAMED: Final = 5
"""Departures that are named, the worst first."""

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
        Over the worst of the departures compared and over all of them, in the parameter's SI unit.
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
    first : tuple of int
        Rows of the first few of them, the worst first.
    untouched : int
        How many of them the design never took over: there S is that without control.
    failed : int
        How many of them failed.
    share_of_S : float
        Their part of the sum of S.
    left : float
        Share of them to the left, and `every_left` that of all.
    every_left : float
    lines : tuple of ParameterLine
        The parameters that vary, most telling first: the worst that were taken over against all that were; of a design
        that never took over, the worst against all. Empty where none of the worst was taken over.
    """

    count: int
    first: tuple[int, ...]
    untouched: int
    failed: int
    share_of_S: float
    left: float
    every_left: float
    lines: tuple[ParameterLine, ...]

    @property
    def telling(self) -> tuple[ParameterLine, ...]:
        """The parameters in which the worst departures differ."""
        return tuple(line for line in self.lines if line.apart)


def worst_first(S: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Rows of S (n,) from the largest on; on a tie the earliest first."""
    return np.argsort(-S, kind="stable")


def worst_departures(
    scenarios: Scenarios, S: npt.NDArray[np.float64], took_over: BoolArray, failed: BoolArray
) -> WorstDepartures | None:
    """Compare the departures with the largest 5 % of S with all of them, where the design took over.

    Parameters
    ----------
    scenarios : Scenarios
        n departures.
    S : (n,) [m s]
        Of one design.
    took_over, failed : (n,) bool
        What it did there.

    Returns
    -------
    WorstDepartures or None
        None where there are fewer than 40 departures, or all have the same S.

    Examples
    --------
    >>> scenarios = Scenarios.from_arrays(T=np.linspace(1.0, 5.0, 100), d_y=0.3, v_mean=25.0)
    >>> took_over = np.ones(100, dtype=bool)
    >>> found = worst_departures(scenarios, scenarios.T, took_over, ~took_over)
    >>> found.count, found.telling[0].name, round(found.telling[0].worst.median, 2)
    (5, 'T', 4.92)
    """
    n = S.size
    if n < _FEWEST or not np.ptp(S) > 0:
        return None
    count = max(1, round(WORST * n))
    rows = worst_first(S)[:count]
    total = float(S.sum())
    compared = took_over if took_over.any() else np.ones(n, dtype=bool)
    return WorstDepartures(
        count=count,
        first=tuple(rows[:NAMED].tolist()),
        untouched=int((~took_over[rows]).sum()),
        failed=int(failed[rows].sum()),
        share_of_S=float(S[rows].sum()) / total if total > 0 else 0.0,
        left=float((scenarios.side[rows] == LEFT).mean()),
        every_left=float((scenarios.side == LEFT).mean()),
        lines=_lines(scenarios, rows[compared[rows]], np.flatnonzero(compared)),
    )


def _lines(
    scenarios: Scenarios, worst: npt.NDArray[np.int64], every: npt.NDArray[np.int64]
) -> tuple[ParameterLine, ...]:
    if not worst.size:
        return ()
    varying = [name for name in PARAMETER_NAMES if np.ptp(getattr(scenarios, name)[every]) > 0]
    # Smirnov's asymptotic bound, shared out over the parameters
    chance = math.sqrt(-0.5 * math.log(0.5 * _CHANCE / max(len(varying), 1)) * (1.0 / worst.size + 1.0 / every.size))
    lines = []
    for name in varying:
        some, values = getattr(scenarios, name)[worst], getattr(scenarios, name)[every]
        distance = _distance(some, values)
        apart = distance > max(chance, _APART)
        lines.append(ParameterLine(name, Spread.of(some), Spread.of(values), distance, apart))
    return tuple(sorted(lines, key=lambda line: -line.distance))


def _distance(some: npt.NDArray[np.float64], every: npt.NDArray[np.float64]) -> float:
    from scipy.stats import ks_2samp

    return float(ks_2samp(some, every, method="asymp").statistic)
