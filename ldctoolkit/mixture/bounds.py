"""Bounds read off the data: where a column's density ends abruptly, and where it only thins out."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture.checks import as_matrix, check_matrix

LEAST_ROWS: Final = 50  # with fewer rows no end is looked for; only zero is

_TAIL_SHARE: Final = 0.1
_TAIL_ROWS: Final = (20, 500)
_ABRUPT_INDEX: Final = -0.3
_DOUBT: Final = 1.2
_ZERO_INDEX: Final = -0.15
_ZERO_DOUBT: Final = 0.2
_JUMP_INDEX: Final = -0.7
_TOO_FAR: Final = 7.0  # ln of 1/0.001: the least value lies further from zero than it would once in a thousand samples


def auto_bounds(x: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of each column, infinite where the density thins out and does not end.

    Raises `InputError` if `x` is no matrix of finite numbers.

    Parameters
    ----------
    x : (n, d)
        Events, finite.

    Returns
    -------
    lower, upper : (d,)
        Strictly outside the data; -inf and inf are open. A constant column is open.

    Notes
    -----
    At each end of a column the k outermost values are taken, a tenth of the rows but from 20 to 500 (a fifth of fewer
    than 100 rows). Their distances from the next value inside follow a generalised Pareto law, whose index xi is
    estimated after Zhang and Stephens (2009). xi = -1/a where the density ends like the power a - 1 of the distance
    to the end: -1 for a jump, -1/2 for a straight line to zero; 0 for an exponential tail, a little below 0 for a
    normal one.

    - **Zero** is the bound where all values are on one side of it and ln(value/next) of the m outermost, a tenth of
      the rows, has a mean below -0.15 - 0.2/sqrt(m) (the index if the density ended at zero: a normal column would
      have its mean within about four standard deviations of zero), unless the density jumps, xi < -0.7, too far from
      zero to be a chance of 1 in 1,000.
      Values that are zero themselves keep the bound half the least other distance away.
    - **An abrupt end**, xi < -0.3 - 1.2/sqrt(k), is the bound: beyond the extreme value by as much as the extreme of k
      such values is expected to fall short of the end.
    - **Otherwise** the end is open, as it is with fewer than 50 rows.

    A tail whose index lies near -0.4 (a density that goes to zero like the power 1.5 of the distance, somewhere else
    than at zero) is decided by chance.

    References
    ----------
    Zhang and Stephens, Technometrics 51(3):316-325, 2009. Pickands, Annals of Statistics 3(1):119-131, 1975.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> x = np.column_stack([rng.normal(20.0, 2.0, 1000), rng.gamma(2.0, 1.0, 1000), rng.uniform(1.0, 3.0, 1000)])
    >>> lower, upper = auto_bounds(x)
    >>> lower.round(2).tolist(), upper.round(2).tolist()
    ([-inf, 0.0, 1.0], [inf, inf, 3.0])
    """
    events = as_matrix(x)
    check_matrix(events, events.shape[1], None)
    ends = np.array([(0.0 - _upper_end(-column), _upper_end(column)) for column in events.T]).reshape(-1, 2)
    return ends[:, 0], ends[:, 1]


def _upper_end(column: FloatArray) -> float:
    """The upper end of one column; infinite if open."""
    n = column.size
    x = np.sort(column)
    if n < 2 or not x[-1] - x[0] > 1e-12 * max(-x[0], x[-1]):
        return math.inf
    if n < LEAST_ROWS:
        return _outside_zero(x) if _may_end_at_zero(x, _zero_index(x)) else math.inf
    k = n // 5 if n < 5 * _TAIL_ROWS[0] else int(min(max(_TAIL_SHARE * n, _TAIL_ROWS[0]), _TAIL_ROWS[1]))
    inside = x[-k - 1]
    distances = x[-k:] - inside
    distances = distances[distances > 0.0]
    if distances.size == 0:  # the extreme itself, again and again
        return _outside_zero(x) if x[-1] == 0.0 else float(x[-1] + _small_step(x))
    index = _tail_index(distances) if distances.size >= 5 else -1.0
    abrupt = index < _ABRUPT_INDEX - _DOUBT / math.sqrt(k)
    zero = _zero_index(x)
    too_far = index < _JUMP_INDEX and k * (x[-1] / inside) ** (-1.0 / zero) > _TOO_FAR if zero < 0.0 else True
    if _may_end_at_zero(x, zero) and not (abrupt and too_far):
        return _outside_zero(x)
    if not abrupt:
        return math.inf
    a = max(index, -1.0)
    short = math.exp(math.lgamma(1.0 - a) + math.lgamma(k + 1.0) - math.lgamma(k + 1.0 - a))
    end = float(inside + distances[-1] / (1.0 - short))
    return end if end > x[-1] else float(x[-1] + _small_step(x))


def _tail_index(distances: FloatArray) -> float:
    """Index of a generalised Pareto law from ascending positive values; negative means a finite end."""
    y = distances / distances[-1]
    m = 20 + int(math.sqrt(y.size))
    quarter = max(float(y[max(int(y.size / 4 + 0.5) - 1, 0)]), 1e-12)
    theta = 1.0 + (1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))) / (3.0 * quarter)
    theta[theta == 0.0] = 1e-12
    index = np.log1p(-theta[:, None] * y).mean(axis=1)
    log_likelihood = y.size * (np.log(-theta / index) - index - 1.0)
    weight = np.exp(log_likelihood - log_likelihood.max())
    mean = float(weight @ theta / weight.sum())
    return float(np.log1p(-mean * y).mean())


def _zero_index(x: FloatArray) -> float:
    """Index of the outermost tenth of ascending values if their upper end is zero; 0 if some are positive."""
    if x[-1] > 0.0:
        return 0.0
    tail = x[-_zero_rows(x) - 1 :]
    if tail[-1] == 0.0:
        return -math.inf
    return float((np.log(-tail[1:]) - np.log(-tail[0])).mean())


def _zero_rows(x: FloatArray) -> int:
    return max(int(_TAIL_SHARE * x.size), min(5, x.size - 1))


def _may_end_at_zero(x: FloatArray, index: float) -> bool:
    return index < _ZERO_INDEX - _ZERO_DOUBT / math.sqrt(_zero_rows(x))


def _outside_zero(x: FloatArray) -> float:
    return 0.0 if x[-1] < 0.0 else max(float(-0.5 * x[x < 0.0][-1]), math.nextafter(0.0, 1.0))


def _small_step(x: FloatArray) -> float:
    """Half the least distance of the other values to the extreme, at most a thousandth of the spread."""
    step = min(0.5 * float(x[-1] - x[x < x[-1]][-1]), 1e-3 * float(x.std()))
    return max(step, math.nextafter(x[-1], math.inf) - float(x[-1]))
