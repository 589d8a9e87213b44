"""Probability of a box under a Gaussian by separation of variables, and the univariate truncated normal behind it."""

from __future__ import annotations

import dataclasses
import functools
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import InputError

_LOG_ROOT_2PI: Final = 0.5 * float(np.log(2.0 * np.pi))
_NARROW: Final = 1e-2
"""Below this width (times 1 + distance from zero) differences of CDFs and densities cancel: quadrature instead."""

_FAR: Final = 20.0  # so far from zero the moments cancel too
_DEEP: Final = 36.0  # so far from zero the CDF nears the smallest double: quantiles are taken from logarithms

_THREAD: Final = 1e-3
"""On intervals narrower than this the density is an exponential to seven digits: its quantile is explicit."""

_DEPTH: Final = 45.0  # a far interval is integrated to where its density has fallen to exp(-45) of its largest

_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(32)


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Standard normals restricted to intervals, mirrored so that each lies mostly left of zero."""

    low: FloatArray  # (...): ends of the mirrored intervals
    high: FloatArray  # (...)
    mirrored: BoolArray  # (...): which intervals are mirrored
    Phi_low: FloatArray  # (...): Phi(low), the mass below the interval
    mass: FloatArray  # (...): Phi(high) - Phi(low)
    log_mass: FloatArray  # (...): its logarithm, from quadrature where the interval is special
    special: BoolArray  # (...): far or narrow intervals, whose mass and moments come from quadrature
    offset: FloatArray  # (special,): high - E z of those
    variance: FloatArray  # (special,): Var z of those

    @classmethod
    def of(cls, a: FloatArray, b: FloatArray) -> Restricted:
        """Intervals (a, b), a < b; infinite ends are allowed."""
        from scipy.special import ndtr  # here, so that importing the package stays fast

        mirrored = a > -b
        low, high = np.where(mirrored, -b, a), np.where(mirrored, -a, b)
        Phi_low = ndtr(low)
        mass = ndtr(high) - Phi_low
        with np.errstate(divide="ignore", invalid="ignore"):
            log_mass = np.log(mass)
        special = (high < -_FAR) | (high - low < _NARROW / (1.0 + np.abs(high)))
        offset = variance = np.empty(0)
        if special.any():
            log_mass[special], offset, variance = _quadrature(low[special], high[special])
        return cls(low, high, mirrored, Phi_low, mass, log_mass, special, offset, variance)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """E z and Var z, in the caller's orientation."""
        root = float(np.exp(-_LOG_ROOT_2PI))
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            # densities of the restricted normal at both ends
            f_low = root * np.exp(-0.5 * self.low**2) / self.mass
            f_high = root * np.exp(-0.5 * self.high**2) / self.mass
            mean = f_low - f_high
            # an infinite end has no density: 0 in place of 0 times infinity
            variance = 1.0 + np.where(f_low > 0.0, self.low, 0.0) * f_low
            variance -= np.where(f_high > 0.0, self.high, 0.0) * f_high + mean * mean
        if self.offset.size:
            mean[self.special] = self.high[self.special] - self.offset
            variance[self.special] = self.variance
        return np.where(self.mirrored, -mean, mean), variance

    def mean_between(self, a: FloatArray, b: FloatArray, shift: FloatArray) -> FloatArray:
        """E z + shift, where a and b are the ends plus that shift: no digits are lost to a large one."""
        out: FloatArray = self.moments()[0] + shift
        if self.offset.size:
            k = self.special
            out[k] = np.where(self.mirrored[k], a[k] + self.offset, b[k] - self.offset)
        return out

    def quantile(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """The z below which a share u of the mass lies; v = 1 - u, given apart so that neither end loses digits."""
        from scipy.special import ndtr, ndtri

        below, above = np.where(self.mirrored, v, u), np.where(self.mirrored, u, v)
        left, right = self.Phi_low + below * self.mass, ndtr(-self.high) + above * self.mass
        z = ndtri(np.minimum(left, right))
        z = np.where(left <= right, z, -z)
        if self.offset.size:
            k = self.special
            z[k] = _special_quantile(self.low[k], self.high[k], below[k], above[k], z[k])
        z = np.minimum(np.maximum(z, self.low), self.high)
        return np.asarray(np.where(self.mirrored, -z, z))


def _quadrature(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithm of the mass, high - E z and Var z: Gauss-Legendre in the distance from the end nearer to zero."""
    depth = np.maximum(-high, 0.0)
    reach = np.minimum(high - low, 2.0 * _DEPTH / (depth + np.sqrt(depth**2 + 2.0 * _DEPTH)))
    reach = np.maximum(reach, np.spacing(depth))  # ends that rounding has made equal
    total, first, second = np.zeros_like(low), np.zeros_like(low), np.zeros_like(low)
    for t, w in zip(0.5 * (_NODES + 1.0), 0.5 * _NODE_WEIGHTS, strict=True):
        s = t * reach
        density = w * np.exp(s * (high - 0.5 * s))
        total += density
        first += density * t
        second += density * t * t
    first, second = first / total, second / total
    log_p = np.log(total * reach) - 0.5 * high**2 - _LOG_ROOT_2PI
    return log_p, first * reach, (second - first**2) * reach**2


def _special_quantile(
    low: FloatArray, high: FloatArray, below: FloatArray, above: FloatArray, z: FloatArray
) -> FloatArray:
    """`z`, bettered where it lies so deep, or the interval is so narrow, that the CDF has no digits left."""
    from scipy.special import log_ndtr, ndtri_exp

    deep = high < -_DEEP
    if deep.any():
        with np.errstate(divide="ignore"):
            left, right = np.log(above[deep]) + log_ndtr(low[deep]), np.log(below[deep]) + log_ndtr(high[deep])
        z[deep] = ndtri_exp(np.logaddexp(left, right))
    thread = high - low < _THREAD
    if thread.any():
        width = high[thread] - low[thread]
        rate = 0.5 * width - high[thread]
        width = np.maximum(width, 1e-300)  # ends that rounding has made equal
        rate = np.where(np.abs(rate * width) < 1e-9, 1e-9 / width, rate)
        z[thread] = high[thread] + np.log1p(above[thread] * np.expm1(-rate * width)) / rate
    return z


_STEPS: Final = 60
_TOLERANCE: Final = 1e-9
_ACCEPTED: Final = 1e-6  # gradient, relative to the terms it is the sum of, above which the tilt has failed

_INNER_STEPS: Final = 80
_CAREFUL_STEPS: Final = 100
_LEAST_GAIN: Final = 1e-11  # what a further step may still add to psi, relative to it


def _tilt_terms(
    strict: FloatArray, a: FloatArray, b: FloatArray, x: FloatArray, mu: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log weight psi (K,), its gradient (K, 2p) and the truncated variances (K, p)."""
    c = np.einsum("kij,kj->ki", strict, x)
    low, high = a - c, b - c
    inner = Restricted.of(low - mu, high - mu)
    mean, variance = inner.moments()
    psi = np.sum(0.5 * mu**2 - x * mu + inner.log_mass, axis=1)
    by_x = -mu + np.einsum("kij,ki->kj", strict, mean)
    by_mu = inner.mean_between(low, high, mu) - x
    return psi, np.concatenate([by_x, by_mu], axis=1), variance


def minimax_tilt(strict: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tilt mu (K, p) and log weight psi (K,) at the saddle point; a zero row and infinity where the search failed.

    Damped Newton on the gradient for all components at once; what it does not solve (nearly opposite variables in a
    far corner) is left to `_careful`.
    """
    K, p = a.shape
    m = p - 1  # x_p and mu_p stay zero
    free = np.r_[0:m, p : p + m]
    eye = np.eye(m)
    # start: every variable at its truncated mean given the ones before it
    x = np.zeros((K, p))
    for j in range(m):
        c = np.einsum("ki,ki->k", strict[:, j], x)
        x[:, j], _ = Restricted.of(a[:, j] - c, b[:, j] - c).moments()
    start = x.copy()
    mu = np.zeros((K, p))
    psi, gradient, variance = _tilt_terms(strict, a, b, x, mu)
    norm = np.linalg.norm(gradient[:, free], axis=1)
    # not below the rounding of the terms themselves, which grow with the distance to the box
    scale = 1.0 + np.abs(x).max(axis=1)
    unsolved = norm > _TOLERANCE * scale
    for _ in range(_STEPS):
        if not unsolved.any():
            break
        k = np.flatnonzero(unsolved)
        J = np.zeros((k.size, 2 * m, 2 * m))
        s, d = strict[k], variance[k] - 1.0
        J[:, :m, :m] = np.einsum("kia,ki,kib->kab", s[:, :, :m], d, s[:, :, :m])
        cross = d[:, :m, None] * s[:, :m, :m] - eye
        J[:, m:, :m] = cross
        J[:, :m, m:] = cross.transpose(0, 2, 1)
        J[:, m:, m:] = eye * variance[k][:, :m, None]
        try:
            step = np.linalg.solve(J, -gradient[k][:, free][:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            break
        t = np.ones(k.size)
        waiting = np.arange(k.size)
        for _ in range(30):
            kk = k[waiting]
            x_new, mu_new = x[kk].copy(), mu[kk].copy()
            x_new[:, :m] += t[waiting, None] * step[waiting, :m]
            mu_new[:, :m] += t[waiting, None] * step[waiting, m:]
            psi_new, gradient_new, variance_new = _tilt_terms(strict[kk], a[kk], b[kk], x_new, mu_new)
            norm_new = np.linalg.norm(gradient_new[:, free], axis=1)
            good = norm_new < (1.0 - 1e-3 * t[waiting]) * norm[kk]
            done = kk[good]
            x[done], mu[done], psi[done] = x_new[good], mu_new[good], psi_new[good]
            gradient[done], variance[done], norm[done] = gradient_new[good], variance_new[good], norm_new[good]
            waiting = waiting[~good]
            t[waiting] *= 0.5
            if waiting.size == 0:
                break
        scale = 1.0 + np.abs(x).max(axis=1)
        unsolved[k] = norm[k] > _TOLERANCE * scale[k]
        unsolved[k[waiting]] = False  # no further descent: judged below
    failed = ~(norm <= _ACCEPTED * scale)
    for k_failed in np.flatnonzero(failed):
        k = np.array([k_failed])
        saddle = _careful(strict[k], a[k], b[k], start[k])
        if saddle is not None:
            mu[k], psi[k], failed[k] = *saddle, False
    return np.where(failed[:, None], 0.0, mu), np.where(failed, np.inf, psi)


def _careful(strict: FloatArray, a: FloatArray, b: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Saddle point of one component by Newton on the concave min over mu of psi(x; mu), from x within the box.

    That function falls to minus infinity towards the box's faces, so a step that raises it stays inside.
    """
    m = a.shape[1] - 1
    eye = np.eye(m)
    mu = _best_tilt(strict, a, b, x)
    psi, gradient, variance = _tilt_terms(strict, a, b, x, mu)
    for _ in range(_CAREFUL_STEPS):
        s, d = strict[0, :, :m], variance[0] - 1.0
        cross = d[:m, None] * s[:m] - eye
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            curvature = (s * d[:, None]).T @ s - cross.T @ (cross / variance[0, :m, None])
        if not np.isfinite(curvature).all():
            return None
        try:
            step = np.linalg.solve(curvature, -gradient[0, :m])
        except np.linalg.LinAlgError:
            return None
        gain = 0.5 * float(step @ gradient[0, :m])
        if not gain > _LEAST_GAIN * (1.0 + abs(float(psi[0]))):
            # what psi could still gain is added: it must not exceed the peak that sampling is given
            return mu, psi + abs(gain)
        t = 1.0
        while t > 1e-9:
            x_new = x.copy()
            x_new[0, :m] += t * step
            c = (strict @ x_new[:, :, None])[:, :m, 0]
            if np.all((x_new[:, :m] > a[:, :m] - c) & (x_new[:, :m] < b[:, :m] - c)):
                mu_new = _best_tilt(strict, a, b, x_new)
                psi_new, gradient_new, variance_new = _tilt_terms(strict, a, b, x_new, mu_new)
                if psi_new[0] > psi[0]:
                    break
            t *= 0.5
        else:
            return None
        x, mu, psi, gradient, variance = x_new, mu_new, psi_new, gradient_new, variance_new
    return None


def _best_tilt(strict: FloatArray, a: FloatArray, b: FloatArray, x: FloatArray) -> FloatArray:
    """The mu that makes each conditional mean equal to x: Newton between bounds that hold for any interval."""
    m = a.shape[1] - 1
    c = (strict @ x[:, :, None])[:, :m, 0]
    low, high, target = a[:, :m] - c, b[:, :m] - c, x[:, :m]
    left, right = target - 1.0 / (target - low) - 1.0, target + 1.0 / (high - target) + 1.0
    mu = np.where(target - low < high - target, left + 1.0, right - 1.0)
    for _ in range(_INNER_STEPS):
        inner = Restricted.of(low - mu, high - mu)
        _, variance = inner.moments()
        excess = inner.mean_between(low, high, mu) - target
        if np.all(np.abs(excess) <= 1e-15 * (1.0 + np.abs(target))):
            break
        left, right = np.where(excess < 0.0, mu, left), np.where(excess > 0.0, mu, right)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = mu - excess / variance
        mu = np.where((newton > left) & (newton < right), newton, 0.5 * (left + right))
    out = np.zeros_like(x)
    out[:, :m] = mu
    return out


_CACHED: Final = 16_384
"""Points times components handled at once, so that they stay in the second cache; it changes no number."""


@dataclasses.dataclass(frozen=True)
class Separation:
    """K boxes made ready for one-variable-at-a-time integration."""

    order: IntArray  # (K, p): variables in the order in which they are integrated
    factor: FloatArray  # (K, p, p): G with x - mu = G z and G G^T = Sigma
    strict: FloatArray  # (K, p, p): the factor in integration order over its diagonal, without that
    lower: FloatArray  # (K, p): bounds in the integration order over the factor's diagonal
    upper: FloatArray  # (K, p)
    tilt: FloatArray  # (K, p): minimax tilt
    log_peak: FloatArray  # (K,): largest value of the log weight psi over the box at that tilt


@dataclasses.dataclass(frozen=True)
class WhitenedMoments:
    """Results of the integration in whitened coordinates z."""

    log_p: FloatArray  # (K,): logarithm of the probability of the box
    mean: FloatArray  # (K, p): E z inside the box
    second: FloatArray  # (K, p, p): E z z^T inside the box
    covariance: FloatArray  # (K, p, p): covariance of z inside the box, without the cancellation of a far mean
    points: FloatArray  # (K, p, n): weighted points inside the box
    weights: FloatArray  # (K, n): their weights, summing to one


def integration_order(covariance: FloatArray, lower: FloatArray, upper: FloatArray) -> IntArray:
    """Variables with the least conditional probability first (Gibson, Glasbey and Elston), (K, p)."""
    K, p = lower.shape
    S = covariance.copy()  # conditional covariance given the variables chosen so far
    shift = np.zeros((K, p))  # conditional mean, the chosen ones at their truncated mean
    order = np.empty((K, p), dtype=np.int64)
    remaining = np.ones((K, p), dtype=bool)
    rows = np.arange(K)
    for step in range(p):
        deviation = np.sqrt(np.maximum(np.diagonal(S, axis1=1, axis2=2), 1e-300))
        a, b = (lower - shift) / deviation, (upper - shift) / deviation
        mass = Restricted.of(a, b).log_mass
        pick = np.argmin(np.where(remaining, mass, np.inf), axis=1)
        order[:, step], remaining[rows, pick] = pick, False
        picked = (rows, pick)
        mean, _ = Restricted.of(a[picked], b[picked]).moments()
        column = S[rows, :, pick]
        shift = shift + column * (mean / deviation[picked])[:, None]
        S = S - column[:, :, None] * column[:, None, :] / (deviation[picked] ** 2)[:, None, None]
    return order


def separate(covariance: FloatArray, lower: FloatArray, upper: FloatArray, order: IntArray | None = None) -> Separation:
    """Separation of K boxes of p dimensions; raises `InputError` for a covariance that is not positive definite."""
    K, p = lower.shape
    order = integration_order(covariance, lower, upper) if order is None else order
    rows = np.arange(K)[:, None]
    ordered = covariance[rows[:, :, None], order[:, :, None], order[:, None, :]]
    try:
        L = np.linalg.cholesky(ordered)
    except np.linalg.LinAlgError:
        raise InputError("truncated normal", "a covariance matrix is not positive definite") from None
    diagonal = np.diagonal(L, axis1=1, axis2=2)
    strict = L / diagonal[:, :, None]
    strict[:, np.arange(p), np.arange(p)] = 0.0
    factor = np.empty_like(L)
    factor[rows, order] = L
    a, b = lower[rows, order] / diagonal, upper[rows, order] / diagonal
    if p > 1:
        tilt, log_peak = minimax_tilt(strict, a, b)
    else:
        tilt, log_peak = np.zeros((K, p)), Restricted.of(a, b).log_mass[:, 0]
    return Separation(order, factor, strict, a, b, tilt, log_peak)


def integrate(box: Separation, points: int) -> WhitenedMoments:
    """Probability and moments by the frozen lattice; the last variable is integrated analytically.

    Each variable is drawn from a distribution whose mean and variance given the ones before it are known. The moments
    are therefore sums of known ones and of differences from them, and those differences are weighted by how far the
    weights are from their average (control variates): where the weights are nearly equal, a far box or a weak
    correlation, the lattice's own error drops out.
    """
    K, p = box.lower.shape
    grid = lattice(points, p)
    at_once = max(1, _CACHED // points)
    parts = [_integrate(component_rows(box, slice(k, k + at_once)), grid) for k in range(0, K, at_once)]
    if len(parts) == 1:
        return parts[0]
    names = [field.name for field in dataclasses.fields(WhitenedMoments)]
    return WhitenedMoments(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def component_rows(box: Separation, rows: slice) -> Separation:
    return Separation(**{field.name: getattr(box, field.name)[rows] for field in dataclasses.fields(Separation)})


def _integrate(box: Separation, grid: Lattice) -> WhitenedMoments:
    """Moments of the whitened variables by the lattice."""
    K, p = box.lower.shape
    z = np.empty((K, p, grid.weight.size))
    expected, variance = np.empty_like(z), np.empty_like(z)
    log_weight = np.zeros((K, grid.weight.size))
    for j in range(p):
        mu = box.tilt[:, j, None]
        shift = (box.strict[:, j, None, :j] @ z[:, :j])[:, 0] + mu
        inner = Restricted.of(box.lower[:, j, None] - shift, box.upper[:, j, None] - shift)
        mean, variance[:, j] = inner.moments()
        expected[:, j] = mean + mu
        z[:, j] = inner.quantile(grid.u[j], grid.v[j]) + mu
        log_weight += inner.log_mass - z[:, j] * mu
    log_weight += 0.5 * np.sum(box.tilt**2, axis=1)[:, None]
    peak = log_weight.max(axis=1, keepdims=True)
    weights = np.exp(log_weight - peak) * grid.weight
    total = weights.sum(axis=1, keepdims=True)
    weights /= total
    drawn = weights * grid.last
    drawn /= drawn.sum(axis=1, keepdims=True)
    log_p = peak[:, 0] + np.log(total[:, 0])
    # mean and covariance with control variates
    last = p - 1
    smooth = z.copy()
    smooth[:, last] = expected[:, last]
    noise = smooth - expected  # of expectation zero given the variables before; none in the last one
    W, L = weights[:, None, :], grid.weight
    origin = smooth[:, :, 0]  # far outside, points differ in their last digits only: sums are taken from one of them
    mean = origin + (weights[:, None] @ (smooth - origin[:, :, None]).transpose(0, 2, 1))[:, 0] - noise @ L
    centred = smooth - mean[:, :, None]
    covariance = (centred * W) @ centred.transpose(0, 2, 1)
    # an entry i < j loses the lattice's sum of (z_i - mean_i) noise_j, an entry j, j that of noise_j^2 - variance_j
    # + 2 noise_j (expected_j - mean_j), all of expectation zero
    cross = np.triu((centred * L) @ noise.transpose(0, 2, 1), 1)
    covariance -= cross + cross.transpose(0, 2, 1)
    excess = noise * (noise + 2.0 * (expected - mean[:, :, None])) - variance
    excess[:, last] = 0.0
    diagonal = np.arange(last + 1)
    covariance[:, diagonal, diagonal] -= excess @ L
    covariance[:, last, last] += np.sum(weights * variance[:, last], axis=1)
    second = covariance + mean[:, :, None] * mean[:, None, :]
    return WhitenedMoments(log_p, mean, second, covariance, z, drawn)


_GENERATORS: Final = {
    1021: (1, 374, 228, 286, 174, 355, 195, 31, 251, 43),
    4093: (1, 1210, 1542, 1785, 842, 1113, 1495, 437, 254, 1130),
    16381: (1, 6768, 7521, 2297, 7750, 1248, 7478, 1032, 5094, 5961),
}
"""Component-by-component generating vectors of rank-1 lattices, by their number of points (an odd prime), in a Korobov
space of smoothness 4 with weights of 0.3, 0.5 and 0.25 per further variable: of 0.2, 0.25, 0.3 and 0.5 those with the
smallest worst error over hard boxes (equal correlations of 0.95 and -0.9, slabs, means far outside)."""

_FEWEST_FOR_SECOND_ORDER: Final = {7: 10_000, 8: 10_000}
"""Points from which Sidi's second order pays, by the number of variables: always up to six, never beyond eight; with
fewer points its uneven weights cost more than its smoothness gains (worst whitened covariance over hard boxes, eight
variables: 4,093 points, 6e-3 by the first order and 4e-2 by the second; 16,381 points, 6e-4 and 7e-4)."""


@dataclasses.dataclass(frozen=True)
class Lattice:
    """n points in the unit cube and their weights."""

    u: FloatArray  # (dimension, n): coordinates
    v: FloatArray  # (dimension, n): one minus them, so that neither end loses digits
    weight: FloatArray  # (n,): weights, summing to one, for integrands of all variables but the last
    last: FloatArray  # (n,): what the last variable multiplies `weight` by for integrands of all variables


@functools.lru_cache(maxsize=32)
def lattice(n: int, dimension: int) -> Lattice:
    """The rank-1 lattice of n points for `dimension` variables."""
    if n not in _GENERATORS or dimension > len(_GENERATORS[n]):
        most = max(map(len, _GENERATORS.values()))
        problem = f"{n} points in {dimension} bounded dimensions"
        raise InputError("truncated normal", problem, allowed=f"{list(_GENERATORS)} in at most {most}")
    z = np.array(_GENERATORS[n][:dimension], dtype=np.int64)
    # half a cell off the origin: with n odd no coordinate is ever 0 or 1
    t = ((np.outer(z, np.arange(n)) % n) / n + 0.5) % 1.0
    if n >= _FEWEST_FOR_SECOND_ORDER.get(dimension, 0 if dimension < 7 else n + 1):
        u, v = _sidi(t), _sidi(1.0 - t)
        jacobian = 1.0 - np.cos(2.0 * np.pi * t)
    else:
        u, v = np.sin(0.5 * np.pi * t) ** 2, np.cos(0.5 * np.pi * t) ** 2
        jacobian = 0.5 * np.pi * np.sin(np.pi * t)
    weight = np.prod(jacobian[:-1], axis=0)
    points = Lattice(u, v, weight / weight.sum(), jacobian[-1])
    for array in (points.u, points.v, points.weight, points.last):
        array.setflags(write=False)
    return points


def _sidi(t: FloatArray) -> FloatArray:
    """Sidi's transformation of order two, t - sin(2 pi t)/(2 pi); a series keeps it exact near zero."""
    angle = 2.0 * np.pi * t
    small = angle < 0.05
    series = angle**3 / 6.0 * (1.0 - angle**2 / 20.0 * (1.0 - angle**2 / 42.0))
    return np.asarray(np.where(small, series, angle - np.sin(angle)) / (2.0 * np.pi))
