"""What is left behind by a run that was stopped between its stages, or of other settings, is never taken for new."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ldctoolkit.errors import StoreError
from ldctoolkit.studies import Study, rank_study, read_manifest, read_results, run_study
from ldctoolkit.studies.running import campaign
from ldctoolkit.studies.storage.checked_parts import locked
from ldctoolkit.studies.storage.store import Store

MakeStudy = Callable[..., Study]

FOUR = [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1, 0.15, 0.2]}]


def study_of(make_study: MakeStudy, **parts: Any) -> Study:
    settings: dict[str, Any] = {
        "design": FOUR, "simulation": {}, "scenarios": {"left": 30, "right": 30},
        "ranking": {"bootstrap": 200, "finalists": 3},
    }  # fmt: skip
    return make_study(**(settings | parts))


def stop_at(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    """An interrupt when a stage begins."""
    complete = campaign.Campaign.complete

    def stopped(self: campaign.Campaign, designs: Any, name: str) -> None:
        if name.startswith(stage):
            raise KeyboardInterrupt
        complete(self, designs, name)

    monkeypatch.setattr(campaign.Campaign, "complete", stopped)


def test_finalists_are_the_best_on_other_scenarios(make_study: MakeStudy, tmp_path: Path) -> None:
    study = study_of(make_study)
    results = run_study(study, directory=tmp_path, workers=1)
    fresh = results.fresh
    # three finalists, and the baseline, so that the gain is known on fresh scenarios too
    assert "none" in [design.law for design in fresh.designs]
    assert 3 <= len(fresh.designs) <= 4
    assert not np.isin(fresh.scenarios.d_y, results.scenarios.d_y).any()
    best = rank_study(results, study).designs[0]
    assert best in fresh.designs
    again = read_results(tmp_path)
    np.testing.assert_array_equal(again.fresh.S, fresh.S)
    none = study_of(make_study, ranking={"finalists": 0})
    assert run_study(none, directory=tmp_path, workers=1).fresh is None
    assert read_results(tmp_path).fresh is None


def test_finalists_of_another_ranking_are_not_shown(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    run_study(study_of(make_study), directory=tmp_path, workers=1)
    fewer = study_of(make_study, design=[{"law": "lqr", "y_s": [0.15, 0.2]}])
    with monkeypatch.context() as patch:
        stop_at(patch, "finalists")
        with pytest.raises(KeyboardInterrupt):
            run_study(fewer, directory=tmp_path, workers=1)
    results = read_results(tmp_path)
    assert [design.y_s for design in results.designs] == [0.15, 0.2]
    assert results.fresh is None
    assert "no fresh scores of this ranking yet; run the study again" in caplog.text
    rank_study(results, fewer)
    one = study_of(make_study, design=[{"law": "lqr", "y_s": 0.2}])
    assert run_study(one, directory=tmp_path, workers=1).fresh is None
    assert read_results(tmp_path).fresh is None
    assert run_study(fewer, directory=tmp_path, workers=1).fresh is not None


def test_fresh_scores_of_other_settings_are_not_taken_for_this_rankings(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Stopped before the finalists of a new ranking were chosen: the old ones are finished, and of the same designs."""
    run_study(study_of(make_study), directory=tmp_path, workers=1)
    assert read_results(tmp_path).fresh is not None
    other = study_of(make_study, ranking={"bootstrap": 200, "finalists": 3, "require": ["S < 10"]})
    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.runner.rank_study", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            run_study(other, directory=tmp_path, workers=1)
    assert read_manifest(tmp_path / "finalists").finished
    assert read_results(tmp_path).fresh is None
    assert "no fresh scores of this ranking yet; run the study again" in caplog.text
    assert run_study(other, directory=tmp_path, workers=1).fresh is not None
    assert read_results(tmp_path).fresh is not None


def test_a_refused_run_changes_nothing(make_study: MakeStudy, tmp_path: Path) -> None:
    run_study(study_of(make_study), directory=tmp_path, workers=1)
    before = (tmp_path / "manifest.json").read_bytes()
    with locked(tmp_path), pytest.raises(StoreError, match="another run is writing"):
        run_study(study_of(make_study, design=[{"law": "none"}]), directory=tmp_path, workers=1)
    assert (tmp_path / "manifest.json").read_bytes() == before


SEARCH = {
    "search": {"trials": 12, "batch": 4, "sampler": "random"},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [{"law": "lqr", "y_s": {"from": 0.05, "to": 0.3}, "gains": {"r_delta": {"from": 10, "to": 5000}}}],
}


@pytest.mark.slow
def test_a_search_goes_on_where_it_was_stopped(
    make_study: MakeStudy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stored_rows: Callable[..., Any]
) -> None:
    study = study_of(make_study, **SEARCH)
    whole = run_study(study, directory=tmp_path / "whole", workers=1)
    assert len(whole.designs) == 12
    with monkeypatch.context() as patch:
        stop_at(patch, "designs 5")
        with pytest.raises(KeyboardInterrupt):
            run_study(study, directory=tmp_path / "s", workers=1)
    with pytest.raises(StoreError, match="its search is not over yet; run the study again"):
        read_results(tmp_path / "s")
    # a finished one that is looked through again, and stopped, has lost nothing
    with monkeypatch.context() as patch:
        stop_at(patch, "designs 5")
        with pytest.raises(KeyboardInterrupt):
            run_study(study, directory=tmp_path / "whole", workers=1)
    assert len(Store.open(tmp_path / "whole").designs()) == 12
    for folder in ("s", "whole"):
        results = run_study(study, directory=tmp_path / folder, workers=1)
        assert results.designs == whole.designs
        np.testing.assert_array_equal(read_results(tmp_path / folder).S, whole.S)
    assert stored_rows(tmp_path / "s").equals(stored_rows(tmp_path / "whole"))
    assert read_manifest(tmp_path / "s").finished
