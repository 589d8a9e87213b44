"""From a CasADi function to the source text of a compiled function on scalars.

CasADi's own way to fast code goes through a C compiler, which a user's machine may not have. An SX function is a list
of scalar operations, so a line of Python for each of them is all that numba needs.
"""

from __future__ import annotations

import keyword
import math
from typing import Any, Final

from ldctoolkit.errors import InputError

TEMPLATES: Final = {
    "OP_ASSIGN": "{0}",
    "OP_ADD": "{0} + {1}",
    "OP_SUB": "{0} - {1}",
    "OP_MUL": "{0} * {1}",
    "OP_DIV": "{0} / {1}",
    "OP_NEG": "-{0}",
    "OP_SQ": "{0} * {0}",
    "OP_TWICE": "2.0 * {0}",
    "OP_INV": "1.0 / {0}",
    "OP_POW": "{0} ** {1}",
    "OP_CONSTPOW": "{0} ** {1}",
    "OP_ATAN2": "math.atan2({0}, {1})",
    "OP_FABS": "abs({0})",
} | {
    f"OP_{name.upper()}": f"math.{name}({{0}})"
    for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh")
}
"""Python of each operation, by CasADi's name; operands are names or numbers, never expressions."""


def numba_function(function: Any, name: str, docstring: str) -> str:
    """Source of a straight-line numba function that computes what a CasADi SX function computes.

    Every operation is one line, in CasADi's order, and every line gives a new name: CasADi's work slots are used again
    and again, a name never. The source needs ``import math`` and ``import numba``.

    Parameters
    ----------
    function : casadi.Function
        Made of SX expressions; inputs and outputs dense.
    name : str
        Name of the new function.
    docstring : str
        Its docstring, without the quotes; lines as they should stand in the file, indented by four spaces.

    Returns
    -------
    str
        ``def name(...)`` with its decorator. One float argument for each scalar input, in CasADi's order; an input x of
        n > 1 entries gives ``x_0`` to ``x_{n-1}``, column by column. It returns the tuple of all outputs' entries.

    Raises
    ------
    InputError
        For a function not made of SX expressions, an operation without a translation, an input or output that is not
        dense, or a name that Python cannot use.

    Examples
    --------
    >>> import casadi
    >>> x = casadi.SX.sym("x", 2)
    >>> f = casadi.Function("f", [x], [casadi.sin(x[0]) * x[1]], ["x"], ["y"])
    >>> for line in numba_function(f, "f", "Product.").splitlines()[-3:]:
    ...     print(line.strip())
    w0 = math.sin(x_0)
    w1 = w0 * x_1
    return (w1,)
    """
    if not function.is_a("SXFunction"):
        raise InputError(
            f"function: {function.name()!r} is a {function.class_name()}; allowed: a function of SX symbols"
        )
    arguments = _arguments(function)
    flat = [argument for group in arguments for argument in group]
    for used in (name, *flat):
        if keyword.iskeyword(used) or not used.isidentifier() or used in ("math", "numba", "abs"):
            raise InputError(f"name: {used!r}; allowed: a Python name other than 'math', 'numba', 'abs'")
    lines, results = _body(function, arguments, _prefix([name, *flat]))
    returned = ", ".join(results) + ("," if len(results) == 1 else "")
    return "\n".join(
        [
            '@numba.njit(error_model="numpy")',
            f"def {name}(",
            *(f"    {argument}: float," for argument in flat),
            f") -> tuple[{', '.join(['float'] * len(results))}]:",
            f'    """{docstring}"""',
            *(f"    {line}" for line in lines),
            f"    return ({returned})" if len(results) == 1 else f"    return {returned}",
            "",
        ]
    )


def _arguments(function: Any) -> list[list[str]]:
    """Names of the scalars of each input."""
    for kind, names, sparsity in (
        ("input", function.name_in(), function.sparsity_in),
        ("output", function.name_out(), function.sparsity_out),
    ):
        for i, each in enumerate(names):
            if not sparsity(i).is_dense() or sparsity(i).nnz() == 0:
                raise InputError(f"{kind} {each!r}: {sparsity(i).dim(True)}; allowed: dense, at least one entry")
    sizes = [function.nnz_in(i) for i in range(function.n_in())]
    return [
        [each] if size == 1 else [f"{each}_{j}" for j in range(size)]
        for each, size in zip(function.name_in(), sizes, strict=True)
    ]


def _prefix(names: list[str]) -> str:
    """Start of the new names that no given name has."""
    prefix = "w"
    while any(name.startswith(prefix) for name in names):
        prefix += "_"
    return prefix


def _body(function: Any, arguments: list[list[str]], prefix: str) -> tuple[list[str], list[str]]:
    """Lines of the function, and what it returns."""
    import casadi

    codes = {getattr(casadi, op): op for op in dir(casadi) if op.startswith("OP_")}
    slots: dict[int, str] = {}  # what a work slot holds at the moment
    results: dict[tuple[int, int], str] = {}
    lines: list[str] = []
    for k in range(function.n_instructions()):
        op = codes[function.instruction_id(k)]
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if op == "OP_INPUT":
            slots[given[0]] = arguments[taken[0]][taken[1]]
        elif op == "OP_CONST":
            slots[given[0]] = _literal(function.instruction_constant(k))
        elif op == "OP_OUTPUT":
            results[given[0], given[1]] = slots[taken[0]]
        elif op in TEMPLATES:
            fresh = f"{prefix}{len(lines)}"
            lines.append(f"{fresh} = {TEMPLATES[op].format(*(slots[slot] for slot in taken))}")
            slots[given[0]] = fresh
        else:
            raise InputError(f"function: {function.name()!r} uses {op}; allowed: {', '.join(sorted(TEMPLATES))}")
    return lines, [results[key] for key in sorted(results)]


def _literal(value: float) -> str:
    """A number that can stand as an operand."""
    if not math.isfinite(value):
        raise InputError(f"function: the constant {value!r}; allowed: finite numbers")
    return repr(float(value)) if math.copysign(1.0, value) > 0 else f"({float(value)!r})"
