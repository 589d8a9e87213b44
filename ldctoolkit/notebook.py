"""What a notebook shows of an object: escaped HTML without script."""

import html
from collections.abc import Iterable
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.control import EventStatus, StatusArray
from ldctoolkit.departures import LEFT, RIGHT

# no ground and no text colour of its own: the notebook's theme, light or dark, sets them
CELL: Final = "padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"

_NAMES = {
    EventStatus.OK: "taken over and driven to the end",
    EventStatus.NEVER_TRIGGERED: "never triggered",
    EventStatus.SOLVER_FAILED: "solver failed",
    EventStatus.DIVERGED: "diverged",
    EventStatus.TIMED_OUT: "timed out",
    EventStatus.INVALID: "cannot be driven",
    EventStatus.CRASHED: "crashed",
    EventStatus.BEYOND_DELTA_MAX: "taken over beyond delta_max, driven to the end",
}
_FAILURES = (EventStatus.SOLVER_FAILED, EventStatus.DIVERGED, EventStatus.TIMED_OUT, EventStatus.CRASHED)


def facts_html(title: str, lines: Iterable[tuple[str, str]], value_style: str) -> str:
    """A title and a table of names and values, these in a CSS style."""
    rows = "".join(
        f'<tr><th scope="row" style="text-align:left;font-weight:normal;{CELL}">{html.escape(name)}</th>'
        f'<td style="{value_style};{CELL}">{html.escape(value)}</td></tr>'
        for name, value in lines
    )
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(title)}</b></div>'
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><tbody>{rows}</tbody></table></div>'
    )


def outcome_html(
    window: str,
    S: FloatArray,
    S_uncorrected: FloatArray,
    deepest: FloatArray,
    status: StatusArray,
    failed_solves: IntArray,
    side: IntArray | None,
) -> str:
    """Of one design on n scenarios, arrays of n as in `Outcome`; means leave out what cannot be driven."""
    every, lines = status != EventStatus.INVALID, []

    def means(rows: BoolArray, where: str) -> None:
        if rows.any():
            mean, mean_0 = float(np.mean(S[rows])), float(np.mean(S_uncorrected[rows]))
            change = f", {100.0 * (mean / mean_0 - 1.0):+.1f} %".replace("-", "\u2212") if mean_0 > 0 else ""
            lines.append((f"mean S with control{where}", f"{mean:.4f} m s{change}"))
            lines.append((f"mean S without control{where}", f"{mean_0:.4f} m s"))

    means(every, "")
    for number, name in () if side is None else ((LEFT, "left"), (RIGHT, "right")):
        rows = every & (side == number)
        means(rows, f", {name} ({int(rows.sum()):,})")
    if np.isfinite(deepest[every]).any():
        row = int(np.flatnonzero(every)[np.nanargmax(deepest[every])])
        lines.append(("deepest beyond the line", f"{deepest[row]:.3f} m (no. {row})".replace("-", "\u2212")))
    counts = {one: int(np.sum(status == one)) for one in EventStatus}
    lines += [(_NAMES[one], f"{count:,}") for one, count in counts.items() if count]
    lines.append(("failures", f"{sum(counts[one] for one in _FAILURES):,}"))
    if failed_solves.any():
        lines.append(("commands from a fallback", f"{int(failed_solves.sum()):,}"))
    title = f"Outcome of {S.size:,} scenario{'' if S.size == 1 else 's'}, {window} window"
    return facts_html(title, lines, "text-align:right;white-space:nowrap")
