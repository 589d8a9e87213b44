"""docs/recording-biases.md says what the code does."""

import re
from pathlib import Path

from helpers import round_trip as making
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.recordings.find_departures import HALF_WINDOW

PAGE = (Path(__file__).parents[4] / "docs" / "recording-biases.md").read_text(encoding="utf-8")


def test_the_noise_is_the_default():
    noise = making.Noise()
    for words in (
        f"white, {noise.lane:g} m, then rounded to 1/{1 / noise.lane_resolution:g} m",
        f"white, {noise.speed:g} m/s",
        f"white, {noise.yaw_rate:g} deg/s, and each value stays for {['', 'one', 'two'][noise.yaw_rate_rows]} rows",
        f"white, {noise.heading:g} deg",
    ):
        assert words in PAGE, words


def test_each_table_has_every_parameter():
    for title in ("Sampling alone", "With noise", "With three times the noise"):
        (section,) = re.findall(rf"^## {title}\n(.*?)(?=^## )", PAGE, flags=re.M | re.S)
        assert re.findall(r"^\| (\w+) \[", section, flags=re.M) == list(PARAMETER_NAMES)


def test_the_window_is_the_one_that_is_used():
    assert f"smoothed over {HALF_WINDOW:g} s to either side" in PAGE
    other = (Path(__file__).parents[4] / "docs" / "recordings.md").read_text(encoding="utf-8")
    assert re.search(rf"within\s+{HALF_WINDOW:g} s to either side", other)
