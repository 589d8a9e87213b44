"""What a release claims: versions agree, templates ask for what repeats a ranking, ratios are those of the pages."""

import importlib.util
import json
import re
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from helpers.cli import ROOT, tool

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
TESTED = [line.rpartition(" ")[2] for line in PROJECT["classifiers"] if ":: Python :: 3." in line]
GITHUB = sorted(
    path.relative_to(ROOT).as_posix() for path in [*(ROOT / ".github").rglob("*.yml"), ROOT / ".pre-commit-config.yaml"]
)


def read(name: str) -> Any:
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def history() -> ModuleType:
    spec = importlib.util.spec_from_file_location("history", ROOT / "tests" / "benchmarks" / "history.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = read("CITATION.cff")
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Zhao", "Wang", "LeBlanc"]
    assert paper["title"] in " ".join(text("docs/explanation/index.md").split())


def test_claimed_interpreters_are_those_that_are_tried() -> None:
    assert TESTED == ["3.11", "3.12", "3.13"]
    assert f"for version in {' '.join(TESTED)}; do" in text(".ci/run")
    jobs = read(".github/workflows/ci.yml")["jobs"]
    for name in ("default", "installed"):
        matrix = jobs[name]["strategy"]["matrix"]
        assert matrix["python"] == TESTED
        assert matrix["os"] == ["ubuntu-latest", "macos-latest", "windows-latest"]
    assert f"Python {TESTED[0]} to {TESTED[-1]}" in text("README.md")


def test_the_workflow_runs_the_tests_that_make_runs() -> None:
    (chosen,) = re.findall(r'pytest -n 2 (-m "not slow.*")', text("Makefile"))
    assert chosen in text(".github/workflows/ci.yml")
    targets = set(re.findall(r"^([a-z-]+):", text("Makefile"), flags=re.M))
    for name in GITHUB:
        assert set(re.findall(r"run: make ([a-z-]+)", text(name))) <= targets


@pytest.mark.parametrize("name", GITHUB)
def test_files_of_the_service_are_well_formed(name: str) -> None:
    content = read(name)
    if "ISSUE_TEMPLATE" in name and "body" in content:
        assert content["name"]
        assert content["description"]
        for field in content["body"]:
            assert field["type"] in ("textarea", "input", "dropdown", "markdown", "checkboxes")
            assert field["attributes"]["label"]
    if "workflows" in name:
        assert "never run" in text(name)
        for job in content["jobs"].values():
            assert all("uses" in step or "run" in step for step in job["steps"])


def test_a_template_asks_for_what_repeats_a_ranking() -> None:
    body = read(".github/ISSUE_TEMPLATE/ranking.yml")["body"]
    asked = {field["id"]: field for field in body if field.get("validations", {}).get("required")}
    assert {"version", "study", "seed", "commands"} <= set(asked)
    assert "ldc --version --json" in asked["version"]["attributes"]["label"]
    assert "ldc --version --json" in text(".github/pull_request_template.md")


def test_pre_commit_checks_in_the_projects_environment() -> None:
    (local,) = read(".pre-commit-config.yaml")["repos"]
    assert local["repo"] == "local"
    assert [hook["id"] for hook in local["hooks"]] == ["ruff-check", "ruff-format", "mypy", "links"]
    assert all(hook["entry"].startswith(".venv/bin/") for hook in local["hooks"])


def test_pinned_versions_are_within_the_declared_bounds() -> None:
    pins = dict(line.split("==") for line in text("constraints.txt").split())
    pinned = {canonicalize_name(name): version for name, version in pins.items()}
    declared = [
        *PROJECT["dependencies"],
        *(one for extra in PROJECT["optional-dependencies"].values() for one in extra),
    ]
    for requirement in map(Requirement, declared):
        assert pinned[canonicalize_name(requirement.name)] in requirement.specifier, requirement


def test_bounds_of_an_extra_are_those_that_the_tests_use() -> None:
    extras = {
        name: {Requirement(one).name: one for one in requirements}
        for name, requirements in PROJECT["optional-dependencies"].items()
    }
    for name in ("cluster", "fmu", "mdf", "scenario", "search", "sensitivity"):
        for package, requirement in extras[name].items():
            assert extras["dev"][package] == requirement


def test_claimed_ratios_are_those_of_the_pages(history: ModuleType) -> None:
    pages = {page.name: " ".join(page.read_text("utf-8").split()) for page in (ROOT / "docs/explanation").glob("*.md")}
    for benchmark, cases in history.claims().items():
        assert benchmark in history.NAMES
        for case, claim in cases.items():
            if isinstance(claim, dict):
                assert any(claim["text"] in page for page in pages.values()), case
            else:
                assert re.search(rf"(?<![\d.]){re.escape(str(claim))}(?![\d.]\d)", pages["benchmarks.md"]), case


def test_every_benchmark_reports_its_ratios(history: ModuleType) -> None:
    scripts = {path.stem: path.read_text("utf-8") for path in (ROOT / "tests/benchmarks").glob("*.py")}
    assert set(history.NAMES) == set(scripts) - {"history"}
    assert all("    report(" in scripts[name] for name in history.NAMES)


def test_a_history_keeps_ratios_beside_their_claims(
    history: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    script = (
        "import json, os\nprint(json.dumps({'case': 'one', 'ratio': 2.5}), file=open(os.environ['LDC_RATIOS'], 'a'))"
    )
    (tmp_path / "risk.py").write_text(script)
    (tmp_path / "ranking.py").write_text("raise SystemExit(1)")
    (tmp_path / "claims.toml").write_text("[risk]\none = { ratio = 3.0, text = 'thrice' }\n")
    kept = tmp_path / "out" / "kept.jsonl"
    monkeypatch.setattr(history, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["history.py", "risk", "--keep", str(kept)])
    history.main()
    history.main()
    assert "| risk | one | 2.5 | 3 |" in capfd.readouterr().out
    first, second = map(json.loads, kept.read_text().splitlines())
    assert (first["benchmark"], first["case"], first["ratio"], first["claim"]) == ("risk", "one", 2.5, 3.0)
    assert set(first) == {
        "date", "commit", "changed", "processor", "cores", "versions", "benchmark", "seconds", "case", "ratio", "claim",
    }  # fmt: skip
    assert first["versions"]["numpy"] == second["versions"]["numpy"]
    monkeypatch.setattr(sys, "argv", ["history.py", "ranking", "risk"])
    with pytest.raises(SystemExit, match="failed: ranking"):
        history.main()
    assert "| risk | one | 2.5 | 3 |" in capfd.readouterr().out


def test_a_ratio_is_reported_only_where_it_is_asked_for(
    history: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    history.report("case", 1.5)
    monkeypatch.setenv("LDC_RATIOS", str(tmp_path / "ratios"))
    history.report("case", 1.5)
    assert (tmp_path / "ratios").read_text() == '{"case": "case", "ratio": 1.5}\n'


@pytest.mark.parametrize(("lost", "said"), [("SECURITY.md", "without SECURITY.md"), ("studies/b.toml", "/b.toml")])
def test_a_release_without_a_file_is_refused(lost: str, said: str, tmp_path: Path) -> None:
    """One that a contributor needs lacks in the archive, one of the toolkit in the wheel."""
    trying = tool("try_release")
    source = tmp_path / "ldctoolkit-1"
    for name in (*trying.IN_ARCHIVE, "ldctoolkit/a.py", "studies/b.toml", "ldctoolkit/a.pyi"):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).touch()
    wheel, archive = tmp_path / "a.whl", tmp_path / "a.tar.gz"

    def packed(left_out: str) -> Path:
        with zipfile.ZipFile(wheel, "w") as file:
            for name, place in {"ldctoolkit/a.py": "", "studies/b.toml": "ldctoolkit/"}.items():
                if name != left_out:
                    file.writestr(place + name, "")
        with tarfile.open(archive, "w:gz") as file:
            for path in source.rglob("*"):
                if path.relative_to(source).as_posix() != left_out or path.suffix != ".md":
                    file.add(path, path.relative_to(tmp_path), recursive=False)
        return Path(trying.unpacked(archive, wheel, tmp_path / f"to {left_out}"))

    assert packed("").name == "ldctoolkit-1"
    with pytest.raises(SystemExit, match=re.escape(said)):
        packed(lost)
