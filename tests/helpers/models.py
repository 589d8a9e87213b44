"""Scenario models and fits made for tests."""

import dataclasses

import numpy as np

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import (
    PHYSICAL_BOUNDS,
    FitSettings,
    ModelProvenance,
    ScenarioModel,
    SideModel,
    SideSummary,
)
from ldctoolkit.scenario_model.fidelity import SideFidelity


def one_component_model() -> ScenarioModel:
    """One component a side, numbers that need all their digits, and a full card."""
    mean = np.array([[2.1, 0.2, 0.05, 25.0, 0.0, 0.04, 1e-4, 0.0]]) / 0.97
    cov = np.diag(np.array([1.0, 0.1, 0.03, 4.0, 0.3, 0.02, 1e-3, 5e-4]) ** 2)[None] / 3.0
    lower, upper = (np.array([PHYSICAL_BOUNDS[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    mixture = BoundedGaussianMixture.from_parameters([1.0], mean, cov, lower=lower, upper=upper)
    side = SideModel(mixture, PARAMETER_NAMES)
    fit = SideSummary(200, (1, 2), (1000.0 / 3.0, 1100.0), (-2.5, -2.4), True, (("T", 2),), 0.0)
    card = dataclasses.replace(
        fit, n_parameters=(44, 89), reason="K = 1 has the smallest BIC",
        failed=((3, "no maximum"),), passes=7, stop_reason="converged", weight=250.5,
        bounds_from=(("T", "given", "auto"),),
    )  # fmt: skip
    provenance = ModelProvenance(
        {"description": "made up"}, seed=3, warnings=("one",), left=card, right=fit, versions={"numpy": "2"},
        settings=FitSettings(10.0, 1e-6, 8, 500),
    )  # fmt: skip
    return ScenarioModel(side, side, provenance)


NAMES = ("T", "d_y", "v_mean", "a_mean")
CONSTANTS = (("sigma_y", 0.02), ("sigma_v", 0.1), ("c_0", 0.0), ("dc", 0.0))


def make_model(**provenance: object) -> ScenarioModel:
    """Two components over four parameters a side, summaries included."""
    mixture = BoundedGaussianMixture.from_parameters(
        [0.4, 0.6], [[1.5, 0.25, 14.0, 0.0], [3.0, 0.45, 28.0, 0.1]],
        [np.diag([0.4, 0.01, 9.0, 0.1]), np.diag([1.5, 0.04, 9.0, 0.1])], lower=[0.5, 0.0, 5.0, -9.81],
        upper=[10.0, np.inf, np.inf, 9.81],
    )  # fmt: skip
    summary = SideSummary(400, (1, 2, 3), (-120.0, -950.5, -930.0), (0.1, 1.2, 1.25), True, (("d_y", 2),), 0.0)
    side = SideModel(mixture, NAMES, CONSTANTS)
    settings = {
        "source": {"recordings": 3, "hours": 1.5, "files": ["a & b.csv"]}, "software": "ldctoolkit 0.1.0", "seed": 7,
        "left": summary, "right": summary, "hours": 1.5, "distance": 72_400.0,
    }  # fmt: skip
    return ScenarioModel(side, side, ModelProvenance(**(settings | provenance)))  # type: ignore[arg-type]


def checked_model() -> ScenarioModel:
    """The same with the check of its fit: one answer to the left lies outside, 46 for 36 to 44 % needless."""
    replayed = ((0.3, 0.9, 0.4, 2.0, 0.5),) * 12
    low, high = (tuple(tuple(factor * x for x in row) for row in replayed) for factor in (0.9, 1.1))
    outside = (replayed[0], (0.3, 0.9, 0.46, 2.0, 0.5), *replayed[2:])
    left, right = (
        SideFidelity(86, (0.02, 0.06, 0.17, 0.23), replayed, low, high, made) for made in (outside, replayed)
    )
    summary = make_model().provenance.left
    assert summary is not None
    sides = {name: dataclasses.replace(summary, fidelity=side) for name, side in (("left", left), ("right", right))}
    return make_model(**sides)


def make_departures(model: ScenarioModel, n: int = 400, seed: int = 1) -> Departures:
    """As drawn from the model, n a side."""
    drawn = model.sample(n, n, seed)
    zero = np.zeros(2 * n, dtype=np.int64)
    columns = {name: getattr(drawn, name) for name in ("side", *PARAMETER_NAMES)}
    return Departures(**columns, recording=zero.astype(str), start_time=1.0 * zero, samples=zero)


def varied_departures(n: int = 200, seed: int = 0, **changed: object) -> Departures:
    """n departures a side, drawn; a column can be replaced."""
    rng = np.random.default_rng(seed)
    m = 2 * n
    columns = {
        "T": np.clip(np.exp(rng.normal(0.7, 0.5, m)), 0.51, 9.9), "d_y": rng.gamma(3.0, 0.07, m),
        "sigma_y": rng.gamma(3.0, 0.02, m), "v_mean": rng.normal(25.0, 4.0, m), "a_mean": rng.normal(0.0, 0.3, m),
        "sigma_v": rng.gamma(4.0, 0.01, m), "c_0": rng.normal(0.0, 1e-3, m), "dc": rng.normal(0.0, 5e-4, m),
    } | changed  # fmt: skip
    return Departures(
        side=np.repeat([LEFT, RIGHT], n),
        **{name: np.broadcast_to(np.asarray(columns[name], dtype=float), m).copy() for name in PARAMETER_NAMES},
        recording=np.full(m, "r"),
        start_time=np.zeros(m),
        samples=np.full(m, 20),
    )


def skewed(departures: Departures) -> Departures:
    """The same with d_y crowding towards its bound."""
    return dataclasses.replace(departures, d_y=departures.d_y**6)
