"""Whether a law keeps state between runs: a few departures of a run, driven once more, must give the same numbers.

What a design scores would otherwise depend on what was run before it, and so on how a study is split.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import IntArray
from ldctoolkit.metrics import COMPANION_UNITS
from ldctoolkit.simulation import Outcome, Takeover

_DEPARTURES = 6

_SAME = 1e-9
"""Of S: sums in another order, in a batch of another size, are no state."""

_SAME_COMPANION = 1e-6
"""Of the companions: peaks and rates magnify what S averages."""


def first_departures(takeover: Takeover) -> tuple[IntArray, Takeover]:
    """The first few departures that trigger: their row numbers (k,), and a takeover of them alone."""
    rows = np.sort(takeover.rows)[:_DEPARTURES]
    return rows, Takeover.build(takeover.scenarios.take(rows), takeover.setup, y_s=takeover.y_s)


def kept_state(
    columns: Sequence[str],
    values: npt.NDArray[np.float64],
    status: npt.NDArray[np.int8],
    failed_solves: npt.NDArray[np.int32],
    again: Sequence[Outcome],
) -> str:
    """A sentence if departures have other numbers when they are driven once more; empty if they do not.

    Parameters
    ----------
    columns : sequence of str
        c names of the columns of a result.
    values : (c, m)
        Of m departures.
    status, failed_solves : (m,)
    again : sequence of Outcome
        Of the same departures, one a window.
    """
    scores = [numbers for outcome in again for numbers in (outcome.S, outcome.S_uncorrected)]
    second = [*scores, *(getattr(again[0].companions, name) for name in COMPANION_UNITS)]
    same = (status == again[0].status) & (failed_solves == again[0].failed_solves)
    for column, (name, numbers) in enumerate(zip(columns, second, strict=True)):
        most = _SAME_COMPANION if name in COMPANION_UNITS else _SAME
        same &= np.isclose(values[column], numbers, rtol=most, atol=most, equal_nan=True)
    if same.all():
        return ""
    i = int(np.argmin(same))
    return (
        "keeps state between runs: the same departure, driven twice, gave "
        f"S = {values[0, i]:.9g} m s and then {second[0][i]:.9g} m s; "
        "allowed: state that init makes and step returns"
    )
