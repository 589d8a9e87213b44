"""The page: context for the template, rendered and written whole."""

from __future__ import annotations

import dataclasses
import importlib.resources
from pathlib import Path

import jinja2
from markupsafe import Markup

from ldctoolkit.errors import InputError
from studies.report import prose, text
from studies.report.answer import answer
from studies.report.inputs import ReportInput
from studies.report.limits import against_limits, limits_table
from studies.report.panels import Panels
from studies.report.summary import CaseTable, Row, case_table, is_baseline
from studies.storage.files import write_text

SECTIONS = (
    ("answer", "Answer"),
    ("ranking", "Ranking"),
    ("limits", "Release limits"),
    ("landscape", "Landscape"),
    ("sides", "Left and right"),
    ("paths", "Example paths"),
    ("distribution", "Distribution"),
    ("convergence", "Convergence"),
    ("failures", "Failures and limits"),
    ("settings", "Settings"),
)
"""Identifiers of the sections, which stay the same from version to version, and their titles."""


@dataclasses.dataclass(frozen=True)
class Tile:
    """One large number at the top of the page."""

    value: str
    unit: str
    text: str
    detail: str


def _tiles(table: CaseTable) -> list[Tile]:
    best, shown = table.best, text.number
    interval = f"{text.percent(table.confidence, 0)} interval {prose.between(best.fresh or best.S)}"
    if best.fresh is not None:
        scenarios = f"mean score S of {table.best_name} on {table.fresh_scenarios:,} fresh departures"
        tiles = [
            Tile(
                shown(best.fresh.value),
                "m·s",
                scenarios,
                f"{interval}; {shown(best.S.value)} where designs were chosen",
            )
        ]
    else:
        tiles = [Tile(shown(best.S.value), "m·s", f"mean score S of {table.best_name}", interval)]
    if not is_baseline(best):
        change = best.reduction
        interval = f"interval {shown(-100 * change.high, 1)} to {shown(-100 * change.low, 1)}"
        tiles.append(Tile(text.signed(-100 * change.value, 1), "%", "against no control", interval))
        deep = f"of departures deeper than {text.compact(table.D_y)}\u00a0m"
        before = f"{text.percent(table.uncorrected_deeper)} without control"
        tiles.append(Tile(shown(100 * best.deeper, 1), "%", deep, before))
    if table.winner is None:
        of = f"of {text.plural(len(table.rows), 'design')}"
        ranked = f"{of}, {table.ranked:,} where designs were chosen"
        what = (
            "finalists meet the requirements on fresh departures" if table.ranked else "designs meet the requirements"
        )
        tiles.append(Tile("0", "", what, ranked if table.ranked else of))
    elif len(table.rows) > 1:
        others = len(table.set_of_best) - 1
        holds = f"the truly best is in it with {text.percent(table.confidence, 0)} confidence"
        tiles.append(
            Tile(f"{others:,}", "", f"other {'design' if others == 1 else 'designs'} in the set of best", holds)
        )
    return tiles


def _bar(row: Row, table: CaseTable) -> str:
    """Width of the bar of S in per cent; full is 1.2 times no control."""
    full = 1.2 * table.uncorrected
    share = row.S.value / full if full > 0 else 0.0
    return f"{100.0 * min(share, 1.0):.1f}"


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("studies.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        "number": text.number,
        "signed": text.signed,
        "percent": text.percent,
        "change": text.change,
        "symbols": text.symbols,
        "printable": text.printable,
        "compact": text.compact,
    }
    environment.globals |= {
        "bar": _bar,
        "is_baseline": is_baseline,
        "design_text": prose.design_text,
        "between": prose.between,
        "plural": text.plural,
    }
    return environment


def _asset(name: str) -> Markup:
    # our own files, not a user's: they go into <style> and <script> as they are
    return Markup((importlib.resources.files("studies.report") / "templates" / name).read_text(encoding="utf-8"))


def render(report: ReportInput) -> str:
    """The report as one HTML document; the same input gives the same text.

    Parameters
    ----------
    report : ReportInput

    Returns
    -------
    str

    Raises
    ------
    InputError
        If the results hold no design, scenario or case, or the rankings do not belong to the cases.
    """
    results = report.results
    if not results.designs or not results.cases or results.scenarios.n == 0:
        raise InputError("report: the results hold no designs, no cases or no scenarios; allowed: at least one of each")
    if len(report.rankings) != len(results.cases):
        raise InputError(
            f"report: {len(report.rankings)} rankings for {len(results.cases)} cases; allowed: one per case"
        )
    every, results = results.scenarios.n, results.drivable()
    if results.scenarios.n == 0:
        raise InputError("report: no scenario could be driven under every design; there is nothing to report on")
    report = dataclasses.replace(report, results=results)
    tables = [case_table(results, i, ranking) for i, ranking in enumerate(report.rankings)]
    primary = tables[0]
    elsewhere = {warning for table in tables[1:] for warning in table.warnings}  # told beside their own tables
    warnings = dict.fromkeys((*report.warnings, *primary.warnings))
    panels = Panels(report, primary)
    replayed = panels.replay()
    return _environment().get_template("report.html").render(
        report=report,
        sections=SECTIONS,
        style=_asset("report.css"),
        script=_asset("report.js"),
        tables=tables,
        primary=primary,
        warnings=[one for one in warnings if one not in elsewhere or one in primary.warnings],
        tiles=_tiles(primary),
        every=every,
        raced=primary.race is not None and bool(primary.race.dropped),
        answer=answer(report, primary),
        plant=prose.plant(report),
        limits=limits_table(report, primary, report.rankings[0]),
        against_limits=against_limits(report, primary, report.rankings[0]),
        limitations=prose.limitations(report, primary, replayed.peak_steering),
        partial=prose.partial_grids(report),
        landscape=panels.landscape(),
        sides=panels.sides(),
        replayed=replayed,
        paths=panels.paths(replayed),
        legend=panels.legend(),
        distribution=panels.distribution(),
        convergence=panels.convergence(),
    )  # fmt: skip


def write_page(report: ReportInput, path: Path) -> Path:
    """Render and write, whole or not at all; see `studies.report.write_report`."""
    write_text(path, render(report))
    return path
