"""Sobol indices of a number over a space of designs: exact on a full grid, estimated on a sample."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError, LdcError
from studies.ranking.bootstrap import percentile_interval

LEAST_RBD_FAST = 64
"""Designs below which RBD-FAST is not used: its harmonics, and its interval from halves of the sample, need room."""

_HARMONICS = 6
"""Of RBD-FAST: with ten, its error on 64 designs is half as large again, and from 256 on there is no difference."""


@dataclasses.dataclass(frozen=True)
class Indices:
    """First-order and total Sobol indices of k dimensions, with intervals; NaN where a method gives none.

    Attributes
    ----------
    first, first_low, first_high : (k,)
        Part of the variance that goes with one dimension alone, 0 to 1. An estimate may leave that range by its error.
    total, total_low, total_high : (k,)
        Part that goes when every dimension but this one is known: `first` and all interactions with others.
    """

    first: FloatArray
    first_low: FloatArray
    first_high: FloatArray
    total: FloatArray
    total_low: FloatArray
    total_high: FloatArray


def factorial_shares(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Exact first-order and total indices of numbers on full grids, every point of a grid as likely as the others.

    Parameters
    ----------
    values : (b, n_1, ..., n_k)
        b tables over the grid of k dimensions.

    Returns
    -------
    first, total : (b, k)
        NaN for a table whose numbers are all the same.

    Notes
    -----
    With V the variance over the grid: V[E[Y | x_i]] / V, and E[V[Y | all but x_i]] / V. They are the sums of squares
    of the factorial's analysis of variance, of the main effect and of every term that x_i is part of.

    References
    ----------
    Saltelli et al., "Variance based sensitivity analysis of model output", Computer Physics Communications 181 (2010).

    Examples
    --------
    >>> import numpy as np
    >>> first, total = factorial_shares(np.array([[[0.0, 1.0], [3.0, 4.0]]]))
    >>> first, total
    (array([[0.9, 0.1]]), array([[0.9, 0.1]]))
    """
    axes = range(1, values.ndim)
    centred = values - values.mean(axis=tuple(axes), keepdims=True)
    variance = (centred**2).mean(axis=tuple(axes))
    variance = np.where(variance > 0.0, variance, np.nan)
    first = [centred.mean(axis=tuple(a for a in axes if a != i)) for i in axes]
    total = [centred - centred.mean(axis=i, keepdims=True) for i in axes]
    return (
        np.stack([(mean**2).mean(axis=1) / variance for mean in first], axis=1),
        np.stack([(rest**2).mean(axis=tuple(axes)) / variance for rest in total], axis=1),
    )


def factorial_indices(S: FloatArray, resampled: FloatArray, levels: Sequence[int], *, confidence: float) -> Indices:
    """Indices on a full grid, with intervals over scenarios.

    Parameters
    ----------
    S : (d,)
        One number a design, the last dimension fastest.
    resampled : (b, d)
        The same from resampled scenarios.
    levels : sequence of int
        Number of values in every dimension; their product is d.
    confidence : float
        Of the percentile intervals.

    Returns
    -------
    Indices

    Raises
    ------
    InputError
        If nothing differs in any resample.
    """
    first, total = (shares[0] for shares in factorial_shares(S.reshape(1, *levels)))
    # a resample in which nothing differs has no indices
    one, all_ = (shares[~np.isnan(shares).any(axis=1)] for shares in factorial_shares(resampled.reshape(-1, *levels)))
    if not len(one):
        raise InputError("S: the same for all designs in every resample; there is no variance to share out")
    return Indices(first, *percentile_interval(one, confidence), total, *percentile_interval(all_, confidence))


def saltelli_indices(S: FloatArray, k: int, *, confidence: float, samples: int, seed: int) -> Indices:
    """Indices from a Saltelli sample, by SALib; intervals over the sample's base points.

    Parameters
    ----------
    S : (m (k + 2),)
        One number a row of the sample, in its order, without the rows for second-order indices.
    k : int
        Number of dimensions.
    confidence : float
    samples : int
        Resamples of the base points.
    seed : int
        Of these.

    Returns
    -------
    Indices

    Raises
    ------
    InputError
        If the number of rows does not fit.
    LdcError
        Without SALib.
    """
    if S.ndim != 1 or S.size < 2 * (k + 2) or S.size % (k + 2):
        raise InputError(f"S: shape {S.shape}; allowed: a whole number of times k + 2 = {k + 2} rows, at least two")
    sobol = _salib("sobol")
    found = sobol.analyze(
        _cube(k), S, calc_second_order=False, num_resamples=samples, conf_level=confidence, seed=_salib_seed(seed)
    )
    return Indices(*_around(found["S1"], found["S1_conf"]), *_around(found["ST"], found["ST_conf"]))


def rbd_fast_indices(x: FloatArray, S: FloatArray, *, confidence: float, samples: int, seed: int) -> Indices:
    """First-order indices from any even sample, by SALib's RBD-FAST; there are no total ones.

    Parameters
    ----------
    x : (m, k)
        Where the designs are; only the order along every dimension counts.
    S : (m,)
        One number a design.
    confidence : float
    samples : int
        Resamples of the designs.
    seed : int
        Of these.

    Returns
    -------
    Indices
        NaN for the total ones.

    Raises
    ------
    InputError
        For fewer than 64 designs.
    LdcError
        Without SALib.
    """
    if S.size < LEAST_RBD_FAST:
        raise InputError(f"{S.size} designs; allowed: at least {LEAST_RBD_FAST} for first-order indices of a sample")
    k = x.shape[1]
    found = _salib("rbd_fast").analyze(
        _cube(k), x, S, M=_HARMONICS, num_resamples=samples, conf_level=confidence, seed=_salib_seed(seed)
    )
    nothing = np.full(k, np.nan)
    return Indices(*_around(found["S1"], found["S1_conf"]), nothing, nothing, nothing)


def _around(index: Any, half: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
    middle, width = np.asarray(index, dtype=np.float64), np.asarray(half, dtype=np.float64)
    return middle, middle - width, middle + width


def _cube(k: int) -> dict[str, Any]:
    return {"num_vars": k, "names": [str(i) for i in range(k)], "bounds": [[0.0, 1.0]] * k}


def _salib_seed(seed: int) -> int:
    """SALib takes 0 for no seed at all."""
    return int(np.random.SeedSequence([seed, 0x736F626F]).generate_state(1)[0]) | 1


def _salib(name: str) -> Any:
    import importlib

    try:
        return importlib.import_module(f"SALib.analyze.{name}")
    except ImportError:
        message = "Sobol indices of a sample need SALib, which is not installed"
        raise LdcError(f'{message}; install the extra: pip install "ldctoolkit[sensitivity]"') from None
