"""What version 1 promises: public things go with a deprecation only, and files of an earlier version are read."""

import argparse
import copy
import dataclasses
import json
import re
import shutil
import tomllib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import ldctoolkit as ldc
from helpers.cli import ROOT, bad, csv_rows, good, tool
from helpers.cli import ldc as command
from helpers.stored import rewrite_json
from ldctoolkit.deprecation import Deprecation
from ldctoolkit.errors import CheckedArguments, LdcError, RecordingError, StoreError
from ldctoolkit.recordings import departures_table
from ldctoolkit.studies import cli, study_file
from ldctoolkit.studies.storage import manifest

surfaces = tool("public_surface")
STORED = ROOT / "tests/data/stored_1_0"
OLD = Deprecation(since="1.1", removed_in="1.2", instead="new")


@pytest.fixture(scope="module")
def pinned() -> dict[str, Any]:
    """What the last release with a file of its own had."""
    return json.loads(surfaces.last().read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def now() -> dict[str, Any]:
    return surfaces.surface()


def test_nothing_public_is_gone_without_a_deprecation(pinned: dict[str, Any], now: dict[str, Any]) -> None:
    faults = surfaces.broken(pinned, now)
    assert not faults, "see docs/reference/stability.md"


def test_every_kind_of_public_thing_is_pinned(pinned: dict[str, Any]) -> None:
    public = pinned["public"]
    assert pinned["version"] == "1.0.0"
    assert "run_study" in public["names"]["ldctoolkit"].split()
    assert "LdcError" in public["names"]["ldctoolkit"].split()
    assert public["arguments"]["ldctoolkit.read_results"] == "folder"
    assert public["arguments"]["ldctoolkit.LQR"] == "q_y q_y_rate q_psi q_psi_rate r_delta"
    assert {"S", "reduction", "to_polars"} <= set(public["members"]["ldctoolkit.Outcome"].split())
    assert {"<1>", "-o", "--output", "--workers"} <= set(public["options"]["ldc run"].split())
    assert public["choices"]["ldc scenarios --format"] == "openscenario csv"
    assert {"dt", "settle", "trigger"} <= set(public["keys"]["simulation"].split())
    assert public["gains"]["lqr"] == "q_y q_y_rate q_psi q_psi_rate r_delta"
    assert {"S", "a_y_peak_p95", "ay_p95"} <= set(public["metrics"]["of a design"].split())
    assert "spmd-das1" in public["entry points"]["ldctoolkit.recordings"].split()


def renamed(text: str, old: str, new: str) -> str:
    return " ".join(new if word == old else word for word in text.split())


@pytest.mark.parametrize(
    ("kind", "owner", "word"),
    [
        ("options", "ldc rank", "--require"),
        ("names", "ldctoolkit", "simulate"),
        ("members", "ldctoolkit.Outcome", "reduction"),
        ("arguments", "ldctoolkit.simulate", "y_s"),
        ("keys", "ranking", "bootstrap"),
        ("gains", "linear_mpc", "horizon"),
        ("choices", "ldc scenarios --format", "csv"),
        ("metrics", "of a design", "ay_p95"),
    ],
)
def test_what_is_renamed_is_found_unless_it_was_deprecated(
    now: dict[str, Any], kind: str, owner: str, word: str
) -> None:
    later = copy.deepcopy(now) | {"version": "1.2.0"}
    later["public"][kind][owner] = renamed(later["public"][kind][owner], word, "other")
    name = f"{kind}: {owner}: {word}"
    assert surfaces.broken(now, later)[0] == f"{name} is gone"
    announced = now | {"version": "1.1.0", "deprecated": {name: ["1.1", "1.2"]}}
    assert surfaces.broken(announced, later) == []
    assert surfaces.broken(announced, later | {"version": "1.1.3"})[0] == f"{name} is gone"


def test_additions_are_no_fault(now: dict[str, Any]) -> None:
    later = copy.deepcopy(now)
    for owners in later["public"].values():
        for owner in owners:
            owners[owner] += " added"
        owners["other"] = "word"
    assert surfaces.broken(now, later) == []
    later["public"]["arguments"]["ldctoolkit.simulate"] = "added " + now["public"]["arguments"]["ldctoolkit.simulate"]
    (first, *_) = surfaces.broken(now, later)
    assert re.fullmatch(r"arguments: ldctoolkit.simulate: \w+ is no longer argument 1", first)


@pytest.mark.parametrize(
    ("versions", "fault"),
    [(("1.1", "1.1"), "goes in 1.1, with no minor version since 1.1"), (("0.9", "1.0"), "was to be removed in 1.0")],
)
def test_a_deprecation_holds_for_a_minor_version_and_ends(now: dict[str, Any], versions: Any, fault: str) -> None:
    name = "options: ldc rank: --old"
    assert surfaces.broken(now, now | {"deprecated": {name: list(versions)}}) == [f"{name} {fault}"]


@pytest.fixture
def of_rank(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[argparse.ArgumentParser], None]], None]:
    """Change the parser of `ldc rank` once it is declared."""
    declare = cli.rank.add_parser

    def change(how: Callable[[argparse.ArgumentParser], None]) -> None:
        def declared(commands: Any) -> None:
            declare(commands)
            how(commands.choices["rank"])

        monkeypatch.setattr(cli.rank, "add_parser", declared)

    return change


def rename_require(parser: argparse.ArgumentParser) -> None:
    (action,) = (one for one in parser._actions if "--require" in one.option_strings)
    del parser._option_string_actions["--require"]
    action.option_strings, parser._option_string_actions["--needs"] = ["--needs"], action


def test_a_renamed_flag_fails_and_passes_with_a_deprecation(
    pinned: dict[str, Any], of_rank: Any, tmp_path: Path
) -> None:
    of_rank(rename_require)
    assert surfaces.broken(pinned, surfaces.surface()) == ["options: ldc rank: --require is gone"]

    def former(parser: argparse.ArgumentParser) -> None:
        rename_require(parser)
        action = parser.add_argument("--require", dest="require", action="append", help="the former name")
        Deprecation("1.1", "1.2", "--needs").option(action)

    of_rank(former)
    assert surfaces.broken(pinned, changed := surfaces.surface()) == []
    assert changed["deprecated"] == {"options: ldc rank: --require": ["1.1", "1.2"]}
    shutil.copytree(STORED / "study", tmp_path / "s")
    done = command("rank", "s", "--require", "gain_margin >= 5", "--json", cwd=tmp_path)
    assert done.returncode == 0
    assert json.loads(done.stdout)["require"] == ["gain_margin >= 5"]
    text = "--require of ldc rank is deprecated since 1.1 and will be removed in 1.2; use --needs"
    assert f"ldc: warning: {text}\n" in done.stderr
    assert "the former name" not in good("rank", "--help", cwd=tmp_path)


def test_a_renamed_key_is_read_with_a_warning(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    content: dict[str, Any] = {"name": "s", "design": [{"law": "none"}], "ranking": {"samples": 300}}
    with pytest.raises(LdcError, match="no such key"):
        ldc.Study.from_dict(content)
    monkeypatch.setattr(study_file, "FORMER_KEYS", {"ranking.samples": Deprecation("1.1", "1.2", "bootstrap")})
    with pytest.warns(DeprecationWarning, match="key samples is deprecated since 1.1 .* use bootstrap"):
        assert ldc.Study.from_dict(content).ranking.bootstrap == 300
    both = content | {"ranking": {"samples": 300, "bootstrap": 400}}
    with pytest.raises(LdcError, match="no such key"):
        ldc.Study.from_dict(both)
    (tmp_path / "s.toml").write_text('name = "s"\n[ranking]\nsamples = 7\n[[design]]\nlaw = "none"\n', encoding="utf-8")
    done = command("run", "s.toml", cwd=tmp_path)
    assert done.stderr.startswith("ldc: warning: key samples is deprecated")
    assert "ranking.bootstrap" in done.stderr


@OLD
def double(x: int) -> int:
    """Twice x."""
    return 2 * x


@OLD.argument("old")
def triple(x: int, *, new: int = 0, **more: int) -> int:
    return 3 * x + new + sum(more.values())


@OLD
@dataclasses.dataclass(frozen=True)
class Former:
    a: int = 1

    @property
    @OLD
    def b(self) -> int:
        return self.a


@OLD.argument("old")
@dataclasses.dataclass(frozen=True)
class Changed(CheckedArguments):
    new: int = 1


@pytest.mark.parametrize(
    ("call", "value", "what"),
    [
        (lambda: double(2), 4, "double"),
        (lambda: Former(a=3).a, 3, "Former"),
        (lambda: triple(1, old=4, z=2), 9, "argument old of triple"),
        (lambda: Changed(old=5).new, 5, "argument old of Changed"),
    ],
)
def test_what_is_deprecated_works_and_warns_at_the_users_line(call: Callable[[], int], value: int, what: str) -> None:
    with warnings.catch_warnings(record=True, action="always") as caught:
        assert call() == value
    (warning,) = caught
    assert issubclass(warning.category, DeprecationWarning)
    assert str(warning.message) == f"{what} is deprecated since 1.1 and will be removed in 1.2; use new"
    assert (warning.filename, warning.lineno) == (__file__, call.__code__.co_firstlineno)


def test_what_is_used_as_it_is_now_does_not_warn() -> None:
    with warnings.catch_warnings(action="error"):
        assert triple(1, new=4) == 7
        assert Changed(new=5) == Changed(5)
    with pytest.raises(TypeError, match="old"):
        Changed(new=5, old=5)
    with pytest.raises(LdcError, match="did you mean 'new'"):
        Changed(nev=5)


def test_the_surface_knows_deprecations(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"m.double": double, "m.triple": triple, "m.Former": Former}
    monkeypatch.setattr(surfaces, "public_names", lambda: names)
    monkeypatch.setattr(surfaces, "members", lambda kind: {"b": kind.b})
    found = surfaces.surface()
    assert {name for name in found["deprecated"] if ": m" in name} == {
        "names: m: double", "arguments: m.triple: old", "names: m: Former", "members: m.Former: b",
    }  # fmt: skip
    assert found["public"]["arguments"]["m.triple"] == "x * new old"


def test_the_version_is_the_same_everywhere() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert ldc.__version__ == project["version"] == "1.0.0"
    assert dict(ldc.version.versions())["ldctoolkit"] == "1.0.0"
    assert good("--version", cwd=ROOT) == "ldc 1.0.0\n"
    assert "\n## 1.0.0 (2026-11-27)\n" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    shutil.copytree(STORED, tmp_path / "stored")
    return tmp_path / "stored"


def test_a_study_of_1_0_is_read_ranked_and_reported(stored: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = manifest.versions()
    monkeypatch.setattr(manifest, "versions", lambda *_: (("ldctoolkit", "1.9.0"), *versions[1:]))
    results = ldc.read_results(stored / "study")
    assert [design.id for design in results.designs] == ["a0e5f462b2a7", "309ff8b1d17f", "a2af0b53d036"]
    np.testing.assert_allclose(results.S.mean(axis=1), [3.1591564394703036, 1.0754537722334636, 2.5145756477198815])
    np.testing.assert_allclose(results.metrics.a_y_peak[1, 0], 2.737689704609594)
    assert results.fresh is not None
    fresh = [1.012512081228948, 2.2189671788223664, 2.7570811251629106]
    np.testing.assert_allclose(results.fresh.S.mean(axis=1), fresh)
    np.testing.assert_allclose(results.measures["gain_margin"][1:], [7.19235378845957, 3.54089167], rtol=1e-8)
    done = command("rank", "study", "--json", cwd=stored)
    assert done.returncode == 0
    assert "study: was run with ldctoolkit 1.0.0 (now 1.9.0)" in done.stderr
    summary = json.loads(done.stdout)
    assert summary["winner"]["S_m_s"] == pytest.approx(1.0754537722334636, rel=1e-12)
    assert summary["winner"]["recordings"]["high"] == pytest.approx(1.0691152540988544, rel=1e-9)
    assert {
        "event", "study", "study_hash", "designs", "scenarios", "failed_designs", "winner", "set_of_best", "verdict",
        "usable", "lights", "binding", "sweep_ends", "blocked", "extended", "baseline", "rank_by",
        "baseline_difference_m_s", "require", "not_ranked", "pareto", "pareto_front", "confidence", "warnings",
        "ranking",
    } <= summary.keys()  # fmt: skip
    was, is_now = csv_rows(stored / "ranking.csv"), csv_rows(stored / "study/ranking.csv")
    assert was[0].keys() <= is_now[0].keys()
    assert [(row["design"], row["rank"]) for row in is_now] == [(row["design"], row["rank"]) for row in was]
    for column in ("S_m_s", "S_low_m_s", "fresh_S_m_s", "a_y_peak_p95_m_s2", "gain_margin"):
        then, today = ([float(row[column] or "nan") for row in rows] for rows in (was, is_now))
        np.testing.assert_allclose(today, then, rtol=1e-9, err_msg=column)
    good("report", "study", "--no-figures", "--no-robustness", cwd=stored)
    page = (stored / "study/report.html").read_text(encoding="utf-8")
    assert "This study was run with ldctoolkit 1.0.0 (now 1.9.0)" in page
    assert "1.075" in page


def test_a_model_of_1_0_is_read(stored: Path) -> None:
    model = ldc.load_model(stored / "model.json")
    np.testing.assert_allclose(model.left.weights_, [0.2344712365446945, 0.7655287634553054])
    assert model.content_hash.startswith("9b57554d524d")
    assert model.provenance.recorded is not None
    assert model.sample(3, 2, seed=1).n == 5


def test_departures_of_1_0_are_read(stored: Path) -> None:
    departures, provenance = ldc.read_departures(stored / "departures.parquet", signals=True)
    assert departures.n == 60
    np.testing.assert_allclose(departures.d_y[:3], [0.16484912551477643, 0.36499412938223924, 0.2542963744867321])
    assert departures.signals is not None
    np.testing.assert_allclose(departures.signals.y[:3], [0.0, 0.0021999999999998687, 0.03939999999999988])
    assert provenance.hours == pytest.approx(0.13166666666666665)


def test_files_of_a_newer_version_are_refused(stored: Path) -> None:
    rewrite_json(stored / "study/manifest.json", lambda content: content.update(format_version=6))
    message = bad("rank", "study", cwd=stored)
    assert "manifest.json: format_version: 6; allowed: 5; the folder is newer, update ldctoolkit" in message
    with pytest.raises(StoreError, match="newer"):
        ldc.read_results(stored / "study")
    rewrite_json(stored / "model.json", lambda content: content.update(version=6))
    message = bad("models", "model.json", cwd=stored)
    assert "model.json: version: 6; allowed: version 4 to 5, which this program reads; the file is newer" in message
    table = pl.read_parquet(stored / "departures.parquet")
    metadata = pl.read_parquet_metadata(stored / "departures.parquet")
    content = json.loads(metadata[departures_table.METADATA_KEY]) | {"format_version": 3}
    table.write_parquet(stored / "newer.parquet", metadata={departures_table.METADATA_KEY: json.dumps(content)})
    with pytest.raises(RecordingError, match="departures table of format 3; this version reads 2"):
        ldc.read_departures(stored / "newer.parquet")
    assert "departures table of format 3" in bad("fit", "newer.parquet", "-o", "m.json", cwd=stored)


def test_stored_files_are_small() -> None:
    assert sum(path.stat().st_size for path in STORED.rglob("*") if path.is_file()) < 200_000


def test_the_page_lists_formats_and_modules_as_the_code_has_them() -> None:
    made = dict(surfaces.generated.promises())
    assert [row.split(" | ")[2:] for row in made["formats.md"].splitlines()[2:]] == [
        ["5", "5 |"], ["5", "4, 5 |"], ["2", "2 |"],
    ]  # fmt: skip
    assert "| `ldctoolkit.recordings` | `Label`, `Preparation`, `Problem`, " in made["public-modules.md"]
