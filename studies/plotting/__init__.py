"""Figures of rankings and results for notebooks and scripts: each draws on matplotlib axes and returns them."""

from __future__ import annotations

from studies.plotting.landscape_plot import plot_landscape
from studies.plotting.ranking_plots import plot_ranking, plot_trade_off
from studies.plotting.score_plots import plot_convergence, plot_distribution

__all__ = ["plot_convergence", "plot_distribution", "plot_landscape", "plot_ranking", "plot_trade_off"]
