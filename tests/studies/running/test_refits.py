"""Refits to resampled recordings: what they are against analytic errors, where they are kept, what they cover."""

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import t as student

import ldctoolkit as ldc
from helpers.cli import good
from helpers.errors import refused
from ldctoolkit.clusters import cluster_error
from ldctoolkit.departures import Departures
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.scenario_model import ScenarioModel, fit_scenario_model, load_model
from ldctoolkit.scenario_model.refit import refit, uncertainty
from ldctoolkit.studies.ranking.ranking import Ranking, rank_study
from ldctoolkit.studies.ranking.verdict import more_lines
from ldctoolkit.studies.results import RefitScores, StudyResults
from ldctoolkit.studies.storage.store import read_results

POOL = load_model("reference").sample(4000, 4000, seed=11)


def trips(n: int, count: int, correlation: float, seed: int) -> Departures:
    """n departures a side of the pool; the depths of one trip are alike, their distribution is that of the pool."""
    rng = np.random.default_rng(seed)
    trip = np.r_[np.arange(count), rng.integers(0, count, 2 * n - count)]
    effect = rng.normal(size=count)[trip]
    rank = ndtr(np.sqrt(correlation) * effect + np.sqrt(1.0 - correlation) * rng.normal(size=2 * n))
    side = np.repeat([1, -1], n)
    rows = np.empty(2 * n, dtype=np.int64)
    for which in (1, -1):
        among = np.flatnonzero(POOL.side == which)
        among = among[np.argsort(POOL.d_y[among])]
        rows[side == which] = among[(rank[side == which] * among.size).astype(int)]
    names = np.array([f"trip {i}" for i in trip])
    return Departures(side, *POOL.matrix()[rows].T, names, np.zeros(2 * n), np.full(2 * n, 20))


RECORDED = trips(120, 30, 0.3, seed=1)


@pytest.fixture(scope="module")
def smooth() -> ScenarioModel:
    return fit_scenario_model(RECORDED, kind="smoothed")


STUDY = ldc.study(ldc.NoControl, ldc.LQR, ldc.PID, name="small", left=100, right=100)


@pytest.fixture(scope="module")
def folder(smooth: ScenarioModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    ldc.run_study(STUDY, folder, model=smooth, workers=1, refits=12)
    return folder


# ------------------------------------------------------------------------------------------------ the model's file


def test_a_model_keeps_its_departures_and_its_identity_is_that_of_what_it_generates(
    smooth: ScenarioModel, tmp_path: Path
) -> None:
    kept = smooth.provenance.recorded
    assert kept is not None
    by_trip, given = (
        sorted(sorted(np.column_stack([d.side, d.matrix()])[trip == one].tolist()) for one in np.unique(trip))
        for d, trip in ((kept.departures, kept.clusters.index), (RECORDED, RECORDED.recording))
    )
    assert by_trip == given
    assert (kept.kind, kept.trips, kept.drivers) == ("trips", 30, 0)
    smooth.save(tmp_path / "m.json")
    assert ScenarioModel.load(tmp_path / "m.json").provenance.recorded == kept
    bare = dataclasses.replace(smooth, provenance=dataclasses.replace(smooth.provenance, recorded=None))
    assert bare.content_hash == smooth.content_hash


def test_weights_are_kept_and_departures_of_no_weight_are_not() -> None:
    weights = np.r_[np.zeros(20), np.full(100, 3.0), np.ones(120)]
    kept = fit_scenario_model(RECORDED, kind="smoothed", weights=weights).provenance.recorded
    assert kept is not None
    assert kept.weight == (3.0,) * 100 + (1.0,) * 120
    assert sorted(kept.departures.d_y.tolist()) == sorted(RECORDED.d_y[20:].tolist())


@pytest.mark.slow
def test_more_than_2000_departures_of_a_side_are_not_kept() -> None:
    assert fit_scenario_model(trips(2001, 30, 0.1, 1), components=1).provenance.recorded is None
    assert fit_scenario_model(trips(2000, 30, 0.1, 1), components=1).provenance.recorded is not None


@pytest.mark.parametrize(
    ("key", "change"),
    [
        ("weight", lambda kept: kept["weight"].__setitem__(3, 0.0)),
        ("cluster", lambda kept: kept["cluster"].pop()),
        ("cluster", lambda kept: kept.update(cluster=[2 * i for i in kept["cluster"]])),
        ("columns", lambda kept: kept["columns"].pop("T")),
        ("columns.T", lambda kept: kept["columns"]["T"].pop()),
        ("side", lambda kept: kept.update(side=[1] * 240)),
        ("kind", lambda kept: kept.update(kind="buses")),
    ],
)
def test_what_does_not_belong_into_the_file_is_refused(
    smooth: ScenarioModel, tmp_path: Path, key: str, change: Any
) -> None:
    smooth.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    change(content["provenance"]["recorded"])
    (tmp_path / "m.json").write_text(json.dumps(content))
    with pytest.raises(ModelError) as caught:
        ScenarioModel.load(tmp_path / "m.json")
    assert caught.value.path.endswith(f"provenance.recorded.{key}")


def test_a_file_of_version_4_is_read_without_departures(smooth: ScenarioModel, tmp_path: Path) -> None:
    smooth.save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text())
    del content["provenance"]["recorded"], content["checksum"]
    (tmp_path / "m.json").write_text(json.dumps(content | {"version": 4}))
    old = ScenarioModel.load(tmp_path / "m.json")
    assert old.provenance.recorded is None
    assert old.content_hash == smooth.content_hash
    with refused("model", InputError):
        refit(old, 0)


# ------------------------------------------------------------------------------------------------ refits


@pytest.mark.parametrize(
    "settings", [{"kind": "smoothed"}, *(pytest.param({"components": K}, marks=pytest.mark.slow) for K in (1, 2))]
)
def test_refits_spread_as_the_mean_over_clusters_does(settings: dict[str, Any]) -> None:
    """The mean depth of a model is nearly that of the departures, whose error over whole trips has a formula."""
    model = fit_scenario_model(RECORDED, **settings)
    kept = model.provenance.recorded
    assert kept is not None
    depths = [refit(model, i).sample(1000, 1000, seed=5).d_y.mean() for i in range(50)]
    factor, df = uncertainty(kept, 50)
    influence = (kept.departures.d_y - kept.departures.d_y.mean())[None]
    exact, alone = (cluster_error(influence, index) for index in (kept.clusters.index, np.arange(240)))
    assert factor * np.std(depths, ddof=1) == pytest.approx(exact.error[0], rel=0.3)
    assert exact.error[0] > 1.5 * alone.error[0]
    assert 10.0 < df < 29.0


def test_a_refit_follows_from_its_number_alone(smooth: ScenarioModel) -> None:
    assert refit(smooth, 3).content_hash == refit(smooth, 3).content_hash != refit(smooth, 4).content_hash


def test_the_error_of_the_draws_is_taken_off() -> None:
    """Variance 4 of what refits differ by, 9 of each draw."""
    rng = np.random.default_rng(0)
    values = 100.0 + 2.0 * rng.normal(size=(4000, 1)) + 3.0 * rng.normal(size=(4000, 2))
    scores = RefitScores(("a",), np.stack([values, values], axis=1), 0, 1.5, 12.0, (), "", "")
    assert scores.half_width(values, 0.9) == pytest.approx(student.ppf(0.95, 12.0) * 1.5 * 2.0, rel=0.06)
    assert np.isnan(scores.half_width(values[:4], 0.9))
    assert np.isnan(dataclasses.replace(scores, failed=6).half_width(values[:6], 0.9))


# ------------------------------------------------------------------------------------------------ in a study


def ends(ranking: Ranking) -> Iterator[np.ndarray]:
    yield from (values for values in vars(ranking.recordings).values() if isinstance(values, np.ndarray))


def test_only_the_winner_has_an_interval_of_the_recordings(folder: Path) -> None:
    ranking = ldc.rank_study(read_results(folder), STUDY)
    winner = ranking.winner
    assert winner == 0
    assert all(np.isfinite(values).tolist() == [True, False, False] for values in ends(ranking))
    found = ranking.recordings
    S, saved, difference = ranking.fresh.S[0], ranking.fresh_saved[0], ranking.fresh.baseline_difference[0]
    assert (found.low[0] + found.high[0]) / 2 == pytest.approx(S)
    assert (found.reduction_low[0] + found.reduction_high[0]) / 2 == pytest.approx(saved)
    middle = (found.baseline_difference_low[0] + found.baseline_difference_high[0]) / 2
    assert middle == pytest.approx(difference)
    assert (found.refits, found.failed) == (12, 0)
    assert "30 trips" in found.text
    columns = ranking.to_polars()
    assert columns["recordings_low_m_s"][0] == found.low[0]
    assert columns["recordings_reduction_high"].is_finite().fill_null(value=False).to_list() == [True, False, False]


def test_a_run_that_goes_on_drives_no_refit_again_and_another_model_meets_none(
    smooth: ScenarioModel, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = read_results(folder)

    def never(*_: object, **__: object) -> None:
        raise AssertionError

    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.running.refits.RefitTask.run", never)
        again = ldc.run_study(STUDY, folder, model=smooth, workers=1, refits=12)
    assert np.array_equal(refits_of(before).S, refits_of(again).S)
    kept = smooth.provenance.recorded
    assert kept is not None
    other = dataclasses.replace(kept, cluster=tuple(range(240)), kind="departures")
    changed = dataclasses.replace(smooth, provenance=dataclasses.replace(smooth.provenance, recorded=other))
    with monkeypatch.context() as patch:  # a run that ends before its refits leaves none of other recordings
        patch.setattr("ldctoolkit.studies.runner.scores_of_refits", never)
        with pytest.raises(AssertionError):
            ldc.run_study(STUDY, folder, model=changed, workers=1, refits=12)
    assert read_results(folder).refits is None
    alone = ldc.run_study(STUDY, folder, model=changed, workers=1, refits=12)
    assert not np.array_equal(refits_of(before).S, refits_of(alone).S)
    assert ldc.run_study(STUDY, folder, model=smooth, workers=1, refits=0).refits is None
    assert read_results(folder).refits is None
    anew = ldc.run_study(STUDY, folder, model=smooth, workers=2, refits=12)
    assert np.array_equal(refits_of(before).S, refits_of(anew).S)


def refits_of(results: StudyResults) -> RefitScores:
    assert results.refits is not None
    return results.refits


def test_a_ranking_with_another_winner_says_that_nothing_is_known(folder: Path) -> None:
    results = read_results(folder)
    swapped = dataclasses.replace(refits_of(results), designs=("0123456789ab", *refits_of(results).designs[1:]))
    ranking = ldc.rank_study(dataclasses.replace(results, refits=swapped), STUDY)
    assert all(np.isnan(values).all() for values in ends(ranking))
    assert ranking.recordings.text.startswith("not known for this winner")


def test_refits_of_which_too_many_fail_say_so(
    smooth: ScenarioModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(model: ScenarioModel, number: int) -> ScenarioModel:
        if number < 2:
            return refit(model, number)
        raise ModelError("side", "cannot be fitted")

    monkeypatch.setattr("ldctoolkit.studies.running.refits.refit", fails)
    results = ldc.run_study(STUDY, tmp_path, model=smooth, workers=1, refits=5)
    assert results.refits is not None
    assert (results.refits.failed, len(results.refits.S)) == (3, 2)
    lines = list(more_lines(rank_study(results, STUDY)))
    assert "Uncertainty from the limited recordings is not known: 3 of 5 refits failed." in lines


def test_a_model_without_recorded_departures_says_so(tmp_path: Path) -> None:
    results = ldc.run_study(STUDY, tmp_path, workers=1)
    assert len(refits_of(results).S) == 0
    found = ldc.rank_study(results, STUDY).recordings
    assert "holds no recorded departures" in found.text
    assert np.isnan(found.low).all()


@pytest.mark.parametrize("refits", [-1, 4, 2.5, True])
def test_numbers_of_refits_that_show_nothing_are_refused(refits: Any) -> None:
    with refused("refits", InputError):
        ldc.run_study(STUDY, refits=refits)


def test_the_first_screen_says_what_is_open(smooth: ScenarioModel, tmp_path: Path) -> None:
    smooth.save(tmp_path / "m.json")
    run = good(
        "run",
        "paper",
        "--model",
        tmp_path / "m.json",
        "-o",
        tmp_path / "out",
        "--no-figures",
        "--refits",
        "6",
        cwd=tmp_path,
    )
    words = " ".join(run.split())
    assert re.search(r"\d+ % either way from the scenarios, \d+ % from the recordings", words)
    assert "240 departures of 30 trips" in words
    page = " ".join((tmp_path / "out" / "report.html").read_text(encoding="utf-8").split())
    assert re.search(r"\d+ % either way from the scenarios, \d+ % from the recordings", page)


@pytest.mark.slow
def test_the_interval_of_the_recordings_covers_the_answer_of_the_population() -> None:
    """20 sets of 240 departures in 25 unequal trips: reduction and difference of the pool lie within in 16 and more.

    Of a 95 % interval, fewer would be seen once in 390; of 40 sets, 40 (S) and 38 (reduction) were measured.
    """
    study = ldc.study(ldc.NoControl, ldc.LQR, name="coverage", left=300, right=300)
    truth = ldc.rank_study(ldc.run_study(study, scenarios=POOL, workers=2, refits=0), study)
    place = next(i for i, design in enumerate(truth.designs) if not design.is_baseline)
    reduction, S = truth.metrics.reduction[place], truth.metrics.S[place]
    within = np.zeros(2)
    for seed in range(20):
        model = fit_scenario_model(trips(120, 25, 0.15, seed=100 + seed), kind="smoothed")
        ranking = ldc.rank_study(ldc.run_study(study, model=model, workers=2), study)
        found, i = ranking.recordings, next(i for i in range(2) if not ranking.designs[i].is_baseline)
        # the ends about the model's own answer, whose draws are of the scenarios' interval
        half = 0.5 * (found.high[i] - found.low[i]), 0.5 * (found.reduction_high[i] - found.reduction_low[i])
        drawn = model.sample(4000, 4000, seed=9)
        answer = ldc.rank_study(ldc.run_study(study, scenarios=drawn, workers=2, refits=0), study)
        j = next(j for j in range(2) if not answer.designs[j].is_baseline)
        gaps = abs(answer.metrics.S[j] - S), abs(answer.metrics.reduction[j] - reduction)
        within += np.array(gaps) <= np.array(half)
    assert (within >= 16).all()
