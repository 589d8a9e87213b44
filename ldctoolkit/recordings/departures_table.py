"""The result of an extraction, and the departures table that it is stored in."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.checked_files import (
    PARQUET_CHECKSUM,
    check_parquet,
    parquet_bytes,
    parse_json,
    read_regular,
    write_whole,
)
from ldctoolkit.departures import (
    LEFT,
    PARAMETER_COLUMNS,
    RIGHT,
    Departures,
    DepartureSignals,
    ExtraColumn,
    combined_departures,
    no_departures,
)
from ldctoolkit.errors import RecordingError, first_line
from ldctoolkit.recordings.extraction_statistics import (
    Account,
    Drawn,
    QualityStatistics,
    combined_accounts,
    combined_examples,
    combined_statistics,
)
from ldctoolkit.recordings.find_departures import Criteria, Refused
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem, SourceFile, missing_column

if TYPE_CHECKING:
    import polars as pl


@dataclasses.dataclass(frozen=True)
class PartResult:
    """What the recordings of one part give."""

    # In the order of the recordings and of time; extra columns: source, lane_scale, labels
    departures: Departures = dataclasses.field(default_factory=no_departures)
    accounts: tuple[Account, ...] = ()  # One an origin
    evidence: QualityStatistics = dataclasses.field(default_factory=QualityStatistics)  # For warnings
    drawn: Drawn = dataclasses.field(default_factory=Drawn)  # Departures with their signals, to be looked at
    problems: tuple[Problem, ...] = ()  # What could not be used


def combined_results(parts: Iterable[PartResult]) -> PartResult:
    """The results of several parts as one, in their order."""
    parts = list(parts)
    return PartResult(
        departures=combined_departures([part.departures for part in parts]),
        accounts=combined_accounts(account for part in parts for account in part.accounts),
        evidence=combined_statistics(part.evidence for part in parts),
        drawn=combined_examples(part.drawn for part in parts),
        problems=tuple(problem for part in parts for problem in part.problems),
    )


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Where departures come from and how they were found; kept in the departures table."""

    criteria: Criteria = dataclasses.field(default_factory=Criteria)  # What counted as a departure
    refused: Refused = dataclasses.field(default_factory=Refused)  # Candidates that did not
    sources: tuple[SourceFile, ...] = ()  # Files read; empty when the recordings were given as arrays
    recordings: int = 0
    samples: int = 0
    invalid_samples: int = 0  # Those marked so and those with a missing number
    hours: float = 0.0  # [h] Time driven: steps between usable neighbours, without gaps
    distance: float = 0.0  # [m] Driven in these hours; 0 in a table of an earlier version: not known
    curvature: str = "none"  # "measured", "yaw_rate", "none" or "mixed"
    warnings: tuple[str, ...] = ()  # What looked wrong with the recordings
    reader: str = "table"  # Name of the reader: "table", "spmd-das1", ...
    # How recordings were brought to a common form
    preparation: Preparation = dataclasses.field(default_factory=Preparation)
    problems: tuple[str, ...] = ()  # What could not be used, with file and line


@dataclasses.dataclass(frozen=True)
class Extraction:
    """Departures found, and the account of everything else."""

    departures: Departures  # In the order of the recordings and, inside each, of time
    provenance: Provenance  # Criteria, counts and sources
    accounts: tuple[Account, ...] = ()  # Counts of each source and label
    drawn: Drawn = dataclasses.field(default_factory=Drawn)  # Some departures with their signals, to be looked at
    problems: tuple[Problem, ...] = ()  # What could not be used; the rest was

    @property
    def refused(self) -> Refused:
        """Refused candidates by reason."""
        return self.provenance.refused

    @property
    def candidates(self) -> int:
        """Departures and refused candidates together."""
        return len(self.departures) + self.refused.total

    @property
    def recordings(self) -> int:
        """Number of recordings read."""
        return self.provenance.recordings

    @property
    def hours(self) -> float:
        """Time driven [h], without gaps and invalid samples."""
        return self.provenance.hours

    @property
    def distance(self) -> float:
        """Distance driven in these hours [m]."""
        return self.provenance.distance

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looked wrong with the recordings, as text."""
        return self.provenance.warnings


FORMAT_VERSION: Final = 2

METADATA_KEY: Final = "ldctoolkit.departures"

COLUMNS: Final = {
    "recording": "recording",
    "side": "side",
    "start_time_s": "start_time",
    "samples": "samples",
    **{column: name for name, column in PARAMETER_COLUMNS.items()},
}
"""Column of the table -> field of `Departures`; the unit is the end of the column's name."""

_SIGNALS: Final = {"t_s": "t", "y_m": "y", "v_m_s": "v", "c_1_m": "c"}
"""Column of the second table -> field of `DepartureSignals`."""


def write_departures(path: str | os.PathLike[str], departures: Departures, provenance: Provenance) -> None:
    """Write a departures table to `path`, a name that ends in .parquet, whole or not at all; the provenance is kept as
    JSON in the file's metadata. Signals, where they were kept, go into a second table, ``d.signals.parquet`` beside
    ``d.parquet``.

    Raises `RecordingError` if the suffix differs, a value of the departures is outside what `read_departures` accepts,
    or the file cannot be written.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from ldctoolkit.recordings import Provenance
    >>> departures = Departures(*[np.array([x]) for x in (1, 2.0, 0.2, 0.05, 25.0, 0.0, 0.04, 0.0, 0.0, "a", 1.0, 19)])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_departures(pathlib.Path(folder, "d.parquet"), departures, Provenance())
    ...     back, _ = read_departures(pathlib.Path(folder, "d.parquet"))
    >>> float(back.d_y[0])
    0.2
    """
    import polars as pl

    from ldctoolkit.version import __version__

    target = Path(path)
    if target.suffix.lower() != ".parquet":
        raise RecordingError(target.name, "the suffix of a departures table is .parquet")
    sides = np.where(departures.side == LEFT, "left", np.where(departures.side == RIGHT, "right", "?"))
    table = pl.DataFrame(
        [
            pl.Series("recording", departures.recording.tolist(), dtype=pl.String),
            pl.Series("side", sides.tolist(), dtype=pl.String),
            *(
                pl.Series(column, getattr(departures, field), dtype=pl.Int64 if field == "samples" else pl.Float64)
                for column, field in COLUMNS.items()
                if field not in ("recording", "side")
            ),
            *(
                pl.Series(column.name, column.values.tolist(), dtype=pl.Float64 if numeric else pl.String)
                for column in departures.extra
                for numeric in [column.values.dtype.kind == "f"]
            ),
        ]
    )
    _check_values(target.name, table)
    content = {"format_version": FORMAT_VERSION, "ldctoolkit": __version__} | dataclasses.asdict(provenance)
    metadata = {METADATA_KEY: json.dumps(content, ensure_ascii=False, allow_nan=False)}
    write_whole(target, parquet_bytes(table, metadata), RecordingError)
    if departures.signals is not None:
        write_whole(signals_path(target), parquet_bytes(signals_table(departures.signals)), RecordingError)


def signals_path(path: str | os.PathLike[str]) -> Path:
    """Where the signals of a departures table lie."""
    return Path(path).with_suffix(".signals.parquet")


def signals_table(signals: DepartureSignals) -> pl.DataFrame:
    """Signals as a table: row number of the departure (the first is 0), t, y, v and c."""
    import polars as pl

    departure = np.repeat(np.arange(signals.n), np.diff(signals.offsets))
    return pl.DataFrame(
        {"departure": departure, **{column: getattr(signals, name) for column, name in _SIGNALS.items()}}
    )


def read_signals(path: str | os.PathLike[str], T: FloatArray, *, checksum: bool = False) -> DepartureSignals:
    """Read and check a table of signals of n departures, whose durations are T (n,); with `checksum` it must have one.

    Raises `RecordingError` naming file, column and row.
    """
    source = Path(path)
    table, _ = read_table(source, "a table of signals (ldc extract --signals)", checksum=checksum)
    departure, *columns = (column_of(source.name, table, name) for name in ("departure", *_SIGNALS))
    starts = np.flatnonzero(np.diff(departure, prepend=-1.0))
    offsets = np.append(starts, departure.size)
    signals = DepartureSignals(offsets, *columns)
    t = signals.t
    good = (
        np.array_equal(departure[starts], np.arange(T.size))
        and (np.delete(np.diff(t), starts[1:] - 1) > 0.0).all()
        and (t[starts] == 0.0).all()
        and np.allclose(t[offsets[1:] - 1], T, rtol=1e-9, atol=0.0)
    )
    if not good:
        raise RecordingError(
            source.name,
            f"not the signals of these {T.size} departures (their numbers, times or durations differ)",
            hint="extract both tables together",
        )
    return signals


def read_table(source: Path, needed: str, *, checksum: bool = False) -> tuple[pl.DataFrame, dict[str, str]]:
    """A Parquet file and its metadata; `needed` says in messages what it should be."""
    import polars as pl

    data = read_regular(source, lambda *what: RecordingError(*what, hint=f"needed: {needed}"), None)
    try:
        check_parquet(data, needed=checksum)
        return pl.read_parquet(data), pl.read_parquet_metadata(io.BytesIO(data))
    except ValueError as error:
        advice = f"make it anew, or, if it was changed on purpose, drop its metadata '{PARQUET_CHECKSUM}'"
        raise RecordingError(source.name, f"{error}", hint=advice) from None
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise RecordingError(source.name, f"cannot be read as Parquet: {first_line(error)}") from None


def column_of(name: str, table: pl.DataFrame, column: str) -> FloatArray:
    """A column of finite numbers; `name` is the file, for messages."""
    import polars as pl

    _require_column(name, table, column)
    values = table[column]
    if not values.dtype.is_numeric():
        raise RecordingError(name, f"column '{column}' is of type {values.dtype}", allowed="numbers")
    numbers: FloatArray = values.cast(pl.Float64).to_numpy()
    if not np.isfinite(numbers).all():
        row = int(np.argmin(np.isfinite(numbers)))
        raise RecordingError(
            f"{name}, row {row + 1}", f"column '{column}' holds {values[row]!r}", allowed="no missing value"
        )
    return numbers.copy()


def _require_column(name: str, table: pl.DataFrame, column: str) -> None:
    if column not in table.columns:
        raise missing_column(column, [title for title in table.columns if title not in COLUMNS]).within(name)


def read_departures(path: str | os.PathLike[str], *, signals: bool = False) -> tuple[Departures, Provenance]:
    """Read and check the departures table at `path`: n departures, perhaps none, and where they come from; with
    `signals` also the second table, which `write_departures` put beside it.

    Raises `RecordingError` naming file, column and row (the first row is 1).

    Examples
    --------
    >>> read_departures("no.parquet")
    Traceback (most recent call last):
    ldctoolkit.errors.RecordingError: no.parquet: cannot be read: No such file or directory; needed: a departures table
    """
    import polars as pl

    source = Path(path)
    table, metadata = read_table(source, "a departures table")
    for column in COLUMNS:
        _require_column(source.name, table, column)
    if METADATA_KEY not in metadata:
        raise RecordingError(
            source.name, f"no metadata '{METADATA_KEY}': not a departures table", hint="write it with write_departures"
        )
    provenance = provenance_from_json(source.name, metadata[METADATA_KEY])
    _check_values(source.name, table)
    numbers: dict[str, Any] = {
        field: table[column].cast(pl.Int64 if field == "samples" else pl.Float64).to_numpy().copy()
        for column, field in COLUMNS.items()
        if field not in ("recording", "side")
    }
    extra: list[ExtraColumn] = []
    for name in table.columns:  # those of the source's own that are neither text nor numbers are passed over
        values = table[name]
        if name not in COLUMNS and values.dtype == pl.String:
            extra.append(ExtraColumn(name, np.array(values.fill_null("").to_list(), dtype=np.str_)))
        elif name not in COLUMNS and values.dtype.is_numeric():
            extra.append(ExtraColumn(name, values.cast(pl.Float64).fill_null(float("nan")).to_numpy().copy()))
    departures = Departures(
        side=np.where((table["side"] == "left").to_numpy(), LEFT, RIGHT).astype(np.int64),
        recording=np.array(table["recording"].to_list(), dtype=np.str_),
        extra=tuple(extra),
        **numbers,
    )
    if signals:
        departures = dataclasses.replace(departures, signals=read_signals(signals_path(source), departures.T))
    return departures, provenance


_LEAST: Final = {"T_s": ">", "v_mean_m_s": ">", "d_y_m": ">=", "sigma_y_m": ">=", "sigma_v_m_s": ">="}
"""Columns that are above zero, or not below."""


def _check_values(name: str, table: pl.DataFrame) -> None:
    import polars as pl

    bad: list[tuple[str, pl.Series, str]] = []  # column, rows at fault, what is allowed
    for column in COLUMNS:
        values, kind = table[column], table[column].dtype
        text, whole = column in ("recording", "side"), column == "samples"
        if kind != pl.String if text else not (kind.is_integer() if whole else kind.is_numeric()):
            allowed = "text" if text else "integers" if whole else "numbers"
            raise RecordingError(name, f"column '{column}' is of type {kind}", allowed=allowed)
        bad.append((column, values.is_null() if text else ~values.is_finite(), "no missing value"))
    bad.append(("side", ~table["side"].is_in(["left", "right"]), "left, right"))
    bad.append(("samples", table["samples"] < 3, "3 or more"))
    for column, sign in _LEAST.items():
        bad.append((column, table[column] <= 0 if sign == ">" else table[column] < 0, f"{sign} 0"))
    for column, rows, allowed in bad:
        if count := rows.fill_null(True).sum():
            row = rows.fill_null(True).arg_max() or 0
            total = f" ({count} rows in all)" if count > 1 else ""
            what = f"column '{column}' holds {table[column][row]!r}"
            raise RecordingError(f"{name}, row {row + 1}", what, allowed=f"{allowed}{total}")


def provenance_from_json(name: str, text: str) -> Provenance:
    """Provenance from JSON; `name` is the file, for messages. Raises RecordingError."""
    try:
        content: dict[str, Any] = parse_json(text)
        version = content.pop("format_version")
        if version != FORMAT_VERSION:
            raise ValueError(f"departures table of format {version!r}; this version reads {FORMAT_VERSION}")
        content.pop("ldctoolkit", None)
        criteria, refused = Criteria(**content.pop("criteria")), Refused(**content.pop("refused"))
        sources = tuple(SourceFile(**source) for source in content.pop("sources"))
        texts: dict[str, Any] = {key: tuple(content.pop(key)) for key in ("warnings", "problems")}
        preparation = Preparation(**content.pop("preparation"))
        return Provenance(
            criteria=criteria, refused=refused, sources=sources, preparation=preparation, **texts, **content
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordingError(name, f"its metadata '{METADATA_KEY}' cannot be understood: {error}") from None


def read_all_departures(paths: Sequence[str | os.PathLike[str]]) -> tuple[Departures, Provenance]:
    """Read departures tables, in this order, as one.

    Raises `RecordingError` as `read_departures`; for tables of different criteria or preparations, or of the same
    recordings.
    """
    absolute = [Path(path).absolute() for path in paths]
    for path in absolute:
        if absolute.count(path) > 1:
            raise RecordingError(path.name, "given more than once", allowed="every table once")
    tables = [read_departures(path) for path in paths]
    if len(tables) == 1:
        return tables[0]
    provenance = merged_provenance([path.name for path in absolute], [origin for _, origin in tables])
    return combined_departures([departures for departures, _ in tables]), provenance


def merged_provenance(names: Sequence[str], origins: Sequence[Provenance]) -> Provenance:
    """Where the departures of several tables come from; `names` are the tables', for messages.

    Raises `RecordingError` if the criteria or the preparations differ, or a recording is in two tables.
    """
    first = origins[0]
    seen: dict[str, str] = {}
    for name, origin in zip(names, origins, strict=True):
        for kind in ("criteria", "preparation"):
            expected = dataclasses.asdict(getattr(first, kind))
            for key, value in dataclasses.asdict(getattr(origin, kind)).items():
                if value != expected[key]:
                    raise RecordingError(
                        name,
                        f"extracted with {key} = {value!r}, {names[0]} with {expected[key]!r}",
                        allowed=f"tables of the same {kind}",
                    )
        for source in origin.sources:
            # empty files are all alike
            if source.bytes and seen.setdefault(source.sha256, name) != name:
                raise RecordingError(
                    name,
                    f"holds departures of {source.name}, as does {seen[source.sha256]}",
                    allowed="every recording once",
                )
    sums: dict[str, Any] = {
        name: sum(getattr(origin, name) for origin in origins)
        for name in ("recordings", "samples", "invalid_samples", "hours")
    }
    kinds: dict[str, Any] = {
        name: getattr(first, name) if len({getattr(origin, name) for origin in origins}) == 1 else "mixed"
        for name in ("curvature", "reader")
    }
    refused = [dataclasses.asdict(origin.refused) for origin in origins]
    with_distance = all(origin.distance > 0.0 or origin.hours == 0.0 for origin in origins)
    return dataclasses.replace(
        first,
        refused=Refused(**{reason: sum(counts[reason] for counts in refused) for reason in refused[0]}),
        sources=tuple(source for origin in origins for source in origin.sources),
        distance=math.fsum(origin.distance for origin in origins) if with_distance else 0.0,
        warnings=tuple(dict.fromkeys(warning for origin in origins for warning in origin.warnings)),
        problems=tuple(problem for origin in origins for problem in origin.problems),
        **sums,
        **kinds,
    )
