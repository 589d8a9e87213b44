"""Work that a worker runs only if it has the packages of whoever sent it."""

from __future__ import annotations

import functools
import importlib.metadata
import pickle
from typing import Any, Final

from ldctoolkit.errors import InputError
from studies.running.worker import run_task

SAME_VERSIONS: Final = ("ldctoolkit", "numpy", "scipy", "numba")
"""Packages whose versions decide a number's last bits: they must be the same here and on every worker."""

Versions = tuple[tuple[str, str], ...]
"""Names of packages and their versions; ``"not installed"`` where there is none."""


@functools.cache
def versions(packages: tuple[str, ...] = SAME_VERSIONS) -> Versions:
    """What this process has of some packages."""
    return tuple((name, _version(name)) for name in packages)


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def check(sender: Versions, worker: Versions, named: str) -> None:
    """Compare two processes."""
    there = dict(worker)
    for name, version in sender:
        if there.get(name) != version:
            raise InputError(
                f"dask: {named} has {name} {there.get(name)}, the process that sends the work {version}; allowed: the "
                "same version everywhere, or numbers would depend on where they were computed"
            )


def run_checked(sender: Versions, task: bytes) -> Any:
    """Run a pickled piece of work in this process."""
    check(sender, versions(tuple(name for name, _ in sender)), "a worker")
    return run_task(pickle.loads(task))
