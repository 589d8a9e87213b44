"""The figures of a report, drawn and captioned."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from ldctoolkit.departures import LEFT, RIGHT
from studies.report.examples import SIDE_NAMES, Replay, replay
from studies.report.figures import (
    Curve,
    convergence_figure,
    distribution_figure,
    interleaved,
    sides_figure,
    sides_limit,
)
from studies.report.figures_landscape import heat_map, profile
from studies.report.figures_paths import path_figure, path_limits
from studies.report.inputs import ReportInput
from studies.report.landscape import color_range, landscapes
from studies.report.prose import design_text, rank_text
from studies.report.style import RECORDED, LineStyle, law_styles
from studies.report.summary import CaseTable, Row, is_baseline
from studies.report.svg import inline_svg, line_sample
from studies.report.text import percent, printable, symbols

MOST_CURVES = 5
"""Designs in one figure; more cannot be told apart."""


@dataclasses.dataclass(frozen=True)
class Panel:
    """One drawn figure.

    Attributes
    ----------
    svg : Markup
    note : Markup
        What is particular to this panel; may be empty.
    """

    svg: Markup
    note: Markup


@dataclasses.dataclass(frozen=True)
class Legend:
    """One entry of a legend outside the figures."""

    sample: Markup
    text: Markup


class Panels:
    """Draws the figures of one report, in its primary case.

    Parameters
    ----------
    report : ReportInput
    table : CaseTable
        Of the primary case.
    """

    def __init__(self, report: ReportInput, table: CaseTable) -> None:
        self.report, self.table = report, table
        self.scenarios, self.case = report.results.scenarios, report.results.cases[0]
        self.S = self.case.counted  # what is ranked: a failure is at least as bad as no control
        self.styles = law_styles(row.design.law for row in table.best_of_each_law)  # the winner's line is solid
        self._count = 0

    def _panel(self, figure: Figure, title: str, note: Markup | str = "") -> Panel:
        self._count += 1
        return Panel(inline_svg(figure, f"f{self._count}", printable(title)), Markup(note))

    def _style(self, row: Row) -> LineStyle:
        return self.styles[row.design.law]

    def shown(self) -> tuple[Row, ...]:
        """The best design of each law that intervenes, the winner first."""
        return tuple(row for row in self.table.best_of_each_law if not is_baseline(row))[:MOST_CURVES]

    def _curves(self, rows: Iterable[Row], mask: np.ndarray, *, recorded: bool = True) -> list[Curve]:
        curves = []
        if recorded:
            S_0 = self.case.S_uncorrected[self.table.best.index]
            curves.append(Curve("No control", RECORDED, S_0[mask]))
        paper = self.table.paper_design
        for row in rows:
            S, S_0 = self.S[row.index][mask], self.case.S_uncorrected[row.index][mask]
            is_paper = paper is not None and row.index == paper.index
            label = printable(row.title) + (" (Table I)" if is_paper else "") + ("" if row.rank else " (not ranked)")
            saved = 1.0 - float(np.mean(S)) / float(np.mean(S_0)) if np.any(S_0 > 0) else 0.0
            curves.append(Curve(label, self._style(row), S, saved))
        return curves

    def landscape(self) -> list[Panel]:
        """S over (y_s, gains)."""
        designs = self.report.results.designs
        S_mean = self.S.mean(axis=1)
        framed = [row.index for row in self.table.best_of_each_law]
        every = list(landscapes(designs, S_mean, self.table.best.index, framed))
        low, high = color_range(every, self.table.uncorrected) if every else (0.0, 1.0)
        panels = []
        for one in every:
            name = f"Mean S of {one.title} over {one.x.name}" + (f" and {one.y.name}" if one.y else "")
            if one.y is None:
                figure = profile(one, self.styles[one.law], self.table.uncorrected)
            else:
                figure = heat_map(one, low, high, self.table.uncorrected)
            panels.append(self._panel(figure, name))
        return panels

    def sides(self) -> list[Panel]:
        """The paper's bar figure."""
        rows = list(self.shown())
        paper = self.table.paper_design
        if paper is not None and paper.index not in {row.index for row in rows}:
            rows.append(paper)
        present = [side for side in (LEFT, RIGHT) if (self.scenarios.side == side).any()]
        curves = {side: self._curves(rows, self.scenarios.side == side) for side in present}
        limit = max(sides_limit(some) for some in curves.values())
        panels = []
        for side in present:
            title = f"{SIDE_NAMES[side]} departures ({int((self.scenarios.side == side).sum()):,})"
            panels.append(self._panel(sides_figure(curves[side], title, limit), f"Mean and spread of S, {title}"))
        return panels

    def replay(self) -> Replay:
        """The example departures, driven again."""
        shown = [(row.index, row.design, printable(row.title), self._style(row)) for row in self.shown()]
        if not shown:
            return Replay((), 0.0)
        if self.table.best.index != shown[0][0]:  # no control won: follow the best design that intervenes
            shown = sorted(shown, key=lambda one: one[0] != shown[0][0])
        return replay(self.report, self.case, shown)

    def paths(self, replayed: Replay) -> list[Panel]:
        """Example departures with and without control."""
        limits = path_limits(replayed.examples) if replayed.examples else None
        return [
            self._panel(
                path_figure(example, limits),
                f"{example.side} departure, {example.role}: lateral position and steering angle over time",
                symbols(f"{example.facts}; S {_change(example.reduction)}"),
            )
            for example in replayed.examples
        ]

    def legend(self) -> list[Legend]:
        """Lines of the path figures."""
        entries = [Legend(line_sample(RECORDED.color, RECORDED.dash), Markup("uncorrected path, no control"))]
        for row in self.shown():
            style = self._style(row)
            entries.append(Legend(line_sample(style.color, style.dash), design_text(row)))
        return entries

    def distribution(self) -> list[Panel]:
        """Distribution of S over the departures of each side."""
        panels = []
        for side in (LEFT, RIGHT):
            mask = self.scenarios.side == side
            if mask.any():
                title = f"{SIDE_NAMES[side]} departures"
                figure = distribution_figure(self._curves(self.shown(), mask), title)
                panels.append(self._panel(figure, f"Distribution of S, {title}"))
        return panels

    def convergence(self) -> list[Panel]:
        """Running mean of S, and of the paired difference to the best."""
        if self.scenarios.n < 2:
            return []
        order = interleaved(self.scenarios.side)
        everyone = np.ones(self.scenarios.n, dtype=bool)
        rows = self.shown() or (self.table.best,)
        curves = self._curves(rows, everyone, recorded=False)
        panels = [
            self._panel(
                convergence_figure(curves, order, "Mean score", "Mean S [m·s]"), "Running mean of S with a 95 % band"
            )
        ]
        S_best = self.S[self.table.best.index]
        others = [row for row in self.rivals() if row.index != self.table.best.index]
        if others:
            named = [
                Curve(f"{printable(row.title)}, {rank_text(row)}", style, self.S[row.index] - S_best)
                for row, style in zip(others, self._rival_styles(others), strict=True)
            ]
            figure = convergence_figure(
                named, order, f"Paired difference to {self.table.best_name}", "Mean paired difference of S [m·s]"
            )
            panels.append(self._panel(figure, f"Running mean of the paired difference to {self.table.best_name}"))
        return panels

    def rivals(self) -> tuple[Row, ...]:
        """The first design of the ranking beside the best, and the best of each other law."""
        second = [row for row in self.table.rows if row is not self.table.best][:1]
        chosen = {row.index: row for row in (*second, *self.shown()[1:]) if not is_baseline(row)}
        return tuple(sorted(chosen.values(), key=lambda row: row.place))[:MOST_CURVES]

    def _rival_styles(self, rows: list[Row]) -> list[LineStyle]:
        """Each law's own style; a second design of a law gets another dash."""
        seen: dict[str, int] = {}
        styles = []
        for row in rows:
            style = self._style(row)
            again = seen.get(row.design.law, 0)
            styles.append(dataclasses.replace(style, dash=(1.0, 1.0)) if again else style)
            seen[row.design.law] = again + 1
        return styles


def _change(reduction: float) -> str:
    return f"{'falls' if reduction >= 0 else 'rises'} by {percent(abs(reduction))}"
