"""The page of a fit: whether a scenario model describes its departures, and what it is good enough for."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.diagnostics import N_MODEL, Calibration, ModelDiagnostics, SideDiagnostics, diagnose_model
from ldctoolkit.scenario_model import ScenarioModel, SideModel, SideSummary
from ldctoolkit.scenario_model.fidelity import QUANTITIES, UNITS, SideFidelity
from ldctoolkit.version import __version__

from ..storage.folder_files import write_text
from ..storage.scenario_source import model_notes
from ..tables import Cell, Column, Row, Table, Value, to_html
from ..text import PARAMETER_MEANINGS, compact, number, parameter_label, plural, symbols
from .charts import Axis, Chart, Dot, Series, Style, bars, dots, heat_map, legend
from .shell import Section, bullets, details, figure, make_page, pairs, paragraphs

Progress = Callable[[str, int, int], None]

SIDE: Final = {"left": Style(0, "", "o"), "right": Style(1, "7 3", "s")}
MODEL: Final = Style(-1, "", "|")
OUTSIDE: Final = Style(-1, "", "x")

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
    diagnostics: SideDiagnostics

    @property
    def title(self) -> str:
        """The key, capitalised."""
        return self.key.capitalize()

    @property
    def K(self) -> int:
        """Components."""
        return int(self.model.mixture.weights_.size)

    @property
    def generated_from(self) -> str:
        """K, or that departures are smoothed."""
        return f"K = {self.K}" if self.summary is None or self.summary.kind == "mixture" else "smoothed"

    @property
    def misfits(self) -> list[str]:
        """Parameters whose distribution is clearly not that of the events."""
        return [c.name for c in self.diagnostics.calibrations if c.distance > max(c.limit, CLEAR)]


def write_fit_page(
    target: str | Path,
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    progress: Progress | None = None,
) -> None:
    """Check a model against the departures that it was fitted to, and write the page."""
    n = N_MODEL if departures.n > FEW_TO_DRAW else N_MODEL // 4
    diagnostics = diagnose_model(model, departures, seed=seed, weights=weights, n_model=n, progress=progress)
    write_text(Path(target), fit_page(model, diagnostics, seed=seed))


def fit_page(model: ScenarioModel, diagnostics: ModelDiagnostics, *, seed: int) -> str:
    """The page as one HTML document; the same input gives the same text."""
    origin = model.provenance
    left = Side("left", model.left_side, origin.left, diagnostics.left)
    right = Side("right", model.right_side, origin.right, diagnostics.right)
    sides = (left, right)
    source = _source_line(model)
    return make_page(
        kind="Lane departure correction: scenario model",
        title=f"Scenario model {model.content_hash[:12]}: how well it fits",
        heading="How well the model fits",
        facts=[
            *(f"{side.key}: {plural(side.diagnostics.events, 'departure')}, {side.generated_from}" for side in sides),
            f"model {model.content_hash[:12]}",
            *([source] if source else []),
        ],
        sections=[
            _verdict_section(model, sides),
            _fidelity(sides),
            _margins_section(sides),
            _joint_section(sides),
            _selection_section(sides),
            _settings_section(model, sides, seed),
        ],
        footer=f"ldctoolkit {__version__}. The bounded Gaussian mixture and the choice of K follow Zhao, Wang and "
        "LeBlanc (2017); its fit follows Lee and Scott (2012).",
    )


# ------------------------------------------------------------------------------------------------ the verdict


def side_verdict(side: Side) -> str:
    """What a side of the model is good enough for: first of all, whether designs do on it as on its recordings."""
    n, misfits = side.diagnostics.effective_events, side.misfits
    fidelity = None if side.summary is None else side.summary.fidelity
    name = f"{side.title}:" if fidelity is None else f"{side.title}: {fidelity.text}."
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


def _verdict_section(model: ScenarioModel, sides: tuple[Side, ...]) -> Section:
    body = Markup("").join(Markup('<p class="verdict">{}</p>').format(symbols(side_verdict(side))) for side in sides)
    body += bullets(fit_warnings(model, sides), "warnings") or paragraphs("No warnings: all checks passed.")
    body += paragraphs(
        "Unless a warning says otherwise the model is checked against the departures that it was fitted to: a misfit "
        "is certain, a good fit is weaker evidence than fresh departures would give."
    )
    return Section("verdict", "Verdict", body, printed=True)


def fit_warnings(model: ScenarioModel, sides: tuple[Side, ...]) -> list[str]:
    """Warnings of the diagnosis and those that the model carries; a warning of both sides is listed once."""
    origin = model.provenance
    sides_of: dict[str, list[str]] = {}
    for side in sides:
        summary, diagnostics = side.summary, side.diagnostics
        if summary is not None and summary.events != diagnostics.events + sum(n for _, n in diagnostics.outside):
            text = (
                f"the model was fitted to {summary.events:,} departures and is checked here against "
                f"{diagnostics.events:,} others"
            )
            sides_of.setdefault(text, []).append(side.key)
        for warning in diagnostics.warnings:
            sides_of.setdefault(warning, []).append(side.key)
    lines = (
        ["the model is synthetic: it was fitted to invented, not to recorded departures"] if origin.synthetic else []
    )
    lines += [f"{' and '.join(keys)}: {text}" for text, keys in sides_of.items()]
    covered = tuple(f"{side.key}: Not converged" for side in sides)  # by the diagnosis
    return list(dict.fromkeys((*lines, *(text for text in origin.warnings if not text.startswith(covered)))))


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
    body, tables = Markup(), Markup()
    columns = [Column("Design", text=True)]
    for name, unit in zip(QUANTITIES, UNITS, strict=True):
        columns += [Column(name.capitalize(), unit.replace("^2", "\u00b2") or "%"), Column("Replay", text=True)]
    for side in sides:
        fidelity = None if side.summary is None else side.summary.fidelity
        if fidelity is None:
            body += paragraphs(f"{side.title}: the model was not checked when it was fitted.")
            continue
        rows: list[list[Cell | Value]] = [[design] for design in fidelity.designs]
        charts = [_answers(side.key, fidelity, j, rows) for j in range(len(QUANTITIES))]
        styles = [(f"replayed, {side.key}", SIDE[side.key]), ("model", MODEL), ("model, outside", OUTSIDE)]
        key = legend(styles if not fidelity.passed else styles[:2], points=True)
        title = f"{side.title}: generated departures, and {fidelity.departures:,} replayed ones"
        body += Markup("<h3>{}</h3>").format(side.title) + figure(charts, f"{title}. A row: design and y_s.", key)
        tables += to_html(Table(title, columns, [Row(tuple(cells)) for cells in rows]))
        if fidelity.unseen:
            body += paragraphs(f"{side.title}: the intervals cannot show {fidelity.unseen}.")
    body += _held_out(sides)
    note = (
        "Each test design is driven on the recorded departures and on generated ones. Lines (brackets in the table): "
        "95 % bootstrap interval of the replay, for all test designs at once, and no narrower than what a designer "
        "would act on (3 points of a share, 5 % of a peak). A cross (highlighted in the table): outside. A model "
        "passes where no answer is."
    )
    body += paragraphs(note) + (details("The same as a table", tables) if tables else "")
    return Section("fidelity", "The recordings' answer", body)


def _answers(key: str, fidelity: SideFidelity, j: int, rows: Sequence[list[Cell | Value]]) -> Chart:
    """One quantity of all test designs as a chart, and as two more cells of each row of the table."""
    factor, digits = (1.0, 2) if UNITS[j] else (100.0, 1)
    columns = fidelity.replayed, fidelity.low, fidelity.high, fidelity.generated
    numbers, drawn = factor * np.array(columns)[:, :, j], []
    for design, cells, within, values in zip(fidelity.designs, rows, fidelity.within[:, j], numbers.T, strict=True):
        at, low, high, generated = values.tolist()
        replayed = "{} ({} to {})".format(*(number(value, digits) for value in (at, low, high)))
        cells += [Cell(number(generated, digits), bad=not within), replayed]
        tip, model = f"{design}: model {number(generated, digits)}, replayed {replayed}", MODEL if within else OUTSIDE
        label = design.replace("y_s = ", "")
        drawn.append([Dot(label, at, low, high, SIDE[key], open=True, tip=tip, beside=(generated, model))])
    name, unit = QUANTITIES[j], UNITS[j].replace("^2", "\u00b2") or "%"
    axis = Axis.around(f"{name.capitalize()} [{unit}]", numbers)
    return dots(f"answer-{key}-{j}", f"{key}: {name} of the test designs, replayed and generated", drawn, axis)


def _held_out(sides: tuple[Side, ...]) -> Markup:
    """Models of half of the departures beside the other half: how many answers agree, and the worst reduction."""
    rows = []
    for side in sides:
        for half in side.summary.held_out if side.summary is not None else ():
            gap = np.abs(np.array(half.generated) - np.array(half.replayed))[:, 0]
            answers = (half.replayed, half.low, half.high, half.generated)
            replayed, low, high, drawn = (number(100.0 * values[int(gap.argmax())][0], 1) for values in answers)
            agree = f"{half.within.sum()} of {half.within.size}"
            rows.append(Row((side.title, half.resampled, agree, drawn, f"{replayed} ({low} to {high})")))
    columns = [Column(name, text=True) for name in ("Side", "Replayed", "Answers that agree")]
    columns += [Column("Reduction, farthest off", "%"), Column("Replay", text=True)]
    title = "Held out: models of half of the departures, and the other half; intervals of the difference"
    return to_html(Table(title, columns, rows)) if rows else Markup()


def _margins_section(sides: tuple[Side, ...]) -> Section:
    body = legend([("events, left", SIDE["left"]), ("events, right", SIDE["right"]), ("model", MODEL)])
    for side in sides:
        charts = [
            bars(
                f"margin-{side.key}-{m.name}", f"{side.key}: {m.name}, {PARAMETER_MEANINGS.get(m.name, '')}",
                m.edges, [("events", 100.0 * m.data, SIDE[side.key])], parameter_label(m.name),
                "Share per bin [%]", outlines=[("model", 100.0 * m.model, MODEL)],
            )
            for m in side.diagnostics.marginals
        ]  # fmt: skip
        body += Markup("<h3>{}</h3>").format(side.title) + figure(
            charts,
            "Share of events (bars) and of the model (line) in equal bins, without the outermost 0.3 % at open ends.",
        )
    columns = [Column("Parameter", text=True)]
    for side in sides:
        columns += [Column(f"{side.title}: distance", "%"), Column("Limit", "%"), Column("Reached at")]
    by_name = [{c.name: c for c in side.diagnostics.calibrations} for side in sides]
    rows = [
        Row((f"{parameter_label(name)}: {PARAMETER_MEANINGS[name]}",
                  *(cell for side in by_name for cell in _calibration_cells(side.get(name)))))
        for name in PARAMETER_NAMES
    ]  # fmt: skip
    body += to_html(
        Table("Kolmogorov distances in per cent of events; highlighted: beyond sampling error", columns, rows)
    )
    body += paragraphs(
        "With very many events a distance may be beyond its limit and still too small to matter: below 5 % it is not a "
        "reason to refuse the model."
    )
    return Section("margins", "Margins", body)


def _calibration_cells(calibration: Calibration | None) -> tuple[Cell | Value, ...]:
    if calibration is None:
        return "constant", "", ""
    distance = Cell(number(100 * calibration.distance, 2), bad=calibration.distance > calibration.limit)
    return distance, number(100 * calibration.limit, 2), compact(float(f"{calibration.position:.3g}"))


def _joint_section(sides: tuple[Side, ...]) -> Section:
    body = Markup()
    for side in sides:
        pair = side.diagnostics.joint
        if pair is not None:
            charts = [density(side.key, (pair.first_edges, pair.second_edges), values, what)
                      for what, values in (("events", pair.data), ("model", pair.model))]  # fmt: skip
            body += figure(
                charts, f"{side.title}: events, and the model, on one scale of the square root of the density."
            )
    return Section("joint", "T and d_y", body or paragraphs("T or d_y does not vary."))


def density(key: str, pair: Sequence[FloatArray], values: FloatArray, what: str) -> Chart:
    """Joint density of T and d_y between their edges, as a heat map of its square root."""
    cells = np.sqrt(values.T)
    cells[cells == 0.0] = np.nan
    labels = [
        [compact(float(f"{edge:.3g}")) if i % max(1, (edges.size - 1) // 5) == 0 else "" for i, edge in enumerate(low)]
        for edges, low in ((edges, edges[:-1].tolist()) for edges in pair)
    ]
    title, empty = f"{key}: density of T and d_y, {what}", [[""] * cells.shape[1]] * cells.shape[0]
    x, y = (f"T [s], {what}", labels[0]), ("d_y [m]", labels[1])
    return heat_map(f"joint-{key}-{what}", title, cells, empty, x, y)


def _selection_section(sides: tuple[Side, ...]) -> Section:
    body = Markup()
    for side in sides:
        summary = side.summary
        if summary is None or not summary.bic:
            body += paragraphs(f"{side.title}: the model does not say how its K = {side.K} was chosen.")
            continue
        if summary.reason:
            body += paragraphs(f"{side.title}: {summary.reason}.")
        body += to_html(curve(summary, side.K, f"{side.title}: choice of K; the chosen one has a star"))
    return Section("selection", "Choice of K", body + bic_figure([(side.key, side.summary) for side in sides]))


def curve(summary: SideSummary, taken: int, title: str = "") -> Table:
    """Every K that was fitted; the one that was taken has a star."""
    columns = [
        Column("K"), Column("p", about="Free parameters"), Column("Log-likelihood", "nats an event", ".4f"),
        Column("BIC", form=".1f"), Column("Above the least", form=".1f"),
    ]  # fmt: skip
    parameters = summary.n_parameters or (None,) * len(summary.bic)  # of an earlier version
    numbers = zip(summary.n_components, parameters, summary.log_likelihood, summary.bic, strict=True)
    rows = [
        Row([f"{K}{' *' if taken == K else '  '}", p, fit, bic, bic - min(summary.bic)], "winner" if taken == K else "")
        for K, p, fit, bic in numbers
    ]
    return Table(title, columns, rows)


def bic_figure(sides: Sequence[tuple[str, SideSummary | None]]) -> Markup:
    """BIC over K of the sides for which several K were fitted; nothing without one."""
    series = [
        Series(key, np.array(side.n_components, dtype=float), np.array(side.bic) - min(side.bic), SIDE[key])
        for key, side in sides
        if side is not None and len(side.bic) > 1
    ]
    if not series:
        return Markup()
    x = Axis("K", min(curve.x[0] for curve in series), max(curve.x[-1] for curve in series))
    y = Axis.around("BIC above the least", *(curve.y for curve in series), [0.0])
    key = legend([(curve.label, curve.style) for curve in series])
    return figure([Chart("bic", "BIC", x, y, series)], "BIC above its least value, by K.", key)


def _settings_section(model: ScenarioModel, sides: tuple[Side, ...], seed: int) -> Section:
    facts = [
        ("Model content", model.content_hash),
        *((f"Log-likelihood, {s.key}", f"{number(s.diagnostics.log_likelihood, 4)} nats an event") for s in sides),
        ("Seed of the checks", str(seed)),
        ("Model sample", f"{sides[0].diagnostics.n_model:,} events a side"),
    ]
    return Section("settings", "Settings", bullets(model_notes(model)) + pairs(facts))
