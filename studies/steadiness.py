"""Whether a law keeps state between runs: the same few departures driven twice must give the same numbers.

What a design scores would otherwise depend on what was run before it, and so on how a study is split.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ldctoolkit import Controller
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import Run, Takeover, drive

FloatArray = npt.NDArray[np.float64]

_DEPARTURES = 6


def first_departures(takeover: Takeover) -> Takeover | None:
    """The same takeover with its first few departures that trigger, scored to their end; None where none does."""
    if not takeover.m:
        return None
    rows = np.sort(takeover.rows)[:_DEPARTURES]
    return Takeover.build(
        takeover.scenarios.take(rows),
        takeover.model,
        y_s=takeover.y_s,
        dt=takeover.dt,
        options=takeover.options,
        seed=takeover.seed,
        settle=0.0,
    )


def kept_state(controller: Controller, few: Takeover) -> str:
    """A sentence if a design gives other numbers when it is driven a second time; empty if it does not.

    Parameters
    ----------
    controller : Controller
        It has been driven on all departures before, without an error.
    few : Takeover
        Of `first_departures`.
    """
    first, second = (drive(controller, few, threads=1) for _ in range(2))
    wrong = np.logical_or.reduce([_differ(a, b) for a, b in zip(_numbers(first), _numbers(second), strict=True)])
    if not wrong.any():
        return ""
    S, again = (run.outcome("departure").S[few.rows] for run in (first, second))
    i = int(np.argmax(wrong))
    return (
        "keeps state between runs: the same departure, driven twice, gave "
        f"S = {S[i]:.9g} m s and then {again[i]:.9g} m s; allowed: state that init makes and step returns"
    )


def _numbers(run: Run) -> list[FloatArray]:
    """Everything that a run says of its departures, but the time it took."""
    area = [] if run.area is None else [run.area]
    companions = [getattr(run.companions, name) for name in COMPANION_UNITS]
    return [*area, run.status.astype(float), run.failed_solves.astype(float), *companions]


def _differ(one: FloatArray, other: FloatArray) -> npt.NDArray[np.bool_]:
    return np.asarray((one != other) & ~(np.isnan(one) & np.isnan(other)), dtype=np.bool_)
