"""Compiled code of CasADi functions, where a C compiler is found; CasADi's virtual machine elsewhere.

The C text is generated and compiled on first use into a library in the user's cache folder, whose name is a digest of
the text, of the compiler and of its options. Contractions of products and sums are switched off, so that both routes
give the same numbers. Environment: ``LDC_NMPC_CODE=vm`` takes the virtual machine, ``LDC_NMPC_CACHE`` names the folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from ldctoolkit.errors import InputError, nearest

CODE, CACHE = "LDC_NMPC_CODE", "LDC_NMPC_CACHE"
_OPTIONS = ("-O2", "-fPIC", "-shared", "-ffp-contract=off")


def compiled(functions: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    """The functions from compiled C code, or as they are where that is switched off or does not work.

    Parameters
    ----------
    functions : tuple of casadi.Function
    name : str
        First part of the library's file name.

    Returns
    -------
    tuple of casadi.Function
        In the same order.

    Raises
    ------
    InputError
        If the environment variable `CODE` holds another word than auto or vm.
    """
    import casadi as ca

    choice = os.environ.get(CODE, "") or "auto"
    if choice not in ("auto", "vm"):
        raise InputError(f"{CODE}: {choice!r}; {nearest(choice, ('auto', 'vm'))}")
    library = _library(functions, name) if choice == "auto" else None
    if library is None:
        return functions
    try:
        return tuple(ca.external(function.name(), str(library)) for function in functions)
    except RuntimeError:  # a damaged file, made anew by the next process, or a folder that nothing may run from
        with contextlib.suppress(OSError):
            library.unlink(missing_ok=True)
        return functions


def cache_folder() -> Path:
    """Where libraries are kept: `CACHE`, or the folder that the platform has for caches of the user."""
    named = os.environ.get(CACHE)
    if named:
        return Path(named)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "ldctoolkit"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ldctoolkit"


def _library(functions: tuple[Any, ...], name: str) -> Path | None:
    """The compiled library, made if it is not there yet; None where it cannot be made."""
    compiler = None if sys.platform == "win32" else shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return None
    text = _c_text(functions, name)
    key = hashlib.sha256("\n".join([compiler, *_OPTIONS, platform.platform(), text]).encode()).hexdigest()[:24]
    try:
        folder = cache_folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        target = folder / f"{name}-{key}.so"
        if not target.is_file():
            _compile(compiler, text, target)
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None
    return target


def _c_text(functions: tuple[Any, ...], name: str) -> str:
    import casadi as ca

    generator = ca.CodeGenerator(name)
    for function in functions:
        generator.add(function)
    return str(generator.dump())


def _compile(compiler: str, text: str, target: Path) -> None:
    """Compile beside the target and rename, so that nobody ever sees half a library."""
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".compile-") as folder:
        source, made = Path(folder, "code.c"), Path(folder, "code.so")
        source.write_text(text, encoding="utf-8")
        command = [compiler, *_OPTIONS, "-o", str(made), str(source), "-lm"]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        with contextlib.suppress(FileExistsError):
            made.replace(target)
