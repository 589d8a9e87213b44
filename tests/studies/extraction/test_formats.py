"""Sources that have parts of their own: two workers write the table that one writes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers import das1, uah
from ldctoolkit.recordings.opened import open_recordings
from studies.extraction import run_extraction


def das1_folder(folder: Path) -> None:
    for i in range(3):
        drives = [das1.planted_drive(7 + i, trip) for trip in (1, 2)]
        # a speed of its own each, else they would be told as one trip repeated
        drives = [dataclasses.replace(drive, speed=drive.speed + 2 * i + drive.trip) for drive in drives]
        das1.write_tables(folder, drives, suffix=f"_{i}")


def uah_folder(folder: Path) -> None:
    for i in range(3):
        uah.make_trip(seed=i).write(folder, f"2015111017571{i}-16km-D1-NORMAL-MOTORWAY")


@pytest.mark.slow
@pytest.mark.parametrize(("format_", "make"), [("spmd-das1", das1_folder), ("uah-driveset", uah_folder)])
def test_two_workers_write_what_one_writes(tmp_path: Path, format_: str, make: Callable[[Path], None]) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    make(folder)
    recordings = open_recordings(folder)
    assert recordings.reader.name == format_
    assert len(recordings.source.parts) == 3
    found = [run_extraction(recordings, output=tmp_path / f"{n}.parquet", workers=n) for n in (1, 2)]
    assert len(found[0].departures) >= 12
    assert not found[0].problems
    assert (tmp_path / "1.parquet").read_bytes() == (tmp_path / "2.parquet").read_bytes()
    assert found[0].provenance == found[1].provenance
