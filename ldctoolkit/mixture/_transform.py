"""Coordinates in which a mixture is fitted: a bounded dimension as it is, or mapped onto the whole line."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from ldctoolkit.arrays import FloatArray
from ldctoolkit.errors import InputError, nearest

Kind = Literal["none", "log", "logit"]

KINDS: Final = ("none", "log", "logit", "auto")


@dataclasses.dataclass(frozen=True)
class Transform:
    """One monotone, increasing map a dimension."""

    kinds: tuple[Kind, ...]
    lower: FloatArray  # (d,): the box in the data's units
    upper: FloatArray  # (d,): the box in the data's units

    @classmethod
    def of(cls, wanted: str | Sequence[str] | None, lower: FloatArray, upper: FloatArray) -> Transform:
        """The caller's wish, checked against the bounds."""
        d = lower.size
        names = (
            ["none"] * d if wanted is None else [wanted] * d if isinstance(wanted, str) else [str(w) for w in wanted]
        )
        if len(names) != d:
            raise InputError(f"transform: {len(names)} names; allowed: one name, or {d}, one per column")
        for name in names:
            if name not in KINDS:
                raise InputError(f"transform: {name!r}; {nearest(name, KINDS)}")
        ends = np.isfinite(lower).astype(int) + np.isfinite(upper)
        kinds: list[Kind] = []
        for j, name in enumerate(names):
            if name == "auto":
                name = ("none", "log", "logit")[ends[j]]
            if name == "log" and ends[j] != 1:
                raise InputError(f"transform: 'log' for column {j} with {ends[j]} finite bounds; allowed: exactly one")
            if name == "logit" and ends[j] != 2:
                raise InputError(f"transform: 'logit' for column {j} with {ends[j]} finite bounds; allowed: two")
            kinds.append("log" if name == "log" else "logit" if name == "logit" else "none")
        return cls(tuple(kinds), lower, upper)

    @property
    def identity(self) -> bool:
        """Whether nothing is mapped."""
        return all(kind == "none" for kind in self.kinds)

    def box(self) -> tuple[FloatArray, FloatArray]:
        """The box in the new coordinates: a mapped dimension is open."""
        mapped = np.array([kind != "none" for kind in self.kinds])
        return np.where(mapped, -np.inf, self.lower), np.where(mapped, np.inf, self.upper)

    def forward(self, x: FloatArray) -> FloatArray:
        """Rows (n, d) in the new coordinates; a value on a bound is infinite, one outside NaN."""
        if self.identity:
            return x
        out = x.copy()
        with np.errstate(divide="ignore", invalid="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    out[:, j] = np.log(x[:, j] - low) - np.log(high - x[:, j])
                elif kind == "log":
                    out[:, j] = np.log(x[:, j] - low) if np.isfinite(low) else -np.log(high - x[:, j])
        return out

    def inverse(self, y: FloatArray) -> FloatArray:
        """Rows in the data's units, strictly inside the box."""
        if self.identity:
            return y
        out = y.copy()
        with np.errstate(over="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    share = 1.0 / (1.0 + np.exp(-np.abs(y[:, j])))
                    near = (high - low) * (1.0 - share)
                    out[:, j] = np.where(y[:, j] < 0.0, low + near, high - near)
                elif kind == "log":
                    out[:, j] = low + np.exp(y[:, j]) if np.isfinite(low) else high - np.exp(-y[:, j])
        inside: FloatArray = np.clip(out, np.nextafter(self.lower, np.inf), np.nextafter(self.upper, -np.inf))
        return inside

    def log_slope(self, x: FloatArray) -> FloatArray:
        """Logarithm of the maps' derivatives, (n,): what a density in the new coordinates gains in the data's."""
        out = np.zeros(x.shape[0])
        with np.errstate(divide="ignore", invalid="ignore"):
            for j, kind in enumerate(self.kinds):
                low, high = self.lower[j], self.upper[j]
                if kind == "logit":
                    out += np.log(high - low) - np.log(x[:, j] - low) - np.log(high - x[:, j])
                elif kind == "log":
                    out -= np.log(x[:, j] - low) if np.isfinite(low) else np.log(high - x[:, j])
        return out
