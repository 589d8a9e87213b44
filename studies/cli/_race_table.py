"""How a race went, for a terminal."""

from __future__ import annotations

from studies.cli._console import console
from studies.results import Race


def print_race(race: Race) -> None:
    """One line a round, and what the race saved."""
    out = console()
    before = len(race.dropped) + race.alive[-1]
    for i, (size, alive) in enumerate(zip(race.rounds, race.alive, strict=True), start=1):
        out.print(f"round {i}: {size:,} scenarios, {before - alive} of {before} designs given up", highlight=False)
        before = alive
    share = 100 * race.runs / race.full_runs
    out.print(
        f"race: {race.runs:,} scenario runs, {share:.1f} % of the full study's; {len(race.dropped)} designs were "
        "separable from the best and were given up, see race.json\n",
        highlight=False,
        soft_wrap=True,
    )
