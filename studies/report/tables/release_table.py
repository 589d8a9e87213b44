"""What a release asks for beside S, as a table of metrics and a few sentences on the best design."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterator

from markupsafe import Markup

from ldctoolkit.metrics import A_Y_LIMIT, DTLE_LIMIT, JERK_LIMIT, JERK_WINDOW
from ldctoolkit.simulation import Takeover
from studies.ranking.figures import figure_values
from studies.ranking.ranking import Ranking
from studies.ranking.release import ReleaseFigures
from studies.report.inputs import ReportInput
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row, is_baseline
from studies.report.words.metric_text import metric_text
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
    """One metric of every design, and the limit that it is held against."""

    name: Markup
    limit: str
    cells: tuple[str | Markup, ...]


@dataclasses.dataclass(frozen=True)
class Group:
    """Metrics that are taken over the same departures."""

    title: str
    over: str
    lines: tuple[Line, ...]


@dataclasses.dataclass(frozen=True)
class LimitsTable:
    """Metrics down, designs across."""

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
    settle = report.setup.settle

    def line(title: str, show: Callable[[Row], str | Markup], limit: str = "", *, acts: bool = True) -> Line:
        """`acts`: what is shown is of the interventions, of which the baseline has none."""
        return Line(Markup(title), limit, tuple(DASH if acts and is_baseline(row) else show(row) for row in rows))

    def of(name: str, digits: int) -> Callable[[Row], str]:
        return lambda row: metric_text(name, figure_values(name, ranking)[row.place], digits)

    def spread(quantity: str) -> Callable[[Row], str]:
        def text(row: Row) -> str:
            parts = [of(f"{quantity}_{word}", 1)(row) for word in ("mean", "p95", "max")]
            return DASH if DASH in parts else " / ".join(parts)

        return text

    def opposite_crossing(row: Row) -> str | Markup:
        text = of("opposite_crossing_max", 2)(row)
        far = ranking.release.opposite_crossing_max[row.place] > report.setup.vehicle.w_l
        return Markup('<span class="bad">{}</span> <small>{}</small>').format(text, _TOO_FAR) if far else text

    def law_time(row: Row) -> str:
        """A linear law has no step of its own to be timed."""
        seconds = report.results.cases[0].law_time[row.index]
        return number(1e6 * seconds, 1) if seconds else "linear"

    @functools.cache
    def recorded(y_s: float) -> str:
        over = Takeover.build(report.results.scenarios, report.setup, y_s=y_s)
        a_y, jerk = over.driven.peaks(over.start, report.setup.dt, JERK_WINDOW)
        return f"{percent((a_y > A_Y_LIMIT).mean())} / {percent((jerk > JERK_LIMIT).mean())}" if over.m else DASH

    D_y = compact(table.D_y)
    groups = (
        Group(
            "In the lane",
            "all departures, to the departure\u2019s end",
            (
                line("DTLE stays above \u22120.3\u00a0m", of("within_dtle", 1), _DTLE_LIMIT, acts=False),
                line("DTLE, 5\u00a0% quantile [m]", of("dtle_p5", 2), acts=False),
                line("DTLE at its worst [m]", of("dtle_min", 2), acts=False),
                line(f"Deeper than D<sub>y</sub> = {D_y}\u00a0m", of("deeper", 1), acts=False),
            ),
        ),
        Group(
            "Back to the lane",
            "interventions" + (f", to {compact(settle)}\u00a0s after the departure\u2019s end" if settle else ""),
            (
                line("Back inside at some time", of("back_inside", 1)),
                line("Back inside after, median [s]", of("t_back_median", 2)),
                line("Opposite line crossed", of("opposite_crossed_share", 1)),
                line("Opposite line crossed by at most [m]", opposite_crossing),
            ),
        ),
        Group(
            "Comfort",
            "interventions; mean / 95\u00a0% quantile / largest",
            (
                line("Both limits kept", of("comfortable", 1), "ISO 11270"),
                line("Added lateral acceleration [m/s²]", spread("a_y_added_peak"), f"limit {compact(A_Y_LIMIT)}"),
                line("Added lateral jerk [m/s³]", spread("jerk_added_peak"), f"limit {compact(JERK_LIMIT)}"),
                line("Peak lateral acceleration [m/s²]", spread("a_y_peak")),
                line("Peak lateral jerk [m/s³]", spread("jerk_peak")),
                line("Recorded path alone beyond these limits", lambda row: recorded(row.design.y_s)),
            ),
        ),
        Group(
            "Steering",
            "interventions",
            (
                line("Largest angle [°]", of("delta_peak_max", 1)),
                line("Largest rate [°/s]", of("delta_rate_peak_max", 1)),
                line("Mean effort ∫δ² dt [°²·s]", of("effort_mean", 2)),
            ),
        ),
        Group(
            "Interventions",
            "all departures",
            (
                line("Departures taken over", of("triggered", 1)),
                line(f"Needless: without control not deeper than {compact(-DTLE_LIMIT)}\u00a0m", of("needless", 1)),
                line("Departures with a failed solve", lambda row: f"{row.solver_failed:,}"),
                line("Departures that diverged", lambda row: f"{row.diverged:,}"),
                line("Departures that timed out or crashed", lambda row: f"{row.timed_out + row.crashed:,}"),
                line("Takeovers beyond delta_max", lambda row: f"{row.beyond_delta_max:,}"),
                line("Time of the law per command [µs]", law_time),
            ),
        ),
    )
    return LimitsTable(tuple(_column(row) for row in rows), groups, baseline is not None)


_DTLE_LIMIT = "Euro NCAP LSS, EU 2021/646"
_TOO_FAR = "more than the lane\u2019s width"


def _column(row: Row) -> Column:
    if is_baseline(row):
        return Column(row.title, Markup(""))
    threshold = f"y_s\u00a0=\u00a0{compact(row.design.y_s)}\u00a0m"
    gains = (f"{name}\u00a0=\u00a0{value}{chr(0xA0) + unit if unit else ''}" for name, value, unit in row.gains)
    return Column(row.title, symbols(", ".join([threshold, *gains, *([] if row.rank else ["not ranked"])])))


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
        "<strong>{}</strong> of its interventions keep both comfort limits; they add at most "
        "{}\u00a0m/s² of lateral acceleration and {}\u00a0m/s³ of jerk to the recorded path. {}"
    )
    yield said.format(
        percent(figures.comfortable[k]),
        number(figures.a_y_added_peak_max[k], 1),
        number(figures.jerk_added_peak_max[k], 1),
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
    if not figures.opposite_crossed_share[k] > 0:
        return f"{back}, and the opposite edge never crosses the opposite line."
    share, most = percent(figures.opposite_crossed_share[k]), number(figures.opposite_crossing_max[k], 2)
    far = f", {_TOO_FAR}" if figures.opposite_crossing_max[k] > report.setup.vehicle.w_l else ""
    return f"{back}; in {share} the opposite edge crosses the opposite line, by up to {most}\u00a0m{far}."
