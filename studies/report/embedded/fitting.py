"""How many departures and designs the explorer holds: what fits into its part of the page."""

from __future__ import annotations

import dataclasses
from typing import Final

from studies.report.context import Context
from studies.report.embedded.departures import (
    BUDGET,
    COUNTS,
    MOST,
    bytes_of,
    embedded_departures,
    grids,
    trimmed,
    weight,
)
from studies.report.replay.paths import Replay, replay
from studies.report.replay.picks import Chosen, Pick, picked_departures

_FEWEST: Final = 100
"""Departures that further designs leave in the page."""


def fitted_departures(context: Context, designs: tuple[Chosen, ...]) -> tuple[int, Replay, dict[str, object]]:
    """Drive again what fits into the page: departures first, then further designs as long as a hundred departures stay.

    Parameters
    ----------
    context : Context
    designs : tuple of Chosen
        Further ones last.

    Returns
    -------
    every : int
        Samples of the controller from one embedded sample to the next.
    replayed : Replay
        With the designs that are in the page.
    data : dict
        What the script reads.
    """
    kept = tuple(one for one in designs if not one.further)
    every, picks = 1, picked_departures(context, kept, 0)
    for grid in grids(context.report.setup.dt):
        every, picks = grid.every, picked_departures(context, kept, grid.count)
        if weight(context, picks, kept, every) <= BUDGET:
            break
    else:
        picks = trimmed(context, picks, kept, every)
    # further designs take the place of departures that nobody asked for or named, down to a hundred
    for count in range(len(designs), len(kept), -1):
        for most in COUNTS:
            some = picked_departures(context, designs[:count], most)
            fits = weight(context, some, designs[:count], every) <= BUDGET
            if fits and len(some) >= min(_FEWEST, len(picks)):
                return _driven(context, every, some, designs[:count])
    return _driven(context, every, picks, kept)


def _driven(
    context: Context, every: int, picks: tuple[Pick, ...], designs: tuple[Chosen, ...]
) -> tuple[int, Replay, dict[str, object]]:
    """Further designs go first where paths weigh more than they were estimated to, then departures."""
    replayed = replay(context, picks, designs)
    data = embedded_departures(context, replayed, every)
    while bytes_of(data) > MOST and replayed.designs[-1].chosen.further:
        replayed = dataclasses.replace(replayed, designs=replayed.designs[:-1])
        data = embedded_departures(context, replayed, every)
    while bytes_of(data) > MOST and len(replayed.picks) > max(1, len(context.report.departures)):
        replayed = replayed.first(max(1, len(context.report.departures), int(0.8 * len(replayed.picks))))
        data = embedded_departures(context, replayed, every)
    return every, replayed, data
