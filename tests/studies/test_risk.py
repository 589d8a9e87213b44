"""Rare events: counts against direct simulation, intervals against their closed form and their coverage, no number that
depends on workers or on where a run was stopped."""

import csv
import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from helpers.bits import assert_same_bits
from helpers.cli import bad, good, ldc
from helpers.closed_loop import known
from helpers.errors import refused
from helpers.kills import killing
from helpers.models import varied_departures
from ldctoolkit import Controller, LinearLaw, Plant, Scenarios, gain, load_model, simulate
from ldctoolkit.departures import PARAMETER_NAMES
from ldctoolkit.errors import InputError, LdcError, StoreError
from ldctoolkit.scenario_model import ScenarioModel, fit_scenario_model
from ldctoolkit.scenario_model.refit import refit
from ldctoolkit.studies import Design, Study
from ldctoolkit.studies.pages.risk_page import probabilities
from ldctoolkit.studies.ranking.inference import exact_interval, paired_sign
from ldctoolkit.studies.risk import Risk, estimate_risk
from ldctoolkit.studies.study_file import load_study

PAPER = load_study("paper")
TABLE_I = PAPER.designs[1]
EVENTS = (
    "depth > 0.3 m", "depth > 0.5 m", "depth > 0.8 m", "depth > 1 m", "depth > 1.75 m", "DTLE < -0.1 m",
    "DTLE < -0.3 m", "opposite line crossed", "diverged",
)  # fmt: skip


# ------------------------------------------------------------------------------------------------ intervals, pairs


@pytest.mark.parametrize(("count", "n"), [(0, 1), (1, 1), (3, 20), (0, 10_000_000), (7, 10_000_000), (999, 1000)])
def test_intervals_are_those_of_clopper_and_pearson(count: int, n: int) -> None:
    expected = binomtest(count, n).proportion_ci(0.95, method="exact")
    assert exact_interval(count, n) == pytest.approx((expected.low, expected.high), rel=1e-9)
    assert exact_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("b", "c", "sign"),
    [(0, 0, 0), (0, 5, 0), (0, 6, -1), (6, 0, 1), (9, 2, 0), (10, 2, 1), (2, 10, -1), (5000, 5000, 0), (5200, 4800, 1)],
)
def test_pairs_are_separated_by_the_exact_test(b: int, c: int, sign: int) -> None:
    """0 of 5 has p = 0.0625, 0 of 6 has 0.031; 2 of 11 has 0.065, 2 of 12 has 0.039."""
    assert paired_sign(b, c) == sign


# ------------------------------------------------------------------------------------------------ counts


REAL = load_study("trigger-and-gains")
STEERING = [design for design in REAL.designs if design.law in ("lqr", "lqi") and design.y_s in (0.05, 0.2)][::5]


def departures(model: ScenarioModel, seed: int, chunk: int, sizes: list[tuple[int, int]]) -> Iterator[Scenarios]:
    """What chunks of so many left and right departures hold, drawn directly."""
    for k, (left, right) in enumerate(sizes):
        state = np.random.SeedSequence([seed, 0x7269736B, k]).generate_state(1, np.uint64)[0]
        drawn = model.sample(left, right, seed=int(state >> 1))
        yield dataclasses.replace(drawn, index=np.arange(drawn.n) + k * chunk)


def events_of(design: Design, scenarios: Scenarios, study: Study) -> np.ndarray:
    out = simulate(design.controller(), scenarios, setup=study.setup(), y_s=design.y_s)
    depth, dtle = out.metrics.deepest, out.metrics.dtle
    beyond = [depth > x for x in (0.3, 0.5, 0.8, 1.0, 1.75)] + [dtle < -0.1, dtle < -0.3]
    return np.array([*beyond, out.metrics.opposite_crossing > 0, out.status == 3])


@pytest.fixture(scope="module")
def risk() -> Risk:
    """A realistic plant, several thresholds, a last chunk that is not whole."""
    return estimate_risk(STEERING, REAL, n=620, chunk=250, workers=1)


@pytest.fixture(scope="module")
def drawn() -> list[Scenarios]:
    """The departures of `risk`, drawn directly."""
    return list(departures(load_model("reference"), 1, 250, [(125, 125), (125, 125), (60, 60)]))


def test_counts_are_those_of_a_direct_simulation(risk: Risk, drawn: list[Scenarios]) -> None:
    assert risk.events == EVENTS
    assert risk.n == 620
    without = np.concatenate([events_of(risk.designs[0], one, REAL) for one in drawn], axis=1)
    left = np.concatenate([one.side == 1 for one in drawn])
    for design in STEERING:
        found = np.concatenate([events_of(design, one, REAL) for one in drawn], axis=1)
        for j, event in enumerate(EVENTS):
            pair = risk.event(design, event)
            assert risk.event(design, event).count == found[j].sum()
            assert risk.event(design, event, "left").count == (found[j] & left).sum()
            assert risk.event(design, event, "right").count == (found[j] & ~left).sum()
            assert risk.event(risk.designs[0], event).count == without[j].sum()
            assert pair.design_only == (found[j] & ~without[j]).sum()
            assert pair.no_control_only == (without[j] & ~found[j]).sum()
    assert risk.event(STEERING[0], "depth > 0.3 m").count > 10


def test_the_worst_departures_are_the_deepest_and_are_driven_again_to_the_same_bits(
    risk: Risk, drawn: list[Scenarios]
) -> None:
    for design in risk.designs:
        runs = [simulate(design.controller(), one, setup=REAL.setup(), y_s=design.y_s) for one in drawn]
        depth = np.concatenate([one.metrics.deepest for one in runs])
        order = np.argsort(-depth)[:20]
        assert risk.worst(design).index.tolist() == np.concatenate([one.index for one in drawn])[order].tolist()
        again = simulate(design.controller(), risk.worst(design), setup=risk.setup, y_s=design.y_s)
        kept = np.array([row["deepest_m"] for row in risk.worst_rows(design)])
        assert_same_bits(again.metrics.deepest, kept)
        assert_same_bits(kept, depth[order])
        depths, shares = risk.exceedance(design)
        np.testing.assert_allclose((depths[0], depths[9], depths[-1]), (0.05, 0.5, 3.0), rtol=1e-12)
        np.testing.assert_allclose(shares, [np.mean(depth >= x) for x in depths], rtol=0.0, atol=1e-12)


def test_fewer_departures_than_are_kept_and_a_trigger_before_the_line() -> None:
    design = Design.from_gains("lqr", -0.8, {"r_delta": 100.0})
    risk = estimate_risk([design], PAPER, n=15, workers=1)
    depths = [row["deepest_m"] for row in risk.worst_rows(design)]
    assert len(depths) == risk.worst(design).n == 15
    assert depths == sorted(depths, reverse=True)
    assert risk.exceedance(design)[1][0] == np.mean(np.array(depths) >= 0.05)


def test_what_the_worst_have_in_common_is_how_far_their_mean_is_from_that_of_all() -> None:
    """The population's numbers from 40,000 other departures: to 0.05 of a standard deviation."""
    risk = estimate_risk([TABLE_I], PAPER, n=2000, chunk=1000, workers=1)
    common, worst = risk.in_common(TABLE_I), risk.worst(TABLE_I)
    every = load_model("reference").sample(20_000, 20_000, seed=77)

    def columns(some: Scenarios) -> dict[str, np.ndarray]:
        named = {name: getattr(some, name) for name in PARAMETER_NAMES}
        return named | {"v^2 c": some.v_mean**2 * (some.c_0 + some.dc / 2)}

    for name, difference, mean in zip(common.names, common.differences, common.mean, strict=True):
        of_all, of_worst = columns(every)[name], columns(worst)[name]
        assert mean == pytest.approx(of_worst.mean(), rel=1e-9)
        assert difference == pytest.approx((of_worst.mean() - of_all.mean()) / of_all.std(), rel=0.03, abs=0.05)
    assert np.all(np.diff(np.abs(common.differences)) <= 0)
    assert common.names[0] == "v^2 c"
    assert common.sentence.startswith("In common to the 20 worst departures: v^2 c 0.929 instead of")


@pytest.mark.parametrize("events", [{"left": (7, None), "right": (3, None)}, {"left": (3, 7.0), "right": (9, 3.0)}])
def test_sides_are_drawn_as_they_were_recorded_and_rates_follow(events: dict[str, tuple[int, float | None]]) -> None:
    """7 left departures to 3 right ones, or as many that the recorded ones stand for; 10 departures in 2 hours and
    100 km are 5 an hour and 100 per 1,000 km.
    """
    model = load_model("reference")
    origin = model.provenance
    sides = {
        key: dataclasses.replace(getattr(origin, key), events=n, weight=weight) for key, (n, weight) in events.items()
    }
    model = dataclasses.replace(model, provenance=dataclasses.replace(origin, **sides, hours=2.0, distance=1e5))
    risk = estimate_risk([TABLE_I], PAPER, n=1001, chunk=100, model=model, workers=1)
    assert risk.tally.n.tolist() == [701, 300]
    assert risk.departure_rates() == {"per_1000_km": 100.0, "per_hour": 5.0}
    assert risk.departure_rates("right") == {"per_1000_km": 30.0, "per_hour": 1.5}
    row = next(row for row in risk.rows() if row["event"] == "depth > 0.3 m" and row["side"] == "both")
    found = risk.event(risk.designs[0], "depth > 0.3 m")
    assert row["per_hour"] == 5.0 * found.count / 1001
    assert row["per_1000_km_high"] == 100.0 * found.high
    assert estimate_risk([TABLE_I], PAPER, n=10, workers=1).departure_rates() == {}


def test_the_papers_law_is_worse_than_no_control_in_the_tail() -> None:
    """Better up to 0.5 m, worse beyond 0.8 m and 1 m: the mean does not show it."""
    risk = estimate_risk([TABLE_I], PAPER, n=20_000, workers=1)
    signs = {event: risk.event(TABLE_I, event).sign for event in EVENTS}
    assert signs["depth > 0.3 m"] == -1
    assert signs["depth > 0.8 m"] == signs["depth > 1 m"] == signs["depth > 1.75 m"] == 1
    light = risk.light(TABLE_I)
    assert light.state == "bad"
    assert light.text.startswith("Worse than no control: depth > 0.8 m (")


@pytest.mark.parametrize(
    ("event", "state"),
    [
        ("depth > 0.3 m", "bad"), ("DTLE < -0.3 m", "bad"), ("diverged", "bad"), ("opposite line crossed", "warning"),
        (None, "warning"),
    ],
)  # fmt: skip
def test_what_is_worse_than_without_control_is_red(event: str | None, state: str) -> None:
    """12 departures that have one event with the design alone; 9 that have another only without it are better."""
    risk = estimate_risk([TABLE_I], PAPER, n=20, workers=1)
    counts, only = np.zeros_like(risk.tally.counts), np.zeros_like(risk.tally.only)
    if event is not None:
        counts[1, EVENTS.index(event), 0] = only[1, EVENTS.index(event), 0] = 12
        counts[0, EVENTS.index("depth > 1 m"), 1] = 9
    made = dataclasses.replace(risk, tally=dataclasses.replace(risk.tally, counts=counts, only=only))
    assert made.light(TABLE_I).state == state
    if event is not None:
        assert [made.event(TABLE_I, one).sign for one in (event, "depth > 1 m")] == [1, -1]


def test_the_worst_beyond_what_was_recorded_are_named_at_both_ends() -> None:
    """Quantiles of the recorded departures that begin above every generated speed, or end below every d_y."""
    risk = estimate_risk([TABLE_I], PAPER, n=200, workers=1)
    model = risk.job.model
    sides = {}
    for name in ("left", "right"):
        side = getattr(model.provenance, name)
        known = dict(zip(side.source_summary.names, side.source_summary.quantiles, strict=True))
        wide = dict.fromkeys(known, (-1000000000.0, 1000000000.0)) | {"v_mean": (1e3, 1e9), "d_y": (-1e9, -1.0)}
        summary = dataclasses.replace(side.source_summary, quantiles=tuple(wide[key] for key in known))
        sides[name] = dataclasses.replace(side, source_summary=summary)
    model = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, **sides))
    made = dataclasses.replace(risk, job=dataclasses.replace(risk.job, model=model))
    beyond = [text for text in made.in_common(TABLE_I).warnings if "beyond the outermost quantiles" in text]
    assert [text.split(" beyond")[0] for text in sorted(beyond)] == [
        "20 of the 20 worst departures have d_y", "20 of the 20 worst departures have v_mean",
    ]  # fmt: skip


def test_one_line_says_what_n_can_show() -> None:
    lines: list[str] = []
    estimate_risk([TABLE_I], PAPER, n=20_000, workers=1, notice=lines.append)
    assert len(lines) == 1
    assert lines[0].endswith("with n = 20,000 nothing below 1.5e-04 can be detected")


# ------------------------------------------------------------------------------------------------ resume


def assert_same(one: Risk, other: Risk) -> None:
    assert_same_bits(vars(one.tally), vars(other.tally))
    assert_same_bits(one.population, other.population)


class StoppedError(Exception):
    """Out of a line on progress."""


def stop(line: str) -> None:
    raise StoppedError(line)


def test_a_run_that_was_stopped_goes_on(tmp_path: Path) -> None:
    small: dict[str, Any] = {"chunk": 250, "workers": 1}
    with pytest.raises(StoppedError):
        estimate_risk([TABLE_I], PAPER, n=1100, directory=tmp_path, notice=stop, **small)
    (part,) = (tmp_path / "risk.parts").glob("part-*")
    assert json.loads(part.read_text())[0] == [0, 1]
    assert_same(
        estimate_risk([TABLE_I], PAPER, n=1100, directory=tmp_path, **small),
        estimate_risk([TABLE_I], PAPER, n=1100, **small),
    )
    with pytest.raises(StoreError, match=r"risk.parts: its parts are of another plan \(n: 1100 there, 1000 now\)"):
        estimate_risk([TABLE_I], PAPER, n=1000, directory=tmp_path, **small)


@pytest.mark.slow
def test_numbers_do_not_depend_on_workers(tmp_path: Path) -> None:
    """Nor on where a chunk ran: 40 chunks in two processes, or on a cluster, end in any order."""
    same: dict[str, Any] = {"n": 20_100, "chunk": 500}
    one = estimate_risk(STEERING, REAL, workers=1, **same)
    assert_same(estimate_risk(STEERING, REAL, workers=2, **same), one)
    assert_same(estimate_risk(STEERING, REAL, workers=2, dask="local", **same), one)


KILLED = """
from ldctoolkit.studies import risk
from ldctoolkit.studies.study_file import load_study

risk._STORE_EVERY = -1.0
study = load_study("trigger-and-gains")
risk.estimate_risk([study.designs[-1]], study, n=3_700, chunk=500, workers=2, directory=sys.argv[1])
"""


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    """Killed while it writes the counts of the third of eight chunks: those of two are there."""
    code = killing(tmp_path / "risk.parts" / ".part", 8) + KILLED
    process = subprocess.run([sys.executable, "-c", code, str(tmp_path)], timeout=600, check=False)
    assert process.returncode == -signal.SIGKILL
    assert len(list(tmp_path.glob("risk.parts/.part-*.part"))) == 1
    assert len(list(tmp_path.glob("risk.parts/part-*"))) == 2
    assert not (tmp_path / "risk.json").exists()
    design, same = REAL.designs[-1], {"n": 3_700, "chunk": 500}
    resumed = estimate_risk([design], REAL, **same, workers=1, directory=tmp_path)
    assert_same(resumed, estimate_risk([design], REAL, **same, workers=2))
    assert not list(tmp_path.rglob(".*.part"))


# ------------------------------------------------------------------------------------------------ coverage


TRUTH = {"depth > 0.5 m": 0.05046986, "depth > 1 m": 0.00847753, "depth > 1.75 m": 0.0010431}
"""Of the paper's law: counted over n = 100,000,000 departures with `estimate_risk([TABLE_I], PAPER, n=10**8,
seed=20260101)`, 40 minutes on two cores; 95 % intervals are within 0.1 %, 0.3 % and 0.7 % of these."""


@pytest.mark.slow
def test_intervals_cover_the_truth() -> None:
    """200 seeds of 5,000 departures; exact intervals cover at least as often as they say, and little more."""
    covered = dict.fromkeys(TRUTH, 0)
    for seed in range(200):
        risk = estimate_risk([TABLE_I], PAPER, n=5000, seed=seed, workers=1)
        for event, truth in TRUTH.items():
            found = risk.event(TABLE_I, event)
            covered[event] += found.low <= truth <= found.high
    assert all(0.95 <= count / 200 <= 0.99 for count in covered.values()), covered


# ------------------------------------------------------------------------------------------------ wrong input


@dataclasses.dataclass(frozen=True)
class Breaks(Controller):
    name = "breaks"
    title = "Breaks"
    dies: bool = gain(False, unit="1", description="ends its process")

    def prepare(self, plant: Plant) -> LinearLaw:
        if self.dies:
            os._exit(1)
        raise ZeroDivisionError("no stiffness")


def test_a_law_that_raises_is_named() -> None:
    with known(Breaks):
        design = Design.from_gains("breaks", 0.2, {})
        with pytest.raises(
            LdcError, match=r"Breaks, y_s=0.2 m\S*.*: ZeroDivisionError: no stiffness \(test_risk.py, line \d+\)"
        ):
            estimate_risk([TABLE_I, design], PAPER, n=100, workers=1)


@pytest.mark.parametrize(
    ("name", "value"),
    [*(("n", n) for n in (0, -1, 10**9 + 1, 2.5, True)), ("depths", [0.0]), ("dtle_limits", [np.nan]), ("chunk", 0)],
)
def test_arguments_out_of_range_are_refused(name: str, value: Any) -> None:
    with refused(name, value=value):
        estimate_risk([TABLE_I], PAPER, **{"n": 10, name: value})


def test_another_estimate_in_the_folder_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {"n": 100, "directory": tmp_path, "workers": 1}
    risk = estimate_risk([TABLE_I], PAPER, **given)
    before = (tmp_path / "risk.json").read_bytes()
    with pytest.raises(
        StoreError, match=r"another plan \(setup: '\w+' there, '\w+' now; seed: 1 there, 5 now\); remove"
    ):
        estimate_risk([TABLE_I], PAPER, seed=5, **given)
    with pytest.raises(StoreError, match=r"another plan \(designs: "):
        estimate_risk([], PAPER, **given)
    with monkeypatch.context() as patch:
        patch.setattr("ldctoolkit.studies.running.chunks.versions", lambda: (("numpy", "0.1"),))
        with pytest.raises(StoreError, match=r"another plan \(versions\."):
            estimate_risk([TABLE_I], PAPER, **given)
    assert (tmp_path / "risk.json").read_bytes() == before
    # a part that is not what was written is counted again
    (part,) = (tmp_path / "risk.parts").glob("part-*")
    part.write_bytes(part.read_bytes().replace(b"[0]", b"[9]"))
    assert_same(estimate_risk([TABLE_I], PAPER, **given), risk)
    assert "broken: its content is not what was written" in caplog.text
    # results without the parts behind them, as an earlier version wrote them
    shutil.rmtree(tmp_path / "risk.parts")
    with pytest.raises(StoreError, match=r"risk.json: there is no risk.parts beside it"):
        estimate_risk([TABLE_I], PAPER, **given)


@pytest.mark.slow
def test_a_law_that_ends_its_process_is_one_message(tmp_path: Path) -> None:
    with known(Breaks):
        design = Design.from_gains("breaks", 0.2, {"dies": True})
        with pytest.raises(LdcError, match="a worker process ended among departures of chunk 0; run it again to go on"):
            estimate_risk([design], PAPER, n=100, workers=2)


# ------------------------------------------------------------------------------------------------ the command


def test_the_command_writes_its_files(tmp_path: Path) -> None:
    out = good("risk", "paper", "-n", "2e3", "--workers", "1", "--depth", "0.5", "--depth", "0.8", cwd=tmp_path)
    assert "with n = 2,000 nothing below 1.5e-03 can be detected" in out
    folder = tmp_path / "out" / "paper"
    rows = list(csv.DictReader((folder / "risk.csv").open(encoding="utf-8")))
    assert len(rows) == 2 * 6 * 3
    assert [row["event"] for row in rows[::3]][:3] == ["depth > 0.5 m", "depth > 0.8 m", "DTLE < -0.1 m"]
    risk = estimate_risk([TABLE_I], PAPER, n=2000, depths=[0.5, 0.8], workers=1)
    assert [int(row["count"]) for row in rows] == [row["count"] for row in risk.rows()]
    worst = list(csv.DictReader((folder / "worst.csv").open(encoding="utf-8")))
    assert float(worst[0]["deepest_m"]) == next(risk.worst_rows())["deepest_m"]
    assert {"d_y_m", "v_mean_m_s", "c_0_1_m"} <= set(worst[0])
    page = (folder / "risk.html").read_text(encoding="utf-8")
    assert page.count("<section") == 4
    assert ">nan<" not in page
    stored = json.loads((folder / "risk.json").read_text())
    assert [row["count"] for row in stored["results"]] == [row["count"] for row in risk.rows()]


def test_a_folder_of_a_study_gives_the_design_of_its_verdict(tmp_path: Path) -> None:
    content = {"name": "small", "scenarios": {"left": 20, "right": 20}, "ranking": {"finalists": 0}}
    content |= {"design": [{"law": "none"}, {"law": "lqr", "y_s": [0.05, 0.3]}]}
    from ldctoolkit.studies import run_study

    run_study(Study.from_dict(content), directory=tmp_path / "run", workers=1, progress=False)
    good("risk", "run", "-n", "200", "--workers", "1", cwd=tmp_path)
    rows = list(csv.DictReader((tmp_path / "run" / "risk.csv").open(encoding="utf-8")))
    assert list(dict.fromkeys(row["label"] for row in rows)) == ["No control, y_s=0.05 m", "LQR, y_s=0.05 m"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("papr",), "did you mean 'paper'?"),
        (("paper", "-n", "0"), "argument -n: '0'; allowed: a whole number from 1 to 1e+09"),
        (("paper", "-n", "1e10"), "argument -n: '1e10'; allowed"),
        (("paper", "--design", "zzz"), "--design 'zzz': no such design"),
        (("paper", "--depth", "-1"), "depths: [-1.0]; allowed: numbers > 0 [m]"),
        (("zoo-sweep",), "choose some with --design"),
        (("paper", "--model", "nowhere"), "nowhere"),
    ],
)
def test_wrong_input_is_one_message(words: tuple[str, ...], message: str, tmp_path: Path) -> None:
    assert message in bad("risk", *words, cwd=tmp_path)


def test_a_study_that_replays_a_table_is_refused(tmp_path: Path) -> None:
    good("sample", "reference", "-n", "20", "-o", "d.parquet", cwd=tmp_path)
    (tmp_path / "s.toml").write_text('name = "s"\n[scenarios]\ntable = "d.parquet"\n[[design]]\nlaw = "lqr"\n')
    done = ldc("risk", "s.toml", "-n", "100", cwd=tmp_path)
    assert done.returncode == 2
    assert "study s: replays recorded departures: none is rarer than those; give --model" in done.stderr
    study = Study.from_toml(tmp_path / "s.toml")
    with pytest.raises(InputError, match="study s: replays recorded departures: none is rarer than those"):
        estimate_risk(study.designs, study, n=100)


# ------------------------------------------------------------------------------------------------ what recordings know


def planted(**settings: Any) -> ScenarioModel:
    """125 departures a side of 25 trips; 7 of one trip are beyond 0.5 m, 2 of these beyond 0.8 m."""
    recorded = varied_departures(125, seed=3)
    depth = np.minimum(recorded.d_y, 0.45)
    depth[:7] = [0.55, 0.6, 0.65, 0.7, 0.75, 0.85, 0.9]
    trip = np.r_[np.zeros(7, dtype=int), np.arange(243) % 25].astype(np.str_)
    model = fit_scenario_model(
        dataclasses.replace(recorded, d_y=depth, T=2.0 + 0.5 * recorded.T, recording=trip), **settings
    )
    return dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, hours=2.0))


@pytest.fixture(scope="module")
def few() -> ScenarioModel:
    return planted(components=1)


@pytest.fixture(scope="module")
def of_few(few: ScenarioModel) -> Risk:
    return estimate_risk([TABLE_I], PAPER, n=4000, chunk=1000, model=few, workers=1)


def test_recorded_departures_beyond_each_depth_are_stated_with_their_exact_limit(of_few: Risk) -> None:
    assert [of_few.recorded(deeper=x) for x in (-1.0, 0.5, 0.8, 1.0)] == [250, 7, 2, 0]
    assert [of_few.recorded("left", deeper=x) for x in (-1.0, 0.5)] == [125, 7]
    assert of_few.recorded("right", deeper=0.5) == 0
    notes = " ".join(of_few.notes())
    assert "250 departures of 25 trips" in notes
    assert "2 beyond 0.8 m (upper limit 0.029), 0 beyond 1 m (upper limit 0.015)" in notes
    assert "below 3/250 = 0.012 a probability is decided by the model, not by the recordings" in notes


def test_no_probability_below_three_of_the_recorded_departures_is_shown(of_few: Risk) -> None:
    hidden = 0
    for design in of_few.designs:
        table = probabilities(of_few, design)
        titles = [column.title for column in table.columns]
        for row, event in zip(table.rows, EVENTS, strict=True):
            found, texts = of_few.event(design, event), dict(zip(titles, table.texts(row), strict=True))
            rare = found.count < 4000 * 3 / 250
            hidden += rare
            assert (texts["P"] == "by the model") == rare
            assert (".." in texts["Per hour"]) == rare
            assert texts["No control"] == "by the model" or float(texts["No control"]) >= 0.012
            assert found.interval == (found.refits if rare else (found.low, found.high))
            assert 0.0 <= found.interval[0] < found.interval[1] <= 1.0
        numbers = [float(x) for x in re.findall(r"[(t] (\d[\d.e-]*)", of_few.light(design).text)]
        assert all(x >= 0.012 for x in numbers)
    assert hidden >= 4
    for row in of_few.rows():
        shown = row["probability"], row["per_hour"]
        rare = row["count"] * (250 if row["side"] == "both" else 125) < 3 * row["n"]
        assert (row["decided_by"], shown == (None, None)) == ("model" if rare else "recordings", rare)


@pytest.mark.slow
def test_what_lies_outside_of_the_recordings_and_on_refits_is_counted_as_driven_directly(
    few: ScenarioModel, of_few: Risk
) -> None:
    known = few.provenance.recorded
    assert known is not None
    outside = np.zeros(2, dtype=int)
    for drawn in departures(few, PAPER.seed, 1000, [(500, 500)] * 4):
        happened = events_of(TABLE_I, drawn, PAPER)[0]
        for j, side in enumerate((1, -1)):
            mine = known.departures.take(known.departures.side == side)
            beyond = np.zeros(drawn.n, dtype=bool)
            for name in ("d_y", "T", "v_mean"):
                x, ends = getattr(drawn, name), getattr(mine, name)
                beyond |= (x < ends.min()) | (x > ends.max())
            outside[j] += (beyond & happened & (drawn.side == side)).sum()
    assert of_few.event(TABLE_I, EVENTS[0]).outside == outside.sum() > 0
    assert of_few.event(TABLE_I, EVENTS[0], "left").outside == outside[0]
    assert of_few.tally.refit_n.tolist() == [[50, 50]] * 20
    many = estimate_risk([TABLE_I], PAPER, n=40_000, model=few, workers=2)
    shares = many.tally.refit_counts[:, 0, 0].sum(axis=1) / many.tally.refit_n.sum(axis=1)
    direct = [(refit(few, i).sample(2000, 2000, seed=8).d_y > 0.3).mean() for i in range(20)]
    assert np.corrcoef(shares, direct)[0, 1] > 0.6
    assert shares.mean() == pytest.approx(np.mean(direct), rel=0.1)


@pytest.mark.slow
def test_a_trip_with_all_deep_departures_makes_the_interval_of_refits_wide() -> None:
    """Seven deep departures of one trip: as many independent ones would say more."""
    smooth = planted(kind="smoothed")
    origin = smooth.provenance
    assert origin.recorded is not None
    alone = dataclasses.replace(origin.recorded, cluster=tuple(range(250)), kind="departures")
    apart = dataclasses.replace(smooth, provenance=dataclasses.replace(origin, recorded=alone))
    width = []
    for model in (smooth, apart):
        risk = estimate_risk([], PAPER, n=100_000, model=model, workers=2)
        found = risk.event(risk.designs[0], "depth > 0.5 m")
        width.append(np.log(found.refits[1] / found.refits[0]))
    assert width[0] > 1.5 * width[1]


def test_of_a_model_that_keeps_no_departures_nothing_is_computed_and_it_says_so(few: ScenarioModel) -> None:
    origin = dataclasses.replace(few.provenance, recorded=None)
    risk = estimate_risk([TABLE_I], PAPER, n=1000, model=dataclasses.replace(few, provenance=origin), workers=1)
    assert risk.tally.refit_n.shape == (0, 2)
    found = risk.event(TABLE_I, "diverged")
    assert found.by_model
    assert np.isnan(found.refits).all()
    assert any("holds no recorded departures" in note for note in risk.notes())


def test_the_command_prints_one_json_object(few: ScenarioModel, tmp_path: Path) -> None:
    few.save(tmp_path / "few.json")
    content = json.loads(good("risk", "paper", "--model", "few.json", "-n", 2000, "--json", cwd=tmp_path))
    assert content["n"] == 2000
    assert content["recorded"] == "250 departures of 25 trips, 7 % of them in one trip"
    rare = [row for row in content["rows"] if row["decided_by"] == "model"]
    assert rare
    assert all(row["probability"] is None and row["probability_high"] > 0.0 for row in rare)
