"""Metrics as people read them: values in the units that are shown, names in sentences, requirements with their unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.metrics import GROUPS, METRICS
from studies.ranking.figures import figure_values, parse_requirement
from studies.ranking.ranking import Ranking
from studies.report.words.text import compact, number, unit_text

SHOWN: Final = tuple(sorted(METRICS.values(), key=lambda one: tuple(GROUPS).index(one.group)))
"""All metrics, group by group."""

_OF_A_LAW_THAT_ACTS: Final = frozenset(("triggered", "needless"))
"""Metrics that no control has none of, whatever is stored."""

_BEFORE: Final = ("mean", "largest", "median")
"""What a title ends with and a sentence begins with."""


def metric_text(name: str, value: float, digits: int | None = None) -> str:
    r"""A metric as a page shows it, without its unit but for the sign of per cent; a dash where there is none.

    Parameters
    ----------
    name : str
        As in `ldctoolkit.metrics.METRICS`.
    value : float
        In the metric's unit.
    digits : int, optional
        Those of the table by default.

    Examples
    --------
    >>> metric_text("deeper", 0.064), metric_text("delta_peak_max", 0.0175)
    ('6.4\xa0%', '1.00')
    """
    one = METRICS[name]
    text = number(one.scale * float(value), one.digits if digits is None else digits)
    return f"{text}\u00a0%" if one.shown_unit == "%" and not math.isnan(value) else text


def shown_values(name: str, ranking: Ranking) -> npt.NDArray[np.float64]:
    """Values of a metric as they stand, (d,) in its unit, NaN where the page has none to show.

    Parameters
    ----------
    name : str
        As in `ldctoolkit.metrics.METRICS`.
    ranking : Ranking
        Of d designs.
    """
    values = figure_values(name, ranking)
    if name in _OF_A_LAW_THAT_ACTS:
        values = np.where([design.is_baseline for design in ranking.designs], np.nan, values)
    return values


def shown_limits(require: Sequence[str]) -> dict[str, tuple[str, ...]]:
    r"""Limits of requirements by metric, in the units that are shown.

    Examples
    --------
    >>> shown_limits(["a_y_peak_p95 <= 3", "deeper < 0.1", "a_y_peak_p95 > 1"])
    {'a_y_peak_p95': ('≤ 3', '> 1'), 'deeper': ('< 10\xa0%',)}
    """
    limits: dict[str, tuple[str, ...]] = {}
    for text in require:
        one = parse_requirement(text)
        sign = one.operator.replace("<=", "\u2264").replace(">=", "\u2265")
        limit = f"{sign} {compact(one.limit * one.figure.scale)}" + ("\u00a0%" * (one.figure.shown_unit == "%"))
        limits[one.figure.name] = (*limits.get(one.figure.name, ()), limit)
    return limits


def metric_name(name: str) -> str:
    """What a sentence calls a metric.

    Parameters
    ----------
    name : str
        As in `ldctoolkit.metrics.METRICS`.

    Examples
    --------
    >>> metric_name("a_y_peak_mean"), metric_name("a_y_peak_p95"), metric_name("S")
    ('mean peak a_y', 'peak a_y (95 % quantile)', 'mean S')
    """
    title, _, rest = METRICS[name].title.partition(", ")
    if title[1:2].islower():
        title = title[0].lower() + title[1:]
    if rest in _BEFORE:
        return f"{rest} {title}"
    return f"{title} ({rest})" if rest else title


def requirement_text(requirement: str) -> str:
    """A requirement with the unit of its limit; shares and counts have none.

    Parameters
    ----------
    requirement : str
        As `studies.ranking.figures.parse_requirement` takes it.

    Examples
    --------
    >>> requirement_text("a_y_peak_p95 <= 3"), requirement_text("deeper <= 0.1")
    ('a_y_peak_p95 <= 3 m/s²', 'deeper <= 0.1')
    """
    parsed = parse_requirement(requirement)
    unit = "" if parsed.figure.unit in ("share", "count") else unit_text(parsed.figure.unit)
    return f"{parsed.text} {unit}".rstrip()
