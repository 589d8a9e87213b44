"""Columns that travel along with departures: into the table, back, through joins and into a fit."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from helpers.recordings import drive
from ldctoolkit.departures import Departures, ExtraColumn, combined_columns, combined_departures
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import (
    Label,
    Preparation,
    Problem,
    Provenance,
    Recording,
    extract_departures,
    read_departures,
    write_departures,
)
from ldctoolkit.recordings.departures_table import COLUMNS, METADATA_KEY


def extract(*items: Recording | Problem, **preparation: Any) -> Any:
    return extract_departures(list(items), vehicle_width=1.8, preparation=Preparation(**preparation))


def columns_of(departures: Departures) -> dict[str, list[Any]]:
    return {column.name: column.values.tolist() for column in departures.extra}


def labels(**values: str) -> tuple[Label, ...]:
    return tuple(Label(name, value) for name, value in values.items())


def test_labels_become_columns_and_come_back(tmp_path):
    found = extract(
        drive("a", labels=labels(driver="D1", road="motorway"), source="D1"),
        drive("b", source="D2"),
        drive("c", labels=labels(road="ländlich, „x“"), source="D2", lane_scale=1.25),
        Problem("x.csv", "line 3", "what"),
    )
    wanted = {
        "source": ["D1", "D2", "D2"], "lane_scale": [1.0, 1.0, 1.25], "driver": ["D1", "", ""],
        "road": ["motorway", "", "ländlich, „x“"],
    }  # fmt: skip
    assert columns_of(found.departures) == wanted
    write_departures(tmp_path / "d.parquet", found.departures, found.provenance)
    frame = pl.read_parquet(tmp_path / "d.parquet")
    assert (frame.columns, frame["lane_scale"].dtype) == ([*COLUMNS, *wanted], pl.Float64)
    departures, provenance = read_departures(tmp_path / "d.parquet")
    assert columns_of(departures) == wanted
    assert [column.values.dtype.kind for column in departures.extra] == ["U", "f", "U", "U"]
    assert (provenance, provenance.problems) == (found.provenance, ("x.csv, line 3: what",))
    assert columns_of(departures.take([2])) == {name: values[2:] for name, values in wanted.items()}


def test_columns_that_tell_nothing_are_left_out():
    assert columns_of(extract(drive("a", source="x"), drive("b", source="x")).departures) == {}
    assert columns_of(extract(drive("a"), step=0.1).departures) == {}
    assert columns_of(extract(drive("a"), nominal_lane_width=3.6).departures) == {"lane_scale": [1.0]}


def test_no_departures_but_columns(tmp_path):
    quiet = drive("a", lane_offset=np.zeros(100), labels=labels(driver="D1"))
    found = extract(quiet)
    write_departures(tmp_path / "d.parquet", found.departures, found.provenance)
    departures, _ = read_departures(tmp_path / "d.parquet")
    assert departures.n == 0
    assert columns_of(departures) == {"driver": []}


@pytest.mark.parametrize("name", ["T_s", "d_y", "recording", "side", "samples", "source", "lane_scale", ""])
def test_a_label_with_the_name_of_a_column(name, tmp_path):
    found = extract(drive("a", labels=labels(**{name: "x"}), source="x.csv"), drive("b", source="x.csv"))
    assert found.departures.recording.tolist() == ["b"]
    (problem,) = found.problems
    assert f"recording 'a': label {name!r}; allowed: a name that is no column" in str(problem)
    write_departures(tmp_path / "d.parquet", found.departures, found.provenance)


def test_tables_with_different_columns_are_joined():
    one = extract(drive("a", labels=labels(driver="D1"))).departures
    two = extract(drive("b", labels=labels(road="city")), nominal_lane_width=3.6).departures
    none = extract(drive("c", lane_offset=np.zeros(100))).departures
    joined = combined_departures([one, none, two])
    assert joined.recording.tolist() == ["a", "b"]
    back = columns_of(joined)
    assert list(back) == ["driver", "lane_scale", "road"]
    assert (back["driver"], back["road"]) == (["D1", ""], ["", "city"])
    np.testing.assert_array_equal(back["lane_scale"], [np.nan, 1.0])


def test_numbers_and_text_under_one_name():
    """Text wins; a number that is not known is empty text, as it is where the column is missing."""
    text, numbers = ExtraColumn("x", np.array(["a"])), ExtraColumn("x", np.array([0.5, np.nan]))
    (joined,) = combined_columns([((text,), 1), ((numbers,), 2), ((), 1)])
    assert joined.values.tolist() == ["a", "0.5", "", ""]
    (joined,) = combined_columns([((numbers,), 2), ((), 1)])
    np.testing.assert_array_equal(joined.values, [0.5, np.nan, np.nan])
    assert combined_columns([((), 3)]) == ()


def test_foreign_columns_of_a_table(tmp_path):
    """Text and numbers travel along, whatever wrote them; anything else is passed over."""
    found = extract(drive("a"), drive("b"))
    path = tmp_path / "d.parquet"
    write_departures(path, found.departures, found.provenance)
    metadata = {METADATA_KEY: pl.read_parquet_metadata(path)[METADATA_KEY]}
    frame = pl.read_parquet(path).with_columns(
        pl.Series("trip", [7, None]), pl.Series("weather", [None, "rain"]), pl.Series("parts", [[1], [2]])
    )
    frame.write_parquet(path, metadata=metadata)
    departures, _ = read_departures(path)
    back = columns_of(departures)
    assert list(back) == ["trip", "weather"]
    np.testing.assert_array_equal(back["trip"], [7.0, np.nan])
    assert back["weather"] == ["", "rain"]


def test_a_preparation_that_is_not_allowed(tmp_path):
    found = extract(drive("a"))
    path = tmp_path / "d.parquet"
    write_departures(path, found.departures, found.provenance)
    content = json.loads(pl.read_parquet_metadata(path)[METADATA_KEY])
    content["preparation"]["step"] = -1.0
    pl.read_parquet(path).write_parquet(path, metadata={METADATA_KEY: json.dumps(content)})
    with pytest.raises(RecordingError, match=r"d\.parquet: its metadata .* step: -1\.0; allowed"):
        read_departures(path)


@pytest.mark.slow
def test_a_model_is_fitted_to_a_table_with_extra_columns(tmp_path, capsys):
    """The same model as without them."""
    from studies.cli import main

    rng = np.random.default_rng(0)
    n = 120
    numbers = [rng.uniform(low, high, n) for low, high in ((1.0, 4.0), (0.1, 0.5), (0.01, 0.05), (20.0, 30.0))]
    numbers += [rng.normal(0.0, scale, n) for scale in (0.1, 1.0, 1e-3, 1e-3)]
    numbers[5] = np.abs(numbers[5])
    base = (rng.choice([1, -1], n), *numbers, np.array(["a"] * n), np.arange(n) * 10.0, np.full(n, 20))
    extra = (ExtraColumn("driver", rng.choice(["D1", "D2"], n)), ExtraColumn("lane_scale", rng.uniform(1.0, 1.1, n)))
    models = []
    for i, columns in enumerate([(), extra]):
        write_departures(tmp_path / f"{i}.parquet", Departures(*base, extra=columns), Provenance())
        model = tmp_path / f"{i}.json"
        options = ["--components", "1", "--n-init", "1", "--workers", "1", "-o", str(model)]
        assert main(["fit", str(tmp_path / f"{i}.parquet"), *options]) == 0, capsys.readouterr().err
        models.append(json.loads(Path(model).read_text(encoding="utf-8")))
    capsys.readouterr()
    for model in models:
        model.pop("provenance", None)
    assert models[0] == models[1]
