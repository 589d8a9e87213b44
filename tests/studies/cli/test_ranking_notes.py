"""What stands below a printed ranking, and the table itself, for the cases that a small study does not show."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rich.console import Console

from ldctoolkit import Scenarios
from ldctoolkit.metrics import Companions
from studies import Case, CaseResults, Design, Ranking, StudyResults
from studies.cli._ranking_notes import ranking_notes
from studies.cli._ranking_table import ranking_table


def results(S: np.ndarray, first: int = 0) -> StudyResults:
    d, n = S.shape
    companions = Companions(**{f.name: np.full((d, n), 1 + i, np.float32)
                               for i, f in enumerate(dataclasses.fields(Companions))})  # fmt: skip
    case = CaseResults(
        case=Case("departure", "consistent"),
        S=S,
        S_uncorrected=S + 1.0,
        status=np.zeros((d, n), dtype=np.int8),
        companions=companions,
        failed_solves=np.zeros((d, n), dtype=np.int32),
        law_time=np.zeros(d),
    )
    designs = tuple(Design.from_gains("lqr" if i else "none", 0.1 + 0.1 * i, {}) for i in range(first, first + d))
    side = np.where(np.arange(n) < n // 2, 1, -1)
    return StudyResults(designs, Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=20.0, side=side), (case,))


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
    fresh = results(S[1:3] + np.array([[0.010], [0.004]]), first=1)
    ranking = Ranking.of(dataclasses.replace(study, fresh=fresh), study.cases[0], bootstrap=500)
    (note,) = [note for note in ranking_notes(ranking) if "fresh" in note]
    winner = int(ranking.index[ranking.winner])
    assert note.startswith(f"Winner on 200 fresh scenarios: # {ranking.rank[ranking.winner]}, ")
    assert winner == 2
    assert "0.0040 too low" in note
    table = printed(ranking)
    assert "fresh S" in table
    assert f"{ranking.fresh_S[ranking.winner]:.4f}" in table


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
