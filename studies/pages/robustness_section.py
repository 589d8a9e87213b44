"""Other plants: designs on vehicles that are not the study's, the margins of their loops, and each kind of driver."""

import math
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from ldctoolkit.arrays import IntArray

from ..ranking.verdict import design_name, law_title
from ..robustness import CONFIDENCE, LEAVES, Robustness
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import percent, plural
from .charts import LEFT_IS_BETTER, Axis, Chart, Dot, Series, dots, legend
from .context import Context
from .shell import Section, bullets, details, figure, paragraphs

MOST_LAWS: Final = 4  # designs in the table; their margins too
MOST_WITH_DRIVERS: Final = 6  # designs in the section with a driver
HANDS_OFF: Final = "Nobody holds the wheel in this study. What a driver changes: docs/explanation/driver.md."
ALL: Final = "all together"  # the drivers of the study
NOT_DRIVEN: Final = (
    "Designs were not driven on other plants for this report: leave --no-robustness out to have them here."
)


def section(context: Context) -> Section:
    """The section."""
    robustness = context.report.robustness
    hands_off = HANDS_OFF if context.report.setup.options.driver.ideal else ""
    if robustness is None:
        return Section("robustness", "Other plants", paragraphs(NOT_DRIVEN, hands_off))
    shown = tuple(_shown(context, robustness))
    charts = tuple(_margins(context, robustness, shown))
    body = paragraphs(*_sentences(context, robustness)) + to_html(_plants_table(context, robustness, shown))
    body += bullets(_left_out(robustness)) + paragraphs(hands_off)
    if charts:
        body += details(
            "Margins of the loop over speed",
            figure(
                charts,
                "On the study\u2019s plant, without its limits of rate and angle. At 0 the loop is unstable. "
                "Dashed: the least that the set stable requires. Gain margins above 20 are drawn at 20.",
            ),
        )
    return Section("robustness", "Other plants", body, charts)


Shown = tuple[tuple[int, int], ...]  # of each design: its position among those of the robustness, and in the ranking


def _shown(context: Context, robustness: Robustness, most: int = MOST_LAWS) -> Iterator[tuple[int, int]]:
    """The reference, then the best design of each law."""
    positions = {design.id: i for i, design in enumerate(context.ranking.designs)}
    laws: set[str] = set()
    for i, id in enumerate(robustness.designs):
        position = positions.get(id)
        if position is None or context.ranking.designs[position].is_baseline:
            continue
        law = context.ranking.designs[position].law
        if law not in laws and len(laws) < most:
            laws.add(law)
            yield i, position


def _sentences(context: Context, robustness: Robustness) -> Iterator[str]:
    """What happens to the reference, most serious first."""
    reference = [design for design in context.ranking.designs if design.id == robustness.designs[0]]
    name = design_name(reference[0]) if reference else "The first design"
    plants = [p for p, adds in enumerate(robustness.adds) if adds]
    others = len(robustness.plants) - 1 - len(robustness.drivers)
    yield (
        f"{name} on {plural(others, 'other plant')}, {robustness.n:,} of the study scenarios each "
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
        if p in robustness.drivers.values():
            continue
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


# ------------------------------------------------------------------------------------------------ with a driver


def driver_section(context: Context) -> Section | None:
    """The designs with each kind of driver; none where nobody holds the wheel of the study's plant."""
    driver, robustness = context.report.setup.options.driver, context.report.robustness
    if driver.ideal:
        return None
    if robustness is None:
        return Section("driver", "With a driver", paragraphs(NOT_DRIVEN))
    shown = tuple(of for of in _shown(context, robustness, MOST_WITH_DRIVERS) if robustness.contends[of[0]])
    plants, S = {ALL: 0} | robustness.drivers, robustness.S[:, [i for i, _ in shown]]
    places = 1 + (S[:, None, :] < S[:, :, None]).sum(axis=2)  # (p, shown)
    change, (low, high) = robustness.difference, robustness.difference_ends
    laws = [law_title(context.ranking.designs[position]) for _, position in shown]
    looks = [(i, law, context.style(position)) for law, (i, position) in zip(laws, shown, strict=True)]
    rows = [
        [Dot(who, float(change[p, i]), float(low[p, i]), float(high[p, i]), style, tip=f"{who}: {law}")
         for i, law, style in looks]
        for who, p in plants.items() if who != LEAVES
    ]  # fmt: skip
    ends = [(dot.low, dot.high, 0.0) for row in rows for dot in row]
    x = Axis.around(f"Difference of mean S [m\u00b7s]{LEFT_IS_BETTER}", ends)
    title = f"Mean S minus that of {context.shown_name} with each kind of driver"
    chart = dots("drivers", f"{title}, better to the left", rows, x, upright=(0.0, context.shown_name))
    body = paragraphs(*_of_drivers(context, robustness, shown, places))
    body += to_html(_drivers_table(context, robustness, shown, places, plants))
    caption = f"{title}, with intervals; to the right a design is worse. Without {LEAVES}."
    body += figure((chart,), caption, legend([(law, style) for _, law, style in looks]))
    return Section("driver", "With a driver", body, (chart,))


def _of_drivers(context: Context, robustness: Robustness, shown: Shown, places: IntArray) -> Iterator[str]:
    """Who the drivers are, and which laws keep their place with each of the mix."""
    driver, designs = context.report.setup.options.driver, context.ranking.designs
    mix = robustness.of_mix(driver)
    yield (
        f"The study\u2019s drivers: {', '.join(f'{percent(getattr(driver, name), 0)} {name}' for name in mix)}. In a "
        f"row below all are of one kind, on {robustness.n:,} of the study scenarios, with the hands and reaction times "
        "that they have in the study. More: docs/explanation/driver.md."
    )
    yield "; ".join(f"{who}: {robustness.differences[p]}" for who, p in robustness.drivers.items()) + "."
    counted, kept, moved = {name: p for name, p in mix.items() if name != LEAVES}, [], []
    for k, (i, position) in enumerate(shown if counted and len(shown) > 1 else ()):
        law, (low, high) = law_title(designs[position]), robustness.difference_ends[:, :, i]
        if (places[list(counted.values()), k] == places[0, k]).all():
            kept.append(f"{law} ({places[0, k]})")
            continue
        unit = f"m\u00b7s to {context.shown_name}"
        other = (
            f"{places[p, k]} with {who}" + (f" ({low[p]:+.3f} to {high[p]:+.3f} {unit})" if i else "")
            for who, p in counted.items()
        )
        moved.append(f"{law}: place {places[0, k]} {ALL}, {', '.join(other)}.")
    if kept or moved:
        yield f"Laws that keep their place with {' and '.join(counted)}: {', '.join(kept) or 'none'}. {' '.join(moved)}"


def _drivers_table(
    context: Context, robustness: Robustness, shown: Shown, places: IntArray, plants: Mapping[str, int]
) -> Table:
    columns = [
        Column("Driver", text=True), Column("Law", text=True), Column("Place", form="d"),
        Column("Mean S", "m\u00b7s", ".3f"), Column("Interval", "m\u00b7s", ".3f"),
        Column(f"To {context.shown_name}", "m\u00b7s", "+.3f"), Column("Interval", "m\u00b7s", "+.3f"),
        Column("Peak torque, mean", "N\u00b7m", ".2f"), Column("95 %", "N\u00b7m", ".2f"),
        Column("Against the driver", "s", ".2f"), Column("Overridden", "%", ".0f"),
    ]  # fmt: skip
    rows, of = [], robustness
    for who, p in plants.items():
        share = getattr(context.report.setup.options.driver, who, 0.0)
        placed = np.isfinite(of.S[p]) & (who != LEAVES)
        for k, (i, position) in enumerate(shown):
            ends = [(float(low[p, i]), float(high[p, i])) for low, high in (of.S_ends, of.difference_ends)]
            change = [float(of.difference[p, i]), ends[1]] if i else [None, None]
            torque_mean, torque_p95, against, overridden = of.felt[:, p, i].tolist()
            rows.append(Row([
                f"{who} ({percent(share, 0)})" if share else who, law_title(context.ranking.designs[position]),
                int(places[p, k]) if placed[i] else None, float(of.S[p, i]), ends[0], *change,
                torque_mean, torque_p95, against, 100.0 * overridden,
            ], "winner" if position == context.ranking.winner else ""))  # fmt: skip
    about = f"{LEAVES}: the departure is wanted, torque counts and not S"
    return Table(f"Kinds of drivers, {100 * CONFIDENCE:g} % intervals; {about}", columns, rows)
