"""Loops that are compiled say so, once, where there is somebody to read it; loops that are on disk do not."""

import contextlib
import io
import json
from collections.abc import Callable, Iterator

import numba
import pytest

from ldctoolkit import compiling
from ldctoolkit.studies.cli.run import Lines
from ldctoolkit.studies.running.dispatch import displayed

TEXT = "compiling the closed loops, once, about a minute"


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """A function that is compiled at its first call, together with one that it calls."""
    compiling.line.cache_clear()
    compiling.listen()
    monkeypatch.setattr(compiling, "MODULES", {__name__})

    @numba.njit
    def inner(x: float) -> float:
        return 2.0 * x

    @numba.njit
    def outer(x: float) -> float:
        return inner(x) + 1.0

    return lambda: outer(1.0)


class Record:
    """A display that keeps what happens."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    @contextlib.contextmanager
    def __call__(self, text: str) -> Iterator[None]:
        self.seen.append(text)
        yield
        self.seen.append("done")


def test_one_line_in_a_script_or_notebook(watched: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> None:
    watched()
    watched()

    @numba.njit
    def another(x: float) -> float:
        return x

    another(1.0)
    assert capsys.readouterr() == ("", f"{TEXT}\n")


def test_the_innermost_display_shows_the_outermost_function(
    watched: Callable[[], None], capsys: pytest.CaptureFixture[str]
) -> None:
    outer, inner = Record(), Record()
    with compiling.shown_by(outer):
        with compiling.shown_by(inner):
            watched()
        assert (outer.seen, inner.seen) == ([], [TEXT, "done"])
        watched()  # nothing is compiled any more
    assert outer.seen == []
    assert capsys.readouterr().err == ""


def test_functions_of_others_are_not_shown(capsys: pytest.CaptureFixture[str]) -> None:
    theirs: dict[str, Callable[[float], float]] = {}
    exec("def theirs(x):\n    return x", {"__name__": "somewhere.other"}, theirs)
    numba.njit(theirs["theirs"])(1.0)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(("progress", "shown"), [(None, f"{TEXT}\n"), (False, "")])
def test_without_a_terminal(
    watched: Callable[[], None], progress: bool | None, shown: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with displayed(progress):
        watched()
    assert capsys.readouterr().err == shown


def test_a_json_line(watched: Callable[[], None], capsys: pytest.CaptureFixture[str]) -> None:
    stream = io.StringIO()
    with displayed(Lines(stream)) as progress:
        progress.stage("designs", 4)
        watched()
        numba.njit(lambda x: x)(1.0)  # the next loop says nothing new
        progress.advance(4)
    lines = [json.loads(line) for line in stream.getvalue().splitlines()]
    assert [line.get("done") for line in lines] == [0, None, 4]
    assert lines[1] == {"event": "phase", "phase": TEXT}
    assert capsys.readouterr().err == ""
