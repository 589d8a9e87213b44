"""Clusters of recorded departures: those of one trip or driver are alike, and tell less than as many independent ones.

Standard errors come from sums of residuals over whole clusters, corrected for few clusters of unequal size (CR2, with
the degrees of freedom of Satterthwaite; Bell and McCaffrey, *Survey Methodology* 28, 2002; Imbens and Kolesar, *Review
of Economics and Statistics* 98, 2016). The working model is a random effect of each cluster, with the intraclass
correlation that the departures show. What this covers is measured in `tests/ldctoolkit/test_clusters.py`.
"""

from __future__ import annotations

import dataclasses
import re
from typing import Final, Literal, TypeGuard

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray, IntArray, ReadOnly
from ldctoolkit.departures import DepartureParameters

FEWEST_DRIVERS: Final = 10
"""With so many drivers, whole drivers are resampled; with fewer, their trips."""

FEWEST_CLUSTERS: Final = 10
"""With fewer clusters an interval cannot be trusted, and says so."""


_Z: Final = 1.959963984540054  # 97.5 % quantile of the standard normal distribution


@dataclasses.dataclass(frozen=True)
class Clusters(ReadOnly):
    """Which of n recorded departures belong together.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> clusters = Clusters.of(ldc.load_model("reference").sample(2, 1, seed=0))  # not recorded: nothing is known
    >>> clusters.kind, clusters.count
    ('departures', 3)
    """

    kind: Literal["drivers", "trips", "departures"]  # What a cluster is; departures where nothing is known of them
    index: IntArray  # (n,) Number of each departure's cluster, from 0 on
    trips: int = 0  # Number of trips, 0 where they are not known
    drivers: int = 0  # Number of drivers, 0 where they are not known
    largest_trip: float = 0.0  # Share of the departures in the trip that has most of them

    @classmethod
    def of(cls, departures: DepartureParameters) -> Clusters:
        """The drivers of n departures where there are at least 10 or trips are not known, or else their trips, or else
        each departure by itself.

        A trip is a recording (stretches of one whose clock starts again, ``"a (2)"``, are of one trip); a driver is an
        entry of the column ``driver``. Either counts if it is known of all departures.
        """
        driver = next((c.values for c in getattr(departures, "extra", ()) if c.name == "driver"), None)
        return cls.of_names(departures.n, getattr(departures, "recording", None), driver)

    @classmethod
    def of_names(
        cls, n: int, recording: npt.NDArray[np.str_] | None, driver: npt.NDArray[np.generic] | None = None
    ) -> Clusters:
        """The same of n departures whose recordings and drivers have these names (n,), or drivers these numbers."""
        trip = by_driver = np.arange(n)
        trips, drivers, largest = 0, 0, 0.0
        if _all_known(recording):
            trip, trips = _numbered(np.array([re.sub(r" \(\d+\)$", "", name) for name in recording.tolist()]))
            largest = float(np.bincount(trip).max()) / n
        if _all_known(driver):
            by_driver, drivers = _numbered(driver.astype(np.str_))
        known = (trips, drivers, largest)
        if drivers >= (FEWEST_DRIVERS if trips else 2):
            return cls("drivers", by_driver, *known)
        if trips < 2:  # what differs between trips cannot be seen
            return cls("departures", np.arange(n), *known)
        return cls("trips", trip, *known)

    @property
    def count(self) -> int:
        """Number of clusters."""
        return int(np.max(self.index, initial=-1)) + 1

    @property
    def numbers(self) -> IntArray:
        """As `Scenarios.cluster`, (n,): those of drivers or trips; all 0 of a single trip, -1 of unknown ones."""
        return self.index if self.kind != "departures" else np.full(self.index.size, min(self.trips, 1) - 1)

    @property
    def doubt(self) -> str:
        """Why intervals of these departures cannot be trusted; empty where they can."""
        return doubt_of(self.numbers)

    @property
    def text(self) -> str:
        """What the departures come from, and what is resampled; one phrase."""
        of = f" of {self.trips:,} trip{'s' * (self.trips > 1)}" if self.trips else ""
        by = f" of {self.drivers:,} driver{'s' * (self.drivers > 1)}" if self.drivers else ""
        share = f", {100.0 * self.largest_trip:.0f} % of them in one trip" if self.trips > 1 else ""
        return "; ".join(filter(None, (f"{self.index.size:,} departures{of}{by}{share}", self.doubt)))

    def take(self, rows: npt.ArrayLike) -> Clusters:
        """The clusters of chosen departures, numbered anew; what is known of all of them stays."""
        index, _ = _numbered(self.index[np.asarray(rows)])
        return dataclasses.replace(self, index=index)


def _all_known(names: npt.NDArray[np.generic] | None) -> TypeGuard[npt.NDArray[np.generic]]:
    """Whether there are names, and none is empty or NaN."""
    if names is None or not names.size:
        return False
    return bool((~np.isnan(names) if names.dtype.kind == "f" else names.astype(np.str_) != "").all())


def doubt_of(cluster: IntArray | None) -> str:
    """Why intervals of recorded departures with these `Clusters.numbers` cannot be trusted; may be empty."""
    count = np.unique([] if cluster is None else cluster).size
    if not 0 < count < FEWEST_CLUSTERS or cluster is None:
        return ""
    if cluster[0] < 0:
        return "trips are not known: departures count as independent, and intervals cannot be trusted"
    if count == 1:
        return "what differs between trips cannot be seen in a single one, and intervals cannot be trusted"
    return f"with {count} trips or drivers only, intervals cannot be trusted"


def several(cluster: IntArray | None) -> IntArray | None:
    """The clusters (n,) numbered from 0 on; None where there are not two: departures count as independent."""
    index = None if cluster is None else np.unique(cluster, return_inverse=True)[1].ravel()
    return index if index is not None and index.any() else None


def _numbered(labels: npt.NDArray[np.generic]) -> tuple[IntArray, int]:
    """Each label as a number in the order of the first occurrences, and how many there are."""
    _, first, inverse = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(np.argsort(first))
    return order[inverse.ravel()].astype(np.int64), first.size


@dataclasses.dataclass(frozen=True)
class StandardErrors:
    """How uncertain k estimates from n clustered departures are."""

    error: FloatArray  # (k,) Standard error
    df: FloatArray  # (k,) Degrees of freedom of Student's t
    factor: FloatArray  # (k,) Of the plain sum over clusters, which resampling whole clusters shows; 1 without spread


def cluster_sums(values: FloatArray, index: IntArray) -> FloatArray:
    """Sums (k, G) of values (k, n) over the departures of each cluster."""
    order = np.argsort(index, kind="stable")
    starts = np.searchsorted(index[order], np.arange(int(index.max()) + 1))
    result: FloatArray = np.add.reduceat(values[:, order], starts, axis=1)
    return result


def cluster_error(influence: FloatArray, index: IntArray, weights: FloatArray | None = None) -> StandardErrors:
    """Standard errors of k weighted means, or of what is one to first order, such as a ratio.

    Parameters
    ----------
    influence : (k, n)
        How far each departure pulls each estimate: y - mean for a mean, (a - R b)/mean(b) for a ratio R of sums of a
        and b. Their weighted means are 0.
    index : (n,)
        Clusters, as those of `Clusters`.
    weights : (n,), optional
        Events that each departure stands for.

    Returns
    -------
    StandardErrors
        Infinite where there is one cluster only.

    Examples
    --------
    >>> import numpy as np
    >>> y = np.array([[1.0, 1.2, 3.0, 2.9, 2.0, 2.2]])
    >>> alone, pairs = (cluster_error(y - y.mean(), i) for i in (np.arange(6), np.array([0, 0, 1, 1, 2, 2])))
    >>> bool(pairs.error[0] > 1.3 * alone.error[0])
    True
    """
    k, n = influence.shape
    w = np.full(n, 1.0 / n) if weights is None else weights / weights.sum()
    H, q = (cluster_sums(row[None], index)[0] for row in (w, w * w))  # share of each cluster, and of squares
    if H.size < 2 or H.max() >= 1.0:
        return StandardErrors(np.full(k, np.inf), np.ones(k), np.ones(k))
    c = 1.0 / np.sqrt(1.0 - H)
    sums = cluster_sums(influence * w, index)
    error, plain = (np.sqrt((part**2).sum(axis=1)) for part in (sums * c, sums))
    factor = np.divide(error, plain, out=np.ones(k), where=plain > 0.0)
    rho = _intraclass_correlation(influence, index)[:, None]
    # covariance of the corrected sums of a working model with variance 1 and this correlation within a cluster:
    # M_gh = c_g c_h (delta_gh u_g - u_g H_h - H_g u_h + U H_g H_h); df = trace(M)^2 / sum M_gh^2
    u = (1.0 - rho) * q + rho * H**2
    U = u.sum(axis=1, keepdims=True)
    diagonal, cross, share = c**2 * u, c * u, c * H
    off = -2.0 * cross * share + U * share**2
    xx, yy, xy = (cross**2).sum(axis=1), float(share @ share), cross @ share
    squares = (diagonal**2).sum(axis=1) + 2.0 * (diagonal * off).sum(axis=1)
    squares += 2.0 * (xx * yy + xy**2) + U[:, 0] ** 2 * yy**2 - 4.0 * U[:, 0] * xy * yy
    trace = (diagonal + off).sum(axis=1)
    return StandardErrors(error, np.maximum(trace**2 / squares, 1.0), factor)


def _intraclass_correlation(values: FloatArray, index: IntArray) -> FloatArray:
    """Share of the variance between clusters, (k,), by analysis of variance; 0 where no cluster has two departures."""
    k, n = values.shape
    size = np.bincount(index).astype(np.float64)
    G = size.size
    if n == G:
        return np.zeros(k)
    means = cluster_sums(values, index) / size
    between = (size * (means - values.mean(axis=1, keepdims=True)) ** 2).sum(axis=1) / (G - 1)
    within = ((values - means[:, index]) ** 2).sum(axis=1) / (n - G)
    typical = (n - float(size @ size) / n) / (G - 1)
    total = between + (typical - 1.0) * within
    result: FloatArray = np.clip(np.divide(between - within, total, out=np.zeros(k), where=total > 0.0), 0.0, 0.99)
    return result


def cluster_values(values: FloatArray, index: IntArray) -> FloatArray:
    """One value (k, G) for each cluster of values (k, n), whose mean is the same, and whose error that of clusters.

    Taken as independent, the values of a row have its mean, and a standard error that is `cluster_error`'s but for the
    shift of their own mean, which is of second order.
    """
    n, mean = values.shape[1], values.mean(axis=1, keepdims=True)
    share = np.bincount(index) / n
    G = share.size
    parts = cluster_sums(values - mean, index) / n / np.sqrt(np.maximum(1.0 - share, 1e-12)) * np.sqrt(G * (G - 1.0))
    result: FloatArray = parts - parts.mean(axis=1, keepdims=True) + mean
    return result


def design_effect(influence: FloatArray, index: IntArray) -> FloatArray:
    """How many clustered departures tell as much as one independent one, (k,), at least 1.

    The square of the ratio of half widths of 95 % intervals. An estimate that does not vary (an event that never came)
    shows no correlation; it counts clusters, as if all departures of one were the same.
    """
    n, clustered = influence.shape[1], cluster_error(influence, index)
    alone = np.sqrt((influence**2).sum(axis=1)) / n
    wider = clustered.error * with_tails_of_t(_Z, clustered.df) / _Z
    same = n * float(((np.bincount(index) / n) ** 2).sum())
    effect = np.divide(wider, alone, out=np.full(alone.size, np.sqrt(same)), where=alone > 0.0) ** 2
    result: FloatArray = np.maximum(effect, 1.0)
    return result


def with_tails_of_t(critical: npt.ArrayLike, df: npt.ArrayLike) -> FloatArray:
    """Critical value of Student's t with the same tail as a critical value of the standard normal distribution."""
    from scipy.special import ndtr, stdtrit

    return np.asarray(-stdtrit(df, ndtr(-np.asarray(critical, dtype=np.float64))))
