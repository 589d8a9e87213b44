"""The paper's own design, to be found among others."""

from __future__ import annotations

from typing import Final

from studies.design import Design

PAPER_LAW: Final = "preview_proportional"
"""Registry name of the paper's law."""

_PAPER_DESIGN: Final = {"y_s": 0.2, "K_y": -0.005, "K_psi": -0.2, "T_lp": 2.0}
"""Table I of the paper."""


def is_paper_design(design: Design) -> bool:
    """Whether it is the design of the paper's Table I.

    Examples
    --------
    >>> is_paper_design(Design.from_gains("preview_proportional", 0.2, {"K_y": -0.01}))
    False
    """
    values = {"y_s": design.y_s, **dict(design.gains)}
    return design.law == PAPER_LAW and all(values.get(name) == value for name, value in _PAPER_DESIGN.items())
