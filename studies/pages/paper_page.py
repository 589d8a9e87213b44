"""The page of the source paper: its procedure, its figures and its table, made from the departures of a study."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Self, get_args

import numpy as np
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.clusters import cluster_error, with_tails_of_t
from ldctoolkit.departures import PARAMETER_NAMES, SIDES, DepartureParameters, DepartureSignals, rebuild_signals
from ldctoolkit.scenario_model import SideSummary, conditions
from ldctoolkit.scenario_model.provenance import UNIT, SourceSummary, cell_edges
from ldctoolkit.simulation import Takeover, Window
from ldctoolkit.version import __version__

from ..design import Design, is_paper_design
from ..ranking.verdict import design_name, law_title
from ..storage.folder_files import write_text
from ..tables import Cell, Column, Row, Table, to_html
from ..text import PARAMETER_MEANINGS, number, parameter_label, percent, shorten, unit_text
from .charts import RECORDED, Axis, Chart, Dot, Kind, Series, Style, bars, dots, legend
from .confidence_section import convergence
from .context import SIDE_NAMES, Context, ReportInput, side_rows
from .fit_page import MODEL, SIDE, bic_figure, density
from .model_section import source_quantiles, source_rows
from .replay import ExplorerDeparture, ExplorerDesign, replay
from .report import not_ideal
from .shell import Section, figure, make_page, paragraphs, render

REDUCTION: Final = {"left": 26.47, "right": 34.24}  # [%] of mean S, from the trigger on, in the paper
MOST_PATHS: Final = 200  # of a side; as many as in the paper

TABLE_1: Final = {
    "C_af": ("cornering stiffness, front tyre", 80000.0, "N/rad"), "I_z": ("yaw inertia", 3344.0, "kg m^2"),
    "C_ar": ("cornering stiffness, rear tyre", 80000.0, "N/rad"), "m": ("mass", 1000.0, "kg"),
    "l_f": ("centre of gravity to front axle", 1.43, "m"), "w_l": ("lane width", 3.6, "m"),
    "l_r": ("centre of gravity to rear axle", 1.47, "m"), "w_v": ("vehicle width", 1.9, "m"),
    "K_y": ("gain on the lateral offset", -0.005, "rad/m"), "T_s": ("sample time", 0.05, "s"),
    "K_psi": ("gain on the heading error", -0.2, "rad/rad"), "T_lp": ("preview time", 2.0, "s"),
    "y_s": ("trigger threshold", 0.2, "m"), "D_y": ("depth that counts as deep", 0.5, "m"),
}  # fmt: skip
"""Symbol -> meaning, value and unit in the paper's Table I."""

_DRAWN: Final = 20_000  # departures of a side that show the model
_BINS: Final = 24
_STEP: Final = 0.2  # [s] between the drawn points of a path
_KEY: Final = (("without control", RECORDED), *((f"with control, {side}", style) for side, style in SIDE.items()))
_LINE: Final = Style(-1, "", "o")
_CENTRE: Final = Style(-1, "9 3 2 3", "o")


@dataclasses.dataclass(frozen=True)
class SideScore:
    """S of one side over one window."""

    side: str  # ``"left"`` or ``"right"``
    S: FloatArray  # (n,) [m s] With control, as it counts in the ranking
    S_0: FloatArray  # (n,) [m s] Without control

    def reduction(self, confidence: float) -> tuple[float, float, float]:
        """1 - mean S / mean S_0 and the ends of its interval [%], from the linear part of the ratio."""
        from scipy.special import ndtri

        mean = float(self.S_0.mean())
        ratio = float(self.S.mean()) / mean if mean > 0.0 else math.nan
        spread = cluster_error((self.S - ratio * self.S_0)[None] / (mean or math.nan), np.arange(self.S.size))
        half = float((with_tails_of_t(ndtri(0.5 + 0.5 * confidence), spread.df) * spread.error)[0])
        return 100.0 * (1.0 - ratio), 100.0 * (1.0 - ratio - half), 100.0 * (1.0 - ratio + half)


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """A study as the paper evaluates: one design against no control."""

    context: Context
    position: int  # Of the design of Table I in the ranking, or else of the one that the report discusses
    scores: dict[Window, list[SideScore]]  # The study's window has the scores of its results

    @classmethod
    def of(cls, context: Context) -> Self:
        """Choose the design, and score it over both windows."""
        designs, own = context.ranking.designs, context.results.window
        position = next((i for i, design in enumerate(designs) if is_paper_design(design)), context.shown)
        before = Takeover.build(context.scenarios, context.report.setup, y_s=designs[position].y_s).S_before
        scores: dict[Window, list[SideScore]] = {}
        for window in get_args(Window):
            shift = before * (0.0 if window == own else -1.0 if window == "control" else 1.0)
            pair = context.S(position) + shift, context.S_uncorrected(position) + shift
            scores[window] = [SideScore(name, *(S[rows] for S in pair)) for name, rows in side_rows(context)]
        return cls(context, position, scores)

    @property
    def design(self) -> Design:
        """The design."""
        return self.context.ranking.designs[self.position]

    @property
    def recorded(self) -> DepartureParameters | None:
        """Recorded departures, where the study has them."""
        report, replayed = self.context.report, self.context.results.replayed
        if report.model is None:
            return self.context.scenarios
        return report.source_departures or (None if replayed is None else replayed.scenarios)

    def summary(self, side: str) -> SideSummary | None:
        """How the model of a side was fitted, where that is known."""
        model = self.context.report.model
        return None if model is None else dict(model.provenance.sides).get(side)


def write_paper_page(report: ReportInput, path: str | Path) -> Path:
    """Write the page as one HTML file that needs nothing else."""
    own = Evaluation.of(Context.of(report))
    html = make_page(
        kind="Lane departure correction: the source paper, figure by figure",
        title=f"{report.title}: figures of the paper",
        heading="The evaluation of Zhao, Wang and LeBlanc (2017) on the departures of this study",
        facts=(report.title, own.context.scenario_text(), report.model_name, design_name(own.design)),
        sections=(*_result(own), _departures(own), _model(own), _control(own), _scores(own)),
        footer=f"Study {report.study_name}. ldctoolkit {__version__}. All figures are drawn from this study's numbers.",
    )
    write_text(Path(path), html)
    return Path(path)


def _result(own: Evaluation) -> Iterator[Section]:
    """The reductions beside the paper's with reasons; the procedure and Table I."""
    report, level, model = own.context.report, own.context.ranking.confidence, own.context.report.model
    gains, vehicle = dict(own.design.gains), report.setup.vehicle
    values = {"T_s": report.setup.dt, "y_s": own.design.y_s, "D_y": own.context.ranking.D_y}
    here = {name: values.get(name, getattr(vehicle, name, gains.get(name))) for name in TABLE_1}
    other = [name for name, (_, value, _) in TABLE_1.items() if here[name] != value]
    columns = [Column("", text=True), Column("Parameter", text=True), Column("Paper"), Column("Here"), Column("Unit")]
    rows = [
        Row([name, about, value, Cell(here[name], bad=name in other), unit_text(unit)])
        for name, (about, value, unit) in TABLE_1.items()
    ]
    known = [f"{summary.events:,} {name}" for name in SIDES if (summary := own.summary(name)) is not None]
    sizes = [model.side(which).mixture.weights_.size for which in SIDES.values()] if model else []
    driven = [f"{score.S.size:,} {score.side}" for score in own.scores["control"]]
    boxes = (
        ("Recordings", "lane position, speed, bend"),
        ("Departures", ", ".join(known) or "edge beyond the line"),
        ("Eight parameters", "of y(x), v(t) and c(t)"),
        ("Bounded Gaussian mixture", "K = {} left, {} right".format(*sizes) if sizes else "not used"),
        (f"{'Generated' if model else 'Replayed'} departures", ", ".join(driven)),
        ("Trigger", f"edge {own.design.y_s:g} m beyond the line"),
        ("Closed loop", shorten(f"{law_title(own.design)}, or no control", 28)),
        ("Score S", "integral of |e_y| over time"),
    )
    shared: dict[str, Any] = {
        "report": report,
        "here": {window: ", ".join(_text(*score.reduction(level), score.side) for score in scores)
                 for window, scores in own.scores.items()},
        "about": f"In brackets: {percent(level, 0)} intervals, each by itself. {own.context.model_sentence}",
        "convention": own.context.results.convention,
        "other": other + [f"{part.name} of the plant" for part in not_ideal(report.setup.options)],
        "boxes": boxes,
        "table_1": to_html(Table("Table I; highlighted: other than in the paper", columns, rows)),
    }  # fmt: skip
    for part, title in (("result", "Paper and study"), ("procedure", "Procedure and Table I")):
        yield Section(part, title, render("paper.html", part=part, **shared), printed=True)


def _text(reduction: float, low: float, high: float, side: str) -> str:
    ends = f" ({number(low, 1)} to {number(high, 1)}\u00a0%)" if math.isfinite(low + high) else ""
    return f"{number(reduction, 2)}\u00a0% {side}{ends}"


def _departures(own: Evaluation) -> Section:
    """y, v and c of a few departures of each side."""
    scenarios, shown = own.context.scenarios, list[int]()
    for _, rows in side_rows(own.context):
        order = rows[np.argsort(scenarios.d_y[rows], kind="stable")]
        shown += dict.fromkeys(order[[int(share * (order.size - 1)) for share in (0.25, 0.5, 0.9)]].tolist())
    picked = scenarios.take(shown)
    drawn: list[tuple[DepartureSignals, Kind]] = [(rebuild_signals(picked, 0.02), "line")]
    drawn += [(picked.signals, "points")] if picked.signals else []
    charts = []
    for name, label, factor in (("y", "y [m]", 1.0), ("v", "v [m/s]", 1.0), ("c", "c [1/km]", 1000.0)):
        series = []
        for (signals, kind), k in itertools.product(drawn, range(picked.n)):
            part, style = slice(*signals.offsets[k : k + 2]), SIDE[SIDE_NAMES[int(picked.side[k])]]
            values = factor * getattr(signals, name)[part]
            series.append(Series(f"no. {picked.index[k]}", signals.t[part], values, style, kind=kind))
        charts.append(_chart(f"{label} of example departures", "Time since the crossing [s]", label, series))
    caption = (
        "y: edge beyond the line; v: speed; c: curvature of the lane, outward. Of each side the departures at 25, 50 "
        f"and 90 % of d_y, rebuilt from their eight parameters{'; points: as recorded' * (len(drawn) > 1)}."
    )
    body = figure(charts, caption, legend([(name, SIDE[name]) for name, _ in side_rows(own.context)]))
    return Section("departures", "Example departures", body, printed=True)


def _chart(title: str, x_label: str, y_label: str, series: Sequence[Series]) -> Chart:
    x = Axis.around(x_label, *(curve.x for curve in series), zero=True)
    return Chart("paper", title, x, Axis.around(y_label, *(curve.y for curve in series)), series, height=220.0)


def _model(own: Evaluation) -> Section:
    """Margins and joint density of T and d_y, recorded and generated, and the choice of K."""
    report, limits, body = own.context.report, conditions(own.context.report.given), Markup()
    joint, texts = list[Chart](), list[str]()
    seed = report.setup.seed
    generated = None if report.model is None else report.model.sample(_DRAWN, _DRAWN, seed, report.given)
    for side, which in SIDES.items():
        drawn, summary = generated and generated.take(generated.side == which), own.summary(side)
        names = report.model.side(which).names if report.model else PARAMETER_NAMES
        source = source_quantiles(which, names, own.recorded, summary, limits)
        known, about = ({}, source) if isinstance(source, str) else (source[0], f"{source[1]:,} recorded departures.")
        charts = []
        for name in names:
            samples = [*([getattr(drawn, name)] if drawn else []), *(known[name][:1] if name in known else [])]
            ends = [end for values in samples for end in np.quantile(values, (0.003, 0.997))]
            if not ends or min(ends) == max(ends):
                continue
            edges, title = np.linspace(min(ends), max(ends), _BINS + 1), f"{side}: {name}, {PARAMETER_MEANINGS[name]}"
            shares = [("recorded", 100.0 * np.diff(np.interp(edges, *known[name])), SIDE[side])] if known else []
            lines = [("model", np.histogram(getattr(drawn, name), edges)[0] / (0.01 * drawn.n), MODEL)] if drawn else []
            charts.append(bars(f"margin-{name}", title, edges, shares, parameter_label(name), "Share per bin [%]",
                               outlines=lines, height=150.0))  # fmt: skip
        key = legend([("recorded", SIDE[side])] * bool(known) + [("model", MODEL)] * bool(drawn))
        body += figure(charts, f"{side.capitalize()}: share of departures per bin. {about}", key)
        rows = own.recorded and source_rows(which, own.recorded, limits)
        kept = None if rows or limits or summary is None else summary.source_summary
        joint += _joint(side, rows, drawn, kept)
        texts += [f"{side.capitalize()}: {summary.reason}."] if summary is not None and summary.reason else []
    body += figure(joint, "T and d_y together, by the square root of the density: bright is frequent.")
    body += paragraphs(*texts) + bic_figure([(side, own.summary(side)) for side in SIDES])
    return Section("model", "Departures and model", body, printed=True)


def _joint(
    side: str, rows: DepartureParameters | None, drawn: DepartureParameters | None, kept: SourceSummary | None
) -> Iterator[Chart]:
    """Densities of T and d_y: of recorded departures, or what a model's file keeps of them, and of the model."""
    tables = {what: (table.T, table.d_y) for what, table in (("recorded", rows), ("model", drawn)) if table}
    if kept is not None and kept.names[:2] == ("T", "d_y"):  # the first pair of the summary
        b = math.isqrt(len(kept.cells[0]))
        edges = [cell_edges(np.array(values), b) for values in kept.quantiles[:2]]
        cells = {"recorded": np.reshape(kept.cells[0], (b, b)) / UNIT}
    else:
        ends = [np.quantile(np.concatenate(values), (0.0, 0.995)) for values in zip(*tables.values(), strict=True)]
        edges = [np.linspace(low, high, _BINS + 1) for low, high in ends]
        cells = {}
    if edges and all(np.ptp(edge) > 0.0 for edge in edges):
        cells |= {what: np.histogram2d(*table, edges)[0] / table[0].size for what, table in tables.items()}
        for what, values in cells.items():
            yield density(side, edges, values, f"{side}, {what}")


def _control(own: Evaluation) -> Section:
    """One departure of each side with and without control, and all paths from the trigger on."""
    departures = [
        ExplorerDeparture(row, ()) for _, rows in side_rows(own.context) for row in rows[:MOST_PATHS].tolist()
    ]
    replayed = replay(own.context, tuple(departures), (ExplorerDesign(own.position, ""),), "paper-paths")
    paths, scenarios, setup = replayed.paths[0], replayed.scenarios, own.context.report.setup
    examples, bundles, every = list[Chart](), list[Chart](), max(1, round(_STEP / setup.dt))
    for side, which in SIDES.items():
        rows = np.flatnonzero(np.isfinite(paths.t).any(axis=1) & (scenarios.side == which))
        if not rows.size:
            continue
        k = int(rows[np.argmin(np.abs(scenarios.d_y[rows] - np.median(scenarios.d_y[rows])))])
        t, since = np.linspace(0.0, float(scenarios.T[k]), 121), paths.t - paths.t[:, :1]
        curves = [Series("without control", t, replayed.recorded.take([k]).lateral(t[None])[0], RECORDED)]
        curves += [Series("with control", paths.t[k], paths.y[k], SIDE[side], kind="started")]
        lines = [Series(f"no. {scenarios.index[row]}", since[row, ::every], paths.y[row, ::every], SIDE[side], kind="thin")
                 for row in rows]  # fmt: skip
        for charts, of, start, series in (
            (examples, f"no. {scenarios.index[k]}", "crossing", curves), (bundles, f"{rows.size} paths", "trigger", lines),
        ):  # fmt: skip
            end = np.array([0.0, max(float(np.nanmax(curve.x)) for curve in series)])
            series += [Series("line", end, 0.0 * end, _LINE)]
            series += [Series("lane centre", end, 0.0 * end - setup.vehicle.edge_offset, _CENTRE)]
            title, label = f"Departures to the {side}: {of}", f"Time since the {start} [s], {side}"
            charts.append(_chart(title, label, "Edge beyond the line [m]", series))
    if not examples:
        return Section("control", "Control", paragraphs("Control acts in none of these departures."), printed=True)
    key = legend([*_KEY, ("lane line", _LINE), ("edge with the vehicle in the lane\u2019s centre", _CENTRE)])
    body = figure(examples, "One departure of each side, at the median of d_y. The mark is the trigger.", key)
    body += figure(bundles, "All paths with control, from the trigger on until they settle.")
    return Section("control", "With and without control", body + paragraphs(replayed.note), printed=True)


def _scores(own: Evaluation) -> Section:
    """Mean and standard deviation of S by side, and the mean over the number of departures."""
    level, rows, spread, curves = own.context.ranking.confidence, [], [], list[Chart]()
    S_columns = [
        Column(title, "m\u00b7s", ".3f") for title in ("Without control", "Std. dev.", "With control", "Std. dev.")
    ]
    columns = [
        Column("S counts", text=True), Column("Side", text=True), Column("Departures"), *S_columns,
        Column("Reduction", "%", ".2f"), Column(f"{percent(level, 0)} interval", "%", ".1f"), Column("Paper", "%", ".2f"),
    ]  # fmt: skip
    for window, score in [(window, score) for window, scores in own.scores.items() for score in scores]:
        reduction, low, high = score.reduction(level)
        pairs = (("without control", score.S_0, RECORDED), (f"with control, {score.side}", score.S, SIDE[score.side]))
        numbers = [(float(S.mean()), float(S.std(ddof=1)) if S.size > 1 else math.nan) for _, S, _ in pairs]
        paper, of = (REDUCTION[score.side], "from the trigger") if window == "control" else (None, "whole departure")
        rows.append(Row([of, score.side, score.S.size, *numbers[0], *numbers[1], reduction, (low, high), paper]))
        if window == "control":
            spread.append([Dot(score.side, mean, mean - sigma, mean + sigma, style, tip=name)
                           for (mean, sigma), (name, _, style) in zip(numbers, pairs, strict=True)])  # fmt: skip
            if score.S.size > 2:
                chart = convergence(pairs, np.zeros(score.S.size, dtype=np.int64))
                label = f"Number of departures, {score.side}"
                curves.append(
                    dataclasses.replace(chart, x=dataclasses.replace(chart.x, label=label), title=f"Mean S: {label}")
                )
    ends = Axis.around("S [m\u00b7s]", [end for row in spread for dot in row for end in (dot.low, dot.high)])
    body = figure(
        [dots("spread-of-S", "Mean and standard deviation of S", spread, ends), *curves],
        "S from the trigger on. First: mean, and one standard deviation of the departures to both sides. Then: mean S "
        "over the first departures, with 1.96 standard errors.", legend(_KEY),
    ) + to_html(Table("Mean S and its standard deviation over the departures", columns, rows))  # fmt: skip
    return Section("scores", "S with and without control", body, printed=True)
