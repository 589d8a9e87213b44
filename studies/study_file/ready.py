"""The catalog: studies that come with the toolkit."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ldctoolkit.errors import UnknownNameError, nearest
from studies.study_file.spec import Study

if TYPE_CHECKING:
    from studies.study_file.spec import Study


_LIST: Final = re.compile(r"\[\n((?:    [^\[\]{}\n\"']*,\n)+)\]|\[\n    (\"[^\"\\\n]*\"),\n\]")
"""A list of numbers, or of one text, a line each."""

_WIDTH: Final = 100


def toml_text(study: Study) -> str:
    """The study with every default written out."""
    import tomli_w

    return _LIST.sub(_on_one_line, tomli_w.dumps(_without_none(study.content())))


def _on_one_line(found: re.Match[str]) -> str:
    line = f"[{found[2] or ' '.join(found[1].split()).removesuffix(',')}]"
    return line if len(line) <= _WIDTH else found[0]


def _without_none(value: Any) -> Any:
    """TOML has no null: what is not set is left out, and the open end of a range is infinite."""
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, list):
        return [(-math.inf, math.inf)[bool(i)] if item is None else _without_none(item) for i, item in enumerate(value)]
    return value


CATALOG: Final = Path(__file__).parent.parent / "catalog"


def catalog_names() -> tuple[str, ...]:
    """Names of the studies in the catalog, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_study(name_or_path: str | Path) -> Study:
    """A study of the catalog by its name, or any other by the path of its TOML file."""
    path = Path(name_or_path)
    if str(name_or_path) in catalog_names():
        return Study.from_toml(CATALOG / f"{name_or_path}.toml")
    if path.suffix == ".toml" or path.exists():
        return Study.from_toml(path)
    raise UnknownNameError(
        f"study {str(name_or_path)!r}: neither a file nor in the catalog; {nearest(str(name_or_path), catalog_names())}"
    )
