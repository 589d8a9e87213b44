"""One study, its report and its page, made once for all tests of the report."""

import dataclasses

import numpy as np
import pytest

from helpers.pages import Page
from helpers.results import PRIMARY, grid, invented_scenarios, page_of, report_input, run
from ldctoolkit import EventStatus
from ldctoolkit.studies.pages.context import ReportInput
from ldctoolkit.studies.results import Case, StudyResults


@pytest.fixture(scope="session")
def results() -> StudyResults:
    return run(grid(), invented_scenarios(60, 40), (PRIMARY, Case("control", "consistent")))


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
    cases = []
    for case in results.cases:
        status = np.full(case.status.shape, EventStatus.DIVERGED, dtype=np.int8)
        status[:, ::2] = EventStatus.SOLVER_FAILED
        cases.append(dataclasses.replace(case, status=status, S=case.S + 20.0, failed_solves=case.failed_solves + 3))
    return dataclasses.replace(results, cases=tuple(cases))
