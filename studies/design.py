"""A design of a study: a law with its gains and its trigger threshold."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import warnings
from collections.abc import Sequence
from typing import Any, Final

from ldctoolkit.control import Controller
from ldctoolkit.declared import GainValue, UnitWarning, unit_slip
from ldctoolkit.errors import InputError, UnknownNameError, nearest
from ldctoolkit.registry import bound_class, code_of, controller_class
from ldctoolkit.vehicle import Convention

PAPER_LAW: Final = "preview_proportional"  # registry name of the paper's law
_PAPER_DESIGN: Final = {"y_s": 0.2, "K_y": -0.005, "K_psi": -0.2, "T_lp": 2.0}  # Table I of the paper


def is_paper_design(design: Design) -> bool:
    """Whether it is the design of the paper's Table I."""
    values = {"y_s": design.y_s, **dict(design.gains)}
    return design.law == PAPER_LAW and all(values.get(name) == value for name, value in _PAPER_DESIGN.items())


CONVENTION_GAIN: Final = "convention"
"""Name of the option through which a law declares that it knows the two readings of the paper."""

NO_CONTROL: Final = "none"  # registry name of the law that never intervenes
FOLLOWS_STUDY: Final = "case"
"""Value of that option in a design that leaves the reading to the study; part of the design's identifier."""


@dataclasses.dataclass(frozen=True)
class Design:
    """One row of a ranking.

    Notes
    -----
    In a study the design's `id` names one set of numbers. A law of the toolkit is known by its name, any other by the
    content of its code: an edited law makes other designs.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> [design.label for design in ldc.study(ldc.LQR(r_delta=300.0), y_s=[0.1, 0.2]).designs]
    ['LQR, y_s=0.1 m, r_delta=300', 'LQR, y_s=0.2 m, r_delta=300']
    """

    law: str  # Registry name of the controller
    y_s: float  # [m] Trigger threshold
    # Every declared gain and option in the law's own order, defaults included. The option `convention` holds
    # `FOLLOWS_STUDY` where the study decides it.
    gains: tuple[tuple[str, GainValue], ...]
    code: str = ""  # Content of the law's code; empty for the toolkit's laws

    def __post_init__(self) -> None:
        if slip := unit_slip("y_s", self.y_s):
            warnings.warn(slip, UnitWarning, stacklevel=4)

    @classmethod
    def of(cls, controller: Controller, y_s: float, *, follow_study: bool = False, code: str | None = None) -> Design:
        """The design that a controller and a threshold make.

        Parameters
        ----------
        controller : Controller
        y_s : float [m]
        follow_study : bool
            Leave the option `convention`, where the law has one, to the study.
        code : str, optional
            Content of the law's code, where it is known already.
        """
        gains = tuple(
            (g.name, FOLLOWS_STUDY if follow_study and g.name == CONVENTION_GAIN else getattr(controller, g.name))
            for g in controller.gains()
        )
        code = code_of(type(controller), dict(gains)) if code is None else code
        return cls(controller.name, float(y_s), gains, code)

    @classmethod
    def from_gains(cls, law: str, y_s: float, given: dict[str, Any]) -> Design:
        """The design of a law by name with some gains given; the rest keep their defaults.

        Raises `UnknownNameError` for an unknown law; `InputError` for a gain outside its declaration.
        """
        return cls.of(controller_class(law)(**given), y_s, follow_study=CONVENTION_GAIN not in given)

    def controller(self, convention: Convention = "consistent") -> Controller:
        """Build the controller anew from plain data (workers receive designs, not controllers).

        Parameters
        ----------
        convention : {"consistent", "as_printed"}
            Reading of the study, for a law that follows it.
        """
        gains = {name: convention if self._follows(name, value) else value for name, value in self.gains}
        return bound_class(self.law, self.code, same=True)(**gains)

    @property
    def kind(self) -> type[Controller]:
        """Class of the law that the design was made with."""
        return bound_class(self.law, self.code)

    @staticmethod
    def _follows(name: str, value: GainValue) -> bool:
        return name == CONVENTION_GAIN and value == FOLLOWS_STUDY

    @functools.cached_property  # used many times in a run
    def id(self) -> str:
        """Twelve hexadecimal digits that depend on the content only."""
        parts = [self.law, self.y_s, self.gains, *([self.code] if self.code else [])]
        content = json.dumps(parts, separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()[:12]

    @property
    def key(self) -> tuple[Any, ...]:
        """Law, threshold and gains: what two studies compare, also where the law's code is another."""
        return self.law, self.y_s, self.gains

    @property
    def batch(self) -> int:
        """Scenarios that are driven as one batch: the law's own choice."""
        return self.kind.batch

    @property
    def is_baseline(self) -> bool:
        """Whether the design never intervenes."""
        return self.law == NO_CONTROL

    @property
    def changed(self) -> tuple[tuple[str, GainValue], ...]:
        """The gains that differ from their defaults."""
        declared = self.kind.gains()
        return tuple(
            (name, value)
            for g, (name, value) in zip(declared, self.gains, strict=True)
            if value != g.default and not self._follows(name, value)
        )

    @property
    def label(self) -> str:
        """Short text for tables and legends: the law's title, y_s, and the gains that differ from their defaults."""
        gains = [f"{name}={gain_text(value)}" for name, value in self.changed]
        return ", ".join([self.kind.title, f"y_s={self.y_s:g} m", *gains])


def gain_text(value: GainValue) -> str:
    """A gain in tables and labels."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def named_designs(designs: Sequence[Design], names: Sequence[str]) -> list[Design]:
    """The designs with these labels or starts of identifiers, in this order, each once."""
    named: dict[str, Design] = {}
    for name in names:
        matches = [d for d in designs if name == d.label or (name and d.id.startswith(name.lower()))]
        if len(matches) > 1:
            problem = f"the ids of {len(matches)} designs start so"
            raise InputError(f"--design {name!r}", problem, allowed="more of the id")
        if not matches:
            # the labels of a large study fill a screen
            listing = "a label, or the id in ranking.csv" if len(designs) > 5 else ""
            close = nearest(name, [design.label for design in designs], listing)
            raise UnknownNameError(f"--design {name!r}", "no such design", hint=close)
        named[matches[0].id] = matches[0]
    return list(named.values())
