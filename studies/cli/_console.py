"""What the commands share: arguments, output files, tables and progress bars."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import ldctoolkit.compiling as compiling
from ldctoolkit.declared import checked_number, checked_whole
from ldctoolkit.errors import InputError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from ldctoolkit.control import Controller
    from ldctoolkit.departures import Plausibility

    from ..tables import Table


T = TypeVar("T")

_WIDTH = 160  # columns where stdout is no terminal: a file or a log has no width of its own


class Subparsers(Protocol):
    """What `argparse.ArgumentParser.add_subparsers` returns."""

    def add_parser(self, name: str, *, help: str, description: str) -> argparse.ArgumentParser:
        """Add a command."""


def console() -> Console:
    """Standard output for tables."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=_WIDTH)


_STYLES = {"winner": "bold", "bad": "red", "warning": "yellow", "good": "green", "same": "dim"}
_LONGEST_WORD = 16  # columns of a narrow table that a word of text is given before it is broken


def print_table(table: Table, out: Console | None = None, *, narrow: bool = False) -> None:
    """Print a table whose numbers are whole at any width of the terminal; no text in it is markup.

    Where it is narrow, or is to be, there are no rules, and headings and text break at spaces; columns that do not fit
    even then follow below, beside the text columns at the left again.
    """
    from rich import box
    from rich.table import Table as Grid
    from rich.text import Text

    out = out or console()
    heads = [f"{column.title}\n[{column.unit}]" if column.unit else column.title for column in table.columns]
    rows = [table.texts(row) for row in table.rows]
    full, whole, least = [], [], []  # widths of a column: as it is, with a broken heading, with broken text too
    for j, (column, head) in enumerate(zip(table.columns, heads, strict=True)):
        cells = [row[j] for row in rows]
        words = [word[:_LONGEST_WORD] for cell in cells for word in cell.split()] if column.text else cells
        full.append(max(len(line) for cell in (head, *cells) for line in (cell or " ").splitlines()))
        whole.append(max(map(len, (*head.split(), *cells))))
        least.append(max(map(len, (*head.split(), *words))))
    ruled = not narrow and sum(whole) + 3 * len(heads) + 1 <= out.width
    keys = next((j for j, column in enumerate(table.columns) if j and not column.text), len(heads))
    shown, rest, title = list(range(keys)), list(range(keys, len(heads))), table.title
    between, smallest = (3, whole) if ruled else (1, least)
    while True:
        while rest and (ruled or len(shown) == keys or sum(least[j] + 1 for j in (*shown, rest[0])) <= out.width):
            shown.append(rest.pop(0))
        widths = {j: full[j] for j in shown}
        while sum(widths.values()) + between * len(shown) + ruled > out.width and any(
            widths[j] > smallest[j] for j in shown
        ):
            widths[max(shown, key=lambda j: widths[j] - smallest[j])] -= 1
        grid = Grid(
            title=Text(title, style="table.title") if title else None, title_justify="left", pad_edge=ruled,
            box=box.HEAVY_HEAD if ruled else None, padding=(0, 1) if ruled else (0, 1, 0, 0),
        )  # fmt: skip
        for j in shown:
            justify: Any = "left" if table.columns[j].text else "right"
            grid.add_column(Text(heads[j]), justify=justify, width=widths[j], overflow="fold")
        for row, texts in zip(table.rows, rows, strict=True):
            if row.apart:
                grid.add_section()
            states = [cell for _, cell in table.cells(row)]
            styles = ["bad" if cell.bad else "good" if cell.good else "" for cell in states]
            shown_cells = (Text(texts[j], style=_STYLES.get(styles[j], "")) for j in shown)
            grid.add_row(*shown_cells, style=_STYLES.get(row.kind))
        out.print(grid)
        shown, title = list(range(keys)), ""
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


def argument(check: Callable[..., T], **limits: float) -> Callable[[str], T]:
    """The type of an argument that is a number within limits; whole ones may be written as ``1e6``."""

    def read(text: str) -> T:
        try:
            whole = text.isascii() and text.isdigit()
            value: Any = int(text) if whole else float(text)
            value = int(value) if check is checked_whole and value == value // 1 else value
        except (ValueError, OverflowError):
            value = text
        try:
            return check("", value, **limits)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(InputError("", value=text, allowed=error.allowed))) from None

    return read


whole_number = argument(checked_whole, lower=0)
positive_number = argument(checked_whole, lower=1)
number = argument(checked_number)
_end = argument(checked_number, finite=False)


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


def interval(text: str, whole: str) -> Interval:
    """``LOW:HIGH``, an empty end is open."""
    low, colon, high = text.partition(":")
    if not colon:
        raise argparse.ArgumentTypeError(f"{whole!r}; allowed: NAME=LOW:HIGH, an empty end is open")
    return tuple(_end(end) if end.strip() else None for end in (low, high))  # type: ignore[return-value]


def condition(text: str) -> tuple[str, float | Interval]:
    """``NAME=VALUE`` or ``NAME=LOW:HIGH``."""
    name, rest = named(text)
    return name, interval(rest, text) if ":" in rest else _end(rest)


def bound(text: str) -> tuple[str, Interval]:
    """``NAME=LOW:HIGH``, an empty end is open."""
    name, rest = named(text)
    return name, interval(rest, text)


def add_limit(parser: argparse.ArgumentParser) -> None:
    """Declare ``--limit``."""
    parser.add_argument(
        "--limit",
        type=lambda text: (named(text)[0], _end(named(text)[1])),
        action="append",
        metavar="NAME=VALUE",
        help="a departure beyond it is implausible: y_rate (2 m/s), y_acceleration (4 m/s^2), a_y (6 m/s^2); inf for "
        "none; repeatable",
    )


def plausibility(limits: Sequence[tuple[str, float]] | None, default: Plausibility | None = None) -> Plausibility:
    """The limits of ``--limit``, the others those of the default."""
    from ldctoolkit.departures import Plausibility

    each_once("--limit", limits)
    names = [field.name for field in dataclasses.fields(Plausibility)]
    for name, _ in limits or ():
        if name not in names:
            raise InputError("--limit", "is not a limit that a review checks", value=name, allowed=names)
    return dataclasses.replace(default or Plausibility(), **dict(limits or ()))


def each_once(option: str, pairs: Sequence[tuple[str, object]] | None) -> None:
    """Refuse a name that is given twice."""
    names = [name for name, _ in pairs or ()]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{option} {name}", f"given {names.count(name)} times", allowed="each name once")


def law_with_gains(name: str, gains: Sequence[tuple[str, str]] | None) -> Controller:
    """The law of a registry name with the gains of ``--gain``."""
    from ldctoolkit.declared import find_gain
    from ldctoolkit.registry import controller_class

    kind = controller_class(name)
    each_once("--gain", gains)
    return kind(**{gain: find_gain(kind, gain).parsed(value) for gain, value in gains or ()})


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
