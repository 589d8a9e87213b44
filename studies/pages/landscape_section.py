"""Mean S over what was swept: where the best gains are, and which gain matters."""

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray
from ldctoolkit.declared import GainValue
from ldctoolkit.registry import controller_class

from ..design import Design
from ..ranking.ranking import Ranking
from ..sensitivity.sensitivity import BlockSensitivity
from ..tables import Column, Row, Table, to_html
from ..text import compact, unit_text
from .charts import Axis, Chart, Series, Style, heat_map
from .context import Context, metric_text
from .shell import Section, figure, paragraphs

MOST_LAWS: Final = 6
_MOST_VALUES: Final = 14  # of a quantity whose values make cells


@dataclasses.dataclass(frozen=True)
class SweptAxis:
    """Something that the designs of a law differ in."""

    name: str
    unit: str
    values: tuple[GainValue, ...]  # In rising order where they are numbers
    log: bool

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values)

    @property
    def label(self) -> str:
        """Name and unit."""
        unit = unit_text(self.unit)
        return f"{self.name} [{unit}]" if unit else self.name


def values_of(design: Design) -> dict[str, GainValue]:
    """The threshold and the gains of a design by name."""
    return {"y_s": design.y_s, **dict(design.gains)}


def swept_axes(designs: Sequence[Design]) -> tuple[SweptAxis, ...]:
    """What the designs of one law differ in: y_s first, then gains in the law's own order."""
    declared = {g.name: (g.unit, g.scale) for g in designs[0].kind.gains()}
    every = [values_of(design) for design in designs]
    axes = []
    for name, (unit, scale) in {"y_s": ("m", "linear"), **declared}.items():
        seen = list(dict.fromkeys(values[name] for values in every))
        if len(seen) > 1:
            numeric = all(isinstance(v, int | float) and not isinstance(v, bool) for v in seen)
            axes.append(SweptAxis(name, unit, tuple(sorted(seen, key=float) if numeric else seen), scale == "log"))
    return tuple(axes)


def section(context: Context) -> Section:
    """The section."""
    ranking = context.ranking
    charts: list[Chart] = []
    left_out = []
    for position in context.best_of_each_law:
        shown = _charts(context, position)
        if len(charts) < MOST_LAWS or not charts:
            charts += shown
        elif shown:
            left_out.append(ranking.designs[position].kind.title)
    body = figure(
        charts,
        "Mean S in m\u00b7s over what was swept. A cell shows the best design with these two values, over all other "
        "gains. The frame marks the best design of the law, a cross a cell in which no design meets the requirements.",
    )
    if not charts:
        body += paragraphs("No law has designs that differ in a number: there is no landscape to show.")
    if left_out:
        body += paragraphs(f"Not shown: {', '.join(left_out)}.")
    blocks = [block for block in context.report.sensitivity if block.indices is not None]
    if blocks:
        title = "Which gain matters: Sobol indices of mean S over the designs tested"
        body += to_html(index_table(blocks, title, ranking.confidence)) + paragraphs(
            "Total index: share of the variance of mean S that would be left if all other gains were fixed. It depends "
            "on the range swept."
        )
    return Section("landscape", "Gain landscape", body, tuple(charts))


def _charts(context: Context, position: int) -> list[Chart]:
    """One chart a law: the two axes that move the best S most; a line for a single one; points of a sample."""
    ranking, law = context.ranking, context.ranking.designs[position].law
    axes = swept_axes([design for design in ranking.designs if design.law == law])
    if not axes:
        return []
    grid_axes = [axis for axis in axes if len(axis.values) <= _MOST_VALUES]
    if len(grid_axes) < min(len(axes), 2):
        return [_sampled(context, position, axis) for axis in axes[:2] if axis.numeric]

    def spread(axis: SweptAxis) -> float:
        S = best_of_cells(ranking, law, axis)[0]
        finite = S[np.isfinite(S)]
        return float(np.log(finite.max() / finite.min())) if finite.size > 1 and finite.min() > 0 else 0.0

    return [
        landscape(ranking, position, context.style(position), *sorted(grid_axes, key=lambda axis: -spread(axis))[:2])
    ]


def best_of_cells(ranking: Ranking, law: str, x: SweptAxis, y: SweptAxis | None = None) -> tuple[FloatArray, BoolArray]:
    """Mean S of the design that ranks first in each cell, (r, c), and whether it meets the requirements."""
    S = np.full((len(y.values) if y else 1, len(x.values)), np.nan)
    met = np.zeros(S.shape, dtype=np.bool_)
    for i in reversed(range(len(ranking))):
        if ranking.designs[i].law == law:
            values = values_of(ranking.designs[i])
            cell = y.values.index(values[y.name]) if y else 0, x.values.index(values[x.name])
            S[cell], met[cell] = ranking.metrics.S[i], not ranking.missed[i]
    return S, met


def landscape(ranking: Ranking, position: int, style: Style, x: SweptAxis, y: SweptAxis | None = None) -> Chart:
    """Mean S over one or two swept quantities of the law of a design, which is marked."""
    design = ranking.designs[position]
    title, name = design.kind.title, f"landscape-{design.law.replace('_', '-')}"
    S, met = best_of_cells(ranking, design.law, x, y)
    best, names, label = values_of(design), tuple(compact(value) for value in x.values), f"{title}: {x.label}"
    across = x.values.index(best[x.name])
    if y is not None:
        texts = [[metric_text("S", value, unit=False) for value in row] for row in S.tolist()]
        return heat_map(
            name, f"{title}: mean S [m\u00b7s]", S, texts, (label, names), (y.label, [compact(v) for v in y.values]),
            ring=(y.values.index(best[y.name]), across), open_cells=~met, label="Mean S [m\u00b7s]",
        )  # fmt: skip
    level = float(ranking.metrics.S_uncorrected[position])
    return Chart(
        name, f"{title}: mean S over {x.name}", Axis(label, -0.3, len(names) - 0.7, categories=names),
        Axis.around("Mean S [m\u00b7s]", S, [level]),
        [Series(title, np.arange(len(names), dtype=np.float64), S[0], style, kind="marked")],
        level=level, ring=(float(across), float(S[0, across]), ""), height=230,
    )  # fmt: skip


def _sampled(context: Context, position: int, axis: SweptAxis) -> Chart:
    """Designs of a sample as points over one quantity."""
    ranking, design = context.ranking, context.ranking.designs[position]
    members = [i for i, candidate in enumerate(ranking.designs) if candidate.law == design.law]
    values = np.array([float(values_of(ranking.designs[i])[axis.name]) for i in members])
    title, S = design.kind.title, ranking.metrics.S[members]
    return Chart(
        f"landscape-{design.law}-{axis.name}".replace("_", "-"), f"{title}: mean S over {axis.name}",
        Axis.around(f"{title}: {axis.label}", values, log=axis.log and bool((values > 0).all())),
        Axis.around("Mean S [m\u00b7s]", S),
        [Series(title, values, np.where(S > 0, S, np.nan), context.style(position), kind="points")],
        ring=(float(values_of(design)[axis.name]), float(ranking.metrics.S[position]), ""), height=230,
    )  # fmt: skip


def index_table(blocks: Sequence[BlockSensitivity], title: str, confidence: float) -> Table:
    """Sobol indices of blocks of designs, the gain that matters most first."""
    columns = [Column("Law", text=True), Column("Gain", text=True)]
    for name in ("First order", "Total"):
        columns += [Column(name, form=".3f"), Column(f"{100 * confidence:g} % interval", form=".3f")]
    rows = []
    for block in blocks:
        if (shares := block.indices) is not None:
            weight = np.where(np.isnan(shares.total), shares.first, shares.total)
            numbers = np.stack([getattr(shares, field.name) for field in dataclasses.fields(shares)], axis=1)
            for j in np.argsort(-weight, kind="stable").tolist():
                first, first_low, first_high, total, low, high = numbers[j].tolist()
                cells = (first, (first_low, first_high), total, (low, high))
                rows.append(Row([controller_class(block.law).title, block.names[j], *cells]))
    return Table(title, columns, rows, head=1)
