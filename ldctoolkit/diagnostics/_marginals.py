"""The model's marginals, by integration and a large sample, and joint histograms of two parameters."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
from scipy.special import kolmogi

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.diagnostics.parts import Calibration, Marginal, PairDensity
from ldctoolkit.mixture import Distribution, TruncatedNormal

KNOTS: Final = 8
"""Stretches of equal share between which a distribution function is integrated; inside each the sample has its say."""

_POINTS: Final = 1021
"""Lattice points of a knot: its share to about 1e-5, well below any band."""

BINS: Final = 40
_TAIL: Final = 0.003


def box_share(distribution: Distribution, lower: FloatArray, upper: FloatArray, *, points: int = 4093) -> float:
    """Share of a mixture in a box within its own, by integration.

    Parameters
    ----------
    distribution : Distribution
        The mixture.
    lower, upper : (d,)
        The box, in the data's units.
    points : int
        Lattice points, an odd prime.

    Returns
    -------
    float
        sum_k eta_k P_k(box)/P_k.
    """
    whole, ends = distribution.truncated, distribution.transform.forward(np.stack([lower, upper]))
    part = TruncatedNormal(whole.mu, whole.Sigma, ends[0], ends[1], points=points)
    shares = np.exp(np.minimum(part.log_probability - whole.log_probability, 0.0))
    return float(distribution.weights @ shares)


@dataclasses.dataclass(frozen=True)
class ModelMarginal:
    """Distribution function of one parameter of a mixture.

    A large sample gives its shape; at `knots` - 1 values it is integrated, and between two of them the sample is
    stretched to meet both. The error left is that of the sample within one stretch, 0.5/sqrt(n knots) at most: 0.0004
    for n = 200,000 and eight knots.

    Attributes
    ----------
    ordered : (n,)
        The sample, ascending.
    rank : (knots + 1,) int
        Where the knots stand in it, ends included.
    share : (knots + 1,)
        The distribution function there.
    """

    ordered: FloatArray
    rank: IntArray
    share: FloatArray

    def cdf(self, x: FloatArray) -> FloatArray:
        """F(x) for every value of x."""
        n = self.ordered.size
        at = np.searchsorted(self.ordered, x, side="right").astype(float)
        # between two draws F grows linearly: no steps, so no ties
        inner = np.clip(at.astype(np.int64), 1, n - 1)
        low, high = self.ordered[inner - 1], self.ordered[inner]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(high > low, (x - low) / (high - low), 0.0)
        at = np.where((at > 0) & (at < n), at + np.clip(part, 0.0, 1.0), at)
        out: FloatArray = np.interp(at, self.rank.astype(float), self.share)
        return out


def model_marginal(distribution: Distribution, sample: FloatArray, j: int, knots: int = KNOTS) -> ModelMarginal:
    """Distribution function of parameter j, from a sample (n, d) of the mixture."""
    ordered = np.sort(sample[:, j])
    n = ordered.size
    rank = np.round(np.linspace(0, n, knots + 1)).astype(np.int64)
    low, high = distribution.transform.lower, distribution.transform.upper
    share = np.linspace(0.0, 1.0, knots + 1)
    for i in range(1, knots):
        end = high.copy()
        end[j] = ordered[rank[i] - 1]
        share[i] = box_share(distribution, low, end, points=_POINTS)
    return ModelMarginal(ordered, rank, np.maximum.accumulate(share))


def bin_edges(column: FloatArray, drawn: FloatArray, lower: float, upper: float, bins: int) -> FloatArray:
    """Equal bins over all but the outermost 0.3 % of events and draws; a finite bound close to them is an end."""
    low = min(float(np.quantile(part, _TAIL)) for part in (column, drawn))
    high = max(float(np.quantile(part, 1.0 - _TAIL)) for part in (column, drawn))
    margin = 0.15 * (high - low)
    if low - lower < margin:
        low = lower
    if upper - high < margin:
        high = upper
    if not high > low:  # nearly all events are equal
        half = max(abs(low), 1.0) * 1e-6
        low, high = low - half, high + half
    return np.linspace(low, high, bins + 1)


def bin_of(column: FloatArray, edges: FloatArray) -> IntArray:
    """Bin of each value, -1 outside; the last bin holds its right edge."""
    place = np.searchsorted(edges, column, side="right") - 1
    place[column == edges[-1]] = edges.size - 2
    place[(place >= edges.size - 1) | (column < edges[0])] = -1
    return place.astype(np.int64)


def marginal(name: str, column: FloatArray, weight: FloatArray, model: ModelMarginal, edges: FloatArray) -> Marginal:
    """Histogram of one parameter beside the model's share of each bin; weights sum to one."""
    place = bin_of(column, edges)
    seen = place >= 0
    data = np.bincount(place[seen], weight[seen], edges.size - 1).astype(float)
    expected = np.diff(model.cdf(edges))
    return Marginal(name, edges, data, expected, float(weight[~seen].sum()), float(max(0.0, 1.0 - expected.sum())))


JOINT_BINS: Final = 48


def _shares(a: IntArray, b: IntArray, bins: int, weight: FloatArray | None) -> FloatArray:
    """Share of each cell; events outside the axes count in the total."""
    seen = (a >= 0) & (b >= 0)
    counts = np.bincount(a[seen] * bins + b[seen], None if weight is None else weight[seen], bins * bins)
    total = a.size if weight is None else 1.0
    return (counts / total).reshape(bins, bins)


def joint_density(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray, drawn: FloatArray
) -> PairDensity | None:
    """T against d_y, None where one of them does not vary; weights sum to one."""
    if "T" not in names or "d_y" not in names:
        return None
    edges, data, model = [], [], []
    for j in (names.index("T"), names.index("d_y")):
        low, high = (float(end[j]) for end in (distribution.transform.lower, distribution.transform.upper))
        edges.append(bin_edges(x[:, j], drawn[:, j], low, high, JOINT_BINS))
        data.append(bin_of(x[:, j], edges[-1]))
        model.append(bin_of(drawn[:, j], edges[-1]))
    shares = _shares(data[0], data[1], JOINT_BINS, weight), _shares(model[0], model[1], JOINT_BINS, None)
    return PairDensity("T", "d_y", edges[0], edges[1], *shares)


LEVEL: Final = 0.95
_GRID: Final = 201


def kolmogorov_limit(effective_events: float, parameters: int) -> float:
    """Kolmogorov distance that events drawn from the model itself exceed in one parameter of d or more in 5 % of cases.

    Parameters
    ----------
    effective_events : float
        Kish's effective number.
    parameters : int
        d; each is given 0.05/d (Bonferroni), so that it is 5 % or fewer whatever their dependence.

    Returns
    -------
    float

    Notes
    -----
    Kolmogorov's limit distribution with the correction of Vrbik (2018): from 20 events on within 0.6 % of the exact
    quantile. The model is not fitted again: against events that it was fitted to, a right model stays below this
    limit more often than 95 %.

    Examples
    --------
    >>> round(kolmogorov_limit(1000, 1), 4), kolmogorov_limit(149.25, 8) > kolmogorov_limit(150, 8)
    (0.0428, True)
    """
    n = max(effective_events, 1.0)
    scaled = (kolmogi((1.0 - LEVEL) / parameters) - 1.0 / (6.0 * np.sqrt(n)) + 0.25 / n) / (1.0 + 0.25 / n)
    return float(min(scaled / np.sqrt(n), 1.0))


def calibrate(name: str, column: FloatArray, weight: FloatArray, model: ModelMarginal, limit: float) -> Calibration:
    """Compare one parameter's events with the model's distribution function; weights sum to one."""
    order = np.argsort(column, kind="stable")
    ordered = column[order]
    u = model.cdf(ordered)
    above = np.cumsum(weight[order])
    below = above - weight[order]
    gaps = above - u, u - below  # among equal values the greatest are those of the whole step
    best = [int(np.argmax(gap)) for gap in gaps]
    which = 0 if gaps[0][best[0]] >= gaps[1][best[1]] else 1
    grid = np.linspace(0.0, 1.0, _GRID)
    reached = np.concatenate([[0.0], above])[np.searchsorted(u, grid, side="right")]
    return Calibration(
        name=name,
        u=grid,
        difference=reached - grid,
        distance=float(max(gaps[which][best[which]], 0.0)),
        limit=limit,
        position=float(ordered[best[which]]),
    )
