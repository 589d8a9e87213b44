"""The version of this code, and of installed packages."""

import functools
import importlib.metadata
from typing import Final

__version__ = "1.0.0"  # as in pyproject.toml; metadata of an editable installation may be older than its code

DECISIVE: Final = ("ldctoolkit", "numpy", "scipy", "numba", "casadi", "daqp", "osqp", "qpsolvers", "control")
"""Packages whose versions decide a number's last bits: the same on every worker, and wherever a study is resumed."""

RECORDED: Final = (*DECISIVE, "polars", "pydantic", "loky")
"""Packages whose versions are recorded with a study."""

Versions = tuple[tuple[str, str], ...]  # names of packages and their versions; `"not installed"` where there is none


@functools.cache
def versions(packages: tuple[str, ...] = DECISIVE) -> Versions:
    """Versions of packages as this process has them installed."""
    return tuple((name, _version(name)) for name in packages)


def _version(name: str) -> str:
    try:
        return __version__ if name == "ldctoolkit" else importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


@functools.cache
def entry_points(group: str) -> dict[str, importlib.metadata.EntryPoint]:
    """Entry points of a group, by name, in all installed packages."""
    return {point.name: point for point in importlib.metadata.entry_points(group=group)}
