"""All designs of the primary case as columns for the page's script, in the order of the ranking."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit import controller_class
from ldctoolkit.gains import Gain, GainValue
from ldctoolkit.metrics import GROUPS
from studies.design import CONVENTION_GAIN, FOLLOWS_CASE
from studies.report.context import Context
from studies.report.embedded.packed import packed
from studies.report.figures.landscape import swept_axes
from studies.report.tables.case_table import CaseTable
from studies.report.tables.row import Row, is_baseline
from studies.report.tables.tabulate import tried
from studies.report.words.metric_text import SHOWN, requirement_text, shown_limits, shown_values
from studies.report.words.text import printable, unit_text

FLAGS: Final = ("set_of_best", "pareto", "winner", "baseline", "paper", "passive", "best_of_law")
"""Bits of the column `flags`, the lowest first; `passive`: the design never intervenes."""

BAR_END: Final = 1.2
"""Right end of the bars of S, times mean S without control; the mark in report.css stands at 1 / 1.2."""

_COMPARED: Final = ("difference", "baseline_difference")
_FRESH: Final = ("fresh_difference", "fresh_baseline_difference", "optimism")


def designs_data(context: Context) -> dict[str, object]:
    """What ``js/designs.js`` reads.

    Parameters
    ----------
    context : Context

    Returns
    -------
    dict
        Columns of d entries in the order of the ranking, numbers as float of 32 bits. A column of one entry stands for
        d equal ones; a column with few numbers has their places (``at``) and the numbers.
    """
    table, ranking = context.primary, context.ranking
    laws = tuple(dict.fromkeys(design.law for design in ranking.designs))
    figures = [
        {
            "name": one.name,
            "title": one.title,
            "unit": one.shown_unit,
            **{key: getattr(one, key) for key in ("group", "digits", "better", "scale")},
            "values": column(shown_values(one.name, ranking)),
        }
        for one in SHOWN
    ]
    return {
        "count": len(ranking),
        "case": table.case.label,
        "require": [requirement_text(text) for text in table.require],
        "limits": {figure: list(texts) for figure, texts in shown_limits(table.require).items()},
        "pareto": list(table.pareto_figures),
        "confidence": table.confidence,
        "uncorrected": table.uncorrected,
        "full": BAR_END,
        "D_y": table.D_y,
        "groups": dict(GROUPS),
        "figures": figures,
        "ends": _ends(context),
        "rank": packed(ranking.rank, "i4"),
        "flags": packed(_flags(table), "u1"),
        "ids": "".join(design.id for design in ranking.designs),
        "law": packed([laws.index(design.law) for design in ranking.designs], "u2"),
        "y_s": coded([value_text(design.y_s) for design in ranking.designs]),
        "laws": [_law(context, law) for law in laws],
        "unmet": _sets(ranking.unmet),
        "fresh_unmet": _sets(ranking.fresh_unmet),
        "invalid": column(ranking.invalid),
        "styles": {
            law: {"color": style.color, "dash": list(style.dash), "marker": style.marker}
            for law, style in context.styles.items()
        },
    }


def _ends(context: Context) -> dict[str, dict[str, object]]:
    """Intervals by name; where the middle is no figure of its own, it is there too."""
    ranking, rows = context.ranking, context.primary.rows
    ends: dict[str, dict[str, object]] = {
        "S": {"low": column(ranking.S_low), "high": column(ranking.S_high)},
        "reduction": {
            "low": column([row.reduction.low for row in rows]),
            "high": column([row.reduction.high for row in rows]),
        },
    }
    names = _COMPARED + (_FRESH if ranking.fresh_scenarios else ())
    every = {name: tuple(f"{name}{end}" for end in ("", "_low", "_high")) for name in names}
    if ranking.fresh_scenarios:
        every["fresh_S"] = ("fresh_S", "fresh_low", "fresh_high")
    for name, fields in every.items():
        values = [getattr(ranking, field) for field in fields]
        if not np.isnan(values[0]).all():
            ends[name] = {end: column(of) for end, of in zip(("value", "low", "high"), values, strict=True)}
    return ends


def column(values: npt.ArrayLike) -> dict[str, Any]:
    """Numbers of all designs, in the shortest of three ways.

    Examples
    --------
    >>> column([0.0, 0.0, 0.0])
    {'type': 'f4', 'data': 'AAAAAA=='}
    """
    array = np.asarray(values, dtype=np.float64)
    if array.size > 1 and (np.array_equal(array, np.full_like(array, array[0]), equal_nan=True)):
        return packed(array[:1])
    at = np.flatnonzero(~np.isnan(array))
    if 2 * at.size < array.size:
        return {"at": packed(at, "i4"), "values": packed(array[at])}
    return packed(array)


def coded(texts: Sequence[str]) -> dict[str, object]:
    """Texts as a list of the different ones, in the order in which they come, and which one stands where.

    Examples
    --------
    >>> coded(["a", "b", "a"])
    {'texts': ['a', 'b'], 'index': {'type': 'u1', 'data': 'AAEA'}}
    """
    different = {text: i for i, text in enumerate(dict.fromkeys(texts))}
    kind = "u1" if len(different) <= 1 << 8 else "u2" if len(different) <= 1 << 16 else "i4"
    return {"texts": list(different), "index": packed([different[text] for text in texts], kind)}


def value_text(value: GainValue) -> str:
    """A value as a study file has it, in full precision.

    Examples
    --------
    >>> value_text(0.05), value_text(True), value_text("osqp")
    ('0.05', 'true', '"osqp"')
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(printable(value), ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(value)


def _law(context: Context, law: str) -> dict[str, object]:
    """A law, and the gains of its designs in the order of the ranking."""
    kind, ranking = controller_class(law), context.ranking
    members = [design for design in ranking.designs if design.law == law]
    swept = {
        axis.name for axis in swept_axes([design for design in tried(context.report.results) if design.law == law])
    }
    values = [dict(design.gains) for design in members]
    gains = [_gain(gain, [of[gain.name] for of in values], gain.name in swept) for gain in kind.gains()]
    return {"name": law, "title": printable(kind.title), "gains": gains}


def _gain(gain: Gain, values: Sequence[GainValue], swept: bool) -> dict[str, object]:
    follows = gain.name == CONVENTION_GAIN and FOLLOWS_CASE in values
    return {
        "name": gain.name,
        "unit": unit_text(gain.unit),
        "about": printable(gain.description),
        "default": value_text(FOLLOWS_CASE if follows else gain.default),
        "swept": swept,
        **coded([value_text(value) for value in values]),
    }


def _flags(table: CaseTable) -> npt.NDArray[np.uint8]:
    best = {row.place for row in table.best_of_each_law}
    special = {"winner": table.winner, "baseline": table.baseline, "paper": table.paper_design}
    places = {name: -1 if row is None else row.place for name, row in special.items()}

    def bits(row: Row) -> Mapping[str, bool]:
        return {
            "set_of_best": row.in_set,
            "pareto": row.pareto,
            "passive": is_baseline(row),
            "best_of_law": row.place in best,
            **{name: row.place == place for name, place in places.items()},
        }

    return np.array([sum(int(on[name]) << i for i, name in enumerate(FLAGS)) for on in map(bits, table.rows)], "u1")


def _sets(texts: Iterable[tuple[str, ...]]) -> dict[str, object]:
    """Requirements missed: the different lists of them, and which one stands where."""
    every = list(texts)
    different = {one: i for i, one in enumerate(dict.fromkeys(every))}
    kind = "u1" if len(different) <= 1 << 8 else "i4"
    return {
        "sets": [[requirement_text(text) for text in one] for one in different],
        "index": packed([different[one] for one in every], kind),
    }
