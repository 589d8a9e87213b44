"""What the section on failures says of the worst departures, of failed designs and of a race."""

from __future__ import annotations

import dataclasses

import numpy as np

from helpers.reports import report_input
from ldctoolkit import EventStatus
from studies.report.context import Context
from studies.report.replay.picks import chosen_designs, picked_departures
from studies.report.sections.failures import section
from studies.results import Dropped, FailedDesign, Race, StudyResults


def words(context: Context) -> str:
    return " ".join(section(context).body.striptags().split())


def test_the_winners_worst_departures(results: StudyResults) -> None:
    context = Context.of(report_input(results))
    said = words(context)
    S = context.S(context.primary.best)
    share = np.sort(S)[-5:].sum() / S.sum()
    assert "The 5 departures with the largest S of" in said
    assert f"make up {100 * share:.0f}\u00a0% of its sum of S".replace("\u00a0", " ") in said.replace("\u00a0", " ")


def test_departures_without_control_among_the_worst_are_told(results: StudyResults) -> None:
    report = report_input(results)
    best = Context.of(report).primary.best
    status, S = results.cases[0].status.copy(), Context.of(report).S(best)
    worst = np.argsort(-S, kind="stable")[:5]
    status[best.index][worst[1:4]] = EventStatus.NEVER_TRIGGERED
    case = dataclasses.replace(results.cases[0], status=status)
    report = report_input(dataclasses.replace(results, cases=(case,)))
    context = Context.of(report)
    said = words(context)
    assert f"3 of the 5 never get deeper than y s = {best.design.y_s:g} m, so no control acts there" in said.replace(
        "ys", "y s"
    ).replace("\u00a0", " ")
    numbers = [str(k) for k in results.scenarios.index[worst]]
    assert f"The worst are scenarios {', '.join(numbers[:4])} and {numbers[4]}, the worst first" in said
    assert "taken over" in said
    assert not {int(k) for k in worst} - {pick.row for pick in picked_departures(context, chosen_designs(context), 0)}


def test_long_lists_are_cut_and_counted(results: StudyResults) -> None:
    first = results.designs[0]
    failed = tuple(FailedDesign(first, f"reason {i}") for i in range(130))
    dropped = tuple(Dropped(first, 1, 50, 1.0, 0.5, 0.125) for _ in range(130))
    race = Race((50, 100), (145, 15), dropped, 10, 100)
    said = words(Context.of(report_input(dataclasses.replace(results, failed=failed, race=race))))
    assert "reason 99 " in said
    assert "reason 100" not in said
    assert "And 30 more designs" in said
    assert "The 100 that went last of 130" in said
    assert said.count("[from +0.125]") == 100
