"""A small scenario model, built without a fit."""

import dataclasses

import numpy as np

from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import (
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    ScenarioModel,
    SideModel,
    SideSummary,
)


def one_component_model() -> ScenarioModel:
    """One component a side, numbers that need all their digits, and a full card."""
    mean = np.array([[2.1, 0.2, 0.05, 25.0, 0.0, 0.04, 1e-4, 0.0]]) / 0.97
    cov = np.diag(np.array([1.0, 0.1, 0.03, 4.0, 0.3, 0.02, 1e-3, 5e-4]) ** 2)[None] / 3.0
    lower, upper = (np.array([PHYSICAL_BOUNDS[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    mixture = BoundedGaussianMixture.from_parameters([1.0], mean, cov, lower=lower, upper=upper)
    side = SideModel(mixture, PARAMETER_NAMES)
    fit = SideSummary(200, (1, 2), (1000.0 / 3.0, 1100.0), (-2.5, -2.4), True, (("T", 2),), 0.0)
    card = dataclasses.replace(
        fit, n_parameters=(44, 89), aic=(1.0, 1.0 / 7.0), criterion="bic", reason="K = 1 has the smallest BIC",
        failed=((3, "no maximum"),), passes=7, stop_reason="converged", weight=250.5,
        bounds_from=(("T", "given", "auto"),),
    )  # fmt: skip
    provenance = ModelProvenance(
        {"description": "made up"}, seed=3, warnings=("one",), left=card, right=fit, versions={"numpy": "2"},
        settings=FitSettings("bic", None, 0.001, 10.0, 1e-6, 8, 500),
    )  # fmt: skip
    return ScenarioModel(side, side, provenance)
