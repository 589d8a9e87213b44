"""The page of a risk: probabilities of rare events, the exceedance curve, and the worst departures."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.version import __version__

from ..design import NO_CONTROL, Design
from ..risk import BY_MODEL, Risk
from ..storage.folder_files import write_text
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import figure as digits
from ..text import parameter_label, plural, symbols
from .charts import Axis, Chart, Series, law_styles, legend
from .shell import Section, bullets, details, figure, make_page, paragraphs
from .verdict_section import lights_list

_RATES: Final = {"per_1000_km": "Per 1,000 km", "per_hour": "Per hour"}


def write_risk_page(risk: Risk, path: str | Path, *, title: str) -> None:
    """Write a risk as one HTML page that needs nothing else, whole or not at all."""
    html = make_page(
        kind="Lane departure correction: the tail",
        title=f"{title}: the tail",
        heading=f"{title}: how often departures end deep beyond the line",
        facts=[f"{risk.n:,} departures", f"{plural(len(risk.designs) - 1, 'design')} and no control"],
        sections=[_verdict_section(risk), _probabilities_section(risk), _curve_section(risk), _worst_section(risk)],
        footer=f"ldctoolkit {__version__}. Intervals after Clopper and Pearson (1934), 95 %.",
    )
    write_text(Path(path), html)


def _name(design: Design) -> str:
    return "no control" if design.is_baseline else design.label


def _verdict_section(risk: Risk) -> Section:
    lights = [(design, risk.light(design)) for design in risk.designs[1:]]
    named = [dataclasses.replace(light, text=f"{design.label}: {light.text}") for design, light in lights]
    return Section("verdict", "Verdict", lights_list(named) + paragraphs(*risk.notes()), printed=True)


def probabilities(risk: Risk, design: Design) -> Table:
    """How often each event happens with a design, and against no control."""
    rates, recorded = risk.departure_rates(), risk.job.model.provenance.recorded is not None
    columns = [
        Column("Event", text=True), Column("No control", form=digits), Column("P", form=digits),
        Column("95 % interval", form=digits), Column("Departures"),
        *([Column("Outside", "%", ".0f")] if recorded else []),
        *(Column(_RATES[name], form=digits) for name in rates),
        Column("Only with design"), Column("Only with no control"), Column("Design is", text=True),
    ]  # fmt: skip
    rows = []
    for event in risk.events:
        event_risk, without = risk.event(design, event), risk.event(risk.designs[0], event)
        cells: list[Cell | Value] = [event, *(BY_MODEL if x.by_model else x.probability for x in (without, event_risk))]
        cells += [event_risk.interval, event_risk.count]
        outside = 100.0 * event_risk.outside / event_risk.count if event_risk.count else None
        cells += [outside] if recorded else []
        low, high = event_risk.interval
        cells += [(r * low, r * high) if event_risk.by_model else r * event_risk.probability for r in rates.values()]
        verdict = Cell(event_risk.text, bad=event_risk.sign > 0, good=event_risk.sign < 0)
        compared = [event_risk.design_only, event_risk.no_control_only, verdict]
        rows.append(Row([*cells, *([None, None, None] if design.is_baseline else compared)]))
    return Table(f"{_name(design)}, {risk.n:,} departures of either side", columns, rows)


def _probabilities_section(risk: Risk) -> Section:
    body = Markup().join(to_html(probabilities(risk, design)) for design in risk.designs)
    note = (
        "P is a probability per departure, with the ends of its exact 95 % interval. Design and no control are "
        "driven on the same departures: better and worse are exact two-sided tests at 5 % of those departures in "
        "which only one of the two has the event."
    )
    if risk.job.model.provenance.recorded is not None:
        note += (
            " Outside: share of the departures with the event that lie where none was recorded, beyond the recorded "
            "depths d_y, durations T or speeds of their side."
        )
    return Section("probabilities", "Probabilities", body + paragraphs(note), printed=True)


def _curve_section(risk: Risk) -> Section:
    names = [NO_CONTROL if design.is_baseline else design.id for design in risk.designs]
    styles, series = law_styles(names), []
    for design, name in zip(risk.designs, names, strict=True):
        x, share = risk.exceedance(design)
        series.append(Series(_name(design), x, np.where(share > 0.0, share, np.nan), styles[name]))
    y = Axis("P(depth beyond)", 0.5 / max(risk.n, 1), 1.0, log=True)
    chart = Chart("exceedance", "Probability that a departure gets deeper", Axis("Depth [m]", 0.0, 3.0), y, series)
    text = (
        f"Share of departures that get deeper, on a log scale; below {digits(3.0 / max(risk.n, 1), 2)} chance decides."
    )
    if known := risk.recorded():
        text += f" Below 3/{known:,} = {digits(3.0 / known, 2)} the curves are the model's, not the recordings'."
    key = legend([(curve.label, curve.style) for curve in series])
    return Section("exceedance", "Exceedance", figure([chart], text, key), (chart,), printed=True)


def _worst_section(risk: Risk) -> Section:
    columns = [Column("Depth", "m", ".2f"), Column("Scenario", form="d"), Column("Side", text=True)]
    columns += [Column(parameter_label(name), form=digits) for name in PARAMETER_NAMES]
    body = Markup()
    for design in risk.designs:
        common = risk.in_common(design)
        rows = [Row(list(row.values())[3:]) for row in risk.worst_rows(design)]
        table = Table(f"{_name(design)}: deepest departures", columns, rows, head=1)
        body += Markup("<h3>{}</h3>").format(symbols(_name(design))) + paragraphs(common.sentence)
        body += bullets(common.warnings, "warnings") + details("The worst departures", to_html(table))
    return Section("worst", "The worst departures", body)
