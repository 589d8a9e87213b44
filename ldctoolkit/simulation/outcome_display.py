"""An outcome in a notebook: counts and means in a small table, one piece of escaped HTML with its own styles."""

from __future__ import annotations

import html
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ldctoolkit.control import EventStatus
from ldctoolkit.departures import LEFT, RIGHT

if TYPE_CHECKING:
    from ldctoolkit.simulation.outcome import Outcome

# no ground and no text colour of its own: the notebook's theme, light or dark, sets them
_CELL = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"
_NAMES = {
    EventStatus.OK: "taken over and driven to the end",
    EventStatus.NEVER_TRIGGERED: "never triggered",
    EventStatus.SOLVER_FAILED: "solver failed",
    EventStatus.DIVERGED: "diverged",
    EventStatus.TIMED_OUT: "timed out",
    EventStatus.INVALID: "cannot be driven",
    EventStatus.CRASHED: "crashed",
}
_FAILURES = (EventStatus.SOLVER_FAILED, EventStatus.DIVERGED, EventStatus.TIMED_OUT, EventStatus.CRASHED)


def outcome_html(outcome: Outcome) -> str:
    """An outcome as HTML without script.

    Parameters
    ----------
    outcome : Outcome

    Returns
    -------
    str
        Everything in it is escaped. Means leave out scenarios that cannot be driven.
    """
    n = outcome.S.size
    title = f"Outcome of {n:,} scenario{'' if n == 1 else 's'}, {outcome.window} window"
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left;font-weight:normal;{_CELL}">{html.escape(name)}</th>'
        f'<td style="text-align:right;white-space:nowrap;{_CELL}">{html.escape(value)}</td></tr>'
        for name, value in _lines(outcome)
    )
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b></div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><tbody>{rows}</tbody></table></div>'
    )


def _lines(outcome: Outcome) -> Iterator[tuple[str, str]]:
    every = outcome.status != EventStatus.INVALID
    yield from _scores(outcome, every, "")
    if outcome.side is not None:
        for side, name in ((LEFT, "left"), (RIGHT, "right")):
            rows = every & (outcome.side == side)
            if rows.any():
                yield from _scores(outcome, rows, f", {name} ({int(rows.sum()):,})")
    deepest = outcome.deepest[every]
    if deepest.size and np.isfinite(deepest).any():
        row = int(np.flatnonzero(every)[np.nanargmax(deepest)])
        yield "deepest beyond the line", f"{outcome.deepest[row]:.3f} m (no. {row})".replace("-", "\u2212")
    for status in EventStatus:
        count = outcome.count(status)
        if count:
            yield _NAMES[status], f"{count:,}"
    yield "failures", f"{sum(outcome.count(status) for status in _FAILURES):,}"
    if outcome.failed_solves.any():
        yield "commands from a fallback", f"{int(outcome.failed_solves.sum()):,}"


def _scores(outcome: Outcome, rows: npt.NDArray[np.bool_], where: str) -> Iterator[tuple[str, str]]:
    if not rows.any():
        return
    S, S_0 = float(np.mean(outcome.S[rows])), float(np.mean(outcome.S_uncorrected[rows]))
    change = f", {100.0 * (S / S_0 - 1.0):+.1f} %".replace("-", "\u2212") if S_0 > 0 else ""
    yield f"mean S with control{where}", f"{S:.4f} m s{change}"
    yield f"mean S without control{where}", f"{S_0:.4f} m s"
