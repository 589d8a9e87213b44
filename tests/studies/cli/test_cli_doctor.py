"""``ldc doctor``, ``ldc --version --json``, and the scripts of ``ldc completion`` in the shells that are installed."""

import importlib.metadata
import importlib.util
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from numba.core import event

from helpers.cli import bad, good, ldc
from ldctoolkit import load_model, simulate, surroundings
from ldctoolkit.controllers import LQR
from ldctoolkit.numba_internals import kept
from ldctoolkit.studies import read_manifest


def doctor(folder: Path) -> tuple[int, dict[str, Any], dict[str, list[str]]]:
    """Exit code, the whole answer, and state and advice of each line by its name."""
    done = ldc("doctor", "--json", cwd=folder)
    content = json.loads(done.stdout)
    return done.returncode, content, {c["what"]: [c["state"], c["what to do"]] for c in content["checks"]}


def test_a_sound_installation(tmp_path: Path) -> None:
    simulate(LQR(), load_model("reference").sample(6, 6, seed=1))  # compiled, or loaded
    with event.install_recorder("numba:compile") as recorder:
        code, content, lines = doctor(tmp_path)
    assert recorder.buffer == []
    assert (code, content["broken"]) == (0, [])
    assert {state for state, _ in lines.values()} <= {"fine", "slow", "missing"}
    assert all((state == "fine") == (to_do == "") for state, to_do in lines.values())
    assert {"Python", "numpy", "optuna", "compiler of ldc export", "compiled expressions", "free memory"} <= {*lines}
    assert lines["loops: linear laws, ideal plant"] == ["fine", ""]
    numba = next(check for check in content["checks"] if check["what"] == "numba")
    assert numba["found"] == importlib.metadata.version("numba")
    table = good("doctor", cwd=tmp_path)
    assert table.splitlines()[-1] == "everything that is required works"
    for check in content["checks"][3:]:
        assert check["what"] in table


def test_a_package_that_cannot_be_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "osqp", None)
    code, content, lines = doctor(tmp_path)
    assert (code, content["broken"]) == (1, ["osqp"])
    assert lines["osqp"] == ["broken", f'pip install --force-reinstall "{needed("osqp")}"']
    monkeypatch.setitem(sys.modules, "rich", None)  # what would print the table
    done = ldc("doctor", cwd=tmp_path)
    assert (done.returncode, done.stdout.splitlines()[-1]) == (1, "broken: osqp, rich")
    assert "import of osqp halted" in done.stdout


def needed(package: str) -> str:
    return next(text for text in importlib.metadata.requires("ldctoolkit") or () if text.startswith(package))


def test_versions_outside_their_bounds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stated = ["numpy>=99", "daqp>=0.1,<99", "no-such-package>=1", 'optuna>=99; extra == "search"']
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: stated)
    code, content, lines = doctor(tmp_path)
    assert (code, content["broken"]) == (1, ["numpy", "no-such-package"])
    assert lines["daqp"] == ["fine", ""]
    assert lines["optuna"] == ["missing", 'for search: pip install "ldctoolkit[search]"']


def test_compilers_and_caches_that_are_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *of: None if name == "ziglang" else find(name, *of))
    monkeypatch.setenv("PATH", str(tmp_path))
    (tmp_path / "file").touch(mode=0o700)
    monkeypatch.setenv("LDC_NMPC_CACHE", str(tmp_path / "file" / "cache"))
    code, _, lines = doctor(tmp_path)
    assert code == 0
    to_do = 'install gcc or clang, or: pip install "ldctoolkit[export]"'
    assert lines["compiler of ldc export"] == ["missing", to_do]
    assert lines["compiler of expressions"][0] == "slow"
    to_do = "each process compiles anew: set LDC_NMPC_CACHE to a folder that you alone can write to"
    assert lines["compiled expressions"] == ["slow", to_do]


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
def test_a_cache_that_others_can_write_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "cache"
    folder.mkdir(mode=0o700)
    monkeypatch.setattr(surroundings, "cache_folder", lambda: folder)
    monkeypatch.setenv("LDC_NMPC_CACHE", str(folder))
    assert doctor(tmp_path)[2]["compiled expressions"][0] == ("fine" if surroundings.private(folder) else "slow")
    folder.chmod(0o777)
    assert doctor(tmp_path)[2]["compiled expressions"][0] == "slow"


def test_what_no_part_expects_is_a_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ldctoolkit.numba_internals", None)
    code, content, lines = doctor(tmp_path)
    assert (code, content["broken"]) == (1, ["loops"])
    assert lines["free memory"][0] in ("fine", "slow")


def test_few_cores_and_little_memory_are_slow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ldctoolkit.studies.cli.doctor.usable_cores", lambda: 1)
    monkeypatch.setattr("ldctoolkit.studies.cli.doctor.free_memory", lambda: 2.0**28)
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    blas = [{"internal_api": "openblas", "version": "0.3", "architecture": "Zen", "num_threads": 8}]
    monkeypatch.setattr("threadpoolctl.threadpool_info", lambda: blas)
    _, content, lines = doctor(tmp_path)
    assert lines["cores"][0] == "slow"
    assert lines["free memory"] == ["slow", "fewer --workers: each takes up to 0.5 GiB"]
    assert lines["linear algebra"] == ["slow", "set OPENBLAS_NUM_THREADS (or that of your library) to 1"]
    assert content["threads"] == {"cores": 1, "blas": blas}


def test_loops_are_found_once_they_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surroundings, "private", lambda _: True)  # whoever can write to the parents of this folder
    path = tmp_path / "kernel.py"

    def module(number: int) -> ModuleType:
        text = f"import numba\n@numba.njit(cache=True)\ndef f(x):\n    return x + {number}\n"
        path.write_text(text, encoding="utf-8")
        spec = importlib.util.spec_from_file_location("kernel", path)
        assert spec
        assert spec.loader
        made = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(made)
        return made

    first = module(1)
    assert kept(first) == {"f": False}
    assert first.f(1) == 2
    assert kept(first) == {"f": True}
    assert kept(module(10)) == {"f": False}  # another text of the function


def test_versions_as_they_are_recorded_with_a_study(finished: Path, tmp_path: Path) -> None:
    content, manifest = json.loads(good("--version", "--json", cwd=tmp_path)), read_manifest(finished)
    assert content["versions"] == manifest.versions
    assert content["machine"] == manifest.machine.model_dump()
    assert content["python"] == manifest.python
    assert content["threads"]["cores"] >= 1
    assert {"internal_api", "version", "architecture", "num_threads"} == {*content["threads"]["blas"][0]}


def test_json_belongs_to_version_or_to_a_command(tmp_path: Path) -> None:
    assert "required: --version" in bad("--json", cwd=tmp_path)
    assert "required: --version" in bad("--json", "models", cwd=tmp_path)
    assert "required: COMMAND" in bad(cwd=tmp_path)


# ------------------------------------------------------------------------------------------------ completion


Shell = Callable[[str], list[str]]  # a line that is typed; what it is completed with

BASH = """
source ./script; shift 0
COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMP_LINE="$*"; COMP_POINT=${#COMP_LINE}
_shtab_ldc ldc "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}" 2>/dev/null
printf '%s\\n' "${COMPREPLY[@]}"
"""


def output(*words: str, cwd: Path) -> list[str]:
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=60, check=True)
    return [line.partition("\t")[0].removesuffix("/") for line in done.stdout.splitlines()]


@pytest.fixture(params=["bash", "fish"])
def shell(request: pytest.FixtureRequest, tmp_path: Path) -> Shell:
    """A shell that has read its script, in a folder with a study file, a table and a folder."""
    name = request.param
    if not shutil.which(name):
        pytest.skip(f"{name} is not installed")
    (tmp_path / "script").write_text(good("completion", name, cwd=tmp_path), encoding="utf-8")
    for file in ("my-study.toml", "departures.parquet"):
        (tmp_path / file).touch()
    (tmp_path / "out").mkdir()
    if name == "bash":
        return lambda line: output("bash", "-c", BASH, "bash", *line.split(" "), cwd=tmp_path)
    return lambda line: output("fish", "-N", "-c", f"source ./script; complete -C '{line}'", cwd=tmp_path)


def test_commands_options_names_and_files_are_completed(shell: Shell) -> None:
    assert sorted(shell("ldc r")) == ["rank", "report", "review", "risk", "run"]
    assert sorted(shell("ldc run zo")) == ["zoo", "zoo-sweep"]
    assert sorted(shell("ldc run my")) == ["my-study.toml", "my-vehicle"]
    assert sorted(shell("ldc run --mo")) == ["--model"]
    assert sorted(shell("ldc run --model r")) == ["reference"]
    assert sorted(shell("ldc run zoo --output o")) == ["out"]
    assert sorted(shell("ldc init --law l")) == ["linear_mpc", "lqi", "lqr"]
    assert sorted(shell("ldc controllers lqr st")) == ["stanley"]
    assert sorted(shell("ldc review pi")) == ["pid"]
    assert sorted(shell("ldc fit d")) == ["departures.parquet"]
    assert sorted(shell("ldc export out --format ")) == ["c", "json", "m"]
    assert sorted(shell("ldc completion ")) == ["bash", "fish", "zsh"]
    assert {"--help", "--json"} <= {*shell("ldc doctor --")}


def zsh(line: str, folder: Path) -> str:
    """What a terminal shows of a line that is typed up to a tabulator."""
    import pty

    child, terminal = pty.fork()
    if child == 0:  # pragma: no cover
        os.chdir(folder)
        os.environ["TERM"] = "dumb"
        os.execlp("zsh", "zsh", "-f", "-i")
    shown, end = "", time.monotonic() + 60.0
    start = (
        "PS1=; unsetopt zle_bracketed_paste; autoload -U compinit; compinit -u -D; eval \"$(<script)\"; echo RE''ADY"
    )
    for text, mark in ((f"{start}\n", "READY"), (f"{line}\t", line), ("\n", "GOT")):
        os.write(terminal, text.encode())
        shown = ""
        while mark not in shown and time.monotonic() < end:
            if select.select([terminal], [], [], 0.1)[0]:
                shown += os.read(terminal, 65536).decode(errors="replace")
    os.close(terminal)
    os.waitpid(child, 0)
    return shown.partition("GOT ")[2].split("\r")[0]


@pytest.mark.skipif(not shutil.which("zsh"), reason="zsh is not installed")
def test_completion_in_zsh(tmp_path: Path) -> None:
    (tmp_path / "script").write_text(good("completion", "zsh", cwd=tmp_path), encoding="utf-8")
    (tmp_path / "departures.parquet").touch()
    (tmp_path / "script").open("a", encoding="utf-8").write("\nldc() { echo GO''T $*; }\n")
    for line, completed in {
        "ldc sens": "sensitivity", "ldc run trig": "run trigger-and-gains", "ldc init --law sta": "init --law stanley",
        "ldc fit dep": "fit departures.parquet", "ldc run --mod": "run --model",
        "ldc run dep": "run departures.parquet",
    }.items():  # fmt: skip
        assert zsh(line, tmp_path) == completed
