"""The text of a study file with a comment at every key: meaning, unit, default, allowed values."""

import dataclasses
import itertools
import json
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

from pydantic import TypeAdapter

from ldctoolkit.checked_files import read_toml
from ldctoolkit.declared import Gain, declarations
from ldctoolkit.errors import StudyError
from ldctoolkit.registry import controller_class
from ldctoolkit.setup import Setup

from .design_space import rounded
from .study_file import SimulationSettings, Study

Content = dict[str, Any]

_EXAMPLES: Final = {
    "model": "my_car.py:Car",
    "delta_max": 0.5,
    "rate_max": 0.33,
    "left": 500,
    "right": 500,
}  # TOML has no null

_ALWAYS: Final = ("model", "left", "right")  # set always: their defaults depend on whether a table is replayed


def study_text(study: Study, about: Sequence[str] = ()) -> str:
    """The study file, a comment at every key, of a study whose tables name one law each, without a sample."""
    content = study.content()
    usual = Study.from_dict({"name": "x", "design": [{"law": "none"}]}).content() | {"name": None}
    for table in (content, usual):
        table["vehicle"].setdefault("model", None)
    designs = content.pop("design")
    keys = _table("", content, usual, Study, read_toml(Path(__file__).with_name("study_keys.toml"), StudyError))
    note = (
        "# Commented out: keys at their defaults (an example where the default is none), gains with a range to sweep.\n"
        "# SI units, left is positive."
    )
    return "\n".join([*about, note, "", *keys, *(line for block in designs for line in _design(block)), ""])


def _table(path: str, table: Content, usual: Content, owner: type, about: Content, mark: str = "") -> Iterator[str]:
    """The keys of a table, then the tables in it; one that is absent is commented out."""
    tables = {key: texts for key, texts in about.items() if isinstance(texts, dict)}
    for key, value in table.items():
        if key not in tables:
            unit, allowed = _declared(owner, key)
            default = "" if path + key == "name" else f"default {_toml(usual.get(key))}"
            shown = _EXAMPLES[key] if value is None else value
            off = mark or "# " * (value is None or (value == usual.get(key) and key not in _ALWAYS))
            yield _line(key, _toml(shown), [unit + about[key], allowed, default], off)
    for key, texts in tables.items():
        hint = get_type_hints(owner)[key]
        kind = (get_args(hint) or (hint,))[0]  # of "KalmanFilter | None" the first
        every = TypeAdapter(kind).dump_python(kind(), mode="json")
        off = mark or "# " * (table[key] is None)
        more = "; for a key of it, uncomment this line too" if off else ""
        yield from ("", f"{off}[{path}{key}]  # {texts['about']}{more}")
        yield from _table(f"{path}{key}.", table[key] or every, every, kind, texts, off)


def _declared(owner: Any, key: str) -> tuple[str, str]:
    """The unit of a key, and what is allowed."""
    kind = Setup if owner is SimulationSettings else owner
    if dataclasses.is_dataclass(kind) and key in (declared := declarations(kind)):
        return _unit(declared[key].unit), declared[key].in_files.limits
    if not hasattr(owner, "model_fields"):
        return "", ""
    info = owner.model_fields[key]
    signs = {"gt": ">", "ge": ">=", "le": "<=", "lt": "<"}
    bounds = [(sign, getattr(limit, name, None)) for limit in info.metadata for name, sign in signs.items()]
    limits = " and ".join(f"{sign} {end:g}" for sign, end in bounds if end is not None and abs(end) < 1e18)
    return "", " or ".join(_choices(info.annotation)) or limits


def _choices(annotation: Any) -> tuple[str, ...]:
    args = get_args(annotation)
    return args if get_origin(annotation) is Literal else tuple(itertools.chain(*map(_choices, args)))


def _unit(unit: str) -> str:
    return "" if unit == "1" else f"[{unit}] "


def _toml(value: Any) -> str:
    return "none" if value is None else json.dumps(value, ensure_ascii=False)


def _line(key: str, value: str, notes: Iterable[str], mark: str = "") -> str:
    return f"{f'{mark}{key} = {value}':<40}  # {'; '.join(filter(None, notes))}"


def _design(block: Content) -> Iterator[str]:
    """A ``[[design]]`` table: the gains that it sets, and every other one of the law with a range to sweep."""
    kind, gains = controller_class(block["law"]), block["gains"]
    yield from ("", f"[[design]]  # {kind.title}")
    yield _line("law", _toml(block["law"]), ["control law: ldc controllers lists all"])
    notes = [
        "[m] trigger thresholds: how far beyond the line control starts, below 0 before it",
        ">= -10",
        "default 0.2",
    ]
    yield _line("y_s", _toml(block["y_s"]), notes)
    if kind.gains():
        yield "[design.gains]  # a value, a list, or a range: { from, to, count, scale }; together they make a grid"
    for gain in kind.gains():
        notes = [_unit(gain.unit) + gain.description, gain.limits, f"default {_toml(gain.default)}"]
        swept = gain.name not in gains
        yield _line(gain.name, _sweep(gain) if swept else _toml(gains[gain.name]), notes, "# " * swept)


def _sweep(gain: Gain) -> str:
    """A range around the default, within the bounds; the default itself where there is no range around it."""
    default = gain.default
    if isinstance(default, bool | str) or not default:
        return _toml(default)
    factor = 10.0 if gain.scale == "log" else 2.0
    ends = (min(max(rounded(end), gain.lower), gain.upper) for end in (default / factor, default * factor))
    first, last = (round(end) if isinstance(default, int) else end for end in ends)
    scale = ', scale = "log"' if gain.scale == "log" else ""
    return f"{{ from = {first}, to = {last}, count = 5{scale} }}"
