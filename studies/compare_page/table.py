"""Rows of the table of designs: as text for the page, and as numbers for its script."""

from __future__ import annotations

import dataclasses

import numpy as np

from studies.compare_page.sentences import interval_text
from studies.comparison.comparison import CaseComparison, Comparison
from studies.comparison.paired_verdicts import Verdict
from studies.report.embedded.packed import packed
from studies.report.words.text import difference_text, number, printable

MOST_STATIC = 100
"""Rows that stand in the page without its script; the script shows all."""

VERDICTS = tuple(Verdict)
MARKS = {Verdict.BETTER: "▼", Verdict.WORSE: "▲", Verdict.UNTOLD: "?", Verdict.SAME: "="}
"""What stands beside a verdict, so that no colour is needed: S falls, rises, or neither."""


@dataclasses.dataclass(frozen=True)
class DesignRow:
    """One design of both studies, cell by cell.

    Attributes
    ----------
    verdict, mark : str
        The mark says the same as the word.
    label, law : str
    S_old, S_new, difference, interval : str
        In m s.
    changed : str
        Departures whose S changed.
    largest : str
        The largest change of one departure [m s], and which one it is.
    failed : str
        Departures that failed, old and new.
    """

    verdict: str
    mark: str
    label: str
    law: str
    S_old: str
    S_new: str
    difference: str
    interval: str
    changed: str
    largest: str
    failed: str


def design_rows(comparison: Comparison, case: CaseComparison) -> tuple[DesignRow, ...]:
    """The first rows of a case, worse ones first.

    Parameters
    ----------
    comparison : Comparison
    case : CaseComparison
        One of its cases.

    Returns
    -------
    tuple of DesignRow
        At most `MOST_STATIC`.
    """
    S, shared = case.S, comparison.shared
    rows = []
    for i in case.order[:MOST_STATIC]:
        changed = int(S.changed[i])
        largest = f"{difference_text(float(S.largest[i]))} (no. {int(shared.new[S.largest_at[i]])})" if changed else "–"  # noqa: RUF001
        rows.append(
            DesignRow(
                verdict=str(S.verdict[i]),
                mark=MARKS[S.verdict[i]],
                label=case.designs[i].label,
                law=case.designs[i].law,
                S_old=number(float(S.S_old[i]), 4),
                S_new=number(float(S.S_new[i]), 4),
                difference=difference_text(float(S.difference[i])),
                interval=interval_text(float(S.low[i]), float(S.high[i])),
                changed=f"{changed:,}",
                largest=largest,
                failed=f"{case.failed_old[i]:,}, {case.failed_new[i]:,}",
            )
        )
    return tuple(rows)


def table_data(comparison: Comparison) -> list[dict[str, object]]:
    """What the script draws every row from, one entry a case; designs in the order of the static table.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    list of dict
        Laws, labels, and packed arrays with one entry a design.
    """
    every: list[dict[str, object]] = []
    for case in comparison.cases:
        order, S = list(case.order), case.S
        laws = sorted({design.law for design in case.designs})
        largest_at = comparison.shared.new[S.largest_at[order]] if order else np.zeros(0)
        every.append(
            {
                "laws": laws,
                "labels": [printable(case.designs[i].label) for i in order],
                "law": packed([laws.index(case.designs[i].law) for i in order], "u2"),
                "verdict": packed([VERDICTS.index(S.verdict[i]) for i in order], "u1"),
                "S_old": packed(S.S_old[order]),
                "S_new": packed(S.S_new[order]),
                "difference": packed(S.difference[order]),
                "low": packed(S.low[order]),
                "high": packed(S.high[order]),
                "changed": packed(S.changed[order], "i4"),
                "largest": packed(S.largest[order]),
                "largest_at": packed(largest_at, "i4"),
                "failed_old": packed([case.failed_old[i] for i in order], "i4"),
                "failed_new": packed([case.failed_new[i] for i in order], "i4"),
            }
        )
    return every
