"""Plots of a ranking: mean S with intervals, and any two of its figures against each other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.errors import InputError
from studies.plotting.given_axes import axes_of, plain_legend, point_style, styles_of
from studies.ranking.figures import figure, figure_values
from studies.report.figures.trade_off_figure import front_of_two
from studies.report.words.text import shorten

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from studies.ranking.ranking import Ranking


def plot_ranking(ranking: Ranking, ax: Axes | None = None, top: int = 20) -> Axes:
    """Mean S of the first designs with its simultaneous interval, the best on top.

    Parameters
    ----------
    ranking : Ranking
    ax : Axes, optional
        To draw on; those of a new figure by default.
    top : int
        How many designs. The winner and the baseline follow where they are further down.

    Returns
    -------
    Axes
        S in m s. Filled markers are in the set of best; the upright line is no control.

    Raises
    ------
    InputError
        If `top` is less than 1.

    Examples
    --------
    >>> import tempfile
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from studies import Study, rank_study, run_study
    >>> content = {"name": "a", "scenarios": {"left": 20, "right": 20}, "design": [{"law": "lqr", "y_s": [0.05, 0.1]}]}
    >>> study = Study.from_dict(content)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> ax = plot_ranking(rank_study(results, study)[0])
    >>> ax.get_xlabel(), len(ax.get_yticks())
    ('Mean S [m·s]', 2)
    """
    if top < 1:
        raise InputError(f"top: {top}; allowed: 1 or more")
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
    axes.set_title(ranking.case.label, parse_math=False)
    return axes


def plot_trade_off(ranking: Ranking, x: str = "a_y_peak_p95", y: str = "S", ax: Axes | None = None) -> Axes:
    """Two figures of all designs against each other, one marker a law, with the Pareto front of the two.

    Parameters
    ----------
    ranking : Ranking
    x, y : str
        Figures, as `studies.ranking.figures.figure` takes them.
    ax : Axes, optional
        To draw on; those of a new figure by default.

    Returns
    -------
    Axes
        In the units of the report: shares in per cent, angles in degrees. The winner has a ring. Designs without one
        of the figures are not drawn, those that miss a requirement are in no front unless all do.

    Raises
    ------
    UnknownNameError
        For a figure that does not exist; the message names the nearest.

    Examples
    --------
    >>> import tempfile
    >>> import matplotlib
    >>> matplotlib.use("agg")
    >>> from studies import Study, rank_study, run_study
    >>> content = {"name": "a", "scenarios": {"left": 20, "right": 20}, "design": [{"law": "lqr", "y_s": [0.05, 0.1]}]}
    >>> study = Study.from_dict(content)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = run_study(study, directory=folder, workers=1)
    >>> plot_trade_off(rank_study(results, study)[0], x="ay_p95").get_xlabel()
    'Peak a_y, 95 % quantile [m/s²], less is better'
    """
    of_x, of_y = figure(x), figure(y)
    across, up = (one.scale * figure_values(one.name, ranking) for one in (of_x, of_y))
    axes, styles = axes_of(ax), styles_of(ranking.designs)
    shown = np.isfinite(across) & np.isfinite(up)
    laws = np.array([design.law for design in ranking.designs])
    for law, style in styles.items():
        rows = shown & (laws == law)
        if rows.any():
            title = shorten(controller_class(law).title, 60)
            axes.plot(across[rows], up[rows], label=title, alpha=0.8, **point_style(style))
    front = front_of_two(np.stack([across, up]), ranking.rank > 0, of_x.better, of_y.better)
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
