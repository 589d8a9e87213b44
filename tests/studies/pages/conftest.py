"""One study, its report and its page, made once for all tests of the report."""

import dataclasses

import numpy as np
import pytest

from helpers.pages import Page
from helpers.results import grid, invented_scenarios, page_of, report_input, run
from ldctoolkit import EventStatus
from ldctoolkit.scenario_model import ScenarioModel, load_model
from ldctoolkit.studies.pages.context import ReportInput
from ldctoolkit.studies.results import StudyResults


@pytest.fixture(scope="session")
def model() -> ScenarioModel:
    return load_model("reference")


@pytest.fixture(scope="session")
def results() -> StudyResults:
    return run(grid(), invented_scenarios(60, 40))


@pytest.fixture(scope="session")
def report(results: StudyResults) -> ReportInput:
    return report_input(results)


@pytest.fixture(scope="session")
def page(report: ReportInput) -> Page:
    """The whole page."""
    return page_of(report)


@pytest.fixture(scope="session")
def with_failures(results: StudyResults) -> StudyResults:
    """The same results, with every scenario of every design marked as failed or diverged."""
    status = np.full(results.status.shape, EventStatus.DIVERGED, dtype=np.int8)
    status[:, ::2] = EventStatus.SOLVER_FAILED
    solves = results.failed_solves + 3
    return dataclasses.replace(results, status=status, S=results.S + 20.0, failed_solves=solves)
