"""The page of a fit: whether a scenario model describes its departures, and what it is good enough for."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.diagnostics import ModelDiagnostics, SideDiagnostics, diagnose_model
from ldctoolkit.diagnostics._marginals import strip_is_off
from ldctoolkit.diagnostics.diagnosis import N_MODEL
from ldctoolkit.scenario_model import ScenarioModel, SideModel, SideSummary
from ldctoolkit.scenario_model.fidelity import QUANTITIES, UNITS
from ldctoolkit.version import __version__

from ..storage.files import write_text
from ..storage.stored_model import model_notes
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import PARAMETER_MEANINGS, compact, number, parameter_label, percent, plural, symbols
from .charts import Axis, Chart, Dot, Series, Style, bars, dots, heat_map, legend
from .shell import Section, bullets, details, figure, make_page, pairs, paragraphs

Progress = Callable[[str, int, int], None]

SIDE: Final = {"left": Style(0, "", "o"), "right": Style(1, "7 3", "s")}
MODEL: Final = Style(-1, "", "|")

FEW: Final = 150  # departures of a side below which a fitted model can contradict its recordings
ENOUGH: Final = 1000  # departures of a side from which on rare ones are known, too
FEW_TO_DRAW: Final = 2000  # departures below which a smaller sample of the model is fine enough
CLEAR: Final = 0.05  # Kolmogorov distance from which on a misfit matters whatever the number of events


@dataclasses.dataclass(frozen=True)
class Side:
    """One side with all that the page shows of it."""

    key: str
    model: SideModel
    summary: SideSummary | None
    found: SideDiagnostics

    @property
    def K(self) -> int:
        """Components."""
        return len(self.found.components)

    @property
    def misfits(self) -> list[str]:
        """Parameters whose distribution is clearly not that of the events."""
        return [c.name for c in self.found.calibrations if c.distance > max(c.limit, CLEAR)]


def write_fit_page(
    target: str | Path,
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    drawn: bool = False,
    progress: Progress | None = None,
) -> None:
    """Check a model against the departures that it was fitted to, and write the page."""
    events = N_MODEL if departures.n > FEW_TO_DRAW else N_MODEL // 4
    found = diagnose_model(model, departures, seed=seed, weights=weights, n_model=events, progress=progress)
    write_text(Path(target), fit_page(model, found, seed=seed, drawn=drawn))


def fit_page(model: ScenarioModel, found: ModelDiagnostics, *, seed: int, drawn: bool = False) -> str:
    """The page as one HTML document; the same input gives the same text."""
    origin = model.provenance
    left = Side("left", model.left_side, origin.left, found.left)
    right = Side("right", model.right_side, origin.right, found.right)
    sides = (left, right)
    source = _source_line(model)
    return make_page(
        kind="Lane departure correction: scenario model",
        title=f"Scenario model {model.content_hash[:12]}: how well it fits",
        heading="How well the model fits",
        facts=[
            *(f"{side.key}: {plural(side.found.events, 'departure')}, K = {side.K}" for side in sides),
            f"model {model.content_hash[:12]}",
            *([source] if source else []),
        ],
        sections=[
            _verdict(model, sides, drawn=drawn),
            _fidelity(sides),
            _margins(sides),
            _joint(sides),
            _calibration(sides),
            _bounds(sides),
            _components(sides),
            _selection(sides),
            _settings(model, sides, seed),
        ],
        footer=f"ldctoolkit {__version__}. The bounded Gaussian mixture and the choice of K follow Zhao, Wang and "
        "LeBlanc (2017); its fit follows Lee and Scott (2012).",
    )


# ------------------------------------------------------------------------------------------------ the verdict


def side_verdict(side: Side) -> str:
    """What a side of the model is good enough for: first of all, whether designs do on it as on its recordings."""
    n, misfits = side.found.effective_events, side.misfits
    fidelity = None if side.summary is None else side.summary.fidelity
    name = f"{side.key.capitalize()}:" if fidelity is None else f"{side.key.capitalize()}: {fidelity.text}."
    if fidelity is not None and not fidelity.passed:
        return name
    if fidelity is None and n < FEW:
        return (
            f"{name} too few departures for a model ({n:,.0f}; {FEW} at least): rank designs on the recorded "
            "departures instead, or record more."
        )
    if misfits:
        return (
            f"{name} Misfit in {', '.join(misfits)}: good enough for designs that do not depend on it; see the margins."
        )
    if n < ENOUGH:
        return (
            f"{name} Good enough for comparing mean S of designs; too few departures ({n:,.0f}) for rare, extreme ones."
        )
    return f"{name} Good enough for comparing designs, in their mean S and in the worst 5 % of departures."


def _verdict(model: ScenarioModel, sides: tuple[Side, ...], *, drawn: bool) -> Section:
    warnings = fit_warnings(model, sides, drawn=drawn)
    body = Markup("").join(Markup('<p class="verdict">{}</p>').format(symbols(side_verdict(side))) for side in sides)
    body += bullets(warnings, "warnings") or paragraphs("No warnings: no check of this page found anything.")
    body += paragraphs(
        "Unless a warning says otherwise the model is checked against the departures that it was fitted to: a misfit "
        "is certain, a good fit is weaker evidence than fresh departures would give."
    )
    return Section("verdict", "Verdict", body, printed=True)


def fit_warnings(model: ScenarioModel, sides: tuple[Side, ...], *, drawn: bool = False) -> list[str]:
    """Warnings of the diagnosis and those that the model carries; those of both sides together, nothing twice."""
    origin = model.provenance
    found: dict[str, list[str]] = {}
    for side in sides:
        summary = side.summary
        if summary is not None and summary.events != side.found.events + sum(n for _, n in side.found.outside):
            others = "of them, drawn at random" if drawn else "others"
            text = (
                f"the model was fitted to {summary.events:,} departures and is checked here against "
                f"{side.found.events:,} {others}"
            )
            found.setdefault(text, []).append(side.key)
        for warning in side.found.warnings:
            found.setdefault(warning.removeprefix(f"{side.key}: "), []).append(side.key)
    lines = (
        ["the model is synthetic: it was fitted to invented, not to recorded departures"] if origin.synthetic else []
    )
    lines += [f"{' and '.join(keys)}: {text}" for text, keys in found.items()]
    # of components and of the fit's end the diagnosis has spoken
    covered = tuple(f"{side.key}: {start}" for side in sides for start in ("Component", "Not converged"))
    return list(dict.fromkeys((*lines, *(one for one in origin.warnings if not one.startswith(covered)))))


def _source_line(model: ScenarioModel) -> str:
    """Where the departures come from, in one line; empty where the model does not say."""
    source = model.provenance.source
    if source.get("description"):
        return str(source["description"])
    parts = []
    recordings, hours, files = (source.get(key) for key in ("recordings", "hours", "files"))
    if isinstance(recordings, int):
        parts.append(plural(recordings, "recording"))
    if isinstance(hours, int | float):
        parts.append(f"{hours:.3g} hours")
    if model.provenance.distance is not None:
        parts.append(f"{model.provenance.distance / 1000.0:,.0f} km")
    if isinstance(files, list | tuple) and files:
        parts.append(", ".join(map(str, files[:3])) + (f" and {len(files) - 3} more" if len(files) > 3 else ""))
    return f"from {'; '.join(parts)}" if parts else ""


# ------------------------------------------------------------------------------------------------ the evidence


def _fidelity(sides: tuple[Side, ...]) -> Section:
    """The answers of test designs on recorded and on generated departures."""
    scale = [100.0 if not unit else 1.0 for unit in UNITS]
    columns = [Column("Design", text=True)]
    for name, unit in zip(QUANTITIES, UNITS, strict=True):
        columns += [Column(name.capitalize(), unit.replace("^2", "\u00b2") or "%"), Column("Replay", text=True)]
    body = Markup()
    for side in sides:
        found = None if side.summary is None else side.summary.fidelity
        if found is None:
            body += paragraphs(f"{side.key.capitalize()}: the model was not checked when it was fitted.")
            continue
        rows = []
        for i, design in enumerate(found.designs):
            cells: list[Cell | Value] = [design]
            for j, factor in enumerate(scale):
                once, low, high, generated = (
                    number(factor * values[i][j], 1 if factor > 1.0 else 2)
                    for values in (found.replayed, found.low, found.high, found.generated)
                )
                cells += [Cell(generated, bad=not found.within[i, j]), f"{once} ({low} to {high})"]
            rows.append(Row(tuple(cells)))
        title = f"{side.key.capitalize()}: generated departures, and {found.departures:,} replayed ones"
        body += to_html(Table(title, columns, rows))
    note = (
        "Each test design is driven on the recorded departures and on generated ones. In brackets: 95 % bootstrap "
        "interval of the replay, for all test designs at once, and no narrower than what a designer would act on (3 "
        "points of a share, 5 % of a peak). Set off: outside. A model passes where none is."
    )
    return Section("fidelity", "The recordings' answer", body + paragraphs(note))


def _margins(sides: tuple[Side, ...]) -> Section:
    body = legend([("events, left", SIDE["left"]), ("events, right", SIDE["right"]), ("model", MODEL)])
    for side in sides:
        charts = []
        for one, calibration in zip(side.found.marginals, side.found.calibrations, strict=True):
            title = (
                f"{side.key}: {one.name}, {PARAMETER_MEANINGS.get(one.name, '')}; Kolmogorov distance "
                f"{percent(calibration.distance, 2)}"
            )
            charts.append(
                bars(
                    f"margin-{side.key}-{one.name}", title, one.edges, [("events", 100.0 * one.data, SIDE[side.key])],
                    parameter_label(one.name), "Share per bin [%]", outlines=[("model", 100.0 * one.model, MODEL)],
                )
            )  # fmt: skip
        body += Markup("<h3>{}</h3>").format(side.key.capitalize()) + figure(
            charts,
            "Share of events (bars) and of the model (line) in equal bins, without the outermost 0.3 % at open ends.",
        )
    return Section("margins", "Margins", body)


def _joint(sides: tuple[Side, ...]) -> Section:
    body = Markup()
    for side in sides:
        pair = side.found.joint
        if pair is None:
            continue
        charts = [_density(side, pair.first_edges, pair.second_edges, values, what)
                  for what, values in (("events", pair.data), ("model", pair.model))]  # fmt: skip
        body += figure(
            charts, f"{side.key.capitalize()}: events, and the model, on one scale of the square root of the density."
        )
    return Section("joint", "T and d_y", body or paragraphs("T or d_y does not vary."))


def _density(side: Side, x: FloatArray, y: FloatArray, values: FloatArray, what: str) -> Chart:
    cells = np.sqrt(values.T)
    cells = np.where(cells > 0, cells, np.nan)
    empty = [[""] * cells.shape[1] for _ in range(cells.shape[0])]
    every = [max(1, (edges.size - 1) // 5) for edges in (x, y)]
    ends = [
        [compact(float(f"{edge:.3g}")) if i % k == 0 else "" for i, edge in enumerate(edges[:-1].tolist())]
        for edges, k in zip((x, y), every, strict=True)
    ]
    chart = heat_map(f"joint-{side.key}-{what}", f"{side.key}: density of T and d_y, {what}", cells, empty,
                     (f"T [s], {what}", ends[0]), ("d_y [m]", ends[1]))  # fmt: skip
    return dataclasses.replace(chart)


def _calibration(sides: tuple[Side, ...]) -> Section:
    columns = [Column("Parameter", text=True)]
    for side in sides:
        columns += [Column(f"{side.key.capitalize()}: distance", "%"), Column("Limit", "%"), Column("Reached at")]
    rows, charts = [], []
    for name in PARAMETER_NAMES:
        cells: list[Cell | Value] = [f"{parameter_label(name)}: {PARAMETER_MEANINGS[name]}"]
        series = []
        for side in sides:
            one = next((c for c in side.found.calibrations if c.name == name), None)
            if one is None:
                cells += ["constant", "", ""]
                continue
            cells += [
                Cell(number(100 * one.distance, 2), bad=one.distance > one.limit),
                number(100 * one.limit, 2),
                compact(float(f"{one.position:.3g}")),
            ]
            series.append(Series(side.key, one.u, 100.0 * one.difference, SIDE[side.key]))
        rows.append(Row(tuple(cells)))
        if series:
            y = Axis.around("Difference [%]", *(one.y for one in series), [0.0])
            charts.append(
                Chart(
                    f"calibration-{name}",
                    f"Calibration of {name}",
                    Axis(f"u of {name}", 0.0, 1.0),
                    y,
                    series,
                    level=0.0,
                    height=190,
                )
            )
    body = to_html(
        Table("Kolmogorov distances in per cent of events; highlighted: beyond sampling error", columns, rows)
    )
    body += paragraphs(
        "With very many events a distance may be beyond its limit and still too small to matter: below 5 % it is not a "
        "reason to refuse the model."
    )
    body += details("Curves", legend([("left", SIDE["left"]), ("right", SIDE["right"])]) + figure(
        charts, "Probability integral transform u = F(x): share of events below u, minus u. Above zero: the "
            "model lies too high.",
    ))  # fmt: skip
    return Section("calibration", "Calibration", body)


def _bounds(sides: tuple[Side, ...]) -> Section:
    rows = [
        [Dot(f"{side.key}: {s.name} {s.end}", 100 * s.error, 100 * (s.error - 1.96 * s.standard_error),
             100 * (s.error + 1.96 * s.standard_error), SIDE[side.key], open=not strip_is_off(s),
             tip=f"model {percent(s.model, 2)}, events {percent(s.data, 2)}")]
        for side in sides
        for s in side.found.strips
    ]  # fmt: skip
    if not rows:
        return Section("bounds", "Bounds", paragraphs("No events come near a finite bound."))
    ends = [value for (one,) in rows for value in (one.low, one.high)]
    chart = dots(
        "bounds",
        "Error of the mass next to the bounds",
        rows,
        Axis.around("Error of the mass [%]", ends, [0.0]),
        at=0.0,
    )
    body = figure(
        [chart],
        "Error of the model\u2019s share in the strip between a bound and the outermost 5 % of the events, with 1.96 "
        "standard errors. Filled: clearly wrong, by more than 20 % and four standard errors.",
    )
    far = [f"{side.key} {name} {end}" for side in sides for name, end in side.found.far_bounds]
    return Section("bounds", "Bounds", body + paragraphs(f"No events come near: {', '.join(far)}." if far else ""))


def _components(sides: tuple[Side, ...]) -> Section:
    columns = [
        Column("Side", text=True), Column("Component"), Column("Weight", "%"), Column("Effective events"),
        Column("P in the box"), Column("Mean outside by", "standard deviations"), Column("Condition number"),
    ]  # fmt: skip
    rows = []
    for side in sides:
        if side.summary is not None and side.summary.kind == "smoothed":
            continue
        for k, c in sorted(enumerate(side.found.components), key=lambda pair: -pair[1].weight):
            outside = f"{number(c.outside, 2)} ({c.outside_name})" if c.outside > 0 else "inside"
            cells = (
                side.key,
                str(k),
                number(100 * c.weight, 1),
                f"{c.events:,.0f}",
                f"{c.probability:.3g}",
                outside,
                f"{c.condition:.3g}",
            )
            rows.append(Row(cells))
    body = to_html(Table("Components, the heaviest first", columns, rows)) if rows else Markup()
    smooth = [side.key for side in sides if side.summary is not None and side.summary.kind == "smoothed"]
    if smooth:
        body += paragraphs(f"Smoothed departures, a component each: {' and '.join(smooth)}.")
    return Section("components", "Components", body)


def _selection(sides: tuple[Side, ...]) -> Section:
    body = Markup()
    for side in sides:
        summary = side.summary
        if summary is None or not summary.bic:
            body += paragraphs(f"{side.key.capitalize()}: the model does not say how its K = {side.K} was chosen.")
            continue
        if summary.reason:
            body += paragraphs(f"{side.key.capitalize()}: {summary.reason}.")
        least = min(summary.bic)
        columns = [Column("K"), Column("BIC"), Column("Above the least"), Column("Log-likelihood", "nats an event"),
                   *([Column("AIC")] if summary.aic else [])]  # fmt: skip
        rows = [
            Row(
                (
                    str(K),
                    number(summary.bic[i], 1),
                    number(summary.bic[i] - least, 1),
                    number(summary.log_likelihood[i], 4),
                    *(number(value, 1) for value in summary.aic[i : i + 1]),
                ),
                "winner" if K == side.K else "",
            )
            for i, K in enumerate(summary.n_components)
        ]
        body += to_html(Table(f"{side.key.capitalize()}: choice of K; the chosen one is set in bold", columns, rows))
    return Section("selection", "Choice of K", body)


def _settings(model: ScenarioModel, sides: tuple[Side, ...], seed: int) -> Section:
    origin = model.provenance
    facts = [
        ("Model content", model.content_hash),
        ("Fitted with", origin.software),
        ("Created", origin.created),
        ("Seed of the fit", str(origin.seed)),
        *((f"Bounds, {side.key}", _bounds_text(side)) for side in sides),
        *((f"Log-likelihood an event, {side.key}", f"{number(side.found.log_likelihood, 4)} nats") for side in sides),
        ("Seed of the checks", str(seed)),
        ("Model sample", f"{sides[0].found.n_model:,} events a side"),
    ]
    return Section("settings", "Settings", bullets(model_notes(model)) + pairs([(a, b) for a, b in facts if b]))


def _bounds_text(side: Side) -> str:
    """Bounds of each parameter and the constants of a side."""
    parts = []
    for name, low, high in zip(side.model.names, *(ends.tolist() for ends in side.model.bounds()), strict=True):
        a, b = (compact(end) if np.isfinite(end) else "" for end in (low, high))
        parts.append(f"{name} {f'{a} to {b}' if a and b else f'above {a}' if a else f'below {b}' if b else 'open'}")
    parts += [f"{name} = {compact(value)} (constant)" for name, value in side.model.constants]
    return ", ".join(parts)
