"""``ldc doctor``, ``ldc --version --json`` and ``ldc completion``: the machine, its versions, and the shell."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import importlib.metadata
import json
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

from ldctoolkit.errors import first_line
from ldctoolkit.surroundings import free_memory, machine, private, usable_cores
from ldctoolkit.version import RECORDED, __version__, versions

from ..tables import Column, Row, Table, to_text
from ._console import Subparsers, print_table

_LOOPS: Final = (  # what needs compiled loops; their module, functions, and seconds to compile them
    ("linear laws, ideal plant", "simulation.kernel.entry", ("drive_lanes",), 15),
    ("linear laws, any plant", "simulation.kernel.entry", ("drive_any",), 15),
    ("other laws", "simulation.kernel.entry", ("begin", "go_on"), 30),
    ("vehicle models", "simulation.kernel.entry", ("begin", "go_on", "exchange"), 45),
    ("linear MPC", "controllers._mpc_kernel", ("sweep", "assemble", "finish"), 30),
    ("fit of a model", "mixture._kernels", ("_pass",), 5),
)
_NOT_SHOWN: Final = ("bench", "dev", "docs", "export")  # extras: no command needs them, or its compiler has a line
_ROOM: Final = 0.5  # [GiB] of memory for each worker process

_Line = dict[str, str]  # what, found, needed, state (fine, slow, missing: optional, broken: required), what to do


def add_parser(commands: Subparsers) -> None:
    """Declare the commands."""
    about = "check the installation: what is slow, missing or broken, and what to do"
    more = "Nothing is compiled. Exit code 1 where something that is required is broken."
    parser = commands.add_parser("doctor", help=about, description=f"C{about[1:]}. {more}")
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout, and no table")
    parser.set_defaults(run=run)
    about = "print a script with which a shell completes commands, options, names and files"
    parser = commands.add_parser("completion", help=about, description=f"P{about[1:]}.")
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="bash, zsh or fish")
    parser.set_defaults(run=print_completion)


def run(args: argparse.Namespace) -> int:
    """Carry ``ldc doctor`` out; the exit code reports whether something required is broken."""
    with contextlib.redirect_stdout(sys.stderr):  # packages may print when they are imported
        parts, facts = [[*_guarded(part)] for part in (_packages, _compilers, _processor, _loops)], environment()
    checks = [line for part in parts for line in part]
    broken = [line["what"] for line in checks if line["state"] == "broken"]
    end = f"broken: {', '.join(broken)}" if broken else "everything that is required works"
    kinds = {"slow": "warning", "missing": "warning", "broken": "bad"}
    rows = [Row([*line.values()], kinds.get(line["state"], ""), apart=line is p[0]) for p in parts for line in p]
    table = Table("", [Column(head, text=True) for head in checks[0]], rows)
    try:
        if args.json:
            print(json.dumps({"broken": broken, "checks": checks} | facts, indent=1))
        else:
            print_table(table)
            print(end)
    except ImportError:  # of rich
        print(to_text(table), end, sep="\n")
    return int(bool(broken))


def environment() -> dict[str, Any]:
    """What the last bits of a ranking depend on beside its study, as JSON: versions, machine, threads."""
    import threadpoolctl

    with contextlib.suppress(Exception):  # what is broken is a line of the doctor
        importlib.import_module("scipy.linalg")
    keys = ("internal_api", "version", "architecture", "num_threads")
    blas = [{key: library.get(key) for key in keys} for library in threadpoolctl.threadpool_info()]
    return {
        "ldctoolkit": __version__, "python": platform.python_version(), "versions": dict(versions(RECORDED)),
        "machine": machine(), "threads": {"cores": usable_cores(), "blas": blas},
    }  # fmt: skip


def _line(what: str, found: str, needed: str = "", fine: object = True, state: str = "", to_do: str = "") -> _Line:
    state, to_do = ("fine", "") if fine else (state, to_do)
    return {"what": what, "found": found, "needed": needed, "state": state, "what to do": to_do}


def _guarded(part: Callable[[], Iterator[_Line]]) -> Iterator[_Line]:
    """The lines of a part; what is odd beyond what the part looks for is a line too."""
    try:
        yield from part()
    except Exception as error:
        to_do = "repair what is broken above, or set NUMBA_CACHE_DIR to a folder of your own"
        yield _line(part.__name__.strip("_"), first_line(error), "", False, "broken", to_do)


def _packages() -> Iterator[_Line]:
    from packaging.requirements import Requirement

    here, python = machine(), f"{platform.python_implementation()} {platform.python_version()}, {sys.executable}"
    yield _line("Python", python, importlib.metadata.metadata("ldctoolkit")["Requires-Python"])  # pip compares them
    yield _line("platform", f"{here['system']}, {here['architecture']}, {here['processor']}")
    yield _line("ldctoolkit", f"{__version__}, {Path(__file__).resolve().parents[2]}")
    for one in map(Requirement, importlib.metadata.requires("ldctoolkit") or ()):
        extra = "".join(re.findall(r'extra == "(\w+)"', str(one.marker)))
        if extra not in _NOT_SHOWN and (one.marker is None or one.marker.evaluate({"extra": extra})):
            yield _package(one, extra)


def _package(needed: Any, extra: str) -> _Line:
    """A package against its bounds; one that is required is imported too."""
    name, bounds, ((_, found),) = needed.name, str(needed.specifier), versions((needed.name,))
    try:
        fits = found != "not installed" and needed.specifier.contains(found, prereleases=True)
        if fits and not extra:
            importlib.import_module(name.replace("-", "_"))
    except Exception as error:
        fits, found = False, f"{found}, import fails: {first_line(error)}"
    if extra:
        return _line(name, found, bounds, fits, "missing", f'for {extra}: pip install "ldctoolkit[{extra}]"')
    return _line(name, found, bounds, fits, "broken", f'pip install --force-reinstall "{name}{bounds}"')


def _compilers() -> Iterator[_Line]:
    from ldctoolkit.casadi_code import CACHE, c_compiler, code_folder
    from ldctoolkit.controllers import external

    found, to_do = " ".join(external.compiler() or ()), 'install gcc or clang, or: pip install "ldctoolkit[export]"'
    yield _line("compiler of ldc export", found or "none", "cc or ziglang", found, "missing", to_do)
    path, to_do = c_compiler(), "install gcc or clang: nonlinear MPC takes three to four times as long"
    yield _line("compiler of expressions", path or "none", "cc, gcc or clang", path, "slow", to_do)
    yield _cache("compiled expressions", code_folder(), CACHE)
    yield _line("temporary files", tempfile.gettempdir())


def _cache(what: str, folder: Path, variable: str) -> _Line:
    there = next(path for path in (folder, *folder.parents) if os.path.exists(path))  # noqa: PTH110 - raises nothing
    usable = there.is_dir() and os.access(there, os.W_OK | os.X_OK) and (there != folder or private(folder))
    to_do = f"each process compiles anew: set {variable} to a folder that you alone can write to"
    return _line(what, str(folder), "your own, writable", usable, "slow", to_do)


def _processor() -> Iterator[_Line]:
    cores, every, free = usable_cores(), os.cpu_count() or 1, free_memory() / 2**30
    to_do = "taskset, or a container, keeps the others from this process"
    yield _line("cores", f"{cores} of {every}, a worker on each", "", cores >= every, "slow", to_do)
    to_do = f"fewer --workers: each takes up to {_ROOM:g} GiB"
    known = f"{free:.1f} GiB" if free < 1e9 else "unknown"
    yield _line("free memory", known, f"{_ROOM * cores:g} GiB", free >= _ROOM * cores, "slow", to_do)
    for blas in environment()["threads"]["blas"]:
        found = f"{blas['internal_api']} {blas['version']}, threads: {blas['num_threads']}"
        to_do = f"set OPENBLAS_NUM_THREADS (or that of your library) to {cores}"
        yield _line("linear algebra", found, f"<={cores}", blas["num_threads"] <= cores, "slow", to_do)


def _loops() -> Iterator[_Line]:
    from ldctoolkit.numba_internals import kept
    from ldctoolkit.simulation.kernel import entry

    yield _cache("compiled loops", Path(entry.begin.stats.cache_path), "NUMBA_CACHE_DIR")
    for what, module, names, seconds in _LOOPS:
        there = kept(importlib.import_module(f"ldctoolkit.{module}"))
        missing = ", ".join(name for name in names if not there.get(name))
        to_do = f"the first run compiles them, once: about {seconds} s"
        found = f"not compiled: {missing}" if missing else "compiled"
        yield _line(f"loops: {what}", found, "", not missing, "slow", to_do)


def print_completion(args: argparse.Namespace) -> None:
    """Carry ``ldc completion`` out."""
    import shtab

    from ldctoolkit.registry import controller_names
    from ldctoolkit.scenario_model import bundled_models

    from ..study_file import catalog_names
    from . import parser

    laws, studies = [name for name in controller_names() if name.isidentifier()], catalog_names()
    names = {"STUDY": studies, "LAW": laws, "DESIGN": (*laws, *studies), "MODEL": bundled_models()}
    top = parser()
    (commands,) = (action for action in top._actions if isinstance(action, argparse._SubParsersAction))
    for action in (action for command in commands.choices.values() for action in command._actions):
        metavar: Any = action.metavar or ""
        if metavar in names:
            words, bash = " ".join(names[metavar]), f"_ldc_{metavar}"
            action.complete = {
                "bash": bash, "zsh": f"{{compadd {words}; _files}}",
                "fish": f"{words} (__fish_complete_path (commandline -ct))",
                "preamble": {"bash": f'{bash}() {{\n  compgen -W "{words}" -- "$1"\n  compgen -f -- "$1"\n}}'},
            }  # fmt: skip
        elif metavar in ("DIR", "FOLDER", "OLD", "NEW", "PATH", "LOG", "FILE") or "." in metavar:
            action.complete = shtab.FILE
    print(shtab.complete(top, args.shell))
