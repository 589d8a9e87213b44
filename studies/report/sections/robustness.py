"""Robustness: whether the ranking holds on other plants, and the margins of its designs over speed."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import controller_class
from ldctoolkit.arrays import FloatArray
from ldctoolkit.review import Thresholds
from studies.report.context import Context
from studies.report.figures.robustness_figures import Line, Scale, bump_figure, margin_figure
from studies.report.look.style import LineStyle
from studies.report.rendering import render
from studies.report.section import Drawing, Section
from studies.report.tables.row import Row
from studies.report.words.prose import rank_text
from studies.report.words.robustness import (
    change_text,
    gap_text,
    is_not_shown,
    is_worse,
    reduction_text,
    robustness_sentences,
)
from studies.report.words.text import number, printable
from studies.robustness.robustness import CONFIDENCE, Robustness

_GAIN_TOP: Final = 30.0
_PHASE_TOP: Final = 90.0
_DELAY_TOP: Final = 5.0


@dataclasses.dataclass(frozen=True)
class Cell:
    """One design on one plant, as text.

    Attributes
    ----------
    S, change, interval, reduction, rank : str
    told : bool
        Whether the interval of the change excludes 0.
    failures, diverged : int
    worse : bool
        Than no control, beyond chance.
    not_shown : bool
        Worse than no control by what may be chance.
    raised : str
        Why there are no numbers.
    """

    S: str
    change: str
    interval: str
    reduction: str
    rank: str
    told: bool
    failures: int
    diverged: int
    worse: bool
    not_shown: bool
    raised: str


@dataclasses.dataclass(frozen=True)
class PlantLine:
    """One plant of the table."""

    title: str
    what: str
    cells: tuple[Cell, ...]


@dataclasses.dataclass(frozen=True)
class MarginLine:
    """One design of the table of margins: the worst over the speeds, and where."""

    name: str
    cells: tuple[tuple[str, str, str], ...]
    unstable: str
    notes: tuple[str, ...]


def section(context: Context) -> Section:
    """The section."""
    found = context.report.robustness
    rows = _rows(context, found) if found is not None else ()
    if found is None or not rows or not found.n:
        reason = "left-out" if found is None else ("no-design" if not rows else "no-scenario")
        body = render("sections/robustness.html", found=found, reason=reason, slow=_slow(found))
        return Section("robustness", "Robustness", body, styles=("robustness.css",))
    names, styles = _names(context, rows), _styles(context, rows)
    of = context.primary.best_name if rows[0].index == context.primary.best.index else "the best design driven here"
    bump, margins = tuple(_bump(found, names, styles)), tuple(_margins(found, names, styles, context.report.setup.dt))
    body = render(
        "sections/robustness.html",
        reason="",
        found=found,
        slow=_slow(found),
        sentences=robustness_sentences(found, rows, names, of),
        names=names,
        lines=tuple(_lines(found)),
        confidence=CONFIDENCE,
        bump=bump,
        margins=margins,
        margin_lines=tuple(_margin_lines(found, names, context.report.setup.dt)),
        dt=context.report.setup.dt,
        ideal=context.report.setup.options.ideal,
    )
    return Section("robustness", "Robustness", body, (*bump, *margins), styles=("robustness.css",))


def _slow(found: Robustness | None) -> tuple[str, ...]:
    return () if found is None else tuple(controller_class(law).title for law in found.slow)


def _rows(context: Context, found: Robustness) -> tuple[Row, ...]:
    """Rows of the designs, in their order; none where the numbers are not of this ranking."""
    rows = {row.design.id: row for row in context.primary.rows}
    return tuple(rows[name] for name in found.designs) if all(name in rows for name in found.designs) else ()


def _names(context: Context, rows: tuple[Row, ...]) -> tuple[str, ...]:
    """What tells the designs apart: the law, and where there are two of a law, Table I or the rank."""
    count, paper = Counter(row.title for row in rows), context.primary.paper_design
    names = []
    for row in rows:
        of_paper = paper is not None and row.index == paper.index
        more = " (Table I)" if of_paper else (f" ({rank_text(row)})" if count[row.title] > 1 else "")
        names.append(printable(row.title) + more)
    return tuple(names)


def _styles(context: Context, rows: tuple[Row, ...]) -> tuple[LineStyle, ...]:
    """Each law's own; a further design of a law has another dash and marker."""
    seen: Counter[str] = Counter()
    styles = []
    for row in rows:
        style, again = context.styles[row.design.law], seen[row.design.law]
        styles.append(
            dataclasses.replace(style, dash=(1.0, 1.0), marker="*" if again == 1 else "p") if again else style
        )
        seen[row.design.law] += 1
    return tuple(styles)


def _lines(found: Robustness) -> Iterator[PlantLine]:
    raised = {(k, i): reason for k, i, reason in found.raised}
    for k, title in enumerate(found.titles):
        cells = tuple(_cell(found, k, i, raised.get((k, i), "")) for i in range(len(found.designs)))
        yield PlantLine(title, found.differences[k], cells)


def _cell(found: Robustness, k: int, i: int, raised: str) -> Cell:
    low, high = float(found.low[k, i]), float(found.high[k, i])
    now, before = int(found.rank[k, i]), int(found.rank[0, i])
    rank = f"{before} \u2192 {now}" if now and before and now != before else (str(now) if now else "\u2013")
    return Cell(
        S=number(float(found.S[k, i])),
        change=change_text(found, k, i) if k else "",
        interval=f"{gap_text(low)} to {gap_text(high)}" if k and np.isfinite([low, high]).all() else "\u2013",
        reduction=reduction_text(found, k, i),
        rank=rank,
        told=low > 0 or high < 0,
        failures=int(found.failures[k, i]),
        diverged=int(found.diverged[k, i]),
        worse=is_worse(found, k, i),
        not_shown=is_not_shown(found, k, i),
        raised=raised,
    )


def _bump(found: Robustness, names: tuple[str, ...], styles: tuple[LineStyle, ...]) -> Iterator[Drawing]:
    if found.contends.sum() < 2 or len(found.plants) < 2:
        return
    ranks = np.where(found.rank > 0, found.rank, np.nan).astype(np.float64)
    lines = [Line(names[i], styles[i], ranks[:, i]) for i in range(len(names)) if found.contends[i]]
    yield Drawing("robustness-ranks", "Rank of the designs on every plant", bump_figure(lines, found.titles))


def _margins(found: Robustness, names: tuple[str, ...], styles: tuple[LineStyle, ...], dt: float) -> Iterator[Drawing]:
    own = [i for i, one in enumerate(found.margins) if one.linear]
    if not own:
        return
    limits = Thresholds()
    stable = np.array([found.margins[i].stable for i in own])
    gains = [np.minimum(found.margins[i].gain, found.margins[i].gain_reduction) for i in own]
    phases = [np.degrees(found.margins[i].phase) for i in own]
    delays = [found.margins[i].delay / dt for i in own]
    phase = tuple(float(np.degrees(value)) for value in limits.phase_margin)
    scales = (
        ("gain", gains, Scale("Gain margin", "Gain margin [dB]", *limits.gain_margin, _GAIN_TOP)),
        ("phase", phases, Scale("Phase margin", "Phase margin [\u00b0]", phase[0], phase[1], _PHASE_TOP)),
        ("delay", delays, Scale("Delay margin", "Delay margin [samples]", *limits.delay_margin, _DELAY_TOP)),
    )
    for name, values, scale in scales:
        lines = [Line(names[i], styles[i], one) for i, one in zip(own, values, strict=True)]
        title = f"{scale.title} over speed"
        yield Drawing(f"margin-{name}", title, margin_figure(lines, found.v, stable, scale))


def _margin_lines(found: Robustness, names: tuple[str, ...], dt: float) -> Iterator[MarginLine]:
    limits = Thresholds()
    for name, one in zip(names, found.margins, strict=True):
        if not one.linear:
            yield MarginLine(name, (), "", one.notes)
            continue
        cells = (
            _worst(one.gain, found.v, limits.gain_margin, "dB", 1.0),
            _worst(one.gain_reduction, found.v, limits.gain_margin, "dB", 1.0),
            _worst(np.degrees(one.phase), found.v, np.degrees(limits.phase_margin), "\u00b0", 1.0),
            _worst(one.delay, found.v, np.array(limits.delay_margin) * dt, "ms", 1e3),
        )
        yield MarginLine(name, cells, _unstable(one.stable, found.v), one.notes)


def _unstable(stable: npt.NDArray[np.bool_], v: FloatArray) -> str:
    """Speeds without a stable loop; neighbours as a range."""
    lost = np.flatnonzero(~stable)
    if not lost.size:
        return "no"
    runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    told = (" to ".join(number(float(v[i]), 1) for i in dict.fromkeys((run[0], run[-1]))) for run in runs)
    return f"at {', '.join(told)} m/s"


def _worst(
    values: FloatArray, v: FloatArray, limits: tuple[float, float] | FloatArray, unit: str, scale: float
) -> tuple[str, str, str]:
    """The smallest margin, the speed where it is, and which threshold it is below."""
    if np.isnan(values).all():
        return "\u2013", "", ""
    i = int(np.nanargmin(values))
    value = float(values[i])
    word = "fault" if value < limits[1] else ("low" if value < limits[0] else "")
    if not np.isfinite(value):
        return number(value), "", ""
    space = "" if unit == "\u00b0" else "\u00a0"
    digits = 0 if unit == "ms" else 1
    return f"{number(scale * value, digits)}{space}{unit}", f"at {number(float(v[i]), 0)}\u00a0m/s", word
