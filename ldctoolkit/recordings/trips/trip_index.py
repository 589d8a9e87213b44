"""Where the rows of each trip lie in a big text table: one pass over the bytes, in constant memory.

The table's first two columns are the key: a device and a trip. Nothing else of a line is looked at.
"""

from __future__ import annotations

import concurrent.futures
import dataclasses
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from ldctoolkit.errors import RecordingError

BLOCK_BYTES: Final = 1 << 20
LONGEST_LINE: Final = 1 << 20
"""A longer line [bytes] is not a row of a table."""

COMPILED_FROM: Final = 32 << 20
"""Loading a compiler's library is not worth it for a smaller file [bytes]."""

MOST_STRETCHES: Final = 1_000_000
"""More stretches than these mean that the rows are not sorted by trip at all."""

_KEY: Final = re.compile(rb'[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,[ \t]*"?([+-]?\d{1,15})(?:\.0*)?"?[ \t]*,')
_KEY_BYTES: Final = 128
"""A key is looked for in this many first bytes of a line."""


@dataclasses.dataclass(frozen=True, slots=True)
class Stretch:
    """Neighbouring lines of one trip.

    Attributes
    ----------
    device, trip : int
        The key.
    begin, end : int
        Bytes ``begin:end`` of the file; whole lines.
    line : int
        Number of the first line, the file's first is 1.
    lines : int
        How many, blank ones included.
    """

    device: int
    trip: int
    begin: int
    end: int
    line: int
    lines: int


@dataclasses.dataclass(frozen=True)
class LineFault:
    """A line that cannot be used, and why."""

    line: int
    what: str


@dataclasses.dataclass(frozen=True)
class TripIndex:
    """Stretches of a file in its order, and its digest.

    Attributes
    ----------
    stretches : tuple of Stretch
        Two neighbours have the same key only where a faulty line between them was left out.
    faults : tuple of LineFault
        The first lines that have no key.
    more_faults : int
        How many more there are.
    bytes : int
        Size of the file.
    sha256 : str
        Digest of its content, hexadecimal.
    """

    stretches: tuple[Stretch, ...]
    faults: tuple[LineFault, ...]
    more_faults: int
    bytes: int
    sha256: str


def index_trips(
    path: Path,
    begin: int,
    line: int,
    *,
    block_bytes: int = BLOCK_BYTES,
    most_faults: int = 20,
    compiled_from: int = COMPILED_FROM,
) -> TripIndex:
    r"""Find the stretches of lines that belong to one trip each.

    Parameters
    ----------
    path : Path
        A text table whose lines begin with ``device,trip,``, both whole numbers.
    begin, line : int
        Byte and number of the line where the rows begin, behind a header.
    block_bytes : int
        How much is read at once.
    most_faults : int
        How many faulty lines are told one by one.
    compiled_from : int
        Size of a file [bytes] from which lines are compared by a compiled loop; it finds the same.

    Raises
    ------
    RecordingError
        If the file cannot be read, has a line that is longer than any row, or the rows of trips are not together.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "a.csv")
    ...     _ = path.write_bytes(b"Device,Trip,Time\n7,1,0\n7,1,10\n7,2,0\n")
    ...     index = index_trips(path, 17, 2)
    >>> [(one.trip, one.line, one.lines) for one in index.stretches]
    [(1, 2, 2), (2, 4, 1)]
    """
    digest, size, kept = hashlib.sha256(), 0, 0
    # one buffer for the whole file; the begin of a line that a block cuts stays at its front
    buffer = bytearray(LONGEST_LINE + block_bytes + 1)
    view = memoryview(buffer)
    try:
        # the digest is made beside the search: both leave the interpreter free
        compiled = path.stat().st_size >= compiled_from
        scan = _Scan(path.name, begin, line, most_faults, compiled)
        with path.open("rb", buffering=0) as stream, concurrent.futures.ThreadPoolExecutor(1) as beside:
            while count := stream.readinto(view[kept : kept + block_bytes]):
                hashed = beside.submit(digest.update, view[kept : kept + count])
                first, last = 0 if kept else max(0, min(begin - size, count)), kept + count
                size += count
                cut = max(buffer.rfind(b"\n", first, last) + 1, first)
                scan.add(buffer, first, cut)
                kept = last - cut
                hashed.result()
                if kept > LONGEST_LINE:
                    raise RecordingError(f"{path.name}: line {scan.line} is longer than {LONGEST_LINE} bytes")
                view[:kept] = view[cut:last]
    except OSError as error:
        raise RecordingError(f"{path.name}: cannot be read: {error.strerror or error}") from None
    if kept:
        buffer[kept] = 10
        scan.add(buffer, 0, kept + 1, unended=1)
    scan.close()
    return TripIndex(tuple(scan.stretches), tuple(scan.faults), scan.more_faults, size, digest.hexdigest())


class _Scan:
    """State of the search: the stretch that is open, and where the next block begins."""

    def __init__(self, file: str, begin: int, line: int, most_faults: int, compiled: bool) -> None:
        self.stretches: list[Stretch] = []
        self.faults: list[LineFault] = []
        self.more_faults = 0
        self.line = line
        self._file = file
        self._at = begin
        self._most = most_faults
        self._compiled = _compiled() if compiled else None
        self._key: tuple[int, int] | None = None
        self._first = (0, 0)  # byte and line of the open stretch
        self._last = (0, 0)  # behind it

    def add(self, block: bytearray, first: int, last: int, unended: int = 0) -> None:
        """Take bytes ``first:last`` of a block, whole lines; the last one's end may not be in the file."""
        if first == last:
            return
        text = np.frombuffer(block, dtype=np.uint8)[first:last]
        ends = np.flatnonzero(text == 10) + 1
        starts = np.empty_like(ends)
        starts[0], starts[1:] = 0, ends[:-1]
        begins = starts.tolist() if self._compiled is None else []
        i = 0
        while i < starts.size:
            start, end = first + int(starts[i]), first + int(ends[i])
            found = _KEY.match(block, start, min(start + _KEY_BYTES, end))
            after = i + 1
            if found is not None:
                key = (int(found[1]), int(found[2]))
                if self._compiled is None:
                    after = _other(block, first, begins, i, bytes(found[0]))
                else:
                    after = self._compiled(text, starts, i, bytes(found[0]))
                if self._key != key:
                    self.close()
                    self._key, self._first = key, (self._at + start - first, self.line + i)
            elif block[start:end].strip():
                self._fault(bytes(block[start : min(start + _KEY_BYTES, end)]), self.line + i)
            if self._key is not None:  # a blank line stays in its stretch
                self._last = (self._at + int(ends[after - 1]), self.line + after)
            i = after
        self._at += last - first - unended
        self.line += starts.size
        if unended and self._key is not None:
            self._last = (min(self._last[0], self._at), self._last[1])

    def _fault(self, head: bytes, line: int) -> None:
        self.close()
        cells = head.strip(b"\r\n").split(b",")[:2]
        shown = ",".join(cell.decode("utf-8", "replace").strip() for cell in cells)
        what = f"it begins with {shown[:40]!r}; allowed: numbers of device and trip; the line is left out"
        if len(self.faults) < self._most:
            self.faults.append(LineFault(line, what))
        else:
            self.more_faults += 1

    def close(self) -> None:
        """End the open stretch."""
        if self._key is not None:
            (begin, line), (end, after) = self._first, self._last
            self.stretches.append(Stretch(*self._key, begin, end, line, after - line))
            if len(self.stretches) > MOST_STRETCHES:
                raise RecordingError(
                    f"{self._file}, line {line}: more than {MOST_STRETCHES} stretches of rows of one trip each; "
                    "allowed: rows sorted by device, trip and time"
                )
        self._key = None


def _compiled() -> Callable[..., int]:
    from ldctoolkit.recordings.trips._text_kernels import first_other_line

    return first_other_line


def _other(block: bytearray, first: int, begins: list[int], i: int, key: bytes) -> int:
    """First line behind line i that does not begin with the key's bytes."""
    i += 1
    while i < len(begins) and block.startswith(key, first + begins[i]):
        i += 1
    return i
