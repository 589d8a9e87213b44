"""What the commands share: arguments, output files, tables and progress bars."""

from __future__ import annotations

import argparse
import contextlib
import copy
import dataclasses
import math
import os
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import ldctoolkit.compiling as compiling
from ldctoolkit.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from ldctoolkit.departures import Plausibility


_WIDTH = 160  # columns where stdout is no terminal: a file or a log has no width of its own


class Subparsers(Protocol):
    """What `argparse.ArgumentParser.add_subparsers` returns."""

    def add_parser(self, name: str, *, help: str, description: str) -> argparse.ArgumentParser:
        """Add a command."""


def console() -> Console:
    """Standard output for tables."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=_WIDTH)


def new_table(title: str, headings: Sequence[str], left: Container[int] = (0,), *, narrow: bool = False) -> Table:
    """A table whose columns `left` are text and all others numbers; neither title nor headings are markup.

    A narrow one has no rules between its columns, however wide the terminal is.
    """
    from rich import box
    from rich.table import Table
    from rich.text import Text

    table = Table(
        title=Text(title, style="table.title"), title_justify="left", box=None if narrow else box.HEAVY_HEAD,
        padding=(0, 1, 0, 0) if narrow else (0, 1), pad_edge=not narrow,
    )  # fmt: skip
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="left" if i in left else "right")
    return table


def add_row(table: Table, cells: Iterable[str], style: str | None = None) -> None:
    """One row more; cells are no markup."""
    from rich.text import Text

    table.add_row(*map(Text, cells), style=style)


_LONGEST_WORD = 16  # columns of a narrow table that a word of text is given before it is broken


def print_table(table: Table, out: Console | None = None) -> None:
    """Print a table whose numbers are whole at any width of the terminal.

    Where it is narrow there are no rules, and headings and text break at spaces; columns that do not fit even then
    follow below, beside the text columns at the left again.
    """
    out, columns, widest, least = out or console(), table.columns, [], []
    for column in columns:
        heading, cells = str(column.header), [str(cell) for cell in column.cells]
        text = cells if column.justify == "right" else [word[:_LONGEST_WORD] for cell in cells for word in cell.split()]
        widest.append(max(len(line) for cell in (heading, *cells) for line in (cell or " ").splitlines()))
        least.append(max(map(len, (*heading.split(), *text))))
    if table.box is not None and sum(widest) + 3 * len(columns) + 1 <= out.width:
        out.print(table)
        return
    keys = next((i for i, column in enumerate(columns) if i and column.justify == "right"), len(columns))
    part, rest = copy.copy(table), list(range(keys, len(columns)))
    part.box, part.padding, part.pad_edge = None, (0, 1, 0, 0), False
    while True:
        shown = list(range(keys))
        while rest and (len(shown) == keys or sum(least[i] + 1 for i in (*shown, rest[0])) <= out.width):
            shown.append(rest.pop(0))
        widths = {i: widest[i] for i in shown}
        while sum(widths.values()) + len(shown) > out.width and any(widths[i] > least[i] for i in shown):
            widths[max(shown, key=lambda i: widths[i] - least[i])] -= 1
        part.columns = [dataclasses.replace(columns[i], _index=k, width=widths[i]) for k, i in enumerate(shown)]
        out.print(part)
        part.title = None
        if not rest:
            return


def say(out: Console, *lines: str) -> None:
    """Lines that stay as they are: whole, and no markup."""
    for line in lines:
        out.print(line, markup=False, emoji=False, highlight=False, soft_wrap=True)


def warn(message: str) -> None:
    """One line on stderr that does not end the command."""
    print(f"ldc: warning: {message}", file=sys.stderr)


def output_file(path: str, *suffixes: str, option: str = "-o") -> Path:
    """The path that an option gave, checked before any long work starts."""
    target = Path(path)
    if target.suffix.lower() not in suffixes:
        raise InputError(f"{option} {path}", f"the name must end in {' or '.join(suffixes)}")
    if target.is_dir():
        raise InputError(f"{option} {path}", "is a folder")
    if not target.parent.is_dir():
        raise InputError(f"{option} {path}", f"the folder {target.parent} does not exist")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{option} {path}", f"no permission to write into the folder {target.parent}")
    return target


def whole_number(text: str) -> int:
    """A whole number >= 0 on the command line."""
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number >= 0")
    return int(text)


def positive_number(text: str) -> int:
    """A whole number >= 1 on the command line."""
    with contextlib.suppress(argparse.ArgumentTypeError):
        if whole_number(text) >= 1:
            return int(text)
    raise argparse.ArgumentTypeError(f"{text!r}; allowed: a whole number >= 1")


def number(text: str) -> float:
    """A finite number on the command line."""
    with contextlib.suppress(ValueError):
        if math.isfinite(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"{text!r}; allowed: a number")


_live: list[Progress] = []  # what is on the screen: a phase inside another one is a line below it


@contextlib.contextmanager
def progress_bar(label: str, *, show: bool = True) -> Iterator[Callable[[int, int], None] | None]:
    """A phase of a command, as a line on stderr with a bar that ``f(done, total)`` moves; it pulses until then.

    None, and nothing on the screen, where stderr is no terminal.
    """
    if not (show and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with contextlib.ExitStack() as stack:
        # stdout stays what it is where it is a file or a pipe
        new = Progress(console=Console(stderr=True), transient=True, redirect_stdout=sys.stdout.isatty())
        bar = _live[-1] if _live else stack.enter_context(new)
        task = bar.add_task(label, total=None)
        _live.append(bar)
        stack.callback(lambda: _live.pop().remove_task(task))
        yield lambda done, total: bar.update(task, completed=done, total=total)


def moving_line(text: str) -> contextlib.AbstractContextManager[object]:
    """A phase on a terminal, one line on stderr elsewhere."""
    return progress_bar(text) if sys.stderr.isatty() else compiling.line(text)


Interval = tuple[float | None, float | None]  # lower and upper end; None is open


def named(text: str) -> tuple[str, str]:
    """``NAME=REST``."""
    name, equals, rest = text.partition("=")
    if not equals or not name or not rest:
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: NAME=...")
    return name.strip(), rest.strip()


def _number(text: str, whole: str) -> float:
    with contextlib.suppress(ValueError):
        if not math.isnan(value := float(text)):
            return value
    raise argparse.ArgumentTypeError(f"{whole!r}: {text!r} is not a number")


def interval(text: str, whole: str) -> Interval:
    """``LOW:HIGH``, an empty end is open."""
    low, colon, high = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"{whole!r}; allowed: NAME=LOW:HIGH, an empty end is open")
    return tuple(_number(end, whole) if end.strip() else None for end in (low, high))  # type: ignore[return-value]


def condition(text: str) -> tuple[str, float | Interval]:
    """``NAME=VALUE`` or ``NAME=LOW:HIGH``."""
    name, rest = named(text)
    return name, interval(rest, text) if ":" in rest else _number(rest, text)


def bound(text: str) -> tuple[str, Interval]:
    """``NAME=LOW:HIGH``, an empty end is open."""
    name, rest = named(text)
    return name, interval(rest, text)


def add_limit(parser: argparse.ArgumentParser) -> None:
    """Declare ``--limit``."""
    parser.add_argument(
        "--limit",
        type=lambda text: (named(text)[0], _number(named(text)[1], text)),
        action="append",
        metavar="NAME=VALUE",
        help="a departure beyond it is implausible: y_rate (2 m/s), y_acceleration (4 m/s^2), a_y (6 m/s^2); inf for "
        "none; repeatable",
    )


def plausibility(given: Sequence[tuple[str, float]] | None, default: Plausibility | None = None) -> Plausibility:
    """The limits of ``--limit``, the others those of the default."""
    from ldctoolkit.departures import Plausibility

    each_once("--limit", given)
    known = [field.name for field in dataclasses.fields(Plausibility)]
    for name, _ in given or ():
        if name not in known:
            raise InputError("--limit", "is no limit", value=name, allowed=known)
    return dataclasses.replace(default or Plausibility(), **dict(given or ()))


def each_once(option: str, pairs: Sequence[tuple[str, object]] | None) -> None:
    """Refuse a name that is given twice."""
    names = [name for name, _ in pairs or ()]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{option} {name}", f"given {names.count(name)} times", allowed="once a name")


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Declare what every command that writes a report takes."""
    parser.add_argument(
        "--source", action="append", metavar="FILE.parquet",
        help="departures that the scenario model was fitted to, as ldc extract wrote them: the report compares the "
        "generated ones with them; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--no-robustness", action="store_true",
        help="drive no designs on other plants for the report, which takes some seconds the first time: it shows "
        "what DIR/robustness.json holds of this study, or leaves that section out",
    )  # fmt: skip
    parser.add_argument("--no-figures", action="store_true", help="write no figures/: the report's charts as SVG files")
