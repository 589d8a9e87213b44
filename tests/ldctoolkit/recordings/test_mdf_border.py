"""MDF logs at the border of what can be read: clocks that start again, lost samples, names that stand twice, codes."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from helpers import cli
from helpers.mdf import MAP, PLANTED, Group, groups, write_log
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
    """Recordings of a log, and what it says about the rest."""
    items = list(opened(log, channels).source.parts[0].read())
    return [x for x in items if isinstance(x, Recording)], [str(x) for x in items if isinstance(x, Problem)]


def extract(log: Path, channels: str, **more: Any) -> Extraction:
    return extract_departures(opened(log, channels), vehicle_width=1.8, **more)


def made(path: Path, content: list[Group], version: str = "4.10", **signals: Any) -> Path:
    """A log of any version by any name: the library insists on one."""
    own = path.with_name("own.mf4" if version.startswith("4") else "own.mdf")
    return write_log(own, content, version, **signals).rename(path)


def camera(t: np.ndarray, offset: Any = 0.1, **more: tuple[Any, str]) -> Group:
    width, offset = np.full(t.size, 3.6), np.broadcast_to(offset, t.shape)
    return ("Camera", t, {"LaneOffset": (offset, "m"), "LaneWidth": (width, "m"), **more})


def bus(t: np.ndarray, speed: Any = 90.0, **more: tuple[Any, str]) -> Group:
    return ("Bus", t, {"VehicleSpeed": (np.broadcast_to(speed, t.shape), "km/h"), **more})


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
    recordings, problems = read(made(tmp_path / name, content, version))
    assert problems == [f"{name}: the clock starts again; the log is read as {len(lengths)} recordings"]
    assert [one.name for one in recordings] == [name, *(f"{name} ({k})" for k in range(2, len(lengths) + 1))]
    assert [one.samples for one in recordings] == samples
    for k, one in enumerate(recordings):
        assert one.cut is None
        assert not one.continues
        assert one.t[0] == pytest.approx(start)
        np.testing.assert_allclose(one.lane_offset, 0.1 * (k + 1))
        known = np.isfinite(one.speed)
        assert np.count_nonzero(~known) <= 0.2 * rates[0]  # at the end, after the bus's last sample
        np.testing.assert_allclose(one.speed[known], 10.0 * (k + 1))


def test_all_in_one_group_and_two_lines_start_again_as_well(tmp_path: Path) -> None:
    t, drive = clock(10, [5.0, 5.0])
    channels = camera(t, 0.1 * (drive + 1))[2] | bus(t, 36.0 * (drive + 1))[2]
    recordings, _ = read(made(tmp_path / "a.mf4", [("All", t, channels)]))
    assert [one.lane_offset[0] for one in recordings] == pytest.approx([0.1, 0.2])
    assert [one.speed[-1] for one in recordings] == pytest.approx([10.0, 20.0])

    content = [
        ("Left", t, {"LineLeft": (1.8 - 0.1 * drive, "m")}),
        ("Right", t + 0.004, {"LineRight": (-1.8 - 0.1 * drive, "m")}),
        bus(t),
    ]
    lines = 'left_line = {channel="LineLeft"}\nright_line = {channel="LineRight"}\nspeed = {channel="VehicleSpeed"}'
    recordings, _ = read(made(tmp_path / "b.mf4", content), lines)
    assert [one.lane_offset[20] for one in recordings] == pytest.approx([0.0, 0.1])


def test_a_drift_beyond_a_line_is_not_joined_with_the_next_drive(tmp_path: Path) -> None:
    """Mixed by their times, the first drive's end and the second one's beginning would make a departure at 13.2 s."""
    first = np.concatenate([np.zeros(112), np.linspace(0.0, 0.88, 21), np.linspace(0.89, 1.04, 17)])
    second = np.concatenate([np.linspace(0.6, 0.89, 150), np.linspace(0.886, 0.85, 10), np.linspace(0.8, 0.0, 30)])
    t, drive = clock(10, [15.0, 19.0])
    content = [camera(t, np.concatenate([first, second])), bus(t + 0.003, 72.0 + 36.0 * drive)]
    found = extract(made(tmp_path / "a.mf4", content), BASIC, force=True)
    assert found.departures.n == 0
    assert found.recordings == 2


@pytest.mark.parametrize(("version", "name"), [("4.10", "a.mf4"), ("3.30", "a.mdf")])
def test_departures_of_both_drives_come_back(tmp_path: Path, version: str, name: str) -> None:
    """The second drive is the first one mirrored."""
    content: list[Group] = []
    for group, t, channels in groups()[:2]:
        both = {one: (np.concatenate([v, -v if one == "LaneOffset" else v]), u) for one, (v, u) in channels.items()}
        content.append((group, np.concatenate([t, t]), both))
    found = extract(made(tmp_path / name, content, version), MAP)
    assert found.departures.side.tolist() == [1, -1, 1, -1, 1, -1, -1, 1, -1, 1, -1, 1]
    starts = [8.013, 14.7, 30.22, 38.91, 62.5, 80.04]
    np.testing.assert_allclose(found.departures.start_time, starts + starts, atol=0.04)


def test_one_drive_without_speed_does_not_cost_the_other(tmp_path: Path) -> None:
    t, drive = clock(10, [5.0, 6.0])
    speed = np.where(drive == 0, np.nan, 72.0)
    recordings, problems = read(made(tmp_path / "a.mf4", [camera(t), bus(t, speed)]))
    assert [(one.name, one.samples) for one in recordings] == [("a.mf4 (2)", 60)]
    assert problems[1:] == [
        "a.mf4: speed: channel 'VehicleSpeed' has no number at the times of 'LaneOffset', or none within max_gap = "
        "0.25 s"
    ]
    recordings, problems = read(made(tmp_path / "a.mf4", [camera(t), bus(t, np.where(drive == 1, np.nan, 72.0))]))
    assert [(one.name, one.samples) for one in recordings] == [("a.mf4", 50)]
    assert problems[1][:41] == "a.mf4 (2): speed: channel 'VehicleSpeed' "


ONCE, TWICE, THRICE = [20.0], [10.0, 10.0], [7.0, 7.0, 6.0]
SWITCH = BASIC + 'turn_signal = {channel = "Blink"}\n'


@pytest.mark.parametrize(
    ("of_camera", "of_bus", "of_switch", "what"),
    [
        (TWICE, ONCE, None, "speed: channel 'VehicleSpeed' {}1, that of 'LaneOffset' is 2"),
        (ONCE, TWICE, None, "speed: channel 'VehicleSpeed' {}2, that of 'LaneOffset' is 1"),
        (THRICE, ONCE, None, "speed: channel 'VehicleSpeed' {}1, that of 'LaneOffset' is 3"),
        (ONCE, ONCE, [5.0, 5.0], "turn_signal: channel 'Blink' {}2, that of 'LaneOffset' is 1"),
        (TWICE, TWICE, [20.0], "turn_signal: channel 'Blink' {}1, that of 'LaneOffset' is 2"),
        # a state that is written when it changes, once in each drive or never again
        (TWICE, TWICE, [1.0], "turn_signal: channel 'Blink' {}1, that of 'LaneOffset' is 2"),
        (TWICE, TWICE, [1.0, 2.0, 1.0], "turn_signal: channel 'Blink' {}3, that of 'LaneOffset' is 2"),
    ],
)
@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_clocks_that_do_not_start_equally_often_are_refused(
    tmp_path: Path, version: str, of_camera: list[float], of_bus: list[float], of_switch: list[float] | None, what: str
) -> None:
    content = [camera(clock(10, of_camera)[0]), bus(clock(20, of_bus)[0])]
    if of_switch:
        t = clock(2, of_switch)[0]
        content.append(("Switch", t, {"Blink": (np.zeros(t.size, np.uint8), "")}))
    log = made(tmp_path / "a.mf4", content, version).rename(tmp_path / "b.mf4")
    recordings, (text,) = read(log, SWITCH if of_switch else BASIC)
    assert recordings == []
    said = "cannot be placed in time: the number of starts of its clock is "
    assert text == f"b.mf4: {what.format(said)}; allowed: the same"


def test_states_of_each_drive_stay_in_it(tmp_path: Path) -> None:
    """Written when they change: on from 2 s on in the first drive, off and then on from 4 s on in the second."""
    t, _ = clock(10, [6.0, 6.0])
    switch = ("Switch", np.array([0.0, 2.0, 0.0, 4.0]), {"Blink": (np.array([0, 1, 0, 1]), "")})
    recordings, _ = read(made(tmp_path / "a.mf4", [camera(t), bus(t), switch]), SWITCH)
    assert [np.count_nonzero(one.turn_signal == 1) for one in recordings] == [40, 20]


def test_times_in_no_order_are_refused(tmp_path: Path) -> None:
    t = np.arange(400) / 10
    t[1::10], t[2::10] = t[2::10].copy(), t[1::10].copy()
    recordings, (text,) = read(made(tmp_path / "a.mf4", [camera(np.arange(400) / 10), bus(t[::-1].copy())]))
    assert recordings == []
    assert re.fullmatch(
        r"a\.mf4: speed: channel 'VehicleSpeed' cannot be placed in time: the times fall in \d+ places; allowed: rows "
        r"in the order of time",
        text,
    )


LOST = "a.mf4, group {}: {} samples have no time, or one that runs backwards; left out"


@pytest.mark.parametrize("version", ["4.10", "3.30"])
@pytest.mark.parametrize("wrong", [0.5, -1e5, 1e6, np.nan, np.inf, 1e300])
def test_nothing_is_joined_across_a_lost_sample_of_the_camera(tmp_path: Path, wrong: float, version: str) -> None:
    t = np.arange(250) / 25
    t[100] = wrong
    log = made(tmp_path / "a.mf4", [camera(t), bus(np.arange(600) / 50)], version)
    (one,), problems = read(log)
    assert problems == [LOST.format(0, 1)]
    assert one.samples == 249
    assert one.cut is not None
    assert np.flatnonzero(one.cut).tolist() == [100]
    assert one.valid.all()


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
    ],
)
def test_nothing_is_interpolated_across_a_lost_sample_of_the_bus(
    tmp_path: Path, rows: list[int], wrong: float, cuts: list[int], inside: list[int]
) -> None:
    t = np.arange(600) / 50
    t[rows] = wrong
    log = made(tmp_path / "a.mf4", [camera(np.arange(250) / 25), bus(t)])
    (one,), problems = read(log)
    assert problems == [LOST.format(1, len(rows))]
    assert one.samples == 250
    assert one.cut is not None
    assert np.flatnonzero(one.cut).tolist() == cuts
    assert np.flatnonzero(~one.valid).tolist() == inside


@pytest.mark.parametrize("row", [0, 599, None])
def test_nothing_is_cut_where_nothing_lies_between(tmp_path: Path, row: int | None) -> None:
    t = np.arange(600) / 50
    if row is not None:
        t[row] = np.nan
    (one,), problems = read(made(tmp_path / "a.mf4", [camera(np.arange(250) / 25), bus(t)]))
    assert one.cut is None
    assert problems == [LOST.format(1, 1)] * (row is not None)


def test_a_lost_sample_in_each_drive(tmp_path: Path) -> None:
    t, _ = clock(25, [10.0, 10.0])
    t[[100, 350]] = np.nan
    recordings, problems = read(made(tmp_path / "a.mf4", [camera(t), bus(clock(50, [12.0, 12.0])[0])]))
    assert [one.samples for one in recordings] == [249, 249]
    assert [np.flatnonzero(one.cut).tolist() for one in recordings] == [[100], [100]]  # type: ignore[arg-type]
    assert problems == [LOST.format(0, 2), "a.mf4: the clock starts again; the log is read as 2 recordings"]


@pytest.mark.parametrize("group", [0, 1])
def test_a_departure_across_a_lost_sample_does_not_count(tmp_path: Path, group: int) -> None:
    """At 40 s, in the fourth departure."""
    content = groups()[:2]
    t = content[group][1]
    t[np.searchsorted(t, 40.0)] = 0.0
    found = extract(made(tmp_path / "a.mf4", content), MAP)
    starts = [one.start for i, one in enumerate(PLANTED) if i != 3]
    np.testing.assert_allclose(found.departures.start_time, starts, atol=0.04)
    assert found.problems != ()


NONE = np.empty(0)
T = np.arange(100) / 10


@pytest.mark.parametrize("version", ["4.10", "3.30"])
@pytest.mark.parametrize(
    ("of_camera", "of_bus", "what"),
    [
        (NONE, T, "lane_offset: channel 'LaneOffset' {}: its group 0 has no samples"),
        (T, NONE, "speed: channel 'VehicleSpeed' {}: its group 1 has no samples"),
        (0.0 * T + 17.0, T, "lane_offset: channel 'LaneOffset' {}: all times of its group 0 are equal"),
        (T, 0.0 * T, "speed: channel 'VehicleSpeed' {}: all times of its group 1 are equal"),
        (T[:1], T, "lane_offset: channel 'LaneOffset' {}: its group 0 has only one sample"),
        (T, T[:1], "speed: channel 'VehicleSpeed' {}: its group 1 has only one sample"),
        (T + np.nan, T, "lane_offset: channel 'LaneOffset' {}: its group 0 has no samples with a time"),
        (T, T + np.inf, "speed: channel 'VehicleSpeed' {}: its group 1 has no samples with a time"),
        (np.where(T == 5.0, T, np.nan), T,
         "lane_offset: channel 'LaneOffset' {}: its group 0 has only one sample with a time"),
    ],
)  # fmt: skip
def test_a_group_without_a_clock_is_named(
    tmp_path: Path, version: str, of_camera: np.ndarray, of_bus: np.ndarray, what: str
) -> None:
    log = made(tmp_path / "a.mf4", [camera(of_camera), bus(of_bus)], version)
    assert read(log) == ([], [f"a.mf4: {what.format('cannot be placed in time')}"])


@pytest.mark.parametrize(
    ("t", "message"),
    [
        (NONE, "its group 2 has no samples"),
        (np.zeros(3), "all times of its group 2 are equal"),
        (np.zeros(1), ""),  # written once, since it never changed
        (np.array([np.nan]), "its group 2 has no samples with a time"),
    ],
)
def test_a_state_may_have_one_sample(tmp_path: Path, t: np.ndarray, message: str) -> None:
    content = [camera(T), bus(T), ("Switch", t, {"Blink": (np.ones(t.size, np.uint8), "")})]
    recordings, problems = read(made(tmp_path / "a.mf4", content), SWITCH)
    if message:
        assert recordings == []
        assert problems == [f"a.mf4: turn_signal: channel 'Blink' cannot be placed in time: {message}"]
    else:
        assert recordings[0].turn_signal is not None
        assert recordings[0].turn_signal.tolist() == [1] * 100


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
    log = made(tmp_path / "a.mf4", TWINS, version)
    number = f", occurrence = {occurrence}" if occurrence else ""
    recordings, problems = read(log, BASIC.replace('"VehicleSpeed"', f'"VehicleSpeed"{group}{number}'))
    if speed is not None:
        assert problems == []
        np.testing.assert_allclose(recordings[0].speed, speed)
    else:
        assert recordings == []
        assert problems == [
            "a.mf4: speed: channel 'VehicleSpeed' names 3 of the channels of group 1; `occurrence`: "
            f"{occurrence or 'not given'}; allowed: 1 to 3, in their order"
        ]


def test_an_occurrence_counts_in_one_group(tmp_path: Path) -> None:
    """Not across groups; an only channel is the first."""
    log = made(tmp_path / "a.mf4", [*TWINS, ("Other", T, {"VehicleSpeed": (np.full(100, 5.0), "m/s")})])
    for given, text in (("", "not given"), (', group = "Radar"', "'Radar'")):
        _, (problem,) = read(log, BASIC.replace('"VehicleSpeed"', f'"VehicleSpeed"{given}, occurrence = 1'))
        assert problem == (
            "a.mf4: speed: channel 'VehicleSpeed' is in the groups 1 (Bus), 1 (Bus), 1 (Bus), 2 (Other); `group`: "
            f"{text}; allowed: the name or number of one"
        )
    (one,), _ = read(log, BASIC.replace('"VehicleSpeed"', '"VehicleSpeed", group = "Other", occurrence = 1'))
    np.testing.assert_allclose(one.speed, 5.0)
    _, (problem,) = read(log, BASIC.replace('"VehicleSpeed"', '"VehicleSpeed", group = "Other", occurrence = 2'))
    assert problem == (
        "a.mf4: speed: channel 'VehicleSpeed' names 1 of the channels of group 2; `occurrence`: 2; allowed: 1 to 1, in "
        "their order"
    )


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
    log = made(tmp_path / "a.mf4", [camera(T), ("Bus", T, channels)])
    out = cli.good("extract", log, "--list-channels", cwd=tmp_path)
    assert tomllib.loads(out)["speed"].get("occurrence") == occurrence
    if speed is not None:
        (one,), _ = read(log, out)
        np.testing.assert_allclose(one.speed, speed)


@pytest.mark.parametrize(
    ("names", "home"),
    [(("Bus", "Bus"), 1), (("", ""), 1), (("Bus", ""), "Bus"), (("", "Bus"), 1), (("Bus", "B"), "Bus")],
)
def test_the_listed_map_tells_groups_apart(tmp_path: Path, names: tuple[str, str], home: str | int) -> None:
    """By the number where the name does not; the group that is sampled more often is taken."""
    first, second = (name for name in names)
    content = [camera(T), (first, T, bus(T)[2]), (second, T[::2], bus(T[::2], 72.0)[2])]
    log = made(tmp_path / "a.mf4", content)
    out = mdf_logs.list_channels(log)
    assert tomllib.loads(out)["speed"] == {"channel": "VehicleSpeed", "group": home, "unit": "km/h"}
    (one,), _ = read(log, out)
    np.testing.assert_allclose(one.speed, 25.0)


@pytest.mark.parametrize(
    ("text", "key", "message"),
    [
        (", occurrence = 0", "speed.occurrence", "0; allowed: greater than or equal to 1"),
        (", occurrence = -1", "speed.occurrence", "-1; allowed: greater than or equal to 1"),
        (", occurrence = 1.0", "speed.occurrence", "1.0; allowed: a whole number"),
        (", occurrence = '1'", "speed.occurrence", "'1'; allowed: a whole number"),
        (", occurence = 1", "speed.occurence", "no such key; did you mean 'occurrence'?"),
        ("}\nheading = {channel = 'H', unit = 'gon'", "heading.unit", "'gon' of 'H'; allowed: rad, mrad, deg, °"),
        ("}\nsteering = {channel = 'H', unit = '1/m'", "steering.unit", "'1/m' of 'H'; allowed: rad, mrad, deg, °"),
        ("}\nengaged = {channel = 'H', unit = 's'", "engaged.unit", "'s' of 'H'; allowed: none, it is a state"),
        ("}\nengaged = {channel = 'H', min = 1", "engaged.min", "no such key; allowed: channel, group, occurrence, "),
    ],
)  # fmt: skip
def test_wrong_keys_of_a_map(tmp_path: Path, text: str, key: str, message: str) -> None:
    path = tmp_path / "map.toml"
    path.write_text(f"constant_lane_width = 3.5\nlane_offset = {{channel = 'L'}}\nspeed = {{channel = 'V'{text}}}\n")
    with pytest.raises(InputError, match=re.escape(f"map.toml: {key}: {message}")):
        mdf_logs.read_channel_map(path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_a_map_may_begin_with_a_byte_order_mark(tmp_path: Path, encoding: str, ends: str) -> None:
    path = tmp_path / "map.toml"
    path.write_bytes(BASIC.replace("VehicleSpeed", "Größe°").replace("\n", ends).encode(encoding))
    assert mdf_logs.read_channel_map(path).speed.channel == "Größe°"


@pytest.mark.parametrize(
    ("encoding", "message"),
    [
        ("utf-16", "the text is UTF-16; save it as UTF-8"),
        ("utf-16-le", "the text is UTF-16; save it as UTF-8"),
        ("utf-16-be", "the text is UTF-16; save it as UTF-8"),
        ("latin-1", "the text is not UTF-8 ("),
    ],
)
def test_a_map_in_another_encoding_is_refused(tmp_path: Path, encoding: str, message: str) -> None:
    path = tmp_path / "map.toml"
    path.write_bytes(BASIC.replace("VehicleSpeed", "Größe°").encode(encoding))
    with pytest.raises(InputError, match=re.escape(f"map.toml: not a TOML file: {message}")):
        mdf_logs.read_channel_map(path)


def test_a_map_of_nested_lists_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.toml"
    path.write_text("speed = " + "[" * 100_000)
    with pytest.raises(InputError, match=r"map\.toml: not a TOML file: "):
        mdf_logs.read_channel_map(path)


@pytest.mark.parametrize("quantity", ["heading", "steering"])
@pytest.mark.parametrize(
    ("unit", "in_map", "scale", "factor"),
    [
        ("rad", "", 1, 1.0), ("deg", "", 1, 0.017453292519943), ("°", "", 1, 0.017453292519943),
        ("mrad", "", 1, 0.001), ("DEG", "", 1, 0.017453292519943), ("", "deg", 1, 0.017453292519943),
        ("", "rad", -1, -1.0), ("deg", "", -1, -0.017453292519943), ("", "°", 2, 0.034906585039887),
    ],
)  # fmt: skip
def test_angles(tmp_path: Path, quantity: str, unit: str, in_map: str, scale: int, factor: float) -> None:
    values = np.linspace(0.5, 1.5, 100)
    more = f'{quantity} = {{channel = "Angle", scale = {scale}' + (f', unit = "{in_map}"}}' if in_map else "}")
    log = made(tmp_path / "a.mf4", [camera(T), bus(T - 0.01, Angle=(values, unit))])
    (one,), problems = read(log, f"{BASIC}{more}\n")
    assert problems == []
    angle = getattr(one, quantity)
    np.testing.assert_allclose(angle[:-1], factor * (values[:-1] + 0.1 * np.diff(values)), rtol=1e-6)
    assert np.isnan(angle[-1])


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
    log = made(tmp_path / "a.mf4", [camera(t + 0.05), bus(t, Angle=(angle, "deg"))])
    (one,), _ = read(log, BASIC + 'heading = {channel = "Angle"}\nsteering = {channel = "Angle"}\n')
    assert one.heading is not None
    assert one.steering is not None
    turned = (np.degrees(one.heading[4]) - between) % 360.0
    assert min(turned, 360.0 - turned) == pytest.approx(0.0, abs=1e-9)
    far = abs(after - before) > 60.0
    assert np.degrees(one.steering[4]) == pytest.approx(before if far else 0.5 * (before + after))
    assert np.flatnonzero(np.isnan(one.heading)).tolist() == ([9] if gap is None else [6, 7, 9])
    np.testing.assert_allclose(np.cos(one.heading[[5, 8]]), np.cos(np.radians(after)))


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
    log = made(tmp_path / "a.mf4", [camera(T), bus(T), ("Lka", np.array(t), {"Lka": (samples, "")})], **text)
    (one,), problems = read(log, f'{BASIC}[engaged]\nchannel = "Lka"\n{values}\n')
    assert problems == []
    assert one.engaged is not None
    assert one.engaged.dtype == bool
    assert np.flatnonzero(one.engaged).tolist() == list(range(*on))
    assert one.valid.all()


def test_engaged_without_texts_is_named(tmp_path: Path) -> None:
    state = np.where(T > 5.0, b"ACTIVE", b"off")
    log = made(tmp_path / "a.mf4", [camera(T), bus(T, Lka=(state, ""))], Lka={"encoding": "utf-8"})
    what = "holds texts ('off', 'ACTIVE'); allowed: numbers, or `values` for them in the map"
    assert read(log, BASIC + 'engaged = {channel = "Lka"}\n') == ([], [f"a.mf4: engaged: channel 'Lka' {what}"])


@pytest.mark.parametrize(
    ("quantity", "channel", "unit"),
    [
        ("steering", "SteeringWheelAngle", "deg"), ("steering", "StWhlAng", "rad"), ("steering", "ESP_SteerAngle", "°"),
        ("steering", "SWA", "deg"), ("heading", "GPS_Heading", "deg"), ("heading", "CourseOverGround", "rad"),
        ("engaged", "LKA_Active", ""), ("engaged", "LDP_Engaged", ""), ("engaged", "LatCtrlAct", ""),
        ("engaged", "LaneKeepAssistActive", ""), ("engaged", "LKS_State_Engaged", ""),
        # none of the new ones
        (None, "SteeringWheelSpeed", "deg/s"), (None, "SteeringTorque", "Nm"), (None, "SteeringAngleValid", ""),
        (None, "HeadingRate", ""), (None, "PlatformActive", ""), (None, "LatAccActual", "m/s^2"),
        (None, "SwapCount", "1"),
        # those of before keep their channels
        ("speed", "GPS_Speed", "m/s"), ("yaw_rate", "YawRate", "deg/s"), ("lane_offset", "LatOffsetHeading", "m"),
        ("valid", "LaneQuality", ""), ("turn_signal", "TurnIndicator", ""), ("curvature", "LaneCurvature", "1/m"),
    ],
)  # fmt: skip
def test_guesses(tmp_path: Path, quantity: str | None, channel: str, unit: str) -> None:
    log = made(tmp_path / "a.mf4", [("All", T, {channel: (T, unit)})])
    guess = {"channel": channel, "group": "All"} | ({"unit": unit} if unit else {})
    expected = {} if quantity is None else {quantity: [guess] if quantity == "valid" else guess}
    assert tomllib.loads(mdf_logs.list_channels(log)) == expected


@pytest.mark.parametrize("version", ["4.10", "3.30"])
def test_samples_in_bursts_pass_as_they_are(tmp_path: Path, version: str) -> None:
    """Five frames share a time. Of the camera and of the bus in its group each counts, of another group the last."""
    t = np.repeat(np.arange(20) / 4, 5)
    offset = np.arange(100) / 1000
    speed = 36.0 + np.arange(100.0)
    content = [camera(t, offset, Speed2=(speed, "km/h")), bus(t[:-5], speed[:-5])]
    log = made(tmp_path / "a.mf4", content, version)
    (one,), problems = read(log, BASIC.replace("VehicleSpeed", "Speed2"))
    assert problems == []
    np.testing.assert_allclose(one.lane_offset, offset)
    np.testing.assert_allclose(one.speed, speed / 3.6)
    (one,), _ = read(log)
    newest = np.repeat(36.0 + np.arange(4, 100, 5), 5) / 3.6
    np.testing.assert_allclose(one.speed[:-5], newest[:-5])
    assert np.isnan(one.speed[-5:]).all()


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
    at = np.array([0.0, 0.1, 0.3])
    content = [camera(at), ("Bus", np.array(t), {"VehicleSpeed": (np.array(speed, dtype=float), "m/s")})]
    (one,), _ = read(made(tmp_path / "a.mf4", content))
    np.testing.assert_allclose(one.speed, expected)


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
    at = np.arange(150) / 20 + 0.013
    log = made(tmp_path / "a.mf4", [camera(at), bus(t), ("Slow", t, {"Own": (values, unit)})])
    channels = "".join(line + "\n" for line in BASIC.splitlines() if not line.startswith(quantity))
    (one,), problems = read(log, channels + f'{quantity} = {{channel = "Own"}}\n')
    assert problems == []
    found = getattr(one, quantity)
    codes = (at > 3.9) & (at < 4.1)
    np.testing.assert_allclose(found[~codes], good * factor)
    if quantity == "heading":  # of which only the direction counts
        np.testing.assert_allclose(np.cos(found[codes]), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.sin(found[codes]), -1.0)
    else:
        np.testing.assert_allclose(found[codes], code * factor)
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
    (one,), _ = read(made(tmp_path / "a.mf4", content), channels + f'{quantity} = {{channel = "Own"}}\n')
    np.testing.assert_allclose(getattr(one, quantity), [3.0 + 0.25 * step, 3.0 + 0.5 * step])
