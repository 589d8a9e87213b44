"""``ldc report`` with departures and designs that are requested."""

import json
import re
from pathlib import Path

import pytest

from helpers.cli import bad, good
from ldctoolkit.studies import read_results


@pytest.mark.slow
def test_departures_and_designs_are_put_into_the_page(folder: Path) -> None:
    results = read_results(folder / "plain")
    worst = results.designs[int(results.S.mean(axis=1).argsort()[-2])].id
    asked = ("--departure", 248, "--departure", 7, "--design", worst[:8])
    good("report", "plain", *asked, "--no-robustness", "--no-figures", cwd=folder)
    page = (folder / "plain" / "report.html").read_text(encoding="utf-8")
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    data = json.loads(found[1])["departures"]
    assert [one["number"] for one in data["departures"][:2]] == ["248", "7"]
    assert all("requested" in one["name"] for one in data["departures"][:2])
    assert "requested" in [design["why"] for design in data["designs"]]


@pytest.mark.slow
def test_what_lies_in_a_folder_and_how_it_is_written_again(folder: Path) -> None:
    """Numbers on other plants: left out, worked out, and shown where they are stored."""
    out = folder / "plain"
    page, plants, ranking = (out / name for name in ("report.html", "robustness.json", "ranking.csv"))
    good("report", "plain", "--no-robustness", "--no-figures", cwd=folder)
    assert not plants.exists()
    assert b"Designs were not driven on other plants for this report" in page.read_bytes()
    good("report", "plain", cwd=folder)
    assert sorted(path.name for path in out.iterdir()) == [
        ".lock", "designs.parquet", "figures", "finalists", "manifest.json", "measures.parquet", "model.json",
        "paths.parquet", "ranking.csv", "ranking.md", "refits.json", "report.html", "results", "robustness.json",
        "scenarios.parquet", "timing.json",
    ]  # fmt: skip
    written = {path: path.read_bytes() for path in (page, plants, ranking)}
    ranking.unlink()
    good("rank", "plain", cwd=folder)
    good("report", "plain", "--no-robustness", "--no-figures", cwd=folder)
    assert {path: path.read_bytes() for path in written} == written
    assert "plain: holds another study (before): " in bad("run", "paper", "-o", "plain", cwd=folder)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["--departure", "500"], "departure: 500; no departure with this number can be simulated; the nearest is 298"),
        (["--design", "not an id"], "--design 'not an id': no such design"),
    ],
)
def test_what_is_not_there_is_refused(folder: Path, given: list[str], message: str) -> None:
    assert message in bad("report", "plain", *given, cwd=folder)
