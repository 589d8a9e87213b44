"""Departures for other simulators, read back by readers of their own and by the library's."""

import dataclasses
import importlib
import itertools
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lxml import etree
from numpy.typing import NDArray
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq

import ldctoolkit as ldc
from helpers.cli import csv_rows
from ldctoolkit.errors import InputError, LdcError
from ldctoolkit.plant_options import PlantOptions, Residuals
from ldctoolkit.simulation import Outcome, Takeover, Trajectories
from ldctoolkit.vehicle import BicycleModel

Array = NDArray[np.float64]
EDGE, HALF_LANE = 0.85, 1.8  # of the default vehicle


def departures(n: int = 40) -> ldc.Scenarios:
    """Both sides, bends to both and a changing curvature, vehicles that brake and accelerate."""
    rng = np.random.default_rng(7)
    bend = np.where(np.arange(n) // 2 % 2, 1.0, -1.0)
    return ldc.Scenarios.from_arrays(
        T=rng.uniform(2.0, 6.0, n), d_y=rng.uniform(0.3, 0.9, n), v_mean=rng.uniform(12.0, 35.0, n),
        a_mean=rng.uniform(-1.0, 1.0, n), c_0=bend * rng.uniform(5e-4, 6e-3, n), dc=rng.uniform(-3e-3, 3e-3, n),
        side=np.where(np.arange(n) % 2, -1, 1),
    )  # fmt: skip


SCENARIOS = departures()


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    return ldc.simulate(ldc.LQR(), SCENARIOS, 0.1, trajectories=True)


@pytest.fixture(scope="module")
def corrected(outcome: Outcome, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    return SCENARIOS.to_openscenario(tmp_path_factory.mktemp("corrected"), outcome=outcome)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    return SCENARIOS.to_openscenario(tmp_path_factory.mktemp("recorded"))


# ------------------------------------------------------------------------------------------------ readers


def events(file: Path) -> dict[str, tuple[float, Array]]:
    """Of each event its time and the vertices of its trajectory, a row of t, x, y, heading each."""
    read = {}
    for event in etree.parse(file).iter("Event"):
        vertices = [(vertex.get("time"), *map(vertex[0][0].get, "xyh")) for vertex in event.iter("Vertex")]
        read[event.get("name")] = (
            float(event.find(".//SimulationTimeCondition").get("value")), np.array(vertices, dtype=float)
        )  # fmt: skip
    return read


class Road:
    """The plan view of a road, integrated numerically, and its lines."""

    def __init__(self, file: Path) -> None:
        road = etree.parse(file).find("road")
        self.length = float(road.get("length"))
        self.elements = []
        for element in road.find("planView"):
            s, x, y, heading, length = (float(element.get(name)) for name in ("s", "x", "y", "hdg", "length"))
            (shape,) = element
            names = {"line": (), "arc": ("curvature", "curvature"), "spiral": ("curvStart", "curvEnd")}[shape.tag]
            first, last = (float(shape.get(name)) for name in names) if names else (0.0, 0.0)
            self.elements.append((s, x, y, heading, length, first, last))
        offset = float(road.find("lanes/laneOffset").get("a"))
        width = float(road.find("lanes/laneSection/right/lane[@id='-1']/width").get("a"))
        self.lines = offset - width, offset  # right and left of the lane

    def pose(self, s: float, element: int | None = None) -> tuple[float, float, float]:
        starts = [one[0] for one in self.elements]
        i = int(np.searchsorted(starts, s, side="right")) - 1 if element is None else element
        begin, x, y, heading, length, first, last = self.elements[i]

        def turned(way: float) -> float:
            return heading + first * way + (last - first) * way**2 / (2.0 * length)

        def part(wave: Any) -> float:
            return float(quad(lambda way: wave(turned(way)), 0.0, s - begin, epsabs=1e-11)[0])

        return x + part(np.cos), y + part(np.sin), turned(s - begin)

    def beside(self, x: float, y: float, near: float) -> tuple[float, float]:
        """Where the line is beside a point, and how far to the left of it that is."""

        def ahead(s: float) -> float:
            at_x, at_y, heading = self.pose(s)
            return (x - at_x) * float(np.cos(heading)) + (y - at_y) * float(np.sin(heading))

        s = brentq(ahead, near - 2.0, near + 2.0, xtol=1e-10)
        at_x, at_y, heading = self.pose(s)
        return s, float((y - at_y) * np.cos(heading) - (x - at_x) * np.sin(heading))


def plane(row: int, t: Array, origin: float, v: Any, e_y: Array) -> Array:
    """The lane's centre from the scenario's own parameters by `solve_ivp`, and points e_y to the departure's side."""
    p, side = SCENARIOS.take([row]), float(SCENARIOS.side[row])
    T, c_0, dc = (float(getattr(p, name)[0]) for name in ("T", "c_0", "dc"))

    def rates(time: float, state: Array) -> list[float]:
        speed = v(time)
        return [speed * np.cos(state[2]), speed * np.sin(state[2]), side * speed * (c_0 + dc * min(time / T, 1.0))]

    out = np.zeros((3, t.size))
    for times in (t[t >= origin], t[t < origin][::-1]):
        if times.size:
            grid = {"t_eval": times, "rtol": 1e-11, "atol": 1e-12, "max_step": 0.05}
            out[:, np.searchsorted(t, times)] = solve_ivp(rates, (origin, times[-1]), [0.0] * 3, **grid).y
    x, y, heading = out
    return np.stack([x - side * e_y * np.sin(heading), y + side * e_y * np.cos(heading)])


def own_path(row: int, t: Array) -> tuple[Any, Array]:
    """Speed and e_y of the recorded path, from the eight parameters."""
    T, d_y, v_mean, a = (float(getattr(SCENARIOS, name)[row]) for name in ("T", "d_y", "v_mean", "a_mean"))
    share = (v_mean * t + 0.5 * a * (t - T) * t) / (v_mean * T)
    return lambda time: v_mean + a * (time - T / 2.0), 4.0 * d_y * share * (1.0 - share) + EDGE


def plant(paths: Trajectories, row: int, t: Array) -> Array:
    """e_y under the commands of the loop, held over its samples, by `solve_ivp`."""
    v = float(paths.v[row])
    A, B, E = (part[0] for part in BicycleModel().matrices(np.array([v])))
    T, c_0, dc = (float(getattr(SCENARIOS, name)[row]) for name in ("T", "c_0", "dc"))

    def rates(time: float, x: Array, delta: float) -> Any:
        return A @ x + B * delta + E * v * (c_0 + dc * min(time / T, 1.0))

    state, e_y, sample = paths.x[row, 0], np.zeros(t.size), paths.t[row, np.isfinite(paths.t[row])]
    for k, span in enumerate(itertools.pairwise(sample)):
        inside = (t >= span[0] - 1e-9) & (t <= span[1] + 1e-9)
        grid = {"rtol": 1e-10, "atol": 1e-12, "dense_output": True}
        run = solve_ivp(rates, span, state, args=(paths.delta[row, k],), **grid)
        e_y[inside], state = run.sol(np.clip(t[inside], *span))[0], run.y[:, -1]
    return e_y


# ------------------------------------------------------------------------------------------------ positions


def test_the_corrected_path_is_that_of_the_loop(corrected: tuple[Path, ...], outcome: Outcome) -> None:
    """At the loop's samples to its own positions, between them to an integration of the plant."""
    paths = outcome.trajectories
    assert paths is not None
    x, y, heading = paths.world()
    for row in range(40):
        read, t_s = events(corrected[row]), float(outcome.t_s[row])
        assert [*read] == ["recorded", "trigger"]
        assert [time for time, _ in read.values()] == pytest.approx([0.0, t_s], abs=1e-9)
        (t, *pose), known = read["trigger"][1].T, np.isfinite(paths.t[row])
        at = np.searchsorted(t, paths.t[row, known] - 1e-7)
        assert t[0] == pytest.approx(t_s, abs=1e-9)
        assert np.diff(t).max() <= 0.01 + 1e-9
        for values, own in zip(pose, (x, y, heading), strict=True):
            np.testing.assert_allclose(values[at], own[row, known], atol=1e-6)
        if row < 8:
            own_x, own_y = plane(row, t, t_s, lambda _, v=float(paths.v[row]): v, plant(paths, row, t))
            assert np.hypot(pose[0] - own_x, pose[1] - own_y).max() < 1e-4


def test_the_recorded_path_is_that_of_the_parameters(
    recorded: tuple[Path, ...], corrected: tuple[Path, ...], outcome: Outcome
) -> None:
    for row in range(40):
        for file, origin in ((recorded[row], 0.0), (corrected[row], float(outcome.t_s[row]))):
            t, x, y, heading = events(file)["recorded"][1].T
            assert (t[0], t[-1]) == (0.0, pytest.approx(origin or float(SCENARIOS.T[row]), abs=1e-9))
            v, e_y = own_path(row, t)
            own_x, own_y = plane(row, t, origin, v, e_y)
            assert np.hypot(x - own_x, y - own_y).max() < 1e-5
            assert np.hypot(np.diff(x), np.diff(y)).max() < 0.36
            # the body points along the path, but for the side slip
            along = np.arctan2(np.gradient(y, t), np.gradient(x, t))
            assert np.abs(np.sin(along - heading)).max() < 0.04


def test_the_vehicle_is_beyond_the_line_of_the_road_as_far_as_it_was(
    recorded: tuple[Path, ...], corrected: tuple[Path, ...], outcome: Outcome
) -> None:
    paths = outcome.trajectories
    assert paths is not None
    for row in range(40):
        side = float(SCENARIOS.side[row])
        road = Road(recorded[row].with_suffix(".xodr"))
        assert road.lines == pytest.approx((-HALF_LANE, HALF_LANE))
        line = side * road.lines[1 if side > 0 else 0]
        t, x, y, _ = events(recorded[row])["recorded"][1].T
        v, e_y = own_path(row, t)
        s = 50.0 + np.cumsum(np.append(0.0, np.diff(t) * v(t[1:] - np.diff(t) / 2.0)))
        peak = int(np.argmax(e_y))
        for k in (0, peak, t.size - 1):
            at, left = road.beside(x[k], y[k], s[k])
            assert at == pytest.approx(s[k], abs=1e-3)
            beyond = side * left + 0.95 - line
            assert beyond == pytest.approx(float(SCENARIOS.d_y[row]) if k == peak else 0.0, abs=1e-3)
        road = Road(corrected[row].with_suffix(".xodr"))
        before, after = (vertices for _, vertices in events(corrected[row]).values())
        v_0, _ = own_path(row, before[:, 0])
        s_0 = 50.0 + quad(v_0, 0.0, outcome.t_s[row])[0]
        for k in range(0, np.count_nonzero(np.isfinite(paths.t[row])), 9):
            at = int(np.searchsorted(after[:, 0], paths.t[row, k] - 1e-7))
            _, left = road.beside(*after[at, 1:3], s_0 + float(paths.v[row]) * (after[at, 0] - after[0, 0]))
            assert side * left == pytest.approx(float(paths.x[row, k, 0]), abs=1e-3)


def test_the_road_has_no_gaps(recorded: tuple[Path, ...], corrected: tuple[Path, ...]) -> None:
    counts = []
    for file in (*recorded, *corrected):
        road = Road(file.with_suffix(".xodr"))
        counts.append(len(road.elements))
        assert sum(element[4] for element in road.elements) == pytest.approx(road.length)
        for i, (s, x, y, heading, *_) in enumerate(road.elements[1:], start=1):
            assert s == pytest.approx(sum(element[4] for element in road.elements[:i]), abs=1e-9)
            before = road.pose(s, i - 1)
            assert np.hypot(before[0] - x, before[1] - y) < 1e-4
            assert before[2] == pytest.approx(heading, abs=1e-4)
    assert max(counts) < 40


# ------------------------------------------------------------------------------------------------ the standards


SCHEMAS = Path(importlib.import_module("scenariogeneration").__file__ or "").parents[1] / "schemas"


def test_files_are_those_of_the_standards(recorded: tuple[Path, ...], corrected: tuple[Path, ...]) -> None:
    """Order, types and required attributes, by the schemas that the library brings."""
    schemas = {".xosc": "OpenSCENARIO_1_0.xsd", ".xodr": "opendrive_17_core.xsd"}
    for suffix, name in schemas.items():
        schema = etree.XMLSchema(etree.parse(SCHEMAS / name))
        for file in (*recorded, *corrected):
            schema.assertValid(etree.parse(file.with_suffix(suffix)))
    (broken,) = etree.parse(corrected[0]).iter("Maneuver")
    event = broken[0]
    event.insert(0, event[-1])  # its trigger before its action
    whole = etree.XMLSchema(etree.parse(SCHEMAS / schemas[".xosc"]))
    assert not whole.validate(broken.getroottree())


def test_the_library_reads_the_same(recorded: tuple[Path, ...], corrected: tuple[Path, ...], outcome: Outcome) -> None:
    xosc = importlib.import_module("scenariogeneration").xosc
    for row in range(40):
        for file in (recorded[row], corrected[row]) if not row else (corrected[row],):
            if not row:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    read = xosc.ParseOpenScenario(str(file))
            else:
                read = xosc.Scenario.parse(etree.parse(file))
            (group,) = read.storyboard.stories[0].acts[0].maneuvergroup
            own = events(file)
            assert [event.name for event in group.maneuvers[0].events] == [*own]
            for event in group.maneuvers[0].events:
                follow = event.action[0].action
                vertices = [(place.x, place.y, place.h) for place in follow.trajectory.shapes.positions]
                np.testing.assert_array_equal(np.array(vertices), own[event.name][1][:, 1:])
                assert list(follow.trajectory.shapes.time) == own[event.name][1][:, 0].tolist()
                assert (follow.timeref.scale, follow.timeref.offset) == (1.0, 0.0)
                assert follow.timeref.reference_domain.get_name() == "absolute"
                assert event.priority.get_name() == "overwrite"
    assert read.roadnetwork.road_file == "departure-000039.xodr"


def test_vehicle_clock_and_description(outcome: Outcome, corrected: tuple[Path, ...], tmp_path: Path) -> None:
    tree = etree.parse(corrected[3])
    assert tree.find(".//Dimensions").attrib == {"width": "1.9", "length": "4.6", "height": "1.5"}
    assert float(tree.find(".//BoundingBox/Center").get("x")) == pytest.approx(-0.02)
    assert [float(axle.get("positionX")) for axle in tree.find(".//Axles")] == [1.43, -1.47]
    stop = tree.find(".//StopTrigger//SimulationTimeCondition[@value]")
    read = events(corrected[3])
    assert float(tree.findall(".//StopTrigger//SimulationTimeCondition")[-1].get("value")) == read["trigger"][1][-1, 0]
    assert stop is not None
    start = tree.find(".//Init//WorldPosition")
    assert [float(start.get(name)) for name in "xyh"] == read["recorded"][1][0, 1:].tolist()
    assert float(tree.find(".//AbsoluteTargetSpeed").get("value")) == pytest.approx(own_path(3, np.zeros(1))[0](0.0))
    text = tree.find("FileHeader").get("description")
    assert "departure 3 to the right" in text
    assert "length 4.6 m is assumed" in text
    axle = SCENARIOS.to_openscenario(tmp_path, 3, outcome, reference="rear_axle")[0]
    for name, (_, vertices) in events(axle).items():
        _, x, y, heading = read[name][1].T
        shifted = x - 1.47 * np.cos(heading), y - 1.47 * np.sin(heading), heading
        np.testing.assert_allclose(vertices[:, 1:].T, shifted, atol=1e-8)
    tree = etree.parse(axle)
    assert [float(axle.get("positionX")) for axle in tree.find(".//Axles")] == [pytest.approx(2.9), 0.0]
    assert float(tree.find(".//BoundingBox/Center").get("x")) == pytest.approx(1.45)


def test_tables_have_the_same_path(corrected: tuple[Path, ...], outcome: Outcome, tmp_path: Path) -> None:
    paths = outcome.trajectories
    assert paths is not None
    for row in (2, 3):
        (file,) = SCENARIOS.to_openscenario(tmp_path, [row], outcome, format="csv")
        assert file.name == f"departure-00000{row}.csv"
        rows, (_, before), (_, after) = csv_rows(file), *events(corrected[row]).values()
        assert [*rows[0]] == [
            "t_s", "x_m", "y_m", "heading_rad", "speed_m_s", "wheel_angle_rad", "trigger_time_s",
        ]  # fmt: skip
        t, x, y, heading, v, delta, trigger = np.array([[float(cell) for cell in one.values()] for one in rows]).T
        np.testing.assert_allclose(np.stack([t, x, y, heading]).T, np.vstack([before[:-1], after]), atol=1e-6)
        np.testing.assert_allclose(trigger, outcome.t_s[row], atol=1e-9)
        side = float(SCENARIOS.side[row])
        at = np.searchsorted(t, paths.t[row, np.isfinite(paths.t[row])] - 1e-7)
        np.testing.assert_allclose(side * delta[at], paths.delta[row, : at.size], atol=1e-9)
        assert side * delta[at[1] - 1] == pytest.approx(paths.delta[row, 0], abs=1e-9)  # held over the sample
        early = t < outcome.t_s[row] - 1e-6
        np.testing.assert_allclose(v[early], own_path(row, t[early])[0](t[early]), atol=1e-6)
        np.testing.assert_allclose(v[~early], paths.v[row], atol=1e-6)
        bend = float(
            side * delta[early][-1]
        )  # the driver's wheel is that of the steady turn which the loop starts from
        over = Takeover.build(SCENARIOS.take([row]), ldc.Setup(), y_s=0.1)
        assert bend == pytest.approx(float(over.delta_0[0]), abs=1e-4)


# ------------------------------------------------------------------------------------------------ other departures


def assert_on_the_road(file: Path, side: int, t: Array, e_y: Array) -> None:
    """The vehicle is as far from the middle of the road's lane as it should be at these times."""
    road, vertices = Road(file.with_suffix(".xodr")), np.vstack([points for _, points in events(file).values()])
    for time, expected in zip(t, e_y, strict=True):
        here = vertices[np.argmin(np.abs(vertices[:, 0] - time))]
        assert here[0] == pytest.approx(time, abs=1e-7)
        gap = [np.hypot(*(np.array(road.pose(s)[:2]) - here[1:3])) for s in np.arange(0.0, road.length, 1.5)]
        assert side * road.beside(here[1], here[2], 1.5 * int(np.argmin(gap)))[1] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("trigger", ["distance", "ttlc"])
def test_a_speed_profile_and_residuals(trigger: Any, tmp_path: Path) -> None:
    """Of another setup, with a trigger inside the departure and one at its start."""
    setup = ldc.Setup(
        options=PlantOptions(speed="profile", residuals=Residuals(y=True, v=True)), seed=5, trigger=trigger
    )
    few = dataclasses.replace(
        SCENARIOS.take(range(6)), sigma_y=np.full(6, 0.03), sigma_v=np.full(6, 0.2), index=np.arange(40, 46)
    )
    driven = ldc.simulate(ldc.LQR(), few, 0.15, setup=setup, trajectories=[5, 1])
    paths = driven.trajectories
    assert paths is not None
    files = few.to_openscenario(tmp_path, [1, 5], driven, setup=setup)
    assert [file.name for file in files] == ["departure-000041.xosc", "departure-000045.xosc"]
    for file, i in zip(files, (1, 0), strict=True):
        read, known = events(file), np.isfinite(paths.t[i])
        assert [*read] == (["trigger"] if trigger == "ttlc" else ["recorded", "trigger"])
        assert read["trigger"][0] == pytest.approx(paths.t[i, 0], abs=1e-9)
        vertices = read["trigger"][1]
        at = np.searchsorted(vertices[:, 0], paths.t[i, known] - 1e-7)
        np.testing.assert_allclose(vertices[at, 1:].T, [part[i, known] for part in paths.world()], atol=1e-5)
        assert_on_the_road(file, int(few.side[1]), paths.t[i, known][::20], paths.x[i, known, 0][::20])
        if trigger == "distance":
            t = np.array([0.0, read["trigger"][0]])
            assert_on_the_road(file, int(few.side[1]), t, [EDGE, EDGE + 0.15])
    # at the departure's start there is no residual yet
    for other in (ldc.Setup(vehicle=ldc.VehicleParameters(w_v=1.8)), *[None][: trigger == "distance"]):
        with pytest.raises(InputError) as raised:
            few.to_openscenario(tmp_path / "none", [1], driven, setup=other)
        assert raised.value.path == "outcome"
    assert not (tmp_path / "none").exists()


def test_recorded_signals_and_drifts(tmp_path: Path) -> None:
    """Before the trigger the lane is the recorded one, after it that of the parameters."""
    t = np.arange(0.0, 4.0001, 0.1)
    y, v, c = 0.5 * np.sin(np.pi * t / 4.0), 20.0 + np.sin(t), -2e-3 + 5e-4 * np.sin(3.0 * t)
    signals = ldc.DepartureSignals(np.array([0, t.size]), t, y, v, c)
    one = dataclasses.replace(
        ldc.Scenarios.from_arrays(T=4.0, d_y=0.5, v_mean=20.0, c_0=-2e-3, side="right"), signals=signals
    )
    driven = ldc.simulate(ldc.LQR(), one, 0.2, trajectories=True)
    paths, (file,) = driven.trajectories, one.to_openscenario(tmp_path, outcome=driven)
    assert paths is not None
    early = events(file)["recorded"][1][:, 0][::20]
    assert_on_the_road(file, -1, early, EDGE + np.interp(early, t, y))
    assert_on_the_road(file, -1, paths.t[0, :60:15], paths.x[0, :60:15, 0])
    (file,) = one.to_openscenario(tmp_path / "recorded")
    times = events(file)["recorded"][1][:, 0][::50]
    assert_on_the_road(file, -1, times, EDGE + np.interp(times, t, y))
    drift = ldc.Scenarios.from_drifts(v=20.0, lateral_velocity=0.5, radius=1200.0, distance=1.1, T=4.0)
    (file,) = drift.to_openscenario(tmp_path / "drift")
    assert_on_the_road(file, 1, np.array([0.0, 4.0]), EDGE + np.array([-1.1, float(drift.d_y[0])]))
    assert [element[-2:] for element in Road(file.with_suffix(".xodr")).elements] == [(0.0, 0.0)] * 3


def test_a_narrow_bend_and_a_trigger_just_before_the_end(tmp_path: Path) -> None:
    """The road ends before it meets itself; no two points have one time."""
    bend = ldc.Scenarios.from_arrays(T=3.0, d_y=0.4, v_mean=8.0, c_0=-0.1, side=["left", "right"])
    for file, side in zip(bend.to_openscenario(tmp_path), (1, -1), strict=True):
        elements = Road(file.with_suffix(".xodr")).elements
        assert [element[4] for element in elements] == pytest.approx([10.0, 24.0, 10.0])
        assert elements[0][-2:] == pytest.approx((-0.1 * side, -0.1 * side))
        assert_on_the_road(file, side, np.array([0.0, 1.5, 3.0]), EDGE + np.array([0.0, 0.4, 0.0]))
    signals = ldc.DepartureSignals(
        np.array([0, 5]), np.array([0.0, 1.0, 2.0, 2.5, 3.0]), np.array([0.0, 0.1, 0.2, 0.3 + 2e-8, 0.0]),
        np.full(5, 20.0), np.zeros(5),
    )  # fmt: skip
    late = dataclasses.replace(ldc.Scenarios.from_arrays(T=3.0, d_y=0.4, v_mean=20.0), signals=signals)
    for y_s in (0.3, 2e-8):
        driven = ldc.simulate(ldc.LQR(), late, y_s, setup=ldc.Setup(dt=0.5 - 1e-9), trajectories=True)
        (file,) = late.to_openscenario(tmp_path / "late", outcome=driven, setup=ldc.Setup(dt=0.5 - 1e-9))
        read = events(file)
        assert [*read] == ["recorded", "trigger"][y_s < 0.1 :]
        for _, vertices in read.values():
            assert np.diff(vertices[:, 0]).min() > 9e-7


def test_departures_without_control_or_to_no_end(tmp_path: Path) -> None:
    """Never triggered: recorded. Diverged: up to the last sample."""
    few = ldc.Scenarios.from_arrays(T=4.0, d_y=[0.1, 0.6], v_mean=25.0, side=["left", "right"])
    wild = ldc.LQR(q_y=1e6, r_delta=1.0)
    actuator = PlantOptions(actuator=ldc.Actuator(delay=0.5, lag=0.5))
    setup = ldc.Setup(options=actuator, plant_knowledge="ideal")
    driven = ldc.simulate(wild, few, 0.2, setup=setup, trajectories=True)
    assert [ldc.EventStatus(status).name for status in driven.status] == ["NEVER_TRIGGERED", "DIVERGED"]
    never, lost = few.to_openscenario(tmp_path, outcome=driven, setup=setup)
    assert [*events(never)] == ["recorded"]
    assert "recorded path: never triggered" in etree.parse(never).find("FileHeader").get("description")
    paths = driven.trajectories
    assert paths is not None
    end = float(np.nanmax(paths.t[1]))
    assert end < 7.0
    assert events(lost)["trigger"][1][-1, 0] == pytest.approx(end, abs=1e-9)
    assert "diverged, the path ends there" in etree.parse(lost).find("FileHeader").get("description")
    table = few.to_openscenario(tmp_path, 0, driven, setup=setup, format="csv")[0]
    assert {one["trigger_time_s"] for one in csv_rows(table)} == {""}
    assert few.to_openscenario(tmp_path / "nothing", []) == few.to_openscenario(tmp_path / "nothing", False) == ()


def test_the_same_departures_give_the_same_bytes(corrected: tuple[Path, ...], outcome: Outcome, tmp_path: Path) -> None:
    again = SCENARIOS.to_openscenario(tmp_path, [7, 3], outcome)
    for file, row in zip(again, (7, 3), strict=True):
        for suffix in (".xosc", ".xodr"):
            assert file.with_suffix(suffix).read_bytes() == corrected[row].with_suffix(suffix).read_bytes()


@pytest.mark.parametrize(
    ("options", "path"),
    [
        ({"rows": [40]}, "rows"), ({"rows": [-1]}, "rows"), ({"rows": [2, 2]}, "rows"), ({"rows": [0.5]}, "rows"),
        ({"reference": "front"}, "reference"), ({"format": "xml"}, "format"), ({"setup": 1}, "setup"),
        ({"outcome": 1}, "outcome"), ({"folder": 5}, "folder"),
    ],
)  # fmt: skip
def test_what_cannot_be_written_is_named(options: dict[str, Any], path: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as raised:
        SCENARIOS.to_openscenario(**({"folder": tmp_path / "none"} | options))
    assert raised.value.path == path
    assert not (tmp_path / "none").exists()


def test_outcomes_and_scenarios_that_do_not_fit(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "none"
    without, some = (ldc.simulate(ldc.LQR(), SCENARIOS, 0.1, trajectories=rows) for rows in (False, [1]))
    mirrored = dataclasses.replace(SCENARIOS, side=-SCENARIOS.side)
    wrong = dataclasses.replace(SCENARIOS, T=np.where(np.arange(40) == 3, np.nan, SCENARIOS.T))
    turned = SCENARIOS.take(range(39, -1, -1))
    for scenarios, rows, given, path in (
        (SCENARIOS, [0], without, "outcome"), (SCENARIOS, [0], some, "outcome"), (mirrored, [0], outcome, "outcome"),
        (SCENARIOS.take(range(39)), [0], outcome, "outcome"), (turned, [0], outcome, "outcome"),
        (wrong, [0, 3], None, "rows"),
    ):  # fmt: skip
        with pytest.raises(InputError) as raised:
            scenarios.to_openscenario(target, rows, given)
        assert raised.value.path == path
    (tmp_path / "file").write_text("")
    with pytest.raises(LdcError, match="cannot be written"):
        SCENARIOS.to_openscenario(tmp_path / "file", [0])
    monkeypatch.setitem(sys.modules, "scenariogeneration", None)
    with pytest.raises(LdcError) as missing:
        SCENARIOS.to_openscenario(target, [0])
    assert missing.value.hint == "pip install 'ldctoolkit[scenario]'"
    assert not target.exists()
    assert len(SCENARIOS.to_openscenario(target, [0], format="csv")) == 1  # needs no extra
