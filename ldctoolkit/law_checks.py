"""Checks of what a controller hands over, before its numbers are used: the design, its law, the result of each step.

A type checker finds these mistakes too; here they end in one message that names the controller and what is allowed.
"""

import dataclasses
from typing import Any, TypeGuard, get_type_hints

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, unmasked
from ldctoolkit.control import (
    Controller,
    EventStatus,
    Law,
    LinearLaw,
    RecordedPath,
    SolverCalls,
    StatusArray,
    SteeringLaw,
    check_class,
)
from ldctoolkit.errors import InputError
from ldctoolkit.errors import raised as raised

_LONGEST_AGE = 10.0  # [s] of what is seen: a law may ask for the lane where it was seen
_STATUS_OF_A_STEP = (EventStatus.OK, EventStatus.SOLVER_FAILED, EventStatus.BEYOND_DELTA_MAX)


def declared_law(controller: type[Controller]) -> type | None:
    """The kind of law that the annotation of its `prepare` declares; None where there is none."""
    try:
        law = get_type_hints(controller.prepare).get("return")
    except Exception:  # an annotation may be third-party code
        return None
    return law if isinstance(law, type) and issubclass(law, LinearLaw | RecordedPath | SteeringLaw) else None


def check_controller(controller: object) -> Controller:
    """Return the design, with its class checked; its gains were when it was made."""
    if isinstance(controller, Controller):
        check_class(type(controller))
        return controller
    example = "LQR()"
    if isinstance(controller, type) and issubclass(controller, Controller):
        example = f"{controller.__name__}()"
    elif isinstance(controller, str):
        example = f"controller_class({controller!r})()"
    raise InputError("controller", _described(controller), allowed=f"a controller instance, e.g. {example}")


def check_law(law: object, n: int, name: str) -> Law:
    """Return the law of n scenarios that ``prepare`` gave, checked; gains that are not finite pass, and are counted."""
    where = f"controller {name!r}"
    if isinstance(law, RecordedPath):
        return law
    if not isinstance(law, LinearLaw | SteeringLaw):
        allowed = "a LinearLaw, a RecordedPath, or an instance of a subclass of SteeringLaw"
        raise InputError(f"{where}: prepare", f"returned {_described(law)}", allowed=allowed)
    times: Any = law.preview_times
    if callable(times):
        raise InputError(f"{where}: preview_times", "a method", hint="write @property above it")
    _check_array(times, f"{where}: preview_times", ("p",))
    earliest = 0.0 if isinstance(law, LinearLaw) else -_LONGEST_AGE
    wrong = ~(np.isfinite(times) & (times >= earliest))
    if wrong.any():
        allowed = f"finite times >= {earliest:g} [s]"
        raise InputError(f"{where}: preview_times", value=float(times[wrong][0]), allowed=allowed)
    if isinstance(law, LinearLaw):
        shapes: dict[str, tuple[int | str, ...]] = {
            "F": (n, 4), "G_yaw_rate": (n, times.size), "G_heading": (n, times.size), "f_u": (n,),
            "f_i": (n,), "f_past": (n, "q"), "f_wheel": (n,),
        }  # fmt: skip
        for field in dataclasses.fields(law):
            value = getattr(law, field.name)
            if field.name in shapes and not (value is None and field.default is None):
                _check_array(value, f"{where}: {field.name}", shapes[field.name])
        if not isinstance(law.conditioned, bool):
            raise InputError(f"{where}: conditioned", _described(law.conditioned), allowed="True or False")
    return law


def check_step(result: object, n: int, name: str) -> tuple[FloatArray, Any, StatusArray]:
    """Return what ``SteeringLaw.step`` gave for n scenarios, checked; commands that are not finite pass, too."""
    where = f"controller {name!r}: step"
    if not (isinstance(result, tuple) and len(result) == 3):
        raise InputError(where, f"returned {_described(result)}", allowed="a tuple (delta, state, status)")
    delta, status = result[0], result[2]
    if not (_is_plain(delta, np.float64, n) and _is_plain(status, np.int8, n)):  # this comes once a sample
        delta, status = _reals(delta, f"{where}: delta"), _reals(status, f"{where}: status")
        for field, array in (("delta", delta), ("status", status)):
            _check_array(array, f"{where}: {field}", (n,))
    if status.any() and not np.isin(status, _STATUS_OF_A_STEP).all():
        allowed = ", ".join(f"EventStatus.{code.name} ({code:d})" for code in _STATUS_OF_A_STEP)
        unknown = status[~np.isin(status, _STATUS_OF_A_STEP)][0]
        raise InputError(f"{where}: status", value=unknown, allowed=allowed)
    return np.array(delta, dtype=np.float64), result[1], status.astype(np.int8)


def check_taken(result: object, n: int, name: str, times: FloatArray) -> tuple[SteeringLaw, Any] | None:
    """Return what ``SteeringLaw.take`` gave for n scenarios that go on, with its types checked."""
    if result is None:
        return None
    where = f"controller {name!r}: take"
    if not (isinstance(result, tuple) and len(result) == 2 and isinstance(result[0], SteeringLaw)):
        raise InputError(where, f"returned {_described(result)}", allowed="a tuple (law, state), or None")
    check_law(result[0], n, name)
    if not np.array_equal(result[0].preview_times, times):
        raise InputError(where, "changed preview_times", allowed="those of the law before")
    return result[0], result[1]


def check_calls(calls: object, n: int, name: str) -> None:
    """Raise if what ``SteeringLaw.solver_calls`` gave for n scenarios is not what the interface promises."""
    where = f"controller {name!r}: solver_calls"
    if not isinstance(calls, SolverCalls):
        raise InputError(where, f"returned {_described(calls)}", allowed="SolverCalls or None")
    _check_array(calls.position, f"{where}: position", (np.size(calls.position),))
    for field in ("status", "iterations", "primal_residual", "dual_residual"):
        _check_array(getattr(calls, field), f"{where}: {field}", (calls.position.size,))
    allowed = f"whole numbers 0 to {n - 1}"
    if calls.position.dtype.kind not in "iu":
        raise InputError(f"{where}: position", _described(calls.position), allowed=allowed)
    outside = (calls.position < 0) | (calls.position >= n)
    if outside.any():
        raise InputError(f"{where}: position", value=calls.position[outside][0], allowed=allowed)


def _is_plain(value: object, kind: type, n: int) -> TypeGuard[npt.NDArray[Any]]:
    """Whether a value is an array of NumPy's own of that kind, (n,)."""
    return type(value) is np.ndarray and value.dtype == kind and value.shape == (n,)


def _check_array(value: Any, where: str, shape: tuple[int | str, ...]) -> None:
    """Raise if the value is no array of real numbers of that shape; a letter stands for any length."""
    if type(value) is np.ndarray and value.shape == shape and value.dtype.kind in "iuf":
        return  # most are, at every sample
    allowed = f"an array of shape ({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
    if not isinstance(value, np.ndarray):
        raise InputError(where, _described(value), allowed=allowed)
    same = (isinstance(length, str) or length == actual for length, actual in zip(shape, value.shape, strict=False))
    if value.ndim != len(shape) or not all(same):
        raise InputError(where, f"shape {value.shape}", allowed=allowed)
    if np.ma.is_masked(value):
        raise InputError(where, "masked entries", allowed="none")
    _reals(value, where)


def _reals(value: Any, where: str) -> npt.NDArray[Any]:
    """The value as an array of real numbers of whatever kind."""
    try:
        array = np.asarray(unmasked(value))
    except ValueError:  # rows of different lengths
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        raise InputError(where, _described(value), allowed="an array of real numbers")
    return array


def _described(value: object) -> str:
    """A short description of any object, for an error message."""
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and dtype {value.dtype}"
    if value is None or isinstance(value, str | int | float):
        return repr(value)
    return f"a tuple of {len(value)}" if isinstance(value, tuple) else f"an object of type {type(value).__name__}"
