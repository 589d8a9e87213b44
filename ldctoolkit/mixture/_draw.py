"""Exact draws from one truncated normal: plain rejection where the box is likely, tilted accept-reject elsewhere."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np

from ldctoolkit.arrays import BoolArray, FloatArray, IntArray
from ldctoolkit.errors import ModelError
from ldctoolkit.mixture._separation import Separation
from ldctoolkit.mixture._univariate import Restricted

_PLAIN_REJECTION: Final = 0.25
"""Above this probability of the box plain rejection is the cheaper exact sampler."""

_MAX_PROPOSALS: Final = 2000
"""Proposals per wanted event before sampling is given up (far more than either route takes where it works)."""

_DEEPEST: Final = -1e13
"""Below this ln P the logarithms that decide on acceptance are rounded by more than a thousandth."""


@dataclasses.dataclass(frozen=True)
class Sampler:
    """One component made ready for drawing."""

    mu: FloatArray  # (d,): mean before truncation, and the box
    lower: FloatArray  # (d,)
    upper: FloatArray  # (d,)
    bounded: IntArray  # (p,): dimensions with a finite bound, and the others
    free: IntArray  # (p,)
    factor: FloatArray  # (p, p): of the covariance of the bounded ones
    box: Separation | None  # that component alone
    slope: FloatArray  # (p, d - p): the free ones are mu + slope^T z + rest times noise
    rest: FloatArray  # (p, d - p): the free ones are mu + slope^T z + rest times noise
    log_p: float  # ln P
    plain: bool  # whether plain rejection is used

    @classmethod
    def of(
        cls,
        mu: FloatArray,
        Sigma: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        box: Separation | None,
        log_p: float,
    ) -> Sampler:
        """Prepare a component; `box` holds it alone, None where no dimension is bounded."""
        bounded = np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))
        free = np.setdiff1d(np.arange(mu.size), bounded)
        factor = np.empty((0, 0)) if box is None else box.factor[0]
        slope = np.linalg.solve(factor, Sigma[np.ix_(bounded, free)])
        rest = np.linalg.cholesky(Sigma[np.ix_(free, free)] - slope.T @ slope)
        plain = box is None or log_p > np.log(_PLAIN_REJECTION)
        return cls(mu, lower, upper, bounded, free, factor, box, slope, rest, log_p, plain)

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Points (n, d), strictly inside the box."""
        d = self.mu.size
        out = np.empty((n, d))
        if n == 0:
            return out
        rate = self._acceptance()
        found = proposed = 0
        while found < n:
            if proposed > _MAX_PROPOSALS * (n + 10):
                raise self._give_up()
            missing = n - found
            m = int((missing + 2.0 * np.sqrt(missing)) / rate) + 4
            z = (self._plain(m, rng) if self.plain else self._tilted(m, rng))[:, :missing]
            proposed += m
            self._place(z, rng, out[found : found + z.shape[1]])
            found += z.shape[1]
        return out

    def _acceptance(self) -> float:
        """Share of proposals that are kept."""
        if self.box is None:
            return 1.0
        if self.plain:
            return float(np.exp(self.log_p))
        if not np.isfinite(self.box.log_peak[0]) or not self.log_p > _DEEPEST:
            raise self._give_up()
        return float(np.exp(np.clip(self.log_p - self.box.log_peak[0], -5.0, 0.0)))

    def _give_up(self) -> ModelError:
        return ModelError(
            f"truncated normal: its box holds exp({self.log_p:.4g}) of the probability, and no proposal reaches it; "
            "refit with fewer components or a larger prior_strength"
        )

    def _place(self, z: FloatArray, rng: np.random.Generator, out: FloatArray) -> None:
        """Whitened bounded variables (p, n) as rows of all variables."""
        b, f = self.bounded, self.free
        x = self.factor @ z
        for row, j in enumerate(b):
            # rounding may set a point on its bound: the density knows no such points
            inside = np.nextafter(self.lower[j], np.inf), np.nextafter(self.upper[j], -np.inf)
            out[:, j] = np.minimum(np.maximum(x[row] + self.mu[j], inside[0]), inside[1])
        if f.size:
            y = self.slope.T @ z + self.rest @ rng.standard_normal((f.size, out.shape[0]))
            out[:, f] = y.T + self.mu[f]

    def _plain(self, m: int, rng: np.random.Generator) -> FloatArray:
        z = rng.standard_normal((self.bounded.size, m))
        if self.box is None:
            return z
        x = self.factor @ z
        keep: BoolArray = np.ones(m, dtype=bool)
        for row, j in enumerate(self.bounded):
            keep &= x[row] > self.lower[j] - self.mu[j]
            keep &= x[row] < self.upper[j] - self.mu[j]
        return z[:, keep]

    def _tilted(self, m: int, rng: np.random.Generator) -> FloatArray:
        box = self.box
        if box is None:
            raise self._give_up()
        p = self.bounded.size
        u = rng.random((p, m))
        z = np.empty((p, m))
        psi = np.full(m, 0.5 * float(box.tilt[0] @ box.tilt[0]) - box.log_peak[0])
        for j in range(p):
            shift = box.strict[0, j, :j] @ z[:j] + box.tilt[0, j]
            inner = Restricted.of(box.lower[0, j] - shift, box.upper[0, j] - shift)
            z[j] = inner.quantile(u[j], 1.0 - u[j]) + box.tilt[0, j]
            psi += inner.log_mass - z[j] * box.tilt[0, j]
        with np.errstate(divide="ignore"):
            keep = (np.log(rng.random(m)) < psi) & np.isfinite(psi)
        return z[:, keep]
