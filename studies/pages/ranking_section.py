"""The ranking as a table of the report and as ``ranking.md``, and the limits: what each asks, what designs have."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.metrics import METRICS, USER_GROUP, measured_on

from ..ranking.finalists import SCORE
from ..ranking.ranking import Ranking
from ..ranking.verdict import (
    COLUMNS_TEXT,
    STEP_TEXT,
    Verdict,
    limit_line,
    listed_positions,
    more_lines,
    ranking_table,
    set_of_best_line,
    verdict_lines,
)
from ..requirements import metric
from ..storage.folder_files import write_text
from ..storage.manifest import Manifest
from ..study_file import Study
from ..tables import Cell, Column, Row, Table, markdown_text, to_html, to_markdown
from ..text import DASH, compact, percent
from .context import Context, metric_text
from .shell import Section, render

MOST_ROWS: Final = 1000  # designs of the table; all of them are in ranking.csv
MOST_MARKDOWN_ROWS: Final = 50  # designs of a Markdown file; those that are named follow
FIRST_ROWS: Final = 20  # rows that are shown before all are requested, and those that are printed


def section(context: Context) -> Section:
    """The section."""
    ranking = context.ranking
    named = [position for position in (ranking.winner, ranking.baseline) if position is not None]
    marked = {*named, *context.best_of_each_law, *np.flatnonzero(ranking.pareto)[:100].tolist()}
    positions = [i for i in range(len(ranking)) if i < MOST_ROWS or i in marked]
    times = context.report.step_times
    table = ranking_table(ranking, positions, times)
    rows = []
    for position, row in zip(positions, table.rows, strict=True):
        first = position in named or position < FIRST_ROWS
        kind = f"{row.kind} {'kept' if position in named else '' if first else 'far'}".strip()
        rows.append(dataclasses.replace(row, kind=kind, later=not first))
    table = dataclasses.replace(table, rows=rows)
    body = render(
        "ranking.html",
        table=to_html(table, id="designs", sortable=True),
        count=len(ranking),
        listed=len(positions),
        later=sum(row.later for row in rows),
        set_of_best=set_of_best_line(ranking),
        limit=limit_line(ranking),
        timed=STEP_TEXT if times else "",
    )
    return Section("ranking", "Ranking", body, scripts=("table.js",), printed=True)


# ------------------------------------------------------------------------------------------------ limits


def limits_section(context: Context) -> Section:
    """What each requirement asks, what the shown design and no control have, and how many designs meet it."""
    ranking, i, without = context.ranking, context.shown, context.no_control
    columns = [
        Column("Metric", text=True),
        Column("Limit"),
        Column("Set", text=True),
        Column(_title(context)),
        Column("No control"),
        Column("Designs that meet it"),
    ]

    def value(name: str, position: int | None) -> str:
        return DASH if position is None else metric_text(name, context.metric(name, position))

    rows, ends = [], []
    for requirement, estimate in zip(ranking.limits, ranking.estimates(i), strict=True):
        met = requirement.met(context.values(requirement.metric.name))
        shown_value = Cell(value(requirement.metric.name, i), bad=not met[i], good=bool(met[i]))
        limit = f"{_operator(requirement.operator)} {_limit_text(requirement.metric.name, requirement.limit)}"
        origin = (requirement.set or "own") if estimate.required else f"{requirement.set} (not required)"
        cells = (
            requirement.metric.title,
            limit,
            origin,
            shown_value,
            value(requirement.metric.name, without),
            f"{int(met.sum()):,}",
        )
        rows.append(Row(cells))
        if estimate.interval:
            shown = Cell(
                metric_text(requirement.metric.name, estimate.value), bad=not estimate.met, good=not estimate.uncertain
            )
            ends.append(Row((requirement.metric.title, limit, shown, estimate.interval)))
    caption = f"{_title(context)} on {ranking.sample(i)}, each metric with an interval of its own"
    heads = [*columns[:2], Column("Value"), Column(f"{percent(ranking.confidence, 0)} interval")]
    body = render(
        "limits.html",
        table=to_html(Table("Limits", columns, rows)),
        certainty=to_html(Table(caption, heads, ends)) if ends else "",
        metrics=_named_metrics(context),
        recorded=context.verdict.recorded,
        recorded_text=percent(context.verdict.recorded),
    )
    return Section("limits", "Limits", body, printed=True)


def _operator(operator: str) -> str:
    return {"<=": "\u2264", ">=": "\u2265"}.get(operator, operator)


def _limit_text(name: str, limit: float) -> str:
    definition = metric(name)
    unit = f"\u00a0{definition.shown_unit}" if definition.shown_unit else ""
    return f"{compact(float(f'{definition.scale * limit:.4g}'))}{unit}"


def _title(context: Context) -> str:
    return "Winner" if context.ranking.winner is not None else "First design"


def _named_metrics(context: Context) -> Markup:
    """Every metric of the shown design beside no control and the baseline."""
    ranking, i = context.ranking, context.shown
    others = [("No control", context.no_control)]
    if ranking.baseline is not None and ranking.baseline not in (i, context.no_control):
        others.append(("Baseline", ranking.baseline))
    columns = [Column("Metric", text=True), Column(_title(context)), *(Column(name) for name, _ in others)]
    rows = []
    users = {row.name: row for row in map(metric, ranking.metrics.beside) if row.group == USER_GROUP}
    for name, definition in (measured_on(context.results.options, METRICS) | users).items():
        values = [context.metric(name, i), *(math.nan if j is None else context.metric(name, j) for _, j in others)]
        if any(math.isfinite(value) for value in values):
            rows.append(Row((definition.title, *(metric_text(name, value) for value in values))))
    return to_html(Table("All metrics", columns, rows))


# ------------------------------------------------------------------------------------------------ Markdown


def write_markdown(ranking: Ranking, path: Path, study: Study, manifest: Manifest, verdict: Verdict) -> None:
    """Write a ranking as a Markdown file, whole or not at all."""
    write_text(path, ranking_markdown(ranking, study, manifest, verdict))


def ranking_markdown(ranking: Ranking, study: Study, manifest: Manifest, verdict: Verdict) -> str:
    """The text of ``ranking.md``; the same ranking gives the same text."""
    return "\n".join(_blocks(ranking, study, manifest, verdict))


def _blocks(ranking: Ranking, study: Study, manifest: Manifest, verdict: Verdict) -> Iterator[str]:
    yield f"# {markdown_text(study.title or study.name)}\n"
    title, *others = verdict_lines(verdict)
    yield f"**{markdown_text(title)}**\n"
    yield "".join(f"- {markdown_text(line)}\n" for line in (*others, *more_lines(ranking)))
    for warning in ranking.warnings:
        yield f"> **Warning:** {markdown_text(warning)}\n"
    positions = listed_positions(ranking, MOST_MARKDOWN_ROWS)
    yield to_markdown(ranking_table(ranking, positions))
    if len(positions) < len(ranking):
        yield f"{len(positions):,} of {len(ranking):,} designs; all of them are in `ranking.csv`.\n"
    window = "the whole departure" if ranking.window == "departure" else "the time under control"
    about = f"{SCORE}. Here it is taken over {window}. Intervals hold for all designs at once. {COLUMNS_TEXT}"
    if (of := ranking.criterion) is not None:
        about = f"Designs are ranked by {of.metric.title}. Differences are of it, above 0 where worse. {about}"
    yield f"{markdown_text(about)}\n"
    n_left, n_right = study.scenarios.counts
    synthetic = "; synthetic, not fitted to recorded driving" if manifest.model_synthetic else ""
    facts = (
        f"Study: {study.name}",
        f"{study.scenarios.source}: {manifest.model} (content {manifest.model_hash[:12]}){synthetic}",
        f"Scenarios: {n_left + n_right:,} ({n_left:,} left, {n_right:,} right), seed {study.seed}",
        f"S: {ranking.label}",
    )
    yield "".join(f"- {markdown_text(fact)}\n" for fact in facts)
    if ranking.failed:
        yield "## Failed designs\n"
        yield "".join(f"- {markdown_text(failure.sentence)}\n" for failure in ranking.failed[:MOST_MARKDOWN_ROWS])
        if len(ranking.failed) > MOST_MARKDOWN_ROWS:
            yield f"And {len(ranking.failed) - MOST_MARKDOWN_ROWS:,} more, see `ranking.csv`.\n"
