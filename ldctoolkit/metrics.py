"""Metrics: one table of what is measured beside S, what it is called and how it is shown, and the shares taken of it.

A designer's metric is a `UserMetric`, a row like any other that brings the function which measures it.

A metric of a scenario is a field of `MetricValues`, a row with its unit, title, digits and limit. A metric of a design
is a row of `METRICS`: most are aggregates of a metric of its scenarios, and take their unit and title from it. Columns
of the store and of ``ranking.csv``, names in requirements, axes and texts on pages follow from these rows.

S and the metrics of a scenario are computed in `simulation.kernel` (`exact_loop`, `rk4_loop`, `block_table`),
aggregates and shares here. Arrays of n scenarios, or of (d, n) for d designs: everything is taken along the last axis.
"""

import dataclasses
import hashlib
import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import BoolArray, FloatArray, unmasked
from ldctoolkit.code_content import content_of
from ldctoolkit.declared import checked_choice, checked_number
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.plant_options import PlantOptions

Better = Literal["less", "more"]
Over = Literal["all", "interventions"]

DTLE_LIMIT: Final = -0.3
"""Distance to lane edge [m] that is still allowed, 0.3 m beyond the line: Euro NCAP, Test Protocol - Lane Support
Systems; Commission Implementing Regulation (EU) 2021/646."""

A_Y_LIMIT: Final = 3.0
"""Largest lateral acceleration [m/s^2] that a lane keeping action may induce (ISO 11270:2014, 5.4)."""

JERK_LIMIT: Final = 5.0
"""Largest lateral jerk [m/s^3] that a lane keeping action may induce, averaged over 0.5 s (ISO 11270:2014, 5.4)."""

TAIL: Final = 0.8
"""Depth of the edge beyond the line [m] from which on a departure counts as one that went badly."""

AGAINST_LIMIT: Final = 1.0
"""Longest intervention [s] against the driver once the vehicle is parallel to the line (Euro NCAP 2026, v1.1)."""

JERK_WINDOW: Final = 0.5  # moving average [s] of the lateral jerk (ISO 11270)


# ------------------------------------------------------------------------------------------------ of a scenario


@dataclasses.dataclass(frozen=True)
class ScenarioMetric:
    """One number a scenario beside S: a row of the table, kept with the field of `MetricValues` that holds it."""

    unit: str
    title: str  # What a page calls it
    group: str  # A key of `GROUPS`
    digits: int  # Decimals on a page, in its shown unit
    over: Over = "interventions"  # Which scenarios it is about; aggregates are taken over these
    better: Better = "less"  # Which way is good
    limit: float = math.nan  # What a standard allows, NaN where none says anything
    short: str = ""  # Another beginning of its aggregates' names: ``ay_p95`` for ``a_y_peak_p95``

    def column(self, name: str) -> str:
        """The column of a table for it, or an aggregate of it, of that name."""
        return _column(name, self.unit)


_PURE: Final = ("ratio", "share", "count")  # units that no column's name ends with


def _column(name: str, unit: str) -> str:
    """A column with the unit at the end: ``a_y_peak_m_s2``."""
    return name if unit in _PURE else f"{name}_{unit.replace('/', '_').replace('^', '').replace(' ', '_')}"


def _row(*entries: Any, **options: Any) -> dict[str, ScenarioMetric]:
    """Metadata of a field of `MetricValues`: how its metric is called and shown."""
    return {"row": ScenarioMetric(*entries, **options)}


@dataclasses.dataclass(frozen=True)
class MetricValues:
    """What is reported beside S, one number a scenario: arrays of n, or of (d, n) for d designs.

    The first two are about the departure, [0, T]; the others about everything that was driven, [t_s, T + settle]. The
    compiled loops and the store hold them in this order.
    """

    deepest: FloatArray = field(metadata=_row("m", "Deepest crossing", "lane", 3, "all"))
    """Deepest position of the edge beyond the line [m]."""

    dtle: FloatArray = field(metadata=_row("m", "DTLE", "lane", 3, "all", better="more", limit=DTLE_LIMIT))
    """Smallest distance of the front axle's edge to the line [m], negative beyond it."""

    t_back: FloatArray = field(metadata=_row("s", "Back inside after", "back", 2))
    """Time since the departure's start at which the edge is first back inside after the trigger [s]; infinite where it
    is not back by the end."""

    opposite_crossing: FloatArray = field(metadata=_row("m", "Opposite line crossed by", "back", 3, short="overshoot"))
    """How far the opposite edge gets beyond the opposite line [m]; 0 where it does not."""

    a_y_peak: FloatArray = field(metadata=_row("m/s^2", "Peak a_y", "comfort", 2, short="ay"))
    """Largest lateral acceleration [m/s^2], that of the bend included."""

    jerk_peak: FloatArray = field(metadata=_row("m/s^3", "Peak lateral jerk", "comfort", 2, short="jerk"))
    """Largest lateral jerk, as a moving average over 0.5 s [m/s^3]."""

    a_y_added_peak: FloatArray = field(
        metadata=_row("m/s^2", "Peak added a_y", "comfort", 2, limit=A_Y_LIMIT, short="ay_added")
    )
    """Largest excess of |a| over |y''| of the recorded path at the same time [m/s^2], with a = a_y - v^2 c."""

    jerk_added_peak: FloatArray = field(
        metadata=_row("m/s^3", "Peak added jerk", "comfort", 2, limit=JERK_LIMIT, short="jerk_added")
    )
    """The same of da/dt and y''', each as a moving average over 0.5 s [m/s^3]."""

    delta_peak: FloatArray = field(metadata=_row("rad", "Steering angle", "steering", 2))
    """Largest steering angle of the wheel [rad]."""

    delta_rate_peak: FloatArray = field(metadata=_row("rad/s", "Steering rate", "steering", 1))
    """Largest change of that angle from one sample to the next, over dt [rad/s]."""

    effort: FloatArray = field(metadata=_row("rad^2 s", "Steering effort", "steering", 3))
    """Integral of the squared steering angle [rad^2 s]."""

    travel: FloatArray = field(metadata=_row("rad", "Steering travel", "steering", 2))
    """Sum of the changes of the steering angle, without their signs [rad]."""

    # with a driver at the wheel; NaN without one
    driver_torque_peak: FloatArray = field(metadata=_row("N m", "Peak driver torque", "driver", 2))
    """Largest torque of the driver at the steering wheel [N m]."""

    driver_torque_mean: FloatArray = field(metadata=_row("N m", "Mean driver torque", "driver", 2))
    """Mean of that torque without its sign, from the trigger on [N m]."""

    against_time: FloatArray = field(metadata=_row("s", "Time against the driver", "driver", 2))
    """How long the driver's torque was beyond 1 N m against that of the assist [s]."""

    against_parallel: FloatArray = field(
        metadata=_row("s", "Against the driver, longest once parallel", "driver", 2, limit=AGAINST_LIMIT)
    )
    """The longest such stretch after the vehicle was first parallel to the line [s]."""

    overridden: FloatArray = field(metadata=_row("share", "Overridden", "driver", 1))
    """1 where the driver overrode the assist, else 0."""

    handover_step: FloatArray = field(metadata=_row("N m", "Torque step at hand-over", "driver", 2))
    """Largest change of the assist's torque within 0.1 s as it hands over, overridden or at the end [N m]."""


SCENARIO_METRICS: Final[Mapping[str, ScenarioMetric]] = {
    column.name: column.metadata["row"] for column in dataclasses.fields(MetricValues)
}
"""Every metric of a scenario beside S by its name."""

METRIC_UNITS: Final = {name: row.unit for name, row in SCENARIO_METRICS.items()}  # metric of a scenario -> its unit

DRIVER_METRICS: Final = tuple(name for name, row in SCENARIO_METRICS.items() if row.group == "driver")
"""The metrics of a scenario that need a driver at the wheel; NaN without one."""

METRIC_COLUMNS: Final = {name: _column(name, row.unit) for name, row in SCENARIO_METRICS.items()}
"""Metric of a scenario -> its column in a stored table, the unit at the end: ``a_y_peak_m_s2``."""


# ------------------------------------------------------------------------------------------------ of a design

GROUPS: Final[Mapping[str, str]] = {
    "score": "Score",
    "lane": "In the lane, all departures",
    "back": "Back to the lane, interventions",
    "comfort": "Comfort, interventions",
    "steering": "Steering, interventions",
    "driver": "Driver at the wheel, interventions",
    "interventions": "Interventions",
    "loop": "Linear loop",
    "failures": "Failures",
}
"""Which metrics belong together, in the order to be shown."""

_SHOWN_UNITS: Final[Mapping[str, tuple[float, str]]] = {
    "share": (100.0, "%"),
    "ratio": (1.0, ""),
    "1": (100.0, "%"),  # a reduction
    "count": (1.0, ""),
    "rad": (math.degrees(1.0), "°"),
    "rad/s": (math.degrees(1.0), "°/s"),
    "rad^2 s": (math.degrees(1.0) ** 2, "°²·s"),
    "m s": (1.0, "m·s"),
    "N m": (1.0, "N·m"),
    "m/s^2": (1.0, "m/s²"),
    "m/s^3": (1.0, "m/s³"),
}
"""Unit -> factor and unit on a page; others stand as they are."""

MEAN_OF_ALL: Final = "mean_all"
"""The aggregate that designs can be ranked by: the mean over all departures, with or without an intervention."""

_AGGREGATES: Final[Mapping[str, str]] = {
    "mean": "mean", "median": "median", "min": "least", "max": "largest", MEAN_OF_ALL: "mean of all departures"
}  # fmt: skip
"""Aggregate -> end of a title; ``p95`` is the 95 % quantile."""


@dataclasses.dataclass(frozen=True)
class Interventions:
    """Where d designs took over (d, n), the depth of the departures without control (n,), and what counts as deep."""

    acted: BoolArray
    d_y: FloatArray
    D_y: float


@dataclasses.dataclass(frozen=True)
class Metric:
    """One number that a design is judged by."""

    name: str  # What study files and `ldctoolkit.Ranking` call it
    # SI unit; ``"share"`` for a part of departures from 0 to 1, ``"count"`` for a number of departures or commands,
    # ``"ratio"`` for a factor, ``"1"`` for another pure number
    unit: str
    better: Better  # Which way is good
    column: str  # Its column in ``ranking.csv``
    title: str  # What a page calls it
    group: str  # A key of `GROUPS`
    digits: int  # Decimals on a page, in its shown unit
    aliases: tuple[str, ...] = ()  # Other names beside the column
    of: tuple[str, ...] = ()  # The metrics of a scenario that it is taken from
    # ``"mean"``, ``"mean_all"``, ``"median"``, ``"min"``, ``"max"``, or a quantile as ``"p95"``; empty for a share and
    # for what comes from elsewhere
    aggregate: str = ""
    over: Over = "all"  # Which scenarios an aggregate is taken over
    # Of `Interventions` and the values of the metrics `of`, (d, n) each; gives (d,)
    share: Callable[..., Any] | None = None

    @property
    def scale(self) -> float:
        """Factor from the SI number to the number that a page shows."""
        return _SHOWN_UNITS.get(self.unit, (1.0, self.unit))[0]

    @property
    def shown_unit(self) -> str:
        """The unit that a page shows, such as per cent or degrees."""
        return _SHOWN_UNITS.get(self.unit, (1.0, self.unit))[1]

    @property
    def label(self) -> str:
        """Title and unit, for an axis."""
        return f"{self.title} [{self.shown_unit}]" if self.shown_unit else self.title

    def column_of(self, name: str) -> str:
        """A column of that name in the unit of the metric."""
        return _column(name, self.unit)


def _of(
    name: str, *aggregates: str, title: str = "", alias: str = "", row: ScenarioMetric | None = None
) -> Iterator[Metric]:
    """The rows of a design's table that are aggregates of a scenario's metric."""
    row = row or SCENARIO_METRICS[name]
    for aggregate in aggregates:
        full, end = f"{name}_{aggregate}", _AGGREGATES.get(aggregate, f"{aggregate[1:]} % quantile")
        aliases = tuple(text for text in (alias, row.short and f"{row.short}_{aggregate}") if text)
        label, column = title or f"{row.title}, {end}", _column(full, row.unit)
        over: Over = "all" if aggregate == MEAN_OF_ALL else row.over
        more = row.group, row.digits, aliases, (name,), aggregate, over
        yield Metric(full, row.unit, row.better, column, label, *more)


def _share(
    name: str, title: str, group: str, of: tuple[str, ...] = (), share: Callable[..., Any] | None = None, **options: Any
) -> Metric:
    """The row of a share of the departures, or of the interventions."""
    defaults: dict[str, Any] = {"better": "less", "column": f"{name.removesuffix('_share')}_share", "digits": 1}
    return Metric(name=name, unit="share", title=title, group=group, of=of, share=share, **(defaults | options))


def _score(name: str, title: str, *alias: str) -> Metric:
    """Row of a score in m s."""
    return Metric(name, "m s", "less", f"{name}_m_s", title, "score", 3, alias)


def _reduction(name: str, title: str) -> Metric:
    return Metric(name, "1", "more", name, title, "score", 1)


def _count(name: str, title: str) -> Metric:
    """Row of a number of failures."""
    return Metric(name, "count", "less", name, title, "failures", 0)


def _metrics_by_name(*rows: Metric) -> dict[str, Metric]:
    return {row.name: row for row in rows}


_RANKED: Final = _metrics_by_name(
    _score("S", "Mean S", "mean_S"),
    _score("S_left", "Mean S, left"),
    _score("S_right", "Mean S, right"),
    _score("S_p95", "S, 95 % quantile"),
    _score("S_cvar95", "S, mean of the worst 5 %"),
    _reduction("reduction", "Mean S saved against no control"),
    _reduction("reduction_left", "Saved, left"),
    _reduction("reduction_right", "Saved, right"),
    _share("deeper", "Deeper than D_y", "lane", ("deepest",), lambda by, deepest: share_deeper(deepest, by.D_y),
           column="deeper_than_D_y_share"),
    _share("triggered", "Taken over", "interventions"),
    _count("solver_failed", "Departures with a failed solve"),
    _count("diverged", "Departures that diverged"),
    _count("timed_out", "Departures that timed out"),
    _count("crashed", "Departures that crashed"),
    _count("beyond_delta_max", "Takeovers beyond delta_max"),
    _count("failed_solves", "Failed solves [commands]"),
)  # fmt: skip

RELEASE_METRICS: Final[Mapping[str, Metric]] = _metrics_by_name(
    *_of("deepest", "mean", "p95"),
    *_of("dtle", "mean", "p5"),
    *_of("dtle", "min", title="DTLE at its worst"),
    _share("tail_0p8", "Deeper than 0.8 m", "lane", ("deepest",), lambda _, deepest: share_deeper(deepest, TAIL),
           digits=2, aliases=("tail_0.8",)),
    _share("within_dtle", "DTLE stays above \u22120.3 m", "lane", ("dtle",), lambda _, dtle: share_within_dtle(dtle),
           better="more", aliases=("dtle_0p3_share",)),
    Metric("within_dtle_gain", "1", "more", "within_dtle_gain", "The same, more than without control", "lane", 1),
    _share("needless", "Needless interventions", "interventions", (), lambda by: needless_share(by.acted, by.d_y)),
    _share("opposite_crossed_share", "Opposite line crossed", "back", ("opposite_crossing",),
           lambda by, past: opposite_crossed_share(past, by.acted), aliases=("overshoot_share",)),
    *_of("opposite_crossing", "max", title="Opposite line crossed by at most", alias="overshoot_max_m"),
    _share("back_inside", "Back inside", "back", ("t_back",), lambda by, t_back: back_inside_share(t_back, by.acted),
           better="more"),
    *_of("t_back", "median"),
    *_of("a_y_peak", "mean", "p95", "max"),
    *_of("jerk_peak", "mean", "p95", "max"),
    *_of("a_y_added_peak", "mean", "p95", "max"),
    *_of("jerk_added_peak", "mean", "p95", "max"),
    _share("comfortable", "Both limits of ISO 11270 kept", "comfort", ("a_y_added_peak", "jerk_added_peak"),
           lambda by, a_y, jerk: comfortable_share(a_y, jerk, by.acted), better="more"),
    *_of("delta_peak", "max"),
    *_of("delta_rate_peak", "max"),
    *_of("effort", "mean", alias="effort"),
    *_of("travel", "mean", alias="travel"),
    *_of("driver_torque_peak", "mean", "p95", "max"),
    *_of("driver_torque_mean", "mean"),
    *_of("against_time", "mean", "p95"),
    *_of("against_parallel", "p95", "max"),
    *_of("overridden", "mean", title="Overridden by the driver", alias="overridden_share"),
    *_of("handover_step", "p95", "max"),
    _count("lost", "Departures that diverged though friction allows their recorded path"),
    Metric("gain_margin", "ratio", "more", "gain_margin", "Gain margin, least over speed", "loop", 2),
    Metric("phase_margin", "rad", "more", "phase_margin_rad", "Phase margin, least over speed", "loop", 1),
    _score("S_worst", "Mean S, worst of the named vehicles"),
    _share("comfortable_worst", "Comfortable, worst of the named vehicles", "comfort", better="more"),
)  # fmt: skip
"""What a release requires beside S, by its name, in the order of ``ranking.csv``."""

METRICS: Final[Mapping[str, Metric]] = {**_RANKED, **RELEASE_METRICS}  # every metric of a design by its name

_Row = TypeVar("_Row", ScenarioMetric, Metric)


def measured_on(options: PlantOptions | None, rows: Mapping[str, _Row]) -> dict[str, _Row]:
    """The rows whose metrics a run on a plant has: those of a driver only where one holds the wheel."""
    driver = options is not None and not options.driver.ideal
    return {name: row for name, row in rows.items() if driver or row.group != "driver"}


# ------------------------------------------------------------------------------------------------ of a designer

USER_GROUP: Final = "user"  # `Metric.group` of designers' metrics
USER_AGGREGATES: Final = ("mean", MEAN_OF_ALL, "median", "p5", "p95", "min", "max")


@dataclasses.dataclass(frozen=True)
class UserMetric(ScenarioMetric):
    """A designer's metric of a scenario, made with `metric`; called with `Paths` of n scenarios it gives (n,)."""

    name: str = ""
    code: str = ""  # Content of the function: edited, it is another metric
    source: str = ""  # How a study file names it; empty where it was given as an object
    function: Callable[[Any], Any] | None = field(default=None, compare=False, repr=False)

    def __call__(self, paths: Any) -> Any:
        """What the function gives; `LdcError` where only the stored numbers of the metric are known."""
        if self.function is None:
            hint = "run the study from its file, or with the metric itself"
            raise LdcError(f"metric {self.name}", "its function was edited, or is not loaded", hint=hint)
        return self.function(paths)

    def content(self) -> dict[str, Any]:
        """All but the function, in plain JSON types."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in ("function", "limit")}

    @property
    def rows(self) -> dict[str, Metric]:
        """The metrics of a design that are its aggregates, by their names; the mean has the metric's own name too."""
        mean = _of(self.name, "mean", alias=self.name, row=self)
        return {row.name: row for row in (*mean, *_of(self.name, *USER_AGGREGATES[1:], row=self))}


_functions: dict[tuple[str, str], Callable[[Any], Any]] = {}  # of designers' metrics by name and content
_user_rows: dict[str, dict[str, Metric]] = {}  # a designer's metric -> its rows


def declare(metric: UserMetric) -> UserMetric:
    """Make the rows of a designer's metric known; one without its function gets it, where this process has met it."""
    function = metric.function or _functions.get((metric.name, metric.code))
    if function is not None:
        _functions[metric.name, metric.code] = function
    metric = dataclasses.replace(metric, function=function)
    _user_rows[metric.name] = metric.rows
    return metric


def user_rows() -> dict[str, Metric]:
    """Rows of all designers' metrics that are known by name, alias and column."""
    rows = [row for rows in _user_rows.values() for row in rows.values()]
    return {name: row for row in rows for name in (row.name, row.column, *row.aliases)}


def metric(
    *, unit: str, title: str = "", better: Better = "less", over: Over = "interventions", digits: int = 3
) -> Callable[[Callable[[Any], Any]], UserMetric]:
    """Make a metric of a function of `Paths`; used as a decorator, in a study as ``metrics=[...]``.

    Raises `InputError` for a name that a metric of the toolkit has, and for arguments outside what is allowed.

    Parameters
    ----------
    unit : str
        SI unit, ``"m/s^2"``; ``"ratio"`` for a pure number, ``"share"`` for a part from 0 to 1, ``"count"``.
    title : str
        What tables and axes call it; the function's name by default.
    better : {"less", "more"}
        Which way is good.
    over : {"interventions", "all"}
        Which departures its aggregates are taken over: those where the design took over, or all.
    digits : int
        Decimals in tables.

    Examples
    --------
    >>> import numpy as np
    >>> import ldctoolkit as ldc
    >>> @ldc.metric(unit="m", title="Widest offset")
    ... def widest(paths):
    ...     return np.nanmax(np.abs(paths.e_y), axis=1)
    >>> study = ldc.study(ldc.LQR, left=5, right=5, metrics=[widest], require="widest_p95 <= 2.0")
    >>> results = ldc.run_study(study, workers=1)
    >>> results.user_metrics["widest"].shape
    (1, 10)
    """
    for name, text in (("unit", unit), ("title", title)):
        if not isinstance(text, str):
            raise InputError(f"metric: {name}", value=text, allowed="text")
    checked_choice("metric: better", better, get_args(Better))
    checked_choice("metric: over", over, get_args(Over))

    def made(function: Callable[[Any], Any]) -> UserMetric:
        name = getattr(function, "__name__", "")
        if not callable(function) or not name.isidentifier():
            raise InputError("metric", value=function, allowed="a function with a name, of Paths")
        taken = {*SCENARIO_METRICS, *METRICS, *itertools.chain(*((m.column, *m.aliases) for m in METRICS.values()))}
        if taken & {name, *(f"{name}_{aggregate}" for aggregate in USER_AGGREGATES)}:
            raise InputError("metric", "is the name of a metric of the toolkit", value=name, hint="choose another")
        # which way is good decides what counts in a departure that failed
        code = hashlib.sha256(f"{content_of(function)} {better}".encode()).hexdigest()[:16]
        si_unit, shown = "ratio" if unit in ("", "1") else unit, title or name.replace("_", " ")
        return UserMetric(si_unit, shown, USER_GROUP, digits, over, better, name=name, code=code, function=function)

    return made


# ------------------------------------------------------------------------------------------------ reduction and shares


def reduction(S: FloatArray, S_uncorrected: FloatArray) -> FloatArray:
    """Reduction 1 - S/S_uncorrected, per scenario, (n,); 0 where there was nothing to reduce.

    Examples
    --------
    >>> reduction(np.array([0.25, 0.5]), np.array([1.0, 0.0]))
    array([0.75, 0.  ])
    """
    ratio = np.divide(S, S_uncorrected, out=np.ones_like(S), where=~(S_uncorrected <= 0))
    return 1.0 - ratio


# Three rules hold for every share. It is taken along the last axis: of arrays of n it is a float, of (d, n) (d,). A
# share of all scenarios is 0 where there are none; a share of the interventions, of the scenarios that `triggered`, is
# NaN without any, since it is then a share of nothing. And no scenario is dropped in silence: a NaN among the values
# counted gives NaN. Each raises `InputError` for shapes that do not fit, and for a limit that is no number.


def share_deeper(deepest: npt.ArrayLike, D_y: float) -> float | FloatArray:
    """Share of all departures whose deepest position [m] is deeper than D_y [m] beyond the line; Table I has 0.5 m.

    Examples
    --------
    >>> share_deeper([0.2, 0.5, 0.7, 0.8], 0.5)
    0.5
    """
    (values,) = _of_one_shape(deepest=deepest)
    return _fraction(values > checked_number("D_y", D_y, finite=False), np.isnan(values))


def share_within_dtle(dtle: npt.ArrayLike, limit: float = DTLE_LIMIT) -> float | FloatArray:
    """Share of all scenarios whose smallest distance to lane edge [m], negative beyond it, is not below a limit.

    Examples
    --------
    >>> share_within_dtle([0.1, -0.3, -0.31, -0.5])
    0.5
    """
    (values,) = _of_one_shape(dtle=dtle)
    return _fraction(values >= checked_number("limit", limit, finite=False), np.isnan(values))


def comfortable(
    a_y_added_peak: npt.ArrayLike,
    jerk_added_peak: npt.ArrayLike,
    a_y_limit: float = A_Y_LIMIT,
    jerk_limit: float = JERK_LIMIT,
) -> BoolArray:
    """Which interventions induce no more than ISO 11270 allows: both added peaks within their limits; False for a NaN.

    Acceleration in m/s^2, jerk in m/s^3 as a moving average over 0.5 s; (n,) or (d, n) each, as is what is returned.

    Examples
    --------
    >>> comfortable([3.0, 1.0, 4.0], [5.0, 6.0, 1.0])
    array([ True, False, False])
    """
    a_y, jerk = _of_one_shape(a_y_added_peak=a_y_added_peak, jerk_added_peak=jerk_added_peak)
    a_y_kept = a_y <= checked_number("a_y_limit", a_y_limit, finite=False)
    result: BoolArray = a_y_kept & (jerk <= checked_number("jerk_limit", jerk_limit, finite=False))
    return result


def comfortable_share(
    a_y_added_peak: npt.ArrayLike,
    jerk_added_peak: npt.ArrayLike,
    triggered: npt.ArrayLike,
    a_y_limit: float = A_Y_LIMIT,
    jerk_limit: float = JERK_LIMIT,
) -> float | FloatArray:
    """Share of the interventions that are `comfortable`.

    Examples
    --------
    >>> comfortable_share([3.0, 1.0, 0.0], [5.0, 6.0, 0.0], [True, True, False])
    0.5
    """
    a_y, jerk, flags = _of_one_shape(
        a_y_added_peak=a_y_added_peak, jerk_added_peak=jerk_added_peak, triggered=triggered
    )
    return _fraction(comfortable(a_y, jerk, a_y_limit, jerk_limit), np.isnan(a_y) | np.isnan(jerk), flags)


def needless(triggered: npt.ArrayLike, d_y: npt.ArrayLike, limit: float = DTLE_LIMIT) -> BoolArray:
    """Which interventions were needless: triggered, though the recorded departure keeps the lane-edge limit itself.

    That is, -d_y >= limit, with the peak d_y (n,) [m] of the recorded departure beyond the line and the distance to the
    lane edge that is allowed [m], negative beyond it; False for a NaN. `triggered` is (n,) or (d, n), as is the result.

    Examples
    --------
    >>> needless([True, True, False], [0.3, 0.4, 0.1])
    array([ True, False, False])
    """
    depth, flags = _of_one_shape(d_y=d_y, triggered=triggered)
    result: BoolArray = flags & (-depth >= checked_number("limit", limit, finite=False))
    return result


def needless_share(triggered: npt.ArrayLike, d_y: npt.ArrayLike, limit: float = DTLE_LIMIT) -> float | FloatArray:
    """Share of all scenarios in which the intervention was `needless`.

    Not of the interventions, so that a design cannot make it smaller by triggering more. A scenario that cannot be
    driven counts as not taken over: leave such rows out.

    Examples
    --------
    >>> needless_share([True, True, False, False], [0.3, 0.4, 0.1, 0.9])
    0.25
    """
    depth, flags = _of_one_shape(d_y=d_y, triggered=triggered)
    return _fraction(needless(flags, depth, limit), flags & np.isnan(depth))


def back_inside_share(t_back: npt.ArrayLike, triggered: npt.ArrayLike) -> float | FloatArray:
    """Share of the interventions after which the edge is back inside by the end: `t_back` [s] is not infinite.

    Examples
    --------
    >>> back_inside_share([2.5, float("inf"), 4.0], [True, True, False])
    0.5
    """
    time, flags = _of_one_shape(t_back=t_back, triggered=triggered)
    return _fraction(np.isfinite(time), np.isnan(time), flags)


def opposite_crossed_share(opposite_crossing: npt.ArrayLike, triggered: npt.ArrayLike) -> float | FloatArray:
    """Share of the interventions that take the vehicle beyond the opposite line: opposite_crossing > 0 [m].

    Examples
    --------
    >>> opposite_crossed_share([0.2, 0.0, 0.0], [True, True, False])
    0.5
    """
    past, flags = _of_one_shape(opposite_crossing=opposite_crossing, triggered=triggered)
    return _fraction(past > 0, np.isnan(past), flags)


def _fraction(holds: BoolArray, unknown: BoolArray, interventions: BoolArray | None = None) -> float | FloatArray:
    """Share of all, or of the interventions."""
    among, of_none = (np.ones_like(holds), 0.0) if interventions is None else (interventions, np.nan)
    total = np.sum(among, axis=-1)
    count = np.sum(holds & among, axis=-1)
    share = np.divide(count, total, out=np.full(total.shape, of_none), where=total > 0)
    share = np.where(np.any(unknown & among, axis=-1), np.nan, share)
    return float(share) if share.ndim == 0 else share


def _of_one_shape(**named: npt.ArrayLike) -> tuple[Any, ...]:
    """Arguments as arrays of one shape: floats, and booleans for `triggered`."""
    arrays = []
    for name, values in named.items():
        try:
            array = np.asarray(unmasked(values), dtype=None if name == "triggered" else np.float64)
        except (TypeError, ValueError):
            raise InputError(name, "not an array of numbers") from None
        if name == "triggered" and array.size and (array.dtype != np.bool_ or np.ma.is_masked(values)):
            masked = " with masked entries" if np.ma.is_masked(values) else ""
            raise InputError("triggered", f"an array of {array.dtype}{masked}", allowed="booleans")
        arrays.append(array.astype(bool) if name == "triggered" else array)
    shapes = {array.shape for array in arrays}
    largest = max(shapes, key=len)
    if not largest or any(shape not in (largest, largest[-1:]) for shape in shapes):
        text = ", ".join(f"{name} {array.shape}" for name, array in zip(named, arrays, strict=True))
        raise InputError("shapes", text, allowed="(n,) or (d, n), with the same n")
    return tuple(np.broadcast_to(array, largest) for array in arrays)
