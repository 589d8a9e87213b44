"""``ranking.csv``: every design of every case, one row each, units in the names of the columns.

A design that misses a requirement has no rank; the column ``unmet`` says which. A design whose law failed has a row
without rank and figures; the column ``failure`` says why. A design that a race gave up has one behind those of the
primary case, in which the race was; the columns ``dropped_...`` say when, and what was known of it then.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from ldctoolkit import controller_class
from ldctoolkit.metrics import METRICS, RELEASE_METRICS
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.results import Race
from studies.storage.files import write_text

_DROPPED: Final = ("dropped_in_round", "dropped_scenarios", "dropped_S_m_s", "dropped_low_m_s")
"""Columns of a design that a race gave up: after which round and on how many scenarios, its mean S on them, and the
lower bound of how much worse than the best it is."""


_NUMBERS: Final = {
    "S": METRICS["S"].column,
    "S_low": "S_low_m_s",
    "S_high": "S_high_m_s",
    "S_p95": METRICS["S_p95"].column,
    "S_cvar95": METRICS["S_cvar95"].column,
    "S_left": METRICS["S_left"].column,
    "S_right": METRICS["S_right"].column,
    "S_uncorrected": "S_uncorrected_m_s",
    "reduction": METRICS["reduction"].column,
    "reduction_left": METRICS["reduction_left"].column,
    "reduction_right": METRICS["reduction_right"].column,
    "difference": "difference_to_best_m_s",
    "difference_low": "difference_low_m_s",
    "difference_high": "difference_high_m_s",
    "baseline_difference": "baseline_difference_m_s",
    "baseline_difference_low": "baseline_difference_low_m_s",
    "baseline_difference_high": "baseline_difference_high_m_s",
    "set_of_best": "set_of_best",
    "best_frequency": "best_frequency",
    "pareto": "pareto",
    "fresh_S": "fresh_S_m_s",
    "fresh_low": "fresh_low_m_s",
    "fresh_high": "fresh_high_m_s",
    "fresh_difference": "fresh_difference_to_first_m_s",
    "fresh_difference_low": "fresh_difference_to_first_low_m_s",
    "fresh_difference_high": "fresh_difference_to_first_high_m_s",
    "fresh_baseline_difference": "fresh_baseline_difference_m_s",
    "fresh_baseline_difference_low": "fresh_baseline_difference_low_m_s",
    "fresh_baseline_difference_high": "fresh_baseline_difference_high_m_s",
    "fresh_reduction": "fresh_reduction",
    "optimism": "optimism_m_s",
    "optimism_low": "optimism_low_m_s",
    "optimism_high": "optimism_high_m_s",
}
"""Attribute of a ranking -> column: scores with their intervals; the other metrics follow from their table."""

_COUNTS: Final = ("solver_failed", "diverged", "timed_out", "crashed", "beyond_delta_max", "invalid", "failed_solves")


def write_csv(rankings: Sequence[Ranking], path: str | Path, race: Race | None = None) -> None:
    """Write rankings as one CSV file, whole or not at all; window and convention name the case."""
    gains = _gain_columns(rankings, race)
    text = io.StringIO()
    rows = [row for ranking in rankings for row in _rows(ranking, gains)]
    if race is not None:
        behind = len(rankings[0]) + len(rankings[0].failed)
        rows[behind:behind] = _given_up(race, rankings[0], gains)
    # what a row has no value for is empty
    writer = csv.DictWriter(text, fieldnames=[*rows[0], *_DROPPED], restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(Path(path), text.getvalue())


def _gain_columns(rankings: Iterable[Ranking], race: Race | None) -> list[str]:
    dropped = () if race is None else race.dropped
    laws = {design.law for ranking in rankings for design in _every(ranking)} | {one.design.law for one in dropped}
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
    numbers: dict[str, Any] = {column: getattr(ranking, name) for name, column in _NUMBERS.items()}
    numbers["winner"] = np.arange(len(ranking)) == ranking.winner
    numbers |= {METRICS[name].column: getattr(ranking, name) for name in ("triggered", "deeper")}
    numbers |= {name: getattr(ranking, name) for name in _COUNTS}
    numbers |= {one.column: getattr(ranking.release, one.name) for one in RELEASE_METRICS.values()}
    reasons = [""] * len(ranking) + [one.reason for one in ranking.failed]
    for i, (design, reason) in enumerate(zip(_every(ranking), reasons, strict=True)):
        here = i < len(ranking)
        yield {
            **_named(ranking, int(ranking.rank[i]) if here and ranking.rank[i] else "", design, gains),
            **{name: _field(column[i].item()) if here else "" for name, column in numbers.items()},
            "unmet": "; ".join(ranking.unmet[i]) if here else "",
            "fresh_unmet": "; ".join(ranking.fresh_unmet[i]) if here else "",
            "optimism_of": _optimism_of(ranking, i) if here else "",
            "failure": reason,
        }


def _named(ranking: Ranking, rank: int | str, design: Design, gains: Sequence[str]) -> dict[str, Any]:
    """The columns that say which design in which case."""
    values = dict.fromkeys(gains, "") | dict(
        zip(_columns_of(design.law), (_field(value) for _, value in design.gains), strict=True)
    )
    return {
        "window": ranking.case.window,
        "convention": ranking.case.convention,
        "rank": rank,
        "design": design.id,
        "law": design.law,
        "y_s_m": repr(design.y_s),
        **{f"gain_{name}": value for name, value in values.items()},
    }


def _given_up(race: Race, ranking: Ranking, gains: Sequence[str]) -> Iterator[dict[str, Any]]:
    """No rank and no figures: these would stand for fewer scenarios than all others."""
    for one in race.dropped:
        figures = (one.round, one.scenarios, _field(one.S), _field(one.low))
        yield _named(ranking, "", one.design, gains) | dict(zip(_DROPPED, figures, strict=True))


def _optimism_of(ranking: Ranking, i: int) -> str:
    if np.isnan(ranking.optimism[i]):
        return ""
    return "baseline_difference" if ranking.optimism_paired else "S"


def _field(value: Any) -> str:
    """Numbers in full precision, truth values in lower case, nothing for a figure that is taken over no departure."""
    if isinstance(value, bool):
        return str(value).lower()
    return "" if value != value else str(value)
