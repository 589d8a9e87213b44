# ruff: noqa: RUF001 - the page shows true minus signs and dashes
"""The page of an extraction: whole, self-contained, right about every number, for every kind of extraction."""

from __future__ import annotations

import dataclasses
import html
import statistics
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from helpers.extractions import make_extraction
from helpers.pages import EVIL, Page, whole
from helpers.recordings import drive
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import StoreError
from ldctoolkit.recordings import (
    Criteria,
    Extraction,
    Preparation,
    SourceFile,
    extract_departures,
    recording_reader,
)
from ldctoolkit.recordings.account import Origin
from ldctoolkit.recordings.events import REASONS
from ldctoolkit.recordings.recording import Label, Problem
from studies.extraction_page import write_extraction_page
from studies.extraction_page.page import MOST_PROBLEMS, SECTIONS, make_page


def parsed(extraction: Extraction) -> Page:
    return Page(make_page(extraction))


def plain(number: str) -> float:
    return float(number.replace("−", "-").replace(",", ""))


@pytest.fixture(scope="module")
def three() -> Extraction:
    return make_extraction(3, (30, 20), labels=True)


@pytest.fixture(scope="module")
def page(three: Extraction) -> Page:
    return parsed(three)


def test_self_contained_and_well_formed(page: Page) -> None:
    whole(page)
    assert [section for section in page.text if section] == [id for id, _ in SECTIONS]
    assert page.counts["script"] == 0
    # 8 parameters and lane width of 3 sources; of all and of each source 12 departures of each kind and side
    assert len(page.images) == 8 + 1 + 3 + 3 * 9 + 48 + 3 * 48
    assert all(len(words.split()) > 3 for words in page.images)


def test_every_row_holds_the_numbers_of_its_account(three: Extraction, page: Page) -> None:
    extraction, rows = three, page.captioned("By source and side")[2:]
    assert [row[0] for row in rows] == ["D1", "D2", "D3", "All"]
    for row, account in zip(rows, extraction.accounts, strict=False):
        assert row[1:6] == ["4", "2.00", "1.67 (83 %)", "30", "18.0"]
        assert row[6] == str(sum(int(count) for count in account.refused[0]))
        assert row[7:9] == ["20", "12.0"]
        assert row[9] == str(sum(int(count) for count in account.refused[1]))
    assert rows[3][:6] == ["All", "12", "6.00", "5.00 (83 %)", "90", "18.0"]
    assert int(rows[3][6]) + int(rows[3][9]) == extraction.refused.total


def test_the_first_numbers_are_those_of_all_accounts(three: Extraction, page: Page) -> None:
    refused = sum(account.refused.sum(axis=0) for account in three.accounts)
    most = REASONS[int(np.argmax(refused))].replace("_", " ")
    candidates = 150 + int(refused.sum())
    for said in (
        "150departures90 left, 60 right",
        "30.0 1/hdepartures in a valid hour18.0 left, 12.0 right",
        "5.00 hvalid83 % of 6.00 h read",
        f"{refused.sum():,}candidates refused{100 * refused.sum() / candidates:.0f} %; most often: {most}",
        "12 recordings of 3 sources",
    ):
        assert said in page.all_words
    told = {row[0]: row[1] for row in page.captioned("Format and criteria")}
    assert told["Read"] == "12 recordings, 216,000 samples, 180,000 of them valid"
    assert told["Duration"].endswith(" s")


def test_reasons_are_counted_by_source_and_side() -> None:
    extraction = make_extraction(2)
    found = parsed(extraction)
    table = found.captioned(f"{extraction.refused.total} of {extraction.candidates} candidates refused, by reason")
    by_reason = {row[0].replace(" ", "_"): row[2:] for row in table[1:]}
    assert list(by_reason) == [reason for reason, count in extraction.refused.items() if count]
    for reason, (left, right, share) in by_reason.items():
        count = getattr(extraction.refused, reason)
        assert int(left) + int(right) == count
        assert plain(share.split()[0]) == pytest.approx(100 * count / extraction.candidates, abs=0.051)
    table = found.captioned("Refused by source and reason: left / right")
    for row, account in zip(table[1:], extraction.accounts, strict=False):
        for name, cell in zip(table[0][1:], row[1:], strict=True):
            k = REASONS.index(name.replace(" ", "_"))
            counts = [int(account.refused[side, k]) for side in (0, 1)]
            assert cell == (" / ".join(map(str, counts)) if any(counts) else "0")
    assert table[3][0] == "All"


def test_a_reason_that_never_holds_is_left_out() -> None:
    one = make_extraction(1)
    refused = one.accounts[0].refused.copy()
    refused[:, REASONS.index("jump")] = 0
    changed = dataclasses.replace(one, accounts=(dataclasses.replace(one.accounts[0], refused=refused),))
    assert "the offset jumps in it" in parsed(one).text["refusals"]
    assert "the offset jumps in it" not in parsed(changed).text["refusals"]
    nothing = dataclasses.replace(one.accounts[0], refused=np.zeros_like(refused))
    assert "No candidate was refused" in parsed(dataclasses.replace(one, accounts=(nothing,))).text["refusals"]


@pytest.mark.slow
def test_groups_by_label() -> None:
    """Six drivers, three behaviours; one more source without labels."""
    extraction = make_extraction(6, (30, 20), labels=True)
    bare = dataclasses.replace(extraction.accounts[0], origin=Origin("D9"))
    found = parsed(dataclasses.replace(extraction, accounts=(*extraction.accounts, bare)))
    rows = found.captioned("By behaviour and side")[2:]
    assert [row[0] for row in rows] == ["aggressive", "drowsy", "normal", "not known"]
    assert [row[4] for row in rows] == ["60", "60", "60", "30"]
    assert [row[7] for row in rows] == ["40", "40", "40", "20"]
    assert len(found.captioned("By driver and side")) == 2 + 7
    assert "Refused by driver and reason: left / right" in found.captions
    assert "carry no labels" in parsed(make_extraction(1)).text["groups"]


@pytest.mark.slow
def test_values_of_a_label_are_in_the_order_of_their_numbers() -> None:
    found = parsed(make_extraction(100, (1, 1), labels=True))
    drivers = [row[0] for row in found.captioned("By driver and side")[2:]]
    assert drivers == [*(f"D{i}" for i in range(1, 60)), "41 more"]


def test_quantiles_are_those_of_the_departures() -> None:
    extraction = make_extraction(1, (31, 21))
    rows = parsed(extraction).captioned("Parameters in numbers: 5 % quantile, median, 95 % quantile")[2:]
    assert len(rows) == 8
    for row, name in zip(rows, PARAMETER_NAMES, strict=True):
        scale = 1000 if name in ("c_0", "dc") else 1
        for side, cells in ((1, row[1:4]), (-1, row[4:7])):
            values = sorted(
                scale * v
                for v, s in zip(getattr(extraction.departures, name), extraction.departures.side, strict=True)
                if s == side
            )
            middle = values[len(values) // 2]  # odd counts
            assert plain(cells[1]) == pytest.approx(middle, abs=0.051 if name == "v_mean" else 0.0051)
            assert plain(cells[0]) < plain(cells[1]) < plain(cells[2])


def test_medians_of_each_source() -> None:
    extraction = make_extraction(3, (15, 11))
    found = parsed(extraction)
    rows = found.captioned("Each column has one axis")[1:]
    assert [row[0] for row in rows] == ["D1", "D2", "D3"]
    departures = extraction.departures
    source = departures.extra[0].values.tolist()
    for row in rows:
        for cell, name, scale in ((row[1], "T", 1.0), (row[4], "v_mean", 1.0), (row[8], "dc", 1000.0)):
            for said, side in zip(cell.split(" / "), (1, -1), strict=True):
                values = [
                    scale * value
                    for value, s, of in zip(getattr(departures, name), departures.side, source, strict=True)
                    if s == side and of == row[0]
                ]
                assert plain(said) == pytest.approx(
                    statistics.median(values), abs=0.051 if name == "v_mean" else 0.0051
                )


def test_what_was_read_is_told() -> None:
    extraction = make_extraction(
        2,
        criteria=Criteria(vehicle_width=2.05, min_speed=7.0),
        preparation=Preparation(step=0.05, nominal_lane_width=3.5, yaw_rate_factor=-1.0),
    )
    files = (SourceFile("D1/a.txt", 31_400_000, "0123456789abcdef" * 4),)
    provenance = dataclasses.replace(extraction.provenance, sources=files)
    found = parsed(dataclasses.replace(extraction, provenance=provenance))
    told = dict(row for row in found.captioned("Format and criteria")[1:])
    own = recording_reader("uah-driveset").vehicle_width
    assert told["Vehicle width"] == f"2.05 m, given by the user; uah-driveset takes {own:g} m by itself"
    assert told["Time step"] == "0.05 s, by local medians of valid samples"
    assert told["Nominal lane width"].startswith("3.5 m: offset and width of each recording scaled")
    assert told["Mean speed"] == "above 7 m/s"
    assert told["Curvature"] == "from yaw rate and speed; yaw rate times −1"
    assert next(rows for rows in found.filled() if "SHA-256" in str(rows[0]))[1] == [
        "D1/a.txt",
        "31.4 MB",
        "0123456789ab",
    ]
    same = parsed(make_extraction(1, criteria=Criteria(vehicle_width=own)))
    assert dict(row for row in same.captioned("Format and criteria")[1:])["Vehicle width"] == (
        f"{own:g} m, what uah-driveset takes unless another is given"
    )


@pytest.mark.parametrize(
    ("reader", "width", "said"),
    [
        ("other-makers", 1.8, "1.8 m, as given"),
        ("spmd-das1 + spmd-das2", 1.82, "1.82 m, what spmd-das1 + spmd-das2 takes unless another is given"),
    ],
)
def test_other_readers(reader: str, width: float, said: str) -> None:
    told = parsed(make_extraction(1, reader=reader, criteria=Criteria(vehicle_width=width)))
    facts = {row[0]: row[1] for row in told.captioned("Format and criteria")}
    assert facts["Format"].startswith(reader)
    assert facts["Vehicle width"] == said


@pytest.mark.parametrize(
    ("max_gap", "step", "said"),
    [(None, None, "2.5 median steps"), (None, 0.1, "0.25 s between"), (0.4, 0.1, "0.4 s")],
)
def test_the_longest_step_that_is_no_gap(max_gap: float | None, step: float | None, said: str) -> None:
    one = make_extraction(1, criteria=Criteria(max_gap=max_gap), preparation=Preparation(step=step))
    told = dict(row for row in parsed(one).captioned("Format and criteria")[1:])
    assert told["Longest step that is no gap"].startswith(said)


def test_warnings_and_problems_stand_at_the_top() -> None:
    problems = tuple(Problem(f"{k % 7}.txt", f"line {k}", "text where a number is needed") for k in range(1000))
    page = make_page(make_extraction(1, problems=problems, warnings=("the yaw rate turns against the heading",)))
    found = Page(page)
    assert page.index("the yaw rate turns against") < page.index("What was read, and how")
    rows = found.captioned(f"Problems by file and place: the first {MOST_PROBLEMS} of 1,000")
    assert rows[1:] == [[one.file, one.place, one.what] for one in problems[:MOST_PROBLEMS]]
    assert "1,000" in found.text["warnings"]
    quiet = parsed(make_extraction(1)).text["warnings"]
    assert "No warnings" in quiet
    assert "No problems" in quiet


@pytest.mark.parametrize(
    ("sources", "each"),
    [
        (0, (0, 0)),
        (1, (0, 0)),
        (3, (0, 0)),
        (1, (1, 0)),
        (1, (0, 5)),
        (2, (0, 1)),
        (1, (3, 3)),
        (50, (4, 0)),
        (1, (900, 2)),
    ],
)
def test_every_kind_of_extraction(sources: int, each: tuple[int, int]) -> None:
    found = parsed(make_extraction(sources, each, labels=sources == 3))
    words = found.all_words + " ".join(found.images)
    for never in ("nan", "None", "inf ", "Infinity", "Undefined"):
        assert never not in words, never
    assert all(len(found.words(id).split()) > 4 for id, _ in SECTIONS)
    if not sum(each) * sources:
        assert "No departures were found" in found.text["parameters"]
        assert "No departures were found" in found.text["deepest"]


def test_hours_of_nothing_valid() -> None:
    one = make_extraction(2, (0, 0))
    accounts = tuple(
        dataclasses.replace(a, valid_ns=0, read_ns=0, usable=0, widths=0 * a.widths, refused=0 * a.refused)
        for a in one.accounts
    )
    found = parsed(dataclasses.replace(one, accounts=accounts))
    assert found.captioned("By source and side")[2][3:6] == ["0.00 (– %)", "0", "–"]
    assert "No valid samples" in found.text["widths"]


def test_sources_with_the_fewest_hours_are_gathered() -> None:
    one = make_extraction(70, (1, 0))
    accounts = tuple(dataclasses.replace(a, read_ns=a.read_ns * (1 + i)) for i, a in enumerate(one.accounts))
    rows = parsed(dataclasses.replace(one, accounts=accounts)).captioned("By source and side")[2:]
    assert [rows[0][0], rows[-3][0], rows[-2][0], rows[-1][0]] == ["D12", "D70", "11 more", "All"]


@pytest.mark.slow
@pytest.mark.parametrize("sources", [pytest.param(50, marks=pytest.mark.slow), 400])
def test_many_sources_stay_light(sources: int) -> None:
    """At 50 samples a second, so that drawings are as heavy as they get; the rest is gathered in one row."""
    extraction = make_extraction(sources, (20, 20), labels=True, dt=0.02)
    page = make_page(extraction)
    assert len(page) < 2_000_000
    rows = Page(page).captioned("By source and side")[2:]
    assert rows[-1][0] == "All"
    assert len(rows) == min(sources, 60) + 1
    assert sum(plain(row[4]) for row in rows[:-1]) == plain(rows[-1][4]) == 20 * sources
    assert sum(plain(row[9]) for row in rows[:-1]) == plain(rows[-1][9])
    if sources > 60:
        assert rows[-2][0] == "341 more"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sources", "said"),
    [
        (12, ""),
        (13, "Those of 13 sources are in the table above."),
        (500, "Those of 59 sources, and those of 441 more together, are in the table above."),
    ],
)
def test_where_the_lane_widths_of_many_sources_are(sources: int, said: str) -> None:
    found = parsed(make_extraction(sources, (2, 2)))
    words = found.text["widths"]
    assert said in words
    assert ("in the table above" in words) == bool(said)
    rows = [row[0] for row in found.captioned("Each column has one axis")[1:]]
    assert len(rows) == min(sources, 60)
    assert (rows[-1] == "441 more") == (sources == 500)


@pytest.mark.slow
def test_departures_are_drawn_by_source_and_side() -> None:
    """As many of each as fit, and the page says how many and who is not there."""
    few = parsed(make_extraction(3, (20, 5)))
    assert few.text["random"].count("D1: 17 deepest, 17 by lot") == 1
    assert "up to 12 of each kind and side." in few.text["random"]
    many = parsed(make_extraction(70, (5, 5)))
    assert "up to 1 of each kind and side: with more" in many.text["random"]
    assert "The 11 sources with the fewest hours are not drawn one by one." in many.text["random"]
    one = parsed(make_extraction(1, (30, 7)))
    for section in ("deepest", "random"):
        assert one.text[section].count("Left, dy = ") == 12
        assert one.text[section].count("Right, dy = ") == 7
    assert "Source by source" not in one.text["random"]


def test_same_extraction_same_bytes(tmp_path: Path) -> None:
    first = write_extraction_page(tmp_path / "a.html", make_extraction(2)).read_bytes()
    assert write_extraction_page(tmp_path / "b.html", make_extraction(2)).read_bytes() == first
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.html", "b.html"]


def test_text_of_others_is_text() -> None:
    extraction = make_extraction(2, warnings=(EVIL,), problems=(Problem(EVIL, EVIL, EVIL),), reader=EVIL)
    origins = [Origin(EVIL + str(i), (Label(EVIL, EVIL),)) for i in range(2)]
    accounts = tuple(
        dataclasses.replace(one, origin=origin) for one, origin in zip(extraction.accounts, origins, strict=True)
    )
    drawn = extraction.drawn
    events = tuple(dataclasses.replace(one, source=EVIL + "0", recording=EVIL) for one in drawn.deepest)
    hostile = dataclasses.replace(
        extraction, accounts=accounts, drawn=dataclasses.replace(drawn, deepest=events, by_lot=events)
    )
    page = parsed(hostile)
    assert page.counts["script"] == 0
    assert "\u202e" not in page.html
    assert "<script>alert(1)" in page.all_words


@pytest.mark.slow
def test_endless_text_does_not_make_an_endless_page() -> None:
    long = "x" * 100_000
    one = make_extraction(
        2, problems=tuple(Problem(long, long, long) for _ in range(400)), warnings=tuple(f"odd {k}" for k in range(99))
    )
    labels = tuple(Label(f"label{k}", long) for k in range(9))
    accounts = tuple(dataclasses.replace(a, origin=Origin(a.origin.source + long, labels)) for a in one.accounts)
    events = tuple(dataclasses.replace(event, recording=long, source=long) for event in one.drawn.deepest)
    page = make_page(dataclasses.replace(one, accounts=accounts, drawn=dataclasses.replace(one.drawn, deepest=events)))
    found = Page(page)
    assert len(page) < 2_000_000
    assert "and 39 more warnings" in found.text["warnings"]
    assert "Not shown: label6, label7, label8" in found.text["groups"]


def test_a_page_that_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="cannot be written"):
        write_extraction_page(tmp_path / "none" / "a.html", make_extraction(1))
    assert list(tmp_path.iterdir()) == []


def test_from_recordings_to_the_page() -> None:
    """Five planted departures to the left and two to the right, and one that the recording cuts."""
    t = np.arange(0.0, 80.0, 0.1)
    offset = np.zeros(t.size)
    for k, side in enumerate((1, 1, 1, 1, 1, -1, -1)):
        offset += side * (0.85 + 0.3) * np.exp(-(((t - 8.0 - 10.0 * k) / 2.0) ** 4))
    offset += 1.3 * np.clip(t - 77.5, 0.0, 1.0)
    found = parsed(extract_departures([drive("trip", t, lane_offset=offset, curvature=1e-3, lane=None)]))
    (row,) = found.captioned("By source and side")[2:]
    assert [row[i] for i in (4, 6, 7, 9)] == ["5", "1", "2", "0"]
    assert "cut by end" in found.text["refusals"]
    assert found.text["deepest"].count("trip, from") == found.text["random"].count("trip, from") == 7
    told = dict(one for one in found.captioned("Format and criteria")[1:])
    assert told["Curvature"] == "recorded by the source"
    assert told["Time step"] == "as recorded"


def test_importing_it_is_light() -> None:
    code = "import sys, studies.extraction_page; print({'matplotlib', 'jinja2', 'scipy', 'polars'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_words_of_a_drawing_say_what_it_shows() -> None:
    extraction = make_extraction(1, (31, 0))
    images = [html.unescape(one) for one in parsed(extraction).images]
    middle = sorted(extraction.departures.T.tolist())[15]
    assert images[0].startswith(f"All departures: T, duration. left median {middle:.2f} s; right none.")
    deepest = extraction.departures.d_y.max()
    (first, *_) = [one for one in images if one.startswith("Departure")]
    assert first.startswith(f"Departure to the left, d_y = {deepest:.2f} m, T = ")
