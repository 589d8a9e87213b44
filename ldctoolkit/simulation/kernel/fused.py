"""A product and a sum rounded once, where the code says so.

Left to the compiler, what is fused depends on what it had compiled before: two processes of one machine could then
differ in the last bit.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def"

from __future__ import annotations

from typing import Any, Final

from numba import types
from numba.extending import intrinsic


def _fma(typing, a, b, c):  # noqa: ARG001
    """Return a b + c, rounded once: an instruction, or the slower function of that name on a machine without it."""

    def build(context, builder, signature, arguments):  # noqa: ARG001
        return builder.fma(*arguments)

    if any(argument != types.float64 for argument in (a, b, c)):
        return None
    return types.float64(types.float64, types.float64, types.float64), build


fma: Final[Any] = intrinsic(_fma)
