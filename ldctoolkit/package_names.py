"""``ldctoolkit.controllers`` and ``ldctoolkit.studies``, whose short names ``controllers`` and ``studies`` stay usable.

Both folders stand beside this package. Their modules exist once, under the long name; the short one is an alias of the
same modules, and only where a user has no folder of that name: nothing in the toolkit imports by it.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Final

from ldctoolkit.surroundings import guard_caches

_ROOT: Final = Path(__file__).resolve().parent.parent
_PACKAGES: Final = ("controllers", "studies")

_by_name = " -m ldctoolkit" in " ".join(sys.orig_argv) and not sys.flags.safe_path
if _by_name and Path(sys.path[0]) == Path.cwd() != _ROOT:
    del sys.path[0]  # `python -m ldctoolkit` looks for modules in the working directory first, which `ldc` does not


class _Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        first, _, rest = name.partition(".")
        guard_caches()  # whatever is imported behind Numba's caches
        if first == "ldctoolkit" and rest in _PACKAGES:
            folder = _ROOT / rest
            return importlib.util.spec_from_file_location(
                name, folder / "__init__.py", submodule_search_locations=[str(folder)]
            )
        if first not in _PACKAGES:
            return None
        if rest:
            ours = sys.modules[first] is sys.modules.get(f"ldctoolkit.{first}")
        else:
            found = importlib.machinery.PathFinder.find_spec(name, path, target)
            ours = found is not None and found.origin == str(_ROOT / first / "__init__.py")
        return importlib.machinery.ModuleSpec(name, self) if ours else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        module = importlib.import_module(f"ldctoolkit.{spec.name}")
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state  # the import system put the alias's in its place


def install() -> None:
    """Once, by ``ldctoolkit``. A package that is just being imported by its short name is replaced by the long one."""
    sys.meta_path.insert(0, _Finder())
    guard_caches()
    for name in _PACKAGES:
        if name in sys.modules and getattr(sys.modules[name], "__file__", None) == str(_ROOT / name / "__init__.py"):
            sys.modules[name] = importlib.import_module(f"ldctoolkit.{name}")
