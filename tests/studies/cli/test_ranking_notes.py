"""What stands below a printed ranking, and the table itself, for the cases that a small study does not show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rich.console import Console

from helpers.results import results_of
from ldctoolkit.metrics import Companions
from studies import Design, Ranking, StudyResults
from studies.cli._results import ranking_notes, ranking_table


def results(S: np.ndarray, first: int = 0) -> StudyResults:
    designs = [Design.from_gains("lqr" if i else "none", 0.1 + 0.1 * i, {}) for i in range(first, first + len(S))]
    metrics = {field.name: np.asarray(1.0 + k) for k, field in enumerate(dataclasses.fields(Companions))}
    return results_of(S, designs, uncorrected=S + 1.0, metrics=metrics)


@pytest.fixture
def study() -> StudyResults:
    generator = np.random.default_rng(4)
    common = generator.gamma(2.0, 0.1, 200)
    return results(common + np.array([[0.5], [0.0], [0.0005], [0.2]]) + 0.01 * generator.gamma(1.0, 1.0, (4, 200)))


def printed(ranking: Ranking, top: int = 10) -> str:
    console = Console(width=250, record=True, file=None, quiet=False)
    with console.capture() as capture:
        console.print(ranking_table(ranking, top))
    return capture.get()


def test_notes_of_the_set_the_baseline_and_the_front(study: StudyResults) -> None:
    ranking = Ranking.of(study, study.cases[0], pareto=("S", "a_y_peak_max"), bootstrap=500)
    notes = list(ranking_notes(ranking))
    assert notes[0].startswith("=: not told apart from the best on these scenarios (1 design); the truly best one")
    assert notes[1].startswith("Winner against the baseline (No control")
    assert f"{ranking.baseline_difference[0]:+.4f} m s" in notes[1]
    assert notes[2] == "Pareto front over S, a_y_peak_max: 1 design, see ranking.csv"
    assert len(notes) == 3
    table = printed(ranking)
    assert "fresh" not in table
    assert table.count(" =") == 1


def test_notes_of_fresh_scenarios(study: StudyResults) -> None:
    S = study.cases[0].S
    fresh = results(S[:3] + np.array([[0.0], [0.010], [0.004]]))
    ranking = Ranking.of(dataclasses.replace(study, fresh=fresh), study.cases[0], bootstrap=500)
    i = ranking.winner
    assert i is not None
    notes = list(ranking_notes(ranking))
    (note,) = [note for note in notes if note.startswith("On 200 fresh scenarios the winner (# ")]
    assert f"{100 * ranking.fresh_reduction[i]:.1f} % less than No control" in note
    assert f"(difference {ranking.fresh_baseline_difference[i]:+.4f} m s, " in note
    # the same difference on the search's scenarios is not told beside it
    assert not [note for note in notes if note.startswith("Winner against")]
    (note,) = [note for note in notes if note.startswith("The search had S ")]
    assert note.endswith("within chance")
    assert f"{ranking.optimism[i]:.4f} too low" in note
    table = printed(ranking)
    assert "fresh S" in table
    assert f"{ranking.fresh_S[i]:.4f}" in table


def test_a_change_of_the_lead_and_a_real_loss_are_told(study: StudyResults) -> None:
    S = study.cases[0].S
    first, second = np.argsort(S.mean(axis=1))[:2].tolist()
    again = S + 2.0
    again[first] += 0.1
    ranking = Ranking.of(dataclasses.replace(study, fresh=results(again)), study.cases[0], bootstrap=500)
    assert ranking.index[ranking.winner] == second
    notes = list(ranking_notes(ranking))
    assert any(note.startswith("It was not the first of the search") for note in notes)
    assert any(note.startswith("The search had S") and note.endswith("more than chance") for note in notes)


def test_a_winner_that_was_no_finalist_has_no_number(study: StudyResults) -> None:
    first = int(study.cases[0].S.mean(axis=1).argmin())
    fresh = results(study.cases[0].S[[3]], first=3)
    ranking = Ranking.of(dataclasses.replace(study, fresh=fresh), study.cases[0], bootstrap=500)
    assert ranking.index[ranking.winner] == first
    notes = list(ranking_notes(ranking))
    assert "The winner of this case was no finalist; it has no fresh score" in notes
    assert not [note for note in notes if "nan" in note]


def test_what_a_race_gave_up_is_told(study: StudyResults) -> None:
    ranking = Ranking.of(study, study.cases[0], bootstrap=500)
    raced = dataclasses.replace(ranking, given_up=6)
    assert "6 of 10 designs were given up in the race before" in list(ranking_notes(raced))
    notes = list(ranking_notes(dataclasses.replace(raced, raced=False, winner=None)))
    assert notes == ["=: not told apart from the best of the 4 survivors of another case's race; no winner here"]


def test_a_side_of_one_scenario_has_no_interval(study: StudyResults) -> None:
    ranking = Ranking.of(study, study.cases[0], bootstrap=500)
    nothing = np.full(4, np.inf)
    table = printed(dataclasses.replace(ranking, S_low=-nothing, S_high=nothing))
    assert "inf" not in table


def test_what_misses_is_counted_and_has_no_number(study: StudyResults) -> None:
    limit = float(np.sort(study.cases[0].S.mean(axis=1))[1])
    ranking = Ranking.of(study, study.cases[0], require=(f"S >= {limit!r}", "a_y_peak_max <= 100"), bootstrap=500)
    notes = list(ranking_notes(ranking))
    # the design without control has no peak at all
    assert notes[-1] == f"Not ranked: 2 of 4 designs, which miss S >= {limit!r} (1), a_y_peak_max <= 100 (1)"
    rows = [line for line in printed(ranking).splitlines() if "LQR" in line or "No control" in line]
    assert [row.split()[1] for row in rows] == ["1", "2", "-", "-"]
    assert "-0.0" in rows[2]  # better by S than the best that is ranked


def test_nobody_ranked_is_printed_too(study: StudyResults) -> None:
    ranking = Ranking.of(study, study.cases[0], require=("S <= 0.001",), bootstrap=500)
    assert list(ranking_notes(ranking)) == ["Not ranked: 4 of 4 designs, which miss S <= 0.001 (4)"]
    assert "4 designs by mean S" in printed(ranking)
