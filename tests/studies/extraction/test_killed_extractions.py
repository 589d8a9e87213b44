"""An extraction that is killed at any moment, or runs on a cluster: the same table, and nothing is left behind."""

import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.kills import killing
from ldctoolkit.recordings import extract_departures, read_departures
from ldctoolkit.recordings.recording import open_recordings
from ldctoolkit.studies.extraction import run_extraction

FILES = 40
KILLS = 8

LONG = 600
"""Seconds that a whole extraction may take, on a machine that does other things as well and has to compile first."""


def plain_tables(folder: Path) -> None:
    """Recording tables with departures to both sides; the last file but one is broken."""
    generator = np.random.default_rng(3)
    t = np.arange(0, 12, 0.1)
    for i in range(FILES):
        lines = ["recording,t,lane_offset,lane_width,speed,yaw_rate\n"]
        for j in range(40):
            T, peak, v = generator.uniform(1, 4), generator.uniform(0.1, 0.5), generator.uniform(15, 30)
            offset = (-1) ** j * (np.maximum(peak * (1 - (2 * (t - 6) / T) ** 2), -0.6) + 0.9)
            offset += 0.01 * generator.normal(size=t.size)
            turn = 0.01 * generator.normal(size=t.size)
            name = f"r{i}-{j}"
            lines += [f"{name},{a:.1f},{b:.6f},3.6,{v:.6f},{c:.6f}\n" for a, b, c in zip(t, offset, turn, strict=True)]
        (folder / f"{i:02d}.csv").write_text("".join(lines))
    (folder / f"{FILES - 2:02d}.csv").write_text("recording,t,lane_offset,lane_width,speed\na,0,x,3.6,25\n")


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of files, one part each."""
    folder = tmp_path_factory.mktemp("tables")
    plain_tables(folder)
    return folder


def run(tables: Path, folder: Path, workers: int, *, killed_at: int = 0) -> subprocess.CompletedProcess[str]:
    """The command, killed before it takes that step; 0: it is not."""
    code = killing(folder, killed_at) + "from ldctoolkit.studies.cli import main; sys.exit(main())"
    words = ["extract", str(tables), "-o", "d.parquet", "--workers", str(workers)]
    return subprocess.run(
        [sys.executable, "-c", code, *words], cwd=folder, capture_output=True, text=True, timeout=LONG, check=False
    )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes are killed in another way on Windows")
def test_kills_lose_nothing_and_leave_nothing_behind(tables: Path, tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    whole.mkdir()
    killed.mkdir()
    expected = run(tables, whole, 2)
    assert expected.returncode == 3, expected.stderr
    chance, kept = random.Random(5), []
    for i in range(KILLS):
        assert run(tables, killed, 2 if i % 3 else 1, killed_at=chance.randint(1, 45)).returncode == -signal.SIGKILL
        kept.append(len(list(killed.glob("d.parquet.parts/part-*"))))
    last = run(tables, killed, 2)
    assert last.returncode == 3, last.stderr
    assert (last.stdout, last.stderr) == (expected.stdout, expected.stderr)
    assert (killed / "d.parquet").read_bytes() == (whole / "d.parquet").read_bytes()
    assert [path.name for path in killed.iterdir()] == ["d.parquet"]
    # some were killed while they stored parts, others while they removed them
    assert np.diff(kept).min() < 0 < np.diff(kept).max(), kept
    # and what was written is what the library finds, in one process and without parts
    found = extract_departures(open_recordings(tables))
    assert len(found.departures) > FILES * 12
    assert found.problems
    departures, provenance = read_departures(killed / "d.parquet")
    np.testing.assert_array_equal(departures.matrix(), found.departures.matrix())
    assert departures.recording.tolist() == found.departures.recording.tolist()
    assert provenance == found.provenance


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_bits(tables: Path, tmp_path: Path) -> None:
    output = tmp_path / "d.parquet"
    recordings = open_recordings(tables)
    found = run_extraction(recordings, output=output, dask="local", workers=2)
    alone = run_extraction(recordings, output=tmp_path / "e.parquet", workers=1)
    assert found.provenance == alone.provenance
    np.testing.assert_array_equal(found.departures.matrix(), alone.departures.matrix())
    assert output.read_bytes() == (tmp_path / "e.parquet").read_bytes()
    assert found.provenance.recordings == 40 * (FILES - 1)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "e.parquet"]
