"""Plots on axes: what is drawn are the numbers of the ranking and the results; wrong names are named."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from ldctoolkit import Scenarios, controller_class, plot_departure, simulate
from ldctoolkit.errors import InputError, UnknownNameError
from studies import (
    Ranking,
    Study,
    StudyResults,
    plot_convergence,
    plot_distribution,
    plot_landscape,
    plot_ranking,
    plot_trade_off,
    rank_study,
    run_study,
)
from studies.plotting import law_styles

matplotlib.use("agg")

STUDY = {
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
    return Study.from_dict(STUDY)


@pytest.fixture(scope="module")
def results(study: Study, tmp_path_factory: pytest.TempPathFactory) -> StudyResults:
    return run_study(study, directory=Path(tmp_path_factory.mktemp("plots")) / "s", workers=1)


@pytest.fixture(scope="module")
def ranking(study: Study, results: StudyResults) -> Ranking:
    return rank_study(results, study)[0]


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


def test_ranking(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    assert plot_ranking(ranking, ax, top=3) is ax
    labels = [text.get_text() for text in ax.get_yticklabels()]
    assert labels[:2] == [f"{ranking.rank[i]}. {ranking.designs[i].label}" for i in range(2)]
    places = [0, 1, 2, ranking.baseline]  # the baseline follows
    assert points(ax) == {(float(ranking.S[i]), float(row)) for row, i in enumerate(places) if i is not None}
    drawn = {tuple(segment[:, 0]) for lines in ax.collections for segment in lines.get_segments()}
    assert (float(ranking.S_low[0]), float(ranking.S_high[0])) in drawn
    with pytest.raises(InputError, match="top: 0; allowed"):
        plot_ranking(ranking, ax, top=0)


def test_trade_off(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_trade_off(ranking, "a_y_peak_p95", "S", ax)
    x = ranking.release.a_y_peak_p95
    assert points(ax) == {(float(a), float(b)) for a, b in zip(x, ranking.S, strict=True) if a == a}
    front = next(line for line in ax.lines if line.get_label() == "Pareto front").get_xydata()
    for a, b in zip(x, ranking.S, strict=True):  # nothing beats a point of the front in both
        assert not any((a < p and b <= q) or (a <= p and b < q) for p, q in np.asarray(front))
    with pytest.raises(UnknownNameError, match="did you mean"):
        plot_trade_off(ranking, "a_y_peak_p59", ax=ax)


def test_distribution(results: StudyResults, ax: matplotlib.axes.Axes) -> None:
    plot_distribution(results, [1, results.designs[2]], ax, side="left")
    left = results.scenarios.side > 0
    for line, S in zip(ax.lines, (results.cases[0].S_uncorrected[1], *results.cases[0].counted[1:3]), strict=True):
        x = np.sort(np.asarray(line.get_xdata(), dtype=float))
        np.testing.assert_allclose(x[np.isfinite(x)][-left.sum() :], np.sort(S[left]))
    with pytest.raises(InputError, match="side: 'lift'"):
        plot_distribution(results, side="lift")
    with pytest.raises(InputError, match="designs: 99; allowed: 0 to 7"):
        plot_distribution(results, [99])
    with pytest.raises(InputError, match="case: 'departure windw, consistent'"):
        plot_distribution(results, case="departure windw, consistent")


def test_convergence_ends_at_the_mean(results: StudyResults, ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    best = ranking.designs[0]
    plot_convergence(results, [best], ax)
    assert ax.lines[0].get_ydata()[-1] == pytest.approx(ranking.S[0])  # type: ignore[index]
    plot_convergence(results, [ranking.designs[1]], ax, to=best)
    assert ax.lines[1].get_ydata()[-1] == pytest.approx(ranking.difference[1])  # type: ignore[index]


def test_landscape(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_landscape(ranking, "lqr", y="r_delta", ax=ax)
    shown = np.asarray(ax.collections[0].get_array()).reshape(2, 3)
    for design, S in zip(ranking.designs, ranking.S, strict=True):
        if design.law == "lqr":
            at = [30.0, 300.0].index(dict(design.gains)["r_delta"]), [0.05, 0.1, 0.2].index(design.y_s)  # type: ignore[arg-type]
            assert shown[at] == S
    with pytest.raises(InputError, match="x: 'y_z' is not swept in lqr"):
        plot_landscape(ranking, "lqr", x="y_z")
    with pytest.raises(InputError, match="law: 'lqt' has no designs here"):
        plot_landscape(ranking, "lqt")


def test_landscape_over_one_quantity_is_its_profile(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_landscape(ranking, "lqr", ax=ax)
    best: dict[float, float] = {}
    for design, S in zip(ranking.designs, ranking.S, strict=True):
        if design.law == "lqr":
            best[design.y_s] = min(float(S), best.get(design.y_s, np.inf))
    np.testing.assert_allclose(ax.lines[0].get_ydata(), [best[y_s] for y_s in sorted(best)])


def test_a_title_with_a_dollar_sign_is_text(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    class Priced(type(ranking.designs[0])):  # type: ignore[misc]
        label = "costs $5_{ and $6"

    designs = tuple(Priced(d.law, d.y_s, d.gains) for d in ranking.designs)
    plot_ranking(dataclasses.replace(ranking, designs=designs), ax)
    ax.figure.canvas.draw()  # a formula would not be read


def test_departure(ax: matplotlib.axes.Axes) -> None:
    from controllers import LQR, NoControl

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


def test_laws_look_as_in_the_report(ranking: Ranking, results: StudyResults, ax: matplotlib.axes.Axes) -> None:
    """Styles go by the ranking's order of laws, and laws have their titles."""
    laws = list(dict.fromkeys(design.law for design in ranking.designs))
    assert laws != sorted(laws)
    styles = law_styles(laws)
    plot_trade_off(ranking, ax=ax)
    lines = {str(line.get_label()): line for line in ax.lines}
    for law in laws:
        if law != "none":  # it has no acceleration of an intervention
            assert lines[controller_class(law).title].get_color() == styles[law].color
    ax.clear()
    first = {law: next(i for i, design in enumerate(results.designs) if design.law == law) for law in laws[:2]}
    plot_distribution(results, first.values(), ax)
    assert [line.get_color() for line in ax.lines[1:]] == [styles[law].color for law in first]


def test_trade_off_has_the_units_of_the_report(ranking: Ranking, ax: matplotlib.axes.Axes) -> None:
    plot_trade_off(ranking, "delta_peak_max", "reduction", ax)
    assert ax.get_xlabel() == "Steering angle, largest [°], less is better"
    assert ax.get_ylabel() == "Mean S saved against no control [%], more is better"
    x, y = np.degrees(ranking.release.delta_peak_max), 100 * ranking.reduction
    drawn = sorted(points(ax))
    assert drawn == [pytest.approx(one) for one in sorted((a, b) for a, b in zip(x, y, strict=True) if a == a)]


def test_paths_on_the_same_axes_differ(ax: matplotlib.axes.Axes) -> None:
    from controllers import LQR

    scenarios = Scenarios.from_arrays(T=[3.0], d_y=0.6, v_mean=25.0, side=1)
    for r_delta in (30.0, 300.0, 3000.0):
        plot_departure(simulate(LQR(r_delta=r_delta), scenarios, y_s=0.1, trajectories=True), 0, ax, label="a")
    line, *paths = ax.lines
    assert len(paths) == 3
    assert line.get_ydata() == [0.0, 0.0]
    for look in ("get_color", "get_marker", "get_linestyle"):
        assert len({str(getattr(path, look)()) for path in paths[:2]}) == 2
    assert len({path.get_color() for path in paths}) == 3
