"""The main job as a user does it: recordings in, a ranked comparison report out."""

from pathlib import Path

import polars as pl
import pytest

from helpers.cli import csv_rows, good
from helpers.planted import plant_recording
from helpers.results import SECTIONS


def check_study(folder: Path, designs: int) -> None:
    rows = csv_rows(folder / "ranking.csv")
    assert len(rows) == designs
    broken = [bool(row["unmet"]) for row in rows]
    assert sorted(broken) == broken  # designs that meet the limits first
    S = [float(row["S_m_s"]) for row in rows if not row["unmet"]]
    assert S
    assert sorted(S) == S
    (none,) = (row for row in rows if row["law"] == "none")
    assert float(none["reduction"]) == 0.0
    report = (folder / "report.html").read_text(encoding="utf-8")
    for section in SECTIONS:
        assert f'id="{section}"' in report


@pytest.mark.slow
def test_real_driving_to_a_report(ngsim_recordings: Path, tmp_path: Path) -> None:
    found = good("extract", str(ngsim_recordings), "--vehicle-width", "1.8", "-o", "d.parquet", cwd=tmp_path)
    assert "refused: lane change" in found
    # what `ldc models` and docs/how-to/public-recordings.md say of them
    table = pl.read_parquet(tmp_path / "d.parquet")
    assert table["side"].value_counts().sort("side").rows() == [("left", 86), ("right", 161)]
    assert table["recording"].n_unique() == 173
    fitted = good("fit", "d.parquet", "-o", "m.json", cwd=tmp_path)
    assert fitted.count("the model gives the recordings' answer") == 2
    ran = good(
        "run", "trigger-and-gains", "--model", "m.json", "-o", "out", "--no-robustness", "--no-figures", cwd=tmp_path
    )
    assert "report:" in ran
    check_study(tmp_path / "out", designs=86)


STUDY = """
name = "small"
seed = 3
[scenarios]
left = 40
right = 40
model = "m.json"
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [0.05, 0.2]
[design.gains]
r_delta = [30.0, 300.0]
[[design]]
law = "linear_mpc"
y_s = 0.1
"""


@pytest.mark.slow
def test_planted_departures_to_a_report(tmp_path: Path) -> None:
    kept = plant_recording(tmp_path / "trip.csv")
    found = good("extract", "trip.csv", "-o", "d.parquet", cwd=tmp_path)
    table = pl.read_parquet(tmp_path / "d.parquet")
    assert table.height == kept, found
    good("fit", "d.parquet", "-o", "m.json", "--components", "1", cwd=tmp_path)
    assert "recordings: 1\n" in good("models", "m.json", cwd=tmp_path)
    good("sample", "m.json", "--left", "30", "--right", "20", "--seed", "5", "-o", "s.csv", cwd=tmp_path)
    assert pl.read_csv(tmp_path / "s.csv").height == 50
    (tmp_path / "small.toml").write_text(STUDY, encoding="utf-8")
    ran = good("run", "small.toml", "-o", "out", "--workers", "1", "--no-robustness", "--no-figures", cwd=tmp_path)
    assert "small: 6 designs x 80 scenarios, " in ran
    assert ran.splitlines()[-2:] == ["ranking: out/ranking.csv", "report:  out/report.html"]
    check_study(tmp_path / "out", designs=6)
    assert [row["rank"] for row in csv_rows(tmp_path / "out" / "ranking.csv")] == ["1", "2", "3", "4", "5", "6"]
