"""Search with Optuna: finds what is there to find, asks the same again when told the same, runs nothing twice."""

import contextlib
import io
import json
import math
import os
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.errors import refused
from ldctoolkit.errors import InputError, StudyError
from ldctoolkit.studies import Design, Study, rank_study, run_study
from ldctoolkit.studies.search import Search

pytestmark = pytest.mark.usefixtures("laws")

Objective = Callable[[Design], tuple[float, ...] | None]
Margins = Callable[[Design], tuple[float, ...]]

TWO_LAWS = [
    {"law": "none"},
    {
        "law": ["lqr", "linear_mpc"],
        "y_s": {"from": 0.05, "to": 0.3},
        "gains": {"r_delta": {"from": 50, "to": 5000}, "horizon": {"from": 5, "to": 60}, "blocks": [0, 3, 5]},
    },
]
ONE_LAW = [
    {
        "law": "linear_mpc",
        "y_s": {"from": 0.05, "to": 0.3},
        "gains": {"r_delta": {"from": 50, "to": 5000}, "horizon": {"from": 5, "to": 60}, "q_psi": {"from": 0, "to": 4}},
    }
]


def make(design: Any, seed: int = 0, **search: Any) -> Study:
    return Study.from_dict({"name": "s", "seed": seed, "search": search, "design": design})


def drive(search: Search, objective: Objective, margins: Margins | None = None) -> list[tuple[Design, ...]]:
    """Batches until there are no more."""
    batches = []
    while batch := search.ask():
        batches.append(batch)
        values = {design.id: objective(design) for design in batch}
        search.tell(values, {design.id: margins(design) for design in batch} if margins else None)
    return batches


def bowl(design: Design) -> tuple[float, ...]:
    """Zero at y_s = 0.12, r_delta = 300, horizon = 33, q_psi = 1.5."""
    gains = dict(design.gains)
    value = 100 * (design.y_s - 0.12) ** 2 + math.log(float(gains["r_delta"]) / 300) ** 2
    return (value + abs(float(gains["horizon"]) - 33) / 30 + abs(float(gains["q_psi"]) - 1.5) / 4,)


def two_bowls(design: Design) -> tuple[float, ...]:
    """Both laws at their best at y_s = 0.12, r_delta = 300: there an LQR costs 0.2, an MPC 0 if its horizon is 33."""
    gains = dict(design.gains)
    if design.law == "none":
        return (9.0,)
    value = 100 * (design.y_s - 0.12) ** 2 + math.log(float(gains["r_delta"]) / 300) ** 2
    return (value + (0.2 if design.law == "lqr" else abs(float(gains["horizon"]) - 33) / 30),)


SEEDS = pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.slow)])


@pytest.mark.slow
def test_a_search_is_clearly_better_than_chance() -> None:
    """The best of 100 designs in five dimensions of freedom, the median of five seeds: a third of chance's or less."""
    best: dict[str, list[float]] = {}
    for sampler in ("tpe", "random"):
        for seed in range(5):
            search = Search(make(ONE_LAW, seed, trials=100, batch=4, sampler=sampler))
            drive(search, bowl)
            assert len(search.asked) == 100
            best.setdefault(sampler, []).append(min(bowl(design)[0] for design in search.asked))
    assert np.median(best["tpe"]) < np.median(best["random"]) / 3


@SEEDS
def test_the_better_law_is_found_although_it_is_harder_to_tune(seeds: int) -> None:
    """Few MPCs of the first batches are better than an LQR, for want of the right horizon."""
    trials = 160 if seeds > 1 else 80
    for seed in range(seeds):
        search = Search(make(TWO_LAWS, seed, trials=trials, batch=8))
        drive(search, two_bowls)
        assert min(search.asked, key=two_bowls).law == "linear_mpc"
        laws = [design.law for design in search.asked]
        assert min(laws.count("lqr"), laws.count("linear_mpc")) >= trials // 4  # half of the proposals go in turn


@pytest.mark.parametrize(
    ("sampler", "objectives"),
    [
        ("tpe", ["S"]),
        ("nsga2", ["S", "a_y_peak_mean"]),
        *(
            pytest.param(sampler, objectives, marks=pytest.mark.slow)
            for sampler, objectives in (("tpe", ["S", "a_y_peak_mean"]), ("nsga2", ["S"]), ("random", ["S"]))
        ),
    ],
)
def test_the_same_values_lead_to_the_same_designs(sampler: str, objectives: list[str]) -> None:
    """A search that is started anew and told the same asks the same; the order within a batch does not matter."""

    def objective(design: Design) -> tuple[float, ...] | None:
        if int(design.id, 16) % 7 == 0:
            return None
        return (two_bowls(design)[0], 1 / design.y_s)[: len(objectives)]

    study = make(TWO_LAWS, 3, trials=30, batch=7, sampler=sampler, objectives=objectives)
    first = Search(study)
    batches = drive(first, objective)
    again = Search(Study.from_dict(json.loads(json.dumps(study.content()))))
    for wanted in batches:
        assert again.ask() == wanted
        again.tell({design.id: objective(design) for design in reversed(wanted)})
    assert again.ask() == ()
    assert again.asked == first.asked == tuple(design for batch in batches for design in batch)
    assert len({design.id for design in first.asked}) == 30
    other = Search(make(TWO_LAWS, 4, trials=30, batch=7, sampler=sampler, objectives=objectives))
    assert other.ask()[1:] != batches[0][1:]


HASHED = """
from ldctoolkit.studies import Study
from ldctoolkit.studies.search import Search
block = {"law": "linear_mpc", "y_s": {"from": 0.05, "to": 0.3}, "gains": {"horizon": {"from": 5, "to": 60},
         "q_psi": {"from": 0, "to": 4}, "blocks": [0, 3, 5], "solver": ["osqp", "daqp"]},
         "when": {"blocks": {"solver": "osqp"}}}
search = Search(Study.from_dict({"name": "s", "search": {"trials": 40, "batch": 6}, "design": [block]}))
while batch := search.ask():
    search.tell({d.id: (d.y_s + dict(d.gains)["q_psi"],) for d in batch})
print(*(d.id for d in search.asked))
"""


@pytest.mark.slow
def test_the_designs_do_not_depend_on_the_process() -> None:
    """Python orders sets of words anew in every process."""
    told = set()
    for hash_seed in ("1", "2"):
        environment = os.environ | {"PYTHONHASHSEED": hash_seed}
        done = subprocess.run(
            [sys.executable, "-W", "default", "-c", HASHED], capture_output=True, text=True, check=True, env=environment
        )
        assert done.stderr == ""  # nor a log line, nor a warning
        told.add(done.stdout)
    assert len(told) == 1


@pytest.mark.parametrize(("objective", "most"), [("S", 0.3), ("reduction", 1.0)])
def test_objectives_of_which_more_is_better_are_made_large(objective: str, most: float) -> None:
    search = Search(make([{"law": "toy", "y_s": {"from": 0.0, "to": 1.0}}], trials=30, batch=3, objectives=[objective]))
    drive(search, lambda design: (design.y_s,))
    assert most - 0.3 <= np.mean([design.y_s for design in search.asked[15:]]) <= most


@pytest.mark.parametrize(
    ("design", "batches"),
    [
        ([{"law": "toy", "y_s": [0.1, 0.2], "gains": {"N": [3, 4, 5]}}, {"law": "none"}], [4, 3]),
        ([{"law": "toy", "y_s": [0.1, 0.2, 0.3]}, {"law": "toy", "y_s": [0.2, 0.3, 0.4]}], [4]),  # tables that share
        # N = 3, 4, 6 with it, the default without
        ([{"law": "toy", "gains": {"N": [3, 4, 6], "on": [True, False]}, "when": {"N": {"on": True}}}], [4]),
    ],
)
def test_a_design_is_asked_for_once_and_a_small_space_comes_to_its_end(design: Any, batches: list[int]) -> None:
    """However many trials there are; those without a choice first."""
    search = Search(make(design, trials=500, batch=4))
    asked = drive(search, lambda design: (design.y_s,))
    assert [len(batch) for batch in asked] == batches
    assert len({design.id for design in search.asked}) == sum(batches)
    assert asked[0][0].law == design[-1]["law"]


def test_every_law_has_random_numbers_of_its_own() -> None:
    block = {"law": ["toy", "boom"], "y_s": {"from": 0.0, "to": 1.0}}
    asked = Search(make([block], trials=6, batch=6, sampler="random")).ask()
    assert ({design.law for design in asked}, len({design.y_s for design in asked})) == ({"toy", "boom"}, 6)


def test_a_space_whose_conditions_merge_designs_comes_to_its_end() -> None:
    block = [{"law": "toy", "gains": {"N": [3, 4, 6], "on": [True, False]}, "when": {"N": {"on": True}}}]
    search = Search(make(block, trials=50, batch=2))
    drive(search, lambda design: (1.0,))
    assert len(search.asked) == 4  # N = 3, 4, 6 with it, the default without


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_conditions_decide_what_varies(sampler: str) -> None:
    gains = {"N": {"from": 20, "to": 50}, "on": [True, False], "K": {"from": -1, "to": 0}}
    search = Search(make([{"law": "toy", "gains": gains, "when": {"N": {"on": True}}}], trials=30, sampler=sampler))
    drive(search, lambda design: (float(dict(design.gains)["K"]),))
    off = [dict(d.gains) for d in search.asked if not dict(d.gains)["on"]]
    assert off
    assert {gains["N"] for gains in off} == {5}
    assert all(int(dict(d.gains)["N"]) >= 20 for d in search.asked if dict(d.gains)["on"])


def test_ranges_are_kept_and_logs_may_be_negative() -> None:
    gains = {"K": {"from": -0.01, "to": -1.0, "scale": "log"}, "N": {"from": 2, "to": 40}}
    search = Search(make([{"law": "toy", "gains": gains}], trials=200, batch=50, sampler="random"))
    drive(search, lambda design: (0.0,))
    K = np.array([float(dict(d.gains)["K"]) for d in search.asked])
    N = [dict(d.gains)["N"] for d in search.asked]
    assert ((K >= -1) & (K <= -0.01)).all()
    assert np.median(np.log10(-K)) == pytest.approx(-1, abs=0.2)  # standard error 0.07
    assert {type(n) for n in N} == {int}
    assert set(N) <= set(range(2, 41))
    assert all(float(f"{k:.12g}") == k for k in K)


def test_failed_designs_are_never_asked_again_and_do_not_stop_the_search() -> None:
    """All trials fail above y_s = 0.5, by None or by a value that is not a number; the best are found below."""

    def objective(design: Design) -> tuple[float, ...] | None:
        if design.y_s > 0.75:
            return None
        return (math.nan,) if design.y_s > 0.5 else (1 - design.y_s,)

    search = Search(make([{"law": "toy", "y_s": {"from": 0.0, "to": 1.0}}], trials=40, batch=8))
    drive(search, objective)
    assert len(search.asked) == 40
    assert max(d.y_s for d in search.asked if d.y_s <= 0.5) > 0.47
    nothing = Search(make(TWO_LAWS, trials=30, batch=8))
    drive(nothing, lambda design: None)
    assert len(nothing.asked) == 30


def test_what_is_told_wrongly_is_refused_and_changes_nothing() -> None:
    search = Search(make(ONE_LAW, trials=8, batch=2))
    first, second = search.ask()
    with pytest.raises(InputError, match=f"the last batch has no values yet: {first.id}, {second.id}"):
        search.ask()
    with pytest.raises(InputError, match=f"design {second.id} was proposed and is missing"):
        search.tell({first.id: (1.0,)})
    with refused("tell", value="x", allowed={first.id, second.id}):
        search.tell({first.id: (1.0,), second.id: (1.0,), "x": (1.0,)})
    with pytest.raises(InputError, match=r"2 values; allowed: 1, one for each objective"):
        search.tell({first.id: (1.0,), second.id: (1.0, 2.0)})
    search.tell({first.id: (1.0,), second.id: None})
    assert len(search.ask()) == 2


def test_a_study_without_search_or_with_an_unknown_objective_is_refused() -> None:
    with pytest.raises(InputError, match=r"no \[search\] table"):
        Search(Study.from_dict({"name": "s", "design": [{"law": "none"}]}))
    with pytest.raises(StudyError) as refused:
        Search(make(ONE_LAW, objectives=["T"]))
    assert refused.value.value == "T"


def test_without_optuna_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(InputError) as refused:
        Search(make(ONE_LAW))
    assert (refused.value.path, refused.value.value) == ("search.method", "optuna")
    assert 'pip install "ldctoolkit[search]"' in refused.value.hint


def test_optunas_own_settings_are_left_as_they_were() -> None:
    import optuna

    optuna.logging.set_verbosity(optuna.logging.DEBUG)
    try:
        with contextlib.redirect_stderr(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("error")
            drive(Search(make(TWO_LAWS, trials=30, batch=5)), two_bowls)
        assert optuna.logging.get_verbosity() == optuna.logging.DEBUG
    finally:
        optuna.logging.set_verbosity(optuna.logging.INFO)


# --- requirements -----------------------------------------------------------------------------------------------------
def restricted(design: Any, require: list[str], seed: int = 0, **search: Any) -> Study:
    content = {"name": "s", "seed": seed, "search": search, "design": design, "ranking": {"require": require}}
    return Study.from_dict(content)


@pytest.mark.parametrize(
    ("sampler", "objectives"),
    [
        ("tpe", ["S"]),
        pytest.param("tpe", ["S", "a_y_peak_mean"], marks=pytest.mark.slow),
        pytest.param("nsga2", ["S"], marks=pytest.mark.slow),
        pytest.param("nsga2", ["S", "a_y_peak_mean"], marks=pytest.mark.slow),
    ],
)
def test_a_search_keeps_to_what_the_ranking_requires(sampler: str, objectives: list[str]) -> None:
    """The first cost falls towards y_s = 0, and only 0.6 to 1 is allowed; below 0.3 there is no figure for it."""

    def costs(design: Design) -> tuple[float, ...]:
        return (design.y_s, float(dict(design.gains)["q_psi"]))[: len(objectives)]

    def margins(design: Design) -> tuple[float, ...]:
        return (0.6 - design.y_s if design.y_s > 0.3 else math.inf, -1.0)

    block = [ONE_LAW[0] | {"y_s": {"from": 0.0, "to": 1.0}}]
    study = restricted(block, ["S <= 1", "deeper <= 0.5"], trials=120, batch=6, sampler=sampler, objectives=objectives)
    search, again = Search(study), Search(study)
    drive(search, costs, margins)
    met = np.array([design.y_s for design in search.asked]) >= 0.6
    # of six seeds the least is 0.47 of the second half (with optuna 4 one is 0.43), and the most 0.27 without; the best
    # lie next to the limit
    assert met[60:].mean() > 0.4
    assert min(design.y_s for design in search.asked if design.y_s >= 0.6) < 0.65
    # the same margins, the same designs, whatever the order in a batch
    while len(again.asked) < 40 and (batch := again.ask()):
        again.tell({d.id: costs(d) for d in reversed(batch)}, {d.id: margins(d) for d in reversed(batch)})
    assert again.asked == search.asked[: len(again.asked)]


def test_chance_is_not_led_by_requirements() -> None:
    block = [{"law": "toy", "y_s": {"from": 0.0, "to": 1.0}}]
    free, bound = (Search(restricted(block, ["S <= 1"], trials=20, batch=4, sampler="random")) for _ in range(2))
    drive(free, lambda design: (design.y_s,))
    drive(bound, lambda design: (design.y_s,), lambda design: (0.6 - design.y_s,))
    assert free.asked == bound.asked


@pytest.mark.parametrize("distance", [-1.0, 2.0])
def test_laws_that_meet_the_requirements_are_asked_more_often(distance: float) -> None:
    """The LQR costs nothing and is farther from the limit; the MPC meets it, or comes nearer."""
    search = Search(restricted(TWO_LAWS, ["S <= 1"], trials=61, batch=5, sampler="random"))
    drive(
        search,
        lambda design: (0.0 if design.law == "lqr" else 1.0,),
        lambda design: (5.0 if design.law == "lqr" else distance,),
    )
    laws = [design.law for design in search.asked]
    # one without control, half of the others in turn, half by rank but for the first batch
    assert laws.count("linear_mpc") >= 42


def test_designs_that_fail_have_no_margins_and_wrong_ones_are_refused() -> None:
    search = Search(restricted(ONE_LAW, ["S <= 1", "deeper <= 0.5"], trials=8, batch=2))
    first, second = search.ask()
    values: dict[str, Any] = {first.id: (1.0,), second.id: None}
    for margins in ((), (1.0,), (1.0, math.nan)):
        allowed = "2 numbers, one for each requirement"
        with refused(f"tell: margins of design {first.id}", value=margins, allowed=allowed):
            search.tell(values, {first.id: margins} if margins else {})
    search.tell(values, {first.id: (1.0, math.inf)})
    assert len(search.ask()) == 2


def test_a_run_asks_for_what_its_values_and_margins_lead_to(make_study: Callable[..., Study], tmp_path: Path) -> None:
    """Told by hand from the ranking of what ran: S, and how far S <= 0.9 and reduction > 0 are missed, as parts."""
    study = make_study(
        design=[{"law": "none"}, {"law": "lqr", "y_s": {"from": 0.05, "to": 0.3}, "gains": {"r_delta": [10, 5000]}}],
        search={"trials": 16, "batch": 4},
        simulation={},
        ranking={"bootstrap": 100, "finalists": 0, "require": ["S <= 0.9", "reduction > 0"]},
    )
    results = run_study(study, directory=tmp_path, workers=1)
    ranking = rank_study(results, study)
    assert any(ranking.unmet)
    assert not all(ranking.unmet)
    metrics = ranking.metrics
    figures = zip(ranking.designs, metrics.S.tolist(), metrics.reduction.tolist(), strict=True)
    told = {
        design: ((S,), ((S - 0.9) / 0.9, max(-reduction, 1e-12) if reduction <= 0 else -reduction))
        for design, S, reduction in figures
    }
    search = Search(study)
    drive(search, lambda design: told[design][0], lambda design: told[design][1])
    assert search.asked == results.designs
