"""S and comfort on the worst of the named vehicles, against runs on vehicles that were changed by hand."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers import LQR
from ldctoolkit import simulate
from ldctoolkit.errors import StudyError
from ldctoolkit.metrics import comfortable_share
from ldctoolkit.plant_options import Actuator, Mismatch, PlantOptions
from studies import Study, rank_study, run_study
from studies.cli import main
from studies.results import StudyResults

CONTENT: dict[str, Any] = {
    "name": "vehicles",
    "seed": 3,
    "scenarios": {"model": "reference", "left": 70, "right": 60},
    "plant": {"actuator": {"lag": 0.1, "rate_max": 0.33}, "mismatch": {"m": [0.95, 1.05]}},
    "ranking": {"bootstrap": 100, "finalists": 0},
    "design": [{"law": "none", "y_s": 0.2}, {"law": "lqr", "y_s": [0.1, 0.2], "gains": {"r_delta": [3000.0, 20000.0]}}],
}
FACTORS = {
    "light": {"m": 0.85, "I_z": 0.85},
    "heavy": {"m": 1.3, "I_z": 1.3},
    "soft": {"C_af": 0.8, "C_ar": 0.8},
    "stiff": {"C_af": 1.2, "C_ar": 1.2},
}


def study(**ranking: Any) -> Study:
    return Study.from_dict(CONTENT | {"ranking": CONTENT["ranking"] | ranking})


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_study(study(), directory=tmp_path_factory.mktemp("vehicles") / "run")


def by_hand(results: StudyResults, r_delta: float, y_s: float, vehicles: dict[str, Any]) -> tuple[float, float]:
    """Largest mean S and least comfortable share; the law is designed on the nominal vehicle."""
    S, comfortable = [], []
    side = results.scenarios.side
    first = np.concatenate([np.flatnonzero(side == one)[:50] for one in (1, -1)])
    some = results.scenarios.take(first)
    for factors in vehicles.values():
        mismatch = Mismatch(**{name: (factor, factor) for name, factor in factors.items()})
        plant = PlantOptions(actuator=Actuator(lag=0.1, rate_max=0.33), mismatch=mismatch)
        setup = dataclasses.replace(study().setup(), options=plant)
        outcome = simulate(LQR(r_delta=r_delta), some, y_s=y_s, setup=setup, window="departure")
        S.append(outcome.S.mean())
        peaks = outcome.companions
        share = comfortable_share(peaks.a_y_added_peak, peaks.jerk_added_peak, outcome.triggered)
        comfortable.append(float(share))
    return max(S), min(comfortable)


@pytest.mark.parametrize("names", [["soft"], ["light", "heavy"], ["light", "heavy", "soft", "stiff"]])
def test_the_worst_is_that_of_vehicles_changed_by_hand(results: StudyResults, names: list[str]) -> None:
    ranking = rank_study(results, study(vehicles=names))[0]
    for i, design in enumerate(ranking.designs):
        if design.is_baseline:
            assert np.isnan(ranking.release.comfortable_worst[i])
            continue
        S, share = by_hand(results, dict(design.gains)["r_delta"], design.y_s, {name: FACTORS[name] for name in names})
        assert ranking.release.S_worst[i] == pytest.approx(S, rel=1e-12)
        assert ranking.release.comfortable_worst[i] == share


def test_a_requirement_on_the_worst_drives_all_four(results: StudyResults) -> None:
    free = rank_study(results, study(vehicles=list(FACTORS)))[0]
    limit = float(np.sort(free.release.S_worst)[1]) + 1e-9
    asked = study(require=[f"S_worst <= {limit}"])
    assert asked.vehicles == ("light", "heavy", "soft", "stiff")
    ranking = rank_study(results, asked)[0]
    assert sum(not missed for missed in ranking.missed) == 2
    np.testing.assert_array_equal(np.sort(ranking.release.S_worst), np.sort(free.release.S_worst))
    assert study(pareto=["S", "comfortable_worst"]).vehicles == asked.vehicles
    assert study().vehicles == ()
    assert np.isnan(rank_study(results, study())[0].release.S_worst).all()


def test_a_vehicle_that_is_none_is_named() -> None:
    with pytest.raises(StudyError, match=r"ranking.vehicles.*'haevy'.*heavy"):
        study(vehicles=["haevy"])


def test_the_command_line_and_the_search_take_the_worst(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = CONTENT | {"search": {"objectives": ["S_worst", "needless"], "trials": 4, "batch": 2}}
    content["design"] = [{"law": "lqr", "y_s": [0.1, 0.2, 0.3], "gains": {"r_delta": [3000.0, 20000.0, 40000.0]}}]
    searched = Study.from_dict(content)
    found = run_study(searched, directory=tmp_path / "run")
    ranking = rank_study(found, searched)[0]
    assert np.isfinite(ranking.release.S_worst).all()
    assert main(["rank", str(tmp_path / "run"), "--require", "S_worst <= 0.01"]) == 0
    assert "Mean S, worst of the named vehicles" in capsys.readouterr().out
