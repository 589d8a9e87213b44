"""Eight scenarios side by side as one value in compiled code: a number of each in the processor's vector registers.

Compiled functions work on two types. `Lanes` are eight floats: ``+ - * /``, ``abs``, ``min``, ``max``, `copysign`,
`rint`, `fma` and comparisons act on each by itself, a float beside them stands for eight of it. A comparison gives a
mask, with ``& | ~``, for `select` and `any_lane`. A table has rows of lanes: ``w[row]`` is a row, ``w[row, lane]`` one
number. No lane sees its neighbours, so that the numbers of a scenario cannot depend on them, and an equation reads as
it does for one scenario.

Left to itself, the compiler makes vector instructions of a loop over eight numbers only if the loop's body suits it.
"""

# mypy: disable-error-code="untyped-decorator, no-untyped-def, no-untyped-call, misc"

import inspect
import math
import operator
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, register_model

from ldctoolkit.arrays import LANES, FloatArray

_ALIGNED: Final = 64  # [bytes] of a row: it lies in one line of the processor's cache

_VECTOR: Final = ir.VectorType(ir.DoubleType(), LANES)
_BITS: Final = ir.VectorType(ir.IntType(1), LANES)
_INDEX: Final = ir.IntType(64)


class _Lanes(types.Type):
    def __init__(self) -> None:
        super().__init__(name="Lanes")


class _Mask(types.Type):
    def __init__(self) -> None:
        super().__init__(name="LanesMask")


class _Table(types.Type):
    def __init__(self) -> None:
        super().__init__(name="LanesTable")


_lanes, _mask, _table, _float, _position = _Lanes(), _Mask(), _Table(), types.float64, types.UniTuple(types.intp, 2)


def _model(kind: type, value: ir.Type) -> None:
    @register_model(kind)
    class Model(models.PrimitiveModel):
        def __init__(self, manager, numba_type):
            super().__init__(manager, numba_type, value)


_model(_Lanes, _VECTOR)
_model(_Mask, _BITS)
_model(_Table, ir.PointerType(ir.DoubleType()))


def _wide(builder, value):
    """Eight of a float or a condition; lanes and masks as they are."""
    if isinstance(value.type, ir.VectorType):
        return value
    kind, zeros = ir.VectorType(value.type, LANES), ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    nothing = ir.Constant(kind, ir.Undefined)
    first = builder.insert_element(nothing, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, nothing, zeros)


def _called(builder, name, arguments):
    """One of the compiler's functions of vectors."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR] * len(arguments))
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v{LANES}f64"), arguments)


# ------------------------------------------------------------------------------------------------ operators


def _operator(function: Any, result: types.Type, build: Callable[..., Any], count: int = 2) -> None:
    """Let an operator act on lanes, or on lanes and floats."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):  # noqa: ARG002
            numbers = all(a == _lanes or isinstance(a, types.Float | types.Integer) for a in args)
            if len(args) == count and _lanes in args and numbers:
                return signature(result, *(a if a == _lanes else _float for a in args))
            return None

    infer_global(function)(Template)

    def lower(context, builder, signature, arguments):  # noqa: ARG001
        return build(builder, *(_wide(builder, value) for value in arguments))

    for kinds in [(_lanes,)] if count == 1 else [(_lanes, _lanes), (_lanes, _float), (_float, _lanes)]:
        lower_builtin(function, *kinds)(lower)


def _logic(function: Any, build: Callable[..., Any], count: int = 2) -> None:
    """Let an operator act on masks, or on masks and conditions."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):  # noqa: ARG002
            fits = len(args) == count and _mask in args and all(a in (_mask, types.boolean) for a in args)
            return signature(_mask, *args) if fits else None

    infer_global(function)(Template)

    def lower(context, builder, signature, arguments):  # noqa: ARG001
        return build(builder, *(_wide(builder, value) for value in arguments))

    for kinds in [(_mask,)] if count == 1 else [(_mask, _mask), (_mask, types.boolean), (types.boolean, _mask)]:
        lower_builtin(function, *kinds)(lower)


for _add, _subtract, _multiply in (
    (operator.add, operator.sub, operator.mul), (operator.iadd, operator.isub, operator.imul),
):  # fmt: skip
    _operator(_add, _lanes, lambda builder, a, b: builder.fadd(a, b))
    _operator(_subtract, _lanes, lambda builder, a, b: builder.fsub(a, b))
    _operator(_multiply, _lanes, lambda builder, a, b: builder.fmul(a, b))
_operator(operator.truediv, _lanes, lambda builder, a, b: builder.fdiv(a, b))
_operator(operator.neg, _lanes, lambda builder, a: builder.fneg(a), 1)
_operator(abs, _lanes, lambda builder, a: _called(builder, "fabs", [a]), 1)
_operator(math.copysign, _lanes, lambda builder, a, b: _called(builder, "copysign", [a, b]))
# the second one where a number is NaN
_operator(max, _lanes, lambda builder, a, b: builder.select(builder.fcmp_ordered(">", a, b), a, b))
_operator(min, _lanes, lambda builder, a, b: builder.select(builder.fcmp_ordered("<", a, b), a, b))
for _compare, _sign in (
    (operator.lt, "<"), (operator.le, "<="), (operator.gt, ">"), (operator.ge, ">="), (operator.eq, "=="),
):  # fmt: skip
    _operator(_compare, _mask, lambda builder, a, b, sign=_sign: builder.fcmp_ordered(sign, a, b))
_operator(operator.ne, _mask, lambda builder, a, b: builder.fcmp_unordered("!=", a, b))
for _and, _or in ((operator.and_, operator.or_), (operator.iand, operator.ior)):
    _logic(_and, lambda builder, a, b: builder.and_(a, b))
    _logic(_or, lambda builder, a, b: builder.or_(a, b))
_logic(operator.invert, lambda builder, a: builder.not_(a), 1)


# ------------------------------------------------------------------------------------------------ functions


def _function(result: Callable[..., Any], build: Callable[..., Any], *names: str) -> Any:
    """A function of lanes, of floats, or of both; `result` is its type for those of the arguments, or None."""

    def function(typing, *arguments):  # noqa: ARG001
        arguments = tuple(_float if isinstance(a, types.Integer) else a for a in arguments)
        kind = result(*arguments)
        if kind is None:
            return None

        def lower(context, builder, signature, values):  # noqa: ARG001
            wide = _lanes in signature.args or _mask in signature.args
            return build(builder, *(_wide(builder, v) if wide and v.type == ir.DoubleType() else v for v in values))

        return kind(*arguments), lower

    function.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in ("typing", *names)]
    )
    return intrinsic(function)


def _widest(*kinds):
    if not all(kind in (_lanes, _float) for kind in kinds):
        return None
    return _lanes if _lanes in kinds else _float


def _fused(builder, a, b, c):
    return _called(builder, "fma", [a, b, c]) if a.type == _VECTOR else builder.fma(a, b, c)


def _rounding(name):
    return _function(lambda a: a if a == _lanes else None, lambda builder, a: _called(builder, name, [a]), "a")


# a product and a sum rounded once, where the code says so: left to the compiler, two processes could differ in it
fma: Final[Any] = _function(_widest, _fused, "a", "b", "c")
# a where a mask, or a condition, holds, else b; without a branch
select: Final[Any] = _function(
    lambda mask, a, b: _lanes if mask == _mask else _widest(a, b),
    lambda builder, mask, a, b: builder.select(mask, a, b),
    "mask", "a", "b",
)  # fmt: skip
# to the nearest whole number, halves to even ones
rint: Final[Any] = _rounding("rint")


def _reduced(name):
    def build(builder, a):
        function = ir.FunctionType(ir.DoubleType(), [_VECTOR])
        name_of_all = f"llvm.vector.reduce.{name}.v{LANES}f64"
        return builder.call(cgutils.get_or_insert_function(builder.module, function, name_of_all), [a])

    return _function(lambda a: types.float64 if a == _lanes else None, build, "a")


# the largest and the smallest number of lanes
largest: Final[Any] = _reduced("fmax")
smallest: Final[Any] = _reduced("fmin")
# each number to the next whole one
ceil: Final[Any] = _rounding("ceil")
# whether a mask holds in any lane
any_lane: Final[Any] = _function(
    lambda mask: types.boolean if mask == _mask else None,
    lambda builder, mask: builder.icmp_unsigned(
        "!=", builder.bitcast(mask, ir.IntType(LANES)), ir.Constant(ir.IntType(LANES), 0)
    ),
    "mask",
)


# ------------------------------------------------------------------------------------------------ tables


@intrinsic
def table(typing, array):  # noqa: ARG001
    """The table in an array of floats, row after row; the caller of the compiled entry keeps the array alive.

    A table has no count of references: counting them in each small function would cost as much as the step of a plant,
    and the counters would go back and forth between the threads.
    """

    def build(context, builder, signature, arguments):  # noqa: ARG001
        return context.make_array(array)(context, builder, arguments[0]).data

    return (_table(array), build) if isinstance(array, types.Array) and array.dtype == _float else None


@intrinsic
def below(typing, start, row):  # noqa: ARG001
    """The table that begins with a row of another."""

    def build(context, builder, signature, arguments):  # noqa: ARG001
        return _row(builder, *arguments)

    return (_table(start, types.intp), build) if start == _table else None


def _row(builder, start, row, lane=None):
    position = builder.mul(row, ir.Constant(_INDEX, LANES))
    return builder.gep(start, [position if lane is None else builder.add(position, lane)])


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args, kws):  # noqa: ARG002
        if args[0] != _table:
            return None
        if isinstance(args[1], types.Integer):
            return signature(_lanes, _table, types.intp)
        return signature(_float, _table, _position)


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args, kws):  # noqa: ARG002
        if args[0] != _table:
            return None
        if isinstance(args[1], types.Integer):
            return signature(types.none, _table, types.intp, _lanes if args[2] == _lanes else _float)
        return signature(types.none, _table, _position, _float)


def _get(context, builder, signature, arguments):  # noqa: ARG001
    start, place = arguments
    if signature.args[1] == types.intp:
        at = builder.bitcast(_row(builder, start, place), ir.PointerType(_VECTOR))
        return builder.load(at, align=8)
    return builder.load(_row(builder, start, *cgutils.unpack_tuple(builder, place)))


def _set(context, builder, signature, arguments):
    start, place, value = arguments
    if signature.args[1] == types.intp:
        at = builder.bitcast(_row(builder, start, place), ir.PointerType(_VECTOR))
        builder.store(_wide(builder, value), at, align=8)
    else:
        builder.store(value, _row(builder, start, *cgutils.unpack_tuple(builder, place)))
    return context.get_dummy_value()


for _place in (types.intp, _position):
    lower_builtin(operator.getitem, _table, _place)(_get)
    lower_builtin(operator.setitem, _table, _place, _float)(_set)
lower_builtin(operator.setitem, _table, types.intp, _lanes)(_set)


def zeros(*shape: int) -> FloatArray:
    """Zeros, (..., numbers of a table), whose rows of lanes lie in one line of the cache each."""
    size = math.prod(shape)
    memory = np.zeros(size + LANES)
    skip = (-memory.ctypes.data // memory.itemsize) % (_ALIGNED // memory.itemsize)
    return memory[skip : skip + size].reshape(shape)
