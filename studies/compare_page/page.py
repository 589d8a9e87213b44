"""The page: sections, figures, table and script of a comparison in one file."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from markupsafe import Markup

from studies.compare_page import figures, sentences, table
from studies.comparison.comparison import CaseComparison, Comparison
from studies.comparison.paired_verdicts import Verdict
from studies.ranking.ranking import SCORE
from studies.report.embedded.packed import script_json
from studies.report.rendering import asset, render
from studies.report.section import Drawing
from studies.report.words import text
from studies.results import FailedDesign

_PACKAGE = "studies.compare_page"

SECTIONS = (
    ("answer", "Answer"),
    ("differences", "What differs"),
    ("designs", "Designs"),
    ("changes", "Largest changes"),
    ("scatter", "Old against new"),
    ("only", "In one study"),
    ("failures", "Failures"),
    ("settings", "How it was compared"),
)
"""Identifiers of the sections, which stay the same from version to version, and their titles."""

MOST_LISTED = 100
"""Designs of one study only, and failures, that are named one by one."""


@dataclasses.dataclass(frozen=True)
class CaseTexts:
    """One case for the template.

    Attributes
    ----------
    case : CaseComparison
    label : str
    winners : Markup
        A sentence; why there are none where there are none.
    counts : tuple of (Verdict, mark, count)
    rows : tuple of DesignRow
        The first ones.
    laws : tuple of str
    """

    case: CaseComparison
    label: str
    winners: Markup
    counts: tuple[tuple[Verdict, str, int], ...]
    rows: tuple[table.DesignRow, ...]
    laws: tuple[str, ...]


def make_page(comparison: Comparison) -> str:
    """The page as one HTML document; the same comparison gives the same text.

    Parameters
    ----------
    comparison : Comparison

    Returns
    -------
    str
    """
    cases = tuple(_texts(comparison, case) for case in comparison.cases)
    data = {"compare": {"verdicts": [str(v) for v in table.VERDICTS], "marks": [table.MARKS[v] for v in table.VERDICTS],
                        "cases": table.table_data(comparison)}}  # fmt: skip
    return str(
        render(
            "compare.html",
            _PACKAGE,
            comparison=comparison,
            score=SCORE.replace("'", "\u2019"),
            sections=SECTIONS,
            lead=sentences.lead(comparison),
            cases=cases,
            winner=sentences.winner_tile(comparison),
            changes=tuple(_drawings(comparison, "changes")),
            scatter=tuple(_drawings(comparison, "scatter")),
            differences=[one.partition(": ")[::2] for one in comparison.differences],
            failures=_failures(comparison),
            most_changed=figures.MOST_CHANGED,
            most_static=table.MOST_STATIC,
            most_listed=MOST_LISTED,
            style=Markup("\n").join((asset("report.css"), asset("compare.css", _PACKAGE))),
            script=Markup("\n").join((asset("js/ldc.js"), asset("js/sorting.js"), asset("js/compare.js", _PACKAGE))),
            data=Markup(script_json(data)),
        )
    )


def _texts(comparison: Comparison, case: CaseComparison) -> CaseTexts:
    return CaseTexts(
        case=case,
        label=case.case.label,
        winners=text.symbols(sentences.no_winners_text(case))
        if case.winners is None
        else sentences.winners_text(case.winners),
        counts=tuple((verdict, table.MARKS[verdict], case.count(verdict)) for verdict in Verdict),
        rows=table.design_rows(comparison, case),
        laws=tuple(sorted({design.law for design in case.designs})),
    )


def _drawings(comparison: Comparison, kind: str) -> Iterator[Drawing]:
    for i, case in enumerate(comparison.cases, 1):
        figure = figures.forest_figure(case) if kind == "changes" else figures.scatter_figure(case)
        if figure is None:
            continue
        label = case.case.label
        title = {
            "changes": f"{label}: differences of mean S, new minus old, with their intervals, by size",
            "scatter": f"{label}: mean S in the old study against that in the new one, with the line of equality",
        }[kind]
        yield Drawing(f"{kind}-{i}", title, figure, text.symbols(label))


def _failures(comparison: Comparison) -> tuple[tuple[str, tuple[FailedDesign, ...]], ...]:
    every = (
        ("Fails now, ran before", comparison.new_failures),
        ("Runs now, failed before", comparison.repaired),
        ("Fails in both", comparison.failed_in_both),
    )
    return tuple((title, failed) for title, failed in every if failed)
