"""Recorded departures of one trip are alike: rankings, comparisons and limits resample whole trips."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from helpers.bits import assert_same_bits
from helpers.cli import good
from helpers.pages import Page
from helpers.results import results_of
from ldctoolkit import load_model
from ldctoolkit.clusters import cluster_error, cluster_values, design_effect
from ldctoolkit.controllers import LQR, NoControl
from ldctoolkit.departures import PARAMETER_COLUMNS, PARAMETER_NAMES, Departures, ExtraColumn
from ldctoolkit.recordings import Criteria, Provenance, write_departures
from ldctoolkit.studies import Design, Ranking, Study, read_results, run_study
from ldctoolkit.studies.comparison.paired import paired_differences
from ldctoolkit.studies.ranking.inference import Resampled, exact_interval, simultaneous_interval
from ldctoolkit.studies.ranking.ranking import rank_study
from ldctoolkit.studies.study_file import toml_text

DESIGNS = [Design.of(NoControl(), 0.2), Design.of(LQR(), 0.1)]


def clustered_scores(rng: np.random.Generator, trips: int, correlation: float) -> tuple[np.ndarray, np.ndarray]:
    """Skewed scores (2, n) of two laws whose trips differ, and the trip of each; the second is 0.05 x larger."""
    size = np.maximum(1, np.round(13 * trips * (share := rng.lognormal(0.0, 1.1, trips)) / share.sum())).astype(int)
    trip = np.repeat(np.arange(trips), size)

    def effect(deviation: float) -> np.ndarray:
        own = np.sqrt(1.0 - correlation) * rng.standard_normal(trip.size)
        return np.exp(deviation * (np.sqrt(correlation) * rng.standard_normal(trips)[trip] + own))

    uncorrected = effect(0.8)
    return np.stack([0.45 * uncorrected * effect(0.35), 0.5 * uncorrected * effect(0.35)]), trip


TRUTH = 0.05 * np.exp((0.8**2 + 0.35**2) / 2.0)  # difference of the laws' means


@pytest.mark.parametrize(("trips", "correlation"), [(8, 0.3), (15, 0.05), (15, 0.3), (40, 0.15)])
def test_intervals_of_differences_cover_what_they_say(trips: int, correlation: float) -> None:
    """Of 300 draws; three binomial standard errors are 0.04. Intervals of independent departures cover far less."""
    rng = np.random.default_rng(trips)
    covered, alone = 0, 0
    for seed in range(300):
        scores, trip = clustered_scores(rng, trips, correlation)
        for cluster in (trip, None):
            side = np.zeros(trip.size, dtype=np.int64)
            resampled = Resampled.of(scores, side, seed=seed, samples=200, cluster=cluster)
            interval = simultaneous_interval(resampled, 0.95, 0)
            holds = interval.low[1] <= TRUTH <= interval.high[1]
            covered, alone = covered + (holds and cluster is not None), alone + (holds and cluster is None)
    assert covered / 300 >= (0.93 if trips >= 15 else 0.90) - 0.04
    assert correlation < 0.1 or alone / 300 < 0.85


def test_values_of_clusters_keep_mean_and_error() -> None:
    rng = np.random.default_rng(1)
    scores, trip = clustered_scores(rng, 30, 0.2)
    values = cluster_values(scores, trip)
    assert values.shape == (2, 30)
    np.testing.assert_allclose(values.mean(axis=1), scores.mean(axis=1), rtol=1e-13)
    error = values.std(axis=1, ddof=1) / np.sqrt(30)
    expected = cluster_error(scores - scores.mean(axis=1, keepdims=True), trip).error
    np.testing.assert_allclose(error, expected, rtol=0.02)


def recorded(trips: int, drivers: int = 0) -> Departures:
    """Departures of trips in turn, which differ in their duration."""
    drawn = load_model("reference").sample(90, 90, seed=5)
    number = np.random.default_rng(2).integers(trips, size=drawn.n)
    columns = {name: getattr(drawn, name) for name in PARAMETER_NAMES}
    columns["T"] = drawn.T * (0.6 + 1.8 * (number % 3 == 0))
    extra = (ExtraColumn("driver", np.char.add("D", (number % drivers).astype(str))),) if drivers else ()
    return Departures(
        drawn.side, **columns, recording=np.char.add("trip ", number.astype(str)), extra=extra,
        start_time=np.arange(drawn.n) * 20.0, samples=np.full(drawn.n, 20),
    )  # fmt: skip


def study_on(folder: Path, key: str = "departures") -> Study:
    designs = [{"law": "none"}, {"law": "lqr", "y_s": 0.1}]
    return Study.from_dict({"name": "r", "scenarios": {key: "d.parquet"}, "design": designs}, folder=folder)


def ranked(folder: Path, departures: Departures) -> Ranking:
    folder.mkdir()
    write_departures(folder / "d.parquet", departures, Provenance(criteria=Criteria(1.9)))
    results = run_study(study_on(folder), directory=folder / "out", workers=1)
    assert_same_bits(read_results(folder / "out").scenarios, results.scenarios)
    return rank_study(results, study_on(folder))


def test_a_replay_resamples_trips_or_drivers(tmp_path: Path) -> None:
    """Trips as a whole; drivers from ten on; where nothing is known, departures; the scores are the same."""
    departures = recorded(trips=24)
    by_trip = ranked(tmp_path / "trips", departures)
    unknown = dataclasses.replace(departures, recording=np.full(departures.n, "r"))
    alone = ranked(tmp_path / "alone", unknown)
    few_drivers = ranked(tmp_path / "few", recorded(trips=24, drivers=9))
    drivers = ranked(tmp_path / "drivers", recorded(trips=24, drivers=12))
    assert by_trip.metrics.S.tobytes() == alone.metrics.S.tobytes()
    widths = [r.inference.S_high[-1] - r.inference.S_low[-1] for r in (by_trip, alone, few_drivers, drivers)]
    assert widths[0] > 1.3 * widths[1]
    assert widths[2] == widths[0] != widths[3]
    assert not any("cannot be trusted" in text for text in by_trip.warnings)


DOUBTS = {
    1: "What differs between trips cannot be seen in a single one, and intervals cannot be trusted.",
    5: "With 5 trips or drivers only, intervals cannot be trusted.",
    12: "",
    0: "Trips are not known: departures count as independent, and intervals cannot be trusted.",
}


@pytest.mark.parametrize("trips", [1, 5, 12, 0])
def test_a_replay_says_where_intervals_cannot_be_trusted(trips: int, tmp_path: Path) -> None:
    """Terminal, Markdown, report and comparison; of finalists too."""
    departures, doubt = recorded(trips or 1), DOUBTS[trips]
    columns: dict[str, Any] = {column: getattr(departures, name) for name, column in PARAMETER_COLUMNS.items()}
    columns |= {"side": np.where(departures.side > 0, "left", "right")}
    columns |= {"recording": departures.recording} if trips else {}
    pl.DataFrame(columns).write_parquet(tmp_path / "d.parquet")
    (tmp_path / "s.toml").write_text(toml_text(study_on(tmp_path, "table")), encoding="utf-8")
    plain = ("--workers", "1", "--no-robustness", "--no-figures")
    said = [good("run", "s.toml", "-o", "a", *plain, cwd=tmp_path), good("rank", "a", cwd=tmp_path)]
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    said += [good("compare", "a", "b", cwd=tmp_path), (tmp_path / "a/ranking.md").read_text(encoding="utf-8")]
    said += [Page((tmp_path / "a/report.html").read_text(encoding="utf-8")).words("verdict")]
    for text in said:
        words = " ".join(text.split())
        assert doubt in words
        assert ("cannot be trusted" in words) is bool(doubt)
    with_model = study_on(tmp_path, "table").changed(
        scenarios={"model": "reference", "left": 20, "right": 20}, ranking={"bootstrap": 100, "finalists": 3}
    )
    ranking = rank_study(run_study(with_model, workers=1, refits=0), with_model)
    of_finalists = [text for text in ranking.warnings if "cannot be trusted" in text]
    assert of_finalists == ([f"Of the replayed departures: {doubt[0].lower()}{doubt[1:]}"] if doubt else [])


def test_a_plain_table_with_recordings_has_trips_too(tmp_path: Path) -> None:
    departures = recorded(trips=24)
    columns = {column: getattr(departures, name) for name, column in PARAMETER_COLUMNS.items()}
    side = np.where(departures.side > 0, "left", "right")
    pl.DataFrame({"side": side, "recording": departures.recording, **columns}).write_parquet(tmp_path / "d.parquet")
    results = run_study(study_on(tmp_path, "table"), directory=tmp_path / "out", workers=1)
    assert results.scenarios.cluster is not None
    assert np.unique(results.scenarios.cluster).size == 24


def test_shares_count_trips() -> None:
    """Whole trips that act or do not tell as much as one departure each; without any event too."""
    trip = np.repeat(np.arange(20), 10)
    acts = np.repeat(np.arange(20) < 5, 10)[None]
    effect = design_effect(np.where(acts, 1.0, 0.0) - 0.25, trip)
    assert 9.0 < effect[0] < 15.0
    assert design_effect(np.zeros((1, 200)), trip)[0] == pytest.approx(10.0)
    results = results_of(np.full((2, 200), 1.0), DESIGNS, status=np.stack([np.full(200, 1), np.where(acts[0], 0, 1)]))
    cluster = dataclasses.replace(results.scenarios, cluster=trip)
    require = ("triggered <= 0.9",)
    wide, narrow = (
        Ranking.of(dataclasses.replace(results, scenarios=scenarios), require=require).limited[0, :, :]
        for scenarios in (cluster, results.scenarios)
    )
    law = int(np.argmax(narrow[0]))
    np.testing.assert_allclose(narrow[1:, law], exact_interval(50, 200), rtol=1e-12)
    assert wide[1, law] < narrow[1, law]
    assert wide[2, law] > narrow[2, law]


def test_comparisons_of_studies_resample_trips() -> None:
    rng = np.random.default_rng(3)
    scores, trip = clustered_scores(rng, 20, 0.3)
    side = np.zeros(trip.size, dtype=np.int64)
    old, new = scores[:1], scores[1:]
    wide, narrow = (paired_differences(old, new, side, seed=0, bootstrap=500, cluster=c) for c in (trip, None))
    assert wide.difference == narrow.difference
    assert wide.high - wide.low > 1.3 * (narrow.high - narrow.low)
