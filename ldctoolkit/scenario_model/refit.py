"""Models refitted to resampled clusters of the recorded departures: what these leave open.

The Bayesian bootstrap (Rubin, *Annals of Statistics* 9, 1981) weights whole clusters by exponential numbers: no cluster
is ever left out, so that a side of few departures can always be fitted.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Final

import numpy as np
import threadpoolctl

from ldctoolkit.arrays import FloatArray
from ldctoolkit.clusters import cluster_error, cluster_sums
from ldctoolkit.departures import SIDES
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture.checks import Events
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.provenance import RecordedDepartures, SideModel, check_usable

REFITS: Final = 20
NOT_KEPT: Final = "the model holds no recorded departures (they are kept up to 2,000 a side, from version 5 on)"

_TOL, _PASSES = 1e-5, 100  # a start at the fit's own maximum; the change of the answer beyond is small
_STREAM: Final = 0x72656669


def refit(model: ScenarioModel, number: int, seed: int = 0) -> ScenarioModel:
    """Fit the model's kind and K again, to its recorded departures with other weights of their clusters.

    Raises `InputError` if the model holds no recorded departures; `ModelError` or `InputError` if what comes out cannot
    be sampled.

    Parameters
    ----------
    model : ScenarioModel
        A fitted one.
    number, seed : int
        Which refit: the same numbers give the same one.

    Examples
    --------
    >>> import ldctoolkit as ldc
    >>> refit(ldc.load_model("reference"), 0)
    Traceback (most recent call last):
    ...
    ldctoolkit.errors.InputError: model: the model holds no recorded departures (they are kept up to 2,000 a side, from\
 version 5 on)
    """
    recorded = model.recorded
    if recorded is None:
        raise InputError("model", NOT_KEPT)
    rng = np.random.default_rng([_STREAM, seed, number])
    clusters = recorded.clusters
    weight = recorded.share * recorded.departures.n * rng.exponential(size=clusters.count)[clusters.index]
    sides: dict[str, Any] = {}
    with threadpoolctl.threadpool_limits(1, "blas"):  # as in a fit
        for label, summary in model.provenance.sides:
            rows, side = recorded.of_side(label), model.side(SIDES[label])
            x = recorded.departures.take(rows)
            events = Events(np.column_stack([getattr(x, name) for name in side.names]), weight[rows], 1)
            fit = _smoothed if summary.kind == "smoothed" else _mixture
            mixture = fit(side, events, recorded.share[rows])
            check_usable(mixture)
            sides[f"{label}_side"] = dataclasses.replace(side, mixture=mixture)
    return dataclasses.replace(model, **sides)


def _mixture(side: SideModel, events: Events, share: FloatArray) -> BoundedGaussianMixture:  # noqa: ARG001
    """The maximum near that of the fit."""
    lower, upper = side.bounds()
    again = BoundedGaussianMixture(
        side.mixture.n_components, lower=lower, upper=upper, transform=side.transform(), tol=_TOL, max_iter=_PASSES,
    )  # fmt: skip
    return again.fit_events(events, start=side.mixture)


def _smoothed(side: SideModel, events: Events, share: FloatArray) -> BoundedGaussianMixture:
    """The same kernel in units of the departures' spread, about their new mean."""
    old, weight = side.mixture, events.weight
    if weight is None or old.n_components != events.rows:
        raise ModelError("recorded", f"{events.rows} departures", allowed=f"{old.n_components}, one a component")
    y = old.distribution.transform.forward(events.x)
    weight = weight / weight.sum()
    before, now = (np.cov(y.T, aweights=w).reshape(2 * y.shape[1:]) for w in (share / share.sum(), weight))
    ratio = min(float(np.trace(old.covariances_[0]) / np.trace(before)), 1.0)
    kernel = ratio * (now + 1e-6 * np.diag(np.diag(now)))
    mean = weight @ y
    lower, upper = side.bounds()
    return BoundedGaussianMixture.from_parameters(
        weight, mean + math.sqrt(1.0 - ratio) * (y - mean), np.tile(kernel, (events.rows, 1, 1)),
        lower=lower, upper=upper, transform=side.transform(), names=side.names,
    )  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """How far what refits differ by is from the uncertainty of the recordings."""

    factor: float  # Of the standard deviation over refits: clusters are few, and unequal
    df: float  # Degrees of freedom of Student's t

    @classmethod
    def of(cls, recorded: RecordedDepartures, refits: int) -> Uncertainty:
        """CR2 over the plain sum over clusters, the median over the parameters; what is seen of the means of eight."""
        index, share, x = recorded.clusters.index, recorded.share, recorded.departures.matrix().T
        influence = (x - (x @ share)[:, None])[np.ptp(x, axis=1) > 0.0]
        exact = cluster_error(influence, index, share)
        plain = np.sqrt((cluster_sums(influence * share, index) ** 2).sum(axis=1))
        G = recorded.clusters.count
        factor = float(np.median(exact.error / plain)) * math.sqrt(1.0 + 1.0 / G)  # of the sum of exponential weights
        return cls(factor, 1.0 / (1.0 / float(np.median(exact.df)) + 1.0 / max(refits - 1, 1)))
