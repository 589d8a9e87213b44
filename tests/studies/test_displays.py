"""What notebooks show: displays and plots."""

import dataclasses
import html
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.axes
import numpy as np
import pytest

from helpers.pages import Page
from ldctoolkit import EventStatus, Scenarios, controller_class, plot_departure, simulate
from ldctoolkit.controllers import LQR, NoControl
from ldctoolkit.errors import InputError, UnknownNameError
from ldctoolkit.studies import (
    Ranking,
    Study,
    StudyResults,
    compare,
    plot_convergence,
    plot_distribution,
    plot_landscape,
    plot_ranking,
    plot_trade_off,
    rank_study,
    run_study,
)
from ldctoolkit.studies.pages.charts import law_styles

EVIL = "<script>alert(1)</script>"
STUDY: dict[str, Any] = {
    "name": "shown",
    "seed": 3,
    "scenarios": {"left": 30, "right": 20},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [{"law": "none"}, {"law": "lqr", "y_s": [round(0.05 + 0.01 * i, 2) for i in range(24)]}],
}


def rows_of(text: str) -> list[list[str]]:
    """Cells of all rows; refuses anything that is not plain, closed HTML."""
    page = Page(text)
    assert set(page.counts) <= {"div", "b", "br", "table", "thead", "tbody", "tr", "th", "td", "span", "sub", "small"}
    assert set(re.findall(r' ([a-z-]+)="', text)) <= {"style", "title", "scope"}
    return [row for table in page.filled() for row in table]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_study(Study.from_dict(STUDY), directory=tmp_path_factory.mktemp("display") / "s", workers=1)


@pytest.fixture(scope="module")
def ranking(results: StudyResults) -> Ranking:
    return rank_study(results, Study.from_dict(STUDY))


def test_ranking(ranking: Ranking) -> None:
    text = ranking._repr_html_()
    _, *rows = rows_of(text)
    assert len(rows) == 21  # and no control, which is the last
    for row, i in zip(rows, [*range(20), 24], strict=True):
        assert (row[0], row[1]) == (str(ranking.rank[i]), "LQR" if i < 20 else "No control")
        assert float(row[2]) == ranking.designs[i].y_s
        low, high = map(float, row[5].split(" to "))
        assert float(row[4]) == pytest.approx(ranking.metrics.S[i], abs=6e-4)
        assert (low, high) == pytest.approx((ranking.inference.S_low[i], ranking.inference.S_high[i]), abs=6e-4)
        assert row[6] == f"{100 * ranking.metrics.reduction[i]:.1f}".replace("-", "\u2212")
    assert "and 4 more" in text
    assert "winner" in rows[0][-1]
    assert "baseline" in rows[-1][-1]
    title, head, *lines = str(dataclasses.replace(ranking, warnings=("Few.",))).splitlines()
    assert title.startswith("25 designs by mean S")
    assert [line.split() for line in lines] == [
        *([c for cell in row for c in cell.replace(" to ", "..").split()] for row in rows),
        ["Warning:", "Few."],
    ]
    assert head.index("Verdict") == lines[0].index("winner") == lines[-2].index("baseline")


def test_numbers_have_true_minus_signs_and_do_not_break(ranking: Ranking) -> None:
    metrics = dataclasses.replace(ranking.metrics, reduction=-1.0 - ranking.metrics.reduction)
    worse = dataclasses.replace(ranking, metrics=metrics)
    text = worse._repr_html_()
    _, *rows = rows_of(text)
    assert rows[0][6].startswith("\u22121")
    assert not any(re.search(r"-\d", cell) for row in rows for cell in row)
    cells = re.findall(r'<td style="([^"]*)">', text)
    assert all("white-space:nowrap" in style for style in cells[4::11])


def test_text_of_users_is_text(ranking: Ranking) -> None:
    text = dataclasses.replace(ranking, warnings=(EVIL,))._repr_html_()
    assert EVIL not in text
    assert html.escape(EVIL) in text


def test_nothing_ranked_and_one_design(results: StudyResults) -> None:
    none = Ranking.of(results, bootstrap=50, require=["S <= 0"])
    assert "None meets the requirements." in none._repr_html_()
    assert {row[0] for row in rows_of(none._repr_html_())[1:]} == {"–"}  # noqa: RUF001


def test_results(results: StudyResults) -> None:
    lines = {row[0]: row[1] for row in rows_of(results._repr_html_())}
    assert (lines["designs"], lines["scenarios"]) == ("25: none (1), lqr (24)", "50 (30 left, 20 right)")
    assert lines["S"] == results.label


@pytest.mark.slow
def test_comparison(results: StudyResults, tmp_path: Path) -> None:
    content = STUDY | {"design": STUDY["design"][:1], "vehicle": {"m": 1200.0}}
    for name, parts in (("a", {"vehicle": {}}), ("b", {})):
        run_study(Study.from_dict(content | parts), directory=tmp_path / name, workers=1)
    found = dataclasses.replace(compare(tmp_path / "a", tmp_path / "b"), new_name=EVIL)
    text = found._repr_html_()
    assert EVIL not in text
    assert html.escape(found.summary) in text
    row = rows_of(text)[1]
    assert row[0] == "the same"
    assert float(row[2]) == pytest.approx(found.S.S_old[0], abs=6e-5)
    assert float(row[4].replace("\u2212", "-")) == pytest.approx(found.S.difference[0], rel=1e-3)
    assert "-" not in "".join(row[2:])


def test_outcome() -> None:
    scenarios = Scenarios.from_arrays(
        T=[3.0, 2.0, 2.0, 2.0], d_y=[0.6, 0.4, 0.02, 0.3], v_mean=25.0, side=[1, -1, -1, 1]
    )
    scenarios = dataclasses.replace(scenarios, v_mean=np.array([25.0, 25.0, 25.0, 95.0]))
    outcome = simulate(LQR(r_delta=100.0), scenarios, y_s=0.1)
    lines = {row[0]: row[1] for row in rows_of(outcome._repr_html_())}
    driven = outcome.status != EventStatus.INVALID
    S, S_0 = np.mean(outcome.S[driven]), np.mean(outcome.S_uncorrected[driven])
    assert lines["mean S with control"] == f"{S:.4f} m s, {100 * (S / S_0 - 1):+.1f} %".replace("-", "\u2212")
    assert lines["mean S without control, left (1)"] == f"{outcome.S_uncorrected[0]:.4f} m s"
    assert lines["mean S with control, right (2)"].startswith(f"{np.mean(outcome.S[1:3]):.4f} m s")
    assert lines["deepest beyond the line"] == f"{np.max(outcome.deepest[driven]):.3f} m (no. 0)"
    counts = {"taken over and driven to the end": "2", "never triggered": "1", "cannot be driven": "1", "failures": "0"}
    assert counts.items() <= lines.items()


def test_an_outcome_without_scenarios_to_speak_of() -> None:
    bad = dataclasses.replace(Scenarios.from_arrays(T=[2.0], d_y=0.3, v_mean=25.0), v_mean=np.array([95.0]))
    lines = {row[0]: row[1] for row in rows_of(simulate(NoControl(), bad)._repr_html_())}
    assert lines == {"cannot be driven": "1", "failures": "0"}


def test_showing_a_ranking_loads_no_templates_and_no_plots() -> None:
    code = (
        "import sys, ldctoolkit.studies.ranking.ranking, ldctoolkit.studies.comparison.comparison\n"
        "print(*sorted({'jinja2', 'matplotlib', 'polars'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


matplotlib.use("agg")

STUDY_PLOTTING = {
    "name": "small",
    "seed": 3,
    "scenarios": {"left": 30, "right": 20},
    "ranking": {"bootstrap": 200, "finalists": 0},
    "design": [
        {"law": "none"},
        {"law": "lqr", "y_s": [0.05, 0.1, 0.2], "gains": {"r_delta": [30.0, 300.0]}},
        {"law": "preview_proportional"},
    ],
}


@pytest.fixture(scope="module")
def study() -> Study:
    return Study.from_dict(STUDY_PLOTTING)


@pytest.fixture(scope="module")
def results_plotting(study: Study, tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_study(study, directory=Path(tmp_path_factory.mktemp("plots")) / "s", workers=1)


@pytest.fixture(scope="module")
def ranking_plotting(study: Study, results_plotting: StudyResults) -> Ranking:
    return rank_study(results_plotting, study)


@pytest.fixture
def ax() -> Iterator[matplotlib.axes.Axes]:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots()
    yield axes
    plt.close(figure)


def points(axes: matplotlib.axes.Axes) -> set[tuple[float, float]]:
    """All points drawn with a marker and no line."""
    alone = [line for line in axes.lines if line.get_linestyle() == "None" and line.get_label() != "winner"]
    return {(float(x), float(y)) for line in alone for x, y in zip(*line.get_data(), strict=True)}


def test_ranking_plotting(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    assert plot_ranking(ranking_plotting, ax, top=3) is ax
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert labels[:2] == [f"{ranking_plotting.rank[i]}. {ranking_plotting.designs[i].label}" for i in range(2)]
    places = [0, 1, 2, ranking_plotting.baseline]  # the baseline follows
    assert points(ax) == {
        (float(ranking_plotting.metrics.S[i]), float(row)) for row, i in enumerate(places) if i is not None
    }
    drawn = {tuple(segment[:, 0]) for lines in ax.collections for segment in lines.get_segments()}
    assert (float(ranking_plotting.inference.S_low[0]), float(ranking_plotting.inference.S_high[0])) in drawn
    with pytest.raises(InputError, match="top: 0; allowed"):
        plot_ranking(ranking_plotting, ax, top=0)


def test_trade_off(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_trade_off(ranking_plotting, "a_y_peak_p95", "S", ax)
    x = ranking_plotting.metrics.beside["a_y_peak_p95"]
    assert points(ax) == {(float(a), float(b)) for a, b in zip(x, ranking_plotting.metrics.S, strict=True) if a == a}
    front = next(line for line in ax.lines if line.get_label() == "Pareto front").get_xydata()
    for a, b in zip(x, ranking_plotting.metrics.S, strict=True):  # nothing beats a point of the front in both
        assert not any((a < p and b <= q) or (a <= p and b < q) for p, q in np.asarray(front))
    with pytest.raises(UnknownNameError, match="did you mean"):
        plot_trade_off(ranking_plotting, "a_y_peak_p59", ax=ax)


def test_distribution(results_plotting: StudyResults, ax: matplotlib.axes.Axes) -> None:
    plot_distribution(results_plotting, [1, results_plotting.designs[2]], ax, side="left")
    left = results_plotting.scenarios.side > 0
    for line, S in zip(ax.lines, (results_plotting.S_uncorrected[1], *results_plotting.counted[1:3]), strict=True):
        x = np.sort(np.asarray(line.get_xdata(), dtype=float))
        np.testing.assert_allclose(x[np.isfinite(x)][-left.sum() :], np.sort(S[left]))
    with pytest.raises(InputError, match="side: 'lift'"):
        plot_distribution(results_plotting, side="lift")
    with pytest.raises(InputError, match="designs: 99; allowed: 0 to 7"):
        plot_distribution(results_plotting, [99])


def test_convergence_ends_at_the_mean(
    results_plotting: StudyResults, ranking_plotting: Ranking, ax: matplotlib.axes.Axes
) -> None:
    best = ranking_plotting.designs[0]
    plot_convergence(results_plotting, [best], ax)
    assert ax.lines[0].get_ydata()[-1] == pytest.approx(ranking_plotting.metrics.S[0])  # type: ignore[index]
    plot_convergence(results_plotting, [ranking_plotting.designs[1]], ax, to=best)
    assert ax.lines[1].get_ydata()[-1] == pytest.approx(ranking_plotting.inference.difference[1])  # type: ignore[index]


def test_landscape(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_landscape(ranking_plotting, "lqr", y="r_delta", ax=ax)
    shown = np.asarray(ax.collections[0].get_array()).reshape(2, 3)
    for design, S in zip(ranking_plotting.designs, ranking_plotting.metrics.S, strict=True):
        if design.law == "lqr":
            at = [30.0, 300.0].index(dict(design.gains)["r_delta"]), [0.05, 0.1, 0.2].index(design.y_s)  # type: ignore[arg-type]
            assert shown[at] == S
    with pytest.raises(InputError, match="x: 'y_z' is not swept in lqr"):
        plot_landscape(ranking_plotting, "lqr", x="y_z")
    with pytest.raises(InputError, match="law: 'lqt' has no designs here"):
        plot_landscape(ranking_plotting, "lqt")


def test_landscape_over_one_quantity_is_its_profile(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_landscape(ranking_plotting, "lqr", ax=ax)
    best: dict[float, float] = {}
    for design, S in zip(ranking_plotting.designs, ranking_plotting.metrics.S, strict=True):
        if design.law == "lqr":
            best[design.y_s] = min(float(S), best.get(design.y_s, np.inf))
    level, profile, _ = ax.lines
    np.testing.assert_allclose(profile.get_ydata(), [best[y_s] for y_s in sorted(best)])
    assert set(level.get_ydata()) == {ranking_plotting.metrics.S_uncorrected[0]}


def test_a_title_with_a_dollar_sign_is_text(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    class Priced(type(ranking_plotting.designs[0])):  # type: ignore[misc]
        label = "costs $5_{ and $6"

    designs = tuple(Priced(d.law, d.y_s, d.gains) for d in ranking_plotting.designs)
    plot_ranking(dataclasses.replace(ranking_plotting, designs=designs), ax)
    ax.figure.canvas.draw()  # a formula would not be read


def test_departure(ax: matplotlib.axes.Axes) -> None:
    scenarios = Scenarios.from_arrays(T=[3.0, 2.0], d_y=[0.6, 0.02], v_mean=25.0, side=[1, -1])
    outcome = simulate(LQR(r_delta=100.0), scenarios, y_s=0.1, trajectories=True)
    plot_departure(outcome, 0, ax, scenarios=scenarios)
    line, recorded, driven = ax.lines
    assert line.get_ydata() == [0.0, 0.0]
    assert np.max(recorded.get_ydata()) == pytest.approx(0.6, rel=1e-3)
    assert driven.get_xdata()[0] == pytest.approx(outcome.t_s[0])  # type: ignore[index]
    assert driven.get_ydata()[0] == pytest.approx(0.1, abs=0.05)  # type: ignore[index]  # the first sample at y_s or deeper
    inside = np.asarray(driven.get_xdata()) <= 3.0
    assert np.max(np.asarray(driven.get_ydata())[inside]) <= outcome.deepest[0] + 1e-9
    with pytest.raises(InputError, match="i: 5; allowed: 0 to 1"):
        plot_departure(outcome, 5)
    with pytest.raises(InputError, match="trajectories=True"):
        plot_departure(simulate(NoControl(), scenarios), 0)
    with pytest.raises(InputError, match="i: 1 has no path in this outcome; allowed: 0"):
        plot_departure(simulate(LQR(r_delta=100.0), scenarios, y_s=0.1, trajectories=[0]), 1)


def test_laws_look_as_in_the_report(
    ranking_plotting: Ranking, results_plotting: StudyResults, ax: matplotlib.axes.Axes
) -> None:
    """Styles go by the ranking's order of laws, and laws have their titles."""
    laws = list(dict.fromkeys(design.law for design in ranking_plotting.designs))
    assert laws != sorted(laws)
    styles = law_styles(laws)
    plot_trade_off(ranking_plotting, ax=ax)
    lines = {str(line.get_label()): line for line in ax.lines}
    for law in laws:
        if law != "none":  # it has no acceleration of an intervention
            assert lines[controller_class(law).title].get_color() == styles[law].hex
    ax.clear()
    first = {law: next(i for i, design in enumerate(results_plotting.designs) if design.law == law) for law in laws[:2]}
    plot_distribution(results_plotting, first.values(), ax)
    assert [line.get_color() for line in ax.lines[1:]] == [styles[law].hex for law in first]


def test_trade_off_has_the_units_of_the_report(ranking_plotting: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_trade_off(ranking_plotting, "delta_peak_max", "reduction", ax)
    assert ax.get_xlabel() == "Steering angle, largest [°], less is better"
    assert ax.get_ylabel() == "Mean S saved against no control [%], more is better"
    x, y = np.degrees(ranking_plotting.metrics.beside["delta_peak_max"]), 100 * ranking_plotting.metrics.reduction
    drawn = sorted(points(ax))
    assert drawn == [pytest.approx(one) for one in sorted((a, b) for a, b in zip(x, y, strict=True) if a == a)]


def test_paths_on_the_same_axes_differ(ax: matplotlib.axes.Axes) -> None:
    scenarios = Scenarios.from_arrays(T=[3.0], d_y=0.6, v_mean=25.0, side=1)
    for r_delta in (30.0, 300.0, 3000.0):
        plot_departure(simulate(LQR(r_delta=r_delta), scenarios, y_s=0.1, trajectories=True), 0, ax, label="a")
    line, *paths = ax.lines
    assert len(paths) == 3
    assert line.get_ydata() == [0.0, 0.0]
    for look in ("get_color", "get_marker", "get_linestyle"):
        assert len({str(getattr(path, look)()) for path in paths[:2]}) == 2
    assert len({path.get_color() for path in paths}) == 3
