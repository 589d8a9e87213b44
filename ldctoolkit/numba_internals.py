"""Where the compiled loops reach into numba: nothing else in the toolkit does.

Plain numba would do, but for four things: equal bits, whatever the machine compiled before (`OPTIONS`, `fma`); bodies
without a branch, since only they become vector instructions (`larger`, `LARGEST_FLOAT`, `copy`); arrays without a
count of references (`uncounted`); code on disk that is made anew when a file that it calls changes (`source_version`).
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call"

import hashlib
import inspect
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numba
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

import ldctoolkit.compiling as compiling

compiling.listen()

# strict arithmetic: no number depends on its neighbours in a vector, nor on what was compiled before, which decides
# where a compiler that may fuses a product and a sum; division by zero gives infinity as in NumPy
OPTIONS: Final[dict[str, Any]] = {"nogil": True, "error_model": "numpy"}

LARGEST_FLOAT: Final = 1.7e308  # A comparison with infinity itself is not compiled for lanes

_POSITIVE: Final = (1 << 48) - 1  # Mask of an index: the compiler then knows that it is not counted from the end


def _instruction(build, *names):
    """A function of floats that is an instruction or two of the processor, without a branch."""

    def function(typing, *arguments):  # noqa: ARG001
        if any(argument != types.float64 for argument in arguments):
            return None
        return types.float64(*[types.float64] * len(names)), lambda _, builder, __, values: build(builder, *values)

    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in ("typing", *names)]
    )
    return intrinsic(function)


# a product and a sum rounded once, where the code says so: left to the compiler, two processes could differ in it
fma: Final[Any] = _instruction(lambda builder, a, b, c: builder.fma(a, b, c), "a", "b", "c")
# the larger one, or b where one is NaN
larger: Final[Any] = _instruction(lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b), "a", "b")


@numba.njit(forceinline=True, **OPTIONS)
def copy(w, row, other, other_row, count):
    """Copy rows of eight lanes from another array: what a loop over the lanes works on lies in one.

    Eight numbers are read before any is written: only then are they moved together.
    """
    for n in range(count):
        p, q = (other_row + 8 * n) & _POSITIVE, (row + 8 * n) & _POSITIVE
        a_0, a_1, a_2, a_3 = other[p], other[p + 1], other[p + 2], other[p + 3]
        a_4, a_5, a_6, a_7 = other[p + 4], other[p + 5], other[p + 6], other[p + 7]
        w[q], w[q + 1], w[q + 2], w[q + 3] = a_0, a_1, a_2, a_3
        w[q + 4], w[q + 5], w[q + 6], w[q + 7] = a_4, a_5, a_6, a_7


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


def source_version(modules: Iterable[ModuleType], *words: str) -> int:
    """A number >= 0 that changes with the text of modules, or with words.

    Numba keeps compiled code on disk, and looks only at the file of the function itself. A function that closes over
    this number, and uses it, is kept once for each value.
    """
    text = hashlib.sha256(",".join(words).encode())
    for module in modules:
        text.update(Path(str(module.__file__)).read_bytes())
    return int.from_bytes(text.digest()[:6], "big")
