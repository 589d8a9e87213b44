"""Events in Parquet files: the same bits as in memory however rows are cut, bounded memory, errors that say where."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ldctoolkit.errors import InputError
from ldctoolkit.mixture import ArrayEvents, BoundedGaussianMixture, EventSource, _parquet_rows, select_components
from ldctoolkit.mixture.parquet_events import ParquetEvents
from ldctoolkit.mixture.sources import BLOCK, Pass, profile_of, sums_of

COLUMNS = ("T_s", "d_y_m", "v_mean_m_s")


def table(n=2 * BLOCK + 321, seed=0):
    rng = np.random.default_rng(seed)
    numbers = {name: rng.gamma(2.0, size=n) + 0.01 for name in COLUMNS}
    weight = rng.integers(0, 4, size=n).astype(np.int32)
    side = rng.choice(["left", "right"], n)
    return pl.DataFrame({"side": side, **numbers, "weight": weight, "twin": rng.integers(0, 3, n)})


def matrix(frame):
    return np.ascontiguousarray(frame.select(pl.col(COLUMNS).cast(pl.Float64)).to_numpy())


def write(folder, frame, cuts, row_group=None):
    """One file for each part between the cuts."""
    paths = []
    for i, (first, end) in enumerate(zip([0, *cuts], [*cuts, frame.height], strict=True)):
        paths.append(Path(folder, f"part{i}.parquet"))
        frame[first:end].write_parquet(paths[-1], row_group_size=row_group)
    return paths


@pytest.fixture
def one(tmp_path):
    """A file with the table, as changed."""

    def make(*changes, frame=None, name="d.parquet"):
        path = tmp_path / name
        (table(500) if frame is None else frame).with_columns(*changes).write_parquet(path)
        return path

    return make


@pytest.mark.parametrize("weight", [None, "weight"])
@pytest.mark.parametrize("where", [None, {"side": "left"}, {"side": "right", "twin": 2}])
def test_the_same_bits_as_in_memory(tmp_path, where, weight):
    frame = table()
    paths = write(tmp_path, frame, [1, 1, 9000, 9001], row_group=777)
    for name, value in (where or {}).items():
        frame = frame.filter(pl.col(name) == value)
    x, w = matrix(frame), None if weight is None else frame[weight].to_numpy().astype(float)
    stream, array = ParquetEvents(paths, COLUMNS, where=where, weight=weight, threads=3), ArrayEvents(x, w)
    assert isinstance(stream, EventSource)
    assert (stream.dimension, stream.columns) == (3, COLUMNS)
    assert repr(profile_of(stream)) == repr(profile_of(array))
    work = Pass(np.full(3, 2.0), np.ones(3), np.random.default_rng(1).normal(size=(3, 10)) * 0.1)
    (value, sums), (other_value, other_sums) = sums_of(stream, work), sums_of(array, work)
    assert value == other_value
    assert np.array_equal(sums, other_sums)
    assert np.array_equal(np.concatenate(list(stream.blocks())), x)
    assert [block.shape[0] for block in stream.blocks()] == [block.shape[0] for block in array.blocks()]
    for rows in (np.array([0, 3, x.shape[0] - 1]), np.arange(x.shape[0]), np.array([], dtype=np.int64)):
        (found, weights), (expected, other_weights) = stream.take(rows), array.take(rows)
        assert found.flags.c_contiguous
        assert np.array_equal(found, expected)
        assert (weights is None) == (other_weights is None)
        assert weights is None or np.array_equal(weights, other_weights)


@given(
    cuts=st.lists(st.integers(0, 60), max_size=4).map(sorted),
    row_group=st.sampled_from([1, 4, 7, 100]),
    piece=st.integers(1, 30),
    chosen=st.sampled_from([None, "left", "right"]),
    rows=st.lists(st.integers(0, 19), unique=True).map(sorted),
)
@settings(max_examples=60, deadline=None)
def test_any_cutting_gives_the_same_blocks(cuts, row_group, piece, chosen, rows):
    frame = table(60, seed=5)
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        paths = write(folder, frame, cuts, row_group)
        patch.setattr(_parquet_rows, "PIECE", piece)
        patch.setattr(_parquet_rows, "BLOCK", 8)
        where = None if chosen is None else {"side": chosen}
        stream = ParquetEvents(paths, COLUMNS, where=where, weight="weight", threads=2)
        taken = frame if chosen is None else frame.filter(pl.col("side") == chosen)
        x, w = matrix(taken), taken["weight"].to_numpy()
        found = list(stream.map_blocks(lambda x, w: (x, w)))
        assert [part.shape[0] for part, _ in found] == [min(8, x.shape[0] - at) for at in range(0, x.shape[0], 8)]
        assert all(part.flags.c_contiguous for part, _ in found)  # the last digits of sums depend on it
        assert np.array_equal(np.concatenate([part for part, _ in found]), x)
        assert np.array_equal(np.concatenate([part for _, part in found]), w)
        assert np.array_equal(stream.take(np.array(rows, dtype=np.int64))[0], x[rows])


@pytest.mark.parametrize("transform", [None, "auto"])
def test_a_fit_is_the_fit_to_the_array(tmp_path, transform):
    frame = table()
    paths = write(tmp_path, frame, [5000], row_group=999)
    settings = {"lower": 0.0, "random_state": 3, "n_init": 2, "max_iter": 12, "transform": transform}
    w = frame["weight"].to_numpy().astype(float)
    array = BoundedGaussianMixture(2, **settings).fit(matrix(frame), sample_weight=w)
    stream = BoundedGaussianMixture(2, **settings).fit(ParquetEvents(paths, COLUMNS, weight="weight"))
    for name in ("weights_", "means_", "covariances_", "lower_bounds_"):
        assert np.array_equal(getattr(array, name), getattr(stream, name)), name


def test_choosing_K_from_a_file(one):
    frame = table(3000)
    settings = {"lower": 0.0, "random_state": 0, "n_init": 1, "max_iter": 10}
    stream = select_components(ParquetEvents(one(frame=frame), COLUMNS), (1, 2), **settings)
    array = select_components(matrix(frame), (1, 2), **settings)
    assert stream.bic == pytest.approx(array.bic, rel=1e-12)
    assert np.array_equal(stream.best.means_, array.best.means_)


@pytest.mark.parametrize("kind", [pl.Float32, pl.Int16, pl.UInt64, pl.Decimal(12, 2)])
def test_any_number_type(one, kind):
    frame = table(500).with_columns((pl.col(COLUMNS) * 10).round(1).cast(kind))
    assert np.array_equal(next(ParquetEvents(one(frame=frame), COLUMNS).blocks()), matrix(frame))


@pytest.mark.parametrize(
    ("column", "value"),
    [
        (pl.Series(["a", "b", "a"], dtype=pl.Categorical), "a"),
        (pl.Series(["a", "b", "a"], dtype=pl.Enum(["a", "b"])), "a"),
        (pl.Series([1, -1, 1], dtype=pl.Int8), np.int64(1)),
        (pl.Series([1.5, None, 1.5]), 1.5),
        (pl.Series([True, False, True]), True),
    ],
)
def test_filters_of_any_type(tmp_path, column, value):
    pl.DataFrame({"x": [1.0, None, 3.0], "f": column}).write_parquet(tmp_path / "d.parquet")
    found = ParquetEvents(tmp_path / "d.parquet", ["x"], where={"f": value})
    assert next(found.blocks()).ravel().tolist() == [1.0, 3.0]


# what is refused


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"columns": ("T_s", "d_y")}, "d.parquet: column 'd_y' is missing; did you mean 'd_y_m'? (allowed: T_s,"),
        ({"columns": ("T_s", "side")}, "d.parquet: column 'side' is of type String; allowed: numbers"),
        ({"columns": ()}, "columns: (); allowed: one or more names of columns"),
        ({"columns": "T_s"}, "columns: 'T_s'; allowed: one or more names of columns"),
        ({"columns": ("T_s", "T_s")}, "columns: 'T_s' is given more than once"),
        ({"weight": "wait"}, "d.parquet: column 'wait' is missing; did you mean 'weight'?"),
        ({"weight": "T_s"}, "weight: 'T_s' is among the columns of an event; allowed: another column"),
        ({"weight": "side"}, "d.parquet: column 'side' is of type String; allowed: numbers"),
        ({"where": {"sid": "left"}}, "d.parquet: column 'sid' is missing; did you mean 'side'?"),
        ({"where": {"side": 1}}, "where: 'side' = 1; allowed: a value of type String, as in d.parquet"),
        ({"where": {"twin": "1"}}, "where: 'twin' = '1'; allowed: a value of type Int64, as in d.parquet"),
        ({"where": {"twin": True}}, "where: 'twin' = True; allowed: a value of type Int64, as in d.parquet"),
        ({"where": {"side": ["left"]}}, "where: 'side' = ['left']; allowed: a text, a number or a truth value"),
        ({"threads": 0}, "threads: 0; allowed: an integer >= 1"),
    ],
)
def test_wrong_requests(one, arguments, message):
    with pytest.raises(InputError, match="^" + re.escape(message)):
        ParquetEvents(one(), **{"columns": COLUMNS, **arguments})


def test_wrong_files(one, tmp_path):
    good, text = one(), tmp_path / "text.parquet"
    text.write_text("T_s,d_y_m\n")
    (tmp_path / "empty.parquet").touch()
    (tmp_path / "cut.parquet").write_bytes(good.read_bytes()[:2000])
    for name, message in (
        ("none.parquet", r"none\.parquet: does not exist; allowed: Parquet files"),
        ("", "is a folder; allowed: Parquet files"),
        ("text.parquet", r"text\.parquet: cannot be read as Parquet: "),
        ("empty.parquet", r"empty\.parquet: cannot be read as Parquet: "),
        ("cut.parquet", r"cut\.parquet: cannot be read as Parquet: "),
    ):
        with pytest.raises(InputError, match=message):
            ParquetEvents([good, tmp_path / name], COLUMNS)
    with pytest.raises(InputError, match=r"^paths: none; allowed: one or more Parquet files$"):
        ParquetEvents([], COLUMNS)
    with pytest.raises(InputError, match=r"^paths: '.*d\.parquet' is given more than once$"):
        ParquetEvents([good, good], COLUMNS)


def test_the_second_file_lacks_a_column(one):
    other = one(frame=table(10).drop("T_s"), name="e.parquet")
    with pytest.raises(InputError, match=r"^e\.parquet: column 'T_s' is missing"):
        ParquetEvents([one(), other], COLUMNS)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("d_y_m", None, "column 'd_y_m' holds nothing; allowed: finite numbers (2 of 600 rows)"),
        ("d_y_m", float("nan"), "column 'd_y_m' holds nan; allowed: finite numbers (2 of 600 rows)"),
        ("T_s", float("-inf"), "column 'T_s' holds -inf; allowed: finite numbers (2 of 600 rows)"),
        ("weight", -1, "column 'weight' holds -1.0; allowed: finite numbers >= 0 (2 of 600 rows)"),
        ("weight", None, "column 'weight' holds nothing; allowed: finite numbers >= 0 (2 of 600 rows)"),
    ],
)
def test_bad_values_are_named_with_file_and_row(one, monkeypatch, column, value, message):
    monkeypatch.setattr(_parquet_rows, "PIECE", 64)
    number = pl.int_range(pl.len())
    bad = pl.when(number.is_in([70, 400])).then(pl.lit(value)).otherwise(pl.col(column)).alias(column)
    paths = [one(frame=table(100), name="a.parquet"), one(bad, name="b.parquet")]
    events = ParquetEvents(paths, COLUMNS, weight="weight")
    with pytest.raises(InputError, match="^" + re.escape(f"b.parquet, row 71: {message}") + "$"):
        BoundedGaussianMixture(1, lower=0.0).fit(events)
    side = pl.when(number.is_in([70, 400])).then(pl.lit("right")).otherwise(pl.lit("left")).alias("side")
    filtered = ParquetEvents(one(bad, side), COLUMNS, weight="weight", where={"side": "left"})
    assert profile_of(filtered).rows == 498  # rows that are not taken may hold anything


def test_large_numbers_are_no_fault_of_the_file(one):
    path = one(pl.lit(1.7e308).alias("T_s"))  # their sum is infinite, they are not
    assert next(ParquetEvents(path, COLUMNS).blocks())[0, 0] == 1.7e308


def test_data_on_a_bound_are_named(one):
    T = pl.col("T_s").clip(0.1, 9.9)
    frame = table().with_columns(pl.when(pl.int_range(pl.len()) == 9000).then(10.0).otherwise(T).alias("T_s"))
    model = BoundedGaussianMixture(1, lower=0.0, upper=[10.0, np.inf, np.inf], names=["T", "d_y", "v_mean"])
    with pytest.raises(InputError, match=r"^X: column 'T', row 9000: 10.0; allowed: strictly .* \(1 of 16705 rows\)"):
        model.fit(ParquetEvents(one(frame=frame), COLUMNS))


def test_no_rows(one):
    with pytest.raises(InputError, match=r"^d\.parquet: no rows; allowed: at least one event$"):
        BoundedGaussianMixture(1).fit(ParquetEvents(one(frame=table(0)), COLUMNS))
    wrong = ParquetEvents(one(), COLUMNS, where={"side": "lft", "twin": 1})
    message = (
        "d.parquet: none of 500 rows has side = 'lft' and twin = 1; side: did you mean 'left'? (allowed: left, right)"
    )
    with pytest.raises(InputError, match=f"^{re.escape(message)}$"):
        BoundedGaussianMixture(1).fit(wrong)


def test_weights_that_are_all_zero(one):
    path = one(pl.lit(0).alias("weight"))
    with pytest.raises(InputError, match="the weights of all 500 rows are zero"):
        BoundedGaussianMixture(1).fit(ParquetEvents(path, COLUMNS, weight="weight"))


def test_a_file_that_changes_or_goes_during_a_fit(one):
    path = one()
    events = ParquetEvents(path, COLUMNS)
    one(frame=table(400))
    with pytest.raises(InputError, match=r"^d\.parquet: has changed since it was opened; allowed: files at rest$"):
        list(events.blocks())
    path.unlink()
    with pytest.raises(InputError, match=r"d\.parquet: does not exist"):
        list(events.blocks())


def test_folders_that_look_like_partitions_or_patterns_mean_nothing(one, tmp_path):
    path = tmp_path / "side=left" / "a[1]*.parquet"
    path.parent.mkdir()
    table(30).write_parquet(path)
    assert profile_of(ParquetEvents(path, COLUMNS, where={"side": "right"})).rows < 30


def test_a_failure_of_the_work_comes_through_and_no_thread_stays(one):
    events = ParquetEvents(one(frame=table(12 * BLOCK)), COLUMNS, threads=2)
    before = threading.active_count()

    def work(x, weight):
        raise ArithmeticError("in the work")

    with pytest.raises(ArithmeticError, match="in the work"):
        list(events.map_blocks(work))
    started = events.map_blocks(lambda x, weight: x.shape[0])
    assert next(started) == BLOCK
    started.close()
    assert threading.active_count() == before


MEMORY = """
import sys
import numpy as np
from ldctoolkit.mixture.parquet_events import ParquetEvents
from ldctoolkit.mixture.sources import Pass, profile_of, sums_of

def status(key):
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith(key)) / 1024

columns = [f"c{i}" for i in range(8)]
where = {"side": "left"} if sys.argv[3] == "filter" else None
work = Pass(np.zeros(8), np.ones(8), np.zeros((10, 45)))
sums_of(ParquetEvents(sys.argv[1], columns), work)  # what is loaded once
start = status("VmRSS")
events = ParquetEvents(sys.argv[2], columns, where=where)
profile_of(events)
sums_of(events, work)
events.take(np.arange(0, 300_000, 12))
print(status("VmHWM") - start)
"""


def write_large(folder, rows):
    """A large file, a small one, and the large one's size [MiB]."""
    rng = np.random.default_rng(0)
    frame = pl.DataFrame({f"c{i}": rng.normal(size=rows) for i in range(8)})
    frame = frame.with_columns(side=pl.Series(["left", "right"])[rng.integers(0, 2, rows)])
    frame[:1000].write_parquet(folder / "small.parquet")
    frame.write_parquet(folder / "large.parquet")
    return (folder / "large.parquet").stat().st_size / 2**20


def growth(folder, rows):
    """Peak memory of passes over all or half of the rows of the large file, above the start [MiB]."""
    done = subprocess.run(
        [sys.executable, "-c", MEMORY, folder / "small.parquet", folder / "large.parquet", rows],
        capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    return float(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_stays_below_the_file(tmp_path):
    """The numbers alone would be 122 MiB; measured 50 to 60 MiB."""
    assert write_large(tmp_path, 2_000_000) > 110
    assert growth(tmp_path, "all") < 90


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_does_not_grow_with_the_file(tmp_path):
    """The same bound with three times the rows; measured 53 to 68 MiB with five times."""
    assert write_large(tmp_path, 6_000_000) > 330
    assert growth(tmp_path, "all") < 90
    assert growth(tmp_path, "filter") < 90
