"""The page of an extraction: departures of recordings, refused candidates with reasons, and what the data allow."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, DepartureParameters, curvature, lateral, speed
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import Extraction, RecordingReader, recording_reader
from ldctoolkit.recordings.extract import SCALE, SOURCE
from ldctoolkit.recordings.extraction_statistics import Account, Origin, combined_accounts, share_of_widths
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.recording import CombinedReader
from ldctoolkit.version import __version__

from ..storage.folder_files import write_text
from ..tables import Column, Row, Table, to_html
from ..text import PARAMETER_MEANINGS, compact, number, parameter_label, percent, plural, printable, shorten, symbols
from .charts import Axis, Chart, Series, Style, bars, legend
from .shell import Section, bullets, details, figure, make_page, pairs, paragraphs

if TYPE_CHECKING:
    from ldctoolkit.recordings.extraction_statistics import DrawnEvent

SIDE: Final = {"left": Style(0, "", "o"), "right": Style(1, "7 3", "s")}
FIT: Final = Style(-1, "", "|")

FEW: Final = 30  # least departures of a side for a fit
MODEL: Final = 150  # least departures of a side for a model that agrees with its recordings
RARE: Final = 1000  # least departures of a side for statements about rare departures

MOST_ROWS: Final = 60
MOST_PROBLEMS: Final = 300
MOST_FILES: Final = 200
MOST_WARNINGS: Final = 60
MOST_LABELS: Final = 6
MOST_BINS: Final = 40
MOST_DOTS: Final = 80
NOT_KNOWN: Final = "not known"

MEANINGS: Final = {
    "lane_change": "the lane changes in it",
    "invalid": "it holds or touches samples that cannot be used",
    "gap": "it holds a gap in time",
    "jump": "the offset or the lane's width jumps in it",
    "cut_by_end": "the recording starts or ends with the edge beyond the line",
    "too_short": "shorter than the shortest duration",
    "too_long": "longer than the longest duration",
    "too_few_samples": "fewer than three samples between its crossings",
    "slow": "too slow on average, or the vehicle stops in it",
    "engaged": "a system steers in it",
    "intended": "the turn signal is on towards the departed side",
    "implausible": "its path asks more of driver, vehicle or tyres than they can do, or the lane is no wider than the "
    "vehicle: noise",
}


def write_extraction_page(path: str | Path, extraction: Extraction) -> Path:
    """Write the page of an extraction as a self-contained HTML file."""
    write_text(Path(path), extraction_page(extraction))
    return Path(path)


def extraction_page(extraction: Extraction) -> str:
    """The page as an HTML document; the same extraction gives the same text."""
    accounts, n = extraction.accounts, extraction.departures.n
    rows, whole = by_source(accounts), total(accounts)
    left, right = _side_counts(extraction)
    return make_page(
        kind="Lane departure correction: departures of recordings",
        title=f"{plural(n, 'departure')} in {plural(extraction.recordings, 'recording')}",
        heading=f"{plural(n, 'departure')} in {plural(extraction.recordings, 'recording')}",
        facts=[
            f"{left:,} left, {right:,} right",
            f"{hours(whole.account.hours_valid if whole else 0.0)} h valid, {extraction.distance / 1000.0:,.0f} km",
            plural(len({account.origin.source for account in accounts}), "source"),
            f"format {extraction.provenance.reader}",
        ],
        sections=[
            _verdict_section(extraction, whole),
            _read_section(extraction),
            _amounts_section(extraction, whole, rows),
            _refusals_section(whole, rows),
            _parameters_section(extraction, rows),
            _widths_section(extraction, whole, rows),
            _events_section("deepest", "Deepest", extraction.drawn.deepest, lambda event: event.depth,
                            "Those with the largest d_y of each side"),
            _events_section("random", "At random", extraction.drawn.by_lot, lambda event: (event.lot, *event.depth),
                            "Every departure of a side had the same chance; the choice is the same in every run"),
        ],
        footer=(f"ldctoolkit {__version__}. What counts as a departure, and the eight parameters, follow Zhao, "
            "Wang and LeBlanc (2017)."),
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------ counts


@dataclasses.dataclass(frozen=True)
class SourceRow:
    """Counts of a group of recordings: a title, their sum, and the sources or label values in it."""

    title: str
    account: Account
    sources: tuple[str, ...] = ()

    @property
    def departures(self) -> tuple[int, int]:
        """Departures, left and right."""
        left, right = self.account.departures.tolist()
        return left, right

    @property
    def refused(self) -> tuple[int, int]:
        """Refused candidates, left and right."""
        left, right = self.account.refused.sum(axis=1).tolist()
        return left, right

    def refusals(self, side: int) -> dict[str, int]:
        """Count of each reason; 0 left, 1 right."""
        return dict(zip(REASONS, self.account.refused[side].tolist(), strict=True))


def total(accounts: Sequence[Account]) -> SourceRow | None:
    """The sum of all accounts; None where nothing was read."""
    joined = combined_accounts(dataclasses.replace(account, origin=Origin()) for account in accounts)
    return SourceRow("All", joined[0]) if joined else None


def by_source(accounts: Sequence[Account], most: int = MOST_ROWS) -> tuple[SourceRow, ...]:
    """A row for each source in the order of the accounts; beyond `most`, those with the fewest hours share a row."""
    return _rows([dataclasses.replace(account, origin=Origin(account.origin.source)) for account in accounts], most)


def by_label(accounts: Sequence[Account], name: str, most: int = MOST_ROWS) -> tuple[SourceRow, ...]:
    """A row for each value of a label, D2 before D10; recordings without it come last. `most` is as in `by_source`."""

    def value(account: Account) -> str:
        return next((label.value for label in account.origin.labels if label.name == name), "")

    valued = [dataclasses.replace(account, origin=Origin(value(account))) for account in accounts]
    return _rows(sorted(valued, key=lambda account: (not account.origin.source, _natural(account.origin.source))), most)


def _natural(text: str) -> list[tuple[int, int, str]]:
    """Sort key that compares runs of digits as numbers of any length."""
    parts = re.split("0*([0-9]+)", text)
    return [(1, 0, part) if k % 2 == 0 else (0, len(part), part) for k, part in enumerate(parts)]


def _rows(accounts: Sequence[Account], most: int) -> tuple[SourceRow, ...]:
    """One row an origin, in their order; beyond `most` rows the shortest are joined in the last."""
    joined = combined_accounts(accounts)
    longest = set(range(len(joined)))
    if len(joined) > most:
        longest = set(sorted(longest, key=lambda i: -joined[i].read_ns)[: most - 1])
    rows = [
        SourceRow(account.origin.source or NOT_KNOWN, account, (account.origin.source,))
        for i, account in enumerate(joined)
        if i in longest
    ]
    rest = [account for i, account in enumerate(joined) if i not in longest]
    if rest:
        (gathered,) = combined_accounts(dataclasses.replace(account, origin=Origin()) for account in rest)
        rows.append(SourceRow(f"{len(rest):,} more", gathered, tuple(account.origin.source for account in rest)))
    return tuple(rows)


def _side_counts(extraction: Extraction) -> tuple[int, int]:
    """Departures left and right."""
    left = int(np.sum(extraction.departures.side == LEFT))
    return left, extraction.departures.n - left


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


# ------------------------------------------------------------------------------------------------ sections


def extraction_verdict(left: int, right: int) -> str:
    """What the departures allow, judged by the side with fewer."""
    least, side = (left, "left") if left <= right else (right, "right")
    counted = f"{least:,} {side}"
    if not left + right:
        return "No departures were found: see what was refused, and the vehicle width."
    if least < FEW:
        return f"Too few departures for a model of both sides ({counted}; {FEW} a side at least)."
    if least < MODEL:
        return (
            f"Enough to compare designs on the recorded departures; too few for a model ({counted}; {MODEL} "
            "a side at least)."
        )
    if least < RARE:
        return (
            f"Good enough for a scenario model and mean S of designs; too few departures ({counted}) for "
            "rare, extreme ones."
        )
    return f"Good enough for a scenario model, and for the worst 5 % of departures ({counted})."


def _verdict_section(extraction: Extraction, whole: SourceRow | None) -> Section:
    body = Markup('<p class="verdict">{}</p>').format(symbols(extraction_verdict(*_side_counts(extraction))))
    if whole is not None:
        account = whole.account
        share = f" ({percent(account.hours_valid / account.hours_read, 0)})" if account.hours_read > 0 else ""
        candidates, refused = int(account.candidates.sum()), sum(whole.refused)
        text = (
            f"{hours(account.hours_valid)} h of {hours(account.hours_read)} h read are valid{share}; "
            f"{refused:,} of {plural(candidates, 'candidate')} were refused"
        )
        reasons = {reason: count + whole.refusals(1)[reason] for reason, count in whole.refusals(0).items()}
        most = max(reasons, key=lambda reason: reasons[reason])
        body += paragraphs(f"{text}, most often: {most.replace('_', ' ')}." if refused else f"{text}.")
    shown = list(extraction.warnings[:MOST_WARNINGS])
    more = len(extraction.warnings) - len(shown)
    body += bullets([*shown, f"and {plural(more, 'more warning')}"] if more else shown, "warnings") or paragraphs(
        "No warnings: units, signs, scale and curvature look plausible, and no recording repeats another."
    )
    problems = extraction.problems
    if problems:
        first = f", the first {MOST_PROBLEMS} of {len(problems):,}" if len(problems) > MOST_PROBLEMS else ""
        rows = [
            Row((shorten(problem.file, 300), shorten(problem.place, 300), shorten(problem.what, 1000)))
            for problem in problems[:MOST_PROBLEMS]
        ]
        columns = [Column("File", text=True), Column("Place", text=True), Column("What", text=True)]
        table = to_html(Table(f"What could not be used, or only in part{first}", columns, rows))
        body += table if len(rows) <= 10 else details(f"{plural(len(problems), 'problem')} with the files", table)
    else:
        body += paragraphs("No problems: every file was read whole.")
    return Section("verdict", "Verdict", body, printed=True)


def _read_section(extraction: Extraction) -> Section:
    sources = extraction.provenance.sources
    body = pairs(facts(extraction))
    if sources:
        columns = [Column("File", text=True), Column("Size"), Column("SHA-256", text=True)]
        rows = [Row([shorten(file.name, 300), size(file.bytes), file.sha256[:12]]) for file in sources[:MOST_FILES]]
        first = f", the first {MOST_FILES}" if len(sources) > MOST_FILES else ""
        title = f"{plural(len(sources), 'file')}{first}; twelve digits of each SHA-256"
        body += details("Files", to_html(Table(title, columns, rows)))
    return Section("read", "What was read", body)


def facts(extraction: Extraction) -> list[tuple[str, str]]:
    """Name and value of format, criteria and preparation."""
    origin = extraction.provenance
    criteria, preparation = origin.criteria, origin.preparation
    reader = _reader(origin.reader)
    valid = origin.samples - origin.invalid_samples
    width = f"{compact(criteria.vehicle_width)} m"
    if reader is not None:
        is_default = criteria.vehicle_width == reader.vehicle_width
        width += (
            f", the default of {reader.name}"
            if is_default
            else f", given by the user; {reader.name} takes {compact(reader.vehicle_width)} m by itself"
        )
    step = "as recorded"
    if preparation.step is not None:
        default = " (the reader\u2019s own)" if reader is not None and preparation.step == reader.step else ""
        step = f"{compact(preparation.step)} s{default}, by local medians of valid samples"
    gap = "2.5 median steps of the recording, at least 0.25 s"
    if criteria.max_gap is not None:
        gap = f"{compact(criteria.max_gap)} s"
    elif preparation.step is not None:
        gap = f"{compact(preparation.max_gap)} s between valid samples, bridged by resampling"
    return [
        ("Format", f"{origin.reader}{f' ({reader.title})' if reader else ''}"),
        ("Read", f"{plural(origin.recordings, 'recording')}, {plural(origin.samples, 'sample')}, {valid:,} of "
            "them valid"),
        ("Vehicle width", width),
        ("Time step", step),
        ("Nominal lane width", _nominal(extraction)),
        ("Curvature", curvature_text(extraction)),
        ("Duration", f"{compact(criteria.min_duration)} to {compact(criteria.max_duration)} s"),
        ("Mean speed", f"above {compact(criteria.min_speed)} m/s"),
        ("Longest step that is no gap", gap),
        ("Largest jump of the offset", f"{compact(criteria.max_jump)} m in 0.1 s"),
        ("Width of a lane", f"{compact(criteria.min_lane_width)} to {compact(criteria.max_lane_width)} m"),
        ("While a system steers", "counted" if criteria.keep_engaged else "left out"),
        ("Plausible up to", str(criteria.plausibility)),
    ]  # fmt: skip


def _reader(name: str) -> RecordingReader | CombinedReader | None:
    try:
        readers = tuple(map(recording_reader, name.split(" + ")))
    except LdcError:  # the defaults of a reader that is not installed are unknown
        return None
    return readers[0] if len(readers) == 1 else CombinedReader(readers)


def _nominal(extraction: Extraction) -> str:
    nominal = extraction.provenance.preparation.nominal_lane_width
    if nominal is None:
        return "none: lanes as recorded"
    text = f"{compact(nominal)} m: offset and width of each recording scaled to it"
    scales = next((column.values for column in extraction.departures.extra if column.name == SCALE), np.empty(0))
    if scales.size and scales.dtype.kind == "f":
        text += f", by factors of {scales.min():.3f} to {scales.max():.3f} where there are departures"
    return text


def curvature_text(extraction: Extraction) -> str:
    """The source of the curvature; one that records 0 everywhere counts as no source."""
    origin, departures = extraction.provenance, extraction.departures
    text = {
        "measured": "recorded by the source",
        "yaw_rate": "from yaw rate and speed",
        "none": "not recorded: taken as 0",
        "mixed": "recorded in some of the recordings, from yaw rate and speed or taken as 0 in others",
    }.get(origin.curvature, origin.curvature)
    if origin.curvature in ("measured", "mixed") and departures.n and not (departures.c_0.any() or departures.dc.any()):
        text = "0 in every departure: the source gives no curvature, roads are taken as straight"
    factor = origin.preparation.yaw_rate_factor
    return text if factor == 1.0 else f"{text}; yaw rate times {compact(factor)}"


def _amounts(rows: Sequence[SourceRow], head: str, whole: SourceRow | None = None) -> Markup:
    columns = [
        Column(head, text=True), Column("Recordings"), Column("Hours read", form=hours), Column("Valid", form=hours),
        Column("Left"), Column("Right"), Column("Per valid hour, left", form=rate), Column("right", form=rate),
        Column("Refused"),
    ]  # fmt: skip
    out = []
    for row in (*rows, *([whole] if whole else [])):
        account, valid = row.account, row.account.hours_valid
        rates = (count / valid if valid > 0 else math.nan for count in row.departures)
        amounts = [account.recordings, account.hours_read, valid, *row.departures, *rates, sum(row.refused)]
        out.append(Row([shorten(row.title, 200), *amounts], "winner" if row is whole else ""))
    return to_html(Table(f"By {head.lower()}", columns, out))


def _amounts_section(extraction: Extraction, whole: SourceRow | None, rows: Sequence[SourceRow]) -> Section:
    if whole is None:
        return Section("sides", "Hours and departures", paragraphs("Nothing was read from these recordings."))
    body = _amounts(rows, "Source", whole if len(rows) > 1 else None)
    names = tuple(dict.fromkeys(label.name for account in extraction.accounts for label in account.origin.labels))
    for name in names[:MOST_LABELS]:
        body += _amounts(by_label(extraction.accounts, name), printable(name).capitalize())
    if len(names) > MOST_LABELS:
        body += paragraphs(f"Not shown: {', '.join(map(printable, names[MOST_LABELS:]))}.")
    body += paragraphs(
        "Valid hours are those in which a departure could have been seen; departures per hour are per valid hour."
    )
    return Section("sides", "Hours and departures", body)


def _refusals_section(whole: SourceRow | None, rows: Sequence[SourceRow]) -> Section:
    reasons = [] if whole is None else [r for r in REASONS if whole.refusals(0)[r] or whole.refusals(1)[r]]
    if whole is None or not reasons:
        text = "No candidate was refused." if whole else "Nothing was read from these recordings."
        return Section("refusals", "Refused", paragraphs(text))
    candidates = int(whole.account.candidates.sum())
    columns = [
        Column("Reason", text=True), Column("The candidate", text=True), Column("Left"), Column("Right"),
        Column("Of all candidates", "%", ".1f"),
    ]  # fmt: skip
    counts = {reason: (whole.refusals(0)[reason], whole.refusals(1)[reason]) for reason in reasons}
    lines = [
        Row([reason.replace("_", " "), MEANINGS[reason], *pair, 100.0 * sum(pair) / candidates])
        for reason, pair in counts.items()
    ]
    title = f"{sum(whole.refused):,} of {plural(candidates, 'candidate')} refused, by reason"
    body = to_html(Table(title, columns, lines))
    body += paragraphs(
        "A candidate is a stretch with the vehicle\u2019s edge beyond a line. Each refused one has one reason, the "
        "first that holds in this order."
    )
    if len(rows) > 1:
        heads = [Column("Source", text=True), *(Column(reason.replace("_", " ")) for reason in reasons)]
        cells = [
            Row([shorten(row.title, 200), *(f"{row.refusals(0)[r]:,} / {row.refusals(1)[r]:,}" for r in reasons)])
            for row in rows
        ]
        body += details("By source", to_html(Table("Refused by source and reason: left / right", heads, cells)))
    return Section("refusals", "Refused", body)


def _parameters_section(extraction: Extraction, rows: Sequence[SourceRow]) -> Section:
    departures = extraction.departures
    if not departures.n:
        return Section("parameters", "Parameters", paragraphs("No departures were found."))
    charts, lines = [], []
    for name in PARAMETER_NAMES:
        values = np.asarray(getattr(departures, name), dtype=np.float64)
        # edges of bins over nearly all values
        finite = values[np.isfinite(values)]
        low, high = np.quantile(finite, (0.002, 0.998)) if finite.size >= 500 else (finite.min(), finite.max())
        if high <= low:
            low, high = low - 0.5, high + 0.5
        edges = np.linspace(low, high, int(np.clip(3 * np.cbrt(finite.size), 8, MOST_BINS)) + 1)
        shares, cells = [], list[float]()
        for side, which in (("left", LEFT), ("right", RIGHT)):
            side_values = values[departures.side == which]
            cells += np.quantile(side_values, (0.05, 0.5, 0.95)).tolist() if side_values.size else [math.nan] * 3
            if side_values.size:
                shares.append((side, 100.0 * np.histogram(side_values, edges)[0] / side_values.size, SIDE[side]))
        title = f"{name}, {PARAMETER_MEANINGS[name]}"
        charts.append(bars(f"parameter-{name}", title, edges, shares, parameter_label(name), "Share per bin [%]"))
        lines.append(Row([f"{parameter_label(name)}: {PARAMETER_MEANINGS[name]}", *cells]))
    left, right = _side_counts(extraction)
    key = legend(
        [(f"left, {plural(left, 'departure')}", SIDE["left"]), (f"right, {plural(right, 'departure')}", SIDE["right"])]
    )
    body = figure(
        charts,
        "Share of the departures of a side in each bin. Curvature is outward, positive where the lane bends "
        "towards the departed side.",
        key,
    )
    columns = [
        Column("Parameter", text=True),
        *(Column(f"{side} {q}", form=".3g") for side in ("Left", "Right") for q in ("5 %", "median", "95 %")),
    ]
    body += to_html(Table("Parameters in numbers", columns, lines))
    if len(rows) > 1:
        body += details("Medians by source", _medians(extraction, rows))
    return Section("parameters", "Parameters", body)


def _medians(extraction: Extraction, rows: Sequence[SourceRow]) -> Markup:
    departures = extraction.departures
    column = next((extra.values for extra in departures.extra if extra.name == SOURCE), None)
    source = np.full(departures.n, "", dtype=object) if column is None else column.astype(str)
    out = []
    for row in rows:
        mask = np.isin(source, row.sources)
        medians = [float(np.median(getattr(departures, n)[mask])) if mask.any() else math.nan for n in PARAMETER_NAMES]
        out.append(Row([shorten(row.title, 200), int(mask.sum()), *medians]))
    columns = [Column("Source", text=True), Column("Departures")]
    columns += [Column(parameter_label(name), form=".3g") for name in PARAMETER_NAMES]
    return to_html(Table("Medians of both sides", columns, out))


def _widths_section(extraction: Extraction, whole: SourceRow | None, rows: Sequence[SourceRow]) -> Section:
    if whole is None or not whole.account.widths.any():
        return Section("widths", "Lane width", paragraphs("No valid samples."))
    edges, share = share_of_widths(whole.account.widths)
    inside = np.flatnonzero((np.cumsum(share) > 0.002) & (np.cumsum(share[::-1])[::-1] > 0.002))
    first, last = max(int(inside[0]) - 1, 0), int(inside[-1]) + 2
    edges, share = edges[first : last + 1], share[first:last]
    chart = bars(
        "lane-width",
        "Lane width of all valid samples",
        edges,
        [("all", 100.0 * share, SIDE["left"])],
        "Lane width [m]",
        "Share per bin [%]",
    )
    scaled = (
        ", after scaling to the nominal width"
        if extraction.provenance.preparation.nominal_lane_width is not None
        else ""
    )
    body = figure(
        [chart], f"Share of the valid samples in bins of 0.1 m{scaled}; median {number(_median_width(whole), 2)} m."
    )
    if len(rows) > 1:
        out = [Row([shorten(row.title, 200), _median_width(row)]) for row in rows]
        columns = [Column("Source", text=True), Column("Median", "m", ".2f")]
        body += details("By source", to_html(Table("Median lane width", columns, out)))
    return Section("widths", "Lane width", body)


def _median_width(row: SourceRow) -> float:
    counts = row.account.widths
    if not counts.any():
        return math.nan
    edges, _ = share_of_widths(counts)
    return float(np.interp(0.5 * counts.sum(), np.concatenate([[0], np.cumsum(counts)]), edges))


# ------------------------------------------------------------------------------------------------ single departures


def _events_section(
    id: str, title: str, events: Sequence[DrawnEvent], order: Callable[[DrawnEvent], tuple[object, ...]], about: str
) -> Section:
    if not events:
        return Section(id, title, paragraphs("No departures were found."))
    body = legend([("samples, left", SIDE["left"]), ("samples, right", SIDE["right"]), ("fit by the parameters", FIT)])
    for side, which in (("left", LEFT), ("right", RIGHT)):
        shown = sorted((event for event in events if event.side == which), key=order)[:4]
        body += Markup("").join(_event(event, side) for event in shown)
    return Section(
        id,
        title,
        body
        + paragraphs(
            f"{about}: y, the edge\u2019s distance beyond the line, with the fitted parabola; speed v and "
            "outward curvature c with their lines."
        ),
    )


def _event(event: DrawnEvent, side: str) -> Markup:
    """Samples and fit of one departure."""
    sides = np.array([event.side])
    fit = DepartureParameters(sides, *(event.parameters[i : i + 1] for i in range(len(PARAMETER_NAMES))))
    finite = np.isfinite(event.t) & np.isfinite(event.y) & np.isfinite(event.v) & np.isfinite(event.c)
    rows = np.flatnonzero(finite)
    rows = rows[np.linspace(0, rows.size - 1, min(rows.size, MOST_DOTS)).round().astype(np.int64)]
    T = float(fit.T[0])
    t, fine = event.t[rows], np.linspace(0.0, T, 33)
    charts = [
        _signal(event, side, "y [m]", t, event.y[rows], fine, np.ravel(lateral(fit, fine))),
        _signal(event, side, "v [m/s]", t, event.v[rows], fine, np.ravel(speed(fit, fine))),
        _signal(event, side, "c [1/km]", t, 1000.0 * event.c[rows], fine, 1000.0 * np.ravel(curvature(fit, fine))),
    ]
    d_y = float(fit.d_y[0])
    source = f" of {shorten(event.source, 100)}" if event.source else ""
    caption = (
        f"{side.capitalize()}: d_y = {number(d_y, 2)} m, T = {number(T, 1)} s; "
        f"{shorten(event.recording, 200)}{source}, from {number(event.start_time, 1)} s"
    )
    return figure(charts, caption)


def _signal(
    event: DrawnEvent, side: str, label: str, t: FloatArray, values: FloatArray, at: FloatArray, fitted: FloatArray
) -> Chart:
    low, high = float(min(values.min(), fitted.min())), float(max(values.max(), fitted.max()))
    room = max(0.06 * (high - low), {"y [m]": 0.05, "v [m/s]": 0.5}.get(label, 0.25))
    y = Axis(label, low - room, high + room)
    return Chart(
        "event", f"Departure to the {side}, {shorten(event.recording, 100)}: {label}, samples and fit",
        Axis("Time since the crossing [s]", 0.0, float(at[-1]) or 1.0), y,
        [Series("samples", t, values, SIDE[side], kind="points"), Series("fit", at, fitted, FIT)], height=170,
    )  # fmt: skip
