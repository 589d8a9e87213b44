"""The command ``ldc``, and ``python -m ldctoolkit``: makes sure that the toolkit's own packages are the ones that run.

``controllers`` and ``studies`` are general names. A folder of the user's that is called so, in the working directory or
on ``PYTHONPATH``, would be imported in their place; the installation's own root comes first when that would happen. The
command itself is found by the entry-point group ``ldctoolkit.commands``: the toolkit does not import it.
"""

import importlib
import importlib.metadata
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ldctoolkit.errors import LdcError, ShadowedPackageError
from ldctoolkit.registry import check_not_shadowed

GROUP: Final = "ldctoolkit.commands"
COMMAND: Final = "ldc"
_PACKAGES: Final = ("controllers", "studies")


def main() -> int:
    """Run the command line; the value is the exit code."""
    try:
        command = _load()
    except LdcError as error:
        print(f"{COMMAND}: error: {error}", file=sys.stderr)
        return 2
    return command()


def _load() -> Callable[[], int]:
    own_packages_first()
    point = next(iter(importlib.metadata.entry_points(group=GROUP, name=COMMAND)), None)
    if point is None:
        raise LdcError("the command is not installed (no entry point in the group ldctoolkit.commands); install again")
    package = point.value.partition(":")[0].partition(".")[0]
    try:
        command: Callable[[], int] = point.load()
    except ModuleNotFoundError as error:
        check_not_shadowed(package)
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise ShadowedPackageError(
            f"the package {package!r} of the toolkit was not found: {error}; install again"
        ) from None
    for name in _PACKAGES:
        check_not_shadowed(name)
    return command


def own_packages_first() -> None:
    """Put the installation's root first on ``sys.path`` if another package of the same name would come before it."""
    root = Path(__file__).resolve().parent.parent
    if all(_found_in(name, root) for name in _PACKAGES):
        return
    sys.path.insert(0, str(root))
    importlib.invalidate_caches()


def _found_in(package: str, root: Path) -> bool:
    try:
        spec = importlib.util.find_spec(package)
    except ValueError:  # imported already, and without a specification
        return False
    places = [] if spec is None else [Path(place).resolve() for place in spec.submodule_search_locations or ()]
    return root / package in places[:1]


if __name__ == "__main__":
    sys.exit(main())
