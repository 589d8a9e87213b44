"""How thoroughly, and how strictly, a contract is checked."""

from __future__ import annotations

import dataclasses

from ldctoolkit.errors import InputError, plain
from ldctoolkit.option_checks import is_number


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
