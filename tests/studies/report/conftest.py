from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Iterable
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from ldctoolkit import BicycleModel, EventStatus, Scenarios, VehicleParameters, simulate
from ldctoolkit.metrics import COMPANION_UNITS, Companions
from studies.design import Design
from studies.ranking.ranking import Ranking
from studies.report import ReportInput
from studies.results import Case, CaseResults, StudyResults


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


def run(designs: Iterable[Design], scenarios: Scenarios, cases: Iterable[Case], **settings: Any) -> StudyResults:
    """Results of a study, one `simulate` call a design and case."""
    designs = tuple(designs)
    scored = []
    for case in cases:
        model = BicycleModel(VehicleParameters(), convention=case.convention)
        outcomes = [
            simulate(d.controller(case.convention), scenarios, vehicle=model, y_s=d.y_s, window=case.window, **settings)
            for d in designs
        ]
        columns = {name: np.stack([getattr(o, name) for o in outcomes])
                   for name in ("S", "S_uncorrected", "status", "failed_solves")}  # fmt: skip
        companions = {name: np.stack([getattr(o.companions, name) for o in outcomes]).astype(np.float32)
                      for name in COMPANION_UNITS}  # fmt: skip
        scored.append(
            CaseResults(case, **columns, companions=Companions(**companions), law_time=np.zeros(len(designs)))
        )
    return StudyResults(designs, scenarios, tuple(scored))


def report_input(results: StudyResults, **changes: object) -> ReportInput:
    rankings = tuple(Ranking.of(results, case, bootstrap=200) for case in results.cases)
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
    return ReportInput(results=results, rankings=rankings, **(given | changes))  # type: ignore[arg-type]


def grid() -> list[Design]:
    designs = [Design.of(NoControl(), 0.2), Design.of(PreviewProportional(), 0.2)]
    for y_s, K_y, K_psi in itertools.product((0.05, 0.2), (-0.005, -0.02), (-0.2, -0.4)):
        designs.append(Design.of(PreviewProportional(K_y=K_y, K_psi=K_psi), y_s))
    for y_s, r_delta in itertools.product((0.05, 0.1, 0.2), (30.0, 300.0)):
        designs.append(Design.of(LQR(r_delta=r_delta), y_s))
    return list({d.id: d for d in designs}.values())


PRIMARY = Case("departure", "consistent")


@pytest.fixture(scope="session")
def results() -> StudyResults:
    cases = (PRIMARY, Case("control", "consistent"))
    return run(grid(), invented_scenarios(60, 40), cases)


@pytest.fixture(scope="session")
def report(results: StudyResults) -> ReportInput:
    return report_input(results)


@pytest.fixture(scope="session")
def with_failures(results: StudyResults) -> StudyResults:
    """The same results, with every scenario of every design marked as failed or diverged."""
    cases = []
    for case in results.cases:
        status = np.full(case.status.shape, EventStatus.DIVERGED, dtype=np.int8)
        status[:, ::2] = EventStatus.SOLVER_FAILED
        cases.append(dataclasses.replace(case, status=status, S=case.S + 20.0, failed_solves=case.failed_solves + 3))
    return dataclasses.replace(results, cases=tuple(cases))


@pytest.fixture(scope="session")
def make() -> ModuleType:
    """The functions above; test modules cannot import each other."""
    return sys.modules[__name__]
