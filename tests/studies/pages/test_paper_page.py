"""The page of the source paper: every figure, and numbers that `simulate` and ``ranking.csv`` give."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from helpers.cli import csv_rows, good
from helpers.models import make_model
from helpers.pages import EVIL, Page, whole
from helpers.results import report_input, run
from ldctoolkit import Scenarios, load_model, simulate
from ldctoolkit.controllers import LQR, NoControl, PreviewProportional
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.simulation import Window
from ldctoolkit.studies import load_study
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.pages.context import ReportInput
from ldctoolkit.studies.pages.paper_page import write_paper_page
from ldctoolkit.studies.ranking.ranking import write_csv
from ldctoolkit.studies.storage.folder_files import read_parquet
from ldctoolkit.studies.study_file import catalog_names

SECTIONS = ["result", "procedure", "departures", "model", "control", "scores"]
NO_CONTROL, TABLE_1 = Design.of(NoControl(), 0.2), Design.of(PreviewProportional(), 0.2)


@pytest.fixture(scope="module")
def scenarios(model: ScenarioModel) -> Scenarios:
    return model.sample(60, 40, seed=1)


def written(report: ReportInput, folder: Path) -> Page:
    page = Page(write_paper_page(report, folder / "paper.html").read_text(encoding="utf-8"))
    whole(page)
    assert [section for section in page.text if section] == SECTIONS
    return page


def paper(
    scenarios: Scenarios, *designs: Design, model: ScenarioModel | None = None, window: Window = "departure",
    folder: Path | None = None,
) -> ReportInput:  # fmt: skip
    results = run(designs or (NO_CONTROL, TABLE_1), scenarios, window)
    name = "the model reference" if model else "d.parquet, replayed"
    return report_input(results, model=model, model_name=name, folder=folder, synthetic=model is not None)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("paper")


@pytest.fixture(scope="module")
def report(scenarios: Scenarios, model: ScenarioModel, folder: Path) -> ReportInput:
    return paper(scenarios, model=model, folder=folder)


@pytest.fixture(scope="module")
def page(report: ReportInput, folder: Path) -> Page:
    return written(report, folder)


def scores(page: Page) -> dict[tuple[str, str], list[str]]:
    """Side and where S begins -> the numbers of its row."""
    return {(row[0], row[1]): row[2:] for row in page.captioned("Mean S and its standard deviation")[1:]}


def test_every_figure_of_the_paper_is_there(page: Page, scenarios: Scenarios) -> None:
    for label, count in {
        r"The procedure of the paper": 1,
        r"(y|v|c) \[.*\] of example departures": 3,
        r"(left|right): \w+, ": 16,  # margins of eight parameters
        r"(left|right): density of T and d_y, \w+, (invented|model)": 4,
        r"Departures to the (left|right): no\. \d+": 2,
        r"Departures to the (left|right): \d+ paths": 2,
        r"Mean and standard deviation of S": 1,
        r"Mean S, (left|right)": 2,
    }.items():
        assert sum(re.match(label, image) is not None for image in page.images) == count, label
    assert "K = 10 left, 10 right" in page.drawn
    assert "30,000 left, 30,000 right" in page.drawn
    assert "acts in none" not in page.words("control")
    assert len(page.html) < 400_000


def test_a_path_for_each_departure_that_triggers(page: Page, scenarios: Scenarios, folder: Path) -> None:
    paths = simulate(PreviewProportional(), scenarios, trajectories=True).trajectories
    assert paths is not None
    left = scenarios.d_y[scenarios.side > 0] > 0.2
    right = scenarios.d_y[scenarios.side < 0] > 0.2
    assert [page.html.count(f'class="thin c{k}"') for k in (0, 1)] == [left.sum(), right.sum()]
    assert 5 < left.sum() < 60
    import polars as pl

    numbers = {"shape": pl.List(pl.Int64()), "values": pl.List(pl.Float64())}
    schema = {"key": pl.String(), "name": pl.String(), **numbers}
    table = read_parquet(folder / "paper-paths.parquet", schema, finite=False)
    stored = np.array(table.row(0)[3]).reshape(table.row(0)[2])
    np.testing.assert_allclose(stored[0], paths.t, atol=1e-12)
    np.testing.assert_allclose(stored[1], paths.x[:, :, 0] - 0.85, atol=1e-9)


def drawing(page: Page, label: str) -> str:
    """The chart whose label begins like this."""
    found = re.search(rf'<svg class="chart" role="img" [^>]*aria-label="{label}.*?</svg>', page.html, re.DOTALL)
    assert found is not None, label
    return found[0]


def heights(svg: str, kind: str) -> list[np.ndarray]:
    """Vertical positions of the corners of each path of a class [units, downward]."""
    paths = re.findall(rf'<path class="{kind}"[^>]* d="M([^"]*)"', svg)
    return [np.array([float(pair.split()[1]) for pair in path.strip("Z").split("L")]) for path in paths]


def test_drawings_show_departures_model_and_control(page: Page) -> None:
    """The reference model is close to its departures: bars beside its line, cells beside its cells."""
    for name in ("T", "d_y", "v_mean"):
        svg = drawing(page, f"right: {name}, ")
        (bar,), (line,) = heights(svg, "bar c1"), heights(svg, "curve recorded")
        assert np.ptp(bar) > 80.0
        assert np.abs(bar - line).max() < 10.0
    fills = [
        re.findall(
            r'<rect x="([\d.]+)" y="([\d.]+)" [^>]*fill="(#\w+)"', drawing(page, f"left: density of T and d_y, {side}")
        )
        for side in ("left, invented", "left, model")
    ]
    common = {cell[:2]: cell[2] for cell in fills[0]}
    same = [common[cell[:2]] == cell[2] for cell in fills[1] if cell[:2] in common]
    assert len(same) > 60
    assert np.mean(same) > 0.82
    for label in ("Departures to the left: no", r"Departures to the right: \d+ paths"):
        line, centre = heights(drawing(page, label), "curve recorded")[-2:]
        assert np.ptp(line) == np.ptp(centre) == 0.0
        assert centre[0] > line[0] + 40.0
    (without,), (control,) = (heights(drawing(page, "Mean S, right"), f"curve {style}") for style in ("recorded", "c1"))
    assert control[-1] > without[-1] + 10.0  # further down: less


def test_numbers_are_those_of_the_ranking_and_of_simulate(
    page: Page, report: ReportInput, scenarios: Scenarios, tmp_path: Path
) -> None:
    write_csv(report.ranking, tmp_path / "ranking.csv")
    of_law = {row["law"]: row for row in csv_rows(tmp_path / "ranking.csv")}
    rows = scores(page)
    for side in ("left", "right"):
        n, mean_0, _, mean, _, reduction, _, printed = rows[side, "the crossing"]
        expected = (of_law["none"][f"S_{side}_m_s"], of_law["preview_proportional"][f"S_{side}_m_s"])
        assert [float(mean_0), float(mean)] == pytest.approx([float(x) for x in expected], abs=6e-4)
        assert float(reduction) == pytest.approx(
            100.0 * float(of_law["preview_proportional"][f"reduction_{side}"]), abs=6e-3
        )
        assert (int(n), printed) == ({"left": 60, "right": 40}[side], "")
    for start, window in (("the trigger", "control"), ("the crossing", "departure")):
        outcome = simulate(PreviewProportional(), scenarios, y_s=0.2, window=window)  # type: ignore[arg-type]
        for side, sign in (("left", 1), ("right", -1)):
            S_0, S = (x[scenarios.side == sign] for x in (outcome.S_uncorrected, outcome.S))
            expected = [S_0.mean(), S_0.std(ddof=1), S.mean(), S.std(ddof=1), 100.0 * (1.0 - S.mean() / S_0.mean())]
            shown = [float(text.replace("\u2212", "-")) for text in rows[side, start][1:6]]
            assert shown == pytest.approx(expected, abs=6e-3)
            assert shown[:4] == pytest.approx(expected[:4], abs=6e-4)
    assert [rows[side, "the trigger"][-1] for side in ("left", "right")] == ["26.47", "34.24"]
    first = rows["left", "the trigger"]
    low, high = first[6].split(" to ")
    assert (
        f"Reduction of mean S: 26.47\u00a0% left, 34.24\u00a0% right in the paper; here {first[5]}\u00a0% left "
        f"({low} to {high}\u00a0%), {rows['right', 'the trigger'][5]}\u00a0% right"
    ) in " ".join(page.text["result"].split(" "))


def test_a_study_in_the_window_of_the_paper_shows_the_same(
    page: Page, scenarios: Scenarios, model: ScenarioModel, tmp_path: Path
) -> None:
    assert scores(written(paper(scenarios, model=model, window="control"), tmp_path)) == scores(page)


def test_intervals_are_those_of_a_bootstrap(page: Page, scenarios: Scenarios) -> None:
    outcome = simulate(PreviewProportional(), scenarios, y_s=0.2)
    S_0, S = (x[scenarios.side == 1] for x in (outcome.S_uncorrected, outcome.S))
    rows = np.random.default_rng(0).integers(S.size, size=(4000, S.size))
    spread = np.std(100.0 * (1.0 - S[rows].mean(axis=1) / S_0[rows].mean(axis=1)))
    low, high = (float(text.replace("\u2212", "-")) for text in scores(page)["left", "the crossing"][6].split(" to "))
    assert high - low == pytest.approx(2.0 * 2.001 * spread, rel=0.06)  # Student's t of 59 degrees of freedom


def test_replayed_departures_of_one_trip_count_as_one(scenarios: Scenarios, tmp_path: Path) -> None:
    """Each departure four times in a trip of its own: the interval is that of a single copy of each."""
    copies = scenarios.take(np.repeat(np.arange(100), 4))
    trips = dataclasses.replace(copies, index=np.arange(400), cluster=np.repeat(np.arange(100), 4))
    page, single = written(paper(trips), tmp_path), written(paper(scenarios), tmp_path)
    for key, row in scores(single).items():
        assert scores(page)[key][5:7] == row[5:7]
    assert "Replayed departures" in page.drawn
    assert "each replayed as it is" in page.words("result")
    assert "not used" in page.drawn
    assert "160 recorded departures" in page.words("model")
    assert "model" not in {image.rpartition(" ")[2] for image in page.images}


def test_what_differs_from_table_1_is_named(scenarios: Scenarios, model: ScenarioModel, tmp_path: Path) -> None:
    other = written(paper(scenarios, NO_CONTROL, Design.of(LQR(r_delta=300.0), 0.1), model=model), tmp_path)
    words = other.words("result")
    assert "Not as in Table I: Tlp, Ky, K\u03c8, ys" in words
    rows = {row[1]: row[2:4] for row in other.captioned("Table I")[1:]}
    assert rows["trigger threshold"] == ["0.2", "0.1"]
    assert rows["preview time"] == ["2", "\u2013"]
    assert rows["mass"] == ["1000", "1000"]
    assert other.html.count('class="n bad"') == 4
    mine = written(paper(scenarios, NO_CONTROL, Design.of(LQR(r_delta=300.0), 0.1), TABLE_1, model=model), tmp_path)
    assert "Not as in Table I" not in mine.words("result")  # the paper's design, whichever wins
    assert 'class="n bad"' not in mine.html


def test_reasons_follow_the_study(page: Page, scenarios: Scenarios, tmp_path: Path) -> None:
    words = page.words("result")
    assert "fitted to invented, not to recorded driving" in words
    assert "Here both are consistent" in words
    assert "includes side slip" in words
    assert "Speed looks like km/h." in words  # a warning of the study
    results = run((NO_CONTROL, TABLE_1), scenarios, convention="as_printed")
    given = report_input(
        results, synthetic=False, model=load_model("reference"), model_name=EVIL, title=EVIL, warnings=(EVIL,)
    )
    evil = written(given, tmp_path)
    assert "<script>alert(1)" not in evil.html
    words = evil.words("result")
    assert words.count("alert(1)") == 2
    assert "Signs: as printed" in words
    assert "fitted to other recordings" in words


def test_bic_where_several_numbers_of_components_were_tried(tmp_path: Path) -> None:
    model = make_model()
    report = paper(model.sample(30, 30, seed=2), model=model)
    assert written(report, tmp_path).images.count("BIC") == 1


@pytest.mark.parametrize("sides", [(12, 0), (0, 12), (1, 0), (3, 2)])
def test_few_departures(model: ScenarioModel, tmp_path: Path, sides: tuple[int, int]) -> None:
    for given in (model, None):
        page = written(paper(model.sample(*sides, seed=3), model=given), tmp_path)
        assert len(scores(page)) == 2 * sum(n > 0 for n in sides)
        if given is None:
            assert "30 are needed" in page.words("model")


def test_nothing_triggers(scenarios: Scenarios, model: ScenarioModel, tmp_path: Path) -> None:
    page = written(paper(scenarios, Design.of(PreviewProportional(), 5.0), model=model), tmp_path)
    assert "Control acts in none of these departures." in page.words("control")
    assert scores(page)["left", "the trigger"][1:7] == ["0.000"] * 4 + ["\u2013"] * 2
    assert scores(page)["left", "the crossing"][5] == "0.00"


def test_the_two_studies_of_the_catalog_ask_for_it() -> None:
    assert [name for name in catalog_names() if load_study(name).report.paper] == ["paper", "paper-as-printed"]


def test_ldc_run_writes_it_where_the_study_asks_for_it(tmp_path: Path) -> None:
    """And takes away that of an earlier run."""
    text = "[scenarios]\nleft = 6\nright = 6\n[ranking]\nbootstrap = 100\nfinalists = 0\n[report]\npaper = {}\n"
    text = 'name = "s"\n' + text + '[[design]]\nlaw = "none"\n[[design]]\nlaw = "preview_proportional"\n'
    quick = ("--workers", 1, "--no-robustness", "--no-figures", "--quiet")
    for asked, last in (("true", "paper:   out/s/paper.html"), ("false", "report:  out/s/report.html")):
        (tmp_path / "s.toml").write_text(text.format(asked), encoding="utf-8")
        assert good("run", "s.toml", *quick, cwd=tmp_path).splitlines()[-1] == last
        assert (tmp_path / "out" / "s" / "paper.html").exists() == (asked == "true")
