"""Scenario model: fit, file, sampling, and the orders of magnitude of the bundled model."""

from __future__ import annotations

import contextlib
import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.errors import InputError, ModelError, UnknownNameError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.recordings import Criteria
from ldctoolkit.recordings.events import LARGEST_ACCELERATION
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


def departures(n=200, seed=0, **changed):
    """n departures a side; a column can be replaced."""
    rng = np.random.default_rng(seed)
    m = 2 * n
    columns = {
        "T": np.clip(np.exp(rng.normal(0.7, 0.5, m)), 0.51, 9.9),
        "d_y": rng.gamma(3.0, 0.07, m),
        "sigma_y": rng.gamma(3.0, 0.02, m),
        "v_mean": rng.normal(25.0, 4.0, m),
        "a_mean": rng.normal(0.0, 0.3, m),
        "sigma_v": rng.gamma(4.0, 0.01, m),
        "c_0": rng.normal(0.0, 1e-3, m),
        "dc": rng.normal(0.0, 5e-4, m),
    } | changed
    return Departures(
        side=np.repeat([LEFT, RIGHT], n),
        **{name: np.broadcast_to(np.asarray(columns[name], dtype=float), m).copy() for name in PARAMETER_NAMES},
        recording=np.full(m, "r"),
        start_time=np.zeros(m),
        samples=np.full(m, 20),
    )


@pytest.fixture(scope="module")
def model():
    return fit_scenario_model(departures(), components=[1, 2], seed=3, source_provenance="made up")


@pytest.fixture(scope="module")
def reference():
    return load_model("reference")


def test_the_reference_says_that_it_is_synthetic(reference):
    assert "reference" in bundled_models()
    assert reference.provenance.synthetic
    assert "SYNTHETIC" in reference.provenance.source["description"]
    for half in (reference.left_side, reference.right_side):
        assert half.mixture.weights_.size == 10
        assert half.names == PARAMETER_NAMES
    assert reference.provenance.left is not None
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


@pytest.mark.parametrize(("name", "args"), [("n_left", (-1, 0, 1)), ("n_right", (0, 1.5, 1)), ("seed", (1, 1, -2))])
def test_sample_refuses_what_is_not_a_count(reference, name, args):
    with pytest.raises(InputError, match=f"{name}: .*allowed: an integer >= 0"):
        reference.sample(*args)


def slow_model(speed, spread):
    """A model in which many events brake to below the speed floor."""
    mean = np.array([[8.0, 0.2, 0.05, speed, 0.0, 0.04, 0.0, 0.0]])
    cov = np.diag(np.array([0.5, 0.05, 0.01, 0.5, spread, 0.01, 1e-4, 1e-4]) ** 2)[None]
    bounds = PHYSICAL_BOUNDS | {"a_mean": (-np.inf, np.inf)}
    lower, upper = (np.array([bounds[name][end] for name in PARAMETER_NAMES]) for end in (0, 1))
    side = SideModel(
        BoundedGaussianMixture.from_parameters([1.0], mean, cov, lower=lower, upper=upper), PARAMETER_NAMES
    )
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


def test_a_file_gives_back_every_bit(model, tmp_path):
    path = tmp_path / "m.json"
    model.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]
    back = ScenarioModel.load(path)
    assert back.content_hash == model.content_hash
    assert back.provenance == model.provenance
    assert np.array_equal(back.sample(100, 100, 1).matrix(), model.sample(100, 100, 1).matrix())
    assert load_model(path).content_hash == load_model(str(path)).content_hash == model.content_hash
    later = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, created="later"))
    assert later.content_hash == model.content_hash


def test_the_same_seed_gives_the_same_model(model):
    again = fit_scenario_model(departures(), components=[1, 2], seed=3)
    assert again.content_hash == model.content_hash
    assert fit_scenario_model(departures(seed=1), components=1, seed=3).content_hash != model.content_hash


def test_a_fit_tells_how_it_was_made(model):
    p = model.provenance
    assert (p.seed, p.synthetic, p.source) == (3, False, {"description": "made up"})
    assert p.left is not None
    assert (p.left.events, p.left.n_components) == (200, (1, 2))
    assert len(p.left.bic) == len(p.left.log_likelihood) == 2
    assert model.left.weights_.size == p.left.n_components[int(np.argmin(p.left.bic))]


def test_constant_columns_stay_constant():
    d = departures(60, c_0=0.0, dc=0.0)
    fitted = fit_scenario_model(d, seed=0)
    assert fitted.left_side.constants == (("c_0", 0.0), ("dc", 0.0))
    assert fitted.left.means_.shape[1] == 6
    s = fitted.sample(50, 50, 1)
    assert np.all(s.c_0 == 0.0)
    assert np.all(s.dc == 0.0)
    assert any("c_0 is 0 in every event" in w for w in fitted.provenance.warnings)
    assert any("larger numbers were not tried" in w for w in fitted.provenance.warnings)


def test_values_on_a_bound_are_moved_inside_and_counted():
    d = departures(100)
    d.sigma_v[:7] = 0.0
    d.T[150] = 10.0
    fitted = fit_scenario_model(d, components=1)
    assert fitted.provenance.left is not None
    assert fitted.provenance.right is not None
    assert fitted.provenance.left.moved_inside == (("sigma_v", 7),)
    assert fitted.provenance.right.moved_inside == (("T", 1),)
    assert d.sigma_v[0] == 0.0


def test_few_or_wrong_departures_are_refused():
    d = departures(40)
    with pytest.raises(InputError, match="40 left and 0 right; allowed: at least 30 a side"):
        fit_scenario_model(d.take(d.side == LEFT))
    with pytest.raises(InputError, match=r"departures \(left\): T = 20\.0 in event 0; allowed: 0\.5 to 10 \(40 of 40"):
        fit_scenario_model(departures(40, T=np.r_[np.full(40, 20.0), np.full(40, 2.0)]), components=1)
    with pytest.raises(InputError, match=r"departures \(left\): c_0\[0\] = nan"):
        fit_scenario_model(departures(40, c_0=np.nan))
    with pytest.raises(InputError, match=r"bounds: no parameter 'd_yy'; did you mean 'd_y'"):
        fit_scenario_model(d, bounds={"d_yy": (0.0, 1.0)})
    with pytest.raises(InputError, match=r"bounds\['d_y'\]: .*allowed: 0 <= lower < upper"):
        fit_scenario_model(d, bounds={"d_y": (-1.0, 1.0)})
    with pytest.raises(InputError, match="seed"):
        fit_scenario_model(d, seed=-1)
    with pytest.raises(InputError, match=r"seed: 1000.*allowed: below 10\^18"):
        fit_scenario_model(d, seed=10**18)


def test_bounds_can_be_given():
    fitted = fit_scenario_model(departures(60), components=1, bounds={"a_mean": (-3.0, 3.0), "d_y": (0.0, 2.0)})
    s = fitted.sample(500, 0, 1)
    assert np.abs(s.a_mean).max() < 3.0
    assert s.d_y.max() < 2.0


def test_unknown_names_and_missing_files(tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean 'reference'"):
        load_model("refrence")
    with pytest.raises(ModelError, match=r"no such file; bundled models: reference"):
        load_model(tmp_path / "absent.json")
    with pytest.raises(ModelError, match="no such file"):
        load_model("absent.json")
    with pytest.raises(ModelError, match="cannot read"):
        ScenarioModel.load(tmp_path)


def test_a_file_that_cannot_be_written_leaves_nothing(model, tmp_path):
    with pytest.raises(ModelError, match="cannot write"):
        model.save(tmp_path / "no" / "m.json")
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"x": object()}))
    with pytest.raises(ModelError, match="cannot be written as JSON"):
        odd.save(tmp_path / "m.json")
    assert list(tmp_path.iterdir()) == []


def test_what_could_not_be_read_back_is_not_written(model, tmp_path):
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"bytes": 10**30}))
    with pytest.raises(ModelError, match=r"m\.json: 1000.*at most 18 digits"):
        odd.save(tmp_path / "m.json")
    assert list(tmp_path.iterdir()) == []


def changed(data, path, value):
    *parents, last = path
    target = data
    for key in parents:
        target = target[key]
    if value is KeyError:
        del target[last]
    else:
        target[last] = value


LEFT_SIDE = ("sides", "left")


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("format",), "other", r"format: 'other'; allowed: 'ldctoolkit-scenario-model'"),
        (("version",), 2, r"version: 2; this program reads version 1"),
        (("sides",), KeyError, r"sides: missing"),
        (("sides", "right"), [], r"sides\.right: \[\]; allowed: an object"),
        ((*LEFT_SIDE, "weights"), KeyError, r"sides\.left\.weights: missing"),
        ((*LEFT_SIDE, "weights"), [0.5], r"sides\.left\.weights: sum 0\.5"),
        ((*LEFT_SIDE, "weights"), [], r"sides\.left\.weights: empty"),
        ((*LEFT_SIDE, "means"), [[1.0]], r"sides\.left\.means: shape \(1, 1\); allowed: \(1, 8\)"),
        ((*LEFT_SIDE, "means", 0), ["a"] * 8, r"sides\.left\.means: not numbers"),
        ((*LEFT_SIDE, "means", 0, 2), None, r"sides\.left\.means\[0\]\[2\]: null is not a finite number"),
        ((*LEFT_SIDE, "covariances", 0, 0, 0), -1.0, r"sides\.left\.covariances\[0\]: not positive definite"),
        ((*LEFT_SIDE, "covariances", 0, 0, 1), 9.0, r"sides\.left\.covariances\[0\]: not positive definite"),
        ((*LEFT_SIDE, "lower", 0), 11.0, r"sides\.left: bounds: lower\[0\]"),
        ((*LEFT_SIDE, "lower", 1), None, r"sides\.left\.lower\[1\]: d_y below 0 cannot be replayed"),
        ((*LEFT_SIDE, "parameters", 0), "TT", r"sides\.left\.parameters: 'TT'"),
        ((*LEFT_SIDE, "parameters", 0), "d_y", r"sides\.left\.parameters: must name each of"),
        ((*LEFT_SIDE, "constants"), {"T": -1.0}, r"sides\.left\.parameters: must name each of"),
        (("provenance", "seed"), "x", r"provenance\.seed: 'x'; allowed: an integer"),
        (("provenance", "synthetic"), 1, r"provenance\.synthetic: 1; allowed: true or false"),
        (("provenance", "left", "bic"), [1.0, 2.0, 3.0], r"provenance\.left\.bic: shape"),
        (("provenance", "left", "moved_inside"), [1], r"provenance\.left\.moved_inside"),
        (("provenance", "left", "moved_inside"), [["T", 1.5]], r"provenance\.left\.moved_inside: \['T', 1\.5\]"),
        (("provenance", "left", "n_components"), [1, "2"], r"provenance\.left\.n_components: '2'"),
        (("provenance", "left", "redrawn_share"), 10**400, "whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "means", 0, 0), 10**400, "whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "weights", 0), -(10**400), "whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "lower", 0), 10**18, "10{18}; allowed: whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "means", 0, 0), "3.0", r"sides\.left\.means: not numbers of shape \(1, 8\): '3\.0'"),
        ((*LEFT_SIDE, "weights", 0), True, r"sides\.left\.weights: not numbers"),
        ((*LEFT_SIDE, "upper", 0), "10", r"sides\.left\.upper: not numbers"),
    ],
)
def test_a_broken_file_is_one_clear_message(model, tmp_path, path, value, message):
    file = tmp_path / "m.json"
    model.save(file)
    data = json.loads(file.read_text())
    changed(data, path, value)
    file.write_text(json.dumps(data))
    with pytest.raises(ModelError, match=message) as caught:
        ScenarioModel.load(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"format": 1,\n "version" 2}', "line 2, column 12: broken JSON"),
        ("", "line 1, column 1: broken JSON"),
        ("[1]", "not a scenario model"),
        ('{"x": NaN}', "NaN is not a finite number"),
        ("[" * 100_000, "broken JSON"),
        ('{"x": 1e999}', "1e999 is not a finite number"),
        ('{"x": -1e999}', "-1e999 is not a finite number"),
        ('{"version": ' + "1" * 5000 + "}", r"111\.\.\.; allowed: whole numbers of at most 18 digits"),
    ],
)
def test_broken_json(tmp_path, text, message):
    file = tmp_path / "m.json"
    file.write_text(text)
    with pytest.raises(ModelError, match=message):
        ScenarioModel.load(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="not UTF-8"):
        ScenarioModel.load(file)


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.sampled_from([10**400, -(10**400), 10**18 - 1, "3.0", "FAR"])
    | st.integers()
    | st.floats()
    | st.floats(-10, 10)
    | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(deadline=None, max_examples=150)
@given(data=st.data())
def test_any_value_anywhere_is_a_model_or_a_model_error(tmp_path_factory, model, data):
    """Whatever stands at whatever key of a file, nothing but `ModelError` gets out."""
    file = tmp_path_factory.getbasetemp() / "fuzzed.json"
    model.save(file)
    content = json.loads(file.read_text())
    target, path = content, []
    while isinstance(target, dict | list) and target and (not path or data.draw(st.integers(0, 5))):
        key = data.draw(st.sampled_from(sorted(target) if isinstance(target, dict) else range(len(target))))
        path.append(key)
        target = target[key]
    changed(content, path, data.draw(JSON))
    file.write_text(json.dumps(content).replace('"FAR"', "1e999"))
    with contextlib.suppress(ModelError):
        ScenarioModel.load(file).sample(3, 3, 0)


def test_the_bounds_are_those_of_the_extraction():
    criteria = Criteria()
    assert PHYSICAL_BOUNDS["T"] == (criteria.min_duration, criteria.max_duration)
    assert PHYSICAL_BOUNDS["v_mean"] == (criteria.min_speed, np.inf)
    assert PHYSICAL_BOUNDS["a_mean"] == (-LARGEST_ACCELERATION, LARGEST_ACCELERATION)


def test_real_departures_fit(ngsim_recordings):
    """About 250 departures without curvature: few components, constants, replayable scenarios."""
    from ldctoolkit.recordings import extract_departures, read_recordings

    found = extract_departures(read_recordings(ngsim_recordings), vehicle_width=1.8).departures
    fitted = fit_scenario_model(found, seed=0)
    s = fitted.sample(500, 500, 1)
    assert np.all(s.c_0 == 0.0)
    for side in (LEFT, RIGHT):
        real, drawn = found.take(found.side == side), s.take(s.side == side)
        # one or two Gaussians for skewed data: the middle is right to a third
        assert abs(np.median(drawn.d_y) / np.median(real.d_y) - 1.0) < 0.35
        assert abs(np.median(drawn.v_mean) / np.median(real.v_mean) - 1.0) < 0.15
        assert drawn.T.min() > 0.5
        # a fit at a maximum keeps the means; the prior pulls the spread before truncation towards that of the events,
        # so columns that pile up at a bound (T, d_y) come out up to a third too narrow
        for name, most in (("T", 0.4), ("d_y", 0.4), ("a_mean", 0.25)):
            one, two = getattr(real, name), getattr(drawn, name)
            assert abs(two.mean() - one.mean()) < 0.2 * one.std()  # standard error 0.045
            assert abs(two.std() / one.std() - 1.0) < most
        assert np.abs(drawn.a_mean).max() < 9.81
