"""Smoothed departures, and models refitted to resampled clusters of the recorded departures: what these leave open.

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
from ldctoolkit.clusters import cluster_error
from ldctoolkit.departures import SIDES
from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture import BoundedGaussianMixture
from ldctoolkit.mixture._distribution import Transform
from ldctoolkit.mixture.checks import Events
from ldctoolkit.scenario_model.model import ScenarioModel
from ldctoolkit.scenario_model.provenance import RecordedDepartures, SideModel, check_usable

REFITS: Final = 20
FEWEST: Final = 5  # refits that show how far they differ
NOT_KEPT: Final = "the model file holds no recorded departures (it keeps up to 2,000 per side, since file version 5)"

_STREAM: Final = 0x72656669


def refit(model: ScenarioModel, number: int) -> ScenarioModel:
    """Fit the model's kind and K again, to its recorded departures with other weights of their clusters.

    The same number gives the same model. Raises `InputError` if there are no recorded departures; `ModelError` or
    `InputError` if what comes out cannot be sampled.
    """
    recorded = model.provenance.recorded
    if recorded is None:
        raise InputError("model", NOT_KEPT)
    rng = np.random.default_rng([_STREAM, number])
    weight = np.array(recorded.weight) * rng.exponential(size=recorded.clusters.count)[recorded.clusters.index]
    sides: dict[str, Any] = {}
    with threadpoolctl.threadpool_limits(1, "blas"):  # as in a fit
        for label, summary in model.provenance.sides:
            side, rows = model.side(SIDES[label]), recorded.departures.side == SIDES[label]
            x = np.column_stack([getattr(recorded.departures, name)[rows] for name in side.names])
            share = weight[rows] * rows.sum() / weight[rows].sum()
            fit = _smoothed if summary.kind == "smoothed" else _mixture
            mixture = fit(side, Events(x, share, 1))
            check_usable(mixture)
            sides[f"{label}_side"] = dataclasses.replace(side, mixture=mixture)
    return dataclasses.replace(model, **sides)


def _mixture(side: SideModel, events: Events) -> BoundedGaussianMixture:
    """The maximum near that of the fit."""
    lower, upper = side.bounds()
    again = BoundedGaussianMixture(
        side.mixture.n_components, lower=lower, upper=upper, transform=side.transform(), tol=1e-5, max_iter=100
    )
    return again.fit_events(events, start=side.mixture)


def _smoothed(side: SideModel, events: Events) -> BoundedGaussianMixture:
    """The same kernels with other weights; drawn in towards their mean, which goes where the departures' goes."""
    old, weight = side.mixture, events.weight
    if weight is None or old.n_components != events.rows:
        raise ModelError("recorded", f"{events.rows} departures", allowed=f"{old.n_components}, one per component")
    weight, mu = weight / weight.sum(), old.means_
    spread = old.weights_ @ (mu - old.weights_ @ mu) ** 2
    drawn_in = math.sqrt(1.0 + float(np.trace(old.covariances_[0])) / float(spread.sum()))
    moved = (drawn_in - 1.0) * (weight - old.weights_) @ mu
    lower, upper = side.bounds()
    return BoundedGaussianMixture.from_parameters(
        weight, mu + moved, old.covariances_, lower=lower, upper=upper, transform=side.transform(), names=side.names
    )


BANDWIDTHS: Final = (0.5, 0.25, 0.125)
"""Of Silverman's rule, which oversmooths what has several modes and a boundary: docs/explanation/decisions.md, 0037."""


def smoothed(
    events: Events, lower: FloatArray, upper: FloatArray, names: tuple[str, ...], width: float
) -> BoundedGaussianMixture:
    """The departures themselves with a Gaussian kernel in mapped coordinates; mean and covariance are kept there."""
    transform, weight = Transform.of("auto", lower, upper), events.weight
    y = transform.forward(events.x)
    n, d = y.shape
    share = np.full(n, 1.0 / n) if weight is None else weight / weight.sum()
    h = width * (4.0 / (d + 2)) ** (1.0 / (d + 4)) * effective_number(events) ** (-1.0 / (d + 4))
    mean, covariance = share @ y, np.cov(y.T, aweights=share).reshape(d, d)
    covariance += 1e-6 * np.diag(np.diag(covariance))  # columns that depend on each other
    kernel = covariance * h**2 / (1.0 + h**2)
    return BoundedGaussianMixture.from_parameters(
        share,
        mean + (y - mean) / np.sqrt(1.0 + h**2),
        np.tile(kernel, (n, 1, 1)),
        lower=lower,
        upper=upper,
        transform=transform.kinds,
        names=names,
    )


def effective_number(events: Events) -> float:
    """Kish's effective number of weighted events."""
    return float(events.rows if events.weight is None else events.weight.sum() ** 2 / (events.weight @ events.weight))


def uncertainty(recorded: RecordedDepartures, refits: int) -> tuple[float, float]:
    """What the standard deviation over refits is to be multiplied by, and the degrees of freedom of Student's t.

    CR2 over the plain sum over clusters, and its degrees of freedom: the median over the parameters' means.
    """
    index, weight, x = recorded.clusters.index, np.array(recorded.weight), recorded.departures.matrix().T
    share = weight / weight.sum()
    influence = (x - (x @ share)[:, None])[np.ptp(x, axis=1) > 0.0]
    exact = cluster_error(influence, index, share)
    exponential = math.sqrt(1.0 + 1.0 / recorded.clusters.count)  # whose sum is not fixed
    df = 1.0 / (1.0 / float(np.median(exact.df)) + 1.0 / max(refits - 1, 1))
    return float(np.median(exact.factor)) * exponential, df
