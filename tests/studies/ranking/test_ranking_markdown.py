"""ranking.md as a Markdown reader understands it: cells, numbers, escaped text, what is listed."""

from __future__ import annotations

import dataclasses
import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from helpers.results import results_of
from studies.design import Design
from studies.ranking.markdown_text import markdown_text
from studies.ranking.ranking import Ranking
from studies.ranking.ranking_markdown import MOST_ROWS, StudyHead, listed_places, ranking_markdown, write_markdown
from studies.report.words.text import printable
from studies.results import Case, FailedDesign

EVIL = "<script>alert(1)</script>"
HEAD = StudyHead("A | B", "a-b", f"m {EVIL}", synthetic=True, left=30, right=20, seed=7)


def ranking_of(S: np.ndarray, *, failed: tuple[FailedDesign, ...] = (), **settings: Any) -> Ranking:
    """Designs with given scores, 3/5 of the scenarios to the left."""
    designs = [Design.from_gains("lqr", 0.1 + 0.001 * i, {}) for i in range(len(S))]
    results = results_of(S, designs, left=3 * S.shape[1] // 5, parts={"failed": failed})
    return Ranking.of(results, results.cases[0], bootstrap=200, **settings)


def scores(d: int, n: int = 50) -> np.ndarray:
    generator = np.random.default_rng(4)
    return generator.gamma(2.0, 0.2, n) + np.linspace(0.0, 1.0, d)[:, None] + 0.01 * generator.random((d, n))


def table(text: str) -> list[list[str]]:
    """Cells of the only table, as a Markdown parser has them."""
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    rows: list[list[str]] = []
    for before, token in itertools.pairwise(tokens):
        if before.type == "tr_open":
            rows.append([])
        if before.type in ("td_open", "th_open"):
            rows[-1].append("".join(child.content for child in token.children or ()))
    return rows


def test_the_table_holds_the_numbers_of_the_ranking() -> None:
    ranking = ranking_of(scores(4))
    head, *rows = table(ranking_markdown([ranking], HEAD))
    assert head[:4] == ["Rank", "Design", "Mean S [m s]", "To the best [m s]"]
    assert len(rows) == 4
    for i, row in enumerate(rows):
        assert row[0] == str(ranking.rank[i])
        assert row[1] == f"{ranking.designs[i].label} ({ranking.designs[i].id})"
        value, low, high = map(float, re.findall(r"[+-]?\d+\.\d+", row[2]))
        assert [value, low, high] == pytest.approx([ranking.S[i], ranking.S_low[i], ranking.S_high[i]], abs=6e-5)
        assert (row[3] == "–") == (i == 0)  # noqa: RUF001
        assert i == 0 or re.fullmatch(r"\+\d\.\d{4} \(\+\d\.\d{4} to \+\d\.\d{4}\)", row[3])
        assert i == 0 or float(row[3].split()[0]) == pytest.approx(ranking.difference[i], abs=6e-5)
        assert float(row[4].split()[0]) == pytest.approx(100 * ranking.reduction[i], abs=0.06)
        assert float(row[5]) == pytest.approx(ranking.S_left[i], abs=6e-5)
        assert float(row[6]) == pytest.approx(ranking.S_right[i], abs=6e-5)
    assert "winner" in rows[0][-1]


def test_the_head_says_what_was_ranked() -> None:
    html = MarkdownIt("commonmark").enable("table").render(ranking_markdown([ranking_of(scores(3))], HEAD))
    assert "<h1>A | B</h1>" in html
    assert "50 (30 left, 20 right), seed 7" in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html
    assert "<script" not in html
    assert "Winner: LQR, y_s=0.1 m, mean S" in html
    assert "synthetic" in html
    assert "S is the integral over time of |e_y|, the distance of the vehicle's centre" in html
    assert "Here it is taken over the whole departure." in html


def test_the_first_designs_and_those_with_a_mark_are_listed() -> None:
    d = MOST_ROWS + 30
    ranking = ranking_of(scores(d), baseline="")
    assert listed_places(ranking) == list(range(MOST_ROWS))
    last = dataclasses.replace(ranking, baseline=d - 1, pareto=np.arange(d) == d - 3)
    assert listed_places(last) == [*range(MOST_ROWS), d - 3, d - 1]
    text = ranking_markdown([last], HEAD)
    assert f"{MOST_ROWS + 2} of {d} designs" in text
    rows = table(text)[1:]
    assert [row[-1] for row in rows[-2:]] == ["Pareto", "baseline"]


def test_nothing_ranked() -> None:
    text = ranking_markdown([ranking_of(scores(3), require=["S <= 0"])], HEAD)
    assert "none is ranked and none wins" in text
    rows = table(text)[1:]
    assert [row[0] for row in rows] == ["–"] * 3  # noqa: RUF001
    assert all(row[-1] == "misses S <= 0" for row in rows)


def test_one_design_and_failed_ones_with_their_reasons() -> None:
    failed = FailedDesign(Design.from_gains("lqr", 0.5, {}), f"ValueError: {EVIL}\n# no | heading")
    text = ranking_markdown([ranking_of(scores(1), failed=(failed,))], HEAD)
    html = MarkdownIt("commonmark").enable("table").render(text)
    assert "&lt;script&gt;alert(1)&lt;/script&gt; # no | heading" in html
    assert html.count("<h1") == 1
    assert "1 design failed, without figures." in html


def test_warnings_are_text() -> None:
    ranking = dataclasses.replace(ranking_of(scores(2)), warnings=(f"*look* {EVIL} `x` [a](b) www.example.org",))
    html = MarkdownIt("commonmark").enable("table").render(ranking_markdown([ranking], HEAD))
    assert "*look* &lt;script&gt;alert(1)&lt;/script&gt; `x` [a](b) www.example.org" in html


def test_other_cases_have_a_line_each_and_the_text_is_the_same_each_time(tmp_path: Path) -> None:
    ranking = ranking_of(scores(3))
    other = dataclasses.replace(ranking, case=Case("control", "as_printed"))
    write_markdown([ranking, other], tmp_path / "r.md", HEAD)
    text = (tmp_path / "r.md").read_text(encoding="utf-8")
    assert "- control window, as printed\\: Winner" in text or "- control window, as printed: Winner" in text
    assert text == ranking_markdown([ranking_of(scores(3)), other], HEAD)
    assert len(table(text)) == 4


@pytest.mark.parametrize("turn", "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069")
def test_no_text_turns_what_follows(turn: str) -> None:
    assert markdown_text(f"a{turn}b") == "a\ufffdb"
    assert printable(f"a{turn}b") == "a\ufffdb"
    assert printable("\u05d0\u200f\u2029") == "\u05d0\u200f\u2029"


@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=40))
def test_any_text_stays_what_it_is(text: str) -> None:
    """A Markdown parser gives the text back, in a cell as in a line of a list."""
    shown = markdown_text(text)
    assert "\n" not in shown
    parser = MarkdownIt("commonmark").enable("table")
    text = re.sub("[\u202a-\u202e\u2066-\u2069]", "\ufffd", text)
    expected = " ".join(text.replace("\u2028", " ").replace("\u2029", " ").split(" ")).strip()
    for block in (f"| a |\n| --- |\n| {shown} |\n", f"- {shown}\n"):
        inline = [token for token in parser.parse(block) if token.type == "inline"]
        children = inline[-1].children or [] if inline else []
        assert {child.type for child in children} <= {"text", "html_inline", "text_special"}
        assert all(child.content == "<!-- -->" for child in children if child.type == "html_inline")
        got = "".join(child.content for child in children if child.type != "html_inline")
        if block.startswith("|") and not shown:
            continue
        assert re.sub(r"\s+", " ", got).strip() == re.sub(r"\s+", " ", expected).strip()
