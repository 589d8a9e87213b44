"""Compiled E-step: rows are taken 256 at a time, features and shares stay in the first cache, the GIL is released.

log N(x; mu, Sigma) is linear in the features (1, x_i, x_i x_j), so a block's logits are a matrix product, and so are
its sufficient statistics. The products are written out two components at a time: each feature is then read half as
often. The compiler takes a while to import: callers import this module where they call it.
"""

import math
from typing import Any, Final

import numba
import numpy as np

import ldctoolkit.compiling as compiling
from ldctoolkit.arrays import FloatArray, IntArray

compiling.listen()

_ROWS: Final = 256
_FLOOR: Final = -100.0
"""Logits this far below a row's largest are raised to it: smaller shares would be denormal numbers, which are slow."""

# sums may be reassociated and contracted; NaN and infinity keep their meaning. How depends on what is compiled
# together: only the pass as a whole is kept on disk, no part of it, which could not be taken apart any more
_OPTIONS: Final[dict[str, Any]] = {"nogil": True, "fastmath": {"contract", "reassoc", "nsz"}}

# the two parts of ln 2 must not be added up
_EXP_OPTIONS: Final[dict[str, Any]] = _OPTIONS | {"fastmath": {"contract", "nsz"}}

_LOG2_E: Final = 1.4426950408889634
_LN2_HIGH: Final = 6.93147180369123816490e-01
_LN2_LOW: Final = 1.90821492927058770002e-10


@numba.njit(**_EXP_OPTIONS)  # type: ignore[untyped-decorator]
def _exp(x: FloatArray, power: IntArray, m: int) -> None:
    """Exponential of x[:m], -700 to 0, as x * 2^power in place: a Taylor polynomial that vectorises, to 1 ulp."""
    for e in range(m):
        whole = np.rint(x[e] * _LOG2_E)
        r = (x[e] - whole * _LN2_HIGH) - whole * _LN2_LOW
        p = 1.0 / 6227020800.0
        p = p * r + 1.0 / 479001600.0
        p = p * r + 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        x[e] = p * r + 1.0
        power[e] = (np.int64(whole) + 1023) << 52


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def _features(
    x: FloatArray, first: int, m: int, location: FloatArray, inverse_scale: FloatArray, out: FloatArray
) -> None:
    """Features (F, m) of standardised rows; the constant feature is there already."""
    d = x.shape[1]
    for i in range(d):
        z = out[1 + i]
        low, inverse = location[i], inverse_scale[i]
        for e in range(m):
            z[e] = (x[first + e, i] - low) * inverse
    row = 1 + d
    for i in range(d):
        for j in range(i, d):
            a, b, c = out[1 + i], out[1 + j], out[row]
            for e in range(m):
                c[e] = a[e] * b[e]
            row += 1


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def _logits(theta: FloatArray, features: FloatArray, m: int, out: FloatArray) -> None:
    """Coefficients theta (2 H, F) times features, two components and three features at a time."""
    F = features.shape[0]
    for pair in range(theta.shape[0] // 2):
        one, two = out[2 * pair], out[2 * pair + 1]
        s, t = theta[2 * pair], theta[2 * pair + 1]
        for e in range(m):
            one[e] = s[0]
            two[e] = t[0]
        q = 1
        while q + 2 < F:
            a, b, c = features[q], features[q + 1], features[q + 2]
            s0, s1, s2, t0, t1, t2 = s[q], s[q + 1], s[q + 2], t[q], t[q + 1], t[q + 2]
            for e in range(m):
                one[e] += s0 * a[e] + s1 * b[e] + s2 * c[e]
                two[e] += t0 * a[e] + t1 * b[e] + t2 * c[e]
            q += 3
        while q < F:
            a = features[q]
            s0, t0 = s[q], t[q]
            for e in range(m):
                one[e] += s0 * a[e]
                two[e] += t0 * a[e]
            q += 1


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def _shares(logits: FloatArray, K: int, m: int, scale: FloatArray, power: IntArray, value: FloatArray) -> None:
    """Logits to shares in place, and ln sum exp of each row into `value`."""
    total = np.zeros(m)
    for e in range(m):
        value[e] = logits[0, e]
    for k in range(1, K):
        g = logits[k]
        for e in range(m):
            value[e] = max(value[e], g[e])
    for k in range(K):
        g = logits[k]
        for e in range(m):
            g[e] = max(g[e] - value[e], _FLOOR)
        _exp(g, power, m)
        for e in range(m):
            g[e] *= scale[e]
            total[e] += g[e]
    for e in range(m):
        value[e] += math.log(total[e])
        total[e] = 1.0 / total[e]
    for k in range(K):
        g = logits[k]
        for e in range(m):
            g[e] *= total[e]


@numba.njit(**_OPTIONS)  # type: ignore[untyped-decorator]
def _add(shares: FloatArray, features: FloatArray, m: int, sums: FloatArray) -> None:
    """Add to sums (2 H, F) the shares times features^T, two components and three features at a time."""
    F = features.shape[0]
    for pair in range(shares.shape[0] // 2):
        r, s = shares[2 * pair], shares[2 * pair + 1]
        q = 0
        while q + 2 < F:
            a, b, c = features[q], features[q + 1], features[q + 2]
            r0, r1, r2, s0, s1, s2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for e in range(m):
                r0 += r[e] * a[e]
                r1 += r[e] * b[e]
                r2 += r[e] * c[e]
                s0 += s[e] * a[e]
                s1 += s[e] * b[e]
                s2 += s[e] * c[e]
            sums[2 * pair, q] += r0
            sums[2 * pair, q + 1] += r1
            sums[2 * pair, q + 2] += r2
            sums[2 * pair + 1, q] += s0
            sums[2 * pair + 1, q + 1] += s1
            sums[2 * pair + 1, q + 2] += s2
            q += 3
        while q < F:
            a = features[q]
            r0, s0 = 0.0, 0.0
            for e in range(m):
                r0 += r[e] * a[e]
                s0 += s[e] * a[e]
            sums[2 * pair, q] += r0
            sums[2 * pair + 1, q] += s0
            q += 1


@numba.njit(cache=True, **_OPTIONS)  # type: ignore[untyped-decorator]
def _pass(
    x: FloatArray,
    weight: FloatArray,
    location: FloatArray,
    inverse_scale: FloatArray,
    theta: FloatArray,
    K: int,
    sums: FloatArray,
    density: FloatArray,
) -> float:
    """One pass over rows; `sums` gains the statistics, `density` the log-density, either may be empty."""
    n, F = x.shape[0], theta.shape[1]
    features = np.empty((F, _ROWS))
    logits = np.zeros((theta.shape[0], _ROWS))
    scale = np.empty(_ROWS)
    power = scale.view(np.int64)
    value = np.empty(_ROWS)
    features[0] = 1.0
    log_likelihood = 0.0
    for first in range(0, n, _ROWS):
        m = min(_ROWS, n - first)
        _features(x, first, m, location, inverse_scale, features)
        _logits(theta, features, m, logits)
        _shares(logits, K, m, scale, power, value)
        if density.size:
            for e in range(m):
                density[first + e] = value[e]
        if sums.size == 0:
            continue
        if weight.size:
            for e in range(m):
                log_likelihood += weight[first + e] * value[e]
            for k in range(K):
                g = logits[k]
                for e in range(m):
                    g[e] *= weight[first + e]
        else:
            for e in range(m):
                log_likelihood += value[e]
        logits[K:] = 0.0
        _add(logits, features, m, sums)
    return log_likelihood


def _rows(x: FloatArray) -> FloatArray:
    """The same numbers, contiguous and read-only: all callers meet one version of the compiled pass."""
    view = np.ascontiguousarray(x).view()
    view.flags.writeable = False
    return view


def _paired(theta: FloatArray) -> FloatArray:
    """Coefficients (K, F) with a row of zeros added where K is odd."""
    return np.concatenate([theta, np.zeros((theta.shape[0] % 2, theta.shape[1]))])


_NONE: Final = np.empty(0)
_NO_SUMS: Final = np.empty((0, 0))


def statistics_of_rows(
    x: FloatArray, weight: FloatArray | None, location: FloatArray, scale: FloatArray, theta: FloatArray
) -> tuple[float, FloatArray]:
    """Log-likelihood and feature sums of some rows."""
    K = theta.shape[0]
    padded = _paired(theta)
    sums = np.zeros(padded.shape)
    weight = _rows(_NONE if weight is None else weight)
    total = _pass(_rows(x), weight, _rows(location), 1.0 / scale, padded, K, sums, _NONE)
    return float(total), sums[:K]


def log_density_of_rows(x: FloatArray, location: FloatArray, scale: FloatArray, theta: FloatArray) -> FloatArray:
    """Logarithm of sum_k exp(theta_k . features) of each row, (m,)."""
    out = np.empty(x.shape[0])
    if out.size:
        padded, K = _paired(theta), theta.shape[0]
        _pass(_rows(x), _rows(_NONE), _rows(location), 1.0 / scale, padded, K, _NO_SUMS, out)
    return out
