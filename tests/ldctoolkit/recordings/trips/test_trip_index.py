import hashlib
import re
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from helpers.examples import examples
from ldctoolkit.errors import RecordingError
from ldctoolkit.recordings import trip_index
from ldctoolkit.recordings.trip_index import Stretch, index_trips

HEADER = b"Device,Trip,Time\r\n"


def indexed(text: bytes, **options: int) -> trip_index.TripIndex:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.csv")
        path.write_bytes(HEADER + text)
        return index_trips(path, len(HEADER), 2, **options)


def by_hand(text: bytes) -> tuple[list[Stretch], list[int]]:
    """Line after line."""
    found: list[Stretch] = []
    faults: list[int] = []
    open_ = False
    at = len(HEADER)
    lines = text.split(b"\n")
    whole = [line + b"\n" for line in lines[:-1]] + ([lines[-1]] if lines[-1] else [])
    for number, line in enumerate(whole, 2):
        begin, at = at, at + len(line)
        cells = line.split(b",")
        if not line.strip():
            if open_:
                one = found.pop()
                found.append(Stretch(one.device, one.trip, one.begin, at, one.line, one.lines + 1))
            continue
        key = [cell.strip(b" \t") for cell in cells[:2]]
        if len(cells) < 3 or not all(re.fullmatch(rb"-?\d+(\.0*)?", cell) for cell in key):
            faults.append(number)
            open_ = False
            continue
        device, trip = (int(float(cell)) for cell in key)
        if open_ and (found[-1].device, found[-1].trip) == (device, trip):
            one = found.pop()
            found.append(Stretch(device, trip, one.begin, at, one.line, one.lines + 1))
        else:
            found.append(Stretch(device, trip, begin, at, number, 1))
        open_ = True
    return found, faults


line = st.one_of(
    st.builds(
        lambda device, trip, rest: f"{device},{trip},{rest}".encode(),
        st.sampled_from(["7", "71", "7 ", " 8", "8.0", "-3"]),
        st.sampled_from(["1", "12", "1 ", "2", "123456"]),
        st.text("0123456789,.-E \t", max_size=30),
    ),
    st.sampled_from([b"", b"  ", b"junk", b"7,1", b"7,x,1", b",,", b"\xff\xfe", b"7;1;2", b"1_0,1,2"]),
)
text = st.builds(
    lambda lines, end, last: end.join([*lines, b""] if last else lines),
    st.lists(line.flatmap(lambda one: st.integers(1, 40).map(lambda n: [one] * n)), max_size=12).map(
        lambda runs: [one for run in runs for one in run]
    ),
    st.sampled_from([b"\n", b"\r\n"]),
    st.booleans(),
)


@pytest.mark.slow
@examples(150)
@given(
    text=text,
    block_bytes=st.sampled_from([1, 7, 64, 1000, 1 << 20]),
    compiled_from=st.sampled_from([0, trip_index.COMPILED_FROM]),
)
def test_stretches_are_those_of_a_line_by_line_search(text: bytes, block_bytes: int, compiled_from: int) -> None:
    found = indexed(text, block_bytes=block_bytes, compiled_from=compiled_from)
    stretches, faults = by_hand(text)
    assert (list(found.stretches), [fault.line for fault in found.faults]) == (stretches, faults[:20])
    assert (found.more_faults, found.bytes) == (len(faults[20:]), len(HEADER + text))
    assert found.sha256 == hashlib.sha256(HEADER + text).hexdigest()


@examples(100)
@given(text=st.binary(max_size=400), block_bytes=st.integers(1, 60))
def test_any_bytes_give_whole_lines(text: bytes, block_bytes: int) -> None:
    whole, parts = indexed(text), indexed(text, block_bytes=block_bytes)
    assert whole == parts == indexed(text, compiled_from=0)
    content = HEADER + text
    for one in whole.stretches:
        assert content[one.begin - 1 : one.begin] == b"\n"
        assert content[one.end - 1 : one.end] == b"\n" or one.end == len(content)
        assert one.line == content.count(b"\n", 0, one.begin) + 1


@pytest.mark.parametrize("block_bytes", [1 << 16, 1 << 20])
def test_a_line_longer_than_any_row_ends_the_file(block_bytes: int) -> None:
    long = b"7,1," + b"1" * (3 << 20)
    with pytest.raises(RecordingError, match=r"a.csv: line 4 is longer than 1048576 bytes"):
        indexed(b"7,1,0\n7,1,1\n" + long + b"\n7,1,3\n", block_bytes=block_bytes)


def test_rows_that_are_not_sorted_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trip_index, "MOST_STRETCHES", 10)
    with pytest.raises(
        RecordingError, match=r"a.csv, line 12: more than 10 stretches .*sorted by device, trip and time"
    ):
        indexed(b"7,1,0\n7,2,0\n" * 20)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"a.csv: cannot be read: No such file"):
        index_trips(tmp_path / "a.csv", 0, 1)
