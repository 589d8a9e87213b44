"""What the section on failures says of the worst departures, of failed designs and of a race."""

from __future__ import annotations

import dataclasses
from types import ModuleType

import numpy as np

from studies.report.context import Context
from studies.report.sections.failures import section
from studies.results import Dropped, FailedDesign, Race, StudyResults


def words(context: Context) -> str:
    return " ".join(section(context).body.striptags().split())


def test_the_winners_worst_departures(make: ModuleType, results: StudyResults) -> None:
    context = Context.of(make.report_input(results))
    said = words(context)
    S = context.S(context.primary.best)
    share = np.sort(S)[-5:].sum() / S.sum()
    assert "The 5 departures with the largest S of" in said
    assert f"make up {100 * share:.0f}\u00a0% of its sum of S".replace("\u00a0", " ") in said.replace("\u00a0", " ")


def test_long_lists_are_cut_and_counted(make: ModuleType, results: StudyResults) -> None:
    first = results.designs[0]
    failed = tuple(FailedDesign(first, f"reason {i}") for i in range(130))
    dropped = tuple(Dropped(first, 1, 50, 1.0, 0.5, 0.125) for _ in range(130))
    race = Race((50, 100), (145, 15), dropped, 10, 100)
    said = words(Context.of(make.report_input(dataclasses.replace(results, failed=failed, race=race))))
    assert "reason 99 " in said
    assert "reason 100" not in said
    assert "And 30 more designs" in said
    assert "The 100 that went last of 130" in said
    assert said.count("[from +0.125]") == 100
