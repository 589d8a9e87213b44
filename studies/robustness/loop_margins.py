"""Margins of a design's linear loop over speed, from the design review."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from typing import TYPE_CHECKING, Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.law_errors import raised
from ldctoolkit.review import SPEEDS, Finding, review

if TYPE_CHECKING:
    from ldctoolkit import Controller, Setup
    from ldctoolkit.simulation import Takeover


POINTS: Final = 7
"""Speeds."""

_TOLD: Final = ("raises", "finite", "quiet", "nonlinear", "memory", "bound")
"""Findings that say how far the margins go."""


@dataclasses.dataclass(frozen=True)
class LoopMargins:
    """Margins of one design at k speeds: NaN where the closed loop is unstable or there is no loop.

    Attributes
    ----------
    linear : bool
        Whether there is a linear loop to speak of.
    stable : (k,) bool
    gain : (k,) [dB]
        How much the gain may grow.
    gain_reduction : (k,) [dB]
        How much it may shrink.
    phase : (k,) [rad]
    delay : (k,) [s]
    notes : tuple of str
        How far that goes: of a law that is not linear, or that has no loop at all.
    """

    linear: bool
    stable: BoolArray
    gain: FloatArray
    gain_reduction: FloatArray
    phase: FloatArray
    delay: FloatArray
    notes: tuple[str, ...]


def trigger_speeds(takeovers: Iterable[Takeover]) -> FloatArray:
    """Speeds from the slowest to the fastest trigger, (k,) [m/s]; the review's own range where nothing triggers."""
    v = [takeover.plant.v for takeover in takeovers if takeover.m]
    if not v:
        return np.linspace(SPEEDS[0], SPEEDS[-1], POINTS)
    low, high = min(float(one.min()) for one in v), max(float(one.max()) for one in v)
    return np.linspace(low, high, POINTS if high > low else 1)


def loop_margins(controller: Controller, setup: Setup, v: FloatArray) -> LoopMargins:
    """The margins of a design on the study's plant.

    Parameters
    ----------
    controller : Controller
    setup : Setup
    v : (k,) [m/s]

    Returns
    -------
    LoopMargins
        What the design raises is a note.
    """
    try:
        found = review(
            controller, model=setup.model, dt=setup.dt, options=setup.options, speeds=v,
            plant_knowledge=setup.plant_knowledge,
        )  # fmt: skip
    except Exception as error:  # a controller may be anybody's code
        return _without(v, (f"No linear loop: {raised(error)}",))
    notes = tuple(finding.sentence for finding in found.findings if _matters(finding))
    loop = found.loop
    if loop is None:
        return _without(v, notes or tuple(finding.sentence for finding in found.findings))
    return LoopMargins(
        True, loop.stable, loop.gain_margin, loop.gain_reduction_margin, loop.phase_margin, loop.delay_margin, notes
    )


def _matters(finding: Finding) -> bool:
    return finding.name in _TOLD


def _without(v: FloatArray, notes: tuple[str, ...]) -> LoopMargins:
    nothing = np.full(v.size, np.nan)
    return LoopMargins(False, np.zeros(v.size, dtype=np.bool_), nothing, nothing, nothing, nothing, notes)
