"""``ldc review`` and the listing of ``ldc controllers``."""

import json
import re
from pathlib import Path

import pytest

from helpers.cli import bad, good, ldc, printed_rows
from ldctoolkit import LinearLaw, Plant
from ldctoolkit.controllers import LQR
from ldctoolkit.studies import Study, run_study
from ldctoolkit.studies.cli import main

STUDY = """
name = "tiny"
[scenarios]
left = 6
right = 6
[simulation]
plant_knowledge = "ideal"
[plant.actuator]
lag = 0.1
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [0.1, 0.2]
[design.gains]
r_delta = [30.0, 30000.0]
"""


def reviewed(code: int, *arguments: object, cwd: Path) -> str:
    done = ldc("review", *arguments, cwd=cwd)
    assert done.returncode == code, (done.stdout, done.stderr)
    assert done.stderr == ""
    return done.stdout


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "s.toml").write_text(STUDY, encoding="utf-8")
    return tmp_path


def test_a_sound_law(tmp_path: Path) -> None:
    out = reviewed(0, "lqr", "--gain", "r_delta=50", "--gain", "q_y=2", cwd=tmp_path)
    assert out.startswith("LQR, r_delta=50, q_y=2, dt = 0.05 s")
    assert out.count("│") >= 13 * 2
    assert out.endswith("no findings\n")


@pytest.mark.parametrize(
    ("words", "code", "sentence"),
    [
        # slow growth is printed with enough digits to differ from 1
        ("preview_proportional --gain K_y=-0.02 --delay 0.2 --lag 0.1 --speed 30", 3,
         "fault: At 30 m/s the closed loop is unstable: a deviation grows by a factor of 1.029 a sample"),
        ("linear_mpc --speed 20:30 --points 2 --rate-max 0.1", 0,
         "warning: The law counts on rate_max = 0.2 rad/s, the actuator gives 0.1 rad/s"),
        ("none", 0, "there is no loop to review"),
    ],
)  # fmt: skip
def test_findings_of_a_law(words: str, code: int, sentence: str, tmp_path: Path) -> None:
    assert sentence in reviewed(code, *words.split(), cwd=tmp_path)


def test_arms_on_the_wheel_have_rows_below_their_design(folder: Path) -> None:
    held = STUDY.replace("[[design]]", "[plant.driver]\nstraight = 1.0\ngrip = [0.1, 0.4]\n[[design]]", 1)
    (folder / "held.toml").write_text(held, encoding="utf-8")
    out = reviewed(0, "held.toml", "--design", "LQR, y_s=0.1 m, r_delta=30000", "--json", "r.json", cwd=folder)
    (entry,) = json.loads((folder / "r.json").read_text(encoding="utf-8"))
    names = ["arms relaxed (g = 0.1)", "arms tensed (g = 0.4)"]
    assert list(entry["held"]) == names
    _, _, label, *rows = printed_rows(out.split("worst of all speeds")[1])
    assert label[0].startswith("LQR")
    assert [row[0] for row in rows] == names
    for row, loop in zip(rows, entry["held"].values(), strict=True):
        assert row[1] == f"{min(loop['gain_margin_dB']):.1f}"
        assert row[4:] == [f"{min(loop['damping']):.2f}", "–", "–", "", ""]  # noqa: RUF001


@pytest.mark.slow
def test_a_study_and_one_of_its_designs(folder: Path) -> None:
    """One review for each set of gains, on the study's plant; thresholds that share it are listed together."""
    out = reviewed(3, "s.toml", "--json", "r.json", cwd=folder)
    assert "LQR, y_s=0.1, 0.2 m, r_delta=30\nfault: " in out
    none, stiff, soft = entries = json.loads((folder / "r.json").read_text(encoding="utf-8"))
    assert [len(entry["ids"]) for entry in entries] == [1, 2, 2]
    assert ([entry["law"] for entry in entries], none["loop"]) == (["none", "lqr", "lqr"], {})
    assert "phase_margin" in {finding["name"] for finding in stiff["findings"] if finding["severity"] == "fault"}
    assert all(finding["severity"] != "fault" for finding in soft["findings"])
    assert len(soft["loop"]["v_m_s"]) == 13
    assert set(soft["loop"]["gain_margin_dB"]) != {None}
    assert set(soft["loop"]["stable"]) == {True}

    out = reviewed(0, "s.toml", "--design", soft["ids"][1], "--speed", "15:30", "--points", "4", cwd=folder)
    assert "LQR, y_s=0.2 m, r_delta=30000, dt = 0.05 s" in out
    assert reviewed(0, "s.toml", "--design", "LQR, y_s=0.1 m, r_delta=30000", "--lag", "0", cwd=folder)


def test_a_result_folder_says_what_its_results_say(folder: Path) -> None:
    """Without the results nothing would be wrong with this loop: the acceleration is what tyres cannot give."""
    hard = STUDY.replace("lag = 0.1", "lag = 0.0").replace("r_delta = [30.0, 30000.0]", "r_delta = [30.0]")
    (folder / "hard.toml").write_text(hard.replace("left = 6\nright = 6", "left = 60\nright = 60"), encoding="utf-8")
    assert ldc("run", "hard.toml", "-o", "hard", "--no-robustness", "--quiet", cwd=folder).returncode == 0
    out = reviewed(3, "hard", cwd=folder)
    assert re.search(
        r"fault: In the stored results a_y reaches [\d.]+ m/s\^2 \([\d.]+ g\), friction allows 9.81 m/s\^2", out
    )
    assert "no findings" not in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["lqq"], "'lqq' is neither a law nor a study; did you mean 'lqr'?"),
        ([], "required: DESIGN"),
        (["lqr", "--gain", "r_delt=2"], "lqr.r_delt: no such gain; did you mean 'r_delta'?"),
        (["lqr", "--gain", "r_delta=much"], "lqr.r_delta: 'much'; allowed: a number from 0.001 to 1e+06"),
        (["lqr", "--gain", "r_delta=0"], "lqr.r_delta: 0.0; allowed"),
        (["lqr", "--gain", "r_delta=1", "--gain", "r_delta=2"], "--gain r_delta: given 2 times"),
        (["lqr", "--gain", "r_delta"], "allowed: NAME=..."),
        (["lqr", "--design", "x"], "--design: needs a study"),
        (["lqr", "--speed", "30:20"], "allowed: LOW:HIGH"),
        (["lqr", "--speed", "20:200"], "'20:200'; allowed: LOW:HIGH, or one speed, 1 <= LOW <= HIGH <= 90 [m/s]"),
        (["lqr", "--points", "1"], "allowed: a whole number from 2 to 1000"),
        (["lqr", "--dt", "0"], "allowed: a finite number > 0"),
        (["lqr", "--delay", "-1"], "actuator.delay: -1.0; allowed"),
        (["lqr", "--json", "x.txt"], "error: --json x.txt: the name must end in .json"),
        (["a" * 300], "is neither a law nor a study"),
        (["lqr", "--dt", "1e-6", "--delay", "0.05"], "actuator.delay: 0.05 s is 50000 samples of 1e-06 s; allowed"),
        (["s.toml", "--speed", "0.5:20"], "'0.5:20'; allowed: LOW:HIGH"),
        (["lqr", "--json", "nowhere/x.json"], "the folder nowhere does not exist"),
        (["none.toml"], "none.toml: cannot be read"),
        (["s.toml", "--gain", "r_delta=1"], "--gain: needs the name of a law"),
        (["s.toml", "--design", "x"], "--design 'x': no such design"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_arguments_get_one_message(arguments: list[str], message: str, folder: Path) -> None:
    assert message in bad("review", *arguments, cwd=folder)


def test_the_number_of_speeds_counts_without_their_range(tmp_path: Path) -> None:
    reviewed(0, "lqr", "--points", "4", "--json", "r.json", cwd=tmp_path)
    (entry,) = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert entry["loop"]["v_m_s"] == [10.0, 20.0, 30.0, 40.0]


@pytest.mark.slow
def test_the_convention_of_a_study_is_reviewed(folder: Path) -> None:
    both = STUDY.replace("[simulation]", '[simulation]\nconvention = "as_printed"', 1)
    (folder / "printed.toml").write_text(both, encoding="utf-8")
    reviewed(3, "s.toml", "--json", "s.json", cwd=folder)
    reviewed(3, "printed.toml", "--json", "printed.json", cwd=folder)
    one, two = (json.loads((folder / f"{name}.json").read_text(encoding="utf-8")) for name in ("s", "printed"))
    assert [entry["design"] for entry in two] == [entry["design"] for entry in one]
    assert two[2]["loop"]["gain_margin_dB"] != one[2]["loop"]["gain_margin_dB"]


@pytest.mark.slow
def test_a_design_that_raises_does_not_hide_the_others(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prepare = LQR.prepare

    def exiting(self: LQR, plant: Plant) -> LinearLaw:
        if self.r_delta == 30.0:
            raise SystemExit(3)
        return prepare(self, plant)

    monkeypatch.setattr(LQR, "prepare", exiting)
    out = reviewed(3, "s.toml", "--json", "r.json", cwd=folder)
    assert "fault: No review: controller 'lqr': prepare raised SystemExit: 3" in out
    entries = json.loads((folder / "r.json").read_text(encoding="utf-8"))
    faults = [[f["name"] for f in entry["findings"] if f["severity"] == "fault"] for entry in entries]
    assert faults == [[], ["raises"], []]
    assert len(entries[2]["loop"]["v_m_s"]) == 13


@pytest.mark.slow
def test_labels_are_no_markup(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LQR, "title", "a [b]c[/b] [/x] :smile:")
    assert reviewed(0, "lqr", "--speed", "20", cwd=folder).count("a [b]c[/b] [/x] :smile:") == 1
    assert reviewed(3, "s.toml", cwd=folder).count("a [b]c[/b] [/x] :smile:") == 4


def test_numbers_stand_under_their_headings_in_their_units(tmp_path: Path) -> None:
    arguments = ("--gain", "r_delta=30000", "--lag", "0.1", "--speed", "30", "--json", "r.json")
    headings, units, row = printed_rows(reviewed(0, "lqr", *arguments, cwd=tmp_path))
    assert {f"{a} {b}".strip(): c for a, b, c in zip(headings, units, row, strict=True)} == {
        "v [m/s]": "30", "slowest pole [s]": "1.1", "damping": "0.69", "gain margin [dB]": "26.9",
        "phase margin [deg]": "62.0", "delay margin [ms]": "547", "disk margin": "1.10", "crossover [rad/s]": "1.98",
        "e_y in a bend [m]": "0.000",  # without the sign that rounding leaves
        "other tyres [m]": "-0.520",
    }  # fmt: skip
    (entry,) = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    (finding,) = entry["findings"]
    assert (finding["severity"], finding["name"], finding["allowed"]) == ("warning", "bend_mismatched", 0.3)
    assert finding["value"] == pytest.approx(0.520, abs=5e-4)
    assert entry["loop"].pop("hessian_condition") == [None]
    assert entry["loop"].pop("gain_reduction_margin_dB") == ["inf"]
    assert {name: pytest.approx(value, rel=1e-3, abs=1e-9) for name, (value,) in entry["loop"].items()} == {
        "v_m_s": 30.0, "bend_rad_s": 2 / 30, "stable": True, "radius": 0.95539, "damping": 0.69163,
        "slowest_s": 1.09576, "gain_margin_dB": 26.949, "phase_margin_rad": 1.08276, "delay_margin_s": 0.54749,
        "disk_margin": 1.10371, "crossover_rad_s": 1.97766, "bandwidth_rad_s": 1.97722, "e_y_bend_m": 0.0,
        "e_y_bend_mismatched_m": -0.52047, "bend_error": 0.0,
    }  # fmt: skip


def test_an_overview_holds_the_worst_of_all_speeds(folder: Path) -> None:
    """Speeds of 10 and 40 m/s: margins are least at one end, offsets largest at the other."""
    out = reviewed(3, "s.toml", "--speed", "10:40", "--points", "2", cwd=folder)
    headings, units, *rows = printed_rows(out)
    assert [f"{a} {b}".strip() for a, b in zip(headings, units, strict=True)] == [
        "design", "gain margin [dB]", "phase margin [deg]", "disk margin", "damping", "e_y in a bend [m]",
        "other tyres [m]", "faults", "warnings",
    ]  # fmt: skip
    assert rows == [
        ["No control, y_s=0.2 m", *["–"] * 6, "0", "0"],  # noqa: RUF001
        ["LQR, y_s=0.1, 0.2 m, r_delta=30", "4.1", "1.2", "0.02", "0.01", "0.000", "∞", "6", "2"],
        ["LQR, y_s=0.1, 0.2 m, r_delta=30000", "24.2", "46.1", "0.84", "0.65", "0.000", "0.442", "0", "1"],
    ]
    for sentence in (
        "fault: At 40 m/s the loop gets unstable if its gain shrinks by 2.3 dB; allowed: at least 6 dB (so at 1 of 2",
        "fault: At 40 m/s the loop has a phase margin of 1.16 deg; allowed: at least 30 deg",
        "fault: At 40 m/s the loop stands no more additional delay than 2.55 ms; allowed: at least 50 ms",
        "fault: At 40 m/s the closed loop has a damping ratio of 0.012; allowed: at least 0.3",
        "warning: At 40 m/s the slowest pole of the closed loop has a time constant of 10.5 s; allowed: at most 10 s",
    ):
        assert sentence in out


def test_the_listing_of_laws_says_everything(tmp_path: Path) -> None:
    out = good("controllers", "lqr", "linear_mpc", "none", cwd=tmp_path)
    assert "lqr: LQR, linear law" in out
    assert "linear_mpc: Linear MPC, steering law" in out
    assert "none: No control, recorded path, no gains" in out
    row = next(line for line in out.splitlines() if "r_delta" in line)
    cells = [cell.strip() for cell in re.split("[│┃]", row)][1:-1]
    assert cells == ["r_delta", "1/rad^2", "20000.0", "0.001 .. 1e+06", "log", "weight on delta^2"]


def test_a_design_of_a_search_is_reviewed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Such a study has no designs of its own: those of its results are reviewed."""
    pytest.importorskip("optuna")
    block = {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": {"from": 50, "to": 5000, "count": 9}}}
    study = {"name": "s", "scenarios": {"left": 6, "right": 6}, "search": {"trials": 2, "batch": 2}, "design": [block]}
    results = run_study(Study.from_dict(study | {"ranking": {"finalists": 0}}), tmp_path / "s", workers=1)
    label = results.designs[1].label
    assert main(["review", str(tmp_path / "s"), "--design", label]) in (0, 3)
    assert label in capsys.readouterr().out


def test_a_plan_is_drawn(folder: Path) -> None:
    """Of one predictive design, over what came of it; others are named before any work is done."""
    out = reviewed(0, "nonlinear_mpc", "--gain", "horizon=8", "--speed", "20", "--plan", "plan.svg", cwd=folder)
    assert out.endswith("written to plan.svg\n")
    drawing = (folder / "plan.svg").read_text(encoding="utf-8")
    assert drawing.startswith("<svg")
    assert all(text in drawing for text in ("planned at the trigger", "driven", "Edge beyond the line"))
    assert "lqr" in bad("review", "lqr", "--plan", "other.svg", cwd=folder)
    assert "--design" in bad("review", "s.toml", "--plan", "other.svg", cwd=folder)
    assert not (folder / "other.svg").exists()
