"""What a release asks for beside S, as a table of figures and a few sentences on the best design."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

from markupsafe import Markup

from studies.ranking.ranking import Ranking
from studies.ranking.release import ReleaseFigures
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row, is_baseline
from studies.report.words.prose import design_text
from studies.report.words.text import compact, number, percent, plural, symbols

MOST_COLUMNS = 6
"""Designs side by side; more do not fit a screen."""

DASH = "–"  # noqa: RUF001 - the page shows true dashes


@dataclasses.dataclass(frozen=True)
class Column:
    """One design: the law's title, and what tells it from others of its law."""

    title: str
    gains: Markup


@dataclasses.dataclass(frozen=True)
class Line:
    """One figure of every design, and the limit that it is held against."""

    name: Markup
    limit: str
    cells: tuple[str | Markup, ...]


@dataclasses.dataclass(frozen=True)
class Group:
    """Figures that are taken over the same departures."""

    title: str
    over: str
    lines: tuple[Line, ...]


@dataclasses.dataclass(frozen=True)
class LimitsTable:
    """Figures down, designs across."""

    columns: tuple[Column, ...]
    groups: tuple[Group, ...]
    baseline: bool


def limits_table(report: ReportInput, table: CaseTable, ranking: Ranking) -> LimitsTable:
    """The table of the primary case.

    Parameters
    ----------
    report : ReportInput
    table : CaseTable
        Of the primary case.
    ranking : Ranking
        Of that case.

    Returns
    -------
    LimitsTable
        The winner, the best design of each other law by rank, and no control last.
    """
    rows = [row for row in table.best_of_each_law if not is_baseline(row)][:MOST_COLUMNS]
    baseline = next((row for row in table.rows if is_baseline(row)), None)
    rows += [baseline] if baseline is not None else []
    places = [row.place for row in rows]
    figures, settle = ranking.release, report.setup.settle

    def line(name: str, show: Callable[[Row, int], str], limit: str = "", *, acts: bool = False) -> Line:
        """`acts`: a figure of the interventions, of which the baseline has none."""
        cells = (DASH if acts and is_baseline(r) else show(r, k) for r, k in zip(rows, places, strict=True))
        return Line(Markup(name), limit, tuple(cells))

    def spread(quantity: str) -> Callable[[Row, int], str]:
        return lambda _, k: _spread(figures, quantity, k)

    groups = (
        Group(
            "In the lane",
            "all departures, to the departure\u2019s end",
            (
                line("DTLE stays above \u22120.3\u00a0m", lambda _, k: percent(figures.within_dtle[k]), _DTLE_LIMIT),
                line("DTLE, 5\u00a0% quantile [m]", lambda _, k: number(figures.dtle_p5[k], 2)),
                line("DTLE at its worst [m]", lambda _, k: number(figures.dtle_min[k], 2)),
                line(f"Deeper than D<sub>y</sub> = {compact(table.D_y)}\u00a0m", lambda r, _: percent(r.deeper)),
            ),
        ),
        Group(
            "Back to the lane",
            "interventions" + (f", to {compact(settle)}\u00a0s after the departure\u2019s end" if settle else ""),
            (
                line("Back inside at some time", lambda _, k: percent(figures.back_inside[k]), acts=True),
                line("Back inside after, median [s]", lambda _, k: number(figures.t_back_median[k], 2), acts=True),
                line("Opposite line crossed", lambda _, k: percent(figures.overshoot_share[k]), acts=True),
                line(
                    "Opposite line crossed by at most [m]",
                    lambda _, k: _overshoot(figures.overshoot_max[k], report.setup.vehicle.w_l),
                    acts=True,
                ),
            ),
        ),
        Group(
            "Comfort",
            "interventions; mean / 95\u00a0% quantile / largest",
            (
                line("Both limits kept", lambda _, k: percent(figures.comfortable[k]), "ISO 11270", acts=True),
                line("Peak lateral acceleration [m/s²]", spread("a_y_peak"), "limit 3", acts=True),
                line("Peak lateral jerk [m/s³]", spread("jerk_peak"), "limit 5", acts=True),
            ),
        ),
        Group(
            "Steering",
            "interventions",
            (
                line("Largest angle [°]", lambda _, k: _degrees(figures.delta_peak_max[k]), acts=True),
                line("Largest rate [°/s]", lambda _, k: _degrees(figures.delta_rate_peak_max[k]), acts=True),
                line(
                    "Mean effort ∫δ² dt [°²·s]", lambda _, k: number(_DEGREES**2 * figures.effort_mean[k], 2), acts=True
                ),
            ),
        ),
        Group(
            "Interventions",
            "all departures",
            (
                line("Departures taken over", lambda r, _: percent(r.triggered), acts=True),
                line(
                    f"Needless: without control not deeper than {compact(table.D_y)}\u00a0m",
                    lambda _, k: percent(figures.needless[k]),
                    acts=True,
                ),
                line("Departures with a failed solve", lambda r, _: f"{r.solver_failed:,}", acts=True),
                line("Departures that diverged", lambda r, _: f"{r.diverged:,}", acts=True),
                line("Departures that timed out or crashed", lambda r, _: f"{r.timed_out + r.crashed:,}", acts=True),
                line("Time of the law per command [µs]", lambda _, k: _law_time(figures.law_time[k]), acts=True),
            ),
        ),
    )
    return LimitsTable(tuple(_column(row) for row in rows), groups, baseline is not None)


_DTLE_LIMIT = "Euro NCAP LSS, EU 2021/646"
_DEGREES = math.degrees(1.0)


def _column(row: Row) -> Column:
    if is_baseline(row):
        return Column(row.title, Markup(""))
    threshold = f"y_s\u00a0=\u00a0{compact(row.design.y_s)}\u00a0m"
    gains = (f"{name}\u00a0=\u00a0{value}{chr(0xA0) + unit if unit else ''}" for name, value, unit in row.gains)
    return Column(row.title, symbols(", ".join([threshold, *gains, *([] if row.rank else ["not ranked"])])))


def _spread(figures: ReleaseFigures, quantity: str, k: int) -> str:
    values = [float(getattr(figures, f"{quantity}_{word}")[k]) for word in ("mean", "p95", "max")]
    return DASH if math.isnan(values[0]) else " / ".join(number(value, 1) for value in values)


def _degrees(value: float) -> str:
    return number(_DEGREES * value, 1)


def _overshoot(value: float, w_l: float) -> Markup:
    shown = Markup(number(value, 2))
    return Markup('<span class="bad">{}</span> <small>{}</small>').format(shown, _TOO_FAR) if value > w_l else shown


_TOO_FAR = "more than the lane\u2019s width"


def _law_time(value: float) -> str:
    """A linear law has no step of its own to be timed."""
    return number(value, 1) if value else "linear"


def against_limits(report: ReportInput, table: CaseTable, ranking: Ranking) -> Iterator[Markup]:
    """The winner against the limits, a sentence or two."""
    best, figures = table.best, ranking.release
    k = best.place
    if is_baseline(best):
        yield Markup("No control is {} here, so there is no intervention to judge.").format(table.best_name)
        return
    said = Markup(
        "<strong>{}</strong>, {}{}, keeps the front axle\u2019s edge within 0.3\u00a0m beyond the line "
        "in <strong>{}</strong> of the departures{}; at worst the edge is {} it."
    )
    none = next((row.place for row in table.rows if is_baseline(row)), None)
    before = "" if none is None else f" ({percent(figures.within_dtle[none])} without control)"
    misses = "" if best.rank else f" (it misses {', '.join(best.unmet)})"
    share, worst = percent(figures.within_dtle[k]), _beyond(figures.dtle_min[k])
    yield said.format(design_text(best), table.best_name, symbols(misses), share, before, worst)
    if best.triggered == 0:
        yield Markup("It never took over, so there is no intervention to judge.")
        return
    said = Markup(
        "<strong>{}</strong> of its interventions keep both comfort limits; the largest lateral acceleration is "
        "{}\u00a0m/s², the largest lateral jerk {}\u00a0m/s³. {}"
    )
    yield said.format(
        percent(figures.comfortable[k]),
        number(figures.a_y_peak_max[k], 1),
        number(figures.jerk_peak_max[k], 1),
        _way_back(report, figures, k),
    )
    if best.diverged:
        yield Markup(
            "In {} its path left \u00b120\u00a0m: as it stands, the design is not stable on this plant."
        ).format(plural(best.diverged, "departure"))


def _beyond(dtle: float) -> str:
    return f"{number(abs(dtle), 2)}\u00a0m {'beyond' if dtle < 0 else 'inside'}"


def _way_back(report: ReportInput, figures: ReleaseFigures, k: int) -> str:
    horizon = (
        f" within {compact(report.setup.settle)}\u00a0s after the departure\u2019s end" if report.setup.settle else ""
    )
    back = f"In {percent(figures.back_inside[k])} of them the edge comes back inside at some time{horizon}"
    if not figures.overshoot_share[k] > 0:
        return f"{back}, and the opposite edge never crosses the opposite line."
    share, most = percent(figures.overshoot_share[k]), number(figures.overshoot_max[k], 2)
    far = f", {_TOO_FAR}" if figures.overshoot_max[k] > report.setup.vehicle.w_l else ""
    return f"{back}; in {share} the opposite edge crosses the opposite line, by up to {most}\u00a0m{far}."
