"""A mixture with known parameters: density, shares and sampling on its box."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import numpy.typing as npt

from ldctoolkit.mixture._expectation import Components, FloatArray, log_density, log_terms, shares
from ldctoolkit.mixture._transform import Transform
from ldctoolkit.mixture.truncated_normal import TruncatedNormal

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

SAMPLE_BLOCK: Final = 1024
"""Events drawn from one random stream; fixed, so that the first m of n samples do not depend on n."""


@dataclasses.dataclass(frozen=True)
class Distribution:
    """Density sum_k eta_k g_k/P_k in the coordinates of a transform.

    Attributes
    ----------
    weights : (K,)
        eta_k.
    truncated : TruncatedNormal
        The components, in the transform's coordinates.
    transform : Transform
        From the data's units; it holds the box in them.
    """

    weights: FloatArray
    truncated: TruncatedNormal
    transform: Transform

    @property
    def dimension(self) -> int:
        """Number of columns d."""
        return int(self.truncated.mu.shape[1])

    def _own_units(self) -> tuple[Components, FloatArray, FloatArray]:
        """Components in units of the mixture's own spread: the features x_i x_j would otherwise cancel."""
        t = self.truncated
        location = self.weights @ t.mu
        scale = np.sqrt(self.weights @ np.diagonal(t.Sigma, axis1=1, axis2=2))
        scaled = Components(
            self.weights, (t.mu - location) / scale, t.Sigma / (scale[:, None] * scale), t.log_probability
        )
        return scaled, location, scale

    def inside(self, x: FloatArray) -> BoolArray:
        """Which rows lie in the closed box, (n,)."""
        out: BoolArray = np.all((x >= self.transform.lower) & (x <= self.transform.upper), axis=1)
        return out

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log-density of each row, (n,); -inf outside the box, and on a bound that is mapped to infinity."""
        scaled, location, scale = self._own_units()
        y = self.transform.forward(x)
        inside = self.inside(x) & np.isfinite(y).all(axis=1)
        if not inside.all():
            out = np.full(x.shape[0], -np.inf)
            if inside.any():
                out[inside] = self.log_density(x[inside])
            return out
        values = log_density(y, scaled, location, scale) - float(np.log(scale).sum())
        return values if self.transform.identity else values + self.transform.log_slope(x)

    def shares(self, x: FloatArray) -> FloatArray:
        """Share of each component in each row, (n, K); rows inside the box."""
        scaled, location, scale = self._own_units()
        return shares(log_terms((self.transform.forward(x) - location) / scale, scaled))

    def sample_block(self, seed: int, key: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """`SAMPLE_BLOCK` events and their components, from the random stream named by (seed, key)."""
        rng = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))
        label = rng.choice(self.weights.size, size=SAMPLE_BLOCK, p=self.weights / self.weights.sum())
        y = np.empty((SAMPLE_BLOCK, self.dimension))
        for k in range(self.weights.size):
            rows = np.flatnonzero(label == k)
            y[rows] = self.truncated.sample(rows.size, rng, component=k)
        return self.transform.inverse(y), label.astype(np.int64)

    def sample(self, n: int, seed: int) -> tuple[FloatArray, IntArray]:
        """Draw n events (n, d) and their components (n,); the first m of n do not depend on n."""
        parts = [self.sample_block(seed, (block,)) for block in range(-(-n // SAMPLE_BLOCK))]
        if not parts:
            return np.empty((0, self.dimension)), np.empty(0, dtype=np.int64)
        return np.concatenate([p[0] for p in parts])[:n], np.concatenate([p[1] for p in parts])[:n]

    def check_samplable(self) -> None:
        """Draw from every component: a `ModelError` here rather than in a later `sample`."""
        for k in np.flatnonzero(self.weights > 0.0):
            self.truncated.sample(4, 0, component=int(k))
