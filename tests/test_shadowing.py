"""`controllers` and `studies` are general names: a user's own folders of that name break nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import controllers.lqr
import ldctoolkit.controllers.lqr
import ldctoolkit.studies.ranking
import studies.ranking
from helpers.cli import TINY_STUDY

FILES = {
    "packages": {"__init__.py": "mine = True\n", "lqr.py": "class LQR: pass\n"},
    "folders": {"lqr.py": "class LQR: pass\n"},
    "raising packages": {"__init__.py": "raise RuntimeError('the wrong package')\n"},
}
KINDS = (*FILES, "modules")
LAUNCH = "from ldctoolkit.studies.cli import main; sys.exit(main())"
RUN = ["run", "s.toml", "-o", "o", "--workers", "2", "--no-robustness", "--no-figures"]


def write(folder: Path, kind: str) -> Path:
    for name in ("controllers", "studies"):
        if kind == "modules":
            (folder / f"{name}.py").write_text("mine = True\n")
        else:
            (folder / name).mkdir()
            for file, text in FILES[kind].items():
                (folder / name / file).write_text(text)
    (folder / "s.toml").write_text(TINY_STUDY)
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
    done = python("-m", "ldctoolkit", "controllers", "none", cwd=write(tmp_path, "raising packages"), path=".")
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
import sys, ldctoolkit as ldc
print({'controllers', 'studies'} & set(sys.modules))
scenarios = ldc.load_model('reference').sample(3, 3, seed=1)
print(ldc.controller_class('lqr') is ldc.LQR, ldc.simulate(ldc.LQR(), scenarios, 0.1).S.shape)
try:
    import controllers
    print(controllers.__file__)
except RuntimeError as error:
    print(error)
"""


@pytest.mark.parametrize("kind", ["packages", *(pytest.param(k, marks=pytest.mark.slow) for k in KINDS[1:])])
def test_a_script_beside_folders_of_that_name(kind: str, tmp_path: Path) -> None:
    """The toolkit uses neither name; the short name is the user's own where the user has one."""
    folder = write(tmp_path, kind)
    done = python("-c", LIBRARY, cwd=folder)
    assert done.returncode == 0, done.stderr
    touched, works, theirs = done.stdout.splitlines()
    assert (touched, works) == ("set()", "True (6,)")
    if kind == "raising packages":
        assert theirs == "the wrong package"
    elif kind != "folders":  # a folder without __init__.py comes after every package
        assert theirs.startswith(str(folder))


ALIASES = """
import sys
{}
import controllers.lqr, ldctoolkit.controllers.lqr, studies.ranking, ldctoolkit.studies.ranking, pickle
assert controllers is ldctoolkit.controllers and controllers.lqr is ldctoolkit.controllers.lqr
assert studies is ldctoolkit.studies and studies.ranking is ldctoolkit.studies.ranking
assert sys.modules["controllers.lqr"].LQR is controllers.LQR is ldctoolkit.controller_class("lqr")
assert controllers.LQR.__module__ == "ldctoolkit.controllers.lqr"
assert controllers.lqr.__spec__.name == "ldctoolkit.controllers.lqr"
from studies import Study
"""


@pytest.mark.parametrize(
    "first", ["import controllers", "import studies.cli", "import ldctoolkit", "from controllers.lqr import LQR", ""]
)
def test_both_names_are_the_same_modules(first: str, tmp_path: Path) -> None:
    done = python("-c", ALIASES.format(first), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert controllers.lqr is ldctoolkit.controllers.lqr
    assert studies.ranking is ldctoolkit.studies.ranking
