"""Checks of what files hold: one strict base for their tables, and errors at the key path.

A validator raises `InputError` at a path below the validated value; `first_problem` makes one error of what pydantic
collects.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ldctoolkit.errors import InputError, LdcError

_ALLOWED: Final = {
    "model_type": "a table of keys",
    "dict_type": "a table of keys",
    "is_instance_of": "a table of keys",
    "dataclass_type": "a table of keys",
    "dataclass_exact_type": "a table of keys",
    "tuple_type": "a list",
    "too_short": "one value or more",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "text",
    "bool_type": "true or false",
}


class Part(BaseModel):
    """A table of a file: no unknown keys, no silent conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def first_problem(error: ValidationError, content: Any, model: type[BaseModel], whole: str) -> InputError:
    """The first problem of what was read, at its key path; its hint counts the others in the `whole`."""
    problems = error.errors(include_url=False)
    # a wrong key often causes a missing one; the key that was written is what the author can look up
    problems.sort(key=lambda problem: problem["type"] == "missing")
    first, further = _problem(problems[0], content, model), len(problems) - 1
    return first.hinted(f"{further} more problem{'s' if further > 1 else ''} in this {whole}") if further else first


def _problem(problem: Any, content: Any, model: type[BaseModel]) -> InputError:
    location, kind = list(problem["loc"]), problem["type"]
    if isinstance(raised := problem.get("ctx", {}).get("error"), LdcError):
        return InputError.of(raised).within(_path(location))
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return InputError(_path(location), "no such key", allowed=_keys(model, location[:-1]))
    if kind == "missing":
        return InputError(_path(location), "is missing and has no default")
    value = _look_up(content, location)
    if location and isinstance(location[-1], int) and not isinstance(_look_up(content, location[:-1]), list | tuple):
        location.pop()  # a scalar was written where a list is allowed too
    allowed: Any = _ALLOWED.get(kind, problem["msg"].removeprefix("Input should be "))
    if kind == "literal_error":
        allowed = [word.strip(" '") for word in problem["ctx"]["expected"].replace(" or ", ",").split(",")]
    elif allowed == "a list" and isinstance(value, dict):
        allowed = "a list of tables: write [[...]] with two brackets"
    return InputError(_path(location), value=value, allowed=allowed)


def as_tuples(value: Any) -> Any:
    """TOML arrays as tuples: strict validation takes nothing else for a tuple field; NumPy's numbers as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: as_tuples(item) for key, item in value.items()}
    return tuple(as_tuples(item) for item in value) if isinstance(value, list | tuple) else value


def _path(location: list[Any]) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")


def _look_up(content: Any, location: list[Any]) -> Any:
    """What stands at a location of the content; as far as it leads."""
    for part in location:
        if not isinstance(content, dict | list | tuple):
            break  # a scalar stands where a list is allowed too
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            break
    return content


def _keys(kind: Any, location: list[Any]) -> list[str]:
    """The keys allowed at a place of the file."""

    def fields(kind: Any) -> dict[str, Any]:
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            return {name: field.annotation for name, field in kind.model_fields.items()}
        return get_type_hints(kind) if isinstance(kind, type) and dataclasses.is_dataclass(kind) else {}

    for part in location:
        annotation = fields(kind).get(part)
        inner = next((t for t in (annotation, *get_args(annotation)) if fields(t)), None)
        kind = inner if inner is not None else kind
    return list(fields(kind))
