"""Scenario model files: what comes back, and how a bad file, a bad path and a bad value are refused."""

import contextlib
import dataclasses
import json
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.bits import examples
from helpers.errors import refused
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


def test_unknown_names_and_missing_files(tmp_path):
    for name in ("refrence", ""):
        with refused("scenario model", UnknownNameError, value=name, allowed=("reference",)):
            load_model(name)
    for path in (tmp_path / "absent.json", "absent.json", "x" * 300 + ".json", "nul\0.json"):
        with refused(str(path), ModelError, problem="no such file", hint="bundled models: reference"):
            load_model(path)
    for path in (tmp_path, "nul\0.json", "x" * 300 + ".json", ""):
        with pytest.raises(ModelError, match="cannot be read"):
            ScenarioModel.load(path)


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
    with refused("m.json", ModelError, value=str(10**30), allowed="whole numbers of at most 18 digits"):
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


BROKEN = {  # what the error says of it: a key of the file, and what is written there
    "'ldctoolkit-scenario-model'": [("format", "other")],
    "version 4 to 5, which this program reads": [("version", odd) for odd in (6, 3, "4", True, 4.0, KeyError)],
    "is missing and has no default": [
        ("sides", KeyError), ("units", KeyError), ("sides.left.transform", KeyError), ("sides.left.weights", KeyError),
        ("provenance.left.bounds_from", [["T", "auto"]], "provenance.left.bounds_from[0][2]"),
        ("provenance.left.failed", [[3]], "provenance.left.failed[0][1]"),
    ],
    "tol": [("provenance.settings.tl", 1)],
    "bic": [("provenance.left.bics", 1)],
    "weights": [("sides.left.wieghts", [1.0])],
    "units": [("unit", {})],
    "right": [("sides.middle", {})],
    "seed": [("provenance.sed", 1)],
    "logit": [("sides.left.transform[1]", "auto")],
    "with 1 finite bounds": [("sides.left.transform[1]", "logit", "sides.left: transform['d_y']")],
    "T": [
        ("provenance.left.bounds_from", [["t", "auto", "auto"]]),
        ("sides.left.parameters[0]", "TT", "sides.left.parameters"),
    ],
    f"each of {', '.join(PARAMETER_NAMES)} once, here or among the constants": [
        ("sides.left.parameters[0]", "d_y", "sides.left.parameters"),
        ("sides.left.constants", {"T": -1.0}, "sides.left.parameters"),
    ],
    "'s'": [("units.T", "min"), ("units.T", KeyError)],
    "text": [("provenance.versions", {"numpy": 2}, "provenance.versions.numpy")],
    "true or false": [("provenance.synthetic", 1)],
    "a table of keys": [("provenance.settings", 3), ("sides.right", [])],
    "a list": [("provenance.left.moved_inside", [1], "provenance.left.moved_inside[0]")],
    "one value or more": [("sides.left.weights", [])],
    "a number": [
        ("provenance.hours", "1"), ("provenance.settings.tol", "x"), ("provenance.left.weight", "1"),
        ("sides.left.means[0][2]", None), ("sides.left.means[0][0]", "3.0"), ("sides.left.weights[0]", True),
    ],
    "a whole number": [
        ("provenance.seed", "x"), ("provenance.left.failed", [[True, "x"]], "provenance.left.failed[0][0]"),
        ("provenance.left.moved_inside", [["T", 1.5]], "provenance.left.moved_inside[0][1]"),
        ("provenance.left.n_components", [1, "2"], "provenance.left.n_components[1]"),
    ],
    "a finite number > 0": [("provenance.hours", 0.0), ("provenance.distance", -1.5)],
    "whole numbers of at most 18 digits": [
        ("sides.left.weights[0]", -(10**400), ""), ("sides.left.lower[0]", 10**18, ""),
    ],
    "(2,)": [
        ("provenance.left.bic", []), ("provenance.left.bic", [1.0, 2.0, 3.0]), ("provenance.left.n_parameters", [1]),
    ],
    "(8,)": [("sides.left.transform", ["none"])],
    "(1, 8)": [("sides.left.means", [[1.0]])],
    "shares >= 0 that sum to one": [
        ("sides.left.weights", [total]) for total in (0.5, 1.0 - 1.1e-9, 1.0 + 1.1e-9)
    ],
    "not positive definite (or not symmetric)": [
        ("sides.left.covariances[0][0][0]", -1.0, "sides.left.covariances[0]"),
        *(("sides.left.covariances[0][0][1]", odd, "sides.left.covariances[0]") for odd in (1e-10, 9.0)),
    ],
    "lower < upper": [("sides.left.lower[0]", 11.0, "sides.left: bounds")],
    "d_y below 0 cannot be replayed": [("sides.left.lower[1]", None)],
    "the probability of its box is not a number that a computer can hold": [
        ("sides.left.means[0][0]", 1e300, "sides.left: component 0")
    ],
}  # fmt: skip


@pytest.mark.parametrize(("expected", "case"), [(expected, case) for expected in BROKEN for case in BROKEN[expected]])
def test_a_broken_file_is_one_clear_message(text, tmp_path, expected, case):
    key, value, *at = case
    file = tmp_path / "m.json"
    data = json.loads(text)
    changed(data, [int(part) if part.isdigit() else part for part in re.findall(r"[^.\[\]]+", key)], value)
    file.write_text(json.dumps(data))
    with pytest.raises(ModelError) as caught:
        ScenarioModel.load(file)
    error, (path,) = caught.value, at or [key]
    assert error.path == (f"{file}: {path}" if path else str(file))
    names = (error.allowed,) if isinstance(error.allowed, str) else error.allowed
    assert expected in (error.problem, *names)
    assert key != "version" or error.hint == ("the file is newer, update ldctoolkit" if value == 6 else "")


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
