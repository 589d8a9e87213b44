"""A ranking as a table for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ldctoolkit import controller_class
from studies.cli._console import add_row, gain_text, new_table
from studies.ranking.ranking import Ranking

if TYPE_CHECKING:
    from rich.table import Table


def ranking_table(ranking: Ranking, top: int = 10) -> Table:
    """The first `top` designs, the best of each law, the winner and the baseline."""
    named = {place for place in (ranking.winner, ranking.baseline) if place is not None}
    shown = sorted({*range(min(top, len(ranking))), *ranking.best_of_each_law(), *named})
    headings = ["#", "law", "y_s\n[m]", "gains that differ\nfrom defaults", "mean S\n[m s]",
                f"{100 * ranking.confidence:g}%\ninterval", "to the best\n[m s]", "reduction", "left", "right",
                f"deeper\n{ranking.D_y:g} m", "failed"]  # fmt: skip
    if ranking.fresh_scenarios:
        headings.append("fresh S\n[m s]")
    table = new_table(f"{len(ranking)} designs by mean S, {ranking.case.label}", headings, left=(1, 3))
    for previous, i in zip([-1, *shown], shown, strict=False):
        if i > previous + 1:
            table.add_section()
        add_row(table, _cells(ranking, i), "bold" if i == ranking.winner else None)
    return table


def _cells(ranking: Ranking, i: int) -> list[str]:
    design = ranking.designs[i]
    gains = ", ".join(f"{name}={gain_text(value)}" for name, value in design.changed)
    tie = " =" if i and ranking.set_of_best[i] else ""
    failed = int(ranking.solver_failed[i] + ranking.diverged[i] + ranking.timed_out[i] + ranking.crashed[i])
    fresh = "-" if np.isnan(ranking.fresh_S[i]) else f"{ranking.fresh_S[i]:.4f}"
    return [
        str(ranking.rank[i]) if ranking.rank[i] else "-",
        controller_class(design.law).title,
        f"{design.y_s:g}",
        gains,
        f"{ranking.S[i]:.4f}",
        f"{ranking.S_low[i]:.3f} .. {ranking.S_high[i]:.3f}" if np.isfinite(ranking.S_low[i]) else "-",
        f"{ranking.difference[i]:+.4f}{tie}",
        *(_percent(values[i]) for values in (ranking.reduction, ranking.reduction_left, ranking.reduction_right)),
        _percent(ranking.deeper[i]),
        str(failed) if failed else "-",
        *([fresh] if ranking.fresh_scenarios else []),
    ]


def _percent(value: float) -> str:
    return "-" if np.isnan(value) else f"{100 * value:.1f} %"
