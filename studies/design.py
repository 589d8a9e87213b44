"""A design of a study: a law with its gains and its trigger threshold."""

from __future__ import annotations

import dataclasses
import hashlib
import json

from ldctoolkit import Controller, controller_class
from ldctoolkit.gains import GainValue


@dataclasses.dataclass(frozen=True)
class Design:
    """One row of a ranking.

    Attributes
    ----------
    law : str
        Registry name of the controller.
    y_s : float [m]
        Trigger threshold.
    gains : tuple of (name, value)
        Every declared gain and option in the law's own order, defaults included.
    """

    law: str
    y_s: float
    gains: tuple[tuple[str, GainValue], ...]

    @classmethod
    def of(cls, controller: Controller, y_s: float) -> Design:
        """The design that a controller and a threshold make."""
        return cls(controller.name, float(y_s), tuple((g.name, getattr(controller, g.name)) for g in controller.gains()))

    def controller(self) -> Controller:
        """Build the controller anew from plain data (workers receive designs, not controllers)."""
        return controller_class(self.law)(**dict(self.gains))

    @property
    def id(self) -> str:
        """Twelve hexadecimal digits that depend on the content only."""
        content = json.dumps([self.law, self.y_s, self.gains], separators=(",", ":"))
        return hashlib.sha256(content.encode()).hexdigest()[:12]

    @property
    def label(self) -> str:
        """Short text for tables and legends: the law's title, y_s, and the gains that differ from their defaults."""
        kind = controller_class(self.law)
        changed = [f"{g.name}={value:g}" if isinstance(value, float) else f"{g.name}={value}"
                   for g, (_, value) in zip(kind.gains(), self.gains, strict=True) if value != g.default]  # fmt: skip
        return ", ".join([kind.title, f"y_s={self.y_s:g} m", *changed])
