"""Study files: what they stand for, and what each mistake says."""

import dataclasses
import itertools
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import ldctoolkit as ldc
from helpers.errors import assert_fields
from ldctoolkit import VehicleParameters, load_model, simulate
from ldctoolkit.errors import StudyError
from ldctoolkit.plant_options import PlantOptions
from ldctoolkit.studies import Design, Study
from ldctoolkit.studies.design_space import expand
from ldctoolkit.studies.pages.report import plant_settings
from ldctoolkit.studies.study_file import CATALOG, catalog_names, load_study, toml_text

pytestmark = pytest.mark.usefixtures("laws")

Y_S_ALLOWED = "a finite number >= -10 m, below 0 before the line"
ONE_SIGN = "both ends of one sign, neither zero"


def toy(**gains: Any) -> dict[str, Any]:
    return {"design": [{"law": "toy", "gains": gains}]}


MISTAKES: list[tuple[dict[str, Any], str, Any, str | set[str]]] = [
    ({"sedd": 1}, "sedd", ..., {"seed"}),
    ({"race": True}, "race", ..., {"name"}),
    ({"seed": "x"}, "seed", "x", "a whole number"),
    ({"name": "a/b"}, "name", "a/b", "up to 80 letters, digits, '-', '_' and '.', a letter or digit first"),
    ({"name": 3}, "name", 3, "text"),
    ({"scenarios": {"lft": 3}}, "scenarios.lft", ..., {"left"}),
    ({"scenarios": {"given": 3}}, "scenarios.given", 3, "a table of keys"),
    ({"scenarios": {"given": {"v": 3}}}, "scenarios.given", "v", {"T"}),
    ({"scenarios": {"given": {"v_mean": "fast"}}}, "scenarios.given.v_mean", "fast", ""),
    ({"scenarios": {"given": {"v_mean": [35, 25]}}}, "scenarios.given.v_mean", (35, 25), ""),
    ({"scenarios": {"given": {"v_mean": True}}}, "scenarios.given.v_mean", True, ""),
    ({"scenarios": {"given": {"c_0": float("nan")}}}, "scenarios.given.c_0", float("nan"), ""),
    ({"scenarios": {"left": 0, "right": 0}}, "scenarios", ..., "at least one scenario"),
    ({"scenarios": {"left": True}}, "scenarios.left", True, "a whole number"),
    ({"report": {"D_y": float("inf")}}, "report.D_y", float("inf"), "a finite number"),
    ({"simulation": {"dt": float("nan")}}, "simulation.dt", float("nan"), "a number from 0.001 to 1 s"),
    ({"simulation": {"window": "departur"}}, "simulation.window", "departur", {"departure"}),
    ({"simulation": {"window": ["departure", "control"]}}, "simulation.window", ["departure", "control"], "one value"),
    ({"simulation": {"convention": ["as_printed"]}}, "simulation.convention", ["as_printed"], "one value"),
    ({"simulation": {"convention": "printed"}}, "simulation.convention", "printed", {"as_printed"}),
    ({"simulation": {"initial_yaw_rate": 0}}, "simulation.initial_yaw_rate", 0, {"path"}),
    ({"plant": {"sped": "frozen"}}, "plant.sped", ..., {"speed"}),
    ({"plant": {"speed": "profil"}}, "plant.speed", "profil", {"profile"}),
    ({"plant": {"actuator": 3}}, "plant.actuator", 3, "a table of keys"),
    ({"plant": {"actuator": {"rate": 1}}}, "plant.actuator.rate", ..., {"rate_max"}),
    ({"plant": {"actuator": {"rate_max": -1}}}, "plant.actuator.rate_max", -1, "a finite number > 0 rad/s"),
    ({"plant": {"mismatch": {"mu": [0.5, 1.0]}}}, "plant.mismatch.mu", (0.5, 1.0), ""),
    ({"plant": {"sensors": {"kalman": True}}}, "plant.sensors.kalman", True, "a table of keys"),
    ({"plant": {"sensors": {"kalman": {"r_y": 0}}}}, "plant.sensors.kalman.r_y", 0, "a finite number > 0 m"),
    (
        {"plant": {"tyres": {"model": "magic_formula"}}, "simulation": {"convention": "as_printed"}},
        "simulation.convention",
        "as_printed",
        "'consistent'",
    ),
    ({"plant": {"residuals": {"y": 1}}}, "plant.residuals.y", 1, "true or false"),
    ({"vehicle": {"C_a": 3}}, "vehicle.C_a", ..., {"C_ar"}),
    ({"vehicle": {"m": -3}}, "vehicle.m", -3, "a finite number > 0 kg"),
    ({"vehicle": {"w_v": 5.0}}, "vehicle.w_v", 5.0, "less than the lane's width, 3.6 m"),
    ({"vehicle": 3}, "vehicle", 3, "a table of keys"),
    ({"design": []}, "design", ..., "one [[design]] table or more"),
    ({"design": {"law": "toy"}}, "design", {"law": "toy"}, "a list of tables: write [[...]] with two brackets"),
    ({"design": [{}]}, "design[0].law", ..., ""),
    ({"design": [{"law": "toy"}, {"law": "ty"}]}, "design[1].law", "ty", {"toy"}),
    ({"design": [{"law": 3}]}, "design[0].law", 3, "text, or a list of different laws"),
    ({"design": [{"law": "toy", "y_s": ["a"]}]}, "design[0].y_s", "a", Y_S_ALLOWED),
    ({"design": [{"law": "toy", "gain": {}}]}, "design[0].gain", ..., {"gains"}),
    (toy(KK=1), "design[0].gains.KK", ..., {"K"}),
    (toy(K=1), "design[0].gains.K", 1, "a number from -1 to 0 rad/rad"),
    (toy(N=2.5), "design[0].gains.N", 2.5, "a whole number from 1 to 50 samples"),
    (toy(on=1), "design[0].gains.on", 1, "true or false"),
    (toy(K=[]), "design[0].gains.K", ..., "1 to 10000"),
    (toy(convention="case"), "design[0].gains.convention", "case", {"consistent"}),
    (toy(K={"from": -1}), "design[0].gains.K.to", ..., ""),
    (toy(K={"from": -1, "to": 0, "count": 3, "scale": "log"}), "design[0].gains.K.scale", "log", ONE_SIGN),
    (toy(K={"from": -1, "to": 0.5, "count": 4}), "design[0].gains.K", 0.5, "a number from -1 to 0 rad/rad"),
    (
        {"design": [{"law": "toy", "y_s": {"from": 0, "to": 1, "count": 9000}, "gains": {"N": list(range(1, 51))}}]},
        "design",
        ...,
        "at most 100000",
    ),
]


def test_the_largest_grid_is_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    from ldctoolkit.studies import study_file

    assert study_file.MOST_DESIGNS == 100_000
    monkeypatch.setattr(study_file, "MOST_DESIGNS", 6)
    block = {"law": "toy", "gains": {"N": [1, 2, 3, 4, 5, 6]}}
    assert len(Study.from_dict({"name": "a", "design": [block]}).designs) == 6
    with pytest.raises(StudyError, match="the grids make 7 designs; allowed: at most 6"):
        Study.from_dict({"name": "a", "design": [block, {"law": "toy"}]})


def test_a_side_in_a_table_of_scenarios_counts() -> None:
    assert ldc.study(ldc.LQR, scenarios={"left": 40}, right=30).scenarios.counts == (40, 30)
    assert ldc.study(ldc.LQR, scenarios={"right": 40}).scenarios.counts == (500, 40)


@pytest.mark.parametrize(("parts", "key", "value", "allowed"), MISTAKES)
def test_a_mistake_is_named_by_key_path_value_and_what_is_allowed(
    parts: dict[str, Any], key: str, value: Any, allowed: str | set[str]
) -> None:
    with pytest.raises(StudyError) as caught:
        Study.from_dict({"name": "a", "design": [{"law": "toy"}]} | parts, source="s.toml")
    assert_fields(caught.value, f"s.toml: {key}", value, allowed)
    assert "more problem" not in caught.value.hint  # one mistake is one problem
    assert "\n" not in str(caught.value)


ALLOWED: list[tuple[str, list[Any], list[Any]]] = [
    ("ranking.confidence", [0, 1, -0.5, 2, float("nan")], [1e-9, 0.5, 1 - 1e-9]),
    ("ranking.bootstrap", [99, 1_000_001], [100, 1_000_000]),
    ("ranking.finalists", [-1, 1001], [0, 1000]),
    ("search.trials", [0, 100_001], [1, 100_000]),
    ("search.batch", [0, 10_001], [1, 10_000]),
    ("scenarios.left", [-1, 10_000_001], [0, 10_000_000]),
    ("scenarios.right", [-1, 10_000_001], [0, 10_000_000]),
    ("simulation.dt", [0, 0.00099, 1.001], [0.001, 1.0]),
    ("simulation.settle", [-1e-9, 60.001], [0.0, 60.0]),
    ("report.D_y", [0, -0.1], [1e-9, 10.0]),
    ("seed", [-1, 2**63], [0, 2**63 - 1]),
    ("design.0.y_s", [-10.001, float("inf")], [-10.0, 0.0, 1e-9]),
    ("design.0.sample.count", [0, 100_001], [1, 100_000]),
    ("design.0.sample.seed", [-1, 2**63], [0, 2**63 - 1]),
    ("design.0.gains.K.count", [1, 10_001], [2, 10_000]),
]


@pytest.mark.parametrize(
    ("key", "refused", "taken"),
    [
        pytest.param(*case, id=case[0], marks=pytest.mark.slow if case[0] == "design.0.gains.K.count" else ())
        for case in ALLOWED
    ],
)
def test_what_a_number_may_be_and_its_edges(key: str, refused: list[Any], taken: list[Any]) -> None:
    for value in (*refused, *taken):
        content: dict[str, Any] = {"name": "a", "design": [{"law": "toy"}]}
        *path, last = key.split(".")
        table: Any = content
        for part in path:
            table = table[int(part)] if part.isdigit() else table.setdefault(part, {})
        if path[-1:] == ["sample"]:
            table.update({"method": "sobol", "count": 4})
        if path[-1:] == ["K"]:
            table.update({"from": -1, "to": -0.5})
        table[last] = value
        if value in refused:
            with pytest.raises(StudyError) as caught:
                Study.from_dict(content)
            assert caught.value.path.endswith(last)
            assert repr(caught.value.value) == repr(value)
        else:
            Study.from_dict(content)


def test_several_mistakes_are_counted() -> None:
    with pytest.raises(StudyError) as caught:
        Study.from_dict({"name": "a", "seed": "x", "title": 3, "design": [{"law": "toy"}]})
    assert caught.value.hint == "1 more problem in this study"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"name = ", "not a TOML file: "), (b"name = 'a'\nname = 'b'", "not a TOML file: "),
        (b"\xff\xfe", "not a TOML file: "), (b"", "name: is missing"), (b"name = 'a'", "design: is missing"),
    ],
)  # fmt: skip
def test_a_broken_file_is_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(content)
    with pytest.raises(StudyError) as caught:
        Study.from_toml(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_a_study_file_as_in_the_reference(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(
        """
        name = "t"
        seed = 1
        [scenarios]
        model = "m.json"
        left = 5
        right = 6
        [simulation]
        window = "control"
        convention = "as_printed"
        [vehicle]
        m = 1200
        [[design]]
        law = "toy"
        y_s = [0.1, 0.2]
        [design.gains]
        K = { from = -0.4, to = -0.1, count = 3, scale = "log" }
        N = { from = 1, to = 10, count = 4, scale = "linear" }
        """
    )
    study = Study.from_toml(path)
    assert (study.simulation.window, study.setup().convention) == ("control", "as_printed")
    assert (study.vehicle, study.model_path) == (VehicleParameters(m=1200.0), tmp_path / "m.json")
    assert len(study.designs) == 2 * 3 * 4
    first = dict(study.designs[0].gains)
    assert first == {"K": -0.4, "N": 1, "on": True, "convention": "case"}
    assert {dict(d.gains)["N"] for d in study.designs} == {1, 4, 7, 10}


def test_identity_follows_numbers_and_not_words(make_study: Callable[..., Study]) -> None:
    study = make_study()
    for same in (
        {"title": "other"},
        {"report": {"D_y": 0.3, "paper": True}},
        {"ranking": {"bootstrap": 300}},
        {"name": "other"},
    ):
        assert make_study(**same).hash == study.hash
    for other in ({"seed": 4}, {"vehicle": {"m": 999.0}}, {"scenarios": {"left": 7, "right": 6}}):
        assert make_study(**other).hash != study.hash
    assert make_study(design=[{"law": "none"}]).hash != study.hash


def test_conditions_on_scenarios_decide_the_numbers(make_study: Callable[..., Study], tmp_path: Path) -> None:
    """A study without conditions has the identity that it had before there were any."""
    plain = make_study()
    assert plain.identity()["scenarios"] == {"left": 7, "right": 5}
    (tmp_path / "s.toml").write_text(
        'name = "motorway"\n[scenarios]\nleft = 5\nright = 5\n[scenarios.given]\nv_mean = [25, inf]\nc_0 = 0.001\n'
        '[[design]]\nlaw = "none"\n'
    )
    study = Study.from_toml(tmp_path / "s.toml")
    assert study.scenarios.given == {"v_mean": (25.0, None), "c_0": 0.001}
    assert Study.from_dict(json.loads(json.dumps(study.content()))).content() == study.content()
    assert study.identity()["scenarios"]["given"] == {"v_mean": [25.0, None], "c_0": 0.001}
    scenarios = {"left": 7, "right": 5, "given": {"v_mean": [25, 30]}}
    some = make_study(scenarios=scenarios)
    other = make_study(scenarios=scenarios | {"given": {"v_mean": [25, 31]}})
    assert len({plain.hash, some.hash, other.hash}) == 3
    assert make_study(scenarios=scenarios | {"given": {}}).hash == plain.hash


EVERY_OPTION = """
name = "real"
[simulation]
dt = 0.05
settle = 2
[plant]
speed = "profile"
[plant.actuator]
delta_max = 0.5
rate_max = 1
lag = 0.1
delay = 0.03
[plant.mismatch]
m = [0.9, 1.2]
I_z = [0.9, 1.1]
C_af = [0.8, 1.2]
C_ar = [0.8, 1.2]
mu = [0.5, 1]
[plant.tyres]
model = "magic_formula"
mu = 0.8
shape = 1.4
[plant.sensors]
e_y_noise = 0.02
e_psi_noise = 0.002
e_y_bias = 0.05
e_psi_bias = -0.001
e_y_step = 0.01
e_psi_step = 0.001
period = 0.15
delay = 0.3
curvature_gain = 0.1
curvature_bias = 1e-4
curvature_noise = 2e-4
[plant.sensors.kalman]
q_y = 1
q_psi = 0.3
r_y = 0.02
r_psi = 0.002
[plant.residuals]
y = true
v = true
bandwidth = 0.5
[[design]]
law = "toy"
"""
# both models of the driver: keys of one are refused beside the other
HANDS = {
    "recorded": 0.2, "straight": 0.2, "follows": 0.2, "against": 0.2, "returns": 0.2, "reaction": [0.4, 1.1],
    "across": [0.2, 0.7], "frequency": [0.7, 1.1], "return_damping": 0.7, "assist_stiffness": 50.0, "torque_max": 6.0,
    "override_torque": 2.5, "override_time": 0.3, "ramp": 0.4, "return_after": 1.0,
}  # fmt: skip
GRIP = HANDS | {"grip": [0.3, 0.4], "arm_lag": 0.1}
ARMS = HANDS | {
    "model": "arms", "stiffness": [15.0, 30.0], "damping": 2.0, "inertia": 0.08, "assist_damping": 3.0,
    "wheel_inertia": 0.12, "wheel_damping": 0.5, "trail": 0.05, "boost": 0.5,
}  # fmt: skip


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    """Key path -> value of everything below a value of tables."""
    if not isinstance(value, dict):
        return {path: value}
    return {k: v for key, inner in value.items() for k, v in leaves(inner, f"{path}.{key}" if path else key).items()}


def test_every_key_of_the_plant_is_read_and_told(tmp_path: Path) -> None:
    """Every option of the dataclasses is in the file above, differs from its default, and is told to a reader."""
    (tmp_path / "s.toml").write_text(EVERY_OPTION)
    study = Study.from_toml(tmp_path / "s.toml")
    assert study.simulation.settle == 2.0
    content = tomllib.loads(EVERY_OPTION)
    ideal = leaves(json.loads(json.dumps(dataclasses.asdict(PlantOptions()))))
    seen = set()
    for driver in (GRIP, ARMS):
        plant = Study.from_dict(content | {"plant": content["plant"] | {"driver": driver}}).plant
        written = leaves(content["plant"] | {"driver": driver})
        read = leaves(json.loads(json.dumps(dataclasses.asdict(plant))))
        assert read == {key: ideal[key] for key in read if key.startswith("driver.")} | written
        assert not [key for key, value in written.items() if value == ideal.get(key)]
        told = dict(plant_settings(plant))
        assert (set(told), told["actuator.rate_max"], told["mismatch.m"]) == (set(written), "1 rad/s", "0.9 to 1.2")
        seen |= set(written)
    assert seen == set(read)


def test_the_plant_is_ideal_unless_the_study_says_otherwise(make_study: Callable[..., Study]) -> None:
    study = make_study()
    assert study.plant.ideal
    assert study.simulation.settle == 3.0
    assert list(plant_settings(study.plant)) == []
    empty = make_study(plant={"actuator": {}, "mismatch": {}, "tyres": {}, "sensors": {}, "residuals": {}})
    assert empty.hash == study.hash
    assert not make_study(plant={"sensors": {"kalman": {}}}).plant.ideal  # a filter with its defaults is a filter


def test_plant_and_horizon_decide_numbers_and_go_through_json(make_study: Callable[..., Study], tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(EVERY_OPTION)
    study = Study.from_toml(tmp_path / "s.toml")
    again = Study.from_dict(json.loads(json.dumps(study.content())))
    assert (again.content(), again.plant, again.hash) == (study.content(), study.plant, study.hash)
    simulation = {"window": "control"}
    hashes = {make_study(simulation=simulation).hash}
    for key, value in leaves(tomllib.loads(EVERY_OPTION)["plant"]).items():
        table: Any = value
        for part in reversed(key.split(".")):
            table = {part: table}
        if key == "mismatch.mu":
            table["tyres"] = {"model": "magic_formula"}
        elif key in ("tyres.mu", "tyres.shape"):
            table["tyres"]["model"] = "magic_formula"
        elif key == "residuals.bandwidth":
            table["residuals"]["y"] = True
        hashes.add(make_study(plant=table, simulation=simulation).hash)
    hashes.add(make_study(simulation=simulation | {"settle": 2}).hash)
    # every key gives a study of its own; tyres.model alone is the one that mismatch.mu was compared with
    assert len(hashes) == 2 + len(leaves(tomllib.loads(EVERY_OPTION)["plant"]))


def test_frames_a_second_are_another_way_to_write_a_period(make_study: Callable[..., Study]) -> None:
    study = make_study(plant={"sensors": {"fps": 30, "delay": 0.07}})
    assert study.hash == make_study(plant={"sensors": {"period": 1 / 30, "delay": 0.07}}).hash
    assert Study.from_dict(json.loads(json.dumps(study.content()))).plant == study.plant
    assert list(plant_settings(study.plant)) == [("sensors.period", "0.0333333 s"), ("sensors.delay", "0.07 s")]


def test_a_design_runs_once_however_often_it_is_written() -> None:
    blocks = [{"law": "toy", "y_s": [0.1, 0.2]}, {"law": "toy", "y_s": 0.1, "gains": {"K": -0.2}}]
    assert len(Study.from_dict({"name": "a", "design": blocks}).designs) == 2


def test_a_law_follows_the_study_unless_the_design_says_otherwise() -> None:
    free = Design.from_gains("toy", 0.2, {})
    fixed = Design.from_gains("toy", 0.2, {"convention": "consistent"})
    assert free.id != fixed.id
    assert free.controller("as_printed").convention == "as_printed"  # type: ignore[attr-defined]
    assert fixed.controller("as_printed").convention == "consistent"  # type: ignore[attr-defined]
    assert free.label == fixed.label == "Toy, y_s=0.2 m"


@given(
    st.lists(st.floats(0, 1), min_size=1, max_size=4, unique=True),
    st.lists(st.floats(0, 1), min_size=1, max_size=4, unique=True),
    st.lists(st.integers(1, 50), min_size=1, max_size=3, unique=True),
)
def test_a_grid_is_the_whole_product_in_the_order_written(y_s: list[float], K: list[float], N: list[int]) -> None:
    block = {"law": "linear_mpc", "y_s": y_s, "gains": {"q_y_rate": K, "horizon": N}}
    study = Study.from_dict({"name": "a", "design": [block]})
    designs = [(d.y_s, dict(d.gains)["q_y_rate"], dict(d.gains)["horizon"]) for d in study.designs]
    assert designs == list(dict.fromkeys(itertools.product(y_s, K, N)))
    assert len({d.id for d in study.designs}) == len(designs)


@pytest.mark.parametrize(
    ("entry", "values"),
    [
        ({"from": 0.1, "to": 0.3, "count": 3}, (0.1, 0.2, 0.3)),
        ({"from": 2, "to": -2, "count": 5}, (2.0, 1.0, 0.0, -1.0, -2.0)),
        ({"from": 1, "to": 1000, "count": 4, "scale": "log"}, (1.0, 10.0, 100.0, 1000.0)),
        ({"from": -1e-3, "to": -0.1, "count": 3, "scale": "log"}, (-0.001, -0.01, -0.1)),
        ({"from": 1 / 3, "to": 3.000000000000004, "count": 2}, (1 / 3, 3.000000000000004)),
        ([3, 1, 3, 2, 1], (3, 1, 2)),
        ([True, 1, 1.0], (True, 1, 1.0)),
        ("osqp", ("osqp",)),
    ],
)
def test_the_values_of_an_entry(entry: Any, values: tuple[Any, ...]) -> None:
    """Ends as they are written, between them twelve digits; each value once."""
    assert list(map(repr, expand(entry))) == list(map(repr, values))


def test_whole_values_of_a_range_and_the_scale_that_a_gain_declares() -> None:
    assert expand({"from": 1, "to": 10, "count": 4}, whole=True) == (1, 4, 7, 10)
    assert expand({"from": 1, "to": 16, "count": 5}, "log", whole=True) == (1, 2, 4, 8, 16)
    assert expand({"from": 0, "to": 16, "count": 3}, "log") == (0.0, 8.0, 16.0)  # no logarithm of 0
    assert expand({"from": -1, "to": 1, "count": 3}, "log") == (-1.0, 0.0, 1.0)
    assert expand({"from": 1, "to": 3, "count": 3, "scale": "linear"}, "log") == (1.0, 2.0, 3.0)


PAPER = load_study("paper").content()
HARD_TEXT = 'a "quoted"  title, with [brackets],\n\\ and </script> ü'


@pytest.mark.parametrize(
    "content",
    [
        *(load_study(name).content() for name in catalog_names()),
        PAPER | {"title": HARD_TEXT},
        *(
            PAPER | {"scenarios": {"left": 3, "given": {"v_mean": given}}}
            for given in ((25.0, None), (None, 25.0), 25.0)
        ),
        PAPER | {"ranking": {"require": ["deeper <= 0.5"], "pareto": ["S", "deeper"]}},
    ],
)
def test_a_study_written_as_toml_is_the_same_study_again(content: dict[str, Any], tmp_path: Path) -> None:
    study, path = Study.from_dict(content), tmp_path / "s.toml"
    path.write_text(toml_text(study), encoding="utf-8")
    (tmp_path / "my_car.py").write_text((CATALOG / "my_car.py").read_text(encoding="utf-8"), encoding="utf-8")
    again = load_study(str(path))
    assert (again.content(), again.hash, again.title) == (study.content(), study.hash, content["title"])
    if "ranking" in content and content["ranking"]["require"] == ["deeper <= 0.5"]:
        assert 'require = ["deeper <= 0.5"]' in path.read_text(encoding="utf-8")


def test_the_paper_is_run_from_the_printed_start() -> None:
    """Mean S over both windows; from the steady start they would be others."""
    means = []
    for window in ("departure", "control"):
        for study in map(load_study, ("paper", "paper-as-printed")):
            scenarios = load_model("reference").sample(200, 200, seed=study.seed)
            controller = study.designs[1].controller(study.simulation.convention)
            means.append(simulate(controller, scenarios, setup=study.setup(), y_s=0.2, window=window).S.mean())
    expected = [2.2745467139154925, 2.612075935029094, 0.8985804534786732, 1.236109674592275]
    np.testing.assert_allclose(means, expected, rtol=1e-6)  # to what the loop promises on any processor


def test_the_catalog_loads() -> None:
    names = "driver ideal my-vehicle paper paper-as-printed reality road-edge trigger-and-gains zoo zoo-sweep"
    assert catalog_names() == tuple(names.split())
    assert all(load_study(name).name == name for name in catalog_names())
    assert not load_study("reality").plant.ideal
    assert [name for name in catalog_names() if not load_study(name).plant.driver.ideal] == ["driver"]
    assert load_study("paper").plant.ideal
    assert load_study("ideal").plant.ideal
    assert len(load_study("ideal").designs) >= 100
    for name in ("trigger-and-gains", "zoo", "zoo-sweep"):
        study = load_study(name)
        assert not study.plant.ideal
        assert {"stable", "comfort"} <= set(study.ranking.require)
        # beside laws that know no limit of comfort are those that do
        knows = {design.law for design in study.designs if 0.0 < dict(design.gains).get("jerk_max", 0.0) < 5.0}
        assert "linear_mpc" in knows
        assert not {design.law for design in study.designs if "mpc" in design.law} - knows


@pytest.mark.parametrize(
    ("parts", "key", "value"),
    [
        ({"ranking": {"baseline": "lqx"}}, "ranking.baseline", "lqx"),
        ({"ranking": {"baseline": "000000"}}, "ranking.baseline", "000000"),
        ({"ranking": {"pareto": ["S", "cost"]}}, "ranking.pareto[1]", "cost"),
        ({"search": {"objectives": []}}, "search.objectives", []),
    ],
)
def test_what_a_night_could_be_lost_on_is_refused_at_once(parts: dict[str, Any], key: str, value: Any) -> None:
    content = {"name": "s", "design": [{"law": "none"}, {"law": "lqr"}]}
    with pytest.raises(StudyError) as caught:
        Study.from_dict(content | parts)
    assert_fields(caught.value, f"study: {key}", value)
    with pytest.raises(StudyError, match=r"^study: ranking\.require: .*'ay_p59'.*did you mean 'a_y_peak_p95'"):
        Study.from_dict(content | {"ranking": {"require": "ay_p59 <= 3"}})
    good = content | {"ranking": {"baseline": Study.from_dict(content).designs[1].id[:7], "require": "ay_p95 <= 3"}}
    assert Study.from_dict(good).ranking.require


def test_several_objectives_of_a_search_are_the_pareto_front() -> None:
    content: dict[str, Any] = {"name": "s", "design": [{"law": "lqr", "gains": {"r_delta": [50, 500]}}]}
    two = content | {"search": {"objectives": ["S", "effort_mean"]}}
    assert Study.from_dict(two).ranking.pareto == ("S", "effort_mean")
    assert Study.from_dict(two | {"ranking": {"pareto": ["S"]}}).ranking.pareto == ("S",)
    one = Study.from_dict(content | {"search": {}})
    assert one.ranking.pareto == Study.from_dict(content).ranking.pareto
    assert Study.from_dict(one.content()).ranking == one.ranking
