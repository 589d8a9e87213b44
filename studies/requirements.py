"""Metrics of a design by name or alias, requirements on them, ``"a_y_peak_p95 <= 3.0"``, and named sets of these."""

import dataclasses
import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, InstanceOf, PlainSerializer

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.code_content import from_file
from ldctoolkit.errors import InputError, UnknownNameError, nearest
from ldctoolkit.metrics import A_Y_LIMIT, JERK_LIMIT, MEAN_OF_ALL, METRICS, Metric, UserMetric, declare, user_rows
from ldctoolkit.plant_options import PlantOptions

from .standards import ADD_DRIVER, load_standard, standard_names

Operator = Literal["<=", "<", ">=", ">"]

_ALIASES: Final = {
    **{alias: metric.name for metric in METRICS.values() for alias in metric.aliases},
    **{metric.column: metric.name for metric in METRICS.values()},
}
"""Other names of the same metrics; the columns of ``ranking.csv`` are among them."""


def _user_metrics(entry: Any) -> Any:
    """Designers' metrics, as objects or as `UserMetric.content`; each of its own name."""
    metrics: list[UserMetric] = []
    for i, value in enumerate(entry if isinstance(entry, tuple) else (entry,)):
        row = UserMetric(**value) if isinstance(value, dict) and "code" in value else value
        if not isinstance(row, UserMetric):
            allowed = "a function with the decorator @ldc.metric(unit=...), or FILE.py:NAME of one"
            raise InputError(f"[{i}]", value=value, allowed=allowed)
        if row.name in (other.name for other in metrics):
            raise InputError(f"[{i}]", "is the name of two metrics", value=row.name, allowed="a name for each")
        metrics.append(declare(row))
    return tuple(metrics)


def loaded_metrics(entry: Any, folder: Path) -> list[Any]:
    """The entries of ``metrics``, those that are texts loaded from their files."""
    metrics = []
    for i, value in enumerate(entry if isinstance(entry, list | tuple) else [entry]):
        if isinstance(value, str):
            given = from_file(f"metrics[{i}]", value, folder, "FILE.py:NAME of a metric")
            value = dataclasses.replace(given, source=value) if isinstance(given, UserMetric) else given
        metrics.append(value)
    return metrics


UserMetrics = Annotated[
    tuple[InstanceOf[UserMetric], ...],
    BeforeValidator(_user_metrics),
    PlainSerializer(lambda metrics: [row.content() for row in metrics]),
]


def metric(name: str) -> Metric:
    """The metric of a name, of an alias (``ay_p95``), or of a column of ``ranking.csv``; or the score in a standard."""
    known, users = _ALIASES.get(name, name), user_rows()
    if known in users:
        return users[known]
    if known in standard_names():
        title, column = f"{load_standard(known).title}, cells passed", f"{known.replace('-', '_')}_share"
        return Metric(known, "share", "more", column, title, "lane", 1)
    if known not in METRICS:
        # the beginning of an alias, such as ``ay``, is too short to be compared by its letters
        begun = next((target for alias, target in _ALIASES.items() if name and alias.startswith(name)), name)
        known_names = (*METRICS, *users, *standard_names())
        raise UnknownNameError("metric", "is not a metric", value=name, hint=nearest(begun, known_names))
    return METRICS[known]


def criterion(name: str) -> Metric:
    """The metric of a design that `rank_by` stands for: S, or the mean of a designer's metric over all departures."""
    means = {row.of[0]: row for row in user_rows().values() if row.aggregate == MEAN_OF_ALL}
    if name != "S" and name not in means:
        raise InputError(value=name, allowed=("S", *means), hint="metrics of yours must be listed in metrics")
    return means.get(name, METRICS["S"])


def metric_values(name: str, source: Any) -> FloatArray:
    """Values of a metric of each design, (d,); NaN where a design has none.

    The source is a `ldctoolkit.Ranking`, its ``metrics``, or a mapping of names to values. Raises `UnknownNameError`
    for an unknown name; `InputError` for a metric that is not among them.
    """
    canonical, metrics = metric(name).name, getattr(source, "metrics", source)
    values = (metrics if isinstance(metrics, Mapping) else vars(metrics) | metrics.beside).get(canonical)
    if values is None:
        hint = ADD_DRIVER if metric(name).group == "driver" else ""
        raise InputError(f"metric {canonical}", "not among these results", hint=hint)
    return np.asarray(values, dtype=np.float64)


_OPERATORS: Final[Mapping[Operator, Callable[[FloatArray, float], Any]]] = {
    "<=": np.less_equal,
    "<": np.less,
    ">=": np.greater_equal,
    ">": np.greater,
}

_TEXT: Final = re.compile(r"\s*(?P<name>[A-Za-z][\w.-]*)\s*(?P<operator><=|>=|<|>)\s*(?P<limit>[-+.\w]+)\s*")


SETS: Final[Mapping[str, tuple[str, ...]]] = {
    "stable": ("lost <= 0", "gain_margin >= 2", f"phase_margin >= {math.radians(30.0)!r}"),
    "comfort": (f"a_y_added_peak_p95 <= {A_Y_LIMIT}", f"jerk_added_peak_p95 <= {JERK_LIMIT}"),
    "lane-edge": ("within_dtle_gain >= 0",),
    # Euro NCAP 2026, v1.1: overriding torque, of the 95 % quantile an assumption; its `AGAINST_LIMIT`; an assumption
    "acceptable": ("driver_torque_peak_p95 <= 3.0", "against_parallel_max <= 1.0", "handover_step_p95 <= 1.0"),
    "physical": (),
}
"""Named sets of requirements. ``physical`` depends on the plant: `requirements_of` creates it; ``acceptable`` needs a
driver."""

G: Final = 9.81  # acceleration of free fall [m/s^2]


@dataclasses.dataclass(frozen=True)
class Requirement:
    """What a design must meet. Created with `parse_requirement` or `requirements_of`."""

    metric: Metric
    operator: Operator
    limit: float  # In the metric's unit
    set: str = ""  # Name of the set that it belongs to; empty without a set

    def met(self, values: npt.ArrayLike) -> BoolArray:
        """Where it is met, (d,). A metric that a design does not have (NaN) never meets a requirement without a set.
        In a set it does: margins are those of linear loops, comfort is that of interventions, and a design without
        either cannot violate them.
        """
        array = np.asarray(values, dtype=np.float64)
        result: BoolArray = np.asarray(_OPERATORS[self.operator](array, self.limit)) | (
            np.isnan(array) & bool(self.set)
        )
        return result

    def excess(self, values: npt.ArrayLike) -> FloatArray:
        """How far values (d,) are beyond the limit, as a fraction of it, or in the metric's unit for a limit of 0. At
        most 0 where `met` is true, above 0 elsewhere, infinite for a metric that a design does not have.
        """
        array = np.asarray(values, dtype=np.float64)
        sign = 1.0 if self.operator in ("<", "<=") else -1.0
        with np.errstate(over="ignore"):  # an infinite excess is a valid result
            beyond = sign * (array - self.limit) / (abs(self.limit) or 1.0)
        beyond = np.where(np.isnan(beyond), np.inf, beyond)
        return np.where(self.met(array), np.minimum(beyond, 0.0), np.maximum(beyond, _MISSED))

    @property
    def text(self) -> str:
        """The requirement with the name of its metric: ``"a_y_peak_p95 <= 3"``."""
        return f"{self.metric.name} {self.operator} {self.limit!r}".removesuffix(".0")


_CLOSE: Final = 0.05  # share of a limit within which a value is close to it
_MISSED: Final = 1e-9  # least excess of a requirement that is missed: `"S < 0.5"` at exactly 0.5


@dataclasses.dataclass(frozen=True)
class Miss:
    """A requirement that a design misses, and the value it has instead."""

    requirement: Requirement
    value: float

    @property
    def excess(self) -> float:
        """How far the value is beyond the limit, see `Requirement.excess`."""
        return float(self.requirement.excess([self.value])[0])

    @property
    def text(self) -> str:
        """For a reader: ``"Peak added a_y, 95 % quantile 12.40 m/s², limit 3.00 m/s² (4.1 times)"``."""
        of, limit = self.requirement.metric, self.requirement.limit
        if math.isnan(self.value):
            return f"{of.title} not known, limit {_shown(of, limit)}"
        times = f" ({self.value / limit:.1f} times)" if limit > 0 and self.value > 1.05 * limit else ""
        return f"{of.title} {_shown(of, self.value)}, limit {_shown(of, limit)}{times}"

    @property
    def broken(self) -> str:
        """The requirement in the unit that readers see, and the value: ``"needless <= 50 % (52.1 %)"``."""
        of = self.requirement.metric
        value = "not known" if math.isnan(self.value) else _shown(of, self.value)
        return f"{of.name} {self.requirement.operator} {_limit(self.requirement)} ({value})"


@dataclasses.dataclass(frozen=True)
class Estimate(Miss):
    """The value of a limited metric, which may meet its limit, with the interval that the draw of scenarios leaves."""

    low: float  # NaN for a metric without an interval
    high: float
    required: bool
    fresh: bool  # Whether it is taken over the fresh scenarios

    @property
    def met(self) -> bool:
        """Whether the value meets the limit."""
        return bool(self.requirement.met([self.value])[0])

    @property
    def uncertain(self) -> bool:
        """Whether the limit lies inside the interval."""
        low, high = self.requirement.met([self.low, self.high]).tolist()
        return low != high and not math.isnan(self.low)

    @property
    def binds(self) -> bool:
        """Whether its interval reaches the limit, or the value lies within 5 % of it, unless it cannot be better."""
        of, limit = self.requirement.metric, self.requirement.limit
        best = limit in {"share": (0.0, 1.0), "count": (0.0,)}.get(of.unit, ())
        return self.low <= limit <= self.high or (not best and abs(self.value - limit) <= _CLOSE * abs(limit))

    @property
    def of_limit(self) -> str:
        """The value beside its limit: ``"Needless interventions 48.2 of 50 %"``."""
        of, least = self.requirement.metric, "at least " if self.requirement.operator in (">=", ">") else ""
        return f"{of.title} {_shown(of, self.value).partition(' ')[0]} of {least}{_limit(self.requirement)}"

    def with_interval(self, level: str) -> str:
        """The text with the interval, where there is one."""
        return f"{self.text}, {level} interval {self.interval}" if self.interval else self.text

    @property
    def interval(self) -> str:
        """For a reader: ``"4.70 to 5.20 m/s³"``; an end that too few departures leave unknown is open."""
        low, high = (_shown(self.requirement.metric, end) for end in (self.low, self.high))
        if math.isnan(self.low):
            return ""
        if math.isinf(self.low):
            return "not known" if math.isinf(self.high) else f"at most {high}"
        return f"at least {low}" if math.isinf(self.high) else f"{low.partition(' ')[0]} to {high}"


def _limit(of: Requirement) -> str:
    """A limit in the unit that readers see, with the digits that it has."""
    return f"{of.metric.scale * of.limit:g} {of.metric.shown_unit}".rstrip().replace("-", "\u2212")


def _shown(of: Metric, value: float) -> str:
    """A value with the digits and the unit that readers see."""
    return f"{of.scale * value:.{of.digits}f}{f' {of.shown_unit}' if of.shown_unit else ''}".replace("-", "\u2212")


def missed_by(requirements: Sequence[Requirement], metrics: Any) -> tuple[tuple[Miss, ...], ...]:
    """For every design the requirements that it does not meet."""
    missed: list[list[Miss]] = [[] for _ in metric_values("S", metrics)]
    for requirement in requirements:
        values = metric_values(requirement.metric.name, metrics)
        for i in np.flatnonzero(~requirement.met(values)).tolist():
            missed[i].append(Miss(requirement, float(values[i])))
    return tuple(tuple(misses) for misses in missed)


def friction(options: PlantOptions) -> float:
    """Largest lateral acceleration that tyres allow [m/s^2]: mu g of the plant, 1 g where its tyres are linear."""
    return G if options.tyres.ideal else G * options.tyres.mu * options.mismatch.mu[1]


def requirements_of(texts: Sequence[str], options: PlantOptions | None = None) -> tuple[Requirement, ...]:
    """Requirements of a list that may contain names of sets, without duplicates."""
    requirements: dict[str, Requirement] = {}
    for text in texts:
        if text in SETS:
            members = SETS[text]
            if text == "physical":
                members = (f"a_y_peak_max <= {friction(options or PlantOptions())!r}",)
            parsed = [dataclasses.replace(parse_requirement(member), set=text) for member in members]
        else:
            parsed = [parse_requirement(text)]
        for requirement in parsed:
            requirements.setdefault(requirement.text, requirement)
    return tuple(requirements.values())


def parse_requirement(text: str) -> Requirement:
    """Read a requirement: a metric, an operator and a number, in this order; or a standard: all its cells pass."""
    text = f"{text} >= 1" if text in standard_names() else text
    match = _TEXT.fullmatch(text) if isinstance(text, str) else None
    if match is None and isinstance(text, str) and re.fullmatch(r"[a-z0-9-]{3,}", text) and text not in _ALIASES:
        near = nearest(text, (*SETS, *standard_names()))
        raise UnknownNameError("requirement", "is not a set of requirements", value=text, hint=near)
    if match is None:
        raise InputError(
            "requirement",
            "cannot be read",
            value=text,
            allowed=f"a set ({', '.join(SETS)}), or a metric, one of {', '.join(_OPERATORS)}, and a number, "
            "as 'a_y_peak_p95 <= 3.0'",
        )
    try:
        target = metric(match["name"])
    except UnknownNameError as error:
        raise error.within(f"requirement {text!r}", ": ") from None
    try:
        limit = float(match["limit"])
    except ValueError:
        limit = math.nan
    lower, upper = {"share": (0.0, 1.0), "count": (0.0, math.inf)}.get(target.unit, (-math.inf, math.inf))
    if not (math.isfinite(limit) and lower <= limit <= upper):
        kind = {"share": "a share from 0 to 1", "count": "a number >= 0"}.get(target.unit, "a finite number")
        raise InputError(f"requirement {text!r}: limit", value=match["limit"], allowed=kind)
    operator: Any = match["operator"]
    return Requirement(target, operator, limit + 0.0)
