"""The input of a report, and the context that its sections share."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import InputError
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup

from ..ranking.ranking import Ranking
from ..ranking.verdict import StepTimes, Verdict, verdict
from ..requirements import metric, metric_values
from ..results import StudyResults
from ..text import number
from .charts import Style, law_styles

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures
    from ldctoolkit.scenario_model import Given, ScenarioModel

    from ..robustness import Robustness
    from ..sensitivity.sensitivity import BlockSensitivity

MOST_CURVES = 5  # designs in one chart of curves

SIDE_NAMES = {LEFT: "left", -LEFT: "right"}


@dataclasses.dataclass(frozen=True)
class ReportInput:
    """The content of a report. Strings are plain text; the report escapes them."""

    title: str  # For people
    study_name: str  # The study's short name
    results: StudyResults  # Scores of all designs
    ranking: Ranking  # Of these results
    # How scenarios were driven; example paths are simulated again with it
    setup: Setup = dataclasses.field(default_factory=Setup)
    settings: tuple[tuple[str, str], ...] = ()  # The study's settings, seeds and hashes, in the order to be shown
    versions: tuple[tuple[str, str], ...] = ()  # Software and machine
    model_notes: tuple[str, ...] = ()  # The origin of the scenario model
    warnings: tuple[str, ...] = ()  # Facts that the reader must know first
    synthetic: bool = False  # Whether the scenario model was fitted to invented and not to recorded driving
    command: str = ""  # The command that repeats the study
    study_file: str = ""  # Text of a study file that repeats it, with every default written out
    departures: tuple[int, ...] = ()  # Numbers of departures that the explorer shows in addition
    shown_designs: tuple[str, ...] = ()  # Identifiers, or their beginnings, of designs that it shows in addition
    sensitivity: tuple[BlockSensitivity, ...] = ()  # Sensitivity of S to gains; empty leaves that part out
    robustness: Robustness | None = None  # Designs on other plants; None if they were not simulated
    # Median and 99 % quantile of the time of a law's step [s], by identifier, of the designs that were timed
    step_times: StepTimes = dataclasses.field(default_factory=dict)
    model: ScenarioModel | None = None  # The model that generated the scenarios
    model_name: str = ""  # Its name; empty where no model generated them
    given: Given = dataclasses.field(default_factory=dict)  # Conditions that they were drawn under
    # The departures that the model was fitted to; without them the report uses the summary in the model's file
    source_departures: Departures | None = None
    folder: Path | None = None  # Folder of the study, which stores results of simulations for the report


@dataclasses.dataclass(frozen=True)
class Context:
    """The input of a report, restricted to scenarios that can be driven under every design."""

    report: ReportInput
    every: int  # Number of all scenarios, those that cannot be driven included

    @classmethod
    def of(cls, report: ReportInput) -> Self:
        """Check and restrict the input."""
        results = report.results
        if not results.designs or results.scenarios.n == 0:
            raise InputError("report", "the results hold no designs or no scenarios", allowed="at least one of each")
        every, results = results.scenarios.n, results.on_drivable()
        if results.scenarios.n == 0:
            raise InputError(
                "report", "no scenario could be driven under every design", hint="there is nothing to report on"
            )
        return cls(dataclasses.replace(report, results=results), every)

    @property
    def ranking(self) -> Ranking:
        """The ranking of the results."""
        return self.report.ranking

    @property
    def results(self) -> StudyResults:
        """The results on the scenarios that can be driven."""
        return self.report.results

    @property
    def scenarios(self) -> Scenarios:
        """The n scenarios that can be driven."""
        return self.report.results.scenarios

    @cached_property
    def verdict(self) -> Verdict:
        """The verdict on the ranking."""
        return verdict(self.ranking, self.report.results, self.report.setup, self.report.robustness, self.report.model)

    @property
    def shown(self) -> int:
        """Position of the design that the page discusses: the winner, else the design that the verdict names."""
        return self.verdict.position

    @property
    def shown_name(self) -> str:
        """The phrase for the shown design in a sentence."""
        if self.ranking.winner is not None:
            return "the winner"
        return "the first of the ranking" if self.ranking.ranked else "the nearest design"

    @cached_property
    def best_of_each_law(self) -> tuple[int, ...]:
        """Positions of the best design of each law that intervenes, the shown design first."""
        ranking, positions = self.ranking, dict.fromkeys((self.shown,))
        laws = {ranking.designs[self.shown].law}
        for position in ranking.best_of_each_law():
            if ranking.designs[position].law not in laws:
                laws.add(ranking.designs[position].law)
                positions[position] = None
        return tuple(position for position in positions if not ranking.designs[position].is_baseline)

    @cached_property
    def styles(self) -> dict[str, Style]:
        """The style of each law; that of the shown design is solid."""
        first = self.ranking.designs[self.shown].law
        return law_styles((first, *(design.law for design in self.ranking.designs)))

    def style(self, position: int) -> Style:
        """Style of a design's law."""
        return self.styles[self.ranking.designs[position].law]

    @property
    def no_control(self) -> int | None:
        """Position of the design without control."""
        return next((i for i, design in enumerate(self.ranking.designs) if design.is_baseline), None)

    def S(self, position: int) -> FloatArray:
        """Scores of a design as they count, (n,) [m s]."""
        result: FloatArray = self.results.counted[self.ranking.index[position]]
        return result

    def S_uncorrected(self, position: int) -> FloatArray:
        """Scores without control over the same window, (n,) [m s]."""
        result: FloatArray = self.results.S_uncorrected[self.ranking.index[position]]
        return result

    def metric(self, name: str, position: int) -> float:
        """A metric of a design, in SI units."""
        return float(self.values(name)[position])

    def values(self, name: str) -> FloatArray:
        """A metric of all designs, in the order of the ranking."""
        return metric_values(name, self.ranking)

    @property
    def model_sentence(self) -> str:
        """The limitation of intervals: they leave out the uncertainty of the scenario model."""
        if self.report.model is None:
            return "Intervals hold for the departures that these scenarios were drawn from, not for other traffic."
        return (
            "Intervals cover the random draw of scenarios from the scenario model. They do not cover how well the "
            "model represents traffic."
        )

    def scenario_text(self) -> str:
        """Number of study scenarios, side by side."""
        side = self.scenarios.side
        parts = [f"{int((side == which).sum()):,} {name}" for which, name in SIDE_NAMES.items()]
        left_out = self.every - self.scenarios.n
        text = f"{self.scenarios.n:,} study scenarios ({', '.join(parts)})"
        return f"{text}, {left_out:,} more cannot be driven" if left_out else text


def metric_text(name: str, value: float, *, unit: bool = True) -> str:
    """A metric with its digits, in the unit of the page."""
    definition = metric(name)
    shown = number(definition.scale * value, definition.digits)
    return f"{shown}\u00a0{definition.shown_unit}" if unit and definition.shown_unit and math.isfinite(value) else shown


def side_rows(context: Context) -> Iterator[tuple[str, np.ndarray]]:
    """Name and rows of each side with scenarios."""
    for which, name in SIDE_NAMES.items():
        rows = np.flatnonzero(context.scenarios.side == which)
        if rows.size:
            yield name, rows
