"""Studies on recorded departures themselves: which rows, with which vehicle, and beside a scenario model."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from helpers.cli import bad, good
from helpers.errors import refused
from ldctoolkit import Scenarios, Setup, VehicleParameters, load_model, simulate
from ldctoolkit.controllers import LQR
from ldctoolkit.departures import LEFT, PARAMETER_COLUMNS, PARAMETER_NAMES, RIGHT, Departures, ExtraColumn
from ldctoolkit.errors import InputError, LdcError, StudyError
from ldctoolkit.recordings import Criteria, Provenance, write_departures
from ldctoolkit.studies import Study, read_results, run_study
from ldctoolkit.studies.ranking.ranking import rank_study

LEFT_ROWS, RIGHT_ROWS = 40, 25


def recorded(**extra: np.ndarray) -> Departures:
    """Departures to both sides in turn, in bends, as an extraction would give them; with other columns."""
    drawn = load_model("reference").sample(LEFT_ROWS, RIGHT_ROWS, seed=5)
    drawn = drawn.take(np.random.default_rng(0).permutation(drawn.n))
    columns = {name: getattr(drawn, name) for name in PARAMETER_NAMES}
    assert np.abs(drawn.c_0).min() > 0.0
    return Departures(
        drawn.side, **columns, recording=np.full(drawn.n, "r"), start_time=np.arange(drawn.n) * 20.0,
        samples=np.full(drawn.n, 20), extra=tuple(ExtraColumn(*item) for item in extra.items()),
    )  # fmt: skip


@pytest.fixture
def table(tmp_path: Path) -> Departures:
    """Written to d.parquet, found with a vehicle 1.75 m wide."""
    found = recorded(worth=np.where(np.arange(LEFT_ROWS + RIGHT_ROWS) % 5 == 0, 8.0, 1.0))
    write_departures(tmp_path / "d.parquet", found, Provenance(criteria=Criteria(1.75)))
    return found


def study_on(folder: Path, *, designs: Any = None, **scenarios: Any) -> Study:
    designs = designs or [{"law": "none"}, {"law": "lqr", "y_s": 0.1, "gains": {"r_delta": 500.0}}]
    content = {"name": "r", "seed": 4, "scenarios": scenarios, "design": designs, "ranking": {"bootstrap": 200}}
    return Study.from_dict(content, folder=folder)


def by_hand(found: Departures, rows: np.ndarray, **setup: Any) -> np.ndarray:
    """S of the study's LQR on rows of the table."""
    car = VehicleParameters(w_v=1.75)
    scenarios = Scenarios.from_departures(found.take(rows))
    return simulate(LQR(r_delta=500.0), scenarios, setup=Setup(vehicle=car, seed=4, **setup), y_s=0.1).S


def in_order(found: Departures) -> np.ndarray:
    return np.concatenate([np.flatnonzero(found.side == side) for side in (LEFT, RIGHT)])


def test_scores_are_those_of_simulate_to_the_bit(table: Departures, tmp_path: Path) -> None:
    """All rows, left ones first, with the width that they were found with; without a model there is nothing fresh."""
    results = run_study(study_on(tmp_path, departures="d.parquet"), directory=tmp_path / "out", workers=1)
    assert results.scenarios.side.tolist() == [LEFT] * LEFT_ROWS + [RIGHT] * RIGHT_ROWS
    assert results.S[1].tobytes() == by_hand(table, in_order(table)).tobytes()
    assert results.fresh is None
    stored = read_results(tmp_path / "out")
    assert stored.S.tobytes() == results.S.tobytes()
    again = run_study(study_on(tmp_path, departures="d.parquet"), directory=tmp_path / "out", workers=2)
    assert again.S.tobytes() == results.S.tobytes()


def test_a_right_departure_is_the_mirror_image_of_a_left_one(table: Departures, tmp_path: Path) -> None:
    mirrored = dataclasses.replace(table, side=-table.side)
    write_departures(tmp_path / "m.parquet", mirrored, Provenance(criteria=Criteria(1.75)))
    one, other = (
        run_study(study_on(tmp_path, departures=name), directory=tmp_path / f"out-{name}", workers=1)
        for name in ("d.parquet", "m.parquet")
    )
    left = other.S[1][other.scenarios.side == LEFT]
    np.testing.assert_allclose(left, one.S[1][one.scenarios.side == RIGHT], rtol=1e-9)


def test_some_rows_are_chosen_by_number_and_by_condition(table: Departures, tmp_path: Path) -> None:
    wanted = {"departures": "d.parquet", "left": 7, "right": 0}
    few = run_study(study_on(tmp_path, **wanted), directory=tmp_path / "few", workers=1)
    known = set(table.T[table.side == LEFT].tolist())
    assert few.scenarios.n == 7 == len(set(few.scenarios.T.tolist()) & known)
    low, high = np.quantile(table.v_mean, [0.3, 0.7])
    given = {"v_mean": (float(low), float(high))}
    some = run_study(study_on(tmp_path, departures="d.parquet", given=given), directory=tmp_path / "some", workers=1)
    assert some.scenarios.n == int(((table.v_mean >= low) & (table.v_mean <= high)).sum())
    one = float(table.v_mean[3])
    alone = run_study(study_on(tmp_path, departures="d.parquet", given={"v_mean": one}), directory=tmp_path / "one",
                      workers=1)  # fmt: skip
    assert alone.scenarios.v_mean.tolist() == [one]
    with pytest.raises(InputError, match=r"^scenarios\.left: 41; allowed: up to 40, which d\.parquet holds$"):
        run_study(study_on(tmp_path, departures="d.parquet", left=41), directory=tmp_path / "no", workers=1)


def test_weights_choose_rows_in_proportion(table: Departures, tmp_path: Path) -> None:
    """By default as many as their weights are worth (Kish); each as often as its weight asks for, to within one."""
    weight = next(column.values for column in table.extra if column.name == "worth").astype(float)
    wanted = {"departures": "d.parquet", "weights": "worth"}
    worth = run_study(study_on(tmp_path, **wanted), directory=tmp_path / "a", workers=1).scenarios
    w = weight[table.side == LEFT]
    assert (worth.side == LEFT).sum() == round(w.sum() ** 2 / (w**2).sum()) < LEFT_ROWS
    many = run_study(study_on(tmp_path, **wanted, left=400, right=100), directory=tmp_path / "b", workers=1).scenarios
    for side, n in ((LEFT, 400), (RIGHT, 100)):
        own = table.side == side
        times = np.array([(many.T[many.side == side] == T).sum() for T in table.T[own]])
        np.testing.assert_allclose(times, n * weight[own] / weight[own].sum(), atol=1.0)
    with pytest.raises(LdcError, match=r"^d\.parquet: 'wort' is not a column of numbers; did you mean 'worth'"):
        run_study(study_on(tmp_path, departures="d.parquet", weights="wort"), directory=tmp_path / "no", workers=1)


def test_weights_stay_with_their_rows_where_some_cannot_be_driven(tmp_path: Path) -> None:
    """The first row falls below 1 m/s; 1 and 3 in turn, of which each row of 3 is drawn three times as often."""
    weight = np.tile([1.0, 3.0], 33)[: LEFT_ROWS + RIGHT_ROWS]
    found = recorded(worth=weight)
    found = dataclasses.replace(found, v_mean=np.where(np.arange(found.n) == 0, 0.5, found.v_mean))
    write_departures(tmp_path / "d.parquet", found, Provenance(criteria=Criteria(1.75)))
    wanted = {"departures": "d.parquet", "weights": "worth", "left": 400, "right": 0}
    drawn = run_study(study_on(tmp_path, **wanted), directory=tmp_path / "out", workers=1).scenarios
    own = (found.side == LEFT) & (np.arange(found.n) > 0)
    times = np.array([(drawn.T == T).sum() for T in found.T[own]])
    np.testing.assert_allclose(times, 400 * weight[own] / weight[own].sum(), atol=1.0)


def own_table(path: Path, found: Departures, **changes: Any) -> None:
    columns: dict[str, Any] = {column: getattr(found, name) for name, column in PARAMETER_COLUMNS.items()}
    columns["side"] = ["left" if side == LEFT else "right" for side in found.side.tolist()]
    columns |= changes
    pl.DataFrame({name: values for name, values in columns.items() if values is not None}).write_parquet(path)


def test_a_table_of_the_eight_parameters_is_replayed(table: Departures, tmp_path: Path) -> None:
    own_table(tmp_path / "own.parquet", table)
    study = study_on(tmp_path, table="own.parquet")
    found = run_study(study, directory=tmp_path / "out", workers=1)
    scenarios = Scenarios.from_departures(table.take(in_order(table)))
    expected = simulate(LQR(r_delta=500.0), scenarios, setup=study.setup(), y_s=0.1).S
    assert found.S[1].tobytes() == expected.tobytes()


def test_what_cannot_be_driven_keeps_its_value(table: Departures, tmp_path: Path) -> None:
    own_table(tmp_path / "own.parquet", table, d_y_m=[30.0] * table.n)
    with refused("own.parquet: scenarios.d_y[0]", value=30.0, allowed="up to 10 m"):
        run_study(study_on(tmp_path, table="own.parquet"), workers=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"v_mean_m_s": None, "v_mean_km_h": 90.0}, "own.parquet: column 'v_mean_m_s' is missing; did you mean"),
        ({"v_mean_m_s": 110.0}, "own.parquet: scenarios.v_mean[0]: 110.0; allowed: the speed"),
        ({"d_y_m": 30.0}, "own.parquet: scenarios.d_y[0]: 30.0; allowed: up to 10 m; 65 rows in all"),
        ({"T_s": float("nan")}, "own.parquet, row 1: column 'T_s' holds nan; allowed: no missing value"),
        ({"dc_1_m": "x"}, "own.parquet: column 'dc_1_m' is of type String; allowed: numbers"),
        ({"side": None}, "own.parquet: column 'side' is missing; allowed: left, right"),
        ({"side": "port"}, "own.parquet: scenarios.side[0]: 'port'"),
    ],
)
def test_a_bad_table_gets_one_message(table: Departures, tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    whole = {name: value if value is None else [value] * table.n for name, value in changes.items()}
    own_table(tmp_path / "own.parquet", table, **whole)
    (tmp_path / "s.toml").write_text('name = "s"\nscenarios = {table = "own.parquet"}\n[[design]]\nlaw = "none"\n')
    assert message in bad("run", "s.toml", "-o", "out", cwd=tmp_path)


@pytest.mark.parametrize(
    ("scenarios", "key"),
    [
        ({"departures": "d.parquet", "table": "t.parquet"}, "table"), ({"model": ""}, "model"),
        ({"path": "recorded"}, "path"), ({"table": "t.parquet", "path": "recorded"}, "path"),
        ({"weights": "w"}, "weights"),
    ],
)  # fmt: skip
def test_what_does_not_go_together_is_refused(scenarios: dict[str, Any], key: str, tmp_path: Path) -> None:
    with refused(f"study: scenarios.{key}", StudyError):
        study_on(tmp_path, **scenarios)


def test_finalists_of_a_model_are_scored_on_the_departures_too(table: Departures, tmp_path: Path) -> None:
    designs = [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.1], "gains": {"r_delta": [500.0, 5000.0]}}]
    study = study_on(tmp_path, model="reference", departures="d.parquet", left=30, right=30, designs=designs)
    study = study.changed(vehicle={"w_v": 1.75})
    results = run_study(study, directory=tmp_path / "out", workers=1)
    assert results.scenarios.n == 60
    assert results.fresh is not None
    assert results.replayed is not None
    assert {one.id for one in results.replayed.designs} == {one.id for one in results.fresh.designs}
    ranking = rank_study(results, study)
    i = next(k for k, one in enumerate(ranking.designs) if one.y_s == 0.1 and dict(one.gains)["r_delta"] == 500.0)
    S = by_hand(table, in_order(table))
    assert ranking.replayed.S[i] == pytest.approx(S.mean(), rel=1e-12)
    half = 1.96 * S.std(ddof=1) / np.sqrt(S.size)
    assert S.mean() - 2.5 * half < ranking.replayed.low[i] < S.mean() - half / 2
    assert S.mean() + half / 2 < ranking.replayed.high[i] < S.mean() + 2.5 * half
    none = next(k for k, one in enumerate(ranking.designs) if one.law == "none")
    assert ranking.replayed.reduction[i] == pytest.approx(1.0 - S.mean() / ranking.replayed.S[none], rel=1e-9)
    stored = rank_study(read_results(tmp_path / "out"), study)
    np.testing.assert_array_equal(stored.replayed.S, ranking.replayed.S)
    page = good("report", "out", "--no-robustness", cwd=tmp_path)
    assert "report.html" in page
    html = (tmp_path / "out" / "report.html").read_text()
    assert "on 65 replayed departures" in html
    assert f"{S.mean():.3f}" in html
    assert "On 65 replayed departures its mean S is" in good("rank", "out", cwd=tmp_path)
    assert "replayed_S_m_s" in (tmp_path / "out" / "ranking.csv").read_text()


def test_the_command_line_ranks_on_departures(table: Departures, tmp_path: Path) -> None:
    """In place of the study's model, with the recorded width, and under the table's own name."""
    (tmp_path / "s.toml").write_text(
        'name = "s"\n[scenarios]\nmodel = "reference"\nleft = 3\nright = 3\n[[design]]\nlaw = "none"\n'
        '[[design]]\nlaw = "lqr"\ny_s = 0.1\ngains = {r_delta = 500.0}\n'
    )
    out = good("run", "s.toml", "--departures", "d.parquet", "-o", "out", "--no-robustness", cwd=tmp_path)
    assert "s: 2 designs x 65 scenarios" in out
    assert "replayed departures d.parquet" in out
    html = (tmp_path / "out" / "report.html").read_text()
    assert "Recorded departures, replayed: 65 of d.parquet" in html
    assert str(tmp_path) not in (tmp_path / "out" / "manifest.json").read_text()
    assert read_results(tmp_path / "out").scenarios.n == 65
    assert "holds another study" in bad("run", "s.toml", "-o", "out", cwd=tmp_path)
    assert "nowhere.parquet: cannot be read" in bad("run", "s.toml", "--departures", "nowhere.parquet", cwd=tmp_path)
    both = good(
        "run", "s.toml", "--model", "reference", "--departures", "d.parquet", "-o", "both", "--no-robustness",
        "--vehicle-width", "1.75", cwd=tmp_path,
    )  # fmt: skip
    assert "s: 2 designs x 6 scenarios" in both
    assert "On 65 replayed departures" in both


def test_a_model_beside_a_study_of_departures_generates_its_scenarios(table: Departures, tmp_path: Path) -> None:
    """500 a side, and the departures are for the finalists."""
    (tmp_path / "s.toml").write_text(
        'name = "s"\nscenarios = {departures = "d.parquet"}\nvehicle = {w_v = 1.75}\n[[design]]\nlaw = "none"\n'
        '[[design]]\nlaw = "lqr"\ny_s = 0.1\n'
    )
    out = good("run", "s.toml", "--model", "reference", "-o", "out", "--no-robustness", cwd=tmp_path)
    assert "s: 2 designs x 1,000 scenarios" in out
    assert "scenario model reference" in out
    assert "On 65 replayed departures" in out
    assert "On 65 replayed departures" in good("rank", "out", cwd=tmp_path)


def test_departures_too_slow_to_drive_are_left_out_and_counted(table: Departures, tmp_path: Path) -> None:
    slow = dataclasses.replace(table, v_mean=np.where(np.arange(table.n) < 3, 0.8, table.v_mean), a_mean=0 * table.T)
    write_departures(tmp_path / "slow.parquet", slow, Provenance(criteria=Criteria(1.75)))
    results = run_study(study_on(tmp_path, departures="slow.parquet"), directory=tmp_path / "out", workers=1)
    assert results.scenarios.n == table.n - 3
    assert "3 of them fall below 1 m/s" in (tmp_path / "out" / "manifest.json").read_text()


def test_the_recorded_path_is_replayed_from_the_second_table(tmp_path: Path) -> None:
    """Extracted, run, read again: S is that of `simulate` with the signals, and not that of the parabolas."""
    from ldctoolkit.recordings import read_departures

    t = np.arange(0.0, 400.0, 0.1)
    offset = 0.85 + 0.25 * np.sin(0.9 * t) * np.sin(0.017 * t + 0.4) ** 2 - 0.1
    lines = [
        f"a,{a:.1f},{b:.6f},3.6,{20 + np.sin(a):.4f},0.0005" for a, b in zip(t.tolist(), offset.tolist(), strict=True)
    ]
    (tmp_path / "drive.csv").write_text(
        "recording,t,lane_offset,lane_width,speed,curvature\n" + "\n".join(lines) + "\n"
    )
    # always left of the lane's centre, which no vehicle is
    good("extract", "drive.csv", "--vehicle-width", "1.9", "--signals", "--force", "-o", "d.parquet", cwd=tmp_path)
    found, _ = read_departures(tmp_path / "d.parquet", signals=True)
    assert found.n > 10
    study = study_on(tmp_path, departures="d.parquet", path="recorded")
    run_study(study, directory=tmp_path / "out", workers=2)
    stored = read_results(tmp_path / "out")
    S = simulate(LQR(r_delta=500.0), Scenarios.from_departures(found, path="recorded"), setup=study.setup(), y_s=0.1).S
    order = in_order(found)
    assert stored.S[1].tobytes() == S[order].tobytes()
    parabolas = simulate(LQR(r_delta=500.0), Scenarios.from_departures(found), setup=study.setup(), y_s=0.1).S
    assert np.abs(S - parabolas).max() > 1e-3
    good("report", "out", "--no-robustness", cwd=tmp_path)
    (tmp_path / "d.signals.parquet").unlink()
    with pytest.raises(LdcError, match=r"d\.signals\.parquet: cannot be read: .*; needed: a table of signals"):
        run_study(study, directory=tmp_path / "again", workers=1)
