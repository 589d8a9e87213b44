"""What takes its time is named on a terminal, and nowhere else."""

import contextlib
import io
import re
from pathlib import Path

import numba
import pytest

from helpers.cli import Terminal, good
from helpers.recordings import OFFSET, drive, frame_of
from ldctoolkit import compiling
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.cli._console import moving_line
from ldctoolkit.studies.running import campaign


def on_terminal(*arguments: str, cwd: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[str, str]:
    """Standard output, which is no terminal, and what a terminal at stderr gets."""
    monkeypatch.setenv("TERM", "xterm")
    out, err = io.StringIO(), Terminal()
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(arguments) == 0
    return out.getvalue(), err.getvalue()


def test_phases_of_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good("init", "ideal", "--law", "lqr", "-n", "20", "-o", "s.toml", cwd=tmp_path)
    out, err = on_terminal("run", "s.toml", "--workers", "1", cwd=tmp_path, monkeypatch=monkeypatch)
    phases = ("choosing the finalists", "ranking", "driving the best on other plants", "writing ranking and report")
    places = [err.find(phase) for phase in phases]
    assert min(places) >= 0
    assert places == sorted(places)
    assert out.endswith("report:  out/s/report.html\n")
    assert on_terminal("run", "s.toml", "--quiet", cwd=tmp_path, monkeypatch=monkeypatch)[1] == ""
    assert on_terminal("run", "s.toml", "--json", cwd=tmp_path, monkeypatch=monkeypatch)[1] == ""


def test_a_pipe_gets_what_it_got(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in (("rank", "plain"), ("report", "plain", "--no-figures"), ("sensitivity", "plain", "--points", "3")):
        piped = good(*command, cwd=folder)
        out, err = on_terminal(*command, cwd=folder, monkeypatch=monkeypatch)
        assert out == piped
        assert "ranking" in err


def test_a_phase_inside_another_is_a_line_below_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame_of([drive(), drive("b", lane_offset=-OFFSET)]).write_csv(tmp_path / "r.csv")
    words = ("extract", "r.csv", "--vehicle-width", "1.8", "-o", "d.parquet", "--report", "q.html")
    out, err = on_terminal(*words, cwd=tmp_path, monkeypatch=monkeypatch)
    assert out.startswith("format: table (")
    assert 0 <= err.find("looking at the recordings") < err.find("reading table")
    assert re.search(r"reading table[^\r\n]*\n[^\r\n]*writing the page", err)


def test_compiling_is_a_moving_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the bar of a run, and where a command has none."""

    def compiles(*arguments: object) -> None:
        @numba.njit
        def loop(x: float) -> float:
            return x

        loop(1.0)

    compiling.listen()
    monkeypatch.setattr(compiling, "MODULES", {__name__})
    monkeypatch.setattr(campaign, "load_loops", compiles)
    good("init", "ideal", "--law", "lqr", "-n", "20", "-o", "s.toml", cwd=tmp_path)
    text = "compiling the closed loops, once, about a minute"
    arguments = "run", "s.toml", "--workers", "1"
    out, err = on_terminal(*arguments, cwd=tmp_path, monkeypatch=monkeypatch)
    assert 0 <= err.find(text) < err.find("designs ") < err.find("choosing the finalists")
    assert text not in out
    for option in ("--json", "--quiet"):
        out, err = on_terminal(*arguments, option, "-o", option[2:], cwd=tmp_path, monkeypatch=monkeypatch)
        assert err == ""
        assert out.count(f'{{"event": "phase", "phase": "{text}"}}\n') == (option == "--json")
    with contextlib.redirect_stderr(Terminal()) as err, moving_line(text):
        pass
    assert text in err.getvalue()
