"""``ranking.csv``: every design of every case, one row each, units in the names of the columns.

A design that misses a requirement has no rank; the column ``unmet`` says which. A design whose law failed has a row
without rank and figures; the column ``failure`` says why.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ldctoolkit import controller_class
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.ranking.release import COLUMNS
from studies.storage.files import write_text


def write_csv(rankings: Sequence[Ranking], path: str | Path) -> None:
    """Write rankings as one CSV file, whole or not at all; window and convention name the case.

    Parameters
    ----------
    rankings : sequence of Ranking
    path : path

    Raises
    ------
    StoreError
        If the file cannot be written.
    """
    gains = _gain_columns(rankings)
    text = io.StringIO()
    rows = [row for ranking in rankings for row in _rows(ranking, gains)]
    writer = csv.DictWriter(text, fieldnames=list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(Path(path), text.getvalue())


def _gain_columns(rankings: Iterable[Ranking]) -> list[str]:
    laws = dict.fromkeys(design.law for ranking in rankings for design in _every(ranking))
    return list(dict.fromkeys(column for law in sorted(laws) for column in _columns_of(law)))


def _every(ranking: Ranking) -> Iterator[Design]:
    yield from ranking.designs
    yield from (one.design for one in ranking.failed)


def _columns_of(law: str) -> list[str]:
    """Column of every gain of a law; a gain of one name and unit shares its column between laws."""
    units = {"1": "", "samples": ""}
    return [
        g.name + (f"_{unit}" if (unit := units.get(g.unit, g.unit.replace("/", "_per_").replace("^", ""))) else "")
        for g in controller_class(law).gains()
    ]


def _rows(ranking: Ranking, gains: Sequence[str]) -> Iterator[dict[str, Any]]:
    numbers = {
        "S_m_s": ranking.S,
        "S_low_m_s": ranking.S_low,
        "S_high_m_s": ranking.S_high,
        "S_p95_m_s": ranking.S_p95,
        "S_cvar95_m_s": ranking.S_cvar95,
        "S_left_m_s": ranking.S_left,
        "S_right_m_s": ranking.S_right,
        "S_uncorrected_m_s": ranking.S_uncorrected,
        "reduction": ranking.reduction,
        "reduction_left": ranking.reduction_left,
        "reduction_right": ranking.reduction_right,
        "difference_to_best_m_s": ranking.difference,
        "difference_low_m_s": ranking.difference_low,
        "difference_high_m_s": ranking.difference_high,
        "baseline_difference_m_s": ranking.baseline_difference,
        "baseline_difference_low_m_s": ranking.baseline_difference_low,
        "baseline_difference_high_m_s": ranking.baseline_difference_high,
        "set_of_best": ranking.set_of_best,
        "best_frequency": ranking.best_frequency,
        "pareto": ranking.pareto,
        "fresh_S_m_s": ranking.fresh_S,
        "fresh_low_m_s": ranking.fresh_low,
        "fresh_high_m_s": ranking.fresh_high,
        "optimism_m_s": ranking.optimism,
        "winner": np.arange(len(ranking)) == ranking.winner,
        "triggered_share": ranking.triggered,
        "deeper_than_D_y_share": ranking.deeper,
        "solver_failed": ranking.solver_failed,
        "diverged": ranking.diverged,
        "timed_out": ranking.timed_out,
        "crashed": ranking.crashed,
        "invalid": ranking.invalid,
        "failed_solves": ranking.failed_solves,
        **{column: getattr(ranking.release, name) for name, column in COLUMNS.items()},
    }
    reasons = [""] * len(ranking) + [one.reason for one in ranking.failed]
    for i, (design, reason) in enumerate(zip(_every(ranking), reasons, strict=True)):
        here = i < len(ranking)
        values = dict.fromkeys(gains, "") | dict(
            zip(_columns_of(design.law), (_field(value) for _, value in design.gains), strict=True)
        )
        yield {
            "window": ranking.case.window,
            "convention": ranking.case.convention,
            "rank": int(ranking.rank[i]) if here and ranking.rank[i] else "",
            "design": design.id,
            "law": design.law,
            "y_s_m": repr(design.y_s),
            **{f"gain_{name}": value for name, value in values.items()},
            **{name: _field(column[i].item()) if here else "" for name, column in numbers.items()},
            "unmet": "; ".join(ranking.unmet[i]) if here else "",
            "failure": reason,
        }


def _field(value: Any) -> str:
    """Numbers in full precision, truth values in lower case, nothing for a figure that is taken over no departure."""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value != value else str(value)
