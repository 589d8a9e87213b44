"""Plots of rankings and results for notebooks and scripts: each draws on the matplotlib axes `ax`, by default those of
a new figure, and returns them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import InputError, expect, nearest
from ldctoolkit.registry import controller_class

from .design import Design
from .pages import charts
from .pages.confidence_section import interleaved, running_mean
from .pages.landscape_section import swept_axes, values_of
from .pages.text import compact, shorten
from .ranking.design_metrics import pareto_front
from .ranking.ranking import Ranking
from .requirements import metric, metric_values
from .results import StudyResults

if TYPE_CHECKING:
    from matplotlib.axes import Axes


__all__ = ["plot_convergence", "plot_distribution", "plot_landscape", "plot_ranking", "plot_trade_off"]

_SIDES = {"both": (LEFT, RIGHT), "left": (LEFT,), "right": (RIGHT,)}


@dataclasses.dataclass(frozen=True)
class LineStyle:
    """How one law, or the recorded path, is drawn: colour, dash in line widths, matplotlib marker."""

    color: str
    dash: tuple[float, ...]
    marker: str

    @classmethod
    def of(cls, style: charts.Style) -> LineStyle:
        """The style that the report's charts have."""
        color = "#595959" if style.color < 0 else charts.COLORS[style.color]
        marker = {"d": "D", "x": "X"}.get(style.marker, style.marker)
        return cls(color, tuple(float(part) for part in style.dash.split()), marker)

    def line(self) -> dict[str, Any]:
        """Keyword arguments of ``Axes.plot``."""
        return {"color": self.color, "linestyle": (0, self.dash) if self.dash else "-"}


def law_styles(laws: Iterable[str]) -> dict[str, LineStyle]:
    """One style a law, as the report has them."""
    return {law: LineStyle.of(style) for law, style in charts.law_styles(laws).items()}


_RECORDED = LineStyle.of(charts.RECORDED)


def axes_of(ax: Axes | None) -> Axes:
    """The given axes, or those of a new figure of pyplot, which a notebook shows by itself."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    new: Axes = plt.subplots(layout="constrained")[1]
    return new


def plain_legend(axes: Axes) -> None:
    """A legend whose text is no formula: a user's title may hold a dollar sign."""
    for text in axes.legend().get_texts():
        text.set_parse_math(False)


def point_style(style: LineStyle) -> dict[str, Any]:
    """Keyword arguments of ``Axes.plot`` for points of a law."""
    return {"color": style.color, "marker": "X" if style.marker == "|" else style.marker, "linestyle": "none"}


def styles_of(designs: Iterable[Design]) -> dict[str, LineStyle]:
    """One style a law, the law of the first design first: with those of a ranking as the report has them."""
    return law_styles(design.law for design in designs)


def curve_styles(results: StudyResults, chosen: Sequence[int]) -> list[LineStyle]:
    """A style for each curve: that of the law, or, where two are of one law, one of its own.

    Laws stand in the order of their least mean S, as in a ranking without requirements.
    """
    laws = [results.designs[i].law for i in chosen]
    if len(set(laws)) < len(laws):
        return list(law_styles(map(str, range(len(laws)))).values())
    mean = np.array([np.mean(S) for S in results.counted])
    styles = styles_of(results.designs[i] for i in np.argsort(mean, kind="stable").tolist())
    return [styles[law] for law in laws]


def chosen_designs(results: StudyResults, designs: Iterable[Design | int]) -> list[int]:
    """Positions of designs in the results."""
    place = {design.id: i for i, design in enumerate(results.designs)}
    found = []
    for one in designs:
        if isinstance(one, int):
            if not 0 <= one < len(place):
                raise InputError("designs", value=one, allowed=f"0 to {len(place) - 1}")
            found.append(one)
        elif one.id in place:
            found.append(place[one.id])
        else:
            raise InputError(
                "designs", f"{one.label} has no results here", allowed=f"the {len(place)} designs of the study"
            )
    if not found:
        raise InputError("designs", "none", allowed="at least one")
    return found


def plot_landscape(
    ranking: Ranking, law: str | None = None, x: str = "y_s", y: str | None = None, ax: Axes | None = None
) -> Axes:
    """Least mean S over one or two swept quantities of a law, at the best of all the others.

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
        S in m s. The law's best design of those drawn has a star; cells without a design are empty.

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
    places = [i for i, design in enumerate(ranking.designs) if design.law == law]
    swept = {axis.name: axis for axis in swept_axes([ranking.designs[i] for i in places])}
    for name, wanted in (("x", x), ("y", y)):
        if wanted is not None and wanted not in swept:
            allowed = nearest(wanted, swept) if swept else "its designs differ in nothing"
            raise InputError(name, f"is not swept in {law}", value=wanted, hint=allowed)
    across, up = swept[x], None if y is None else swept[y]
    S = np.full((1 if up is None else len(up.values), len(across.values)), np.nan)
    for i in places:
        values = values_of(ranking.designs[i])
        cell = (0 if up is None else up.values.index(values[up.name]), across.values.index(values[across.name]))
        S[cell] = np.fmin(S[cell], ranking.S[i])
    row, column = np.unravel_index(int(np.nanargmin(S)), S.shape)
    axes = axes_of(ax)
    labels = [compact(value) for value in across.values]
    if up is None:
        style = styles_of(ranking.designs)[law]
        axes.plot(range(len(labels)), S[0], **(point_style(style) | style.line()))
        axes.axhline(float(ranking.S_uncorrected[places[0]]), color="#767676", linewidth=1.0, linestyle="--")
        axes.plot(column, S[0, column], marker="*", markersize=13, color="#ffffff", markeredgecolor="#000000")
        axes.set_ylabel("Mean S [m·s]")
    else:
        mesh = axes.pcolormesh(np.arange(len(labels) + 1) - 0.5, np.arange(len(up.values) + 1) - 0.5, S, cmap="viridis")
        axes.plot(column, row, marker="*", markersize=13, color="#ffffff", markeredgecolor="#000000")
        axes.set_yticks(range(len(up.values)), [compact(value) for value in up.values], parse_math=False)
        axes.set_ylabel(up.label, parse_math=False)
        axes.figure.colorbar(mesh, ax=axes, label="Mean S [m·s]")
    axes.set_xticks(range(len(labels)), labels, parse_math=False)
    axes.set_xlabel(across.label, parse_math=False)
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
    axes, styles = axes_of(ax), styles_of(ranking.designs)
    named = {place for place in (ranking.winner, ranking.baseline) if place is not None}
    places = sorted({*range(min(top, len(ranking))), *named})
    for row, place in enumerate(places):
        style = styles[ranking.designs[place].law]
        if np.isfinite(ranking.S_low[place]) and np.isfinite(ranking.S_high[place]):
            axes.hlines(row, ranking.S_low[place], ranking.S_high[place], color=style.color, linewidth=1.6)
        fill = style.color if ranking.set_of_best[place] else "none"
        axes.plot(ranking.S[place], row, markersize=6, **(point_style(style) | {"markerfacecolor": fill}))
    axes.axvline(float(ranking.S_uncorrected[0]), color="#767676", linewidth=1.0, linestyle="--")
    axes.set_yticks(range(len(places)), [_name(ranking, place) for place in places], parse_math=False)
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xlabel("Mean S [m·s]")
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
        In the units of the report: shares in per cent, angles in degrees. The winner has a ring. Designs without one
        of the metrics are not drawn, those that miss a requirement are in no front unless all do.

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
    of_x, of_y = metric(x), metric(y)
    across, up = (one.scale * metric_values(one.name, ranking) for one in (of_x, of_y))
    axes, styles = axes_of(ax), styles_of(ranking.designs)
    shown = np.isfinite(across) & np.isfinite(up)
    laws = np.array([design.law for design in ranking.designs])
    for law, style in styles.items():
        rows = shown & (laws == law)
        if rows.any():
            title = shorten(controller_class(law).title, 60)
            axes.plot(across[rows], up[rows], label=title, alpha=0.8, **point_style(style))
    front = _front(across, up, ranking.rank > 0, of_x.better, of_y.better)
    if front.size:
        axes.step(across[front], up[front], where="post", color="#767676", linewidth=1.0, zorder=1,
                  label="Pareto front")  # fmt: skip
    if ranking.winner is not None and shown[ranking.winner]:
        axes.plot(across[ranking.winner], up[ranking.winner], marker="o", markersize=13, color="none",
                  markeredgecolor="#000000", linestyle="none", label="winner")  # fmt: skip
    axes.set_xlabel(f"{of_x.label}, {of_x.better} is better", parse_math=False)
    axes.set_ylabel(f"{of_y.label}, {of_y.better} is better", parse_math=False)
    plain_legend(axes)
    return axes


def _name(ranking: Ranking, place: int) -> str:
    rank = f"{ranking.rank[place]}. " if ranking.rank[place] else ""
    return shorten(f"{rank}{ranking.designs[place].label}", 60)


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
    chosen = chosen_designs(results, designs)
    rows = np.isin(results.scenarios.side, _SIDES[side])
    if not rows.any():
        raise InputError("side", value=side, hint="the study has no such scenarios")
    axes = axes_of(ax)
    recorded = results.S_uncorrected[chosen[0]][rows]
    axes.ecdf(recorded, label="without control", **_RECORDED.line())
    for i, style in zip(chosen, curve_styles(results, chosen), strict=True):
        label = shorten(results.designs[i].label, 60)
        axes.ecdf(results.counted[i][rows], label=label, **style.line())
    axes.set_xlim(0.0, max(float(np.quantile(recorded, 0.995)), 1e-3))
    axes.set_xlabel("Score S [m·s]")
    axes.set_ylabel("Share of departures with less")
    plain_legend(axes)
    return axes


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
    chosen = chosen_designs(results, designs)
    reference: FloatArray | float = 0.0
    if to is not None:
        reference = results.counted[chosen_designs(results, [to])[0]]
    order = interleaved(results.scenarios.side)
    axes = axes_of(ax)
    for i, style in zip(chosen, curve_styles(results, chosen), strict=True):
        count, mean, error = running_mean((results.counted[i] - reference)[order])
        axes.fill_between(count, mean - error, mean + error, color=style.color, alpha=0.16, linewidth=0)
        axes.plot(count, mean, label=shorten(results.designs[i].label, 60), **style.line())
    _plain_log(axes, order.size)
    axes.set_xlabel("Number of scenarios")
    axes.set_ylabel("Mean S [m·s]" if to is None else "Mean paired difference of S [m·s]")
    plain_legend(axes)
    return axes


def _plain_log(axes: Axes, n: int) -> None:
    """A logarithmic axis of counts with the numbers written out."""
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.set_xscale("log")
    axes.set_xlim(2, max(n, 3))
    ticks = [t for k in range(8) for t in (10**k, 2 * 10**k, 5 * 10**k) if 2 <= t <= n and (t < 10_000 or t == 10**k)]
    axes.xaxis.set_major_locator(FixedLocator(ticks))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:,.0f}")


def _front(x: FloatArray, y: FloatArray, ranked: BoolArray, better_x: str, better_y: str) -> IntArray:
    """Places on the Pareto front of two metrics, from the best of the first one on; of ranked designs where any is."""
    signs = np.array([[1.0 if better == "less" else -1.0] for better in (better_x, better_y)])
    values = np.stack([x, y])
    allowed = np.isfinite(values).all(axis=0)
    if (allowed & ranked).any():
        allowed &= ranked
    costs = np.where(allowed, signs * values, np.nan).T
    front = np.flatnonzero(pareto_front(costs))
    return front[np.lexsort(costs[front].T[::-1])]
