# ruff: noqa: RUF001 - the page shows true minus signs
"""The fit page as a file: whole, self-contained, complete, and right about what it says."""

from __future__ import annotations

import dataclasses
import html
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from markupsafe import Markup

from helpers.fits import make_departures, make_model, skewed
from helpers.pages import EVIL, Page, whole
from ldctoolkit.departures import Departures
from ldctoolkit.diagnostics import ModelDiagnostics, diagnose_model
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.scenario_model import ScenarioModel
from studies.fit_page import write_fit_page
from studies.fit_page.figures import density_levels, pairs_figure
from studies.fit_page.page import SECTIONS, render_page


@pytest.fixture(scope="module")
def model() -> ScenarioModel:
    return make_model()


@pytest.fixture(scope="module")
def departures(model: ScenarioModel) -> Departures:
    return make_departures(model)


@pytest.fixture(scope="module")
def found(model: ScenarioModel, departures: Departures) -> ModelDiagnostics:
    return diagnose_model(model, departures, seed=3)


@pytest.fixture(scope="module")
def page(model: ScenarioModel, found: ModelDiagnostics) -> Page:
    return Page(render_page(model, found, seed=3))


@pytest.mark.slow
def test_self_contained_and_well_formed(page: Page) -> None:
    whole(page)
    assert page.counts["script"] == 0
    # four margins, two maps, one strips and one BIC panel a side, pairs, and four calibration panels
    assert len(page.images) == 2 * (4 + 2 + 1 + 1 + 1) + 4
    assert {name for name, _ in SECTIONS} <= set(page.ids)
    assert len(page.html) < 5_000_000


@pytest.mark.slow
def test_says_what_it_is_about(page: Page, model: ScenarioModel) -> None:
    text = page.all_words
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
        "800departures400 left, 400 right",
        "2 / 2components Kleft / right",
    ):
        assert said in text, said
    assert page.html.index("Warnings") < page.html.index("Margins")
    rows = {row[0]: row[1:] for table in page.filled("calibration") for row in table}
    assert set(rows["c0 [1/m] initial curvature, outward"]) == {"constant"}
    for label in ("T [s]", "dy [m]", "vmean [m/s]", "amean [m/s²]", "Share per bin [%]", "Share per cell [%]"):
        assert label in page.drawn, label


def test_numbers_are_those_of_the_diagnosis(model: ScenarioModel, found: ModelDiagnostics) -> None:
    """Numbers that no other could be taken for, in the place of what the diagnosis found."""
    every = found.left.calibrations
    far = dataclasses.replace(every[1], distance=0.4321, limit=0.1234)
    strip = dataclasses.replace(found.right.strips[0], error=-0.87, standard_error=0.11)
    left = dataclasses.replace(found.left, events=123, calibrations=(every[0], far, *every[2:]))
    right = dataclasses.replace(found.right, strips=(strip, *found.right.strips[1:]))
    with mock.patch("studies.fit_page.page.inline_svg", return_value=Markup("")):
        page = Page(render_page(model, dataclasses.replace(found, left=left, right=right), seed=3))
    text = page.words("warnings")
    assert "523departures123 left, 400 right" in text
    assert "43.21 %Kolmogorov distance of dy, leftthe worst against its limit, 12.34 %" in text
    assert f"−87 %mass next to the {strip.end} bound of {strip.name.replace('_', '')}, right" in text
    assert "the largest error at a bound, standard error 11 %" in text
    (row,) = (row for row in page.captioned("Kolmogorov distances") if row[0].startswith("dy [m]"))
    assert row[1:3] == ["43.21", "12.34"]
    assert row[4] == f"{100 * found.right.calibrations[1].distance:.2f}"


def test_pairs_stand_where_their_axes_say(found: ModelDiagnostics, departures: Departures) -> None:
    """Rows are vertical axes, columns horizontal ones; events below the diagonal, the model above."""
    rows, names = departures.take(departures.side == 1), found.left.names
    X, d = np.column_stack([getattr(rows, name) for name in names]), len(names)
    axes = pairs_figure(found.left, "left").axes
    for i, j in ((2, 0), (0, 2)):
        image = axes[i * d + j].images[0]
        assert image.get_extent()[:2] == pytest.approx(found.left.marginals[j].edges[[0, -1]])
        assert image.get_extent()[2:] == pytest.approx(found.left.marginals[i].edges[[0, -1]])
        (pair,) = (one for one in found.left.pairs if {one.first, one.second} == {names[0], names[2]})
        events = np.histogram2d(X[:, 2], X[:, 0], [pair.second_edges, pair.first_edges])[0] / len(X)
        np.testing.assert_allclose(image.get_array().filled(0.0) ** 2, events if i > j else pair.model, atol=1e-12)


@pytest.mark.slow
def test_the_file_is_the_page_and_the_picture_is_large(
    page: Page, model: ScenarioModel, departures: Departures, tmp_path: Path
) -> None:
    write_fit_page(tmp_path / "fit.html", model, departures, seed=3, png=tmp_path / "fit.png")
    assert (tmp_path / "fit.html").read_text(encoding="utf-8") == page.html
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.html", "fit.png"]
    data = (tmp_path / "fit.png").read_bytes()
    assert data.startswith(b"\x89PNG")
    assert min(int.from_bytes(data[i : i + 4], "big") for i in (16, 20)) > 800


@pytest.mark.slow
def test_a_foreign_model_without_summaries(tmp_path: Path, departures: Departures) -> None:
    bare = make_model(left=None, right=None, source={}, software="", synthetic=True)
    write_fit_page(tmp_path / "fit.html", bare, departures)
    text = Page((tmp_path / "fit.html").read_text(encoding="utf-8")).all_words
    assert "the model does not say how its K = 2 was chosen" in text
    assert "the model is synthetic" in text


@pytest.mark.slow
def test_a_misfit_is_warned_of_first(tmp_path: Path, model: ScenarioModel, departures: Departures) -> None:
    write_fit_page(tmp_path / "fit.html", model, skewed(departures).take(np.arange(100, 800)))
    warned = Page((tmp_path / "fit.html").read_text(encoding="utf-8")).words("warnings")
    assert "Kolmogorov distance beyond" in warned
    assert "left: the model's mass next to bounds is not that of the events: dy lower" in warned
    assert "left: the model was fitted to 400 departures and is checked here against 300 others" in warned
    assert "right: the model was fitted" not in warned


@pytest.mark.slow
def test_hostile_text_is_escaped(tmp_path: Path, departures: Departures) -> None:
    model = make_model(source={"description": EVIL}, software=EVIL, warnings=(EVIL,))
    write_fit_page(tmp_path / "fit.html", model, departures)
    page = Page((tmp_path / "fit.html").read_text(encoding="utf-8"))
    assert page.counts["script"] == 0
    assert "<script>alert(1)" in page.all_words


@pytest.mark.slow
def test_weights_reach_the_checks(tmp_path: Path, model: ScenarioModel, departures: Departures) -> None:
    weights = np.where(np.median(departures.T) > departures.T, 5.0, 1.0)
    write_fit_page(tmp_path / "fit.html", model, departures, weights=weights)
    assert "Kolmogorov distance beyond" in html.unescape((tmp_path / "fit.html").read_text(encoding="utf-8"))


@pytest.mark.slow
def test_nothing_is_left_of_a_page_that_cannot_be_made(tmp_path: Path, model: ScenarioModel) -> None:
    rows = make_departures(model, 20)
    with pytest.raises(InputError, match=r"departures \(right\)"):
        write_fit_page(tmp_path / "fit.html", model, rows.take(rows.side == 1))
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(StoreError, match="cannot be written"):
        write_fit_page(tmp_path / "none" / "fit.html", model, rows)


def test_contour_levels_hold_their_shares() -> None:
    share = np.random.default_rng(0).dirichlet(np.ones(900)).reshape(30, 30)
    low, high = density_levels(share, (0.9, 0.5))
    assert share[share >= low].sum() == pytest.approx(0.9, abs=0.01)
    assert share[share >= high].sum() == pytest.approx(0.5, abs=0.01)
