"""MDF logs, written by asammdf itself: planted departures come back, units and signs are right, faults are named."""

import dataclasses
import functools
import os
import random
import re
import subprocess
import sys
import threading
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import cli
from helpers.fuzz import check
from helpers.mdf import MAP, PLANTED, VEHICLE, WIDTH, curvature, groups, lane_offset, speed, write_log
from helpers.planted import assert_planted as departures_are_planted
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Extraction, extract_departures, mdf_logs, open_recordings, read_recordings

STEP = 0.04


def extract(logs: Path | list[Path], channels: str = MAP, **criteria: Any) -> Extraction:
    """Departures of logs with a map."""
    path = (logs[0] if isinstance(logs, list) else logs).parent / "map.toml"
    path.write_text(channels)
    return extract_departures(open_recordings(logs, channels=path), vehicle_width=VEHICLE, **criteria)


def assert_planted(extraction: Extraction, missing: tuple[int, ...] = ()) -> None:
    planted = [departure for i, departure in enumerate(PLANTED) if i not in missing]
    departures_are_planted(extraction.departures, planted, curvature, step=STEP, bend=3e-5)
    middle = np.array([departure.start + departure.T / 2.0 for departure in planted])
    np.testing.assert_allclose(extraction.departures.v_mean, speed(middle), atol=0.1)


@pytest.mark.parametrize(
    ("version", "name"), [("4.10", "a.mf4"), ("4.20", "a.MF4"), ("3.30", "a.mdf"), ("2.14", "a.mdf")]
)
def test_planted_departures_come_back(tmp_path: Path, version: str, name: str) -> None:
    extraction = extract(write_log(tmp_path / "log.mf4", version=version).rename(tmp_path / name) if name == "a.MF4"
                    else write_log(tmp_path / name, version=version))  # fmt: skip
    assert extraction.problems == ()
    assert_planted(extraction)
    assert extraction.provenance.curvature == "measured"
    assert [file.name for file in extraction.provenance.sources] == [name, "map.toml"]


def test_blocks_may_be_compressed_and_times_start_anywhere(tmp_path: Path) -> None:
    content = [(name, t + 1e6, channels) for name, t, channels in groups()]
    log = write_log(tmp_path / "a.mf4", content, compression=2)
    assert log.stat().st_size < 0.8 * write_log(tmp_path / "b.mf4", content).stat().st_size
    departures = extract(log).departures
    np.testing.assert_allclose(departures.start_time - 1e6, [departure.start for departure in PLANTED], atol=STEP)


def test_a_yaw_rate_serves_where_there_is_no_curvature(tmp_path: Path) -> None:
    yaw = MAP.replace('[curvature]\nchannel = "RoadCurvature"\nscale = -1', '[yaw_rate]\nchannel = "YawRate"')
    extraction = extract(write_log(tmp_path / "a.mf4"), yaw)
    assert_planted(extraction)
    assert extraction.provenance.curvature == "yaw_rate"


def test_two_lines_with_clocks_of_their_own_are_one_lane(tmp_path: Path) -> None:
    """Distances from the vehicle's sides, positive outwards, the right one 13 ms late and in mm."""
    late = np.arange(0.013, 97.0, 0.04)
    content = groups()
    _, t, camera = content[0]
    half = (WIDTH - VEHICLE) / 2.0
    camera["DistLeft"] = (half - lane_offset(t), "m")
    content.append(("Second", late, {"DistRight": (1000.0 * (half + lane_offset(late)), "mm")}))
    lines = """
    left_line = {channel = "DistLeft", offset = 0.9}
    right_line = {channel = "DistRight", scale = -1, offset = -0.9}
    speed = {channel = "VehicleSpeed", group = 1}
    curvature = {channel = "RoadCurvature", scale = -1}
    """
    extraction = extract(write_log(tmp_path / "a.mf4", content), lines)
    assert_planted(extraction)
    (recording,) = read_recordings(tmp_path / "a.mf4", channels=tmp_path / "map.toml")
    np.testing.assert_allclose(recording.lane_width[1:], WIDTH, atol=0.012)  # straight lines across kinks
    assert np.isnan(recording.lane_width[0])  # nothing is made up before the first sample


def invalid_between(t: np.ndarray, start: float, end: float) -> dict[str, Any]:
    return {"invalidation_bits": (t > start) & (t < end)}


@pytest.mark.parametrize("channel", ["LaneOffset", "VehicleSpeed", "LaneQuality", "RoadCurvature"])
def test_samples_with_invalidation_bits_are_missing(tmp_path: Path, channel: str) -> None:
    content = groups()[:2]
    t = content[0][1] if channel.startswith("Lane") else content[1][1]
    log = write_log(tmp_path / "a.mf4", content, **{channel: invalid_between(t, 39.5, 40.0)})
    extraction = extract(log)
    assert_planted(extraction, missing=(3,))
    assert extraction.refused.invalid == 1


def test_a_channel_may_be_invalid_as_a_whole(tmp_path: Path) -> None:
    """By a flag of the channel, without invalidation bits."""
    from asammdf import MDF

    write_log(tmp_path / "a.mf4")
    with MDF(tmp_path / "a.mf4") as log:
        next(channel for channel in log.groups[1].channels if channel.name == "VehicleSpeed").flags |= 1
        path = log.save(tmp_path / "b.mf4")
    assert "speed: channel 'VehicleSpeed' has no number at the times of 'LaneOffset'" in problem(path, MAP)


def test_a_channels_unit_overrides_that_of_its_conversion(tmp_path: Path) -> None:
    """Which several channels may share."""
    content = groups()
    conversion = {"a": 1.0, "b": 0.0, "unit": "km/h"}
    name, t, bus = content[1]
    content[1] = (name, t, bus | {"VehicleSpeed": (speed(t), "m/s")})
    assert_planted(extract(write_log(tmp_path / "a.mf4", content, VehicleSpeed={"conversion": conversion})))


def test_longer_gaps_than_allowed_are_not_bridged(tmp_path: Path) -> None:
    content = groups()
    name, t, bus = content[1]
    retained = (t < 39.2) | (t > 39.7)
    content[1] = (name, t[retained], {n: (v[retained], unit) for n, (v, unit) in bus.items()})
    log = write_log(tmp_path / "a.mf4", content)
    assert_planted(extract(log), missing=(3,))
    assert_planted(extract(log, "max_gap = 0.6\n" + MAP))


def test_a_state_is_held_no_longer_than_a_gap(tmp_path: Path) -> None:
    content = groups()
    t = np.arange(0.0, 97.0, 0.1)
    t = t[(t < 39.2) | (t > 39.8)]
    content.append(("Second", t, {"Quality": (np.ones(t.size), "")}))
    log = write_log(tmp_path / "a.mf4", content)
    channels = MAP + '[[valid]]\nchannel = "Quality"\n'
    assert_planted(extract(log, channels), missing=(3,))
    assert_planted(extract(log, "max_gap = 0.8\n" + channels))


def test_a_jump_stays_one_and_nothing_is_made_up_at_the_ends(tmp_path: Path) -> None:
    """A lane change at 2.03 s, between samples of both lines, which have clocks of their own."""
    t, late = np.arange(0.0, 4.0, 0.04), np.arange(0.013, 3.9, 0.04)
    content = [
        ("Left", t, {"LineLeft": (np.where(t < 2.03, 0.2, 3.7), "m"), "Speed": (np.full(t.size, 20.0), "m/s")}),
        ("Right", late, {"LineRight": (np.where(late < 2.03, -3.3, 0.2), "m")}),
    ]
    (tmp_path / "map.toml").write_text(
        'left_line = {channel = "LineLeft"}\nright_line = {channel = "LineRight"}\nspeed = {channel = "Speed"}'
    )
    (recording,) = read_recordings(write_log(tmp_path / "a.mf4", content), channels=tmp_path / "map.toml")
    finite = (t > 0.013) & (t < 3.893)
    np.testing.assert_array_equal(np.isfinite(recording.lane_width), finite)
    np.testing.assert_allclose(recording.lane_width[finite], 3.5)
    np.testing.assert_allclose(recording.lane_offset[finite], np.where(t < 2.03, 1.55, -1.95)[finite])


# what one of the unit is in SI, by hand
DEGREE = 0.017453292519943
SI = {
    "LaneOffset": {"m": 1.0, "cm": 0.01, "MM": 0.001, "ft": 0.3048, "in": 0.0254},
    "VehicleSpeed": {"m/s": 1.0, "km/h": 0.2777777777777778, "kph": 1 / 3.6, "mph": 0.44704, "kn": 0.514444444},
    "RoadCurvature": {"1/m": 1.0, "m^-1": 1.0, "m⁻¹": 1.0, "1/km": 0.001},
    "YawRate": {"rad/s": 1.0, "deg/s": DEGREE, "°/s": DEGREE, "mrad/s": 0.001},
    "Heading": {"rad": 1.0, "deg": DEGREE, "°": DEGREE, "mrad": 0.001},
    "SteeringAngle": {"rad": 1.0, "DEG": DEGREE, "°": DEGREE, "mrad": 0.001},
}  # fmt: skip
TRUE = {"LaneOffset": lane_offset, "VehicleSpeed": speed, "RoadCurvature": curvature, "Heading": lambda t: 0.5 + t,
        "YawRate": lambda t: curvature(t) * speed(t), "SteeringAngle": lambda t: 0.1 * t - 0.2}  # fmt: skip
COLUMN = {"LaneOffset": "lane_offset", "VehicleSpeed": "speed", "RoadCurvature": "curvature", "YawRate": "yaw_rate",
          "Heading": "heading", "SteeringAngle": "steering"}  # fmt: skip


@pytest.mark.parametrize("in_the_log", [True, False])
@pytest.mark.parametrize(("channel", "unit"), [(channel, unit) for channel, units in SI.items() for unit in units])
def test_units(tmp_path: Path, channel: str, unit: str, in_the_log: bool) -> None:
    t = np.arange(0.0, 4.0, 0.04)
    channels = {name: (TRUE[name](t), next(iter(units))) for name, units in SI.items()}
    channels[channel] = (TRUE[channel](t) / SI[channel][unit], unit if in_the_log else "")
    log = write_log(tmp_path / "a.mf4", [("All", t, channels)])
    lines = [f'{COLUMN[name]} = {{channel = "{name}"{"" if name != channel or in_the_log else f", unit = {unit!r}"}}}'
             for name in SI]  # fmt: skip
    (tmp_path / "map.toml").write_text("\n".join(["constant_lane_width = 3.5", *lines]))
    (recording,) = read_recordings(log, channels=tmp_path / "map.toml")
    np.testing.assert_allclose(getattr(recording, COLUMN[channel]), TRUE[channel](t), rtol=1e-8)
    np.testing.assert_array_equal(recording.lane_width, 3.5)


def problem(log: Path, channels: str) -> str:
    """What a log with such a map is left out for."""
    extraction = extract(log, channels)
    assert extraction.recordings == 0
    (text,) = extraction.provenance.problems
    return text


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("logs") / "a.mf4")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('scale = -1\n[lane_width]', 'unit = "m"\n[lane_width]', "lane_offset: channel 'LaneOffset' is in cm in the l"),
        ('"LaneOffset"', '"YawRate"', "lane_offset: channel 'YawRate' has the unit 'deg/s' in the log; allowed: m, cm"),
        ('"LaneOffset"', '"LaneQuality"', "lane_offset: channel 'LaneQuality' has the unit '' in the log; allowed: m,"),
        ('"LaneOffset"', '"LaneOfset"', "lane_offset: channel 'LaneOfset' is not in the log; did you mean 'LaneOffset"),
        ('group = "Bus"', '', "speed: channel 'VehicleSpeed' is in the groups 1 (Bus), 2 (GPS); `group`: not given; "),
        ('group = "Bus"', 'group = "Camera"', "speed: channel 'VehicleSpeed' is in the groups 1 (Bus), 2 (GPS); `grou"),
        ('group = "Bus"', 'group = 2', "speed: channel 'VehicleSpeed' has no number at the times of 'LaneOffset'"),
    ],
)  # fmt: skip
def test_what_does_not_fit_the_log_is_named(log: Path, old: str, new: str, message: str) -> None:
    assert old in MAP
    assert problem(log, MAP.replace(old, new, 1)).startswith(f"a.mf4: {message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed = 1 2", "not a TOML file: "), ("speed = " + "[" * 100_000, "not a TOML file: "),
        (MAP.replace("[speed]", "[sped]"), "sped: no such key; did you mean 'speed'? (allowed: "),
        (MAP.replace("scale", "sign", 1), "lane_offset.sign: no such key; allowed: channel, "),
        (MAP.replace("scale = -1", "scale = '-1'", 1), "lane_offset.scale: '-1'; allowed: a number"),
        (MAP.replace("scale = -1", "unit = 'furlong'", 1), "lane_offset.unit: 'furlong' of 'LaneOffset'; allowed: m,"),
        (MAP.replace("min = 2", "unit = 'm'"), "valid.unit: 'm' of 'LaneQuality'; allowed: none, it is a state"),
        (MAP.replace('channel = "LaneWidth"', ""), "lane_width.channel: is missing and has no default"),
        (MAP.replace('[lane_width]\nchannel = "LaneWidth"', ""), "lane_width: missing; needed: this, left_line and "),
        ("constant_lane_width = 0\n" + MAP, "constant_lane_width: 0; allowed: "),
        (MAP.replace("[lane_offset]", "[left_line]"), "lane_offset: missing; needed: this, or left_line and right_lin"),
        (MAP.replace("scale = -1", "min = 1", 1), "lane_offset.min: no such key; allowed: channel, "),
        ("max_gap = 0\n" + MAP, "max_gap: 0; allowed: "),
        (MAP[MAP.index("[curvature]"):], "speed: is missing and has no default"),
        (MAP.replace("scale = -1", "occurrence = 0", 1), "lane_offset.occurrence: 0; allowed: "),
        (MAP.replace("scale = -1", "occurrence = 1.0", 1), "lane_offset.occurrence: 1.0; allowed: a whole number"),
        (MAP.replace("scale = -1", "occurence = 1", 1), "lane_offset.occurence: no such key; did you mean 'occurrence"),
        (MAP + "[heading]\nchannel = 'H'\nunit = 'gon'", "heading.unit: 'gon' of 'H'; allowed: rad, mrad, deg, °"),
        (MAP + "[steering]\nchannel = 'H'\nunit = '1/m'", "steering.unit: '1/m' of 'H'; allowed: rad, mrad, deg, °"),
        (MAP + "[engaged]\nchannel = 'H'\nunit = 's'", "engaged.unit: 's' of 'H'; allowed: none, it is a state"),
        (MAP + "[engaged]\nchannel = 'H'\nmin = 1", "engaged.min: no such key; allowed: channel, group, occurrence, "),
    ],
)  # fmt: skip
def test_a_wrong_map_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(f"map.toml: {message}")):
        mdf_logs.read_channel_map(path)


def test_texts_are_states(tmp_path: Path) -> None:
    """Tables of a channel: texts for all values, or for some of them, where a camera says why there is no number."""
    content = groups()
    _, t, camera = content[0]
    _, t_bus, bus = content[1]
    bus["TurnSignal"] = (np.select([(t_bus > 14.0) & (t_bus < 20.0), (t_bus > 61.0) & (t_bus < 66.0)], [2, 1]), "")
    texts = {"val_0": 0, "text_0": "off", "val_1": 1, "text_1": "LEFT", "val_2": 2, "text_2": "RIGHT", "default": b"?"}
    offset = np.round(-100.0 * lane_offset(t)).astype(np.int16)
    offset[(t > 8.5) & (t < 9.0)] = 4095
    camera["LaneOffset"] = (offset, "cm")
    partly = {"lower_0": 4095, "upper_0": 4095, "text_0": "SNA", "default_addr": {"a": 1.0, "b": 0.0}}
    log = write_log(tmp_path / "a.mf4", content, TurnSignal={"conversion": texts}, LaneOffset={"conversion": partly})
    channels = MAP + '[turn_signal]\nchannel = "TurnSignal"\n'
    assert "turn_signal: channel 'TurnSignal' holds texts ('off', 'RIGHT', 'LEFT'); " in problem(log, channels)
    extraction = extract(log, channels + "values = {LEFT = 1, RIGHT = -1}")
    assert (extraction.refused.intended, extraction.refused.invalid) == (2, 1)
    assert_planted(extraction, missing=(0, 1, 4))


@pytest.mark.parametrize("channel", ["turn_signal", "left_signal"])
def test_numbers_of_a_signal_that_mean_nothing_here_are_named(tmp_path: Path, channel: str) -> None:
    """In many logs 1 is to the left and 2 to the right: taken as they are, both would be to the left."""
    content = groups()
    _, t, bus = content[1]
    bus["TurnSignal"] = (np.select([(t > 14.0) & (t < 20.0), (t > 61.0) & (t < 66.0)], [2, 1]), "")
    log = write_log(tmp_path / "a.mf4", content)
    channels = f'{MAP}[{channel}]\nchannel = "TurnSignal"\n'
    assert f"{channel}: channel 'TurnSignal' holds the number 2; allowed: -1, 0, 1, " in problem(log, channels)
    if channel == "turn_signal":
        extraction = extract(log, channels + "values = {1 = 1, 2 = -1}")
        assert extraction.refused.intended == 2
        assert_planted(extraction, missing=(1, 4))


@pytest.mark.parametrize(("version", "name"), [("4.10", "a.mf4"), ("3.30", "a.mdf")])
def test_texts_may_be_latin_1(tmp_path: Path, version: str, name: str) -> None:
    t = groups()[0][1]
    texts = np.where((t > 61.0) & (t < 66.0), "LÄNKS".encode("latin-1"), b"av")
    content = [*groups(), ("Switch", t, {"Blink": (texts, "")})]
    log = write_log(tmp_path / name, content, version, Blink={"encoding": "latin-1"})
    extraction = extract(log, MAP + '[left_signal]\nchannel = "Blink"\nvalues = {"LÄNKS" = 1}\n')
    assert_planted(extraction, missing=(4,))


def test_long_texts_are_cut_in_messages(tmp_path: Path) -> None:
    t = groups()[0][1]
    content = [*groups(), ("Notes", t, {"Note": (np.full(t.size, b"x" * 5000), "")})]
    log = write_log(tmp_path / "a.mf4", content, Note={"encoding": "utf-8"})
    assert len(problem(log, MAP + '[left_signal]\nchannel = "Note"\n')) < 300


def test_two_flags_are_a_turn_signal_and_are_held(tmp_path: Path) -> None:
    """Recorded when they change only, as a logger of events does."""
    content = groups()
    content.append(("Left", np.array([0.0, 61.0, 66.0]), {"FlashLeft": (np.array([0, 1, 0]), "")}))
    content.append(("Right", np.array([0.0, 14.0, 66.0]), {"FlashRight": (np.array([0, 1, 0]), "")}))
    channels = MAP + '[left_signal]\nchannel = "FlashLeft"\n[right_signal]\nchannel = "FlashRight"\n'
    extraction = extract(write_log(tmp_path / "a.mf4", content), channels)
    # to the right from 14 to 66 s, but for both at once from 61 s on, which is none
    assert_planted(extraction, missing=(1, 3))
    assert extraction.refused.intended == 2


def test_lane_labels(tmp_path: Path) -> None:
    content = groups()
    _, t, camera = content[0]
    camera["LaneId"] = (np.where(t < 15.5, 2, 3), "")
    extraction = extract(write_log(tmp_path / "a.mf4", content), MAP + '[lane]\nchannel = "LaneId"\n')
    assert_planted(extraction, missing=(1,))
    assert extraction.refused.lane_change == 1


def test_an_array_is_refused(tmp_path: Path) -> None:
    content = groups()
    pairs = np.zeros(content[0][1].size, dtype=[("LaneOffset", np.float64, (2,))])
    content[0][2]["LaneOffset"] = (pairs, "cm")
    text = problem(write_log(tmp_path / "a.mf4", content), MAP)
    assert re.match(r"a\.mf4: lane_offset: channel 'LaneOffset' holds .*; allowed: a number or text at a time$", text)


def test_an_empty_group_beside_another_of_the_same_channel_does_not_count(tmp_path: Path) -> None:
    empty = ("Old", np.array([]), {"LaneOffset": (np.array([]), "m")})
    assert_planted(extract(write_log(tmp_path / "a.mf4", [empty, *groups()])))


def test_a_folder_is_trips_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    for i in range(2):
        (tmp_path / f"day{i}").mkdir()
        write_log(tmp_path / f"day{i}" / "trip.mf4")
    write_log(tmp_path / "other.mdf", version="3.30").rename(tmp_path / "other.dat")
    (tmp_path / "notes.dat").write_text("no log")
    (tmp_path / "cut.dat").write_bytes(b"UnFinMF ")
    (tmp_path / "bad.mf4").write_bytes((tmp_path / "day0/trip.mf4").read_bytes()[:5000])
    (tmp_path / "text.mf4").write_text("t,y\n0,1\n")
    (tmp_path / "none.mf4").write_bytes(b"")
    (tmp_path / "map.toml").write_text(MAP)
    done = cli.ldc(
        "extract", tmp_path, "--channels", "map.toml", "-o", "d.parquet", "--vehicle-width", VEHICLE, "--workers", 1,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 3
    assert "format: mdf (7 MDF logs)\n" in done.stdout
    assert "18 candidates in 3 recordings" in done.stdout
    assert "18 departures written to d.parquet" in done.stdout
    for name in ("bad.mf4", "text.mf4", "none.mf4", "cut.dat"):
        assert re.search(rf"warning: {name}: cannot be read as MDF; it is damaged, or none \(", done.stderr), name
    assert "Traceback" not in done.stderr


def test_the_listed_map_is_one(log: Path) -> None:
    out = cli.good("extract", log, "--list-channels", cwd=log.parent)
    assert out.startswith("# a.mf4: MDF 4.10, 8 channels\n# channel ")
    assert re.search(r"^# RoadCurvature +1 Bus +1/km +50 +4805$", out, flags=re.M)
    guess = tomllib.loads(out)
    assert guess["lane_offset"] == {"channel": "LaneOffset", "group": "Camera", "unit": "cm"}
    assert guess["speed"] == {"channel": "VehicleSpeed", "group": "Bus", "unit": "km/h"}
    assert guess["curvature"] == {"channel": "RoadCurvature", "group": "Bus", "unit": "1/km"}
    assert guess["yaw_rate"] == {"channel": "YawRate", "group": "Bus", "unit": "deg/s"}
    assert guess["valid"] == [{"channel": "LaneQuality", "group": "Camera"}]
    assert guess["turn_signal"] == {"channel": "TurnSignal", "group": "Bus"}
    assert all(f"\n# {name}: no channel looks like it\n" in out for name in ("left_line", "right_line", "lane"))
    edited = out.replace('"LaneOffset"', '"LaneOffset"\nscale = -1').replace(
        '"RoadCurvature"', '"RoadCurvature"\nscale=-1'
    )
    assert_planted(extract(log, edited))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["a.mf4", "-o", "d.parquet"], "a.mf4: needs a channel map; allowed: --channels MAP.toml (--list-channels "),
        (["a.mf4", "--channels", "none.toml", "-o", "d.parquet"], "none.toml: cannot be read: No such file or directo"),
        (["a.mf4"], "-o: is missing; allowed: -o FILE.parquet"),
        (["a.csv", "--channels", "m.toml", "-o", "d.parquet"], "channels: '/"),
        (["a.csv", "--list-channels"], "a.csv: cannot be read as MDF; it is damaged, or none ("),
    ],
)  # fmt: skip
def test_the_command_says_what_is_missing(log: Path, tmp_path: Path, arguments: list[str], message: str) -> None:
    (tmp_path / "a.mf4").write_bytes(log.read_bytes())
    (tmp_path / "a.csv").write_text("recording,t,lane_offset,lane_width,speed\na,0,0,3.5,20\n")
    assert message in cli.bad("extract", *arguments, cwd=tmp_path)


def test_without_the_extra_one_sentence_names_it(log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    sentence = 'MDF logs need the package asammdf; install the extra: pip install "ldctoolkit[mdf]"'
    (tmp_path / "a.mf4").write_bytes(log.read_bytes())
    for arguments in (["--list-channels"], ["--channels", "m.toml", "-o", "d.parquet"]):
        assert cli.bad("extract", "a.mf4", *arguments, cwd=tmp_path) == f"ldc: error: {sentence}\n"


@pytest.mark.parametrize("block", [b"##CN", b"##DG"])
def test_blocks_in_a_circle_end(log: Path, tmp_path: Path, block: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    """The library alone would follow them for ever; the next log is read as if nothing had been."""
    monkeypatch.setattr(mdf_logs, "PATIENCE", 1.0)
    content = bytearray(log.read_bytes())
    position = content.index(block)
    content[position + 24 : position + 32] = position.to_bytes(8, "little")  # the link to the next block, to itself
    circle = tmp_path / "a.mf4"
    circle.write_bytes(content)
    assert problem(circle, MAP) == "a.mf4: reading it as MDF takes longer than 1 s; the file is damaged"
    monkeypatch.undo()
    assert_planted(extract(log))


def test_a_log_that_takes_too_long_is_tried_once(log: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the process is gone before the timer is: the reading process never answers, the timer ends last."""

    @functools.cache
    def waits(owner: int) -> subprocess.Popen[bytes]:
        code = "import sys; sys.stdin.buffer.read()"  # until it is killed
        return subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    kill, kills, over = subprocess.Popen.kill, [], threading.Event()

    def slow(process: subprocess.Popen[bytes]) -> None:
        kill(process)
        kills.append(process)
        if isinstance(threading.current_thread(), threading.Timer):
            over.wait()

    monkeypatch.setattr(mdf_logs, "PATIENCE", -log.stat().st_size / 1e6)
    monkeypatch.setattr(mdf_logs, "_process", waits)
    monkeypatch.setattr(subprocess.Popen, "kill", slow)
    try:
        assert problem(log, MAP) == "a.mf4: reading it as MDF takes longer than 0 s; the file is damaged"
    finally:
        over.set()
    assert len(set(kills)) == 1


def test_a_log_that_is_gone_is_a_problem_of_its_own(log: Path, tmp_path: Path) -> None:
    path, channels = tmp_path / "a.mf4", tmp_path / "map.toml"
    path.write_bytes(log.read_bytes())
    channels.write_text(MAP)
    opened = open_recordings(path, channels=channels)
    path.unlink()
    (text,) = extract_departures(opened, vehicle_width=VEHICLE).provenance.problems
    assert re.match(r"a\.mf4: cannot be read as MDF; it is damaged, or none \(.*a\.mf4", text)


def test_a_log_that_ends_the_process_is_named_and_does_no_harm_to_the_next(
    log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the library's C code does in some damaged files: whichever log is read when it happens is tried once more."""
    assert_planted(extract(log))
    process = mdf_logs._process(os.getpid())
    process.kill()
    process.wait()
    assert_planted(extract(log))

    @functools.cache
    def dies(owner: int) -> subprocess.Popen[bytes]:
        return subprocess.Popen(["false"], stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    monkeypatch.setattr(mdf_logs, "_process", dies)
    assert problem(log, MAP) == "a.mf4: reading it as MDF ends the process; the file is damaged"


def damaged(sound: bytes, rng: random.Random) -> bytes:
    """Cut short, or with some bytes changed, half of them where the blocks are that describe the data."""
    content = bytearray(sound)
    if rng.random() < 0.2:
        return bytes(content[: rng.randrange(len(content))])
    blocks = [damaged_bytes.start() for damaged_bytes in re.finditer(rb"##[A-Z]{2}", sound)]
    for _ in range(rng.choice((1, 1, 2, 5, 20, 100))):
        position = rng.randrange(len(content))
        if rng.random() < 0.5:
            position = min(rng.choice(blocks or [0]) + rng.randrange(400), len(content) - 1)
        how = rng.randrange(5)
        if how == 0:
            content[position] ^= 1 << rng.randrange(8)
        elif how == 1:
            content[position] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
        elif how == 2:
            content[position] = rng.randrange(256)
        elif how == 3:
            content[position : position + 8] = bytes(rng.choice((0, 0xFF)) for _ in range(8))
        elif rng.random() < 0.05:  # a link to another block, or a number that is too large
            position -= position % 8
            content[position : position + 8] = rng.choice(blocks or [64]).to_bytes(8, "little")
    return bytes(content)


LONG = [pytest.param(seed, 2000, marks=pytest.mark.slow) for seed in (1, 2)]  # 4,000 in all, for two workers


@pytest.mark.parametrize(("seed", "count"), [(0, 300), *LONG])
def test_a_damaged_log_gives_departures_or_a_known_error(
    tmp_path: Path, seed: int, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mdf_logs, "PATIENCE", 1.0)  # a sound one takes some milliseconds
    sound = {
        version: write_log(tmp_path / f"a{version}{suffix}", groups(12.0), version, compression).read_bytes()
        for version, suffix, compression in (("4.10", ".mf4", 0), ("3.30", ".mdf", 0), ("4.20", ".mf4", 2))
    }
    channels = tmp_path / "map.toml"
    channels.write_text(MAP)
    rng = random.Random(seed)
    outcomes: Counter[str] = Counter()
    folder = tmp_path / "in"
    folder.mkdir()
    for i in range(count):
        content = damaged(sound[rng.choice(list(sound))], rng)
        path = folder / f"x{i}.mf4"
        path.write_bytes(content)
        outcomes[check([path], "auto", channels=channels)] += 1
        assert path.read_bytes() == content  # a log that was not finalised is finalised elsewhere
        path.unlink()
    assert outcomes["departures"] > count / 20
    assert outcomes["problems"] > count / 5
    assert outcomes["refused without a word"] == 0


def test_a_map_is_part_of_what_was_read(log: Path) -> None:
    first_map = extract(log)
    other_map = extract(log, MAP + "\n# another\n")
    sources = [extraction.provenance.sources for extraction in (first_map, other_map)]
    assert sources[0][0] == sources[1][0]
    assert sources[0][1].sha256 != sources[1][1].sha256
    assert dataclasses.replace(first_map.provenance, sources=()) == dataclasses.replace(
        other_map.provenance, sources=()
    )


def test_the_pages_map_and_python_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (text,) = cli.blocks("docs/how-to/mdf-logs.md", "toml")
    Path("page.toml").write_text(text)
    assert mdf_logs.read_channel_map(Path("page.toml")).speed.channel == "VehicleSpeed"
    page = (cli.ROOT / "docs/how-to/mdf-logs.md").read_text(encoding="utf-8")
    for name, units in mdf_logs.UNITS.items():
        assert name == "time" or all(unit in page for unit in units), name
    assert all(f"`{name}`" in page for name in (*mdf_logs.ChannelMap.model_fields, *mdf_logs.ValidChannel.model_fields))
    cli.run_python("docs/how-to/mdf-logs.md", {"__name__": "page"})
    assert capsys.readouterr().out == "8 departures in 1.0 minutes\n"


@pytest.mark.parametrize(
    ("quantity", "channel", "unit"),
    [
        ("left_line", "Lane_Dist_Left", "m"), ("right_line", "DistToLineRight", "cm"),
        ("lane_offset", "LatDevCenter", "m"), ("lane_offset", "LatOffsetHeading", "m"), ("speed", "VehSpd", "km/h"),
        ("speed", "GPS_Speed", "m/s"), ("yaw_rate", "ESP_YawRate", "deg/s"), ("yaw_rate", "YawRate", "deg/s"),
        ("curvature", "LaneCurv", "1/m"), ("curvature", "LaneCurvature", "1/m"), ("valid", "LaneQuality", ""),
        ("left_signal", "BlinkerLeft", ""), ("right_signal", "TurnIndicator_Right", ""),
        ("turn_signal", "TurnIndicator", ""), ("lane", "LaneIndex", ""),
        ("steering", "SteeringWheelAngle", "deg"), ("steering", "StWhlAng", "rad"), ("steering", "ESP_SteerAngle", "°"),
        ("steering", "SWA", "deg"), ("heading", "GPS_Heading", "deg"), ("heading", "CourseOverGround", "rad"),
        ("engaged", "LKA_Active", ""), ("engaged", "LDP_Engaged", ""), ("engaged", "LatCtrlAct", ""),
        ("engaged", "LaneKeepAssistActive", ""), ("engaged", "LKS_State_Engaged", ""),
        (None, "SteeringWheelSpeed", "deg/s"), (None, "SteeringTorque", "Nm"), (None, "SteeringAngleValid", ""),
        (None, "HeadingRate", ""), (None, "PlatformActive", ""), (None, "LatAccActual", "m/s^2"),
        (None, "SwapCount", "1"),
    ],
)  # fmt: skip
def test_guesses_by_names_and_units(tmp_path: Path, quantity: str | None, channel: str, unit: str) -> None:
    t = np.arange(3.0)
    remaining = {"WheelSpeedFL": (t, "km/h"), "EngineSpeed": (t, "1/min"), "LeftTemperature": (t, "degC")}
    log = write_log(tmp_path / "a.mf4", [("All", t, remaining | {channel: (t, unit)})])
    guess = {"channel": channel, "group": "All", **({"unit": unit} if unit else {})}
    expected = {} if quantity is None else {quantity: [guess] if quantity == "valid" else guess}
    assert tomllib.loads(mdf_logs.list_channels(log)) == expected
