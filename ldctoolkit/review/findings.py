"""What a review says: findings with their severity, and the thresholds that they come from."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal, get_args

from ldctoolkit.errors import InputError, nearest
from ldctoolkit.option_checks import is_number

Severity = Literal["fault", "warning", "note"]


@dataclasses.dataclass(frozen=True)
class Finding:
    """One thing that a review found.

    Attributes
    ----------
    severity : {"fault", "warning", "note"}
        A fault makes the design useless or dangerous somewhere in the range, a warning is worth a second look, a note
        says what the numbers stand on.
    name : str
        The check.
    sentence : str
        What was found, what is allowed, what helps.
    value : float
        The worst value, in SI units; NaN where there is none.
    allowed : float
        Where the finding starts; NaN where there is none.
    v : float [m/s]
        Speed of the worst value; NaN where it does not depend on the speed.

    Raises
    ------
    InputError
        For an unknown severity.

    Examples
    --------
    >>> Finding("note", "linear", "The law is linear.").severity
    'note'
    """

    severity: Severity
    name: str
    sentence: str
    value: float = math.nan
    allowed: float = math.nan
    v: float = math.nan

    def __post_init__(self) -> None:
        if self.severity not in get_args(Severity):
            raise InputError(f"severity: {self.severity!r}; {nearest(str(self.severity), get_args(Severity))}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where findings start. A pair is (warning, fault).

    Gain and phase margin, and the damping that goes with the latter, are the lower ends of what is usual: gain margin 2
    to 5, phase margin 30 to 60 degrees (K. J. Astrom, R. M. Murray, *Feedback Systems*, section on stability margins).
    A disk margin of 0.5 stands for gain that changes by a factor of 1.67 and phase that changes by 28 degrees, one of
    the two, or part of both at a time (P. Seiler, A. Packard, P. Gahinet, *An Introduction to Disk Margins*, IEEE
    Control Systems Magazine 40(5), 2020). Faults are at half of these. Sampling ten times faster than the bandwidth is
    a usual lower end (K. J. Astrom, B. Wittenmark, *Computer-Controlled Systems*); half the sampling frequency is
    Nyquist's limit. The others are choices of this toolkit.

    Attributes
    ----------
    gain_margin : (float, float) [dB]
        Factor that the loop gain may grow, or shrink, by.
    phase_margin : (float, float) [rad]
    disk_margin : (float, float)
        Balanced (skew 0).
    delay_margin : (float, float) [samples]
    damping : (float, float)
        Damping ratio of the closed loop's poles.
    sampling : (float, float)
        Bandwidth over sampling frequency.
    slowest : (float, float) [s]
        Time constant of the slowest pole.
    bend : (float, float) [m]
        |e_y| in a steady bend on the nominal vehicle.
    bend_mismatched : (float, float) [m]
        The same on a vehicle with other tyres.
    hessian : (float, float)
        Condition number of the condensed Hessian.

    Raises
    ------
    InputError
        For a value that is not > 0, or a fault that starts before its warning.

    Examples
    --------
    >>> Thresholds(gain_margin=(8.0, 4.0)).disk_margin
    (0.5, 0.25)
    """

    gain_margin: tuple[float, float] = (6.0, 3.0)
    phase_margin: tuple[float, float] = (math.radians(30.0), math.radians(15.0))
    disk_margin: tuple[float, float] = (0.5, 0.25)
    delay_margin: tuple[float, float] = (1.0, 0.5)
    damping: tuple[float, float] = (0.3, 0.1)
    sampling: tuple[float, float] = (0.1, 0.5)
    slowest: tuple[float, float] = (10.0, 100.0)
    bend: tuple[float, float] = (0.1, 0.3)
    bend_mismatched: tuple[float, float] = (0.3, 0.6)
    hessian: tuple[float, float] = (1e6, 1e12)

    def __post_init__(self) -> None:
        rising = {"sampling", "slowest", "bend", "bend_mismatched", "hessian"}
        for field in dataclasses.fields(self):
            pair = getattr(self, field.name)
            if not (isinstance(pair, tuple) and len(pair) == 2):
                raise InputError(f"thresholds.{field.name}: {pair!r}; allowed: (warning, fault)")
            if not all(is_number(value) and value > 0 for value in pair):
                raise InputError(f"thresholds.{field.name}: {pair!r}; allowed: numbers > 0")
            ordered = pair[0] <= pair[1] if field.name in rising else pair[0] >= pair[1]
            if not ordered:
                word = ">=" if field.name in rising else "<="
                raise InputError(f"thresholds.{field.name}: {pair!r}; allowed: (warning, fault), fault {word} warning")
