"""The catalog: studies that come with the toolkit."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from ldctoolkit.errors import UnknownNameError, nearest
from studies.study_file.spec import Study

CATALOG: Final = Path(__file__).parent.parent / "catalog"


def catalog_names() -> tuple[str, ...]:
    """Names of the studies in the catalog, sorted."""
    return tuple(sorted(path.stem for path in CATALOG.glob("*.toml")))


def load_study(name_or_path: str | Path) -> Study:
    """A study of the catalog by its name, or any other by the path of its TOML file.

    Raises
    ------
    UnknownNameError
        If it is neither; the message lists the catalog.
    StudyError
        If the file is wrong.

    Examples
    --------
    >>> load_study("paper").scenarios.left
    200
    """
    path = Path(name_or_path)
    if str(name_or_path) in catalog_names():
        return Study.from_toml(CATALOG / f"{name_or_path}.toml")
    if path.suffix == ".toml" or path.exists():
        return Study.from_toml(path)
    raise UnknownNameError(
        f"study {str(name_or_path)!r}: neither a file nor in the catalog; {nearest(str(name_or_path), catalog_names())}"
    )
