"""Reading recording files: whole recordings at a time, in bounded memory."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, RecordingError
from ldctoolkit.recordings.source_file import SourceFile
from ldctoolkit.recordings.table import RecordingTable, check_times

if TYPE_CHECKING:
    import polars as pl

SUFFIXES: Final = (".csv", ".csv.gz", ".parquet")
BLOCK_BYTES: Final = 16 << 20


class Recordings:
    """Recordings in files; iterating reads them and yields tables of whole recordings.

    Made by `read_recordings`. It can be iterated again, which reads the files again.
    """

    def __init__(self, paths: tuple[Path, ...], block_bytes: int, progress: Callable[[int, int], None] | None) -> None:
        self._paths = paths
        self._block_bytes = block_bytes
        self._progress = progress
        self._sources: tuple[SourceFile, ...] = ()

    @property
    def sources(self) -> tuple[SourceFile, ...]:
        """The files that the latest iteration has read to their end."""
        return self._sources

    def __iter__(self) -> Iterator[RecordingTable]:
        from ldctoolkit.recordings.plain.frames import Meter, frames

        self._sources = ()
        done, total = 0, sum(_size(path) for path in self._paths)

        def tick(count: int) -> None:
            nonlocal done
            done += count
            if self._progress is not None:
                self._progress(done, total)

        owner: dict[str, str] = {}
        for path in self._paths:
            meter = Meter(tick)
            try:
                yield from _tables(path.name, frames(path, self._block_bytes, meter), owner)
            except OSError as error:
                raise RecordingError(f"{path.name}: cannot be read: {error.strerror or error}") from None
            self._sources += (SourceFile(path.name, meter.bytes, meter.sha256),)


def check_file(path: Path, needed: str) -> None:
    """Refuse a path that is not a file; `needed` says in the message what it should be."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        raise RecordingError(f"{path}: does not exist; {needed} is needed") from None
    except (OSError, ValueError) as error:  # no permission, name too long, a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise RecordingError(f"{path}: cannot be read: {reason}") from None
    if not stat.S_ISREG(mode):
        state = "is a folder" if stat.S_ISDIR(mode) else "is not a regular file"
        raise RecordingError(f"{path}: {state}; {needed} is needed")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read: {error.strerror or error}") from None


def read_recordings(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    block_bytes: int = BLOCK_BYTES,
    progress: Callable[[int, int], None] | None = None,
) -> Recordings:
    r"""Open driving recordings: plain recording tables in CSV, CSV.gz or Parquet files.

    Parameters
    ----------
    paths : path or iterable of paths
        Files with the columns ``recording, t, lane_offset, lane_width, speed`` and optionally ``curvature``,
        ``yaw_rate``, ``lane``, ``valid``, ``turn_signal``. A recording lies in one file, its rows together.
    block_bytes : int
        About how much text is parsed at once; bounds the memory together with the longest recording.
    progress : callable, optional
        Called as ``progress(bytes_done, bytes_total)`` while reading.

    Returns
    -------
    Recordings
        Iterable of `RecordingTable`; the content is read, and checked, while iterating.

    Raises
    ------
    RecordingError
        If a file is missing, is given twice or has another suffix. While iterating: for content that cannot be used,
        naming file, column and place.
    InputError
        If no path is given or `block_bytes` is not positive.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> folder = tempfile.TemporaryDirectory()
    >>> path = pathlib.Path(folder.name, "drive.csv")
    >>> _ = path.write_text("recording,t,lane_offset,lane_width,speed\na,0,0.1,3.6,25\na,0.1,0.2,3.6,25\n")
    >>> [table.samples for table in read_recordings(path)]
    [2]
    >>> folder.cleanup()
    """
    given = [paths] if isinstance(paths, str | os.PathLike) else list(paths)
    files = tuple(Path(path) for path in given)
    if not files:
        raise InputError("paths: none given; at least one recording file is needed")
    if block_bytes < 1:
        raise InputError(f"block_bytes: {block_bytes!r}; allowed: >= 1")
    seen: set[Path] = set()
    for path in files:
        if not path.name.lower().endswith(SUFFIXES):
            raise RecordingError(f"{path.name}: the suffix is not known; allowed: {', '.join(SUFFIXES)}")
        check_file(path, "a recording file")
        if path.resolve() in seen:
            raise RecordingError(f"{path.name}: given twice")
        seen.add(path.resolve())
    return Recordings(files, block_bytes, progress)


def _tables(source: str, blocks: Iterator[pl.DataFrame], owner: dict[str, str]) -> Iterator[RecordingTable]:
    for frame in whole_recordings(blocks):
        yield _table(source, frame, owner)


def whole_recordings(blocks: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    """Regroup blocks of rows so that each holds whole recordings: the last recording of a block waits for the next."""
    import polars as pl

    waiting: list[pl.DataFrame] = []
    for block in blocks:
        if block.height == 0:
            continue
        waiting.append(block)
        last = block["recording"][-1]
        if waiting[0]["recording"][0] == last:  # one long recording; its blocks are joined once, at its end
            continue
        # rows of the block that belong to its last recording, counted from the end
        other = (block["recording"] != last).reverse().arg_true()
        tail = int(other[0]) if other.len() else block.height
        waiting[-1] = block[: block.height - tail]
        yield pl.concat(waiting)
        waiting = [block[block.height - tail :]]
    if waiting:
        yield pl.concat(waiting)


def _table(source: str, frame: pl.DataFrame, owner: dict[str, str]) -> RecordingTable:
    from ldctoolkit.recordings.plain.table_values import ROW

    labels = frame["recording"]
    starts = np.concatenate([[0], np.flatnonzero((labels != labels.shift(1)).fill_null(False).to_numpy())])
    rows = frame[ROW].to_numpy()
    word = "row" if source.lower().endswith(".parquet") else "line"
    labelled = labels.gather(starts).to_list()
    if len(set(labelled)) < len(labelled) or not owner.keys().isdisjoint(labelled):
        raise _repeated(source, word, labelled, rows[starts], owner)
    owner.update(dict.fromkeys(labelled, source))

    table = RecordingTable(
        names=np.array(labelled, dtype=np.str_),
        offsets=np.append(starts, frame.height).astype(np.int64),
        source=source,
        **columns_of(frame),
    )
    check_times(table, word, rows)
    return table


def columns_of(frame: pl.DataFrame) -> dict[str, Any]:
    """The columns of a frame as those of a `RecordingTable` or a `Recording`, by name; None for one that it lacks."""

    def numbers(name: str) -> npt.NDArray[np.float64] | None:
        return frame[name].to_numpy().astype(np.float64) if name in frame.columns else None

    valid = frame["valid"].to_numpy() if "valid" in frame.columns else np.ones(frame.height, dtype=bool)
    lane = None
    if "lane" in frame.columns:
        valid = valid & frame["lane"].is_not_null().to_numpy()
        lane = frame["lane"].rank("dense").fill_null(0).to_numpy().astype(np.int64)
    return {
        "t": frame["t"].to_numpy(),
        "lane_offset": frame["lane_offset"].to_numpy(),
        "lane_width": frame["lane_width"].to_numpy(),
        "speed": frame["speed"].to_numpy(),
        "valid": valid,
        "curvature": numbers("curvature"),
        "yaw_rate": numbers("yaw_rate"),
        "lane": lane,
        "turn_signal": frame["turn_signal"].to_numpy() if "turn_signal" in frame.columns else None,
    }


def _repeated(
    source: str, word: str, names: list[str], rows: npt.NDArray[np.int64], owner: dict[str, str]
) -> RecordingError:
    """The first recording of a table that was seen before."""
    seen = dict(owner)
    for name, row in zip(names, rows, strict=True):
        if name in seen:
            fault = "comes in separate pieces" if seen[name] == source else f"was already read from {seen[name]}"
            return RecordingError(
                f"{source}, {word} {row}: column 'recording': {name!r} {fault}; "
                "allowed: each recording in one piece, under a name of its own"
            )
        seen[name] = source
    raise ValueError("no recording is repeated")
