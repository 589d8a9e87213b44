"""The translator against CasADi's own evaluation, and the generated file against what it is generated from."""

import ast
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
import pytest

from helpers.cli import tool
from ldctoolkit.errors import InputError
from ldctoolkit.vehicle import _nonlinear_compiled

numba_function = tool("casadi_to_numba").numba_function


def translation(function: Any) -> Callable[..., tuple[float, ...]]:
    """The translated function, as Python evaluates it; the closed loop's tests take the compiled one."""
    names: dict[str, Any] = {"math": math, "numba": SimpleNamespace(njit=lambda **_: lambda python: python)}
    exec(numba_function(function, "translated", "Translated."), names)
    result: Callable[..., tuple[float, ...]] = names["translated"]
    return result


def test_every_operation_equals_casadis() -> None:
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    terms = [x + y, x - y, x * y, x / y, -x, x * x, 2 * x, 1 / x, x**y, casadi.constpow(x, 2.5), casadi.atan2(x, y)]
    terms += [casadi.fabs(x), casadi.SX(-1.5), casadi.SX(0.0), x]
    terms += [getattr(casadi, name)(x) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan")]
    terms += [getattr(casadi, name)(x) for name in ("sinh", "cosh", "tanh")]
    function = casadi.Function("terms", [x, y], terms, ["x", "y"], [f"o{i}" for i in range(len(terms))])
    codes = {getattr(casadi, op): op for op in dir(casadi) if op.startswith("OP_")}
    used = {codes[function.instruction_id(k)] for k in range(function.n_instructions())}
    # a copy is never made by SX; everything else that has a translation is here
    assert set(tool("casadi_to_numba").TEMPLATES) - used == {"OP_ASSIGN"}
    translated = translation(function)
    for a, b in ((0.3, 1.7), (0.9, -2.25), (1e-3, 40.0)):
        expected = [float(value) for value in function(a, b)]
        # two mathematical libraries: a few units in the last place
        np.testing.assert_allclose(translated(a, b), expected, rtol=2e-15)


def test_reused_work_slots_keep_no_old_value() -> None:
    x = casadi.SX.sym("x", 3)
    y = casadi.SX.sym("y")
    total = y
    for i in range(30):
        total = casadi.sin(total + x[i % 3]) * total - x[(i + 2) % 3]
    function = casadi.Function("chain", [x, y], [total, casadi.vertcat(y, total * total)], ["x", "y"], ["a", "b"])
    written = [function.instruction_output(k)[0] for k in range(function.n_instructions())]
    assert len(set(written)) < len(written) / 4  # CasADi does use its slots again
    source = numba_function(function, "chain", "Chain.")
    tree = ast.parse(source).body[0]
    assert isinstance(tree, ast.FunctionDef)
    assert [argument.arg for argument in tree.args.args] == ["x_0", "x_1", "x_2", "y"]
    names = [node.targets[0].id for node in ast.walk(tree) if isinstance(node, ast.Assign)]  # type: ignore[attr-defined]
    assert len(names) == len(set(names)) == 121
    value = translation(function)(0.3, -0.2, 0.5, 0.7)
    a, b = function([0.3, -0.2, 0.5], 0.7)
    # 30 steps, each of which may add an error of one unit in the last place
    np.testing.assert_allclose(value, [float(a), *np.array(b)[:, 0]], rtol=1e-13)


def test_an_argument_never_meets_a_name_of_the_function() -> None:
    w0, w_1 = casadi.SX.sym("w0"), casadi.SX.sym("w_1")
    function = casadi.Function("f", [w0, w_1], [casadi.sin(w_1) + w0], ["w0", "w_1"], ["y"])
    assert translation(function)(2.0, 0.5) == pytest.approx((math.sin(0.5) + 2.0,), rel=1e-15)


@pytest.mark.parametrize("name", ["lambda", "math"])
def test_a_name_that_python_cannot_use_is_refused(name: str) -> None:
    x = casadi.SX.sym("x")
    with pytest.raises(InputError, match=rf"name: '{name}'; allowed: a Python name"):
        numba_function(casadi.Function("f", [x], [2 * x], [name], ["y"]), "f", "F.")
    with pytest.raises(InputError, match=rf"name: '{name}'; allowed: a Python name"):
        numba_function(casadi.Function("f", [x], [2 * x], ["x"], ["y"]), name, "F.")


def test_the_generated_file_is_what_the_tool_makes() -> None:
    generated = Path(_nonlinear_compiled.__file__).read_text(encoding="utf-8")
    assert generated == tool("compile_nonlinear").text(), "run: python tools/compile_nonlinear.py"
