"""Full disks, folders that cannot be written, files that were cut or changed: told in one line, and repaired."""

import contextlib
import errno
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.errors import StoreError
from studies import Study, read_results, run_study
from studies.storage.run_table import checked_content, parse_part

MakeStudy = Callable[..., Study]


def part_of(folder: Path) -> Path:
    return min((folder / "results").glob("part-*.parquet"))


@pytest.fixture
def finished(make_study: MakeStudy, tmp_path: Path) -> Path:
    run_study(make_study(), directory=tmp_path / "s", workers=1)
    return tmp_path / "s"


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[Path]:
    """A file system of a few kilobytes, where this machine lets us make one."""
    folder.mkdir()
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)], capture_output=True, check=False
    )
    if made.returncode:
        pytest.skip("no permission to mount a small file system here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="tmpfs is Linux's")
def test_what_fitted_on_a_full_disk_is_kept(make_study: MakeStudy, tmp_path: Path, stored_rows: Any) -> None:
    """A real one; then the same study with room goes on from what was stored."""
    blocks = [{"law": "preview_proportional", "y_s": 0.1, "gains": {"K_y": {"from": -0.04, "to": -0.002, "count": 60}}}]
    study = make_study(design=blocks, scenarios={"left": 150, "right": 150})
    with small_disk(tmp_path / "disk", 500) as disk:
        with pytest.raises(StoreError, match=r"cannot be written: No space left on device; what was finished before"):
            run_study(study, directory=disk / "s", workers=1, block_size=1)
        for part in (disk / "s" / "results").glob("part-*"):
            list(parse_part(part, checked_content(part), study.simulation.window, 300))  # whole, or not there
        assert not list(disk.rglob(".*.part"))
        subprocess.run(["mount", "-o", "remount,size=100m", str(disk)], check=True)
        run_study(study, directory=disk / "s", workers=1)
        run_study(study, directory=tmp_path / "whole", workers=1)
        assert stored_rows(disk / "s").equals(stored_rows(tmp_path / "whole"))


def test_a_disk_that_fills_on_the_way(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On every machine: the second part finds no room."""
    from studies.running import campaign
    from studies.storage import run_table

    monkeypatch.setattr(campaign, "_STORE_EVERY", 0.0)
    whole, written = run_table.stored_file, []

    @contextlib.contextmanager
    def full(path: Path) -> Iterator[IO[bytes]]:
        written.extend([path] if path.parent.name == "results" else [])
        if len(written) > 1:
            raise StoreError(f"{path}: cannot be written: {os.strerror(errno.ENOSPC)}")
        with whole(path) as stream:
            yield stream

    monkeypatch.setattr(run_table, "stored_file", full)
    with pytest.raises(StoreError, match="No space left on device"):
        run_study(make_study(), directory=tmp_path, workers=1, block_size=1)
    with pytest.raises(
        StoreError, match=r"designs are not complete \([0-9]+ % of the scenario runs are there\); run the study again"
    ):
        read_results(tmp_path)
    assert len(list((tmp_path / "results").iterdir())) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="a folder under a file is refused in other words elsewhere")
def test_a_folder_that_cannot_be_made_or_written_is_named(make_study: MakeStudy, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match=r"file/s: cannot be made: Not a directory"):
        run_study(make_study(), directory=tmp_path / "file" / "s", workers=1)
    with pytest.raises(StoreError, match=r"/proc/s: cannot be made: "):
        run_study(make_study(), directory="/proc/s", workers=1)
    if os.geteuid():
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o500)
        with pytest.raises(StoreError, match="cannot be made: Permission denied"):
            run_study(make_study(), directory=locked / "s", workers=1)


@settings(examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_flipped_byte_and_every_cut_is_found(finished: Path, data: st.DataObject) -> None:
    """Not only where the format notices: the checksum in the name covers all of it."""
    part = part_of(finished)
    content = part.read_bytes()
    at = data.draw(st.integers(0, len(content) - 1))
    if data.draw(st.booleans()):
        changed = content[:at]
    else:
        flip = data.draw(st.integers(1, 255))
        changed = content[:at] + bytes([content[at] ^ flip]) + content[at + 1 :]
    part.write_bytes(changed)
    try:
        with pytest.raises(StoreError, match=rf"{part.name}: broken: .*run the study into this folder again"):
            read_results(finished)
    finally:
        part.write_bytes(content)
    read_results(finished)


def test_only_what_is_bad_is_computed_anew(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored_rows: Callable[..., Any],
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    from studies.running import campaign
    from studies.running.tasks import Simulator

    with monkeypatch.context() as patch:
        patch.setattr(campaign, "_STORE_EVERY", 0.0)
        run_study(make_study(), directory=tmp_path, workers=1, block_size=1)
    before = stored_rows(tmp_path)
    parts = sorted((tmp_path / "results").iterdir())
    assert len(parts) == 14
    parts[3].write_bytes(parts[3].read_bytes()[:-7])
    parts[8].write_bytes(parts[8].read_bytes()[::-1])
    ran: list[int] = []
    run = Simulator.run
    monkeypatch.setattr(Simulator, "run", lambda self, task: (ran.append(task.runs), run(self, task))[1])
    run_study(make_study(), directory=tmp_path, workers=1)
    assert ran == [12, 12]
    assert all(f"{part.name}: broken" in caplog.text for part in (parts[3], parts[8]))
    assert stored_rows(tmp_path).equals(before)


def test_rows_are_read_in_one_line_by_polars_and_duckdb(finished: Path) -> None:
    import duckdb
    import polars as pl

    results = read_results(finished)
    design = results.designs[1].id
    expected = results.cases[0].S[1]
    rows = f"'{finished}/results/*.parquet' where design = '{design}' and convention = 'consistent'"
    mean = f"select avg(S_departure_m_s), count(*) from {rows}"
    told = duckdb.sql(mean).fetchall()[0]
    np.testing.assert_allclose(told[0], expected.mean(), rtol=1e-14)  # a sum in another order
    assert told[1] == 12
    lazy = pl.scan_parquet(f"{finished}/results/*.parquet").filter(design=design, convention="consistent").collect()
    np.testing.assert_array_equal(lazy.sort("scenario")["S_departure_m_s"].to_numpy(), expected)
    assert lazy.schema["a_y_peak_m_s2"] == pl.Float64()
    named = pl.read_parquet(finished / "designs.parquet").filter(design=design)
    assert named["law"].to_list() == [results.designs[1].law]
    assert named["label"].to_list() == [results.designs[1].label]
