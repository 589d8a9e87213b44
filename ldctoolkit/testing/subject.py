"""What one check looks at, and the words that faults are told in."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import Controller, SteeringLaw
from ldctoolkit.errors import InputError, plain
from ldctoolkit.option_checks import is_number
from ldctoolkit.testing.roads import Commands, Road, bends, commands, prepared


@dataclasses.dataclass(frozen=True)
class ContractSettings:
    """Size and tolerances of the checks.

    Attributes
    ----------
    scenarios : int
        Scenarios in one batch, 4 or more.
    samples : int
        Time steps of one run, 4 or more.
    dt : float [s]
        Sample time.
    mirror_tolerance : float
        How far a mirrored command may be from the mirror image, relative to the largest command of the scenario.
        The default leaves room for sums in another order and for iterative solvers; 0 asks for equal bits.
    limit_tolerance : float [rad]
        How far a command may exceed a declared limit: the accuracy of an iterative solver.
    quiet_tolerance : float [rad]
        How far a command on a straight road may be from 0.

    Raises
    ------
    InputError
        For a value outside what is allowed.

    Examples
    --------
    >>> ContractSettings(mirror_tolerance=0.0).scenarios
    12
    """

    scenarios: int = 12
    samples: int = 6
    dt: float = 0.05
    mirror_tolerance: float = 1e-9
    limit_tolerance: float = 1e-6
    quiet_tolerance: float = 0.0

    def __post_init__(self) -> None:
        for name in ("scenarios", "samples"):
            value = plain(getattr(self, name))
            if isinstance(value, bool) or not (isinstance(value, int) and value >= 4):
                raise InputError(f"{name}: {getattr(self, name)!r}; allowed: a whole number >= 4")
        if not (is_number(plain(self.dt)) and self.dt > 0):
            raise InputError(f"dt: {self.dt!r}; allowed: a number > 0 [s]")
        for name in ("mirror_tolerance", "limit_tolerance", "quiet_tolerance"):
            if not (is_number(plain(getattr(self, name))) and getattr(self, name) >= 0):
                raise InputError(f"{name}: {getattr(self, name)!r}; allowed: a number >= 0")


@dataclasses.dataclass(frozen=True)
class Subject:
    """A design under the contract."""

    design: Controller
    settings: ContractSettings

    @property
    def name(self) -> str:
        """Registry key of the law."""
        return self.design.name

    def bends(self) -> Road:
        """The road that most checks use."""
        return bends(self.settings.scenarios, self.settings.samples)

    def law(self, road: Road) -> SteeringLaw | None:
        """The law, prepared anew; None where it leaves the departure alone."""
        return prepared(self.design, road.v, self.settings.dt)

    def commands(self, road: Road, law: SteeringLaw | None = None) -> Commands | None:
        """What the law says on a road: the one given, or one that is prepared anew."""
        law = self.law(road) if law is None else law
        return None if law is None else commands(law, road, self.settings.dt, self.name)


Check = Callable[[Subject], Iterator[str]]
"""Yields one sentence for each fault."""


def difference(one: Commands | None, other: Commands | None, what: str) -> Iterator[str]:
    """A sentence on the first command or status that is not the same to the bit; nothing where all are."""
    if one is None or other is None:
        if one is not other:
            yield f"{what}: a law that steers one time and leaves the departure alone the other"
        return
    for field, unit in (("delta", " rad"), ("status", "")):
        a, b = getattr(one, field), getattr(other, field)
        wrong = (a != b) & ~(np.isnan(a) & np.isnan(b))
        if wrong.any():
            k, i = (int(place[0]) for place in np.nonzero(wrong))
            yield (
                f"{what}: {field} is {shown(a[k, i])}{unit} and {shown(b[k, i])}{unit} at sample {k} of scenario {i} "
                f"({int(wrong.sum())} of {wrong.size} differ); allowed: the same to the bit"
            )
            return


def shown(value: Any) -> str:
    """A number with all the digits that tell it from its neighbours."""
    return repr(value.item() if hasattr(value, "item") else value)


def arrays_in(value: Any, depth: int = 4) -> Iterator[npt.NDArray[Any]]:
    """The arrays that a state is made of: itself, or inside tuples, lists, dictionaries and dataclasses."""
    if isinstance(value, np.ndarray):
        yield value
    elif depth > 0:
        parts: list[Any] = []
        if isinstance(value, list | tuple):
            parts = list(value)
        elif isinstance(value, dict):
            parts = list(value.values())
        elif dataclasses.is_dataclass(value) and not isinstance(value, type):
            parts = [getattr(value, field.name, None) for field in dataclasses.fields(value)]
        for part in parts:
            yield from arrays_in(part, depth - 1)
