"""The lines of docs/how-to/openpilot-logs.md, on stand-ins of the messages: planted departures come back."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from helpers.cli import run_python
from helpers.mdf import PLANTED, VEHICLE, WIDTH, curvature, lane_offset, speed
from helpers.planted import assert_planted
from ldctoolkit.recordings import extract_departures, open_recordings

NS = 1e9
CAMERA = 0.06  # m left of the vehicle's centre


def message(kind: str, t: float, body: SimpleNamespace, valid: bool = True) -> SimpleNamespace:
    return SimpleNamespace(which=lambda: kind, logMonoTime=int(t * NS), valid=valid, **{kind: body})


def drive() -> Iterator[SimpleNamespace]:
    """The car at 100 Hz, pose and model at 20 Hz. A boot time of days; y to the right, z down."""
    for i in range(9600):
        t = np.array(i * 0.01)
        clock = 2e5 + float(t)
        flashing = 61.0 < t < 66.0
        yield message(
            "carState", clock, SimpleNamespace(vEgo=float(speed(t)), leftBlinker=flashing, rightBlinker=False)
        )
        yield message("carControl", clock, SimpleNamespace(latActive=79.0 < t < 81.0))
        if i % 5 == 0:
            r = float(curvature(t) * speed(t))
            rate = SimpleNamespace(x=0.0, y=0.0, z=-r, valid=True)
            yield message("livePose", clock, SimpleNamespace(angularVelocityDevice=rate))
            # of each line its position to the right of the camera
            lines = [float(lane_offset(t)) + CAMERA + WIDTH * k for k in (-1.5, -0.5, 0.5, 1.5)]
            unsure = 38.0 < t < 39.5
            model = SimpleNamespace(
                timestampEof=int(clock * NS),
                laneLines=[SimpleNamespace(y=[y, y + 1.0]) for y in lines],
                laneLineProbs=[0.1, 0.9, 0.3 if unsure else 0.8, 0.1],
            )
            yield message("modelV2", clock + 0.05, model)


def test_the_lines_turn_signs_and_keep_departures(tmp_path: Path) -> None:
    scope: dict[str, Any] = run_python("docs/how-to/openpilot-logs.md", {"__name__": "page"})
    scope["write_table"](tmp_path / "drive.csv", drive(), "route", camera_left=CAMERA)
    extraction = extract_departures(open_recordings(tmp_path / "drive.csv"), vehicle_width=VEHICLE)
    # the fifth with its signal on, the fourth where a line is not sure, the sixth while openpilot steers
    assert (extraction.refused.intended, extraction.refused.invalid, extraction.refused.engaged) == (1, 1, 1)
    assert_planted(extraction.departures, PLANTED[:3], curvature, step=0.05, bend=5e-5)
    assert extraction.provenance.curvature == "yaw_rate"


def test_what_is_not_known_yet_is_missing() -> None:
    scope: dict[str, Any] = run_python("docs/how-to/openpilot-logs.md", {"__name__": "page"})
    only_model = [text for text in drive() if text.which() == "modelV2"][:2]
    first, second = scope["rows"](only_model, "a")
    assert first[:2] == ("a", 0.0)
    assert first[4:] == (None, None, 1, 0, 0)
    assert second[1] == pytest.approx(0.05)
