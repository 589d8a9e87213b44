"""How far chance takes two rank correlations apart, without drawing."""

from __future__ import annotations

import functools
import math
from typing import Final

_LEVEL: Final = 0.95
_LARGEST: Final = 1.0 - 1e-9


def rank_limits(reference: float, n: float, n_reference: float, pairs: int) -> tuple[float, float]:
    """Limits of a rank correlation of n departures about the one of other departures of the same population.

    Parameters
    ----------
    reference : float
        Spearman's rank correlation of the other departures.
    n, n_reference : float
        Departures behind the two; effective numbers where they have weights.
    pairs : int
        Pairs that are looked at; each is given 0.05/pairs (Bonferroni).

    Returns
    -------
    tuple of float
        Chance alone leads beyond them in one pair or more in about 5 % of cases, or fewer.

    Notes
    -----
    Fisher's z = artanh r has nearly the same spread whatever r is; for ranks its variance is (1 + r^2/2)/(n - 3)
    (Bonett and Wright 2000). That of a difference is the sum of both samples'; small ones need Student's quantile, with
    Welch's degrees of freedom. Measured with 20 to 200 departures of the reference model, 28 pairs: some pair is beyond
    in 3.5 to 6 % of cases.

    Examples
    --------
    >>> [round(end, 2) for end in rank_limits(0.5, 300, 30_000, 28)]
    [0.34, 0.63]
    """
    centre = math.atanh(min(max(reference, -_LARGEST), _LARGEST))
    reach = math.sqrt(1.0 + 0.5 * reference**2) * _reach_at_zero(n, n_reference, pairs)
    return math.tanh(centre - reach), math.tanh(centre + reach)


@functools.cache
def _reach_at_zero(n: float, n_reference: float, pairs: int) -> float:
    # SciPy's distributions take long to import
    from scipy.stats import t

    parts = [1.0 / max(size - 3.0, 1.0) for size in (n, n_reference)]
    df = sum(parts) ** 2 / sum(part**3 for part in parts)
    return float(t.isf(0.5 * (1.0 - _LEVEL) / pairs, df)) * math.sqrt(sum(parts))
