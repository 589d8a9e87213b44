"""Checks of what files hold: one strict base for their tables, and messages that name the key path."""

from __future__ import annotations

import dataclasses
from typing import Any, Final, get_args, get_type_hints

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from ldctoolkit.errors import nearest

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


def fail(path: str, message: str) -> PydanticCustomError:
    """What a validator raises: the key path below the validated value, and what is wrong."""
    return PydanticCustomError("checked", "{message}", {"path": path, "message": message})


def first_problem(error: ValidationError, content: Any, model: type[BaseModel], whole: str) -> str:
    """The first problem of what was read, as a message; behind it the number of others in the `whole`."""
    problems = error.errors(include_url=False)
    # a wrong key often causes a missing one; the key that was written is what the author can look up
    problems.sort(key=lambda p: p["type"] == "missing")
    others = len(problems) - 1
    more = f" (and {others} more problem{'s' if others > 1 else ''} in this {whole})" if others else ""
    return f"{_message(problems[0], content, model)}{more}"


def _message(problem: Any, content: Any, model: type[BaseModel]) -> str:
    location = list(problem["loc"])
    if problem["type"] == "checked":
        path = _path([*location, *([problem["ctx"]["path"]] if problem["ctx"]["path"] else [])])
        return f"{path}: {problem['ctx']['message']}" if path else str(problem["ctx"]["message"])
    if problem["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        keys = _keys(model, location[:-1])
        return f"{_path(location)}: no such key; {nearest(str(location[-1]), keys)}"
    if problem["type"] == "missing":
        return f"{_path(location)}: missing, and has no default"
    value = _look_up(content, location)
    if location and isinstance(location[-1], int) and not isinstance(_look_up(content, location[:-1]), list | tuple):
        location.pop()  # a scalar was written where a list is allowed too
    if problem["type"] == "literal_error":
        options = [option.strip(" '") for option in problem["ctx"]["expected"].replace(" or ", ",").split(",")]
        return f"{_path(location)}: {short(value)}; {nearest(str(value), options)}"
    allowed = _ALLOWED.get(problem["type"], problem["msg"].removeprefix("Input should be "))
    if allowed == "a list" and isinstance(value, dict):
        allowed = "a list of tables: write [[...]] with two brackets"
    return f"{_path(location)}: {short(value)}; allowed: {allowed}"


def as_tuples(value: Any) -> Any:
    """TOML arrays as tuples: strict validation takes nothing else for a tuple field; NumPy's numbers as Python's."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict):
        return {key: as_tuples(item) for key, item in value.items()}
    return tuple(as_tuples(item) for item in value) if isinstance(value, list | tuple) else value


def short(value: object) -> str:
    """A value for a message."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _path(location: list[Any]) -> str:
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _look_up(content: Any, location: list[Any]) -> Any:
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
