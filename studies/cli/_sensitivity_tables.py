"""Sobol indices and profiles as tables for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit import controller_class
from studies.cli._console import add_row, console, gain_text, new_table, say
from studies.design import Design
from studies.sensitivity.sensitivity import BlockSensitivity
from studies.sensitivity.winner_profile import Profile

if TYPE_CHECKING:
    from rich.table import Table


def print_indices(blocks: Sequence[BlockSensitivity], case: str, confidence: float) -> None:
    """One table for every block with indices, and one line for every other."""
    for block in blocks:
        title = f"design[{block.block}], {controller_class(block.law).title}"
        if block.indices is None:
            say(console(), f"{title}: no Sobol indices: {block.reason}")
        else:
            console().print(_index_table(block, f"{title}: Sobol indices of mean S, {case}", confidence))
            notes = (block.note, f"{block.designs} designs", f"intervals over {block.interval_over}")
            say(console(), "; ".join(note for note in notes if note))
        console().print()


def print_profiles(profiles: Sequence[Profile], middle: Design, which: str, case: str, confidence: float) -> None:
    """One line for every dimension, the one that moves S most first; `which` says what the design in the middle is."""
    say(console(), f"Around {middle.label} ({middle.id}), {which}, one at a time, {case}:")
    if not profiles:
        say(console(), "nothing varies in the designs of this law")
        return
    console().print(_profile_table(profiles, confidence))
    for profile in profiles:
        if (end := profile.beyond) is not None:
            say(console(), f"{profile.name}: S is least at {gain_text(end)}, the end of its range in this study: "
                  "something better may lie beyond")  # fmt: skip
        for value, reason in zip(profile.values, profile.failures, strict=True):
            if reason:
                say(console(), f"{profile.name} = {gain_text(value)}: {reason}")


def _index_table(block: BlockSensitivity, title: str, confidence: float) -> Table:
    found, interval = block.indices, f"{100 * confidence:g}%\ninterval"
    table = new_table(title, ("dimension", "first order", interval, "total", interval))
    if found is None:
        return table
    weight = np.where(np.isnan(found.total), found.first, found.total)
    for i in np.argsort(-weight, kind="stable"):
        row = [block.names[i], f"{found.first[i]:.3f}", f"{found.first_low[i]:.3f} .. {found.first_high[i]:.3f}"]
        if np.isnan(found.total[i]):
            row += ["-", "-"]
        else:
            row += [f"{found.total[i]:.3f}", f"{found.total_low[i]:.3f} .. {found.total_high[i]:.3f}"]
        add_row(table, row)
    return table


def _profile_table(profiles: Sequence[Profile], confidence: float) -> Table:
    interval = f"{100 * confidence:g}%\ninterval"
    headings = ("dimension", "value", "from", "to", "values\n(driven)", "S moves by\n[m s]")
    table = new_table("", (*headings, "least S at", "there\n[m s]", interval))
    for one in sorted(profiles, key=lambda profile: -profile.spread):
        unit = "" if one.unit == "1" else f" {one.unit}"
        best = one.best
        row = [
            one.name,
            f"{gain_text(one.values[one.at])}{unit}",
            gain_text(one.values[0]),
            gain_text(one.values[-1]),
            f"{len(one.values)} ({int((~one.stored).sum())})",
            f"{one.spread:.4f}",
            gain_text(one.values[best]),
            f"{one.difference[best]:+.4f}",
            f"{one.low[best]:+.4f} .. {one.high[best]:+.4f}",
        ]
        add_row(table, row)
    return table
