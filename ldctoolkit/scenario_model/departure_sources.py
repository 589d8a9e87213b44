"""Departures tables that stay where they lie: read at every pass by this process, or by the workers of a cluster."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Final, Self

import numpy as np
import numpy.typing as npt

from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.errors import RecordingError
from ldctoolkit.mixture import DaskEvents, EventSource, ParquetEvents
from ldctoolkit.mixture.cluster import Cluster
from ldctoolkit.recordings import Provenance
from ldctoolkit.recordings.departures_table import METADATA_KEY, provenance_from_json
from ldctoolkit.recordings.read import check_file
from ldctoolkit.scenario_model.merged import merged_provenance

if TYPE_CHECKING:
    import polars as pl
    from distributed import Client

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Paths = str | os.PathLike[str] | Sequence[str | os.PathLike[str]]

_COLUMNS: Final = [PARAMETER_COLUMNS[name] for name in PARAMETER_NAMES]
_SIDES: Final = ("left", "right")

_LOOK: Final = 1 << 20
"""Rows whose side is looked at in one go."""


@dataclasses.dataclass(frozen=True)
class DepartureSources:
    """Departures of each side in sources of events; a context manager, which leaves a cluster at its end.

    Attributes
    ----------
    left, right : EventSource
        Departures, columns as `PARAMETER_NAMES`, SI units.
    provenance : Provenance
        Where they come from.
    closing : callable
        What `close` does.
    """

    left: EventSource
    right: EventSource
    provenance: Provenance = dataclasses.field(default_factory=Provenance)
    closing: Callable[[], None] = lambda: None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the cluster, unless its client was given."""
        self.closing()

    def draw(self, n: int, seed: int) -> tuple[Departures, FloatArray | None]:
        """At most n departures of both sides in proportion, and their weights if they have any.

        Each side is cut into equal stretches of rows, and one row of each is drawn: every departure has the same
        chance, and the whole of the table is seen. Recordings and times are not read.

        Examples
        --------
        >>> from ldctoolkit.mixture import ArrayEvents
        >>> x = np.arange(800.0).reshape(100, 8)
        >>> drawn, weight = DepartureSources(ArrayEvents(x), ArrayEvents(x[:50])).draw(30, seed=1)
        >>> int((drawn.side == LEFT).sum()), drawn.n, weight
        (20, 30, None)
        """
        sources = {LEFT: self.left, RIGHT: self.right}
        rows = {side: sum(source.map_blocks(_rows_of)) for side, source in sources.items()}
        total = max(sum(rows.values()), 1)
        parts = []
        for side, source in sources.items():
            count = min(rows[side], n * rows[side] // total)
            parts.append(source.take(_spread(rows[side], count, np.random.default_rng([seed, side == LEFT]))))
        x = np.concatenate([part for part, _ in parts])
        weights = [weight for _, weight in parts if weight is not None]
        departures = Departures(
            side=np.repeat([LEFT, RIGHT], [part.shape[0] for part, _ in parts]),
            **{name: x[:, j].copy() for j, name in enumerate(PARAMETER_NAMES)},
            extra=(),
            recording=np.full(x.shape[0], ""),
            start_time=np.zeros(x.shape[0]),
            samples=np.zeros(x.shape[0], dtype=np.int64),
        )
        return departures, np.concatenate(weights) if weights else None


def _rows_of(x: FloatArray, weight: FloatArray | None) -> int:
    del weight
    return len(x)


def _spread(rows: int, count: int, rng: np.random.Generator) -> IntArray:
    """Ascending row numbers, one out of each of `count` equal stretches."""
    edges = np.arange(count + 1, dtype=np.int64) * rows // max(count, 1)
    return rng.integers(edges[:-1], edges[1:])


def open_departures(
    paths: Paths,
    *,
    cluster: Client | str | None = None,
    weight: str | None = None,
    threads: int | None = None,
) -> DepartureSources:
    """Open departures tables without reading them whole; a fit reads them at every pass.

    Only the side and the eight parameters are read. The fit checks the parameters; `read_departures` checks the other
    columns too.

    Parameters
    ----------
    paths : path or sequence of paths
        Files written by `write_departures`, with the same criteria.
    cluster : Client or str, optional
        A Dask client, or the address of a scheduler such as ``"tcp://10.0.0.1:8786"``. Its workers read the files,
        which they must see under the same path; this computer need not see them.
    weight : str, optional
        Another column, of the events that each departure stands for.
    threads : int, optional
        Blocks worked on at a time without a cluster; all cores by default. It changes no number.

    Returns
    -------
    DepartureSources
        For `fit_scenario_model`; to be closed if there is a cluster.

    Raises
    ------
    RecordingError
        For a file that is no departures table, another side than left or right, or tables of different criteria.
    InputError
        As for `ParquetEvents` and `DaskEvents`.
    ClusterError
        As for `DaskEvents`.

    Examples
    --------
    >>> open_departures("nowhere.parquet")
    Traceback (most recent call last):
    ldctoolkit.errors.RecordingError: nowhere.parquet: does not exist; a departures table is needed
    """
    files = _files(paths)
    with contextlib.ExitStack() as stack:
        left, right = {"side": "left"}, {"side": "right"}
        if cluster is None:
            heads = _heads(files)
            local = [
                ParquetEvents(files, _COLUMNS, where=side, weight=weight, threads=threads) for side in (left, right)
            ]
            if sum(events.count_rows() for events in local) != sum(rows for rows, _ in heads):
                raise _other_side(files)
            sources: list[EventSource] = [*local]
        else:
            files = tuple(path.absolute() for path in files)  # a worker has a working folder of its own
            workers = Cluster(cluster)
            stack.callback(workers.close)
            workers.check_workers(files)
            heads = workers.result(workers.client.submit(_heads, files, pure=False))
            far = [DaskEvents(workers.client, files, _COLUMNS, where=side, weight=weight) for side in (left, right)]
            if sum(events.count_rows() for events in far) != sum(rows for rows, _ in heads):
                raise workers.result(workers.client.submit(_other_side, files, pure=False))
            sources = [*far]
        provenance = merged_provenance([path.name for path in files], [found for _, found in heads])
        return DepartureSources(sources[0], sources[1], provenance, stack.pop_all().close)


def table_rows(paths: Paths) -> int:
    """Rows of Parquet files together, from their heads.

    Raises
    ------
    RecordingError
        For a file that cannot be read as Parquet.
    """
    return sum(_row_count(path) for path in _files(paths))


def _files(paths: Paths) -> tuple[Path, ...]:
    several = [paths] if isinstance(paths, str | os.PathLike) else paths
    return tuple(Path(path) for path in several)


def _heads(files: tuple[Path, ...]) -> list[tuple[int, Provenance]]:
    """Rows of each table, and where they come from."""
    return [_head(path) for path in files]


def _head(path: Path) -> tuple[int, Provenance]:
    import polars as pl

    rows = _row_count(path)
    with _readable(path):
        metadata = pl.read_parquet_metadata(path)
    if METADATA_KEY not in metadata:
        raise RecordingError(
            f"{path.name}: no metadata '{METADATA_KEY}': not a departures table; write it with write_departures"
        )
    return rows, provenance_from_json(path.name, metadata[METADATA_KEY])


def _row_count(path: Path) -> int:
    import polars as pl

    check_file(path, "a departures table")
    with _readable(path):
        return int(_scan(path).select(pl.len()).collect().item())


def _other_side(files: tuple[Path, ...]) -> RecordingError:
    """What to raise where a side is neither left nor right."""
    import polars as pl

    first, count = "", 0
    for path in files:
        for start in range(0, _row_count(path), _LOOK):
            with _readable(path):
                side = _scan(path).select(pl.col("side").cast(pl.String)).slice(start, _LOOK).collect()["side"]
            bad = ~side.is_in(_SIDES).fill_null(False)
            if bad.any():
                at = bad.arg_max() or 0
                first = first or f"{path.name}, row {start + at + 1}: column 'side' holds {side[at]!r}"
                count += int(bad.sum() or 0)
    more = f" ({count} rows in all)" if count > 1 else ""
    return RecordingError(f"{first}; allowed: left, right{more}")


def _scan(path: Path) -> pl.LazyFrame:
    import polars as pl

    return pl.scan_parquet(path, glob=False, hive_partitioning=False, cache=False)


@contextlib.contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Tell of a file that cannot be read as such."""
    import polars as pl

    try:
        yield
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise RecordingError(f"{path.name}: cannot be read as Parquet: {str(error).splitlines()[0]}") from None
