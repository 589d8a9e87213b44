"""How well a fitted mixture describes events: marginal distributions and their calibration, as numbers and warnings."""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import kolmogi

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.declared import checked_seed, checked_whole
from ldctoolkit.departures import SIDES, Departures
from ldctoolkit.errors import InputError
from ldctoolkit.mixture import BoundedGaussianMixture, Distribution, TruncatedNormal
from ldctoolkit.mixture._separation import Restricted
from ldctoolkit.mixture.checks import Events, check_matrix, check_weights, inside_bounds
from ldctoolkit.mixture.selection import Progress
from ldctoolkit.scenario_model import ScenarioModel, SideModel, SideSummary

N_MODEL: Final = 200_000  # events drawn from the model
LEAST_EVENTS: Final = 10
BINS: Final = 40
JOINT_BINS: Final = 48
KNOTS: Final = 8
"""Stretches of equal share between which a distribution function is integrated; inside each it follows the sample."""

_KNOT_POINTS: Final = 1021  # lattice points of a knot: its share to about 1e-5, well below any limit
_TAIL: Final = 0.003  # share of events and draws that a histogram may leave out at each end
_LEVEL: Final = 0.95  # of the Kolmogorov limit


@dataclasses.dataclass(frozen=True)
class Marginal:
    """Histogram of one parameter, events beside model."""

    name: str  # The parameter
    edges: FloatArray  # (m + 1,) [SI units of the parameter] Edges of the bins; they may leave out the outermost tails
    data: FloatArray  # (m,) Share of the events in each bin
    model: FloatArray  # (m,) Share of the model in each bin


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Probability integral transform of one parameter: u = F(x), uniform where the model is right."""

    name: str  # The parameter
    distance: float  # Kolmogorov distance, the greatest absolute difference over all events
    limit: float  # For as many events drawn from this very model, no parameter exceeds it in 95 % of cases
    position: float  # [SI units of the parameter] Where the distance is reached


@dataclasses.dataclass(frozen=True)
class PairDensity:
    """Joint histogram of two parameters, events beside model."""

    first: str  # The first parameter
    second: str
    first_edges: FloatArray  # (a + 1,) [SI units] Edges of the bins
    second_edges: FloatArray  # (b + 1,) [SI units]
    data: FloatArray  # (a, b) Shares of the events in each bin
    model: FloatArray  # (a, b) Shares of the model in each bin


@dataclasses.dataclass(frozen=True)
class SideDiagnostics:
    """How well a mixture describes events."""

    label: str  # Which side; may be empty
    names: tuple[str, ...]  # The d parameters of the mixture
    events: int  # Events inside the box
    effective_events: float  # Kish's effective number of them; equal to `events` without weights
    outside: tuple[tuple[str, int], ...]  # Events outside the bounds, per parameter; they are left out
    n_model: int  # Events drawn from the model
    log_likelihood: float  # Per event, on these events [nats]
    marginals: tuple[Marginal, ...]  # One a parameter
    calibrations: tuple[Calibration, ...]  # One a parameter
    joint: PairDensity | None  # T against d_y, where both vary
    warnings: tuple[str, ...]  # What a user should know; the side is not in the sentences


@dataclasses.dataclass(frozen=True)
class ModelDiagnostics:
    """How well a scenario model describes events, on both sides."""

    left: SideDiagnostics
    right: SideDiagnostics


def diagnose(
    model: SideModel | BoundedGaussianMixture,
    X: npt.ArrayLike,
    *,
    names: Sequence[str] | None = None,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    summary: SideSummary | None = None,
    label: str = "",
    n_model: int = N_MODEL,
) -> SideDiagnostics:
    """Check a fitted mixture against events.

    Raises `InputError` on events or settings that do not fit, or fewer than ten events inside the box.

    Parameters
    ----------
    model : SideModel or BoundedGaussianMixture
        The mixture.
    X : (n, d)
        Events, columns as in the mixture. Those outside the box are left out and counted; values on a bound are moved
        just inside, as in `fit_scenario_model`.
    names : sequence of str, optional
        Parameters; by default those of the side or of the mixture, else ``x0``, ``x1``, ...
    seed : int
        Seed of the model's sample.
    weights : (n,), optional
        Events that each row stands for.
    summary : SideSummary, optional
        How the side was fitted, for the warnings.
    label : str
        Side.
    n_model : int
        Events drawn from the model, at least 1,000.

    Notes
    -----
    Marginals of a truncated mixture have no closed form. A distribution function is integrated at seven values and
    follows a sample of `n_model` events between them, to 0.0004; the joint density is that of the sample. The
    Kolmogorov limit is that of fresh events, without a refit: see `Calibration` and
    ``docs/how-to/reading-the-report.md``.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).gamma(1.5, size=(2000, 1))
    >>> normal = BoundedGaussianMixture(1, lower=0.0, random_state=0, n_init=1).fit(x)
    >>> calibration = diagnose(normal, x, names=["T"], n_model=20_000).calibrations[0]
    >>> calibration.distance > calibration.limit
    True
    """
    mixture = model.mixture if isinstance(model, SideModel) else model
    distribution = mixture.distribution
    parameters = _names(model, names, distribution.dimension)
    n_model, seed = checked_whole("n_model", n_model, lower=1000), checked_seed(seed)
    x, weight, outside = _events(distribution, parameters, X, weights)
    share = weight / weight.sum()
    effective = float(weight.sum() ** 2 / (weight**2).sum())
    drawn, _ = distribution.sample(n_model, seed)
    limit = kolmogorov_limit(effective, len(parameters))
    marginals: list[Marginal] = []
    calibrations: list[Calibration] = []
    for j, name in enumerate(parameters):
        of_model = model_marginal(distribution, drawn, j)
        edges = bin_edges(distribution, x, drawn, j, BINS)
        marginals.append(_marginal(name, x[:, j], share, of_model, edges))
        calibrations.append(calibrate(name, x[:, j], share, of_model, limit))
    diagnostics = SideDiagnostics(
        label=label,
        names=parameters,
        events=x.shape[0],
        effective_events=effective,
        outside=outside,
        n_model=n_model,
        log_likelihood=float(share @ mixture.score_samples(x)),
        marginals=tuple(marginals),
        calibrations=tuple(calibrations),
        joint=_joint_density(distribution, parameters, x, share, drawn),
        warnings=(),
    )
    return dataclasses.replace(diagnostics, warnings=tuple(_warnings(diagnostics, mixture, summary)))


def diagnose_model(
    model: ScenarioModel,
    departures: Departures,
    *,
    seed: int = 0,
    weights: npt.ArrayLike | None = None,
    n_model: int = N_MODEL,
    progress: Progress | None = None,
) -> ModelDiagnostics:
    """Check both sides of a scenario model against departures.

    Raises `InputError` as for `diagnose`; its path names the side.

    Parameters
    ----------
    model : ScenarioModel
        The model.
    departures : Departures
        Those of both sides.
    weights : (n,), optional
        Events that each departure stands for.
    seed, n_model
        As for `diagnose`.
    progress : callable, optional
        Called as ``progress("left", done, total)`` before each side, and once at the end.

    Examples
    --------
    >>> from ldctoolkit.departures import PARAMETER_NAMES
    >>> from ldctoolkit.scenario_model import load_model
    >>> drawn = load_model("reference").sample(300, 300, seed=1)
    >>> columns = {name: getattr(drawn, name) for name in ("side", *PARAMETER_NAMES)}
    >>> zero = np.zeros(600, dtype=np.int64)
    >>> departures = Departures(**columns, recording=zero.astype(str), start_time=1.0 * zero, samples=zero)
    >>> diagnostics = diagnose_model(load_model("reference"), departures, n_model=5_000)
    >>> diagnostics.left.events, diagnostics.right.label
    (300, 'right')
    """
    report = progress or (lambda *_: None)
    weight = None if weights is None else check_weights(weights, departures.n, "weights", "departure")
    sides: dict[str, SideDiagnostics] = {}
    summaries = dict(model.provenance.sides)
    for label, side in SIDES.items():
        half, summary = model.side(side), summaries.get(label)
        report(label, len(sides), 2)
        mask = departures.side == side
        rows = departures.take(mask)
        X = np.column_stack([getattr(rows, name) for name in half.names])
        share = None if weight is None else weight[mask]
        try:
            diagnostics = diagnose(half, X, seed=seed, weights=share, summary=summary, label=label, n_model=n_model)
        except InputError as error:
            raise error.within(f"departures ({label})", ": ") from None
        varying = tuple(_varying_constants(half, rows))
        sides[label] = dataclasses.replace(diagnostics, warnings=diagnostics.warnings + varying)
    report("done", 2, 2)
    return ModelDiagnostics(**sides)


def _varying_constants(half: SideModel, rows: Departures) -> Iterator[str]:
    """Warnings of parameters that the model holds constant and the departures do not."""
    for name, value in half.constants:
        column = getattr(rows, name)
        if not np.allclose(column, value, rtol=1e-9, atol=1e-12):
            shown = f"{float(column.min()):g} to {float(column.max()):g}"
            yield f"the model holds {name} at {value:g}, in the departures it is {shown}"


def _names(model: SideModel | BoundedGaussianMixture, names: Sequence[str] | None, dimension: int) -> tuple[str, ...]:
    """Names of the columns: those given, the model's, or x0, x1, ..."""
    labels = names if names is not None else model.names
    if labels is None:
        return tuple(f"x{j}" for j in range(dimension))
    if len(labels) != dimension:
        raise InputError("names", f"{len(labels)} names", allowed=f"{dimension}, one per column")
    return tuple(str(name) for name in labels)


def _events(
    distribution: Distribution, names: tuple[str, ...], X: npt.ArrayLike, weights: npt.ArrayLike | None
) -> tuple[FloatArray, FloatArray, tuple[tuple[str, int], ...]]:
    """Rows inside the box, those on a bound moved just inside as the fit does; weights; counts of those outside."""
    x = check_matrix(X, distribution.dimension, names)
    weight = np.ones(x.shape[0]) if weights is None else check_weights(weights, x.shape[0], "weights")
    low, high = distribution.transform.lower, distribution.transform.upper
    beyond = (x < low) | (x > high)
    keep = ~beyond.any(axis=1) & (weight > 0.0)
    counts = tuple((names[j], int(beyond[:, j].sum())) for j in np.flatnonzero(beyond.any(axis=0)))
    x, weight = x[keep], weight[keep]
    if x.shape[0] < LEAST_EVENTS:
        problem = f"{x.shape[0]} of {keep.size} events lie inside the model's bounds"
        raise InputError("X", problem, allowed=f"{LEAST_EVENTS} or more")
    return inside_bounds(Events(x, weight), low, high, names, keep_constant=True).events.x, weight, counts


def box_share(distribution: Distribution, lower: FloatArray, upper: FloatArray, *, points: int = 4093) -> float:
    """Share of a mixture in a box within its own, lower to upper (d,) in the data's units: sum_k eta_k P_k(box)/P_k."""
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
        position = np.searchsorted(self.ordered, x, side="right").astype(float)
        # between two draws F grows linearly: no steps, so no ties
        inner = np.clip(position.astype(np.int64), 1, n - 1)
        low, high = self.ordered[inner - 1], self.ordered[inner]
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(high > low, (x - low) / (high - low), 0.0)
        position = np.where((position > 0) & (position < n), position + np.clip(part, 0.0, 1.0), position)
        out: FloatArray = np.interp(position, self.rank.astype(float), self.share)
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
        share[i] = box_share(distribution, low, end, points=_KNOT_POINTS)
    return ModelMarginal(ordered, rank, np.maximum.accumulate(share))


def bin_edges(distribution: Distribution, x: FloatArray, drawn: FloatArray, j: int, bins: int) -> FloatArray:
    """Equal bins of column j over all but the outermost 0.3 % of events and draws; a bound close to them is an end."""
    lower, upper = float(distribution.transform.lower[j]), float(distribution.transform.upper[j])
    low = min(float(np.quantile(rows[:, j], _TAIL)) for rows in (x, drawn))
    high = max(float(np.quantile(rows[:, j], 1.0 - _TAIL)) for rows in (x, drawn))
    margin = 0.15 * (high - low)
    if low - lower < margin:
        low = lower
    if upper - high < margin:
        high = upper
    if not high > low:  # nearly all events are equal
        half = max(abs(low), 1.0) * 1e-6
        low, high = low - half, high + half
    return np.linspace(low, high, bins + 1)


def _marginal(name: str, column: FloatArray, share: FloatArray, model: ModelMarginal, edges: FloatArray) -> Marginal:
    data, _ = np.histogramdd(column[:, None], [edges], weights=share)
    return Marginal(name, edges, data, np.diff(model.cdf(edges)))


def _joint_density(
    distribution: Distribution, names: tuple[str, ...], x: FloatArray, share: FloatArray, drawn: FloatArray
) -> PairDensity | None:
    """Joint histogram of T and d_y; None where one of them does not vary."""
    if "T" not in names or "d_y" not in names:
        return None
    pair = [names.index("T"), names.index("d_y")]
    edges = [bin_edges(distribution, x, drawn, j, JOINT_BINS) for j in pair]
    data, _ = np.histogramdd(x[:, pair], edges, weights=share)  # events outside the axes count in the total
    model, _ = np.histogramdd(drawn[:, pair], edges)
    return PairDensity("T", "d_y", edges[0], edges[1], data, model / drawn.shape[0])


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
    scaled = (kolmogi((1.0 - _LEVEL) / parameters) - 1.0 / (6.0 * np.sqrt(n)) + 0.25 / n) / (1.0 + 0.25 / n)
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
    return Calibration(name, float(max(gaps[which][best[which]], 0.0)), limit, float(ordered[best[which]]))


def _warnings(
    diagnostics: SideDiagnostics, mixture: BoundedGaussianMixture, summary: SideSummary | None
) -> Iterator[str]:
    """Warnings of a side as sentences, the most serious first."""
    converged = summary.converged if summary is not None else getattr(mixture, "converged_", True)
    if not converged:
        yield "the fit stopped before it had converged"
    K = mixture.distribution.weights.size
    if summary is not None and len(summary.n_components) > 1 and max(summary.n_components) == K:
        d = len(diagnostics.names)
        few = diagnostics.effective_events * mixture.weights_.min() < 1 + d + d * (d + 1) // 2
        advice = "more departures are needed, not more components" if few else "the best may be larger, try more"
        yield f"the chosen K = {K} is the largest that was tried: {advice}"
    beyond = sorted((c for c in diagnostics.calibrations if c.distance > c.limit), key=lambda c: -c.distance)
    if beyond:
        shown = ", ".join(f"{c.name} {c.distance:.3g}" for c in beyond)
        yield (
            f"Kolmogorov distance beyond the {beyond[0].limit:.3g} that chance allows in {len(beyond)} of "
            f"{len(diagnostics.names)} parameters: {shown}"
        )
    for name, count in summary.moved_inside if summary is not None else ():
        yield f"{count} events had {name} exactly on a bound, moved just inside"
    if diagnostics.outside:
        shown = ", ".join(f"{name} {count}" for name, count in diagnostics.outside)
        yield f"events outside the model's bounds were left out ({shown})"
