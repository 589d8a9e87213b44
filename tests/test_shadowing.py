"""`controllers` and `studies` are general names: a user's own folders of that name are not taken for the toolkit's."""

import os
import subprocess
import sys
import types
from pathlib import Path

import pytest

import ldctoolkit.__main__ as launcher

STUDY = """
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
FILES = {
    "packages": {"__init__.py": "mine = True\n", "lqr.py": "class LQR: pass\n"},
    "folders": {"lqr.py": "class LQR: pass\n"},
    "raising packages": {"__init__.py": "raise RuntimeError('the wrong package')\n"},
}
KINDS = (*FILES, "modules")
LAUNCH = "from ldctoolkit.__main__ import main; sys.exit(main())"
RUN = ["run", "s.toml", "-o", "o", "--workers", "2", "--no-robustness", "--no-figures"]


def write(folder: Path, kind: str) -> Path:
    for name in ("controllers", "studies"):
        if kind == "modules":
            (folder / f"{name}.py").write_text("mine = True\n")
        else:
            (folder / name).mkdir()
            for file, text in FILES[kind].items():
                (folder / name / file).write_text(text)
    (folder / "s.toml").write_text(STUDY)
    return folder


def python(*arguments: str, cwd: Path, path: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = path
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd, env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip


def test_the_command_uses_its_own_packages(tmp_path: Path) -> None:
    folder = write(tmp_path, "raising packages")
    root = Path(launcher.__file__).resolve().parent.parent
    done = python("-m", "ldctoolkit", "controllers", "none", cwd=folder, path=f".{os.pathsep}{root}")
    assert (done.returncode, done.stderr) == (0, "")
    assert "none: No control" in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("path", [None, "."], ids=["no PYTHONPATH", "PYTHONPATH=."])
@pytest.mark.parametrize("kind", KINDS)
def test_it_does_so_however_it_is_started(kind: str, tmp_path: Path, path: str | None) -> None:
    done = python("-c", f"import sys; {LAUNCH}", "controllers", "lqr", cwd=write(tmp_path, kind), path=path)
    assert done.returncode == 0, done.stderr
    assert "r_delta" in done.stdout


@pytest.mark.slow
def test_workers_use_the_toolkits_packages(tmp_path: Path) -> None:
    """Also those that start afresh, as on macOS and Windows: a new interpreter, whose path begins with this folder."""
    folder = write(tmp_path, "raising packages")
    done = python("-m", "ldctoolkit", *RUN, cwd=folder, path=".")
    assert done.returncode == 0, done.stderr
    assert (folder / "o" / "report.html").is_file()
    (folder / "main.py").write_text(
        "import sys, multiprocessing\n"
        "if __name__ == '__main__':\n"
        f"    multiprocessing.set_start_method('spawn'); {LAUNCH}\n"
    )
    done = python("main.py", *RUN[:3], "again", *RUN[4:], cwd=folder, path=".")
    assert done.returncode == 0, done.stderr


LIBRARY = """
import sys, ldctoolkit
print({'controllers', 'studies'} & set(sys.modules), flush=True)
print(ldctoolkit.controller_class('lqr').title)
"""


@pytest.mark.parametrize("kind", ["packages", *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS[1:])])
def test_as_a_library_it_works_or_names_the_shadow_in_one_line(kind: str, tmp_path: Path) -> None:
    """Importing the toolkit alone touches neither package."""
    folder = write(tmp_path, kind)
    done = python("-c", LIBRARY, cwd=folder)
    touched, *title = done.stdout.splitlines()
    assert touched == "set()"
    if done.returncode == 0:
        assert title == ["LQR"]
        assert kind == "folders"  # found after the toolkit's own
        return
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("ldctoolkit.errors.ShadowedPackageError: ")
    assert str(folder / "controllers") in last
    assert "shadows the toolkit's own package 'controllers'" in last


def test_a_package_already_there_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Someone imported their own package before the launcher could do anything about it."""
    mine = types.ModuleType("studies")
    mine.__path__ = ["/nowhere/studies"]
    for name in [name for name in sys.modules if name.partition(".")[0] == "studies"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "studies", mine)
    monkeypatch.setattr(sys, "path", sys.path[:])
    assert launcher.main() == 2
    error = capsys.readouterr().err
    assert error.startswith("ldc: error: /nowhere/studies shadows the toolkit's own package 'studies' at ")
    assert error.count("\n") == 1
