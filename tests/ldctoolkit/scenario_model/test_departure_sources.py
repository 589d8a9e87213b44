"""Departures tables that stay in files: the same model as in memory, what is told of wrong tables, memory."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys

import numpy as np
import polars as pl
import pytest

from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, PARAMETER_NAMES, RIGHT
from ldctoolkit.errors import InputError, RecordingError
from ldctoolkit.mixture import ArrayEvents
from ldctoolkit.recordings import Criteria, Provenance, Refused, SourceFile, read_departures, write_departures
from ldctoolkit.scenario_model import (
    DepartureSources,
    fit_scenario_model,
    open_departures,
    read_all_departures,
    table_rows,
)

FIT = {"components": [1, 2], "n_init": 2, "seed": 4}


@pytest.fixture(scope="module")
def made(departures):
    """4,600 departures in mixed order, some on a bound."""
    drawn = departures(2300, seed=2, sigma_v=np.random.default_rng(0).gamma(4.0, 0.01, 4600))
    drawn.sigma_v[:9] = 0.0
    drawn.T[2300:2303] = 10.0
    return drawn.take(np.random.default_rng(1).permutation(4600))


def origin(number=0, **changed):
    source = SourceFile(f"{number}.csv", 10, f"{number:064d}")
    given = {"refused": Refused(gap=3), "recordings": 2, "hours": 1.5, "curvature": "none", "warnings": ("odd",)}
    return Provenance(sources=(source,), **{**given, **changed})


@pytest.fixture(scope="module")
def tables(made, tmp_path_factory):
    """The departures in two tables."""
    folder = tmp_path_factory.mktemp("tables")
    paths = [folder / "a.parquet", folder / "b.parquet"]
    write_departures(paths[0], made.take(slice(0, 1000)), origin(0))
    write_departures(paths[1], made.take(slice(1000, None)), origin(1, curvature="measured"))
    return paths


@pytest.fixture
def changed(tables, tmp_path):
    """Writes the first table with changed columns, and with its metadata unless told otherwise."""

    def write(*changes, metadata=True, name="x.parquet"):
        path = tmp_path / name
        kept = {k: v for k, v in pl.read_parquet_metadata(tables[0]).items() if k.startswith("ldc")} if metadata else {}
        pl.read_parquet(tables[0]).with_columns(*changes).write_parquet(path, metadata=kept)
        return path

    return write


@pytest.mark.parametrize("more", [{}, {"transform": "auto", "bounds": {"d_y": (0.0, 3.0)}}])
def test_the_same_model_as_in_memory(made, tables, more):
    inside = fit_scenario_model(made, **FIT, **more)
    for threads in (1, 3):
        with open_departures(tables, threads=threads) as sources:
            model = fit_scenario_model(sources, **FIT, **more)
        assert model.content_hash == inside.content_hash
        assert model.provenance.left == inside.provenance.left
        assert model.provenance.right == inside.provenance.right
        assert model.provenance.warnings == inside.provenance.warnings
    assert inside.provenance.left.moved_inside == (("sigma_v", 9),)
    assert inside.provenance.right.moved_inside == (("T", 3),)
    assert {name for name, _ in inside.left_side.constants} == {"sigma_y", "a_mean", "c_0", "dc"}


def test_weights_in_a_column(made, changed):
    weight = np.random.default_rng(3).integers(1, 4, 1000)
    path = changed(pl.Series("weight", weight))
    inside = fit_scenario_model(made.take(slice(0, 1000)), weights=weight, **FIT)
    model = fit_scenario_model(open_departures(path, weight="weight"), **FIT)
    assert model.content_hash == inside.content_hash
    assert model.provenance.left == inside.provenance.left
    assert model.provenance.left.weight == weight[made.side[:1000] == LEFT].sum()
    # weights that sum to the number of events are weights all the same
    of_one = fit_scenario_model(open_departures(changed(pl.lit(1).alias("w")), weight="w"), **FIT)
    assert of_one.provenance.left.weight == of_one.provenance.left.events


def test_any_pair_of_sources(made):
    left, right = (ArrayEvents(made.matrix()[made.side == side]) for side in (LEFT, RIGHT))
    model = fit_scenario_model(DepartureSources(left, right), **FIT)
    assert model.content_hash == fit_scenario_model(made, **FIT).content_hash


def test_tables_together(tables):
    with open_departures(tables) as sources:
        found = sources.provenance
    departures, read = read_all_departures(tables)
    assert read == found
    assert [source.name for source in found.sources] == ["0.csv", "1.csv"]
    assert (found.recordings, found.hours, found.refused.gap) == (4, 3.0, 6)
    assert (found.curvature, found.warnings) == ("mixed", ("odd",))
    assert departures.n == table_rows(tables) == 4600
    assert open_departures(tables[0]).provenance == read_departures(tables[0])[1]


def test_some_departures_are_drawn(made, tables):
    with open_departures(tables) as sources:
        drawn, weights = sources.draw(1000, seed=1)
        again, _ = sources.draw(1000, seed=1)
        other, _ = sources.draw(1000, seed=2)
        every, _ = sources.draw(10**6, seed=1)
    assert weights is None
    assert np.array_equal(drawn.matrix(), again.matrix())
    assert not np.array_equal(drawn.matrix(), other.matrix())
    assert (drawn.side == LEFT).sum() == (drawn.side == RIGHT).sum() == 500
    for side in (LEFT, RIGHT):
        rows = {tuple(row) for row in made.matrix()[made.side == side]}
        few = [tuple(row) for row in drawn.matrix()[drawn.side == side]]
        assert len(set(few)) == len(few)
        assert set(few) <= rows
        assert np.array_equal(every.matrix()[every.side == side], made.matrix()[made.side == side])


def test_every_departure_has_the_same_chance():
    x = np.tile(np.arange(70.0)[:, None], (1, 8))
    sources = DepartureSources(ArrayEvents(x, np.full(70, 2.0)), ArrayEvents(x[:7], np.full(7, 3.0)))
    draws = [sources.draw(33, seed) for seed in range(2000)]
    counts = np.bincount(np.concatenate([d.T[d.side == LEFT] for d, _ in draws]).astype(int), minlength=70)
    # 30 of 70 rows; a count of 2,000 draws has a standard deviation of at most sqrt(2000)/2 = 22; stretches of 2 and 3
    assert counts.sum() == 2000 * 30
    assert set(np.round(counts / 2000, 1)) <= {0.3, 0.4, 0.5, 0.6}
    assert [(w == 2.0).sum() for _, w in draws[:3]] == [30, 30, 30]
    assert [(w == 3.0).sum() for _, w in draws[:3]] == [3, 3, 3]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            pl.when(pl.int_range(pl.len()) == 6).then(pl.lit("rihgt")).otherwise("side").alias("side"),
            RecordingError,
            "x.parquet, row 7: column 'side' holds 'rihgt'; allowed: left, right",
        ),
        (
            pl.when(pl.int_range(pl.len()) > 6).then("side").otherwise(None).alias("side"),
            RecordingError,
            "x.parquet, row 1: column 'side' holds None; allowed: left, right (7 rows in all)",
        ),
        (pl.col("T_s").cast(pl.String), InputError, "x.parquet: column 'T_s' is of type String; allowed: numbers"),
        (pl.lit(1).alias("side"), InputError, "where: 'side' = 'left'; allowed: a value of type Int32"),
    ],
)
def test_tables_that_cannot_be_opened(changed, change, error, message):
    with pytest.raises(error, match=f"^{re.escape(message)}"):
        open_departures(changed(change))


def test_files_that_are_no_tables(changed, tmp_path):
    (tmp_path / "t.parquet").write_text("no Parquet")
    for look in (open_departures, table_rows):
        with pytest.raises(RecordingError, match=r"^t\.parquet: cannot be read as Parquet: "):
            look(tmp_path / "t.parquet")
        with pytest.raises(RecordingError, match=r"nix\.parquet: does not exist; a departures table is needed$"):
            look(tmp_path / "nix.parquet")
    with pytest.raises(
        RecordingError, match=r"^x\.parquet: no metadata 'ldctoolkit\.departures': not a departures tab"
    ):
        open_departures(changed(metadata=False))


@pytest.mark.parametrize("look", [open_departures, read_all_departures])
def test_tables_that_do_not_go_together(made, tables, tmp_path, look):
    faster = tmp_path / "faster.parquet"
    write_departures(faster, made, origin(7, criteria=Criteria(min_speed=7.0)))
    message = (
        r"^faster\.parquet: extracted with min_speed = 7\.0, a\.parquet with 5\.0; allowed: tables of the same crit"
    )
    with pytest.raises(RecordingError, match=message):
        look([*tables, faster])
    again = tmp_path / "again.parquet"
    write_departures(again, made, origin(1))
    with pytest.raises(
        RecordingError, match=r"^again\.parquet: holds departures of 1\.csv, as does b\.parquet; allowed"
    ):
        look([*tables, again])
    with pytest.raises((RecordingError, InputError), match=r"a\.parquet.* given more than once"):
        look([tables[0], tables[0]])


@pytest.mark.parametrize(
    ("change", "more", "message"),
    [
        (pl.lit(-0.1).alias("sigma_v_m_s"), {}, "departures (left): sigma_v = -0.1 in event 0; allowed: 0 to inf ("),
        (pl.lit(99.0).alias("T_s"), {}, "departures (left): T = 99.0 in event 0; allowed: 0.5 to 10 ("),
        (pl.lit(1e300).alias("d_y_m"), {}, ""),  # a constant, if a strange one
        (pl.lit(float("nan")).alias("c_0_1_m"), {}, "x.parquet, row 5: column 'c_0_1_m' holds nan; allowed: finite nu"),
        (
            pl.when(pl.col("T_s") > 2.0).then(0.0).otherwise("T_s").alias("T_s"),
            {"bounds": {"T": (0.0, 10.0)}},
            "departures (left): T = 0.0 in event 0; allowed: above 0 (",
        ),
        (
            pl.when(pl.int_range(pl.len()) < 950).then(pl.lit("left")).otherwise(pl.lit("right")).alias("side"),
            {"components": range(30, 40)},
            "components: 30 and more; allowed: a range that begins at",
        ),
        (
            pl.when(pl.int_range(pl.len()) < 980).then(pl.lit("left")).otherwise(pl.lit("right")).alias("side"),
            {},
            "departures: 980 left and 20 right; allowed: at least 30 a side",
        ),
        (pl.lit("left").alias("side"), {}, "x.parquet: none of 1000 rows has side = 'right'; side: allowed: left"),
        ([], {"bounds": "auto"}, "bounds['T']: 'auto' for departures in files; allowed: 'physical' or (lower, upper)"),
        ([], {"bounds": {"d_y": (0.0, "auto")}}, "bounds['d_y']: 'auto' for departures in files; "),
        ([], {"criterion": "held_out"}, "criterion: 'held_out' for a source of events; allowed: bic, aic, icl, or"),
        ([], {"weights": [1.0]}, "weights: given beside sources of departures; allowed: weights in the sources"),
    ],
)
def test_fits_that_are_refused(changed, change, more, message):
    sources = open_departures(changed(change))
    if not message:
        assert ("d_y", 1e300) in fit_scenario_model(sources, components=1, **more).left_side.constants
        return
    with pytest.raises(InputError, match=f"^{re.escape(message)}"):
        fit_scenario_model(sources, **{"components": 1, **more})


def test_the_count_of_wrong_values_is_over_all_blocks():
    x = np.tile([2.0, 0.2, 0.05, 25.0, 0.0, 0.04, 0.0, 0.0], (20_000, 1))
    x[:, 1] += np.linspace(0.0, 0.1, 20_000)
    x[[9000, 19_000], 0] = 11.0
    good = ArrayEvents(np.where(x == 11.0, 2.0, x))
    message = r"^departures \(right\): T = 11\.0 in event 9000; allowed: 0\.5 to 10 \(2 of 20000 events\)$"
    with pytest.raises(InputError, match=message):
        fit_scenario_model(DepartureSources(good, ArrayEvents(x)), components=1)
    with pytest.raises(InputError, match=r"^departures \(right\): 3 columns; allowed: the 8 parameters T, d_y, "):
        fit_scenario_model(DepartureSources(good, ArrayEvents(x[:, :3])), components=1)


MEMORY = """
import sys
from ldctoolkit.scenario_model import fit_scenario_model, open_departures

def status(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key)) / 1024

def fit(path):
    return fit_scenario_model(open_departures(path, threads=2), components=2, n_init=1, max_iter=3)

fit(sys.argv[1])  # what is loaded once
start = status("VmRSS")
model = fit(sys.argv[2])
print(status("VmHWM") - start, model.provenance.left.events)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_a_whole_fit_stays_below_the_table(departures, tmp_path):
    """Three million departures are 183 MiB of parameters; measured: 49 MiB above the start."""
    drawn = departures(40_000)
    write_departures(tmp_path / "small.parquet", drawn, Provenance())
    kept = {k: v for k, v in pl.read_parquet_metadata(tmp_path / "small.parquet").items() if k.startswith("ldc")}
    rng = np.random.default_rng(0)
    rows = rng.integers(0, 80_000, 3_000_000)
    columns = {PARAMETER_COLUMNS[name]: getattr(drawn, name)[rows] for name in PARAMETER_NAMES}
    columns["d_y_m"] = columns["d_y_m"] * rng.uniform(0.9, 1.0, rows.size)  # nothing that compresses
    columns["v_mean_m_s"] = columns["v_mean_m_s"] * rng.uniform(0.9, 1.0, rows.size)
    columns["side"] = np.where(drawn.side[rows] == LEFT, "left", "right")
    pl.DataFrame(columns).write_parquet(tmp_path / "large.parquet", metadata=kept)
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, tmp_path / "small.parquet", tmp_path / "large.parquet"],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    growth, events = map(float, done.stdout.split())
    assert events > 1_400_000
    assert growth < 90


@pytest.mark.slow
def test_the_same_model_on_a_cluster(made, tables, tmp_path):
    distributed = pytest.importorskip("distributed")
    inside = fit_scenario_model(made, **FIT)
    with (
        distributed.LocalCluster(
            processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
        ) as cluster,
        open_departures(tables, cluster=cluster.scheduler_address) as sources,
    ):
        model = fit_scenario_model(sources, **FIT)
        assert model.content_hash == inside.content_hash
        assert dataclasses.replace(model.provenance, created="") == dataclasses.replace(inside.provenance, created="")
        drawn, _ = sources.draw(100, seed=1)
        assert np.array_equal(drawn.matrix(), open_departures(tables).draw(100, seed=1)[0].matrix())
        wrong = pl.read_parquet(tables[0]).with_columns(side=pl.lit("both"))
        kept = {k: v for k, v in pl.read_parquet_metadata(tables[0]).items() if k.startswith("ldc")}
        pl.concat([wrong, pl.read_parquet(tables[1])]).write_parquet(tmp_path / "w.parquet", metadata=kept)
        message = r"^w\.parquet, row 1: column 'side' holds 'both'; allowed: left, right \(1000 rows in all\)$"
        with pytest.raises(RecordingError, match=message):
            open_departures(tmp_path / "w.parquet", cluster=cluster.scheduler_address)
        with distributed.Client(cluster, set_as_default=False) as client:
            open_departures(tables, cluster=client).close()
            assert client.status == "running"  # a client that was given stays open
