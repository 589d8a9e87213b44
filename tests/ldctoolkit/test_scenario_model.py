"""Scenario model: fit, file, sampling, and the orders of magnitude of the bundled model."""

import dataclasses

import numpy as np
import pytest

from helpers.errors import refused
from helpers.models import varied_departures as departures
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.recordings import Criteria
from ldctoolkit.recordings.find_departures import LARGEST_ACCELERATION
from ldctoolkit.scenario_model import (
    PHYSICAL_BOUNDS,
    ModelProvenance,
    ScenarioModel,
    SideModel,
    bundled_models,
    fit_scenario_model,
    load_model,
)
from ldctoolkit.scenarios import SPEED_FLOOR, slowest_speed


def plane(n, seed=0):
    """n plausible departures a side of which only T and d_y vary."""
    made = departures(n, seed, sigma_y=0.05, v_mean=25.0, a_mean=0.0, sigma_v=0.04, c_0=0.0, dc=0.0)
    return dataclasses.replace(made, d_y=np.minimum(made.d_y, 0.4 * made.T * np.minimum(made.T, 1.0)))


@pytest.fixture(scope="module")
def model():
    return fit_scenario_model(plane(100), components=[1, 2], kind="mixture", seed=3, source_provenance="made up")


@pytest.fixture(scope="module")
def reference():
    return load_model("reference")


def test_the_reference_says_that_it_is_synthetic(reference):
    assert "reference" in bundled_models()
    assert reference.provenance.synthetic
    assert "SYNTHETIC" in reference.provenance.source["description"]
    assert (reference.provenance.hours, reference.provenance.distance) == (None, None)
    for half in (reference.left_side, reference.right_side):
        assert (half.mixture.weights_.size, half.names) == (10, PARAMETER_NAMES)
    assert reference.provenance.left.converged


def test_the_reference_has_the_orders_of_magnitude_of_real_roads(reference):
    s = reference.sample(20_000, 20_000, seed=1)
    assert s.T.min() > 0.5
    assert s.T.max() < 10.0
    assert 1.8 < np.median(s.T) < 2.2
    assert 0.18 < np.median(s.d_y) < 0.22
    assert 0.45 < np.quantile(s.d_y, 0.95) < 0.55
    assert 1e-4 < np.mean(s.d_y > 1.0) < 5e-3
    assert np.median(s.d_y[s.T > 3.0]) > 1.4 * np.median(s.d_y[s.T < 1.5])
    assert 0.22 < np.median(s.sigma_y / s.d_y) < 0.28
    urban = s.v_mean < 21.0
    assert 0.3 < urban.mean() < 0.6
    assert 13.0 < np.median(s.v_mean[urban]) < 15.0
    assert 27.0 < np.median(s.v_mean[~urban]) < 29.0
    assert 0.27 < s.a_mean.std() < 0.33
    assert 0.03 < np.median(s.sigma_v) < 0.05
    lateral = s.v_mean**2 * s.c_0
    assert np.quantile(np.abs(lateral), 0.99) < 2.0
    assert s.c_0[urban].std() > 3.0 * s.c_0[~urban].std()
    assert 0.4 < s.dc.std() / s.c_0.std() < 0.6
    left = s.side == LEFT
    assert np.median(lateral[left]) > 0.05 > -0.05 > np.median(lateral[~left])
    assert np.median(s.d_y[~left]) > 1.05 * np.median(s.d_y[left])
    assert urban[left].mean() > urban[~left].mean() + 0.05


def test_sampling_is_deterministic_nested_and_inside(reference):
    s = reference.sample(1500, 300, seed=7)
    assert s.side.tolist() == [LEFT] * 1500 + [RIGHT] * 300
    fewer = reference.sample(10, 5, seed=7)
    assert np.array_equal(fewer.matrix()[:10], s.matrix()[:10])
    assert np.array_equal(fewer.matrix()[10:], s.matrix()[1500:1505])
    assert not np.array_equal(reference.sample(10, 0, seed=8).matrix(), s.matrix()[:10])
    assert np.unique(s.T).size == 1800  # no block repeats another one, no side the other
    lower, upper = (np.array([PHYSICAL_BOUNDS[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    assert np.all((s.matrix() > lower) & (s.matrix() < upper))
    assert len(reference.sample(0, 0, seed=1)) == 0


@pytest.mark.parametrize(
    ("path", "value", "args"),
    [
        ("n_left", -1, (-1, 0, 1)),
        ("n_right", 1.5, (0, 1.5, 1)),
        ("n_right", True, (0, True, 1)),
        ("seed", -2, (1, 1, -2)),
    ],
)
def test_sample_refuses_what_is_not_a_count(reference, path, value, args):
    with refused(path, value=value):
        reference.sample(*args)


def slow_model(speed, spread):
    """A model in which many events brake to below the speed floor."""
    mean = np.array([[8.0, 0.2, 0.05, speed, 0.0, 0.04, 0.0, 0.0]])
    cov = np.diag(np.array([0.5, 0.05, 0.01, 0.5, spread, 0.01, 1e-4, 1e-4]) ** 2)[None]
    bounds = PHYSICAL_BOUNDS | {"a_mean": (-np.inf, np.inf)}
    lower, upper = (np.array([bounds[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    mixture = BoundedGaussianMixture.from_parameters([1.0], mean, cov, lower=lower, upper=upper)
    side = SideModel(mixture, PARAMETER_NAMES)
    return ScenarioModel(side, side, ModelProvenance({}))


def test_events_below_the_speed_floor_are_drawn_again():
    slow = slow_model(6.0, 1.5)
    share = slow.redrawn_share(LEFT)
    assert 0.3 < share < 0.5
    s = slow.sample(3000, 0, seed=1)
    assert len(s) == 3000
    assert slowest_speed(s.v_mean, s.a_mean, s.T).min() >= SPEED_FLOOR
    assert np.array_equal(slow.sample(50, 0, seed=1).matrix(), s.matrix()[:50])


def test_a_model_that_cannot_be_replayed_is_an_error_and_not_a_hang():
    with pytest.raises(ModelError, match=r"scenario model \(left\): 9.*fall below 1\.0 m/s"):
        slow_model(6.0, 500.0).sample(2000, 0, seed=1)


def test_the_same_seed_gives_the_same_model(model):
    again = fit_scenario_model(plane(100), components=[1, 2], kind="mixture", seed=3)
    assert again.content_hash == model.content_hash
    assert fit_scenario_model(plane(100, seed=1), components=1, seed=3).content_hash != model.content_hash


def test_a_fit_tells_how_it_was_made(model):
    p = model.provenance
    assert (p.seed, p.synthetic, p.source) == (3, False, {"description": "made up"})
    assert (p.left.events, p.left.n_components) == (100, (1, 2))
    assert len(p.left.bic) == len(p.left.log_likelihood) == 2
    assert "K = 1, the smallest whose BIC lies within 10 of the best" in p.left.reason
    assert (p.left.kind, p.left.fidelity.departures, model.left.weights_.size) == ("mixture", 100, 2)
    assert p.left.fidelity.passed
    assert not [text for text in p.warnings if text.endswith(": do not use it")]


@pytest.mark.slow
def test_constant_columns_stay_constant():
    d = departures(60, c_0=0.0, dc=0.0)
    fitted = fit_scenario_model(d, components=range(1, 11), seed=0, n_init=1)
    assert (fitted.left_side.constants, fitted.left.means_.shape[1]) == ((("c_0", 0.0), ("dc", 0.0)), 6)
    s = fitted.sample(50, 50, 1)
    assert np.all(s.c_0 == 0.0)
    assert np.all(s.dc == 0.0)
    assert any("c_0 is 0 in every event" in w for w in fitted.provenance.warnings)
    assert any("larger K were not tried" in w for w in fitted.provenance.warnings)


def test_values_on_a_bound_are_moved_inside_and_counted():
    d = departures(100)
    row = np.arange(d.n)
    d = dataclasses.replace(d, sigma_v=np.where(row < 7, 0.0, d.sigma_v), T=np.where(row == 150, 10.0, d.T))
    fitted = fit_scenario_model(d, components=1)
    assert fitted.provenance.left.moved_inside == (("sigma_v", 7),)
    assert (fitted.provenance.right.moved_inside, d.sigma_v[0]) == ((("T", 1),), 0.0)


@pytest.mark.parametrize(("n", "most"), [(32, 10), pytest.param(33, 11, marks=pytest.mark.slow)])
def test_half_an_event_stands_behind_each_parameter(n, most):
    """Two dimensions: 2 means, 3 covariances and a weight a component, so 3 events each."""
    fitted = fit_scenario_model(plane(n), components=range(10, 13), kind="mixture", n_init=1, max_iter=3)
    assert fitted.provenance.left.n_components == tuple(range(10, most + 1))
    assert f"left: {n} events carry no more than K = {most}; larger K were not tried" in fitted.provenance.warnings
    assert any(w.startswith("left: Not converged in ") for w in fitted.provenance.warnings)


def test_the_number_of_components_is_checked():
    d = plane(40)
    allowed = "a range that begins at 13 or below, 40 left departures carry no more"
    with refused("components", value=14, allowed=allowed):
        fit_scenario_model(d, components=range(14, 17))
    with refused("departures (left): X", problem="40 rows"):
        fit_scenario_model(d, components=14)
    for wrong in ("3", 3.0, [1, "2"], [1.0], True, 0, [0], []):
        with refused("components"):
            fit_scenario_model(d, components=wrong)
    one = fit_scenario_model(d, components=np.int64(1))
    assert one.content_hash == fit_scenario_model(d, components=1).content_hash


@pytest.mark.slow
def test_what_a_fit_gives_can_be_saved_and_loaded(tmp_path):
    """Forty per cent of a column at its bound: nearly nothing of a component is left inside, ln P falls without end."""
    zero = np.random.default_rng(0).random(240) < 0.4
    sigma_v = np.where(zero, 0.0, np.random.default_rng(1).gamma(4.0, 0.01, 240))
    sigma_v[np.flatnonzero(~zero)[0]] = 1e-9
    fitted = fit_scenario_model(dataclasses.replace(plane(120), sigma_v=sigma_v), components=2)
    assert fitted.left.log_probabilities_.min() < -300.0
    fitted.save(tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").content_hash == fitted.content_hash


def test_thirty_departures_a_side_and_the_longest_seed_are_enough():
    fitted = fit_scenario_model(plane(30), components=1, seed=10**18 - 1)
    assert fitted.provenance.left.events == 30
    with refused("departures", problem="29 left and 29 right", allowed="at least 30 a side"):
        fit_scenario_model(plane(29), components=1)


def test_few_or_wrong_departures_are_refused():
    d = departures(40)
    problem = "39 left and 0 right, beside 1 that are not plausible"
    with refused("departures", problem=problem, allowed="at least 30 a side"):
        fit_scenario_model(d.take(d.side == LEFT))
    bad = np.isin(np.arange(80), (57, 45))
    with refused("departures (right): c_0", problem="in departure 45 (2 of 39 departures)", allowed="finite numbers"):
        fit_scenario_model(dataclasses.replace(d, c_0=np.where(bad, [np.nan, np.inf] * 40, d.c_0)))
    for seed in (-1, 10**18):
        with refused("seed", value=seed):
            fit_scenario_model(d, seed=seed)


def test_the_bounds_are_those_of_the_extraction():
    criteria = Criteria()
    assert PHYSICAL_BOUNDS["T"] == (criteria.min_duration, criteria.max_duration)
    assert PHYSICAL_BOUNDS["v_mean"] == (criteria.min_speed, np.inf)
    assert PHYSICAL_BOUNDS["a_mean"] == (-LARGEST_ACCELERATION, LARGEST_ACCELERATION)


@pytest.mark.slow
def test_real_departures_fit(ngsim_recordings):
    """About 250 departures without curvature: few components, constants, replayable scenarios."""
    from ldctoolkit.recordings import extract_departures, read_recordings

    recorded = extract_departures(read_recordings(ngsim_recordings), vehicle_width=1.8).departures
    fitted = fit_scenario_model(recorded, seed=0)
    s = fitted.sample(500, 500, 1)
    assert np.all(s.c_0 == 0.0)
    for side in (LEFT, RIGHT):
        real, drawn = recorded.take(recorded.side == side), s.take(s.side == side)
        # one or two Gaussians for skewed data: the middle is right to a third
        assert abs(np.median(drawn.d_y) / np.median(real.d_y) - 1.0) < 0.35
        assert abs(np.median(drawn.v_mean) / np.median(real.v_mean) - 1.0) < 0.15
        assert drawn.T.min() > 0.5
        # a fit at a maximum keeps the means; the prior pulls the spread before truncation towards that of the events,
        # so columns that pile up at a bound (T, d_y) come out up to a third too narrow
        for name, most in (("T", 0.4), ("d_y", 0.4), ("a_mean", 0.25)):
            first, second = getattr(real, name), getattr(drawn, name)
            assert abs(second.mean() - first.mean()) < 0.2 * first.std()  # standard error 0.045
            assert abs(second.std() / first.std() - 1.0) < most
        assert np.abs(drawn.a_mean).max() < 9.81
