"""What a small score is paid for with: comfort, needless interventions, steering, margins."""

from typing import Final

import numpy as np

from ldctoolkit.metrics import METRICS
from studies.pages.context import Context, metric_text, name_of
from studies.pages.shell import Cell, Column, Section, TableRow, figure, paragraphs, table
from studies.pages.text import number, plural
from studies.pages.verdict_section import cloud_legend, trade_off

ACROSS: Final = ("jerk_added_peak_p95", "needless", "effort_mean", "within_dtle")
MOST_ROWS: Final = 15


def section(context: Context) -> Section:
    """The section."""
    ranking = context.ranking
    charts = tuple(
        trade_off(context, name, "S", f"trade-off-{name.replace('_', '-')}")
        for name in ACROSS
        if np.isfinite(context.values(name)).any()
    )
    front = np.flatnonzero(ranking.pareto)
    sentence = (
        f"Pareto front over {', '.join(METRICS[name].title for name in ranking.pareto_metrics)}: "
        f"{plural(front.size, 'design')} that no other ranked design beats in one metric without being worse "
        "in another."
        if ranking.pareto_metrics and ranking.ranked
        else "There is no Pareto front: no design is ranked."
        if ranking.pareto_metrics
        else ""
    )
    body = paragraphs(sentence) + figure(
        charts,
        "Mean S against another metric, one point a design; filled: meets all requirements. The line is the front of "
        "these two metrics alone.",
        cloud_legend(context),
    )
    if front.size:
        names = [name for name in ranking.pareto_metrics if name != "S"]
        columns = [
            Column("Rank"), Column("Design", text=True), Column("Mean S", "m\u00b7s"),
            *(Column(METRICS[name].title, METRICS[name].shown_unit) for name in names),
        ]  # fmt: skip
        rows = [
            TableRow(
                (
                    str(ranking.rank[i]),
                    name_of(ranking.designs[i]),
                    number(float(ranking.S[i])),
                    *(Cell(metric_text(name, context.metric(name, i), unit=False)) for name in names),
                ),
                "winner" if i == ranking.winner else "",
            )
            for i in front[:MOST_ROWS].tolist()
        ]
        more = f", the first {MOST_ROWS} of {front.size}" if front.size > MOST_ROWS else ""
        body += table(f"The Pareto front{more}", columns, rows, head=1)
    return Section("trade-offs", "Trade-offs", body, charts)
