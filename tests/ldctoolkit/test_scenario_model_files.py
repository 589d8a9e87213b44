"""Scenario model files: what comes back, and how a bad file, a bad path and a bad value are refused."""

import contextlib
import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import examples
from helpers.models import one_component_model
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import ModelError, UnknownNameError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import ScenarioModel, SideModel, load_model


@pytest.fixture(scope="module")
def model():
    return one_component_model()


@pytest.fixture(scope="module")
def text(model, tmp_path_factory):
    """What a file holds."""
    path = tmp_path_factory.mktemp("model") / "m.json"
    model.save(path)
    return path.read_text()


def test_a_file_gives_back_every_bit(model, tmp_path):
    path = tmp_path / "m.json"
    model.save(path)
    assert [p.name for p in tmp_path.iterdir()] == ["m.json"]
    back = ScenarioModel.load(path)
    assert (back.content_hash, back.provenance) == (model.content_hash, model.provenance)
    assert np.array_equal(back.sample(100, 100, 1).matrix(), model.sample(100, 100, 1).matrix())
    assert load_model(path).content_hash == load_model(str(path)).content_hash == model.content_hash
    later = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, created="later"))
    assert later.content_hash == model.content_hash


def test_hours_and_distance_come_back_and_do_not_enter_the_hash(model, text, tmp_path):
    path = tmp_path / "m.json"
    known = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, hours=1.5, distance=72_000.25))
    known.save(path)
    back = load_model(path)
    assert (back.provenance.hours, back.provenance.distance) == (1.5, 72_000.25)
    assert (back.provenance, back.content_hash) == (known.provenance, model.content_hash)
    data = json.loads(text)
    assert (data["provenance"].pop("hours"), data["provenance"].pop("distance")) == (None, None)
    del data["checksum"]
    path.write_text(json.dumps(data))  # as an earlier version wrote it
    assert (load_model(path).provenance, load_model(path).content_hash) == (model.provenance, model.content_hash)


def test_a_file_of_version_3_is_read_without_its_retired_keys(model, text, tmp_path):
    data = json.loads(text)
    data["version"] = 3
    data["provenance"]["left"] |= {"aic": [1.0, 2.0], "criterion": "aic"}
    data["provenance"]["settings"] |= {"criterion": "aic", "slack": None, "indifference": 0.001}
    del data["checksum"]
    (tmp_path / "m.json").write_text(json.dumps(data))
    back = load_model(tmp_path / "m.json")
    assert (back.provenance, back.content_hash) == (model.provenance, model.content_hash)


def test_unknown_names_and_missing_files(tmp_path):
    with pytest.raises(UnknownNameError, match="did you mean 'reference'"):
        load_model("refrence")
    with pytest.raises(ModelError, match=r"no such file; bundled models: reference"):
        load_model(tmp_path / "absent.json")
    with pytest.raises(ModelError, match="no such file"):
        load_model("absent.json")
    for path in (tmp_path, "nul\0.json", "x" * 300 + ".json", ""):
        with pytest.raises(ModelError, match="cannot be read"):
            ScenarioModel.load(path)
    with pytest.raises(ModelError, match="no such file"):
        load_model("x" * 300 + ".json")
    with pytest.raises(ModelError, match=r"nul.*no such file|cannot be read"):
        load_model("nul\0.json")
    with pytest.raises(UnknownNameError, match="''"):
        load_model("")


def test_a_file_that_cannot_be_written_leaves_nothing(model, tmp_path):
    (tmp_path / "file").touch()
    for path in (tmp_path / "no" / "m.json", tmp_path / "file" / "m.json", tmp_path / "nul\0", "", "x" * 300, tmp_path):
        with pytest.raises(ModelError, match="cannot be written"):
            model.save(path)
    (tmp_path / "file").unlink()
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"x": object()}))
    with pytest.raises(ModelError, match="cannot be written as JSON"):
        odd.save(tmp_path / "m.json")
    assert list(tmp_path.iterdir()) == []


def test_what_could_not_be_read_back_is_not_written(model, tmp_path):
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"bytes": 10**30}))
    with pytest.raises(ModelError, match=r"m\.json: '1000.*at most 18 digits"):
        odd.save(tmp_path / "m.json")
    assert list(tmp_path.iterdir()) == []


def test_a_transform_comes_back_and_enters_the_hash(model, tmp_path):
    """Mapped columns keep their box in the data's units; every other number of the file is the same."""
    left = model.left_side
    mapped = BoundedGaussianMixture.from_parameters(
        [1.0],
        [[0.0, -1.6, -3.0, 25.0, 0.0, -3.2, 0.0, 0.0]],
        np.diag(np.array([0.3, 0.4, 0.4, 4.0, 0.3, 0.4, 1e-3, 5e-4]) ** 2)[None],
        lower=left.bounds()[0],
        upper=left.bounds()[1],
        transform=["logit", "log", "log", "none", "none", "log", "none", "none"],
    )
    side = SideModel(mapped, PARAMETER_NAMES)
    written = dataclasses.replace(model, left_side=side)
    written.save(tmp_path / "m.json")
    back = load_model(tmp_path / "m.json")
    assert back.left_side.transform() == side.transform()
    assert back.content_hash == written.content_hash != model.content_hash
    drawn = back.sample(3000, 0, 1)
    assert np.array_equal(drawn.matrix(), written.sample(3000, 0, 1).matrix())
    # the median of a monotone map is the map of the median: d_y = exp(-1.6), T = (0.5 + 10)/2; 5 standard errors
    assert abs(np.log(np.median(drawn.d_y)) + 1.6) < 5 * 1.2533 * 0.4 / np.sqrt(3000)
    assert abs(np.median(drawn.T) - 5.25) < 5 * 1.2533 * 0.3 * 9.5 / 4 / np.sqrt(3000)
    plain = BoundedGaussianMixture.from_parameters(
        [1.0], mapped.means_, mapped.covariances_, lower=left.bounds()[0], upper=left.bounds()[1]
    )
    other = dataclasses.replace(model, left_side=SideModel(plain, PARAMETER_NAMES))
    assert other.content_hash != written.content_hash


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
        (("version",), 5, r"version: 5; allowed: version 3 or 4, .*; the file is newer, update ldctoolkit$"),
        (("version",), 2, r"version: 2; allowed: version 3 or 4, which this program reads$"),
        (("version",), True, r"version: True; allowed: version 3 or 4"),
        (("version",), 4.0, r"version: 4\.0; allowed: version 3 or 4"),
        (("version",), KeyError, r"version: None; allowed: version 3 or 4"),
        ((*LEFT_SIDE, "transform"), ["none"], r"sides\.left\.transform: shape \(1,\); allowed: \(8,\)"),
        ((*LEFT_SIDE, "transform", 1), "auto", r"sides\.left\.transform\[1\]: 'auto'; allowed: log, logit, none"),
        ((*LEFT_SIDE, "transform", 1), "logit", r"sides\.left: transform\['d_y'\]: 'logit' with 1 finite bounds"),
        ((*LEFT_SIDE, "transform"), KeyError, r"sides\.left\.transform: missing"),
        (("provenance", "versions"), {"numpy": 2}, r"provenance\.versions\.numpy: 2; allowed: text"),
        (("provenance", "hours"), "1", r"provenance\.hours: '1'; allowed: a number"),
        (("provenance", "hours"), 0.0, r"provenance\.hours: 0\.0; allowed: a finite number > 0"),
        (("provenance", "settings"), 3, r"provenance\.settings: 3; allowed: a table of keys"),
        (("provenance", "settings", "tol"), "x", r"provenance\.settings\.tol: 'x'; allowed: a number"),
        (("provenance", "left", "aic"), [1.0], r"provenance\.left\.aic: no such key"),
        (("provenance", "left", "n_parameters"), [1], r"provenance\.left\.n_parameters: shape \(1,\); allowed: \(2,\)"),
        (("provenance", "left", "bounds_from"), [["T", "auto"]], r"provenance\.left\.bounds_from\[0\]\[2\]: missing"),
        (("provenance", "left", "bounds_from"), [["t", "auto", "auto"]], r"provenance\.left\.bounds_from: 't'"),
        (("provenance", "left", "failed"), [[3]], r"provenance\.left\.failed\[0\]\[1\]: missing"),
        (("sides",), KeyError, r"sides: missing"),
        (("sides", "right"), [], r"sides\.right: \[\]; allowed: a table of keys"),
        ((*LEFT_SIDE, "weights"), KeyError, r"sides\.left\.weights: missing"),
        ((*LEFT_SIDE, "weights"), [0.5], r"sides\.left\.weights: sum 0\.5"),
        ((*LEFT_SIDE, "weights"), [1.0 - 1.1e-9], r"sides\.left\.weights: sum 0\.9999999989; allowed"),
        ((*LEFT_SIDE, "weights"), [1.0 + 1.1e-9], r"sides\.left\.weights: sum 1\.0000000011; allowed"),
        ((*LEFT_SIDE, "weights"), [], r"sides\.left\.weights: \[\]; allowed: one value or more"),
        ((*LEFT_SIDE, "means"), [[1.0]], r"sides\.left\.means: shape \(1, 1\); allowed: \(1, 8\)"),
        ((*LEFT_SIDE, "means", 0, 2), None, r"sides\.left\.means\[0\]\[2\]: None; allowed: a number"),
        ((*LEFT_SIDE, "covariances", 0, 0, 1), 1e-10, r"sides\.left\.covariances\[0\]: .*\(or not symmetric\)"),
        ((*LEFT_SIDE, "covariances", 0, 0, 1), 9.0, r"sides\.left\.covariances\[0\]: not positive definite"),
        ((*LEFT_SIDE, "lower", 0), 11.0, r"sides\.left: bounds: lower\[0\]"),
        ((*LEFT_SIDE, "lower", 1), None, r"sides\.left\.lower\[1\]: d_y below 0 cannot be replayed"),
        ((*LEFT_SIDE, "parameters", 0), "TT", r"sides\.left\.parameters: 'TT'; did you mean 'T'"),
        ((*LEFT_SIDE, "parameters", 0), "d_y", r"sides\.left\.parameters: .*allowed: each of"),
        ((*LEFT_SIDE, "constants"), {"T": -1.0}, r"sides\.left\.parameters: .*allowed: each of"),
        ((*LEFT_SIDE, "wieghts"), [1.0], r"sides\.left\.wieghts: no such key; did you mean 'weights'"),
        (("unit",), {}, r"m\.json: unit: no such key; did you mean 'units'"),
        (("provenance", "left", "bics"), 1, r"provenance\.left\.bics: no such key; did you mean 'bic'"),
        (("units", "T"), "min", r"units\.T: 'min'; allowed: 's'"),
        (("units", "T"), KeyError, r"units\.T: None; allowed: 's'"),
        (("units",), KeyError, r"units: missing"),
        ((*LEFT_SIDE, "means", 0, 0), 1e300, r"sides\.left: "),
        (("provenance", "seed"), "x", r"provenance\.seed: 'x'; allowed: a whole"),
        (("provenance", "synthetic"), 1, r"provenance\.synthetic: 1; allowed: true or false"),
        (("provenance", "left", "bic"), [1.0, 2.0, 3.0], r"provenance\.left\.bic: shape"),
        (("provenance", "left", "moved_inside"), [1], r"provenance\.left\.moved_inside"),
        (
            ("provenance", "left", "moved_inside"),
            [["T", 1.5]],
            r"provenance\.left\.moved_inside\[0\]\[1\]: 1\.5; allowed: a whole number",
        ),
        ((*LEFT_SIDE, "means", 0, 0), 10**400, "whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "weights", 0), -(10**400), "whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "lower", 0), 10**18, "10{18}'; allowed: whole numbers of at most 18 digits"),
        ((*LEFT_SIDE, "means", 0, 0), "3.0", r"sides\.left\.means\[0\]\[0\]: '3\.0'; allowed: a number"),
        ((*LEFT_SIDE, "weights", 0), True, r"sides\.left\.weights\[0\]: True; allowed: a number"),
        ((*LEFT_SIDE, "upper", 0), "10", r"sides\.left\.upper\[0\]: '10'; allowed: a number"),
    ],
)
def test_a_broken_file_is_one_clear_message(text, tmp_path, path, value, message):
    file = tmp_path / "m.json"
    data = json.loads(text)
    changed(data, path, value)
    file.write_text(json.dumps(data))
    with pytest.raises(ModelError, match=message) as caught:
        ScenarioModel.load(file)
    assert str(file) in str(caught.value)


@pytest.mark.parametrize("sum_of_weights", [1.0 - 0.9e-9, 1.0 + 0.9e-9])
def test_weights_may_be_off_by_their_rounding_and_numbers_have_18_digits(text, tmp_path, sum_of_weights):
    data = json.loads(text)
    data["sides"]["left"]["weights"] = [sum_of_weights]
    data["provenance"]["seed"] = 10**18 - 1  # 18 digits
    (tmp_path / "m.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"not what was written .* changed on purpose, remove the key 'checksum'"):
        load_model(tmp_path / "m.json")
    del data["checksum"]
    (tmp_path / "m.json").write_text(json.dumps(data))
    model = load_model(tmp_path / "m.json")
    assert (model.left.weights_.tolist(), model.provenance.seed) == ([sum_of_weights], 10**18 - 1)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ('{"format": 1,\n "version" 2}', "line 2, column 12: broken JSON"),
        ("", "line 1, column 1: broken JSON"),
        ("[1]", "not a scenario model"),
        ('{"x": NaN}', "'NaN'; allowed: finite numbers"),
        ("[" * 100_000, "broken JSON"),
        ('{"x": 1e999}', "'1e999'; allowed: finite numbers"),
        ('{"x": -1e999}', "'-1e999'; allowed: finite numbers"),
        ('{"version": ' + "1" * 5000 + "}", r"111\.\.\..*allowed: whole numbers of at most 18 digits"),
    ],
)
def test_broken_json(tmp_path, broken, message):
    file = tmp_path / "m.json"
    file.write_text(broken)
    with pytest.raises(ModelError, match=message):
        ScenarioModel.load(file)
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ModelError, match="the text is UTF-16; save it as UTF-8"):
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


@examples(150)
@given(data=st.data())
def test_any_value_anywhere_is_a_model_or_a_model_error(tmp_path_factory, text, data):
    """Whatever stands at whatever key of a file, nothing but `ModelError` gets out."""
    file = tmp_path_factory.getbasetemp() / "fuzzed.json"
    content = json.loads(text)
    target, path = content, []
    while isinstance(target, dict | list) and target and (not path or data.draw(st.integers(0, 5))):
        key = data.draw(st.sampled_from(sorted(target) if isinstance(target, dict) else range(len(target))))
        path.append(key)
        target = target[key]
    changed(content, path, data.draw(JSON))
    file.write_text(json.dumps(content).replace('"FAR"', "1e999"))
    with contextlib.suppress(ModelError):
        ScenarioModel.load(file).sample(3, 3, 0)
