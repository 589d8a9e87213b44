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
import numpy.typing as npt

from ldctoolkit.errors import RecordingError

BLOCK_BYTES: Final = 1 << 20
LONGEST_LINE: Final = 1 << 20
"""A longer line [bytes] is not a row of a table; it is left out."""

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
        If the file cannot be read, or the rows of trips are not together at all.

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
    digest, size, kept, skipping = hashlib.sha256(), 0, 0, False
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
                first, last = kept + max(0, min(begin - size, count)), kept + count
                size += count
                if skipping:  # inside a line that is longer than any row
                    end = buffer.find(b"\n", first, last) + 1
                    scan.skip((end or last) - first, ended=end > 0)
                    first, skipping = end or last, end == 0
                elif kept:
                    first = 0
                cut = max(buffer.rfind(b"\n", first, last) + 1, first)
                scan.add(buffer, first, cut)
                kept = last - cut
                hashed.result()
                if kept > LONGEST_LINE:
                    scan.too_long()
                    scan.skip(kept, ended=False)
                    kept, skipping = 0, True
                view[:kept] = view[last - kept : last]
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
        self._file = file
        self._at, self._line = begin, line
        self._most = most_faults
        self._same = _compiled() if compiled else _same
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
        long = ends - starts > LONGEST_LINE
        same = _same if long.any() else self._same
        i = 0
        while i < starts.size:
            start, end = int(starts[i]), int(ends[i])
            head = bytes(block[first + start : first + min(start + _KEY_BYTES, end)])
            found = _KEY.match(head)
            if found is None or long[i]:
                after = i + 1
                self._without_key(head, self._line + i, bool(long[i]))
                if self._key is not None and not text[start:end].tobytes().strip():  # blank: stays in its stretch
                    self._last = (self._at + end, self._line + after)
            else:
                key = (int(found[1]), int(found[2]))
                after = same(text, starts, i, found[0], long)
                if self._key != key:
                    self.close()
                    self._key, self._first = key, (self._at + start, self._line + i)
                self._last = (self._at + int(ends[after - 1]), self._line + after)
            i = after
        self._at += last - first - unended
        self._line += starts.size
        if unended and self._key is not None:
            self._last = (min(self._last[0], self._at), self._last[1])

    def _without_key(self, head: bytes, line: int, long: bool) -> None:
        if not head.strip():
            return
        if long:
            self._fault(line, f"longer than {LONGEST_LINE} bytes; the line is left out")
            return
        cells = head.strip(b"\r\n").split(b",")[:2]
        shown = ",".join(cell.decode("utf-8", "replace").strip() for cell in cells)
        self._fault(line, f"it begins with {shown[:40]!r}; allowed: numbers of device and trip; the line is left out")

    def _fault(self, line: int, what: str) -> None:
        self.close()
        if len(self.faults) < self._most:
            self.faults.append(LineFault(line, what))
        else:
            self.more_faults += 1

    def too_long(self) -> None:
        """The line that comes now does not end soon enough."""
        self._without_key(b"-", self._line, True)

    def skip(self, length: int, ended: bool) -> None:
        """Pass over bytes of a line that is too long."""
        self._at += length
        self._line += ended

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
    from ldctoolkit.recordings.trips._key_kernel import first_other_line

    def same(
        text: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], i: int, key: bytes, _: npt.NDArray[np.bool_]
    ) -> int:
        return first_other_line(text, starts, i, key)

    return same


def _same(
    text: npt.NDArray[np.uint8], starts: npt.NDArray[np.int64], i: int, key: bytes, long: npt.NDArray[np.bool_]
) -> int:
    """First line behind line i that does not begin with the key's bytes.

    Windows grow, so that a short trip does not pay for the whole block, and a long one not for each of its lines.
    """
    at, window = i + 1, 32
    while at < starts.size:
        some = starts[at : at + window]
        same = ~long[at : at + window]
        for p, byte in enumerate(key):
            # a key holds no line end and the text ends with one, so clipped places never agree
            same &= text[p:].take(some, mode="clip") == byte
        if not same.all():
            return at + int(np.argmin(same))
        at += some.size
        window = min(4 * window, 1 << 15)
    return at
