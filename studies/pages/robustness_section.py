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
    robustness = context.report.robustness
    if robustness is None:
        body = paragraphs(
            "Designs were not driven on other plants for this report: leave --no-robustness out to have them here."
        )
        return Section("robustness", "Other plants", body)
    shown = tuple(_shown(context, robustness))
    charts = tuple(_margins(context, robustness, shown))
    body = paragraphs(*_sentences(context, robustness)) + to_html(_plants_table(context, robustness, shown))
    body += bullets(_left_out(robustness))
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


Shown = tuple[tuple[int, int], ...]  # of each design: its position among those of the robustness, and in the ranking


def _shown(context: Context, robustness: Robustness) -> Iterator[tuple[int, int]]:
    """The reference, then the best design of each law."""
    positions = {design.id: i for i, design in enumerate(context.ranking.designs)}
    laws: set[str] = set()
    for i, id in enumerate(robustness.designs):
        position = positions.get(id)
        if position is None or context.ranking.designs[position].is_baseline:
            continue
        law = context.ranking.designs[position].law
        if law not in laws and len(laws) < MOST_LAWS:
            laws.add(law)
            yield i, position


def _sentences(context: Context, robustness: Robustness) -> Iterator[str]:
    """What happens to the reference, most serious first."""
    reference = [design for design in context.ranking.designs if design.id == robustness.designs[0]]
    name = design_name(reference[0]) if reference else "The first design"
    plants = [p for p, adds in enumerate(robustness.adds) if adds]
    yield (
        f"{name} on {plural(len(robustness.plants) - 1, 'other plant')}, {robustness.n:,} of the study scenarios each "
        f"({robustness.left:,} left, {robustness.right:,} right). {len(plants)} of them add a difficulty to the "
        "study\u2019s plant: the sentences below and the light of the verdict are about these. The others take one "
        "away."
    )
    lost = [robustness.titles[p] for p in plants if robustness.diverged[p, 0]]
    if lost:
        yield f"It diverges in some departures with: {', '.join(lost)}."
    worse = [robustness.titles[p] for p in plants if robustness.excess[p, 0] > 0]
    if worse:
        yield f"It is worse than no control with: {', '.join(worse)}."
    changes = np.where(robustness.adds, robustness.S[:, 0] - robustness.S[0, 0], np.nan)
    if np.isfinite(changes).any():
        p = int(np.nanargmax(changes))
        ratio = robustness.S[p, 0] / robustness.S[0, 0] if robustness.S[0, 0] > 0 else math.nan
        if changes[p] > 0 and math.isfinite(ratio):
            rise = f"{ratio:.2g} times" if ratio >= 2.0 else percent(ratio - 1.0, 0) + " more"
            yield f"S rises most with {robustness.titles[p]} ({robustness.differences[p]}): {rise}."
    behind = [robustness.titles[p] for p in plants if robustness.behind[p] > 0]
    if behind:
        yield f"Another of the designs compared is better with: {', '.join(behind)}."


def _plants_table(context: Context, robustness: Robustness, shown: Shown) -> Table:
    columns = [Column("Plant", text=True), Column("Differs in", text=True)]
    for _, position in shown:
        title = law_title(context.ranking.designs[position])
        columns += [
            Column(f"{title}: S", "m\u00b7s", ".3f"),
            Column("Change", "%", "+.0f"),
            Column("Diverged", form="d"),
        ]
    rows = []
    for p, what in enumerate(zip(robustness.titles, robustness.differences, strict=True)):
        cells: list[Cell | Value] = [*what]
        for i, _ in shown:
            S, unchanged, lost = float(robustness.S[p, i]), float(robustness.S[0, i]), int(robustness.diverged[p, i])
            change = 100.0 * (S / unchanged - 1.0) if unchanged > 0 else math.nan
            cells += [Cell(S, bad=bool(robustness.excess[p, i] > 0)), change if p else None, Cell(lost, bad=bool(lost))]
        rows.append(Row(cells))
    faults = "worse than no control there, or diverged where friction allows the path"
    return Table(f"Mean S on other plants; highlighted: {faults}", columns, rows)


def _left_out(robustness: Robustness) -> Iterator[str]:
    yield from (f"{title} is left out: {reason}" for title, reason in robustness.left_out)
    if robustness.slow:
        yield f"Laws that take too long to be driven again: {', '.join(robustness.slow)}."
    if robustness.unsafe:
        yield f"Laws that ended or held up their process: {', '.join(robustness.unsafe)}."
    for plant, design, reason in robustness.raised:
        yield f"{robustness.titles[plant]}: design {robustness.designs[design]}: {reason}"


def _margins(context: Context, robustness: Robustness, shown: Shown) -> Iterator[Chart]:
    """Gain and phase margin over speed."""
    for name, title, margins, largest, level in (
        ("gain", "Gain margin", robustness.gain, 20.0, 2.0),
        ("phase", "Phase margin [\u00b0]", np.degrees(robustness.phase), 180.0, 30.0),
    ):
        series = []
        for i, position in shown:
            if not np.isnan(margins[i]).all():
                law, drawn = law_title(context.ranking.designs[position]), np.minimum(margins[i], largest)
                series.append(Series(law, robustness.v, drawn, context.style(position), kind="marked"))
        if series and robustness.v.size > 1:
            y = Axis.around(title, *(curve.y for curve in series), [level], zero=True)
            x = Axis.around("Speed [m/s]", robustness.v)
            yield Chart(f"margin-{name}", title, x, y, series, level=level, height=230)
