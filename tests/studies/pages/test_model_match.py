"""The scenario model against its departures, and the notebook of the documentation."""

import dataclasses
import re
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy import stats

import ldctoolkit
from ldctoolkit import Outcome, Scenarios, studies
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, Departures
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.scenario_model import ScenarioModel, SideModel, load_model
from ldctoolkit.studies import Ranking, StudyResults
from ldctoolkit.studies.pages.model_section import match


def recorded(scenarios: Scenarios) -> Departures:
    """The same departures as if they were recorded."""
    n = len(scenarios)
    columns = {name: getattr(scenarios, name) for name in PARAMETER_NAMES}
    return Departures(
        scenarios.side, **columns, recording=np.full(n, "r"), start_time=np.zeros(n), samples=np.full(n, 9)
    )


@pytest.fixture(scope="module")
def generated(model: ScenarioModel) -> Scenarios:
    return model.sample(300, 200, seed=5)


def test_a_departures_table_is_compared_exactly(model: ScenarioModel, generated: Scenarios) -> None:
    source = recorded(model.sample(900, 700, seed=6))
    left, right = match(generated, model, source=source)
    assert (left.key, left.generated, left.source, right.generated, right.source) == ("left", 300, 900, 200, 700)
    rows, mine = source.side == LEFT, generated.side == LEFT
    for parameter in left.parameters:
        values, source_values = getattr(generated, parameter.name)[mine], getattr(source, parameter.name)[rows]
        assert parameter.to_source is not None
        exact = stats.ks_2samp(values, source_values).statistic
        assert exact - 1 / 300 - 1 / 900 <= parameter.to_source.value <= exact + 1e-12
        # 5 % in eight parameters together, as one sample of as many effective events
        assert parameter.to_source.limit == pytest.approx(stats.kstwo.ppf(1 - 0.05 / 8, 225), rel=0.05)
        assert parameter.median == pytest.approx(np.median(values))


def test_the_same_driving_is_within_chance(model: ScenarioModel, generated: Scenarios) -> None:
    for side in match(generated, model):
        assert (side.source, side.reason) == (30_000, "")
        assert not any(
            parameter.to_model.beyond or parameter.to_source.beyond
            for parameter in side.parameters
            if parameter.to_model and parameter.to_source
        )


def test_other_driving_is_beyond_chance(model: ScenarioModel, generated: Scenarios) -> None:
    faster = recorded(model.sample(800, 800, seed=6))
    faster = dataclasses.replace(faster, v_mean=faster.v_mean + 4.0)
    for side in match(generated, model, source=faster):
        assert [
            parameter.name for parameter in side.parameters if parameter.to_source and parameter.to_source.beyond
        ] == ["v_mean"]


def test_margins_of_the_model_are_exact() -> None:
    """One normal, cut at zero: the distribution is that of the truncated normal."""
    mixture = BoundedGaussianMixture.from_parameters(
        [1.0], [[2.0, 0.1, 25.0]], np.diag([0.25, 0.01, 9.0])[None], lower=[0.5, 0.0, 5.0], upper=[10.0, np.inf, np.inf]
    )
    rest = tuple((name, 0.0) for name in PARAMETER_NAMES if name not in ("T", "d_y", "v_mean"))
    side = SideModel(mixture, ("T", "d_y", "v_mean"), rest)
    model = dataclasses.replace(load_model("reference"), left_side=side)
    scenarios = model.sample(200, 0, seed=1)
    (left,) = match(scenarios, model)
    assert [parameter.name for parameter in left.parameters] == ["T", "d_y", "v_mean"]
    cut = stats.truncnorm(-1.0, np.inf, loc=0.1, scale=0.1)
    assert left.parameters[1].to_model is not None
    assert left.parameters[1].to_model.value == pytest.approx(stats.kstest(scenarios.d_y, cut.cdf).statistic, abs=3e-3)


def test_what_cannot_be_compared_is_said(model: ScenarioModel, generated: Scenarios) -> None:
    few = recorded(model.sample(20, 20, seed=6))
    assert "holds 20 departures of this side; 30 are needed" in match(generated, model, source=few)[0].reason
    given = model.sample(50, 50, seed=1, given={"v_mean": (20.0, 30.0)})
    assert "not those under the conditions" in match(given, model, given={"v_mean": (20.0, 30.0)})[0].reason


matplotlib.use("agg")
PAGE = Path(__file__).resolve().parents[3] / "docs/gallery/index.md"


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {"__name__": "page"}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S):
        exec(compile(code, "notebooks.md", "exec"), scope)
    assert len(plt.get_fignums()) == 6
    plt.close("all")
    for name, kind in (("ranking", Ranking), ("results", StudyResults), ("outcome", Outcome)):
        shown = scope[name]
        assert isinstance(shown, kind)
        assert shown._repr_html_().startswith("<div")


def test_the_page_names_every_plot_and_pages_that_exist() -> None:
    text = PAGE.read_text(encoding="utf-8")
    plots = {name for module in (studies, ldctoolkit) for name in module.__all__ if name.startswith("plot_")}
    assert plots == set(re.findall(r"\| `(plot_\w+)\(", text))
    for link in re.findall(r"\]\(([\w/.-]+)\)", text):
        assert (PAGE.parent / link).exists(), link
