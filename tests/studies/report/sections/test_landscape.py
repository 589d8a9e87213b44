"""The gain landscape: which panels are drawn, where the designs stand in them, and what is said of the indices."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from controllers import LQR, NoControl, PreviewProportional
from helpers.reports import PRIMARY, invented_scenarios, report_input, run, said_in, section_of
from studies.design import Design
from studies.report.figures.landscape import is_full_grid
from studies.report.figures.landscape_figures import Landscape
from studies.report.figures.landscape_panels import MOST_PANELS, PANELS_OF_A_LAW, influence, landscape_panels
from studies.report.figures.sample_figure import MOST_POINTS, Sample, shown_points
from studies.report.inputs import ReportInput
from studies.report.sections import landscape
from studies.report.words.sensitivity import sensitivity_sentence
from studies.sensitivity.sensitivity import BlockSensitivity, Indices


def sampled(count: int, seed: int = 0) -> tuple[Design, ...]:
    """Designs without a common value."""
    rng = np.random.default_rng(seed)
    return tuple(
        Design.of(LQR(q_y=float(q), r_delta=float(r)), float(y))
        for y, q, r in zip(
            rng.uniform(0.05, 0.5, count), rng.uniform(0.5, 2, count), 10 ** rng.uniform(1, 4, count), strict=True
        )
    )


def test_samples_are_points_and_grids_are_cells() -> None:
    designs = sampled(50)
    S = np.random.default_rng(1).uniform(1.0, 2.0, 50)
    best = int(S.argmin())
    panels = landscape_panels(designs, S, best)
    assert len(panels.shown) == 2
    for panel in panels.shown:
        assert isinstance(panel, Sample)
        assert panel.x.name == "y_s"
        assert panel.at[:, 0].tolist() == [design.y_s for design in designs]
        assert panel.at[:, 1].tolist() == [dict(design.gains)[panel.y.name] for design in designs]
        assert panel.S.tolist() == S.tolist()
        assert (panel.best, panel.winner) == (best, True)
    assert not panels.left_out
    assert not panels.thinned
    grid = tuple(Design.of(LQR(r_delta=r), y) for r, y in itertools.product((10.0, 30.0, 100.0), (0.1, 0.2, 0.3)))
    (panel,) = landscape_panels(grid, S[:9], 0).shown
    assert isinstance(panel, Landscape)


@pytest.mark.parametrize("size", [3, MOST_POINTS, MOST_POINTS + 1, 5000])
def test_thinned_points_keep_the_best(size: int) -> None:
    S = np.random.default_rng(2).permutation(size).astype(float)
    marked = int(np.flatnonzero(size - 2 == S)[0])  # a winner on fresh scenarios need not have the least S
    shown = shown_points(S, marked)
    assert len(set(shown.tolist())) == shown.size <= MOST_POINTS + 1
    assert marked in shown
    drawn = set(S[shown])
    assert set(range(min(size, MOST_POINTS // 2))) <= drawn
    assert size - 1 in drawn
    if size <= MOST_POINTS:
        assert np.all(np.diff(S[shown]) < 0)


def test_large_samples_are_neither_listed_nor_slow() -> None:
    designs = sampled(600)
    assert not is_full_grid(designs)  # 600 ** 3 combinations
    assert landscape_panels(designs, np.arange(600.0), 0).thinned


def test_influence_is_the_correlation_ratio() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.integers(0, 4, 4000), rng.normal(size=4000)
    S = x + y
    # variances 1.25 and 1
    assert influence(x.tolist(), S) == pytest.approx(1.25 / 2.25, abs=0.02)
    assert influence(rng.normal(size=4000).tolist(), S) < 0.01
    u = rng.uniform(size=4000)
    assert influence(u.tolist(), u) == pytest.approx(1.0 - 1.0 / 64.0, abs=0.01)  # eight groups
    assert influence([0.1, 0.2], np.ones(2)) == 0.0


def test_what_matters_most_is_drawn_and_the_rest_told() -> None:
    declared = [gain.name for gain in LQR.gains() if isinstance(gain.default, float)]
    names = tuple(declared[:5])
    assert len(names) > PANELS_OF_A_LAW
    rng = np.random.default_rng(4)
    designs = tuple(
        Design.of(LQR(**{name: float(v) for name, v in zip(names, values, strict=True)}), float(y))
        for y, *values in rng.uniform(0.1, 1.0, (200, 1 + len(names)))
    )
    S = np.array([10 * dict(d.gains)[names[-1]] + 3 * dict(d.gains)[names[1]] + d.y_s for d in designs])
    panels = landscape_panels(designs, S, int(S.argmin()))
    assert len(panels.shown) == PANELS_OF_A_LAW
    assert [panel.y.name for panel in panels.shown if panel.y][:2] == [names[-1], names[1]]
    (left,) = panels.left_out
    assert {*left.names, *(panel.y.name for panel in panels.shown if panel.y)} == set(names)
    known = {"lqr": {name: float(i == 0) for i, name in enumerate(names)}}
    first = landscape_panels(designs, S, int(S.argmin()), weights=known).shown[0]
    assert first.y is not None
    assert first.y.name == names[0]
    assert len(panels.shown) <= MOST_PANELS


def made(report: ReportInput, **changes: object) -> str:
    return said_in(landscape.section, dataclasses.replace(report, **changes))  # type: ignore[arg-type]


def indices(first: list[float], total: list[float], width: float = 0.05) -> Indices:
    one, all_ = np.array(first), np.array(total)
    return Indices(one, one - width, one + width, all_, all_ - width, all_ + width)


def test_indices_are_drawn_tabled_and_told(report: ReportInput) -> None:
    block = BlockSensitivity(
        1, "lqr", ("y_s", "r_delta"), 6, "factorial", indices([0.2, 0.3], [0.6, 0.7], 0.2), "", "exact"
    )
    sample = BlockSensitivity(2, "preview_proportional", ("y_s", "K_y"), 90, "rbd_fast",
                              indices([0.9, 0.01], [np.nan, np.nan], 0.02), "", "first order only")  # fmt: skip
    none = BlockSensitivity(3, "lqr", ("y_s",), 0, reason="a <b>race</b> gave up 1 of its 3 designs")
    section, page = section_of(landscape.section, dataclasses.replace(report, sensitivity=(block, sample, none)))
    said = page.words()
    assert "rδ matters most (total index 0.70, interval 0.50 to 0.90), not clearly before ys (0.60)" in said
    assert "what rδ does depends on other gains (alone 0.30)" in said
    assert "ys matters most (first-order index 0.90, interval 0.88 to 0.92), then Ky (0.01)" in said
    assert "table 4: no indices: a <b>race</b> gave up" in said
    assert "<b>race" not in section.body
    assert "0.700 [0.500 to 0.900]" in said
    assert "0.900 [0.880 to 0.920]" in said
    names = [drawing.name for drawing in section.drawings if drawing.name.startswith("sensitivity")]
    assert names == ["sensitivity-1", "sensitivity-2"]


def test_what_hardly_matters_is_told() -> None:
    block = BlockSensitivity(0, "lqr", ("y_s", "q_y", "r_delta"), 27, "factorial",
                             indices([0.9, 0.0, 0.1], [0.9, 0.001, 0.1], 0.01))  # fmt: skip
    assert "q<sub>y</sub> hardly matters" in sensitivity_sentence(block, "LQR")


def test_without_indices_or_sweeps(report: ReportInput) -> None:
    assert "Which gain matters" not in made(report)
    one = report_input(run([Design.of(PreviewProportional(), 0.2)], invented_scenarios(4, 4), [PRIMARY]))
    assert "Nothing is swept" in made(one)


@pytest.mark.slow
def test_a_sampled_study_says_how_its_points_are_read() -> None:
    results = run([*sampled(20), Design.of(NoControl(), 0.1)], invented_scenarios(6, 6), [PRIMARY])
    said = made(report_input(results))
    assert "every point is one design" in said
    assert "Each value is the least" not in said
    assert "Not every combination was run" not in said
