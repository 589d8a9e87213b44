"""Designers' metrics in studies: stored by content, aggregated, required, ranked by, searched, compared, counted."""

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.cli import csv_rows, good
from ldctoolkit import LdcError, Paths, Study, StudyResults
from ldctoolkit.errors import InputError, StudyError
from ldctoolkit.metrics import UserMetric
from ldctoolkit.simulation import loop
from ldctoolkit.studies.ranking.ranking import write_csv
from ldctoolkit.studies.ranking.verdict import more_lines, ranking_table, verdict
from ldctoolkit.studies.risk import estimate_risk

FILE = """
import numpy as np

import ldctoolkit as ldc

MARK = 0.2


@ldc.metric(unit="s", title="Time beyond the mark")
def outside(paths):
    return paths.dt * np.sum(paths.distance < -MARK, axis=1)


@ldc.metric(unit="m", title="Least distance", better="more", over="all")
def least(paths):
    return np.nanmin(paths.distance, axis=1)


def plain(paths):
    return paths.T
"""

STUDY = """
name = "mine"
metrics = ["my_metrics.py:outside", "my_metrics.py:least"]
[scenarios]
left = 30
right = 20
[ranking]
bootstrap = 100
rank_by = "outside"
require = ["outside_p95 <= 2.5"]
pareto = ["S", "least"]
finalists = 2
[[design]]
law = "none"
[[design]]
law = "lqr"
y_s = [0.05, 0.2]
gains.r_delta = [100.0, 5000.0]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "my_metrics.py").write_text(FILE)
    (tmp_path / "study.toml").write_text(STUDY)
    return tmp_path


def ran(folder: Path, out: str = "out", **settings: Any) -> tuple[Study, StudyResults]:
    study = Study.from_toml(folder / "study.toml")
    return study, ldc.run_study(study, folder / out, **{"workers": 1, "refits": 0, "progress": False} | settings)


def test_a_study_stores_its_metrics_and_no_split_changes_a_bit(folder: Path) -> None:
    study, results = ran(folder)
    assert {name: values.shape for name, values in results.user_metrics.items()} == {
        "outside": (5, 50), "least": (5, 50)
    }  # fmt: skip
    (folder / "my_metrics.py").unlink()  # workers and stored numbers do not need the file
    again = ldc.run_study(study, folder / "other", workers=2, block_size=1, refits=0, progress=False)
    stored = ldc.read_results(folder / "out")
    for name, values in results.user_metrics.items():
        np.testing.assert_array_equal(again.user_metrics[name], values)
        np.testing.assert_array_equal(stored.user_metrics[name], values)
        np.testing.assert_array_equal(results.fresh.user_metrics[name], stored.fresh.user_metrics[name])  # type: ignore[union-attr]
        alone = ldc.run_study(study.changed(scenarios={"left": 30, "right": 0}), workers=1, refits=0, progress=False)
        np.testing.assert_array_equal(alone.user_metrics[name], values[:, :30])
    frame = results.to_polars()
    np.testing.assert_array_equal(frame["outside_s"].to_numpy(), results.user_metrics["outside"].ravel())
    assert frame["least_m"].dtype.is_float()
    plain = ldc.run_study(study.with_content(study.content() | {"metrics": [], "ranking": {}}), workers=1, refits=0)
    np.testing.assert_array_equal(plain.S, results.S)
    assert plain.user_metrics == {}


def drives(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    driven: list[Any] = []
    real = loop.drive_many

    def counted(controllers: list[Any], *arguments: Any, **settings: Any) -> Any:
        driven.extend(controllers)
        return real(controllers, *arguments, **settings)

    monkeypatch.setattr("ldctoolkit.studies.running.tasks.drive_many", counted)
    return driven


def test_an_edit_runs_anew_and_nothing_stale_is_read(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    _, first = ran(folder)
    driven = drives(monkeypatch)
    ran(folder)
    (folder / "my_metrics.py").write_text(
        FILE.replace("Time beyond the mark", "Title").replace("import np", "import np  #")
    )
    _, same = ran(folder)
    assert driven == []  # a title and a comment are no part of the numbers
    os.utime(folder / "my_metrics.py", (0, 0))
    (folder / "my_metrics.py").write_text(FILE.replace("MARK = 0.2", "MARK = 0.1"))
    os.utime(folder / "my_metrics.py", (0, 0))  # an edit is seen by its content
    _, edited = ran(folder)
    assert len(driven) >= 5
    assert "metric 'outside'" in caplog.text
    np.testing.assert_array_equal(same.user_metrics["outside"], first.user_metrics["outside"])
    assert (edited.user_metrics["outside"] > first.user_metrics["outside"]).any()
    np.testing.assert_array_equal(edited.user_metrics["least"], first.user_metrics["least"])
    np.testing.assert_array_equal(edited.S, first.S)
    (folder / "my_metrics.py").write_text(FILE)
    driven.clear()
    _, back = ran(folder)
    assert driven == []  # both are stored
    np.testing.assert_array_equal(back.user_metrics["outside"], first.user_metrics["outside"])


def test_aggregates_follow_from_the_stored_values(folder: Path) -> None:
    study, results = ran(folder)
    ranking = ldc.rank_study(results, study)
    rows = {row["design"]: row for row in ranking.to_polars().iter_rows(named=True)}
    for i, design in enumerate(results.designs):
        outside, least, row = results.user_metrics["outside"][i], results.user_metrics["least"][i], rows[design.id]
        acted = results.status[i] != ldc.EventStatus.NEVER_TRIGGERED
        np.testing.assert_allclose(row["outside_mean_all_s"], outside.mean(), rtol=1e-12)
        np.testing.assert_allclose(row["least_mean_m"], least.mean(), rtol=1e-12)
        np.testing.assert_allclose(row["least_p5_m"], np.quantile(least, 0.05), rtol=1e-12)
        if design.is_baseline:
            assert row["outside_mean_s"] is None
            continue
        assert 0 < acted.sum() < 50 or design.y_s < 0.2
        np.testing.assert_allclose(row["outside_mean_s"], outside[acted].mean(), rtol=1e-12)
        np.testing.assert_allclose(row["outside_p95_s"], np.quantile(outside[acted], 0.95), rtol=1e-12)
        np.testing.assert_allclose(row["outside_max_s"], outside[acted].max(), rtol=1e-12)
    assert ranking.pareto_metrics == ("S", "least_mean")
    (required,) = ranking.requirements
    assert (required.metric.name, required.limit) == ("outside_p95", 2.5)


@pytest.mark.parametrize(("name", "unit", "sign"), [("outside", "s", 1.0), ("least", "m", -1.0)])
def test_designs_are_ranked_by_a_metric(folder: Path, name: str, unit: str, sign: float) -> None:
    study, results = ran(folder)
    study = study.changed(ranking={"rank_by": name, "require": [], "baseline": "lqr"})
    results = dataclasses.replace(results, fresh=None)
    ranking = ldc.rank_study(results, study)
    means = results.user_metrics[name].mean(axis=1)
    order = np.argsort(sign * means, kind="stable")
    assert [design.id for design in ranking.designs] == [results.designs[i].id for i in order]
    by_S = ldc.rank_study(results, study.changed(ranking={"rank_by": "S"}))
    assert ranking.criterion is not None
    assert by_S.criterion is None
    assert ranking.ranked_by.name == f"{name}_mean_all"
    np.testing.assert_allclose(ranking.criterion.mean, means[order], rtol=1e-12)
    assert (ranking.criterion.low <= means[order] + 1e-12).all()
    assert (ranking.criterion.high >= means[order] - 1e-12).all()
    # differences are in its unit, and above 0 where a design is worse
    baseline = ranking.baseline
    assert baseline is not None
    np.testing.assert_allclose(
        ranking.inference.baseline_difference, sign * (means[order] - means[order][baseline]), rtol=0, atol=1e-12
    )
    assert ranking.inference.difference[-1] > 0
    # S and its intervals stay those of S
    for i, design in enumerate(ranking.designs):
        j = by_S.designs.index(design)
        assert ranking.metrics.S[i] == by_S.metrics.S[j]
        assert ranking.inference.S_low[i] == pytest.approx(by_S.inference.S_low[j])
    write_csv(ranking, folder / "ranking.csv")
    row = csv_rows(folder / "ranking.csv")[0]
    assert f"difference_to_best_{unit}" in row
    assert f"{name}_mean_all_low_{unit}" in row
    assert {"S_low_m_s", f"baseline_difference_{unit}"} <= set(row)
    assert "baseline_difference_m_s" not in row
    table = ranking_table(ranking, range(len(ranking)))
    assert ranking.ranked_by.title in table.title
    column = [c.title for c in table.columns].index(ranking.ranked_by.title)
    assert [round(float(row.cells[column].value), 9) for row in table.rows] == [round(m, 9) for m in means[order]]  # type: ignore[union-attr]
    judged = verdict(ranking, results)
    assert ranking.ranked_by.title in judged.title + judged.sentences[0]
    (paired,) = (
        (line for line in more_lines(ranking) if "baseline" in line.lower()) if ranking.winner != baseline else ("",)
    )
    assert f" {unit} (" in paired or not paired


def test_finalists_are_those_of_the_metric_on_fresh_departures(folder: Path) -> None:
    study, results = ran(folder)
    ranking = ldc.rank_study(results, study)
    fresh = results.fresh
    assert fresh is not None
    assert ranking.criterion is not None
    for i, design in enumerate(ranking.designs):
        if design not in fresh.designs:
            assert np.isnan(ranking.criterion.fresh[i])
            continue
        j = fresh.designs.index(design)
        assert ranking.criterion.fresh[i] == pytest.approx(fresh.user_metrics["outside"][j].mean())
        assert ranking.fresh.S[i] == pytest.approx(fresh.S[j].mean())
    assert ranking.fresh.winner == 0


def test_a_report_shows_them(folder: Path) -> None:
    ran(folder)
    good("report", folder / "out", "--no-robustness", "--no-figures", cwd=folder)
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    table = page.split('<table id="designs"')[1].split("</table>")[0]
    assert "Time beyond the mark, mean of all departures" in table
    assert "Least distance" in table
    assert "Time beyond the mark, 95 % quantile" in page.split('id="limits"')[1].split("</section>")[0]


def test_a_number_that_is_not_known_is_dropped_nowhere() -> None:
    @ldc.metric(unit="s")
    def some(paths: Paths) -> Any:
        return np.where(paths.T > 3.0, np.nan, 1.0)

    study = ldc.study(ldc.NoControl, ldc.LQR, y_s=0.05, left=20, right=20, metrics=[some], ranking={"bootstrap": 100})
    results = ldc.run_study(study, workers=1, refits=0, progress=False)
    assert np.isnan(results.user_metrics["some"]).any()
    ranking = ldc.rank_study(results, study)
    assert np.isnan(ranking.metrics.beside["some_mean"]).all()
    assert np.isnan(ranking.metrics.beside["some_max"]).all()
    assert [text for text in ranking.warnings if "some" in text]
    required = ldc.rank_study(results, study.changed(ranking={"require": ["some_mean <= 5"]}))
    assert required.ranked == 0
    with pytest.raises(InputError) as caught:
        ldc.rank_study(results, study.changed(ranking={"rank_by": "some"}))
    assert (caught.value.path, caught.value.value) == ("ranking.rank_by", "some")


def test_another_study_with_a_metric_of_the_same_name_changes_no_ranking() -> None:
    def study(unit: str, better: Any) -> Study:
        @ldc.metric(unit=unit, better=better, over="all")
        def outside(paths: Paths) -> Any:
            return paths.dt * np.sum(paths.distance < 0.0, axis=1)

        ranking = {"rank_by": "outside", "finalists": 0, "bootstrap": 100}
        return ldc.study(ldc.NoControl, ldc.LQR, y_s=0.1, left=10, right=10, metrics=[outside], ranking=ranking)

    first = study("s", "less")
    results = ldc.run_study(first, workers=1, refits=0, progress=False)
    study("m", "more")
    table = ldc.rank_study(results, first).to_polars()
    assert table["law"].to_list() == ["lqr", "none"]
    assert "outside_mean_s" in table.columns
    assert "outside_s" in results.to_polars().columns


def test_a_mistake_is_found_before_a_design_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    @ldc.metric(unit="s")
    def broken(paths: Paths) -> Any:
        return paths.e_y

    driven = drives(monkeypatch)
    study = ldc.study(ldc.LQR, left=5, right=5, metrics=[broken])
    with pytest.raises(LdcError) as caught:
        ldc.run_study(study, workers=1, progress=False)
    assert caught.value.path == "metric broken"
    assert driven == []


@pytest.mark.parametrize("workers", [1, 2])
def test_a_metric_that_raises_for_one_design_fails_that_design(workers: int) -> None:
    @ldc.metric(unit="s")
    def picky(paths: Paths) -> Any:
        if (np.isfinite(paths.t_s) & (paths.t_s > 0.5)).any():
            raise ValueError("a late trigger")
        return paths.T

    study = ldc.study(ldc.LQR, y_s=[-0.1, 0.2], left=20, right=20, metrics=[picky], ranking={"finalists": 0})
    results = ldc.run_study(study, workers=workers, refits=0, progress=False)
    assert [design.y_s for design in results.designs] == [-0.1]
    (failed,) = results.failed
    assert failed.design.y_s == 0.2
    assert "metric picky" in failed.reason
    assert "a late trigger" in failed.reason


def test_a_search_takes_what_is_ranked_by_as_its_objective() -> None:
    @ldc.metric(unit="s")
    def outside(paths: Paths) -> Any:
        return paths.dt * np.sum(paths.distance < -0.2, axis=1)

    table = {"law": "lqr", "y_s": [0.05, 0.2], "gains": {"r_delta": {"from": 50.0, "to": 5000.0}}}
    ranking = {"rank_by": "outside", "bootstrap": 100, "finalists": 0}
    study = ldc.study(table, left=10, right=10, metrics=[outside], ranking=ranking, search={"trials": 4, "batch": 2})
    assert study.search is not None
    assert study.search.objectives == ("outside_mean_all",)
    results = ldc.run_study(study, workers=1, refits=0, progress=False)
    assert results.user_metrics["outside"].shape == (4, 20)


def test_a_comparison_and_a_risk_have_them(folder: Path) -> None:
    study, old = ran(folder, "old")
    heavier = study.changed(vehicle={"m": 1200.0})
    new = ldc.run_study(heavier, folder / "new", workers=1, refits=0, progress=False)
    comparison = ldc.compare(folder / "old", folder / "new")
    for name, sign in (("outside", 1.0), ("least", 1.0)):
        change = (new.user_metrics[name] - old.user_metrics[name]).mean(axis=1)
        np.testing.assert_allclose(comparison.metrics[name].difference, sign * change, rtol=0, atol=1e-12)
    (folder / "my_metrics.py").write_text(FILE.replace("MARK = 0.2", "MARK = 0.1"))
    ran(folder, "edited")
    assert set(ldc.compare(folder / "old", folder / "edited").metrics) == {"least"}

    settings: dict[str, Any] = {"n": 300, "metric_limits": ["outside > 1.0", "least < -0.3"], "progress": False}
    risk = estimate_risk(study.designs[1:3], study, workers=1, **settings)
    other = estimate_risk(study.designs[1:3], study, workers=2, **settings)
    event = risk.event(study.designs[1], "outside > 1")
    np.testing.assert_array_equal(risk.tally.counts, other.tally.counts)
    assert 0 <= event.count < risk.event(risk.designs[0], "outside > 1").count
    # the least distance of the edge and its depth are one quantity
    for design in risk.designs:
        deep = risk.event(design, "depth > 0.3 m").count
        assert abs(risk.event(design, "least < -0.3").count - deep) <= 2
    for text in ("deepest_mean > 1", "outside_p95 > 1", "other > 1"):
        with pytest.raises(LdcError):
            estimate_risk(study.designs[1:3], study, n=10, metric_limits=[text], workers=1)


@pytest.mark.parametrize(
    ("entry", "path"),
    [
        ("my_metric.py:outside", "metrics[0]"),
        ("my_metrics.py:outsid", "metrics[0]"),
        ("my_metrics.py", "metrics[0]"),
        ("my_metrics.py:plain", "metrics[0]"),
        ("broken.py:x", "metrics[0]"),
        (3, "metrics[0]"),
    ],
)
def test_what_a_study_file_names_wrongly_is_said(folder: Path, entry: Any, path: str) -> None:
    (folder / "broken.py").write_text("1 / 0\n")
    content = {"name": "x", "metrics": [entry], "design": [{"law": "none"}]}
    with pytest.raises(StudyError) as caught:
        Study.from_dict(content, source="study.toml", folder=folder)
    assert caught.value.path.startswith(f"study.toml: {path}")


def test_names_of_metrics_are_checked_with_those_of_the_study(folder: Path) -> None:
    content = {"name": "x", "metrics": ["my_metrics.py:outside"] * 2, "design": [{"law": "none"}]}
    with pytest.raises(StudyError):
        Study.from_dict(content, folder=folder)
    for ranking in ({"rank_by": "outsid"}, {"rank_by": "deepest"}, {"require": ["outside_p80 <= 1"]}):
        with pytest.raises(StudyError) as caught:
            Study.from_dict(content | {"metrics": ["my_metrics.py:outside"], "ranking": ranking}, folder=folder)
        assert "ranking" in caught.value.path
    text = ldc.studies.study_file.toml_text(Study.from_toml(folder / "study.toml"))  # type: ignore[attr-defined]
    assert '"my_metrics.py:outside"' in text


def test_a_metric_without_its_function_can_be_read_but_not_run(folder: Path) -> None:
    study, _ = ran(folder)
    (row,) = (metric for metric in study.metrics if metric.name == "least")
    unknown = UserMetric(**row.content() | {"code": "0" * 16})
    strange = study.with_content(study.content() | {"metrics": [unknown.content()], "ranking": {}})
    with pytest.raises(LdcError) as caught:
        ldc.run_study(strange, folder / "out", workers=1, progress=False)
    assert caught.value.path == "metric least"
