"""What `ldc extract` prints about what it found and what it could not use."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from studies.cli._console import console, warn

if TYPE_CHECKING:
    from ldctoolkit.recordings.recording import Problem
    from ldctoolkit.recordings.result import Extraction

PROBLEMS_TOLD: Final = 20


def tell_problems(problems: Sequence[Problem], *, written: bool) -> None:
    """What could not be used: the first twenty, one line each, and how many more there are.

    `written`: whether there is a departures table, which holds them.
    """
    for problem in problems[:PROBLEMS_TOLD]:
        warn(str(problem))
    if len(problems) > PROBLEMS_TOLD:
        more = len(problems) - PROBLEMS_TOLD
        where = "; the departures table holds them all" if written else ""
        warn(f"and {more:,} more problems, {len(problems):,} in all{where}")


def print_extraction(found: Extraction) -> None:
    """Candidates, departures by side, refused candidates by reason."""
    from rich.table import Table

    from ldctoolkit.departures import LEFT

    out = console()
    out.print(f"{found.candidates} candidates in {found.recordings} recordings, {found.hours:.1f} h")
    table = Table()
    table.add_column("candidate")
    table.add_column("count", justify="right")
    left = int((found.departures.side == LEFT).sum())
    table.add_row("departure, left", str(left))
    table.add_row("departure, right", str(len(found.departures) - left), end_section=True)
    for reason, count in found.refused.items():
        table.add_row(f"refused: {reason.replace('_', ' ')}", str(count))
    out.print(table)
