"""Text tables among the files and folders that a user names."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

DEPTH: Final = 2
"""Folders inside a folder are looked into this many levels down."""

_TABLE: Final = re.compile(r"\.(csv|txt|csv\.gz|csv\.bz2|csv\.xz|csv\.zip)$", re.IGNORECASE)


def find_tables(paths: Iterable[Path]) -> list[tuple[Path, bool]]:
    """Files named by the user, and files in named folders that may be tables; each once.

    Parameters
    ----------
    paths : iterable of Path
        Files and folders.

    Returns
    -------
    list of (Path, bool)
        Each file, and whether it was named itself; folders in the order of names.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a.csv").write_text("x")
    ...     [(path.name, named) for path, named in find_tables([Path(folder)])]
    [('a.csv', False)]
    """
    found: dict[str, tuple[Path, bool]] = {}
    for path in paths:
        named = not os.path.isdir(path)  # noqa: PTH112 - this one raises nothing, whatever the path
        inside = [path] if named else [one for one in _walk(path, DEPTH) if _TABLE.search(one.name)]
        for one in inside:
            place = place_of(one)
            known = found.get(place)
            found[place] = (known[0] if known else one, named or (known is not None and known[1]))
    return list(found.values())


def place_of(path: Path) -> str:
    """Where a file is, whatever links lead there."""
    try:
        return os.path.realpath(path)
    except ValueError:  # a NUL in the name; opening it tells
        return str(path)


def _walk(folder: Path, depth: int) -> Iterator[Path]:
    try:
        inside = sorted(folder.iterdir(), key=lambda one: one.name)
    except OSError:
        return
    for one in inside:
        if os.path.isdir(one):  # noqa: PTH112
            if depth > 0 and not one.name.startswith("."):
                yield from _walk(one, depth - 1)
        elif not one.name.startswith(".") and os.path.isfile(one):  # noqa: PTH113
            yield one


def shown_names(paths: Sequence[Path]) -> list[str]:
    """Names to tell files apart by: as few of the last folders as it takes.

    Examples
    --------
    >>> shown_names([Path("/d/april/DataLane.csv"), Path("/d/october/DataLane.csv"), Path("/d/april/DataWsu.csv")])
    ['april/DataLane.csv', 'october/DataLane.csv', 'DataWsu.csv']
    """
    whole = [path.absolute().parts for path in paths]
    names = [parts[-1] for parts in whole]
    for length in range(2, max(map(len, whole), default=1) + 1):
        count = Counter(names)
        if len(count) == len(names):
            break
        names = [
            "/".join(parts[-length:]) if count[name] > 1 else name for name, parts in zip(names, whole, strict=True)
        ]
    return names
