# ruff: noqa: RUF001 - the page shows true minus signs
"""The fit page as a file: whole, self-contained, complete, and right about what it says."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ldctoolkit.departures import Departures
from ldctoolkit.diagnostics import diagnose
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.scenario_model import ScenarioModel
from studies.fit_page import write_fit_page
from studies.fit_page.figures_pairs import density_levels, pairs_figure
from studies.fit_page.page import SECTIONS


class Checker(HTMLParser):
    """Identifiers, links, and whether every element is closed."""

    VOID = frozenset({"meta", "br", "link", "img"})

    def __init__(self) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.open: list[str] = []
        self.images = 0
        self.titles = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if given.get("id"):
            self.ids.append(str(given["id"]))
        for key in ("href", "src"):
            if given.get(key) and tag != "use":
                (self.links if str(given[key]).startswith("#") else self.sources).append(str(given[key]))
        self.images += given.get("role") == "img"
        self.titles += bool(given.get("aria-labelledby"))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def page(model: ScenarioModel, departures: Departures, tmp_path_factory: pytest.TempPathFactory) -> Path:
    target = tmp_path_factory.mktemp("fit") / "fit.html"
    write_fit_page(target, model, departures, seed=3, png=target.with_suffix(".png"))
    return target


def checked(page: Path) -> tuple[str, Checker]:
    text = page.read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(text)
    assert checker.open == []
    return text, checker


def plain(text: str) -> str:
    """Text without tags and with single spaces."""
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", "", text)))


def test_self_contained_and_well_formed(page: Path) -> None:
    text, found = checked(page)
    assert len(found.ids) == len(set(found.ids))
    assert {link[1:] for link in found.links} <= set(found.ids)
    assert all(source.startswith("data:image/png;base64,") for source in found.sources)
    assert "<script" not in text
    assert not re.search(r"(?:src|href)=\"https?:|@import|url\(http", text)
    # four margins, two maps, one strips and one BIC panel a side, pairs, and four calibration panels
    assert found.images == found.titles == 2 * (4 + 2 + 1 + 1 + 1) + 4
    assert {name for name, _ in SECTIONS} <= set(found.ids)
    assert len(text) < 5_000_000


def test_says_what_it_is_about(page: Path, model: ScenarioModel) -> None:
    text = plain(page.read_text(encoding="utf-8"))
    for said in (
        "Left: 400 departures, K = 2",
        "seed 7",
        "ldctoolkit 0.1.0",
        model.content_hash[:12],
        "from 3 recordings; 1.5 hours; a & b.csv",
        "left: 2 events had dy exactly on a bound, moved just inside",
        "−950.5",
        "830.5",  # K = 1 above the least: -120 + 950.5
        "Seed of the checks",
    ):
        assert said in text, said
    assert text.index("Warnings") < text.index("Margins")
    # a constant parameter has its row, without numbers
    assert "initial curvature, outwardconstantconstant" in text


def test_units_stand_on_the_axes(page: Path) -> None:
    text = plain(page.read_text(encoding="utf-8"))
    for label in ("T [s]", "dy [m]", "vmean [m/s]", "amean [m/s²]", "Share per bin [%]", "Share per cell [%]"):
        assert label in text, label


def test_png(page: Path) -> None:
    data = page.with_suffix(".png").read_bytes()
    assert data.startswith(b"\x89PNG")
    width, height = (int.from_bytes(data[i : i + 4], "big") for i in (16, 20))
    assert width > 800
    assert height > 800


@pytest.mark.slow
def test_same_input_same_bytes(page: Path, model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    write_fit_page(tmp_path / "again.html", model, departures, seed=3)
    assert (tmp_path / "again.html").read_bytes() == page.read_bytes()
    assert [p.name for p in tmp_path.iterdir()] == ["again.html"]


@pytest.mark.slow
def test_a_foreign_model_without_summaries(tmp_path: Path, make: ModuleType, departures: Departures) -> None:
    bare = make.make_model(left=None, right=None, source={}, software="", synthetic=True)
    write_fit_page(tmp_path / "fit.html", bare, departures)
    text = plain(checked(tmp_path / "fit.html")[0])
    assert "the model does not say how its K = 2 was chosen" in text
    assert "the model is synthetic" in text


@pytest.mark.slow
def test_a_misfit_is_warned_of_first(
    tmp_path: Path, make: ModuleType, model: ScenarioModel, departures: Departures
) -> None:
    rows = make.skewed(departures)
    write_fit_page(tmp_path / "fit.html", model, rows.take(np.arange(100, 800)))
    text = plain(checked(tmp_path / "fit.html")[0])
    warned = text[: text.index("Share of events (bars)")]
    assert "Kolmogorov distance beyond" in warned
    assert "left: the model's mass next to bounds is not that of the events: dy lower" in warned
    assert "left: the model was fitted to 400 departures and is checked here against 300 others" in warned
    assert "right: the model was fitted" not in warned


@pytest.mark.slow
def test_hostile_text_is_escaped(tmp_path: Path, make: ModuleType, departures: Departures) -> None:
    evil = "<script>alert(1)</script>"
    model = make.make_model(source={"description": evil}, software=evil, warnings=(evil,))
    write_fit_page(tmp_path / "fit.html", model, departures)
    text, _ = checked(tmp_path / "fit.html")
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)" in text


@pytest.mark.slow
def test_weights_reach_the_checks(tmp_path: Path, model: ScenarioModel, departures: Departures) -> None:
    weights = np.where(np.median(departures.T) > departures.T, 5.0, 1.0)
    write_fit_page(tmp_path / "fit.html", model, departures, weights=weights)
    assert "Kolmogorov distance beyond" in plain((tmp_path / "fit.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_nothing_is_left_of_a_page_that_cannot_be_made(tmp_path: Path, make: ModuleType, model: ScenarioModel) -> None:
    rows = make.make_departures(model, 20)
    with pytest.raises(InputError, match=r"departures \(right\)"):
        write_fit_page(tmp_path / "fit.html", model, rows.take(rows.side == 1))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(StoreError, match="cannot be written"):
        write_fit_page(tmp_path / "none" / "fit.html", model, rows)


def test_importing_it_is_light() -> None:
    code = "import sys, studies.fit_page; print([m for m in ('matplotlib', 'jinja2', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_pairs_stand_where_their_axes_say(make: ModuleType, model: ScenarioModel, departures: Departures) -> None:
    """Rows are vertical axes, columns horizontal ones; events below the diagonal, the model above."""
    rows = departures.take(departures.side == 1)
    X = np.column_stack([getattr(rows, name) for name in make.NAMES])
    found = diagnose(model.left_side, X, n_model=5000)
    d = len(make.NAMES)
    figure = pairs_figure(found, "left")
    for i in range(d):
        for j in range(d):
            axes = figure.axes[i * d + j]
            if i == j:
                assert not axes.images
                continue
            drawn = np.asarray(axes.images[0].get_array().filled(0.0)) ** 2
            x, y = axes.images[0].get_extent()[:2], axes.images[0].get_extent()[2:]
            assert x == pytest.approx(found.marginals[j].edges[[0, -1]])
            assert y == pytest.approx(found.marginals[i].edges[[0, -1]])
            if i > j:
                pair = next(p for p in found.pairs if (p.first, p.second) == (make.NAMES[j], make.NAMES[i]))
                want = np.histogram2d(X[:, i], X[:, j], [pair.second_edges, pair.first_edges])[0] / len(X)
            else:
                pair = next(p for p in found.pairs if (p.first, p.second) == (make.NAMES[i], make.NAMES[j]))
                want = pair.model
            np.testing.assert_allclose(drawn, want, atol=1e-12)


def test_contour_levels_hold_their_shares() -> None:
    share = np.random.default_rng(0).dirichlet(np.ones(900)).reshape(30, 30)
    low, high = density_levels(share, (0.9, 0.5))
    assert share[share >= low].sum() == pytest.approx(0.9, abs=0.01)
    assert share[share >= high].sum() == pytest.approx(0.5, abs=0.01)
