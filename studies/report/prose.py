"""The report's sentences: what won, by how much, how sure, and what the study cannot say."""

from __future__ import annotations

import math
from collections.abc import Iterator

from markupsafe import Markup

from ldctoolkit.departures import LEFT
from studies.report.inputs import ReportInput
from studies.report.landscape import is_full_grid, on_the_edge
from studies.report.summary import PAPER_LAW, CaseTable, Interval, Row, is_baseline
from studies.report.text import compact, number, percent, plural, symbols
from studies.study_file.plant_table import differences

_NB = "\u00a0"


def design_text(row: Row) -> Markup:
    """A design in running text: title, threshold, gains."""
    gains = "".join(f", {name}{_NB}={_NB}{value}{_NB + unit if unit else ''}" for name, value, unit in row.gains)
    threshold = "" if is_baseline(row) else f", y_s{_NB}={_NB}{compact(row.design.y_s)}{_NB}m"
    return symbols(f"{row.title}{threshold}{gains}")


def between(interval: Interval, digits: int = 3) -> str:
    """``1.20 to 1.27``."""
    return f"{number(interval.low, digits)} to {number(interval.high, digits)}"


def between_percent(interval: Interval) -> str:
    """``31.2 % to 33.0 %``."""
    return f"{percent(interval.low)} to {percent(interval.high)}"


def answer(report: ReportInput, table: CaseTable) -> list[Markup]:
    """The answer in a few sentences, each a paragraph."""
    winner = table.winner
    sentences = [_lead(report, table)]
    if is_baseline(winner):
        sentences.append(Markup("No design of this study improves on leaving the departures alone."))
    else:
        sentences.append(_against_no_control(table))
        rival, words = _rival(table)
        if rival is not None:
            sentences.append(_against(rival, words))
    sentences.append(_tied(table))
    if winner.triggered == 0 and not is_baseline(winner):
        sentences.append(
            Markup("No departure went deep enough to trigger it, so the score is that of the uncorrected paths.")
        )
    edge = () if is_baseline(winner) else on_the_edge(report.results.designs, winner.index)
    if edge:
        said = Markup("The best design sits at the end of what was tried for {}: a wider sweep may find a better one.")
        sentences.append(said.format(symbols(", ".join(edge))))
    return sentences


def _lead(report: ReportInput, table: CaseTable) -> Markup:
    winner, n = table.winner, report.results.scenarios.n
    left = int((report.results.scenarios.side == LEFT).sum())
    equal = sum(row.rank == winner.rank for row in table.rows) - 1
    has = f"shares with {plural(equal, 'other')}" if equal else "has"
    said = Markup(
        "<strong>{}</strong> {} the lowest mean score of {}: <strong>S&nbsp;=&nbsp;{}&nbsp;m·s</strong> "
        "({} interval {}) over {} ({:,} left, {:,} right), the same for all designs."
    )
    return said.format(
        design_text(winner),
        has,
        plural(len(table.rows), "design"),
        number(winner.S.value),
        percent(table.confidence, 0),
        between(winner.S),
        plural(n, "generated departure"),
        left,
        n - left,
    )


def _against_no_control(table: CaseTable) -> Markup:
    winner = table.winner
    saved = winner.reduction.value
    word = "less" if saved >= 0 else "more"
    shown = winner.reduction if saved >= 0 else Interval(-saved, -winner.reduction.high, -winner.reduction.low)
    return Markup("Against no control ({} m·s) that is <strong>{} {}</strong> (interval {}).").format(
        number(table.uncorrected), percent(shown.value), word, between_percent(shown)
    )


def _rival(table: CaseTable) -> tuple[Row | None, str]:
    """The best design of the paper's law, or of another law where that law won."""
    if table.winner.design.law != PAPER_LAW:
        paper = table.best_of(PAPER_LAW)
        if paper is not None:
            return paper, "the best design of the paper\u2019s law"
    others = [r for r in table.best_of_each_law if r.design.law != table.winner.design.law and not is_baseline(r)]
    return (others[0], "the best design of any other law") if others else (None, "")


def _against(rival: Row, words: str) -> Markup:
    saved = rival.difference
    share = saved.value / rival.S.value if rival.S.value > 0 else 0.0
    said = Markup(
        "Against {} ({}; rank {}, {} m·s) it is <strong>{} m·s or {} less</strong> (paired interval {} m·s).{}"
    )
    return said.format(
        words,
        design_text(rival),
        rival.rank,
        number(rival.S.value),
        number(saved.value),
        percent(share),
        between(saved),
        " The two cannot be told apart on these departures." if rival.tied else "",
    )


def _tied(table: CaseTable) -> Markup:
    if len(table.rows) == 1:
        return Markup("It is the only design of this study.")
    if not table.tied:
        return Markup(
            "No other design is statistically tied with it: the interval of every paired difference lies above zero."
        )
    names = [row for row in table.rows[1:] if row.tied]
    said = Markup(
        "<strong>{}</strong> {} statistically tied with it, the interval of the paired difference holds zero: {}{}."
    )
    return said.format(
        plural(table.tied, "other design"),
        "is" if table.tied == 1 else "are",
        Markup("; ").join(Markup("{} (rank {})").format(design_text(row), row.rank) for row in names[:3]),
        f"; and {len(names) - 3:,} more" if len(names) > 3 else "",
    )


_LINEAR = "The plant is the linear single-track model: tyres do not saturate."
_SATURATING = (
    "The plant is the single-track model with saturating tyres and static wheel loads: roll, pitch and load transfer "
    "are left out."
)
_AT_ONCE = "Steering takes effect at once: the actuator has no delay, no lag and no limit."
_SEEN = "Laws see the lane and the vehicle\u2019s state as they are."
_FROZEN = "The speed is frozen at its value at the trigger."
_UNCORRECTED = (
    "The uncorrected path, rebuilt from eight parameters, stands for what happens without control. The driver does not "
    "react to the intervention."
)
_NO_RESIDUALS = "The small residuals about the fitted path are left out."
_NO_HORIZON = "Control ends where the uncorrected departure ends; what follows is not looked at."
_HORIZON = (
    "S ends where the uncorrected departure ends. The loop goes on for {} s, which count for overshoot, the way back, "
    "comfort and steering only."
)
_COMFORT = (
    "S puts no price on steering or comfort, and laws have different limits of their own: a design that steers harder "
    "scores better as long as the plant stays stable. What it costs stands under "
    "<a href='#limits'>what a release asks for</a>."
)
_CHANCE = (
    "Intervals hold the chance in drawing departures from the scenario model. They do not hold the uncertainty of the "
    "model, which was fitted to the numbers of departures given under its name below, and more generated departures do "
    "not make that smaller."
)
_CHOSEN = (
    "The best of {} is chosen on the departures that it is scored on, so its own mean is slightly optimistic, and "
    "intervals are not corrected for the number of comparisons."
)
_CONTROL_WINDOW = (
    "Over the control window S starts at the trigger: a later trigger scores less time, so such scores must not be "
    "compared between thresholds y<sub>s</sub>."
)
_AS_PRINTED = "Cases marked <em>as printed</em> follow the paper\u2019s misprints and are there for comparison only."
_SYNTHETIC = (
    "<strong>The scenario model is synthetic.</strong> It was not fitted to recorded driving: the ranking shows how "
    "designs compare on the stated population, not on a real road."
)


def limitations(report: ReportInput, table: CaseTable, peak_steering: float | None = None) -> list[Markup]:
    """What the numbers of this study do not say; `peak_steering` [rad] is the best design's in the example paths."""
    cases = [results.case for results in report.results.cases]
    said = [*_of_the_plant(report), Markup(_COMFORT), Markup(_CHANCE)]
    if peak_steering is not None:
        share = Markup("In the example departures above the best design steers up to {}\u00b0 at the front wheels.")
        said.append(share.format(number(math.degrees(peak_steering), 1)))
    if len(table.rows) > 1:
        said.append(Markup(_CHOSEN).format(plural(len(table.rows), "design")))
    if any(case.window == "control" for case in cases):
        said.append(Markup(_CONTROL_WINDOW))
    if any(case.convention == "as_printed" for case in cases):
        said.append(Markup(_AS_PRINTED))
    if report.synthetic:
        said.append(Markup(_SYNTHETIC))
    return said


def _of_the_plant(report: ReportInput) -> Iterator[Markup]:
    """What the plant of this study leaves out."""
    options = report.options
    yield Markup(_LINEAR if options.tyres.ideal else _SATURATING)
    if options.actuator.ideal:
        yield Markup(_AT_ONCE)
    if options.sensors.ideal:
        yield Markup(_SEEN)
    if options.speed == "frozen":
        yield Markup(_FROZEN)
    yield Markup(_UNCORRECTED)
    if options.residuals.ideal:
        yield Markup(_NO_RESIDUALS)
    yield Markup(_HORIZON).format(compact(report.settle)) if report.settle > 0 else Markup(_NO_HORIZON)


def plant(report: ReportInput) -> Markup:
    """One sentence on a plant that is not ideal; empty for the ideal one."""
    words = differences(report.options)
    if not words:
        return Markup("")
    said = Markup(
        "<strong>The plant of this study is not ideal:</strong> {}. Its values stand in the "
        "<a href='#settings'>settings</a>; scores must not be compared with those on another plant."
    )
    return said.format("; ".join(words))


def partial_grids(report: ReportInput) -> bool:
    """Whether some law was not run on every combination of its swept values."""
    designs = report.results.designs
    return any(not is_full_grid([d for d in designs if d.law == law]) for law in {d.law for d in designs})
