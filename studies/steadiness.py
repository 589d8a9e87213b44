"""Whether a law keeps state between runs: a few departures of a run, driven once more, must give the same numbers.

What a design scores would otherwise depend on what was run before it, and so on how a study is split.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import InitialYawRate, Takeover
from studies.run_table import RunResult

IntArray = npt.NDArray[np.int64]

_DEPARTURES = 6

_SAME = 1e-9
"""Of S: sums in another order, in a batch of another size, are no state."""

_SAME_SINGLE = 1e-6
"""Of the companions, which are kept in single precision."""


def first_departures(takeover: Takeover, initial_yaw_rate: InitialYawRate, settle: float) -> tuple[IntArray, Takeover]:
    """The first few departures that trigger: their row numbers (k,), and a takeover of them alone."""
    rows = np.sort(takeover.rows)[:_DEPARTURES]
    return rows, Takeover.build(
        takeover.scenarios.take(rows),
        takeover.model,
        y_s=takeover.y_s,
        dt=takeover.dt,
        initial_yaw_rate=initial_yaw_rate,
        options=takeover.options,
        seed=takeover.seed,
        settle=settle,
    )


def kept_state(result: RunResult, rows: IntArray, again: RunResult) -> str:
    """A sentence if some departures have other numbers when they are driven once more; empty if they do not.

    Parameters
    ----------
    result : RunResult
        Of all departures.
    rows : (k,) int
        Which were driven again.
    again : RunResult
        Of these alone.
    """
    pairs: list[tuple[npt.NDArray[Any], npt.NDArray[Any], float]] = [(result.S[:, rows], again.S, _SAME)]
    pairs += [(result.status[rows], again.status, 0.0), (result.failed_solves[rows], again.failed_solves, 0.0)]
    pairs += [
        (getattr(result.companions, name)[rows], getattr(again.companions, name), _SAME_SINGLE)
        for name in COMPANION_UNITS
    ]
    same = [np.isclose(a, b, rtol=most, atol=most, equal_nan=True).reshape(-1, rows.size) for a, b, most in pairs]
    wrong = ~np.concatenate(same).all(axis=0)
    if not wrong.any():
        return ""
    i = int(np.argmax(wrong))
    return (
        "keeps state between runs: the same departure, driven twice, gave "
        f"S = {result.S[0, rows[i]]:.9g} m s and then {again.S[0, i]:.9g} m s; "
        "allowed: state that init makes and step returns"
    )
