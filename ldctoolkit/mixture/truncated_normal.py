"""Multivariate normals truncated to a box: probability, mean, covariance and exact sampling."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from ldctoolkit.errors import InputError, ModelError
from ldctoolkit.mixture._separation import IntArray, Separation, WhitenedMoments, integrate, separate
from ldctoolkit.mixture._univariate import FloatArray, mass_and_quantile

Array = npt.NDArray[Any]
Fields = TypeVar("Fields", Separation, WhitenedMoments)

MOMENT_POINTS: Final = 4093
"""Lattice points: ln P to about 1e-6, whitened covariance to about 1e-4 in eight correlated dimensions."""

_PLAIN_REJECTION: Final = 0.1
"""Above this probability of the box plain rejection is the cheaper exact sampler."""

_MAX_PROPOSALS: Final = 2000
"""Proposals per wanted event before sampling is given up (acceptance is 0.1 or more in either route)."""


class TruncatedNormal:
    """K normals N(mu_k, Sigma_k), each truncated to the same box.

    Parameters
    ----------
    mu : (K, d)
        Means before truncation.
    Sigma : (K, d, d)
        Covariances before truncation, positive definite.
    lower, upper : (d,)
        The box; -inf and inf are allowed. A dimension that is open on both sides costs nothing: it is carried along
        by Gaussian regression on the bounded ones.
    points : int
        Lattice points, an odd prime.
    order : (K, p) int, optional
        Order of integration of the p bounded variables; chosen afresh by default.

    Attributes
    ----------
    log_probability : (K,)
        ln P_k, the logarithm of the probability of the box.
    mean : (K, d)
        Mean inside the box.
    covariance : (K, d, d)
        Covariance inside the box.
    bounded : (p,) int
        The dimensions with a finite bound.

    Raises
    ------
    InputError
        On wrong shapes, lower >= upper, numbers that are not finite, or a covariance that is not positive definite.

    Notes
    -----
    The bounded variables are ordered (Gibson, Glasbey, Elston), whitened by a Cholesky factor, tilted (Botev 2017)
    and integrated one at a time on a frozen rank-1 lattice, the last one analytically. Moments are weighted averages
    of the transformed points, so they stay accurate where ln P is far below the smallest double.

    Examples
    --------
    >>> import numpy as np
    >>> half = TruncatedNormal([[0.0]], [[[1.0]]], [0.0], [np.inf])
    >>> np.round([half.log_probability[0], half.mean[0, 0], half.covariance[0, 0, 0]], 6).tolist()
    [-0.693147, 0.797885, 0.36338]
    """

    log_probability: FloatArray
    mean: FloatArray
    covariance: FloatArray
    bounded: IntArray

    def __init__(
        self,
        mu: npt.ArrayLike,
        Sigma: npt.ArrayLike,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        *,
        points: int = MOMENT_POINTS,
        order: IntArray | None = None,
    ) -> None:
        self.mu = np.asarray(mu, dtype=float)
        self.Sigma = np.asarray(Sigma, dtype=float)
        self.lower = np.asarray(lower, dtype=float)
        self.upper = np.asarray(upper, dtype=float)
        self._check()
        self._open = np.isneginf(self.lower) & np.isposinf(self.upper)
        self.bounded = np.flatnonzero(~self._open)
        self.box: Separation | None = None
        self.whitened: WhitenedMoments | None = None
        if self.bounded.size == 0:
            self.log_probability = np.zeros(self.mu.shape[0])
            self.mean, self.covariance = self.mu.copy(), self.Sigma.copy()
            return
        b = self.bounded
        mu_b, Sigma_b = self.mu[:, b], self.Sigma[:, b[:, None], b]
        self.box = separate(Sigma_b, self.lower[b] - mu_b, self.upper[b] - mu_b, order)
        self.whitened = integrate(self.box, points)
        self.log_probability = np.minimum(self.whitened.log_p, 0.0)
        # E[x] = mu + Sigma[:, B] Sigma_BB^-1 (E[x_B] - mu_B), and Sigma_BB = G G^T
        G = self.box.factor
        spread = np.linalg.solve(G, self.Sigma[:, b, :]).transpose(0, 2, 1)
        z = self.whitened.mean
        V = self.whitened.second - z[:, :, None] * z[:, None, :]
        self.mean = self.mu + (spread @ z[:, :, None])[:, :, 0]
        covariance = self.Sigma + spread @ (V - np.eye(b.size)) @ spread.transpose(0, 2, 1)
        covariance[:, b[:, None], b] = G @ V @ G.transpose(0, 2, 1)  # without the cancellation of Sigma
        self.covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))

    def with_components(self, rows: IntArray, other: TruncatedNormal, which: IntArray) -> TruncatedNormal:
        """A copy whose components `rows` are the components `which` of another one on the same box."""
        out = copy.copy(self)
        for name in ("mu", "Sigma", "log_probability", "mean", "covariance"):
            setattr(out, name, _put(getattr(self, name), rows, getattr(other, name), which))
        if self.box is not None and other.box is not None:
            out.box = _put_fields(self.box, rows, other.box, which)
        if self.whitened is not None and other.whitened is not None:
            out.whitened = _put_fields(self.whitened, rows, other.whitened, which)
        return out

    def _check(self) -> None:
        K, d = self.mu.shape if self.mu.ndim == 2 else (-1, -1)
        if K < 1 or self.Sigma.shape != (K, d, d) or self.lower.shape != (d,) or self.upper.shape != (d,):
            raise InputError(
                f"truncated normal: shapes mu {self.mu.shape}, Sigma {self.Sigma.shape}, lower {self.lower.shape}, "
                f"upper {self.upper.shape}; allowed: (K, d), (K, d, d), (d,), (d,)"
            )
        if not (np.isfinite(self.mu).all() and np.isfinite(self.Sigma).all()):
            raise InputError("truncated normal: mu and Sigma must be finite numbers")
        check_bounds(self.lower, self.upper)

    def sample(
        self, n: int, random_state: int | np.random.Generator | None = None, *, component: int = 0
    ) -> FloatArray:
        """Draw exactly from one component.

        Parameters
        ----------
        n : int
            Number of draws.
        random_state : int or Generator, optional
            Seed.
        component : int
            Which of the K.

        Returns
        -------
        (n, d)
            Points inside the box.

        Raises
        ------
        ModelError
            If the box has so little probability that neither route finds points (proposals are capped).

        Notes
        -----
        Plain rejection where P > 0.1, otherwise accept-reject from the tilted proposal (Botev 2017), both exact.
        """
        rng = np.random.default_rng(random_state)
        k = component
        out = np.empty((0, self.mu.shape[1]))
        if n <= 0:
            return out
        plain = self.box is None or self.log_probability[k] > np.log(_PLAIN_REJECTION)
        if not plain and self.box is not None and not np.isfinite(self.box.log_peak[k]):
            raise self._give_up(k)
        parts: list[FloatArray] = []
        found = proposed = 0
        rate = max(float(np.exp(self.log_probability[k])), _PLAIN_REJECTION) if plain else 0.5
        while found < n:
            if proposed > _MAX_PROPOSALS * (n + 10):
                raise self._give_up(k)
            m = int((n - found) / rate * 1.1) + 16
            part = self._plain(m, rng, k) if plain else self._tilted(m, rng, k)
            proposed += m
            found += part.shape[0]
            parts.append(part)
        return np.concatenate(parts)[:n]

    def _give_up(self, k: int) -> ModelError:
        return ModelError(
            f"truncated normal: component {k} cannot be sampled, its box holds exp({self.log_probability[k]:.4g}) of "
            "its probability and no proposal reaches it; refit with fewer components or a larger prior_strength"
        )

    def _plain(self, m: int, rng: np.random.Generator, k: int) -> FloatArray:
        L = np.linalg.cholesky(self.Sigma[k])
        x: FloatArray = self.mu[k] + rng.standard_normal((m, L.shape[0])) @ L.T
        return x[np.all((x > self.lower) & (x < self.upper), axis=1)]

    def _tilted(self, m: int, rng: np.random.Generator, k: int) -> FloatArray:
        box = self.box
        if box is None:
            raise self._give_up(k)
        p = box.order.shape[1]
        u = rng.random((p, m))
        z = np.zeros((p, m))
        psi = np.zeros(m)
        with np.errstate(divide="ignore"):
            log_u, log_1mu = np.log(u), np.log1p(-u)
        for j in range(p):
            c = box.strict[k, j, :j] @ z[:j]
            tilt = box.tilt[k, j]
            low, high = box.lower[k, j] - c - tilt, box.upper[k, j] - c - tilt
            mass, drawn = mass_and_quantile(low, high, log_u[j], log_1mu[j])
            z[j] = drawn + tilt
            psi += 0.5 * tilt**2 - z[j] * tilt + mass
        keep = (np.log(rng.random(m)) < psi - box.log_peak[k]) & np.isfinite(z).all(axis=0)
        z = z[:, keep]
        b, free = self.bounded, np.flatnonzero(self._open)
        x = np.empty((z.shape[1], self.mu.shape[1]))
        x[:, b] = self.mu[k, b] + z.T @ box.factor[k].T
        if free.size:
            spread = np.linalg.solve(box.factor[k], self.Sigma[k][np.ix_(b, free)])
            rest = self.Sigma[k][np.ix_(free, free)] - spread.T @ spread
            noise = rng.standard_normal((z.shape[1], free.size)) @ np.linalg.cholesky(rest).T
            x[:, free] = self.mu[k, free] + z.T @ spread + noise
        # rounding may set a point on its bound: the density knows no such points
        inside: FloatArray = np.clip(x, np.nextafter(self.lower, np.inf), np.nextafter(self.upper, -np.inf))
        return inside


def _put(mine: Array, rows: IntArray, theirs: Array, which: IntArray) -> Array:
    out = mine.copy()
    out[rows] = theirs[which]
    return out


def _put_fields(mine: Fields, rows: IntArray, theirs: Fields, which: IntArray) -> Fields:
    names = [field.name for field in dataclasses.fields(mine)]
    return dataclasses.replace(mine, **{n: _put(getattr(mine, n), rows, getattr(theirs, n), which) for n in names})


def check_bounds(lower: FloatArray, upper: FloatArray) -> None:
    """Refuse bounds that are NaN or not in order; the message names the dimension."""
    bad = ~(lower < upper)
    if bad.any():
        j = int(np.argmax(bad))
        raise InputError(
            f"bounds: lower[{j}] = {float(lower[j])!r}, upper[{j}] = {float(upper[j])!r}; allowed: lower < upper"
        )
