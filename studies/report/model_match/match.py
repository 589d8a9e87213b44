"""Compare the generated departures of a study, side by side, with the source departures and with the model."""

from __future__ import annotations

import functools
import math
from typing import Final

import numpy as np

from ldctoolkit import Scenarios
from ldctoolkit.arrays import FloatArray
from ldctoolkit.departures import LEFT, PARAMETER_NAMES, RIGHT, Departures
from ldctoolkit.diagnostics import ModelMarginal, bin_edges, kolmogorov_limit, model_marginal
from ldctoolkit.mixture import Distribution
from ldctoolkit.scenario_model import Given, ScenarioModel, SideModel, SourceSummary, conditions, summarize
from ldctoolkit.scenario_model.model import Condition, mixture_conditions
from ldctoolkit.scenario_model.source_summary import (
    CELLS,
    cell_edges,
    places_between,
    rank_correlation,
    weighted_ranks,
)
from studies.report.model_match.parts import Distance, Drawing, Margin, Pair, SideMatch
from studies.report.model_match.source import Source, source_of_side

BINS: Final = 24
QUANTILES: Final = (0.05, 0.5, 0.95)
_DRAWN: Final = 100_000
_KNOTS: Final = 4
"""Of a margin: 0.0008 is far below what chance makes in any study."""
_LEAST_PAIRED: Final = 20
"""Generated departures below which a map of two parameters says nothing."""


def match(
    scenarios: Scenarios,
    model: ScenarioModel | None,
    *,
    source: Departures | None = None,
    given: Given | None = None,
) -> tuple[SideMatch, ...]:
    """Compare generated departures with where they come from.

    Parameters
    ----------
    scenarios : Scenarios
        The generated departures.
    model : ScenarioModel, optional
        What generated them.
    source : Departures, optional
        What the model was fitted to; else what the model's file holds of them.
    given : mapping, optional
        The conditions that they were drawn under.

    Returns
    -------
    tuple of SideMatch
        Left and right, without a side that has no departures. The same arguments give the same numbers.

    Raises
    ------
    InputError
        If the conditions are none, or the model cannot meet them.

    Examples
    --------
    >>> from ldctoolkit import load_model
    >>> model = load_model("reference")
    >>> (left,) = match(model.sample(200, 0, seed=1), model)
    >>> left.origin, left.source, all(margin.to_model.value < 0.15 for margin in left.margins)
    ('summary', 30000, True)
    """
    wanted = conditions(given)
    out = []
    for side, key in ((LEFT, "left"), (RIGHT, "right")):
        rows = scenarios.side == side
        if rows.any():
            x = {name: np.asarray(getattr(scenarios, name)[rows], dtype=float) for name in PARAMETER_NAMES}
            out.append(_side(side, key, x, model, source, wanted))
    return tuple(out)


def _side(
    side: int,
    key: str,
    x: dict[str, FloatArray],
    model: ScenarioModel | None,
    table: Departures | None,
    wanted: tuple[Condition, ...],
) -> SideMatch:
    n = x["T"].size
    half = None if model is None else (model.left_side if side == LEFT else model.right_side)
    fitted = None if model is None else (model.provenance.left if side == LEFT else model.provenance.right)
    single = {condition.name for condition in wanted if condition.low == condition.high}
    varies = half.names if half is not None else tuple(name for name in x if np.ptp(x[name]) > 0.0)
    names = tuple(name for name in varies if name not in single)
    source = (
        Source("none", reason="Nothing is known of where these departures come from")
        if model is None and table is None
        else source_of_side(side, names, table, fitted, wanted)
    )
    drawn = None if half is None or not names else _drawn(half, wanted, key)
    counts = (0.0 if drawn is None else n, n * source.effective / (n + source.effective))
    limits = tuple(kolmogorov_limit(count, len(names)) if names and count else 1.0 for count in counts)
    margins = tuple(_margin(name, x[name], source, half, drawn, limits) for name in names)
    reference = source.summary
    if source.origin == "none" and drawn is not None:
        columns = [drawn[0][:, drawn_column(half, name)] for name in names]
        reference = summarize(np.column_stack(columns), names=names)
    # without source departures the reference is drawn from the model
    behind = source.effective if source.origin != "none" else float(_DRAWN)
    pairs = _pairs(names, x, reference, behind) if n >= _LEAST_PAIRED and reference is not None else ()
    drawing = None
    if model is not None and half is not None:
        redrawn = model.redrawn_share(side) if fitted is None else fitted.redrawn_share
        drawing = Drawing(half.mixture.weights_.size, within_bounds(half), redrawn, _met(half, wanted, key))
    return SideMatch(key, n, source.count, source.origin, source.reason, margins, pairs, drawing)


def drawn_column(half: SideModel | None, name: str) -> int:
    """Column of a parameter in the draws of a side."""
    return 0 if half is None else half.names.index(name)


def within_bounds(half: SideModel) -> float:
    """Share of the draws of a side's mixture without bounds that lie within them.

    Of component k, P_k of its draws lie within; for one departure of it 1/P_k draws are needed. So for one departure
    of the mixture sum_k eta_k/P_k are needed.
    """
    distribution = half.mixture.distribution
    with np.errstate(over="ignore"):
        needed = float(distribution.weights @ np.exp(-distribution.truncated.log_probability))
    return 1.0 / needed


def _conditional(half: SideModel, wanted: tuple[Condition, ...], key: str) -> tuple[Distribution, float] | None:
    """The side's distribution under the conditions, and the share that meets them; None where all values are given."""
    columns = mixture_conditions(wanted, half, key)
    if not columns:
        return half.mixture.distribution, 1.0
    if all(isinstance(value, float) for value in columns.values()) and len(columns) == len(half.names):
        return None
    found = half.mixture.distribution.condition(columns)
    single = any(isinstance(value, float) for value in columns.values())
    return found, math.nan if single else math.exp(found.log_mass)


def _met(half: SideModel, wanted: tuple[Condition, ...], key: str) -> float | None:
    if not wanted:
        return None
    found = _conditional(half, wanted, key)
    return None if found is None or math.isnan(found[1]) else found[1]


def _drawn(
    half: SideModel, wanted: tuple[Condition, ...], key: str
) -> tuple[FloatArray, dict[str, ModelMarginal]] | None:
    """Draws (m, d) of the side's mixture, and its margins."""
    found = _conditional(half, wanted, key)
    if found is None:
        return None
    distribution = found[0]
    sample, _ = distribution.sample(_DRAWN, 0)
    plain = distribution is half.mixture.distribution
    margins = {
        # under conditions the margins are those of the draws, to 0.002
        name: model_marginal(distribution, sample, j, _KNOTS)
        if plain
        else ModelMarginal(np.sort(sample[:, j]), np.array([0, _DRAWN]), np.array([0.0, 1.0]))
        for j, name in enumerate(half.names)
    }
    return sample, margins


def _margin(
    name: str,
    column: FloatArray,
    source: Source,
    half: SideModel | None,
    drawn: tuple[FloatArray, dict[str, ModelMarginal]] | None,
    limits: tuple[float, ...],
) -> Margin:
    edges = _edges(name, column, source, half, drawn)
    gap = source.distance(name, column)
    of_model = None if drawn is None else drawn[1][name]
    return Margin(
        name,
        edges,
        np.histogram(column, edges)[0] / column.size,
        source.shares(name, edges),
        None if of_model is None else np.diff(of_model.cdf(edges)),
        np.quantile(column, QUANTILES),
        source.at(name, QUANTILES),
        None if gap is None else Distance(gap, min(limits[1], 1.0)),
        None if of_model is None else Distance(_to_model(column, of_model), min(limits[0], 1.0)),
    )


def _edges(
    name: str,
    column: FloatArray,
    source: Source,
    half: SideModel | None,
    drawn: tuple[FloatArray, dict[str, ModelMarginal]] | None,
) -> FloatArray:
    """Bins over all but the outermost of what is known."""
    lower, upper = -np.inf, np.inf
    if half is not None and name in half.names:
        lower, upper = (float(end[half.names.index(name)]) for end in half.bounds())
    other = column
    if drawn is not None:
        other = drawn[1][name].ordered
    elif name in source.columns:
        other = source.columns[name]
    return bin_edges(column, other, lower, upper, BINS)


def _to_model(column: FloatArray, model: ModelMarginal) -> float:
    """Kolmogorov distance of values from a distribution function."""
    u = model.cdf(np.sort(column))
    step = np.arange(column.size + 1) / column.size
    return float(max((step[1:] - u).max(), (u - step[:-1]).max(), 0.0))


def _pairs(
    names: tuple[str, ...], x: dict[str, FloatArray], reference: SourceSummary | None, behind: float
) -> tuple[Pair, ...]:
    n = x["T"].size
    share = np.full(n, 1.0 / n)
    ranks = {name: weighted_ranks(x[name], share) for name in names}
    known = () if reference is None else reference.names
    edges = {
        name: reference.edges(known.index(name))
        if reference is not None and name in known and reference.b
        else cell_edges(np.quantile(x[name], (np.arange(CELLS) + 0.5) / CELLS), CELLS)
        for name in names
    }
    places = {name: places_between(x[name], edges[name]) for name in names}
    compared = math.comb(len(set(names) & set(known)), 2)
    out = []
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            a, b = places[first], places[second]
            size = edges[first].size - 1, edges[second].size - 1
            seen = (a >= 0) & (b >= 0)
            cells = np.bincount(a[seen] * size[1] + b[seen], minlength=size[0] * size[1]).reshape(size) / n
            both = reference is not None and first in known and second in known
            at = sorted((known.index(first), known.index(second))) if both else [0, 0]
            turned = both and known.index(first) > known.index(second)
            other = reference.pair(*at) if both and reference is not None else None
            rank = reference.rank_correlation(*at) if both and reference is not None else None
            out.append(
                Pair(
                    first,
                    second,
                    edges[first],
                    edges[second],
                    cells,
                    other.T if other is not None and turned else other,
                    rank_correlation(ranks[first], ranks[second], share),
                    rank,
                    None if rank is None else rank_limits(rank, n, behind, compared),
                )
            )
    return tuple(out)


_LEVEL: Final = 0.95
_LARGEST: Final = 1.0 - 1e-9


def rank_limits(reference: float, n: float, n_reference: float, pairs: int) -> tuple[float, float]:
    """Limits of a rank correlation of n departures about the one of other departures of the same population.

    Parameters
    ----------
    reference : float
        Spearman's rank correlation of the other departures.
    n, n_reference : float
        Departures behind the two; effective numbers where they have weights.
    pairs : int
        Pairs that are looked at; each is given 0.05/pairs (Bonferroni).

    Returns
    -------
    tuple of float
        Chance alone leads beyond them in one pair or more in about 5 % of cases, or fewer.

    Notes
    -----
    Fisher's z = artanh r has nearly the same spread whatever r is; for ranks its variance is (1 + r^2/2)/(n - 3)
    (Bonett and Wright 2000). That of a difference is the sum of both samples'; small ones need Student's quantile, with
    Welch's degrees of freedom. Measured with 20 to 200 departures of the reference model, 28 pairs: some pair is beyond
    in 3.5 to 6 % of cases.

    Examples
    --------
    >>> [round(end, 2) for end in rank_limits(0.5, 300, 30_000, 28)]
    [0.34, 0.63]
    """
    centre = math.atanh(min(max(reference, -_LARGEST), _LARGEST))
    reach = math.sqrt(1.0 + 0.5 * reference**2) * _reach_at_zero(n, n_reference, pairs)
    return math.tanh(centre - reach), math.tanh(centre + reach)


@functools.cache
def _reach_at_zero(n: float, n_reference: float, pairs: int) -> float:
    # SciPy's distributions take long to import
    from scipy.stats import t

    parts = [1.0 / max(size - 3.0, 1.0) for size in (n, n_reference)]
    df = sum(parts) ** 2 / sum(part**3 for part in parts)
    return float(t.isf(0.5 * (1.0 - _LEVEL) / pairs, df)) * math.sqrt(sum(parts))
