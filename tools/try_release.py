"""Try what is in ``dist`` as a new user would: ``python tools/try_release.py [FOLDER] [--python INTERPRETER]...``.

The wheel goes into an environment of its own outside the checkout, once for each interpreter (this one without
``--python``), and everything runs in another folder: versions, the catalog, a first study, which compiles, a second,
an extraction, a fit, an export with its proof, and Python of the documentation: recordings as the tutorial makes them
up, and the README. Both are taken from the source archive, from which ``python -m build`` made the wheel. Prints the
time of each step.
"""

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

IN_ARCHIVE = (
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "SECURITY.md", "LICENSE", "Makefile",
    "constraints.txt", "docs/conf.py", "docs/index.md", "docs/tutorial.md", "tests/conftest.py", "tools/try_release.py",
)  # fmt: skip

CATALOG = """
from ldctoolkit import load_model, load_study
from ldctoolkit.studies.standards import load_standard, standard_names
from ldctoolkit.studies.study_file import catalog_names
studies = [load_study(name) for name in catalog_names()]
standards = [load_standard(name) for name in standard_names()]
print(len(studies), "studies,", len(standards), "standards,", load_model("reference").sample(1, 1, seed=1).n, "drawn")
"""

STUDY = """
name = "small"
[scenarios]
left = 200
right = 200
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [0.1, 0.2]
"""


class Trial:
    """One interpreter: commands in a folder that has nothing of the checkout, and how long each step took."""

    def __init__(self, python: str, folder: Path) -> None:
        self.python, self.folder, self.elsewhere = python, folder, folder / "elsewhere"
        self.elsewhere.mkdir()
        self.environment = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}

    def bin(self, name: str) -> str:
        windows = os.name == "nt"
        return str(self.folder / "env" / ("Scripts" if windows else "bin") / (f"{name}.exe" if windows else name))

    def run(self, *words: str | Path) -> str:
        """What a command prints; its whole output and an end where it fails."""
        done = subprocess.run(
            list(map(str, words)), cwd=self.elsewhere, env=self.environment, encoding="utf-8", errors="replace",
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False,
        )  # fmt: skip
        if done.returncode:
            sys.exit(f"{done.stdout}\n{' '.join(map(str, words))}: exit code {done.returncode}")
        return done.stdout

    def script(self, name: str, parts: list[str]) -> None:
        """Python as a file: worker processes read it again."""
        (self.elsewhere / name).write_text("\n".join(parts), encoding="utf-8")
        self.run(self.bin("python"), name)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Print minutes, and those of the processor, which count where a machine does other work too."""
        wall, before = time.perf_counter(), os.times()
        yield
        after = os.times()
        processor = after.children_user + after.children_system - before.children_user - before.children_system
        print(f"  {name}: {(time.perf_counter() - wall) / 60:.1f} minutes", end="")
        print(f" ({processor / 60:.1f} of processor time)" if processor else "", flush=True)


def expect(true: object, otherwise: str) -> None:
    if not true:
        sys.exit(f"the release is not what it should be: {otherwise}")


def unpacked(sdist: Path, wheel: Path, folder: Path) -> Path:
    """Where the source archive is unpacked; it has what a contributor needs, and the wheel has all of the toolkit."""
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (root,) = (path for path in folder.iterdir() if path.is_dir())
    lost = [name for name in IN_ARCHIVE if not (root / name).is_file()]
    expect(not lost, f"{sdist.name} is without {', '.join(lost)}")
    with zipfile.ZipFile(wheel) as archive:
        packed = {name for name in archive.namelist() if ".dist-info/" not in name}
    places = {"ldctoolkit": "ldctoolkit", "controllers": "ldctoolkit/controllers", "studies": "ldctoolkit/studies"}
    wanted = {
        f"{place}/{path.relative_to(root / name).as_posix()}"
        for name, place in places.items()
        for path in (root / name).rglob("*")
        if path.is_file() and path.suffix != ".pyi"
    }
    expect(packed == wanted, f"{wheel.name} differs from the source by {', '.join(sorted(packed ^ wanted))}")
    return root


def python_of(page: Path) -> list[str]:
    """The blocks of Python of a page, run by hand or while the site is built."""
    text = page.read_text(encoding="utf-8")
    return re.findall(r"^```(?:python|\{code-cell\} ipython3)\n(.*?)^```", text, flags=re.M | re.S)


def until_recordings(cells: list[str]) -> list[str]:
    """Those of the tutorial that make up its recordings."""
    return cells[: 1 + next(i for i, cell in enumerate(cells) if "recordings.csv" in cell)]


def try_wheel(wheel: Path, source: Path, python: str) -> None:
    """Everything that a first hour needs."""
    with tempfile.TemporaryDirectory(prefix="ldc-release-") as scratch:
        trial = Trial(python, Path(scratch))
        print(trial.run(python, "-c", "import sys; print('Python', sys.version.split()[0])").strip(), flush=True)
        with trial.step("environment and installation"):
            trial.run(python, "-m", "venv", trial.folder / "env")
            trial.run(trial.bin("python"), "-m", "pip", "install", "--quiet", wheel)
        ldc, version = trial.bin("ldc"), wheel.name.split("-")[1]
        with trial.step("version and catalog"):
            expect(version in trial.run(ldc, "--version"), f"ldc --version does not say {version}")
            if "doctor" in trial.run(ldc, "--help"):
                trial.run(ldc, "doctor")
            print("  " + trial.run(trial.bin("python"), "-c", CATALOG).strip())
        (trial.elsewhere / "small.toml").write_text(STUDY, encoding="utf-8")
        for name in ("first study, which compiles", "second study"):
            with trial.step(name):
                trial.run(ldc, "run", "small.toml", "-o", name.split()[0])
        with trial.step("extraction and fit"):
            trial.script("recordings.py", until_recordings(python_of(source / "docs" / "tutorial.md")))
            trial.run(ldc, "extract", "recordings.csv", "--vehicle-width", "1.9", "-o", "departures.parquet")
            trial.run(ldc, "fit", "departures.parquet", "--components", "1:2", "-o", "model.json")
        with trial.step("export with its proof"):
            proof = trial.run(ldc, "export", "first", "-o", "code")
            expect(re.search("steps: passed", proof), f"no proof of the exported code:\n{proof}")
        with trial.step("the README's Python"):
            trial.script("readme.py", python_of(source / "README.md"))


def main() -> None:
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("folder", nargs="?", default="dist", type=Path)
    asked.add_argument("--python", action="append", help="interpreter to try the wheel with; repeatable")
    chosen = asked.parse_args()
    (wheel,), (sdist,) = (list(chosen.folder.resolve().glob(kind)) for kind in ("*.whl", "*.tar.gz"))
    with tempfile.TemporaryDirectory(prefix="ldc-sdist-") as scratch:
        source = unpacked(sdist, wheel, Path(scratch))
        for python in chosen.python or [sys.executable]:
            try_wheel(wheel, source, python)


if __name__ == "__main__":
    main()
