"""A study that grows: more scenarios in the same folder; scenarios that keep their numbers and their paths."""

import json
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ldctoolkit as ldc
from helpers.pages import Page
from helpers.results import assert_same_results
from ldctoolkit.studies.cli import main
from ldctoolkit.studies.ranking.verdict import verdict
from ldctoolkit.studies.running import tasks
from ldctoolkit.studies.study_file import toml_text

NOISY = {
    "actuator": {"lag": 0.1, "delay": 0.07},
    "sensors": {"e_y_noise": 0.05, "e_psi_noise": 0.003},
    "mismatch": {"m": [0.9, 1.1]},
    "residuals": {"y": True, "v": True},
}


def noisy(left: int, right: int, **tables: Any) -> ldc.Study:
    return ldc.study(
        ldc.NoControl, ldc.LQR, {"law": "pid", "y_s": [0.05, 0.1]}, plant=NOISY, name="noisy", left=left, right=right,
        ranking={"finalists": 2, "bootstrap": 100}, **tables,
    )  # fmt: skip


@pytest.fixture
def driven(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Scenarios of each run of a design."""
    counts: list[int] = []
    drive_many = tasks.drive_many

    def watched(controllers: Any, takeover: Any, **named: Any) -> Any:
        counts.extend(takeover.scenarios.n for _ in controllers)
        return drive_many(controllers, takeover, **named)

    monkeypatch.setattr(tasks, "drive_many", watched)
    return counts


def test_more_scenarios_are_those_of_a_study_that_began_with_them(
    tmp_path: Path, driven: list[int], caplog: pytest.LogCaptureFixture
) -> None:
    small = ldc.run_study(noisy(6, 9), tmp_path / "out", workers=1)
    whole = ldc.run_study(noisy(15, 10), tmp_path / "whole", workers=1)
    with caplog.at_level(logging.WARNING):
        grown = ldc.run_study(noisy(15, 10), tmp_path / "out", workers=1)
    assert not caplog.records
    assert_same_results(grown, whole)
    assert_same_results(ldc.read_results(tmp_path / "out"), whole)
    rows = np.flatnonzero(np.isin(whole.scenarios.index, small.scenarios.index))
    assert rows.size == 15
    np.testing.assert_array_equal(grown.S[:, rows], small.S)
    driven.clear()
    ldc.run_study(noisy(15, 10), tmp_path / "out", workers=1)
    assert driven == []
    # and back: what is there of more scenarios is not in the way
    assert_same_results(ldc.run_study(noisy(6, 9), tmp_path / "out", workers=1), small)
    assert driven == []
    assert_same_results(ldc.read_results(tmp_path / "out"), small)


def test_batches_that_are_there_are_not_driven_again(
    tmp_path: Path, driven: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ldc.Controller, "batch", 10)
    ldc.run_study(noisy(20, 20), tmp_path / "out", workers=1)
    before = sum(driven)
    ldc.run_study(noisy(20, 40), tmp_path / "out", workers=1)
    assert sum(driven) - before == 4 * 20 + 3 * 20  # four designs, and three finalists with the baseline


def test_two_sizes_are_compared_on_what_both_have(tmp_path: Path) -> None:
    for name, counts in (("small", (8, 6)), ("large", (12, 20))):
        ldc.run_study(noisy(*counts), tmp_path / name, workers=1)
    compared = ldc.compare(tmp_path / "small", tmp_path / "large")
    assert (compared.shared.left, compared.shared.right, compared.shared.other_draws) == (8, 6, 0)
    assert (compared.S.difference == 0.0).all()
    assert compared.differences == ("scenarios.left: 8 -> 12", "scenarios.right: 6 -> 20")


def scenarios_of(how: str) -> ldc.Scenarios:
    if how == "drift":
        return ldc.Scenarios.from_drifts(
            v=[20.0, 25.0, 22.0], lateral_velocity=[0.4, 0.5, 0.6], radius=1200.0, distance=[0.5, 0.4, 0.3], T=6.0,
            side=[-1, 1, 1],
        )  # fmt: skip
    drawn = ldc.load_model("reference").sample(3, 3, seed=2)
    return drawn.take(np.array([3, 0, 4, 1, 5, 2]))  # right ones at even rows


@pytest.mark.parametrize("how", ["drawn", "drift"])
def test_given_scenarios_are_read_back(tmp_path: Path, how: str, make_study: Callable[..., ldc.Study]) -> None:
    given = scenarios_of(how)
    results = ldc.run_study(noisy(1, 1), tmp_path, scenarios=given, workers=1)
    back = ldc.read_results(tmp_path)
    assert_same_results(back, results)
    assert (
        back.scenarios.index.tolist()
        == results.scenarios.index.tolist()
        == np.argsort(-given.side, kind="stable").tolist()
    )
    for design, S in zip(back.designs, back.S, strict=True):
        again = ldc.simulate(design.controller(), back.scenarios, design.y_s, setup=noisy(1, 1).setup())
        np.testing.assert_array_equal(again.S, S)
    assert (back.scenarios.drift is None) == (how == "drawn")


# ------------------------------------------------------------------------------------------------ beyond a sweep's end
SOFT_FIRST = {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": [40_000.0, 20_000.0]}}


def swept(*designs: Any, r_delta: list[float] | None = None, extend: int = 0, require: Any = ()) -> ldc.Study:
    """LQR whose S falls with r_delta."""
    block = SOFT_FIRST if r_delta is None else SOFT_FIRST | {"gains": {"r_delta": r_delta}}
    ranking = {"finalists": 2, "bootstrap": 100, "extend": extend, "require": require}
    return ldc.study(ldc.NoControl, block, *designs, name="swept", left=15, right=15, ranking=ranking)


def test_a_run_goes_on_beyond_the_end_of_a_sweep(tmp_path: Path, driven: list[int]) -> None:
    """The same as the study that has these values from the start, in one run, resumed, or with another block size."""
    longer = [40_000.0, 20_000.0, 10_000.0, 5000.0]
    whole = ldc.run_study(swept(r_delta=longer), tmp_path / "whole", workers=1)
    results = ldc.run_study(swept(extend=2), tmp_path / "out", workers=1)
    assert_same_results(results, whole)
    assert results.fresh is not None
    assert whole.fresh is not None
    assert_same_results(results.fresh, whole.fresh)
    stored = ldc.read_results(tmp_path / "out")
    assert_same_results(stored, whole)
    assert_same_results(stored.fresh or whole, whole.fresh)
    manifest = ldc.studies.read_manifest(tmp_path / "out")
    assert manifest.extended == ("lqr: r_delta = 10000", "lqr: r_delta = 5000")
    assert manifest.read_study().designs == whole.designs
    driven.clear()
    assert_same_results(ldc.run_study(swept(extend=2), tmp_path / "out", workers=1, block_size=1), whole)
    assert driven == []
    # a run without is another study in the same folder, and one that stops in between is resumed
    short = ldc.run_study(swept(extend=2), tmp_path / "out", workers=1, extend=False)
    assert [dict(design.gains).get("r_delta") for design in short.designs] == [None, 40_000.0, 20_000.0]
    assert ldc.studies.read_manifest(tmp_path / "out").extended == ()
    assert_same_results(ldc.run_study(swept(extend=2), tmp_path / "out", workers=1), whole)
    assert driven == []


def test_bounds_are_those_of_the_first_study_in_the_folder(tmp_path: Path, driven: list[int]) -> None:
    """The study that a folder holds, with the lists that it has made longer, is not the start of another extension."""
    longest = [40_000.0, 20_000.0, 10_000.0, 5000.0, 2500.0]
    for extend, values in ((2, longest[:4]), (2, longest[:4]), (9, longest), (9, longest)):
        again = ldc.studies.read_manifest(tmp_path).read_study() if driven else swept()
        driven.clear()
        results = ldc.run_study(again.changed(ranking={"extend": extend}), tmp_path, workers=1)
        assert [dict(design.gains)["r_delta"] for design in results.designs[1:]] == values
        manifest = ldc.studies.read_manifest(tmp_path)
        assert manifest.extended == tuple(f"lqr: r_delta = {value:g}" for value in values[2:])
    results = ldc.run_study(manifest.read_study(), tmp_path, workers=1, extend=False)
    assert len(results.designs) == 6
    assert ldc.studies.read_manifest(tmp_path).extended == manifest.extended
    # other lists are another study's
    results = ldc.run_study(swept(extend=1, r_delta=longest[1:]), tmp_path, workers=1)
    assert [dict(design.gains)["r_delta"] for design in results.designs[1:]] == [*longest[1:], 1250.0]
    assert ldc.studies.read_manifest(tmp_path).extended == ("lqr: r_delta = 1250",)


@pytest.mark.slow
def test_an_extension_is_the_same_in_processes(tmp_path: Path) -> None:
    alone = ldc.run_study(swept(extend=2), workers=1)
    assert_same_results(ldc.run_study(swept(extend=2), tmp_path / "out", workers=2, block_size=1), alone)


@pytest.mark.parametrize(
    ("study", "values"),
    [
        # three designs: at most three more, whatever `extend` says
        (swept(), [40_000.0, 20_000.0, 10_000.0, 5000.0, 2500.0]),
        (swept(extend=1), [40_000.0, 20_000.0, 10_000.0]),
        # the last step ends at the largest weight that the law allows, where there is nothing beyond
        (swept(r_delta=[3e5, 6e5], require="S >= 0", extend=5), [3e5, 6e5, 1.5e5, 7.5e4, 3.75e4]),
        (swept(r_delta=[20_000.0], extend=5), [20_000.0]),
        (swept(SOFT_FIRST | {"gains": {"r_delta": 10_000.0}}, r_delta=[20_000.0], extend=5), [20_000.0, 10_000.0]),
        (swept(r_delta=[5000.0, 40_000.0, 20_000.0, 10_000.0], require="S > 1e3", extend=5), [5e3, 4e4, 2e4, 1e4]),
    ],
)
def test_extensions_are_bounded(study: ldc.Study, values: list[float]) -> None:
    results = ldc.run_study(study, workers=1, extend=True)
    assert [dict(design.gains)["r_delta"] for design in results.designs[1:]] == values


def test_a_requirement_ends_an_extension() -> None:
    """The value that breaks it is tried and not ranked; the winner then lies inside."""
    free = ldc.rank_study(results := ldc.run_study(swept(extend=3), workers=1), swept())
    peaks = dict(zip((d.y_s and dict(d.gains).get("r_delta") for d in free.designs),
                     free.metrics.beside["a_y_added_peak_p95"].tolist(), strict=True))  # fmt: skip
    assert len(results.designs) == 6
    study = swept(require=f"a_y_added_peak_p95 <= {0.5 * (peaks[10_000.0] + peaks[5000.0])}", extend=3)
    results = ldc.run_study(study, workers=1)
    ranking = ldc.rank_study(results, study)
    assert [dict(design.gains).get("r_delta") for design in results.designs[-2:]] == [10_000.0, 5000.0]
    assert dict(ranking.designs[ranking.winner or 0].gains)["r_delta"] == 10_000.0
    (blocked,) = verdict(ranking, results).blocked
    assert (blocked.gain.name, blocked.value) == ("r_delta", 5000.0)


def test_commands_see_what_was_added(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Terminal, one line of JSON, report and Markdown; `ldc rank` reads the same from the folder."""
    (tmp_path / "s.toml").write_text(toml_text(swept(extend=1)), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    plain = ["--workers", "1", "--no-figures", "--no-robustness", "-o", "out"]
    line = "r_delta = 10000 is the end of its sweep: extend it."
    for command in (["run", "s.toml", *plain], ["rank", "out"]):
        assert main(command) == 0
        out = capsys.readouterr().out
        assert line in out.splitlines()
        assert "Added beyond the ends of sweeps: lqr: r_delta = 10000." in out.splitlines()
    assert line in (tmp_path / "out/ranking.md").read_text(encoding="utf-8").replace("\\_", "_")
    page = Page((tmp_path / "out/report.html").read_text(encoding="utf-8"))
    assert "r δ = 10000 is the end of its sweep: extend it." in page.words("verdict").replace("rδ", "r δ")
    assert "designs4added beyond the ends of sweepslqr: r δ = 10000" in page.words("settings").replace("rδ", "r δ")
    for command, designs, value, added in (
        (["rank", "out"], 4, 10_000.0, ["lqr: r_delta = 10000"]),
        (["run", "s.toml", "--extend", *plain], 4, 10_000.0, ["lqr: r_delta = 10000"]),
        (["run", "s.toml", "--no-extend", *plain], 3, 20_000.0, []),
    ):
        assert main([*command, "--json"]) == 0
        done = json.loads(capsys.readouterr().out.splitlines()[-1])
        ends = [{"name": "r_delta", "value": value, "text": f"r_delta = {value:g} is the end of its sweep: extend it"}]
        assert (done["designs"], done["sweep_ends"], done["extended"]) == (designs, ends, added)
        assert done["binding"] == done["blocked"] == []


def test_a_search_has_no_list_to_extend() -> None:
    tables = {"search": {"trials": 2}, "ranking": {"extend": 1}}
    with pytest.raises(ldc.errors.StudyError) as raised:
        ldc.study({"law": "lqr", "gains": {"r_delta": {"from": 1e3, "to": 1e4}}}, **tables)
    assert (raised.value.path.split(": ")[-1], raised.value.allowed) == ("ranking.extend", "0")
