"""Whatever lies on the disk, every reader gives departures within the criteria or an `LdcError`, nothing else."""

import tempfile
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from helpers import fuzz as making
from ldctoolkit.recordings import extract_departures, open_recordings

READERS = tuple(making.SOUND)
SHAPES = [(reader, i) for reader, shapes in making.SOUND.items() for i in range(len(shapes))]


def fixed(examples: int) -> settings:
    """Examples that follow from the code alone: without a seed or a store of earlier ones. They are not the same in
    every run: hypothesis also takes numbers out of the modules that are loaded."""
    return settings(
        max_examples=examples, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
    )


@pytest.mark.parametrize(("reader", "shape"), SHAPES)
def test_the_sound_files_hold_departures(tmp_path: Path, reader: str, shape: int) -> None:
    """Else the damage would be done to nothing."""
    making.write(tmp_path, making.SOUND[reader][shape])
    for format_ in (reader, "auto"):
        opened = open_recordings([tmp_path], format=format_)
        extraction = extract_departures(opened)
        assert (opened.reader.name, extraction.problems) == (reader, ())
        assert extraction.departures.n == making.DEPARTURES[reader]


Outcomes = Counter[str]


def fuzz_damaged_files(reader: str, examples: int) -> Outcomes:
    """Damaged files of a format, given to its reader or to whichever is found."""
    outcomes: Outcomes = Counter()
    sound = making.SOUND[reader]
    formats, widths = st.sampled_from((reader, reader, "auto")), st.sampled_from((None, None, 3.5))

    @fixed(examples)
    @example(sound[0], reader, True, None, 0, False)
    @example({}, reader, True, None, 0, False)
    @given(making.files_changed(sound), formats, st.booleans(), widths, st.integers(0, 15), st.booleans())
    def run(
        files: dict[str, bytes], format_: str, as_folder: bool, width: float | None, written: int, small: bool
    ) -> None:
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder, "in")
            root.mkdir()
            paths = making.write(root, files)
            table = Path(folder, "d.parquet") if written == 0 else None
            given_paths = [root] if as_folder else paths
            outcomes[making.check(given_paths, format_, width, table, small_parts=small)] += 1

    run()
    return outcomes


def fuzz_bytes(reader: str, examples: int) -> Outcomes:
    """Any bytes under the names that a format's files have."""
    outcomes: Outcomes = Counter()
    names = list(making.SOUND[reader][0])
    contents = st.lists(st.binary(max_size=300) | making.WORDS, min_size=len(names), max_size=len(names))

    @fixed(examples)
    @given(contents, st.booleans())
    def run(contents: list[bytes], as_folder: bool) -> None:
        with tempfile.TemporaryDirectory() as folder:
            paths = making.write(Path(folder), dict(zip(names, contents, strict=True)))
            outcomes[making.check([Path(folder)] if as_folder else paths, reader)] += 1

    run()
    return outcomes


FUZZ = {"damaged": fuzz_damaged_files, "bytes": fuzz_bytes}
FAST, SLOW = {"damaged": 20, "bytes": 8}, {"damaged": 300, "bytes": 300}


def check_outcomes(kind: str, outcomes: Outcomes, examples: int) -> None:
    """Neither were all files refused, nor did all stay as they were: one example of each is always among them."""
    assert outcomes.total() >= examples
    with_departures = outcomes["departures"] + outcomes["damaged departures"]
    assert (with_departures > 0) == (kind != "bytes")
    assert outcomes["refused"] > 0 or kind == "bytes"
    assert outcomes["refused without a word"] == 0


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", FUZZ)
def test_departures_or_a_known_error(kind: str, reader: str) -> None:
    check_outcomes(kind, FUZZ[kind](reader, FAST[kind]), FAST[kind])


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", FUZZ)
def test_departures_or_a_known_error_at_length(kind: str, reader: str) -> None:
    check_outcomes(kind, FUZZ[kind](reader, SLOW[kind]), SLOW[kind])
