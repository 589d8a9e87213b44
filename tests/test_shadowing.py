"""`controllers` and `studies` are general names: a user's own folders of that name are not taken for the toolkit's."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

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

KINDS = ("packages", "folders", "modules", "raising packages")


@pytest.fixture(params=KINDS)
def user_folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    for name in ("controllers", "studies"):
        if request.param == "modules":
            (tmp_path / f"{name}.py").write_text("mine = True\n")
            continue
        (tmp_path / name).mkdir()
        (tmp_path / name / "lqr.py").write_text("class LQR: pass\n")
        if request.param != "folders":
            text = (
                "raise RuntimeError('the wrong package')\n" if request.param.startswith("raising") else "mine = True\n"
            )
            (tmp_path / name / "__init__.py").write_text(text)
    (tmp_path / "s.toml").write_text(STUDY)
    return tmp_path


def python(*arguments: str, cwd: Path, path: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    if path is not None:
        environment["PYTHONPATH"] = path
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("path", [None, "."], ids=["no PYTHONPATH", "PYTHONPATH=."])
def test_the_command_uses_its_own_packages(user_folder: Path, path: str | None) -> None:
    for start in (["-m", "ldctoolkit"], ["-c", "import sys; from ldctoolkit.launcher import main; sys.exit(main())"]):
        done = python(*start, "controllers", "lqr", cwd=user_folder, path=path)
        assert done.returncode == 0, done.stderr
        assert "r_delta" in done.stdout


@pytest.mark.slow
def test_workers_use_the_toolkits_packages(user_folder: Path) -> None:
    done = python(
        "-m",
        "ldctoolkit",
        "run",
        "s.toml",
        "-o",
        "o",
        "--workers",
        "2",
        "--no-robustness",
        "--no-figures",
        cwd=user_folder,
        path=".",
    )
    assert done.returncode == 0, done.stderr
    assert (user_folder / "o" / "report.html").is_file()


@pytest.mark.slow
def test_workers_that_start_afresh_use_the_toolkits_packages(user_folder: Path) -> None:
    """The start method of macOS and Windows: a new interpreter, whose path begins with the user's folder."""
    (user_folder / "main.py").write_text(
        "import sys, multiprocessing\n"
        "from ldctoolkit.launcher import main\n"
        "if __name__ == '__main__':\n"
        "    multiprocessing.set_start_method('spawn')\n"
        "    sys.exit(main())\n"
    )
    done = python(
        "main.py",
        "run",
        "s.toml",
        "-o",
        "o",
        "--workers",
        "2",
        "--no-robustness",
        "--no-figures",
        cwd=user_folder,
        path=".",
    )
    assert done.returncode == 0, done.stderr


def test_as_a_library_it_works_or_names_the_shadow_in_one_line(user_folder: Path) -> None:
    code = "import ldctoolkit; print(ldctoolkit.controller_class('lqr').title)"
    done = python("-c", code, cwd=user_folder)
    if done.returncode == 0:
        assert done.stdout == "LQR\n"
        return
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("ldctoolkit.errors.ShadowedPackageError: ")
    assert str(user_folder / "controllers") in last
    assert "shadows the toolkit's own package 'controllers'" in last


def test_importing_the_toolkit_alone_touches_neither_package(user_folder: Path) -> None:
    code = "import sys, ldctoolkit; print({'controllers', 'studies'} & set(sys.modules))"
    assert python("-c", code, cwd=user_folder).stdout == "set()\n"


def test_a_package_that_is_in_place_already_is_named(user_folder: Path) -> None:
    """Someone imported their own package before the launcher could do anything about it."""
    code = "import sys, types\n"
    code += "m = types.ModuleType('studies'); m.__path__ = ['/nowhere/studies']; sys.modules['studies'] = m\n"
    code += "from ldctoolkit.launcher import main; sys.exit(main())"
    done = python("-c", code, "--version", cwd=user_folder)
    assert done.returncode == 2
    assert done.stderr.startswith("ldc: error: /nowhere/studies shadows the toolkit's own package 'studies' at ")
    assert done.stderr.count("\n") == 1
