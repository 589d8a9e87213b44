"""Sobol indices against functions whose indices are known, and profiles against direct simulation."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from helpers.closed_loop import Unsighted, known
from helpers.results import results_of as given_results
from helpers.results import results_of_outcomes
from ldctoolkit import Controller, EventStatus, LinearLaw, Plant, Scenarios, gain, simulate
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.scenario_model import load_model
from ldctoolkit.studies import Design, Study, StudyResults
from ldctoolkit.studies.ranking.inference import bootstrap_means
from ldctoolkit.studies.results import FailedDesign
from ldctoolkit.studies.sensitivity.sensitivity import (
    BlockSensitivity,
    factorial_shares,
    gain_value,
    rbd_fast_indices,
    saltelli_indices,
    sensitivity,
)
from ldctoolkit.studies.sensitivity.winner_profile import COLUMNS, Profile, winner_profile, write_sensitivity

ISHIGAMI_FIRST = (0.3139, 0.4424, 0.0)
ISHIGAMI_TOTAL = (0.5576, 0.4424, 0.2437)
"""Of sin a + 7 sin^2 b + 0.1 c^4 sin a over [-pi, pi]^3: Ishigami and Homma (1990), Saltelli et al. (2000)."""


@dataclasses.dataclass(frozen=True)
class Waves(Controller):
    name = "waves"
    title = "Waves"

    a: float = gain(0.0, unit="1", lower=-4.0, upper=4.0, description="a number")
    b: float = gain(0.0, unit="1", lower=-4.0, upper=4.0, description="a number")
    c: float = gain(0.0, unit="rad/m", lower=-4.0, upper=4.0, description="a number")
    N: int = gain(5, unit="samples", lower=1, upper=50, scale="log", description="a whole number")
    on: bool = gain(True, unit="1", description="a switch")

    def prepare(self, plant: Plant) -> LinearLaw:
        if self.c > 3.0:
            raise ZeroDivisionError("c is too large")
        n = plant.n
        F = np.tile([-0.01 * self.a, 0.0, -0.2 - 0.001 * self.N - 0.1 * self.on, 0.0], (n, 1))
        return LinearLaw(F, np.zeros(0), np.zeros((n, 0)), np.zeros((n, 0)), np.zeros(n))


@dataclasses.dataclass(frozen=True)
class Feedback(Unsighted):
    fails: bool

    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        status = EventStatus.SOLVER_FAILED if self.fails else EventStatus.OK
        return -0.02 * x[:, 0] - 0.3 * x[:, 2], state, np.full(t.size, status, dtype=np.int8)


@dataclasses.dataclass(frozen=True)
class GivingUp(Controller):
    name = "giving_up"
    title = "Giving up"

    K: float = gain(0.0, unit="1", lower=0.0, upper=9.0, description="says that it failed above 1")

    def prepare(self, plant: Plant) -> Feedback:
        return Feedback(self.K > 1.0)


@pytest.fixture(autouse=True)
def _laws() -> Iterator[None]:
    with known(Waves, GivingUp):
        yield


def study_of(*blocks: dict[str, Any], **parts: Any) -> Study:
    content = {"name": "s", "seed": 5, "ranking": {"bootstrap": 200}, "design": list(blocks)}
    return Study.from_dict(content | parts)


def results_of(
    study: Study, S: Callable[[Design], Any], n: int = 6, designs: tuple[Design, ...] | None = None, **parts: Any
) -> StudyResults:
    """Scores from a formula, which may give a number or one number a scenario; 100 is added to each."""
    designs = study.designs if designs is None else designs
    values = np.stack([np.broadcast_to(np.asarray(S(design), dtype=np.float64) + 100.0, n) for design in designs])
    return given_results(values, designs, uncorrected=90.0, parts=parts)


def ishigami(design: Design) -> float:
    a, b, c = (float(gain_value(design, name)) for name in "abc")
    return math.sin(a) + 7.0 * math.sin(b) ** 2 + 0.1 * c**4 * math.sin(a)


CUBE = {name: {"from": -math.pi, "to": math.pi} for name in "abc"}


# --- the formulas -----------------------------------------------------------------------------------------------------
@given(st.integers(0, 2**32), st.lists(st.integers(1, 4), min_size=1, max_size=4))
def test_the_shares_are_those_of_the_analysis_of_variance(seed: int, levels: list[int]) -> None:
    """Every effect by inclusion and exclusion of conditional means; its sum of squares goes to all that are part."""
    y = np.random.default_rng(seed).normal(size=levels)
    k, V = len(levels), float(y.var())
    first, total = factorial_shares(y[None])
    if y.size < 2:
        assert np.isnan(first).all()
        assert np.isnan(total).all()
        return
    axes = range(k)
    variance: dict[tuple[int, ...], float] = {}
    for size in axes:
        for part in itertools.combinations(axes, size + 1):
            effect = sum(
                (-1) ** (len(part) - len(kept)) * y.mean(axis=tuple(i for i in axes if i not in kept), keepdims=True)
                for count in range(len(part) + 1)
                for kept in itertools.combinations(part, count)
            )
            variance[part] = float(np.mean(np.square(effect)))
    assert sum(variance.values()) == pytest.approx(V)
    for i in axes:
        assert first[0, i] == pytest.approx(variance[(i,)] / V, abs=1e-9)
        assert total[0, i] == pytest.approx(sum(v for part, v in variance.items() if i in part) / V, abs=1e-9)


def test_samples_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match=r"k \+ 2 = 5 rows"):
        saltelli_indices(np.zeros(12), 3, confidence=0.95, seed=0)
    with pytest.raises(InputError) as caught:
        rbd_fast_indices(np.zeros((63, 1)), np.zeros(63), confidence=0.95, seed=0)
    assert (caught.value.path, caught.value.value) == ("designs", 63)
    even = (np.arange(64.0) + 0.5) / 64
    assert rbd_fast_indices(even[:, None], even, confidence=0.95, seed=0).first[0] > 0.9


# --- blocks of a study ------------------------------------------------------------------------------------------------
def only(blocks: tuple[BlockSensitivity, ...]) -> BlockSensitivity:
    assert len(blocks) == 1
    return blocks[0]


def test_a_full_grid_gives_the_indices_of_a_linear_function() -> None:
    """S = 3 a + 2 b + y_s: no interactions; the shares go with the squared slopes times the variances."""
    a, b, y_s = [-1.0, 0.0, 0.5, 2.0], [0.0, 3.0], [0.1, 0.2, 0.5]
    study = study_of({"law": "waves", "y_s": y_s, "gains": {"b": b, "a": a, "c": 1.0}})
    result = only(
        sensitivity(results_of(study, lambda d: 3 * gain_value(d, "a") + 2 * gain_value(d, "b") + d.y_s), study)
    )
    parts = np.array([np.var(y_s), 4 * np.var(b), 9 * np.var(a)])
    assert (result.names, result.method, result.designs) == (("y_s", "b", "a"), "factorial", 24)
    for index in ("first", "first_low", "first_high", "total", "total_low", "total_high"):
        # scores do not depend on the scenario: nor do the indices, whatever is drawn. 100 m s are added to all:
        # 14 of 16 digits are left, and the resampled means keep about twelve
        np.testing.assert_allclose(getattr(result.indices, index), parts / parts.sum(), rtol=1e-8)
    assert "exact for the grid" in result.note
    assert result.interval_over == "scenarios"


def test_a_grid_in_which_only_the_product_counts_is_all_interaction() -> None:
    study = study_of({"law": "waves", "gains": {"a": [-1.0, 1.0], "b": [-2.0, 2.0], "on": [True, False]}})
    result = only(sensitivity(results_of(study, lambda d: gain_value(d, "a") * gain_value(d, "b")), study))
    for end in ("", "_low", "_high"):
        np.testing.assert_allclose(getattr(result.indices, f"first{end}"), [0, 0, 0], atol=1e-9)
        np.testing.assert_allclose(getattr(result.indices, f"total{end}"), [1, 1, 0], atol=1e-9)


def test_the_interval_of_an_index_is_that_of_resampled_scenarios() -> None:
    """S = a s1 + b s2: the index of the mean slopes of each resample, and the 2.5 and 97.5 % quantiles of these."""
    a = [-1.0, 0.0, 1.0]
    study = study_of({"law": "waves", "gains": {"a": a, "b": a}})
    slopes = np.random.default_rng(1).normal([[2.0], [1.0]], 1.0, (2, 200))
    scores = results_of(study, lambda d: gain_value(d, "a") * slopes[0] + gain_value(d, "b") * slopes[1], n=200)
    result = only(sensitivity(scores, study)).indices
    means = bootstrap_means(slopes, scores.scenarios.side, samples=200, seed=5)
    index = means**2 / (means**2).sum(axis=1, keepdims=True)
    low, high = np.quantile(index, [0.025, 0.975], axis=0)
    for name in ("first", "total"):
        np.testing.assert_allclose(getattr(result, f"{name}_low"), low, rtol=1e-6)
        np.testing.assert_allclose(getattr(result, f"{name}_high"), high, rtol=1e-6)


def test_scores_count_as_in_the_ranking() -> None:
    """A failed scenario counts at least as without control, and one that some design cannot drive for none."""
    study = study_of({"law": "waves", "gains": {"a": [0.0, 1.0], "b": [0.0, 1.0]}})
    plain = results_of(study, lambda d: gain_value(d, "a"), n=4)
    S, status, before = plain.S.copy(), plain.status.copy(), plain.S_uncorrected.copy()
    S[:, 3], status[0, 3] = np.nan, EventStatus.INVALID
    S[1, 0], before[1, 0], status[1, 0] = 0.0, 112.0, EventStatus.SOLVER_FAILED  # a = 0, b = 1
    changed = dataclasses.replace(plain, S=S, status=status, S_uncorrected=before)
    result = only(sensitivity(changed, study)).indices
    first, total = factorial_shares(np.array([[[0.0, 4.0], [1.0, 1.0]]]))
    np.testing.assert_allclose(result.first, first[0], rtol=1e-9)
    np.testing.assert_allclose(result.total, total[0], rtol=1e-9)


@pytest.mark.parametrize(("count", "error"), [(128, 0.12), pytest.param(1024, 0.05, marks=pytest.mark.slow)])
def test_a_saltelli_sample_gives_the_known_indices_of_ishigami(count: int, error: float) -> None:
    """SALib's intervals hold the known values; of 1,024 base points they are +-0.08 at most."""
    study = study_of({"law": "waves", "gains": CUBE, "sample": {"method": "saltelli", "count": count, "seed": 1}})
    result = only(sensitivity(results_of(study, ishigami), study))
    assert (result.names, result.method, result.designs) == (("a", "b", "c"), "saltelli", 5 * count)
    one = result.indices
    np.testing.assert_allclose(one.first, ISHIGAMI_FIRST, atol=error)
    np.testing.assert_allclose(one.total, ISHIGAMI_TOTAL, atol=error)
    for index, wanted in (("first", ISHIGAMI_FIRST), ("total", ISHIGAMI_TOTAL)):
        low, high = getattr(one, f"{index}_low"), getattr(one, f"{index}_high")
        assert ((low <= wanted) & (wanted <= high)).all()
        assert (high - low < 4 * error).all()
    assert result.interval_over == "designs"


@pytest.mark.parametrize("method", ["sobol", pytest.param("latin_hypercube", marks=pytest.mark.slow)])
def test_an_even_sample_gives_the_first_order_indices_of_ishigami(method: str) -> None:
    """512 designs: the error of RBD-FAST has a standard deviation of 0.03 here."""
    study = study_of({"law": "waves", "gains": CUBE, "sample": {"method": method, "count": 512, "seed": 3}})
    result = only(sensitivity(results_of(study, ishigami), study))
    assert (result.method, result.designs) == ("rbd_fast", 512)
    np.testing.assert_allclose(result.indices.first, ISHIGAMI_FIRST, atol=0.1)
    assert np.isnan(result.indices.total).all()
    assert "total indices need a full grid" in result.note


def test_numbers_depend_on_the_study_only() -> None:
    study = study_of({"law": "waves", "gains": CUBE, "sample": {"method": "saltelli", "count": 64}}, seed=0)
    results = results_of(study, ishigami)
    order = np.random.default_rng(0).permutation(len(results.designs))
    rows = {name: getattr(results, name)[order] for name in ("S", "S_uncorrected", "status")}
    mixed = dataclasses.replace(results, designs=tuple(results.designs[i] for i in order), **rows)
    np.random.seed(1)  # noqa: NPY002  (SALib falls back on it without a seed)
    one, other = only(sensitivity(results, study)).indices, only(sensitivity(mixed, study)).indices
    for field in dataclasses.fields(one):  # type: ignore[arg-type]
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_every_law_of_every_table_has_its_own_indices() -> None:
    study = study_of(
        {"law": "none"},
        {"law": ["waves", "lqr"], "y_s": [0.1, 0.2], "gains": {"a": [0.0, 1.0], "r_delta": [10.0, 20.0, 30.0]}},
    )
    blocks = sensitivity(results_of(study, lambda d: d.y_s), study)
    assert [(block.block, block.law, block.names, block.designs) for block in blocks] == [
        (1, "waves", ("y_s", "a"), 4),
        (1, "lqr", ("y_s", "r_delta"), 6),
    ]


def test_why_there_are_no_indices_is_said() -> None:
    grid = {"law": "waves", "gains": {"a": [0.0, 1.0, 2.0]}}
    study = study_of(grid)
    a = study.designs
    assert "same mean S" in only(sensitivity(results_of(study, lambda d: 1.0), study)).reason

    failed = results_of(study, ishigami, designs=a[:2], failed=(FailedDesign(a[2], "raised"),))
    assert "1 of its 3 designs have no results" in only(sensitivity(failed, study)).reason

    searched = study_of({"law": "waves", "gains": CUBE}, search={"trials": 10})
    designs = tuple(Design.from_gains("waves", 0.2, {"a": x}) for x in (0.0, 1.0))
    assert "a search asks" in only(sensitivity(results_of(searched, ishigami, designs=designs), searched)).reason

    few = study_of({"law": "waves", "gains": CUBE, "sample": {"method": "sobol", "count": 32}})
    assert "at least 64" in only(sensitivity(results_of(few, ishigami), few)).reason

    when = study_of({"law": "waves", "gains": {"on": [True, False], "a": [0.0, 1.0]}, "when": {"a": {"on": [True]}}})
    assert "no full grid" in only(sensitivity(results_of(when, ishigami), when)).reason


def test_a_few_failed_designs_of_an_even_sample_are_left_out_and_counted() -> None:
    study = study_of({"law": "waves", "gains": CUBE, "sample": {"method": "latin_hypercube", "count": 200}})
    bad = study.designs[7]
    results = results_of(study, ishigami, designs=(*study.designs[:7], *study.designs[8:]),
                         failed=(FailedDesign(bad, "raised"),))  # fmt: skip
    result = only(sensitivity(results, study))
    assert result.designs == 199
    assert "1 failed designs are left out" in result.note
    # the others keep their places: 200 designs know an index to about 0.05
    np.testing.assert_allclose(result.indices.first, ISHIGAMI_FIRST, atol=0.2)


# --- the profile ------------------------------------------------------------------------------------------------------

SETTINGS: dict[str, Any] = {
    "simulation": {"dt": 0.1, "settle": 1.0},
    "plant": {"sensors": {"e_y_noise": 0.05}, "actuator": {"rate_max": 0.3}},
}


def driven(study: Study, designs: tuple[Design, ...] | None = None, n: int = 12) -> StudyResults:
    """What a run of the study gives, by `simulate` alone."""
    scenarios = load_model("reference").sample(n // 2, n - n // 2, seed=study.seed)
    designs = study.designs if designs is None else designs
    outcomes = [_outcome(study, design, scenarios) for design in designs]
    return results_of_outcomes(designs, scenarios, outcomes, study.simulation.window, study.simulation.convention)


def _outcome(study: Study, design: Design, scenarios: Scenarios) -> Any:
    setup = study.setup()
    return simulate(
        design.controller(setup.convention), scenarios, setup=setup, y_s=design.y_s, window=study.simulation.window
    )


def by_name(profiles: tuple[Profile, ...]) -> dict[str, Profile]:
    return {profile.name: profile for profile in profiles}


def reach(c: float, g: float) -> float:
    """Standard errors that an interval goes above a mean of skewness g; see docs/explanation/statistics.md."""
    return c + min(c, max(0.0, g * g * (c**5 + 2 * c**3 - 3 * c) / 18)) + max(0.0, g * (1 + 2 * c * c) / 6)


@pytest.mark.parametrize("window", ["departure", "control"])
def test_a_profile_is_what_simulate_gives(window: str) -> None:
    study = study_of(
        {"law": "waves", "y_s": [0.1, 0.3], "gains": {"a": [0.5, 2.0], "N": [2, 8]}},
        **SETTINGS | {"simulation": SETTINGS["simulation"] | {"window": window}},
        ranking={"bootstrap": 1000},
    )
    results = driven(study, n=30)
    winner = Design.from_gains("waves", 0.1, {"a": 2.0, "N": 8})
    counts: list[tuple[int, int]] = []
    profiles = by_name(winner_profile(results, study, winner, points=5, advance=lambda *c: counts.append(c)))
    assert (list(profiles), profiles["y_s"].values) == (["y_s", "a", "N"], (0.1, 0.15, 0.2, 0.25, 0.3))
    assert profiles["a"].values == (0.5, 0.875, 1.25, 1.625, 2.0)
    # whole, and even on a logarithmic scale
    assert profiles["N"].values == (2, 3, 4, 6, 8)
    at_winner = _outcome(study, winner, results.scenarios).S
    critical: list[float] = []
    for profile in profiles.values():
        assert profile.values[profile.at] == gain_value(winner, profile.name)
        assert profile.stored.tolist() == [True, False, False, False, True]
        rows = [_outcome(study, design, results.scenarios).S for design in profile.designs]
        np.testing.assert_allclose(profile.S, np.mean(rows, axis=1), rtol=1e-12)
        paired = np.stack(rows) - at_winner
        np.testing.assert_allclose(profile.difference, paired.mean(axis=1), rtol=1e-9, atol=1e-12)
        # all intervals have one critical value for scores without skewness, in standard errors of a mean of two strata
        strata = [paired[:, results.scenarios.side == side] for side in (1, -1)]
        error = np.sqrt(sum(part.shape[1] * part.var(axis=1, ddof=1) for part in strata)) / paired.shape[1]
        third = sum((part.shape[1] / (part.shape[1] - 1)) ** 1.5 * ((part.T - part.mean(axis=1)) ** 3).sum(axis=0)
                    for part in strata) / paired.shape[1] ** 3  # fmt: skip
        for i in np.flatnonzero(error > 0):
            g = third[i] / error[i] ** 3
            above = (profile.high[i] - profile.difference[i]) / error[i]
            critical.append(scipy.optimize.brentq(lambda c, g=g, above=above: reach(c, g) - above, 0.5, 50.0))
            below = (profile.difference[i] - profile.low[i]) / error[i]
            np.testing.assert_allclose(below, reach(critical[-1], -g), rtol=1e-8)
        assert profile.low[profile.at] == profile.high[profile.at] == 0.0
        assert {design.law for design in profile.designs} == {"waves"}
    np.testing.assert_allclose(critical, critical[0], rtol=1e-8)
    # between one comparison's and Bonferroni's for all; 1,000 resamples give the quantile to a few per cent
    df = len(results.scenarios) - 2
    assert 0.95 * scipy.stats.t.ppf(0.975, df) < critical[0] < 1.1 * scipy.stats.t.ppf(1 - 0.025 / len(critical), df)
    # nine designs and the winner, which is driven once more to see that nothing has changed
    assert counts == [(i, 10) for i in range(1, 11)]
    assert (profiles["a"].unit, profiles["y_s"].unit) == ("1", "m")


def test_driven_designs_count_as_stored_ones_do() -> None:
    """A law that steers well and says that it failed counts as if it had not steered."""
    study = study_of({"law": "giving_up", "gains": {"K": [0.0, 1.0, 2.0]}}, simulation={"dt": 0.1})
    results = driven(study, study.designs[:2])
    profile = winner_profile(results, study, study.designs[0], points=3)[0]
    assert profile.stored.tolist() == [True, True, False]
    whole = driven(study)
    assert (whole.counted[2] > whole.S[2]).any()
    np.testing.assert_allclose(profile.S, whole.counted.mean(axis=1), rtol=1e-12)


def test_no_points_take_what_the_study_holds() -> None:
    """A line of three along a, nothing else next to the winner in y_s, and no run."""
    designs = [(0.1, 0.5), (0.1, 1.0), (0.1, 2.0), (0.3, 0.7)]
    blocks = [{"law": "waves", "y_s": y_s, "gains": {"a": a}} for y_s, a in designs]
    study = study_of(*blocks)
    results = results_of(study, lambda d: (gain_value(d, "a") - 1.2) ** 2)
    profiles = winner_profile(results, study, study.designs[1], points=0)
    assert [(profile.name, profile.values) for profile in profiles] == [("a", (0.5, 1.0, 2.0))]
    np.testing.assert_allclose(profiles[0].difference, [0.45, 0.0, 0.6], rtol=1e-9)
    assert profiles[0].stored.all()
    assert profiles[0].spread == pytest.approx(0.6)
    assert profiles[0].best == profiles[0].at == 1
    assert profiles[0].beyond is None


def test_switches_are_all_tried_and_a_law_that_fails_is_named() -> None:
    study = study_of(
        {"law": "waves", "gains": {"on": True, "c": [0.0, 2.9]}},
        {"law": "waves", "gains": {"on": False, "c": 3.2}},
        simulation={"dt": 0.1},
    )
    results = driven(study, study.designs[:2])
    profiles = by_name(winner_profile(results, study, study.designs[0], points=3))
    assert (profiles["on"].values, profiles["on"].stored.tolist()) == ((True, False), [True, False])
    assert np.isfinite(profiles["on"].S).all()
    # 1.6 is the middle of the range; the end is there although 2.9 is in the study and close to it
    assert profiles["c"].values == (0.0, 1.6, 2.9, 3.2)
    wide = by_name(winner_profile(results, study, study.designs[0], points=41))["c"]
    assert wide.values[-1] == 3.2
    assert "ZeroDivisionError: c is too large" in wide.failures[-1]
    assert np.isnan(wide.S[-1])
    assert np.isfinite(wide.S[np.array(wide.values, dtype=float) <= 3.0]).all()
    assert np.isfinite(wide.spread)


@pytest.mark.parametrize(
    ("a", "S", "end"),
    [
        ([0.0, 1.0, 2.0], lambda a: -a, 2.0),
        ([2.0, 0.0, 1.0], lambda a: a, 0.0),
        ([0.0, 1.0, 2.0], lambda a: abs(a - 1.0), None),  # least inside
        ([0.0, 1.0, 4.0], lambda a: -a, None),  # the law itself ends at 4
        ([0.0, 1.0, 2.0], lambda a: -1e-9 * a, None),  # solver tolerance
        ([0.0, 1.0, 2.0], lambda a: -0.1 * a + a * np.array([5.0, -5.0] * 3), None),  # chance
    ],
)
def test_the_end_of_a_range_is_told_where_s_falls(a: list[float], S: Callable[[float], Any], end: float | None) -> None:
    study = study_of({"law": "waves", "gains": {"a": a, "on": [False, True]}})
    results = results_of(study, lambda d: S(float(gain_value(d, "a"))))
    best = min(study.designs, key=lambda d: float(np.mean(S(float(gain_value(d, "a"))))))
    profiles = by_name(winner_profile(results, study, best, points=0))
    assert profiles["a"].beyond == end
    assert profiles["on"].beyond is None


def test_the_end_is_told_where_only_the_profile_gets_there() -> None:
    """The design is inside, S at the end is smaller for certain, or for all one knows not."""
    study = study_of({"law": "waves", "gains": {"a": [0.0, 1.0, 2.0]}})
    inside = study.designs[1]
    for noise, end in ((0.0, 2.0), (5.0, None)):
        S = results_of(study, lambda d, n=noise: (0.1 + n * np.array([1.0, -1.0] * 3)) * -gain_value(d, "a"))
        assert by_name(winner_profile(S, study, inside, points=0))["a"].beyond == end


@pytest.mark.parametrize("more", [{}, {"search": {"trials": 8}}])
def test_a_range_ends_where_the_study_file_says(more: dict[str, Any]) -> None:
    """Not at the smallest and largest number that was drawn, however close these are."""
    block: dict[str, Any] = {
        "law": "waves",
        "y_s": {"from": 0.3, "to": 0.05},
        "gains": {"a": {"from": -1.0, "to": 1.0}, "N": {"from": 2, "to": 9}, "on": [True, False]},
    }
    drawn = study_of(block | {"sample": {"method": "sobol", "count": 8}}, simulation={"dt": 0.1})
    study = study_of(block, simulation={"dt": 0.1}, **more) if more else drawn
    results = driven(study, drawn.designs)
    # the design with the smallest threshold of those drawn, and something to fall on towards it
    middle = min(drawn.designs, key=lambda d: d.y_s)
    assert 0.05 < middle.y_s < 0.09
    held = by_name(winner_profile(results, study, middle, points=0))
    assert "y_s" not in held
    profiles = by_name(winner_profile(results, study, middle, points=4))
    assert list(profiles) == ["y_s", "a", "N", "on"]
    assert (profiles["y_s"].values[0], profiles["y_s"].values[-1]) == (0.05, 0.3)
    assert profiles["y_s"].at == 1
    assert (profiles["a"].values[0], profiles["a"].values[-1]) == (-1.0, 1.0)
    assert (profiles["N"].values[0], profiles["N"].values[-1]) == (2, 9)
    assert ({type(value) for value in profiles["N"].values}, set(profiles["on"].values)) == ({int}, {True, False})
    assert len(set(profiles["y_s"].values)) == len(profiles["y_s"].values)


def test_a_study_that_cannot_be_reproduced_gets_no_driven_designs() -> None:
    study = study_of({"law": "waves", "gains": {"a": [0.0, 1.0]}})
    results = driven(study)
    other = dataclasses.replace(results, S=results.S + 1e-3)
    with pytest.raises(LdcError, match="does not give its stored scores"):
        winner_profile(other, study, study.designs[0])
    assert winner_profile(other, study, study.designs[0], points=0)[0].stored.all()


def test_a_winner_from_elsewhere_and_negative_points_are_refused() -> None:
    study = study_of({"law": "waves", "gains": {"a": [0.0, 1.0]}})
    results = results_of(study, ishigami)
    with pytest.raises(InputError, match="not among the results"):
        winner_profile(results, study, Design.from_gains("none", 0.2, {}))
    with pytest.raises(InputError, match="points: -1"):
        winner_profile(results, study, study.designs[0], points=-1)
    assert winner_profile(results_of(study_of({"law": "none"}), lambda d: 1.0), study_of({"law": "none"}),
                          Design.from_gains("none", 0.2, {})) == ()  # fmt: skip


def test_the_table_holds_all_of_it(tmp_path: Path) -> None:
    import polars as pl

    study = study_of(
        {"law": "waves", "gains": {"a": [0.0, 1.0, 2.0], "b": [0.0, 1.0]}},
        {"law": "waves", "gains": CUBE, "sample": {"method": "sobol", "count": 16}},
    )
    results = results_of(study, lambda d: gain_value(d, "a") ** 2 * (1 + gain_value(d, "b")))
    blocks = sensitivity(results, study)
    profiles = winner_profile(results, study, study.designs[0], points=0)
    write_sensitivity(blocks, profiles, tmp_path / "s.csv")
    table = pl.read_csv(tmp_path / "s.csv", infer_schema_length=None)
    assert table.columns == list(COLUMNS)
    total = table.filter(pl.col("kind") == "total")
    assert total["index"].to_list() == blocks[0].indices.total.tolist()
    assert total["dimension"].to_list() == ["a", "b"]
    assert table.filter(pl.col("kind") == "none")["note"].to_list() == [blocks[1].reason]
    rows = table.filter((pl.col("kind") == "profile") & (pl.col("dimension") == "a"))
    assert rows["value"].to_list() == [0.0, 1.0, 2.0]
    assert rows["S_m_s"].to_list() == profiles[0].S.tolist()
    assert rows["design"].to_list() == [design.id for design in profiles[0].designs]
