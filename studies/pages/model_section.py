"""The scenario model: distances of the study's departures from the model and from its source departures."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, DepartureParameters, Departures
from ldctoolkit.diagnostics import ModelMarginal, kolmogorov_limit, model_marginal
from ldctoolkit.scenario_model import Given, ScenarioModel, SideModel, SideSummary, conditions
from ldctoolkit.scenario_model.model import Condition, meeting, mixture_conditions
from ldctoolkit.scenarios import Scenarios

from ..tables import Cell, Column, Row, Table, to_html
from ..text import compact, figure, parameter_label, percent, plural
from .context import Context
from .shell import Section, bullets, details, paragraphs

LEAST: Final = 30  # source departures for a comparison, as for a fit

_DRAWN: Final = 40_000
_KNOTS: Final = 4  # of a marginal distribution: its error of 0.0008 is far below the sampling error of any study


@dataclasses.dataclass(frozen=True)
class Gap:
    """A Kolmogorov distance and its critical value of 5 %, simultaneous over the parameters."""

    value: float
    limit: float

    @property
    def beyond(self) -> bool:
        """Whether the distance exceeds sampling error."""
        return self.value > self.limit


@dataclasses.dataclass(frozen=True)
class ParameterMatch:
    """A parameter: medians of generated and source departures, and distances to the model and to the source."""

    name: str
    median: float
    source_median: float
    to_model: Gap | None
    to_source: Gap | None


@dataclasses.dataclass(frozen=True)
class SideMatch:
    """A side: numbers of generated and source departures, its parameters, and why there is no source."""

    key: str
    generated: int
    source: int | None
    reason: str
    parameters: tuple[ParameterMatch, ...]


def match(
    scenarios: Scenarios, model: ScenarioModel | None, *, source: Departures | None = None, given: Given | None = None
) -> tuple[SideMatch, ...]:
    """Compare generated departures with the model and with its source departures."""
    limits = conditions(given)
    return tuple(
        _side_match(key, side, scenarios.take(np.flatnonzero(scenarios.side == side)), model, source, limits)
        for side, key in ((LEFT, "left"), (RIGHT, "right"))
        if (scenarios.side == side).any()
    )


def _side_match(
    key: str, side: int, scenarios: Scenarios, model: ScenarioModel | None, table: Departures | None,
    limits: tuple[Condition, ...],
) -> SideMatch:  # fmt: skip
    side_model = None if model is None else model.side(side)
    fitted = None if model is None else dict(model.provenance.sides).get(key)
    single = {condition.name for condition in limits if condition.low == condition.high}
    varies = (
        side_model.names
        if side_model is not None
        else tuple(n for n in PARAMETER_NAMES if np.ptp(getattr(scenarios, n)) > 0)
    )
    names = tuple(name for name in varies if name not in single)
    source = source_quantiles(side, names, table, fitted, limits)
    columns, count, effective = ({}, None, 0.0) if isinstance(source, str) else source
    margins = {} if side_model is None else _margins(side_model, limits, key)
    by_chance = [kolmogorov_limit(size, len(names)) if names and size else 1.0
              for size in (scenarios.n, scenarios.n * effective / (scenarios.n + effective))]  # fmt: skip
    rows = []
    for name in names:
        x = np.sort(np.asarray(getattr(scenarios, name), dtype=np.float64))
        to_model = Gap(_to_model(x, margins[name]), by_chance[0]) if name in margins else None
        quantiles = columns.get(name)
        to_source = None if quantiles is None else Gap(_to_quantiles(x, *quantiles), by_chance[1])
        middle = math.nan if quantiles is None else float(np.interp(0.5, quantiles[1], quantiles[0]))
        rows.append(ParameterMatch(name, float(np.median(x)), middle, to_model, to_source))
    return SideMatch(key, scenarios.n, count, source if isinstance(source, str) else "", tuple(rows))


def source_rows(side: int, table: DepartureParameters, limits: tuple[Condition, ...]) -> DepartureParameters:
    """The source departures of a side that meet the conditions."""
    return table.take((table.side == side) & meeting(table, limits))


def source_quantiles(
    side: int, names: tuple[str, ...], table: DepartureParameters | None, fitted: SideSummary | None,
    limits: tuple[Condition, ...],
) -> tuple[dict[str, tuple[FloatArray, FloatArray]], int, float] | str:  # fmt: skip
    """Quantiles of each parameter with shares, nominal and effective number of departures, or why there are none."""
    if table is not None:
        rows = source_rows(side, table, limits)
        if rows.n < LEAST:
            under = " that meet the study\u2019s conditions" if limits else ""
            return f"The departures table holds {rows.n} departures of this side{under}; {LEAST} are needed."
        share = np.arange(1, rows.n + 1) / rows.n
        columns = {name: (np.sort(np.asarray(getattr(rows, name), dtype=np.float64)), share) for name in names}
        return columns, rows.n, float(rows.n)
    summary = None if fitted is None else fitted.source_summary
    if summary is None:
        return "Source departures are not known: the model\u2019s file holds no summary of them."
    if limits:
        return "The model\u2019s file sums up all of its source departures, not those under the conditions."
    columns = {
        name: (np.array(summary.quantiles[summary.names.index(name)]), np.asarray(summary.probabilities))
        for name in names
        if name in summary.names
    }
    return columns, summary.departures, float(summary.effective)


def _margins(side_model: SideModel, limits: tuple[Condition, ...], key: str) -> dict[str, ModelMarginal]:
    """Marginal distributions of a side's mixture under the conditions; empty where these fix all values."""
    columns = mixture_conditions(limits, side_model, key)
    distribution = side_model.mixture.distribution
    if columns:
        if all(isinstance(value, float) for value in columns.values()) and len(columns) == len(side_model.names):
            return {}
        distribution = distribution.condition(columns)
    sample, _ = distribution.sample(_DRAWN, 0)
    if columns:  # under conditions the margins are those of the draws, to 0.003
        ends = np.array([0, _DRAWN]), np.array([0.0, 1.0])
        return {name: ModelMarginal(np.sort(sample[:, j]), *ends) for j, name in enumerate(side_model.names)}
    return {name: model_marginal(distribution, sample, j, _KNOTS) for j, name in enumerate(side_model.names)}


def _to_model(x: FloatArray, model: ModelMarginal) -> float:
    """Kolmogorov distance of ordered values from a distribution function."""
    u, step = model.cdf(x), np.arange(x.size + 1) / x.size
    return float(max((step[1:] - u).max(), (u - step[:-1]).max(), 0.0))


def _to_quantiles(x: FloatArray, quantiles: FloatArray, share: FloatArray) -> float:
    """Kolmogorov distance of ordered values from quantiles with their shares, taken at these quantiles."""
    return float(np.abs(np.searchsorted(x, quantiles, side="right") / x.size - share).max())


# ------------------------------------------------------------------------------------------------ the section


def section(context: Context) -> Section:
    """The section on the scenario model."""
    report = context.report
    matches = match(context.scenarios, report.model, source=report.source_departures, given=report.given)
    table = details("Parameter by parameter", to_html(_match_table(matches)))
    body = paragraphs(*_match_sentences(context, matches)) + table
    if report.model_notes:
        body += details("Where the departures come from", bullets(report.model_notes))
    return Section("model", "Scenario model", body)


def _match_sentences(context: Context, matches: tuple[SideMatch, ...]) -> Iterator[str]:
    report = context.report
    if report.model is not None:
        yield (
            f"The study scenarios were drawn from {report.model_name}; ldc fit writes the page that shows how well "
            "that model fits."
        )
    if report.given:
        conditions = (f"{name} {_condition_text(value)}" for name, value in report.given.items())
        yield f"Under the conditions: {', '.join(conditions)}."
    for side in matches:
        for what, gaps in (
            ("the model", {row.name: row.to_model for row in side.parameters if row.to_model}),
            ("the source departures", {row.name: row.to_source for row in side.parameters if row.to_source}),
        ):
            if not gaps:
                continue
            worst = max(gaps, key=lambda name: gaps[name].value / gaps[name].limit)
            verdict = "beyond sampling error" if gaps[worst].beyond else "within sampling error"
            of = f" ({side.source:,})" if side.source and what != "the model" else ""
            yield (
                f"{side.key.capitalize()}, {plural(side.generated, 'departure')} against {what}{of}: the largest gap "
                f"is in {worst}, {percent(gaps[worst].value)} of departures, {verdict} ({percent(gaps[worst].limit)})."
            )
        if side.reason:
            yield f"{side.key.capitalize()}: {side.reason}"


def _condition_text(value: object) -> str:
    if isinstance(value, tuple | list):
        low, high = (("" if end is None else compact(float(end))) for end in value)
        return f"{low} to {high}"
    return str(value)


def _match_table(matches: tuple[SideMatch, ...]) -> Table:
    columns = [
        Column("Parameter", text=True), Column("Side", text=True), Column("Median", form=figure),
        Column("Source median", form=figure), Column("Gap to the model", "%", ".1f"),
        Column("Gap to the source", "%", ".1f"),
    ]  # fmt: skip
    rows = []
    for side in matches:
        for row in side.parameters:
            gaps = (
                Cell(math.nan if gap is None else 100.0 * gap.value, bad=gap is not None and gap.beyond)
                for gap in (row.to_model, row.to_source)
            )
            rows.append(Row([parameter_label(row.name), side.key, row.median, row.source_median, *gaps]))
    return Table("Kolmogorov distances; highlighted: beyond sampling error", columns, rows)
