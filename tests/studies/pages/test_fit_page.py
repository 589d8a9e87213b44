# ruff: noqa: RUF001
"""The pages of a fit and of an extraction."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from helpers.models import checked_model, make_departures, make_model, skewed
from helpers.pages import EVIL, Page, whole
from helpers.recordings import drive, make_extraction
from ldctoolkit.departures import Departures
from ldctoolkit.diagnostics import ModelDiagnostics, diagnose_model
from ldctoolkit.errors import InputError, StoreError
from ldctoolkit.recordings import Extraction, SourceFile, extract_departures
from ldctoolkit.recordings.extraction_statistics import Origin
from ldctoolkit.recordings.find_departures import REASONS
from ldctoolkit.recordings.recording import Problem
from ldctoolkit.scenario_model import ScenarioModel
from ldctoolkit.studies.pages.extraction_page import (
    extraction_page,
    extraction_verdict,
    hours,
    rate,
    size,
    write_extraction_page,
)
from ldctoolkit.studies.pages.fit_page import fit_page, write_fit_page

SECTIONS = ["verdict", "fidelity", "margins", "joint", "selection", "settings"]


@pytest.fixture(scope="module")
def model() -> ScenarioModel:
    return make_model()


@pytest.fixture(scope="module")
def departures(model: ScenarioModel) -> Departures:
    return make_departures(model)


@pytest.fixture(scope="module")
def diagnostics(model: ScenarioModel, departures: Departures) -> ModelDiagnostics:
    return diagnose_model(model, departures, seed=3)


@pytest.fixture(scope="module")
def page(model: ScenarioModel, diagnostics: ModelDiagnostics) -> Page:
    return Page(fit_page(model, diagnostics, seed=3))


def with_left(diagnostics: ModelDiagnostics, **changes: object) -> ModelDiagnostics:
    return dataclasses.replace(diagnostics, left=dataclasses.replace(diagnostics.left, **changes))  # type: ignore[arg-type]


def verdicts(model: ScenarioModel, diagnostics: ModelDiagnostics) -> str:
    return Page(fit_page(model, diagnostics, seed=3)).words("verdict")


def test_self_contained_and_well_formed(page: Page) -> None:
    whole(page)
    assert [section for section in page.text if section] == SECTIONS
    assert len(page.html) < 1_000_000
    assert len(page.images) == 2 * 4 + 2 * 2 + 1  # margins, joint densities, BIC


def test_the_recordings_answer_is_drawn_and_its_table_folded(diagnostics: ModelDiagnostics) -> None:
    """Five charts a side, twelve rows each; one answer outside is crossed, and said under the pointer."""
    html = fit_page(checked_model(), diagnostics, seed=3)
    page = Page(html)
    whole(page)
    drawn = [name for name in page.images if "test designs" in name]
    assert drawn == [
        f"{side}: {quantity} of the test designs, replayed and generated"
        for side in ("left", "right")
        for quantity in ("reduction", "trigger share", "needless", "added a_y p95", "depth p95")
    ]
    section = html[html.index('id="fidelity"') : html.index('id="margins"')]
    assert section.count(">feedback 1 rad/s, 0.23 m</text>") == 10
    tip = "Preview P, y_s = 0.06 m: model 46.0, replayed 40.0 (36.0 to 44.0)"
    assert section.count(f"<title>{tip}</title>") == 2  # of the interval, and of the model's cross
    assert section.count("m0 -8l-8 8") == 2  # the cross in the chart and in the left legend
    assert "model, outside" in section[: section.index("<h3>Right</h3>")]
    assert "model, outside" not in section[section.index("<h3>Right</h3>") :]
    folded = section[section.index("<details>") :]
    assert (section.count("<table"), folded.count("<table"), folded.count("<tr")) == (2, 2, 2 * 13)
    assert folded.count('class="n bad"') == 1


def test_the_verdict_says_what_it_is_good_enough_for(model: ScenarioModel, diagnostics: ModelDiagnostics) -> None:
    words = verdicts(model, diagnostics)
    assert words.startswith(
        "Verdict Left: Good enough for comparing mean S of designs; too few departures (400) for rare"
    )
    first, *others = diagnostics.left.calibrations
    off = (dataclasses.replace(first, distance=0.3, limit=0.1), *others)
    for changes, text in (
        ({"effective_events": 80.0}, "Left: too few departures for a model (80; 150 at least): rank designs on"),
        ({"effective_events": 5000.0}, "Left: Good enough for comparing designs, in their mean S and in the worst 5 %"),
        ({"calibrations": off}, "Left: Misfit in T: good enough for designs that do not depend on it"),
    ):
        assert text in verdicts(model, with_left(diagnostics, **changes))


def test_says_what_it_is_about(page: Page, model: ScenarioModel) -> None:
    for text in (
        "left: 400 departures, K = 2", "ldctoolkit 0.1.0", model.content_hash[:12], "from 3 recordings; 1.5 "
            "hours; 72 km; a & b.csv",
        "2 events had dy exactly on a bound, moved just inside", "−950.5", "830.5", "Seed of the checks",
    ):  # fmt: skip
        assert text in page.all_words, text
    rows = {row[0]: row[1:] for table in page.filled("margins") for row in table}
    assert rows["c0 [1/m]: initial curvature, outward"] == ["constant", "", "", "constant", "", ""]


def test_numbers_are_those_of_the_diagnosis(model: ScenarioModel, diagnostics: ModelDiagnostics) -> None:
    """Numbers that no other could be taken for, in the place of what the diagnosis found."""
    every = diagnostics.left.calibrations
    far = dataclasses.replace(every[1], distance=0.4321, limit=0.1234)
    changed = with_left(diagnostics, events=123, calibrations=(every[0], far, *every[2:]))
    page = Page(fit_page(model, changed, seed=3))
    rows = {row[0]: row[1:] for row in page.filled("margins")[0]}
    assert rows["dy [m]: peak lateral departure"][:2] == ["43.21", "12.34"]
    assert "checked here against 123 others" in page.words("verdict")


def test_the_chosen_k_and_its_neighbours(page: Page) -> None:
    left, right = page.filled("selection")
    assert left == right
    assert left[-2:] == [["2 *", "", "1.2000", "−950.5", "0.0"], ["3", "", "1.2500", "−930.0", "20.5"]]


def test_warnings_of_the_model_stand_beside_those_of_the_diagnosis(diagnostics: ModelDiagnostics) -> None:
    """Of components the diagnosis says nothing; that a fit did not converge it says itself."""
    words = verdicts(
        make_model(warnings=("left: Component 0 (1 events): few.", "left: Not converged in 9 passes.")), diagnostics
    )
    assert "left: Component 0 (1 events): few." in words
    assert "in 9 passes" not in words


def test_warnings_are_merged_by_cause(model: ScenarioModel, diagnostics: ModelDiagnostics) -> None:
    for warnings, text in (
        (("the fit stopped before it had converged",), "left and right: the fit stopped before it had converged"),
        ((), "No warnings: all checks passed."),
    ):
        right = dataclasses.replace(diagnostics.right, warnings=warnings)
        words = verdicts(model, dataclasses.replace(with_left(diagnostics, warnings=warnings), right=right))
        assert words.count(text) == 1
        assert words.count("stopped before") == len(warnings)


def test_users_text_stays_text(diagnostics: ModelDiagnostics) -> None:
    evil = make_model(source={"description": EVIL}, warnings=(EVIL,), software=EVIL)
    page = Page(fit_page(evil, diagnostics, seed=3))
    assert "<script>alert(1)" not in page.html
    assert "alert(1)" in page.words("verdict")
    assert "\u202e" not in page.html


def test_the_same_bytes(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_fit_page(tmp_path / name, model, departures, seed=3)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_skewed_departures_are_a_misfit(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    write_fit_page(tmp_path / "p", model, skewed(departures))
    assert "Misfit in" in Page((tmp_path / "p").read_text(encoding="utf-8")).words("verdict")


def test_too_few_and_nowhere_to_write(model: ScenarioModel, departures: Departures, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        write_fit_page(tmp_path / "p", model, make_departures(model, 3))
    assert not (tmp_path / "p").exists()
    with pytest.raises(StoreError):
        write_fit_page(tmp_path / "no" / "p", model, departures)


SECTIONS_EXTRACTION_PAGE = ["verdict", "read", "sides", "refusals", "parameters", "widths", "deepest", "random"]


def parsed(extraction: Extraction) -> Page:
    page_extraction_page = Page(extraction_page(extraction))
    whole(page_extraction_page)
    assert [section for section in page_extraction_page.text if section] == SECTIONS_EXTRACTION_PAGE
    return page_extraction_page


@pytest.fixture(scope="module")
def three() -> Extraction:
    return make_extraction(3, (30, 20), labels=True)


@pytest.fixture(scope="module")
def page_extraction_page(three: Extraction) -> Page:
    return parsed(three)


def test_the_verdict_says_what_the_departures_are_enough_for(page_extraction_page: Page) -> None:
    assert page_extraction_page.words("verdict").startswith(
        "Verdict Enough to compare designs on the recorded departures; too few for a model (60 right;"
    )
    assert extraction_verdict(0, 0).startswith("No departures were found")
    assert extraction_verdict(400, 12) == "Too few departures for a model of both sides (12 right; 30 a side at least)."
    assert extraction_verdict(200, 300).startswith("Good enough for a scenario model and mean S of designs; too few")
    assert extraction_verdict(1000, 2000).startswith("Good enough for a scenario model, and for the worst 5 %")


def test_every_row_holds_the_numbers_of_its_account(three: Extraction, page_extraction_page: Page) -> None:
    rows = page_extraction_page.captioned("By source")[1:]
    assert [row[0] for row in rows] == ["D1", "D2", "D3", "All"]
    for row, account in zip(rows, three.accounts, strict=False):
        assert row[1:8] == ["4", "2.00", "1.67", "30", "20", "18.0", "12.0"]
        assert row[8] == str(int(account.refused.sum()))
    assert rows[3][:6] == ["All", "12", "6.00", "5.00", "90", "60"]
    assert rows[3][8] == f"{three.refused.total:,}"


def test_the_first_numbers_are_those_of_all_accounts(three: Extraction, page_extraction_page: Page) -> None:
    refused = sum(account.refused.sum(axis=0) for account in three.accounts)
    most = REASONS[int(np.argmax(refused))].replace("_", " ")
    candidates = 150 + int(refused.sum())
    words = page_extraction_page.words("verdict")
    assert "5.00 h of 6.00 h read are valid (83 %)" in words
    assert "5.00 h valid, 360 km" in page_extraction_page.all_words
    assert f"{refused.sum():,} of {candidates:,} candidates were refused, most often: {most}." in words
    assert "12 recordings, 216,000 samples, 180,000 of them valid" in page_extraction_page.words("read")


def test_reasons_are_counted_by_source_and_side() -> None:
    extraction = make_extraction(2)
    page = parsed(extraction)
    table = page.captioned(f"{extraction.refused.total} of {extraction.candidates} candidates refused, by reason")
    by_reason = {row[0].replace(" ", "_"): row[2:] for row in table[1:]}
    assert list(by_reason) == [reason for reason, count in extraction.refused.items() if count]
    for reason, (left, right, share) in by_reason.items():
        count = getattr(extraction.refused, reason)
        assert int(left) + int(right) == count
        assert float(share) == pytest.approx(100 * count / extraction.candidates, abs=0.051)


def test_nothing_refused_and_nothing_read() -> None:
    extraction = make_extraction(1)
    nothing = dataclasses.replace(extraction.accounts[0], refused=np.zeros_like(extraction.accounts[0].refused))
    assert "No candidate was refused" in parsed(dataclasses.replace(extraction, accounts=(nothing,))).text["refusals"]
    assert "Nothing was read from these recordings." in parsed(extract_departures([])).words("sides")


def test_groups_by_label() -> None:
    """Six drivers, three behaviours; one more source without labels."""
    extraction = make_extraction(6, (30, 20), labels=True)
    bare = dataclasses.replace(extraction.accounts[0], origin=Origin("D9"))
    page = parsed(dataclasses.replace(extraction, accounts=(*extraction.accounts, bare)))
    rows = page.captioned("By behaviour")[1:]
    assert [row[0] for row in rows] == ["aggressive", "drowsy", "normal", "not known"]
    assert [row[4] for row in rows] == ["60", "60", "60", "30"]


def test_parameters_are_those_of_the_departures(three: Extraction, page_extraction_page: Page) -> None:
    rows = {row[0]: row[1:] for row in page_extraction_page.captioned("Parameters in numbers")[1:]}
    left = three.departures.T[three.departures.side == 1]
    assert [float(cell) for cell in rows["T [s]: duration"][:3]] == pytest.approx(
        np.quantile(left, (0.05, 0.5, 0.95)), rel=6e-3
    )
    medians = {row[0]: row for row in page_extraction_page.captioned("Medians of both sides")[1:]}
    assert medians["D2"][1] == "50"


def test_a_curvature_of_zero_everywhere_is_no_curvature(three: Extraction) -> None:
    """It was called recorded by the source."""
    measured = dataclasses.replace(three, provenance=dataclasses.replace(three.provenance, curvature="measured"))
    assert "recorded by the source" in parsed(measured).words("read")
    zero = np.zeros(three.departures.n)
    flat = dataclasses.replace(measured, departures=dataclasses.replace(three.departures, c_0=zero, dc=zero))
    words = parsed(flat).words("read")
    assert "0 in every departure: the source gives no curvature" in words
    assert "recorded by the source" not in words


def test_problems_and_warnings_are_counted_and_text() -> None:
    extraction = make_extraction(1)
    problems = tuple(Problem(f"f{i}.csv", f"line {i}", EVIL) for i in range(400))
    many = dataclasses.replace(extraction.provenance, warnings=tuple(f"{EVIL} {i}" for i in range(70)))
    page = parsed(dataclasses.replace(extraction, problems=problems, provenance=many))
    assert "the first 300 of 400" in page.words("verdict")
    assert "and 10 more warnings" in page.words("verdict")
    assert "<script>alert(1)" not in page.html
    assert "No problems: every file was read whole." in parsed(dataclasses.replace(extraction, problems=())).words(
        "verdict"
    )


def test_files_are_listed() -> None:
    extraction = make_extraction(1)
    files = tuple(SourceFile(f"a{i}.csv", 1500 * (i + 1), f"{i:064d}") for i in range(3))
    given = dataclasses.replace(extraction, provenance=dataclasses.replace(extraction.provenance, sources=files))
    assert ["a1.csv", "3.0 kB", "000000000000"] in parsed(given).filled("read")[0]


def test_single_departures_are_drawn(page_extraction_page: Page) -> None:
    assert sum("samples and fit" in image for image in page_extraction_page.images) == 2 * 2 * 4 * 3
    assert "d_y" not in page_extraction_page.words("deepest")
    assert "dy = " in page_extraction_page.words("deepest")


def test_one_real_drive(tmp_path: Path) -> None:
    extraction = extract_departures([drive()])
    path = write_extraction_page(tmp_path / "q.html", extraction)
    whole(Page(path.read_text(encoding="utf-8")))
    assert path.read_bytes() == write_extraction_page(tmp_path / "r.html", extraction).read_bytes()
    with pytest.raises(StoreError):
        write_extraction_page(tmp_path / "no" / "q.html", extraction)


def test_numbers_of_any_size() -> None:
    assert [size(n) for n in (999, 1000, 99_950, 1_500_000, 10**15)] == [
        "999 B",
        "1.0 kB",
        "100 kB",
        "1.5 MB",
        "1000 TB",
    ]
    assert [rate(x) for x in (0.05, 2.345, 12.34, 123.4, float("nan"))] == ["0.050", "2.35", "12.3", "123", "–"]
    assert [hours(x) for x in (1.234, 12.34, 1234.5)] == ["1.23", "12.3", "1,234"]
