"""The page of a risk: probabilities of rare events, the exceedance curve, and the worst departures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from markupsafe import Markup

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.version import __version__

from ..design import NO_CONTROL, Design
from ..risk import Risk
from ..storage.files import write_text
from .charts import Axis, Chart, Series, law_styles, legend
from .shell import Cell, Column, Section, TableRow, bullets, details, figure, make_page, paragraphs, table
from .text import figure as digits
from .text import number, parameter_label, plural, symbols, true_minus
from .verdict_section import STATES, SYMBOLS


def write_risk_page(risk: Risk, path: str | Path, *, title: str) -> None:
    """Write a risk as one HTML page that needs nothing else, whole or not at all."""
    html = make_page(
        kind="Lane departure correction: the tail",
        title=f"{title}: the tail",
        heading=f"{title}: how often departures end deep beyond the line",
        facts=[f"{risk.n:,} departures", f"{plural(len(risk.designs) - 1, 'design')} and no control"],
        sections=[_verdict(risk), _probabilities(risk), _curve(risk), _worst(risk)],
        footer=f"ldctoolkit {__version__}. Intervals after Clopper and Pearson (1934), 95 %.",
    )
    write_text(Path(path), html)


def _name(design: Design) -> str:
    return "no control" if design.is_baseline else design.label


def _verdict(risk: Risk) -> Section:
    items = Markup()
    for design in risk.designs[1:]:
        light = risk.light(design)
        items += Markup(
            '<li class="{0}"><span class="light {0}" role="img" aria-label="{1}">{2}</span><b>{3}</b>'
            "<span>{4}</span></li>"
        ).format(light.state, STATES[light.state], SYMBOLS[light.state], light.name,
                 symbols(true_minus(f"{design.label}: {light.text}")))  # fmt: skip
    body = Markup('<ul class="lights" aria-label="Lights">{}</ul>').format(items) if items else Markup()
    return Section("verdict", "Verdict", body + paragraphs(*map(true_minus, risk.notes())), printed=True)


def _probabilities(risk: Risk) -> Section:
    shown = {"per_1000_km": "Per 1,000 km", "per_hour": "Per hour"}
    columns = [Column("Event", text=True), Column("P"), Column("From"), Column("To"), Column("Departures")]
    columns += [Column(shown[name]) for name in risk.departure_rates()]
    columns += [Column("Only with design"), Column("Only with no control"), Column("Design is", text=True)]

    body = Markup()
    for design in risk.designs:
        rows = []
        for event in risk.events:
            found = risk.event(design, event)
            cells: list[Cell | str] = [true_minus(event), *map(digits, (found.probability, found.low, found.high))]
            cells += [
                f"{found.count:,}",
                *(digits(rate * found.probability) for rate in risk.departure_rates().values()),
            ]
            compared = () if design.is_baseline else (found.design_only, found.no_control_only)
            cells += [f"{count:,}" for count in compared] or ["", ""]
            cells.append(Cell(found.text if compared else "", bad=found.sign > 0, good=found.sign < 0))
            rows.append(TableRow(tuple(cells)))
        body += table(f"{_name(design)}, a departure of either side", columns, rows)
    note = (
        "P is a probability per departure, with the ends of its exact 95 % interval. Design and no control are "
        "driven on the same departures: better and worse are exact two-sided tests at 5 % of those departures in "
        "which only one of the two has the event."
    )
    return Section("probabilities", "Probabilities", body + paragraphs(note), printed=True)


def _curve(risk: Risk) -> Section:
    series, styles = [], law_styles(NO_CONTROL if design.is_baseline else design.id for design in risk.designs)
    for design in risk.designs:
        x, share = risk.exceedance(design)
        series.append(
            Series(
                _name(design),
                x,
                np.where(share > 0.0, share, np.nan),
                styles[NO_CONTROL if design.is_baseline else design.id],
            )
        )
    y = Axis("P(depth beyond)", 0.5 / max(risk.n, 1), 1.0, log=True)
    chart = Chart("exceedance", "Probability that a departure gets deeper", Axis("Depth [m]", 0.0, 3.0), y, series)
    text = (
        f"Share of departures that get deeper, on a log scale; below {digits(3.0 / max(risk.n, 1), 2)} chance decides."
    )
    key = legend([(one.label, one.style) for one in series])
    return Section("exceedance", "Exceedance", figure([chart], text, key), (chart,), printed=True)


def _worst(risk: Risk) -> Section:
    columns = [Column("Depth", "m"), Column("Scenario"), Column("Side", text=True)]
    columns += [Column(parameter_label(name)) for name in PARAMETER_NAMES]
    body = Markup()
    for design in risk.designs:
        common = risk.in_common(design)
        rows = [
            TableRow(
                (number(one["deepest_m"], 2), str(one["scenario"]), one["side"], *map(digits, list(one.values())[6:]))
            )
            for one in risk.worst_rows(design)
        ]
        body += Markup("<h3>{}</h3>").format(symbols(_name(design))) + paragraphs(true_minus(common.sentence))
        body += bullets(common.warnings, "warnings")
        body += details("The worst departures", table(f"{_name(design)}: deepest departures", columns, rows, head=1))
    return Section("worst", "The worst departures", body)
