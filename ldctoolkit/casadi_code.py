"""CasADi expressions of a designer: names in them, checks of them, and their compiled functions."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import inspect
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from ldctoolkit.compiling import line
from ldctoolkit.errors import InputError, LdcError, UnknownNameError, raised
from ldctoolkit.surroundings import cache_folder, private


class Names:
    """CasADi expressions by name; another name is an error that proposes the nearest."""

    def __init__(self, path: str, hint: str = "", /, **expressions: Any) -> None:
        self.__dict__.update(expressions)
        self.__path, self.__hint = path, hint

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        names = [key for key in self.__dict__ if not key.startswith("_")]
        names += [key for key in vars(type(self)) if not key.startswith("_")]
        raise UnknownNameError(f"{self.__path}.{name}", "no such name", allowed=names, hint=self.__hint)


_SYMBOLS: Final = (
    "gains, states and lane are symbols of ca.SX: ca.if_else and ca.sqrt take them; if, math and MX do not"
)


def called(path: str, function: Callable[..., Any], *arguments: Any, hint: str = _SYMBOLS) -> Any:
    """What a designer's method returns; what it raises, because it met symbols or not, is one sentence."""
    try:
        return function(*arguments)
    except LdcError:
        raise
    except Exception as error:
        design: Any = getattr(function, "__self__", None)
        if isinstance(error, AttributeError) and design is not None and id(error.obj) == id(design):
            names = [field.name for field in dataclasses.fields(design) if field.init]
            owner = getattr(design, "name", type(design).__name__)
            raise UnknownNameError(f"{owner}.{error.name}", "no such field", allowed=names) from error
        error.__traceback__ = error.__traceback__ and error.__traceback__.tb_next  # from the designer's line on
        if error.__traceback__ is None and design is not None:  # it takes other arguments than those of its base
            kinds, name = reversed(type(design).__mro__), path.rpartition(".")[2]
            documented = next(vars(kind)[name] for kind in kinds if name in vars(kind))
            hint = f"its arguments are {', '.join(inspect.signature(documented).parameters)}"
        raise InputError(path, raised(error), hint=hint) from error


CODE, CACHE = "LDC_NMPC_CODE", "LDC_NMPC_CACHE"
_OPTIONS = ("-O2", "-fPIC", "-shared", "-ffp-contract=off")


def compiled(functions: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    """The functions from compiled C code, or as they are where that is switched off or does not work."""
    import casadi as ca

    choice = os.environ.get(CODE, "") or "auto"
    if choice not in ("auto", "vm"):
        raise InputError(CODE, value=choice, allowed=("auto", "vm"))
    library = _library(functions, name) if choice == "auto" else None
    if library is None:
        if choice == "auto":
            line(
                "CasADi expressions run in its virtual machine, three to four times slower than compiled: "
                "no C compiler (cc, gcc, clang), or no folder of one's own for its code"
            )
        return functions
    try:
        return tuple(ca.external(function.name(), str(library)) for function in functions)
    except RuntimeError:  # a damaged file, made anew by the next process, or a folder that nothing may run from
        with contextlib.suppress(OSError):
            library.unlink(missing_ok=True)
        return functions


def c_compiler() -> str | None:
    """Path of a C compiler for shared libraries; None without one."""
    return None if sys.platform == "win32" else shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")


def code_folder() -> Path:
    """Where compiled expressions are kept."""
    return Path(os.environ.get(CACHE) or cache_folder())


def _library(functions: tuple[Any, ...], name: str) -> Path | None:
    """The compiled library, made if it is not there yet; None where it cannot be made, or kept from others."""
    if (compiler := c_compiler()) is None:
        return None
    import casadi as ca

    generator = ca.CodeGenerator(name)
    for function in functions:
        generator.add(function)
    text = str(generator.dump())
    key = hashlib.sha256("\n".join([compiler, *_OPTIONS, platform.platform(), text]).encode()).hexdigest()[:24]
    try:
        folder = code_folder()
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        target = folder / f"{name}-{key}.so"
        if not private(folder):
            return None
        if not private(target):
            _compile(compiler, text, target)
    except (OSError, RuntimeError, subprocess.SubprocessError):
        return None
    return target


def _compile(compiler: str, text: str, target: Path) -> None:
    """Compile beside the target and rename, so that half a library is never seen."""
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=".compile-") as folder:
        source, library = Path(folder, "code.c"), Path(folder, "code.so")
        source.write_text(text, encoding="utf-8")
        command = [compiler, *_OPTIONS, "-o", str(library), str(source), "-lm"]
        subprocess.run(command, check=True, capture_output=True, timeout=300)
        library.chmod(0o700)
        with contextlib.suppress(FileExistsError):
            library.replace(target)


def checked_expression(path: str, value: Any, known: Any, allowed: str) -> Any:
    """The value as a CasADi scalar of the symbols of `known`; anything else is one sentence."""
    import casadi as ca

    try:
        scalar = ca.SX(value)
    except (TypeError, NotImplementedError, ValueError) as error:
        raise InputError(path, f"of type {type(value).__name__}", allowed=allowed) from error
    if scalar.shape != (1, 1):
        raise InputError(path, f"of shape {scalar.shape}", allowed=allowed)
    symbols = {hash(symbol) for symbol in ca.symvar(known)}
    if free := [symbol.name() for symbol in ca.symvar(scalar) if hash(symbol) not in symbols]:
        raise InputError(path, f"holds the symbol {free[0]!r}", allowed=allowed)
    steps = ca.Function("steps", ca.symvar(scalar), [scalar])
    constants = (k for k in range(steps.n_instructions()) if steps.instruction_id(k) == ca.OP_CONST)
    if any(steps.instruction_constant(k) != steps.instruction_constant(k) for k in constants):
        hint = "float() and functions of math make that of a symbol: use those of casadi"
        raise InputError(path, "holds NaN", hint=hint)
    return ca.densify(scalar)
