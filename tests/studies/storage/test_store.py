"""The store: columns, shared rows, the model, damage."""

import contextlib
import dataclasses
import errno
import logging
import mmap
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from helpers.bits import assert_same_bits, examples
from ldctoolkit import Scenarios, load_model
from ldctoolkit.errors import StoreError
from ldctoolkit.metrics import METRIC_COLUMNS, METRIC_UNITS
from ldctoolkit.studies import Study, StudyResults, read_results, run_study
from ldctoolkit.studies.ranking.ranking import rank_study
from ldctoolkit.studies.running import campaign
from ldctoolkit.studies.running.tasks import Simulator
from ldctoolkit.studies.storage import store
from ldctoolkit.studies.storage.checked_parts import read_part
from ldctoolkit.studies.storage.folder_files import read_scenarios, write_scenarios
from ldctoolkit.studies.storage.manifest import read_manifest
from ldctoolkit.studies.storage.run_table import SharedRows, parse_part
from ldctoolkit.studies.storage.scenario_source import MODEL, read_model

N = 12


@pytest.fixture(scope="module")
def study() -> Study:
    return Study.from_dict(
        {
            "name": "small",
            "scenarios": {"left": 7, "right": N - 7},
            "ranking": {"bootstrap": 100, "finalists": 0},
            "design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.2], "gains": {"r_delta": [50, 500]}}],
        }
    )


@pytest.fixture(scope="module")
def folder(study: Study, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Many parts, each with some of the designs."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "_STORE_EVERY", 0.0)
        run_study(study, directory=folder, workers=1, block_size=2)
    assert len(list((folder / "results").iterdir())) > 3
    return folder


@pytest.fixture
def stored(folder: Path, monkeypatch: pytest.MonkeyPatch) -> StudyResults:
    monkeypatch.setattr(store, "_MOST_IN_MEMORY", 0)
    return read_results(folder)


def table_of(folder: Path, results: StudyResults, column: str) -> Any:
    """A column as another reader of the files finds it."""
    import polars as pl

    rows = pl.read_parquet(folder / "results" / "part-*.parquet")
    # even numbers are to the left, and the left ones first
    rows = rows.sort(pl.col("scenario") % 2, "scenario")
    pivot = rows.group_by("design", maintain_order=True).agg(pl.col(column))
    found = dict(zip(pivot["design"].to_list(), pivot[column].to_list(), strict=True))
    return np.array([found[design.id] for design in results.designs])


def mapping_of(values: Any) -> Any:
    """What an array's numbers are in, in the end."""
    while isinstance(values, np.ndarray):
        values = values.base
    return getattr(values, "obj", None)


def test_columns_are_what_the_parts_hold(folder: Path, stored: StudyResults) -> None:
    for name, column in METRIC_COLUMNS.items():
        values: Any = getattr(stored.metrics, name)
        assert isinstance(mapping_of(values), mmap.mmap)
        np.testing.assert_array_equal(values, table_of(folder, stored, column))


def test_without_room_on_the_disk_columns_are_in_memory(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(store, "_MOST_IN_MEMORY", 0)
    monkeypatch.setattr("os.posix_fallocate", full)
    found = read_results(folder)
    values = found.metrics.deepest
    assert not isinstance(mapping_of(values), mmap.mmap)
    np.testing.assert_array_equal(values, table_of(folder, found, METRIC_COLUMNS["deepest"]))


def test_a_study_gives_the_same_ranking_from_the_parts(folder: Path, study: Study, stored: StudyResults) -> None:
    one = rank_study(stored, study)
    in_memory = run_study(study, directory=folder, workers=1)
    assert not isinstance(mapping_of(in_memory.metrics.deepest), mmap.mmap)
    two = rank_study(in_memory, study)
    assert_same_bits(one, two)


def test_some_scenarios(stored: StudyResults) -> None:
    rows = np.arange(N) % 3 > 0
    some = stored.take(rows).take(np.arange(int(rows.sum())) > 1)
    kept = np.flatnonzero(rows)[2:]
    for name in METRIC_UNITS:
        column: Any = getattr(some.metrics, name)
        assert column.shape == (len(stored.designs), kept.size)
        np.testing.assert_array_equal(column[[3, 1]], np.asarray(getattr(stored.metrics, name))[[3, 1]][:, kept])
    np.testing.assert_array_equal(some.S_uncorrected, stored.S_uncorrected[:, kept])


def test_scores_without_control_are_one_row_where_they_are_equal(stored: StudyResults, study: Study) -> None:
    assert stored.S_uncorrected.strides[0] == 0
    control = run_study(study.changed(simulation={"window": "control"}), workers=1)
    assert control.S_uncorrected.strides[0] > 0


def test_other_columns_are_checked(folder: Path, study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A part whose checksum is right and whose numbers are not."""
    import polars as pl

    monkeypatch.setattr(store, "_MOST_IN_MEMORY", 0)
    shutil.copytree(folder, tmp_path / "copy")
    part = max((tmp_path / "copy" / "results").iterdir())
    table = pl.read_parquet(read_part(part)).with_columns(travel_rad=pl.lit(np.nan))
    monkeypatch.setattr(store, "read_part", lambda path: path.read_bytes())
    table.write_parquet(part)
    with pytest.raises(StoreError, match=f"{part.name}: broken: column travel_rad holds a value that is not finite"):
        read_results(tmp_path / "copy")


D, N_SHARED_ROWS = 4, 6


@given(
    st.lists(
        st.tuples(
            st.integers(0, D - 1),
            st.one_of(
                st.slices(N_SHARED_ROWS).filter(lambda s: s.step in (None, 1)),
                st.lists(st.integers(0, N_SHARED_ROWS - 1), unique=True),
            ),
            st.integers(0, 9),
        ),
        max_size=20,
    ),
    st.integers(0, 20),
)
def test_it_holds_what_was_put_in(steps: list[tuple[int, Any, int]], grown_at: int) -> None:
    """Nine of ten steps write the same row, -0.0 and NaN in it; a value that is put twice is the same twice."""
    usual = np.array([0.0, -0.0, np.nan, 3.0, np.inf, 5.0])
    rows, plain, there = (
        SharedRows(D, N_SHARED_ROWS),
        np.zeros((2 * D, N_SHARED_ROWS)),
        np.zeros((2 * D, N_SHARED_ROWS), dtype=bool),
    )
    size = D
    for k, (place, columns, odd) in enumerate(steps):
        if k == grown_at:
            size = 2 * D
            rows.grow(size)
        if isinstance(columns, list):
            columns = np.array(columns, dtype=np.int64)
        values = usual[columns] if odd else usual[columns] + 1.0
        rows.put(place, columns, values)
        plain[place, columns], there[place, columns] = values, True
    found = rows.take(None)
    assert found.shape == (size, N_SHARED_ROWS)
    same = found.view(np.int64) if found.strides[0] else np.ascontiguousarray(found).view(np.int64)
    assert (same == plain[:size].view(np.int64))[there[:size]].all()
    some = np.array([2, 0])
    np.testing.assert_array_equal(rows.take(some), found[some])


def test_equal_rows_are_kept_once() -> None:
    rows = SharedRows(3, 2)
    for place in range(3):
        rows.put(place, slice(0, 2), np.array([np.nan, 1.0]))
    assert rows.take(None).strides == (0, 8)
    rows.put(1, np.array([1]), np.array([2.0]))
    np.testing.assert_array_equal(rows.take(None), [[np.nan, 1.0], [np.nan, 2.0], [np.nan, 1.0]])


STUDY = {"name": "small", "scenarios": {"left": 4, "right": 4}, "design": [{"law": "none"}]}


def test_a_run_leaves_its_model(small_run: Path) -> None:
    manifest, reference = read_manifest(small_run), load_model("reference")
    model = read_model(small_run, manifest)
    assert model.content_hash == reference.content_hash == manifest.model_hash
    assert model.provenance == reference.provenance


def test_a_missing_model_is_none_and_another_or_a_broken_one_is_refused(small_run: Path, tmp_path: Path) -> None:
    manifest = read_manifest(small_run)
    with pytest.raises(StoreError, match=r"model\.json: holds the model \w{12}, the study's is 000000000000; run"):
        read_model(small_run, manifest.model_copy(update={"model_hash": "0" * 64}))
    assert read_model(tmp_path, manifest) is None  # of an earlier version
    (tmp_path / MODEL).write_text("{")
    with pytest.raises(StoreError, match=r"model\.json, line 1.*run the study into this folder again"):
        read_model(tmp_path, manifest)


def test_a_model_that_json_does_not_know_runs(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    model = load_model("reference")
    odd = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, source={"x": object()}))
    with caplog.at_level(logging.WARNING, logger="studies"):
        run_study(Study.from_dict(STUDY), directory=tmp_path / "o", model=odd, workers=1)
    assert "the report will not show the scenario model" in caplog.text
    assert not (tmp_path / "o" / MODEL).exists()


def test_stored_scenarios_beyond_the_limits_of_new_ones_are_read(tmp_path: Path) -> None:
    odd = Scenarios.drawn(T=2.0, d_y=30.0, v_mean=120.0, a_mean=0.0, c_0=0.1, dc=0.0, sigma_y=0.0, sigma_v=0.0, side=1)
    write_scenarios(tmp_path, odd)
    found = read_scenarios(tmp_path / "scenarios.parquet")
    assert (found.v_mean.tolist(), found.d_y.tolist()) == ([120.0], [30.0])


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
            list(parse_part(part, read_part(part), study.simulation.window, 300))  # whole, or not there
        assert not list(disk.rglob(".*.part"))
        subprocess.run(["mount", "-o", "remount,size=100m", str(disk)], check=True)
        run_study(study, directory=disk / "s", workers=1)
        run_study(study, directory=tmp_path / "whole", workers=1)
        assert stored_rows(disk / "s").equals(stored_rows(tmp_path / "whole"))


def test_a_disk_that_fills_on_the_way(make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On every machine: the second part finds no room."""
    monkeypatch.setattr(campaign, "_STORE_EVERY", 0.0)
    whole, written = Path.write_bytes, []

    def full(path: Path, data: bytes) -> int:
        written.extend([path] if path.parent.name == "results" else [])
        if len(written) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return whole(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
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
    with monkeypatch.context() as patch:
        patch.setattr(campaign, "_STORE_EVERY", 0.0)
        run_study(make_study(), directory=tmp_path, workers=1, block_size=1)
    before = stored_rows(tmp_path)
    parts = sorted((tmp_path / "results").iterdir())
    assert len(parts) == 7
    parts[3].write_bytes(parts[3].read_bytes()[:-7])
    parts[5].write_bytes(parts[5].read_bytes()[::-1])
    ran: list[int] = []
    run = Simulator.run
    monkeypatch.setattr(Simulator, "run", lambda self, task: (ran.append(task.runs), run(self, task))[1])
    run_study(make_study(), directory=tmp_path, workers=1)
    assert ran == [12, 12]
    assert all(f"{part.name}: broken" in caplog.text for part in (parts[3], parts[5]))
    assert stored_rows(tmp_path).equals(before)


def test_rows_are_read_in_one_line_by_polars_and_duckdb(small_run: Path) -> None:
    import duckdb
    import polars as pl

    results = read_results(small_run)
    design = results.designs[1].id
    expected = results.S[1]
    rows = f"'{small_run}/results/*.parquet' where design = '{design}'"
    mean = f"select avg(S_departure_m_s), count(*) from {rows}"
    mean_and_count = duckdb.sql(mean).fetchall()[0]
    np.testing.assert_allclose(mean_and_count[0], expected.mean(), rtol=1e-14)  # a sum in another order
    assert mean_and_count[1] == 12
    lazy = pl.scan_parquet(f"{small_run}/results/*.parquet").filter(design=design).collect()
    in_order = lazy.sort(pl.col("scenario") % 2, "scenario")
    np.testing.assert_array_equal(in_order["S_departure_m_s"].to_numpy(), expected)
    assert lazy.schema["a_y_peak_m_s2"] == pl.Float64()
    named = pl.read_parquet(small_run / "designs.parquet").filter(design=design)
    assert named["law"].to_list() == [results.designs[1].law]
    assert named["label"].to_list() == [results.designs[1].label]
