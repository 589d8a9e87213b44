"""What was found in a part goes into a file and comes back bit for bit; anything else is refused in one way."""

import contextlib
import dataclasses
import io
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

from helpers.bits import assert_same_bits
from helpers.examples import examples
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings.departures_table import PartResult
from ldctoolkit.recordings.extract import extract_items
from ldctoolkit.recordings.find_departures import Criteria
from ldctoolkit.recordings.preparation import Preparation
from ldctoolkit.recordings.recording import Problem, Recording
from studies.extraction import Unread, part_bytes, read_part


@pytest.fixture(scope="session")
def make_result(drive: Callable[[int], Recording]) -> Callable[[], PartResult]:
    """Of recordings with labels, scales and notes, one of them without a usable sample."""
    drives = [drive(i) for i in range(3)]
    blind = drives[0].take(slice(0, 50))
    drives.append(dataclasses.replace(blind, name="blind \u00e9 \u4e00", valid=np.zeros(50, dtype=bool)))
    items: list[Recording | Problem] = [*drives, Problem("f", "line 3", 'what "is" wrong\n')]
    return lambda: extract_items(items, Criteria(1.8), Preparation(step=0.1))


@pytest.mark.parametrize("kind", ["nothing", "three drives"])
def test_there_and_back(make_result: Callable[[], PartResult], kind: str) -> None:
    result = PartResult() if kind == "nothing" else make_result()
    content = part_bytes(result)
    assert_same_bits(read_part(content), result)
    assert part_bytes(read_part(content)) == content


def test_the_same_result_makes_the_same_bytes(make_result: Callable[[], PartResult]) -> None:
    assert part_bytes(make_result()) == part_bytes(make_result())


def test_what_is_not_a_part_is_refused(make_result: Callable[[], PartResult]) -> None:
    good = part_bytes(make_result())
    text = io.BytesIO()
    np.savez(
        text, tree=np.frombuffer(b'{"class": "Problem", "fields": {"file": "", "place": "", "what": ""}}', np.uint8)
    )
    objects = io.BytesIO()
    np.savez(objects, tree=np.array([{"a": 1}], dtype=object))
    for content in (b"", b"hello", good[:100], good[:-30], text.getvalue(), objects.getvalue()):
        with pytest.raises(StoreError, match="broken"):
            read_part(content)
    with pytest.raises(TypeError):
        part_bytes(Unread("not a result"))  # type: ignore[arg-type]


@examples(150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_flipped_byte_is_refused_or_a_result(make_result: Callable[[], PartResult], data: st.DataObject) -> None:
    """Nothing else comes out, whatever the byte; that numbers are as they were written, the checksum tells."""
    content = bytearray(part_bytes(make_result()))
    content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    with contextlib.suppress(StoreError):
        assert isinstance(read_part(bytes(content)), PartResult)
