"""A scenario model's departures come back out of the tables that a vehicle would have recorded."""

import re
from pathlib import Path

import numpy as np
import pytest

from helpers import round_trip as making
from ldctoolkit import extract_departures, fit_scenario_model, load_model, open_recordings
from ldctoolkit.departures import PARAMETER_NAMES

PAGE = (Path(__file__).parents[4] / "docs/explanation/recording-biases.md").read_text(encoding="utf-8")

LARGEST = 0.03  # Kolmogorov distance that is allowed to every parameter on each side
# but to sigma_v: the noise of the speed, 0.01 m/s, is half of its 5 % quantile and hardly leaves a value below itself
LARGEST_OF = np.array([0.06 if name == "sigma_v" else LARGEST for name in PARAMETER_NAMES])


def extracted(folder, drive, noise, **options):
    paths = making.write_tables(folder, making.measure(drive, noise, 7, **options))
    return extract_departures(open_recordings(paths, format="spmd-das1"))


def check(distances):
    reported = {side: dict(zip(PARAMETER_NAMES, row.round(4).tolist(), strict=True)) for side, row in distances.items()}
    assert all((row < LARGEST_OF).all() for row in distances.values()), reported


def errors(extraction, drive):
    """Found less planted by parameter, the pairing, and the planted parameters."""
    pairs = making.compare(extraction.departures, drive)
    truth = drive.planted.parameters.take(pairs.planted)
    return (
        dict(zip(PARAMETER_NAMES, (extraction.departures.matrix()[pairs.found] - truth.matrix()).T, strict=True)),
        pairs,
        truth,
    )


@pytest.mark.slow
def test_marginals_come_back_with_noise(tmp_path):
    drive = making.drive(load_model("reference").sample(750, 750, seed=11), 5)
    extraction = extracted(tmp_path, drive, making.Noise())
    pairs = making.compare(extraction.departures, drive)
    assert pairs.lost < 0.02 * 1500
    assert pairs.surplus < 0.02 * 1500
    check(making.kolmogorov(extraction.departures, drive.planted.parameters))
    assert extraction.problems == ()
    assert not any("yaw" in words for words in extraction.warnings)


def test_sampling_alone_changes_little(tmp_path):
    drive = making.drive(load_model("reference").sample(400, 400, seed=12), 5)
    extraction = extracted(tmp_path, drive, making.Noise.none())
    error, pairs, truth = errors(extraction, drive)
    assert pairs.surplus == 0
    assert pairs.lost <= 0.005 * 800
    slow = np.abs(error["T"]) < 0.01 + 0.01 / truth.T
    assert slow.mean() > 0.97  # but for the residuals that bend y most at the line
    assert np.abs(error["a_mean"]).max() < 1e-6
    assert np.abs(error["sigma_v"]).max() < 1e-6
    assert np.quantile(np.abs(error["d_y"]), 0.95) < 0.003
    assert np.quantile(np.abs(error["c_0"]) * truth.v_mean**2, 0.95) < 0.01
    assert np.quantile(np.abs(error["dc"]) * truth.v_mean**2, 0.95) < 0.01


def test_short_departures_keep_their_bend_where_the_road_does_not_go_on(tmp_path):
    """The curvature stays at its end values outside: what a long smoothing window would take for that inside."""
    model = load_model("reference").sample(200, 200, seed=13, given={"T": (0.7, 1.1)})
    drive = making.drive(model, 5, curvature_held=True)
    extraction = extracted(tmp_path, drive, making.Noise.none())
    error, _, truth = errors(extraction, drive)
    retained = 1.0 + np.sum(error["dc"] * truth.dc) / np.sum(truth.dc**2)
    assert 0.9 < retained < 1.02


def test_what_the_vehicle_turns_itself_is_in_the_curvature(tmp_path):
    """The known bias of the yaw rate, in size and sign: the parabola bends back by 8 d_y/(v T)^2."""
    drive = making.drive(load_model("reference").sample(200, 200, seed=14, given={"T": (1.5, 4.0)}), 5)
    extraction = extracted(tmp_path, drive, making.Noise.none(), own_turning=True)
    error, _, truth = errors(extraction, drive)
    expected = -8.0 * truth.d_y / (truth.v_mean * truth.T) ** 2
    middle = error["c_0"] + 0.5 * error["dc"]
    assert np.median(middle / expected) == pytest.approx(0.9, abs=0.1)  # the window takes some of the way back in


N = 20_000  # departures of the page; drawn, driven and measured with the seeds of the tool that prints its tables


@pytest.fixture(scope="module")
def page_drive():
    return making.drive(load_model("reference").sample(N // 2, N // 2, seed=11), 5)


def section_of_page(title):
    (section,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", PAGE, flags=re.M | re.S)
    return section


def check_page(title, extraction, drive):
    """What the page says of a measurement, within what other random numbers would change."""
    section = section_of_page(title)
    pairs = making.compare(extraction.departures, drive)
    for said in re.findall(r"Found again ([\d,]+), lost (\d+), not planted (\d+)", section):
        counts = [int(number.replace(",", "")) for number in said]
        assert counts[0] + counts[1] == N
        for measured, written in zip((pairs.lost, pairs.surplus), counts[1:], strict=True):
            # rare and independent: four standard deviations of the difference of two counts
            assert abs(measured - written) <= 4.0 * np.sqrt(2.0 * written), (title, measured, written)
    # a distance of two samples of 10,000 scatters by sqrt(0.5/10,000) = 0.007 at most: twice that
    rows = re.findall(r"^\| (\w+) \[.*\| (0\.\d+), (0\.\d+) \|$", section, flags=re.M)
    distances = making.kolmogorov(extraction.departures, drive.planted.parameters)
    for name, *written in rows:
        k = PARAMETER_NAMES.index(name)
        measured = [distances[side][k] for side in ("left", "right")]
        assert measured == pytest.approx([float(row) for row in written], abs=0.015), (title, name)
    return len(rows)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "factor", "own_turning", "rows"),
    [
        ("Sampling alone", 0.0, False, 8),
        ("With three times the noise", 3.0, False, 8),
        ("The vehicle's own turning", 1.0, True, 2),
    ],
)
def test_the_page_says_what_is_measured(page_drive, tmp_path, title, factor, own_turning, rows):
    noise = making.Noise().times(factor) if factor else making.Noise.none()
    extraction = extracted(tmp_path, page_drive, noise, own_turning=own_turning)
    assert check_page(title, extraction, page_drive) == rows


@pytest.mark.slow
def test_a_model_comes_back(page_drive, tmp_path):
    model = load_model("reference")
    extraction = extracted(tmp_path, page_drive, making.Noise())
    pairs = making.compare(extraction.departures, page_drive)
    # a share of departures too few or too many moves no distribution by more than itself: the two leave half for errors
    assert pairs.lost + pairs.surplus < 0.5 * LARGEST * N
    assert check_page("With noise", extraction, page_drive) == 8
    check(making.kolmogorov(extraction.departures, page_drive.planted.parameters))
    # with the maps of the model itself
    again = fit_scenario_model(extraction.departures, components=10, seed=1, n_init=2, transform="auto")
    check(making.kolmogorov(again.sample(100_000, 100_000, seed=3), model.sample(100_000, 100_000, seed=4)))
