"""What a report is made from."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from ldctoolkit import Setup
from studies.results import StudyResults

if TYPE_CHECKING:
    from ldctoolkit.departures import Departures
    from ldctoolkit.scenario_model import Given, ScenarioModel
    from studies.ranking.ranking import Ranking
    from studies.robustness.robustness import Robustness
    from studies.sensitivity.sensitivity import BlockSensitivity


@dataclasses.dataclass(frozen=True)
class ReportInput:
    """Everything that one report shows. Strings are plain text; the report escapes them.

    Attributes
    ----------
    title : str
        For people.
    study_name : str
        The study's short name.
    results : StudyResults
        Scores of all designs.
    rankings : tuple of Ranking
        One per case, in the order of ``results.cases``; the first is the primary one.
    setup : Setup
        How scenarios were driven, in the first convention; example paths are simulated again with it.
    settings : tuple of (name, value)
        The study's settings, seeds and hashes, in the order to be shown.
    versions : tuple of (name, version)
        Software and machine.
    model_notes : tuple of str
        Where the scenario model comes from.
    warnings : tuple of str
        Anything that the reader must know first.
    synthetic : bool
        Whether the scenario model was fitted to invented and not to recorded driving.
    command : str
        What makes the study again.
    study_file : str
        Text of a study file that does, with every default written out.
    departures : tuple of int
        Numbers of departures that the explorer shows beside those of its own rule.
    shown_designs : tuple of str
        Identifiers of designs that it shows likewise, or how they begin.
    sensitivity : tuple of BlockSensitivity
        Which gain matters, of the primary case; none leaves that part out.
    robustness : Robustness, optional
        Some designs on other plants; without it they were not driven.
    model : ScenarioModel, optional
        What generated the scenarios.
    model_name : str
        Its name; empty where no model generated them.
    given : mapping
        Conditions that they were drawn under.
    source_departures : Departures, optional
        What the model was fitted to; without them what its file holds of them.
    """

    title: str
    study_name: str
    results: StudyResults
    rankings: tuple[Ranking, ...]
    setup: Setup = dataclasses.field(default_factory=Setup)
    settings: tuple[tuple[str, str], ...] = ()
    versions: tuple[tuple[str, str], ...] = ()
    model_notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    synthetic: bool = False
    command: str = ""
    study_file: str = ""
    departures: tuple[int, ...] = ()
    shown_designs: tuple[str, ...] = ()
    sensitivity: tuple[BlockSensitivity, ...] = ()
    robustness: Robustness | None = None
    model: ScenarioModel | None = None
    model_name: str = ""
    given: Given = dataclasses.field(default_factory=dict)
    source_departures: Departures | None = None
