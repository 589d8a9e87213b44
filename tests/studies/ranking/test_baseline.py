"""Which design the word of a study file names, and what is said where it names none."""

import numpy as np
import pytest

from ldctoolkit import Scenarios
from ldctoolkit.errors import InputError
from studies import Design, StudyResults
from studies.ranking.design_metrics import find_baseline
from studies.results import Dropped, FailedDesign, Race

NONE = Design.from_gains("none", 0.2, {})
LQR = tuple(Design.from_gains("lqr", y_s, {}) for y_s in (0.1, 0.2))


def results(*designs: Design, failed: tuple[Design, ...] = (), dropped: tuple[Design, ...] = ()) -> StudyResults:
    race = Race((10,), (1,), tuple(Dropped(one, 1, 10, 1.0, 0.5, 0.4) for one in dropped), 20, 40)
    scenarios = Scenarios.from_arrays(T=2.0, d_y=0.3, v_mean=20.0, side=np.array([1, -1]))
    return StudyResults(designs, scenarios, (), tuple(FailedDesign(one, "it broke") for one in failed), race=race)


def test_a_law_an_identifier_or_no_word() -> None:
    every = results(*LQR, NONE)
    assert find_baseline("", every) == 2
    assert find_baseline("none", every) == 2
    assert find_baseline("lqr", every) == 0
    assert find_baseline(LQR[1].id, every) == find_baseline(LQR[1].id[:6], every) == 1
    assert find_baseline("", results(*LQR)) is None


def test_a_baseline_that_failed_or_was_given_up_is_no_mistake_of_the_file() -> None:
    assert find_baseline("none", results(*LQR, failed=(NONE,))) is None
    assert find_baseline("none", results(*LQR, dropped=(NONE,))) is None
    assert find_baseline("lqr", results(LQR[1], NONE, dropped=(LQR[0],))) == 0


@pytest.mark.parametrize("word", ["lqq", "f00baa", LQR[0].id[:5]])
def test_anything_else_is_refused_with_the_nearest(word: str) -> None:
    with pytest.raises(InputError, match=rf"ranking\.baseline: '{word}' is no law .*allowed: lqr, none"):
        find_baseline(word, results(*LQR, NONE))


def test_the_start_of_two_identifiers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Design, "id", property(lambda self: f"abcdef{self.y_s:06.0f}"))
    with pytest.raises(InputError, match="'abcdef' is the start of 2 identifiers; allowed: more digits"):
        find_baseline("abcdef", results(*LQR))
