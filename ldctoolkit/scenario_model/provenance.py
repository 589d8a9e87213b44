"""Where a scenario model comes from: its sides, summaries of the departures, and the settings of the fit."""

import dataclasses
import functools
import math
import platform
from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray, IntArray
from ldctoolkit.clusters import Clusters
from ldctoolkit.departures import PARAMETER_NAMES, DepartureParameters
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import Events
from ldctoolkit.scenario_model.fidelity import SideFidelity
from ldctoolkit.version import __version__, versions

PHYSICAL_BOUNDS: Final[Mapping[str, tuple[float, float]]] = {
    "T": (0.5, 10.0),  # s, the extraction criteria
    "d_y": (0.0, np.inf),  # m
    "sigma_y": (0.0, np.inf),  # m
    "v_mean": (5.0, np.inf),  # m/s, the extraction criteria
    "a_mean": (-9.81, 9.81),  # m/s^2, what tyres can do; the extraction refuses more as implausible
    "sigma_v": (0.0, np.inf),  # m/s
    "c_0": (-np.inf, np.inf),  # 1/m
    "dc": (-np.inf, np.inf),  # 1/m
}
"""Default box of the eight parameters, SI units; infinite means open."""

LEAST_LOWER: Final[Mapping[str, float]] = {"T": 0.0, "d_y": 0.0, "sigma_y": 0.0, "v_mean": 0.0, "sigma_v": 0.0}
"""No model may reach below these: such a departure cannot be replayed."""


@dataclasses.dataclass(frozen=True)
class SideModel:
    """One side: a mixture over the parameters that vary, and the values of those that do not."""

    mixture: BoundedGaussianMixture  # Over `names`, in that order
    names: tuple[str, ...]  # Parameters that vary, in the order of `PARAMETER_NAMES`
    constants: tuple[tuple[str, float], ...] = ()  # The other parameters

    def columns(self, x: FloatArray) -> dict[str, FloatArray]:
        """All eight parameters of drawn events x (n, len(names))."""
        out = {name: np.full(x.shape[0], value) for name, value in self.constants}
        out |= {name: x[:, j] for j, name in enumerate(self.names)}
        return {name: out[name] for name in PARAMETER_NAMES}

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of `names`, in the data's units."""
        transform = self.mixture.distribution.transform
        return transform.lower, transform.upper

    def transform(self) -> tuple[str, ...]:
        """How each of `names` was mapped before the fit: ``"none"``, ``"log"`` or ``"logit"``."""
        return self.mixture.distribution.transform.kinds


def check_usable(mixture: BoundedGaussianMixture) -> None:
    """Refuse a mixture that cannot be sampled, of a fit and of a file alike."""
    if not np.isfinite(mixture.log_probabilities_).all():
        k = int(np.argmin(np.isfinite(mixture.log_probabilities_)))
        raise ModelError(f"component {k}", "the probability of its box is not a number that a computer can hold")
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            mixture.distribution.check_samplable()
    except (FloatingPointError, np.linalg.LinAlgError) as error:
        raise ModelError("mixture", f"cannot be sampled, its numbers are too far apart ({error})") from None


PER_QUANTILE: Final = 10  # departures behind every quantile at least: each is a mean over so many
LEAST_IN_CELL: Final = 5  # departures behind every share of a cell; cells with fewer are reported as empty

QUANTILES: Final = 40
CELLS: Final = 12
UNIT: Final = 10_000  # shares of cells are whole numbers of 1/UNIT

_FEWEST_CELLS: Final = 4
_EVENTS_PER_CELL: Final = 20
_MOST_SUMMARIZED: Final = 50_000


@dataclasses.dataclass(frozen=True)
class SourceSummary:
    """Quantiles, rank correlations and coarse joint shares of one side's departures.

    Notes
    -----
    A quantile is the mean of the quantile function over a window that holds ten departures or more, and windows do not
    overlap. A cell with fewer than five departures counts as empty. So no number can be led back to one departure.

    Examples
    --------
    >>> x = np.random.default_rng(0).normal(size=(4000, 2)) @ [[1.0, 0.8], [0.0, 0.6]]
    >>> summary = summarize(x, names=("T", "d_y"))
    >>> abs(float(summary.at(0.5)[0])) < 0.1, 0.7 < summary.rank_correlations[0] < 0.85
    (True, True)
    """

    names: tuple[str, ...]  # The d parameters that vary, in the order of the side's mixture
    departures: int  # Departures that were looked at
    effective: float  # Kish's effective number of them
    quantiles: tuple[tuple[float, ...], ...]  # (d, m), SI units: at the probabilities (i + 1/2)/m
    rank_correlations: tuple[float, ...]  # Spearman's, of the pairs (0, 1), (0, 2), ..., (d-2, d-1)
    # The same pairs: shares in 1/10,000 of b x b cells between the `cell_edges` of both, row by row, the first
    # parameter's cells one after the other
    cells: tuple[tuple[int, ...], ...]

    @property
    def probabilities(self) -> FloatArray:
        """Probabilities of the quantiles, (m,)."""
        m = len(self.quantiles[0])
        return np.asarray((np.arange(m) + 0.5) / m)

    def at(self, probability: float) -> FloatArray:
        """A quantile of each parameter (d,), between those that are kept; the outermost ones beyond them."""
        return np.array([np.interp(probability, self.probabilities, row) for row in self.quantiles])


def cell_edges(quantiles: FloatArray, b: int) -> FloatArray:
    """Even edges (b + 1,) that reach beyond the outermost quantiles, further where these are few."""
    low, high = float(quantiles[0]), float(quantiles[-1])
    margin = (high - low) * (0.05 + 2.0 / quantiles.size)
    if not margin > 0.0:  # nearly all are equal
        margin = max(abs(low), 1.0) * 1e-6
    return np.linspace(low - margin, high + margin, b + 1)


def summarize(x: FloatArray, weight: FloatArray | None = None, *, names: tuple[str, ...]) -> SourceSummary | None:
    """Sum departures up.

    Parameters
    ----------
    x : (n, d)
        Departures, finite numbers.
    weight : (n,), optional
        Events that each stands for.
    names : tuple of str
        The d parameters.

    Returns
    -------
    SourceSummary or None
        None where too few departures carry too much of the weight: a quantile would be one of them.
    """
    if weight is not None:
        x, weight = x[weight > 0.0], weight[weight > 0.0]
    n, d = x.shape
    share = np.full(n, 1.0 / max(n, 1)) if weight is None else weight / weight.sum()
    half = 0.5 * PER_QUANTILE * float(share.max(initial=1.0 / max(n, 1)))
    m = min(QUANTILES, int(1.0 / (2.0 * half) + 1e-9))
    if n < PER_QUANTILE or m < 2:
        return None
    quantiles = np.stack([_quantiles(x[:, j], share, m, half) for j in range(d)])
    b = min(CELLS, max(_FEWEST_CELLS, math.isqrt(n // _EVENTS_PER_CELL)))
    numbers = [cell_numbers(x[:, j], cell_edges(quantiles[j], b)) for j in range(d)]
    ranks = np.column_stack([weighted_ranks(x[:, j], share) for j in range(d)])
    pairs = [(i, j) for i in range(d) for j in range(i + 1, d)]
    return SourceSummary(
        names,
        n,
        _rounded(1.0 / float((share**2).sum())),
        tuple(tuple(map(_rounded, row.tolist())) for row in quantiles),
        tuple(round(rank_correlation(ranks[:, i], ranks[:, j], share), 4) for i, j in pairs),
        tuple(_cells(numbers[i], numbers[j], share, b) for i, j in pairs),
    )


def summarize_events(events: Events, names: tuple[str, ...]) -> SourceSummary | None:
    """Sum up what a fit was made of; of more than 50,000 departures as many evenly spread rows."""
    rows = events.rows
    if rows > _MOST_SUMMARIZED:
        events = events.take(np.arange(_MOST_SUMMARIZED, dtype=np.int64) * rows // _MOST_SUMMARIZED)
    return summarize(events.x, events.weight, names=names)


def weighted_ranks(column: FloatArray, share: FloatArray) -> FloatArray:
    """Weighted ranks (n,): the share below each value and half of the share at it."""
    _, value = np.unique(column, return_inverse=True)
    mass = np.bincount(value, share)
    return np.asarray((np.cumsum(mass) - 0.5 * mass)[value])


def rank_correlation(first: FloatArray, second: FloatArray, share: FloatArray) -> float:
    """Pearson's correlation of ranks (n,) with shares (n,); 0 where a column is constant."""
    a, b = (ranks - np.einsum("i,i->", share, ranks) for ranks in (first, second))
    size = math.sqrt(float(np.einsum("i,i,i->", share, a, a)) * float(np.einsum("i,i,i->", share, b, b)))
    return float(np.einsum("i,i,i->", share, a, b)) / size if size > 0.0 else 0.0


def cell_numbers(column: FloatArray, edges: FloatArray) -> IntArray:
    """Number of the cell that holds each value (n,), -1 outside all cells."""
    number = np.searchsorted(edges, column, side="right") - 1
    number[(number >= edges.size - 1) | (number < 0)] = -1
    return number.astype(np.int64)


def _quantiles(column: FloatArray, share: FloatArray, m: int, half: float) -> FloatArray:
    """Means of the quantile function over windows of width 2 `half` about (i + 1/2)/m."""
    order = np.argsort(column, kind="stable")
    reached = np.concatenate([[0.0], np.cumsum(share[order])])
    integral = np.concatenate([[0.0], np.cumsum(share[order] * column[order])])
    middle = (np.arange(m) + 0.5) / m
    low, high = np.maximum(middle - half, 0.0), np.minimum(middle + half, reached[-1])
    means = (np.interp(high, reached, integral) - np.interp(low, reached, integral)) / (high - low)
    return np.asarray(np.maximum.accumulate(np.clip(means, column.min(), column.max())))


def _cells(first: IntArray, second: IntArray, share: FloatArray, b: int) -> tuple[int, ...]:
    """Shares of a pair's b x b cells in 1/`UNIT`, rounded down; 0 where few departures are."""
    inside = (first >= 0) & (second >= 0)
    number = first[inside] * b + second[inside]
    shares = np.bincount(number, share[inside], b * b)
    shares[np.bincount(number, minlength=b * b) < LEAST_IN_CELL] = 0.0
    return tuple(int(cell) for cell in np.floor(UNIT * shares + 1e-9))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


@dataclasses.dataclass(frozen=True)
class SideSummary:
    """How one side was fitted."""

    events: int  # Departures used
    n_components: tuple[int, ...]  # The K that were fitted
    bic: tuple[float, ...]  # Bayesian information criterion of each, lower is better
    log_likelihood: tuple[float, ...]  # Per event [nats], of each
    converged: bool  # Whether the chosen fit reached its tolerance
    moved_inside: tuple[tuple[str, int], ...]  # Events that lay exactly on a bound, per parameter
    redrawn_share: float  # Share of drawn events that fall below the speed floor and are drawn again
    n_parameters: tuple[int, ...] = ()  # Free parameters of each K
    reason: str = ""  # Why this K, as text
    failed: tuple[tuple[int, str], ...] = ()  # The K that could not be fitted, and why
    passes: int | None = None  # Of the chosen fit
    stop_reason: str = ""  # Of the chosen fit, as in `BoundedGaussianMixture`
    weight: float | None = None  # Sum of the weights, where the departures had any
    # Parameter, and where its lower and upper bound come from: ``"given"``, ``"extraction criteria"`` or ``"physical"``
    bounds_from: tuple[tuple[str, str, str], ...] = ()
    # How the departures spread; None where weights rest on too few departures
    source_summary: SourceSummary | None = None
    kind: Literal["mixture", "smoothed"] = "mixture"  # What departures are generated from
    # How designs do on generated departures against recorded ones; None in a model of an earlier version
    fidelity: SideFidelity | None = None
    held_out: tuple[SideFidelity, ...] = ()  # Models of half of few departures beside the other half, both ways


@dataclasses.dataclass(frozen=True)
class FitSettings:
    """Settings of the fits, the same for both sides."""

    prior_strength: float  # Pseudo-events per component
    tol: float  # Gain per pass [nats an event] below which a fit has converged
    n_init: int  # Starts
    max_iter: int  # Most passes


MOST_RECORDED: Final = 2_000  # departures of a side that a model keeps


@dataclasses.dataclass(frozen=True)
class RecordedDepartures:
    """The n departures that a model was fitted to, none of them on a bound, and which of them belong together."""

    side: tuple[int, ...]  # (n,) As in `DepartureParameters`
    columns: Mapping[str, tuple[float, ...]]  # Parameter -> (n,), SI units
    weight: tuple[float, ...]  # (n,) Events that each stands for
    cluster: tuple[int, ...]  # (n,) As `Clusters.index`; what follows are its other facts
    kind: Literal["drivers", "trips", "departures"]
    trips: int
    drivers: int
    largest_trip: float

    @functools.cached_property
    def departures(self) -> DepartureParameters:
        """The parameters."""
        return DepartureParameters(np.array(self.side), **{name: np.array(x) for name, x in self.columns.items()})

    @functools.cached_property
    def clusters(self) -> Clusters:
        """The clusters."""
        return Clusters(self.kind, np.array(self.cluster), self.trips, self.drivers, self.largest_trip)


@dataclasses.dataclass(frozen=True)
class ModelProvenance:
    """Where a scenario model comes from."""

    # JSON values that describe the data; ``"criteria"`` and ``"refused"`` are those of the extraction
    source: Mapping[str, Any]
    synthetic: bool = False  # True where the data were drawn from a stated population and not recorded
    created: str = ""  # Time in UTC, ISO 8601
    software: str = ""  # Name and version of the program that fitted it
    seed: int = 0  # Seed of the fit
    warnings: tuple[str, ...] = ()  # What a user of the model should know
    left: SideSummary | None = None  # How each side was fitted
    right: SideSummary | None = None
    # Software behind the numbers, see `software_versions`
    versions: Mapping[str, str] = dataclasses.field(default_factory=dict)
    settings: FitSettings | None = None  # Of the fits
    # [h] and [m] Driven in the recordings; None: not known, as in a synthetic model or one of an earlier version
    hours: float | None = None
    distance: float | None = None
    # What it was fitted to; None with more than 2,000 on a side, in a bundled model and one of an earlier version
    recorded: RecordedDepartures | None = None

    @property
    def sides(self) -> list[tuple[str, SideSummary]]:
        """``"left"`` and ``"right"`` with how they were fitted, where that is known."""
        return [(name, side) for name, side in (("left", self.left), ("right", self.right)) if side is not None]


def driven(source: Mapping[str, Any]) -> dict[str, Any]:
    """Hours [h] and distance [m] that the data's description states; None where it states no number above 0."""
    stated = {key: source.get(key) for key in ("hours", "distance")}
    return {key: float(x) if isinstance(x, int | float) and 0.0 < x < math.inf else None for key, x in stated.items()}


def software_versions() -> dict[str, str]:
    """Versions of what a fit's numbers come from."""
    packages = dict(versions(("numpy", "scipy", "numba")))
    return {"ldctoolkit": __version__, "python": platform.python_version()} | packages
