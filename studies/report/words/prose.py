"""The report's sentences on designs, the plant, and what the study cannot say."""

from __future__ import annotations

import math
from collections.abc import Iterator

from markupsafe import Markup

from studies.report.figures.landscape import is_full_grid
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Interval, Row, is_baseline
from studies.report.tables.tabulate import tried
from studies.report.words.text import compact, difference_text, number, percent, plural, symbols
from studies.study_file.plant_table import differences

_NB = "\u00a0"


def design_text(row: Row) -> Markup:
    """A design in running text: title, threshold, gains."""
    gains = "".join(f", {name}{_NB}={_NB}{value}{_NB + unit if unit else ''}" for name, value, unit in row.gains)
    threshold = "" if is_baseline(row) else f", y_s{_NB}={_NB}{compact(row.design.y_s)}{_NB}m"
    return symbols(f"{row.title}{threshold}{gains}")


def between(interval: Interval, digits: int = 3) -> str:
    """``1.20 to 1.27``, or that it is not known."""
    return _ends(interval, number(interval.low, digits), number(interval.high, digits))


def between_differences(interval: Interval) -> str:
    """``−0.012 to +0.00034``, of a difference."""
    return _ends(interval, difference_text(interval.low, 3), difference_text(interval.high, 3))


def between_percent(interval: Interval) -> str:
    """``31.2 % to 33.0 %``."""
    return _ends(interval, percent(interval.low), percent(interval.high))


def _ends(interval: Interval, low: str, high: str) -> str:
    known = math.isfinite(interval.low) and math.isfinite(interval.high)
    return f"{low} to {high}" if known else "not known"


def rank_text(row: Row) -> str:
    """``rank 3``, or that it has none."""
    return f"rank {row.rank}" if row.rank else "not ranked"


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
    "S ends where the uncorrected departure ends. The loop goes on for {} s, which count for the way back, the "
    "opposite line, comfort and steering only."
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
    "The lowest mean S of {} is the lowest also by luck, so that mean is optimistic{}. Intervals of mean S hold for "
    "all designs at once, and so do those of the differences to the best and to the baseline; the interval of the "
    "reduction and the bands of convergence are those of one design by itself."
)
_CONFIRM = "; a study with finalists, or with another seed, tells by how much"
_FRESH = "; the score on fresh departures, on which no design was chosen, is free of that"
_RACED = (
    "A race gives up designs on few departures: a failure that is rare, and that no design showed there, cannot be "
    "known of. Requirements, the Pareto front and cases beside the primary one were not looked at for that."
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


def limitations(report: ReportInput, table: CaseTable) -> list[Markup]:
    """What the numbers of this study do not say."""
    cases = [results.case for results in report.results.cases]
    said = [*_of_the_plant(report), Markup(_COMFORT), Markup(_CHANCE)]
    if table.tried > 1:
        luck = _FRESH if table.fresh_scenarios else _CONFIRM
        said.append(Markup(_CHOSEN).format(plural(table.tried, "design"), luck))
    if table.race is not None and table.race.dropped:
        said.append(Markup(_RACED))
    if any(case.window == "control" for case in cases):
        said.append(Markup(_CONTROL_WINDOW))
    if any(case.convention == "as_printed" for case in cases):
        said.append(Markup(_AS_PRINTED))
    if report.synthetic:
        said.append(Markup(_SYNTHETIC))
    return said


def _of_the_plant(report: ReportInput) -> Iterator[Markup]:
    """What the plant of this study leaves out."""
    options = report.setup.options
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
    yield Markup(_HORIZON).format(compact(report.setup.settle)) if report.setup.settle > 0 else Markup(_NO_HORIZON)


def plant(report: ReportInput) -> Markup:
    """One sentence on a plant that is not ideal; empty for the ideal one."""
    words = differences(report.setup.options)
    if not words:
        return Markup("")
    said = Markup(
        "<strong>The plant of this study is not ideal:</strong> {}. Its values stand in the "
        "<a href='#settings'>settings</a>; scores must not be compared with those on another plant."
    )
    return said.format("; ".join(words))


def partial_grids(report: ReportInput) -> bool:
    """Whether some law was not run on every combination of its swept values."""
    designs = tried(report.results)
    return any(not is_full_grid([d for d in designs if d.law == law]) for law in {d.law for d in designs})
