"""Departures for other simulators: an OpenDRIVE road and an OpenSCENARIO file each, or a table of the driven path.

The plant passes the lane's centre line at the vehicle's speed and knows the vehicle by e_y and e_psi; here both become
a plane road, whose reference line is that centre line, and the motion of a point of the vehicle along it.
"""

from __future__ import annotations

import contextlib
import datetime
import importlib
import math
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.checked_files import write_whole
from ldctoolkit.control import EventStatus
from ldctoolkit.declared import checked_choice
from ldctoolkit.departures import LEFT
from ldctoolkit.errors import InputError, LdcError, expect
from ldctoolkit.scenarios import Scenarios
from ldctoolkit.setup import Setup
from ldctoolkit.simulation.loop import Outcome, lane_centre, path_rows
from ldctoolkit.simulation.takeover import Takeover
from ldctoolkit.version import __version__

_COLUMNS: Final = "t_s,x_m,y_m,heading_rad,speed_m_s,wheel_angle_rad,trigger_time_s"
_STEP: Final = 0.01  # [s] Between the points of a path, at most: straight lines between them stay within 0.2 mm
_SHORTEST: Final = 1e-6  # [s] Between them, at least
_ROAD_ERROR: Final = 5e-5  # [m] Most that an element of a road may leave the lane's centre line
_BEFORE, _AFTER = 50.0, 100.0  # [m] Of road before and after the path, less in a narrow bend
# what a simulator needs and the toolkit does not know, [m]: strip beside the lane, marks; length beyond the wheelbase,
# height, wheels; [rad], [m/s^2]: limits of the vehicle
_SHOULDER, _MARK, _OVERHANG, _HEIGHT, _WHEEL, _STEERING, _ACCELERATION = 2.0, 0.12, 1.7, 1.5, 0.65, 0.6, 10.0
_DATE: Final = datetime.datetime(1970, 1, 1)  # the standards want one, and the same study gives the same bytes


class _Stretch(NamedTuple):
    """Part of a departure at k times, on the true side: the lane's centre beside the vehicle, and the vehicle."""

    event: str  # that begins it: recorded, or trigger
    t: FloatArray  # (k,) [s] Time since the departure's start
    lane: FloatArray  # (4, k) [m], [m], [m], [rad] Way along the lane, position and heading of its centre
    curvature: FloatArray  # (k,) [1/m] Of the lane
    pose: FloatArray  # (3, k) [m], [m], [rad] Position of the vehicle's reference point, and heading of its body
    v: FloatArray  # (k,) [m/s] Speed
    delta: FloatArray  # (k,) [rad] Angle of the front wheels


def export_scenarios(
    scenarios: Scenarios, folder: str | Path, rows: bool | npt.ArrayLike, outcome: Outcome | None, setup: Setup | None,
    reference: str, format: str, design: str = "",
) -> dict[Path, str]:  # fmt: skip
    """Write departures as `Scenarios.to_openscenario` says; each main file, and what it shows."""
    expect("folder", folder, str | Path)
    expect("setup", setup, Setup | None)
    expect("outcome", outcome, Outcome | None)
    checked_choice("reference", reference, ("centre_of_gravity", "rear_axle"))
    checked_choice("format", format, ("openscenario", "csv"))
    if outcome is not None and outcome.S.size != scenarios.n:
        raise InputError("outcome", f"of {outcome.S.size} scenarios", allowed=f"one of these {scenarios.n}")
    folder, setup, chosen = Path(folder), setup or Setup(), path_rows(rows, scenarios.n, "rows")
    x_ref = -setup.vehicle.l_r if reference == "rear_axle" else 0.0
    numbers, control = [] if chosen is None else chosen.tolist(), f"control by {design}" if design else "control"
    try:
        library: Any = importlib.import_module("scenariogeneration") if format == "openscenario" else None
    except ImportError:
        hint = "pip install 'ldctoolkit[scenario]'"
        raise LdcError("to_openscenario", "scenariogeneration is not installed", hint=hint) from None
    departures = [_departure(scenarios.take([row]), row, setup, outcome, x_ref) for row in numbers]
    written: dict[Path, str] = {}
    with contextlib.suppress(OSError):  # writing says so
        folder.mkdir(parents=True, exist_ok=True)
    for row, parts in zip(numbers, departures, strict=True):
        status = EventStatus.OK if outcome is None else EventStatus(int(outcome.status[row]))
        about = f"{'left' if scenarios.side[row] == LEFT else 'right'}, positions of the {reference.replace('_', ' ')}"
        about = f"departure {scenarios.index[row]} to the {about}, {parts[0].t[0]:.4g} to {parts[-1].t[-1]:.4g} s, "
        about += f"{control} from {parts[-1].t[0]:.4g} s" if parts[-1].event == "trigger" else "recorded path"
        about += f": {status.name.lower().replace('_', ' ')}" if status else ""
        about += ", the path ends there" if status == EventStatus.DIVERGED else ""
        file = folder / f"departure-{scenarios.index[row]:06d}.{'xosc' if library else 'csv'}"
        if library:
            write_whole(file.with_suffix(".xodr"), _road(file.stem, parts, setup, library), LdcError)
        content = _scenario(file.stem, about, parts, setup, x_ref, library) if library else _table(parts)
        write_whole(file, content, LdcError)
        written[file] = about
    return written


def _departure(scenario: Scenarios, row: int, setup: Setup, outcome: Outcome | None, x_ref: float) -> list[_Stretch]:
    """The recorded path until the trigger, and the driven one from there on; or the recorded one alone."""
    over, known, parts = Takeover.build(scenario, setup, y_s=0.0), 0, []
    end = float(over.path.scenarios.T[0])
    if outcome is not None and outcome.triggered[row]:
        paths = outcome.trajectories
        at = np.arange(0) if paths is None else np.flatnonzero(paths.rows == row)
        if paths is None or not at.size:
            hint = "simulate with trajectories=True, or leave the outcome out for the recorded path"
            raise InputError("outcome", f"holds no path of scenario {row}", hint=hint)
        known, path = int(np.isfinite(paths.t[at]).sum()), paths.path.take(at)
        sample, x, held, fixed = (column[at[0], ...] for column in (paths.t, paths.x, paths.delta, paths.v))
        e_y, end = float(over.path.lateral(sample[:1])[0]) + setup.vehicle.edge_offset, float(sample[0])
        same = np.array_equal(path.scenarios.matrix(), scenario.matrix()) and path.scenarios.side == scenario.side
        if not same or abs(x[0, 0] - e_y) > 1e-6:
            raise InputError("outcome", f"is of other scenarios than no. {row}, or was driven with another setup")
    if end > _SHORTEST:
        t = np.linspace(0.0, end, 1 + math.ceil(end / _STEP))[None]
        columns = t, *over.recorded_motion(t), over.path.speed(t), over.path.curvature(t)
        parts.append(_stretch("recorded", scenario, x_ref, *(column[0] for column in columns), backwards=known > 0))
    if known > 1:
        from scipy.interpolate import CubicHermiteSpline

        pieces = math.ceil(np.nanmax(np.diff(sample)) / _STEP)
        t = np.interp(np.arange((known - 1) * pieces + 1) / pieces, np.arange(known), sample[:known])
        t = t[np.append(np.diff(t) > _SHORTEST, True)]
        spline = CubicHermiteSpline(sample[:known], x[:known, ::2], x[:known, 1::2])
        speed = path.speed(t[None])[0] if np.isnan(fixed) else np.full(t.size, fixed)
        delta, c = held[np.searchsorted(sample[:known], t, side="right") - 1], path.curvature(t[None])[0]
        parts.append(_stretch("trigger", scenario, x_ref, t, spline(t)[:, [0, 0, 1]], delta, speed, c))
    if not parts or not over.valid[0]:
        raise InputError("rows", "cannot be driven", value=row)
    return parts


def _stretch(
    event: str, scenario: Scenarios, x_ref: float, t: FloatArray, state: FloatArray, delta: FloatArray, v: FloatArray,
    curvature: FloatArray, *, backwards: bool = False,
) -> _Stretch:  # fmt: skip
    """A stretch whose lane starts at the origin, or ends there, from what is known in the outward frame."""
    side, order = int(scenario.side[0]), slice(None, None, -1 if backwards else 1)
    way = np.abs(t - t[order][0]), order.step * v, side * curvature
    lane = lane_centre(*(column[order][None] for column in way))[:, 0, order]
    e_y, heading = side * state[:, 0], lane[3] + side * state[:, 2]
    x = lane[1] - e_y * np.sin(lane[3]) + x_ref * np.cos(heading)
    y = lane[2] + e_y * np.cos(lane[3]) + x_ref * np.sin(heading)
    return _Stretch(event, t, lane, side * curvature, np.stack([x, y, heading]), v, side * delta)


def _table(parts: list[_Stretch]) -> bytes:
    """The path as CSV; the moment of the trigger is one row, that of the driven path."""
    columns = [np.stack([part.t, *part.pose, part.v, part.delta]) for part in parts]
    columns[:-1] = [column[:, :-1] for column in columns[:-1]]
    trigger = f"{parts[-1].t[0]:.10g}" if parts[-1].event == "trigger" else ""
    rows = [",".join([*(f"{value:.10g}" for value in row), trigger]) for row in np.hstack(columns).T.tolist()]
    return "\n".join([_COLUMNS, *rows, ""]).encode()


def _elements(lane: FloatArray, c: FloatArray) -> list[tuple[float, ...]]:
    """Elements of a reference line: start x, y, heading, length, curvature at both ends, linear in the way.

    Halved until they follow the lane; each starts where the lane does, so that no error adds up.
    """
    (way, *start), half = lane, c.size // 2
    off = np.abs(np.interp(way, way[[0, -1]], c[[0, -1]]) - c).max() * (way[-1] - way[0]) ** 2
    if off <= 2.0 * _ROAD_ERROR or c.size == 2:
        return [(*(column[0] for column in start), way[-1] - way[0], c[0], c[-1])]
    return [*_elements(lane[:, : half + 1], c[: half + 1]), *_elements(lane[:, half:], c[half:])]


def _road(name: str, parts: list[_Stretch], setup: Setup, library: Any) -> bytes:
    """OpenDRIVE: one lane, whose centre is the reference line, between solid marks, and a strip on either side."""
    xodr = library.xodr
    (x, y, heading), c, last = parts[0].lane[1:, 0], parts[0].curvature[0], parts[-1].curvature[-1]
    before, after = (min(most, 1.0 / max(abs(bend), 1e-9)) for most, bend in ((_BEFORE, c), (_AFTER, last)))
    chord, middle = before * np.sinc(0.5 * c * before / np.pi), heading - 0.5 * c * before
    first = x - chord * np.cos(middle), y - chord * np.sin(middle), heading - c * before, before, c, c
    elements = [element for part in parts for element in _elements(part.lane, part.curvature)]
    plan, width = xodr.PlanView(), setup.vehicle.w_l
    every = np.array([first, *elements, (*parts[-1].lane[1:, -1], after, last, last)])
    for x, y, heading, length, c, last in every.tolist():
        shape = xodr.Spiral(c, last, length=length)
        if abs(last - c) * length**2 < 1e-3 * _ROAD_ERROR:
            shape = xodr.Arc(c, length=length) if abs(c) > 1e-12 else xodr.Line(length)
        plan.add_fixed_geometry(shape, x, y, heading)
    section = xodr.LaneSection(0, xodr.Lane(xodr.LaneType.none))
    mark = xodr.RoadMark(xodr.RoadMarkType.solid, width=_MARK)
    section.centerlane.add_roadmark(mark)
    section.add_left_lane(xodr.Lane(xodr.LaneType.shoulder, a=_SHOULDER))
    section.add_right_lane(xodr.standard_lane(width, mark))
    section.add_right_lane(xodr.Lane(xodr.LaneType.shoulder, a=_SHOULDER))
    lanes, drive = xodr.Lanes(), xodr.OpenDrive(name)
    lanes.add_laneoffset(xodr.LaneOffset(0, 0.5 * width))
    lanes.add_lanesection(section)
    drive.add_road(xodr.Road(1, plan, lanes, name=name))
    element = drive.get_element()
    element.find("header").set("date", _DATE.isoformat())
    return bytes(library.prettify(element))


def _scenario(name: str, about: str, parts: list[_Stretch], setup: Setup, x_ref: float, library: Any) -> bytes:
    """OpenSCENARIO 1.0, which every simulator reads that reads any: one vehicle, an event for each stretch."""
    xosc, car = library.xosc, setup.vehicle
    length, limits = car.l_f + car.l_r + _OVERHANG, (max(float(part.v.max()) for part in parts), *2 * [_ACCELERATION])
    about = f"ldctoolkit {__version__}: {about}; length {length:.3g} m is assumed"
    box = xosc.BoundingBox(car.w_v, length, _HEIGHT, 0.5 * (car.l_f - car.l_r) - x_ref, 0.0, 0.5 * _HEIGHT)
    front = xosc.Axle(_STEERING, _WHEEL, car.w_v - _WHEEL / 3, car.l_f - x_ref, 0.5 * _WHEEL)
    rear = xosc.Axle(0.0, _WHEEL, car.w_v - _WHEEL / 3, -car.l_r - x_ref, 0.5 * _WHEEL)
    entities, init, maneuver = xosc.Entities(), xosc.Init(), xosc.Maneuver("departure")
    entities.add_scenario_object("Ego", xosc.Vehicle("car", xosc.VehicleCategory.car, box, front, rear, *limits))

    def after(name: str, t: float, point: str = "start") -> Any:
        condition = xosc.SimulationTimeCondition(round(float(t), 9), xosc.Rule.greaterThan)
        return xosc.ValueTrigger(name, 0.0, xosc.ConditionEdge.none, condition, triggeringpoint=point)

    for part in parts:
        places = [xosc.WorldPosition(x, y, 0.0, h, 0.0, 0.0) for x, y, h in part.pose.T.round(9).tolist()]
        if part is parts[0]:
            at_once = xosc.TransitionDynamics(xosc.DynamicsShapes.step, xosc.DynamicsDimension.time, 0.0)
            init.add_init_action("Ego", xosc.TeleportAction(places[0]))
            init.add_init_action("Ego", xosc.AbsoluteSpeedAction(float(part.v[0]), at_once))
        trajectory, event = xosc.Trajectory(part.event, False), xosc.Event(part.event, xosc.Priority.overwrite)
        trajectory.add_shape(xosc.Polyline(part.t.round(9).tolist(), places))
        timing = xosc.FollowingMode.position, xosc.ReferenceContext.absolute, 1.0, 0.0
        event.add_trigger(after(part.event, part.t[0]))
        event.add_action(part.event, xosc.FollowTrajectoryAction(trajectory, *timing))
        maneuver.add_event(event)
    board = xosc.StoryBoard(init, after("end", parts[-1].t[-1], "stop"))
    board.add_maneuver(maneuver, "Ego")
    rest = xosc.ParameterDeclarations(), entities, board, xosc.RoadNetwork(f"{name}.xodr"), xosc.Catalog()
    scenario = xosc.Scenario(about, "ldctoolkit", *rest, osc_minor_version=0, creation_date=_DATE)
    return bytes(library.prettify(scenario.get_element()))
