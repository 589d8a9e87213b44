"""What a ranking says: each figure belongs to the scenarios that the sentence names."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from helpers.results import results_of as given_results
from ldctoolkit import EventStatus
from studies import Design, Ranking, StudyResults
from studies.ranking.failed_commands import warnings_of
from studies.ranking.ranking import SCORE, failures, marks, ranking_sentences

NONE = Design.from_gains("none", 0.1, {})
LAWS = tuple(Design.from_gains("lqr", 0.1 * (i + 1), {}) for i in range(2))


def results_of(shift: float, designs: tuple[Design, ...], fresh: StudyResults | None = None) -> StudyResults:
    """No control has 4 m s, the designs 1, 2, ... m s, all moved by a shift and with a little noise."""
    noise = 0.01 * np.random.default_rng(1).normal(size=(len(designs), 60))
    S = np.array([4.0 if one.is_baseline else 1.0 + k for k, one in enumerate(designs)])[:, None] + shift + noise
    return given_results(S, designs, uncorrected=4.0 + shift, parts={"fresh": fresh})


def said(results: StudyResults, **settings: Any) -> tuple[Ranking, list[str]]:
    ranking = Ranking.of(results, results.cases[0], bootstrap=100, **settings)
    return ranking, list(ranking_sentences(ranking))


def test_score_is_the_integral_of_the_distance_from_the_centre() -> None:
    assert "integral over time of |e_y|" in SCORE
    assert "centre" in SCORE
    assert "beyond" not in SCORE


def test_on_the_same_scenarios_without_fresh_ones() -> None:
    ranking, sentences = said(results_of(0.0, (*LAWS, NONE)))
    share = 100 * (1 - ranking.S[0] / 4.0)
    assert sentences[1] == f"That is {share:.1f} % less than no control (4.0000 m s)."


def test_a_fresh_score_is_compared_with_fresh_no_control() -> None:
    """On the fresh scenarios no control has 8 m s: the share is that of 5 to 8, and 4 m s is not mentioned."""
    designs = (*LAWS, NONE)
    ranking, sentences = said(results_of(0.0, designs, results_of(4.0, designs)))
    assert ranking.winner == 0
    assert f"mean S {ranking.fresh_S[0]:.4f} m s on 60 fresh scenarios" in sentences[0]
    none = ranking.fresh_S[2]
    assert abs(none - 8.0) < 0.01
    assert sentences[1] == (
        f"On the same scenarios that is {100 * (1 - ranking.fresh_S[0] / none):.1f} % less than "
        f"no control ({none:.4f} m s)."
    )
    assert "37.5 %" in sentences[1] or "37.4 %" in sentences[1] or "37.6 %" in sentences[1]
    assert "4.0000" not in " ".join(sentences)


def test_without_fresh_no_control_both_figures_are_those_of_the_search() -> None:
    ranking, sentences = said(results_of(0.0, LAWS, results_of(4.0, LAWS)))
    assert ranking.baseline is None
    share = 100 * (1 - ranking.S[0] / 4.0)
    assert sentences[1] == (
        f"On the scenarios that designs were chosen on it has mean S {ranking.S[0]:.4f} m s, {share:.1f} % less than "
        "no control (4.0000 m s)."
    )


def test_a_law_as_baseline_is_compared_on_the_fresh_scenarios() -> None:
    ranking, sentences = said(results_of(0.0, LAWS, results_of(4.0, LAWS)), baseline=LAWS[1].id)
    share = 100 * (1 - ranking.fresh_S[0] / ranking.fresh_S[1])
    assert sentences[1] == (
        f"On the same scenarios that is {share:.1f} % less than {LAWS[1].label} ({ranking.fresh_S[1]:.4f} m s)."
    )
    assert sentences[2].startswith("On the scenarios that designs were chosen on it has mean S")


def test_a_best_design_that_is_worse_than_no_control_has_more() -> None:
    """Mean S 5 and 4 m s: by how much it is worse, without a sign, on either kind of scenarios."""
    one = np.full((1, 60), 5.0)
    _, sentences = said(given_results(one, LAWS[:1], uncorrected=4.0))
    assert sentences[0] == "Winner: LQR, y_s=0.1 m, mean S 5.0000 m s (95 % interval 5.0000 to 5.0000)."
    assert sentences[1] == "That is 25.0 % more than no control (4.0000 m s)."
    both = np.repeat([[5.0], [4.0]], 60, axis=1)
    deep = {"deepest": [[0.0], [1.0]]}  # what keeps no control from its place
    fresh = given_results(2 * both, (LAWS[0], NONE), uncorrected=8.0, metrics=deep)
    results = given_results(both, (LAWS[0], NONE), uncorrected=4.0, metrics=deep, parts={"fresh": fresh})
    _, sentences = said(results, require=("deeper <= 0.5",))
    assert sentences[0].startswith("Winner: LQR, y_s=0.1 m, mean S 10.0000 m s on 60 fresh scenarios")
    assert sentences[1] == "On the same scenarios that is 25.0 % more than no control (8.0000 m s)."
    assert "+2.0000 m s (interval +2.0000 to +2.0000, on the fresh scenarios)" in sentences[2]


def test_ends_of_intervals_stand_in_their_order() -> None:
    """The value lies between them, on the search's own scenarios, on fresh ones, and against a baseline."""
    designs = (*LAWS, NONE)
    for fresh in (None, results_of(4.0, designs)):
        _, sentences = said(results_of(0.0, designs, fresh))
        for text in (sentences[0], sentences[-2]):
            value, low, high = (float(one) for one in re.findall(r"[+-]?\d+\.\d{4}", text))
            assert low < value < high
    assert "interval -" in sentences[-2]


def test_failures_are_those_of_any_kind() -> None:
    kinds = [EventStatus.SOLVER_FAILED, EventStatus.DIVERGED, EventStatus.TIMED_OUT, EventStatus.CRASHED]
    results = given_results(np.ones((1, 60)), LAWS[:1], status=[*kinds, EventStatus.NEVER_TRIGGERED, *[0] * 55])
    ranking, _ = said(results)
    assert failures(ranking, 0) == 4
    assert marks(ranking, 0) == ("winner",)


@pytest.mark.parametrize(
    ("law", "n", "warned"), [("linear_mpc", 10, True), ("linear_mpc", 11, False), ("lqr", 11, True)]
)
def test_failed_commands_are_told_from_a_tenth_on(law: str, n: int, warned: int) -> None:
    """One intervention of n; at once where the law has no solver to fall back from."""
    design = Design.from_gains(law, 0.1, {})
    status = [0] * n + [EventStatus.NEVER_TRIGGERED, EventStatus.INVALID]
    case = given_results(np.ones((1, n + 2)), [design], status=status).cases[0]
    case.failed_solves[0, [0, n, n + 1]] = 3
    found = list(warnings_of(case, [design]))
    assert len(found) == warned
    start = "Commands that were not finite, " + (
        "or came from a law's fallback" if law == "linear_mpc" else "of laws that declare no solver to fall back from"
    )
    assert found == [f"{start}: {design.label} in 1 of {n} interventions."] * warned
