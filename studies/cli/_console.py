"""What the commands share: arguments, output files, tables and progress bars."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ldctoolkit.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from ldctoolkit.gains import GainValue

_WIDTH = 160
"""Columns where stdout is no terminal: a file or a log has no width of its own."""


class Subparsers(Protocol):
    """What `argparse.ArgumentParser.add_subparsers` returns."""

    def add_parser(self, name: str, *, help: str, description: str) -> argparse.ArgumentParser:
        """Add a command."""


def console() -> Console:
    """Standard output for tables."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=_WIDTH)


def new_table(title: str, headings: Sequence[str], left: Container[int] = (0,)) -> Table:
    """A table whose columns `left` are words and all others numbers; neither title nor headings are markup."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title, style="table.title"), title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="left" if i in left else "right")
    return table


def add_row(table: Table, cells: Iterable[str], style: str | None = None) -> None:
    """One row more; cells are no markup."""
    from rich.text import Text

    table.add_row(*map(Text, cells), style=style)


def say(out: Console, *lines: str) -> None:
    """Lines that stay as they are: whole, and no markup."""
    for line in lines:
        out.print(line, markup=False, emoji=False, highlight=False, soft_wrap=True)


def gain_text(value: GainValue) -> str:
    """A gain in a table."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def warn(message: str) -> None:
    """One line on stderr that does not end the command."""
    print(f"ldc: warning: {message}", file=sys.stderr)


def output_file(path: str, *suffixes: str, option: str = "-o") -> Path:
    """The path that an option gave, checked before any long work starts.

    Raises
    ------
    InputError
        For another suffix, a folder, or a folder that does not exist or that nothing can be written into, or a name
        that the system refuses.
    """
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{option} {path}: the name must end in {' or '.join(suffixes)}")
    try:
        if target.is_dir():
            raise InputError(f"{option} {path}: is a folder")
        if not target.parent.is_dir():
            raise InputError(f"{option} {path}: the folder {target.parent} does not exist")
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be used: {error.strerror or error}") from None
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{option} {path}: no permission to write into the folder {target.parent}")
    return target


def whole_number(text: str) -> int:
    """A whole number >= 0 on the command line."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number >= 0")
    return int(text)


def positive_number(text: str) -> int:
    """A whole number >= 1 on the command line."""
    if whole_number(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number >= 1")
    return int(text)


def number(text: str) -> float:
    """A finite number on the command line."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a number")
    return value


@contextlib.contextmanager
def progress_bar(label: str) -> Iterator[Callable[[int, int], None] | None]:
    """A bar on stderr, updated as ``f(done, total)``; None where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)
