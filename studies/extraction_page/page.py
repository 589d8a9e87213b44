"""The page: counts, histograms and drawings of an extraction in one file without a script."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup

from ldctoolkit.departures import LEFT
from ldctoolkit.recordings import Extraction
from ldctoolkit.recordings.drawn import KEPT
from ldctoolkit.recordings.events import REASONS
from ldctoolkit.version import __version__
from studies.extraction_page import counts, event_plots, panels, reading
from studies.extraction_page.counts import SIDES, Row, reason_title
from studies.report.rendering import asset, render
from studies.report.section import Tile
from studies.report.words.text import number, percent, plural, printable, shorten


def hours(value: float) -> str:
    """Hours with two decimals where they are few."""
    return number(value, 2) if value < 10.0 else number(value, 1) if value < 100.0 else f"{value:,.0f}"


def rate(value: float) -> str:
    """Events per hour; a dash without any hours."""
    if not math.isfinite(value):
        return number(value)
    return number(value, 0 if value >= 100.0 else 1 if value >= 10.0 else 2 if value >= 0.1 or value == 0.0 else 3)


def size(count: int) -> str:
    """Bytes in a unit that gives a short number, powers of ten."""
    value, units = float(count), iter(("kB", "MB", "GB", "TB"))
    unit = "B"
    while value >= 999.5 and unit != "TB":
        value, unit = value / 1000.0, next(units)
    return f"{value:.0f} {unit}" if unit == "B" or value >= 99.95 else f"{value:.1f} {unit}"


def side_counts(extraction: Extraction) -> tuple[int, int]:
    """Departures left and right."""
    left = int(np.sum(extraction.departures.side == LEFT))
    return left, extraction.departures.n - left


def summary(extraction: Extraction, whole: Row | None, sources: int) -> list[str]:
    """Parts of the line under the heading."""
    left, right = side_counts(extraction)
    return [
        f"{plural(left + right, 'departure')}: {left:,} left, {right:,} right",
        f"{plural(extraction.recordings, 'recording')} of {plural(sources, 'source')}",
        f"{hours(whole.account.hours_valid if whole else 0.0)} h valid",
        f"format {extraction.provenance.reader}",
    ]


def tiles(extraction: Extraction, whole: Row | None) -> list[Tile]:
    """Departures, how often, hours, refusals, faults."""
    left, right = side_counts(extraction)
    out = [Tile(f"{left + right:,}", "", "departures", f"{left:,} left, {right:,} right")]
    if whole is not None:
        rates = whole.rates
        said = ", ".join(f"{rate(one)} {side}" for one, side in zip(rates, SIDES, strict=True))
        out.append(Tile(rate(sum(rates)), "1/h", "departures in a valid hour", said))
        account = whole.account
        share = f"{percent(whole.valid_share, 0)} of {hours(account.hours_read)} h read"
        out.append(Tile(hours(account.hours_valid), "h", "valid", share))
        out.append(_refused(whole))
    faults = len(extraction.problems)
    said = plural(len(extraction.warnings), "warning")
    out.append(Tile(f"{faults:,}", "", "problem with the files" if faults == 1 else "problems with the files", said))
    return out


def _refused(whole: Row) -> Tile:
    refused, candidates = sum(whole.refused), int(whole.account.candidates.sum())
    reasons = {reason: count + whole.refusals(1)[reason] for reason, count in whole.refusals(0).items()}
    most = max(reasons, key=lambda reason: reasons[reason])
    share = percent(refused / candidates, 0) if candidates else ""
    detail = f"{share}; most often: {reason_title(most)}" if refused else f"of {plural(candidates, 'candidate')}"
    return Tile(f"{refused:,}", "", "candidates refused", detail)


_PACKAGE = "studies.extraction_page"

SECTIONS = (
    ("warnings", "Warnings"),
    ("read", "What was read"),
    ("sides", "Hours and departures"),
    ("refusals", "Refused"),
    ("groups", "Groups"),
    ("parameters", "Parameters"),
    ("widths", "Lane width"),
    ("deepest", "Deepest"),
    ("random", "By lot"),
)
"""Identifiers of the sections, which stay the same from version to version, and their titles."""

MOST_PROBLEMS = 300
MOST_FILES = 200
MOST_WARNINGS = 60
MOST_LABELS = 6


def make_page(extraction: Extraction) -> str:
    """The page as one HTML document; the same extraction gives the same text.

    Parameters
    ----------
    extraction : Extraction

    Returns
    -------
    str
    """
    accounts, departures, origin = extraction.accounts, extraction.departures, extraction.provenance
    whole = counts.total(accounts)
    rows = counts.by_source(accounts)
    sources = len({one.origin.source for one in accounts})
    several = departures.n > 0 and len(rows) > 1
    heads, small = panels.small_table(departures, reading.source_column(extraction), rows) if several else ([], [])
    widths = panels.width_panels(whole, rows) if whole is not None else []
    names = counts.label_names(accounts)
    return str(
        render(
            "extraction.html",
            _PACKAGE,
            style=Markup("\n").join((asset("report.css"), asset("extraction.css", _PACKAGE))),
            version=__version__,
            title=f"{plural(departures.n, 'departure')} in {plural(extraction.recordings, 'recording')}",
            sections=SECTIONS,
            summary=summary(extraction, whole, sources),
            warnings=_warnings(extraction),
            tiles=tiles(extraction, whole),
            problems=extraction.problems[:MOST_PROBLEMS],
            problem_count=len(extraction.problems),
            facts=reading.facts(extraction),
            files=origin.sources[:MOST_FILES],
            file_count=len(origin.sources),
            whole=whole,
            rows=rows,
            reasons=_reasons(whole),
            reason_title=counts.reason_title,
            meanings=counts.MEANINGS,
            groups=[(printable(name), counts.by_label(accounts, name)) for name in names[:MOST_LABELS]],
            labels_left_out=[printable(name) for name in names[MOST_LABELS:]],
            counts=side_counts(extraction),
            parameters=panels.parameter_panels(departures) if departures.n else [],
            quantiles=panels.quantile_rows(departures) if departures.n else [],
            small_heads=heads,
            small=small,
            widths=widths,
            widths_elsewhere=_widths_elsewhere(rows) if len(widths) == 1 and small else "",
            nominal=origin.preparation.nominal_lane_width is not None,
            hours=hours,
            rate=rate,
            size=size,
            shorten=shorten,
            **_drawn(extraction, rows),
        )
    )


def _warnings(extraction: Extraction) -> list[str]:
    shown = list(extraction.warnings[:MOST_WARNINGS])
    more = len(extraction.warnings) - len(shown)
    return [*shown, f"and {plural(more, 'more warning')}"] if more else shown


def _reasons(whole: Row | None) -> list[str]:
    """Reasons that hold for any candidate, in their order."""
    if whole is None:
        return []
    return [reason for reason in REASONS if whole.refusals(0)[reason] or whole.refusals(1)[reason]]


def _widths_elsewhere(rows: tuple[Row, ...]) -> str:
    """Where the lane widths of many sources are."""
    named = sum(len(row.sources) == 1 for row in rows)
    gathered = sum(len(row.sources) for row in rows) - named
    together = f", and those of {gathered:,} more together," if gathered else ""
    return f"Those of {plural(named, 'source')}{together} are in the table above."


def _drawn(extraction: Extraction, rows: tuple[Row, ...]) -> dict[str, object]:
    """Departures with their signals: of all sources, and source by source where there are several."""
    drawn = extraction.drawn
    names = [row.sources[0] for row in rows if len(row.sources) == 1]
    sizes = [event.t.size for event in (*drawn.deepest, *drawn.by_lot)]
    return {
        "deepest": event_plots.deepest_of_all(drawn.deepest),
        "by_lot": event_plots.by_lot_of_all(drawn.by_lot),
        "by_source": event_plots.by_source(drawn.deepest, drawn.by_lot, names) if len(rows) > 1 else (),
        "kept": KEPT,
        "most_of_source": event_plots.most_of_source(len(names)),
        "sources_not_drawn": sum(len(row.sources) for row in rows) - len(names),
        "thinned": any(size > event_plots.MOST_DOTS for size in sizes),
        "thinned_of_source": any(size > event_plots.MOST_DOTS_OF_SOURCE for size in sizes),
    }
