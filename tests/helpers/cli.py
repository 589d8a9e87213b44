"""The command line in this process: exit code, standard output and standard error as a real process gives them."""

import contextlib
import io
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from studies.cli import main


def ldc(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command in a folder. A handful of tests use `ldc_process`, for what only a process can show."""
    words = [str(argument) for argument in arguments]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.chdir(cwd), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main(words)
        except SystemExit as stop:  # of argparse
            code = stop.code if isinstance(stop.code, int) else 0 if stop.code is None else 1
    return subprocess.CompletedProcess(["ldc", *words], code, out.getvalue(), err.getvalue())


def ldc_process(*arguments: object, cwd: Path, python: Sequence[str] = ()) -> subprocess.CompletedProcess[str]:
    """The same as a process of its own; `python`: options of the interpreter."""
    command = [sys.executable, *python, "-m", "ldctoolkit", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)


def good(*arguments: object, cwd: Path) -> str:
    """Run what must succeed; the standard output."""
    done = ldc(*arguments, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return done.stdout


def bad(*arguments: object, cwd: Path) -> str:
    """Run what must fail: exit code 2, one message, nothing on stdout, no file added or changed; the message."""
    before = {path: path.stat().st_mtime_ns for path in cwd.rglob("*")}
    done = ldc(*arguments, cwd=cwd)
    assert done.returncode == 2, (done.stdout, done.stderr)
    assert done.stdout == ""
    assert re.fullmatch(r"ldc: error: [^\n]+\n", done.stderr), done.stderr
    assert {path: path.stat().st_mtime_ns for path in cwd.rglob("*")} == before
    return done.stderr


def printed_rows(out: str) -> list[list[str]]:
    """Cells of the lines of printed tables, headings first."""
    lines = (line for line in out.splitlines() if re.match("[│┃]", line))
    return [[cell.strip() for cell in re.split("[│┃]", line)[1:-1]] for line in lines]
