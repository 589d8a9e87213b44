"""Requirements of a study in sentences: who misses them, and at what price."""

from __future__ import annotations

from collections import Counter

from markupsafe import Markup

from studies.report.tables.case_table import CaseTable
from studies.report.words.metric_text import requirement_text
from studies.report.words.prose import design_text
from studies.report.words.text import number, plural, symbols


def requirements_text(table: CaseTable, joint: str = " and ") -> Markup:
    """All requirements with their units."""
    return symbols(joint.join(requirement_text(text) for text in table.require))


def missed_requirements(table: CaseTable) -> Markup:
    """How many designs miss which requirement; empty where none does."""
    missed = Counter(text for row in table.rows for text in row.unmet)
    if not missed:
        return Markup("")
    listed = ", ".join(f"{requirement_text(text)} ({count:,})" for text, count in missed.items())
    out = len(table.rows) - table.ranked
    said = Markup("{} of {} {} a requirement and {} not ranked: {}. Requirements are checked on the estimates.")
    return said.format(
        f"{out:,}", plural(len(table.rows), "design"), "misses" if out == 1 else "miss", "is" if out == 1 else "are",
        symbols(listed),
    )  # fmt: skip


def price_of_requirements(table: CaseTable) -> Markup:
    """Which designs with a lower mean S they keep out, or that all designs meet them; empty where neither is so."""
    if not table.require:
        return Markup("")
    if all(not row.unmet for row in table.rows):
        of = plural(len(table.rows), "design")
        each = f"The {of} meets" if len(table.rows) == 1 else f"All {of} meet"
        return Markup("{} the requirements ({}).").format(each, requirements_text(table, ", "))
    better = [row for row in table.rows if not row.rank and row.S.value < table.best.S.value]
    if not table.ranked or not better:
        return Markup("")
    said = Markup("Of the designs that miss a requirement {} a lower mean S than {}, the lowest {} m·s: {}.")
    return said.format(
        f"{len(better):,} {'has' if len(better) == 1 else 'have'}", table.best_name, number(better[0].S.value),
        design_text(better[0]),
    )  # fmt: skip
