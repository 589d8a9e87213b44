"""The departures table: what is written and read back, columns of the source's own, texts."""

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from helpers.errors import refused
from helpers.recordings import OFFSET, drive, frame_of
from ldctoolkit.departures import Departures, ExtraColumn, combined_departures
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import (
    Label,
    Preparation,
    Problem,
    Provenance,
    Recording,
    extract_departures,
    open_recordings,
    read_departures,
    write_departures,
)
from ldctoolkit.recordings.departures_table import COLUMNS, METADATA_KEY
from ldctoolkit.version import __version__


@pytest.fixture
def extracted(tmp_path):
    frame_of([drive("left"), drive("rechts, ä", lane_offset=-OFFSET)]).write_csv(tmp_path / "drive.csv")
    return extract_departures(open_recordings(tmp_path / "drive.csv"), vehicle_width=1.8)


@pytest.fixture
def written(extracted, tmp_path):
    path = tmp_path / "d.parquet"
    write_departures(path, extracted.departures, extracted.provenance)
    return path


def rewrite(path, frame):
    # only our own key: the file also holds a copy of its schema, which would no longer be true
    frame.write_parquet(path, metadata={METADATA_KEY: pl.read_parquet_metadata(path)[METADATA_KEY]})


def test_round_trip(extracted, written):
    departures, provenance = read_departures(written)
    assert (provenance, departures.recording.tolist()) == (extracted.provenance, ["left", "rechts, ä"])
    for field in dataclasses.fields(Departures):
        if field.name in ("extra", "signals"):
            assert not getattr(departures, field.name)
            continue
        arguments, back = getattr(extracted.departures, field.name), getattr(departures, field.name)
        np.testing.assert_array_equal(back, arguments)
        assert back.dtype.kind == arguments.dtype.kind


def test_a_table_of_an_earlier_version_does_not_know_distance_limits_and_systems(extracted, written):
    frame = pl.read_parquet(written)
    content = json.loads(pl.read_parquet_metadata(written)[METADATA_KEY])
    criteria = [content["criteria"].pop(name) for name in ("min_lane_width", "max_lane_width", "keep_engaged")]
    assert (criteria, content["refused"].pop("engaged")) == ([2.0, 7.0, False], 0)
    assert (extracted.distance, content.pop("distance")) == (495.0, 495.0)  # twice 9.9 s at 25 m/s
    frame.write_parquet(written, metadata={METADATA_KEY: json.dumps(content)})
    assert read_departures(written)[1] == dataclasses.replace(extracted.provenance, distance=0.0)


def test_criteria_and_reasons_come_back(tmp_path):
    steered = drive("a", engaged=(OFFSET > 1.0).astype(float))
    criteria = {"vehicle_width": 1.8, "min_lane_width": 2.5, "max_lane_width": 6.5}
    for keep, departures in ((False, 0), (True, 1)):
        extraction = extract_departures([steered], keep_engaged=keep, **criteria)
        write_departures(tmp_path / "d.parquet", extraction.departures, extraction.provenance)
        back, provenance = read_departures(tmp_path / "d.parquet")
        assert (back.n, provenance.refused.engaged) == (departures, 1 - departures)
        assert {name: getattr(provenance.criteria, name) for name in criteria} == criteria
        assert provenance.criteria.keep_engaged is keep


def test_what_the_file_holds(extracted, written, tmp_path):
    frame = pl.read_parquet(written)
    assert frame.columns == list(COLUMNS)
    assert frame["side"].to_list() == ["left", "right"]
    content = json.loads(pl.read_parquet_metadata(written)[METADATA_KEY])
    assert (content["format_version"], content["ldctoolkit"]) == (2, __version__)
    assert (content["criteria"]["vehicle_width"], content["refused"]["too_short"]) == (1.8, 0)
    assert content["sources"] == [dataclasses.asdict(extracted.provenance.sources[0])]
    assert content["sources"][0]["name"] == "drive.csv"
    assert str(tmp_path) not in json.dumps(content)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "drive.csv"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            pl.col("T_s").alias("d_y_m") * float("nan"),
            "row 1: column 'd_y_m' holds nan; allowed: no missing value (2 rows",
        ),
        (pl.lit(0.0).alias("T_s"), "row 1: column 'T_s' holds 0.0; allowed: > 0"),
        (pl.when(pl.int_range(pl.len()) == 0).then(0.1).alias("c_0_1_m"), "row 2: column 'c_0_1_m' holds None"),
        (pl.lit(-0.1).alias("sigma_y_m"), "column 'sigma_y_m' holds -0.1; allowed: >= 0"),
        (pl.lit("up").alias("side"), "row 1: column 'side' holds 'up'; allowed: left, right"),
        (pl.lit("x").alias("dc_1_m"), "column 'dc_1_m' is of type String; allowed: numbers"),
        (pl.lit(4.5).alias("samples"), "column 'samples' is of type Float64; allowed: integers"),
        (pl.lit(2).alias("samples"), "column 'samples' holds 2; allowed: 3 or more"),
        (pl.lit(7).alias("recording"), "column 'recording' is of type Int32; allowed: text"),
    ],
)
def test_bad_values(written, change, message):
    rewrite(written, pl.read_parquet(written).with_columns(change))
    with pytest.raises(RecordingError, match=rf"^d\.parquet.*{re.escape(message)}"):
        read_departures(written)


def test_bad_columns_and_metadata(written):
    frame = pl.read_parquet(written)
    content = json.loads(pl.read_parquet_metadata(written)[METADATA_KEY])
    rewrite(written, frame.rename({"sigma_y_m": "sigma_y"}))
    with refused(written.name, RecordingError, hint="did you mean 'sigma_y'? (columns not known here: sigma_y)"):
        read_departures(written)
    frame.write_parquet(written)
    with pytest.raises(RecordingError, match=r"no metadata 'ldctoolkit\.departures': not a departures table"):
        read_departures(written)
    for bad, message in [
        ("{", "cannot be understood"),
        ("[]", "cannot be understood"),
        (json.dumps(content | {"format_version": 3}), "departures table of format 3; this version reads 2"),
        (json.dumps(content | {"surprise": 1}), "cannot be understood: .*surprise"),
        (json.dumps(content | {"criteria": {"vehicle_width": -1}}), "cannot be understood: vehicle_width: -1"),
        (json.dumps(content | {"preparation": content["preparation"] | {"step": -1.0}}), "step: -1\\.0; allowed"),
        (json.dumps({k: v for k, v in content.items() if k != "refused"}), "cannot be understood: 'refused'"),
    ]:
        frame.write_parquet(written, metadata={METADATA_KEY: bad})
        with pytest.raises(RecordingError, match=rf"^d\.parquet: .*{message}"):
            read_departures(written)


def test_bad_files(written, tmp_path):
    with pytest.raises(RecordingError, match=r"nowhere\.parquet: cannot be read"):
        read_departures(tmp_path / "nowhere.parquet")
    with pytest.raises(RecordingError, match="Is a directory"):
        read_departures(tmp_path)
    for content, message in (
        (written.read_bytes()[:-7], "its content is not what was written .*; make it anew"),
        (b"", "cannot be read as Parquet"),
        (b"PAR1", "cannot be read as Parquet"),
    ):
        written.write_bytes(content)
        with pytest.raises(RecordingError, match=rf"d\.parquet: {message}"):
            read_departures(written)


def test_all_bytes_are_checked_before_anything_is_parsed(tmp_path, capfd):
    """Also those of the checksum and of its names; without one a table is read as it is, as one made by hand."""
    content = extract_departures([drive("a"), drive("b", lane_offset=-OFFSET)], vehicle_width=1.8, keep_signals=True)
    path = tmp_path / "d.parquet"
    write_departures(path, content.departures, content.provenance)
    for file in (path, tmp_path / "d.signals.parquet"):
        data = file.read_bytes()
        checksum = data.index(b"ldctoolkit.checksum")
        for offset in (*range(0, len(data), 97), *range(checksum, checksum + 105)):
            file.write_bytes(data[:offset] + bytes([data[offset] ^ 1 << offset % 8]) + data[offset + 1 :])
            with pytest.raises(RecordingError, match=f"^{file.name}: its content is not what was written"):
                read_departures(path, signals=True)
        file.write_bytes(data)
    assert capfd.readouterr().err == ""
    read_departures(path, signals=True)
    frame = pl.read_parquet(path).with_columns(d_y_m=pl.lit(0.5))
    frame.write_parquet(path, metadata=pl.read_parquet_metadata(path))
    with pytest.raises(RecordingError, match=r"if it was changed on purpose, drop its metadata 'ldctoolkit\.checksum'"):
        read_departures(path)
    rewrite(path, frame)
    assert read_departures(path)[0].d_y.tolist() == [0.5, 0.5]


def test_nothing_half_written(extracted, written, tmp_path):
    before = written.read_bytes()
    bad = dataclasses.replace(extracted.departures, T=np.array([np.nan, 1.0]))
    with pytest.raises(RecordingError, match=r"d\.parquet, row 1: column 'T_s' holds nan"):
        write_departures(written, bad, extracted.provenance)
    assert written.read_bytes() == before
    with pytest.raises(RecordingError, match=r"the suffix of a departures table is \.parquet"):
        write_departures(tmp_path / "d.csv", extracted.departures, extracted.provenance)
    (tmp_path / "taken.parquet").mkdir()
    for path in (tmp_path / "nofolder" / "d.parquet", written / "d.parquet", tmp_path / "taken.parquet"):
        with pytest.raises(RecordingError, match="cannot be written"):
            write_departures(path, extracted.departures, extracted.provenance)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["d.parquet", "drive.csv", "taken.parquet"]


def extract(*items: Recording | Problem, **preparation: Any) -> Any:
    return extract_departures(list(items), vehicle_width=1.8, preparation=Preparation(**preparation))


def columns_of(departures: Departures) -> dict[str, list[Any]]:
    return {column.name: column.values.tolist() for column in departures.extra}


def labels(**values: str) -> tuple[Label, ...]:
    return tuple(Label(name, value) for name, value in values.items())


def test_labels_become_columns_and_come_back(tmp_path):
    extraction = extract(
        drive("a", labels=labels(driver="D1", road="motorway"), source="D1"),
        drive("b", source="D2"),
        drive("c", labels=labels(road="ländlich, „x“"), source="D2", lane_scale=1.25),
        Problem("x.csv", "line 3", "what"),
    )
    expected = {
        "source": ["D1", "D2", "D2"], "lane_scale": [1.0, 1.0, 1.25], "driver": ["D1", "", ""],
        "road": ["motorway", "", "ländlich, „x“"],
    }  # fmt: skip
    assert columns_of(extraction.departures) == expected
    write_departures(tmp_path / "d.parquet", extraction.departures, extraction.provenance)
    frame = pl.read_parquet(tmp_path / "d.parquet")
    assert (frame.columns, frame["lane_scale"].dtype) == ([*COLUMNS, *expected], pl.Float64)
    departures, provenance = read_departures(tmp_path / "d.parquet")
    assert columns_of(departures) == expected
    assert [column.values.dtype.kind for column in departures.extra] == ["U", "f", "U", "U"]
    assert (provenance, provenance.problems) == (extraction.provenance, ("x.csv, line 3: what",))
    assert columns_of(departures.take([2])) == {name: values[2:] for name, values in expected.items()}


def test_columns_that_tell_nothing_are_left_out():
    assert columns_of(extract(drive("a", source="x"), drive("b", source="x")).departures) == {}
    assert columns_of(extract(drive("a"), step=0.1).departures) == {}
    assert columns_of(extract(drive("a"), nominal_lane_width=3.6).departures) == {"lane_scale": [1.0]}


def test_no_departures_but_columns(tmp_path):
    quiet = drive("a", lane_offset=np.zeros(100), labels=labels(driver="D1"))
    extraction = extract(quiet)
    write_departures(tmp_path / "d.parquet", extraction.departures, extraction.provenance)
    departures, _ = read_departures(tmp_path / "d.parquet")
    assert departures.n == 0
    assert columns_of(departures) == {"driver": []}


@pytest.mark.parametrize("name", ["T_s", "d_y", "recording", "side", "samples", "source", "lane_scale", ""])
def test_a_label_with_the_name_of_a_column(name, tmp_path):
    extraction = extract(drive("a", labels=labels(**{name: "x"}), source="x.csv"), drive("b", source="x.csv"))
    assert extraction.departures.recording.tolist() == ["b"]
    (problem,) = extraction.problems
    assert f"recording 'a': label {name!r}; allowed: a name that is no column" in str(problem)
    write_departures(tmp_path / "d.parquet", extraction.departures, extraction.provenance)


def test_tables_with_different_columns_are_joined():
    recording = extract(drive("a", labels=labels(driver="D1"))).departures
    two = extract(drive("b", labels=labels(road="city")), nominal_lane_width=3.6).departures
    none = extract(drive("c", lane_offset=np.zeros(100))).departures
    joined = combined_departures([recording, none, two])
    assert joined.recording.tolist() == ["a", "b"]
    back = columns_of(joined)
    assert list(back) == ["driver", "lane_scale", "road"]
    assert (back["driver"], back["road"]) == (["D1", ""], ["", "city"])
    np.testing.assert_array_equal(back["lane_scale"], [np.nan, 1.0])


@pytest.mark.slow
def test_a_model_is_fitted_to_a_table_with_extra_columns(tmp_path, capsys):
    """The same model as without them."""
    from ldctoolkit.studies.cli import main

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
        del model["provenance"], model["checksum"]
    assert models[0] == models[1]
