"""``ldc init``: a commented study file from the catalog or from answers; ``ldc run`` without a study."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from helpers.cli import bad, good, ldc
from helpers.closed_loop import ZOO
from helpers.recordings import OFFSET, drive, frame_of
from ldctoolkit import controller_class, load_model
from ldctoolkit.studies.study_file import Study, catalog_names, load_study

KEY = re.compile(r"# (\w+ = .*)")


def keys_of(table: dict[str, Any]) -> dict[str, Any]:
    """The keys of a study file as a tree, without the designs."""
    return {
        key: keys_of(value) if isinstance(value, dict) and key != "given" else None
        for key, value in table.items()
        if key != "design"
    }


@pytest.mark.parametrize("name", catalog_names())
def test_a_file_from_the_catalog_is_its_study(name: str, tmp_path: Path) -> None:
    out = good("init", name, "-o", "mine.toml", cwd=tmp_path)
    assert out == "study file written to mine.toml\nrun it with: ldc run mine.toml\n"
    written, catalog = load_study(tmp_path / "mine.toml"), load_study(name)
    assert written.hash == catalog.hash
    assert written.content() == catalog.content() | {"name": "mine"}
    good("init", name, cwd=tmp_path)
    assert load_study(tmp_path / f"{name}.toml").ranked_as == catalog.ranked_as


def test_every_key_is_there_with_a_comment(tmp_path: Path) -> None:
    good("init", "trigger-and-gains", "-o", "s.toml", cwd=tmp_path)
    text = (tmp_path / "s.toml").read_text(encoding="utf-8")
    lines = text.splitlines()
    assert lines[0].startswith("# When to step in, and how hard: ")
    assert all("  # " in line for line in lines if KEY.fullmatch(line) or (line and line[0] != "#"))
    whole = re.sub(r"^# (?=\[search\]|\w+ = )", "", text, flags=re.M)
    everything = Study.from_dict(
        {"name": "s", "search": {}, "design": [{"law": "none"}], "plant": {"sensors": {"kalman": {}}}}
    )
    content = everything.content()
    content["vehicle"]["model"] = None
    assert keys_of(tomllib.loads(whole)) == keys_of(content)
    for line in (
        "lag = 0.1                                 # [s] time constant; 0 for none; from 0 to 10; default 0.0",
        "rate_max = 0.33                           # [rad/s] limit of the steering rate; > 0; default none",
        "# m = 1000.0                              # [kg] mass; > 0; default 1000.0",
        "# confidence = 0.95                       # of the intervals, all designs together; > 0 and < 1; default 0.95",
        "# batch = 16                              # designs proposed at once; >= 1 and <= 10000; default 16",
        "# T_lp = { from = 1.0, to = 4.0, count = 5 }  # [s] preview time; from 0 to 10; default 2.0",
        '# q_y = { from = 0.1, to = 10.0, count = 5, scale = "log" }'
        "  # [1/m^2] weight on e_y^2; from 1e-06 to 1e+06; default 1.0",
    ):
        assert line in lines, line


def test_what_is_commented_out_is_the_default(tmp_path: Path) -> None:
    for name in catalog_names():
        good("init", name, "-o", "s.toml", "--force", cwd=tmp_path)
        catalog = load_study(name)
        head, _, designs = (tmp_path / "s.toml").read_text(encoding="utf-8").partition("[[design]]")
        settings = re.sub(r"\n# \[plant.sensors.kalman\].*(\n# .*)+", "", head.partition("# [search]")[0])
        lines = (x if x.endswith("default none") else KEY.sub(r"\1", x) for x in settings.splitlines())
        study = Study.from_dict(tomllib.loads("\n".join([*lines, f"[[design]]{designs}"])))
        assert study.ranked_as == catalog.ranked_as


def test_every_gain_can_be_swept(tmp_path: Path) -> None:
    """One after the other; a number with a range makes several designs."""
    laws = [law for law in ZOO if law != "none"]
    good("init", *(word for law in laws for word in ("--law", law)), "-o", "s.toml", cwd=tmp_path)
    text = (tmp_path / "s.toml").read_text(encoding="utf-8")
    assert [design.law for design in load_study(tmp_path / "s.toml").designs] == ["none", *laws]
    for law in laws:
        before, _, after = text.partition(f'law = "{law}"')
        lines = [line for line in after.partition("[[design]]")[0].splitlines() if KEY.fullmatch(line)]
        assert [line.split()[1] for line in lines] == [gain.name for gain in controller_class(law).gains()]
        for line in lines:
            (tmp_path / "t.toml").write_text(f'{before}law = "{law}"{after.replace(line, line[2:], 1)}')
            swept = [design for design in load_study(tmp_path / "t.toml").designs if design.law == law]
            assert len(swept) == (5 if "from = " in line else 1), line


def test_a_study_from_answers_runs(tmp_path: Path) -> None:
    load_model("reference").save(tmp_path / "model.json")
    (tmp_path / "studies").mkdir()
    good(
        "init", "--law", "lqr", "--law", "preview_proportional", "--y-s", "0.1", "0.2", "--model", "model.json", "-n",
        "9", "--require", "a_y_peak_p95 <= 3.0", "--plant", "ideal", "--name", "first", "-o", "studies/one.toml",
        cwd=tmp_path,
    )  # fmt: skip
    study = load_study(tmp_path / "studies/one.toml")
    assert (study.name, study.title, study.ranking.require) == ("first", "", ("a_y_peak_p95 <= 3",))
    assert [(design.law, design.y_s) for design in study.designs] == [
        ("none", 0.2), ("lqr", 0.1), ("lqr", 0.2), ("preview_proportional", 0.1), ("preview_proportional", 0.2),
    ]  # fmt: skip
    assert (study.scenarios.model, study.scenarios.left, study.scenarios.right) == ("../model.json", 5, 4)
    assert study.plant.ideal
    assert (tmp_path / "studies/one.toml").read_text(encoding="utf-8").startswith("# Run it with: ldc run one.toml\n")
    good("run", "studies/one.toml", "--workers", "1", "--no-robustness", "--no-figures", "--quiet", cwd=tmp_path)
    assert (tmp_path / "out/first/report.html").exists()


def test_without_a_model_recorded_departures_are_replayed(tmp_path: Path) -> None:
    frame_of([drive(), drive("b", lane_offset=-OFFSET)]).write_csv(tmp_path / "r.csv")
    good("extract", "r.csv", "--vehicle-width", "1.8", "-o", "d.parquet", cwd=tmp_path)
    answers = ("init", "--law", "lqr", "--departures", "d.parquet")
    good(*answers, "-o", "alone.toml", cwd=tmp_path)
    alone = load_study(tmp_path / "alone.toml").scenarios
    assert (alone.model, alone.departures, alone.left, alone.right) == ("", "d.parquet", None, None)
    good("run", "alone.toml", "--workers", "1", "--no-robustness", "--no-figures", "--quiet", cwd=tmp_path)
    good(*answers, "-n", "1000", "-o", "alone.toml", "--force", cwd=tmp_path)
    assert load_study(tmp_path / "alone.toml").scenarios.counts == (500, 500)  # the default beside a model
    good(*answers, "--model", "reference", "-o", "both.toml", cwd=tmp_path)
    both = load_study(tmp_path / "both.toml").scenarios
    assert (both.model, both.departures, both.left, both.right) == ("reference", "d.parquet", 250, 250)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "init: give a study of the catalog, --law or --data-sheet; allowed: driver, ideal, my-vehicle, paper, "),
        (["papr"], "study: 'papr' is not in the catalog; did you mean 'paper'?"),
        (["there.toml"], "study: 'there.toml' is not in the catalog"),
        (["--law", "lqq"], "did you mean 'lqr'?"),
        (["--law", "lqr", "--plant", "idea"], "study: 'idea' is not in the catalog; did you mean 'ideal'?"),
        (["--law", "lqr", "--y-s", "-11"], "my-study.toml: design[1].y_s: -11.0; allowed: a finite number >= -10 m"),
        (["--law", "lqr", "--require", "a_y_peak_p59 <= 3"], "my-study.toml: ranking.require: "),
        (["--law", "lqr", "--model", "none.json"], "none.json"),
        (["--law", "lqr", "--model", "referenc"], "did you mean 'reference'?"),
        (["--law", "lqr", "--departures", "none.parquet"], "none.parquet"),
        (["--law", "lqr", "--name", "a b"], "a b.toml: name: 'a b'; allowed: up to 80 letters"),
        (["ideal", "-o", "there.toml"], "there.toml: exists already; allowed: another -o, or --force to replace it"),
        (["ideal", "-o", "s.txt"], "-o s.txt: the name must end in .toml"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_wrong_answers_get_one_message(arguments: list[str], message: str, tmp_path: Path) -> None:
    (tmp_path / "there.toml").write_text("mine")
    assert message in bad("init", *arguments, cwd=tmp_path)


def test_run_without_a_study_names_the_next_step(tmp_path: Path) -> None:
    done = ldc("run", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "ldc: error: STUDY is missing: a name in the catalog, or a TOML file\n"
        "  in the catalog: driver, ideal, my-vehicle, paper, paper-as-printed, reality, road-edge, trigger-and-gains, "
        "zoo, zoo-sweep\n"
        "  ldc run trigger-and-gains                runs one of them\n"
        "  ldc init trigger-and-gains -o my.toml    writes it to a file, with a comment at every key\n"
        "  ldc run my.toml                          runs that file\n"
    )
