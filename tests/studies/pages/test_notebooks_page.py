"""The guide to notebooks is run as it stands, in a folder of its own."""

from __future__ import annotations

import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest

import ldctoolkit
import studies
from ldctoolkit import Outcome
from studies import Ranking, StudyResults

matplotlib.use("agg")
PAGE = Path(__file__).resolve().parents[3] / "docs" / "notebooks.md"


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S):
        exec(compile(code, "notebooks.md", "exec"), scope)
    assert len(plt.get_fignums()) == 6
    plt.close("all")
    for name, kind in (("ranking", Ranking), ("results", StudyResults), ("outcome", Outcome)):
        shown = scope[name]
        assert isinstance(shown, kind)
        assert shown._repr_html_().startswith("<div")


def test_the_page_names_every_plot_and_pages_that_exist() -> None:
    text = PAGE.read_text(encoding="utf-8")
    plots = {name for module in (studies, ldctoolkit) for name in module.__all__ if name.startswith("plot_")}
    assert plots == set(re.findall(r"\| `(plot_\w+)\(", text))
    for link in re.findall(r"\]\(([\w/.-]+)\)", text):
        assert (PAGE.parent / link).exists(), link
