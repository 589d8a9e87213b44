"""A law that is broken does not stop a study: its designs are named with their fault, the others are as ever."""

import asyncio
import csv
import dataclasses
import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from helpers.closed_loop import Unsighted, known
from helpers.results import assert_same_results
from ldctoolkit import Controller, EventStatus, LdcError, Plant, gain, registry
from ldctoolkit.errors import StoreError
from ldctoolkit.studies import Study, rank_study, read_manifest, read_results, run_study
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.running.tasks import Simulator

SLOW = pytest.mark.slow
MakeStudy = Callable[..., Study]
pytestmark = pytest.mark.usefixtures("laws", "broken_laws")


@dataclasses.dataclass(frozen=True)
class BrokenLaw(Unsighted):
    how: str

    def step(self, t: Any, x: Any, preview: Any, delta_prev: Any, state: Any) -> Any:
        n, good = t.size, np.zeros(t.size, dtype=np.int8)
        match self.how:
            case "step":
                raise IndexError(f"no [row] {n}\nof many")
            case "exit":
                sys.exit("no licence")
            case "cancel":
                raise asyncio.CancelledError("a \ud800 b")
            case "shape":
                return np.zeros((n, 1)), state, good
            case "type":
                return "straight on", state, good
            case "nan":
                return np.full(n, np.nan), state, good
        return np.zeros(n), state, good


class Broken(Controller):
    how: ClassVar[str]

    def prepare(self, plant: Plant) -> BrokenLaw:
        if self.how == "prepare":
            raise ZeroDivisionError(f"K is {self.K}")  # type: ignore[attr-defined]
        return BrokenLaw(self.how)


def broken(how: str) -> type[Controller]:
    K = gain(0.0, unit="1", lower=0.0, upper=9.0, description="a number")
    space = {"name": f"broken_{how}", "title": f"Broken {how}", "how": how, "__module__": __name__}
    return dataclasses.make_dataclass(f"Broken_{how}", [("K", float, K)], bases=(Broken,), namespace=space, frozen=True)


FAULTS = {
    "prepare": r"ZeroDivisionError: K is 0\.0 \(test_failing_designs\.py, line \d+\)",
    "step": r"IndexError: no \[row\] \d+ of many \(test_failing_designs\.py, line \d+\)",
    "exit": r"SystemExit: no licence \(test_failing_designs\.py, line \d+\)",
    "cancel": r"CancelledError: a \\ud800 b \(.*",
    "shape": r"controller 'broken_shape': step: delta: shape \(\d+, 1\); allowed: an array of shape \(\d+,\)",
    "type": r"controller 'broken_type': .*delta.*'straight on'; allowed: an array of real numbers",
}
LAWS = [broken(how) for how in (*FAULTS, "nan")]


@pytest.fixture
def broken_laws() -> Iterator[None]:
    with known(*LAWS):
        yield


GOOD = [{"law": "none"}, {"law": "toy", "gains": {"K": [-0.4, -0.2]}}]


def study_with(make_study: MakeStudy, *how: str) -> Study:
    return make_study(design=[GOOD[0], *({"law": f"broken_{name}", "y_s": 0.05} for name in how), GOOD[1]])


def without_few(warnings: tuple[str, ...]) -> tuple[str, ...]:
    """All but the one that a dozen scenarios are few."""
    return tuple(warning for warning in warnings if not warning.startswith("Intervals are too short"))


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=SLOW)])
def test_each_fault_is_named_and_the_others_run(make_study: MakeStudy, tmp_path: Path, workers: int) -> None:
    study = study_with(make_study, *FAULTS)
    results = run_study(study, directory=tmp_path / "all", workers=workers)
    alone = run_study(make_study(design=GOOD), directory=tmp_path / "alone", workers=1)
    assert_same_results(results, alone)
    assert [failed.design.law for failed in results.failed] == [f"broken_{how}" for how in FAULTS]
    for failed, pattern in zip(results.failed, FAULTS.values(), strict=True):
        assert re.fullmatch(pattern, failed.reason), failed.reason
        assert failed.sentence.startswith(f"design {failed.design.id} (Broken {failed.design.law[7:]}, y_s=0.05 m): ")
    again = read_results(tmp_path / "all")
    assert again.failed == results.failed
    assert_same_results(again, results)


def test_commands_that_are_no_numbers_are_failed_solves(make_study: MakeStudy, tmp_path: Path) -> None:
    """Not a failed design: the command before goes on, and every one is counted under the design's name."""
    results = run_study(study_with(make_study, "nan"), directory=tmp_path, workers=1)
    assert not results.failed
    ranking = rank_study(results, study_with(make_study, "nan"))
    place = [design.law for design in ranking.designs].index("broken_nan")
    assert ranking.metrics.failed_solves[place] > 0
    assert ranking.metrics.solver_failed[place] + ranking.metrics.diverged[place] == round(
        ranking.metrics.triggered[place] * 12
    )
    steered = results.status[results.designs.index(ranking.designs[place])] != EventStatus.NEVER_TRIGGERED
    assert steered.any()
    n = int(steered.sum())
    assert without_few(ranking.warnings) == (
        "Commands that were not finite, of laws that declare no solver to fall back from: "
        f"Broken nan, y_s=0.05 m in {n} of {n} interventions.",
    )


def test_a_failed_design_is_tried_again(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    study = study_with(make_study, "prepare", "step")
    run_study(study, directory=tmp_path, workers=1)
    assert "failed and not ranked: 2 of 5 designs; the first, design" in caplog.text
    parts = sorted((tmp_path / "results").iterdir())
    before = (tmp_path / "failures.json").read_bytes()

    assert len(run_study(study, directory=tmp_path, workers=1).failed) == 2
    assert sorted((tmp_path / "results").iterdir()) == parts  # nothing new to store
    assert (tmp_path / "failures.json").read_bytes() == before

    # its author has mended it
    monkeypatch.setattr(Broken, "prepare", lambda self, plant: BrokenLaw("no more"))
    results = run_study(study, directory=tmp_path, workers=1)
    assert not results.failed
    assert len(results.designs) == 5
    assert not (tmp_path / "failures.json").exists()
    assert not read_results(tmp_path).failed


def test_failures_survive_an_interrupt(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = make_study(design=[GOOD[0], {"law": "broken_step", "y_s": 0.3}, {"law": "toy", "y_s": 0.4}])
    run = Simulator.run

    def interrupted(self: Simulator, task: Any) -> Any:
        if task.designs[0].law == "toy":
            raise KeyboardInterrupt
        return run(self, task)

    monkeypatch.setattr(Simulator, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_study(study, directory=tmp_path, workers=1, block_size=1)
    (failed,) = json.loads((tmp_path / "failures.json").read_text())["designs"].values()
    assert failed.startswith("IndexError: no [row]")
    with pytest.raises(StoreError, match=r"1 of 3 designs is not complete \(33 %"):  # one run is stored, one failed
        read_results(tmp_path)
    monkeypatch.setattr(Simulator, "run", run)
    assert len(run_study(study, directory=tmp_path, workers=1).failed) == 1
    assert len(read_results(tmp_path).designs) == 2


def test_a_fault_of_no_law_ends_all(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken_takeover(*settings: Any) -> None:
        raise LdcError("no such plant")

    monkeypatch.setattr(Simulator, "sampler", broken_takeover)
    with pytest.raises(LdcError, match="no such plant"):
        run_study(make_study(), directory=tmp_path, workers=1)


def test_a_study_of_failures_alone_ends_with_an_error(make_study: MakeStudy, tmp_path: Path) -> None:
    study = make_study(design=[{"law": "broken_step"}, {"law": "broken_shape"}])
    message = r"every design failed; the first, design [0-9a-f]{12} \(Broken step, y_s=0\.2 m\): "
    message += r"IndexError: no \[row\].*; all of them are in failures\.json"
    with pytest.raises(LdcError, match=rf"small: {message}"):
        run_study(study, directory=tmp_path, workers=1)
    with pytest.raises(LdcError, match=message):
        read_results(tmp_path)
    assert read_manifest(tmp_path).finished  # nothing is left to be run


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"designs": {"a": 1}}', '{"designs": {"a": {}}}'])
def test_broken_failures_are_named_and_made_anew(content: str, make_study: MakeStudy, tmp_path: Path) -> None:
    study = study_with(make_study, "step")
    run_study(study, directory=tmp_path, workers=1)
    (tmp_path / "failures.json").write_text(content)
    with pytest.raises(StoreError, match=r"failures\.json: broken; it holds which designs failed"):
        read_results(tmp_path)
    assert len(run_study(study, directory=tmp_path, workers=1).failed) == 1
    assert len(read_results(tmp_path).failed) == 1


@pytest.fixture
def study_file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\n[scenarios]\nleft = 4\nright = 4\n'
        '[ranking]\nbootstrap = 100\n[[design]]\nlaw = "none"\n[[design]]\nlaw = "toy"\n'
        '[[design]]\nlaw = "broken_step"\ny_s = 0.05\n[design.gains]\nK = [1, 2]\n',
        encoding="utf-8",
    )
    return path


@pytest.mark.slow
def test_table_csv_report_and_exit_code(study_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", str(study_file), "-o", str(out), "--workers", "1", "--no-robustness", "--no-figures"]) == 3
    said = capsys.readouterr()
    assert "2 designs failed and are not ranked:" in said.out
    assert "(Broken step, y_s=0.05 m, K=1): IndexError: no [row] " in said.out  # brackets are no markup
    assert "ldc: warning: failed and not ranked: 2 of 4 designs; the first, design" in said.err

    with (out / "ranking.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 4
    for row in rows:
        failed = row["law"] == "broken_step"
        assert failed == row["failure"].startswith("IndexError: no [row] ")
        assert failed == (row["rank"] == "") == (row["S_m_s"] == "") == (row["invalid"] == "")
    assert [row["gain_K"] for row in rows if row["law"] == "broken_step"] == ["1.0", "2.0"]

    page = (out / "report.html").read_text(encoding="utf-8")
    assert "2 designs failed and are not ranked" in page
    assert page.count("IndexError: no [row] ") == 2
    assert "Broken step, y<sub>s</sub>=0.05 m, K=2" in page

    for command in (["rank"], ["report", "--no-robustness", "--no-figures"]):
        assert main([*command, str(out)]) == 0
    assert "2 designs failed and are not ranked:" in capsys.readouterr().out


def test_exit_code_where_all_fail(study_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = study_file.read_text(encoding="utf-8").replace('"none"', '"broken_exit"').replace('"toy"', '"broken_type"')
    study_file.write_text(text, encoding="utf-8")
    assert main(["run", str(study_file), "-o", str(tmp_path / "out"), "--workers", "1"]) == 2
    assert capsys.readouterr().err.startswith("ldc: error: mine: every design failed; the first, design ")
    assert not (tmp_path / "out" / "ranking.csv").exists()


@pytest.mark.slow
def test_words_of_a_law_are_no_markup(
    study_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from ldctoolkit import controller_class

    K = gain(0.0, unit="[rad]", lower=0.0, upper=9.0, description="ends [/m] and :car: [rad]")
    space = {"title": "Odd [/b] [red]law", "name": "broken_step", "how": "nan", "__module__": __name__}
    odd = dataclasses.make_dataclass("Odd", [("K", float, K)], bases=(Broken,), namespace=space, frozen=True)
    bare = dataclasses.make_dataclass(
        "Bare", [], bases=(Broken,), namespace=space | {"name": "broken_nan"}, frozen=True
    )
    for kind in (odd, bare):
        monkeypatch.setitem(registry._registered, kind.name, kind)
    assert controller_class("broken_step") is odd
    assert main(["controllers", "broken_step", "broken_nan"]) == 0
    said = capsys.readouterr().out
    assert said.count("Odd [/b] [red]law") == 2
    assert " [rad] " in said
    assert "ends [/m] and :car: [rad]" in said

    assert (
        main(["run", str(study_file), "-o", str(tmp_path / "out"), "--workers", "1", "--no-robustness", "--no-figures"])
        == 0
    )
    said = capsys.readouterr().out
    assert "Odd [/b] [red]law, y_s=0.05 m, K=1 in" in said  # the warning
    assert "[m·s]" in said  # a heading
    assert said.count("Odd [/b] [red]law") >= 3
