"""Files, folders, terminals and machines that wish no good, or are unlike the developers' own."""

import base64
import contextlib
import hashlib
import importlib
import io
import itertools
import json
import os
import pickle
import re
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from markupsafe import Markup

from helpers.cli import ROOT, TINY_STUDY, bad, good, ldc, python
from ldctoolkit import LdcError, casadi_code, compiling, load_model, surroundings
from ldctoolkit.controllers import LQR
from ldctoolkit.recordings.mdf_logs import read_channel_map
from ldctoolkit.studies import load_study, read_manifest
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.pages.shell import Section, make_page
from ldctoolkit.studies.storage.run_table import check_room
from ldctoolkit.testing.contract import picklable
from ldctoolkit.testing.subject import ContractSettings, Subject

pytestmark = pytest.mark.skipif(os.name != "posix", reason="users, modes and pipes of POSIX")

RUN = ("--no-robustness", "--no-figures", "--workers")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "s.toml").write_text(TINY_STUDY)
    return tmp_path


# ------------------------------------------------------------------------------------------------ modules


def plant(folder: Path, *names: str) -> Path:
    """Modules that leave a mark when they are imported."""
    mark = folder / "imported"
    for name in names:
        (folder / f"{name}.py").write_text(f"open({str(mark)!r}, 'a').write('{name} ')\nraise ImportError('planted')\n")
    return mark


@pytest.mark.slow
@pytest.mark.parametrize("by", ["module", "command"])
def test_workers_and_their_trackers_import_nothing_from_the_working_directory(folder: Path, by: str) -> None:
    mark = plant(folder, "psutil", "multiprocessing", "loky", "cloudpickle")
    command = folder / "bin" / "ldc.py"  # like the installed one: its own folder comes first, not the working one
    command.parent.mkdir()
    command.write_text("import sys\nfrom ldctoolkit.studies.cli import main\nsys.exit(main())\n")
    words = (command,) if by == "command" else ("-m", "ldctoolkit")
    python(*words, "run", "s.toml", "-o", "o", *RUN, 2, cwd=folder)
    assert not mark.exists(), mark.read_text()


def test_nor_does_the_check_of_a_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = plant(tmp_path, "cloudpickle", "pickle")
    monkeypatch.chdir(tmp_path)
    assert list(picklable(Subject(LQR(), ContractSettings()))) == []
    assert not mark.exists()


SCRIPT = """
import ldctoolkit as ldc
from my_laws import Twice
if __name__ == "__main__":
    study = ldc.study(Twice, ldc.NoControl, left=3, right=3, ranking={"bootstrap": 100, "finalists": 0})
    print(len(ldc.run_study(study, workers=2).designs))
"""
LAW = """
import dataclasses, ldctoolkit as ldc
@dataclasses.dataclass(frozen=True)
class Twice(ldc.LQR):
    name = "twice"
    def prepare(self, plant):
        import my_numbers
        assert my_numbers.TWO == 2
        return super().prepare(plant)
"""


@pytest.mark.slow
def test_a_designers_own_modules_reach_the_workers(tmp_path: Path) -> None:
    for name, text in {"main": SCRIPT, "my_laws": LAW, "my_numbers": "TWO = 2\n"}.items():
        (tmp_path / f"{name}.py").write_text(text)
    assert python("main.py", cwd=tmp_path) == "2\n"


# ------------------------------------------------------------------------------------------------ compiled caches


class Planted:
    """What would run where a cache is read that others can write."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path]]:
        return os.mkdir, (self.mark,)


KERNEL = "import numba\n@numba.njit(cache=True)\ndef f(x):\n    return x + 1\n"


@pytest.fixture
def kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Path]:
    """Imports a compiled function and calls it, as the toolkit's are; the folder of its cache."""
    compiling.listen()
    (tmp_path / "planted_kernel.py").write_text(KERNEL)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "own"))

    def call() -> Path:
        sys.modules.pop("planted_kernel", None)
        module: ModuleType = importlib.import_module("planted_kernel")
        assert module.f(2) == 3
        return Path(module.f.stats.cache_path)

    return call


@pytest.mark.parametrize("kind", ["nbi", "nbc", "folder"])
def test_a_cache_that_others_can_write_is_not_used(kernel: Callable[[], Path], tmp_path: Path, kind: str) -> None:
    cache, mark = kernel(), tmp_path / "ran"
    (file,) = cache.glob(f"planted_kernel.*.{kind.replace('folder', 'nbi')}")
    file.write_bytes(pickle.dumps(Planted(mark)))
    if kind == "folder":
        cache.chmod(0o777)
        assert kernel().is_relative_to(tmp_path / "own")
        cache.chmod(0o755)
    else:
        file.chmod(0o666)
        assert kernel() == cache
        assert not stat.S_IMODE(file.stat().st_mode) & 0o022  # compiled anew
    assert not mark.exists()
    file.write_bytes(pickle.dumps(Planted(mark)))
    with contextlib.suppress(Exception):
        kernel()
    assert mark.exists()  # the attack does work where the file is the user's


def test_whose_a_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a" / "file"
    file.parent.mkdir()
    assert not surroundings.private(file)
    file.touch()
    assert surroundings.private(file)
    file.parent.chmod(0o777)
    assert not surroundings.private(file)
    file.parent.chmod(0o1777)  # as /tmp: what is there belongs to whoever made it
    assert surroundings.private(file)
    assert not surroundings.private(file.parent)
    file.parent.chmod(0o755)
    owner = file.stat().st_uid
    if owner == 0:
        file.chmod(0o620)
        assert not surroundings.private(file)
        os.chown(file, 12345, 12345)
        assert not surroundings.private(file)
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
        assert surroundings.private(file)  # the group is the user's own
        os.chown(file, -1, 12346)
        assert not surroundings.private(file)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: owner + 1)
        assert not surroundings.private(file)


CACHED = [
    ".".join(("ldctoolkit", *path.relative_to(ROOT).with_suffix("").parts)).replace(
        "ldctoolkit.ldctoolkit", "ldctoolkit"
    )
    for folder in ("ldctoolkit", "controllers", "studies")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "cache=True" in path.read_text(encoding="utf-8")
]


@pytest.mark.parametrize("module", [CACHED[0], *(pytest.param(x, marks=pytest.mark.slow) for x in CACHED[1:])])
def test_no_settings_of_numba_from_the_working_directory(module: str, tmp_path: Path) -> None:
    """Whichever module with a cache is imported first; its functions were declared behind the guard."""
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: planted\n")
    code = (
        f"import {module} as module, numba\n"
        "print(repr(numba.core.config.CACHE_DIR))\n"
        "for function in vars(module).values():\n"
        "    if getattr(getattr(function, '_cache', None), 'cache_path', None):\n"
        "        assert type(function._cache._cache_file).__name__ == '_File'\n"
        "        print('guarded' if 'planted' not in function.stats.cache_path else 'planted')\n"
    )
    directory, *functions = python("-c", code, cwd=tmp_path).splitlines()
    assert directory == repr(os.environ.get("NUMBA_CACHE_DIR", ""))
    assert {*functions} == {"guarded"}


def test_compiled_c_code_is_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    casadi = pytest.importorskip("casadi")
    x = casadi.SX.sym("x")
    functions = (casadi.Function("plus_one", [x], [x + 1]),)
    monkeypatch.setenv("LDC_NMPC_CACHE", str(tmp_path))
    library = casadi_code._library(functions, "planted")
    if library is None:
        pytest.skip("no C compiler")
    library.write_bytes(b"planted")
    library.chmod(0o777)
    assert casadi_code._library(functions, "planted") == library
    assert library.read_bytes()[:4] == b"\x7fELF" or sys.platform == "darwin"
    tmp_path.chmod(0o777)
    assert casadi_code._library(functions, "planted") is None


# ------------------------------------------------------------------------------------------------ texts


@pytest.fixture
def within() -> Iterator[None]:
    """End what waits for a pipe, or reads a device without end."""

    def late(*_: object) -> None:
        raise TimeoutError("it waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


TOML = {
    "lists in lists": "x = " + 1000 * "[" + 1000 * "]",
    "dotted key": ".".join(100_000 * ["a"]) + " = 1",
    "dotted table": "[" + " . ".join(100_000 * ['"a"']) + "]",
    "dotted, shorter": ".".join(100 * ["a"]) + " = 1",
    "digits": f"x = {5000 * '1'}",
    "digits that are read": f"x = {400 * '1'}",
    "hexadecimal digits": f"x = 0x{1_000_000 * 'f'}",
}
JSON = {
    "open lists": "[" * 100_000,
    "lists in lists": "[" * 100 + "]" * 100,
    "digits": f'{{"format_version": {300 * "1"}}}',
}
READERS: dict[str, Callable[[Path], object]] = {
    "study": load_study,
    "channel map": read_channel_map,
    "model": load_model,
    "manifest": lambda path: read_manifest(path.parent),
}


def path_for(reader: str, folder: Path) -> Path:
    return folder / ("manifest.json" if reader in ("model", "manifest") else "a.toml")


@pytest.mark.parametrize(
    ("reader", "attack"),
    [*itertools.product(("study", "channel map"), TOML), *itertools.product(("model", "manifest"), JSON)],
)
@pytest.mark.usefixtures("within")
def test_texts_that_ask_for_too_much(tmp_path: Path, reader: str, attack: str) -> None:
    path = path_for(reader, tmp_path)
    toml = path.suffix == ".toml"
    path.write_text((TOML if toml else JSON)[attack])
    with pytest.raises(LdcError, match="not a TOML file" if toml else r"nested too deeply|whole number"):
        READERS[reader](path)


@pytest.mark.parametrize("kind", ["pipe", "device", "large"])
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.usefixtures("within")
def test_only_regular_files_of_some_size(tmp_path: Path, reader: str, kind: str) -> None:
    path = path_for(reader, tmp_path)
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        with path.open("wb") as stream:
            stream.truncate(100 << 20)
    with pytest.raises(LdcError, match="larger than" if kind == "large" else "not a regular file"):
        READERS[reader](path)


@pytest.mark.usefixtures("within")
def test_no_pipe_is_waited_for(folder: Path) -> None:
    good("run", "s.toml", "-o", "o", *RUN, 1, cwd=folder)
    for name in ("manifest.json", "model.json", "scenarios.parquet", "timing.json"):
        kept = (folder / "o" / name).read_bytes()
        (folder / "o" / name).unlink()
        os.mkfifo(folder / "o" / name)
        bad("report", "o", "--no-robustness", "--no-figures", cwd=folder)
        (folder / "o" / name).unlink()
        (folder / "o" / name).write_bytes(kept)
    for suffix in ("csv", "csv.gz", "parquet", "dat", "mf4", "txt"):
        os.mkfifo(folder / f"pipe.{suffix}")
        bad("extract", f"pipe.{suffix}", "-o", "d.parquet", cwd=folder)
    bad("fit", "pipe.parquet", "-o", "m.json", cwd=folder)


# ------------------------------------------------------------------------------------------------ what is written


def test_a_page_says_which_style_and_script_are_its_own() -> None:
    section = Section("one", "One", Markup("<p>text</p>"), data={"x": 1}, scripts=("table.js",))
    page = make_page(kind="Test", title="t", heading="h", facts=(), sections=(section,), footer="f")
    (policy,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]+)">', page)
    assert page.index(policy) < page.index("<title>")
    for name, tag in (("style", "style"), ("script", "script")):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, flags=re.S)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert f"{name}-src 'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "utf-8"])
def test_a_terminal_that_cannot_print_a_character(folder: Path, encoding: str) -> None:
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding=encoding) for _ in range(2))
    with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        assert main(["run", "s.toml", "-o", "o", *RUN, "1"]) == 0
        assert main(["controllers", "lqr"]) == 0
        assert main(["assess", "lqr", "--standard", "euroncap-2026-elk-road-edge", "--no-tolerances"]) in (0, 3)
        assert main(["run", "none-\udcff-\N{GREEK SMALL LETTER DELTA}.toml"]) == 2
    err.flush()
    out.flush()


LONG = 300 * "n"


@pytest.mark.parametrize(
    "words",
    [
        ("run", f"{LONG}.toml"), ("run", LONG), ("run", "s.toml", "-o", LONG), ("rank", LONG), ("report", LONG),
        ("compare", LONG, LONG + "n"), ("extract", LONG, "-o", "d.parquet"), ("fit", f"{LONG}.parquet", "-o", "m.json"),
        ("sample", "reference", "-n", "4", "-o", f"{LONG}.csv"), ("models", LONG), ("models", f"{LONG}.json"),
        ("risk", LONG), ("risk", "s.toml", "-n", "100", "-o", LONG), ("assess", LONG), ("assess", f"{LONG}.toml"),
        ("review", LONG), ("controllers", LONG), ("init", "--law", "lqr", "-o", f"{LONG}.toml", "--name", "x"),
        ("init", "--law", "lqr", "--name", LONG), ("run", "s.toml", "--model", f"{LONG}.json"),
        ("run", "s.toml", "--departures", f"{LONG}.parquet"), ("export", LONG, "-o", "c"),
        ("review", "s.toml", "--plant", LONG),
    ],
    ids=lambda words: " ".join(words).replace(LONG, "LONG"),
)  # fmt: skip
def test_names_of_300_characters(folder: Path, words: tuple[str, ...]) -> None:
    bad(*words, cwd=folder)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "darwin", reason="names are UTF-8 there")
def test_paths_that_are_no_text(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = os.fsdecode(b"st\xff")
    monkeypatch.setattr(sys, "argv", ["ldc", "run", name])
    (folder / "s.toml").rename(folder / f"{name}.toml")
    good("run", f"{name}.toml", "-o", name, "--workers", 1, cwd=folder)
    good("rank", name, "--json", cwd=folder)
    assert name in json.loads((folder / name / "manifest.json").read_text())["command"]
    good("risk", f"{name}.toml", "-n", 1000, "-o", f"{name}r", cwd=folder)
    assert ldc("assess", f"{name}.toml", "--no-tolerances", "-o", f"{name}a", cwd=folder).returncode in (0, 3)
    good("sample", "reference", "-n", 4, "-o", f"{name}.parquet", cwd=folder)


# ------------------------------------------------------------------------------------------------ machines


LARGE = """
name = "large"
scenarios = {left = 50000, right = 50000}
[[design]]
law = "lqr"
y_s = {from = 0.0, to = 1.0, count = 100}
gains.r_delta = {from = 1.0, to = 2.0, count = 100}
"""


def test_more_memory_than_there_is(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ldctoolkit.studies.storage.run_table.free_memory", lambda: 2.0**33)
    (folder / "large.toml").write_text(LARGE)
    message = bad("run", "large.toml", "-o", "o", cwd=folder)
    assert "147.1 GiB" in message
    assert "8.0" in message
    assert not (folder / "o").exists()
    check_room(load_study(folder / "s.toml"), 100_000)
    with pytest.raises(LdcError, match="GiB"):
        check_room(load_study(folder / "s.toml"), 100_000_000)


def test_free_memory_is_a_number() -> None:
    assert surroundings.free_memory() > 1 << 20


def test_folders_of_dead_processes_are_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "import os, signal\nfrom ldctoolkit import surroundings\nkept = surroundings.temporary_folder()\n"
    command = [sys.executable, "-c", f"{code}os.kill(os.getpid(), signal.SIGKILL)"]
    dead = subprocess.run(command, env=os.environ | {"TMPDIR": str(tmp_path)}, check=False)
    assert dead.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    process = left.name.split("-")[-2]
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    others = [f"ldc-other.machine-{process}-x", f"{process}", "ldc-notes", f"ldc-{os.getpid()}-x"]
    for name in others:
        (tmp_path / name).mkdir()
    (tmp_path / f"ldc-{process}-link").symlink_to(tmp_path / others[0])
    (tmp_path / f"ldc-{process}-file").touch()
    (tmp_path / f"ldc-{process}-former").mkdir()
    own = surroundings.temporary_folder()
    surroundings.sweep.__wrapped__()
    there = {path.name for path in tmp_path.iterdir()}
    assert there == {*others, f"ldc-{process}-link", f"ldc-{process}-file", Path(own.name).name}
