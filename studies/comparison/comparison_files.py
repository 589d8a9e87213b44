"""A comparison of two studies as plain data for scripts, and as a CSV file."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from studies.comparison.comparison import CaseComparison, Comparison
from studies.comparison.winners import Winners
from studies.storage.files import write_text

COLUMNS = (
    "window",
    "convention",
    "compared",
    "verdict",
    "design_old",
    "design_new",
    "label_old",
    "label_new",
    "S_old_m_s",
    "S_new_m_s",
    "difference_m_s",
    "difference_low_m_s",
    "difference_high_m_s",
    "scenarios",
    "changed_scenarios",
    "largest_change_m_s",
    "largest_change_scenario",
    "failed_scenarios_old",
    "failed_scenarios_new",
    "reason",
)
"""Of the CSV file; what a row has no value for is empty."""


def comparison_rows(comparison: Comparison) -> Iterator[dict[str, Any]]:
    """One row a case and design, one a case for its winners if it has some, and one for each design that failed."""
    for case in comparison.cases:
        where = {"window": str(case.case.window), "convention": str(case.case.convention)}
        for i in case.order:
            yield where | {"compared": "design"} | _design(comparison, case, i)
        if case.winners is not None:
            yield where | {"compared": "winners"} | _winners(case.winners)
    failures = {
        "new failure": comparison.new_failures,
        "no longer fails": comparison.repaired,
        "fails in both": comparison.failed_in_both,
    }
    for verdict, failed in failures.items():
        for one in failed:
            names = {"design_old": one.design.id, "design_new": one.design.id}
            labels = {"label_old": one.design.label, "label_new": one.design.label}
            yield {"compared": "failure", "verdict": verdict, **names, **labels, "reason": one.reason}


def _design(comparison: Comparison, case: CaseComparison, i: int) -> dict[str, Any]:
    design, S = case.designs[i], case.S
    changed = int(S.changed[i])
    return {
        "verdict": str(S.verdict[i]),
        "design_old": design.id,
        "design_new": design.id,
        "label_old": design.label,
        "label_new": design.label,
        "S_old_m_s": float(S.S_old[i]),
        "S_new_m_s": float(S.S_new[i]),
        "difference_m_s": float(S.difference[i]),
        "difference_low_m_s": _finite(S.low[i]),
        "difference_high_m_s": _finite(S.high[i]),
        "scenarios": comparison.shared.n,
        "changed_scenarios": changed,
        "largest_change_m_s": float(S.largest[i]),
        "largest_change_scenario": int(comparison.shared.new[S.largest_at[i]]) if changed else None,
        "failed_scenarios_old": case.failed_old[i],
        "failed_scenarios_new": case.failed_new[i],
    }


def _winners(winners: Winners) -> dict[str, Any]:
    return {
        "verdict": str(winners.verdict),
        "design_old": winners.old.id,
        "design_new": winners.new.id,
        "label_old": winners.old.label,
        "label_new": winners.new.label,
        "S_old_m_s": winners.S_old,
        "S_new_m_s": winners.S_new,
        "difference_m_s": winners.difference,
        "difference_low_m_s": _finite(winners.low),
        "difference_high_m_s": _finite(winners.high),
        "scenarios": winners.scenarios,
    }


def _finite(value: Any) -> float | None:
    return float(value) if math.isfinite(value) else None


def write_comparison(comparison: Comparison, path: str | Path) -> None:
    """Write a comparison as one CSV file, whole or not at all."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=COLUMNS, lineterminator="\n")
    writer.writeheader()
    for row in comparison_rows(comparison):
        writer.writerow({name: "" if value is None else value for name, value in row.items()})
    write_text(Path(path), text.getvalue())


def comparison_content(comparison: Comparison) -> dict[str, Any]:
    """A comparison in plain JSON types."""
    shared = comparison.shared
    return {
        "old": {"folder": comparison.old, "study": comparison.old_name},
        "new": {"folder": comparison.new, "study": comparison.new_name},
        "summary": comparison.summary,
        "worse": comparison.any_worse,
        "differences": list(comparison.differences),
        "shared_scenarios": {
            "left": shared.left,
            "right": shared.right,
            "same_departure_other_draws": shared.other_draws,
        },
        "bootstrap": comparison.bootstrap,
        "confidence": comparison.confidence,
        "warnings": list(comparison.warnings),
        "only_old": [design.id for design in comparison.only_old],
        "only_new": [design.id for design in comparison.only_new],
        "given_up": [design.id for design in comparison.given_up],
        "rows": list(comparison_rows(comparison)),
    }
