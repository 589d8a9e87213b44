"""Tests of regulations and Euro NCAP as data, against the numbers that their texts print."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers.errors import assert_fields
from ldctoolkit.errors import InputError, StudyError
from ldctoolkit.plant_options import Driver
from ldctoolkit.studies.standards import Cells, load_standard, standard_names

ROAD_EDGE = "euroncap-2026-elk-road-edge"
DRIFTING = (ROAD_EDGE, "euroncap-2025-elk", "euroncap-2026-driveability")


def table(cells: Cells, values: np.ndarray) -> dict[int, list[float]]:
    """Values of each speed [km/h], by rising lateral velocity."""
    kmh = np.round(cells.speed * 3.6).astype(int)
    return {int(v): values[kmh == v][np.argsort(cells.second[kmh == v])].tolist() for v in np.unique(kmh)}


STANDARD = load_standard(ROAD_EDGE)
CELLS = STANDARD.every_cell
MADE = STANDARD.scenarios(CELLS, 0.85)


def test_the_catalog() -> None:
    assert standard_names() == (*sorted(DRIFTING), "iso-11270", "un-r79-b1")
    sizes = {name: load_standard(name).every_cell.n for name in standard_names()}
    assert sizes == dict(zip(standard_names(), (30, 30, 36, 25, 14), strict=True))
    limits = {
        ROAD_EDGE: [-0.1],
        "euroncap-2025-elk": [-0.3],
        "iso-11270": [3.0, 5.0],
        "un-r79-b1": [0.0, 0.0, 5.0, 9.5],
    }
    for name, expected in limits.items():
        assert [condition.limit for condition in load_standard(name).condition] == expected
    for name in standard_names():
        assert load_standard(name).lane_width_m == (3.5, 3.7)
        assert load_standard(name).second_hand == (name not in (ROAD_EDGE, "euroncap-2026-driveability"))


def test_the_grid_of_the_road_edge() -> None:
    assert [int((CELLS.extended == extended).sum()) for extended in (False, True)] == [30, 6]
    assert CELLS.second[CELLS.extended].tolist() == [0.7] * 6
    assert table(CELLS, CELLS.second) == {s: [0.2, 0.3, 0.4, 0.5, 0.6, 0.7] for s in range(50, 101, 10)}
    assert (CELLS.name(0), CELLS.name(35)) == ("50 km/h, 0.2 m/s", "100 km/h, 0.7 m/s")
    assert (STANDARD.speed_tolerance_km_h, STANDARD.lateral_velocity_tolerance_m_s) == (1.0, 0.05)


def test_the_arc_covers_what_the_protocol_prints() -> None:
    """d1 and v^2/R, and d1 = V^2 / (2 v^2/R), to 1 mm and 5e-4 m/s^2; the path goes on for 10 s beyond the line."""
    d1, acceleration = MADE.drift.arc(MADE.v_mean)[1], MADE.v_mean**2 / MADE.drift.radius
    np.testing.assert_allclose(table(CELLS, d1)[70], [0.063, 0.143, 0.254, 0.397, 0.571, 0.778], atol=1e-3)
    printed = {50: 0.322, 60: 0.463, 70: 0.315, 80: 0.412, 90: 0.521, 100: 0.322}
    for speed, values in table(CELLS, acceleration).items():
        np.testing.assert_allclose(values, printed[speed], atol=5e-4)
    np.testing.assert_allclose(d1, CELLS.second**2 / (2 * acceleration), atol=1e-3)
    for values in table(CELLS, MADE.drift.distance - d1).values():
        np.testing.assert_allclose(values, [0.7, 0.9, 0.8, 0.75, 0.6, 0.525], atol=1e-12)
    np.testing.assert_allclose(MADE.drift.motion(MADE.v_mean, MADE.T - 10.0)[0], 0.0, atol=1e-9)
    assert MADE.side.tolist() == [-1] * 36
    assert not MADE.c_0.any()


def test_the_corners_keep_the_arc_of_the_cell() -> None:
    """1,200 m at 69 km/h as at 70."""
    off = STANDARD.scenarios(CELLS, 0.85, speed=-1 / 3.6, rate=0.05)
    np.testing.assert_allclose(off.v_mean, MADE.v_mean - 1 / 3.6)
    np.testing.assert_allclose(off.drift.lateral_velocity, CELLS.second + 0.05)
    np.testing.assert_array_equal(off.drift.radius, MADE.drift.radius)


def test_the_bends_of_r79() -> None:
    """80 and 90 % of 0.5 and 0.8 m/s^2; straight on from the middle of the lane, which is that much further."""
    standard = load_standard("un-r79-b1")
    cells = standard.every_cell
    slow, fast = [0.4, 0.45], [0.64, 0.72]
    assert table(cells, cells.second) == {s: slow if s <= 100 else fast for s in (70, 80, 90, 100, 110, 120, 130)}
    assert cells.name(13) == "130 km/h, 0.72 m/s²"
    made = standard.scenarios(cells, 0.85)
    np.testing.assert_allclose(-made.c_0 * made.v_mean**2, cells.second)
    np.testing.assert_allclose(made.drift.distance, 0.85)
    np.testing.assert_allclose(made.drift.motion(made.v_mean, made.T - 10.0)[0], 0.0, atol=1e-3)


def test_the_limits_of_driveability() -> None:
    standard = load_standard("euroncap-2026-driveability")
    cells = standard.every_cell
    wheel, after, torque, against = standard.condition
    assert (wheel.quantity, wheel.from_speed_km_h, after.from_speed_km_h) == ("steering_wheel_rate", 70.0, 0.0)
    assert table(cells, standard.limits(wheel, cells))[80] == [20.0, 25.0, 30.0, 35.0, 40.0]
    assert table(cells, standard.limits(after, cells))[100] == [0.3, 0.3, 0.4, 0.5, 0.6]
    assert (torque.quantity, torque.limit) == ("driver_torque_peak", 3.0 + 0.5)
    assert (against.quantity, against.limit) == ("against_parallel", 1.0)
    assert standard.required == (3, 4)


def test_without_a_driver_what_needs_one_is_not_assessable(tmp_path: Path) -> None:
    for name, least in (("euroncap-2026-driveability", 2), ("un-r79-b1", 1), ("iso-11270", 0)):
        standard = load_standard(name)
        given, left = standard.assessable(Driver(follows=1.0)), standard.assessable(Driver())
        assert given == standard
        assert len(left.condition) == len(standard.condition) - least
        assert {condition.quantity for condition in left.condition}.isdisjoint(
            {"driver_torque_peak", "against_parallel"}
        )
        assert len(left.not_assessable) == len(standard.not_assessable) + least
        for part in left.not_assessable[:least]:
            assert part.why.startswith(
                "it needs a driver's torque, which the vehicle model does not have; add [plant.driver]"
            )
    left = load_standard("euroncap-2026-driveability").assessable(Driver())
    assert left.not_assessable[0].what == "overriding torque at most 3.0 Nm (+0.5)"
    alone = load_standard(own(tmp_path, 'quantity = "dtle"', 'quantity = "against_parallel"'))
    with pytest.raises(InputError) as caught:
        alone.assessable(Driver())
    assert (caught.value.path, caught.value.value) == ("standard", "own")
    assert "[plant.driver]" in caught.value.hint


OWN = """
name = "own"
title = "Own"
source = "here"
second_hand = false
lane_width_m = [3.5, 3.7]
[drift]
radius_m = [[0.0, 600.0]]
lateral_velocity_m_s = [0.2, 0.5]
distance_m = [0.7, 0.6]
[[cells]]
speed_km_h = [50]
lateral_velocity_m_s = [0.2, 0.5]
[[condition]]
quantity = "dtle"
limit = -0.1
"""


def own(folder: Path, old: str, new: str) -> Path:
    assert old in OWN
    path = folder / "own.toml"
    path.write_text(OWN.replace(old, new, 1), encoding="utf-8")
    return path


def test_a_test_of_ones_own(tmp_path: Path) -> None:
    cells = load_standard(own(tmp_path, "-0.1", "-0.2")).every_cell
    assert [cells.name(i) for i in range(cells.n)] == ["50 km/h, 0.2 m/s", "50 km/h, 0.5 m/s"]


@pytest.mark.parametrize(
    ("old", "new", "key", "value", "allowed"),
    [
        ("title", "titel", "titel", ..., {"title"}),
        ('quantity = "dtle"', 'quantity = "dlte"', "condition[0].quantity", "dlte", {"dtle"}),
        ("false", '"no"', "second_hand", "no", "true or false"),
        ("[50]", "[-3.0]", "cells[0].speed_km_h[0]", -3.0, "greater than 0"),
        ("[50]", "[]", "cells[0].speed_km_h", [], "one value or more"),
        ("600.0", "0.0", "drift.radius_m[0][1]", 0.0, "greater than 0"),
        ("[[0.0, 600.0]]", "[[60.0, 600.0]]", "drift.radius_m", ..., "at 50 or below"),
        ("[3.5, 3.7]", "[3.7, 3.5]", "lane_width_m", (3.7, 3.5), "narrowest, widest"),
        (
            "-0.1",
            "[-0.1, -0.2]\n[[cells]]\nspeed_km_h = [70]\nlateral_acceleration_m_s2 = [0.4]",
            "condition[0].limit",
            ...,
            "a number",
        ),
        ("[0.7, 0.6]", "[0.7]", "drift.distance_m", ..., "one per lateral velocity"),
        ("-0.1", "[-0.1]", "condition[0].limit", ..., "one per lateral velocity"),
        ("0.5]\n[[cond", "0.6]\n[[cond", "cells", 0.6, "one of (0.2, 0.5)"),
        ("lateral_velocity_m_s = [0.2, 0.5]\n[[", "[[", "cells[0]", ..., ""),
        ("false", "false\nrequired = [2, 1]", "required", (2, 1), "how many conditions, and of how many"),
        ("false", "false\nrequired = [0, 1]", "required", (0, 1), "how many conditions, and of how many"),
        ("false", "false\nrequired = [0, 0]", "required", (0, 0), "how many conditions, and of how many"),
        ("-0.1", "-0.1\nunit = 1", "condition[0].unit", ..., {"quantity"}),
    ],
)
def test_a_mistake_is_named_with_file_and_key(
    tmp_path: Path, old: str, new: str, key: str, value: Any, allowed: Any
) -> None:
    path = own(tmp_path, old, new)
    with pytest.raises(StudyError) as caught:
        load_standard(path)
    assert_fields(caught.value, f"{path}: {key}", value, allowed)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=r"own\.toml: not a TOML file: Invalid value \(at line 2, column 7\)"):
        load_standard(own(tmp_path, "name =", "name =="))
    with pytest.raises(StudyError, match=r"none\.toml: cannot be read: No such file"):
        load_standard(tmp_path / "none.toml")
