"""Where a figure of the diagnosis becomes a warning."""

from __future__ import annotations

from typing import Final

from ldctoolkit.diagnostics.parts import Strip

LEAST_PROBABILITY: Final = 1e-6
"""P of a component in the box."""

FAR_OUTSIDE: Final = 5.0
"""Standard deviations of a component's mean outside the box."""

ILL_CONDITIONED: Final = 1e4
"""Condition number of a component's correlation matrix."""

STRIP_ERROR: Final = 0.2
STRIP_STANDARD_ERRORS: Final = 4.0
"""Both must be exceeded by the error of the mass next to a bound."""

COMPARISON_STANDARD_ERRORS: Final = 2.0
"""By which one of two mixtures is better on held-out events."""


def strip_is_off(strip: Strip) -> bool:
    """Whether the mass next to a bound is clearly wrong."""
    return abs(strip.error) > max(STRIP_ERROR, STRIP_STANDARD_ERRORS * strip.standard_error)
