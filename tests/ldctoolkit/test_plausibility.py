"""Limits of plausibility: which departures keep them, and what fits, densities and draws make of them."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import ks_2samp, multivariate_normal

from helpers.cli import bad
from helpers.errors import refused
from helpers.models import varied_departures
from ldctoolkit import load_model
from ldctoolkit.departures import LEFT, RIGHT, DepartureParameters, Plausibility
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.recordings import Criteria, Provenance, write_departures
from ldctoolkit.scenario_model import ModelProvenance, ScenarioModel, SideModel, fit_scenario_model

LIMITS = {"y_rate": 2.0, "y_acceleration": 4.0, "a_y": 6.0}
NONE = dict.fromkeys(LIMITS, math.inf)
TIGHT = {"y_rate": 0.6, "y_acceleration": 0.6, "a_y": 2.0}


def asked(p: DepartureParameters, times: int) -> dict[str, np.ndarray]:
    """The lateral speed at the line, the largest |y''| and |v^2 c + y''| of y(x(t)), and the least v, at many times."""
    result: list[list[np.ndarray]] = []
    rows = 1_000_000 // times
    for first in range(0, len(p), rows):
        part = p.take(slice(first, first + rows))
        share = np.linspace(0.0, 1.0, times)[:, None]
        v, d_x = part.v_mean + part.a_mean * (share - 0.5) * part.T, part.v_mean * part.T
        x = share * d_x - 0.5 * part.a_mean * share * (1.0 - share) * part.T**2
        # y = 4 d_y x (d_x - x)/d_x^2, differentiated twice by the chain rule
        bend = 4.0 * part.d_y / d_x**2 * ((d_x - 2.0 * x) * part.a_mean - 2.0 * v**2)
        total = v**2 * (part.c_0 + part.dc * share) + bend
        result.append([4.0 * part.d_y / part.T, np.abs(bend).max(axis=0), np.abs(total).max(axis=0), v.min(axis=0)])
    return dict(zip((*LIMITS, "v"), map(np.concatenate, zip(*result, strict=True)), strict=True))


def within(p: DepartureParameters, limits: dict[str, float], times: int = 61) -> np.ndarray:
    """Which departures keep the limits; between two times they may go beyond by a hair."""
    most = asked(p, times)
    return np.all([most[name] <= limit * (1.0 + 1e-9) for name, limit in limits.items()], axis=0)


def random_departures(n: int, *, seed: int, standing: bool) -> DepartureParameters:
    """Of any kind, with strong accelerations and changes of curvature; `standing`: some come to a stop, or reverse."""
    rng = np.random.default_rng(seed)
    T, v = rng.uniform(0.5, 10.0, n), rng.uniform(5.0, 40.0, n)
    a = rng.uniform(-1.0, 1.0, n) * np.minimum(9.81, math.inf if standing else 2.0 * (v - 1.0) / T)
    d_y = rng.gamma(2.0, 0.2, n) * rng.choice([0.3, 1.0, 3.0], n)
    c_0, dc = (rng.normal(0.0, 5e-3, n) * rng.choice([0.0, 0.2, 1.0, 3.0], n) for _ in range(2))
    return DepartureParameters(np.full(n, LEFT), T, d_y, 0.0 * T, v, a, 0.0 * T, c_0, dc)


@pytest.mark.parametrize("standing", [False, True])
def test_holds_equals_a_look_at_every_time(standing):
    """All limits at once, and each alone."""
    p = random_departures(8_000, seed=7, standing=standing)
    most = asked(p, 1001)
    for limits in (LIMITS, *(NONE | {name: value} for name, value in LIMITS.items())):
        clear = np.all([np.abs(most[name] - limit) > 1e-3 for name, limit in limits.items()], axis=0)
        expected = np.all([most[name] <= limit for name, limit in limits.items()], axis=0)
        assert clear.mean() > 0.99
        assert 0.05 < expected.mean() < 0.95
        np.testing.assert_array_equal(Plausibility(**limits).holds(p)[clear], expected[clear])


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("value", [0, -1.5, math.nan, True, "2", ()])
def test_a_wrong_limit_is_refused(name, value):
    with pytest.raises(InputError) as error:
        Plausibility(**{name: value})
    assert (error.value.path, error.value.allowed) == (f"plausibility.{name}", "a number > 0")
    assert error.value.value is value


def test_an_infinite_limit_is_none():
    p = random_departures(2_000, seed=1, standing=True)
    assert Plausibility(**NONE).holds(dataclasses.replace(p, d_y=1e3 * p.d_y)).all()
    np.testing.assert_array_equal(Plausibility(**NONE | {"y_rate": 2.0}).holds(p), 4.0 * p.d_y <= 2.0 * p.T)


@pytest.mark.parametrize(
    ("given", "n"),
    [(None, 100_000), ({"T": (0.5, 0.8)}, 100_000), ({"d_y": 0.6}, 20_000), ({"d_y": 0.9, "T": (1.5, 2.2)}, 20_000)],
)
def test_no_draw_of_the_bundled_model_is_beyond_its_limits(given, n):
    model = load_model("reference")
    assert model.plausibility == Plausibility(y_rate=2.0, y_acceleration=4.0, a_y=6.0)
    drawn = model.sample(n, n, seed=5, given=given)
    assert within(drawn, LIMITS).sum() == 2 * n


def test_a_condition_leaves_what_it_leaves_of_all_draws():
    """The distribution of d_y and c_0 in short departures, from rejection: samples of 20,000 and about as many."""
    model = load_model("reference")
    some, every = model.sample(20_000, 0, seed=1, given={"T": (0.5, 0.9)}), model.sample(200_000, 0, seed=2)
    for name in ("d_y", "c_0"):
        rest = getattr(every, name)[every.T < 0.9]
        assert rest.size > 5_000
        assert ks_2samp(getattr(some, name), rest).pvalue > 1e-4


@pytest.mark.parametrize("kind", ["mixture", "smoothed"])
def test_a_model_of_120_departures_keeps_the_limits(kind):
    table = varied_departures(60)
    model = fit_scenario_model(dataclasses.replace(table, d_y=2.0 * table.d_y), components=1, kind=kind, workers=1)
    assert model.plausibility == Plausibility(**LIMITS)
    assert min(model.redrawn_share(side) for side in (LEFT, RIGHT)) > 0.002  # there is something to refuse
    assert within(model.sample(20_000, 20_000, seed=3), LIMITS).all()


def test_the_density_of_two_parameters_integrates_to_one():
    means, covariances = [[1.0, 0.4], [2.0, 0.7]], [[[0.2, 0.0], [0.0, 0.05]], [[0.4, 0.1], [0.1, 0.1]]]
    box = {"lower": [0.5, 0.0], "upper": [4.0, 1.5]}
    mixture = BoundedGaussianMixture.from_parameters([0.4, 0.6], means, covariances, **box)
    constants = {"sigma_y": 0.02, "v_mean": 6.0, "a_mean": -3.0, "sigma_v": 0.1, "c_0": -0.03, "dc": -0.02}
    side = SideModel(mixture, ("T", "d_y"), tuple(constants.items()))
    model = ScenarioModel(side, side, ModelProvenance({}), Plausibility())
    T, d_y = (low + (high - low) * (np.arange(900) + 0.5) / 900 for low, high in ((0.5, 4.0), (0.0, 1.5)))
    cell, x = 3.5 * 1.5 / 900**2, np.column_stack([one.ravel() for one in np.meshgrid(T, d_y)])
    p = model.parameters(RIGHT, x)
    density = np.exp(model.log_density(p))
    assert density.sum() * cell == pytest.approx(1.0, abs=2e-3)
    possible = within(p, LIMITS, times=21) & (asked(p, 2)["v"] >= 1.0)  # and can be replayed
    assert np.mean((density > 0.0) != possible) < 1e-4  # a path may go beyond between two times
    excluded = 1.0 - np.exp(mixture.distribution.log_density(x))[possible].sum() * cell
    assert 0.2 < excluded < 0.8
    assert model.redrawn_share(RIGHT, events=1_048_576) == pytest.approx(excluded, abs=2e-3)


def drawn_with_numpy(side: SideModel, n: int, widen: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a side's mixture, whose components lie inside the box, and their log-density; the covariances can be
    multiplied by a factor."""
    mixture, (lower, upper), rng = side.mixture, side.bounds(), np.random.default_rng(17)
    np.testing.assert_allclose(mixture.log_probabilities_, 0.0, atol=1e-9)
    parts = list(zip(mixture.weights_, mixture.means_, widen * mixture.covariances_, strict=True))
    counts = rng.multinomial(n, mixture.weights_)
    y = np.concatenate([rng.multivariate_normal(m, S, k) for (_, m, S), k in zip(parts, counts, strict=True)])
    log_q = logsumexp([np.log(w) + multivariate_normal(m, S).logpdf(y) for w, m, S in parts], axis=0)
    x = y.copy()
    for j, kind in enumerate(side.transform()):
        if kind == "log":
            x[:, j] = lower[j] + np.exp(y[:, j])
            log_q -= y[:, j]
        elif kind == "logit":
            x[:, j] = lower[j] + (upper[j] - lower[j]) / (1.0 + np.exp(-y[:, j]))
            log_q += np.log(upper[j] - lower[j]) - np.log(x[:, j] - lower[j]) - np.log(upper[j] - x[:, j])
    return x, log_q


@pytest.mark.parametrize("limits", [LIMITS, TIGHT])
@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_the_bundled_density_integrates_to_one(side, limits):
    """By importance sampling from a wider mixture; the tight limits leave 0.6 of the mixture."""
    model = dataclasses.replace(load_model("reference"), plausibility=Plausibility(**limits))
    x, log_q = drawn_with_numpy(model.side(side), 40_000, widen=1.15)
    weight = np.exp(model.log_density(model.parameters(side, x)) - log_q)
    error = weight.std() / math.sqrt(weight.size)
    assert error < 0.02
    assert abs(weight.mean() - 1.0) < 4.0 * error


@pytest.mark.parametrize("side", [LEFT, RIGHT])
def test_the_excluded_probability(side):
    """As the model tells it and as its density has it, against a count."""
    model, n, events = load_model("reference"), 150_000, 1_048_576
    x, log_q = drawn_with_numpy(model.side(side), n)
    p = model.parameters(side, x)
    possible = within(p, LIMITS) & (asked(p, 2)["v"] >= 1.0)
    share = 1.0 - possible.mean()
    one = math.sqrt(share * (1.0 - share))
    assert 0.001 < share < 0.02
    assert abs(model.redrawn_share(side, events=events) - share) < 4.0 * one * math.sqrt(1 / n + 1 / events)
    card = model.provenance.left if side == LEFT else model.provenance.right
    assert abs(card.redrawn_share - share) < 4.0 * one * math.sqrt(1 / n + 1 / 16_384)
    ratio = np.exp(model.log_density(p) - log_q)  # 1/(1 - share) where possible, 0 elsewhere
    assert abs(ratio.mean() - 1.0) < 4.0 * one * math.sqrt(1 / n + 1 / events)
    np.testing.assert_allclose(ratio[possible], ratio.max(), rtol=1e-6)


def test_a_fit_leaves_out_what_is_implausible_and_records_the_limits(tmp_path: Path):
    table = varied_departures(60)
    d_y, dc = table.d_y.copy(), table.dc.copy()
    d_y[::20], dc[5::20] = 9.0, 0.1  # 3.6 m/s or more at the line; a bend of 10 m radius
    table = dataclasses.replace(table, d_y=d_y, dc=dc)
    limits, settings = LIMITS | {"y_rate": 1.5}, {"components": 1, "kind": "mixture", "workers": 1}
    own, kept = Plausibility(y_rate=1.5), within(table, limits)
    assert 80 < kept.sum() <= 108
    model = fit_scenario_model(table, extraction=Criteria(plausibility=own), **settings)
    same = fit_scenario_model(table.take(kept), extraction=Criteria(), plausibility=own, **settings)
    assert (model.plausibility, model.content_hash) == (own, same.content_hash)
    assert model.provenance.left.events + model.provenance.right.events == kept.sum()
    second = [Plausibility(**first) for first in (LIMITS, TIGHT, NONE | {"a_y": 5.0})]
    models = [dataclasses.replace(model, plausibility=first) for first in second]
    assert len({first.content_hash for first in models}) == 3
    for first in models:
        first.save(tmp_path / "m.json")
        back = ScenarioModel.load(tmp_path / "m.json")
        assert (back.plausibility, back.content_hash) == (first.plausibility, first.content_hash)
        np.testing.assert_array_equal(back.sample(50, 0, seed=1).matrix(), first.sample(50, 0, seed=1).matrix())
    with refused("departures", problem="0 left and 0 right, beside 120 that are not plausible"):
        fit_scenario_model(table, plausibility=Plausibility(y_rate=1e-6), **settings)


@pytest.mark.parametrize("command", ["extract", "fit"])
def test_an_unknown_limit_gets_one_message(tmp_path: Path, command: str):
    write_departures(tmp_path / "d.parquet", varied_departures(30), Provenance())
    (tmp_path / "a.csv").write_text("recording,t,lane_offset,lane_width,speed\na,0.0,0.1,3.6,25\na,0.1,0.1,3.6,25\n")
    source, target = ("a.csv", "e.parquet") if command == "extract" else ("d.parquet", "m.json")
    told = bad(command, source, "-o", target, "--limit", "d=1", cwd=tmp_path)
    assert all(part in told for part in ("--limit", "'d'", "allowed: a_y, y_acceleration, y_rate"))
