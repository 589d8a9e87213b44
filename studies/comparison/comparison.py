"""What a comparison of two studies found."""

from __future__ import annotations

import dataclasses
import html
from typing import Final

import numpy as np

from ldctoolkit.notebook import CELL
from studies.comparison.paired_verdicts import PairedDifferences, Verdict
from studies.comparison.shared_scenarios import SharedScenarios
from studies.comparison.winners import Winners
from studies.design import Design
from studies.results import Case, FailedDesign

PHRASES: Final = {
    Verdict.BETTER: "better",
    Verdict.WORSE: "worse",
    Verdict.UNTOLD: "not separated",
    Verdict.SAME: "the same",
}
"""Verdict -> how a sentence says it."""

TOP: Final = 20
"""Rows, of the primary case."""


@dataclasses.dataclass(frozen=True)
class CaseComparison:
    """The k designs that both studies ran, in one case; arrays have one entry a design, in the new study's order."""

    case: Case
    designs: tuple[Design, ...]
    S: PairedDifferences  # Mean S in both studies, their difference with its interval, and the verdict
    # Shared scenarios that failed (solver failed, diverged, timed out, crashed)
    failed_old: tuple[int, ...]
    failed_new: tuple[int, ...]
    # The new study's winner against the old one's; None where no design meets the requirements of one of them, or a
    # race was in another case
    winners: Winners | None
    # A race gave designs up by their scores in another case. Its best design here may be among them, so that there is
    # no winner to compare
    raced_elsewhere: bool = False

    def __len__(self) -> int:
        return len(self.designs)

    def count(self, verdict: Verdict) -> int:
        """Number of designs with this verdict."""
        return self.S.verdict.count(verdict)

    @property
    def order(self) -> tuple[int, ...]:
        """Positions of the designs: worse ones first, then better, untold and unchanged ones, large changes first."""
        rank = {verdict: i for i, verdict in enumerate((Verdict.WORSE, Verdict.BETTER, Verdict.UNTOLD, Verdict.SAME))}
        return tuple(
            sorted(range(len(self)), key=lambda i: (rank[self.S.verdict[i]], -abs(float(self.S.difference[i]))))
        )


@dataclasses.dataclass(frozen=True)
class Comparison:
    """An old and a new study on shared scenarios.

    Attributes
    ----------
    old, new : str
        Folders.
    old_name, new_name : str
        Names of the studies.
    differences : tuple of str
        What decides the numbers and is not the same, as ``"vehicle.m: 1000.0 -> 1100.0"``.
    shared : SharedScenarios
        Those that could be driven in both.
    cases : tuple of CaseComparison
        Cases that both studies have, in the new study's order.
    only_old, only_new : tuple of Design
        Designs that one study has results of and the other does not hold.
    new_failures, repaired, failed_in_both : tuple of FailedDesign
        Designs of both studies whose law failed in the new one only, in the old one only, and in both.
    given_up : tuple of Design
        Designs of both studies that a race gave up in one of them.
    bootstrap : int
        Resamples.
    confidence : float
        Of the intervals, all designs and cases together.
    warnings : tuple of str
    """

    old: str
    new: str
    old_name: str
    new_name: str
    differences: tuple[str, ...]
    shared: SharedScenarios
    cases: tuple[CaseComparison, ...]
    only_old: tuple[Design, ...]
    only_new: tuple[Design, ...]
    new_failures: tuple[FailedDesign, ...]
    repaired: tuple[FailedDesign, ...]
    failed_in_both: tuple[FailedDesign, ...]
    given_up: tuple[Design, ...]
    bootstrap: int
    confidence: float
    warnings: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return comparison_html(self)

    @property
    def any_worse(self) -> bool:
        """A design is worse in some case, fails now, or the new winner is worse than the old one."""
        return bool(self.new_failures) or any(
            case.count(Verdict.WORSE) or (case.winners is not None and case.winners.verdict is Verdict.WORSE)
            for case in self.cases
        )

    @property
    def summary(self) -> str:
        """One sentence: how many designs of the primary case got better, worse, stayed or are not separated."""
        shared = f"{self.shared.n:,} shared scenarios ({self.shared.left:,} left, {self.shared.right:,} right)"
        first = self.cases[0]
        if len(first):
            counts = ", ".join(f"{first.count(verdict)} {PHRASES[verdict]}" for verdict in Verdict)
            told = f"{len(first)} design{'s' if len(first) > 1 else ''} in both, {first.case.label}: {counts}"
        else:
            told = f"no design in both, {first.case.label}"
        failed = f"; {len(self.new_failures)} failed only in the new study" if self.new_failures else ""
        nothing = "not compared" if first.raced_elsewhere else "no winner"
        winners = nothing if first.winners is None else PHRASES[first.winners.verdict]
        return f"{shared}; {told}{failed}; the new winner against the old one: {winners}."


def comparison_html(comparison: Comparison, top: int = TOP) -> str:
    """A comparison as HTML without script."""
    case = comparison.cases[0]
    names = ("verdict", "design", "old S [m s]", "new S [m s]", "new \u2212 old [m s]", "interval")
    headings = "".join(f'<th scope="col" style="text-align:left;{CELL}">{html.escape(name)}</th>' for name in names)
    rows = "".join(_row(case, i) for i in case.order[:top])
    differs = "".join(f"<br>{html.escape(text)}" for text in comparison.differences)
    warnings = "".join(f"<br><b>Warning:</b> {html.escape(text)}" for text in comparison.warnings)
    more = len(case) - min(top, len(case))
    return (
        f'<div style="overflow-x:auto"><div><b>{html.escape(comparison.old_name)} &rarr; '
        f"{html.escape(comparison.new_name)}</b><br>{html.escape(comparison.summary)}{differs}{warnings}</div>"
        f'<table style="border-collapse:collapse;font-variant-numeric:tabular-nums"><thead><tr>{headings}</tr></thead>'
        f"<tbody>{rows}</tbody></table>{f'<div>and {more:,} more</div>' if more else ''}</div>"
    )


def _row(case: CaseComparison, i: int) -> str:
    S = case.S
    interval = f"{S.low[i]:+.4f} to {S.high[i]:+.4f}" if np.isfinite(S.low[i] + S.high[i]) else "too few changed"
    numbers = (f"{S.S_old[i]:.4f}", f"{S.S_new[i]:.4f}", f"{S.difference[i]:+.4g}", interval)
    cells = (str(S.verdict[i]), case.designs[i].label, *(one.replace("-", "\u2212") for one in numbers))
    # only a design's label may break
    styles = (CELL + ";white-space:nowrap" * (column != 1) for column in range(len(cells)))
    shown = (
        f'<td style="text-align:left;{style}">{html.escape(cell)}</td>'
        for style, cell in zip(styles, cells, strict=True)
    )
    return f"<tr>{''.join(shown)}</tr>"
