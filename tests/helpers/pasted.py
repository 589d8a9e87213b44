"""Pages of the documentation as a user pastes them: all Python and all commands, in the order of the page."""

import gzip
import itertools
import re
import shlex
import sys
import types
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt

from helpers import mdf, spmd, uah
from helpers.cli import ROOT, csv_rows, good, ldc
from helpers.planted import plant_recording
from ldctoolkit import load_model

STUDY = """
name = "my"
[scenarios]
left = 40
right = 40
[ranking]
bootstrap = 200
[[design]]
law = "none"
[[design]]
law = "preview_proportional"
y_s = 0.1
[[design]]
law = "lqr"
y_s = [0.1, 0.2]
[design.gains]
r_delta = 300.0
"""


def _recording(path: Path) -> None:
    plain = path.with_name("plain.csv")
    plant_recording(plain, trips=12)
    path.write_bytes(gzip.compress(plain.read_bytes()) if path.suffix == ".gz" else plain.read_bytes())
    plain.unlink()


def _logs(path: Path) -> None:
    path.mkdir()
    mdf.write_log(path / "trip.mf4")


def _spmd(path: Path) -> None:
    path.mkdir()
    spmd.write_tables(path, [spmd.planted_drive(1, 1), spmd.planted_drive(1, 2)])


def _uah(path: Path) -> None:
    for day in range(10, 22):
        uah.make_trip(day).write(path, f"201511{day}{uah.NAME[8:]}")


def _departures(path: Path) -> None:
    _recording(path.with_name("stand-in.csv"))
    good("extract", "stand-in.csv", "--vehicle-width", 1.8, "--signals", "-o", path.name, cwd=path.parent)


def _model(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    _departures(path.with_name("stand-in.parquet"))
    good("fit", "stand-in.parquet", "-o", path.name, "--components", 1, "--kind", "mixture", cwd=path.parent)


def _large_model(path: Path) -> None:
    """Of so many departures that none of them is kept."""
    path.parent.mkdir(parents=True, exist_ok=True)
    load_model("reference").save(path)


def _study(path: Path) -> None:
    path.write_text(STUDY, encoding="utf-8")


def _sheet(path: Path) -> None:
    path.write_text(
        "mass = 1650.0\nfront_load = 910.0\nwheelbase = 2.8\nundersteer_gradient = 0.003\n", encoding="utf-8"
    )


def _results(path: Path) -> None:
    study = path.with_name("stand-in.toml")
    path.parent.mkdir(parents=True, exist_ok=True)
    _study(study)
    good("run", study.name, "-o", path.name, "--no-figures", "--workers", 1, cwd=path.parent)


STAND_INS: dict[str, Callable[[Path], object]] = {
    "drive.csv.gz": _recording, "recordings.csv.gz": _recording, "drive.csv": _recording, "logs": _logs,
    "trip.mf4": mdf.write_log, "map.toml": lambda path: path.write_text(mdf.MAP, encoding="utf-8"), "spmd": _spmd,
    "UAH-DRIVESET-v1": _uah, "departures.parquet": _departures,
    "d.parquet": _departures, "m.json": _model, "out/spmd/model.json": _large_model, "my.toml": _study,
    "car.toml": _sheet, "out": _results, "out/my": _results, "out/my-study": _results,
    "out/trigger-and-gains": _results, "reference": _results,
}  # fmt: skip
"""What stands for a file that a page takes for granted."""

FEWER = {"1e6": "2e4", "1e7": "2e4"}
"""Departures of `ldc risk`: minutes become seconds."""

CORRECTED = ("map.toml",)
"""What a page tells to correct by hand before the next command."""

NOT_RUN = ("--dask",)
"""What needs a cluster; tests/studies/running/test_executors.py has one."""


def steps(page: str) -> Iterator[tuple[str, str]]:
    """``("python", code)`` and ``("ldc", command line)`` of a page, in its order."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for kind, block in re.findall(r"^```([^\n]*)\n(.*?)^```", text, flags=re.M | re.S):
        if kind in ("python", "{code-cell} ipython3"):
            yield "python", re.sub(r"\A---\n.*?^---\n", "", block, flags=re.M | re.S)  # how a cell is shown
        elif kind in ("", "console"):
            lines = (line.removeprefix("$ ") for line in block.splitlines())
            yield from (("ldc", line) for line in lines if line.startswith("ldc "))


def commands(page: str) -> list[str]:
    """The command lines of a page."""
    return [text for kind, text in steps(page) if kind == "ldc"]


def run_page(page: str, folder: Path, only_python: bool = False) -> None:
    """Run a page in an empty folder, in a module of its own (dataclasses look theirs up)."""
    matplotlib.use("agg")
    module = types.ModuleType("page")
    sys.modules["page"] = module
    try:
        for kind, text in steps(page):
            if kind == "python":
                made = re.findall(r'(?:write_\w+|save)\(\s*"([\w.-]+)"', text)
                named = [name for name in re.findall(r'"([\w.-]+\.(?:parquet|json))"', text) if name not in made]
                _stand_in(folder, named)
                exec(compile(text, page, "exec"), module.__dict__)
                plt.close("all")
            elif not only_python and not any(word in text for word in NOT_RUN):
                _run_command(text, folder)
    finally:
        del sys.modules["page"]


def _stand_in(folder: Path, names: Iterable[str]) -> None:
    """Make what is needed and is not there."""
    for name in names:
        if name in STAND_INS and not (folder / name).exists():
            STAND_INS[name](folder / name)


def _run_command(line: str, folder: Path) -> None:
    words = [FEWER.get(word, word) for word in shlex.split(line, comments=True)[1:]]
    target = words[words.index(">") + 1] if ">" in words else None
    words = words[: words.index(">")] if target else words
    read = [word.rstrip("/") for before, word in itertools.pairwise(words) if before != "-o"]
    _stand_in(folder, (f"out/{read[0]}", *read) if words[0] == "report" else read)
    if "--design" in words and re.fullmatch("[0-9a-f]{4,}", words[words.index("--design") + 1]):
        words[words.index("--design") + 1] = csv_rows(folder / words[1] / "ranking.csv")[0]["design"]
    done = ldc(*words, cwd=folder)
    assert done.returncode in (0, 3), (line, done.stderr[-2000:])  # 3: done, and something is to be looked at
    if target:
        file = folder / target.removeprefix("~/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(done.stdout, encoding="utf-8")
        if target in CORRECTED:
            STAND_INS[target](folder / target)
