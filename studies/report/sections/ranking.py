"""Ranking: the designs of every case, with intervals, requirements and failures."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import METRICS, Metric
from studies.ranking.ranking import Ranking
from studies.report.context import Context
from studies.report.embedded.designs import BAR_END, designs_data
from studies.report.rendering import render
from studies.report.section import Section
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row
from studies.report.words.metric_text import metric_text, requirement_text, shown_limits, shown_values

MOST_ROWS: Final = 100
"""First designs of a table that stands without script, and at most as many of a set of designs beside them."""


def section(context: Context) -> Section:
    """The section."""
    body = render(
        "sections/ranking.html",
        report=context.report,
        tables=context.tables,
        primary=context.primary,
        listed={table.case: listed_rows(table) for table in context.tables},
        required={
            table.case: _required(table, ranking)
            for table, ranking in zip(context.tables, context.report.rankings, strict=True)
        },
        requirement=requirement_text,
        bar=_bar,
        full=BAR_END,
    )
    return Section(
        "ranking",
        "Ranking",
        body,
        data=designs_data(context),
        scripts=(
            *("designs.js", "table-columns.js", "table-search.js", "table-filters.js"),
            *("sorting.js", "ranking.js", "details.js"),
        ),
        styles=("ranking.css", "details.css"),
    )


def listed_rows(table: CaseTable, most: int = MOST_ROWS) -> tuple[Row, ...]:
    """The first designs of the ranking and every one with a tag.

    Parameters
    ----------
    table : CaseTable
    most : int
        How many of the first, of the set of best, and of the Pareto front.

    Returns
    -------
    tuple of Row
        In the order of the ranking.
    """
    tagged = (table.winner, table.baseline, table.paper_design, *table.best_of_each_law)
    front = [row for row in table.rows if row.pareto]
    rows = (*table.rows[:most], *(row for row in tagged if row is not None), *table.set_of_best[:most], *front[:most])
    return tuple(sorted({row.place: row for row in rows}.values(), key=lambda row: row.place))


_OWN_COLUMNS: Final = (
    "S",
    "S_left",
    "S_right",
    "reduction",
    "reduction_left",
    "reduction_right",
    "triggered",
    "deeper",
)


@dataclasses.dataclass(frozen=True)
class Required:
    """A column of a metric that has a limit: its name, the limits, and the metric of every design as text."""

    metric: Metric
    limits: tuple[str, ...]
    values: npt.NDArray[np.float64]

    def said(self, place: int) -> str:
        """The metric of the design at this place."""
        return metric_text(self.metric.name, self.values[place])


def _required(table: CaseTable, ranking: Ranking) -> list[Required]:
    """Metrics of the requirements that have no column otherwise."""
    limits = shown_limits(table.require)
    return [
        Required(METRICS[name], limits[name], shown_values(name, ranking))
        for name in limits
        if name not in _OWN_COLUMNS
    ]


def _bar(row: Row, table: CaseTable) -> str:
    """Widths of the bar of S and ends of its whisker in per cent."""
    full = BAR_END * table.uncorrected
    ends = (row.S.value, row.S.low, row.S.high)
    shares = [100.0 * min(max(end / full, 0.0), 1.0) if full > 0 else 0.0 for end in ends]
    return ";".join(f"--{name}:{share:.1f}%" for name, share in zip("wlh", shares, strict=True))
