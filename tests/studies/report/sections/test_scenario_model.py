# ruff: noqa: RUF001 - the page shows true minus signs and apostrophes
"""The scenario model as the page shows it: numbers, odd studies, a model's own words as text."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from controllers import NoControl
from helpers.reports import PRIMARY, report_input, run, section_of
from ldctoolkit import Scenarios
from ldctoolkit.departures import PARAMETER_NAMES, Departures
from ldctoolkit.scenario_model import Given, ScenarioModel, load_model
from studies.design import Design
from studies.report.model_match.match import match
from studies.report.section import Section
from studies.report.sections.scenario_model import section
from studies.report.words.text import percent, signed

WORDS = "<script>alert(1)</script>"


@pytest.fixture(scope="module")
def model() -> ScenarioModel:
    """As after a choice of K."""
    loaded = load_model("reference")
    card = loaded.provenance
    left = dataclasses.replace(
        card.left, n_components=(9, 10, 11), bic=(3.0, 1.0, 2.0), log_likelihood=(1.0, 1.0, 1.0), n_parameters=(),
        aic=(), icl=(), held_out=(), redrawn_share=0.0123, reason="K = 10 has the smallest BIC",
    )  # fmt: skip
    return dataclasses.replace(loaded, provenance=dataclasses.replace(card, left=left, warnings=(WORDS,)))


def made(model: ScenarioModel | None, n: tuple[int, int], **changes: object) -> Section:
    given: Given = changes.get("given", {})  # type: ignore[assignment]
    scenarios = load_model("reference").sample(*n, seed=4, given=given)
    return of(scenarios, **({"model": model, "model_name": "reference", "model_notes": ()} | changes))


def of(scenarios: Scenarios, **changes: object) -> Section:
    return section_of(section, report_input(run([Design.of(NoControl(), 0.2)], scenarios, [PRIMARY]), **changes))[0]


def said(found: Section) -> str:
    return " ".join(found.body.replace("<sub>", "_").replace("\u00a0", " ").split())


def names(found: Section) -> list[str]:
    return [drawing.name for drawing in found.drawings]


@pytest.mark.slow
def test_numbers_are_those_of_the_comparison(model: ScenarioModel) -> None:
    found = made(model, (60, 40))
    assert found.id == "model"
    assert names(found) == [
        "model-margins-left", "model-margins-right", "model-pairs-left", "model-pairs-right", "model-bic-left",
    ]  # fmt: skip
    text = said(found)
    for side in match(load_model("reference").sample(60, 40, seed=4), model):
        for margin in side.margins:
            for gap in (margin.to_source, margin.to_model):
                assert gap is not None
                shown = percent(gap.value).replace("\u00a0", " ")
                assert f"{shown} <small>limit {percent(gap.limit)}".replace("\u00a0", " ") in text
        assert side.drawing is not None
        assert percent(side.drawing.within_bounds).replace("\u00a0", " ") in text
    assert "60 generated departures, 30,000 source departures" in text
    assert "1.23 %" in text
    assert "10 (K = 10 has the smallest BIC)" in text
    assert model.content_hash in text
    assert "the model is synthetic" in text
    assert WORDS not in found.body
    assert "&lt;script&gt;" in found.body


@pytest.mark.slow
def test_rank_correlations_are_told_with_what_chance_makes(model: ScenarioModel) -> None:
    text = said(made(model, (60, 40)))
    pair = match(load_model("reference").sample(60, 40, seed=4), model)[0].widest_pair
    assert pair is not None
    assert pair.limits is not None
    assert not pair.beyond
    assert "Left: rank correlations differ from those of the source departures by no more than chance makes" in text
    assert f"chance reaches from {signed(pair.limits[0], 2)} to {signed(pair.limits[1], 2)}." in text
    # the same columns, each in an order of its own: no rank correlation is left
    shuffled = load_model("reference").sample(400, 0, seed=4)
    rng = np.random.default_rng(0)
    columns = {name: rng.permutation(getattr(shuffled, name)) for name in PARAMETER_NAMES}
    other = dataclasses.replace(shuffled, **columns)
    (left,) = match(other, model)
    assert left.widest_pair is not None
    assert left.widest_pair.beyond
    text = said(of(other, model=model, model_name="reference", model_notes=()))
    assert "Left: the generated departures differ from the source departures by no more than chance" in text
    assert f"{sum(one.beyond for one in left.pairs)} of 28 rank correlations differ from those of the" in text


@pytest.mark.slow
def test_no_summary_no_model_and_no_name(model: ScenarioModel) -> None:
    card = model.provenance
    sides = {key: dataclasses.replace(getattr(card, key), source_summary=None) for key in ("left", "right")}
    bare = dataclasses.replace(model, provenance=dataclasses.replace(card, **sides))
    text = said(made(bare, (60, 40)))
    assert "file holds no summary of its source departures. The departures are compared with the model itself." in text
    assert "differ from the source" not in text
    assert "differ from the model by no more than chance" in text
    found = made(None, (60, 40), model_notes=("a note", f"warning: {WORDS}"))
    text = said(found)
    assert "The study’s folder does not hold the scenario model reference" in text
    assert "a note" in text
    assert names(found) == ["model-margins-left", "model-margins-right"]
    assert WORDS not in found.body
    assert "No scenario model belongs to these departures" in said(made(None, (60, 40), model_name=""))


@pytest.mark.slow
def test_a_departures_table(model: ScenarioModel) -> None:
    drawn = load_model("reference").sample(400, 300, seed=9)
    columns = {name: getattr(drawn, name) for name in PARAMETER_NAMES}
    zero = np.zeros(700)
    source = Departures(drawn.side, **columns, recording=zero.astype(str), start_time=zero, samples=zero.astype(int))
    text = said(made(model, (60, 40), source_departures=source))
    assert "60 generated departures, 400 source departures" in text
    assert "40 quantiles at most" not in text
    text = said(made(None, (60, 40), source_departures=source))
    assert "40 generated departures, 300 source departures" in text
    assert "beside those of the departures table" in text


@pytest.mark.slow
def test_conditions_are_told(model: ScenarioModel) -> None:
    text = said(made(model, (60, 40), given={"v_mean": (25.0, 35.0), "c_0": 0.0}))
    assert "Only departures with v_mean</sub> from 25 to 35 m/s; c_0</sub> = 0 1/m were drawn." in text
    assert "sums up all of its source departures" in text
    assert "Meet the conditions" in text


@pytest.mark.slow
def test_one_departure(model: ScenarioModel) -> None:
    found = made(model, (0, 1))
    assert names(found) == ["model-margins-right"]
    assert "nan" not in said(found).lower().split()
    every = dict(zip(PARAMETER_NAMES, (2.0, 0.2, 0.05, 25.0, 0.0, 0.04, 0.0, 0.0), strict=True))
    found = made(model, (3, 0), given=every)
    assert names(found) == ["model-bic-left"]
    assert "No parameter of these departures varies" in said(found)
