"""``ldc report`` with departures and designs that are asked for."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from studies import Study, read_results, run_study
from studies.cli import main

STUDY: dict[str, Any] = {
    "name": "s",
    "seed": 2,
    "scenarios": {"left": 200, "right": 200},
    "ranking": {"bootstrap": 100, "finalists": 0},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.2]}, {"law": "preview_proportional"}],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "o"
    run_study(Study.from_dict(STUDY), directory=path, workers=1)
    return path


@pytest.mark.slow
def test_departures_and_designs_are_put_into_the_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.report.figure_files.write_figures", lambda *_: ())  # nothing that is looked at here
    results = read_results(folder)
    worst = results.designs[int(results.cases[0].S.mean(axis=1).argsort()[-2])].id
    assert main(["report", str(folder), "--departure", "399", "--departure", "7", "--design", worst[:8]]) == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="ldc-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    data = json.loads(found[1])["departures"]
    assert [roles[0] for roles in data["departures"]["roles"][:2]] == ["asked for", "asked for"]
    assert worst in [design["id"] for design in data["designs"]]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--departure", "400"], "departure: 400; allowed: 0 to 399, the nearest is 399"),
        (["--departure", "-1"], "departure: -1; allowed: 0 to 399, the nearest is 0"),
        (["--design", "not an id"], "design: 'not an id'; no design begins like this, the nearest is"),
        (["--design", ""], "design: ''; no design begins like this"),
    ],
)
def test_what_is_not_there_is_refused(
    folder: Path, given: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert main(["report", str(folder), *given]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
    after = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert {path.name for path in after if before.get(path) != after[path]} <= {".lock"}
