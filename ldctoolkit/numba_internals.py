"""How the compiled loops use numba, beside `ldctoolkit.lanes`; nothing else in the toolkit reaches into it.

Equal bits, whatever the machine compiled before (`OPTIONS`); arrays without a count of references (`uncounted`); code
on disk that is made anew when a file that it calls changes (`source_version`).
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import hashlib
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from numba.core import cgutils
from numba.core.caching import FunctionCache
from numba.core.registry import cpu_target
from numba.extending import intrinsic

import ldctoolkit.compiling as compiling

compiling.listen()

# strict arithmetic: no number depends on its neighbours in a vector, nor on what was compiled before, which decides
# where a compiler that may fuses a product and a sum; division by zero gives infinity as in NumPy
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}

LARGEST_FLOAT: Final = 1.7e308


@intrinsic
def uncounted(typing, array):  # noqa: ARG001
    """The same array without its count of references; the caller of the compiled entry keeps it alive.

    Counting references in each small function would cost as much as the step of a plant, and the counters would go back
    and forth between the threads.
    """

    def build(context, builder, signature, arguments):  # noqa: ARG001
        counted = context.make_array(array)(context, builder, arguments[0])
        bare = context.make_array(array)(context, builder)
        for name in ("data", "nitems", "itemsize", "shape", "strides"):
            setattr(bare, name, getattr(counted, name))
        for name in ("meminfo", "parent"):
            setattr(bare, name, cgutils.get_null_value(getattr(counted, name).type))
        return bare._getvalue()

    return array(array), build


def kept(module: ModuleType) -> dict[str, bool]:
    """Functions of a module that stay on disk once compiled, and whether they are there; nothing is compiled.

    What is there is of the present source and for this processor; another type of an argument may still be missing.
    """
    codegen = cpu_target.target_context.codegen()
    caches = {name: getattr(function, "_cache", None) for name, function in vars(module).items()}
    return {
        name: any(key[1:] == cache._index_key((), codegen)[1:] for key in cache._cache_file._load_index())
        for name, cache in caches.items() if isinstance(cache, FunctionCache)
    }  # fmt: skip


def source_version(modules: Iterable[ModuleType], *words: str) -> int:
    """A number >= 0 that changes with the text of modules, or with words.

    Numba keeps compiled code on disk, and looks only at the file of the function itself. A function that closes over
    this number, and uses it, is kept once for each value.
    """
    text = hashlib.sha256(",".join(words).encode())
    for module in modules:
        text.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(text.digest()[:6], "big")
