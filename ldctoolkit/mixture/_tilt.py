"""Minimax tilt of Botev: the saddle point of the log weight psi(x; mu), convex in mu and concave in x.

References
----------
Botev, JRSS B 79(1):125-148 (2017).
"""

from __future__ import annotations

from typing import Final

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.mixture._univariate import Restricted

_STEPS: Final = 60
_TOLERANCE: Final = 1e-9
_ACCEPTED: Final = 1e-6
"""Gradient, relative to the terms it is the sum of, above which the tilt counts as not found."""

_INNER_STEPS: Final = 80
_CAREFUL_STEPS: Final = 100
_LEAST_GAIN: Final = 1e-11
"""What a further step may still add to psi, relative to it."""


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
    """Tilt mu (K, p) and log weight psi (K,) at the saddle point; a zero row and infinity where it was not found.

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
    open_ = norm > _TOLERANCE * scale
    for _ in range(_STEPS):
        if not open_.any():
            break
        k = np.flatnonzero(open_)
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
        open_[k] = norm[k] > _TOLERANCE * scale[k]
        open_[k[waiting]] = False  # no further descent: judged below
    failed = ~(norm <= _ACCEPTED * scale)
    for k_failed in np.flatnonzero(failed):
        one = slice(k_failed, k_failed + 1)
        found = _careful(strict[one], a[one], b[one], start[one])
        if found is not None:
            mu[one], psi[one], failed[k_failed] = *found, False
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
            # what psi could still gain is added: it must not exceed the peak that sampling is told
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
    low, high, wanted = a[:, :m] - c, b[:, :m] - c, x[:, :m]
    left, right = wanted - 1.0 / (wanted - low) - 1.0, wanted + 1.0 / (high - wanted) + 1.0
    mu = np.where(wanted - low < high - wanted, left + 1.0, right - 1.0)
    for _ in range(_INNER_STEPS):
        inner = Restricted.of(low - mu, high - mu)
        _, variance = inner.moments()
        excess = inner.mean_between(low, high, mu) - wanted
        if np.all(np.abs(excess) <= 1e-15 * (1.0 + np.abs(wanted))):
            break
        left, right = np.where(excess < 0.0, mu, left), np.where(excess > 0.0, mu, right)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = mu - excess / variance
        mu = np.where((newton > left) & (newton < right), newton, 0.5 * (left + right))
    out = np.zeros_like(x)
    out[:, :m] = mu
    return out
