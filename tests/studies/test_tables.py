"""Tables in every rendering: the same numbers, text that stays text."""

import csv
import io
import math
import re
from typing import Any

import pytest
from markdown_it import MarkdownIt
from rich.console import Console

from helpers.pages import EVIL, Page
from ldctoolkit.studies.cli._console import print_table
from ldctoolkit.studies.tables import (
    Cell,
    Column,
    Row,
    Table,
    markdown_text,
    notebook_html,
    to_csv,
    to_html,
    to_markdown,
    to_polars,
)
from ldctoolkit.studies.text import figure, printable

TABLE = Table(
    "K_psi of one",
    [
        Column("Name", text=True), Column("S", "m·s", ".3f", key="S", about='a "b"'), Column("Interval", form=".2f"),
        Column("n"), Column("P", form=figure),
    ],
    [
        Row(["a", 0.12345, (-0.5, 1.0), 12345, 2.06e-4], "winner"),
        Row([EVIL, Cell(-0.0001, bad=True), (math.nan, 1.0), Cell(7, "seven"), math.inf], later=True, apart=True),
    ],
)  # fmt: skip


def shown(table: Table, width: int, **options: Any) -> list[str]:
    out = Console(width=width, file=io.StringIO())
    print_table(table, out, **options)
    return out.file.getvalue().splitlines()  # type: ignore[attr-defined,no-any-return]


def test_html_has_true_minus_signs_classes_and_what_rows_are_sorted_by() -> None:
    html = str(to_html(TABLE, id="t", sortable=True))
    page = Page(html)
    head, *rows = page.filled()[0]
    assert (page.captions, head) == (["Kψ of one"], ["Name", "S [m·s]", "Interval", "n", "P"])
    assert rows[0] == ["a", "0.123", "−0.50 to 1.00", "12,345", "2.06e−4"]  # noqa: RUF001
    assert rows[1] == [printable(EVIL), "0.000", "–", "seven", "∞"]  # noqa: RUF001
    assert "<script" not in html
    assert '<table id="t" data-sortable>' in html
    assert '<th scope="col" class="n" title="a &#34;b&#34;" data-key="S">' in html
    assert '<tr class="winner"><th scope="row">a</th><td class="n" data-v="0.12345">0.123</td>' in html
    assert '<tr class="later">' in html
    assert '<td class="n bad" data-v="-0.0001">0.000</td>' in html
    assert 'data-v="-0.5"' in html  # an interval is sorted by its lower end
    assert html.count("data-v") == 6  # NaN has none
    assert "data-v" not in to_html(TABLE)


def test_a_notebook_has_styles_of_its_own_and_says_what_is_left_out() -> None:
    html = notebook_html(["One line, -1."], [EVIL], TABLE, 1200)
    assert "class=" not in html
    assert "<b>K<sub>ψ</sub> of one</b><br>One line, −1.<br><b>Warning:</b> &lt;script&gt;" in html  # noqa: RUF001
    assert "font-weight:bold" in html.split("<tbody>")[1].split("</tr>")[0]
    assert html.endswith("<div>and 1,200 more</div></div>")
    assert "more</div>" not in notebook_html([], [], TABLE, 0)


def test_markdown_reads_as_the_text_it_is_made_from() -> None:
    name = f"*a* | {EVIL} `x` [a](b) www.example.org"
    text = to_markdown(Table("", TABLE.columns, [Row([name, *TABLE.rows[0].cells[1:]])]))
    html = MarkdownIt("commonmark").enable("table").render(text)
    assert re.findall(r"<td[^>]*>(.*?)</td>", html)[1:] == ["0.123", "-0.50..1.00", "12,345", "2.06e-4"]
    assert (
        "*a* | &lt;script&gt;alert(1)&lt;/script&gt; &quot;q&quot; 'x' &amp; \ufffd `x` [a](b) www.example.org" in html
    )
    assert html.count('style="text-align:right"') == 8


@pytest.mark.parametrize("value", [0.0, -0.0, 0.04, -0.04])
def test_what_is_rounded_to_zero_has_no_sign(value: float) -> None:
    row = Row([value, value])
    assert Table("", [Column("x", form="+.1f"), Column("y", form=".1f")], [row]).texts(row) == ["0.0", "0.0"]


@pytest.mark.parametrize("turn", "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
def test_no_text_turns_what_follows(turn: str) -> None:
    assert markdown_text(f"a{turn}b") == printable(f"a{turn}b") == "a\ufffdb"
    assert printable("\u05d0\u200f\u2029") == "\u05d0\u200f\u2029"


def test_csv_has_full_precision_and_no_formulas() -> None:
    row = {"a": "=1+1", "b": "+cmd", "c": "-2+3", "d": "@SUM(1)", "e": "-0.5", "f": -0.5, "g": "1-2", "h": "-inf"}
    assert to_csv(Table.of("abcdefgh", [row])) == "a,b,c,d,e,f,g,h\n'=1+1,'+cmd,'-2+3,'@SUM(1),-0.5,-0.5,1-2,-inf\n"
    assert to_csv(Table.of("ax", [{"a": "1\r=1", "x": None}, {"a": "@"}])) == "a,x\n1 =1,\n'@,\n"
    rows = [{"a": 0.1 + 0.2, "b": True, "c": math.nan}, {"a": 1, "b": False, "c": "x, y"}]
    text = to_csv(Table.of("abc", rows))
    assert list(csv.reader(io.StringIO(text))) == [
        ["a", "b", "c"], ["0.30000000000000004", "true", ""], ["1", "false", "x, y"]
    ]  # fmt: skip


def test_a_data_frame_has_the_values_themselves() -> None:
    rows = [
        {"x": 0.1, "i": 3, "b": True, "t": "=1+1", "n": None, "m": 1, "e": ""},
        {"x": math.nan, "i": None, "b": None, "t": "", "n": math.nan, "m": 0.5, "e": ""},
    ]
    frame = to_polars(Table.of("xibtnme", rows, text="e"))
    assert {name: str(kind) for name, kind in frame.schema.items()} == {
        "x": "Float64", "i": "Int64", "b": "Boolean", "t": "String", "n": "Float64", "m": "Float64", "e": "String",
    }  # fmt: skip
    assert frame.rows() == [(0.1, 3, True, "=1+1", None, 1.0, None), (None, None, None, None, None, 0.5, None)]


def test_a_terminal_shows_no_markup_and_rules_where_there_is_room() -> None:
    table = Table("[b]T[/b]", [Column("a :smile:", text=True), Column("x", "m", ".1f")], [Row(["[red]r[/red]", 1.25])])
    wide, narrow = shown(table, 80), shown(table, 80, narrow=True)
    assert wide[0].strip() == narrow[0].strip() == "[b]T[/b]"
    assert "│ [red]r[/red] │ 1.2 │" in wide
    assert narrow[-1].split() == ["[red]r[/red]", "1.2"]
    assert any("a :smile:" in line for line in wide)
    assert any("[m]" in line for line in wide)


@pytest.mark.parametrize("width", [30, 41, 64, 80, 200])
def test_columns_that_do_not_fit_follow_below(width: int) -> None:
    columns = [Column("name of a thing", text=True), *(Column(f"number {i}", "m/s", ".2f") for i in range(8))]
    lines = shown(Table("Title", columns, [Row(["a rather long name", *(10**i + 0.25 for i in range(8))])]), width)
    words = " ".join(lines).replace("\u2502", " ").split()
    assert [word for word in words if re.fullmatch(r"\d+\.25", word)] == [f"{10**i + 0.25:.2f}" for i in range(8)]
    assert max(map(len, lines)) <= width
    assert words.count("Title") == 1
    assert words.count("rather") == {30: 4, 41: 3, 64: 2, 80: 1, 200: 1}[width]
