"""Numbers for the script, decoded from the page, against the ranking and against ranking.csv."""

from __future__ import annotations

import base64
import csv
import dataclasses
import itertools
import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from helpers.reports import invented_scenarios, report_input, run
from ldctoolkit.metrics import METRICS
from studies.ranking.ranking import Ranking
from studies.ranking.ranking_csv import write_csv
from studies.report import ReportInput, page
from studies.report.embedded.designs import FLAGS, coded, column, value_text
from studies.report.sections import ranking as ranking_section
from studies.results import StudyResults

CODES = {"f4": "f", "i4": "i", "u2": "H", "u1": "B"}


def numbers(packed: dict[str, str]) -> list[float]:
    raw = base64.b64decode(packed["data"])
    code = CODES[packed["type"]]
    return list(struct.unpack(f"<{len(raw) // struct.calcsize(code)}{code}", raw))


def expanded(given: dict[str, Any], count: int) -> np.ndarray:
    if "at" in given:
        all_of = np.full(count, np.nan)
        all_of[np.array(numbers(given["at"]), dtype=int)] = numbers(given["values"])
        return all_of
    found = numbers(given)
    return np.array(found if len(found) == count else found * count)


def on_page(report: ReportInput, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """The data of the section, as it stands in the page."""
    monkeypatch.setattr(page, "SECTIONS", (ranking_section.section,))
    html = page.make_page(report).html
    (found,) = re.findall(r'<script type="application/json" id="ldc-data">(.*?)</script>', html, re.DOTALL)
    data: dict[str, Any] = json.loads(found)["ranking"]
    return data


def same(found: np.ndarray, wanted: npt.ArrayLike) -> None:
    with np.errstate(over="ignore"):
        np.testing.assert_array_equal(found.astype(np.float32), np.asarray(wanted, np.float64).astype(np.float32))


def test_numbers_are_those_of_ranking_csv(report: ReportInput, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = on_page(report, monkeypatch)
    write_csv(report.rankings[:1], tmp_path / "ranking.csv")
    with (tmp_path / "ranking.csv").open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    assert len(lines) == data["count"]
    for one in data["figures"]:
        wanted = [float(line[METRICS[one["name"]].column] or "nan") for line in lines]
        if one["name"] in ("triggered", "needless"):
            wanted = [np.nan if line["law"] == "none" else number for line, number in zip(lines, wanted, strict=True)]
        same(expanded(one["values"], len(lines)), np.array(wanted))
    for name, end in itertools.product(("S", "difference", "baseline_difference"), ("low", "high")):
        stored = [float(line[f"{name}_{end}_m_s"] or "nan") for line in lines]
        same(expanded(data["ends"][name][end], len(lines)), stored)
    laws = [data["laws"][int(k)] for k in numbers(data["law"])]
    assert [law["name"] for law in laws] == [line["law"] for line in lines]
    thresholds = [data["y_s"]["texts"][int(k)] for k in numbers(data["y_s"]["index"])]
    assert thresholds == [line["y_s_m"] for line in lines]
    for law in data["laws"]:
        own = [line for line in lines if line["law"] == law["name"]]
        for gain in law["gains"]:
            values = [gain["texts"][int(k)] for k in numbers(gain["index"])]
            longer = [one["name"] for one in law["gains"] if one["name"].startswith(gain["name"] + "_")]
            (name,) = (
                key
                for key in own[0]
                if re.fullmatch(f"gain_{gain['name']}(_.*)?", key) and not any(f"gain_{one}" in key for one in longer)
            )
            assert [value.strip('"') for value in values] == [line[name] for line in own]


def test_flags_and_fresh_scores(results: StudyResults, monkeypatch: pytest.MonkeyPatch) -> None:
    first = Ranking.of(results, results.cases[0], bootstrap=100).index[:3]
    finalists = results.designs[:1] + tuple(results.designs[i] for i in first)
    fresh = run(finalists, invented_scenarios(30, 30, seed=5), [results.cases[0].case])
    alone = dataclasses.replace(results, cases=results.cases[:1], fresh=fresh)
    pareto, require = ["S", "effort_mean"], ["S <= 0.8"]
    ranking = Ranking.of(alone, alone.cases[0], bootstrap=100, pareto=pareto, require=require)
    data = on_page(dataclasses.replace(report_input(alone), rankings=(ranking,)), monkeypatch)
    bits = np.array(numbers(data["flags"]), dtype=int)
    flags = {name: (bits >> i & 1).astype(bool) for i, name in enumerate(FLAGS)}
    np.testing.assert_array_equal(flags["set_of_best"], ranking.set_of_best)
    np.testing.assert_array_equal(flags["pareto"], ranking.pareto)
    assert np.flatnonzero(flags["winner"]).tolist() == ([] if ranking.winner is None else [ranking.winner])
    assert np.flatnonzero(flags["baseline"]).tolist() == [ranking.baseline]
    assert [ranking.designs[k].law for k in np.flatnonzero(flags["passive"])] == ["none"]
    assert [ranking.designs[k].label for k in np.flatnonzero(flags["paper"])] == ["Preview P, y_s=0.2 m"]
    unmet = [tuple(data["unmet"]["sets"][int(k)]) for k in numbers(data["unmet"]["index"])]
    assert unmet == [tuple(f"{text} m·s" for text in texts) for texts in ranking.unmet]
    assert data["require"] == ["S <= 0.8 m·s"]
    assert data["limits"] == {"S": ["\u2264 0.8"]}
    assert len(set(unmet)) == 2
    again = [tuple(data["fresh_unmet"]["sets"][int(k)]) for k in numbers(data["fresh_unmet"]["index"])]
    assert again == [tuple(f"{text} m·s" for text in texts) for texts in ranking.fresh_unmet]
    d = data["count"]
    for name, fields in (
        ("fresh_S", ("fresh_S", "fresh_low", "fresh_high")),
        ("fresh_difference", ("fresh_difference", "fresh_difference_low", "fresh_difference_high")),
        ("optimism", ("optimism", "optimism_low", "optimism_high")),
    ):
        for end, field in zip(("value", "low", "high"), fields, strict=True):
            same(expanded(data["ends"][name][end], d), getattr(ranking, field))


def test_columns_are_short() -> None:
    assert column(np.zeros(50)) == column([0.0])
    assert len(numbers(column([np.nan] * 9))) == 1
    few = column([np.nan, 1.5, np.nan, np.nan, 2.5, np.nan])
    assert numbers(few["at"]) == [1, 4]
    assert numbers(few["values"]) == [1.5, 2.5]
    assert numbers(column([1.0, np.inf]))[1] == np.inf
    assert coded([str(i) for i in range(300)])["index"]["type"] == "u2"  # type: ignore[index]


@pytest.mark.parametrize("text", ["plain", 'a"b\\c\n\x7f\t', "é漢😀"])
def test_texts_are_read_back_by_toml(text: str) -> None:
    import tomllib

    assert tomllib.loads(f"a = {value_text(text)}")["a"] == text
