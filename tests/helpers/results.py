"""Results and reports made for tests."""

import dataclasses
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from helpers.bits import assert_same_bits
from helpers.pages import Page, whole
from ldctoolkit import BicycleModel, Outcome, Scenarios, Setup, VehicleParameters, simulate
from ldctoolkit.controllers import LQR, NoControl, PreviewProportional
from ldctoolkit.metrics import MetricValues
from ldctoolkit.simulation import Window
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.measures import measured
from ldctoolkit.studies.pages.context import Context, ReportInput
from ldctoolkit.studies.pages.report import report_page
from ldctoolkit.studies.pages.shell import Section
from ldctoolkit.studies.ranking.ranking import Ranking
from ldctoolkit.studies.results import StudyResults, per_scenario
from ldctoolkit.studies.storage.measure_table import MeasureTable
from ldctoolkit.vehicle import Convention


def per_scenario_numbers(
    S: np.ndarray, *, uncorrected: npt.ArrayLike = 9.0, status: npt.ArrayLike = 0,
    metrics: Mapping[str, npt.ArrayLike] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Scores S (d, n); every other metric is 0 unless it is given, the score without control 9 m s."""
    given = dict.fromkeys((field.name for field in dataclasses.fields(MetricValues)), 0.0) | dict(metrics or {})
    metrics: dict[str, Any] = {
        name: np.array(np.broadcast_to(value, S.shape), dtype=np.float32) for name, value in given.items()
    }
    return {
        "S": S,
        "S_uncorrected": np.array(np.broadcast_to(np.asarray(uncorrected, dtype=np.float64), S.shape)),
        "status": np.array(np.broadcast_to(np.asarray(status, dtype=np.int8), S.shape)),
        "metrics": MetricValues(**metrics),
        "failed_solves": np.zeros(S.shape, dtype=np.int32),
        "law_time": np.full(len(S), np.nan),
    }


def results_of_outcomes(
    designs: Iterable[Design], scenarios: Scenarios, outcomes: Sequence[Outcome],
    window: Window = "departure", convention: Convention = "consistent",
) -> StudyResults:  # fmt: skip
    """What `simulate` gave for each design."""
    arrays = {
        name: np.stack([getattr(one, name) for one in outcomes])
        for name in ("S", "S_uncorrected", "status", "failed_solves")
    }
    names = [field.name for field in dataclasses.fields(MetricValues)]
    metrics = {name: np.stack([getattr(one.metrics, name) for one in outcomes]) for name in names}
    return StudyResults(
        tuple(designs), scenarios, window, convention, **arrays,
        metrics=MetricValues(**metrics), law_time=np.zeros(len(outcomes)),
    )  # fmt: skip


def scenarios_of(n: int, left: int | None = None) -> Scenarios:
    """Scenarios of which only side matters, no two the same; half of them to the left unless that is given."""
    side = np.where(np.arange(n) < (n // 2 if left is None else left), 1, -1)
    return Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=20.0, dc=1e-9 * np.arange(n), side=side)


def results_of(
    S: np.ndarray, designs: Sequence[Design], *, left: int | None = None, window: Window = "departure",
    parts: Mapping[str, Any] | None = None, **more: Any,
) -> StudyResults:  # fmt: skip
    """Scores (d, n) of d designs; `parts` go to `StudyResults`, the others to `per_scenario_numbers`."""
    scenarios = scenarios_of(S.shape[1], left)
    numbers = per_scenario_numbers(S, **more) | dict(parts or {})
    return StudyResults(tuple(designs), scenarios, window, "consistent", **numbers)


def assert_same_results(one: StudyResults, other: StudyResults) -> None:
    """Fail unless designs, scenarios and every number have the same bits; times, which no run gives again, aside."""
    assert (one.designs, one.label) == (other.designs, other.label)
    for name in ("scenarios", "S", "S_uncorrected", "status", "metrics", "failed_solves"):
        assert_same_bits(getattr(one, name), getattr(other, name), name)


def invented_scenarios(n_left: int, n_right: int, seed: int = 1) -> Scenarios:
    """Departures of a plausible size; numbers only, no claim about any road."""
    rng = np.random.default_rng(seed)
    n = n_left + n_right
    v = np.where(rng.random(n) < 0.5, rng.normal(14.0, 1.5, n), rng.normal(28.0, 2.0, n))
    T = np.clip(rng.lognormal(np.log(2.0), 0.5, n), 0.5, 10.0)
    return Scenarios.from_arrays(
        T=T,
        d_y=np.clip(rng.lognormal(np.log(0.2), 0.5, n) * (T / 2.0) ** 0.3, 0.02, 1.2),
        v_mean=np.clip(v, 9.0, 38.0),
        a_mean=rng.normal(0.0, 0.3, n),
        c_0=rng.normal(0.0, 0.4, n) / v**2,
        dc=rng.normal(0.0, 0.2, n) / v**2,
        side=np.repeat([1, -1], [n_left, n_right]),
    )


def run(
    designs: Iterable[Design], scenarios: Scenarios, window: Window = "departure",
    convention: Convention = "consistent", **settings: Any,
) -> StudyResults:  # fmt: skip
    """Results of a study, one `simulate` call a design."""
    designs, model = tuple(designs), BicycleModel(VehicleParameters(), convention=convention)
    outcomes = [
        simulate(d.controller(convention), scenarios, vehicle=model, y_s=d.y_s, window=window, **settings)
        for d in designs
    ]
    results = results_of_outcomes(designs, scenarios, outcomes, window, convention)
    return dataclasses.replace(results, metrics=per_scenario(results.metrics, lambda a: a.astype(np.float32)))


def report_input(results: StudyResults, **changes: object) -> ReportInput:
    require = changes.pop("require", ())
    setup: Any = changes.get("setup", Setup())
    results = measured(results, MeasureTable(), setup)
    ranking = Ranking.of(results, bootstrap=200, require=require, setup=setup)  # type: ignore[arg-type]
    given = {
        "title": "Trigger threshold and gains",
        "study_name": "trigger-and-gains",
        "settings": (("seed", "0"), ("left", "60"), ("model hash", "0f" * 32)),
        "versions": (("ldctoolkit", "0.1.0"), ("python", "3.11")),
        "model_notes": ("An invented population.",),
        "warnings": ("Speed looks like km/h.",),
        "synthetic": True,
        "command": "ldc run trigger-and-gains -o out",
    }
    return ReportInput(results=results, ranking=ranking, **(given | changes))  # type: ignore[arg-type]


def grid() -> list[Design]:
    designs = [Design.of(NoControl(), 0.2), Design.of(PreviewProportional(), 0.2)]
    for y_s, K_y, K_psi in itertools.product((0.05, 0.2), (-0.005, -0.02), (-0.2, -0.4)):
        designs.append(Design.of(PreviewProportional(K_y=K_y, K_psi=K_psi), y_s))
    for y_s, r_delta in itertools.product((0.05, 0.1, 0.2), (30.0, 300.0)):
        designs.append(Design.of(LQR(r_delta=r_delta), y_s))
    return list({d.id: d for d in designs}.values())


SECTIONS = (
    "verdict", "ranking", "limits", "trade-offs", "landscape", "departures", "robustness", "confidence", "model",
    "settings",
)  # fmt: skip
"""Identifiers of the sections of a report, in their order."""


def page_of(report: ReportInput) -> Page:
    """The page of a report, after what must hold for every page."""
    html, _ = report_page(report)
    page = Page(html)
    whole(page)
    assert set(SECTIONS) <= set(page.ids)
    assert all(page.words(name) for name in SECTIONS)
    assert page.counts["script"] == 2
    return page


def section_of(make: Callable[[Context], Section], given: ReportInput | Context) -> tuple[Section, Page]:
    """One section by itself; its text is `Page.words()`."""
    made = make(given if isinstance(given, Context) else Context.of(given))
    return made, Page(str(made.body))


def said_in(make: Callable[[Context], Section], given: ReportInput | Context) -> str:
    """The text of one section."""
    return section_of(make, given)[1].words()


def only(*designs: Design, scenarios: Scenarios | None = None, window: Window = "departure") -> ReportInput:
    """The report of these designs, by default on a dozen departures to the left and nine to the right."""
    return report_input(run(designs, scenarios or invented_scenarios(12, 9), window))


def scored(S: npt.ArrayLike, S_0: npt.ArrayLike, designs: Sequence[Design]) -> StudyResults:
    """A study whose scores are given, all else as for the first design; half of the columns left, half right."""
    d, S, S_0 = len(designs), np.atleast_2d(np.asarray(S, dtype=float)), np.asarray(S_0, dtype=float)
    one = run(designs[:1], invented_scenarios(S_0.size // 2, S_0.size // 2))
    return dataclasses.replace(
        one,
        designs=tuple(designs),
        S=S,
        S_uncorrected=np.tile(S_0, (d, 1)),
        status=np.tile(one.status, (d, 1)),
        failed_solves=np.tile(one.failed_solves, (d, 1)),
        metrics=per_scenario(one.metrics, lambda values: np.tile(values, (d, 1))),
        law_time=np.zeros(d),
    )
