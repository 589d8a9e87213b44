"""Figures of merit of a design by name, and requirements on them: ``"a_y_peak_p95 <= 3.0"``."""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Mapping
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, UnknownNameError, nearest
from studies.ranking.release import COLUMNS

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

Better = Literal["less", "more"]
Operator = Literal["<=", "<", ">=", ">"]

_SHARE = "share"
_COUNT = "count"


@dataclasses.dataclass(frozen=True)
class Figure:
    """One number that a design is judged by.

    Attributes
    ----------
    name : str
        What study files and `studies.Ranking` call it.
    unit : str
        SI unit; ``"share"`` for a part of departures from 0 to 1, ``"count"`` for a number of departures or commands,
        ``"1"`` for another pure number.
    better : {"less", "more"}
        Which way is good.
    column : str
        Its column in ``ranking.csv``.
    """

    name: str
    unit: str
    better: Better
    column: str


_MORE: Final = frozenset(
    (
        *("reduction", "reduction_left", "reduction_right"),
        *("dtle_mean", "dtle_p5", "dtle_min", "within_dtle", "back_inside", "comfortable"),
    )
)

_RANKED: Final = {
    **{name: f"{name}_m_s" for name in ("S", "S_left", "S_right", "S_p95", "S_cvar95")},
    **{name: name for name in ("reduction", "reduction_left", "reduction_right")},
    "deeper": "deeper_than_D_y_share",
    "triggered": "triggered_share",
    **{name: name for name in ("solver_failed", "diverged", "timed_out", "crashed", "failed_solves")},
}
"""Figures that a ranking holds itself -> their columns; the others are in `ReleaseFigures`."""

_UNITS: Final = {
    "_m_s": "m s",
    "_m": "m",
    "_s": "s",
    "_us": "us",
    "_m_s2": "m/s^2",
    "_m_s3": "m/s^3",
    "_rad": "rad",
    "_rad_s": "rad/s",
    "_rad2_s": "rad^2 s",
    "_share": _SHARE,
}
"""End of a column -> unit; the longest that fits counts."""

_COUNTS: Final = frozenset(("solver_failed", "diverged", "timed_out", "crashed", "failed_solves"))


def _unit(name: str, column: str) -> str:
    ends = [end for end in _UNITS if column.endswith(end)]
    return _UNITS[max(ends, key=len)] if ends else _COUNT if name in _COUNTS else "1"


FIGURES: Final[Mapping[str, Figure]] = {
    name: Figure(name, _unit(name, column), "more" if name in _MORE else "less", column)
    for name, column in {**_RANKED, **COLUMNS}.items()
}
"""Every figure by its name."""

_ALIASES: Final = {
    "ay_mean": "a_y_peak_mean",
    "ay_p95": "a_y_peak_p95",
    "ay_max": "a_y_peak_max",
    "jerk_mean": "jerk_peak_mean",
    "jerk_p95": "jerk_peak_p95",
    "jerk_max": "jerk_peak_max",
    "dtle_0p3_share": "within_dtle",
    "mean_S": "S",
    "effort": "effort_mean",
    "travel": "travel_mean",
    **{figure.column: figure.name for figure in FIGURES.values()},
}
"""Other names of the same figures; the columns of ``ranking.csv`` are among them."""


def figure(name: str) -> Figure:
    """The figure of a name, of an alias (``ay_p95``), or of a column of ``ranking.csv``.

    Raises
    ------
    UnknownNameError
        Naming the nearest figure.

    Examples
    --------
    >>> figure("ay_p95").name, figure("dtle_0p3_share").better
    ('a_y_peak_p95', 'more')
    """
    known = _ALIASES.get(name, name)
    if known not in FIGURES:
        # the beginning of another name, as ``ay``, is too short to be near to anything by its letters
        begun = next((target for alias, target in _ALIASES.items() if name and alias.startswith(name)), name)
        raise UnknownNameError(f"figure {name!r}: no such figure; {nearest(begun, FIGURES)}")
    return FIGURES[known]


def figure_values(name: str, *sources: Any) -> FloatArray:
    """Values of a figure, one a design.

    Parameters
    ----------
    name : str
        As `figure` takes it.
    *sources : Mapping or object
        Where to look, in this order: mappings by key, objects by attribute, then the attribute `release` of an object.
        A `studies.Ranking` holds all figures.

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
    figure : Figure
    operator : {"<=", "<", ">=", ">"}
    limit : float
        In the figure's unit.
    """

    figure: Figure
    operator: Operator
    limit: float

    def met(self, values: npt.ArrayLike) -> BoolArray:
        """Where it is met, (d,); NaN, a figure that a design does not have, never is.

        Parameters
        ----------
        values : (d,)
            Of the figure.

        Examples
        --------
        >>> parse_requirement("S <= 0.5").met([0.4, 0.5, 0.6, float("nan")])
        array([ True,  True, False, False])
        """
        result: BoolArray = np.asarray(_OPERATORS[self.operator](np.asarray(values, dtype=np.float64), self.limit))
        return result

    @property
    def text(self) -> str:
        """The requirement with the figure's own name: ``"a_y_peak_p95 <= 3"``."""
        return f"{self.figure.name} {self.operator} {self.limit!r}".removesuffix(".0")


def parse_requirement(text: str) -> Requirement:
    """Read a requirement: a figure, an operator and a number, in this order.

    Raises
    ------
    UnknownNameError
        For an unknown figure; the message names the nearest.
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
    lower, upper = {_SHARE: (0.0, 1.0), _COUNT: (0.0, math.inf)}.get(wanted.unit, (-math.inf, math.inf))
    if not (math.isfinite(limit) and lower <= limit <= upper):
        kind = {_SHARE: "a share from 0 to 1", _COUNT: "a number >= 0"}.get(wanted.unit, "a finite number")
        raise InputError(f"requirement {text!r}: the limit is {found['limit']}; allowed: {kind}")
    operator: Any = found["operator"]
    return Requirement(wanted, operator, limit + 0.0)


def check_figure(name: str) -> str:
    """The figure's own name.

    Raises
    ------
    InputError
        If there is no such figure.
    """
    try:
        return figure(name).name
    except UnknownNameError as error:
        raise InputError(str(error)) from None


def check_requirement(text: str) -> str:
    """The requirement in its canonical text.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        return parse_requirement(text).text
    except UnknownNameError as error:
        raise InputError(str(error)) from None
