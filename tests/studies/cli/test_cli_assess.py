"""``ldc assess``, standards and the tail as requirements of a study, and the light of a tail that got worse."""

import csv
import dataclasses
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from helpers.cli import bad, good, ldc
from helpers.closed_loop import known
from helpers.pages import Page, whole
from ldctoolkit import Controller, LinearLaw, Plant, controllers
from ldctoolkit.studies import Study, rank_study, run_study
from ldctoolkit.studies.ranking.verdict import Light, verdict
from ldctoolkit.studies.requirements import parse_requirement, requirements_of
from ldctoolkit.studies.study_file import load_study

ROAD_EDGE, DRIVEABILITY = "euroncap-2026-elk-road-edge", "euroncap-2026-driveability"
LQR = "LQR, y_s=-0.4 m"
STUDY = f"""
name = "few"
[scenarios]
left = 8
right = 8
[ranking]
bootstrap = 100
finalists = 0
require = ["{ROAD_EDGE} >= 0.9", "tail_0.8 <= 0.01"]
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [-0.4, 0.3]
"""


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def page_at(path: Path) -> Page:
    page = Page(path.read_text(encoding="utf-8"))
    whole(page)
    return page


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder with the study and its results, and what the run printed."""
    folder = tmp_path_factory.mktemp("few")
    (folder / "s.toml").write_text(STUDY, encoding="utf-8")
    return folder, good("run", "s.toml", "-o", "out", "--workers", 1, cwd=folder)


def test_a_law_that_passes(tmp_path: Path) -> None:
    out = good("assess", "lqr", "--standard", ROAD_EDGE, "-o", "found", cwd=tmp_path)
    assert f"{LQR} {ROAD_EDGE} 100 100 100 36 0 0" in " ".join(out.split())
    assert out.replace("\u00a0", " ").splitlines()[-3:] == [
        f"{ROAD_EDGE}: 100 % of the standard cells pass as stated, 100 % at every corner; extended range 100 % of its "
        "points",
        "predictions: found/predictions.csv",
        "page: found/assessment.html",
    ]
    first, *others = rows(tmp_path / "found" / "predictions.csv")
    assert len(others) == 35
    value, worst = float(first.pop("value")), float(first.pop("worst"))
    assert (value, worst) == (pytest.approx(0.322, abs=0.001), pytest.approx(0.276, abs=0.001))
    assert ",".join(first) == (
        "label,standard,range,speed_km_h,lateral_velocity_m_s,lateral_acceleration_m_s2,predicted,light,quantity,"
        "limit,worst_case"
    )
    expected = [LQR, ROAD_EDGE, "standard", "50", "0.2", "", "pass", "green", "dtle", "-0.1"]
    assert list(first.values()) == [*expected, "heavy vehicle, +1 km/h, +0.05 m/s"]
    assert [others[-1][name] for name in ("range", "speed_km_h", "lateral_velocity_m_s")] == ["extended", "100", "0.7"]
    page = page_at(tmp_path / "found" / "assessment.html")
    assert page.images == ["passes at every corner"] * 36
    head, row = page.captioned("Each design in each test")
    assert (head[1], row[1]) == ("Test", "Euro NCAP 2026, ELK road edge")
    grid = page.captioned("DTLE [m]")
    assert grid[0] == ["Speed [km/h]", *(f"{rate} [m/s]" for rate in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7))]
    assert [row[0] for row in grid[1:]] == ["50", "60", "70", "80", "90", "100"]
    assert grid[1][1] == "✓ 0.32 (0.28)"
    assert "Corners: 60 variants of speed, lateral velocity, vehicle and camera noise." in page.words("test-1")


def test_lights_of_every_kind_and_what_cannot_be_assessed(tmp_path: Path) -> None:
    done = ldc("assess", "lqr", "--standard", DRIVEABILITY, "-o", "found", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (3, "")
    assert "  70 km/h, 0.3 m/s: red: Steering wheel velocity 41.7 °/s, limit 25.0 °/s\n" in done.stdout
    assert "  not assessable: overriding torque at most 3.0 Nm (+0.5): it needs a driver's torque" in done.stdout
    assert "  3 of 4 conditions have to hold. 2 can be assessed, and 1 of these hold" in done.stdout
    page = page_at(tmp_path / "found" / "assessment.html")
    meanings = {"passes at every corner": 10, "passes as stated, fails at a corner": 8, "fails as stated": 12}
    assert {name: page.images.count(name) for name in page.images} == meanings
    grid, words = page.captioned("Steering wheel velocity [°/s]; Lateral velocity 2 s after"), page.words("test-1")
    assert grid[1][1].startswith("\u2713 \u2013; 0.")
    assert "Not assessable: overriding torque at most 3.0 Nm (+0.5). Why: it needs a driver's torque" in words
    assert "70 km/h, 0.3 m/s: red. Steering wheel velocity 41.7 °/s, limit 25.0 °/s." in words
    lights = Counter((row["light"], row["predicted"]) for row in rows(tmp_path / "found" / "predictions.csv"))
    assert lights == {("green", "pass"): 20, ("amber", "pass"): 16, ("red", "fail"): 24}


def test_a_plant_with_a_driver_is_assessed_with_it(tmp_path: Path) -> None:
    """A study requires it, and its report says how many conditions hold, and with which driver."""
    text = STUDY.replace(f'"{ROAD_EDGE} >= 0.9", "tail_0.8 <= 0.01"', f'"{DRIVEABILITY} >= 0.5", "acceptable"')
    driver = "[plant]\ndriver = { straight = 0.75, against = 0.25 }\n[ranking]"
    (tmp_path / "s.toml").write_text(text.replace("[ranking]", driver), encoding="utf-8")
    said = ldc("assess", "s.toml", "--design", LQR, "--standard", DRIVEABILITY, "--no-tolerances", cwd=tmp_path).stdout
    assert "3 of 4 conditions have to hold. 4 can be assessed" in said
    assert "With the driver model of [plant.driver] (grip; straight 75 %, against 25 %)" in said.replace("\u00a0", " ")
    assert "not assessable" not in said
    bends = ldc("assess", "s.toml", "--design", LQR, "--standard", "un-r79-b1", "--no-tolerances", cwd=tmp_path).stdout
    torque, time = "the overriding torque is the largest one", "the time against the driver is the longest"
    assert [text in said for text in (torque, time)] == [True, True]
    assert [text in bends for text in (torque, time)] == [True, False]
    ldc("run", "s.toml", "-o", "out", "--workers", 1, "--no-robustness", "--no-figures", cwd=tmp_path)
    page = page_at(tmp_path / "out" / "report.html")
    words = page.words("standards")
    assert "3 of 4 conditions have to hold. 4 can be assessed" in words
    assert "Overriding torque [N·m]; Against the driver once parallel [s]" in words
    metrics = {row[0] for row in page.captioned("All metrics")}
    assert {"Peak driver torque, 95 % quantile", "Overridden by the driver"} <= metrics
    header = (tmp_path / "out" / "ranking.csv").read_text(encoding="utf-8").partition("\n")[0].split(",")
    assert {"driver_torque_peak_p95_N_m", "driver_torque_peak_p95_low_N_m", "overridden_mean"} <= set(header)


def test_no_control_fails(tmp_path: Path) -> None:
    done = ldc("assess", "none", "--standard", ROAD_EDGE, "--no-tolerances", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (3, "")
    assert "  50 km/h, 0.2 m/s: red: DTLE \u22120.50 m, limit \u22120.10 m\n" in done.stdout
    score = f"{ROAD_EDGE}: 0 % of the standard cells pass as stated; extended range 0 % of its points\n"
    assert score in done.stdout.replace("\u00a0", " ")
    assert not list(tmp_path.iterdir())


def test_gains_trigger_and_time_to_line_crossing(tmp_path: Path) -> None:
    """A design that is given word for word; a second before the line is early enough."""
    given = ("assess", "lqr", "--standard", ROAD_EDGE, "--no-tolerances")
    soft = ldc(*given, "--gain", "r_delta=500", "--y-s", "0.15", cwd=tmp_path)
    assert (soft.returncode, "LQR, y_s=0.15 m, r_delta=500" in " ".join(soft.stdout.split())) == (3, True)
    assert ldc(*given, "--y-s", "0", cwd=tmp_path).returncode == 3
    text = 'name = "s"\n[simulation]\ntrigger = "ttlc"\nttlc = 1.0\n[[design]]\nlaw = "none"\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    assert ldc(*given, "--y-s", "0", "--plant", "s.toml", cwd=tmp_path).returncode == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("lrq",), "'lrq' is neither a law, a study nor a folder; did you mean 'lqr'?"),
        (("lqr", "--standard", "euroncap-2026-elk-roadedge"), f"did you mean '{ROAD_EDGE}'?"),
        (("road-edge", "--gain", "r_delta=3"), "--gain, --y-s: need the name of a law; road-edge has its own"),
        (("road-edge", "--y-s", "-0.3"), "--gain, --y-s: need the name of a law; road-edge has its own designs"),
        (("lqr", "--y-s", "-11"), "y_s: -11.0; allowed: a finite number >= -10"),
        (("lqr", "--gain", "r_detla=3"), "did you mean 'r_delta'?"),
    ],
)
def test_bad_input_is_reported_in_a_line(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    assert message in bad("assess", *arguments, cwd=tmp_path)


def test_a_folder_stands_for_its_verdict_and_a_study_for_its_designs(few: tuple[Path, str]) -> None:
    given = ("--standard", "un-r79-b1", "--no-tolerances")
    assert f"{LQR} un-r79-b1" in good("assess", "out", *given, cwd=few[0])
    both = ldc("assess", "s.toml", *given, cwd=few[0])
    assert both.returncode == 3
    words = " ".join(both.stdout.split())
    assert [f"{LQR} un-r79-b1 100 – – " in words, "LQR, y_s=0.3 m un-r79-b1 0 – – " in words] == [True, True]  # noqa: RUF001
    assert "No control" not in both.stdout


def test_standards_and_the_tail_read_as_requirements() -> None:
    assert parse_requirement("tail_0.8 <= 0.01").text == "tail_0p8 <= 0.01"
    assert parse_requirement(ROAD_EDGE).text == f"{ROAD_EDGE} >= 1"
    assert len(requirements_of([ROAD_EDGE, f"{ROAD_EDGE} >= 1.0", f"{ROAD_EDGE} >= 0.5"])) == 2


def test_a_study_that_requires_a_standard(few: tuple[Path, str]) -> None:
    folder, out = few
    early, late, none = rows(folder / "out" / "ranking.csv")
    shares = [row["euroncap_2026_elk_road_edge_share"] for row in (early, late, none)]
    assert shares == ["1.0", "0.0", "0.0"]
    assert [row["tail_0p8_share"] for row in (early, late)] == ["0.0", "0.0"]
    assert [row["rank"] for row in (early, late, none)] == ["1", "", ""]
    assert (early["y_s_m"], late["y_s_m"]) == ("-0.4", "0.3")
    assert late["unmet"] == f"{ROAD_EDGE} >= 0.9"
    assert "2 of 3 designs do not meet a requirement and are not ranked." in out
    assert "Best design that meets the limits: LQR, y_s = -0.4 m." in out
    page = page_at(folder / "out" / "report.html")
    words = page.words("standards")
    assert words.startswith(
        "Standards LQR, ys = \u22120.4 m, on the study's plant.Euro NCAP 2026, ELK road edge100 % of"
    )
    assert page.images.count("passes at every corner") == 36
    limits = page.headed("Metric", "Limit")[0]
    assert ["Euro NCAP 2026, ELK road edge, cells passed", "≥ 90 %", "own", "100.0 %", "0.0 %", "1"] in limits
    assert f"breaks {ROAD_EDGE} >= 0.9 by 100 %" in page.words("ranking")


def test_a_study_that_requires_the_whole_standard(few: tuple[Path, str], tmp_path: Path) -> None:
    """By its bare name; a study without such a requirement has no such section and no such column."""
    folder, _ = few
    out = good("rank", "out", "--require", ROAD_EDGE, cwd=folder)
    assert f"breaks {ROAD_EDGE} >= 1 by 100 %" in " ".join(out.split())
    plain = "\n".join(line for line in STUDY.splitlines() if not line.startswith("require"))
    (tmp_path / "plain.toml").write_text(plain, encoding="utf-8")
    good("run", "plain.toml", "-o", "out", "--workers", 1, cwd=tmp_path)
    assert "standards" not in (page := page_at(tmp_path / "out" / "report.html")).text
    assert not re.search("river torque|once parallel|verridden|hand-over", " ".join(page.text.values()))
    table = (tmp_path / "out" / "ranking.csv").read_text(encoding="utf-8")
    assert not any(word in table for word in ("euroncap", "driver_torque", "against_", "overridden", "handover"))
    assert "ranking.require: 'acceptable' needs a driver" in bad("rank", "out", "--require", "acceptable", cwd=tmp_path)


@pytest.mark.parametrize(
    "tables",
    [
        f'[ranking]\nfinalists = 0\nrequire = ["{ROAD_EDGE}"]\n[search]\ntrials = 4\nbatch = 2',
        f'[ranking]\nfinalists = 0\n[search]\ntrials = 4\nbatch = 2\nobjectives = ["S", "{ROAD_EDGE}"]',
        f'[ranking]\nfinalists = 0\npareto = ["S", "{ROAD_EDGE}"]',
    ],
    ids=["requirement of a search", "objective", "front"],
)
def test_standards_are_metrics_like_others(tables: str, tmp_path: Path) -> None:
    y_s = "{ from = -0.5, to = 0.2 }" if "search" in tables else "[-0.4, 0.2]"
    text = f'name = "s"\n[scenarios]\nleft = 5\nright = 5\n{tables}\n[[design]]\nlaw = "lqr"\ny_s = {y_s}\n'
    (tmp_path / "s.toml").write_text(text, encoding="utf-8")
    good("run", "s.toml", "-o", "out", "--workers", 1, "--no-robustness", cwd=tmp_path)
    shares = {row["euroncap_2026_elk_road_edge_share"] for row in rows(tmp_path / "out" / "ranking.csv")}
    assert "1.0" in shares
    assert len(shares) > 1


@dataclasses.dataclass(frozen=True)
class Picky(Controller):
    name = "picky"
    title = "Picky"

    def prepare(self, plant: Plant) -> LinearLaw:
        if plant.n == 36:  # the cells of the road edge test
            raise RuntimeError("36 is no number")
        law = controllers.LQR().prepare(plant)
        assert isinstance(law, LinearLaw)
        return law


def test_a_law_that_raises_in_a_test_is_a_sentence_of_the_report(tmp_path: Path) -> None:
    content = {"name": "s", "scenarios": {"left": 5, "right": 5}, "ranking": {"finalists": 0, "require": [ROAD_EDGE]}}
    content |= {"design": [{"law": "none"}, {"law": "picky", "y_s": -0.4}]}
    with known(Picky):
        run_study(Study.from_dict(content), directory=tmp_path / "out", workers=1, progress=False)
        good("report", "out", "--no-robustness", cwd=tmp_path)
    page = page_at(tmp_path / "out" / "report.html")
    assert f"{ROAD_EDGE}: law 'picky' in {ROAD_EDGE}: RuntimeError: 36 is no number" in page.words("standards")


def judged(folder: Path, content: dict[str, Any]) -> tuple[list[Light], tuple[str, ...]]:
    """Lights of the tail, and warnings."""
    study = Study.from_dict(content | {"ranking": {"bootstrap": 100, "finalists": 0}})
    results = run_study(study, directory=folder / "run", workers=1, progress=False)
    ranking = rank_study(results, study)
    lights = verdict(ranking, results, study.setup()).lights
    return [light for light in lights if light.name == "Tail"], ranking.warnings


def beside_no_control(design: dict[str, Any]) -> dict[str, Any]:
    """On the ideal plant, 2,000 departures to either side."""
    scenarios = {"model": "reference", "left": 2000, "right": 2000}
    return load_study("ideal").content() | {"scenarios": scenarios, "design": [{"law": "none", "y_s": 0.2}, design]}


def test_the_papers_law_is_worse_than_nothing_in_the_tail(tmp_path: Path) -> None:
    gains = {"K_y": -0.005, "K_psi": -0.2, "T_lp": 2.0}
    content = beside_no_control({"law": "preview_proportional", "y_s": 0.2, "gains": gains})
    (light,), warnings = judged(tmp_path, content)
    text = "orse than no control beyond 0.8 m: 73 of 4,000 departures get so deep, without control 33."
    assert (light.state, light.text) == ("bad", f"W{text}")
    assert f"Preview P, y_s=0.2 m is w{text}" in warnings


RESIDUALS = {"name": "s", "scenarios": {"left": 1000, "right": 1000}, "plant": {"residuals": {"y": True}}}


@pytest.mark.parametrize(
    "content",
    [
        beside_no_control({"law": "lqr", "y_s": 0.1, "gains": {"r_delta": 20_000.0}}),
        RESIDUALS | {"design": [{"law": "lqr", "y_s": 3.0}]},
    ],
    ids=["a good law", "a law that never acts, with residuals and without a design that has no control"],
)
def test_a_tail_that_is_no_worse_has_no_light(content: dict[str, Any], tmp_path: Path) -> None:
    lights, warnings = judged(tmp_path, content)
    assert lights == []
    assert not any("0.8 m" in warning for warning in warnings)


def test_studies_of_the_catalog_keep_their_identity() -> None:
    """A new key with its default changes none of them; only other designs do."""
    names = ("trigger-and-gains", "paper", "zoo")
    assert [load_study(name).hash for name in names] == ["3604820c64b9861c", "58728126bcb38961", "50653dfb49815ae8"]


def test_a_trigger_by_time_is_another_study_and_a_steering_ratio_is_not() -> None:
    content = load_study("trigger-and-gains").content()

    def hash_of(**parts: Any) -> str:
        return Study.from_dict(content | {name: content[name] | given for name, given in parts.items()}).hash

    assert hash_of() == hash_of(vehicle={"steering_ratio": 17.5}) == "3604820c64b9861c"
    driver = {"driver": {"straight": 1.0}}
    assert len({hash_of(plant=driver, vehicle={"steering_ratio": ratio}) for ratio in (15.0, 17.5)}) == 2
    by_time = {ttlc: hash_of(simulation={"trigger": "ttlc", "ttlc": ttlc}) for ttlc in (1.0, 0.8)}
    assert len({"3604820c64b9861c", *by_time.values()}) == 3
