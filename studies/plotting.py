"""Plots for notebooks and scripts: charts of the pages on matplotlib axes, by default those of a new figure."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, expect
from ldctoolkit.paths.uncorrected import UncorrectedPath
from ldctoolkit.plant_options import Residuals
from ldctoolkit.registry import controller_class
from ldctoolkit.vehicle import VehicleParameters

from .design import Design
from .pages.charts import RECORDED, Axis, Chart, Dot, Series, Style, dots, ecdf, law_styles
from .pages.confidence_section import convergence
from .pages.landscape_section import landscape, swept_axes
from .pages.verdict_section import scatter_of_metrics
from .ranking.ranking import Ranking
from .results import StudyResults
from .text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ldctoolkit.scenarios import Scenarios
    from ldctoolkit.simulation.loop import Outcome

__all__ = [
    "plot_convergence", "plot_departure", "plot_distribution", "plot_landscape", "plot_ranking", "plot_trade_off",
]  # fmt: skip

_SIDES: Final = {"both": (LEFT, RIGHT), "left": (LEFT,), "right": (RIGHT,)}
_SOFT: Final = "#767676"
_MARKERS: Final = {"d": "D", "x": "X", "|": "X"}
_PATH: Final = "path-with-control"  # identifier of the lines of paths, by which they are counted


# ------------------------------------------------------------------------------------------------ charts on axes


def draw(chart: Chart, ax: Axes | None = None, *, legend: bool = True) -> Axes:
    """Draw a chart of the pages; a user's text is no formula: it may hold a dollar sign."""
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    if chart.level is not None:
        ax.axhline(chart.level, color=_SOFT, linewidth=1.0, linestyle="--", zorder=1)
    for line, color in ((chart.upright, _SOFT), (chart.limit, "#b3261e")):
        if line is not None:
            ax.axvline(line[0], color=color, linewidth=1.0, linestyle="--", zorder=1)
    if chart.diagonal:
        ax.axline((chart.x.low, chart.x.low), slope=1.0, color=_SOFT, linewidth=1.0, zorder=1)
    if chart.front is not None and chart.front[0].size:
        ax.step(*chart.front, where="post", color=_SOFT, linewidth=1.0, zorder=1, label="Pareto front")
    for series in chart.series:
        _draw_series(series, ax)
    if chart.cells is not None:
        edges = (np.arange(size + 1) - 0.5 for size in chart.cells.values.T.shape)
        mesh = ax.pcolormesh(*edges, chart.cells.values, cmap="viridis")
        ax.figure.colorbar(mesh, ax=ax, label=chart.cells.label)
        if chart.cells.crossed is not None:
            rows, columns = np.nonzero(chart.cells.crossed & np.isfinite(chart.cells.values))
            ax.plot(columns, rows, linestyle="none", marker="x", color="#ffffff")
    for y_position, dot in enumerate(dot for row in chart.rows for dot in row):
        if math.isfinite(dot.low + dot.high):
            ax.hlines(y_position, dot.low, dot.high, color=dot.style.hex, linewidth=1.6)
        for value, style in ((dot.value, dot.style), *([dot.beside] if dot.beside else [])):
            ax.plot(value, y_position, markersize=6, **_points(style, filled=not dot.open))
    if chart.ring is not None and math.isfinite(sum(chart.ring[:2])):
        x, y, label = chart.ring
        look: dict[str, Any] = (
            {"marker": "*", "color": "#ffffff"} if chart.cells is not None else {"marker": "o", "color": "none"}
        )
        ax.plot(x, y, markersize=13, markeredgecolor="#000000", linestyle="none", label=label or None, **look)
    if chart.rows:
        labels = [shorten(dot.label, 60) for row in chart.rows for dot in row]
        ax.set_yticks(range(len(labels)), labels, parse_math=False)
        ax.set_ylim(len(labels) - 0.5, -0.5)
        _set_axis("x", chart.x, ax)
    else:
        _set_axis("x", chart.x, ax)
        _set_axis("y", chart.y, ax)
    if legend and chart.series:
        for text in ax.legend().get_texts():
            text.set_parse_math(False)
    return ax


def _draw_series(series: Series, ax: Axes) -> None:
    label, color = shorten(series.label, 60), series.style.hex
    line: dict[str, Any] = {"color": color, "linestyle": "-"}
    if series.style.dash:
        line["linestyle"] = (0, tuple(float(part) for part in series.style.dash.split()))
    if series.low is not None and series.high is not None:
        ax.fill_between(series.x, series.low, series.high, color=color, alpha=0.16, linewidth=0)
    if series.kind in ("bars", "outline"):
        ax.stairs(series.y, series.x, fill=series.kind == "bars", alpha=0.5, label=label, color=color)
    elif series.kind == "points":
        filled = np.ones(series.x.shape, dtype=bool) if series.filled is None else series.filled
        for state in (False, True):
            if (rows := filled == state).any():
                look = _points(series.style, filled=state)
                ax.plot(series.x[rows], series.y[rows], label=label, alpha=0.8, **look)
                label = ""
    else:
        if series.kind in ("marked", "started"):
            line |= {"marker": _points(series.style)["marker"], "markevery": [0] if series.kind == "started" else None}
        line["drawstyle"] = "steps-post" if series.kind == "steps" else "default"
        ax.plot(series.x, series.y, label=label, **line)


def _points(style: Style, *, filled: bool = True) -> dict[str, Any]:
    """Keyword arguments of ``Axes.plot`` for points."""
    face = style.hex if filled else "none"
    return {"color": style.hex, "marker": _MARKERS.get(style.marker, style.marker), "linestyle": "none",
            "markerfacecolor": face}  # fmt: skip


def _set_axis(name: str, axis: Axis, ax: Axes) -> None:
    """Label, ends and ticks of one axis."""
    getattr(ax, f"set_{name}label")(axis.label, parse_math=False)
    if axis.log:
        getattr(ax, f"set_{name}scale")("log")
        values, texts = zip(*axis.ticks(300.0), strict=True)
        getattr(ax, f"set_{name}ticks")(values, texts)
        ax.minorticks_off()
    elif axis.categories:
        getattr(ax, f"set_{name}ticks")(range(len(axis.categories)), axis.categories, parse_math=False)
    if math.isfinite(axis.low + axis.high):
        getattr(ax, f"set_{name}lim")(axis.low, axis.high)


# ------------------------------------------------------------------------------------------------ of a ranking


def plot_landscape(
    ranking: Ranking, law: str | None = None, x: str = "y_s", y: str | None = None, ax: Axes | None = None
) -> Axes:
    """Mean S over one or two swept quantities of a law, of the best design of all the other values.

    Raises `InputError` for a law without designs, or a quantity that is not swept.

    Parameters
    ----------
    ranking : Ranking
    law : str, optional
        Registry name; by default that of the winner, or of the first design.
    x : str
        ``"y_s"`` or a gain that the designs of the law differ in.
    y : str, optional
        A second one, for a heat map; a line over `x` without it.
    ax : Axes, optional

    Returns
    -------
    Axes
        S in m s of the design that ranks first in each cell. The law's first design is marked; a cross marks cells
        without a design that meets the requirements, cells without a design are empty.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, y_s=[0.1, 0.2], name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ldc.plot_landscape(ranking, "lqr", x="y_s").get_xlabel()
    'y_s [m]'
    """
    expect("ranking", ranking, Ranking)
    laws = list(dict.fromkeys(design.law for design in ranking.designs))
    if law is None:
        law = ranking.designs[ranking.winner or 0].law
    if law not in laws:
        raise InputError("law", "has no designs here", value=law, allowed=laws)
    swept = {axis.name: axis for axis in swept_axes([design for design in ranking.designs if design.law == law])}
    for name, quantity in (("x", x), ("y", y)):
        if quantity is not None and quantity not in swept:
            allowed = swept or "none: its designs differ in nothing"
            raise InputError(name, f"is not swept in {law}", value=quantity, allowed=allowed)
    first = next(i for i, design in enumerate(ranking.designs) if design.law == law)
    across, up = swept[x], None if y is None else swept[y]
    chart = landscape(ranking, first, law_styles(laws)[law], across, up)
    axes = draw(dataclasses.replace(chart, x=dataclasses.replace(chart.x, label=across.label)), ax, legend=False)
    axes.set_title(controller_class(law).title, parse_math=False)
    return axes


def plot_ranking(ranking: Ranking, ax: Axes | None = None, top: int = 20) -> Axes:
    """Mean S of the first designs with its simultaneous interval, the best on top.

    Raises `InputError` if `top` is less than 1.

    Parameters
    ----------
    ranking : Ranking
    ax : Axes, optional
    top : int
        How many designs. The winner and the baseline follow where they are further down.

    Returns
    -------
    Axes
        S in m s. Filled markers are in the set of best; the upright line is no control.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ldc.plot_ranking(ranking).get_xlabel()
    'Mean S [m·s]'
    """
    expect("ranking", ranking, Ranking)
    if top < 1:
        raise InputError("top", value=top, allowed="1 or more")
    styles = law_styles(design.law for design in ranking.designs)
    named = {position for position in (ranking.winner, ranking.baseline) if position is not None}
    rows = []
    for i in sorted({*range(min(top, len(ranking))), *named}):
        rank = f"{ranking.rank[i]}. " if ranking.rank[i] else ""
        S, low, high = (
            float(values[i]) for values in (ranking.metrics.S, ranking.inference.S_low, ranking.inference.S_high)
        )
        style, design = styles[ranking.designs[i].law], ranking.designs[i]
        rows.append([Dot(f"{rank}{design.label}", S, low, high, style, open=not ranking.inference.set_of_best[i])])
    x = Axis("Mean S [m·s]", -math.inf, math.inf)
    axes = draw(dots("ranking", "Mean S", rows, x, upright=(float(ranking.metrics.S_uncorrected[0]), "")), ax)
    axes.set_title(ranking.label, parse_math=False)
    return axes


def plot_trade_off(ranking: Ranking, x: str = "a_y_peak_p95", y: str = "S", ax: Axes | None = None) -> Axes:
    """Two metrics of all designs against each other, one marker a law, with the Pareto front of the two.

    Raises `UnknownNameError` for a metric that does not exist; the message names the nearest.

    Parameters
    ----------
    ranking : Ranking
    x, y : str
        Metrics, as `ldctoolkit.studies.requirements.metric` takes them.
    ax : Axes, optional

    Returns
    -------
    Axes
        In the units of the report: shares in per cent, angles in degrees. The winner has a ring; filled designs meet
        all requirements. Designs without one of the metrics are not drawn, those that miss a requirement are in no
        front unless all do.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ldc.plot_trade_off(ranking, x="a_y_peak_p95", y="S").get_xlabel()
    'Peak a_y, 95 % quantile [m/s²], less is better'
    """
    expect("ranking", ranking, Ranking)
    return draw(
        scatter_of_metrics(ranking, x, y, law_styles(design.law for design in ranking.designs), ranking.winner), ax
    )


# ------------------------------------------------------------------------------------------------ of results


def _positions(results: StudyResults, designs: Iterable[Design | int]) -> list[int]:
    """Positions of designs in the results."""
    position_of = {design.id: i for i, design in enumerate(results.designs)}
    rows = []
    for design in designs:
        if isinstance(design, int):
            if not 0 <= design < len(position_of):
                raise InputError("designs", value=design, allowed=f"0 to {len(position_of) - 1}")
            rows.append(design)
        elif design.id in position_of:
            rows.append(position_of[design.id])
        else:
            allowed = f"the {len(position_of)} designs of the study"
            raise InputError("designs", f"{design.label} has no results here", allowed=allowed)
    if not rows:
        raise InputError("designs", "none", allowed="at least one")
    return rows


def _curves(results: StudyResults, rows: Sequence[int]) -> list[tuple[str, FloatArray, Style]]:
    """Label, counted S and style of designs: the style of the law, or, where two are of one law, one of its own.

    Laws stand in the order of their least mean S, as in a ranking without requirements.
    """
    designs = results.designs
    keys = [designs[i].law for i in rows]
    mean = np.array([np.mean(S) for S in results.counted])
    styles = law_styles(designs[i].law for i in np.argsort(mean, kind="stable").tolist())
    if len(set(keys)) < len(keys):
        keys = [str(k) for k in range(len(keys))]
        styles = law_styles(keys)
    return [(designs[i].label, results.counted[i], styles[key]) for i, key in zip(rows, keys, strict=True)]


def plot_distribution(
    results: StudyResults, designs: Iterable[Design | int] = (0,), ax: Axes | None = None, *, side: str = "both"
) -> Axes:
    """Empirical distribution of S with and without control.

    Raises `InputError` for a side or design that is not there.

    Parameters
    ----------
    results : StudyResults
    designs : iterable of Design or int
        Designs of the study, or their positions in ``results.designs``.
    ax : Axes, optional
    side : {"both", "left", "right"}

    Returns
    -------
    Axes
        S in m s, as it counts: a failed scenario at least as bad as without control.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ldc.plot_distribution(results, ranking.designs).get_xlabel()
    'Score S [m·s]'
    """
    expect("results", results, StudyResults)
    if side not in _SIDES:
        raise InputError("side", value=side, allowed=_SIDES)
    results = results.on_drivable()
    positions = _positions(results, designs)
    of_side = np.isin(results.scenarios.side, _SIDES[side])
    if not of_side.any():
        raise InputError("side", value=side, hint="the study has no such scenarios")
    recorded = results.S_uncorrected[positions[0]][of_side]
    samples = [("without control", recorded, RECORDED)]
    samples += [(label, S[of_side], style) for label, S, style in _curves(results, positions)]
    x = Axis("Score S [m·s]", 0.0, max(float(np.quantile(recorded, 0.995)), 1e-3))
    share = "Share of departures with less"
    return draw(ecdf("distribution", "Distribution of S", samples, x, share, most=recorded.size), ax)


def plot_convergence(
    results: StudyResults,
    designs: Sequence[Design | int] = (0,),
    ax: Axes | None = None,
    *,
    to: Design | int | None = None,
) -> Axes:
    """Mean S over the first k scenarios with a band of 1.96 standard errors, left and right ones interleaved.

    Raises `InputError` for a design that is not there.

    Parameters
    ----------
    results : StudyResults
    designs : sequence of Design or int
        Designs of the study, or their positions in ``results.designs``.
    ax : Axes, optional
    to : Design or int, optional
        Draw paired differences to this design.

    Returns
    -------
    Axes
        Bands are those of one curve by itself.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> study = ldc.study(ldc.NoControl, ldc.LQR, name="small", left=20, right=20)
    >>> results = ldc.run_study(study, workers=1)
    >>> ranking = ldc.rank_study(results, study)
    >>> ldc.plot_convergence(results, ranking.designs).get_xlabel()
    'Number of scenarios'
    """
    expect("results", results, StudyResults)
    results = results.on_drivable()
    curves = _curves(results, _positions(results, designs))
    label = "Mean S [m·s]"
    if to is not None:
        reference, label = results.counted[_positions(results, [to])[0]], "Mean paired difference of S [m·s]"
        curves = [(name, values - reference, style) for name, values, style in curves]
    chart = convergence(curves, results.scenarios.side)
    return draw(dataclasses.replace(chart, y=Axis(label, -math.inf, math.inf)), ax)


# ------------------------------------------------------------------------------------------------ of an outcome


def plot_departure(
    outcome: Outcome,
    i: int,
    ax: Axes | None = None,
    *,
    scenarios: Scenarios | None = None,
    vehicle: VehicleParameters | None = None,
    label: str = "with control",
) -> Axes:
    """Draw the path of one scenario under control, from the trigger on.

    Raises `InputError` if the outcome holds no trajectories, or not of this scenario.

    Parameters
    ----------
    outcome : Outcome
        With trajectories.
    i : int
        Number of the scenario.
    ax : Axes, optional
        To draw on; those of a new figure by default.
    scenarios : Scenarios, optional
        Those that were driven; the path without control, rebuilt from its parameters, is drawn too.
    vehicle : VehicleParameters, optional
        The one that was driven; the default one otherwise.
    label : str
        Of the path under control, in the legend.

    Returns
    -------
    Axes
        Position of the vehicle's edge beyond the line [m], outward, against the time since the crossing [s]. The marker
        is the trigger; a scenario that never triggered has no path under control. Paths on the same axes differ in
        colour, dash and marker.

    Examples
    --------
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from ldctoolkit import LQR, Scenarios, plot_departure, simulate
    >>> scenarios = Scenarios.from_arrays(T=[3.0], d_y=0.6, v_mean=25.0, side=1)
    >>> ax = plot_departure(simulate(LQR(), scenarios, y_s=0.1, trajectories=True), 0, scenarios=scenarios)
    >>> ax.get_xlabel(), len(ax.get_legend().get_texts())
    ('Time since the crossing [s]', 2)
    """
    paths, n = outcome.trajectories, outcome.S.size
    if not 0 <= i < n:
        raise InputError("i", value=i, allowed=f"0 to {n - 1}")
    if scenarios is not None and scenarios.n != n:
        raise InputError("scenarios", f"{scenarios.n}, the outcome has {n}", allowed="those that were driven")
    if paths is None:
        raise InputError("outcome", "it holds no paths", hint="drive with trajectories=True a law that intervenes")
    path_row = np.flatnonzero(paths.rows == i)
    if not path_row.size:
        held = ", ".join(map(str, paths.rows[:5].tolist())) + (", ..." if paths.rows.size > 5 else "")
        raise InputError("i", f"{i} has no path in this outcome", allowed=held)
    before = 0 if ax is None else sum(line.get_gid() == _PATH for line in ax.lines)
    series = []
    if scenarios is not None:
        scenario = scenarios.take([i])
        t = np.linspace(0.0, float(scenario.T[0]), 201)
        y = UncorrectedPath.of(scenario, Residuals(), 0).lateral(t[None, :])[0]
        series.append(Series("without control", t, y, RECORDED))
    driven = np.isfinite(paths.t[path_row[0]])
    if driven.any():
        t = paths.t[path_row[0], driven]
        y = paths.x[path_row[0], driven, 0] - (vehicle or VehicleParameters()).edge_offset
        style = law_styles(map(str, range(before + 1)))[str(before)]
        series.append(Series(label, t, y, style, kind="started"))
    x, y_axis = (
        Axis(text, -math.inf, math.inf) for text in ("Time since the crossing [s]", "Edge beyond the line [m]")
    )
    chart = Chart("departure", f"Scenario {i}", x, y_axis, series, level=None if before else 0.0)
    axes = draw(chart, ax)
    if driven.any():
        axes.lines[-1].set_gid(_PATH)
    axes.set_title(f"Scenario {i}")
    return axes
