"""The page of the source paper: its procedure, its figures and its table, made from the departures of a study."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from markupsafe import Markup

from ldctoolkit.arrays import FloatArray
from ldctoolkit.clusters import cluster_error, several, with_tails_of_t
from ldctoolkit.departures import PARAMETER_NAMES, SIDES, DepartureParameters, DepartureSignals, rebuild_signals
from ldctoolkit.scenario_model import conditions
from ldctoolkit.scenario_model.provenance import UNIT, SourceSummary, cell_edges
from ldctoolkit.simulation import Takeover, Window
from ldctoolkit.version import __version__

from ..design import is_paper_design
from ..ranking.verdict import design_name, law_title
from ..storage.folder_files import write_text
from ..tables import Column, Row, Table, to_html
from ..text import PARAMETER_MEANINGS, parameter_label, percent, shorten
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

_DRAWN: Final = 20_000  # departures of a side that show the model
_STEP: Final = 0.2  # [s] between the drawn points of a path
_LINE: Final = Style(-1, "", "o")
_CENTRE: Final = Style(-1, "9 3 2 3", "o")
_KEY: Final = (("without control", RECORDED), *((f"with control, {side}", style) for side, style in SIDE.items()))


def write_paper_page(report: ReportInput, path: str | Path) -> Path:
    """Write the page as one HTML file that needs nothing else.

    It is about the design of Table I where the study has it, else about the one that the report discusses.
    """
    context = Context.of(report)
    designs = context.ranking.designs
    position = next((i for i, design in enumerate(designs) if is_paper_design(design)), context.shown)
    scores = _scores_of(context, position)
    html = make_page(
        kind="Lane departure correction: the source paper, figure by figure",
        title=f"{report.title}: figures of the paper",
        heading="The evaluation of Zhao, Wang and LeBlanc (2017) on the departures of this study",
        facts=(report.title, context.scenario_text(), report.model_name, design_name(designs[position])),
        sections=(
            *_result(context, position, scores), _departures(context), _model(context), _control(context, position),
            _scores(scores, context.ranking.confidence),
        ),
        footer=f"Study {report.study_name}. ldctoolkit {__version__}. All figures are drawn from this study's numbers.",
    )  # fmt: skip
    write_text(Path(path), html)
    return Path(path)


@dataclasses.dataclass(frozen=True)
class Score:
    """S of one side over one window."""

    window: Window
    side: str  # ``"left"`` or ``"right"``
    S: FloatArray  # (n,) [m s] With control, as it counts in the ranking
    S_0: FloatArray  # (n,) [m s] Without control
    reduction: tuple[float, float, float]  # [%] 1 - mean S / mean S_0, and the ends of its interval


def _scores_of(context: Context, position: int) -> list[Score]:
    """Scores over both windows: those of the study, and the others without, or with, the part before the trigger."""
    from scipy.special import ndtri

    scores, pair = list[Score](), (context.S(position), context.S_uncorrected(position))
    y_s, critical = context.ranking.designs[position].y_s, ndtri(0.5 + 0.5 * context.ranking.confidence)
    cluster = several(context.scenarios.cluster)
    cluster = np.arange(context.scenarios.n) if cluster is None else cluster
    before = Takeover.build(context.scenarios, context.report.setup, y_s=y_s).S_before
    for window, (side, rows) in itertools.product(get_args(Window)[::-1], side_rows(context)):
        shift = before[rows] * (0.0 if window == context.results.window else -1.0 if window == "control" else 1.0)
        S, S_0 = (values[rows] + shift for values in pair)
        mean = float(S_0.mean()) or math.nan
        ratio = float(S.mean()) / mean
        spread = cluster_error((S - ratio * S_0)[None] / mean, np.unique(cluster[rows], return_inverse=True)[1])
        half = float((with_tails_of_t(critical, spread.df) * spread.error)[0])
        reduction = (100.0 * (1.0 - ratio), 100.0 * (1.0 - ratio - half), 100.0 * (1.0 - ratio + half))
        scores.append(Score(window, side, S, S_0, reduction))
    return scores


def _result(context: Context, position: int, scores: Sequence[Score]) -> Iterator[Section]:
    """The reductions beside the paper's, and why they differ; the procedure and Table I."""
    report, design = context.report, context.ranking.designs[position]
    study = {"T_s": report.setup.dt, "y_s": design.y_s, "D_y": context.ranking.D_y}
    here = dict(design.gains) | dataclasses.asdict(report.setup.vehicle) | study
    shared: dict[str, Any] = {"report": report, "scores": scores, "here": here, "law": shorten(law_title(design), 12)}
    shared |= {"level": percent(context.ranking.confidence, 0), "about": context.model_sentence}
    shared |= {"convention": context.results.convention, "not_ideal": [*not_ideal(report.setup.options)]}
    for part, title in (("result", "Paper and study"), ("procedure", "Procedure and Table I")):
        yield Section(part, title, render("paper.html", part=part, **shared), printed=True)


def _chart(title: str, x_label: str, y_label: str, series: Sequence[Series], height: float = 220.0) -> Chart:
    x = Axis.around(x_label, *(curve.x for curve in series), zero=True)
    return Chart("paper", title, x, Axis.around(y_label, *(curve.y for curve in series)), series, height=height)


def _departures(context: Context) -> Section:
    """y, v and c of a few departures of each side."""
    scenarios, shown = context.scenarios, list[int]()
    for _, rows in side_rows(context):
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
    body = figure(charts, caption, legend([(side, SIDE[side]) for side, _ in side_rows(context)]))
    return Section("departures", "Example departures", body, printed=True)


def _model(context: Context) -> Section:
    """Margins and joint density of T and d_y, recorded and of the model, and the choice of K."""
    report, limits, replayed = context.report, conditions(context.report.given), context.results.replayed
    model, body, texts = report.model, Markup(), list[str]()
    table = report.source_departures or (None if replayed is None else replayed.scenarios)
    table = context.scenarios if model is None else table
    kind = "invented" if report.synthetic and table is None else "recorded"
    sample = None if model is None else model.sample(_DRAWN, _DRAWN, report.setup.seed, report.given)
    summaries = {} if model is None else dict(model.provenance.sides)
    for side, which in SIDES.items():
        drawn, summary = None if sample is None else sample.take(sample.side == which), summaries.get(side)
        names = PARAMETER_NAMES if model is None else model.side(which).names
        source = source_quantiles(which, names, table, summary, limits)
        known, count = ({}, _DRAWN) if isinstance(source, str) else source[:2]
        charts = tuple(_margins(side, {name: known.get(name) for name in names}, drawn, kind, count))
        key = legend([(kind, SIDE[side])] * bool(known) + [("model", MODEL)] * (drawn is not None))
        about = source if isinstance(source, str) else f"{count:,} {kind} departures."
        caption = f"{side.capitalize()}: share of departures per bin. {about}"
        body += figure(charts, caption, key) or paragraphs(caption)
        rows = None if table is None else source_rows(which, table, limits)
        kept = None if rows is not None or limits or summary is None else summary.source_summary
        joint = tuple(_joint(side, {kind: rows, "model": drawn}, kept))
        body += figure(joint, f"{side.capitalize()}: T and d_y together, by the square root of the density.")
        texts += [f"{side.capitalize()}: {summary.reason}."] if summary is not None and summary.reason else []
    body += Markup("<h3>Number of components K</h3>") * bool(summaries) + paragraphs(*texts)
    return Section("model", "Departures and model", body + bic_figure([*summaries.items()]), printed=True)


def _margins(
    side: str, known: Mapping[str, tuple[FloatArray, FloatArray] | None], drawn: DepartureParameters | None, kind: str,
    count: int,
) -> Iterator[Chart]:  # fmt: skip
    """Shares of each parameter in bins: of departures from their quantiles and shares, and of the model."""
    bins = int(np.clip(3.0 * np.cbrt(count), 8, 24))
    for name, quantiles in known.items():
        samples = [] if drawn is None else [getattr(drawn, name)]
        columns = [*samples, *([] if quantiles is None else quantiles[:1])]
        ends = np.array([np.quantile(values, (0.003, 0.997)) for values in columns])
        if ends.size and np.ptp(ends) > 0.0:
            edges = np.linspace(ends.min(), ends.max(), bins + 1)
            shares = [] if quantiles is None else [(kind, 100.0 * np.diff(np.interp(edges, *quantiles)), SIDE[side])]
            lines = [("model", 100.0 * np.histogram(x, edges)[0] / x.size, MODEL) for x in samples]
            title, label = f"{side}: {name}, {PARAMETER_MEANINGS[name]}", parameter_label(name)
            yield bars("margin", title, edges, shares, label, "Share per bin [%]", outlines=lines, height=150.0)


def _joint(
    side: str, departures: Mapping[str, DepartureParameters | None], kept: SourceSummary | None
) -> Iterator[Chart]:
    """Densities of T and d_y: of recorded departures, or what a model's file keeps of them, and of the model."""
    tables = {what: (table.T, table.d_y) for what, table in departures.items() if table}
    ends = [np.quantile(np.concatenate(values), 0.995) for values in zip(*tables.values(), strict=True)]
    b = int(np.clip(math.isqrt(min((table[0].size for table in tables.values()), default=0)), 6, 12))
    edges, cells = [np.linspace(0.0, end, b + 1) for end in ends], {}
    if kept is not None and kept.names[:2] == ("T", "d_y"):  # the first pair of the summary
        b = math.isqrt(len(kept.cells[0]))
        edges = [cell_edges(np.array(values), b) for values in kept.quantiles[:2]]
        cells = {next(iter(departures)): np.reshape(kept.cells[0], (b, b)) / UNIT}
    if edges and all(np.ptp(edge) > 0.0 for edge in edges):
        cells |= {what: np.histogram2d(*table, edges)[0] / table[0].size for what, table in tables.items()}
        for what, values in cells.items():
            yield density(side, [np.maximum(edge, 0.0) for edge in edges], values, f"{side}, {what}")


def _control(context: Context, position: int) -> Section:
    """One departure of each side with and without control, and all paths from the trigger on."""
    first = np.concatenate([rows[:MOST_PATHS] for _, rows in side_rows(context)]).tolist()
    departures, design = [ExplorerDeparture(row, ()) for row in first], ExplorerDesign(position, "")
    replayed = replay(context, departures, (design,), "paper-paths")
    paths, scenarios, setup = replayed.paths[0], replayed.scenarios, context.report.setup
    examples, bundles, every = list[Chart](), list[Chart](), max(1, round(_STEP / setup.dt))
    for side, which in SIDES.items():
        rows = np.flatnonzero(np.isfinite(paths.t).any(axis=1) & (scenarios.side == which))
        if not rows.size:
            continue
        k = int(rows[np.argmin(np.abs(scenarios.d_y[rows] - np.median(scenarios.d_y[rows])))])
        t, since = np.linspace(0.0, float(scenarios.T[k]), 121), (paths.t - paths.t[:, :1])[:, ::every]
        curves = [Series("without control", t, replayed.recorded.take([k]).lateral(t[None])[0], RECORDED)]
        curves += [Series("with control", paths.t[k], paths.y[k], SIDE[side], kind="started")]
        lines = [
            Series(f"no. {scenarios.index[i]}", since[i], paths.y[i, ::every], SIDE[side], kind="thin") for i in rows
        ]
        for charts, of, start, series in (
            (examples, f"no. {scenarios.index[k]}", "crossing", curves),
            (bundles, f"{rows.size} paths", "trigger", lines),
        ):
            end = np.array([0.0, max(float(np.nanmax(curve.x)) for curve in series)])
            series += [Series("line", end, 0.0 * end, _LINE)]
            series += [Series("lane centre", end, 0.0 * end - setup.vehicle.edge_offset, _CENTRE)]
            title, label = f"Departures to the {side}: {of}", f"Time since the {start} [s], {side}"
            charts.append(_chart(title, label, "Edge beyond the line [m]", series, 300.0))
    key = legend([*_KEY, ("lane line", _LINE), ("edge with the vehicle in the lane\u2019s centre", _CENTRE)])
    body = figure(examples, "One departure of each side, at the median of d_y. The mark is the trigger.", key)
    body += figure(bundles, f"All paths with control, from the trigger until {setup.settle:g} s after the departure.")
    body = body or paragraphs("Control acts in none of these departures.")
    return Section("control", "With and without control", body, printed=True)


def _scores(scores: Sequence[Score], level: float) -> Section:
    """Mean and standard deviation of S by side, and the mean over the number of departures."""
    rows, spread, curves = list[Row](), list[list[Dot]](), list[Chart]()
    S_columns = ("Without control", "Std. dev.", "With control", "Std. dev.")
    columns = [
        Column("Side", text=True), Column("S from", text=True), Column("Departures"),
        *(Column(title, "m\u00b7s", ".3f") for title in S_columns), Column("Reduction", "%", ".2f"),
        Column(f"{percent(level, 0)} interval", "%", ".1f"), Column("Paper", "%", ".2f"),
    ]  # fmt: skip
    for score in scores:
        pairs = (("without control", score.S_0, RECORDED), ("with control", score.S, SIDE[score.side]))
        moments = [(float(S.mean()), float(S.std(ddof=1)) if S.size > 1 else math.nan) for _, S, _ in pairs]
        paper, start = None, "the crossing"
        if score.window == "control":
            paper, start = REDUCTION[score.side], "the trigger"
            spread.append([
                Dot(score.side, mean, mean - sigma, mean + sigma, style, tip=what)
                for (mean, sigma), (what, _, style) in zip(moments, pairs, strict=True)
            ])  # fmt: skip
            chart = convergence(pairs, np.zeros(score.S.size, dtype=np.int64))
            x = dataclasses.replace(chart.x, label=f"Number of departures, {score.side}")
            curves.append(dataclasses.replace(chart, x=x, title=f"Mean S, {score.side}"))
        reduction, low, high = score.reduction
        rows.append(Row([score.side, start, score.S.size, *moments[0], *moments[1], reduction, (low, high), paper]))
    x = Axis.around("S [m\u00b7s]", [end for row in spread for dot in row for end in (dot.low, dot.high)])
    caption = (
        "S from the trigger on. First: mean, and one standard deviation of the departures to both sides. Then: mean S "
        "over the first departures, with 1.96 standard errors."
    )
    charts = [dots("spread-of-S", "Mean and standard deviation of S", spread, x), *curves]
    body = figure(charts, caption, legend(_KEY))
    body += to_html(Table("Mean S and its standard deviation over the departures", columns, rows))
    return Section("scores", "S with and without control", body, printed=True)
