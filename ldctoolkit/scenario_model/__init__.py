"""Scenario models: one bounded Gaussian mixture a side, fitted to departures, kept in one JSON file."""

from ldctoolkit.scenario_model.fidelity import SideFidelity
from ldctoolkit.scenario_model.fit import check_fidelity, fit_scenario_model
from ldctoolkit.scenario_model.model import Given, ScenarioModel, bundled_models, conditions, load_model
from ldctoolkit.scenario_model.provenance import (
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    SideModel,
    SideSummary,
    SourceSummary,
    summarize,
)

__all__ = [
    "PHYSICAL_BOUNDS",
    "FitSettings",
    "Given",
    "ModelProvenance",
    "ScenarioModel",
    "SideFidelity",
    "SideModel",
    "SideSummary",
    "SourceSummary",
    "bundled_models",
    "check_fidelity",
    "conditions",
    "fit_scenario_model",
    "load_model",
    "summarize",
]
