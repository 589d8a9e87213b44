"""Tables of the commands that compare studies and find out which gain matters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from ldctoolkit.registry import controller_class

from ..comparison.comparison import Comparison
from ..comparison.paired import Verdict, Winners
from ..design import Design, gain_text
from ..pages.landscape_section import index_table
from ..sensitivity.sensitivity import BlockSensitivity
from ..sensitivity.winner_profile import Profile
from ..tables import Column, Row, Table
from ._console import console, print_table, say

if TYPE_CHECKING:
    from rich.console import Console


_STYLE: Final = {Verdict.WORSE: "bad", Verdict.BETTER: "good", Verdict.NOT_SEPARATED: "", Verdict.SAME: "same"}
_MOST_LISTED: Final = 20


def print_comparison(comparison: Comparison, top: int, out: Console) -> None:
    """What differs between the inputs first, then the designs, the failures, the warnings and one sentence."""
    say(out, f"old: {comparison.old} ({comparison.old_name})", f"new: {comparison.new} ({comparison.new_name})")
    if comparison.differences:
        say(out, "Inputs that differ, old -> new:", *(f"  {text}" for text in comparison.differences))
    else:
        say(out, "The inputs are the same: what differs below is in the code of a law, or in the machine.")
    out.print()
    if len(comparison):
        print_table(_table(comparison, top), out)
    say(out, *_verdict_lines(comparison))
    out.print()
    for heading, failed in (
        ("failed only in the new study, worse:", comparison.new_failures),
        ("failed only in the old study:", comparison.repaired),
        ("failed in both studies:", comparison.failed_in_both),
    ):
        if failed:
            say(out, f"{len(failed)} design{'s' if len(failed) > 1 else ''} {heading}")
            say(out, *_some([f"  {one.sentence}" for one in failed]))
    for heading, designs in (("old", comparison.only_old), ("new", comparison.only_new)):
        if designs:
            say(out, f"Only in the {heading} study: {len(designs)} design{'s' if len(designs) > 1 else ''}")
    for warning in comparison.warnings:
        out.print(f"Warning: {warning}", style="yellow", markup=False, emoji=False)
    say(out, comparison.summary)


def _some(lines: Sequence[str]) -> Iterator[str]:
    yield from lines[:_MOST_LISTED]
    if len(lines) > _MOST_LISTED:
        yield f"  and {len(lines) - _MOST_LISTED} more"


def _table(comparison: Comparison, top: int) -> Table:
    """Worse designs first; those that are the same are counted below."""
    designs = f"{len(comparison)} design{'' if len(comparison) == 1 else 's'}"
    title = f"{designs} in both studies, {comparison.shared.n:,} shared scenarios, {comparison.label}"
    headings = ("old S", "new S", "new - old", f"{100 * comparison.confidence:g} % interval", "scenarios changed",
                "largest change", "failed old, new")  # fmt: skip
    columns = [Column("verdict", text=True), Column("design", text=True), *map(Column, headings)]
    order, verdict = comparison.order, comparison.S.verdict
    shown = [i for i in order if verdict[i] is not Verdict.SAME][:top] or list(order[:top])
    return Table(title, columns, [Row(_cells(comparison, i), _STYLE[verdict[i]]) for i in shown])


def _cells(comparison: Comparison, i: int) -> list[str]:
    S, changed = comparison.S, int(comparison.S.changed[i])
    at = f" (no. {comparison.shared.new[S.largest_at[i]]})"
    failed = (comparison.failed_old[i], comparison.failed_new[i])
    return [
        str(S.verdict[i]),
        comparison.designs[i].label,
        f"{S.S_old[i]:.4f}",
        f"{S.S_new[i]:.4f}",
        f"{S.difference[i]:+.2g}" if abs(S.difference[i]) < 1e-4 else f"{S.difference[i]:+.4f}",
        _interval(float(S.low[i]), float(S.high[i])),
        str(changed) if changed else "-",
        f"{S.largest[i]:+.2g}{at}" if changed else "-",
        f"{failed[0]}, {failed[1]}" if any(failed) else "-",
    ]


def _interval(low: float, high: float) -> str:
    if np.isnan(low):
        return "too few changed"
    if np.isinf(low):
        return "too few"
    digits = ".2g" if max(abs(low), abs(high)) < 1e-3 else ".4f"
    return f"{low:+{digits}} .. {high:+{digits}}"


def _verdict_lines(comparison: Comparison) -> Iterator[str]:
    same = comparison.count(Verdict.SAME)
    if same:
        yield f"the same within 1e-6 m s: {same} of {len(comparison)} designs"
    if comparison.winners is not None:
        yield f"{comparison.label}: {_winners_sentence(comparison.winners)}"


def _winners_sentence(winners: Winners) -> str:
    on = f"{winners.scenarios:,} {'fresh ' if winners.fresh else ''}shared scenarios"
    who = f"{winners.new.label} won both studies" if winners.same_design else (
        f"the new winner {winners.new.label} against the old one {winners.old.label}"
    )  # fmt: skip
    interval = _interval(winners.low, winners.high)
    numbers = f"{winners.S_old:.4f} -> {winners.S_new:.4f} m s, {winners.difference:+.4f} ({interval})"
    return f"{who}: {winners.verdict}, {numbers} on {on}"


def print_indices(blocks: Sequence[BlockSensitivity], label: str, confidence: float) -> None:
    """One table for every block with indices, and one line for every other."""
    for block in blocks:
        title = f"design[{block.block}], {controller_class(block.law).title}"
        if block.indices is None:
            say(console(), f"{title}: no Sobol indices: {block.reason}")
        else:
            print_table(index_table([block], f"{title}: Sobol indices of mean S, {label}", confidence))
            notes = (block.note, f"{block.designs} designs", f"intervals over {block.interval_over}")
            say(console(), "; ".join(note for note in notes if note))
        console().print()


def print_profiles(profiles: Sequence[Profile], middle: Design, which: str, label: str, confidence: float) -> None:
    """One line for every dimension, the one that moves S most first; `which` says what the design in the middle is."""
    say(console(), f"Around {middle.label} ({middle.id}), {which}, one at a time, {label}:")
    if not profiles:
        say(console(), "nothing varies in the designs of this law")
        return
    print_table(_profile_table(profiles, confidence))
    for profile in profiles:
        if (end := profile.beyond) is not None:
            say(console(), f"{profile.name}: S is least at {gain_text(end)}, the end of its range in this study: "
                  "something better may lie beyond")  # fmt: skip
        for value, reason in zip(profile.values, profile.failures, strict=True):
            if reason:
                say(console(), f"{profile.name} = {gain_text(value)}: {reason}")


def _profile_table(profiles: Sequence[Profile], confidence: float) -> Table:
    columns = [
        Column("dimension", text=True), Column("value"), Column("from"), Column("to"), Column("values (driven)"),
        Column("S moves by", "m\u00b7s", ".4f"), Column("least S at"), Column("there", "m\u00b7s", "+.4f"),
        Column(f"{100 * confidence:g} % interval", "m\u00b7s", "+.4f"),
    ]  # fmt: skip
    rows = []
    for one in sorted(profiles, key=lambda profile: -profile.spread):
        unit, best = "" if one.unit == "1" else f" {one.unit}", one.best
        ends = gain_text(one.values[0]), gain_text(one.values[-1])
        driven = f"{len(one.values)} ({int((~one.stored).sum())})"
        there = float(one.difference[best]), (float(one.low[best]), float(one.high[best]))
        middle, least = f"{gain_text(one.values[one.at])}{unit}", gain_text(one.values[best])
        rows.append(Row([one.name, middle, *ends, driven, one.spread, least, *there]))
    return Table("", columns, rows)
