"""Other plants: what becomes of the designs on vehicles that are not the study's, and the margins of their loops."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from ..ranking.verdict import design_name, law_title
from ..robustness import Robustness
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import percent, plural
from .charts import Axis, Chart, Series
from .context import Context
from .shell import Section, bullets, details, figure, paragraphs

MOST_LAWS: Final = 4  # designs in the table; their margins too


def section(context: Context) -> Section:
    """The section."""
    found = context.report.robustness
    if found is None:
        body = paragraphs(
            "Designs were not driven on other plants for this report: leave --no-robustness out to have them here."
        )
        return Section("robustness", "Other plants", body)
    charts = tuple(_margins(context, found))
    shown = [i for i, _ in _shown(context, found)]
    body = paragraphs(*_sentences(context, found)) + to_html(_table(context, found, shown)) + bullets(_left_out(found))
    if charts:
        body += details(
            "Margins of the loop over speed",
            figure(
                charts,
                "On the study\u2019s plant, without its limits of rate and angle; 0: the loop is unstable. "
                "Dashed: what stable asks for. Gain margins above 20 are drawn at 20.",
            ),
        )
    return Section("robustness", "Other plants", body, charts)


def _shown(context: Context, found: Robustness) -> Iterator[tuple[int, int]]:
    """Position among the robustness designs and place in the ranking: the reference, then the best of each law."""
    place_of = {design.id: i for i, design in enumerate(context.ranking.designs)}
    laws: set[str] = set()
    for i, id in enumerate(found.designs):
        place = place_of.get(id)
        if place is None or context.ranking.designs[place].is_baseline:
            continue
        law = context.ranking.designs[place].law
        if law not in laws and len(laws) < MOST_LAWS:
            laws.add(law)
            yield i, place


def _sentences(context: Context, found: Robustness) -> Iterator[str]:
    """What happens to the reference, most serious first."""
    place_of = {design.id: design for design in context.ranking.designs}
    name = design_name(place_of[found.designs[0]]) if found.designs[0] in place_of else "The first design"
    plants = [p for p, adds in enumerate(found.adds) if adds]
    yield (
        f"{name} on {plural(len(found.plants) - 1, 'other plant')}, {found.n:,} of the study scenarios each "
        f"({found.left:,} left, {found.right:,} right). {len(plants)} of them add a difficulty to the study\u2019s "
        "plant: the sentences below and the light of the verdict are about these. The others take one away."
    )
    lost = [found.titles[p] for p in plants if found.diverged[p, 0]]
    if lost:
        yield f"It diverges in some departures with: {', '.join(lost)}."
    worse = [found.titles[p] for p in plants if found.excess[p, 0] > 0]
    if worse:
        yield f"It is worse than no control with: {', '.join(worse)}."
    changes = np.where(found.adds, found.S[:, 0] - found.S[0, 0], np.nan)
    if np.isfinite(changes).any():
        p = int(np.nanargmax(changes))
        ratio = found.S[p, 0] / found.S[0, 0] if found.S[0, 0] > 0 else math.nan
        if changes[p] > 0 and math.isfinite(ratio):
            rise = f"{ratio:.2g} times" if ratio >= 2.0 else percent(ratio - 1.0, 0) + " more"
            yield f"S rises most with {found.titles[p]} ({found.differences[p]}): {rise}."
    behind = [found.titles[p] for p in plants if found.behind[p] > 0]
    if behind:
        yield f"Another of the designs compared is better with: {', '.join(behind)}."


def _table(context: Context, found: Robustness, shown: list[int]) -> Table:
    by_id = {design.id: design for design in context.ranking.designs}
    columns = [Column("Plant", text=True), Column("Differs in", text=True)]
    for i in shown:
        title = law_title(by_id[found.designs[i]])
        columns += [
            Column(f"{title}: S", "m\u00b7s", ".3f"),
            Column("Change", "%", "+.0f"),
            Column("Diverged", form="d"),
        ]
    rows = []
    for p, what in enumerate(zip(found.titles, found.differences, strict=True)):
        cells: list[Cell | Value] = [*what]
        for i in shown:
            S, unchanged, lost = float(found.S[p, i]), float(found.S[0, i]), int(found.diverged[p, i])
            change = 100.0 * (S / unchanged - 1.0) if unchanged > 0 else math.nan
            cells += [Cell(S, bad=bool(found.excess[p, i] > 0)), change if p else None, Cell(lost, bad=bool(lost))]
        rows.append(Row(cells))
    faults = "worse than no control there, or diverged where friction allows the path"
    return Table(f"Mean S on other plants; highlighted: {faults}", columns, rows)


def _left_out(found: Robustness) -> Iterator[str]:
    yield from (f"{title} is left out: {reason}" for title, reason in found.left_out)
    if found.slow:
        yield f"Laws that take too long to be driven again: {', '.join(found.slow)}."
    if found.unsafe:
        yield f"Laws that ended or held up their process: {', '.join(found.unsafe)}."
    for plant, design, reason in found.raised:
        yield f"{found.titles[plant]}: design {found.designs[design]}: {reason}"


def _margins(context: Context, found: Robustness) -> Iterator[Chart]:
    """Gain and phase margin over speed."""
    for name, title, factor, level in (
        ("gain", "Gain margin", 1.0, 2.0),
        ("phase", "Phase margin [\u00b0]", math.degrees(1.0), 30.0),
    ):
        series = []
        for i, place in _shown(context, found):
            values = factor * getattr(found, name)[i]
            if not np.isnan(values).all():
                known = np.minimum(values, 20.0 if name == "gain" else 180.0)
                series.append(
                    Series(
                        law_title(context.ranking.designs[place]), found.v, known, context.style(place), kind="marked"
                    )
                )
        if series and found.v.size > 1:
            y = Axis.around(title, *(one.y for one in series), [level], zero=True)
            x = Axis.around("Speed [m/s]", found.v)
            yield Chart(f"margin-{name}", title, x, y, series, level=level, height=230)
