"""What must hold whatever the files hold: an `LdcError`, or departures that are numbers and meet the criteria."""

import contextlib
import dataclasses
import signal
import threading
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ldctoolkit.departures import LEFT, RIGHT
from ldctoolkit.errors import LdcError
from ldctoolkit.recordings import (
    Extraction,
    Preparation,
    extract_departures,
    open_recordings,
    read_departures,
    write_departures,
)

MOST_LETTERS = 600  # of a problem in words: a file's name of up to 255 bytes, and a sentence with a cell cut short
PATIENCE = 60  # seconds after which an example counts as hanging; the slowest takes well under one


class HangError(BaseException):
    """Not an `Exception`: `TimeoutError` is an `OSError`, which readers handle."""


def check(
    paths: Sequence[Path], format_: str, nominal_lane_width: float | None = None, table: Path | None = None,
    small_parts: bool = False, channels: Path | None = None,
) -> str:  # fmt: skip
    """Extract, and check what came; tells in a word what it was. With a `table` the departures are written, too; with
    `small_parts` a reader that puts trips together reads each by itself."""
    with warnings.catch_warnings(), _limited():
        warnings.simplefilter("error")
        try:
            opened = open_recordings(paths, format=format_, channels=channels)
            if small_parts and hasattr(opened.reader, "part_bytes"):
                reader = dataclasses.replace(opened.reader, part_bytes=1)  # type: ignore[type-var]
                opened = dataclasses.replace(opened, reader=reader, source=reader.open(paths))
            preparation = Preparation(step=opened.reader.step, nominal_lane_width=nominal_lane_width)
            found = extract_departures(opened, preparation=preparation)
        except LdcError as error:
            return "refused" if str(error) else "refused without a word"
        _check_departures(found)
        _check_account(found)
        _check_problems(found, paths)
        if table is not None:
            write_departures(table, found.departures, found.provenance)
            back, provenance = read_departures(table)
            np.testing.assert_array_equal(back.matrix(), found.departures.matrix())
            assert provenance == found.provenance
    if found.departures.n:
        return "damaged departures" if found.problems else "departures"
    return "problems" if found.problems else "no departure"


def _check_departures(found: Extraction) -> None:
    departures, criteria = found.departures, found.provenance.criteria
    assert np.isfinite(departures.matrix()).all()
    assert np.isfinite(departures.start_time).all()
    assert np.isin(departures.side, (LEFT, RIGHT)).all()
    assert (criteria.min_duration <= departures.T).all()
    assert (criteria.max_duration >= departures.T).all()
    assert (departures.d_y > 0.0).all()
    assert (departures.sigma_y >= 0.0).all()
    assert (departures.v_mean > criteria.min_speed).all()
    assert (np.abs(departures.a_mean) <= 9.81).all()
    assert (departures.samples >= 3).all()
    assert all(departures.recording.tolist())


def _check_problems(found: Extraction, paths: Sequence[Path]) -> None:
    """They name files without the folder they lie in, in one line that can be read."""
    for problem in found.problems:
        assert problem.file
        assert problem.what
        # a table's columns are its maker's: a problem with one gives its whole name
        assert len(str(problem)) < MOST_LETTERS or found.provenance.reader == "table"
        assert str(problem).isprintable()
        assert not any(str(path.parent) in str(problem) for path in paths)


def _check_account(found: Extraction) -> None:
    provenance = found.provenance
    assert 0.0 <= provenance.hours < np.inf
    assert 0.0 <= provenance.distance < np.inf
    assert 0 <= provenance.invalid_samples <= provenance.samples
    assert found.departures.n == sum(int(account.departures.sum()) for account in found.accounts)
    assert found.candidates == sum(int(account.candidates.sum()) for account in found.accounts)
    assert provenance.recordings == sum(account.recordings for account in found.accounts)
    for account in found.accounts:
        assert 0 <= account.valid_ns <= account.read_ns
        assert account.usable <= account.samples
        assert account.widths.sum() == account.usable


@contextlib.contextmanager
def _limited() -> Iterator[None]:
    """A hang is a failure of its own example, not of the whole run."""
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "SIGALRM"):
        yield
        return

    def stop(*_: object) -> None:
        raise HangError(f"no end after {PATIENCE} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
