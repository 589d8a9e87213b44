"""Events on a Dask cluster: the same bits as in memory, dead workers made up for, errors instead of waiting."""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import polars as pl
import pytest

from ldctoolkit.errors import ClusterError, InputError, LdcError
from ldctoolkit.mixture import ArrayEvents, BoundedGaussianMixture, EventSource, dask_events
from ldctoolkit.mixture.bounded_events import inside_bounds
from ldctoolkit.mixture.cluster import Cluster
from ldctoolkit.mixture.dask_events import DaskEvents
from ldctoolkit.mixture.parquet_events import ParquetEvents
from ldctoolkit.mixture.sources import BLOCK, Pass, profile_of, sums_of

distributed = pytest.importorskip("distributed")
slow = pytest.mark.slow  # starting processes and compiling in each takes some seconds

COLUMNS = ("a", "b", "c")
PARTS = (100, 3 * BLOCK + 5, 8 * BLOCK)


@pytest.fixture(scope="module")
def address():
    with distributed.LocalCluster(
        processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Three files of odd row groups, and all their rows."""
    folder = tmp_path_factory.mktemp("events")
    rng = np.random.default_rng(0)
    paths, frames = [], []
    for i, rows in enumerate(PARTS):
        numbers = {name: rng.gamma(2.0, size=rows) + 0.01 for name in COLUMNS}
        side, weight = rng.choice(["left", "right"], rows), rng.integers(0, 3, rows)
        frames.append(pl.DataFrame({**numbers, "side": side, "weight": weight}))
        paths.append(folder / f"{i}.parquet")
        frames[-1].write_parquet(paths[-1], row_group_size=3001)
    return paths, pl.concat(frames)


def array(frame, weighted):
    x = np.ascontiguousarray(frame.select(COLUMNS).to_numpy())
    return ArrayEvents(x, frame["weight"].to_numpy().astype(float) if weighted else None)


@slow
@pytest.mark.parametrize(("where", "weighted"), [(None, False), ({"side": "left"}, True)])
def test_the_same_bits_as_in_memory(address, files, where, weighted, monkeypatch):
    paths, frame = files
    monkeypatch.setattr(dask_events, "_LEAST", 2)  # several tasks, whose ends lie inside pieces
    monkeypatch.setattr(dask_events, "_MOST", 3)
    frame = frame if where is None else frame.filter(pl.col("side") == "left")
    inside = array(frame, weighted)
    work = Pass(np.full(3, 2.0), np.ones(3), np.random.default_rng(1).normal(size=(3, 10)) * 0.1)
    with DaskEvents(address, paths, COLUMNS, where=where, weight="weight" if weighted else None) as events:
        assert isinstance(events, EventSource)
        assert (events.dimension, events.columns) == (3, COLUMNS)
        assert len(events._spans()) > 2
        assert repr(profile_of(events)) == repr(profile_of(inside))
        (value, sums), (other_value, other_sums) = sums_of(events, work), sums_of(inside, work)
        assert value == other_value
        assert np.array_equal(sums, other_sums)
        blocks = list(events.blocks())
        assert [block.shape[0] for block in blocks] == [block.shape[0] for block in inside.blocks()]
        assert np.array_equal(np.concatenate(blocks), inside.x)
        for rows in (np.array([0, 7, BLOCK, inside.x.shape[0] - 1]), np.array([], dtype=np.int64)):
            (found, w), (expected, other_w) = events.take(rows), inside.take(rows)
            assert np.array_equal(found, expected)
            assert (w is None) == (other_w is None)
            assert w is None or np.array_equal(w, other_w)


@slow
@pytest.mark.parametrize("transform", [None, "auto"])
def test_a_fit_is_the_fit_to_the_array(address, files, transform):
    paths, frame = files
    settings = {"lower": 0.0, "random_state": 3, "n_init": 2, "max_iter": 8, "subsample": 4000, "transform": transform}
    inside = array(frame, True)
    one = BoundedGaussianMixture(2, **settings).fit(inside)
    with distributed.Client(address, set_as_default=False) as client:
        events = DaskEvents(client, paths, COLUMNS, weight="weight")
        other = BoundedGaussianMixture(2, **settings).fit(events)
        events.close()
        assert client.status == "running"  # a client that was given stays open
    for name in ("weights_", "means_", "covariances_", "lower_bounds_"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name


@slow
def test_values_on_a_bound_move_inside_on_the_workers(address, files):
    paths, frame = files
    inside = array(frame, False)
    lower, upper = inside.x.min(axis=0), np.full(3, np.inf)
    with DaskEvents(address, paths, COLUMNS) as events:
        one, other = inside_bounds(events, lower, upper), inside_bounds(inside, lower, upper)
        assert one.moved.tolist() == other.moved.tolist() == [1, 1, 1]
        assert repr(profile_of(one.source)) == repr(profile_of(other.source))


@slow
def test_a_worker_that_dies_is_made_up_for(address, files, tmp_path):
    paths, frame = files
    marker = tmp_path / "died"

    def work(x, weight):
        if not marker.exists():
            marker.touch()
            os._exit(1)
        return x.sum()

    with DaskEvents(address, paths, COLUMNS) as events:
        found = list(events.map_blocks(work))
        assert marker.exists()
    assert found == [block.sum() for block in array(frame, False).blocks()]


@slow
def test_a_task_that_ends_every_worker(files):
    def work(x, weight):
        os._exit(1)

    paths, _ = files
    with (
        distributed.LocalCluster(
            processes=True, n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50
        ) as cluster,
        DaskEvents(cluster.scheduler_address, paths, COLUMNS) as events,
        pytest.raises(ClusterError, match=r"^a task has ended one worker after another, perhaps for want of memory"),
    ):
        list(events.map_blocks(work))


@slow
def test_the_scheduler_goes(files, tmp_path):
    """A scheduler and a worker started from the shell, as a user does; the scheduler is killed in the work."""

    def work(x, weight):
        time.sleep(60)

    def start(program, *options):
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file", str(at), *options]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    at = tmp_path / "scheduler.json"
    scheduler = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--dashboard-address", ":0")
    worker = start("worker", "--no-nanny", "--dashboard-address", ":0")
    try:
        for _ in range(300):
            if at.exists() and at.read_text().endswith("}"):
                break
            time.sleep(0.1)
        events = DaskEvents(json.loads(at.read_text())["address"], files[0], COLUMNS)
        results = events.map_blocks(work)
        threading.Timer(1.0, scheduler.kill).start()
        with pytest.raises(ClusterError, match=r"^the scheduler has gone, or has dropped the work$"):
            next(results)
        events.close()
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()


def test_no_worker_comes():
    with (
        distributed.LocalCluster(processes=False, n_workers=0, dashboard_address=":0", silence_logs=50) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        pytest.raises(ClusterError, match=r"^the cluster has had no worker for 0.5 s; start some: dask worker"),
    ):
        Cluster(client, patience=0.5).check_workers(())


@slow
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"columns": ("a", "bb")}, "0.parquet: column 'bb' is missing; did you mean 'b'?"),
        ({"columns": ("a", "side")}, "0.parquet: column 'side' is of type String; allowed: numbers"),
        ({"where": {"side": "lft"}}, "none of 90217 rows has side = 'lft'; side: did you mean 'left'?"),
        ({"where": {"side": 1.0}}, "where: 'side' = 1.0; allowed: a value of type String"),
        ({"paths": "/nowhere/x.parquet"}, "/nowhere/x.parquet: not seen by 2 of 2 workers, first tcp://127.0.0.1:"),
    ],
)
def test_wrong_requests(address, files, change, message):
    with pytest.raises(InputError, match=re.escape(message)):
        DaskEvents(address, **{"paths": files[0], "columns": COLUMNS, **change})


@slow
def test_bad_values_are_named(address, files, tmp_path):
    bad = files[1].with_columns(b=pl.when(pl.int_range(pl.len()) == 20_000).then(None).otherwise("b"))
    bad.write_parquet(tmp_path / "bad.parquet")
    with DaskEvents(address, tmp_path / "bad.parquet", COLUMNS) as events:
        message = r"^bad\.parquet, row 20001: column 'b' holds nothing; allowed: finite numbers \(1 of 90217 rows\)$"
        with pytest.raises(InputError, match=message):
            BoundedGaussianMixture(1, lower=0.0).fit(events)
    with DaskEvents(address, files[0], COLUMNS) as events, pytest.raises(InputError, match=r"column 'T', row \d+: "):
        BoundedGaussianMixture(1, lower=1.0, names=["T", "d_y", "v"]).fit(events)


@slow
def test_relative_paths_are_those_of_this_process(address, files, monkeypatch):
    monkeypatch.chdir(files[0][0].parent)
    with DaskEvents(address, "0.parquet", COLUMNS) as events:
        assert profile_of(events).rows == PARTS[0]


@slow
def test_the_workers_have_another_version(address, monkeypatch):
    from ldctoolkit.mixture import cluster

    monkeypatch.setattr(cluster, "__version__", "0.0.1")
    with pytest.raises(ClusterError, match=r"^worker tcp://.*: has ldctoolkit .*; allowed: 0\.0\.1, as here$"):
        DaskEvents(address, __file__, COLUMNS)


@pytest.mark.parametrize("where", ["tcp://127.0.0.1:1", "127.0.0.1:1", "tcp://scheduler.invalid:8786", "silent"])
def test_nobody_answers(where, monkeypatch):
    from ldctoolkit.mixture import cluster

    monkeypatch.setattr(cluster, "ANSWER", 0.5)
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        where = f"tcp://127.0.0.1:{listener.getsockname()[1]}" if where == "silent" else where
        with pytest.raises(InputError, match=f"^{re.escape(where)}: no Dask scheduler answers within 0.5 s; allowed: "):
            DaskEvents(where, "x.parquet", COLUMNS)


@slow
def test_the_address_of_a_worker(address):
    with distributed.Client(address, set_as_default=False) as client:
        worker = next(iter(client.nthreads()))
    with pytest.raises(InputError, match=r"a Dask Worker answers there; allowed: the address of a scheduler$"):
        DaskEvents(worker, "x.parquet", COLUMNS)


@pytest.mark.parametrize("where", ["", "scheduler", "tcp://10.0.0.1", "ftp://a:1", "10.0.0.1:port"])
def test_no_address(where):
    with pytest.raises(InputError, match=rf"^{re.escape(repr(where))}: not an address: .*; allowed: such as tcp://"):
        DaskEvents(where, "x.parquet", COLUMNS)


def test_dask_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'^Dask is not installed; .*: pip install "ldctoolkit\[cluster\]"$'):
        DaskEvents("tcp://127.0.0.1:1", "x.parquet", COLUMNS)


def test_cluster_errors_are_the_toolkits():
    assert issubclass(ClusterError, LdcError)


@slow
def test_streams_and_clusters_agree(address, files):
    with DaskEvents(address, files[0], COLUMNS) as events:
        assert repr(profile_of(events)) == repr(profile_of(ParquetEvents(files[0], COLUMNS)))
