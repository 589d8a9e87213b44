"""Choice of the number of components by the Bayesian information criterion."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError
from ldctoolkit.mixture._checks import check_number
from ldctoolkit.mixture.bounded_gaussian_mixture import BoundedGaussianMixture

FloatArray = npt.NDArray[np.float64]
Progress = Callable[[str, int, int], None]


@dataclasses.dataclass(frozen=True)
class Selection:
    """Fits over a range of K, and the one with the least BIC.

    Attributes
    ----------
    n_components : (m,) int
        The K that were tried.
    bic : (m,)
        Their criteria, lower is better.
    log_likelihood : (m,)
        Log-likelihood per event [nats].
    models : tuple of BoundedGaussianMixture
        The fits.
    """

    n_components: npt.NDArray[np.int64]
    bic: FloatArray
    log_likelihood: FloatArray
    models: tuple[BoundedGaussianMixture, ...]

    @property
    def best(self) -> BoundedGaussianMixture:
        """The fit with the least BIC; of equals the one with fewer components."""
        return self.models[int(np.argmin(self.bic))]


def select_components(
    X: npt.ArrayLike,
    components: Iterable[int],
    *,
    progress: Progress | None = None,
    **settings: Any,
) -> Selection:
    """Fit every K of a range and keep all of them.

    Parameters
    ----------
    X : (n, d)
        Events, strictly inside the box.
    components : iterable of int
        The K to try.
    progress : callable, optional
        Called as ``progress("K = 3", done, total)`` before each fit and once at the end.
    **settings
        For `BoundedGaussianMixture`: ``lower``, ``upper``, ``random_state``, ...

    Returns
    -------
    Selection
        In ascending K.

    Raises
    ------
    InputError
        If the range is empty or a K is not a positive integer, and as for `BoundedGaussianMixture.fit`.

    Examples
    --------
    >>> import numpy as np
    >>> x = np.random.default_rng(0).normal(size=(300, 2)) + np.repeat([[0.0, 0.0], [9.0, 9.0]], 150, axis=0)
    >>> select_components(x, range(1, 4), random_state=0).best.n_components
    2
    """
    tried = sorted(set(components))
    if not tried:
        raise InputError("components: an empty range; allowed: at least one number of components")
    for K in tried:
        check_number("components", K, 1, integer=True)
    models = []
    for done, K in enumerate(tried):
        if progress is not None:
            progress(f"K = {K}", done, len(tried))
        models.append(BoundedGaussianMixture(K, **settings).fit(X))
    if progress is not None:
        progress("done", len(tried), len(tried))
    return Selection(
        np.array(tried, dtype=np.int64),
        np.array([m.bic(X) for m in models]),
        np.array([m.score(X) for m in models]),
        tuple(models),
    )
