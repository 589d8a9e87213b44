# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The fit page as a file: whole, self-contained, its verdict first, right about what it says."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from helpers.fits import make_departures, make_model, skewed
from helpers.pages import EVIL, Page, whole
from ldctoolkit.departures import Departures
from ldctoolkit.diagnostics import ModelDiagnostics, diagnose_model
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.scenario_model import ScenarioModel
from studies.pages.fit_page import fit_page, write_fit_page

SECTIONS = ["verdict", "margins", "joint", "calibration", "bounds", "components", "selection", "settings"]


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
    return Page(fit_page(model, found, seed=3))


def verdicts(model: ScenarioModel, found: ModelDiagnostics) -> str:
    return Page(fit_page(model, found, seed=3)).words("verdict")


def test_self_contained_and_well_formed(page: Page) -> None:
    whole(page)
    assert [section for section in page.text if section] == SECTIONS
    assert len(page.html) < 1_000_000
    assert len(page.images) >= 2 * 4 + 4 + 4 + 1


def test_the_verdict_says_what_it_is_good_enough_for(model: ScenarioModel, found: ModelDiagnostics) -> None:
    words = verdicts(model, found)
    assert words.startswith(
        "Verdict Left: good enough for comparing mean S of designs; too few departures (400) for rare"
    )
    few = dataclasses.replace(found, left=dataclasses.replace(found.left, effective_events=80.0))
    assert "Left: too few departures for a model (80; 150 at least): rank designs on the recorded" in verdicts(
        model, few
    )
    many = dataclasses.replace(found, right=dataclasses.replace(found.right, effective_events=5000.0))
    assert "Right: good enough for comparing designs, in their mean S and in the worst 5 %" in verdicts(model, many)
    first, *others = found.left.calibrations
    off = (dataclasses.replace(first, distance=0.3, limit=0.1), *others)
    misfit = dataclasses.replace(found, left=dataclasses.replace(found.left, calibrations=off))
    assert "Left: misfit in T: good enough for designs that do not depend on it" in verdicts(model, misfit)


def test_says_what_it_is_about(page: Page, model: ScenarioModel) -> None:
    for text in (
        "left: 400 departures, K = 2", "ldctoolkit 0.1.0", model.content_hash[:12], "from 3 recordings; 1.5 "
            "hours; a & b.csv",
        "2 events had dy exactly on a bound, moved just inside", "−950.5", "830.5", "Seed of the checks",
    ):  # fmt: skip
        assert text in page.all_words, text
    rows = {row[0]: row[1:] for table in page.filled("calibration") for row in table}
    assert rows["c0 [1/m]: initial curvature, outward"] == ["constant", "", "", "constant", "", ""]


def test_numbers_are_those_of_the_diagnosis(model: ScenarioModel, found: ModelDiagnostics) -> None:
    """Numbers that no other could be taken for, in the place of what the diagnosis found."""
    every = found.left.calibrations
    far = dataclasses.replace(every[1], distance=0.4321, limit=0.1234)
    left = dataclasses.replace(found.left, events=123, calibrations=(every[0], far, *every[2:]))
    made = Page(fit_page(model, dataclasses.replace(found, left=left), seed=3))
    rows = {row[0]: row[1:] for row in made.filled("calibration")[0]}
    assert rows["dy [m]: peak lateral departure"][:2] == ["43.21", "12.34"]
    assert "checked here against 123 others" in made.words("verdict")


def test_warnings_are_merged_by_cause(model: ScenarioModel, found: ModelDiagnostics) -> None:
    both = dataclasses.replace(
        found,
        left=dataclasses.replace(found.left, warnings=("left: the fit stopped before it had converged",)),
        right=dataclasses.replace(found.right, warnings=("right: the fit stopped before it had converged",)),
    )
    words = verdicts(model, both)
    assert "left and right: the fit stopped before it had converged" in words
    assert words.count("stopped before") == 1


def test_warnings_do_not_contradict_each_other() -> None:
    """K at its largest asked for more components, though those that there were carried too few events."""
    model = make_model()
    summary = dataclasses.replace(
        model.provenance.left, n_components=(1, 2), bic=(-120.0, -950.5), log_likelihood=(0.1, 1.2)
    )
    held = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, left=summary, right=summary))
    few = diagnose_model(held, make_departures(model, 30), seed=3)
    (one,) = [text for text in few.left.warnings if "largest that was tried" in text]
    assert "more departures are needed, not more components" in one
    assert "try more" not in " ".join(few.left.warnings)
    enough = diagnose_model(held, make_departures(model, 400), seed=3)
    assert any(text.endswith("the best may be larger: try more") for text in enough.left.warnings)


def test_no_warnings(model: ScenarioModel, found: ModelDiagnostics) -> None:
    quiet = dataclasses.replace(
        found, left=dataclasses.replace(found.left, warnings=()), right=dataclasses.replace(found.right, warnings=())
    )
    assert "No warnings: no check of this page found anything." in verdicts(model, quiet)


def test_users_text_stays_text(found: ModelDiagnostics) -> None:
    evil = make_model(source={"description": EVIL}, warnings=(EVIL,), software=EVIL)
    page = Page(fit_page(evil, found, seed=3))
    assert "<script>alert(1)" not in page.html
    assert "alert(1)" in page.words("verdict")
    assert "\u202e" not in page.html


def test_the_same_bytes(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_fit_page(tmp_path / name, model, departures, seed=3)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_drawn_departures_are_named(model: ScenarioModel, tmp_path: Path) -> None:
    write_fit_page(tmp_path / "p", model, make_departures(model, 200), drawn=True)
    assert "of them, drawn at random" in Page((tmp_path / "p").read_text(encoding="utf-8")).words("verdict")


def test_skewed_departures_are_a_misfit(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    write_fit_page(tmp_path / "p", model, skewed(departures))
    assert "misfit in" in Page((tmp_path / "p").read_text(encoding="utf-8")).words("verdict")


def test_too_few_and_nowhere_to_write(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write_fit_page(tmp_path / "p", model, make_departures(model, 3))
    assert not (tmp_path / "p").exists()
    with pytest.raises(StoreError):
        write_fit_page(tmp_path / "no" / "p", model, departures)
