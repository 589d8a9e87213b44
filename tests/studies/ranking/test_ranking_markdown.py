"""ranking.md as a Markdown reader understands it: cells, numbers, escaped text, what is listed."""

import dataclasses
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from markdown_it import MarkdownIt

from helpers.results import results_of
from ldctoolkit.studies.design import Design
from ldctoolkit.studies.pages.ranking_section import MOST_MARKDOWN_ROWS as MOST_ROWS
from ldctoolkit.studies.pages.ranking_section import ranking_markdown, write_markdown
from ldctoolkit.studies.ranking.ranking import Ranking
from ldctoolkit.studies.ranking.verdict import Verdict, listed_positions, more_lines, verdict
from ldctoolkit.studies.results import FailedDesign
from ldctoolkit.studies.storage.manifest import Manifest
from ldctoolkit.studies.study_file import Study

EVIL = "<script>alert(1)</script>"
CONTENT = {
    "name": "a-b",
    "title": "A | B",
    "seed": 7,
    "scenarios": {"left": 30, "right": 20},
    "design": [{"law": "lqr"}],
}
STUDY = Study.from_dict(CONTENT)
MANIFEST = Manifest.of(STUDY, model="m", model_hash="f" * 64, model_notes=(), model_synthetic=True)
MANIFEST = MANIFEST.model_copy(update={"model": f"m {EVIL}"})


def ranked(S: np.ndarray, *, failed: tuple[FailedDesign, ...] = (), **settings: Any) -> tuple[Ranking, Verdict]:
    """Designs with given scores, 3/5 of the scenarios to the left."""
    designs = [Design.from_gains("lqr", 0.1 + 0.001 * i, {}) for i in range(len(S))]
    results = results_of(S, designs, left=3 * S.shape[1] // 5, parts={"failed": failed})
    ranking = Ranking.of(results, bootstrap=200, **settings)
    return ranking, verdict(ranking, results)


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
    ranking, found = ranked(scores(4))
    head, *rows = table(ranking_markdown(ranking, STUDY, MANIFEST, found))
    assert head[:6] == ["Rank", "Law", "y_s [m]", "Gains", "Mean S [m·s]", "95 % interval [m·s]"]
    assert head[6:] == ["Reduction [%]", "a_y p95 [m/s²]", "Jerk p95 [m/s³]", "Needless [%]", "Verdict"]
    assert len(rows) == 4
    for i, row in enumerate(rows):
        assert row[:3] == [str(ranking.rank[i]), "LQR", f"{ranking.designs[i].y_s:g}"]
        low, high = map(float, row[5].split(".."))
        assert float(row[4]) == pytest.approx(ranking.metrics.S[i], abs=6e-4)
        assert (low, high) == pytest.approx((ranking.inference.S_low[i], ranking.inference.S_high[i]), abs=6e-4)
        assert float(row[6]) == pytest.approx(100 * ranking.metrics.reduction[i], abs=0.06)
    assert "winner" in rows[0][-1]


def test_the_verdict_stands_above_the_table() -> None:
    ranking, found = ranked(scores(3))
    text = ranking_markdown(ranking, STUDY, MANIFEST, found)
    html = MarkdownIt("commonmark").enable("table").render(text)
    assert "<h1>A | B</h1>" in html
    assert "50 (30 left, 20 right), seed 7" in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt;" in html
    assert "<script" not in html
    assert "<strong>Smallest S: LQR, y_s = 0.1 m.</strong>" in html
    assert text.index("Smallest S") < text.index("| Rank |")
    assert "synthetic" in html
    assert "S is the integral over time of |e_y|, the distance of the vehicle's centre" in html
    assert "Here it is taken over the whole departure." in html


def test_the_first_designs_and_those_named_are_listed() -> None:
    d = MOST_ROWS + 30
    ranking, found = ranked(scores(d), baseline="")
    assert listed_positions(ranking, MOST_ROWS) == list(range(MOST_ROWS))
    last = dataclasses.replace(ranking, baseline=d - 1)
    assert listed_positions(last, MOST_ROWS) == [*range(MOST_ROWS), d - 1]
    text = ranking_markdown(last, STUDY, MANIFEST, found)
    assert f"{MOST_ROWS + 1} of {d} designs" in text
    assert table(text)[-1][-1].startswith("baseline")


def test_nothing_ranked() -> None:
    ranking, found = ranked(scores(3), require=["S <= 0"])
    text = ranking_markdown(ranking, STUDY, MANIFEST, found)
    assert "None of 3 designs meets the limits" in text
    rows = table(text)[1:]
    assert [row[0] for row in rows] == ["–"] * 3  # noqa: RUF001
    assert all(row[-1] == "breaks S <= 0" for row in rows)


def test_one_design_and_failed_ones_with_their_reasons() -> None:
    failed = FailedDesign(Design.from_gains("lqr", 0.5, {}), f"ValueError: {EVIL}\n# no | heading")
    ranking, found = ranked(scores(1), failed=(failed,))
    html = MarkdownIt("commonmark").enable("table").render(ranking_markdown(ranking, STUDY, MANIFEST, found))
    assert "&lt;script&gt;alert(1)&lt;/script&gt; # no | heading" in html
    assert html.count("<h1") == 1
    assert "1 design failed, without metrics." in html


def test_the_file_holds_the_text_which_is_the_same_each_time(tmp_path: Path) -> None:
    ranking, found = ranked(scores(3))
    other = dataclasses.replace(ranking, window="control", convention="as_printed")
    write_markdown(other, tmp_path / "r.md", STUDY, MANIFEST, found)
    text = (tmp_path / "r.md").read_text(encoding="utf-8")
    assert "S: control window, signs as printed" in text
    assert text == ranking_markdown(other, STUDY, MANIFEST, found)
    assert len(table(text)) == 4


def test_what_a_limit_inside_the_law_buys() -> None:
    """The best ranked design with one beside the best without: a limit of 0, or of a design not ranked, is none."""
    gains: list[tuple[str, dict[str, Any]]] = [
        ("linear_mpc", {"r_delta": 2500.0, "jerk_max": 4.0}),
        ("linear_mpc", {"r_delta": 1000.0, "jerk_max": 4.5}),
        ("linear_mpc", {"r_delta": 3000.0, "jerk_max": 0.0}),
        ("lqi", {"r_delta": 10000.0}),
        ("none", {}),
    ]
    designs = [Design.from_gains(law, 0.15, given) for law, given in gains]
    n, S = 50, np.array([1.6, 1.5, 1.9, 1.75, 2.5])
    jerk = np.array([4.5, 5.5, 4.0, 4.75, np.nan])
    S = S[:, None] + 0.01 * np.random.default_rng(1).random((5, n)) * np.arange(1, 6)[:, None]
    means = {"jerk_added_peak": np.tile(jerk[:, None], n), "a_y_added_peak": np.full((5, n), 2.0)}
    results = results_of(S, designs, uncorrected=2.5, metrics=means)
    ranking = Ranking.of(results, bootstrap=200, require=["jerk_added_peak_p95 <= 5"])
    (line,) = [line for line in more_lines(ranking) if "limit of comfort" in line]
    saved = [100 * (1 - S[i].mean() / 2.5) for i in (0, 3)]
    assert line.startswith(
        "Best design with a limit of comfort in its law: Linear MPC, y_s = 0.15 m, r_delta = 2500, jerk_max = 4, "
        f"S {saved[0]:.1f} % less than without control at 4.50 m/s\u00b3 of jerk (95 % quantile). Best without: "
        f"LQI, y_s = 0.15 m, r_delta = 10000, S {saved[1]:.1f} % less at 4.75 m/s\u00b3 of jerk. "
        "Difference of the two: "
    )
    assert f" {S[3].mean() - S[0].mean():.4f} m s (" in line
    # with nothing to set beside it there is no sentence
    for kept in ([0, 1, 4], [2, 3, 4]):
        fewer = results_of(
            S[kept], [designs[i] for i in kept], uncorrected=2.5, metrics={k: v[kept] for k, v in means.items()}
        )
        assert not any("limit of comfort" in line for line in more_lines(Ranking.of(fewer, bootstrap=200)))
