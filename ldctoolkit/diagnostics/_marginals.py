"""The model's marginals, by integration and a large sample, and joint histograms of two parameters."""

import dataclasses
from typing import Final, Literal

import numpy as np
from scipy.special import kolmogi

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.mixture import Distribution, TruncatedNormal
from ldctoolkit.mixture._separation import Restricted


@dataclasses.dataclass(frozen=True)
class Marginal:
    """Histogram of one parameter, events beside model."""

    name: str  # The parameter
    edges: FloatArray  # (m + 1,) [SI units of the parameter] Edges of the bins; they may leave out the outermost tails
    data: FloatArray  # (m,) Share of the events, and of the model, in each bin
    model: FloatArray  # (m,) Share of the events, and of the model, in each bin
    data_beyond: float  # Shares outside all bins
    model_beyond: float  # Shares outside all bins


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Probability integral transform of one parameter: u = F(x), uniform where the model is right."""

    name: str  # The parameter
    u: FloatArray  # (m,) Grid from 0 to 1
    difference: FloatArray  # (m,) Share of events with F(x) <= u, minus u
    distance: float  # Kolmogorov distance, the greatest absolute difference over all events
    limit: float  # For as many events drawn from this very model, no parameter exceeds it in 95 % of cases
    position: float  # [SI units of the parameter] Where the distance is reached


@dataclasses.dataclass(frozen=True)
class Strip:
    """Share of events and of the model next to one finite bound."""

    name: str  # The parameter
    end: Literal["lower", "upper"]  # Which bound
    # [SI units of the parameter] The strip lies between them; `edge` is the 5 % (95 %) quantile of the events
    bound: float
    edge: float
    data: float  # Shares in the strip
    model: float  # Shares in the strip
    error: float  # ``model / data - 1``
    standard_error: float  # Of `error`, binomial, for the effective number of events


@dataclasses.dataclass(frozen=True)
class Component:
    """One component of the mixture."""

    weight: float  # eta_k, its share of the events
    log_probability: float  # ln P_k, the logarithm of its normal's probability of the box
    # How far mu_k lies outside the box, in standard deviations of Sigma_k, in the worst parameter; 0 inside
    outside: float
    outside_name: str  # That parameter; empty inside
    condition: float  # Condition number of the correlation matrix of Sigma_k
    events: float  # Effective number of events, sum_i w_i r_ik
    # Kish's effective number, (sum_i w_i r_ik)^2 / sum_i (w_i r_ik)^2: how many whole events would tell as much
    kish: float

    @property
    def probability(self) -> float:
        """P_k; zero where it is below the smallest number that a computer holds."""
        return float(np.exp(self.log_probability))


@dataclasses.dataclass(frozen=True)
class PairDensity:
    """Joint histogram of two parameters, events beside model."""

    first: str  # The parameters
    second: str  # The parameters
    first_edges: FloatArray  # (a + 1,) [SI units] Edges of the bins
    second_edges: FloatArray  # (b + 1,) [SI units]
    data: FloatArray  # (a, b) Shares of the events and of the model in each bin
    model: FloatArray  # (a, b) Shares of the events and of the model in each bin


@dataclasses.dataclass(frozen=True)
class SideDiagnostics:
    """How well a mixture describes events."""

    label: str  # Which side; may be empty
    names: tuple[str, ...]  # The d parameters of the mixture
    events: int  # Events inside the box
    effective_events: float  # Kish's effective number of them; equal to `events` without weights
    outside: tuple[tuple[str, int], ...]  # Events outside the bounds, per parameter; they are left out
    n_model: int  # Events drawn from the model
    seed: int  # Seed of the draws
    log_likelihood: float  # Per event, on these events [nats]
    marginals: tuple[Marginal, ...]  # One a parameter
    calibrations: tuple[Calibration, ...]  # One a parameter
    strips: tuple[Strip, ...]  # One for each finite bound that events come near to
    far_bounds: tuple[tuple[str, str], ...]  # Parameter and end of the finite bounds that they do not come near to
    components: tuple[Component, ...]  # In the order of the mixture
    joint: PairDensity | None  # T against d_y, where both vary
    warnings: tuple[str, ...]  # What a user should know, as text


@dataclasses.dataclass(frozen=True)
class ModelDiagnostics:
    """Both sides of a scenario model."""

    left: SideDiagnostics  # One a side
    right: SideDiagnostics  # One a side


LEAST_PROBABILITY: Final = 1e-6  # P of a component in the box
FAR_OUTSIDE: Final = 5.0  # standard deviations of a component's mean outside the box
ILL_CONDITIONED: Final = 1e4  # condition number of a component's correlation matrix

STRIP_ERROR: Final = 0.2
STRIP_STANDARD_ERRORS: Final = 4.0  # both must be exceeded by the error of the mass next to a bound


def strip_is_off(strip: Strip) -> bool:
    """Whether the mass next to a bound is clearly wrong."""
    return abs(strip.error) > max(STRIP_ERROR, STRIP_STANDARD_ERRORS * strip.standard_error)


KNOTS: Final = 8
"""Stretches of equal share between which a distribution function is integrated; inside each the sample has its say."""

_POINTS: Final = 1021  # lattice points of a knot: its share to about 1e-5, well below any band

BINS: Final = 40
_TAIL: Final = 0.003


def box_share(distribution: Distribution, lower: FloatArray, upper: FloatArray, *, points: int = 4093) -> float:
    """Share of a mixture in a box within its own, lower to upper (d,) in the data's units: sum_k eta_k P_k(box)/P_k, by
    integration over `points` lattice points, an odd prime.
    """
    whole, ends = distribution.truncated, distribution.transform.forward(np.stack([lower, upper]))
    finite = np.flatnonzero(np.isfinite(ends).any(axis=0))
    if finite.size == 1:  # a normal margin, in closed form
        j = int(finite[0])
        z = (ends[:, j, None] - whole.mu[:, j]) / np.sqrt(whole.Sigma[:, j, j])
        log_probability = Restricted.of(z[0], z[1]).log_mass
    else:
        log_probability = TruncatedNormal(whole.mu, whole.Sigma, ends[0], ends[1], points=points).log_probability
    shares = np.exp(np.minimum(log_probability - whole.log_probability, 0.0))
    return float(distribution.weights @ shares)


@dataclasses.dataclass(frozen=True)
class ModelMarginal:
    """Distribution function of one parameter of a mixture.

    A large sample gives its shape; at `knots` - 1 values it is integrated, and between two of them the sample is
    stretched to meet both. The error left is that of the sample within one stretch, 0.5/sqrt(n knots) at most: 0.0004
    for n = 200,000 and eight knots.
    """

    ordered: FloatArray  # (n,) The sample, ascending
    rank: IntArray  # (knots + 1,) Where the knots stand in it, ends included
    share: FloatArray  # (knots + 1,) The distribution function there

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


def marginal(name: str, column: FloatArray, weight: FloatArray, model: ModelMarginal, edges: FloatArray) -> Marginal:
    """Histogram of one parameter beside the model's share of each bin; weights sum to one."""
    data, _ = np.histogramdd(column[:, None], [edges], weights=weight)
    beyond = float(weight[(column < edges[0]) | (column > edges[-1])].sum())
    expected = np.diff(model.cdf(edges))
    return Marginal(name, edges, data, expected, beyond, float(max(0.0, 1.0 - expected.sum())))


JOINT_BINS: Final = 48


def joint_density(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, weight: FloatArray, drawn: FloatArray
) -> PairDensity | None:
    """T against d_y, None where one of them does not vary; weights sum to one."""
    if "T" not in names or "d_y" not in names:
        return None
    pair = [names.index("T"), names.index("d_y")]
    lower, upper = distribution.transform.lower, distribution.transform.upper
    edges = [bin_edges(x[:, j], drawn[:, j], float(lower[j]), float(upper[j]), JOINT_BINS) for j in pair]
    data, _ = np.histogramdd(x[:, pair], edges, weights=weight)  # events outside the axes count in the total
    model, _ = np.histogramdd(drawn[:, pair], edges)
    return PairDensity("T", "d_y", edges[0], edges[1], data, model / drawn.shape[0])


LEVEL: Final = 0.95
_GRID: Final = 201


def kolmogorov_limit(effective_events: float, parameters: int) -> float:
    """Kolmogorov distance that events drawn from the model itself exceed in one parameter of d or more in 5 % of cases.

    The effective number is Kish's; each of the d `parameters` is given 0.05/d (Bonferroni), so that it is 5 % or fewer
    whatever their dependence. Kolmogorov's limit distribution with the correction of Vrbik (2018): from 20 events on
    within 0.6 % of the exact quantile. The model is not fitted again: against events that it was fitted to, a right
    model stays below this limit more often than 95 %.

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
