"""Tables as values, and their renderings: HTML for pages and notebooks, Markdown, CSV, data frames.

A section of results makes a `Table`; the command line prints it with rich. Escaping is in the renderers.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Self

from markupsafe import Markup, escape

from ldctoolkit.arrays import CELL
from ldctoolkit.errors import plain

from .text import DASH, formatted, symbols

if TYPE_CHECKING:
    import polars as pl

Value = str | bool | int | float | tuple[float, float] | None
"""What a cell holds: text, a number, the ends of an interval, or nothing."""


@dataclasses.dataclass(frozen=True)
class Column:
    """One column."""

    title: str
    unit: str = ""
    form: str | Callable[[float], str] = ""  # how its numbers are shown: ``".3f"``, or a function that makes the text
    text: bool = False  # whether it holds text and stands to the left
    key: str = ""  # what the search of a page calls it: ``S``, ``y_s``; empty where it is not searched by value
    about: str = ""  # what it means; shown when the pointer rests on the heading

    @property
    def heading(self) -> str:
        """Title and unit."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclasses.dataclass(frozen=True)
class Cell:
    """One cell; `text` is shown instead of the value, `bad` and `good` set it off."""

    value: Value = None
    text: str = ""  # markup stays as it is in HTML
    bad: bool = False
    good: bool = False


@dataclasses.dataclass(frozen=True)
class Row:
    """One row; `kind` is a class of the style sheet, `later` hides it until all rows are requested."""

    cells: Sequence[Cell | Value]
    kind: str = ""
    later: bool = False
    apart: bool = False  # whether rows are left out before it


@dataclasses.dataclass(frozen=True)
class Table:
    """A table; `head` is the column that names a row."""

    title: str
    columns: Sequence[Column]
    rows: Sequence[Row]
    head: int = 0

    @classmethod
    def of(cls, names: Iterable[str], rows: Iterable[Mapping[str, Any]], text: Iterable[str] = ()) -> Self:
        """Numbers under the names of their columns; what a row does not have is empty; `text` columns hold text."""
        texts = set(text)
        columns = [Column(name, text=name in texts) for name in names]
        return cls("", columns, [Row([plain(row.get(column.title)) for column in columns]) for row in rows])

    def cells(self, row: Row) -> Iterator[tuple[Column, Cell]]:
        """The cells of a row with their columns."""
        for column, cell in zip(self.columns, row.cells, strict=True):
            yield column, cell if isinstance(cell, Cell) else Cell(cell)

    def texts(self, row: Row, between: str = "..") -> list[str]:
        """What the cells of a row show; `between` stands between the ends of an interval."""
        return [cell.text or _cell_text(cell.value, column.form, between) for column, cell in self.cells(row)]


def _cell_text(value: Value, form: str | Callable[[float], str], between: str) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        ends = [_cell_text(end, form, between) for end in value]
        return between.join(ends) if math.isfinite(sum(value)) else DASH
    if callable(form):
        return form(value)
    return formatted(value, form or ("," if isinstance(value, int) else "g"))


# ------------------------------------------------------------------------------------------------ HTML

_LEFT: Final = f"text-align:left;{CELL}"
_RIGHT: Final = f"text-align:right;white-space:nowrap;{CELL}"


def to_html(table: Table, *, id: str = "", sortable: bool = False, inline: bool = False) -> Markup:
    """A table in a frame that scrolls sideways; `inline`: styles of its own, as a notebook needs them."""

    def look(column: Column, *more: str) -> str:
        if inline:
            bold = ";font-weight:bold" if "winner" in more else ""
            return f' style="{_LEFT if column.text else _RIGHT}{bold}"'
        kinds = " ".join(filter(None, ("" if column.text else "n", *more)))
        return f' class="{kinds}"' if kinds else ""

    if inline:
        out = ['<table style="border-collapse:collapse;font-variant-numeric:tabular-nums">']
    else:
        out = [f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(table.title)}"><table']
        out.append(f"{f' id={chr(34)}{id}{chr(34)}' if id else ''}{' data-sortable' if sortable else ''}>")
    out.append("<thead><tr>" if inline else f"<caption>{symbols(table.title)}</caption><thead><tr>")
    for column in table.columns:
        unit = f" <small>[{symbols(column.unit)}]</small>" if column.unit else ""
        about = f' title="{escape(column.about)}"' if column.about else ""
        key = f' data-key="{escape(column.key)}"' if column.key and sortable else ""
        out.append(f'<th scope="col"{look(column)}{about}{key}>{symbols(column.title)}{unit}</th>')
    out.append("</tr></thead><tbody>")
    for row in table.rows:
        kinds = " ".join(filter(None, (row.kind, "later" if row.later else "")))
        out.append("<tr>" if inline or not kinds else f'<tr class="{kinds}">')
        for j, ((column, cell), text) in enumerate(zip(table.cells(row), table.texts(row, " to "), strict=True)):
            state = row.kind if inline else "bad" if cell.bad else "good" if cell.good else ""
            value = cell.value[0] if isinstance(cell.value, tuple) else cell.value
            known = sortable and isinstance(value, int | float) and math.isfinite(value)
            sorted_by = f' data-v="{value:.9g}"' if known else ""
            tag = 'th scope="row"' if j == table.head and not inline else "td"
            shown = text if isinstance(text, Markup) else symbols(text)
            out.append(f"<{tag}{look(column, state)}{sorted_by}>{shown}</{tag[:2]}>")
        out.append("</tr>")
    out.append("</tbody></table>" if inline else "</tbody></table></div>")
    return Markup("".join(out))


def notebook_html(lines: Iterable[str], warnings: Iterable[str], table: Table, more: int) -> str:
    """What a notebook shows of results: the title of a table, sentences, warnings, the rows, and how many follow."""
    said = [*(symbols(line) for line in lines), *(Markup("<b>Warning:</b> {}").format(symbols(w)) for w in warnings)]
    foot = f"<div>and {more:,} more</div>" if more > 0 else ""
    head = "<br>".join((f"<b>{symbols(table.title)}</b>", *said))
    return f'<div style="overflow-x:auto"><div>{head}</div>{to_html(table, inline=True)}{foot}</div>'


# ------------------------------------------------------------------------------------------------ Markdown

_ENTITIES: Final = {"&": "&amp;", "<": "&lt;", ">": "&gt;"}
_MARKS: Final = frozenset("\\`*_[]|~#$")
_ADDRESS: Final = re.compile(r"(?i)\b(www)(\.)|()(:)(?=\S)")
_START: Final = re.compile(r"^(\d{1,9})([.)])|^([-+=])")


def markdown_text(text: str) -> str:
    r"""One line of text that a reader of GitHub-flavoured Markdown shows as it is."""
    line = re.sub(r"[\x00-\x20\x7f\x85\u2028\u2029]+", " ", text).strip()
    # halves of characters, and what turns the direction of the text that follows
    line = re.sub("[\ud800-\udfff\u202a-\u202e\u2066-\u2069]", "\ufffd", line)
    shown = "".join(_ENTITIES.get(c, f"\\{c}" if c in _MARKS else c) for c in line)
    # no address, emoji or mention: a mark inside the word ends what would be one
    shown = _ADDRESS.sub(lambda m: f"{m[1] or ''}\\{m[2] or m[4]}", shown).replace("@", "@<!-- -->")
    return _START.sub(lambda m: f"{m[1]}\\{m[2]}" if m[1] else f"\\{m[3]}", shown)


def to_text(table: Table) -> str:
    """A table in columns of plain text, without its title."""
    rows = [[column.heading for column in table.columns], *map(table.texts, table.rows)]
    cells = zip(table.columns, *rows, strict=True)
    line = "  ".join(f"{{:{'<' if column.text else '>'}{max(map(len, texts))}}}" for column, *texts in cells)
    return "\n".join(line.format(*row).rstrip() for row in rows)


def to_markdown(table: Table) -> str:
    """A table of GitHub-flavoured Markdown, without its title."""
    head = [markdown_text(column.heading) for column in table.columns]
    rule = ["---" if column.text else "---:" for column in table.columns]
    rows = ([markdown_text(text) for text in table.texts(row)] for row in table.rows)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in (head, rule, *rows))


# ------------------------------------------------------------------------------------------------ CSV and data frames

_FORMULA: Final = re.compile(r"[=@\t]|[+-](?!([\d.]+(e[+-]?\d+)?|inf|nan)$)")


def to_csv(table: Table) -> str:
    """Values in full precision, empty where there is none; an apostrophe before what a spreadsheet would run."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([column.title for column in table.columns])
    writer.writerows([_csv_field(cell.value) for _, cell in table.cells(row)] for row in table.rows)
    return text.getvalue()


def _csv_field(value: Value) -> Value:
    """A field of a CSV file: on one line, and no formula to a spreadsheet."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        line = value.replace("\r", " ")  # a line would end there
        return f"'{line}" if _FORMULA.match(line) else line
    return "" if value is None or value != value else value


def to_polars(table: Table) -> pl.DataFrame:
    """A data frame of the values: numbers, truth values or text, null where there is none."""
    import polars as pl

    columns = {}
    for j, column in enumerate(table.columns):
        cells = (row.cells[j] for row in table.rows)
        values = [cell.value if isinstance(cell, Cell) else cell for cell in cells]
        values = [None if value == "" or value != value else value for value in values]
        kinds = {type(value) for value in values if value is not None}
        if column.text or str in kinds or kinds > {bool}:
            values = [None if value is None else str(value) for value in values]
            columns[column.title] = pl.Series(values, dtype=pl.String)
        else:
            whole = pl.Int64 if kinds == {int} else pl.Float64
            columns[column.title] = pl.Series(values, dtype=pl.Boolean if kinds == {bool} else whole)
    return pl.DataFrame(columns)
