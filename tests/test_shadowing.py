"""`controllers` and `studies` are general names: a user's own folders of that name break nothing."""

from pathlib import Path

import pytest

from helpers.cli import ROOT, TINY_STUDY, python

FILES = {
    "packages": {"controllers/__init__.py": "mine = True\n", "controllers/lqr.py": "class LQR: pass\n"},
    "folders": {"controllers/lqr.py": "class LQR: pass\n"},
    "raising packages": {f"{name}/__init__.py": "raise RuntimeError\n" for name in ("controllers", "studies")},
    "modules": {"controllers.py": "mine = True\n", "studies.py": "mine = True\n"},
}
MAIN = "from ldctoolkit.studies.cli import main; sys.exit(main())"
RUN = ["run", "s.toml", "-o", "o", "--workers", "2", "--no-robustness", "--no-figures"]


def write(folder: Path, kind: str) -> Path:
    for file, text in FILES[kind].items() | {("s.toml", TINY_STUDY)}:
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(text)
    return folder


def test_the_command_uses_the_toolkits_packages(tmp_path: Path) -> None:
    folder = write(tmp_path, "raising packages")
    assert "none: No control" in python("-m", "ldctoolkit", "controllers", "none", cwd=folder, PYTHONPATH=".")


@pytest.mark.slow
@pytest.mark.parametrize("path", ["", "."], ids=["no PYTHONPATH", "PYTHONPATH=."])
@pytest.mark.parametrize("kind", FILES)
def test_it_does_so_however_it_is_started(kind: str, tmp_path: Path, path: str) -> None:
    folder = write(tmp_path, kind)
    assert "r_delta" in python("-c", f"import sys; {MAIN}", "controllers", "lqr", cwd=folder, PYTHONPATH=path)


@pytest.mark.slow
def test_workers_use_the_toolkits_packages(tmp_path: Path) -> None:
    """Also those that start afresh, as on macOS and Windows: a new interpreter, whose path begins with this folder."""
    folder = write(tmp_path, "raising packages")
    python("-m", "ldctoolkit", *RUN, cwd=folder, PYTHONPATH=".")
    assert (folder / "o" / "report.html").is_file()
    start = "import sys, multiprocessing\nif __name__ == '__main__':\n    multiprocessing.set_start_method('spawn'); "
    (folder / "main.py").write_text(f"{start}{MAIN}\n")
    python("main.py", *RUN[:3], "again", *RUN[4:], cwd=folder, PYTHONPATH=".")


LIBRARY = """
import sys, ldctoolkit as ldc, ldctoolkit.studies.ranking.ranking
scenarios = ldc.load_model('reference').sample(3, 3, seed=1)
assert ldc.controller_class('lqr') is ldc.LQR is ldc.controllers.lqr.LQR
assert ldc.simulate(ldc.LQR(), scenarios, 0.1).S.shape == (6,)
assert not {'controllers', 'studies'} & set(sys.modules)
"""


@pytest.mark.parametrize("kind", ["packages", *(pytest.param(k, marks=pytest.mark.slow) for k in [*FILES][1:])])
def test_a_script_beside_folders_of_that_name(kind: str, tmp_path: Path) -> None:
    """The toolkit uses neither name, which is the user's."""
    theirs = "import controllers; print(controllers.__file__)\n" if kind in ("packages", "modules") else ""
    folder = write(tmp_path, kind)
    printed = python("-c", LIBRARY + theirs, cwd=folder, PYTHONPATH="")
    assert printed.startswith(str(folder) if theirs else "")


@pytest.mark.parametrize("name", ["controllers", "studies"])
def test_in_a_checkout_no_second_copy_of_a_package_is_imported(name: str, tmp_path: Path) -> None:
    """Its root is on Python's path, and with it both folders."""
    check = f"try:\n    import {name}\nexcept ImportError as error:\n    print(error.name)\n"
    assert python("-c", check, cwd=tmp_path, PYTHONPATH=str(ROOT)) == f"{name}\n"
