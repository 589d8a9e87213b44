"""The results of a study in a notebook: what there is of them, in one piece of escaped HTML."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ldctoolkit.departures import LEFT

if TYPE_CHECKING:
    from studies.results import StudyResults

_CELL = "text-align:left;padding:2px 8px;border-top:1px solid rgba(128,128,128,.35)"


def results_html(results: StudyResults) -> str:
    """Designs, scenarios, cases, failures and a race as HTML without script.

    Parameters
    ----------
    results : StudyResults

    Returns
    -------
    str
        Everything in it is escaped.
    """
    rows = "".join(
        f'<tr><th scope="row" style="font-weight:normal;{_CELL}">{html.escape(name)}</th>'
        f'<td style="{_CELL}">{html.escape(value)}</td></tr>'
        for name, value in _lines(results)
    )
    return (
        '<div style="overflow-x:auto"><div><b>Study results</b></div>'
        f'<table style="border-collapse:collapse"><tbody>{rows}</tbody></table></div>'
    )


def _lines(results: StudyResults) -> Iterator[tuple[str, str]]:
    laws = Counter(design.law for design in results.designs)
    listed = ", ".join(f"{law} ({count:,})" for law, count in laws.items())
    yield "designs", f"{len(results.designs):,}: {listed}" if listed else "0"
    left = int((results.scenarios.side == LEFT).sum())
    yield "scenarios", f"{results.scenarios.n:,} ({left:,} left, {results.scenarios.n - left:,} right)"
    yield "cases", "; ".join(case.case.label for case in results.cases)
    for case in results.cases:
        failed = int(case.failed.sum())
        if failed:
            yield f"failed runs, {case.case.label}", f"{failed:,} of {case.status.size:,}"
    if results.failed:
        yield "designs that failed", f"{len(results.failed):,}"
    if results.fresh is not None:
        yield "finalists", f"{len(results.fresh.designs):,} on {results.fresh.scenarios.n:,} fresh scenarios"
    if results.race is not None:
        yield "given up in a race", f"{len(results.race.dropped):,}"
