"""The alternative that the paper does not have: a mixture after a logarithm or logit of the bounded parameters."""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.diagnostics.parts import Comparison
from ldctoolkit.errors import LdcError
from ldctoolkit.mixture import BoundedGaussianMixture

MOST_EVENTS: Final = 20_000
"""Events of both halves together: the standard error is then some 0.005 nats, and more would only cost time."""

_SETTINGS: Final = {"n_init": 2, "tol": 1e-5, "max_iter": 100}


def compare_transforms(
    mixture: BoundedGaussianMixture,
    names: tuple[str, ...],
    x: FloatArray,
    weight: FloatArray | None,
    seed: int,
) -> Comparison:
    """Fit both mixtures to one random half of the events and score them on the other half.

    Parameters
    ----------
    mixture : BoundedGaussianMixture
        Gives K, the bounds, `prior_strength` and `step`.
    names : tuple of str
        Its d parameters.
    x : (n, d)
        Events strictly inside the box.
    weight : (n,), optional
        Events that each row stands for.
    seed : int
        Seed of the split and of the starts.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a half is too small for K components, or a fit fails.
    """
    rng = np.random.default_rng([seed, 2])
    chosen = rng.permutation(x.shape[0])[:MOST_EVENTS]
    fit_rows, test_rows = np.sort(chosen[: chosen.size // 2]), np.sort(chosen[chosen.size // 2 :])
    transform, K = mixture.distribution.transform, mixture.distribution.weights.size
    scores: list[FloatArray] = []
    kinds: tuple[str, ...] = ()
    for wanted in (None, "auto"):
        fitted = BoundedGaussianMixture(
            K,
            lower=transform.lower,
            upper=transform.upper,
            random_state=seed,
            prior_strength=mixture.prior_strength,
            step=mixture.step,
            transform=wanted,
            names=names,
            n_jobs=mixture.n_jobs,
            **_SETTINGS,  # type: ignore[arg-type]
        ).fit(x[fit_rows], sample_weight=None if weight is None else weight[fit_rows])
        scores.append(fitted.score_samples(x[test_rows]))
        kinds = fitted.distribution.transform.kinds
    share = np.full(test_rows.size, 1.0 / test_rows.size) if weight is None else weight[test_rows]
    share = share / share.sum()
    difference = scores[1] - scores[0]
    mean = float(share @ difference)
    return Comparison(
        K=K,
        events_fit=fit_rows.size,
        events_held_out=test_rows.size,
        transforms=tuple((name, kind) for name, kind in zip(names, kinds, strict=True) if kind != "none"),
        bounded=float(share @ scores[0]),
        transformed=float(share @ scores[1]),
        difference=mean,
        standard_error=float(np.sqrt((share**2) @ (difference - mean) ** 2)),
    )


def comparison_or_reason(
    mixture: BoundedGaussianMixture, names: tuple[str, ...], x: FloatArray, weight: FloatArray | None, seed: int
) -> tuple[Comparison | None, str]:
    """The comparison, or why there is none."""
    transform = mixture.distribution.transform
    if not (np.isfinite(transform.lower) | np.isfinite(transform.upper)).any():
        return None, "no parameter has a finite bound, so there is nothing to transform"
    half, free = min(x.shape[0], MOST_EVENTS) // 2, mixture.n_parameters()
    if half < free:
        return None, f"half of the events, {half}, are fewer than the {free} parameters of the mixture"
    try:
        return compare_transforms(mixture, names, x, weight, seed), ""
    except LdcError as error:
        return None, f"half of the events could not be fitted ({error})"
