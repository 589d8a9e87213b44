"""MDF logs at the border of what can be read: clocks that start again, lost samples, names that stand twice, codes."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import cli
from helpers.mdf import MAP, Group, groups, write_log
from ldctoolkit.errors import InputError
from ldctoolkit.recordings import Extraction, Problem, Recording, extract_departures, mdf_logs, open_recordings

BASIC = """
lane_offset = {channel = "LaneOffset"}
lane_width = {channel = "LaneWidth"}
speed = {channel = "VehicleSpeed"}
"""


def opened(log: Path, channels: str) -> Any:
    path = log.parent / "map.toml"
    path.write_text(channels, encoding="utf-8")
    return open_recordings(log, channels=path)


def read(log: Path, channels: str = BASIC) -> tuple[list[Recording], list[str]]:
    """Recordings of a log, and what it says about the rest, without the log's name."""
    items = list(opened(log, channels).source.parts[0].read())
    problems = [item for item in items if isinstance(item, Problem)]
    assert all(problem.file.startswith(log.name) for problem in problems)
    return [item for item in items if isinstance(item, Recording)], [problem.what for problem in problems]


def extract(log: Path, channels: str, **options: Any) -> Extraction:
    return extract_departures(opened(log, channels), vehicle_width=1.8, **options)


def log_at(path: Path, content: list[Group], version: str = "4.10", **signals: Any) -> Path:
    """A log of any version by any name: the library insists on one."""
    accepted = path.with_name("own.mf4" if version.startswith("4") else "own.mdf")
    return write_log(accepted, content, version, **signals).rename(path)


def camera(t: np.ndarray, offset: Any = 0.1, **columns: tuple[Any, str]) -> Group:
    width, offset = np.full(t.size, 3.6), np.broadcast_to(offset, t.shape)
    return ("Camera", t, {"LaneOffset": (offset, "m"), "LaneWidth": (width, "m"), **columns})


def bus(t: np.ndarray, speed: Any = 90.0, **columns: tuple[Any, str]) -> Group:
    return ("Bus", t, {"VehicleSpeed": (np.broadcast_to(speed, t.shape), "km/h"), **columns})


def clock(rate: float, lengths: list[float], start: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Times of drives whose clock starts again, and the number of the drive."""
    drives = [start + np.arange(round(length * rate)) / rate for length in lengths]
    return np.concatenate(drives), np.repeat(np.arange(len(drives)), [t.size for t in drives])


@pytest.mark.parametrize(
    ("version", "lengths", "rates", "start", "samples"),
    [
        ("4.10", [15.0, 19.0], (10, 10), 0.0, [150, 190]),
        ("3.30", [15.0, 19.0], (10, 10), 0.0, [150, 190]),
        ("2.14", [15.0, 19.0], (10, 10), 0.0, [150, 190]),
        ("4.20", [19.0, 15.0], (10, 10), 0.0, [190, 150]),
        ("4.10", [8.0, 8.0], (25, 100), 0.0, [200, 200]),
        ("4.10", [8.0, 8.0], (50, 5), 0.0, [400, 400]),
        ("4.10", [20.0, 2.0], (10, 10), 0.0, [200, 20]),
        ("4.10", [2.0, 20.0], (10, 10), 0.0, [20, 200]),
        ("4.10", [5.0, 6.0, 7.0], (10, 20), 0.0, [50, 60, 70]),
        ("3.30", [5.0, 5.0, 5.0, 5.0, 5.0], (20, 10), 0.0, [100] * 5),
        ("4.10", [6.0, 6.0], (10, 10), 86400.0, [60, 60]),
        ("4.10", [6.0, 6.0], (10, 10), -3.0, [60, 60]),
    ],
)
def test_a_clock_that_starts_again_begins_another_recording(
    tmp_path: Path, version: str, lengths: list[float], rates: tuple[int, int], start: float, samples: list[int]
) -> None:
    """The drives have 0.1 m and 36 km/h, 0.2 m and 72 km/h, ...: nothing of one comes into another."""
    t, drive = clock(rates[0], lengths, start)
    t_bus, drive_bus = clock(rates[1], lengths, start - 0.003)
    name = "a.mf4" if version.startswith("4") else "a.dat"
    content = [camera(t, 0.1 * (drive + 1)), bus(t_bus, 36.0 * (drive_bus + 1))]
    recordings, problems = read(log_at(tmp_path / name, content, version))
    assert problems == [f"the clock starts again; the log is read as {len(lengths)} recordings"]
    assert [r.name for r in recordings] == [name, *(f"{name} ({k})" for k in range(2, len(lengths) + 1))]
    assert [r.samples for r in recordings] == samples
    for k, recording in enumerate(recordings):
        assert (recording.cut, recording.continues, recording.t[0]) == (None, False, pytest.approx(start))
        np.testing.assert_allclose(recording.lane_offset, 0.1 * (k + 1))
        finite = np.isfinite(recording.speed)
        assert np.count_nonzero(~finite) <= 0.2 * rates[0]  # at the end, after the bus's last sample
        np.testing.assert_allclose(recording.speed[finite], 10.0 * (k + 1))


def test_all_in_one_group_and_two_lines_start_again_as_well(tmp_path: Path) -> None:
    t, drive = clock(10, [5.0, 5.0])
    channels = camera(t, 0.1 * (drive + 1))[2] | bus(t, 36.0 * (drive + 1))[2]
    recordings, _ = read(log_at(tmp_path / "a.mf4", [("All", t, channels)]))
    assert [r.lane_offset[0] for r in recordings] == pytest.approx([0.1, 0.2])
    assert [r.speed[-1] for r in recordings] == pytest.approx([10.0, 20.0])

    content = [
        ("Left", t, {"LineLeft": (1.8 - 0.1 * drive, "m")}),
        ("Right", t + 0.004, {"LineRight": (-1.8 - 0.1 * drive, "m")}),
        bus(t),
    ]
    lines = 'left_line = {channel="LineLeft"}\nright_line = {channel="LineRight"}\nspeed = {channel="VehicleSpeed"}'
    recordings, _ = read(log_at(tmp_path / "b.mf4", content), lines)
    assert [r.lane_offset[20] for r in recordings] == pytest.approx([0.0, 0.1])


@pytest.mark.parametrize(("version", "name"), [("4.10", "a.mf4"), ("3.30", "a.mdf")])
def test_departures_of_both_drives_come_back(tmp_path: Path, version: str, name: str) -> None:
    """The second drive is the first one mirrored."""
    content: list[Group] = []
    for group, t, channels in groups()[:2]:
        both = {n: (np.concatenate([v, -v if n == "LaneOffset" else v]), unit) for n, (v, unit) in channels.items()}
        content.append((group, np.concatenate([t, t]), both))
    extraction = extract(log_at(tmp_path / name, content, version), MAP)
    assert extraction.departures.side.tolist() == [1, -1, 1, -1, 1, -1, -1, 1, -1, 1, -1, 1]
    starts = [8.013, 14.7, 30.22, 38.91, 62.5, 80.04]
    np.testing.assert_allclose(extraction.departures.start_time, starts + starts, atol=0.04)


@pytest.mark.parametrize(("lost", "expected"), [(0, ("a.mf4 (2)", 60)), (1, ("a.mf4", 50))])
def test_one_drive_without_speed_does_not_cost_the_other(tmp_path: Path, lost: int, expected: tuple[str, int]) -> None:
    t, drive = clock(10, [5.0, 6.0])
    log = log_at(tmp_path / "a.mf4", [camera(t), bus(t, np.where(drive == lost, np.nan, 72.0))])
    recordings, (_, problem) = read(log)
    assert [(r.name, r.samples) for r in recordings] == [expected]
    assert problem.startswith("speed: channel 'VehicleSpeed' has no number at the times of 'LaneOffset'")


ONCE, TWICE, THRICE = [20.0], [10.0, 10.0], [7.0, 7.0, 6.0]
SWITCH = BASIC + 'turn_signal = {channel = "Blink"}\n'


@pytest.mark.parametrize(
    ("of_camera", "of_bus", "of_switch", "what"),
    [
        (TWICE, ONCE, None, "speed 1 2"), (ONCE, TWICE, None, "speed 2 1"), (THRICE, ONCE, None, "speed 1 3"),
        (ONCE, ONCE, [5.0, 5.0], "turn_signal 2 1"), (TWICE, TWICE, [20.0], "turn_signal 1 2"),
        # a state that is written when it changes, once in each drive or never again
        (TWICE, TWICE, [1.0], "turn_signal 1 2"), (TWICE, TWICE, [1.0, 2.0, 1.0], "turn_signal 3 2"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_clocks_that_do_not_start_equally_often_are_refused(
    tmp_path: Path, version: str, of_camera: list[float], of_bus: list[float], of_switch: list[float] | None, what: str
) -> None:
    content = [camera(clock(10, of_camera)[0]), bus(clock(20, of_bus)[0])]
    if of_switch:
        t = clock(2, of_switch)[0]
        content.append(("Switch", t, {"Blink": (np.zeros(t.size, np.uint8), "")}))
    log = log_at(tmp_path / "a.mf4", content, version).rename(tmp_path / "b.mf4")
    recordings, (text,) = read(log, SWITCH if of_switch else BASIC)
    assert recordings == []
    column, starts, needed = what.split()
    assert text.startswith(f"{column}: channel ")
    assert re.findall(r" is (\d)", text) == [starts, needed]


def test_states_of_each_drive_stay_in_it(tmp_path: Path) -> None:
    """Written when they change: on from 2 s on in the first drive, off and then on from 4 s on in the second."""
    t, _ = clock(10, [6.0, 6.0])
    switch = ("Switch", np.array([0.0, 2.0, 0.0, 4.0]), {"Blink": (np.array([0, 1, 0, 1]), "")})
    recordings, _ = read(log_at(tmp_path / "a.mf4", [camera(t), bus(t), switch]), SWITCH)
    assert [np.count_nonzero(r.turn_signal == 1) for r in recordings] == [40, 20]


def test_times_in_no_order_are_refused(tmp_path: Path) -> None:
    t = np.arange(400) / 10
    t[1::10], t[2::10] = t[2::10].copy(), t[1::10].copy()
    recordings, (text,) = read(log_at(tmp_path / "a.mf4", [camera(np.arange(400) / 10), bus(t[::-1].copy())]))
    assert recordings == []
    assert text.startswith("speed: channel 'VehicleSpeed' cannot be placed in time: the times fall in ")


LOST = "{} samples have no time, or one that runs backwards; left out"


@pytest.mark.parametrize("version", ["4.10", "3.30"])
@pytest.mark.parametrize("wrong", [0.5, -1e5, 1e6, np.nan, np.inf, 1e300])
def test_nothing_is_joined_across_a_lost_sample_of_the_camera(tmp_path: Path, wrong: float, version: str) -> None:
    t = np.arange(250) / 25
    t[100] = wrong
    log = log_at(tmp_path / "a.mf4", [camera(t), bus(np.arange(600) / 50)], version)
    (recording,), problems = read(log)
    assert problems == [LOST.format(1)]
    assert recording.cut is not None
    assert (recording.samples, np.flatnonzero(recording.cut).tolist(), recording.valid.all()) == (249, [100], True)


@pytest.mark.parametrize(
    ("rows", "wrong", "cuts", "inside"),
    [
        ([200], 0.5, [100, 101], [100]),  # at 4.0 s, that of a sample of the camera, between 3.98 and 4.02 s
        ([200], np.nan, [100, 101], [100]),
        ([200], 1e300, [100, 101], [100]),
        ([201], 0.5, [101], []),  # between 4.0 and 4.04 s: both are known
        ([200, 201, 202, 203], 0.5, [100, 102], [100, 101]),
        ([200, 202], 0.5, [100, 101, 102], [100, 101]),
        ([200, 400], np.nan, [100, 101, 200, 201], [100, 200]),
        ([1], np.nan, [1], []),
        ([0], np.nan, [], []),  # nothing lies before it, or after
        ([599], np.nan, [], []),
    ],
)
def test_nothing_is_interpolated_across_a_lost_sample_of_the_bus(
    tmp_path: Path, rows: list[int], wrong: float, cuts: list[int], inside: list[int]
) -> None:
    t = np.arange(600) / 50
    t[rows] = wrong
    log = log_at(tmp_path / "a.mf4", [camera(np.arange(250) / 25), bus(t)])
    (recording,), problems = read(log)
    assert problems == [LOST.format(len(rows))]
    assert (recording.samples, [] if recording.cut is None else np.flatnonzero(recording.cut).tolist()) == (250, cuts)
    assert np.flatnonzero(~recording.valid).tolist() == inside


def test_a_lost_sample_in_each_drive(tmp_path: Path) -> None:
    t, _ = clock(25, [10.0, 10.0])
    t[[100, 350]] = np.nan
    recordings, problems = read(log_at(tmp_path / "a.mf4", [camera(t), bus(clock(50, [12.0, 12.0])[0])]))
    assert [r.samples for r in recordings] == [249, 249]
    assert [np.flatnonzero(r.cut).tolist() for r in recordings] == [[100], [100]]  # type: ignore[arg-type]
    assert problems == [LOST.format(2), "the clock starts again; the log is read as 2 recordings"]


NONE = np.empty(0)
T = np.arange(100) / 10


@pytest.mark.parametrize("version", ["4.10", "3.30"])
@pytest.mark.parametrize("group", ["camera", "bus", "switch"])
@pytest.mark.parametrize(
    ("t", "what"),
    [
        (NONE, "has no samples"), (0.0 * T + 17.0, "are equal"), (T[:1], "has only one sample"),
        (T + np.nan, "has no samples with a time"), (np.where(T == 5.0, T, np.nan), "has only one sample with a time"),
    ],
)  # fmt: skip
def test_a_group_without_a_clock_is_named(tmp_path: Path, version: str, group: str, t: np.ndarray, what: str) -> None:
    """A state that never changed may have been written once."""
    times = {"camera": T, "bus": T, "switch": T} | {group: t}
    switch = ("Switch", times["switch"], {"Blink": (np.ones(times["switch"].size, np.uint8), "")})
    log = log_at(tmp_path / "a.mf4", [camera(times["camera"]), bus(times["bus"]), switch], version)
    recordings, problems = read(log, SWITCH)
    if group == "switch" and "one sample" in what:
        assert recordings[0].turn_signal[-1] == 1
    else:
        column = {"camera": "lane_offset", "bus": "speed", "switch": "turn_signal"}[group]
        assert recordings == []
        assert re.fullmatch(f"{column}: channel '.*' cannot be placed in time: .*{what}", problems[-1])


TWINS = [
    camera(T),
    bus(T, 90.0, **{"VehicleSpeed#2": (np.full(100, 20.0), "m/s"), "VehicleSpeed#3": (np.full(100, 36.0), "km/h")}),
]


@pytest.mark.parametrize("version", ["4.10", "3.30"])
@pytest.mark.parametrize("group", ["", ", group = 1", ', group = "Bus"'])
@pytest.mark.parametrize(("occurrence", "speed"), [(1, 25.0), (2, 20.0), (3, 10.0), (None, None), (4, None)])
def test_channels_that_share_a_name_in_one_group(
    tmp_path: Path, version: str, group: str, occurrence: int | None, speed: float | None
) -> None:
    log = log_at(tmp_path / "a.mf4", TWINS, version)
    number = f", occurrence = {occurrence}" if occurrence else ""
    recordings, problems = read(log, BASIC.replace('"VehicleSpeed"', f'"VehicleSpeed"{group}{number}'))
    if speed is not None:
        assert problems == []
        np.testing.assert_allclose(recordings[0].speed, speed)
    else:
        assert recordings == []
        assert problems[0].startswith("speed: channel 'VehicleSpeed' names 3 of the channels of group 1; ")
        assert f"{occurrence or 'not given'}; allowed: 1 to 3" in problems[0]


def test_an_occurrence_counts_in_one_group(tmp_path: Path) -> None:
    """Not across groups; an only channel is the first."""
    log = log_at(tmp_path / "a.mf4", [*TWINS, ("Other", T, {"VehicleSpeed": (np.full(100, 5.0), "m/s")})])

    def reported(selection: str) -> tuple[list[Recording], list[str]]:
        return read(log, BASIC.replace('"VehicleSpeed"', f'"VehicleSpeed"{selection}'))

    for selection, text in ((", occurrence = 1", "not given"), (', group = "Radar", occurrence = 1', "'Radar'")):
        _, (problem,) = reported(selection)
        assert f"is in the groups 1 (Bus), 1 (Bus), 1 (Bus), 2 (Other); `group`: {text}; " in problem
    (recording,), _ = reported(', group = "Other", occurrence = 1')
    np.testing.assert_allclose(recording.speed, 5.0)
    _, (problem,) = reported(', group = "Other", occurrence = 2')
    assert "names 1 of the channels of group 2; `occurrence`: 2; " in problem


@pytest.mark.parametrize(
    ("units", "occurrence", "speed"),
    [
        (("km/h", "m/s"), 1, 25.0), (("rpm", "km/h"), 2, 25.0), (("rpm", "%", "m/s"), 3, 90.0), (("km/h",), None, 25.0),
        (("km/h", "km/h"), 1, 25.0), (("", "km/h"), 1, None),
    ],
)  # fmt: skip
def test_the_listed_map_tells_channels_apart(
    tmp_path: Path, units: tuple[str, ...], occurrence: int | None, speed: float | None
) -> None:
    """By the first of a name whose unit fits; one without a unit needs the user."""
    channels = {f"VehicleSpeed#{i}": (np.full(100, 90.0), unit) for i, unit in enumerate(units)}
    log = log_at(tmp_path / "a.mf4", [camera(T), ("Bus", T, channels)])
    out = cli.good("extract", log, "--list-channels", cwd=tmp_path)
    assert tomllib.loads(out)["speed"].get("occurrence") == occurrence
    if speed is not None:
        (recording,), _ = read(log, out)
        np.testing.assert_allclose(recording.speed, speed)


@pytest.mark.parametrize(
    ("names", "home"),
    [(("Bus", "Bus"), 1), (("", ""), 1), (("Bus", ""), "Bus"), (("", "Bus"), 1), (("Bus", "B"), "Bus")],
)
def test_the_listed_map_tells_groups_apart(tmp_path: Path, names: tuple[str, str], home: str | int) -> None:
    """By the number where the name does not; the group that is sampled more often is taken."""
    first, second = (name for name in names)
    content = [camera(T), (first, T, bus(T)[2]), (second, T[::2], bus(T[::2], 72.0)[2])]
    log = log_at(tmp_path / "a.mf4", content)
    out = mdf_logs.list_channels(log)
    assert tomllib.loads(out)["speed"] == {"channel": "VehicleSpeed", "group": home, "unit": "km/h"}
    (recording,), _ = read(log, out)
    np.testing.assert_allclose(recording.speed, 25.0)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_a_map_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str, ends: str) -> None:
    path = tmp_path / "map.toml"
    text = BASIC.replace("VehicleSpeed", "Größe°").replace("\n", ends)
    path.write_bytes(text.encode(encoding))
    assert mdf_logs.read_channel_map(path).speed.channel == "Größe°"
    for refused in ("utf-16", "utf-16-le", "utf-16-be", "latin-1"):
        path.write_bytes(text.encode(refused))
        with pytest.raises(InputError, match=r"map\.toml: not a TOML file: the text is (UTF-16|not UTF-8)"):
            mdf_logs.read_channel_map(path)


@pytest.mark.parametrize(
    ("before", "after", "between"),
    [
        (359.0, 1.0, 360.0), (1.0, 359.0, 0.0), (179.0, -179.0, 180.0), (-179.0, 179.0, -180.0), (10.0, 20.0, 15.0),
        (350.0, 20.0, 365.0), (719.0, 1.0, 720.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("gap", [None, np.nan])
def test_headings_are_interpolated_across_the_wrap(
    tmp_path: Path, before: float, after: float, between: float, gap: float | None
) -> None:
    """Also where one is missing; the same of a steering wheel is a jump, at which the nearer sample is taken."""
    t = np.arange(10) / 10
    angle = np.array([before] * 5 + [after] * 5)
    if gap is not None:
        angle[7] = gap
    log = log_at(tmp_path / "a.mf4", [camera(t + 0.05), bus(t, Angle=(angle, "deg"))])
    (recording,), _ = read(log, BASIC + 'heading = {channel = "Angle"}\nsteering = {channel = "Angle"}\n')
    assert recording.heading is not None
    assert recording.steering is not None
    turned = (np.degrees(recording.heading[4]) - between) % 360.0
    assert min(turned, 360.0 - turned) == pytest.approx(0.0, abs=1e-9)
    far = abs(after - before) > 60.0
    assert np.degrees(recording.steering[4]) == pytest.approx(before if far else 0.5 * (before + after))
    assert np.flatnonzero(np.isnan(recording.heading)).tolist() == ([9] if gap is None else [6, 7, 9])
    np.testing.assert_allclose(np.cos(recording.heading[[5, 8]]), np.cos(np.radians(after)))


@pytest.mark.parametrize(
    ("t", "state", "values", "on"),
    [
        ([0.0], [1], "", (0, 100)),
        ([0.0], [0], "", (0, 0)),
        ([3.0], [1], "", (30, 100)),  # before the first sample none steers
        ([0.0, 2.0, 5.0], [0, 1, 0], "", (20, 50)),  # held, however long
        ([0.0, 2.0, 5.0], [0, 3, 0], "", (20, 50)),
        ([0.0, 2.0, 5.0], [-1, 0.5, 0], "", (20, 50)),
        ([0.0, 2.0, 5.0], [0, 2, 1], "values = {2 = 1}", (20, 50)),  # what is not listed is missing
        ([0.0, 2.0, 5.0], [0, 1, np.nan], "", (20, 50)),
        ([0.0, 2.0, 5.0], [b"off", b"ACTIVE", b"override"], "values = {ACTIVE = 1, off = 0}", (20, 50)),
        ([0.0, 2.0, 5.0], [b"off", b"ACTIVE", b"standby"], "values = {ACTIVE = 1, standby = 0}", (20, 50)),
        ([0.0, 2.0, 2.0, 5.0, 5.0], [0, 0, 1, 1, 0], "", (20, 50)),  # of those at one time the last
    ],
)
def test_engaged_systems(tmp_path: Path, t: list[float], state: list[Any], values: str, on: tuple[int, int]) -> None:
    samples = np.array(state)
    text: dict[str, Any] = {"Lka": {"encoding": "utf-8"}} if samples.dtype.kind == "S" else {}
    log = log_at(tmp_path / "a.mf4", [camera(T), bus(T), ("Lka", np.array(t), {"Lka": (samples, "")})], **text)
    (recording,), problems = read(log, f'{BASIC}[engaged]\nchannel = "Lka"\n{values}\n')
    assert problems == []
    assert recording.engaged is not None
    assert recording.engaged.dtype == bool
    assert np.flatnonzero(recording.engaged).tolist() == list(range(*on))
    assert recording.valid.all()


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_samples_in_bursts_pass_as_they_are(tmp_path: Path, version: str) -> None:
    """Five frames share a time. Of the camera and of the bus in its group each counts, of another group the last."""
    t = np.repeat(np.arange(20) / 4, 5)
    offset = np.arange(100) / 1000
    speed = 36.0 + np.arange(100.0)
    content = [camera(t, offset, Speed2=(speed, "km/h")), bus(t[:-5], speed[:-5])]
    log = log_at(tmp_path / "a.mf4", content, version)
    (recording,), problems = read(log, BASIC.replace("VehicleSpeed", "Speed2"))
    assert problems == []
    np.testing.assert_allclose(recording.lane_offset, offset)
    np.testing.assert_allclose(recording.speed, speed / 3.6)
    (recording,), _ = read(log)
    newest = np.repeat(36.0 + np.arange(4, 100, 5), 5) / 3.6
    np.testing.assert_allclose(recording.speed[:-5], newest[:-5])
    assert np.isnan(recording.speed[-5:]).all()


@pytest.mark.parametrize(
    ("t", "speed", "expected"),
    [
        ([0.0, 0.2, 0.2, 0.4], [10, 10, 20, 20], [10.0, 15.0, 20.0]),  # at 0, 0.1 and 0.3 s
        ([0.0, 0.0, 0.2, 0.4], [20, 10, 20, 20], [10.0, 15.0, 20.0]),
        ([0.0, 0.2, 0.4, 0.4], [10, 10, 10, 20], [10.0, 10.0, 15.0]),
        ([0.0, 0.2, 0.2, 0.2, 0.2, 0.4], [10, 0, 0, 0, 10, 10], [10.0, 10.0, 10.0]),
        ([0.0, 0.2, 0.2, 0.4], [10, 10, np.nan, 10], [10.0, np.nan, np.nan]),
        ([0.0, 0.2, 0.2, 0.4], [10, np.nan, 10, 10], [10.0, 10.0, 10.0]),
    ],
)
def test_repeated_times_of_another_group(
    tmp_path: Path, t: list[float], speed: list[float], expected: list[float]
) -> None:
    sample_times = np.array([0.0, 0.1, 0.3])
    content = [camera(sample_times), ("Bus", np.array(t), {"VehicleSpeed": (np.array(speed, dtype=float), "m/s")})]
    (recording,), _ = read(log_at(tmp_path / "a.mf4", content))
    np.testing.assert_allclose(recording.speed, expected)


@pytest.mark.parametrize(
    ("quantity", "unit", "good", "code", "factor"),
    [
        ("lane_width", "m", 3.6, 655.35, 1.0), ("lane_width", "cm", 360.0, 65535.0, 0.01),
        ("lane_width", "m", 3.6, 0.0, 1.0), ("lane_width", "m", 3.6, 1e300, 1.0),
        ("speed", "km/h", 90.0, 655.35, 1 / 3.6), ("speed", "m/s", 25.0, 163.83, 1.0), ("speed", "m/s", 25.0, 0.0, 1.0),
        ("speed", "km/h", 90.0, 255.0, 1 / 3.6), ("curvature", "1/m", 0.001, 1.0, 1.0),
        ("yaw_rate", "deg/s", 1.0, 163.83, 0.017453292519943), ("heading", "deg", 90.0, 270.0, 0.017453292519943),
        ("steering", "deg", 2.0, -780.0, 0.017453292519943),
    ],
)  # fmt: skip
def test_codes_are_not_interpolated_into_plausible_numbers(
    tmp_path: Path, quantity: str, unit: str, good: float, code: float, factor: float
) -> None:
    """At times between those of the samples there is a good number or the code, nothing else."""
    t = np.arange(40) / 5
    values = np.full(40, good)
    values[20] = code
    sample_times = np.arange(150) / 20 + 0.013
    log = log_at(tmp_path / "a.mf4", [camera(sample_times), bus(t), ("Slow", t, {"Own": (values, unit)})])
    channels = "".join(line + "\n" for line in BASIC.splitlines() if not line.startswith(quantity))
    (recording,), problems = read(log, channels + f'{quantity} = {{channel = "Own"}}\n')
    assert problems == []
    result = getattr(recording, quantity)
    codes = (sample_times > 3.9) & (sample_times < 4.1)
    np.testing.assert_allclose(result[~codes], good * factor)
    if quantity == "heading":  # of which only the direction counts
        np.testing.assert_allclose(np.cos(result[codes]), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.sin(result[codes]), -1.0)
    else:
        np.testing.assert_allclose(result[codes], code * factor)
    assert np.count_nonzero(codes) == 4


@pytest.mark.parametrize(("quantity", "unit", "step"), [
    ("speed", "m/s", 10.0), ("lane_width", "m", 0.5), ("curvature", "1/m", 0.05), ("yaw_rate", "rad/s", 0.5),
    ("steering", "rad", 0.8), ("heading", "rad", 0.8),
])  # fmt: skip
def test_what_a_vehicle_can_do_is_interpolated(tmp_path: Path, quantity: str, unit: str, step: float) -> None:
    t = np.arange(20) / 5
    values = 3.0 + np.where(np.arange(20) >= 10, step, 0.0)
    content = [camera(np.array([1.85, 1.9])), bus(t), ("Slow", t, {"Own": (values, unit)})]
    channels = "".join(line + "\n" for line in BASIC.splitlines() if not line.startswith(quantity))
    (recording,), _ = read(log_at(tmp_path / "a.mf4", content), channels + f'{quantity} = {{channel = "Own"}}\n')
    np.testing.assert_allclose(getattr(recording, quantity), [3.0 + 0.25 * step, 3.0 + 0.5 * step])
