"""The design to take, of finalists that were scored again on fresh scenarios."""

from __future__ import annotations

import numpy as np

from ldctoolkit.arrays import BoolArray
from studies.ranking.resampled import Resampled, simultaneous_interval
from studies.ranking.simultaneous import SAME


def choose_winner(resampled: Resampled, set_of_best: BoolArray, meets: BoolArray, confidence: float) -> int | None:
    """The search's first, unless fresh scenarios part it from a better one.

    Taking the smallest fresh score would choose by luck again, and that score would be too small again. The first of
    the search was not chosen on the fresh scenarios, so its fresh score is not.

    Parameters
    ----------
    resampled : Resampled
        The f finalists on fresh scenarios, in the search's order.
    set_of_best : (f,) bool
        Of the search.
    meets : (f,) bool
        Whether each meets the requirements on the fresh scenarios.
    confidence : float
        Between 0 and 1, of all differences at once.

    Returns
    -------
    int or None
        Place among the finalists: the first one in the set of best that meets the requirements (of all finalists, if
        none in the set does). If the interval of the paired difference to it lies below 0 for others of these, the one
        of them with the smallest mean. None where no finalist meets the requirements.

    Examples
    --------
    >>> import numpy as np
    >>> S = np.random.default_rng(0).gamma(2.0, 1.0, 100)
    >>> S = np.stack([S, S - 0.1 * np.random.default_rng(1).random(100)])
    >>> resampled = Resampled.of(S, np.repeat([1, -1], 50), seed=1, samples=200)
    >>> choose_winner(resampled, np.array([True, True]), np.array([True, True]), 0.95)
    1
    """
    candidates = np.flatnonzero(meets & set_of_best)
    if not candidates.size:
        candidates = np.flatnonzero(meets)
    if not candidates.size:
        return None
    first = int(candidates[0])
    below = simultaneous_interval(resampled, confidence, first).high < -SAME
    better = candidates[below[candidates]]
    return int(better[np.argmin(resampled.mean[better])]) if better.size else first
