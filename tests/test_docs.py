"""Documentation: examples run, links hold."""

import dataclasses
import doctest
import importlib
import inspect
import itertools
import json
import re
import shlex
import sys
import tomllib
import types
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import ldctoolkit
from helpers.cli import ROOT, blocks, python, run_python
from helpers.closed_loop import Stepped
from helpers.pasted import commands, run_page
from ldctoolkit import Scenarios, controller_class, controllers, register, registry, simulate, studies
from ldctoolkit.metrics import METRIC_UNITS, METRICS
from ldctoolkit.plant_options import KalmanFilter, PlantOptions
from ldctoolkit.studies import Study
from ldctoolkit.studies.cli import parser
from ldctoolkit.testing import contract_faults


def test_the_readmes_python_runs_as_a_script(tmp_path: Path) -> None:
    (tmp_path / "readme.py").write_text(blocks("README.md", "python")[1])
    assert "shape: (7, 5)" in python("readme.py", cwd=tmp_path)  # no control, and three designs at two thresholds
    assert [path.name for path in tmp_path.iterdir()] == ["readme.py"]


def test_the_readmes_first_lines_print_what_stands_below_them(tmp_path: Path) -> None:
    (tmp_path / "first.py").write_text(blocks("README.md", "python")[0])
    assert python("first.py", cwd=tmp_path).strip() == blocks("README.md", "text")[0].strip()


def test_the_readmes_pictures_are_there_for_light_and_dark() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    pictures = re.findall(r'srcset="([^"]+)">\n  <img src="([^"]+)" width="\d+%" alt="([^"]+)">', text)
    assert len(pictures) == text.count("<img ") == 3
    for dark, light, words in pictures:
        assert Path(dark).stem == Path(light).stem + "-dark"
        assert len(words.split()) > 8
        for name in (dark, light):
            assert 5_000 < (ROOT / name).stat().st_size < 60_000
    committed = {path.name for path in (ROOT / "docs/_pictures").iterdir()}
    assert committed == {Path(name).name for dark, light, _ in pictures for name in (dark, light)}


@pytest.mark.slow  # the extra `docs` is not there before the longer tier
def test_a_drawing_for_the_dark_has_light_words_and_the_same_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    darkened = importlib.import_module("pictures").darkened
    drawn = '<path id="m1" style="fill: #ffffff; stroke: #000000"/><use style="fill: #767676; stroke: #d55e00"/>'
    assert darkened(drawn) == (
        '<path id="m1" style="fill: #141414; stroke: #f0f0f0"/><use style="fill: #8a8a8a; stroke: #d55e00"/>'
    )
    assert darkened("#0072b2") == "#59a3cd"  # a dark blue is lighter


def test_the_gallery_shows_each_example_once() -> None:
    text = (ROOT / "docs/gallery/index.md").read_text(encoding="utf-8")
    cards = re.findall(r"^- \[.+\]\((.+)\.md\) .+$", text, flags=re.M)
    pages = {path.stem for path in (ROOT / "docs/gallery").glob("*.md")} - {"index"}
    assert len(cards) == len(set(cards)) >= 12
    assert set(cards) == pages


PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in (ROOT / "docs").rglob("*.md")
    if not path.parts[-2].endswith("generated")
)
WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]  # make docs executes the tutorial and the gallery
# the laws of a guide are a package: tests/test_third_party.py installs and runs it
WITH_COMMANDS = [page for page in ("README.md", *PAGES) if page != "docs/how-to/my-law.md" and commands(page)]
LONG = (
    "docs/gallery/",
    "docs/how-to/coming",
    "docs/how-to/reading",
    "docs/explanation/risk",
    "docs/explanation/mpc",
    "docs/how-to/my-mpc",
)
PRINTED = {
    "docs/explanation/closed-loop.md": 7,
    "docs/explanation/plant-options.md": 1,
    "docs/explanation/driver.md": 1,
    "docs/how-to/my-fmu.md": 3,
    "docs/reference/metrics.md": 4,
    "docs/how-to/reviewing-a-design.md": 2,
}


def test_the_site_stays_small() -> None:
    assert len(PAGES) <= 65


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=pytest.mark.slow if page.startswith(LONG) else ()) for page in WITH_PYTHON]
)
def test_a_pages_python_runs_by_itself(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path, only_python=True)
    if page in PRINTED:
        printed = capsys.readouterr().out
        assert len(printed.splitlines()) == PRINTED[page]
        assert "nan" not in printed


@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_a_page_runs_as_a_user_pastes_it(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python and commands in the order of the page, each with the files that those before it left."""
    monkeypatch.chdir(tmp_path)
    run_page(page, tmp_path)


@pytest.mark.parametrize("page", ["README.md", *PAGES])
def test_commands_and_study_files_of_a_page_are_read(page: str, tmp_path: Path) -> None:
    for text in blocks(page, "toml"):
        table = tomllib.loads(text)
        if "metrics" in table:
            (tmp_path / "my_metrics.py").write_text(blocks(page, "python")[0], encoding="utf-8")
        if "wheelbase" in table:
            ldctoolkit.VehicleParameters.from_data_sheet(**table)
        elif "project" not in table and "offset" not in text:  # a package, and a study with the guide's own law
            Study.from_dict({"name": "page", "design": [{"law": "none"}]} | table, folder=tmp_path)
    for line in commands(page):
        words = shlex.split(line.partition(" > ")[0], comments=True)
        parser().parse_args(words[1:])


def anchors(page: Path) -> set[str]:
    """What the headings of a page are called in links, as Sphinx and GitHub call them."""
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return {
        re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in re.findall(r"^#+ (.+)$", text, flags=re.M)
    }


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", *PAGES])
def test_links_hold(page: str) -> None:
    path = ROOT / page
    text = path.read_text(encoding="utf-8")
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        target, _, anchor = link.partition("#")
        to = path if not target else path.parent / target
        assert to.exists(), link
        assert not anchor or anchor in anchors(to) or anchor.startswith("ldc-"), link


def test_paths_of_pages_in_code_exist() -> None:
    files = [
        file
        for folder in ("ldctoolkit", "controllers", "studies", "tests", "tools")
        for file in (ROOT / folder).rglob("*")
    ]
    for file in (ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "Makefile", *files):
        if file.suffix in (".py", ".md", ".toml", ".html", ".js", ".c", ".h", "") and file.is_file():
            for page in re.findall(r"\bdocs/[\w/-]+\.md", file.read_text(encoding="utf-8")):
                assert (ROOT / page).exists(), (file, page)


def test_the_comparison_shows_what_was_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "tests/benchmarks/peers")
    job, run = (importlib.import_module(name) for name in ("job", "run"))
    results = json.loads(run.RESULTS.read_text(encoding="utf-8"))
    assert run.tables(results) in run.PAGE.read_text(encoding="utf-8")
    scripts = [run.HERE / f"{name}.py" for name in run.SCRIPTS]
    assert [one["lines"] for one in results["peers"]] == [job.lines(script) for script in scripts]
    assert [one["lines_shared"] for one in results["peers"]] == [0, *[job.lines(run.HERE / "job.py")] * 3]
    assert run.far(results) == []
    results["peers"][1]["mean_S"]["lqr"] *= 1.00002
    (far,) = run.far(results)
    assert far.startswith("do-mpc + NumPy, LQR: mean S 2.15708")


def test_public_sources_are_the_same_on_the_page_and_at_the_command_line() -> None:
    page = (ROOT / "docs/how-to/public-recordings.md").read_text(encoding="utf-8").replace("`", "")
    rows = [[re.sub(r"\[|\].*", "", cell).strip() for cell in row.split("|")] for row in page.splitlines()]
    for source in tomllib.loads((ROOT / "studies/cli/public_sources.toml").read_text(encoding="utf-8"))["source"]:
        (row,) = (row for row in rows if source["source"] in row[1:2])
        assert row[2:6] == [source[key] for key in ("licence", "format", "departures", "trips")]


def test_every_public_name_is_in_the_reference() -> None:
    text = (ROOT / "docs/reference/index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^   ldctoolkit\.([\w.]+)$", text, flags=re.M))
    of_studies = {f"studies.{name}" for name in studies.__all__ if name not in ldctoolkit.__all__}
    assert set(controllers.__all__) <= set(ldctoolkit.__all__)
    assert listed == set(ldctoolkit.__all__) - {"__version__", "controllers", "studies"} | of_studies
    for name in ("`ldctoolkit.__version__`", "`ldctoolkit.controllers`", "`ldctoolkit.studies`"):
        assert name in text


def test_the_reference_is_made_of_the_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs/_ext")
    importlib.import_module("generated").write(tmp_path)
    made = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    included = [
        re.findall(r"^```\{include\} _generated/(.+)$", (ROOT / page).read_text(), flags=re.M) for page in PAGES
    ]
    assert sorted(made) == sorted(itertools.chain(*included))  # each on one page, once
    assert "| `--bound NAME=LOW:HIGH` | bounds of one parameter in SI units" in made["ldc-fit.md"]
    keys = made["study-keys.md"]
    assert "| `simulation.settle` | `3.0` | [s] how long the loop goes on after the departure; " in keys
    assert "| `ranking.confidence` | `0.95` | of the intervals, all designs together; > 0 and < 1 |" in keys
    assert "| `vehicle.m` | `1000.0` | [kg] mass; > 0 |" in keys
    assert "| `plant.actuator.lag` | `0.0` | [s] time constant; 0 for none; from 0 to 10 |" in keys
    assert "| `name` | needed | short name, " in keys
    assert "\n| `design.sample.count` |" in keys
    assert "| `r_delta` | 1/rad^2 | `20000.0` | 0.001 .. 1e+06 | weight on delta^2 |" in made["law-lqr.md"]
    assert "| `a_y_added_peak` | Peak added a_y | m/s^2 | less | interventions | 3 |" in made["scenario-metrics.md"]
    assert not re.search(r"\| *\|$", keys, flags=re.M)  # every key has a meaning
    for name in METRICS:
        assert f"\n| `{name}` | " in made["design-metrics.md"]


@pytest.mark.parametrize("page", ["docs/explanation/plant-options.md", "docs/explanation/driver.md"])
def test_the_toml_of_the_plant_options_is_its_python(page: str) -> None:
    (code, *_), (text,) = blocks(page, "python"), blocks(page, "toml")
    scope: dict[str, object] = {"__name__": "page"}
    exec(compile(code.partition("scenarios =")[0], page, "exec"), scope)
    study = Study.from_dict({"name": "page", "design": [{"law": "none"}], **tomllib.loads(text)})
    assert isinstance(scope["options"], PlantOptions)
    assert study.plant == scope["options"]


def test_metrics_names_every_companion() -> None:
    text = (ROOT / "docs/reference/metrics.md").read_text(encoding="utf-8")
    for name, unit in METRIC_UNITS.items():
        row = re.search(rf"^\| `{name}` \| ([^|]+) \|", text, flags=re.M)
        assert row, name
        assert row[1].strip() == unit.replace("^2", "²").replace("^3", "³"), name


def test_plant_options_names_every_field() -> None:
    text = (ROOT / "docs/explanation/plant-options.md").read_text(encoding="utf-8")
    tables: list[type] = [KalmanFilter]
    for field in dataclasses.fields(PlantOptions):
        assert f"## `{field.name}`" in text, field.name
        if dataclasses.is_dataclass(value := getattr(PlantOptions(), field.name)):
            tables.append(type(value))
    for table in tables:
        for field in dataclasses.fields(table):
            assert f"`{field.name}`" in text, field.name


@pytest.fixture
def guide() -> Iterator[types.ModuleType]:
    """The controllers of the guide, in a module of their own (dataclasses look their module up)."""
    module = types.ModuleType("guide")
    sys.modules["guide"] = module
    run_python("docs/how-to/my-law.md", module.__dict__)
    yield module
    del sys.modules["guide"]


SCENARIOS = Scenarios.from_arrays(T=[3.0, 5.0], d_y=[0.5, 0.6], v_mean=[25.0, 18.0], c_0=1e-3)


@pytest.mark.parametrize("name", ["Offset", "LimitedOffset"])
def test_the_guides_controllers_run(guide: types.ModuleType, name: str) -> None:
    design = getattr(guide, name)()
    out = simulate(design, SCENARIOS)
    assert (out.reduction > 0).all()
    assert np.isfinite(out.S).all()
    assert not out.failed_solves.any()
    try:
        assert controller_class(register(type(design)).name) is type(design)
    finally:
        registry.forget(design.name)
    assert contract_faults(design, checks=["batch", "take"]) == ()


def test_the_guides_laws_agree_without_integral_and_limit(guide: types.ModuleType) -> None:
    linear = simulate(Stepped(guide.Offset()), SCENARIOS)
    general = simulate(guide.LimitedOffset(K_i=0.0, delta_max=1.0), SCENARIOS)
    np.testing.assert_allclose(general.S, linear.S, rtol=0, atol=1e-12)  # same sums, another order
    assert (simulate(guide.LimitedOffset(), SCENARIOS).S != linear.S).all()


def modules_with_examples() -> list[str]:
    """Found by their text, so that collecting the tests imports nothing."""
    files = [path for package in ("ldctoolkit", "controllers", "studies") for path in (ROOT / package).rglob("*.py")]
    shown = [path.relative_to(ROOT).with_suffix("") for path in files if ">>>" in path.read_text(encoding="utf-8")]
    names = [".".join(path.parts).removesuffix(".__init__") for path in shown]
    return sorted(re.sub(r"^(controllers|studies)\b", r"ldctoolkit.\1", name) for name in names)


HEAVY = ("ldctoolkit.studies", "ldctoolkit.diagnostics", "ldctoolkit.scenario_model")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if name.startswith(HEAVY) else ()) for name in modules_with_examples()],
)
def test_examples_run(name: str) -> None:
    result = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert result.attempted
    assert result.failed == 0


@pytest.mark.parametrize("package", [ldctoolkit, controllers, studies], ids=lambda p: p.__name__)
def test_public_names_are_documented(package: object) -> None:
    for name in package.__all__:  # type: ignore[attr-defined]
        thing = getattr(package, name)
        if inspect.isclass(thing) or inspect.isfunction(thing):
            assert ">>>" in (inspect.getdoc(thing) or ""), f"{name} has no docstring with an example"
        if inspect.isfunction(thing):
            doc = inspect.getdoc(thing) or ""
            for parameter in inspect.signature(thing).parameters:
                assert parameter in doc, f"{name}: parameter {parameter} is not documented"
