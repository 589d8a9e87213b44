"""How a race went, for a terminal."""

from __future__ import annotations

from studies.cli._console import console
from studies.results import Race


def print_race(race: Race) -> None:
    """One line a round, and what the race saved."""
    out = console()
    before = len(race.dropped) + race.alive[-1]
    for i, (size, alive) in enumerate(zip(race.rounds, race.alive, strict=True), start=1):
        given_up = f"{before - alive} of {before} design{'' if before == 1 else 's'} given up"
        out.print(f"round {i}: {size:,} scenario{'' if size == 1 else 's'}, {given_up}", highlight=False)
        before = alive
    share = 100 * race.runs / race.full_runs
    number = len(race.dropped)
    were = "1 design was" if number == 1 else f"{number} designs were"
    out.print(
        f"race: {race.runs:,} scenario runs, {share:.1f} % of the full study's; {were} separable from the best and "
        f"{'was' if number == 1 else 'were'} given up, see ranking.csv\n",
        highlight=False,
        soft_wrap=True,
    )
