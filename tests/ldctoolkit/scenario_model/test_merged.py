"""Several departures tables as one: which go together."""

import hashlib
from typing import Any

import pytest

from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import Preparation, Provenance, SourceFile
from ldctoolkit.scenario_model.model import merged_provenance


def origin(number: int, *more: SourceFile, **changed: Any) -> Provenance:
    return Provenance(sources=(SourceFile(f"{number}.csv", 10, f"{number:064d}"), *more), **changed)


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ({"step": 0.1}, {"step": None}, "step = None, a.parquet with 0.1"),
        ({}, {"nominal_lane_width": 3.5}, "nominal_lane_width = 3.5, a.parquet with None"),
        ({}, {"yaw_rate_factor": -1.0}, "yaw_rate_factor = -1.0, a.parquet with 1.0"),
        ({}, {"max_gap": 0.5}, "max_gap = 0.5, a.parquet with 0.25"),
    ],
)
def test_different_preparations(first: dict[str, Any], second: dict[str, Any], words: str) -> None:
    tables = [origin(0, preparation=Preparation(**first)), origin(1, preparation=Preparation(**second))]
    with pytest.raises(RecordingError, match=f"^b.parquet: extracted with {words}; allowed: .* the same preparation$"):
        merged_provenance(["a.parquet", "b.parquet"], tables)
    tables[1] = origin(1, preparation=Preparation(**first))
    assert merged_provenance(["a.parquet", "b.parquet"], tables).preparation == Preparation(**first)


def test_empty_files_are_no_recordings() -> None:
    """Two folders of trips may each hold an empty file; their digests are the same."""
    nothing = [SourceFile(f"{name}/RAW_GPS.txt", 0, hashlib.sha256(b"").hexdigest()) for name in ("D1", "D2")]
    found = merged_provenance(["a.parquet", "b.parquet"], [origin(i, one) for i, one in enumerate(nothing)])
    assert [source.name for source in found.sources] == ["0.csv", "D1/RAW_GPS.txt", "1.csv", "D2/RAW_GPS.txt"]
