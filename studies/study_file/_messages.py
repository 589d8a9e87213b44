"""Turns what pydantic found wrong with a study into one message: file, key path, value, what is allowed."""

from __future__ import annotations

from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from ldctoolkit.errors import StudyError, nearest

_ALLOWED = {
    "model_type": "a table of keys",
    "dict_type": "a table of keys",
    "is_instance_of": "a table of keys",
    "dataclass_type": "a table of keys",
    "dataclass_exact_type": "a table of keys",
    "tuple_type": "a list (of tables: write [[...]] with two brackets)",
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "text",
}


def study_error(error: ValidationError, content: Any, source: str, model: type[BaseModel]) -> StudyError:
    """The first problem as a message; the number of others behind it."""
    problems = error.errors(include_url=False)
    # a wrong key often causes a missing one; the key that was written is what the author can look up
    problems.sort(key=lambda p: p["type"] == "missing")
    text = _message(problems[0], content, model)
    others = len(problems) - 1
    more = f" (and {others} more problem{'s' if others > 1 else ''} in this study)" if others else ""
    return StudyError(f"{source}: {text}{more}")


def _message(problem: Any, content: Any, model: type[BaseModel]) -> str:
    location = list(problem["loc"])
    if problem["type"] == "study":
        path = _path([*location, *([problem["ctx"]["path"]] if problem["ctx"]["path"] else [])])
        return f"{path}: {problem['ctx']['message']}" if path else str(problem["ctx"]["message"])
    if problem["type"] == "extra_forbidden":
        keys = _keys(model, location[:-1])
        return f"{_path(location)}: no such key; {nearest(str(location[-1]), keys)}"
    if problem["type"] == "missing":
        return f"{_path(location)}: missing, and has no default"
    value = _look_up(content, location)
    if location and isinstance(location[-1], int) and not isinstance(_look_up(content, location[:-1]), list | tuple):
        location.pop()  # a scalar was written where a list is allowed too
    if problem["type"] == "literal_error":
        allowed = [word.strip(" '") for word in problem["ctx"]["expected"].replace(" or ", ",").split(",")]
        return f"{_path(location)}: {value!r}; {nearest(str(value), allowed)}"
    told = problem["msg"].removeprefix("Input should be ")
    return f"{_path(location)}: {value!r}; allowed: {_ALLOWED.get(problem['type'], told)}"


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


def _keys(model: type[BaseModel], location: list[Any]) -> list[str]:
    """The keys allowed at a place of the study."""
    for part in location:
        if isinstance(part, str) and part in model.model_fields:
            annotation = model.model_fields[part].annotation
            inner = next((t for t in (annotation, *get_args(annotation)) if _is_model(t)), None)
            model = inner if inner is not None else model
    return list(model.model_fields)


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)
