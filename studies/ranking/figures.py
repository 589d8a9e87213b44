"""Metrics of a design by name or alias, and requirements on them: ``"a_y_peak_p95 <= 3.0"``."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.errors import InputError, UnknownNameError, nearest
from ldctoolkit.metrics import METRICS, Metric

Operator = Literal["<=", "<", ">=", ">"]

_ALIASES: Final = {
    **{alias: one.name for one in METRICS.values() for alias in one.aliases},
    **{one.column: one.name for one in METRICS.values()},
}
"""Other names of the same metrics; the columns of ``ranking.csv`` are among them."""


def figure(name: str) -> Metric:
    """The metric of a name, of an alias (``ay_p95``), or of a column of ``ranking.csv``.

    Raises
    ------
    UnknownNameError
        Naming the nearest metric.

    Examples
    --------
    >>> figure("ay_p95").name, figure("dtle_0p3_share").better
    ('a_y_peak_p95', 'more')
    """
    known = _ALIASES.get(name, name)
    if known not in METRICS:
        # the beginning of another name, as ``ay``, is too short to be near to anything by its letters
        begun = next((target for alias, target in _ALIASES.items() if name and alias.startswith(name)), name)
        raise UnknownNameError(f"figure {name!r}: no such figure; {nearest(begun, METRICS)}")
    return METRICS[known]


def figure_values(name: str, *sources: Any) -> FloatArray:
    """Values of a metric, one a design.

    Parameters
    ----------
    name : str
        As `figure` takes it.
    *sources : Mapping or object
        Where to look, in this order: mappings by key, objects by attribute, then the attribute `release` of an object.
        A `studies.Ranking` holds all metrics.

    Returns
    -------
    (d,)
        NaN where a design has none.

    Raises
    ------
    UnknownNameError
        For an unknown name.
    InputError
        If no source has it.

    Examples
    --------
    >>> import numpy as np
    >>> figure_values("S", {"S": np.array([0.2, 0.1])})
    array([0.2, 0.1])
    """
    wanted = figure(name).name
    for source in sources:
        values = _lookup(source, wanted)
        if values is None:
            values = _lookup(getattr(source, "release", None), wanted)
        if values is not None:
            return np.asarray(values, dtype=np.float64)
    raise InputError(f"figure {wanted}: not among these results")


def _lookup(source: Any, name: str) -> Any:
    return source.get(name) if isinstance(source, Mapping) else getattr(source, name, None)


_OPERATORS: Final[Mapping[Operator, Callable[[FloatArray, float], Any]]] = {
    "<=": np.less_equal,
    "<": np.less,
    ">=": np.greater_equal,
    ">": np.greater,
}

_TEXT: Final = re.compile(r"\s*(?P<name>[A-Za-z]\w*)\s*(?P<operator><=|>=|<|>)\s*(?P<limit>[-+.\w]+)\s*")


@dataclasses.dataclass(frozen=True)
class Requirement:
    """What a design must meet to be ranked. Made with `parse_requirement`.

    Attributes
    ----------
    figure : Metric
    operator : {"<=", "<", ">=", ">"}
    limit : float
        In the metric's unit.
    """

    figure: Metric
    operator: Operator
    limit: float

    def met(self, values: npt.ArrayLike) -> BoolArray:
        """Where it is met, (d,); NaN, a metric that a design does not have, never is.

        Parameters
        ----------
        values : (d,)
            Of the metric.

        Examples
        --------
        >>> parse_requirement("S <= 0.5").met([0.4, 0.5, 0.6, float("nan")])
        array([ True,  True, False, False])
        """
        result: BoolArray = np.asarray(_OPERATORS[self.operator](np.asarray(values, dtype=np.float64), self.limit))
        return result

    @property
    def text(self) -> str:
        """The requirement with the metric's own name: ``"a_y_peak_p95 <= 3"``."""
        return f"{self.figure.name} {self.operator} {self.limit!r}".removesuffix(".0")


def parse_requirement(text: str) -> Requirement:
    """Read a requirement: a metric, an operator and a number, in this order.

    Raises
    ------
    UnknownNameError
        For an unknown metric; the message names the nearest.
    InputError
        For anything else that is no requirement; the message names the text and what is allowed.

    Examples
    --------
    >>> parse_requirement("ay_p95 <= 3.0").text
    'a_y_peak_p95 <= 3'
    """
    found = _TEXT.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        raise InputError(
            f"requirement {text!r}: cannot be read; allowed: a figure, one of {', '.join(_OPERATORS)}, "
            "and a number, as 'a_y_peak_p95 <= 3.0'"
        )
    try:
        wanted = figure(found["name"])
    except UnknownNameError as error:
        raise UnknownNameError(f"requirement {text!r}: {error}") from None
    try:
        limit = float(found["limit"])
    except ValueError:
        limit = math.nan
    lower, upper = {"share": (0.0, 1.0), "count": (0.0, math.inf)}.get(wanted.unit, (-math.inf, math.inf))
    if not (math.isfinite(limit) and lower <= limit <= upper):
        kind = {"share": "a share from 0 to 1", "count": "a number >= 0"}.get(wanted.unit, "a finite number")
        raise InputError(f"requirement {text!r}: the limit is {found['limit']}; allowed: {kind}")
    operator: Any = found["operator"]
    return Requirement(wanted, operator, limit + 0.0)
