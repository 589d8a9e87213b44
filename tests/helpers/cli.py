"""The command line in this process, tools, and code blocks of the documentation."""

import contextlib
import csv
import importlib
import io
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

from ldctoolkit.studies.cli import main

TINY_STUDY = """
name = "tiny"
[scenarios]
left = 3
right = 3
[ranking]
bootstrap = 100
[[design]]
law = "preview_proportional"
y_s = [0.1, 0.2]
"""


class Terminal(io.StringIO):
    """A stream that is taken for a terminal."""

    def isatty(self) -> bool:
        return True


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


def python(*arguments: object, cwd: Path, **environment: str) -> str:
    """Run Python as a process of its own, which must succeed, with more in its environment; the standard output."""
    command, env = [sys.executable, *map(str, arguments)], os.environ | environment
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def csv_rows(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


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


TOOLS = Path(__file__).resolve().parents[2] / "tools"


def tool(name: str) -> ModuleType:
    """The module tools/NAME.py, which may import its neighbours as when it runs as a script."""
    if str(TOOLS) not in sys.path:
        sys.path.append(str(TOOLS))
    return importlib.import_module(name)


ROOT = Path(__file__).resolve().parents[2]


def blocks(page: str, language: str) -> list[str]:
    """The blocks of a page in one language, by its path in the project: ``"docs/reference/commands.md"``."""
    text = (ROOT / page).read_text(encoding="utf-8")
    found = re.findall(r"^```([^\n]*)\n(.*?)^```", text, flags=re.M | re.S)
    return [block for kind, block in found if kind == language]


def run_python(page: str, scope: dict[str, Any]) -> dict[str, Any]:
    """Run all Python of a page, one block after the other in one scope; the scope."""
    for code in blocks(page, "python"):
        exec(compile(code, page, "exec"), scope)
    return scope


def install(project: Path, site: Path) -> None:
    """Leave in a folder what pip leaves of a pure package there, without a build backend or a network."""
    declared = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    name, version = declared["name"].replace("-", "_"), declared["version"]
    info = site / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {declared['name']}\nVersion: {version}\n")
    groups = (
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in declared["entry-points"].items()
    )
    (info / "entry_points.txt").write_text("\n".join(groups))
    (site / name).symlink_to(project / name, target_is_directory=True)
